"""Cloth from mesh files: what is read, what is refused, what its springs and masses are."""

import base64
import struct
import time
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from gltf import CORNERS, SQUARE_GLTF, accessor, glb, gltf, primitive
from scipy.spatial import Delaunay
from shirt import shirt

from taichi_cloth.cli import run_notes
from taichi_cloth.errors import InputError
from taichi_cloth.files import meshes
from taichi_cloth.kernels import methods
from taichi_cloth.limits.eigenmodes import stable_step
from taichi_cloth.limits.network import Network
from taichi_cloth.scene import assignments, hanging, meshfile, scenefile
from taichi_cloth.scene.library import build
from taichi_cloth.scene.library.shirt import FILE
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.mesh import mesh, placed
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.scene.stencils import Stencils, mesh_stencils
from taichi_cloth.scene.triangles import parted

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
SOLID = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 0 1\n"  # corners of a tetrahedron


def ply(vertices="0 0 0\n1 0 0\n1 1 0\n0 1 0\n", faces="4 0 1 2 3\n", form="ascii", n=4, m=1):
    """A PLY file, its body as text."""
    return (
        f"ply\nformat {form} 1.0\nelement vertex {n}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {m}\nproperty list uchar int vertex_indices\nend_header\n"
        f"{vertices}{faces}"
    )


def binary_ply(order="<", points=CORNERS, faces=((0, 1, 2), (0, 2, 3)), ending="\n"):
    """A binary PLY file; ending: of its header's lines."""
    form = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    rows = b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)
    return (
        ply("", "", form, len(points), len(faces)).replace("\n", ending).encode()
        + np.asarray(points, f"{order}f4").tobytes()
        + rows
    )


def stl(triangles=((0, 1, 2), (0, 2, 3)), points=CORNERS, said=None):
    """A binary STL file."""
    facets = b"".join(
        struct.pack("<12fH", 0, 0, 0, *np.asarray(points)[list(t)].ravel(), 0) for t in triangles
    )
    return b"\0" * 80 + struct.pack("<I", len(triangles) if said is None else said) + facets


# The same, as text.
SQUARE_STL = (
    trimesh.Trimesh(CORNERS, [[0, 1, 2], [0, 2, 3]], process=False)
    .export(file_type="stl_ascii")
    .encode()
)


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
    ("faces.obj", "f 1 2 3\n", "line 1: face 0 has no vertex 1; the file has 1 to 0"),
    ("points.ply", ply(faces="", m=0), "has no faces"),
    ("none.ply", ply().replace("element face 1\nproperty list uchar int vertex_indices\n", ""),
     "has no faces"),
    ("none.stl", stl(()), "has no vertices"),
    ("above.obj", SQUARE + "f 1 2 5\n", "line 5: face 0 has no vertex 5; the file has 1 to 4"),
    ("zero.obj", SQUARE + "f 0 1 2\n", "line 5: face 0 has no vertex 0"),
    ("back.obj", SQUARE + "f -1 -2 -5\n", "line 5: face 0 has no vertex -5"),
    ("above.ply", ply(faces="4 0 1 2 9\n"), "line 14: face 0 has no vertex 9"),
    ("half.ply", ply(faces="4 0 1 2.5 3\n"), "line 14: face 0 has no vertex 2.5; give whole"),
    ("nan-corner.ply", ply(faces="4 0 1 nan 3\n"), "line 14: face 0 has no vertex nan"),
    ("two.obj", SQUARE + "f 1 2\n", "line 5: face 0 has 2 corners"),
    ("two.ply", ply(faces="2 0 1\n"), "line 14: face 0 has 2 corners"),
    ("twice.obj", SQUARE + "f 1 2 3\nf 3 1 2\nf 1 3 4\n", "line 6: face 1 is face 0 again"),
    ("corner.obj", SQUARE + "f 1 2 3 3\nf 1 3 4\n", "face 0 is degenerate: it has vertex 2 tw"),
    ("line.obj", SQUARE + "v 2 0 0\nf 1 2 5\nf 1 2 3 4\n", "line 6: face 0 is degenerate: its cor"),
    ("flat.obj", "v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "line 4: face 0 is degenerate"),
    ("folded.stl", stl([(0, 1, 1)]), "face 0 is degenerate"),
    ("fin.obj", SQUARE + "v 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 3 5\n",
     "line 8: face 2 is the third at the edge of vertices 0 and 2"),
    ("word.obj", SQUARE + "f 1 two 3\n", "line 5: a face has numbers of vertices, not '1 two 3'"),
    ("short.obj", "v 0 0\nf 1 2 3\n", "line 1: a vertex has three numbers, not '0 0'"),
    ("prose.obj", "Dear reader,\nthis is a letter.\n", "no line of vertices or faces"),
    ("comments.obj", "# nothing\ng here\n", "no line of vertices or faces"),
    ("garbage.obj", b"\x00\x01\xfe" * 50, "is binary"),
    ("garbage.ply", b"\x00\x01\xfe" * 50, "does not begin with 'ply'"),
    ("garbage.stl", b"\x07\x01\xfe" * 50, "is cut short, or not an STL file"),
    ("garbage.glb", b"\x00\x01\xfe" * 50, "does not begin with 'glTF'"),
    ("short.stl", b"\x00\x01\xfe", "is not an STL file: it has 3 bytes"),
    ("short.ply", ply(n=5), "line 14: is no 'vertex': '4 0 1 2 3'"),
    ("cut.ply", binary_ply()[:-3], "is cut short: it has 1 of 2 x 'face'"),
    ("points-cut.ply", binary_ply()[:-40], "is cut short: it has 2 of 4 x 'vertex'"),
    ("header.ply", "ply\nformat ascii 1.0\nelement vertex 3\n", "no 'end_header'"),
    ("header2.ply", ply().replace("element face 1", "element face one"), "line 7: is not of a PLY"),
    ("form.ply", ply(form="morse"), "line 2: is not of a PLY header"),
    ("plane.ply", ply().replace("property float z\n", ""), "is no 'vertex': '0 0 0'"),
    ("cut.stl", stl()[:-20], "is cut short, or not an STL file: its header says 2 triangles, and "),
    ("more.stl", stl() + b"z", "goes on past its end, or not an STL file: its header says 2 "
     "triangles, and there is room for 2 and 1 byte"),
    ("cut-text.stl", "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", "no 'endsolid'"),
    ("word.stl", "solid a\nfacet\nvertex 0 0\n", "line 3: a vertex has three numbers"),
    ("cut.glb", glb(np.eye(4))[:-20], "is cut short: it says"),
    ("begun.glb", b"glTF\x02", "is cut short: it has 5 bytes"),
    ("version.glb", b"glTF\x01\0\0\0\x0c\0\0\0", "is of glTF version 1"),
    ("broken.glb", b"glTF\x02\0\0\0\x20\0\0\0" + b"{" * 20, "is damaged, or not a GLB file"),
    ("packed.glb", gltf(extensionsRequired=["KHR_draco_mesh_compression"]),
     "needs glTF's extension 'KHR_draco_mesh_compression', which is not read here"),
    ("copies.glb", gltf(nodes=[{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}}]),
     "needs glTF's extension 'EXT_mesh_gpu_instancing'"),
    ("beside.glb", gltf(buffers=[{"byteLength": 60, "uri": "square.bin"}]), "is in another file"),
    ("view.glb", gltf(accessors=accessor(1, count=9)), "is damaged, or not a GLB file: "),
    ("index.glb", gltf((SQUARE_GLTF[0], SQUARE_GLTF[1] + 9)), "a corner is vertex 12 of 4"),
    ("loop.glb", gltf(nodes=[{"mesh": 0, "children": [0]}]), "node 0 is in two places"),
    ("mesh.glb", gltf(nodes=[{"mesh": -1}]), "it has 1 meshes, and none of number -1"),
    ("points.glb", gltf(meshes=primitive(mode=0)), "has no faces"),
    ("many.glb", gltf(accessors=accessor(0, count=2**40)), "vertices, more than 8388608"),
    ("many.stl", stl(said=2**31), f"its header says {2**31} triangles, and there is room for 2"),
    ("many.ply", ply(n=2**40, form="binary_little_endian"), "vertices, more than 8388608"),
    ("shirt.txt", SQUARE, "is no mesh that can be read, by its suffix; "),
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


def test_a_binary_ply_may_begin_with_the_byte_that_ends_lines(tmp_path):
    for ending in ("\n", "\r", "\r\n"):
        first = np.frombuffer(b"\n\r\n\x40", "<f4")[0]
        content = binary_ply(points=[(first, 0, 0), *CORNERS[1:]], ending=ending)
        (tmp_path / "ten.ply").write_bytes(content)
        assert meshes.read(tmp_path / "ten.ply").vertices[0, 0] == first


def test_lines_of_other_kinds_are_passed_over_with_one_note(tmp_path, capsys):
    """Those of the format that say nothing of faces are not named."""
    known = "mtllib a.mtl\no one\ng two\nusemtl red\ns 1\nvt 0 0\nvn 0 0 1\nvp 0 1\nl 1 2\np 1\n"
    others = "ny 0 1\ncurv 0 1 1 2\nny 0 1\n" + "".join(f"kind{n} 0\n" for n in range(9))
    path = tmp_path / "other.obj"
    path.write_text(SQUARE + known + others + "f 1 2 3 4\n")
    says = "12 lines of kinds that are not read: 'ny', 'curv', 'kind0', 'kind1', 'kind2' and 6 more"
    assert meshes.read(path).notes == (f"{says}, from line 15 on",)
    run_notes.note_files(SceneSource(str(path)).build())
    assert capsys.readouterr().err == f"taichi-cloth: note: {path}: {says}, from line 15 on\n"
    path.write_text(SQUARE + known + "f 1 2 3 4\n")
    assert meshes.read(path).notes == ()


LOOSE = "v 9 9 9\nv 0 0 0\nv 1 0 0\nv 7 7 7\nv 1 1 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("name", "content", "first"),
    [
        ("loose.obj", LOOSE + "f 2 3 5 6\n", "vertex 0 (line 1)"),
        ("loose.ply", ply(LOOSE.replace("v ", ""), "4 1 2 4 5\n", n=6), "vertex 0 (line 10)"),
    ],
)
def test_vertices_without_a_face_are_left_out_and_pins_have_the_files_numbers(
    tmp_path, name, content, first
):
    (tmp_path / name).write_text(content)
    surface = meshes.read(tmp_path / name)
    x, triangles = meshfile.read(tmp_path / name)
    np.testing.assert_array_equal(x, CORNERS)
    np.testing.assert_array_equal(surface.number, [1, 2, 4, 5])
    assert sorted(surface.quads[0]) == [0, 1, 2, 3] and triangles.max() == 3
    says = f"2 vertices are corners of no face, and are left out: the first is {first}"
    assert surface.notes == (says,)
    particles, springs, _ = mesh(tmp_path / name, pinned=[4])
    assert particles.fixed.tolist() == [False, False, True, False] and len(springs) == 6
    scene = SceneSource(str(tmp_path / name)).build()  # held at its highest, and of its own size
    assert scene.particles.fixed.tolist() == [False, False, True, True]
    assert f"{tmp_path / name}: {says}" in scene.notes
    for pin, refusal in ((3, "vertex 3 of .* is a corner of no face"), (6, "has 0 to 5")):
        with pytest.raises(InputError, match=refusal):
            mesh(tmp_path / name, pinned=[pin])


def test_a_surface_is_not_made_twice_while_it_is_held(tmp_path):
    """Also where its file is another; one that changed is read anew."""
    (tmp_path / "one.obj").write_text(SQUARE + "f 1 2 3 4\n")
    (tmp_path / "two.obj").write_text(SQUARE + "f 1 2 3 4\n")
    surface = meshes.read(tmp_path / "one.obj")
    assert meshes.read(tmp_path / "two.obj") is surface
    (tmp_path / "one.obj").write_text(SQUARE + "f 1 2 3\nf 1 3 4\n")
    assert len(meshes.read(tmp_path / "one.obj").quads) == 0 != len(surface.quads)


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


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("slashes.obj", SQUARE + "vt 0 0\nvn 0 0 1\nusemtl a\ng one\nf 1/1/1 2//1 3/1 -1/1/1\n"),
        ("split.obj", "# a\r\n" + SQUARE + "f 1 2 \\\n3 4\r\n"),
        ("noted.obj", "# of C:\\meshes\\\n" + SQUARE.replace("\n", " # a corner\n") + "f 1 2 3 4#"),
        ("curves.obj", "cstype bezier\nny 0 1\n" + SQUARE + "vp 0 1\ncurv 0 1 1 2\nfo 1 2 3 4\n"),
        ("feed.obj", "# a\x0cb\n# c\u2028d\n" + SQUARE + "f 1 2 3 4\n"),
        ("last.obj", SQUARE + "f 1 2 3 4 \\"),
        ("marked.obj", "\ufeff" + SQUARE + "f 1 2 3 4\n"),
        ("text.ply", ply()),
        ("marked.ply", "\ufeff" + ply()),
        ("mac.ply", ply().replace("\n", "\r")),
        ("dos.ply", ply().replace("\n", "\r\n")),
        ("mac-binary.ply", binary_ply(ending="\r")),
        ("dos-binary.ply", binary_ply(ending="\r\n")),
        ("little.ply", binary_ply("<", faces=((0, 1, 2, 3),))),
        ("big.ply", binary_ply(">", faces=((0, 1, 2, 3),))),
        ("triangles.ply", binary_ply()),
        ("mixed.ply", binary_ply(points=[*CORNERS, (2, 0, 0)], faces=((0, 1, 2, 3), (1, 4, 2)))),
        ("binary.stl", stl()),
        ("marked.stl", b"\xef\xbb\xbf" + SQUARE_STL),
        ("one.glb", glb(np.eye(4))),
        ("plain.glb", gltf()),
        ("scene.glb", gltf(scenes=[{"nodes": []}, {"nodes": [0]}], scene=1)),
        (
            "fractions.glb",
            gltf(  # KHR_mesh_quantization, with room between vertices
                (np.pad(CORNERS * 32767, ((0, 0), (0, 1))).astype("<i2"), SQUARE_GLTF[1]),
                extensionsRequired=["KHR_mesh_quantization"],
                accessors=accessor(0, componentType=5122, normalized=True),
                bufferViews=[
                    {"buffer": 0, "byteLength": 32, "byteStride": 8},
                    {"buffer": 0, "byteOffset": 32, "byteLength": 12},
                ],
            ),
        ),
        (
            "sparse.glb",
            gltf(
                (
                    (CORNERS * [1, 0, 1]).astype("<f4"),
                    SQUARE_GLTF[1],
                    np.array([2, 3], "<u2"),
                    CORNERS[2:].astype("<f4"),
                ),
                accessors=accessor(
                    0,
                    sparse={
                        "count": 2,
                        "indices": {"bufferView": 2, "componentType": 5123},
                        "values": {"bufferView": 3},
                    },
                ),
            ),
        ),
        (
            "strip.glb",
            gltf(
                (SQUARE_GLTF[0], np.array([0, 1, 3, 2, 2], "<u2")),
                accessors=accessor(1, count=5),
                meshes=primitive(mode=5),
            ),
        ),
        (
            "fan.glb",
            gltf(
                (SQUARE_GLTF[0], np.array([0, 1, 2, 3], "<u2")),
                accessors=accessor(1, count=4),
                meshes=primitive(mode=6),
            ),
        ),
        (
            "mirror.glb",
            gltf(
                ((CORNERS * [-1, 1, 1]).astype("<f4"), SQUARE_GLTF[1][::-1].copy()),
                nodes=[{"mesh": 0, "scale": [-1, 1, 1]}],
            ),
        ),
        (
            "uri.glb",
            gltf(
                buffers=[
                    {
                        "byteLength": 60,
                        "uri": "data:;base64,"
                        + base64.b64encode(b"".join(t.tobytes() for t in SQUARE_GLTF)).decode(),
                    }
                ]
            ),
        ),
    ],
)
def test_every_format_gives_the_square(tmp_path, name, content):
    """Exactly: its corners, its area, and in OBJ and PLY the numbers of its vertices."""
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    x, triangles = meshfile.read(path)
    corners = x[:4] if name.endswith(("obj", "ply")) else x[np.lexsort(x.T[::-1])][[0, 2, 3, 1]]
    np.testing.assert_array_equal(corners, CORNERS)
    a, b, c = (x[triangles[:, n]] for n in range(3))
    normal = np.cross(b - a, c - a) / 2
    assert (normal[:, 2] > 0).all() and normal[:2, 2].sum() == 1.0


def elasticity(particles, springs):
    """The components 1111, 1112, 1122, 1222 and 2222 of a flat sheet of mass 1 an area."""
    a, b = particles.position[springs.between.T]
    squares = ((b - a) ** 2).sum(axis=1)
    p, q = ((b - a)[:, :2] / np.sqrt(squares)[:, None]).T
    made = [(springs.stiffness * squares * p ** (4 - n) * q**n).sum() for n in range(5)]
    return np.array(made) / particles.mass.sum()


@pytest.mark.parametrize("kind", ["squares", "oblongs", "equilateral"])
def test_a_sheet_has_the_stiffness_of_its_material(tmp_path, kind):
    """Isotropic, a Poisson ratio of 1/3, and Young's modulus `stretch`, whatever the resolution."""
    high, wide = {"squares": (1, 1), "oblongs": (1, 1.4), "equilateral": (0.75**0.5, 1)}[kind]
    n = 60
    row, column = np.divmod(np.arange(n * n), n)
    shift = 0.5 * row if kind == "equilateral" else 0.0 * row
    x = np.column_stack([wide * (column + shift), high * row, 0 * row]) / n
    first = (row[:-n] * n + column[:-n])[column[:-n] < n - 1]
    quads = np.column_stack([first, first + 1, first + 1 + n, first + n])
    faces = quads[:, [0, 1, 3, 1, 2, 3]].reshape(-1, 3) if kind == "equilateral" else quads
    lines = [
        *("v {} {} {}".format(*p) for p in x),
        *("f " + " ".join(map(str, f + 1)) for f in faces),
    ]
    (tmp_path / "sheet.obj").write_text("\n".join(lines))
    particles, springs, triangles = mesh(
        tmp_path / "sheet.obj", material=Material(stretch=7.0, density=1.0)
    )
    assert len(triangles) == 2 * (n - 1) ** 2
    wanted = 7.0 * np.array([9 / 8, 0, 3 / 8, 0, 9 / 8])
    np.testing.assert_allclose(elasticity(particles, springs), wanted, atol=7.0 * 1.5 / n)
    if kind != "equilateral":  # also at the border, where a spring has one quad
        np.testing.assert_allclose(elasticity(particles, springs), wanted, atol=1e-12)


def test_a_mesh_is_placed_weighed_and_pinned(tmp_path):
    """Turned about x, then y, then z; stiffness by van Gelder, worked out by hand."""
    (tmp_path / "t.obj").write_text("v 0 0 0\nv 3 0 0\nv 0 4 0\nv 3 4 0\nf 1 2 3\nf 2 4 3\n")
    particles, springs, triangles = mesh(
        tmp_path / "t.obj", scale=2, turn=(90, 90, 0), move=(0, 1, 0), pinned=[3, 0], damping=0.25,
        break_force=3.0, material=Material(stretch=10, density=0.5, thickness=0.5),
    )  # fmt: skip
    # x -> -z; y -> z -> x.
    np.testing.assert_allclose(
        particles.position, [[0, 1, 0], [0, 1, -6], [8, 1, 0], [8, 1, -6]], atol=1e-15
    )
    np.testing.assert_allclose(particles.mass, 0.5 * 48 / 4)  # a quarter of the oblong each
    assert particles.fixed.tolist() == [True, False, False, True]
    assert (particles.thickness == 0.5).all() and (particles.radius == 0.25).all()
    of = {tuple(b): k for b, k in zip(springs.between.tolist(), springs.stiffness, strict=True)}
    assert of == pytest.approx(
        {(0, 1): 10 * 24 / 36, (0, 2): 10 * 24 / 64, (1, 2): 10 * 48 / 100,
         (1, 3): 10 * 24 / 64, (2, 3): 10 * 24 / 36}
    )  # fmt: skip
    np.testing.assert_allclose(springs.rest_length, [6, 8, 10, 8, 6])
    assert (springs.damping == 0.25).all() and (springs.break_force == 3).all()
    np.testing.assert_allclose(
        placed(np.eye(3), 1, (0, 0, 90), (0, 0, 0))[0], [0, 1, 0], atol=1e-15
    )


def test_a_material_gives_a_meshs_springs_damping_and_strength_by_their_width(tmp_path):
    """Every spring breaks at the same strain, and its dashpot is a time of its stiffness."""
    (tmp_path / "shape.obj").write_text(SQUARE + "v 2 0 0\nf 1 2 3 4\nf 2 5 3\n")
    given = Material(stretch=10.0, damping_time=0.5, strength=2.0)
    _, springs, _ = mesh(tmp_path / "shape.obj", material=given)
    np.testing.assert_allclose(springs.damping, 0.5 * springs.stiffness)
    strain = springs.break_force / springs.stiffness / springs.rest_length
    np.testing.assert_allclose(strain, 0.2)


SCENE = """
[world]
size = [9.0, 9.0, 9.0]
up = "y"
gravity = [0.0, -9.81, 0.0]
[particle]
mass = 2.0
[[particles]]
position = [1.0, 1.0, 0.0]
[[meshes]]
file = "cloths/square.obj"
move = [3.0, 4.0, 0.0]
pinned = { above = 4.5 }
"""


def test_a_mesh_file_by_itself_keeps_off_itself(tmp_path, monkeypatch):
    """Unless it is told not to, is too large, or has large triangles among many small ones."""
    (tmp_path / "square.obj").write_text(SQUARE + "f 1 2 3 4\n")
    source = SceneSource(str(tmp_path / "square.obj"))
    scene, radius = source.build(), hanging.RADIUS
    assert scene.features().thick
    np.testing.assert_allclose(scene.particles.thickness, 2 * scene.particles.radius)
    assert scene.particles.radius[0] == pytest.approx(radius * (4 + 2 * np.sqrt(2)) / 6)
    told = replace(source, assignments=(assignments.read("meshes[0].thickness=0"),))
    assert not told.build().features().thick
    x, y = np.meshgrid(np.linspace(0, 1, 8), np.linspace(0, 1, 8))
    fine = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    small = Delaunay(fine[:, :2]).simplices
    uneven = np.vstack([fine, [[1.0, 8.0, 0.0]]])
    assert hanging.keeps_off_itself(fine, small)
    assert not hanging.keeps_off_itself(uneven, np.vstack([small, [[62, 63, 64]]]))
    monkeypatch.setattr(hanging, "MOST_THICK", 3)
    assert not source.build().features().thick


def test_a_surface_that_lies_in_parts_on_itself_is_noted(tmp_path, capsys):
    """With the first such vertex: OBJ and PLY files keep seams that a program parted."""
    seam = SQUARE + "v -0 0 0\nv 1 1 0\nf 1 2 3\nf 5 6 4\n"
    sewn = SQUARE + "f 1 2 3\nf 1 3 4\n"
    for text, says in (
        (seam, "note: 2 particles of surfaces lie exactly where another one does, and nothing joins"
               " the two: the first is 4, on 0; where"),
        (sewn, ""),
    ):  # fmt: skip
        (tmp_path / "seam.obj").write_text(text)
        run_notes.note_parted(SceneSource(str(tmp_path / "seam.obj")).build())
        assert says in (said := capsys.readouterr().err) and bool(said) == bool(says)
    tied = parted(np.zeros((3, 2)), np.array([[0, 1, 2]]), np.array([[2, 0]]))
    np.testing.assert_array_equal(tied, [[0, 1]])


def test_meshes_in_a_scene_file(tmp_path):
    """Numbered after cloths; files are beside the scene; a dumped scene comes back as it was."""
    (tmp_path / "cloths").mkdir()
    (tmp_path / "cloths/square.obj").write_text(SQUARE + "f 1 2 3 4\n")
    more = "density = 0.3\nstretch = 8.0\nparts = 1\nbending = 2e-3\n"
    (tmp_path / "scene.toml").write_text(SCENE + more)
    scene = scenefile.load(tmp_path / "scene.toml")
    np.testing.assert_array_equal(scene.particles.position[1:], CORNERS + [3, 4, 0])
    np.testing.assert_allclose(scene.particles.mass, [2.0, *[0.3 / 4] * 4])
    assert scene.particles.fixed.tolist() == [False, False, False, True, True]
    np.testing.assert_allclose(np.unique(scene.springs.stiffness), 3.0)  # 3/8 each
    assert len(scene.springs) == 6 and scene.triangles.min() == 1 and len(scene.triangles) == 2
    again = scenefile.parse(scenefile.dump(scene))
    np.testing.assert_array_equal(again.springs.stiffness, scene.springs.stiffness)
    np.testing.assert_array_equal(again.triangles, scene.triangles)
    bent = mesh_stencils(scene.particles.position, scene.triangles, 2e-3)
    assert len(bent) == 2  # across the one edge of two triangles
    for name, column in vars(bent).items():
        np.testing.assert_array_equal(getattr(scene.stencils, name), column)
        np.testing.assert_array_equal(getattr(again.stencils, name), column)
    given = ["meshes[0].stretch=16", "meshes[0].bending=1e-3", "meshes[0].pinned=[0]"]
    other = scenefile.load(tmp_path / "scene.toml", [assignments.read(text) for text in given])
    np.testing.assert_allclose(np.unique(other.springs.stiffness), 6.0)
    assert (other.stencils.bending == 1e-3).all() and np.flatnonzero(other.particles.fixed) == [1]


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("scale = 0.0", "line 14: [[meshes]] 0: scale must be positive and finite, is 0"),
        ("scale = -2.0", "line 14: [[meshes]] 0: scale must be positive"),
        ("scale = nan", "line 14: [[meshes]] 0: scale must be finite, is nan"),
        (
            "scale = 1e300",
            "line 14: [[meshes]] 0: scale, turn and move take the mesh to 1e+300, bey",
        ),
        ("turn = [0.0, 90.0]", "turn must have 3 numbers"),
        ("parts = 2", "line 14: [[meshes]] 0: parts: "),
        ("parts = 0", "parts must be at least 1, is 0"),
        ("stretch = -1.0", "stretch must not be negative, is -1"),
        ("bending = -1.0", "line 14: [[meshes]] 0: bending must not be negative, is -1"),
        ("bending = inf", "line 14: [[meshes]] 0: bending must be finite, is inf"),
        ("bending = 'soft'", "bending must be a number"),
        ("density = 0.0", "density must be positive, is 0"),
        ("thickness = -1.0", "thickness must not be negative"),
        ("strength = 1.0", "strength needs stretch"),
        ("break_force = 0.0", "line 14: [[meshes]] 0: break_force must be positive"),
        ("stiffness = 1.0", "line 14: [[meshes]] 0: unknown key 'stiffness'"),
        ("strech = 1.0", "unknown key 'strech'; did you mean 'stretch'?"),
        ("pinned = [4]", "line 13: [[meshes]] 0: pinned: there is no vertex 4"),
        ("pinned = [-1]", "pinned: there is no vertex -1"),
        ("pinned = [0.5]", "pinned must be a list of vertices, by number, or { above = height }"),
        ("pinned = { below = 1 }", "pinned must be a list of vertices"),
        ("pinned = { above = 5.5 }", "is above 5.5; its highest is at 5"),
        ("pinned = { above = 1.0 }", "every vertex of"),
        ("pinned = { above = inf }", "line 13: [[meshes]] 0: pinned.above must be finite, is inf"),
        ("file = 'missing.obj'", "line 11: [[meshes]] 0: "),
        ("file = 'fin.obj'", "fin.obj line 8: face 2 is the third at the edge"),
        ("move = [9.0, 4.0, 0.0]", "[[meshes]] 0 particle 1: position (10, 4, 0) is outside the"),
    ],
)
def test_keys_of_meshes_are_refused_by_their_line(tmp_path, key, says):
    (tmp_path / "cloths").mkdir()
    (tmp_path / "cloths/square.obj").write_text(SQUARE + "f 1 2 3 4\n")
    (tmp_path / "fin.obj").write_text(SQUARE + "v 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 3 5\n")
    lines = SCENE.splitlines()
    name = key.partition(" ")[0]
    here = [n for n, line in enumerate(lines) if line.startswith(f"{name} =")]
    lines[slice(here[0], here[0] + 1) if here else slice(len(lines), None)] = [key]
    (tmp_path / "scene.toml").write_text("\n".join(lines))
    with pytest.raises(InputError) as refused:
        scenefile.load(tmp_path / "scene.toml")
    assert says in str(refused.value) and "scene.toml" in str(refused.value)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (SQUARE + "f 1 2 3 4\n", "open.obj: the mesh is not closed: it has 1 face at the edge"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\nf 3 2 1\n", "open.obj line 5: face 1 is face 0"),
        (2 * (SOLID + "f -4 -3 -2\nf -4 -3 -1\nf -3 -2 -1\nf -2 -4 -1\n"),
         "open.obj: the mesh has no inside: each face lies on another one"),
    ],
)  # fmt: skip
def test_an_obstacle_that_is_no_body_is_refused_by_its_file(tmp_path, content, says):
    (tmp_path / "open.obj").write_text(content)
    world = "[world]\nsize = [1.0, 1.0, 1.0]\n[[obstacles]]\nshape = 'mesh'\ncell = 0.1\n"
    scene = tmp_path / "scene.toml"
    scene.write_text(f"{world}file = 'open.obj'\n")
    with pytest.raises(InputError) as refused:
        scenefile.load(scene)
    place = f"scene.toml line 6: [[obstacles]] 0: {tmp_path}/"
    assert str(refused.value).startswith(place + says)
    scene.write_text(f"{world}file = 'open.obj'\nfaces = [[0, 1, 2]]\n")
    with pytest.raises(InputError, match="line 7: .* 0: faces and file exclude each other"):
        scenefile.load(scene)


def test_a_mesh_hangs_from_its_highest_points(tmp_path):
    """By itself, as a scene: in the air, y up, held at the top; assignments reach its keys."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    ball.export(tmp_path / "ball.ply")
    source = SceneSource(str(tmp_path / "ball.ply"))
    scene = source.build()
    x, fixed = scene.particles.position, scene.particles.fixed
    assert scene.name == "ball" and scene.world.up == "y" and scene.world.substeps == "auto"
    assert scene.particles.mass.sum() == pytest.approx(0.15 * ball.area)
    assert 0 < fixed.sum() < len(x) and x[fixed, 1].min() > x[~fixed, 1].max()
    assert (x > scene.world.low + 1).all() and (x < scene.world.high - 1).all()
    assert (scene.stencils.bending == 1e-5).all() and len(scene.stencils) == 3 * len(ball.faces)
    (tmp_path / "lies.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nf 1 2 3 4\n")
    lying = SceneSource(str(tmp_path / "lies.obj")).build()
    assert (
        np.ptp(lying.particles.position[:, 1]) == pytest.approx(1)
        and lying.particles.fixed.sum() == 2
    )
    for hung, size in ((scene, 2.0), (lying, 1.0)):  # in the middle, its lowest point a size up
        low, high = hung.particles.position.min(axis=0), hung.particles.position.max(axis=0)
        np.testing.assert_allclose(low[1], size, rtol=1e-6)
        middle = (hung.world.low + hung.world.high) / 2
        np.testing.assert_allclose((low + high)[[0, 2]] / 2, middle[[0, 2]], atol=1e-6)
    # Air slows it down within two seconds; under its own weight it is a 50th longer.
    assert scene.particles.viscous.sum() == pytest.approx(0.5 * scene.particles.mass.sum())
    keys = hanging.table(tmp_path / "ball.ply", meshes.read(tmp_path / "ball.ply"))["meshes"][0]
    assert keys["stretch"] == pytest.approx(0.15 * 9.81 * 2.0 / 0.02, rel=1e-6)
    thin = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.5001 0\nf 1 2 3 5\nf 1 5 4\nf 5 3 4\n"
    (tmp_path / "sliver.obj").write_text(thin.replace("f 1 2 3 5", "f 1 2 3\nf 1 3 5"))
    sliver = SceneSource(str(tmp_path / "sliver.obj")).build()
    method = methods.load("symplectic_euler")
    limit = stable_step(method, Network.from_scene(sliver)).dt
    none = replace(sliver, stencils=Stencils.none())
    assert 0 < sliver.stencils.bending[0] < 1e-7
    assert limit > 0.7 * stable_step(method, Network.from_scene(none)).dt


def test_the_shirt_is_what_its_maker_makes():
    """One part, symmetric, four openings; the scene holds it at its collar."""
    surface = meshes.read(FILE)
    vertices, quads = shirt()
    np.testing.assert_allclose(surface.vertices, vertices, atol=2e-5)
    np.testing.assert_array_equal(surface.quads, quads)
    edges = np.sort(surface.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    assert surface.parts() == 1 and len(vertices) - len(edges) + len(surface.triangles) == 2 - 4
    border = edges[count == 1]
    assert (np.unique(border, return_counts=True)[1] == 2).all()
    mirrored = {tuple(p) for p in surface.vertices.round(5) * [-1, 1, 1] + 0.0}
    assert mirrored == {tuple(p) for p in surface.vertices.round(5) + 0.0}
    assert build("shirt").particles.fixed.sum() < 300
