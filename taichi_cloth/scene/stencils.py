"""Stencils: particles whose weighted sum is a curvature vector, where cloth resists being bent.

A stencil has the curvature vector sum_k weight_k x_k of its particles and the energy
B/2 |curvature vector|^2. That is quadratic in positions: what a flat surface stores when it is bent
without being stretched. Its force is linear, and flat is its shape at rest.

- In a row it is the second difference: with spacing s, for a strip of width b,
  B b/(2 s^3) |x_(i-1) - 2 x_i + x_(i+1)|^2.
- In a mesh, each triangle has up to three, over its corners and those of its neighbours: the second
  derivatives of the quadratic through these six points, so that the energy is B/2 (kappa_1^2 +
  kappa_2^2) a unit of area on any mesh: Onate, Zarate, "Rotation-free triangular plate and shell
  elements", 2000. At a border, or where the six points lie so that no quadratic fits well, edges
  stand for it, each with the vector that Bergou, Wardetzky, Harmon, Zorin, Grinspun, "A quadratic
  bending model for inextensible surfaces", 2006, give it: l angle n n^T / (2 area). Their model
  takes each edge by itself; what that stores depends on how edges lie, up to threefold between two
  directions of one regular mesh.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.scene.equality import Rows
from taichi_cloth.scene.triangles import springs_tying
from taichi_cloth.settings import accepted

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

IN_ROW = 3  # particles of a stencil in a row; those of meshes have more
AT_ONCE = 2**14  # triangles whose stencils are made together, inside a processor's cache
# Of an edge at which a mesh is clamped, both triangles hold half of the energy of a uniform bend;
# where one of them is fixed the whole bend is in the other, which takes twice the energy of both.
AT_CLAMP = 3.0
SMALLEST = 1e-300  # area of a triangle whose inverse is a number
# A quadratic through a triangle's corners and those of its neighbours is taken where edges alone
# recover at least this part of its second derivatives: 0.5 to 1 on usual meshes.
LEAST_RECOVERED = 0.3


@dataclass(frozen=True, eq=False, repr=False)
class Stencils(Rows):
    """m stencils, of any number of particles each.

    start: (m + 1,) int64, where each stencil's particles begin.
    particle: (k,) int64. Three: the middle of a row and the two beside it. More: the corners of a
        triangle, then others of its neighbours.
    weight: (k,) float64, of these particles [1 / length]; those of a stencil add up to 0.
    bending: (m,) float64, the rigidity B [force * length].
    """

    ONE = "stencil"
    start: np.ndarray
    particle: np.ndarray
    weight: np.ndarray
    bending: np.ndarray

    def __post_init__(self) -> None:
        whole = {"start": np.int64, "particle": np.int64}
        accepted.take_types(self, **whole, weight=np.float64, bending=np.float64)

    def __len__(self) -> int:
        return len(self.bending)

    @classmethod
    def none(cls) -> Stencils:
        """No stencils."""
        return cls.build(np.zeros((0, IN_ROW), np.int64), np.zeros((0, IN_ROW)), 0.0)

    @classmethod
    def build(cls, particle: ArrayLike, weight: ArrayLike, bending: ArrayLike) -> Stencils:
        """Stencils of equally many particles, and their weights, both (m, size); bending: one for
        all or one each.

        Raises InputError for what are no numbers of that shape; `checks` knows their limits.
        """
        what = "Stencils.build"
        ends = accepted.whole_numbers(f"{what}: particle", particle)
        if ends.ndim != 2:
            raise InputError(f"{what}: particle must have shape (m, size), has {ends.shape}")
        m, size = ends.shape
        given = accepted.numbers(f"{what}: weight", weight, finite=False)
        if given.shape != ends.shape:
            raise InputError(f"{what}: weight must have shape {ends.shape}, has {given.shape}")
        stiff = accepted.numbers(f"{what}: bending", bending, finite=False)
        return cls(
            np.arange(m + 1, dtype=np.int64) * size,
            ends.ravel(),
            given.ravel(),
            accepted.fitted(f"{what}: bending", stiff, (m,), "stencils"),
        )

    @property
    def sizes(self) -> np.ndarray:
        """How many particles each has, (m,)."""
        sizes: np.ndarray = np.diff(self.start)
        return sizes

    @property
    def owner(self) -> np.ndarray:
        """The stencil that each of the particles belongs to, (k,)."""
        return np.repeat(np.arange(len(self)), self.sizes)

    def by_size(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """The numbers of all stencils of a size (g,), and where their particles are (g, size)."""
        sizes = self.sizes
        for size in sorted(set(sizes.tolist())):
            mine = np.flatnonzero(sizes == size)
            yield mine, self.start[mine, None] + np.arange(size)

    def select(self, chosen: np.ndarray) -> Stencils:
        """Some of these stencils: a mask (m,) bool, or their numbers."""
        rows = np.arange(len(self))[chosen]
        sizes = self.sizes[rows]
        start = np.append(0, np.cumsum(sizes))
        at = np.repeat(self.start[rows] - start[:-1], sizes) + np.arange(start[-1])
        return Stencils(start, self.particle[at], self.weight[at], self.bending[rows])

    def joined(self, other: Stencils) -> Stencils:
        """These stencils followed by `other`."""
        return Stencils.concatenated([self, other])

    @classmethod
    def concatenated(cls, parts: Sequence[Stencils]) -> Stencils:
        """The stencils of all parts, one part after the other."""
        parts = [cls.none(), *parts]
        sizes = np.concatenate([part.sizes for part in parts])
        names = (name for name in vars(parts[0]) if name != "start")
        columns = (np.concatenate([vars(part)[name] for part in parts]) for name in names)
        return cls(np.append(0, np.cumsum(sizes)), *columns)

    def renumbered(self, number: np.ndarray) -> Stencils:
        """These stencils with particle i called number[i]."""
        columns = vars(self) | {"particle": number[self.particle].astype(np.int64)}
        return Stencils(**columns)

    def without(self, gone: np.ndarray) -> Stencils:
        """Those of which no particle is gone; gone: (n,) bool."""
        return self.select(self._per_stencil(gone[self.particle].astype(float)) == 0)

    def _per_stencil(self, values: np.ndarray) -> np.ndarray:
        """Sums (m,) or (m, dim) over each stencil's particles of values (k,) or (k, dim)."""
        total = np.zeros((len(self), *values.shape[1:]))
        for mine, at in self.by_size():
            total[mine] = values[at].sum(axis=1)
        return total

    def curvature(self, x: np.ndarray) -> np.ndarray:
        """The curvature vectors (m, dim) where particles are at x (n, dim)."""
        here = x[self.particle[self.start[:-1]]]
        apart = x[self.particle] - np.repeat(here, self.sizes, axis=0)
        return self._per_stencil(self.weight[:, None] * apart)

    def gathered(self, pull: np.ndarray, particle_count: int) -> np.ndarray:
        """Sums over stencils (n, dim) of pull (m, dim) times the weight of each particle."""
        total = np.zeros((particle_count, pull.shape[1]))
        np.add.at(total, self.particle, self.weight[:, None] * pull[self.owner])
        return total

    def stiffness(self, fixed: np.ndarray) -> np.ndarray:
        """What multiplies curvature vectors in forces [force * length], (m,); fixed: (n,) bool.

        It is B, but where cloth is clamped: what lies between fixed particles cannot bend, and the
        rest of a stencil's cloth is so much stiffer. In a row whose middle and one other particle
        are fixed that is its other half; where all corners of a triangle are, its neighbours.
        """
        factor, held = np.ones(len(self)), fixed[self.particle]
        for mine, at in self.by_size():
            here, weight = held[at], self.weight[at]
            if at.shape[1] == IN_ROW:
                clamped = here[:, 0] & (here[:, 1] ^ here[:, 2]) & (weight[:, 1:] > 0).all(axis=1)
                with np.errstate(all="ignore"):
                    part = weight[:, 2] / weight[:, 1]
                    part = np.where(here[:, 1], part, 1.0 / part)
                factor[mine] = np.where(clamped, 1.0 + part, 1.0)
            else:
                factor[mine] = np.where(here[:, :3].all(axis=1), AT_CLAMP, 1.0)
        k: np.ndarray = self.bending * factor
        return k

    def sides(self, springs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The springs out of `springs` (s, 2) that stencils need: pairs of stencil and spring, both
        (q,), in the order of stencils.

        They are, in a row, those from the middle; in a mesh, all between its particles.
        """
        owner, pairs = [np.zeros(0, np.int64)], [np.zeros((0, 2), np.int64)]
        for mine, at in self.by_size():
            one, other = np.triu_indices(at.shape[1], 1)
            if at.shape[1] == IN_ROW:
                one, other = np.array([0, 0]), np.array([1, 2])
            both = np.stack([self.particle[at[:, one]], self.particle[at[:, other]]], axis=2)
            owner.append(np.repeat(mine, both.shape[1]))
            pairs.append(both.reshape(-1, 2))
        of, ends = np.concatenate(owner), np.concatenate(pairs)
        spring = springs_tying(ends, springs)
        of, spring = of[spring >= 0], spring[spring >= 0]
        order = np.argsort(of, kind="stable")
        return of[order], spring[order]


# --- of meshes -----------------------------------------------------------------------------------


def mesh_stencils(position: ArrayLike, triangles: ArrayLike, bending: float) -> Stencils:
    """The stencils of a mesh, up to three for each triangle, as many as it has neighbours.

    position: (n, 2) or (n, 3), where particles are at rest; flat is the shape that they seek.
    triangles: (t, 3), their corners. bending: rigidity B of the cloth [force * length].

    Raises InputError for a triangle that has no area or a missing corner, and a negative rigidity.
    """
    what = "mesh_stencils"
    x = accepted.numbers(f"{what}: position", position)
    corners = accepted.whole_numbers(f"{what}: triangles", triangles)
    if corners.size == 0:
        corners = np.zeros((0, 3), np.int64)
    if corners.ndim != 2 or corners.shape[1] != 3:
        raise InputError(f"{what}: triangles must have shape (t, 3), has {corners.shape}")
    if x.ndim != 2:
        raise InputError(f"{what}: position must have shape (n, dim), has {x.shape}")
    stiff = accepted.number(f"{what}: bending", bending)
    if not (np.isfinite(stiff) and stiff >= 0):
        raise InputError(f"{what}: bending must not be negative, is {stiff:g}")
    missing = ((corners < 0) | (corners >= len(x))).any(axis=1)
    if missing.any():
        raise InputError(f"{what}: triangle {int(missing.argmax())} has a corner that is missing")
    beyond = _beyond(corners, len(x))
    parts = []
    for first in range(0, len(corners), AT_ONCE):
        mine = slice(first, first + AT_ONCE)
        patches = _Patches(x, corners[mine], beyond[mine])
        if patches.flat.any():
            at = first + int(patches.flat.argmax())
            raise InputError(f"{what}: triangle {at} has no area")
        parts += [Stencils.build(*found, stiff) for found in patches.stencils()]
    return Stencils.concatenated([_distinct(part) for part in parts])


class _Patches:
    """Triangles `corners` (t, 3) of points x (n, dim), with the corners of their neighbours.

    Edge i of a triangle is the one opposite to its corner i. flat: (t,), which have no area.
    beyond: (t, 3), the neighbour's corner opposite to each edge, -1: there is no neighbour.
    """

    def __init__(self, x: np.ndarray, corners: np.ndarray, beyond: np.ndarray) -> None:
        ends, self.corners, self.beyond = x[corners], corners, beyond
        start = np.roll(ends, -1, axis=1)
        self.edge = np.roll(ends, -2, axis=1) - start
        self.length = np.linalg.norm(self.edge, axis=2)
        self.height, self.foot = _seen_from(ends, start, self.edge)
        far = _seen_from(x[self.beyond], start, self.edge)
        there = self.beyond >= 0
        with np.errstate(all="ignore"):
            outer = np.where(there, self.length / far[0], 0.0)
            inner = np.where(there, self.length / self.height, 0.0)
        self.far_height, self.far_foot = (np.where(there, of, 0.0) for of in far)
        self.area = (self.length * self.height)[:, 0] / 2
        self.flat = ~((self.height > 1e-12 * self.length).all(axis=1) & (self.area > SMALLEST))
        # The vectors of edges (t, 3, 6), each its length times the angle between its triangles, as
        # weights of the corners and of the points beyond.
        self.vector = np.zeros((len(corners), 3, 6))
        for i in range(3):
            near, over = inner[:, i], outer[:, i]
            foot, far_foot = self.foot[:, i], self.far_foot[:, i]
            self.vector[:, i, i], self.vector[:, i, 3 + i] = near, over
            self.vector[:, i, (i + 1) % 3] = -(1 - foot) * near - (1 - far_foot) * over
            self.vector[:, i, (i + 2) % 3] = -foot * near - far_foot * over

    def _unfolded(self) -> tuple[np.ndarray, np.ndarray]:
        """The patches laid flat: their six points (t, 6, 2), and normals of the edges (t, 3, 2)."""
        points = np.zeros((len(self.corners), 6, 2))
        points[:, 2, 0] = self.length[:, 0]
        points[:, 0, 0] = self.foot[:, 0] * self.length[:, 0]
        points[:, 0, 1] = self.height[:, 0]
        normals = np.zeros((len(self.corners), 3, 2))
        for i in range(3):
            start = points[:, (i + 1) % 3]
            along = (points[:, (i + 2) % 3] - start) / self.length[:, i, None]
            normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
            inward = np.sign(((points[:, i] - start) * normal).sum(axis=1))
            foot = start + (self.far_foot * self.length)[:, i, None] * along
            points[:, 3 + i] = foot - (inward * self.far_height[:, i])[:, None] * normal
            normals[:, i] = normal
        return points, normals

    @cached_property
    def _forms(self) -> tuple[np.ndarray, np.ndarray]:
        """Matrices between second derivatives (xx, sqrt 2 xy, yy) and edges' vectors, (t, 3, 3).

        First what edges make of the derivatives of a quadratic, then the derivatives that constant
        curvature along edges, spread over the triangle, stands for.
        """
        points, normals = self._unfolded()
        x, y = points[..., 0], points[..., 1]
        quadratics = np.stack([x * x / 2, x * y / np.sqrt(2), y * y / 2], axis=2)
        n, m = normals[..., 0], normals[..., 1]
        squares = np.stack([n * n, np.sqrt(2) * n * m, m * m], axis=1)
        return self.vector @ quadratics, squares / (2 * self.area)[:, None, None]

    def recovered(self) -> np.ndarray:
        """What edges alone make of a quadratic's second derivatives, (t, 3, 3); at best 1."""
        of_edges, back = self._forms
        product: np.ndarray = back @ of_edges
        return product

    def stencils(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Particles and weights, (m, size) each, of all stencils, by their size."""
        # Outside its limits a quadratic through six points has weights far larger than the edges'.
        most = (self.beyond >= 0).all(axis=1)
        recovered = np.zeros(len(self.corners))
        recovered[most] = np.linalg.svd(self.recovered()[most], compute_uv=False)[:, -1]
        fits = recovered > LEAST_RECOVERED
        yield from self.fitted(np.flatnonzero(fits))
        yield from self.by_edges(np.flatnonzero(~fits))

    def fitted(self, mine: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Particles and weights of stencils of triangles that have three neighbours: the second
        derivatives of the quadratic through the six points.
        """
        of_edges = self._forms[0][mine]
        weight = np.linalg.solve(of_edges, self.vector[mine])
        weight *= np.sqrt(self.area[mine])[:, None, None]
        particle = np.column_stack([self.corners[mine], self.beyond[mine]])
        yield np.repeat(particle, 3, axis=0), weight.reshape(-1, 6)

    def by_edges(self, mine: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Particles and weights of stencils by edges alone, as many as there are neighbours."""
        unit = self.edge / self.length[:, :, None]
        # A sliver's edges are parallel, to rounding; their products alone would have no factor.
        products = (unit @ unit.transpose(0, 2, 1)) ** 2 + 1e-12 * np.eye(3)
        products /= (4 * self.area)[:, None, None]
        for has in np.ndindex(2, 2, 2):
            edges = np.flatnonzero(has)
            like = mine[((self.beyond[mine] >= 0) == np.array(has, bool)).all(axis=1)]
            if len(edges) == 0 or len(like) == 0:
                continue
            factor = np.linalg.cholesky(products[np.ix_(like, edges, edges)])
            columns = np.append(np.arange(3), 3 + edges)
            vector = self.vector[np.ix_(like, edges, columns)]
            weight = factor.transpose(0, 2, 1) @ vector
            particle = np.column_stack([self.corners[like], self.beyond[np.ix_(like, edges)]])
            yield np.repeat(particle, len(edges), axis=0), weight.reshape(-1, len(columns))


def _distinct(stencils: Stencils) -> Stencils:
    """The stencils with each particle once: in a small closed mesh two neighbours may share one."""
    parts, twice = [], np.zeros(len(stencils), bool)
    for mine, at in stencils.by_size():
        ends = stencils.particle[at]
        for one, other in zip(*np.triu_indices(at.shape[1], 1), strict=True):
            twice[mine] |= ends[:, one] == ends[:, other]
    if not twice.any():
        return stencils
    for m in np.flatnonzero(twice):
        own = slice(stencils.start[m], stencils.start[m + 1])
        particle, weight = stencils.particle[own], stencils.weight[own]
        once = np.array(list(dict.fromkeys(particle.tolist())))
        total = np.array([weight[particle == i].sum() for i in once])
        parts.append(Stencils.build(once[None], total[None], stencils.bending[m]))
    return Stencils.concatenated([stencils.select(~twice), *parts])


def _seen_from(
    corner: np.ndarray, start: np.ndarray, edge: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The distance of corners from lines along `edge` from `start`, all (t, 3, dim), and where on
    the edge their foot is, 0 at its start and 1 at its end, both (t, 3).
    """
    away = corner - start
    with np.errstate(all="ignore"):
        foot = (away * edge).sum(axis=2) / (edge**2).sum(axis=2)
        return np.linalg.norm(away - foot[:, :, None] * edge, axis=2), foot


def _beyond(corners: np.ndarray, count: int) -> np.ndarray:
    """Of each triangle, the corner of its neighbour beyond the edge opposite to each of its own,
    (t, 3); -1 where the edge has not exactly two triangles.
    """
    ends = np.stack([np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)], axis=2)
    key = (ends.min(axis=2) * count + ends.max(axis=2)).ravel()
    order = np.argsort(key, kind="stable")
    _, first, times = np.unique(key[order], return_index=True, return_counts=True)
    first = first[times == 2]
    one, other = order[first], order[first + 1]
    found, opposite = np.full(len(key), -1, np.int64), corners.ravel()
    found[one], found[other] = opposite[other], opposite[one]
    found[found == opposite] = -1  # the same triangle twice
    return found.reshape(corners.shape)
