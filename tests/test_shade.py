"""How dark a floor is: the shade of what hangs above it, by closed forms and by sums over parts."""

import json
import subprocess
import sys
import textwrap
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lacking import needs_vulkan
from selection import thorough

import taichi_cloth as tc
from taichi_cloth.rasterizer import Shade
from taichi_cloth.scene.cloth import grid, grid_triangles
from taichi_cloth.scene.model import ParticleDefaults, Scene, World
from taichi_cloth.ui import in_space, shade, surfaces
from taichi_cloth.ui.framing import camera_of

MIDDLE = shade.CELLS // 2


@pytest.mark.parametrize(("radius", "height"), [(8, 1), (8, 2), (6, 4), (6, 5.5), (3, 8), (4, 13)])
def test_below_a_disc_the_sky_lacks_what_the_disc_covers_of_it(radius, height):
    """R^2 / (R^2 + h^2) below its middle, half below the edge of one that nearly lies; all, A."""
    side = np.linspace(-radius, radius, 161)
    points = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    points = points[(points**2).sum(axis=1) <= radius**2]
    area = np.full(len(points), np.pi * radius**2 / len(points))
    cell = 0.25  # of whatever size
    dark = shade.on_grid(area * cell**2, points + MIDDLE, np.full(len(points), float(height)), cell)
    below = radius**2 / (radius**2 + height**2)
    assert dark[MIDDLE, MIDDLE] == pytest.approx(below, rel=0.05)
    if height == 1:
        assert dark[MIDDLE, MIDDLE + radius] == pytest.approx(0.5, abs=0.06)
        assert dark.sum() == pytest.approx(np.pi * radius**2, rel=0.01)
    np.testing.assert_allclose(dark, dark[::-1, ::-1], atol=5e-3)


def test_a_triangle_is_its_equal_parts():
    """Their areas add up to its projection's, their middles to its own, whatever its size."""
    corner = np.array([[0.0, 2.0, 0.0], [3.0, 2.5, 0.0], [0.0, 4.0, 5.0]])
    for cell in (10.0, 1.0, 0.3):
        area, points = shade._of_triangles(corner, np.array([[0, 1, 2]]), 1.0, cell)
        assert area.sum() == pytest.approx(7.5) and area.max() <= cell**2 or cell == 10.0
        np.testing.assert_allclose(points.mean(axis=0), corner.mean(axis=0))
        inside = points[:, 0] / 3 + points[:, 2] / 5
        assert (points[:, [0, 2]] > 0).all() and (inside < 1).all()
        assert len(np.unique(points.round(9), axis=0)) == len(points)


def above_a_floor(height=0.8):
    """A level sheet of 0.6 m that is held above a floor."""
    particles, springs = grid(
        [0.7, height, -0.3], 13, 13, 0.05, pinned=[(i, j) for i in range(13) for j in range(13)],
        across=(1.0, 0.0, 0.0), down=(0.0, 0.0, 1.0),
        particle_defaults=ParticleDefaults(radius=0.01),
    )  # fmt: skip
    world = World((2.0, 2.0, 2.0), (0.0, -9.81, 0.0), up="y", ground=0.1, mouse="none")
    return Scene("sheet", world, particles, springs, triangles=grid_triangles(13, 13))


def test_pictures_have_the_floor_as_dark_as_the_sum_over_the_sheet_says(device, monkeypatch):
    """At points of the floor that the camera sees, beside the same picture without shade."""
    scene = above_a_floor()
    camera = camera_of(scene)
    size = np.array([640, 480])
    sim = tc.Simulation(scene)
    with_shade = tc.picture(sim, size=tuple(size), camera=camera, parts="surface").astype(float)
    monkeypatch.setattr(shade, "of", lambda picture, ground, camera: None)
    without = tc.picture(sim, size=tuple(size), camera=camera, parts="surface").astype(float)

    middle, h = np.array([1.0, 0.0]), 0.7  # of the sheet, and its height above the floor
    side = (np.arange(120) + 0.5) / 120 * 0.6 - 0.3
    sheet = middle + np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    compared = 0
    for x in np.arange(0.4, 1.7, 0.1):
        for z in np.arange(-0.6, 0.7, 0.1):
            r2 = ((sheet - [x, z]) ** 2).sum(axis=1)
            lacking = (h**2 / np.pi / (h**2 + r2) ** 2).mean() * 0.36
            pixel, _, _ = camera.project([[x, 0.1, z]])
            scale = min(size / camera.world_size[:2])
            column, row = np.round((pixel[0] - camera.middle) * scale + size / 2 - 0.5).astype(int)
            inside = 0 <= column < size[0] and 0 <= row < size[1]
            if not inside or without[row, column].max() > 80:  # the sheet is before it
                continue
            left = with_shade[row, column].sum() / without[row, column].sum()
            wanted = 1 - shade.DARKEST * max(lacking - shade.FAINT, 0)
            assert left == pytest.approx(wanted, abs=0.03), (x, z)
            compared += lacking > 0.1
    assert compared > 20


BOTH = """
    import json, sys
    import numpy as np
    sys.path.insert(0, {tests!r})
    import taichi_cloth as tc
    from test_shade import above_a_floor
    from taichi_cloth.ui import app, shade
    from taichi_cloth.ui.framing import camera_of
    from taichi_cloth.ui.opening import open_view
    tc.start()
    scene, size = above_a_floor(), (640, 480)
    sim, camera, real, pixels = tc.Simulation(scene), camera_of(scene), shade.of, {{}}
    view = open_view("none", scene.world, pictures=True, size=size, camera=camera)
    assert view.name == "ggui"
    for shaded, of in ((True, real), (False, lambda picture, ground, camera: None)):
        shade.of = of
        pixels["ggui", shaded] = app.pixels_of(sim, view, status=False, show=None)
        pixels["gui", shaded] = tc.picture(sim, size=size, camera=camera)
    parts = [
        pixels[kind, True].astype(float).sum(axis=2)[280::16, 8::16]
        / pixels[kind, False].astype(float).sum(axis=2)[280::16, 8::16]
        for kind in ("ggui", "gui")
    ]
    print(json.dumps(np.array(parts).reshape(2, -1).tolist()))
"""


@thorough
@needs_vulkan
def test_both_views_have_the_same_shade(tmp_path):
    """In GGUI the tiles of the floor are cut into cells, whose corners have it."""
    program = textwrap.dedent(BOTH.format(tests=str(Path(__file__).parent)))
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    ggui, gui = np.array(json.loads(done.stdout))
    np.testing.assert_allclose(ggui, gui, atol=0.03)
    assert (gui < 0.9).mean() > 0.1 and gui.max() == 1.0


def test_what_is_below_the_floor_or_nowhere_darkens_nothing(device):
    scene = above_a_floor()
    camera, pictures = camera_of(scene), []
    real = shade.of

    def noting(picture, ground, camera):
        pictures.append(picture)
        return real(picture, ground, camera)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shade, "of", noting)
        tc.picture(tc.Simulation(scene), size=(64, 48), camera=camera)
    picture = pictures[0]
    dark = real(picture, 0.1, camera).dark
    assert 0.1 < dark.max() < shade.DARKEST
    x = picture.position.astype(np.float64)
    x[:, 1] = -1.0
    assert real(replace(picture, position=x), 0.1, camera) is None
    for lost in (np.nan, np.inf, 1e308, -1e308):  # of a run that flies apart
        x[:] = lost
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert real(replace(picture, position=x), 0.1, camera) is None
    assert in_space.floor(replace(picture, ground=None), camera) is None


def test_tiles_of_a_floor_are_cut_where_there_is_shade_and_cover_what_they_did():
    corner, color, opacity = surfaces.floor(0.1, [1.0, 0.5, 0.2], 1.0)
    side, _ = surfaces.floor_tiles(1.0)
    dark = np.zeros((shade.CELLS + 1,) * 2, np.float32)
    dark[30:40, 33:35] = 0.5
    low = side * (np.round(np.array([1.0, 0.2]) / side) - 4)
    laid = shade.laid(Shade(low, side / shade.IN_A_TILE, dark), corner, color, opacity)

    def areas(corner):
        a, b = corner[:, 1] - corner[:, 0], corner[:, 3] - corner[:, 0]
        return np.cross(a, b)[:, 1]

    assert areas(laid[0]).sum() == pytest.approx(areas(corner).sum())
    assert (np.sign(areas(laid[0])) == np.sign(areas(corner)[0])).all()
    assert len(laid[0]) > len(corner) and all(len(part) == len(laid[0]) for part in laid)
    x, z = np.round((laid[0][..., [0, 2]] - low) / (side / shade.IN_A_TILE)).astype(int).T
    inside = (x >= 0) & (x <= shade.CELLS) & (z >= 0) & (z <= shade.CELLS)
    there = np.where(inside, dark[x.clip(0, shade.CELLS), z.clip(0, shade.CELLS)], 0.0).T
    tile = laid[1] / (1 - there[..., None])  # as it was without shade
    assert {tuple(np.round(one, 6)) for one in tile.reshape(-1, 3)} == {
        tuple(np.round(one, 6)) for one in color.reshape(-1, 3)
    }
