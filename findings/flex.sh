#!/usr/bin/env bash
# MuJoCo 4.0.0, a `flexcomp` that is read from a file: vertices at the same place become one point
# (OBJ and GMSH), and vertices of an OBJ without a face are no point. Pins count after the one,
# before the other.
# Seen: two triangles that lie along each other with vertices of their own (an open seam, 6
# vertices) are one sheet of 4 points, and hold together; `type="direct"` keeps 6. `pin id="3"`
# holds (1, 1), the file's fifth vertex, where the fourth is (1, 0); id 4 is "out of range".
# Behind a vertex without a face there are 4 points for 5, but `pin id="1"` holds the file's
# second vertex, which is point 0.
# The XML reference says that the file's vertex and face data become the points, and that pins
# have the points' numbers, from 0; neither joining nor leaving out is named there. So panels of a
# garment are sewn here and fall apart elsewhere, and a pin by number may hold another place.
# Exits with a status other than 0 if that changes.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q mujoco==4.0.0 numpy==2.2.6
cd "$folder"
venv/bin/python - 2>/dev/null <<'PYTHON'
import mujoco

MODEL = """<mujoco><worldbody><flexcomp name="f" %s dim="2" mass="1" radius="0.01">
<contact selfcollide="none"/>%s</flexcomp></worldbody></mujoco>"""


def points(source, inside=""):
    """The places of a flex's points, and which of them are pinned."""
    model = mujoco.MjModel.from_xml_string(MODEL % (source, inside))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    places = [tuple(round(float(c), 6) for c in p[:2]) for p in data.flexvert_xpos]
    return places, [p for p, body in zip(places, model.flex_vertbodyid) if body == 0]


def write(name, lines):
    with open(name, "w") as file:
        file.write("\n".join(lines) + "\n")


seam = [(0, 0), (1, 0), (0, 1), (1, 0), (1, 1), (0, 1)]
triangles = [(1, 2, 3), (4, 5, 6)]
write("seam.obj", [f"v {x} {y} 0" for x, y in seam] + ["f %d %d %d" % t for t in triangles])
write("seam.msh", [
    "$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$Nodes", "6",
    *(f"{i} {x} {y} 0" for i, (x, y) in enumerate(seam, 1)), "$EndNodes", "$Elements", "2",
    *(f"{i} 2 2 1 1 %d %d %d" % t for i, t in enumerate(triangles, 1)), "$EndElements",
])
flat = " ".join(f"{x} {y} 0" for x, y in seam)
sources = {
    "mesh": 'type="mesh" file="seam.obj"',
    "gmsh": 'type="gmsh" file="seam.msh"',
    "direct": f'type="direct" point="{flat}" element="0 1 2 3 4 5"',
}
counts = {kind: len(points(source)[0]) for kind, source in sources.items()}
print(mujoco.__version__, "points of a seam of 6 vertices:", counts)
assert counts == {"mesh": 4, "gmsh": 4, "direct": 6}

for kind in ("mesh", "gmsh"):
    pinned = points(sources[kind], '<pin id="3"/>')[1]
    print(kind, "pin 3 holds", pinned, "the file has", seam[3])
    assert pinned == [(1, 1)]

square = [(9, 9), (0, 0), (1, 0), (1, 1), (0, 1)]
write("first.obj", [f"v {x} {y} 0" for x, y in square] + ["f 2 3 4", "f 2 4 5"])
places, pinned = points('type="mesh" file="first.obj"', '<pin id="1"/>')
print("a loose vertex first:", places, "pin 1 holds", pinned)
assert places == square[1:] and pinned == [(0, 0)]
PYTHON
