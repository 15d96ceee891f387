"""Second derivatives on the triangles of a mesh, as weights of particles: Morley's element.

Morley, "The triangular equilibrium element in the solution of plate bending problems", 1968. On
each triangle the function is a quadratic with the values at the corners and the slopes across the
sides, at their midpoints, that are given there. A side gives both of its triangles the same slope:
so what a mesh stores converges to what a plate does, however it is cut, and only what is straight
stores nothing.

Particles have no slopes. That across a side is the slope of a quadratic, the nearest one to the
particles of the side's two triangles and of the neighbours of these. As it is exact for quadratics,
it changes nothing of that. At a border the slope is free: it is the one that stores least.

Meshes need not be flat: what lies around a side is laid flat, triangle by triangle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

AT_ONCE = 2**12  # triangles or sides that are looked at together, inside a processor's cache
SMALLEST = 1e-300  # area of a triangle whose inverse is a number
THINNEST = 1e-12  # height of a triangle, in its side's length
# Particles weigh by the inverse fourth power of their distance from a side's midpoint: a far one
# would make the mesh stiffer without making it better. A nearest one weighs as the side's ends.
NEAREST = 0.5  # in lengths of the side
POWER = -4
# A quadratic is known if what particles see of it, weighed so, has at least this square: 0.5 to 5
# in usual meshes. Else particles farther away are asked; what these do not see is taken as 0.
LEAST_KNOWN = 0.05
# Six of eight particles are enough for a quadratic. Two are left out where what is left weighs not
# much more for it, in squares, and is no closer to seeing too little: fewer particles, less work.
MOST_MORE, LEAST_LEFT = 1.5, 0.01
RINGS = 2  # of triangles around the two of a side, at most
NEGLIGIBLE = 1e-12  # part of a stencil's largest weight below which a particle does not count


@dataclass(frozen=True)
class Mesh:
    """Triangles of points, and how they lie beside each other.

    Side i of a triangle leads from its corner i + 1 to its corner i + 2. x: (n, dim). corners:
    (t, 3). beside: (t, 3), the triangle across each side, -1: there is none; side: (t, 3), which of
    its sides that is. length, height, foot: (t, 3), of each side its length, how far the corner
    opposite to it is away, and where the foot of that is, from 0 at the side's start to 1.
    """

    x: np.ndarray
    corners: np.ndarray
    beside: np.ndarray
    side: np.ndarray
    length: np.ndarray
    height: np.ndarray
    foot: np.ndarray

    @classmethod
    def of(cls, x: np.ndarray, corners: np.ndarray) -> Mesh:
        """The mesh of triangles `corners` of the points x."""
        ends = x[corners]
        start = np.roll(ends, -1, axis=1)
        along, away = np.roll(ends, -2, axis=1) - start, ends - start
        with np.errstate(all="ignore"):
            foot = (away * along).sum(axis=2) / (along**2).sum(axis=2)
            height = np.linalg.norm(away - foot[:, :, None] * along, axis=2)
        length = np.linalg.norm(along, axis=2)
        return cls(x, corners, *_neighbours(corners, len(x)), length, height, foot)

    @cached_property
    def area(self) -> np.ndarray:
        """Of each triangle, (t,)."""
        area: np.ndarray = self.length[:, 0] * self.height[:, 0] / 2
        return area

    @property
    def flat(self) -> np.ndarray:
        """The triangles that have no area, (t,) bool."""
        thick = (self.height > THINNEST * self.length).all(axis=1)
        flat: np.ndarray = ~(thick & (self.area > SMALLEST))
        return flat


def _neighbours(corners: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Across each side of triangles (t, 3), where it has exactly two: the other one, and which of
    its sides it is, both (t, 3); else -1.
    """
    ends = np.stack([np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)], axis=2)
    key = (ends.min(axis=2) * count + ends.max(axis=2)).ravel()
    order = np.argsort(key, kind="stable")
    _, first, times = np.unique(key[order], return_index=True, return_counts=True)
    first = first[times == 2]
    one, other = order[first], order[first + 1]
    apart = corners.ravel()[one] != corners.ravel()[other]  # not the same triangle twice
    one, other = one[apart], other[apart]
    across = np.full(len(key), -1, np.int64)
    across[one], across[other] = other, one
    beside, side = np.where(across >= 0, np.divmod(across, 3), -1).reshape(2, *corners.shape)
    return beside, side


# --- slopes across sides -------------------------------------------------------------------------


@dataclass(frozen=True)
class _Front:
    """Triangles around e sides, m of them for each, laid flat around the side's midpoint.

    The side is the unit of length, and lies along the first axis. triangle: (e, m), -1: absent;
    entry: (e, m), the side through which each was reached; at: (e, m, 3, 2), its corners.
    """

    triangle: np.ndarray
    entry: np.ndarray
    at: np.ndarray

    def points(self, mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
        """The corners that are new in these triangles: particles (e, m), -1: absent; and places."""
        particle = np.where(self.triangle >= 0, mesh.corners[self.triangle, self.entry], -1)
        return particle, _corner(self.at, self.entry)

    def beyond(self, mesh: Mesh, unit: np.ndarray) -> _Front:
        """The triangles across the two other sides of each; unit: (e,), the sides' lengths."""
        parts = []
        for turn in (1, 2):
            side = (self.entry + turn) % 3
            triangle = np.where(self.triangle >= 0, mesh.beside[self.triangle, side], -1)
            entry = np.where(triangle >= 0, mesh.side[self.triangle, side], 0)
            own = mesh.corners[self.triangle, (side + 1) % 3]
            same = mesh.corners[triangle, (entry + 1) % 3] == own  # or it is wound the other way
            one, other = (_corner(self.at, (side + k) % 3) for k in (1, 2))
            start = np.where(same[..., None], one, other)
            end = np.where(same[..., None], other, one)
            inside = _corner(self.at, side)
            parts.append((triangle, entry, _laid(mesh, triangle, entry, start, end, inside, unit)))
        joined = (np.concatenate(of, axis=1) for of in zip(*parts, strict=True))
        return _Front(*joined)


def _corner(at: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Of corners (e, m, 3, 2) one each, by its number (e, m): (e, m, 2)."""
    found: np.ndarray = np.take_along_axis(at, which[..., None, None], axis=2)[:, :, 0]
    return found


def _laid(
    mesh: Mesh,
    triangle: np.ndarray,
    entry: np.ndarray,
    start: np.ndarray,
    end: np.ndarray,
    inside: np.ndarray,
    unit: np.ndarray,
) -> np.ndarray:
    """The corners (e, m, 3, 2) of triangles whose side `entry` leads from `start` to `end`, and
    whose third corner is on the other side of that than `inside` is.
    """
    along = end - start
    normal = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    normal /= np.linalg.norm(along, axis=-1, keepdims=True)
    normal *= np.where(((inside - start) * normal).sum(axis=-1) > 0, -1.0, 1.0)[..., None]
    foot = mesh.foot[triangle, entry][..., None]
    height = (mesh.height[triangle, entry] / unit[:, None])[..., None]
    at = np.zeros((*triangle.shape, 3, 2))
    for corner, place in enumerate((start + foot * along + height * normal, start, end)):
        which = (entry + corner) % 3
        np.put_along_axis(at, which[..., None, None], place[:, :, None], axis=2)
    return at


@dataclass(frozen=True)
class _Slopes:
    """The slopes across all sides that two triangles share, as weights of particles.

    particle, weight: (e, p), of each side: its ends, the corners opposite to it of its own triangle
    and of the other one, and more; -1: absent. A particle may be there twice. The slope is towards
    the own triangle. number: (t, 3), which of these slopes the sides of triangles have, -1: none;
    own: (t, 3), those of their own triangles.
    """

    particle: np.ndarray
    weight: np.ndarray
    number: np.ndarray
    own: np.ndarray

    @classmethod
    def of(cls, mesh: Mesh) -> _Slopes:
        """Those of a mesh."""
        own = np.arange(len(mesh.corners))[:, None] < mesh.beside
        triangle, side = np.nonzero(own)
        number = np.full(own.shape, -1, np.int64)
        number[triangle, side] = np.arange(len(side))
        number[mesh.beside[triangle, side], mesh.side[triangle, side]] = np.arange(len(side))
        found = []
        for first in range(0, len(side), AT_ONCE):
            part = slice(first, first + AT_ONCE)
            found += [(first + at, *of) for at, *of in _fitted(mesh, triangle[part], side[part])]
        width = max((particle.shape[1] for _, particle, _ in found), default=4)
        particles, weights = np.full((len(side), width), -1, np.int64), np.zeros((len(side), width))
        for at, particle, weight in found:
            particles[at, : particle.shape[1]], weights[at, : weight.shape[1]] = particle, weight
        return cls(particles, weights, number, own)


def _fitted(
    mesh: Mesh, triangle: np.ndarray, side: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The slopes across sides (e,) of triangles (e,), by how far one has to look: their numbers
    (f,), particles (f, p) and weights (f, p), as `_Slopes` has them.
    """
    unit = mesh.length[triangle, side]
    start = np.tile([-0.5, 0.0], (len(side), 1, 1))
    above, below = np.array([[[0.0, 1.0]]]), np.array([[[0.0, -1.0]]])
    own = triangle[:, None], side[:, None]
    other = mesh.beside[own], mesh.side[own]
    same = mesh.corners[own[0], (own[1] + 1) % 3] == mesh.corners[other[0], (other[1] + 1) % 3]
    turned = np.where(same[..., None], start, -start)
    fronts = [
        (*own, _laid(mesh, *own, start, -start, below, unit)),
        (*other, _laid(mesh, *other, turned, -turned, above, unit)),
    ]
    front = _Front(*(np.concatenate(of, axis=1) for of in zip(*fronts, strict=True)))
    ends = [mesh.corners[own[0], (own[1] + k) % 3] for k in (1, 2)]
    found, place = front.points(mesh)
    particle = np.concatenate([*ends, found], axis=1)
    at = np.concatenate([start, -start, place], axis=1)
    mine: np.ndarray = np.arange(len(side))
    for ring in range(RINGS):
        front = front.beyond(mesh, unit[mine])
        found, place = front.points(mesh)
        particle, at = np.concatenate([particle, found], 1), np.concatenate([at, place], 1)
        fit = _Fit(particle >= 0, at)
        weight, done = fit.weight, fit.known | (ring == RINGS - 1)
        if ring == 0:
            needless = fit.needless()
            fewer = needless.any(axis=1)
            particle = np.where(needless, -1, particle)
            weight[fewer] = _Fit(particle[fewer] >= 0, at[fewer], LEAST_LEFT * LEAST_KNOWN).weight
        yield mine[done], particle[done], weight[done] / unit[mine[done], None]
        left = ~done
        if not left.any():
            return
        mine, particle, at = mine[left], particle[left], at[left]
        front = _Front(front.triangle[left], front.entry[left], front.at[left])


class _Fit:
    """Quadratics nearest to values at points, by least squares: what slope they have at the origin.

    there: (e, p), which of the points count; at: (e, p, 2). weight: (e, p), of the values in the
    slope along the second axis; known: (e,), whether the points see all of a quadratic: at least
    `least` of it in squares.
    """

    def __init__(self, there: np.ndarray, at: np.ndarray, least: float = LEAST_KNOWN) -> None:
        distance = np.maximum(np.linalg.norm(at, axis=2), NEAREST)
        self.root = np.where(there, distance ** (POWER / 2), 0.0)
        x, y = at[..., 0], at[..., 1]
        square = self.root**2
        size = np.sqrt((square * y * y).sum(axis=1) / square.sum(axis=1))[:, None]  # of slivers
        straight = self.root[:, :, None] * np.stack([np.ones_like(x), x, y / size], axis=2)
        curved = np.stack([x * x / 2, x * y / np.sqrt(2), y * y / 2], axis=2)
        curved *= self.root[:, :, None]
        inverse = np.linalg.inv(straight.transpose(0, 2, 1) @ straight)
        # Of the nearest straight function, and what of quadratics is none. Those have no slope.
        self.straight = inverse @ straight.transpose(0, 2, 1)
        first = self.straight[:, 2:] / size[:, None]
        apart = curved - straight @ (self.straight @ curved)
        squares, ways = np.linalg.eigh(apart.transpose(0, 2, 1) @ apart)
        known: np.ndarray = squares > least
        part = np.where(known, 1.0 / np.sqrt(np.where(known, squares, 1.0)), 0.0)[:, None]
        self.curved = (apart @ ways) * part
        wrong = (first @ curved @ ways) * part
        self.weighed = (first - wrong @ self.curved.transpose(0, 2, 1))[:, 0]
        self.weight = self.weighed * self.root
        self.known = np.asarray(known.all(axis=1))
        self._free = straight

    def needless(self) -> np.ndarray:
        """Of fits that know all, two points out of the last four without which they change least,
        if that is little: (e, p) bool, none or two each.
        """
        found = np.zeros(self.root.shape, bool)
        mine = np.flatnonzero(self.known & (self.root > 0).all(axis=1))
        last = slice(self.root.shape[1] - 4, None)
        seen = self._free[mine, last] @ self.straight[mine][:, :, last]
        curved = self.curved[mine, last]
        left = np.eye(4) - seen - curved @ curved.transpose(0, 2, 1)
        weighed = self.weighed[mine]
        least = np.full(len(mine), MOST_MORE) * (weighed**2).sum(axis=1)
        weighed = weighed[:, last]
        best = np.full(len(mine), -1)
        pairs = np.stack(np.triu_indices(4, 1), axis=1)
        for number, (i, j) in enumerate(pairs):
            a, b, c = left[:, i, i], left[:, j, j], left[:, i, j]
            u, v = weighed[:, i], weighed[:, j]
            whole = a * b - c * c
            fits = whole > LEAST_LEFT
            more = (b * u * u - 2 * c * u * v + a * v * v) / np.where(fits, whole, 1.0)
            better = fits & (more < least)
            best[better], least = number, np.where(better, more, least)
        chosen = np.flatnonzero(best >= 0)
        for place in pairs[best[chosen]].T:
            found[mine[chosen], last.start + place] = True
        return found


# --- second derivatives --------------------------------------------------------------------------


def curvature_weights(mesh: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The energy that each triangle stores, as the sum of squares of weighed sums of particles.

    That is the integral of the squared second derivatives over it. It has as many sums as it has
    neighbours. Returns where each begins, (m + 1,), particles and weights, (k,) each. A particle is
    there once, and the triangle's corners come first.
    """
    slopes, parts = _Slopes.of(mesh), []
    for first in range(0, len(mesh.corners), AT_ONCE):
        mine = np.arange(first, min(first + AT_ONCE, len(mesh.corners)))
        parts.append(_summed(mesh.corners[mine], *_of_rows(mesh, slopes, mine)))
    sizes, particle, weight = (np.concatenate(of) for of in zip(*parts, strict=True))
    return np.append(0, np.cumsum(sizes)), particle, weight


def _of_rows(
    mesh: Mesh, slopes: _Slopes, mine: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The place of each turn of triangles `mine` in their sums: the number of each sum, 3 t + row,
    particles, -1: absent, and weights, (k,) each.
    """
    particle, weight = _turns(mesh, slopes, mine)
    # Free sides come first: what they can take, they do. Those of fewest particles come last.
    counts = np.where(mesh.beside[mine] >= 0, (particle >= 0).sum(axis=2), 1 + particle.shape[2])
    order = np.argsort(-counts, axis=1, kind="stable")
    stored = np.take_along_axis(_stored(mesh, mine), order[:, None], axis=2)
    factor = np.asarray(np.linalg.qr(stored, mode="r"))
    bound = (mesh.beside[mine] >= 0).sum(axis=1)
    entries = []
    for row, column in zip(*np.triu_indices(3), strict=True):
        like = np.flatnonzero(bound >= 3 - row)
        side = order[like, column]
        one, value = particle[like, side], factor[like, row, column, None] * weight[like, side]
        number = np.broadcast_to(3 * like[:, None] + row, one.shape)
        entries.append((number.ravel(), one.ravel(), value.ravel()))
    number, among, value = (np.concatenate(of) for of in zip(*entries, strict=True))
    there = among >= 0
    return number[there], among[there], value[there]


def _stored(mesh: Mesh, mine: np.ndarray) -> np.ndarray:
    """Second derivatives (xx, sqrt 2 xy, yy) times the root of the area, by the turn at each side.

    A turn is by how much steeper the function is at the side, outwards, than on the plane through
    the corners. (t, 3, 3), a column for each side; each triangle has axes of its own.
    """
    length, area = mesh.length[mine], mesh.area[mine]
    x, y = np.zeros_like(length), np.zeros_like(length)
    foot = mesh.foot[mine, 0] * length[:, 0]  # of corner 0, along side 0
    x[:, 0] = length[:, 0]
    x[:, 1], y[:, 1] = foot - length[:, 0], mesh.height[mine, 0]
    x[:, 2], y[:, 2] = -foot, -mesh.height[mine, 0]
    stored: np.ndarray = np.stack([y * y, -np.sqrt(2) * x * y, x * x], axis=1)
    stored /= (length * np.sqrt(area)[:, None])[:, None]
    return stored


def _turns(mesh: Mesh, slopes: _Slopes, mine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The turn at each side of triangles `mine`: particles, -1: absent, and weights, (t, 3, p)."""
    own, here = slopes.own[mine], slopes.number[mine]
    if not len(slopes.particle):
        return np.full((*own.shape, 1), -1), np.zeros((*own.shape, 1))
    particle = np.where(here[..., None] >= 0, slopes.particle[here], -1)
    weight = np.where(own, -1.0, 1.0)[..., None] * slopes.weight[here]
    height, foot = mesh.height[mine], mesh.foot[mine]
    from_end = particle[..., 0] != np.roll(mesh.corners[mine], -1, axis=1)
    foot = np.where(from_end, 1 - foot, foot)
    for place, part in enumerate((foot - 1, -foot, own, ~own)):
        weight[..., place] += part / height
    return particle, weight


def _summed(
    corners: np.ndarray, number: np.ndarray, particle: np.ndarray, value: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The particles of each sum, particles and weights, as `curvature_weights` has them.

    corners: (t, 3), of the triangles; number, particle, value: (k,), what adds up.
    """
    own = corners[number // 3] == particle[:, None]
    place = np.where(own.any(axis=1), own.argmax(axis=1), particle + 3)
    count = int(particle.max(initial=0)) + 4
    key, which = np.unique(number * count + place, return_inverse=True)
    value = np.bincount(which.ravel(), value, len(key))
    number, place = np.divmod(key, count)
    _, owner = np.unique(number, return_inverse=True)
    largest = np.zeros(int(owner.max(initial=-1)) + 1)
    np.maximum.at(largest, owner, np.abs(value))
    kept = (place < 3) | (np.abs(value) > NEGLIGIBLE * largest[owner])
    number, place, value, owner = number[kept], place[kept], value[kept], owner[kept]
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    value[first] -= np.bincount(owner, value, len(largest))  # so that they add up to 0
    own_corner = corners[number // 3, np.minimum(place, 2)]
    sizes = np.bincount(owner, minlength=len(largest))
    return sizes, np.where(place < 3, own_corner, place - 3), value
