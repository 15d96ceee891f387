"""The mode that is the first to grow, followed from state to state by a few products at a time.

What `eigenmodes.stable_step` finds for one state takes a large cloth a second; a window that shows
the margin all the time keeps the mode of the last state and improves it where the springs are now:
Knyazev, "Toward the optimal preconditioned eigensolver: locally optimal block preconditioned
conjugate gradient method", 2001, for one vector, without a preconditioner. What is followed is the
largest eigenvalue of h^2 K + 2 h C (both scaled by masses), which is below 4 where symplectic Euler
is stable; other methods weigh damping otherwise, but of the mode that was found their own limit is
asked (`modes.largest_step`).
"""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.limits.eigenmodes import Limit, limit_along
from taichi_cloth.limits.matrices import stencil_matrix
from taichi_cloth.limits.modes import largest_step
from taichi_cloth.limits.network import Network

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

CONVERGED = 1e-3  # of the eigenvalue: a residual below which no more products are taken
NAMED = 5  # states: what sets the limit is looked for in every so manieth one
NOISE = 1e-3  # of the vector: added for a new state, whose largest mode may be another one


@dataclass(frozen=True)
class Followed:
    """The mode at a state. limit: the largest step, and what sets it, as `stable_step` says it.

    error: the part by which omega may be larger than that of `limit`, by what is left to improve.
    """

    limit: Limit
    error: float


@dataclass(frozen=True)
class Shares:
    """The parts of omega^2 and d of a mode.

    stiffness, damping: what each spring adds to omega^2 and to d, (s,). bending, held: what
    stencils, and forces on single particles add to omega^2. drag, air: what these add to d.
    """

    stiffness: np.ndarray
    damping: np.ndarray
    bending: float
    held: float
    drag: float
    air: float

    @property
    def omega2(self) -> float:
        """The whole omega^2."""
        return float(self.stiffness.sum()) + self.bending + self.held

    @property
    def d(self) -> float:
        """The whole d."""
        return float(self.damping.sum()) + self.drag + self.air


class FastestMode:
    """Follows the mode that sets a method's largest stable step; the same states, the same answers.

    method: whose step it is.
    """

    def __init__(self, method: Method) -> None:
        self._method = method
        self._shape = _Shape()
        self._u: np.ndarray | None = None  # (n, dim), of length 1, times the roots of masses
        self._way: np.ndarray | None = None  # the last direction of improvement
        self._named: tuple[int, Limit] | None = None  # for how many more states, and who sets it
        self.shares: Shares | None = None  # of the mode at the last state
        self._random = np.random.default_rng(0)

    def follow(self, network: Network, h: float, improvements: int) -> Followed | None:
        """The mode at a state for a step of h, after so many improvements at most.

        Each takes a product with the stiffness of all springs. None where nothing can grow.
        """
        self._shape.follow(network)
        weighted = _Weighted(network, self._shape, h)
        if not weighted.scale.any():
            return None
        if self._u is None or len(self._u) != len(network.position):
            self._u, self._way = self._noise(weighted), None
        u = _unit(self._u + NOISE * self._noise(weighted))
        au, way = weighted.product(u), self._way
        if float((u * au).sum()) <= 0 and not au.any():
            return None
        a_way = None if way is None else weighted.product(way)
        for _ in range(improvements):
            value = float((u * au).sum())
            left = au - value * u
            size = float(np.sqrt((left * left).sum()))
            if size <= CONVERGED * value:
                break
            left /= size
            a_left = weighted.product(left)
            basis = [(u, au), (left, a_left)]
            if way is not None and a_way is not None:
                basis.append((way, a_way))
            (u, au), (way, a_way) = _best_of(basis)
        self._u, self._way = u, way
        value = float((u * au).sum())
        left = au - value * u
        error = float(np.sqrt((left * left).sum())) / value / 2 if value > 0 else 0.0
        self.shares = weighted.shares(u)
        return Followed(self._limit(weighted, u, self.shares), error)

    def _noise(self, weighted: _Weighted) -> np.ndarray:
        found = self._random.standard_normal(weighted.shape)
        return _unit(found * (weighted.scale > 0)[:, None])

    def _limit(self, weighted: _Weighted, u: np.ndarray, shares: Shares) -> Limit:
        """The limit along a vector; who sets it is looked for now and then."""
        network, omega2, damping = weighted.network, shares.omega2, shares.d
        left, named = self._named or (0, None)
        if named is None or left == 0 or not self._shape.same:
            flat = u[~network.particles.fixed].reshape(-1)
            named, left = limit_along(self._method, network, omega2, damping, flat), NAMED
            named = replace(named, mode=None, velocity=None)
        else:
            step = largest_step(self._method, omega2, damping)
            named = replace(named, dt=step, omega2=omega2, damping=damping)
        self._named = left - 1, named
        return named


class _Shape:
    """The part of the matrices that stays while the same springs hold, wherever they are.

    ends: the differences that springs take, (s, n), and its transpose. bending: what stencils add
    to K of the free particles, scaled by masses (f, f); None: there are none. same: whether the
    last network had the springs of the one before.
    """

    def __init__(self) -> None:
        self._of: tuple[object, ...] = ()
        self.same = False
        self.ends: tuple[csr_matrix, csr_matrix] | None = None
        self.bending: csr_matrix | None = None

    def follow(self, network: Network) -> None:
        """Be that of a network."""
        from scipy import sparse

        of = network.springs, network.stencils, network.particles
        self.same = len(self._of) == len(of) and all(map(operator.is_, of, self._of))
        if self.same:
            return
        self._of, between = of, network.springs.between
        ones, rows = np.ones(len(between)), np.arange(len(between))
        entries = np.concatenate([-ones, ones]), (np.tile(rows, 2), between.T.ravel())
        b = sparse.csr_matrix(entries, shape=(len(between), len(network.particles)))
        self.ends = b, b.T.tocsr()
        self.bending = stencil_matrix(network) if len(network.stencils) else None


class _Weighted:
    """h^2 K + 2 h C of a network, scaled by the roots of masses; what is fixed has none of it."""

    def __init__(self, network: Network, shape: _Shape, h: float) -> None:
        assert shape.ends is not None  # `follow` has been called
        self.network, self.shape = network, network.position.shape
        particles, (k, c) = network.particles, network.along_springs
        self._free = ~particles.fixed
        self.scale = np.where(self._free, 1.0 / np.sqrt(particles.mass), 0.0)
        self._along, t = network.geometry
        self._h, self._stiff, self._damped = h, k, c
        self._axial = h * h * k * (1.0 - t) + 2.0 * h * c
        self._whole = h * h * k * t
        (held, drag), (_, air) = network.on_particles, network.by_triangles
        self._diagonal = (h * h * held + 2.0 * h * (drag + air)) * self.scale**2
        self._ends, self._bending = shape.ends, shape.bending

    def product(self, u: np.ndarray) -> np.ndarray:
        """The matrix times u, (n, dim)."""
        b, transposed = self._ends
        d = b @ (self.scale[:, None] * u)
        axial = self._axial * np.einsum("ij,ij->i", self._along, d)
        pull = axial[:, None] * self._along + self._whole[:, None] * d
        out: np.ndarray = self.scale[:, None] * (transposed @ pull) + self._diagonal[:, None] * u
        if self._bending is not None:
            out[self._free] += self._h**2 * (self._bending @ u[self._free])
        return out

    def shares(self, u: np.ndarray) -> Shares:
        """The quotients omega^2 and d of K and C along a unit vector u (n, dim)."""
        network, (_, t) = self.network, self.network.geometry
        d = self._ends[0] @ (self.scale[:, None] * u)
        axial = np.einsum("ij,ij->i", self._along, d) ** 2
        across = np.einsum("ij,ij->i", d, d) - axial
        (held, drag), (_, air) = network.on_particles, network.by_triangles
        moved = self.scale**2 * np.einsum("ij,ij->i", u, u)
        free = u[self._free]
        bent = self._bending
        return Shares(
            stiffness=self._stiff * (axial + t * across),
            damping=self._damped * axial,
            bending=0.0 if bent is None else float((free * (bent @ free)).sum()),
            held=float((held * moved).sum()),
            drag=float((drag * moved).sum()),
            air=float((air * moved).sum()),
        )


def _unit(u: np.ndarray) -> np.ndarray:
    size = float(np.sqrt((u * u).sum()))
    return u / size if size > 0 else u


def _best_of(
    basis: list[tuple[np.ndarray, np.ndarray]],
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """The vector of the largest quotient among the sums of a basis, and its part beside the first.

    basis: vectors with what the matrix makes of them; so are both that are returned.
    """
    vectors = np.array([u.ravel() for u, _ in basis])
    products = np.array([au.ravel() for _, au in basis])
    gram, matrix = vectors @ vectors.T, vectors @ products.T
    # The basis made orthonormal; what lies in the others but for round-off is left out.
    size, axes = np.linalg.eigh(gram)
    kept = size > 1e-10 * size[-1]
    root = axes[:, kept] / np.sqrt(size[kept])
    weight = root @ np.linalg.eigh(root.T @ (matrix + matrix.T) @ root)[1][:, -1]
    shape = basis[0][0].shape
    best = (weight @ vectors).reshape(shape), (weight @ products).reshape(shape)
    weight[0] = 0.0
    beside = (weight @ vectors).reshape(shape), (weight @ products).reshape(shape)
    length = float(np.sqrt((best[0] ** 2).sum()))
    return (best[0] / length, best[1] / length), beside
