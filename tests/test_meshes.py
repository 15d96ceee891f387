"""Cloth from mesh files: what is read, what is refused, what its springs and masses are."""

import struct
import time

import numpy as np
import pytest
import trimesh
from shirt import shirt

from taichi_cloth.cli.main import main
from taichi_cloth.errors import InputError
from taichi_cloth.files import meshes
from taichi_cloth.files.meshes import surface as surfaces
from taichi_cloth.scene import library, meshfile, scenefile
from taichi_cloth.scene.mesh import mesh, placed
from taichi_cloth.scene.source import SceneSource

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)


def ply(vertices="0 0 0\n1 0 0\n1 1 0\n0 1 0\n", faces="4 0 1 2 3\n", form="ascii", n=4, m=1):
    """A PLY file, its body as text."""
    return (
        f"ply\nformat {form} 1.0\nelement vertex {n}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {m}\nproperty list uchar int vertex_indices\nend_header\n"
        f"{vertices}{faces}"
    )


def binary_ply(order="<", points=CORNERS, faces=((0, 1, 2), (0, 2, 3))):
    """A binary PLY file."""
    form = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    rows = b"".join(
        struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces
    )
    return (
        ply("", "", form, len(points), len(faces)).encode()
        + np.asarray(points, f"{order}f4").tobytes()
        + rows
    )


def stl(triangles=((0, 1, 2), (0, 2, 3)), points=CORNERS, said=None):
    """A binary STL file."""
    facets = b"".join(
        struct.pack("<12fH", 0, 0, 0, *np.asarray(points)[list(t)].ravel(), 0) for t in triangles
    )
    return b"\0" * 80 + struct.pack("<I", len(triangles) if said is None else said) + facets


def glb(*placements):
    """A GLB file of unit squares, each moved and scaled by a matrix."""
    scene = trimesh.Scene()
    for matrix in placements:
        square = trimesh.Trimesh(CORNERS, [[0, 1, 2], [0, 2, 3]], process=False)
        scene.add_geometry(square, transform=matrix)
    return scene.export(file_type="glb")


# name of the file, its content, what the refusal says
MALFORMED = [
    ("empty.obj", "", "is empty"),
    ("blank.ply", " \n\n", "is empty"),
    ("nan.obj", SQUARE.replace("v 1 1 0", "v 1 nan 0") + "f 1 2 3 4\n", "line 3: vertex 2 is not"),
    ("inf.obj", SQUARE.replace("v 1 1 0", "v 1 1 inf") + "f 1 2 3 4\n", "line 3: vertex 2 is not"),
    ("nan.ply", ply().replace("1 1 0", "1 nan 0"), "line 12: vertex 2 is not finite"),
    ("nan.stl", stl(points=CORNERS * [1, np.nan, 1]), "face 0 has a corner that is not finite"),
    ("huge.obj", SQUARE.replace("v 1 1 0", "v 1e30 1 0") + "f 1 2 3 4\n", "beyond 1e+12"),
    ("points.obj", SQUARE, "has no faces"),
    ("faces.obj", "f 1 2 3\n", "line 1: face 0 has no vertex 3; the file has 1 to 0"),
    ("points.ply", ply(faces="", m=0), "has no faces"),
    ("none.ply", ply().replace("element face 1\nproperty list uchar int vertex_indices\n", ""),
     "has no faces"),
    ("none.stl", stl(()), "has no vertices"),
    ("above.obj", SQUARE + "f 1 2 5\n", "line 5: face 0 has no vertex 5; the file has 1 to 4"),
    ("zero.obj", SQUARE + "f 0 1 2\n", "line 5: face 0 has no vertex 0"),
    ("back.obj", SQUARE + "f -1 -2 -5\n", "line 5: face 0 has no vertex -5"),
    ("above.ply", ply(faces="4 0 1 2 9\n"), "line 14: face 0 has no vertex 9"),
    ("two.obj", SQUARE + "f 1 2\n", "line 5: face 0 has 2 corners"),
    ("two.ply", ply(faces="2 0 1\n"), "line 14: face 0 has 2 corners"),
    ("twice.obj", SQUARE + "f 1 2 3\nf 3 1 2\nf 1 3 4\n", "line 6: face 1 is face 0 again"),
    ("corner.obj", SQUARE + "f 1 2 3 3\nf 1 3 4\n", "line 5: face 0 is degenerate: it has vertex 2"),
    ("line.obj", SQUARE + "v 2 0 0\nf 1 2 5\nf 1 2 3 4\n", "line 6: face 0 is degenerate: its cor"),
    ("flat.obj", "v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "line 4: face 0 is degenerate"),
    ("folded.stl", stl([(0, 1, 1)]), "face 0 is degenerate"),
    ("fin.obj", SQUARE + "v 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 3 5\n",
     "line 8: face 2 is the third at the edge of vertices 0 and 2"),
    ("loose.obj", SQUARE + "f 1 2 3\n", "line 4: vertex 3 is a corner of no face"),
    ("word.obj", SQUARE + "f 1 two 3\n", "line 5: a face has numbers of vertices, not '1 two 3'"),
    ("short.obj", "v 0 0\nf 1 2 3\n", "line 1: a vertex has three numbers, not '0 0'"),
    ("prose.obj", "Dear reader,\nthis is a letter.\n", "line 1: is not of an OBJ file"),
    ("comments.obj", "# nothing\ng here\n", "no line of vertices or faces"),
    ("garbage.obj", b"\x00\x01\xfe" * 50, "is binary"),
    ("garbage.ply", b"\x00\x01\xfe" * 50, "does not begin with 'ply'"),
    ("garbage.stl", b"\x07\x01\xfe" * 50, "is cut short, or not an STL file"),
    ("garbage.glb", b"\x00\x01\xfe" * 50, "does not begin with 'glTF'"),
    ("short.stl", b"\x00\x01\xfe", "is not an STL file: it has 3 bytes"),
    ("short.ply", ply(n=5), "is cut short: it has 0 of 1 x 'face'"),
    ("cut.ply", binary_ply()[:-3], "is cut short: it has 1 of 2 x 'face'"),
    ("points-cut.ply", binary_ply()[:-40], "is cut short: it has 3 of 4 x 'vertex'"),
    ("header.ply", "ply\nformat ascii 1.0\nelement vertex 3\n", "no 'end_header'"),
    ("header2.ply", ply().replace("element face 1", "element face one"), "line 7: is not of a PLY"),
    ("form.ply", ply(form="morse"), "line 2: is not of a PLY header"),
    ("plane.ply", ply().replace("property float z\n", ""), "is no 'vertex': '0 0 0'"),
    ("cut.stl", stl()[:-20], "is cut short, or not an STL file: its header says 2 triangles, and "),
    ("cut-text.stl", "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", "no 'endsolid'"),
    ("word.stl", "solid a\nfacet\nvertex 0 0\n", "line 3: a vertex has three numbers"),
    ("cut.glb", glb(np.eye(4))[:-20], "is cut short: it says"),
    ("version.glb", b"glTF\x01\0\0\0\x0c\0\0\0", "is of glTF version 1"),
    ("broken.glb", b"glTF\x02\0\0\0\x20\0\0\0" + b"{" * 20, "is damaged, or not a GLB file"),
    ("many.stl", stl(said=2**31), f"has {2**31} faces, more than {surfaces.LARGEST_COUNT}"),
    ("many.ply", ply(n=2**40, form="binary_little_endian"), f"has {2**40} vertices, more than"),
    ("shirt.txt", SQUARE, "'.txt': is no mesh that can be read"[:0] + "is no mesh that can be read"),
    ("shirt", SQUARE, "is no mesh that can be read, by its suffix; known: .obj, .ply, .stl, .glb"),
    ("shirt.off", SQUARE, "is no mesh that can be read, by its suffix; "),
]  # fmt: skip


@pytest.mark.parametrize(("name", "content", "says"), MALFORMED, ids=[m[0] for m in MALFORMED])
def test_what_is_no_sound_surface_is_refused_in_a_line(tmp_path, name, content, says):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as refused:
        meshfile.read(path)
    assert str(refused.value).startswith(str(path)) and says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_files_that_are_none_or_too_large_are_refused_unread(tmp_path):
    (tmp_path / "large.obj").touch()
    with open(tmp_path / "large.obj", "r+b") as file:
        file.truncate(2**40)
    (tmp_path / "folder.obj").mkdir()
    for name, says in (
        ("large.obj", "has more than 512 MiB"),
        ("folder.obj", "is a folder; name the mesh in it"),
        ("missing.obj", "there is no such file"),
    ):
        begin = time.process_time()
        with pytest.raises(InputError, match=says):
            meshfile.read(tmp_path / name)
        assert time.process_time() - begin < 5
