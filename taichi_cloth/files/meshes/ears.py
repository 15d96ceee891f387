"""Polygons that are not convex as triangles: ears are cut off, the widest first.

Meisters, "Polygons have ears", 1975. No library is asked: `docs/notes/mesh-readers.md` says why.
"""

from __future__ import annotations

from heapq import heapify, heappop, heappush

import numpy as np

# A corner blocks an ear that comes nearer to it than this, in areas of the polygon's box.
MARGIN = 1e-10
AT_ONCE = 2**18  # pairs of sides that are looked at together, inside a processor's cache

Point = tuple[float, float]


def cut(x: np.ndarray) -> np.ndarray:
    """The triangles of a polygon with corners x (c, 3), in their order: numbers of corners,
    (c - 2, 3).

    Each corner is one of some triangle, also on a straight side. Sides may touch, as those that
    lead to a hole and back. A polygon that crosses itself is cut, too, but no cut of it is right
    (`crosses`).
    """
    return _Ears(_flat(x)).cut()


def crosses(x: np.ndarray, triangles: np.ndarray) -> bool:
    """True if a polygon with corners x (c, 3) crosses itself, or `triangles` (c - 2, 3), into which
    it was cut, turn back. Sides that touch, or lie on each other, do not cross. Costs c^2.
    """
    p = _flat(x)
    margin = MARGIN * float((np.ptp(p, axis=0) ** 2).max())

    def turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
        """Which way triangles (k, 2) are wound, (k,): 1, counter-clockwise, -1, or 0."""
        (u, v), (s, t) = (b - a).T, (c - a).T
        twice = u * t - v * s
        return np.where(np.abs(twice) > margin, np.sign(twice), 0.0)

    if (turn(*(p[triangles[:, n]] for n in range(3))) < 0).any():
        return True
    ahead = np.roll(p, -1, axis=0)
    low, high = np.minimum(p, ahead), np.maximum(p, ahead)
    for first in range(0, len(p), at_once := max(AT_ONCE // len(p), 1)):
        part = slice(first, first + at_once)
        near = (low[part, None, 0] < high[:, 0]) & (low[:, 0] < high[part, None, 0])
        near &= (low[part, None, 1] < high[:, 1]) & (low[:, 1] < high[part, None, 1])
        one, other = np.nonzero(near)
        a, b, c, d = p[first + one], ahead[first + one], p[other], ahead[other]
        if ((turn(a, b, c) * turn(a, b, d) < 0) & (turn(c, d, a) * turn(c, d, b) < 0)).any():
            return True
    return False


def _flat(x: np.ndarray) -> np.ndarray:
    """Corners (c, 3) seen along the axis that is nearest to the normal, counter-clockwise, (c, 2).

    Numbers stay what they are: corners on a line stay on it, corners at one place stay there.
    """
    spokes = x[1:] - x[0]
    normal = np.cross(spokes[:-1], spokes[1:]).sum(axis=0)
    axis = int(np.abs(normal).argmax())
    size = np.ptp(x, axis=0)
    if np.abs(normal[axis]) <= MARGIN * size.max() ** 2:  # its parts cancel: it crosses itself
        axis = int(size.argmin())
    kept = [(axis + 1) % 3, (axis + 2) % 3]
    return x[:, kept if normal[axis] > 0 else kept[::-1]]


class _Ears:
    """A polygon (c, 2) of which ears are cut off. Costs c^2."""

    def __init__(self, x: np.ndarray):
        self.points: list[tuple[float, float]] = [(u, v) for u, v in x.tolist()]
        self.u, self.v = x.T.copy()  # of corners that are cut off: NaN, which is nowhere
        count = len(x)
        self.back, self.ahead = [n - 1 for n in range(count)], [n + 1 for n in range(count)]
        self.back[0], self.ahead[-1] = count - 1, 0
        self.left = count
        self.width = [self._width(n) for n in range(count)]
        self.margin = MARGIN * float((np.ptp(x, axis=0) ** 2).max())

    def _width(self, b: int) -> float:
        """Twice the area of the triangle at corner b; negative where the polygon turns back."""
        a, c = self.points[self.back[b]], self.points[self.ahead[b]]
        return _cross(a, self.points[b], c)

    def cut(self) -> np.ndarray:
        triangles: list[tuple[int, int, int]] = []
        # Where no ear is left: those that touch corners, then those with corners on their sides,
        # then whatever is widest. A polygon that does not cross itself has one until the end.
        for margin in (self.margin, 0.0, -self.margin, None):
            there = np.flatnonzero(np.isfinite(self.u)).tolist()
            waiting = [(-self.width[n], n) for n in there]
            heapify(waiting)
            while waiting and self.left > 3:
                narrow, b = heappop(waiting)
                if -narrow != self.width[b]:
                    continue  # it is cut off, or has other neighbours now, and waits with these
                if margin is not None and not (narrow < 0 and self._is_free(b, margin)):
                    continue
                a, c = self.back[b], self.ahead[b]
                triangles.append((a, b, c))
                self._remove(a, b, c)
                for n in (a, c):
                    heappush(waiting, (-self.width[n], n))
        b = int(np.isfinite(self.u).argmax())
        return np.array([*triangles, (b, self.ahead[b], self.ahead[self.ahead[b]])])

    def _remove(self, a: int, b: int, c: int) -> None:
        self.ahead[a], self.back[c] = c, a
        self.u[b] = self.v[b] = self.width[b] = np.nan
        self.left -= 1
        self.width[a], self.width[c] = self._width(a), self._width(c)

    def _is_free(self, b: int, margin: float) -> bool:
        """True if no other corner lies in the triangle at b, or nearer to it than the margin."""
        corners = self.back[b], b, self.ahead[b]
        inside = np.ones(len(self.points), bool)
        for n, m in zip(corners, (*corners[1:], corners[0]), strict=True):
            (u0, v0), (u1, v1) = self.points[n], self.points[m]
            inside &= (u1 - u0) * (self.v - v0) - (v1 - v0) * (self.u - u0) >= -margin
        inside[list(corners)] = False
        # One at an end's own place, where a side leads to a hole and back, is in nobody's way.
        ends = [self.points[n] for n in corners]
        return all(self.points[n] in ends for n in np.flatnonzero(inside).tolist())


def _cross(a: Point, b: Point, c: Point) -> float:
    """Twice the area of a triangle; positive: counter-clockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
