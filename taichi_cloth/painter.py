"""Paints flat shapes into a picture in memory, on the device that is running.

For the view that has nothing else to draw with; a picture has the same bits on every run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.kernels import paint

ROWS = 16  # that a thread of a CPU paints at a time, over the whole width
SQUARE = 8  # pixels along a side of what one of another device does


@dataclass(frozen=True)
class Shapes:
    """Shapes that lie upon each other, the first at the bottom.

    number: (k, 7) float32, what: (k, 2) int32, as `kernels/paint.py` has them.
    """

    number: np.ndarray
    what: np.ndarray


def lines(first: np.ndarray, second: np.ndarray, width: float, color: np.ndarray | int) -> Shapes:
    """Lines with round ends.

    first, second: (k, 2) pixels, their ends. width: pixels. color: (k,) 0xRRGGBB, or that of all.
    """
    number = np.empty((len(first), 7), np.float32)
    number[:, :2], number[:, 2:4], number[:, 6] = first, second, width / 2
    return Shapes(number, _what(len(first), paint.STROKE, color))


def discs(centre: np.ndarray, radius: np.ndarray, color: np.ndarray | int) -> Shapes:
    """Discs. centre: (k, 2) pixels, radius: (k,) pixels, color: (k,) 0xRRGGBB, or that of all."""
    number = np.empty((len(centre), 7), np.float32)
    number[:, :2], number[:, 2:4], number[:, 6] = centre, centre, radius
    return Shapes(number, _what(len(centre), paint.STROKE, color))


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


def draw(picture: np.ndarray, shapes: Sequence[Shapes]) -> None:
    """Paint shapes over a picture (h, w) uint32, 0xRRGGBB, row 0 on top, the first ones first."""
    shapes = [some for some in shapes if len(some.what)]
    if not shapes:
        return
    device = runtime.current_device().arch
    tile = (ROWS, picture.shape[1]) if device == "cpu" else (SQUARE, SQUARE)
    paint.paint(
        picture.view(np.int32),
        *tile,
        np.concatenate([some.number for some in shapes]),
        np.concatenate([some.what for some in shapes]),
    )


def _what(count: int, kind: np.ndarray | int, color: np.ndarray | int) -> np.ndarray:
    what = np.empty((count, 2), np.int32)
    what[:, 0], what[:, 1] = kind, color
    return what
