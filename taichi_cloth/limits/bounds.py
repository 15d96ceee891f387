"""Bounds of all modes: of a state's own geometry, or such that hold however its springs turn.

Three answers, each costlier and closer than the one before: `gershgorin` (NumPy alone, holds in
every geometry), `any_geometry` (the largest eigenvalue of the springs' Laplacian; holds in every
geometry, as springs turn during a run), and `eigenmodes.stable_step` (the state's own geometry).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.limits.laplacian import Laplacian
from taichi_cloth.limits.matrices import largest_eigenvalue, stencil_matrix
from taichi_cloth.limits.modes import ROUND_OFF, growth, largest_step
from taichi_cloth.limits.network import Network
from taichi_cloth.scene.stencils import IN_ROW

BEYOND = 1.000001  # times a step: more than what bisection leaves open


@dataclass(frozen=True)
class Bounds:
    """Bounds that no mode exceeds.

    omega2, particle: the largest omega^2, and the particle that sets it (-1: none does).
    damping, damped: the largest d, and the particle that sets it (-1: none does).
    least_damping: the least d.
    """

    omega2: float
    particle: int
    damping: float
    damped: int
    least_damping: float


def step_within(method: Method, bounds: Bounds) -> float:
    """A step at which no mode inside `bounds` grows, whatever pairs of omega^2 and d there are."""
    if math.isinf(method.claims.stability_limit):
        return math.inf
    least = math.inf
    for omega2, d in reversed(_pairs(bounds)):  # the last is mostly the worst
        # Of who does not grow at a step that is longer yet, nothing is to be found by bisection.
        if math.isinf(least) or least == 0 or growth(method, BEYOND * least, omega2, d) > 1:
            least = min(least, largest_step(method, omega2, d))
    return least


def grows_within(method: Method, bounds: Bounds, h: float) -> bool:
    """True if a mode inside `bounds` grows at the step h; fifty times as fast as `step_within`."""
    if math.isinf(method.claims.stability_limit):
        return False
    return any(growth(method, h, *pair) > 1 + ROUND_OFF for pair in _pairs(bounds) if any(pair))


def _pairs(bounds: Bounds) -> list[tuple[float, float]]:
    """Pairs (omega^2, d) on the border of `bounds`, of which the worst stands for all inside."""
    rates = np.linspace(bounds.least_damping, bounds.damping, 5)
    if bounds.least_damping == bounds.damping:
        rates = rates[:1]
    return [(0.0, bounds.damping), *((bounds.omega2, float(d)) for d in rates)]


def gershgorin(network: Network) -> Bounds:
    """Gershgorin's bounds: the largest row sums of |M^-1 K| and |M^-1 C|, in every geometry.

    omega^2 <= max_i (1/m_i) (sum of k to all neighbours + sum of k to free neighbours + what
    stencils add).
    """
    return _bounds(network, *network.once("gershgorin", lambda: _rows_in_every_geometry(network)))


def _rows_in_every_geometry(network: Network) -> tuple[np.ndarray, np.ndarray]:
    stiffness, damping = network.along_springs
    return _row_sums(network, stiffness[:, None]), _row_sums(network, damping[:, None])


def gershgorin_here(network: Network) -> Bounds:
    """Gershgorin's bounds of the state's own geometry: closer where springs lie along the axes."""
    along, t = network.geometry
    # Row sums of |n n^T|, and of the whole Hessian.
    longitudinal = np.abs(along) * np.abs(along).sum(axis=1, keepdims=True)
    stiffness, damping = network.along_springs
    stiff = stiffness[:, None] * ((1 - t)[:, None] * longitudinal + t[:, None])
    damped = damping[:, None] * longitudinal
    return _bounds(network, _row_sums(network, stiff), _row_sums(network, damped))


def _row_sums(network: Network, weights: np.ndarray) -> np.ndarray:
    """The part of springs in the row sums of |M^-1 K| or |M^-1 C|, (n,): the largest over all axes.

    weights: (s, axes), what they add to a row.
    """
    particles, n = network.particles, len(network.position)
    free = ~particles.fixed
    a, b = network.springs.between.T
    sums = np.zeros(n)
    with np.errstate(over="ignore", invalid="ignore"):  # an infinite bound is a true answer
        for w in weights.T:
            row = np.bincount(a, w * (1.0 + free[b]), n) + np.bincount(b, w * (1.0 + free[a]), n)
            np.maximum(sums, row / particles.mass, out=sums)
    return np.where(free, sums, 0.0)


def _bounds(network: Network, stiff: np.ndarray, damped: np.ndarray) -> Bounds:
    """Bounds from what springs add to the row sums of K and of C, (n,) each."""
    particles = network.particles
    free = ~particles.fixed
    if not free.any():
        return Bounds(0.0, -1, 0.0, -1, 0.0)
    held, drag = (
        (of + by) / particles.mass
        for of, by in zip(network.on_particles, network.by_triangles, strict=True)
    )
    with np.errstate(over="ignore", invalid="ignore"):
        bent = network.once("rows of stencils", lambda: _rows_of_stencils(network))
        omega2 = stiff + np.where(free, held + bent, 0.0)
        damping = damped + np.where(free, drag, 0.0)
    stiffest, damped_most = int(omega2.argmax()), int(damping.argmax())
    return Bounds(
        float(omega2[stiffest]),
        stiffest if omega2[stiffest] > 0 else -1,
        float(damping[damped_most]),
        damped_most if damping[damped_most] > 0 else -1,
        float((network.on_particles[1] / particles.mass)[free].min()),
    )


def _rows_of_stencils(network: Network) -> np.ndarray:
    """The part of stencils in the row sums of |M^-1 K|, (n,).

    In rows that is k |weight_i| times the sum of |weight| over free particles. In meshes, where
    stencils that have the same particles make up for each other, it is that of their matrix.
    """
    stencils, particles = network.stencils, network.particles
    if (stencils.sizes > IN_ROW).any():
        matrix = network.once("stencils", lambda: stencil_matrix(network))
        free_rows, root = np.zeros(len(particles)), np.sqrt(particles.mass[~particles.fixed])
        free_rows[~particles.fixed] = (abs(matrix) @ root) / root
        return free_rows
    weight, of = np.abs(stencils.weight), stencils.owner
    free = weight * ~particles.fixed[stencils.particle]
    total = np.bincount(of, free, len(stencils)) * network.on_curvature
    row = np.bincount(stencils.particle, weight * total[of], len(particles))
    rows: np.ndarray = row / particles.mass
    return rows


class AnyGeometry:
    """Bounds that hold however springs turn, followed from state to state.

    Since n n^T + t (I - n n^T) <= I, K is at most the Laplacian of the graph with weights k, one
    number a particle, with what stencils add, which is the same in every direction; and C is that
    with weights c plus drag. Their largest eigenvalues are found
    starting from the vectors of the last time.
    """

    def __init__(self) -> None:
        self._vectors: list[np.ndarray | None] = [None, None]

    def memory(self) -> list[np.ndarray | None]:
        """The vectors of the last time, (n,) each; None: there is none. `recall` takes them."""
        return list(self._vectors)

    def recall(self, memory: Sequence[np.ndarray | None]) -> None:
        """Go on from such vectors."""
        self._vectors = list(memory)

    def bounds(self, network: Network) -> Bounds:
        """Bounds of this network."""
        rough = gershgorin(network)
        free = ~network.particles.fixed
        if not free.any() or not math.isfinite(rough.omega2 + rough.damping):
            return rough
        laplacians = network.once("laplacians", lambda: _laplacians(network))
        values = []
        for i, (weights, diagonal) in enumerate(_weights_and_diagonal(network)):
            matrix = laplacians[i].with_diagonal(diagonal)
            if i == 0 and len(network.stencils):
                matrix = matrix + network.once("stencils", lambda: stencil_matrix(network))
                weights = np.append(weights, network.on_curvature)
            uniform = not weights.any() and (matrix.diagonal() == matrix.diagonal()[0]).all()
            if uniform:
                values.append(float(matrix.diagonal()[0]))
                continue
            start = self._vectors[i]
            if start is not None:
                start = np.concatenate([start, np.ones(max(len(free) - len(start), 0))])[free]
            value, vector = largest_eigenvalue(matrix, start, rough=True)
            # What is left of the residual may belong to a larger eigenvalue.
            residual = float(np.sqrt(((matrix @ vector - value * vector) ** 2).sum()))
            bound = (rough.omega2, rough.damping)[i]
            values.append(min(value + residual, bound))
            self._vectors[i] = whole = np.zeros(len(free))
            whole[free] = vector
        return Bounds(values[0], rough.particle, values[1], rough.damped, rough.least_damping)

    def at_least(self, network: Network) -> Bounds:
        """Lower bounds: Rayleigh's quotients of the last vectors.

        After springs broke it tells, without an eigenvalue, where the bounds cannot have changed.
        """
        quotients = []
        free, mass = ~network.particles.fixed, network.particles.mass
        a, b = network.springs.between.T
        for u, (weights, diagonal), bent in zip(
            self._vectors,
            _weights_and_diagonal(network),
            (network.on_curvature, 0.0),
            strict=True,
        ):
            if u is None:
                quotients.append(0.0)
                continue
            scaled = np.where(free, u / np.sqrt(mass), 0.0)
            energy = (weights * (scaled[b] - scaled[a]) ** 2).sum() + (diagonal * scaled**2).sum()
            energy += (bent * network.stencils.curvature(scaled[:, None])[:, 0] ** 2).sum()
            quotients.append(float(energy / (u * u).sum()))
        least = gershgorin(network).least_damping
        return Bounds(quotients[0], -1, max(quotients[1], least), -1, least)


def any_geometry(network: Network) -> Bounds:
    """Bounds that hold however springs turn; at most those of `gershgorin`."""
    return AnyGeometry().bounds(network)


def _laplacians(network: Network) -> list[Laplacian]:
    """Those of K and of C."""
    return [Laplacian(network, weights) for weights in network.along_springs]


def _weights_and_diagonal(network: Network) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The Laplacians of K and C, each as springs' weights (s,) and addends of the diagonal (n,)."""
    for weights, held, by in zip(
        network.along_springs, network.on_particles, network.by_triangles, strict=True
    ):
        yield weights, held + by
