"""Flat shapes in a picture: how much of each pixel they cover, and what lies upon what."""

import json
import os
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from lacking import needs_vulkan
from selection import thorough

from taichi_cloth.render import painter, rasterizer
from taichi_cloth.render.picture import Rect

SIZE = (90, 120)  # rows, columns
WHITE, PAPER = 0xFFFFFF, 0x102030


@pytest.fixture(autouse=True)
def started(device):
    """Kernels need Taichi to have been started; anew, it would take the fields of other tests."""


def painted(*shapes, paper=0):
    h, w = SIZE
    picture = np.full(h * w, -1, np.int32)
    on = painter.Painter(Rect(0, 0, w, h), np.full(SIZE, paper, np.int32))
    on.draw(picture, w, shapes)
    return picture.reshape(SIZE)


def covered(*shapes):
    """The area in pixels that white shapes cover."""
    return (painted(*shapes) & 255).sum() / 255


def scattered(count):
    """Lines, discs and triangles in all colours, many of them partly beside the picture."""
    random = np.random.default_rng(3)
    a, b = random.uniform(-20, 140, (2, count, 2))
    color = random.integers(0, 1 << 24, (3, count))
    corner = random.uniform(-60, 180, (count, 3, 2))
    return (
        painter.triangles(corner, random.integers(0, 8, count), color[0]),
        painter.lines(a, a + random.normal(0, 12, (count, 2)), 2.5, color[1]),
        painter.discs(b, random.uniform(0.3, 9, count), color[2]),
    )


def share(number, what, x, y):
    """How much of pixels around (x, y) a shape covers, as `kernels/paint.py` defines it."""
    if what[0] < 0:
        a, b, half = number[:2], number[2:4], number[6]
        way = b - a
        part = ((x - a[0]) * way[0] + (y - a[1]) * way[1]) / max(way @ way, 1e-12)
        part = np.clip(part, 0, 1)
        off = np.stack([x - a[0] - part * way[0], y - a[1] - part * way[1]])
        away = np.maximum(np.hypot(*off), 1e-3)
        reach = np.maximum(np.abs(off).sum(axis=0) / away, 1) / 2
        common = np.minimum(away + reach, half) - np.maximum(away - reach, -half)
        return np.clip(common / (2 * reach), 0, 1)
    corner, least = number[:6].reshape(3, 2), np.ones_like(x)
    turn = np.sign(np.linalg.det(corner[1:] - corner[0]))
    for k in range(3):
        p, way = corner[k], corner[(k + 1) % 3] - corner[k]
        inside = turn * (way[0] * (y - p[1]) - way[1] * (x - p[0]))
        part = inside / np.abs(way).sum() + 0.5 if what[0] >> k & 1 else inside > 0
        least = np.minimum(least, part)
    return np.clip(least, 0, 1)


def test_shapes_cover_their_area():
    """Discs pi r^2, lines their length times their width and two half discs, and triangles."""
    curved = (np.pi + 2) / 12  # more, as edges that are bent are mixed over a pixel's length
    for radius in (1.5, 4.0, 20.3):
        one = painter.discs(np.array([[50.3, 44.7]]), np.array([radius]), WHITE)
        assert covered(one) == pytest.approx(np.pi * radius**2 + curved, rel=0.01)
    for turn in np.radians([0, 11, 45, 90, 137]):
        ends = np.array([50.2, 45.1]) + 30 * np.array([[[0, 0]], [[np.cos(turn), np.sin(turn)]]])
        for width in (0.6, 1.4, 5.0):
            expected = 30 * width + np.pi / 4 * width**2
            area = covered(painter.lines(*ends, width, WHITE))
            assert area == pytest.approx(expected, rel=0.02, abs=0.65)
    corner = np.array([[[10.3, 8.1], [100.7, 30.2], [40.6, 80.9]]])
    area = abs(np.linalg.det(corner[0, 1:] - corner[0, 0])) / 2
    for order in ([0, 1, 2], [2, 1, 0]):
        assert covered(painter.triangles(corner[:, order], 7, WHITE)) == pytest.approx(
            area, rel=2e-3
        )


def test_pixels_are_mixed_in_the_painters_order():
    """Against all shapes over all pixels, one after the other, in f64."""
    shapes = scattered(25)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    expected = np.stack([np.full(SIZE, float(PAPER >> place & 255)) for place in (16, 8, 0)])
    for some in shapes:
        for number, what in zip(some.number.astype(float), some.what, strict=True):
            color = [what[1] >> place & 255 for place in (16, 8, 0)]
            part = share(number, what, x, y)
            expected += part * (np.array(color)[:, None, None] - expected)
    seen = painted(*shapes, paper=PAPER)
    found = np.stack([(seen >> place & 255).astype(float) for place in (16, 8, 0)])
    wrong = np.abs(found - expected).max(axis=0) > 3  # each mixing rounds; f32 at sharp sides
    assert wrong.mean() < 2e-3


def test_a_picture_has_the_same_bits_in_tiles_of_any_size(monkeypatch):
    shapes = scattered(60)
    first = painted(*shapes)
    np.testing.assert_array_equal(painted(*shapes), first)
    for rows in (1, 7, 64):
        monkeypatch.setattr(rasterizer, "ROWS", rows)
        np.testing.assert_array_equal(painted(*shapes), first)


def test_a_surface_has_smooth_edges_and_no_seams():
    line = np.linspace(10.4, 80.4, 8)
    place = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    place += np.random.default_rng(1).normal(0, 1.5, place.shape) * (
        (place > 11) & (place < 80)
    ).all(axis=1, keepdims=True)
    corner = np.arange(49) + np.arange(49) // 7
    a, b, c, d = corner, corner + 1, corner + 8, corner + 9
    faces = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
    smooth = painter.outline(faces)
    assert sum(int(bits).bit_count() for bits in smooth) == 28
    seen = painted(painter.triangles(place[faces], smooth, WHITE)) & 255
    assert (seen[11:80, 11:80] == 255).all()
    partly = seen[20:70, 10] == round(0.6 * 255)
    assert partly.sum() >= 50 - 6  # a pixel at a corner of the surface's edge may be full
    assert (seen[:, :10] == 0).all() and seen.sum() / 255 == pytest.approx(70 * 70, abs=15)


def test_what_is_far_away_costs_nothing_and_harms_nothing():
    far = np.array([[1e7, -3e8], [-2e9, 4.0]])
    shapes = painter.lines(far, far + 1, 2.0, WHITE), painter.discs(far, np.ones(2), WHITE)
    assert not painted(*shapes).any()
    over = np.array([[[-1e4, -1e4], [3e4, -1e4], [-1e4, 3e4]]])
    assert (painted(painter.triangles(over, 7, WHITE)) == WHITE).all()
    flat = np.array([[[5.0, 5.0], [50.0, 50.0], [20.0, 20.0]]])
    assert not painted(painter.triangles(flat, 7, WHITE)).any()


ON_BOTH = """
    import json, sys
    import numpy as np
    sys.path.insert(0, {tests!r})
    import taichi_cloth as tc
    from test_drawing import WORLD, camera
    from test_raster import random_picture
    from taichi_cloth.render.renderer import Renderer
    drawn = {{}}
    for arch in ("cpu", "vulkan"):
        tc.start(arch, "f32")
        for name in ("cloth", "drape"):
            sim = tc.Simulation(tc.scenes.build(name))
            drawn[name, arch] = tc.picture(sim, size=(320, 240)).astype(int)
        on, rng, frames = Renderer((120, 100)), np.random.default_rng(7), []
        for frame in range(12):
            on.draw(random_picture(rng), WORLD, camera(rot_x=20, rot_y=frame // 6), None, None)
            code = on.pixels()
            frames.append(np.stack([(code >> k & 255).astype(int) for k in (16, 8, 0)]))
        drawn["frames", arch] = np.array(frames)
    names = "cloth", "drape", "frames"
    pairs = [(drawn[name, "cpu"], drawn[name, "vulkan"]) for name in names]
    print(json.dumps([[float((np.abs(a - b) > 1).mean()), float(a.std())] for a, b in pairs]))
"""


@thorough
@needs_vulkan
def test_a_graphics_driver_draws_the_same_pictures(tmp_path):
    """Of a plane and of space, and of frames of which each leaves alone what has not changed."""
    program = textwrap.dedent(ON_BOTH.format(tests=os.path.dirname(__file__)))
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    # What rounding decides is whether a pixel is an edge, and what covers a sample.
    for differ, contrast in json.loads(done.stdout.splitlines()[-1]):
        assert differ < 1e-4 and contrast > 10
