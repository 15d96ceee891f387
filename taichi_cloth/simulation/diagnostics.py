"""Energy and momentum of a state, in float64 on the host, and the work that led there.

m, v, x as in `scene.Particles`; fixed particles have no momentum and no kinetic energy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taichi_cloth.scene.model import Springs
from taichi_cloth.simulation.snapshot import Snapshot


@dataclass(frozen=True)
class Work:
    """What a run has done: steps, evaluations of all forces, sweeps of a solver over all springs,
    and how many steps' solutions did not converge to their tolerance.
    """

    steps: int
    force_evaluations: int
    sweeps: int
    unconverged: int


@dataclass(frozen=True)
class Solution:
    """How the equations of a step's last stage were solved.

    outcome: in words, such as "converged"; converged: whether the residual met its tolerance, or is
    as small as rounding leaves it. residual_max, residual_rms: of all particles, as accelerations;
    scale: the acceleration that the tolerance refers to. directions: Newton's; sweeps: products
    with the stiffness matrix in the last one.
    """

    outcome: str
    converged: bool
    residual_max: float
    residual_rms: float
    scale: float
    directions: int
    sweeps: int


@dataclass(frozen=True)
class Energy:
    """Kinetic, gravitational and elastic energy of a state, in the scene's units."""

    kinetic: float
    gravitational: float
    elastic: float

    @property
    def total(self) -> float:
        return self.kinetic + self.gravitational + self.elastic


def energy(
    x: np.ndarray,
    v: np.ndarray,
    mass: np.ndarray,
    fixed: np.ndarray,
    gravity: Sequence[float],
    between: np.ndarray,
    stiffness: np.ndarray,
    rest_length: np.ndarray,
    alive: np.ndarray,
) -> Energy:
    """Energy of a state: x, v (n, dim), springs (s, ...) of which `alive` (s,) count."""
    free = ~fixed
    a, b = between[alive].T
    stretch = np.linalg.norm(x[b] - x[a], axis=1) - rest_length[alive]
    return Energy(
        kinetic=float(0.5 * (mass[free, None] * v[free] ** 2).sum()),
        gravitational=float(-(mass[free] * (x[free] @ np.asarray(gravity))).sum()),
        elastic=float(0.5 * (stiffness[alive] * stretch**2).sum()),
    )


def energy_of(snapshot: Snapshot) -> Energy:
    """Energy of a state, of the springs that pull."""
    particles, springs = snapshot.scene.particles, snapshot.scene.springs
    return energy(
        snapshot.x,
        snapshot.v,
        particles.mass,
        particles.fixed,
        snapshot.scene.world.gravity,
        springs.between,
        springs.stiffness,
        springs.rest_length,
        snapshot.pulling,
    )


def spring_forces(x: np.ndarray, v: np.ndarray, springs: Springs) -> np.ndarray:
    """What `springs` do to the particles at x, v (n, dim), dashpots included, (n, dim)."""
    a, b = springs.between.T
    d = x[b] - x[a]
    length = np.linalg.norm(d, axis=1)
    along = d / np.where(length > 0, length, 1.0)[:, None]
    tension = springs.stiffness * (length - springs.rest_length)
    tension += springs.damping * ((v[b] - v[a]) * along).sum(axis=1)
    force: np.ndarray = np.zeros_like(x)
    np.add.at(force, a, tension[:, None] * along)
    np.subtract.at(force, b, tension[:, None] * along)
    return force


def momentum(v: np.ndarray, mass: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Total linear momentum of the free particles, shape (dim,)."""
    total: np.ndarray = (mass[~fixed, None] * v[~fixed]).sum(axis=0)
    return total
