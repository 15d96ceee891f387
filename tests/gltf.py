"""GLB files by hand and by trimesh: unit squares, and what the format can say of them."""

import json
import struct

import numpy as np
import trimesh

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)


def glb(*placements):
    """A GLB file of unit squares, each moved and scaled by a matrix."""
    scene = trimesh.Scene()
    for matrix in placements:
        square = trimesh.Trimesh(CORNERS, [[0, 1, 2], [0, 2, 3]], process=False)
        scene.add_geometry(square, transform=matrix)
    return scene.export(file_type="glb")


# A square's two triangles in glTF: its accessors and what its nodes show.
GLTF = {
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
    ],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
    "nodes": [{"mesh": 0}],
    "scenes": [{"nodes": [0]}],
}
SQUARE_GLTF = (CORNERS.astype("<f4"), np.array([0, 1, 2, 0, 2, 3], "<u2"))


def gltf(tables=SQUARE_GLTF, **about):
    """A GLB file by hand: a view for each table, and what is said in another way than in `GLTF`."""
    about = {**GLTF, **about}
    begin = np.cumsum([0, *(-(-t.nbytes // 4) * 4 for t in tables)]).tolist()
    body = b"".join(t.tobytes().ljust(-(-t.nbytes // 4) * 4, b"\0") for t in tables)
    views = [
        {"buffer": 0, "byteOffset": at, "byteLength": t.nbytes}
        for at, t in zip(begin[:-1], tables, strict=True)
    ]
    about = {"bufferViews": views, "buffers": [{"byteLength": len(body)}], **about}
    text = json.dumps(about).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(body), 0x004E4942) + body
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def accessor(number, **about):
    """The accessors of `GLTF`, one of them said otherwise."""
    return [{**a, **(about if n == number else {})} for n, a in enumerate(GLTF["accessors"])]


def primitive(**about):
    """The meshes of `GLTF`, its primitive said otherwise."""
    return [{"primitives": [{**GLTF["meshes"][0]["primitives"][0], **about}]}]
