"""Stencils: particles whose weighted sum is a curvature vector, where cloth resists being bent.

A stencil has the curvature vector sum_k weight_k x_k of its particles and the energy
B/2 |curvature vector|^2. That is quadratic in positions: what a flat surface stores when it is bent
without being stretched. Its force is linear, and flat is its shape at rest.

- In a row it is the second difference: with spacing s, for a strip of width b,
  B b/(2 s^3) |x_(i-1) - 2 x_i + x_(i+1)|^2.
- Around a vertex inside a mesh it is the cotangent Laplacian, for the area of cloth around it:
  Bergou, Wardetzky, Harmon, Zorin, Grinspun, "A quadratic bending model for inextensible surfaces",
  2006, section 3, with the conforming operator of Wardetzky, Bergou, Harmon, Zorin, Grinspun,
  "Discrete quadratic curvature energies", 2007. Its energy does not depend on how a mesh divides
  a surface; that of the former paper's edges does, up to threefold between directions.
- Where a mesh has no vertex inside, as in a strip one cell wide, it is the fold of two triangles
  across an edge: the former paper's, by whose measure the two triangles' area is bent.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.settings import accepted

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

IN_ROW, AT_EDGE = 3, 4  # particles of a stencil in a row, and at an edge; more: around a vertex


@dataclass(frozen=True)
class Stencils:
    """m stencils, of any number of particles each.

    start: (m + 1,) int64, where each stencil's particles begin.
    particle: (k,) int64. Three: the middle of a row and the two beside it. Four: the ends of an
        edge, then the opposite corners of its triangles. More: a vertex and its ring, in order.
    weight: (k,) float64, of these particles [1 / length]; those of a stencil add up to 0.
    bending: (m,) float64, the rigidity B [force * length].
    inside: (m,) float64, the part of the area it stands for that lies around it; the rest is at
        the border of a mesh, and counted to the nearest vertices inside.
    """

    start: np.ndarray
    particle: np.ndarray
    weight: np.ndarray
    bending: np.ndarray
    inside: np.ndarray

    def __len__(self) -> int:
        return len(self.bending)

    @classmethod
    def none(cls) -> Stencils:
        return cls.build(np.zeros((0, IN_ROW), np.int64), np.zeros((0, IN_ROW)), 0.0)

    @classmethod
    def build(
        cls, particle: np.ndarray, weight: np.ndarray, bending: ArrayLike, inside: ArrayLike = 1.0
    ) -> Stencils:
        """Stencils of equally many particles (m, size), with their weights; the others for all or
        one each.
        """
        m, size = particle.shape
        return cls(
            np.arange(m + 1, dtype=np.int64) * size,
            particle.ravel().astype(np.int64),
            weight.ravel().astype(np.float64),
            np.array(np.broadcast_to(bending, (m,)), np.float64),
            np.array(np.broadcast_to(inside, (m,)), np.float64),
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
        for size in np.unique(sizes):
            mine = np.flatnonzero(sizes == size)
            yield mine, self.start[mine, None] + np.arange(size)

    def select(self, chosen: np.ndarray) -> Stencils:
        """Some of these stencils: a mask (m,) bool, or their numbers."""
        rows = np.arange(len(self))[chosen]
        sizes = self.sizes[rows]
        start = np.append(0, np.cumsum(sizes))
        at = np.repeat(self.start[rows] - start[:-1], sizes) + np.arange(start[-1])
        return Stencils(
            start, self.particle[at], self.weight[at], self.bending[rows], self.inside[rows]
        )

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

        It is B, but where cloth is clamped: of such a stencil's cloth, the part between particles
        that are fixed cannot bend, and the rest, which does, is so much stiffer.
        """
        factor, held = np.ones(len(self)), fixed[self.particle]
        for mine, at in self.by_size():
            here, size = held[at], at.shape[1]
            if size <= AT_EDGE:
                one, other = here[:, -2], here[:, -1]
                near, far = self.weight[at[:, -2]], self.weight[at[:, -1]]
                clamped = here[:, :-2].all(axis=1) & (one ^ other) & (near * far > 0)
                with np.errstate(all="ignore"):
                    part = np.where(one, far / near, near / far)
                factor[mine] = np.where(clamped, 1.0 + part, 1.0)
            else:
                whole = here[:, 1:] & np.roll(here[:, 1:], 1, axis=1)
                bends = 1.0 - whole.mean(axis=1)
                clamped = here[:, 0] & (bends > 0) & (bends < 1)
                with np.errstate(all="ignore"):
                    part = self.inside[mine] / bends
                factor[mine] = np.where(clamped, part, 1.0)
        k: np.ndarray = self.bending * factor
        return k

    def sides(self, springs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The springs out of `springs` (s, 2) that stencils need: pairs of stencil and spring, both
        (q,), in the order of stencils.

        They are those from the first particle to the others, and beyond rows those between the
        others, one after the other around.
        """
        owner, pairs = [np.zeros(0, np.int64)], [np.zeros((0, 2), np.int64)]
        for mine, at in self.by_size():
            ring = self.particle[at[:, 1:]]
            first = np.broadcast_to(self.particle[at[:, :1]], ring.shape)
            found = [np.stack([first, ring], axis=2)]
            if at.shape[1] > IN_ROW:
                found.append(np.stack([ring, np.roll(ring, 1, axis=1)], axis=2))
            both = np.concatenate(found, axis=1)
            owner.append(np.repeat(mine, both.shape[1]))
            pairs.append(both.reshape(-1, 2))
        of, ends = np.concatenate(owner), np.concatenate(pairs)
        if len(springs) == 0 or len(of) == 0:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        count = int(max(springs.max(), ends.max())) + 1
        keys = springs.min(axis=1) * count + springs.max(axis=1)
        order = np.argsort(keys, kind="stable")
        keys, wanted = keys[order], ends.min(axis=1) * count + ends.max(axis=1)
        at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        there = keys[at] == wanted
        of, spring = of[there], order[at[there]]
        order = np.argsort(of, kind="stable")
        return of[order], spring[order]


# --- of meshes -----------------------------------------------------------------------------------


def mesh_stencils(position: ArrayLike, triangles: ArrayLike, bending: float) -> Stencils:
    """The stencils of a mesh: around its inner vertices, and where it has none across its edges.

    position: (n, 2) or (n, 3), where particles are at rest. triangles: (t, 3), their corners; the
    mesh is taken as flat at rest. bending: rigidity B of the cloth [force * length].

    Raises InputError for a triangle that has no area or a missing corner, and a negative rigidity.
    """
    what = "mesh_stencils"
    x = accepted.numbers(f"{what}: position", position)
    corners = np.asarray(triangles, np.int64).reshape(-1, 3)
    if x.ndim != 2:
        raise InputError(f"{what}: position must have shape (n, dim), has {x.shape}")
    stiff = accepted.number(f"{what}: bending", bending)
    if not (np.isfinite(stiff) and stiff >= 0):
        raise InputError(f"{what}: bending must not be negative, is {stiff:g}")
    missing = ((corners < 0) | (corners >= len(x))).any(axis=1)
    if missing.any():
        raise InputError(f"{what}: triangle {int(missing.argmax())} has a corner that is missing")
    if len(corners) == 0:
        return Stencils.none()
    mesh = _Mesh(x, corners)
    flat = ~(mesh.area > 0)
    if flat.any():
        raise InputError(f"{what}: triangle {int(flat.argmax())} has no area")
    return Stencils.concatenated([*mesh.at_vertices(stiff), mesh.at_edges(stiff)])


class _Mesh:
    """Triangles `corners` (t, 3) on points x (n, dim), seen edge by edge from either end.

    area: (t,). Of each edge from v to j, sorted: v, j; of: how many triangles have it; next: (., 2)
    the opposite corners in the first two; cot: the sum of the cotangents there, halved.
    """

    def __init__(self, x: np.ndarray, corners: np.ndarray) -> None:
        self.x, n = x, len(x)
        sides = [(0, 1, 2), (1, 2, 0), (2, 0, 1)]
        turns = [corners[:, list(side)] for side in sides + [(i, k, j) for i, j, k in sides]]
        v, j, k = np.concatenate(turns).T
        one, other = x[v] - x[k], x[j] - x[k]
        along = (one * other).sum(axis=1)
        with np.errstate(all="ignore"):
            squares = (one**2).sum(axis=1) * (other**2).sum(axis=1) - along**2
            double = np.sqrt(np.maximum(squares, 0.0))  # twice the area
            double[double <= 1e-12 * np.abs(along)] = 0.0
            cot = along / double / 2
        self.area = double[: len(corners)] / 2
        order = np.lexsort((k, j, v))
        key = v[order] * n + j[order]
        _, first, count = np.unique(key, return_index=True, return_counts=True)
        self.v, self.j, self.of = v[order][first], j[order][first], count
        second = np.minimum(first + 1, len(order) - 1)
        self.next = np.stack([k[order][first], k[order][second]], axis=1)
        self.cot = np.add.reduceat(cot[order], first)
        self.beside = np.add.reduceat(double[order] / 2, first)  # area of an edge's triangles
        self.key = key[first]
        self.around = np.bincount(corners.ravel(), np.repeat(self.area / 3, 3), n)
        self.valence = np.bincount(self.v, minlength=n)
        self.rings, self.inner = self._rings()

    def _edge(self, v: np.ndarray, j: np.ndarray) -> np.ndarray:
        """The numbers of the edges from v to j."""
        found: np.ndarray = np.searchsorted(self.key, v * len(self.x) + j)
        return found

    def _rings(self) -> tuple[np.ndarray, np.ndarray]:
        """The rings of vertices (n, longest), in order around them, and which are whole, (n,) bool.

        A whole one goes around its vertex once and has more than three corners.
        """
        n, longest = len(self.x), int(self.valence.max())
        rings = np.full((n, longest), -1, np.int64)
        closed = np.bincount(self.v, self.of != 2, n) == 0
        at = np.flatnonzero(closed & (self.valence >= AT_EDGE))
        first = np.searchsorted(self.v, at)
        here, before = self.j[first], np.full(len(at), -1)
        length = np.zeros(n, np.int64)
        for turn in range(longest):
            rings[at, turn] = here
            length[at] = turn + 1
            one, other = self.next[self._edge(at, here)].T
            here, before = np.where((one == before) & (turn > 0), other, one), here
            on = here != rings[at, 0]
            at, here, before = at[on], here[on], before[on]
        inner = (length > 0) & (length == self.valence)
        return rings, inner

    def at_vertices(self, bending: float) -> Iterator[Stencils]:
        """The stencils around inner vertices, one group for each number of neighbours."""
        # What lies around the others is counted to the inner vertices beside them.
        reach = ~self.inner[self.v] & self.inner[self.j]
        shares = np.bincount(self.v[reach], minlength=len(self.x))
        v, j = self.v[reach], self.j[reach]
        area = self.around + np.bincount(j, self.around[v] / shares[v], len(self.x))
        for size in np.unique(self.valence[self.inner]):
            at = np.flatnonzero(self.inner & (self.valence == size))
            ring = self.rings[at, :size]
            weight = self.cot[self._edge(np.repeat(at, size), ring.ravel())].reshape(ring.shape)
            around = self.around[at]
            weight = weight * (np.sqrt(area[at]) / around)[:, None]
            weight = np.column_stack([-weight.sum(axis=1), weight])
            particle = np.column_stack([at, ring])
            yield Stencils.build(particle, weight, bending, around / area[at])

    def at_edges(self, bending: float) -> Stencils:
        """The stencils at edges between two triangles, both of whose ends are no inner vertices."""
        mine = (self.v < self.j) & (self.of == 2) & ~self.inner[self.v] & ~self.inner[self.j]
        mine &= self.next[:, 0] != self.next[:, 1]
        particle = np.column_stack([self.v[mine], self.j[mine], self.next[mine]])
        ends = self.x[particle]
        edge = ends[:, 1] - ends[:, 0]
        length2 = (edge**2).sum(axis=1)
        weight = np.zeros((len(particle), AT_EDGE))
        for k in (2, 3):
            d = ends[:, k] - ends[:, 0]
            foot = (d * edge).sum(axis=1) / length2
            height = np.linalg.norm(d - foot[:, None] * edge, axis=1)
            of_corner = np.sqrt(length2 / self.beside[mine]) / height
            weight[:, k] = of_corner
            weight[:, 0] -= of_corner * (1 - foot)
            weight[:, 1] -= of_corner * foot
        return Stencils.build(particle, weight, bending)
