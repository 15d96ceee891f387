"""Triangles cut along a line of the window, on both sides of which other things are drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Edge:
    """An upright line of the window. x: its pixels from the left; right: whether what is left of
    it is cut off, and what is right of it stays; else the other way round.
    """

    x: float
    right: bool

    def beyond(self, x: np.ndarray) -> np.ndarray:
        """How far pixels are on the side that is cut off, (k,); not above 0: they stay."""
        return self.x - x if self.right else x - self.x


def clipped(
    vertex: np.ndarray, index: np.ndarray, beyond: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What of triangles stays: vertices and the numbers of corners.

    vertex: (k, columns), all of which change evenly along a triangle. index: (3m,) int32. beyond:
    (k,), which does too, how far each is on the side that is cut off; not above 0: it stays.
    """
    if not len(beyond) or beyond.max() <= 0:
        return vertex, index
    corner = index.reshape(-1, 3)
    out = beyond[corner] > 0
    count = out.sum(axis=1)
    kept, made, total = [corner[count == 0]], [vertex], len(vertex)
    for outside in (1, 2):
        some = corner[count == outside]
        odd = out[count == outside] == (outside == 1)  # the corner that is alone on its side
        first, rows = odd.argmax(axis=1), np.arange(len(some))
        a, b, c = (some[rows, (first + step) % 3] for step in range(3))
        p, q = total + rows, total + len(some) + rows  # on the sides from a to b, and to c
        made += [_between(vertex, beyond, a, other) for other in (b, c)]
        total += 2 * len(some)
        parts = [(p, b, c), (p, c, q)] if outside == 1 else [(a, p, q)]
        kept += [np.stack(part, axis=1) for part in parts]
    corners: np.ndarray = np.concatenate(kept).astype(np.int32).reshape(-1)
    return np.concatenate(made), corners


def _between(vertex: np.ndarray, beyond: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The vertices where sides from a to b, (s,) numbers of vertices, cross the line."""
    share = (beyond[a] / (beyond[a] - beyond[b])).astype(vertex.dtype)[:, None]
    found: np.ndarray = vertex[a] + share * (vertex[b] - vertex[a])
    return found
