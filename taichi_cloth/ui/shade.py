"""How dark a floor is below what hangs above it, under a sky that is as bright everywhere.

Of the sky's light a point of a level floor lacks what is above it: of a piece whose projection on
the floor has the area A, at height h and at the distance r aside, the part

    A h^2 / (pi (h^2 + r^2)^2),

whose integral over the floor is A (the form factor of level patches: Cohen, Wallace, "Radiosity and
realistic image synthesis", 1993, 4.2; as a shade: Zhukov, Iones, Kronin, "An ambient light
illumination model", 1998). So the shade is the projection, the more blurred the higher it is: sharp
below what lies on the floor, wide and pale below what hangs. Parts are added up, and 1 at most.

It is computed on a grid by layers of height, each blurred by a convolution, so it takes a
millisecond or two however many triangles there are. Heights between two layers are shared by both.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from taichi_cloth.rasterizer import Shade
from taichi_cloth.ui import drawing
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.surfaces import floor_tiles
from taichi_cloth.ui.views.contract import Picture

CELLS = 64  # of the grid, along each side
IN_A_TILE = 8  # cells along a tile's side
LAYERS = 13  # at heights of 1, 2 ** 0.5, 2, ... 64 cells
DARKEST = 0.72  # part of the floor's light that a sky has
UNEVEN = 0.15  # so much darker is one place of a tile than another where it is cut into cells
FAINT = 0.01  # of what is lacking: nobody sees it
MOST = 20_000  # parts of triangles that are looked at, of more triangles some
# Where a ball is cut into parts, as its projection: unit vectors, spread evenly (Vogel, 1979).
_PART = np.arange(12)
_TURN = np.pi * (3 - np.sqrt(5)) * _PART
DISC = np.sqrt((_PART + 0.5) / len(_PART))[:, None] * np.stack([np.cos(_TURN), np.sin(_TURN)], 1)


def of(picture: Picture, ground: float, camera: Camera) -> Shade | None:
    """The shade of what a picture has above its floor, at the height `ground`, by x and z, of CELLS
    cells along each side; None: it is nowhere dark.
    """
    side, _ = floor_tiles(camera.radius)
    cell = side / IN_A_TILE
    low = side * (np.round(camera.centre[[0, 2]] / side) - CELLS // IN_A_TILE // 2)
    with np.errstate(all="ignore"):  # of a run that flies apart
        area, place, height = _parts(picture, ground, 1.0 if camera.y_up else -1.0, cell)
        lacking = on_grid(area, (place - low) / cell, height / cell, cell)
    dark = DARKEST * np.maximum(lacking - FAINT, 0.0)
    return Shade(low, cell, dark) if dark.any() else None


def laid(
    shade: Shade, corner: np.ndarray, color: np.ndarray, opacity: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tiles of a floor with the shade on them: those that have any are cut into cells, those in
    which it is much the same into four parts.

    corner (t, 4, 3), color (t, 4, 3) and opacity (t, 4): as `surfaces.floor` returns them, and
    returned likewise.
    """
    n = IN_A_TILE
    first = np.round((corner[:, 0, [0, 2]] - shade.low) / shade.cell).astype(int)
    there = ((first >= 0) & (first <= CELLS - n)).all(axis=1)
    at = np.where(there[:, None], first, 0)[:, :, None] + np.arange(n + 1)
    dark = shade.dark[at[:, 0, :, None], at[:, 1, None, :]]  # (t, n + 1, n + 1)
    shaded, fine = there & dark.any(axis=(1, 2)), np.ptp(dark, axis=(1, 2)) > UNEVEN
    tiles = corner, color, opacity
    found = [[values[~shaded] for values in tiles]]
    for cut, step in ((shaded & fine, 1), (shaded & ~fine, n // 2)):
        over = [_over_cells(values[cut], n // step) for values in tiles]
        over[1] *= 1 - dark[cut, ::step, ::step, None]
        found.append([_quads(values) for values in over])
    corner, color, opacity = (np.concatenate(values) for values in zip(*found, strict=True))
    return corner, color, opacity


def _over_cells(values: np.ndarray, count: int) -> np.ndarray:
    """What is given at the corners of tiles, (t, 4, ...), at those of count^2 parts of each:
    (t, count + 1, count + 1, ...), by x and z.
    """
    part = np.linspace(0, 1, count + 1)
    x, z = np.meshgrid(part, part, indexing="ij")
    weight = np.stack([(1 - x) * (1 - z), x * (1 - z), x * z, (1 - x) * z])
    found: np.ndarray = np.einsum("kxz,tk...->txz...", weight, values)
    return found


def _quads(values: np.ndarray) -> np.ndarray:
    """What is given at the corners of parts, at the four of each part, (parts, 4, ...)."""
    around = values[:, :-1, :-1], values[:, 1:, :-1], values[:, 1:, 1:], values[:, :-1, 1:]
    return np.stack(around, axis=3).reshape(-1, 4, *values.shape[3:])


def on_grid(area: np.ndarray, place: np.ndarray, height: np.ndarray, cell: float) -> np.ndarray:
    """The part of the light that is lacking at the corners of a grid's cells.

    area: (k,), of the parts' projections, world units. place: (k, 2), in cells from the grid's
    first corner. height: (k,), in cells. cell: the side of one, world units.

    Returns (CELLS + 1, CELLS + 1) float32.
    """
    inside = ((place >= 0) & (place < CELLS)).all(axis=1)
    area, place, height = area[inside], place[inside], height[inside]
    layer = np.clip(2 * np.log2(np.maximum(height, 1.0)), 0, LAYERS - 1)
    where = np.stack([layer, *place.T])
    first = np.minimum(where.astype(int), [[LAYERS - 2], [CELLS - 1], [CELLS - 1]])
    # Each part is shared by two layers, and in each by the four corners around it.
    by_layer, by_x, by_z = np.stack([1 - (where - first), where - first], axis=1)
    weight = (by_layer * (area / cell**2))[:, None, None] * by_x[:, None] * by_z
    shape = LAYERS, CELLS + 1, CELLS + 1
    steps = np.array([(CELLS + 1) ** 2, CELLS + 1, 1])
    at = steps @ first + (np.indices((2, 2, 2)).T @ steps).T[..., None]
    flat = np.bincount(at.ravel(), weight.ravel(), int(np.prod(shape)))
    layers = np.fft.rfft2(flat.reshape(shape), (_WIDE, _WIDE))
    blurred = np.fft.irfft2((layers * _blurs()).sum(axis=0), (_WIDE, _WIDE))
    lacking: np.ndarray = blurred[: CELLS + 1, : CELLS + 1].clip(0.0, 1.0).astype(np.float32)
    return lacking


_WIDE = 3 * CELLS // 2  # with room beyond the grid: a convolution goes around


@lru_cache(maxsize=1)
def _blurs() -> np.ndarray:
    """The transforms of each layer's blur, whose parts add up to 1."""
    away = np.minimum(np.arange(_WIDE), _WIDE - np.arange(_WIDE))
    r2 = away[:, None] ** 2 + away**2
    found = []
    for layer in range(LAYERS):
        h2 = 2.0**layer
        blur = h2 / (h2 + r2) ** 2 / np.pi
        # What is beyond is no shade here: high layers keep less than 1.
        found.append(np.fft.rfft2(blur / max(blur.sum(), 1.0)))
    return np.array(found)


def _parts(
    picture: Picture, ground: float, up: float, cell: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parts, about as small as a cell, of what a picture has above its floor: the areas of their
    projections (k,), where these are (k, 2), and their heights (k,).
    """
    parts = [_of_triangles(picture.position, picture.triangles, 1.0, cell)]
    if picture.solids is not None:  # closed, so each is above a point twice
        parts.append(_of_triangles(picture.solids.vertex, picture.solids.triangles, 0.5, cell))
    balls = drawing.are_numbers(picture.position)
    if picture.as_spheres is not None:
        balls = balls & picture.as_spheres
    radius, centre = picture.radius[balls], picture.position[balls]
    area = np.repeat(np.pi * radius**2 / len(DISC), len(DISC))
    points = np.repeat(centre, len(DISC), axis=0)
    points[:, [0, 2]] += (radius[:, None, None] * DISC).reshape(-1, 2)
    parts.append((area, points))
    areas = np.concatenate([area for area, _ in parts])
    points = np.concatenate([points for _, points in parts])
    height = up * (points[:, 1] - ground)
    above = np.isfinite(height) & (height > -cell)
    return areas[above], points[above][:, [0, 2]], height[above]


def _of_triangles(
    position: np.ndarray, triangles: np.ndarray, share: float, cell: float
) -> tuple[np.ndarray, np.ndarray]:
    """The projected areas of the parts of triangles, a share of each, and their middles."""
    some = max(1, -(-len(triangles) // MOST))
    corner = position[triangles[::some]].astype(np.float64)
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = 0.5 * np.abs(first[:, 0] * second[:, 2] - first[:, 2] * second[:, 0])
    largest = float(np.max(area, initial=0.0, where=np.isfinite(area)))
    fine = int(np.ceil(np.sqrt(largest) / cell))
    fine = min(max(fine, 1), max(int(np.sqrt(MOST / max(len(corner), 1))), 1))
    weight = _middles(fine)
    points = np.einsum("mk,tkx->tmx", weight, corner).reshape(-1, 3)
    return np.repeat(share * some * area / len(weight), len(weight)), points


@lru_cache(maxsize=8)
def _middles(fine: int) -> np.ndarray:
    """The weights of a triangle's corners in the middles of fine^2 equal parts of it, (m, 3)."""
    i, j = np.divmod(np.arange(fine * fine), fine)
    upright = i + j < fine
    # Those of the other half of a parallelogram are turned over.
    a = np.where(upright, i + 1 / 3, fine - i - 1 / 3) / fine
    b = np.where(upright, j + 1 / 3, fine - j - 1 / 3) / fine
    return np.stack([a, b, 1 - a - b], axis=1)
