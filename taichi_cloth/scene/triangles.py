"""Triangles between points: areas, what share each corner has, sums at particles (NumPy)."""

from __future__ import annotations

import numpy as np

from taichi_cloth.errors import InputError


def area_vectors(position: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The area of each triangle times its normal, (m, 3); position: (n, dim), in 2-D with z = 0."""
    a, b, c = (_in_space(position)[corner] for corner in triangles.T)
    vectors: np.ndarray = np.cross(b - a, c - a) / 2
    return vectors


def areas(position: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The area of each triangle, (m,)."""
    area: np.ndarray = np.linalg.norm(area_vectors(position, triangles), axis=1)
    return area


def corner_shares(position: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The share that each corner has of its triangle, (m, 3): its angle, in half turns.

    They add up to 1. The four corners of a square that is cut in two get a quarter of it each,
    whichever way it is cut, and those of an equilateral triangle a third, as they should by
    symmetry (Thuermer, Wuethrich, "Computing vertex normals from polygonal facets", 1998, weigh by
    angles for the same reason). Corners of a triangle without an area get a third.
    """
    corners = _in_space(position)[triangles]
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    across = np.linalg.norm(np.cross(ahead, back), axis=-1)
    shares = np.arctan2(across, (ahead * back).sum(axis=-1)) / np.pi
    flat = ~(across > 0).all(axis=1)
    shares[flat] = 1 / 3
    total: np.ndarray = shares / shares.sum(axis=1, keepdims=True)
    return total


def at_corners(values: np.ndarray, triangles: np.ndarray, count: int) -> np.ndarray:
    """The sum at each of `count` particles of what the triangles give their corners.

    values: (m, 3) numbers, or (m, 3, dim) vectors; the result is (count,) or (count, dim).
    """
    flat = values.reshape(len(triangles) * 3, -1)
    sums = [np.bincount(triangles.ravel(), column, count) for column in flat.T]
    total: np.ndarray = np.stack(sums, axis=-1) if values.ndim == 3 else sums[0]
    return total


def springs_of_sides(triangles: np.ndarray, between: np.ndarray) -> np.ndarray:
    """The springs along the sides of triangles, (m, 3): their numbers, -1 where there is none.

    Side k leads from corner k to the next one. triangles: (m, 3); between: (s, 2).
    """
    return springs_tying(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), between)


def springs_tying(pairs: np.ndarray, between: np.ndarray) -> np.ndarray:
    """The springs that tie pairs of particles, (...): their numbers, -1 where there is none.

    pairs: (..., 2), either way round; between: (s, 2), what each spring ties.
    """
    found = np.full(pairs.shape[:-1], -1, np.int64)
    if len(between) == 0 or pairs.size == 0:
        return found
    count = 1 + max(int(between.max()), int(pairs.max()))
    keys = between.min(axis=1) * count + between.max(axis=1)
    wanted = pairs.min(axis=-1) * count + pairs.max(axis=-1)
    order = np.argsort(keys)
    place = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)
    spring: np.ndarray = order[place]
    return np.where(keys[spring] == wanted, spring, found)


def elements(triangles: np.ndarray, between: np.ndarray, count: int, dim: int) -> np.ndarray:
    """Parts of cloths that are tested against sharp obstacles, as triangles (m, 3).

    In 3-D the triangles, in 2-D the springs along their sides; in both the springs between
    particles that are in no triangle, such as those of ropes. Springs are triangles whose last
    corners are one. Links to the next but one are left out: they are in no cloth's surface.

    between: (s, 2), what each spring ties; count: how many particles there are.
    """
    in_triangle = np.zeros(count, bool)
    in_triangle[triangles.ravel()] = True
    as_edge = ~in_triangle[between].any(axis=1)
    if dim == 2:
        sides = springs_of_sides(triangles, between)
        as_edge[sides[sides >= 0]] = True
    edges = between[as_edge][:, [0, 1, 1]]
    found: np.ndarray = edges if dim == 2 else np.concatenate([triangles, edges])
    return found.astype(np.int64)


def longest_side(
    position: np.ndarray, triangles: np.ndarray, between: np.ndarray, rest: np.ndarray
) -> float:
    """The length of the longest side of triangles or, if longer, of a side's spring at rest; 0
    where there are none. between: (s, 2), what each spring ties; rest: (s,), its length at rest.
    """
    x = position[triangles]
    longest = float(np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(initial=0.0))
    springs = np.unique(springs_of_sides(triangles, between))
    return max(longest, float(rest[springs[springs >= 0]].max(initial=0.0)))


def parted(position: np.ndarray, triangles: np.ndarray, between: np.ndarray) -> np.ndarray:
    """Corners of triangles at exactly the same place that no spring ties, (p, 2): the first that
    stands there, and another. position: (n, dim); between: (s, 2).
    """
    in_triangle = np.zeros(len(position), bool)
    in_triangle[triangles.ravel()] = True
    # Sums are equal where places are, and hardly ever elsewhere: few are left to be sorted.
    sums = (position * np.sqrt([2.0, 3.0, 5.0])[: position.shape[1]]).sum(axis=1)
    corners = np.flatnonzero(in_triangle)
    ranked = np.sort(sums[corners])
    twice = ranked[1:][ranked[1:] == ranked[:-1]]
    corners = corners[np.isin(sums[corners], twice)]
    at = position[corners] + 0.0  # makes 0 of -0
    order = np.lexsort((corners, *at.T))
    same = (at[order[1:]] == at[order[:-1]]).all(axis=1)
    begins = np.flatnonzero(~np.concatenate([[False], same]))
    first = np.repeat(begins, np.diff([*begins, len(order)]))
    pairs = np.stack([corners[order[first]], corners[order]], axis=1)[
        first != np.arange(len(order))
    ]
    apart: np.ndarray = pairs[springs_tying(pairs, between) < 0]
    return apart[np.argsort(apart[:, 1])]


def masses(position: np.ndarray, triangles: np.ndarray, density: float) -> np.ndarray:
    """The mass of each particle, (n,): density times its share of the triangles at it.

    What presses on triangles is shared in the same way, so that a flat sheet falls flat. The total
    is density times area, whatever the triangles' size. InputError for a particle at no triangle
    that has an area, which would have no mass.
    """
    shares = corner_shares(position, triangles) * areas(position, triangles)[:, None]
    mass = density * at_corners(shares, triangles, len(position))
    if len(mass) and not mass.min() > 0:
        raise InputError(f"density: particle {int(mass.argmin())} is at no triangle with an area")
    return mass


def _in_space(position: np.ndarray) -> np.ndarray:
    """Points with three coordinates, the last of them 0 in a plane."""
    if position.shape[1] == 3:
        return position
    return np.column_stack([position, np.zeros(len(position))])
