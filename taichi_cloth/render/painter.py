"""Paints flat shapes into an image in memory, on the device that is running.

An image has the same bits on every run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.kernels.render import frame, paint
from taichi_cloth.render.picture import Rect
from taichi_cloth.render.rasterizer import NOWHERE, on_device, tile_of

NONE = np.zeros((0, 7), np.float32), np.zeros((0, 2), np.int32)


@dataclass(frozen=True)
class Shapes:
    """Shapes that lie upon each other, the first at the bottom.

    number: (k, 7) float32, what: (k, 2) int32, as `kernels/render/paint.py` has them.
    """

    number: np.ndarray
    what: np.ndarray


def lines(first: np.ndarray, second: np.ndarray, width: float, color: np.ndarray | int) -> Shapes:
    """Lines with round ends.

    first, second: (k, 2) pixels, their ends. width: pixels. color: (k,) 0xRRGGBB, or that of all.
    """
    number = np.zeros((len(first), 7), np.float32)
    number[:, :2], number[:, 2:4], number[:, 6] = first, second, width / 2
    return Shapes(number, _what(len(first), paint.STROKE, color))


def discs(
    centre: np.ndarray,
    radius: np.ndarray,
    color: np.ndarray | int,
    hidden: np.ndarray | float = 0.0,
) -> Shapes:
    """Discs. centre: (k, 2) pixels, radius: (k,) pixels, color: (k,) 0xRRGGBB, or that of all.

    hidden: (k,), the radius of what is painted over their middles, which need not be painted.
    """
    number = np.empty((len(centre), 7), np.float32)
    number[:, 4] = hidden
    number[:, :2], number[:, 2:4], number[:, 6] = centre, centre, radius
    return Shapes(number, _what(len(centre), paint.DISC, color))


def triangles(corner: np.ndarray, smooth: np.ndarray | int, color: np.ndarray | int) -> Shapes:
    """Triangles.

    corner: (k, 3, 2) pixels. smooth: (k,), for each the sum of 1, 2 and 4 for those of its sides
    (from its corners 0, 1 and 2 to the next) that are smooth; others overlap a neighbour's a
    little. color: (k,) 0xRRGGBB, or that of all.
    """
    number = np.zeros((len(corner), 7), np.float32)
    number[:, :6] = corner.reshape(-1, 6)
    return Shapes(number, _what(len(corner), smooth, color))


def outline(corner: np.ndarray) -> np.ndarray:
    """Which sides of triangles (m, 3) no other one has, (m,) int32, as `triangles` takes them."""
    sides = np.sort(np.stack([corner, np.roll(corner, -1, axis=1)], axis=2), axis=2)
    _, which, count = np.unique(
        sides.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True
    )
    alone = count[which.reshape(corner.shape)] == 1
    bits: np.ndarray = alone.astype(np.int32) @ np.array([1, 2, 4], np.int32)
    return bits


class Painter:
    """Paints in a room of an image, over `under`, and remembers where.

    under: (h, w) int32, 0xRRGGBB, what lies behind all shapes; None: what the image has.
    """

    def __init__(self, room: Rect, under: np.ndarray | None = None):
        tall, wide = self._tile = tile_of(room.width)
        self.room, self._across = room, -(-room.width // wide)
        self._tiles = self._across * -(-room.height // tall)
        self._over = under is None
        self._under = np.zeros(1, np.int32) if under is None else under.reshape(-1)
        self._box = on_device(self._tiles + 64, 4)
        self._triangles = False  # whether there were any
        self._fresh = True

    def draw(
        self,
        image: Any,
        width: int,
        shapes: Sequence[Shapes],
        again: tuple[int, ...] = NOWHERE,
    ) -> None:
        """Paint shapes, the first ones first, into an image (h * width,) int32.

        again: columns and rows of the image, from and to, in which something else was drawn
        meanwhile.
        """
        shapes = [some for some in shapes if len(some.what)]
        if self._over and not shapes:
            return
        number, what = NONE
        if shapes:
            number = np.concatenate([some.number for some in shapes])
            what = np.concatenate([some.what for some in shapes])
        chunks = -(-len(what) // frame.CHUNK)
        needed = self._tiles + chunks
        if self._box.shape[0] < needed:
            self._box, self._fresh = on_device(2 * needed, 4), True
        count = np.zeros(paint.COUNTS, np.int32)
        room = self.room
        count[paint.ROOM :][:4] = room.x, room.y, room.width, room.height
        count[paint.TILE :][:4] = *self._tile, self._across, self._tiles
        count[paint.WIDTH], count[paint.FRESH], count[paint.OVER] = width, self._fresh, self._over
        count[paint.AGAIN :][:4] = again
        count[paint.CHUNKS] = chunks
        count[paint.WORKERS] = runtime.current_device().threads
        self._triangles = self._triangles or bool((what[:, 0] >= 0).any())
        paint.paint(self._triangles, number, what, count, self._box, self._under, image)
        self._fresh = False


def _what(count: int, kind: np.ndarray | int, color: np.ndarray | int) -> np.ndarray:
    what = np.empty((count, 2), np.int32)
    what[:, 0], what[:, 1] = kind, color
    return what
