#!/usr/bin/env bash
# meshio 5.3.5 reads an OBJ's relative numbers (`f -4 -3 -2`: counted back from the last vertex so
# far) as if they were absolute: 1 is taken away, so -1 is -2. NumPy then counts from the end, and
# every face is silently made of its neighbours' vertices; the oldest vertex is out of bounds.
# Seen: a square of four vertices, `f -4 -3 -2` and `f -4 -2 -1`, is [-5, -4, -3] and [-5, -3,
# -2]; two triangles, each after its own vertices, are [-4, -3, -2] twice: one place for two.
# libigl 2.6.3 and pyvista 0.49.1 read both right. (trimesh 5.2.0 counts from the end of the file,
# its issue 2364: right in the first file, one triangle twice in the second.) meshio's
# documentation names OBJ among what it reads, without this limit.
# Exits with a status other than 0 if that changes.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q meshio==5.3.5 libigl==2.6.3 pyvista==0.49.1 trimesh==5.2.0 \
  numpy==2.2.6
cd "$folder"
printf 'v %s\n' '0 0 0' '1 0 0' '1 1 0' '0 1 0' > square.obj
printf 'f %s\n' '-4 -3 -2' '-4 -2 -1' >> square.obj
for x in 0 5; do
  printf "v $x 0 0\nv $((x + 1)) 0 0\nv $((x + 1)) 1 0\nf -3 -2 -1\n"
done > two.obj
venv/bin/python - <<'PYTHON'
import igl
import meshio
import numpy as np
import pyvista
import trimesh

right = {"square.obj": [[0, 1, 2], [0, 2, 3]], "two.obj": [[0, 1, 2], [3, 4, 5]]}
seen = {"square.obj": [[-5, -4, -3], [-5, -3, -2]], "two.obj": [[-4, -3, -2]] * 2}
for name in right:
    mesh = meshio.read(name)
    faces = np.vstack([block.data for block in mesh.cells]).tolist()
    print("meshio", meshio.__version__, name, faces)
    assert faces == seen[name]
    assert np.asarray(igl.read_triangle_mesh(name)[1]).tolist() == right[name]
    assert pyvista.read(name).faces.reshape(-1, 4)[:, 1:].tolist() == right[name]
least = trimesh.load("two.obj", process=False).vertices[:, 0].min()
print("trimesh", trimesh.__version__, "two.obj: x from", least)
assert least == 5
PYTHON
