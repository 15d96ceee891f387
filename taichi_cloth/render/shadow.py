"""The shade on a floor below what hangs above it, under a sky of even brightness.

Of the sky's light a point of a level floor lacks what is above it: of a piece whose projection on
the floor has the area A, at height h and at the distance r aside, the part

    A h^2 / (pi (h^2 + r^2)^2),

whose integral over the floor is A (the form factor of level patches: Cohen, Wallace, "Radiosity and
realistic image synthesis", 1993, 4.2; as a shade: Zhukov, Iones, Kronin, "An ambient light
illumination model", 1998). So the shade is the projection, the more blurred the higher it is: sharp
below what lies on the floor, wide and pale below what hangs. Parts are added up, and 1 at most.

It is computed on a grid by layers of height, each blurred by a convolution, so it takes less than a
millisecond. Heights between two layers are shared by both (`kernels/render/shadow.py`).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from taichi_cloth.kernels.render.shadow import CELLS, LAYERS, ONE, STEP, gather
from taichi_cloth.render.camera import Camera
from taichi_cloth.render.drawing import Cached
from taichi_cloth.render.rasterizer import Shade, Things, on_device
from taichi_cloth.render.surfaces import floor_tiles

IN_A_TILE = 8  # cells along a tile's side
DARKEST = 0.72  # part of the floor's light that a sky has
FAINT = 0.025  # of what is lacking: nobody sees it, and it would be wide
CLOSED = 0.5  # share of a closed surface, which is above a point twice
MOST = 20_000  # triangles that are looked at, of more some


class Shadows:
    """Computes shades; the part of what stands still is kept."""

    def __init__(self) -> None:
        self._of_solids = Cached(gathered)

    def of(
        self, cloth: Things, solids: Things | None, ground: float, camera: Camera
    ) -> Shade | None:
        """The shade on a floor at the height `ground`, by x and z; None: it is nowhere dark.

        solids: closed; None: there are none.
        """
        side, _ = floor_tiles(camera.radius)
        cell = side / IN_A_TILE
        low_x, low_z = side * (np.round(camera.centre[[0, 2]] / side) - CELLS // IN_A_TILE // 2)
        where = float(low_x), float(low_z), float(ground), cell, 1.0 if camera.y_up else -1.0
        layers = gathered(cloth, 1.0, where)
        if solids is not None:
            layers = layers + self._of_solids(solids, CLOSED, where)
        dark = DARKEST * np.maximum(blurred(layers) - FAINT, 0.0)
        return Shade(np.array([low_x, low_z]), cell, dark) if dark.any() else None


def gathered(things: Things, share: float, where: tuple[float, ...]) -> np.ndarray:
    """Gather what is above each corner of a grid's cells, by layers: (layers, k, k) int32.

    It is counted in parts of a cell, of which a cell has `ONE`. share: of the projections that
    counts. where: x and z where the grid begins, the floor's height, a cell's side [world], and 1
    where y points up, else -1.
    """
    grid = on_device(LAYERS * (CELLS + 1) ** 2)
    some = max(1, -(-len(things.corner) // MOST))
    corner, numbers = np.ascontiguousarray(things.corner[::some]), np.array(where, np.float32)
    balls = bool(len(things.ball))
    gather(balls, things.place, corner, things.ball, some * share, share, numbers, grid)
    found: np.ndarray = grid if isinstance(grid, np.ndarray) else grid.to_numpy()
    return found.reshape(LAYERS, CELLS + 1, CELLS + 1)


def blurred(layers: np.ndarray) -> np.ndarray:
    """The part of the light that is lacking at the corners of a grid's cells, (k, k) float32."""
    there = np.flatnonzero(layers.any(axis=(1, 2)))
    if not len(there):
        return np.zeros(layers.shape[1:], np.float32)
    some = slice(there[0], there[-1] + 1)
    waves = np.fft.fft(np.fft.rfft(layers[some], _WIDE, axis=2), _WIDE, axis=1)
    waves *= _blurs()[some]
    lacking = np.fft.irfft2(waves.sum(axis=0), (_WIDE, _WIDE))[: CELLS + 1, : CELLS + 1] / ONE
    parts: np.ndarray = lacking.clip(0.0, 1.0).astype(np.float32)
    return parts


_WIDE = 5 * CELLS // 4  # with some room beyond the grid: a convolution goes around


@lru_cache(maxsize=1)
def _blurs() -> np.ndarray:
    """The transforms of each layer's blur, whose parts add up to 1."""
    away = np.minimum(np.arange(_WIDE), _WIDE - np.arange(_WIDE))
    r2 = away[:, None] ** 2 + away**2
    found = []
    for layer in range(LAYERS):
        h2 = 4.0 ** (STEP * layer)
        blur = h2 / (h2 + r2) ** 2 / np.pi
        # What is beyond is no shade here: high layers keep less than 1.
        found.append(np.fft.rfft2(blur / max(blur.sum(), 1.0)).real)  # as it is even
    return np.array(found)
