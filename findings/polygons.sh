#!/usr/bin/env bash
# The area of a concave polygon depends on the corner that it begins with, in pyvista 0.49.1 (its
# own `area`, while its `triangulate()` is right), and in what libigl 2.6.3 and trimesh 5.2.0
# read: they cut it into a fan from the first corner, and triangles outside the polygon count as
# cloth.
# Seen: an L of area 5 with six corners is 9 from four of the six first corners, 5 from two. Of a
# dart of area 0.4 with four corners libigl and trimesh make 3.6 from two of four; pyvista is
# right there. MuJoCo 4.0.0 (`flexcomp`) cuts all of them right. pyvista documents `area` as the
# area of 2D cells, with no word on concave ones; trimesh says so of a helper ("may be wrong if
# the holes are non-convex"); libigl says nothing.
# Exits with a status other than 0 if that changes.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pyvista==0.49.1 libigl==2.6.3 trimesh==5.2.0 mujoco==4.0.0 \
  numpy==2.2.6
cd "$folder"
venv/bin/python - 2>/dev/null <<'PYTHON'
import igl
import mujoco
import numpy as np
import pyvista
import trimesh

MODEL = """<mujoco><worldbody><flexcomp name="f" type="mesh" dim="2" mass="1" radius="0.01"
file="polygon.obj"><contact selfcollide="none"/></flexcomp></worldbody></mujoco>"""


def area(points, faces):
    a, b, c = (np.asarray(points, float)[np.asarray(faces)[:, k]] for k in range(3))
    return round(float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2), 3)


def areas(corners):
    """The areas by pyvista, its triangulate(), libigl, trimesh and MuJoCo."""
    with open("polygon.obj", "w") as file:
        file.writelines("v %g %g 0\n" % corner for corner in corners)
        file.write("f " + " ".join(str(i + 1) for i in range(len(corners))) + "\n")
    whole = pyvista.read("polygon.obj")
    model = mujoco.MjModel.from_xml_path("model.xml")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return (
        round(whole.area, 3),
        round(whole.triangulate().area, 3),
        area(*igl.read_triangle_mesh("polygon.obj")[:2]),
        round(trimesh.load("polygon.obj", process=False).area, 3),
        area(data.flexvert_xpos, model.flex_elem.reshape(-1, 3)),
    )


with open("model.xml", "w") as file:
    file.write(MODEL)
ell = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]
dart = [(0, 0), (2, 0), (0.2, 0.2), (0, 2)]
seen = {}
for name, corners in (("L", ell), ("dart", dart)):
    for first in range(len(corners)):
        seen[name, first] = areas(corners[first:] + corners[:first])
        print(name, first, "pyvista, triangulate, libigl, trimesh, MuJoCo:", *seen[name, first])
for first in range(6):
    fan = 5 if first in (0, 3) else 9
    assert seen["L", first] == (fan, 5, fan, fan, 5)
for first in range(4):
    fan = 0.4 if first in (0, 2) else 3.6
    assert seen["dart", first] == (0.4, 0.4, fan, fan, 0.4)
PYTHON
