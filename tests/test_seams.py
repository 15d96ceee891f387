"""Seams of meshes: open ones are told of, welded ones are one cloth with its file's vertices."""

import numpy as np
import pytest
import trimesh

from taichi_cloth import Simulation
from taichi_cloth.cli import run_notes
from taichi_cloth.errors import InputError
from taichi_cloth.files.exports import Export
from taichi_cloth.files.meshes import read, seams
from taichi_cloth.files.meshes.surface import Surface
from taichi_cloth.scene import scenefile


def panel(rows, columns, low, high):
    """Vertices of a grid from low to high in a plane, and its quads, from 0."""
    x, y = np.meshgrid(np.linspace(low[0], high[0], columns), np.linspace(low[1], high[1], rows))
    n = np.arange(rows * columns).reshape(rows, columns)
    quads = np.stack([n[:-1, :-1], n[:-1, 1:], n[1:, 1:], n[1:, :-1]], axis=-1).reshape(-1, 4)
    return np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]), quads


def obj(path, *panels):
    """An OBJ file of panels."""
    lines, count = [], 1
    for x, quads in panels:
        lines += ["v {!r} {!r} {!r}".format(*map(float, p)) for p in x]
        lines += ["f " + " ".join(map(str, quad + count)) for quad in quads]
        count += len(x)
    path.write_text("\n".join(lines))
    return path


SCENE = """
[world]
size = [9.0, 9.0, 9.0]
up = "y"
gravity = [0.0, -9.81, 0.0]
dt = 0.001
[particle]
radius = 0.001
[[meshes]]
file = "cloth.obj"
scale = 2.0
move = [4.0, 4.0, 0.0]
stretch = 10.0
density = 0.1
"""


def loaded(tmp_path, more=""):
    (tmp_path / "scene.toml").write_text(SCENE + more)
    return scenefile.load(tmp_path / "scene.toml")


def rims(triangles):
    """How many triangles each edge has, and the pairs of vertices."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)


def two(tmp_path, gap=1e-3):
    """Two panels of 5 x 3 vertices, one above the other, a gap between them."""
    below, above = panel(3, 5, (0, 0), (1, 0.5)), panel(3, 5, (0, 0.5 + gap), (1, 1))
    return obj(tmp_path / "cloth.obj", below, above)


def test_a_seam_that_is_open_is_told_of_and_welded(tmp_path, capsys):
    """How many, the first, how far apart in the world; the vertices keep the file's numbers."""
    path = two(tmp_path)
    scene = loaded(tmp_path, "pinned = [15]\n")
    says = (
        f"{path}: 5 vertices of borders lie near another one of a border, and nothing joins them: "
        "the first is 10, 0.002 from 15; --set meshes[0].weld=0.0021, or weld in [[meshes]], "
        "closes such seams"
    )
    falls = (
        f"{path}: 1 of its 2 parts hangs on nothing and will fall: the first has vertex 0, and is "
        "0.002 from the rest, at vertices 10 and 15"
    )
    assert scene.notes == (says, falls) and scene.file_points is None
    run_notes.note_files(scene)
    assert capsys.readouterr().err == f"taichi-cloth: note: {says}\ntaichi-cloth: note: {falls}\n"
    sewn = loaded(tmp_path, "pinned = [15, 29]\nweld = 0.0021\n")
    assert sewn.notes == () and len(sewn.particles) == 25
    assert np.flatnonzero(sewn.particles.fixed).tolist() == [10, 24]
    np.testing.assert_allclose(sewn.particles.position[10:15, 1], 4 + 2 * 0.5005, rtol=1e-12)
    particle = [*range(15), *range(10, 15), *range(15, 25)]
    np.testing.assert_array_equal(sewn.file_points.particle, particle)
    np.testing.assert_array_equal(sewn.triangles, np.array(particle)[sewn.file_points.corners])
    edges, count = rims(sewn.triangles)
    assert count.max() == 2 and (count == 1).sum() == 2 * 4 + 2 * 4  # a whole sheet of 5 x 5
    assert len(sewn.springs) == len(edges) + 16  # and the other diagonal of each quad


def test_an_export_of_a_welded_mesh_has_the_files_vertices(tmp_path, capfd):
    """Those of a seam coincide; each triangle is that of the file."""
    path = two(tmp_path)
    more = "weld = 0.0021\npinned = [29]\n[[particles]]\nposition = [1.0, 1.0, 1.0]\n"
    sim = Simulation(loaded(tmp_path, more), method="symplectic_euler", topology="graph")
    export = Export(tmp_path / "out/cloth.ply", sim.dt)
    for _ in range(3):
        sim.advance()
        export.record(sim)
    export.save()
    made = trimesh.load(tmp_path / "out/cloth_00003.ply", process=False)
    file = read(path)
    assert len(made.vertices) == 1 + 30
    np.testing.assert_array_equal(made.vertices[11:16], made.vertices[16:21])
    triangles = {tuple(sorted(t)) for t in (file.triangles + 1).tolist()}
    assert {tuple(sorted(t)) for t in made.faces.tolist()} == triangles
    np.testing.assert_allclose(made.vertices[30], file.vertices[29] * 2 + [4, 4, 0])


@pytest.mark.parametrize("gap", [0.0, 1e-4])
def test_vertices_at_an_edge_are_told_of_and_joined_to_it(tmp_path, gap):
    """Eight vertices of a fine panel at four edges of a coarse one: no area is lost or made."""
    coarse, fine = panel(3, 5, (0, 0), (1, 0.5)), panel(3, 13, (0, 0.5 + gap), (1, 1))
    path = obj(tmp_path / "cloth.obj", coarse, fine)
    notes = loaded(tmp_path).notes
    at = "8 vertices of borders lie at an edge that does not end there, and nothing joins them: "
    assert notes[-1].startswith(f"{path}: {at}the first is 16, {2 * gap:.3g} from edge ")
    closed = seams.welded(path, read(path), 2e-4)
    edges, count = rims(closed.surface.triangles)
    assert closed.surface.parts() == 1 and count.max() == 2
    assert (count == 1).sum() == 4 + 12 + 2 * 4
    x, t = closed.surface.vertices, closed.surface.triangles
    area = np.cross(x[t[:, 1]] - x[t[:, 0]], x[t[:, 2]] - x[t[:, 0]])[:, 2] / 2
    assert area.sum() == pytest.approx(1.0, rel=1e-12) and np.abs(area).min() > 1e-3
    assert (area > 0).all() or (area < 0).all()
    # A quad whose edge is split is triangles then; all others stay.
    assert len(closed.surface.quads) == 4 + 24
    corners = np.sort(closed.surface.quads, axis=1)
    for quad, both in zip(corners, closed.surface.quad_triangles, strict=True):
        assert set(t[both].ravel().tolist()) == set(quad.tolist())


def test_what_is_near_is_found_as_by_looking_at_all(monkeypatch):
    """Vertices of borders, and edges, of triangles that lie anywhere."""
    rng = np.random.default_rng(4)
    x = rng.uniform(0, 1, (90, 3))
    empty = np.zeros((0, 4), np.int64), np.zeros((0, 2), np.int64)
    surface = Surface(x, np.arange(90).reshape(-1, 3), *empty)
    reach = 0.08
    found = seams.gaps(surface, reach)
    far = np.linalg.norm(x[:, None] - x, axis=2)
    pairs = np.argwhere(np.triu(far <= reach, 1))
    np.testing.assert_array_equal(found.pairs, pairs)
    np.testing.assert_allclose(found.apart, far[tuple(pairs.T)])
    expected = []
    for p in range(90):
        for face, triangle in enumerate(surface.triangles.tolist()):
            for a, b in zip(triangle, triangle[1:] + triangle[:1], strict=True):
                t = (x[p] - x[a]) @ (x[b] - x[a]) / ((x[b] - x[a]) ** 2).sum()
                off = np.linalg.norm(x[p] - x[a] - t * (x[b] - x[a]))
                ends = min(far[p, a], far[p, b])
                if off <= reach < ends and 0 < t < 1 and p not in triangle:
                    expected.append((p, a, b, face))
    assert len(expected) > 20 and sorted(expected) == sorted(map(tuple, found.at_edges.tolist()))


@pytest.mark.parametrize(
    ("weld", "says"),
    [
        ("0.6", "line 15: [[meshes]] 0: weld 0.6 joins vertices 0 and 1 of one face; give less "),
        ("-1.0", "line 15: [[meshes]] 0: weld must be finite and not negative, is -1"),
        ("inf", "line 15: [[meshes]] 0: weld must be finite, is inf"),
        ("'all'", "line 15: [[meshes]] 0: weld must be a number"),
    ],
)
def test_lengths_that_close_no_seam_are_refused_by_their_line(tmp_path, weld, says):
    two(tmp_path)
    with pytest.raises(InputError) as refused:
        loaded(tmp_path, f"weld = {weld}\n")
    assert says in str(refused.value)


def test_a_third_panel_at_a_seam_is_refused_in_the_files_numbers(tmp_path):
    """An edge has two faces."""
    below, above = panel(3, 5, (0, 0), (1, 0.5)), panel(3, 5, (0, 0.5), (1, 1))
    third = above[0] @ np.diag([1, 0, 0]) + [0, 0.5, 0] + above[0][:, [2, 2, 1]] - [0, 0, 0.5]
    loose = np.full((1, 3), 5.0), np.zeros((0, 4), int)
    obj(tmp_path / "cloth.obj", loose, below, above, (third, above[1]))
    says = "weld 1e-06 joins three faces or more at 4 edges, the first of vertices 11 and 12, and"
    with pytest.raises(InputError, match=f"line 15: .* {says}"):
        loaded(tmp_path, "weld = 1e-6\n")


def test_a_mesh_without_pins_is_told_of_where_another_one_has_them(tmp_path):
    """All of it falls; nothing is said where nothing is pinned, or springs hold it."""
    two(tmp_path, 0.1)
    second = "[[meshes]]\nfile = 'cloth.obj'\nscale = 1.0\nmove = [1.0, 4.0, 0.0]\nstretch = 1.0\n"
    pins = "pinned = [0, 15]\n"
    falls = "it has no pins, as other things of the scene have, and will fall"
    assert loaded(tmp_path, second).notes == ()
    assert loaded(tmp_path, pins + second).notes == (f"{tmp_path}/cloth.obj: {falls}",)
    held = "".join(f"[[springs]]\nbetween = [0, {n}]\nstiffness = 1.0\n" for n in (30, 45))
    assert loaded(tmp_path, pins + second + held).notes == ()


def test_slits_and_whole_sheets_have_no_seam(tmp_path):
    obj(tmp_path / "cloth.obj", panel(3, 5, (0, 0), (1, 0.5)), panel(3, 5, (0, 0.6), (1, 1)))
    assert loaded(tmp_path).notes == ()
    obj(tmp_path / "cloth.obj", panel(9, 9, (0, 0), (1, 1)))
    assert loaded(tmp_path, "weld = 0.01\n").file_points is None


def test_a_body_that_is_parted_at_seams_is_joined_and_said(tmp_path):
    """As a writer parts it where textures begin: at exactly the same place, and no farther."""
    box = trimesh.creation.box()
    scene = tmp_path / "scene.toml"
    scene.write_text(
        "[world]\nsize = [1.0, 1.0, 1.0]\n[[obstacles]]\nshape = 'mesh'\nfile = 'box.ply'\n"
    )

    def loaded(corners):
        trimesh.Trimesh(corners, np.arange(36).reshape(-1, 3), process=False).export(
            tmp_path / "box.ply"
        )
        return scenefile.load(scene)

    corners = box.vertices[box.faces].reshape(-1, 3)
    found = loaded(corners)
    says = "28 vertices that lie exactly on others are joined to them, and the body is closed"
    assert found.notes == (f"{tmp_path}/box.ply: {says}",)
    body = found.obstacles[0].values
    made = trimesh.Trimesh(body["vertices"], body["faces"], process=False)
    assert made.is_watertight and made.volume == pytest.approx(1.0)
    with pytest.raises(InputError, match=r"box.ply: the mesh is not closed"):
        loaded(corners + 1e-6 * np.eye(36, 3))
    # A whole one that it touches along an edge is another body: an edge there has two faces.
    whole = trimesh.Trimesh(corners, np.arange(36).reshape(-1, 3), process=False)
    beside = trimesh.creation.box().apply_translation([1, 1, 0])
    trimesh.util.concatenate([whole, beside]).export(tmp_path / "box.ply")
    body = scenefile.load(scene).obstacles[0].values
    assert trimesh.Trimesh(body["vertices"], body["faces"], process=False).volume == 2.0
