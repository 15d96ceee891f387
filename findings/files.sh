#!/usr/bin/env bash
# trimesh 5.2.0 reads a GLB's vertices as they stand in the file's base table: sparse values
# (glTF 2.0, 3.6.2.3), normalized integers (3.6.2.2; KHR_mesh_quantization) and default weights of
# morph targets (3.7.2.2) are passed over without a word.
# Seen: a unit square whose two upper corners are sparse values is read as a line (y = 0 to 0); one
# in normalized int16 as 32767 wide; one that a morph target of weight 1 moves to z = 1 at z = 0.
# Exits with a status other than 0 if that changes.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q trimesh==5.2.0 numpy==2.2.6
"$folder/venv/bin/python" - <<'PYTHON'
import io, json, struct

import numpy as np
import trimesh

corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
faces = np.array([0, 1, 2, 0, 2, 3], "<u2")


def read(tables, accessors, mesh=None, **more):
    """The vertices that trimesh reads of a file with these tables."""
    views, body = [], b""
    for table in tables:
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": table.nbytes})
        body += table.tobytes()
    about = {
        "asset": {"version": "2.0"}, "buffers": [{"byteLength": len(body)}], "bufferViews": views,
        "accessors": accessors, "scenes": [{"nodes": [0]}], "scene": 0, "nodes": [{"mesh": 0}],
        "meshes": [mesh or {"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}], **more,
    }
    text = json.dumps(about).encode()
    text += b" " * (-len(text) % 4)
    body += b"\0" * (-len(body) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(body), 0x004E4942) + body
    data = b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks
    return trimesh.load(io.BytesIO(data), file_type="glb", process=False).to_geometry().vertices


def of(view, kind, count, shape, **more):
    return {"bufferView": view, "componentType": kind, "count": count, "type": shape, **more}


bounds = {"min": [0, 0, 0], "max": [1, 1, 0]}
index = of(1, 5123, 6, "SCALAR")
sparse = {
    "count": 2,
    "indices": {"bufferView": 2, "componentType": 5123},
    "values": {"bufferView": 3},
}
below = corners * np.array([1, 0, 1], "<f4")
x = read(
    (below, faces, np.array([2, 3], "<u2"), corners[2:]),
    [of(0, 5126, 4, "VEC3", sparse=sparse, **bounds), index],
)
print(trimesh.__version__, "sparse: y from", x[:, 1].min(), "to", x[:, 1].max())
assert x[:, 1].max() == 0

whole = np.pad((corners * 32767).astype("<i2"), ((0, 0), (0, 1)))
views = [
    {"buffer": 0, "byteOffset": 0, "byteLength": 32, "byteStride": 8},
    {"buffer": 0, "byteOffset": 32, "byteLength": 12},
]
limits = {"min": [0, 0, 0], "max": [32767, 32767, 0]}
x = read(
    (whole, faces),
    [of(0, 5122, 4, "VEC3", normalized=True, **limits), index],
    bufferViews=views,
    extensionsUsed=["KHR_mesh_quantization"],
    extensionsRequired=["KHR_mesh_quantization"],
)
print("normalized: x to", x[:, 0].max())
assert x[:, 0].max() == 32767

up = np.tile(np.array([0, 0, 1], "<f4"), (4, 1))
primitive = {"attributes": {"POSITION": 0}, "indices": 1, "targets": [{"POSITION": 2}]}
x = read(
    (corners, faces, up),
    [of(0, 5126, 4, "VEC3", **bounds), index, of(2, 5126, 4, "VEC3", min=[0, 0, 1], max=[0, 0, 1])],
    mesh={"primitives": [primitive], "weights": [1.0]},
)
print("morphed: z to", x[:, 2].max())
assert x[:, 2].max() == 0
PYTHON
