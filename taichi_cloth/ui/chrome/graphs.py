"""Graphs of the last seconds as blocks of pixels: few colours and whole columns, so that a view
that draws rectangles needs few of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taichi_cloth.ui.text import Color

PAPER = (13, 15, 21)
RULE = (38, 43, 57)  # lines at the labels, and each 2 seconds
EVERY = 2.0  # seconds from rule to rule
PARTS = 4  # of a scale: as fine as its ends are rounded


@dataclass(frozen=True)
class Curve:
    """Values (k,) by their ages in seconds (k,), the oldest first.

    A value that is NaN parts the curve: between its neighbours nothing is known. filled: whether
    all below is painted, too.
    """

    age: np.ndarray
    value: np.ndarray
    color: Color
    filled: bool = False


@dataclass(frozen=True)
class Line:
    """A level that curves are compared with."""

    value: float
    color: Color


def scale(low: float, high: float) -> tuple[float, float]:
    """A range around [low, high] that ends at round numbers: 1, 2 or 5 times a power of ten apart.

    A range of nothing gets some room; where 0 is near it is an end.
    """
    if not (math.isfinite(low) and math.isfinite(high)):
        return 0.0, 1.0
    size = max(abs(low), abs(high))
    if high - low <= 1e-9 * size or size == 0.0:
        low, high = low - (0.5 * size or 0.5), high + (0.5 * size or 0.5)
    if 0.0 <= low < 0.6 * high:
        low = 0.0
    if 0.0 >= high > 0.6 * low:
        high = 0.0
    step = rounded_up((high - low) / PARTS)
    return step * math.floor(low / step + 1e-9), step * math.ceil(high / step - 1e-9)


def rounded_up(value: float) -> float:
    """The next of 1, 2, 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= value * (1 - 1e-9))


def draw(
    block: np.ndarray,
    curves: list[Curve],
    lines: list[Line],
    ends: tuple[float, float],
    seconds: float,
    thick: int,
) -> None:
    """Paint a graph into pixels (h, w, 3) uint8; the newest values are at its right edge.

    ends: the values at its lower and upper edge. thick: of curves, pixels.
    """
    height, width = block.shape[:2]
    block[:] = PAPER
    for age in np.arange(EVERY, seconds - 1e-9, EVERY):
        block[:, width - 1 - int(age / seconds * width)] = RULE
    low, high = ends
    per_pixel = (height - thick) / max(high - low, 1e-300)

    def rows(value: np.ndarray) -> np.ndarray:
        row: np.ndarray = np.round(np.clip((high - value) * per_pixel, 0, height - thick))
        return row

    row_number = np.arange(height)[:, None]
    for curve in curves:
        found = _columns(curve.age, curve.value, width, seconds, thick)
        if found is None:
            continue
        least, most, cell = found
        top, bottom = rows(most), rows(least) + thick
        if curve.filled:
            bottom = np.full(len(top), float(height))
        there = ~np.isnan(most)
        inside = (row_number >= top) & (row_number < bottom) & there
        block[inside.repeat(cell, axis=1)[:, -width:]] = curve.color
    for line in lines:
        if low <= line.value <= high:
            row = int(rows(np.array(line.value)))
            block[row : row + max(thick // 2, 1)] = line.color


def _columns(
    age: np.ndarray, value: np.ndarray, width: int, seconds: float, thick: int
) -> tuple[np.ndarray, np.ndarray, int] | None:
    """The least and largest value in columns of pixels, and how wide a column is.

    NaN where there is nothing. What lies between two readings is on a line between them, and is
    nothing where one of them is NaN.
    """
    good = ~np.isinf(value)
    age, value = age[good], value[good]
    if not len(value):
        return None
    count = -(-width // thick)
    edge = -seconds + np.arange(count + 1) * (seconds / count)
    at_edge = np.interp(edge, -age, value, left=np.nan)
    least = np.fmin(at_edge[:-1], at_edge[1:])
    most = np.fmax(at_edge[:-1], at_edge[1:])
    inside = age <= seconds
    cell = np.clip(((seconds - age[inside]) / seconds * count).astype(np.int64), 0, count - 1)
    np.fmin.at(least, cell, value[inside])
    np.fmax.at(most, cell, value[inside])
    return least, most, thick
