"""Polygons as triangles: cuts that cover them once, by exact areas."""

import numpy as np
import pytest

from taichi_cloth.errors import InputError
from taichi_cloth.files import meshes
from taichi_cloth.files.meshes import ears
from taichi_cloth.scene import meshfile

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def test_faces_are_cut_inside_and_wound_alike(tmp_path):
    """An arrow's diagonal, a polygon with a notch, and neighbours that disagree; areas add up."""
    cases = {
        "arrow": ("v 0 0 0\nv 2 -1 0\nv 0 3 0\nv -2 -1 0\nf 1 2 3 4\n", 2 * 3.0),
        "notch": ("v 0 0 0\nv 3 0 0\nv 3 3 0\nv 1.5 1 0\nv 0 3 0\nf 1 2 3 4 5\n", 6.0),
        "wound": (SQUARE + "v 2 0 0\nv 2 1 0\nf 1 2 3\nf 1 4 3\nf 2 5 3\nf 6 5 3\n", 2.0),
    }
    for name, (text, area) in cases.items():
        (tmp_path / f"{name}.obj").write_text(text)
        x, triangles = meshfile.read(tmp_path / f"{name}.obj")
        a, b, c = (x[triangles[:, n]] for n in range(3))
        normal = np.cross(b - a, c - a)[:, 2] / 2
        assert (normal > 0).all() and normal.sum() == pytest.approx(area, rel=1e-15)


def in_plane(u, v):
    return np.column_stack([u, v, np.zeros(len(u))])


def circle(count, radius=1.0, turns=1.0):
    angle = np.arange(count) * (2 * np.pi * turns / count)
    return in_plane(radius * np.cos(angle), radius * np.sin(angle))


def star(count):
    return circle(count) * np.where(np.arange(count) % 2, 1.0, 0.8)[:, None]


def spiral(count):
    """Two arms side by side, each round five times."""
    along = np.linspace(0.1, 1.1, count // 2)
    return np.concatenate([circle(count // 2, along, 5), circle(count // 2, along - 0.04, 5)[::-1]])


def sides(count):
    """A square with many corners on each side."""
    t = np.arange(count) / count
    one = in_plane(t, 0 * t)
    turn = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
    corners = ([0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0])
    return np.concatenate([
        one @ np.linalg.matrix_power(turn, n) + corner for n, corner in enumerate(corners)
    ])  # fmt: skip


def comb(teeth):
    """Notches above, and corners on the straight side below."""
    n = np.arange(teeth)
    above = np.column_stack([n, n + 0.5]).ravel(), np.tile([1, 0.1], teeth)
    below = in_plane(np.concatenate([[0], n + 0.3, [teeth]]), np.zeros(teeth + 2))
    return np.concatenate([below, in_plane([teeth], [1]), in_plane(*above)[::-1]])


def ring(count):
    """A hole that a side leads to and back from: corners twice at one place."""
    outer, inner = circle(count, 2.0), circle(count)
    return np.concatenate([outer, outer[:1], inner[:1], inner[:0:-1], inner[:1]])


SHAPES = {
    "star": star(1000),
    "spiral": spiral(1000),
    "sides": sides(25),
    "comb": comb(40),
    "ring": ring(60),
    "square ring": np.concatenate([sides(1) * 4, [[0, 0, 0]], sides(1)[[0, 3, 2, 1, 0]] * 2 + 1]),
}


def assert_covers(x):
    """Positive triangles whose areas add up to the polygon's: a cover of each point, once."""
    triangles, normal = ears.cut(x), np.cross(x - x[0], np.roll(x, -1, axis=0) - x[0]).sum(axis=0)
    a, b, c = (x[triangles[:, n]] for n in range(3))
    area = np.cross(b - a, c - a) @ normal / (normal @ normal)
    assert len(triangles) == len(x) - 2 and len(np.unique(triangles)) == len(x)
    assert area.min() > 1e-9 and area.sum() == pytest.approx(1, rel=1e-12)


@pytest.mark.parametrize("name", SHAPES)
def test_a_polygon_is_covered_once_wherever_it_lies(name):
    """Also turned in space and seen from behind, where corners are on a line but for rounding."""
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    x = SHAPES[name]
    for n, placed in enumerate((x, x[::-1], x @ turn + 3, (x @ turn)[::-1] * 1e-3)):
        assert_covers(np.roll(placed, 7 * n, axis=0))


def test_polygons_of_any_shape_are_covered_once():
    rng = np.random.default_rng(2)
    done = 0
    while done < 100:
        angle, n = np.sort(rng.uniform(0, 2 * np.pi, 40)), rng.integers(5, 40)
        angle = angle[:n]
        if np.diff(angle, append=angle[0] + 2 * np.pi).max() < 3:
            radius = np.exp(rng.normal(0, 1, n))
            assert_covers(in_plane(radius * np.cos(angle), radius * np.sin(angle)))
            done += 1


@pytest.mark.parametrize("crosses", [False, True])
def test_the_cost_of_a_cut_is_quadratic(monkeypatch, crosses):
    """Each look at a corner asks all others at once; a corner is looked at a few times."""
    looks = []
    free = ears._Ears._is_free

    def counted(self, *about):
        looks.append(1)
        return free(self, *about)

    monkeypatch.setattr(ears._Ears, "_is_free", counted)
    x = np.random.default_rng(3).normal(size=(300, 3)) if crosses else spiral(300)
    assert len(ears.cut(x)) == 298
    assert len(looks) <= (12 if crosses else 3) * 300


SWAPPED = np.r_[:10, 30, 11:30, 10, 31:60]
CROSSING = {
    "bow": [[0, 0, 0], [2, 1, 0], [2, 0, 0], [0, 1, 0]],
    "bow whose halves are as large": [[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0]],
    "pentagram": circle(5)[[0, 2, 4, 1, 3]],
    "twice around": circle(7)[[0, 2, 4, 6, 1, 3, 5]] * [2, 1, 1],
    "star": star(60)[SWAPPED],
    "ring": np.roll(ring(30), 1, axis=0)[SWAPPED],
}


def test_polygons_that_cross_themselves_are_told_of_in_one_note(tmp_path):
    """By the first one's line, wherever they lie; none that only touch themselves are."""
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]

    def notes(polygons):
        lines, faces, count = [], [], 1
        for n, x in enumerate(polygons):
            lines += ["v {!r} {!r} {!r}".format(*map(float, p)) for p in x + [9.0 * n, 0, 0]]
            faces.append("f " + " ".join(map(str, range(count, count + len(x)))))
            count += len(x)
        (tmp_path / "shapes.obj").write_text("\n".join([*lines, *faces]) + "\n")
        return meshes.read(tmp_path / "shapes.obj").notes, count

    for name, x in CROSSING.items():
        for placed in (np.array(x, float), np.array(x, float)[::-1] @ turn):
            found, count = notes([star(60), placed])
            says = (
                "1 face crosses or meets itself, and no cut into triangles is right there: face 1"
            )
            assert found == (f"{says} (line {count + 1}); part it",), name
    found, count = notes([*map(np.array, CROSSING.values()), star(60)])
    assert found[0].startswith("6 faces cross or meet themselves")
    assert f"the first is face 0 (line {count})" in found[0]
    assert notes([*SHAPES.values(), sides(1)])[0] == ()


def test_a_polygon_with_two_corners_at_one_place_in_a_row_is_refused(tmp_path):
    """Such an edge is a spring without a length."""
    (tmp_path / "twice.obj").write_text(SQUARE + "v 0 1 0\nv 0 0.5 0\nf 1 2 3 4 5 6\n")
    with pytest.raises(InputError, match="line 7: face 0 is degenerate: its vertices 3 and 4 lie"):
        meshes.read(tmp_path / "twice.obj")
