"""Stencils: particles whose weighted sum is a curvature vector, where cloth resists being bent.

A stencil has the curvature vector sum_k weight_k x_k of its particles and the energy
B/2 |curvature vector|^2. That is quadratic in positions: what a flat surface stores when it is bent
without being stretched. Its force is linear, and flat is its shape at rest.

- In a row it is the second difference: with spacing s, for a strip of width b,
  B b/(2 s^3) |x_(i-1) - 2 x_i + x_(i+1)|^2.
- In a mesh, each triangle has up to three: what it stores is the integral of B/2 times its squared
  second derivatives, which sums of the particles around it are (`morley.py`). So a mesh is as stiff
  however it is cut, in every direction: it converges to what a plate stores. Bergou, Wardetzky,
  Harmon, Zorin, Grinspun, "A quadratic bending model for inextensible surfaces", 2006, take each
  edge by itself; what that stores depends on how edges lie, up to threefold between two directions
  of one regular mesh.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.scene import morley
from taichi_cloth.scene.equality import Rows
from taichi_cloth.scene.triangles import springs_tying
from taichi_cloth.settings import accepted

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

IN_ROW = 3  # particles of a stencil in a row; those of meshes have more
# Of an edge at which a mesh is clamped, both triangles hold half of the energy of a uniform bend;
# where one of them is fixed the whole bend is in the other, which takes twice the energy of both.
AT_CLAMP = 3.0


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
        """The number of each one's particles, (m,)."""
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
        """Factors of curvature vectors in forces [force * length], (m,); fixed: (n,) bool.

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
    mesh = morley.Mesh.of(x, corners)
    if mesh.flat.any():
        raise InputError(f"{what}: triangle {int(mesh.flat.argmax())} has no area")
    start, particle, weight = morley.curvature_weights(mesh)
    return Stencils(start, particle, weight, np.full(len(start) - 1, stiff))
