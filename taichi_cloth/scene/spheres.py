"""The spheres by which particles of a cloth with a thickness keep apart: how large each must be.

The corners of triangles are spheres that may not overlap. If an edge of one triangle meets another
triangle at a point, and m are the weights of that point's corners in either, then the weighted mean
of the squares of the distances between corners of both is the sum, over both, of the weighted mean
square distance of the corners from the point (Lagrange). That is at most L^2 / 4 for an edge as
long as L, and q for a triangle: the square of its circumradius, or of half its longest edge where
it has an obtuse angle. So where all corners of one keep sqrt(2 q) from those of the other, with the
larger q of both, the triangles cannot meet. That is a spacing, for squares cut in two.

Spheres are STRETCH times as large, for cloth that is stretched and for overlaps that iterations
leave. Pairs that start nearer keep what they start with; neighbours in a cloth part of it, so that
springs and not spheres carry its compression and shear.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from taichi_cloth.errors import InputError, counted
from taichi_cloth.scene.triangles import springs_of_sides

STRETCH = 1.25  # of what triangles need at the start
RINGS = 3  # of sides between two corners that are neighbours: sheets fold no sharper
COMPRESSED = 0.7  # of its distance at the start, to which a pair of neighbours may come
SKIN = 0.4  # of the smallest sphere's diameter, that is listed beyond the reach of pairs
PATCH = 16  # particles of a patch, at least
# About as many patches at most, or twice the root of the particles: each two are compared in a step
FEW_PATCHES, MOST_PATCHES = 256, 2048
MOST_PAIRS = 20_000_000  # that start nearer than their spheres are wide


@dataclass(frozen=True)
class Spheres:
    """The spheres of a scene, by which pairs keep apart.

    radius: (n,), of each particle; -1: it passes through all others. thick: (n,) bool, whether it
    is of a cloth with a thickness. start, other, reach: compressed rows of the pairs that keep
    less than the sum of their radii: those of particle i are `other` and `reach` from start[i] to
    start[i + 1]. skin: how much farther pairs are listed [length]. patch_start, in_patches: patches
    of particles that start near each other, each of one cloth; those of patch b are in_patches
    from patch_start[b] to patch_start[b + 1], and behind the last one those who pass through all.
    widened: what is said of cloths whose spheres are wider than their thickness. unguarded: (u, 2),
    pairs that start so near that triangles at them may meet whatever spheres do, and are no
    neighbours: other layers, as of a lining.
    """

    radius: np.ndarray
    thick: np.ndarray
    start: np.ndarray
    other: np.ndarray
    reach: np.ndarray
    skin: float
    patch_start: np.ndarray
    in_patches: np.ndarray
    widened: tuple[str, ...]
    unguarded: np.ndarray

    def rows_by_place(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """start, other and reach with places in `in_patches` instead of particles."""
        place = np.empty(len(self.in_patches), np.int64)
        place[self.in_patches] = np.arange(len(place))
        counts = np.diff(self.start)[self.in_patches]
        start = np.append(0, np.cumsum(counts))
        row = np.repeat(self.start[self.in_patches] - start[:-1], counts) + np.arange(start[-1])
        return start, place[self.other[row]], self.reach[row]


def needed_diameters(
    position: np.ndarray, triangles: np.ndarray, between: np.ndarray, rest_length: np.ndarray
) -> np.ndarray:
    """The distance of corners at which triangles cannot meet, (n,): sqrt(2 q), see above.

    A side is as long as at the start, or as its spring at rest where that is longer.
    """
    spring = springs_of_sides(triangles, between)
    rest = np.where(spring >= 0, np.append(rest_length, 0.0)[spring], 0.0)
    corners = position[triangles]
    apart = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    squares = np.maximum(apart, rest) ** 2
    longest, total = squares.max(axis=1), squares.sum(axis=1)
    with np.errstate(all="ignore"):
        sixteen_areas2 = total**2 - 2 * (squares**2).sum(axis=1)
        around = squares.prod(axis=1) / sixteen_areas2  # the square of the circumradius
    q = np.where(2 * longest < total, around, longest / 4)
    needed = np.zeros(len(position))
    np.maximum.at(needed, triangles.ravel(), np.repeat(np.sqrt(2 * q), 3))
    return needed


def most_near(position: np.ndarray, triangles: np.ndarray) -> int:
    """The most others that are at the start within the reach of one corner.

    position: (n, 3); triangles: (m, 3). Their spheres are as wide as the triangles ask for.
    """
    from scipy.spatial import cKDTree

    diameter = STRETCH * needed_diameters(
        position, triangles, np.zeros((0, 2), np.int64), np.zeros(0)
    )
    reach = (diameter + diameter.max(initial=0.0)) / 2
    near = cKDTree(position).query_ball_point(position, reach, return_length=True)
    return int(np.max(near, initial=1)) - 1


def spheres(
    position: np.ndarray,
    radius: np.ndarray,
    thickness: np.ndarray,
    triangles: np.ndarray,
    between: np.ndarray,
    rest_length: np.ndarray,
    collisions: bool,
) -> Spheres:
    """The spheres of a scene; InputError where too many pairs start inside each other.

    position (n, 3), radius, thickness (n,), triangles (m, 3), between (s, 2), rest_length (s,): the
    scene's.
    collisions: whether all others collide too, by their radii.
    """
    thick = thickness > 0
    needed = needed_diameters(position, triangles, between, rest_length)
    diameter = np.maximum(thickness, STRETCH * needed)
    size = np.where(thick, diameter / 2, radius if collisions else -1.0)
    part = _parts(thick, triangles, between)
    pairs, reach = _nearer(position, size, part, triangles, between)
    both = np.concatenate([pairs, pairs[:, ::-1]])
    order = np.argsort(both[:, 0], kind="stable")
    start = np.searchsorted(both[order, 0], np.arange(len(position) + 1))
    return Spheres(
        radius=size,
        thick=thick,
        start=start,
        other=both[order, 1],
        reach=np.concatenate([reach, reach])[order],
        skin=SKIN * float(diameter[thick].min(initial=np.inf)),
        **_patches(position, size, part),
        widened=tuple(_widened(thickness, diameter, part)),
        unguarded=_unguarded(position, pairs, needed, triangles),
    )


def _patches(position: np.ndarray, size: np.ndarray, part: np.ndarray) -> dict[str, np.ndarray]:
    """Patches of consecutive particles along a curve through each cloth (Morton, 1966)."""
    extent = np.ptp(position, axis=0).max(initial=0.0) or 1.0
    cell = (1023 * ((position - position.min(axis=0)) / extent)).astype(np.int64)
    code = np.zeros(len(position), np.int64)
    for bit in range(10):
        for axis in range(cell.shape[1]):
            code |= (cell[:, axis] >> bit & 1) << (3 * bit + axis)
    order = np.lexsort((code, part))
    inside, outside = order[size[order] >= 0], order[size[order] < 0]
    patches = min(max(FEW_PATCHES, 2 * int(np.sqrt(len(inside)))), MOST_PATCHES)
    length = max(PATCH, -(-len(inside) // patches))
    cloth = np.flatnonzero(np.diff(part[inside], prepend=-2))
    ends = [np.arange(a, b, length) for a, b in zip(cloth, [*cloth[1:], len(inside)], strict=True)]
    return {
        "patch_start": np.append(np.concatenate(ends), len(inside)),
        "in_patches": np.append(inside, outside),
    }


def _widened(thickness: np.ndarray, diameter: np.ndarray, part: np.ndarray) -> Iterator[str]:
    """A note on cloths whose spheres are wider than their thickness."""
    wider = (part >= 0) & (diameter > thickness)
    for cloth in np.unique(part[wider]):
        mine = np.flatnonzero(part == cloth)
        asked, taken = thickness[mine].max(), diameter[mine].max()
        yield (
            f"thickness {asked:.4g} of particles {mine[0]} to {mine[-1]} is taken as {taken:.4g}: "
            "their spacing asks for that; a finer cloth may be thinner"
        )


def _unguarded(
    position: np.ndarray, pairs: np.ndarray, needed: np.ndarray, triangles: np.ndarray
) -> np.ndarray:
    """Those of the pairs that keep less than their spheres, between which triangles may meet."""
    from scipy.sparse import coo_array

    i, j = pairs.T
    near = pairs[((position[i] - position[j]) ** 2).sum(axis=1) < _reach2(needed, i, j)]
    found: np.ndarray = near
    if not len(near):
        return found
    sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    both, count = np.concatenate([sides, sides[:, ::-1]]).T, len(position)
    ring = coo_array((np.ones(len(both[0])), (both[0], both[1])), shape=(count, count)).tocsr()
    reached = ring
    for _ in range(RINGS - 1):
        reached = reached + reached @ ring
    neighbours = np.asarray(reached[near[:, 0], near[:, 1]]).ravel() > 0
    found = near[~neighbours]
    return found


def _reach2(needed: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """The square of the distance from which on triangles at i and j cannot meet: of both ends of
    sqrt((L^2 / 4) + q); L^2 / 4 is at most the q of the edge's own triangle.
    """
    squares: np.ndarray = (needed[i] ** 2 + needed[j] ** 2) / 2
    return squares


def nearness(position: np.ndarray, of: Spheres) -> str:
    """A note on the layers of a scene that begin too near; "": there are none."""
    if not len(of.unguarded):
        return ""
    (i, j), count = of.unguarded[0], len(of.unguarded)
    apart = float(np.linalg.norm(position[i] - position[j]))
    wide = float((of.radius[of.unguarded].sum(axis=1)).max())
    return (
        f"{counted(count, 'pair')} of particles of cloth begin{'s' * (count == 1)} nearer than the "
        f"thickness can guard, {'' if count == 1 else 'the first '}{i} and {j}, {apart:.3g} apart: "
        "faces there can go through each other; let layers begin "
        f"{wide:.3g} apart, or make them finer"
    )


def _parts(thick: np.ndarray, triangles: np.ndarray, between: np.ndarray) -> np.ndarray:
    """The number of the cloth that each particle is of, (n,); -1 where it has no thickness."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ties = np.concatenate([triangles[:, :2], triangles[:, 1:], between])
    ties = ties[thick[ties].all(axis=1)]
    shape = len(thick), len(thick)
    joined = coo_array((np.ones(len(ties)), (ties[:, 0], ties[:, 1])), shape=shape)
    return np.where(thick, connected_components(joined, directed=False)[1], -1)


def too_near(position: np.ndarray, triangles: np.ndarray, of: Spheres) -> np.ndarray:
    """The pairs of particles of cloths that are so near that triangles at them may meet, (p, 2).

    Where there are none, no two triangles meet but those of neighbours. position: (n, 3), of now;
    triangles: (m, 3), those that are whole.
    """
    from scipy.spatial import cKDTree

    needed = needed_diameters(position, triangles, np.zeros((0, 2), np.int64), np.zeros(0))
    mine = np.flatnonzero(of.thick & (needed > 0))
    widest = float(needed[mine].max(initial=0.0))
    listed = cKDTree(position[mine]).query_pairs(widest, output_type="ndarray")
    pairs = mine[np.sort(listed, axis=1)].reshape(-1, 2)
    i, j = pairs.T
    pairs = pairs[((position[i] - position[j]) ** 2).sum(axis=1) < _reach2(needed, i, j)]
    count = len(position)
    closer = np.repeat(np.arange(count), np.diff(of.start)) * count + of.other
    neighbours = np.setdiff1d(closer, of.unguarded @ (count, 1))
    found: np.ndarray = pairs[~np.isin(pairs @ (count, 1), neighbours)]
    return found


def _nearer(
    position: np.ndarray,
    size: np.ndarray,
    part: np.ndarray,
    triangles: np.ndarray,
    between: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of thick particles (p, 2) that keep less than the sum of their radii, and how much."""
    from scipy.spatial import cKDTree

    thick = part >= 0
    mine = np.flatnonzero(thick)
    tree = cKDTree(position[mine])
    widest = 2 * float(size[mine].max(initial=0.0))
    if tree.count_neighbors(tree, widest) > 2 * MOST_PAIRS:
        raise InputError(
            f"thickness: more than {MOST_PAIRS:g} pairs of particles start nearer to each other "
            f"than {widest:g}; take a smaller one, or a coarser cloth"
        )
    near = mine[np.sort(tree.query_pairs(widest, output_type="ndarray"), axis=1)].reshape(-1, 2)
    sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    ties = np.concatenate([sides, _across(triangles, sides), between])
    ties = np.sort(ties[thick[ties].all(axis=1)], axis=1)
    pairs = np.unique(np.concatenate([near, ties[ties[:, 0] != ties[:, 1]]]), axis=0)
    i, j = pairs.T
    apart = np.linalg.norm(position[i] - position[j], axis=1)
    keep = np.where(part[i] == part[j], COMPRESSED * apart, apart)
    less = keep < size[i] + size[j]
    return pairs[less], keep[less]


def _across(triangles: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Pairs of corners that face each other across a side of two triangles, (p, 2)."""
    facing = np.concatenate([triangles[:, (k + 2) % 3] for k in range(3)])
    if len(sides) == 0:
        return np.zeros((0, 2), np.int64)
    low, high = sides.min(axis=1), sides.max(axis=1)
    order = np.lexsort((high, low))
    low, high, facing = low[order], high[order], facing[order]
    same = (low[1:] == low[:-1]) & (high[1:] == high[:-1])
    return np.column_stack([facing[:-1][same], facing[1:][same]])
