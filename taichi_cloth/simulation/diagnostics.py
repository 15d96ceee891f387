"""Energy and momentum of a state, in float64 on the host, and the work that led there.

m, v, x as in `scene.Particles`; fixed particles have no momentum and no kinetic energy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from taichi_cloth.kernels import forces
from taichi_cloth.kernels.forces.contract import ACCELERATION, CURVATURE, FORCE, TENSION, has
from taichi_cloth.limits import tractions
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.scene.triangles import corner_shares


@dataclass(frozen=True)
class Work:
    """The work of a run: steps, evaluations of all forces, sweeps of a solver over all springs,
    and how many steps' solutions did not converge to their tolerance.
    """

    steps: int
    force_evaluations: int
    sweeps: int
    unconverged: int

    @property
    def mostly_unconverged(self) -> bool:
        """True if most steps' solutions did not converge: what they show is not the scene."""
        return 2 * self.unconverged > self.steps


@dataclass(frozen=True)
class Solution:
    """The solution of a step's last stage.

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
class ContactAccount:
    """The account of contacts in a run.

    gained: the energy that they gave, summed over the steps in which all of them together gave any
    (`kernels.contact_account`), in the scene's units. balance: that of all steps, less what they
    took. first_touch: the time at the end of the step with the first contact; None: there was none.
    """

    gained: float
    balance: float
    first_touch: float | None


@dataclass(frozen=True)
class Energy:
    """The energy of a state, in the scene's units.

    kinetic: of the free particles. potential: of each force that has one, by its name.
    """

    kinetic: float
    potential: Mapping[str, float]

    @property
    def gravitational(self) -> float:
        """Potential energy of gravity, which is zero at the origin."""
        return self.potential["gravity"]

    @property
    def elastic(self) -> float:
        """Energy of the stretched and compressed springs, and of what is bent."""
        return self.potential["springs"] + self.potential["bending"]

    @property
    def total(self) -> float:
        """Kinetic and potential energy."""
        return sum(self.potential.values(), self.kinetic)


def energy(scene: Scene, x: np.ndarray, v: np.ndarray, pulling: np.ndarray) -> Energy:
    """Energy of a scene's particles at x with v, (n, dim), and of the springs that pull, (s,) bool.

    Of a force that the scene does not have it is zero.
    """
    held = scene.springs.select(pulling), scene.stencils_among(pulling)
    return energy_of(x, v, scene.world, scene.particles, *held)


def energy_of(
    x: np.ndarray,
    v: np.ndarray,
    world: World,
    particles: Particles,
    springs: Springs,
    stencils: Stencils,
) -> Energy:
    """Energy of particles at x with v, (n, dim), and of springs and stencils that all pull."""
    mass = np.where(particles.fixed, 0.0, particles.mass)
    terms = {name: forces.load(name) for name in forces.TERMS}
    return Energy(
        kinetic=float(0.5 * (mass * np.einsum("ij,ij->i", v, v)).sum()),
        potential={
            name: term.energy(
                x, v, world, particles, stencils if term.adds == CURVATURE else springs
            )
            for name, term in terms.items()
            if has(term.energy)
        },
    )


def spring_forces(x: np.ndarray, v: np.ndarray, springs: Springs) -> np.ndarray:
    """Forces of `springs` on the particles at x, v (n, dim), dashpots included, (n, dim)."""
    a, b = springs.between.T
    d = x[b] - x[a]
    length = np.linalg.norm(d, axis=1)
    along = d / np.where(length > 0, length, 1.0)[:, None]
    rate = ((v[b] - v[a]) * along).sum(axis=1)
    tension = np.zeros(len(springs))
    for name in forces.TERMS:
        term = forces.load(name)
        if term.adds == TENSION and has(term.twin):
            tension += term.twin(length, rate, springs)
    force: np.ndarray = np.zeros_like(x)
    np.add.at(force, a, tension[:, None] * along)
    np.subtract.at(force, b, tension[:, None] * along)
    return force


def stencil_forces(x: np.ndarray, stencils: Stencils, fixed: np.ndarray) -> np.ndarray:
    """Forces of `stencils` on the particles at x (n, dim), of which some are fixed, (n, dim)."""
    curvature, k = stencils.curvature(x), stencils.stiffness(fixed)
    pull = np.zeros_like(curvature)
    for name in forces.TERMS:
        term = forces.load(name)
        if term.adds == CURVATURE and has(term.twin):
            pull += term.twin(curvature, k)
    force: np.ndarray = stencils.gathered(pull, len(x))
    return force


def acceleration_at_start(scene: Scene) -> np.ndarray:
    """Acceleration of a scene's particles at its start (n, dim), by all forces it has.

    What springs in balance leave of their forces by rounding counts as nothing.
    """
    p, springs, world = scene.particles, scene.springs, scene.world
    a: np.ndarray = np.zeros_like(p.position)
    with np.errstate(all="ignore"):
        force = spring_forces(p.position, p.velocity, springs)
        reach = np.abs(p.position).max(axis=1, initial=0.0)[springs.between].max(axis=1)
        each = springs.stiffness * np.maximum(reach, springs.rest_length)
        rounding = 1e-14 * np.bincount(springs.between.ravel(), np.repeat(each, 2), len(p))
        force = np.where(np.abs(force) > rounding[:, None], force, 0.0)
        force += stencil_forces(p.position, scene.stencils, p.fixed)
        for term in map(forces.load, forces.present_in(scene)):
            if term.adds == FORCE and has(term.twin):
                force += term.twin(p.position, p.velocity, world, p)
            elif term.adds == ACCELERATION and has(term.twin):
                a += term.twin(p.position, p.velocity, world, p)
        shares = corner_shares(p.position, scene.triangles)
        force += tractions.forces_on_particles(
            p.position, p.velocity, 0.0, world, scene.triangles, shares
        )
        a += force / p.mass[:, None]
    return a


def momentum(v: np.ndarray, mass: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Total linear momentum of the free particles, shape (dim,)."""
    total: np.ndarray = np.where(fixed, 0.0, mass) @ v
    return total
