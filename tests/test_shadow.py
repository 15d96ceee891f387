"""How dark a floor is: the shade of what hangs above it, by closed forms and by sums over parts."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import taichi_cloth as tc
from taichi_cloth.render import shadow, space
from taichi_cloth.render.picture import Picture
from taichi_cloth.render.rasterizer import Things
from taichi_cloth.scene.cloth import grid, grid_triangles
from taichi_cloth.scene.model import ParticleDefaults, Scene, World
from taichi_cloth.ui.framing import camera_of

MIDDLE = shadow.CELLS // 2


def triangles_at(corner):
    """Triangles (m, 3, 3) as the rasterizer takes them."""
    place = np.asarray(corner, np.float32).reshape(-1, 3)
    return Things(place, corner=np.arange(len(place), dtype=np.int32).reshape(-1, 3))


def grid_of(things, cell, share=1.0):
    """What is above each cell of a grid that begins at 0, by layers, in parts; y points up."""
    return shadow.gathered(things, share, (0.0, 0.0, 0.0, cell, 1.0))


@pytest.mark.parametrize(("radius", "height"), [(8, 1), (8, 2), (6, 4), (6, 5.5), (3, 8), (4, 13)])
def test_below_a_disc_the_sky_lacks_what_the_disc_covers_of_it(device, radius, height):
    """R^2 / (R^2 + h^2) below its middle, half below the edge of one that nearly lies; all, A."""
    turn = np.linspace(0, 2 * np.pi, 129)
    edge = np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=1)
    rings = radius * np.linspace(0, 1, 33)[:, None, None] * edge
    a, b = rings[:-1, :-1], rings[:-1, 1:]
    c, d = rings[1:, :-1], rings[1:, 1:]
    corner = np.concatenate([np.stack(t, axis=2).reshape(-1, 3, 3) for t in ((a, c, d), (a, d, b))])
    cell = 0.25  # of whatever size
    corner = cell * (corner + [MIDDLE, height, MIDDLE])
    dark = shadow.blurred(grid_of(triangles_at(corner), cell))
    below = radius**2 / (radius**2 + height**2)
    assert dark[MIDDLE, MIDDLE] == pytest.approx(below, rel=0.05)
    if height == 1:
        assert dark[MIDDLE, MIDDLE + radius] == pytest.approx(0.5, abs=0.06)
        assert dark.sum() == pytest.approx(np.pi * radius**2, rel=0.01)
    np.testing.assert_allclose(dark, dark[::-1, ::-1], atol=5e-3)


def test_things_are_their_projections_wherever_they_are_cut(device):
    """Areas and first moments of a triangle and a ball, whatever the size of cells."""
    corner = np.array([[[5.0, 2.0, 5.0], [8.0, 2.5, 5.0], [5.0, 4.0, 10.0]]])
    ball = np.array([[0, 0, np.float32(0.7).view(np.int32)]], np.int32)
    one = Things(np.array([[6.0, 3.0, 7.0]], np.float32), ball=ball)
    for things, area, middle in (
        (triangles_at(corner), 7.5, corner[0].mean(axis=0)),
        (one, np.pi * 0.49, [6.0, 3.0, 7.0]),
    ):
        for cell, share in ((10.0, 1.0), (1.0, 0.5), (0.3, 1.0)):
            layers = grid_of(things, cell, share).sum(axis=0) / shadow.ONE
            assert layers.sum() * cell**2 == pytest.approx(share * area, rel=5e-3)
            x, z = np.indices(layers.shape) * cell
            for at, where in ((x, middle[0]), (z, middle[2])):
                assert (layers * at).sum() / layers.sum() == pytest.approx(
                    where, abs=0.02 * cell + 0.03
                )


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
    """At points of the floor that the camera sees, beside the same picture without shadow."""
    scene = above_a_floor()
    camera = camera_of(scene)
    size = np.array([640, 480])
    sim = tc.Simulation(scene)
    with_shade = tc.picture(sim, size=tuple(size), camera=camera, parts="surface").astype(float)
    monkeypatch.setattr(shadow.Shadows, "of", lambda self, *of: None)
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
            wanted = 1 - shadow.DARKEST * max(lacking - shadow.FAINT, 0)
            assert left == pytest.approx(wanted, abs=0.03), (x, z)
            compared += lacking > 0.1
    assert compared > 20


def test_what_is_below_the_floor_or_nowhere_darkens_nothing(device):
    scene = above_a_floor()
    camera, given = camera_of(scene), []
    real = shadow.Shadows.of

    def noting(self, cloth, solids, ground, camera):
        given.append(cloth)
        return real(self, cloth, solids, ground, camera)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shadow.Shadows, "of", noting)
        tc.picture(tc.Simulation(scene), size=(64, 48), camera=camera)
    cloth, shadows = given[0], shadow.Shadows()
    dark = shadows.of(cloth, None, 0.1, camera).dark
    assert 0.1 < dark.max() < shadow.DARKEST
    x = cloth.place.copy()
    x[:, 1] = -1.0
    assert shadows.of(replace(cloth, place=x), None, 0.1, camera) is None
    for lost in (np.nan, np.inf, 1e38, -1e38):  # of a run that flies apart
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            x = np.full_like(x, lost)
            assert shadows.of(replace(cloth, place=x), None, 0.1, camera) is None
    assert space._floor(Picture(x, x[:, 0], x, x), camera) is None
