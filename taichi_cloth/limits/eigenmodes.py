"""The largest stable step around a state, in its own geometry, and what is responsible for it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.limits.bounds import gershgorin
from taichi_cloth.limits.matrices import largest_eigenvalue, stiffness_and_damping
from taichi_cloth.limits.modes import largest_step
from taichi_cloth.limits.network import Network

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

DENSE = 400  # degrees of freedom up to which all eigenvalues are computed


@dataclass(frozen=True)
class Limit:
    """The largest stable step, and the mode that is the first to grow beyond it.

    dt: inf where every step is stable, 0 where none is.
    omega2, damping: of that mode.
    mode, velocity: (n, dim), its displacement and velocity at one moment.
    spring, ends, share: the number of the spring with the largest share of the mode's energy, its
        particles, and that share; -1 where drag alone sets the limit.
    particle: the one that moves most (-1: none does).
    held: whether it is a force on that particle, and not its drag, that sets the limit.
    bent: the particle at whose curvature most of the mode's energy is, where bending sets the
        limit; else -1.
    """

    dt: float
    omega2: float = 0.0
    damping: float = 0.0
    mode: np.ndarray | None = None
    velocity: np.ndarray | None = None
    spring: int = -1
    ends: tuple[int, int] = (-1, -1)
    share: float = 0.0
    particle: int = -1
    held: bool = False
    bent: int = -1

    def describe(self) -> str:
        """The cause, in words."""
        if self.spring >= 0:
            a, b = self.ends
            return f"spring {self.spring}, between particles {a} and {b}"
        if self.bent >= 0:
            return f"the bending at particle {self.bent}"
        if self.particle < 0:
            return "nothing"
        return f"the {'force' if self.held else 'drag'} on particle {self.particle}"


def stable_step(method: Method, network: Network, *, exact: bool = True) -> Limit:
    """The largest stable step of `method` around this state, and what is responsible for it.

    exact: of a Runge-Kutta method whose damping differs from place to place, the modes of the
    damped system, which take long; else a step that is safe, and up to a percent shorter.
    """
    from scipy.sparse import identity

    bounds = gershgorin(network)
    if math.isinf(method.claims.stability_limit) or bounds.omega2 + bounds.damping <= 0:
        return Limit(math.inf)
    if not math.isfinite(bounds.omega2 + bounds.damping):
        return Limit(0.0, bounds.omega2, bounds.damping, particle=bounds.particle)
    stiffness, damping = stiffness_and_damping(network)
    diagonal = damping.diagonal()
    if (damping - diagonal[0] * identity(len(diagonal))).count_nonzero() == 0:
        # K's modes are those of the whole; of two with the same d the faster is the first to grow.
        u = largest_eigenvalue(stiffness)[1]
        found = [_mode_along(method, stiffness, damping, u)]
        if diagonal[0] > 0:
            still = largest_step(method, 0.0, diagonal[0])
            if still < found[0].step:
                u = np.eye(len(diagonal), 1)[:, 0]
                found = [_Mode(still, 0.0, float(diagonal[0]), u)]
    elif exact and method.stability_function:
        found = _damped_modes(method, stiffness, damping)
    else:
        found = _quadratic_forms(method, stiffness, damping)
    return _limit(network, min(found, key=lambda mode: mode.step))


class _Mode(NamedTuple):
    """A vector u of length 1, real or complex, with the quotients and the largest step along it."""

    step: float
    omega2: float
    damping: float
    u: np.ndarray


def _mode_along(method: Method, stiffness: csr_matrix, damping: csr_matrix, u: np.ndarray) -> _Mode:
    omega2 = max(float((u.conj() @ (stiffness @ u)).real), 0.0)
    rate = max(float((u.conj() @ (damping @ u)).real), 0.0)
    return _Mode(largest_step(method, omega2, rate), omega2, rate, u)


def _quadratic_forms(method: Method, stiffness: csr_matrix, damping: csr_matrix) -> list[_Mode]:
    """Modes among which is that of the least step over all quotients (omega^2, d) of K and C.

    Frank and Wolfe's iteration, An algorithm for quadratic programming, 1956: at the pair found so
    far the step falls fastest in one direction, and the largest eigenvalue of K and C weighted
    like that leads to the next pair. Exact where the pairs of one step lie on a line, as for
    symplectic Euler and Verlet.
    """

    def along_fastest(matrix: csr_matrix, start: np.ndarray | None = None) -> _Mode:
        return _mode_along(method, stiffness, damping, largest_eigenvalue(matrix, start)[1])

    found = [along_fastest(stiffness), along_fastest(damping)]
    for _ in range(12):
        h, omega2, rate, u = min(found, key=lambda mode: mode.step)
        if h == 0:
            break
        small = 1e-4 * max(omega2, rate * rate)
        by_omega2 = (h - largest_step(method, omega2 + small, rate)) / small
        small = 1e-4 * max(math.sqrt(omega2), rate)
        by_rate = (h - largest_step(method, omega2, rate + small)) / small
        weighted = by_omega2 * stiffness + by_rate * damping
        found.append(along_fastest(weighted, u))
        if found[-1].step > h * (1 - 1e-7):
            break
    return found


def _damped_modes(method: Method, stiffness: csr_matrix, damping: csr_matrix) -> list[_Mode]:
    """The mode of u'' = -K u - C u' with the least step: of all where they are few, else of the
    outermost.

    The quotients omega^2 and d along an eigenvector u fulfil mu^2 + d mu + omega^2 = 0.
    """
    from scipy import sparse
    from scipy.sparse.linalg import ArpackNoConvergence, eigs

    n = stiffness.shape[0]
    # In units of time in which the fastest rate is about 1: else u of a vector (u, mu u) is lost.
    rates = math.sqrt(abs(stiffness).max()), float(abs(damping).max())
    unit = 2.0 ** -round(math.log2(max(rates)))  # no digit of K and C is lost
    swings, decays = -unit * unit * stiffness, -unit * damping
    system = sparse.bmat([[None, sparse.identity(n)], [swings, decays]], format="csr")
    if n <= DENSE:
        vectors = [np.linalg.eig(system.toarray())[1]]
    else:
        vectors = []
        start = np.random.default_rng(0).standard_normal(2 * n)
        for which in ("LM", "LI", "SR"):
            try:
                vectors.append(eigs(system, 8, which=which, v0=start, tol=1e-6, ncv=60)[1])
            except ArpackNoConvergence as error:
                vectors.append(error.eigenvectors)
        if not any(v.shape[1] for v in vectors):
            return _quadratic_forms(method, stiffness, damping)
    u = np.concatenate(vectors, axis=1)[:n]
    length = np.sqrt((np.abs(u) ** 2).sum(axis=0))
    u = u[:, length > 1e-12] / length[length > 1e-12]
    omega2 = np.maximum((u.conj() * (stiffness @ u)).sum(axis=0).real, 0.0)
    rate = np.maximum((u.conj() * (damping @ u)).sum(axis=0).real, 0.0)
    steps = [largest_step(method, *pair) for pair in zip(omega2, rate, strict=True)]
    first = int(np.argmin(steps))
    return [_Mode(steps[first], float(omega2[first]), float(rate[first]), u[:, first])]


def limit_along(
    method: Method, network: Network, omega2: float, damping: float, u: np.ndarray
) -> Limit:
    """The limit by one mode alone, with what is responsible for it.

    omega2, damping: its quotients of K and C. u: of length 1, over the free particles' coordinates,
    times the roots of their masses.
    """
    step = largest_step(method, omega2, damping)
    return _limit(network, _Mode(step, omega2, damping, u))


def _limit(network: Network, found: _Mode) -> Limit:
    """The limit with its mode in the particles' coordinates, and what is responsible."""
    h, omega2, rate, u = found
    dim = network.position.shape[1]
    free = ~network.particles.fixed
    mu = -rate / 2 + np.sqrt(complex(rate * rate / 4 - omega2))
    if np.isrealobj(u):  # any moment serves: one at which it has both energies
        moving = u * (math.sqrt(omega2) if omega2 > 0 else rate)
    else:
        u = u * np.exp(-1j * np.angle(u[np.abs(u).argmax()]))
        u, moving = u.real, (mu * u).real
    mode, velocity = np.zeros_like(network.position), np.zeros_like(network.position)
    mass = np.sqrt(network.particles.mass[free])[:, None]
    mode[free], velocity[free] = u.reshape(-1, dim) / mass, moving.reshape(-1, dim) / mass
    particle = int((network.particles.mass * (mode**2).sum(axis=1)).argmax())
    limit = Limit(h, omega2, rate, mode, velocity, particle=particle)
    time = h if 0 < h < math.inf else 1.0
    energy, drag, held = _energies(network, mode, time)
    bent = time * time * network.on_curvature * (network.stencils.curvature(mode) ** 2).sum(axis=1)
    total = energy.sum() + drag + held + bent.sum()
    if bent.sum() > total / 2:
        most = network.stencils.start[int(bent.argmax())]
        return replace(limit, bent=int(network.stencils.particle[most]))
    if not energy.sum() > drag + held:
        return replace(limit, held=held > drag)
    spring = int(energy.argmax())
    a, b = network.springs.between[spring]
    return replace(
        limit,
        spring=int(network.number[spring]),
        ends=(int(a), int(b)),
        share=float(energy[spring] / total),
    )


def _energies(network: Network, mode: np.ndarray, h: float) -> tuple[np.ndarray, float, float]:
    """Energies in a mode (n, dim), weighed as in a step, h^2 K and h C: of springs (s,), of the
    drag on single particles, and of what else holds them.
    """
    (k, c), (held, drag) = network.along_springs, network.on_particles
    along, t = network.geometry
    a, b = network.springs.between.T
    stretch = mode[b] - mode[a]
    axial, whole = (along * stretch).sum(axis=1) ** 2, (stretch**2).sum(axis=1)
    energy = h * h * k * ((1 - t) * axial + t * whole)
    energy += h * c * axial
    moved = (mode**2).sum(axis=1)
    taken = float((drag * moved).sum())
    if len(network.triangles):
        mean = (mode[network.triangles] * network.shares[:, :, None]).sum(axis=1)
        taken += float(np.einsum("mi,mij,mj", mean, network.damping_of_triangles, mean))
    return energy, h * taken, h * h * float((held * moved).sum())
