"""Spring scenes of ours as models of the installed `newton`, and its solvers on them.

Positions, velocities, masses, fixed particles, gravity, rest lengths, stiffnesses and axial
dashpots are ours, in our units, as 32-bit floats; in a plane, z is 0. Contacts are off. On the CPU
it has one thread.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation.storage import adjacency

# By the name in tables: the class, and whether it takes a number of iterations.
SOLVERS = {
    "Newton, semi-implicit": ("SolverSemiImplicit", False),
    "Newton, XPBD": ("SolverXPBD", True),
    "Newton, VBD": ("SolverVBD", True),
}


def model_of(scene: Scene) -> Any:
    """The scene as a `newton.Model` on the CPU.

    Particles are coloured by our springs, as its VBD needs: its own colours are those of triangles.
    Raises InputError where a scene has what Newton has not: drag, contacts, springs that break.
    """
    _check(scene)
    import newton

    particles, springs = scene.particles, scene.springs
    builder = newton.ModelBuilder()
    builder.add_particles(
        pos=in_space(particles.position).tolist(),
        vel=in_space(np.where(particles.fixed[:, None], 0.0, particles.velocity)).tolist(),
        mass=np.where(particles.fixed, 0.0, particles.mass).tolist(),
        radius=[0.0] * len(particles),  # no contacts
    )
    builder.spring_indices = springs.between.ravel().tolist()
    builder.spring_rest_length = springs.rest_length.tolist()
    builder.spring_stiffness = springs.stiffness.tolist()
    builder.spring_damping = springs.damping.tolist()
    builder.spring_control = [0.0] * len(springs)
    colour = adjacency.vertex_colours(springs.between, len(particles))
    colour[colour < 0] = 0  # what no spring holds touches nobody
    builder.set_coloring([np.flatnonzero(colour == c) for c in range(colour.max(initial=0) + 1)])
    model = builder.finalize(device="cpu")
    model.set_gravity(tuple(in_space(np.array([scene.world.gravity]))[0]))
    model.particle_grid = None  # which contacts would need
    return model


def _check(scene: Scene) -> None:
    lacking = {
        "drag": (scene.particles.viscous != 0).any(),
        "contacts": scene.collides or bool(scene.world.walls or scene.obstacles),
        "springs that break": np.isfinite(scene.springs.break_force).any(),
    }
    for what, there in lacking.items():
        if there:
            raise InputError(f"scene '{scene.name}': Newton's models here have no {what}")


def in_space(vectors: np.ndarray) -> np.ndarray:
    """Vectors (n, 2 or 3) with three components, the third 0 where there was none."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))


class Stepper:
    """One of Newton's solvers on a scene of ours. solver: its class; the other words are its."""

    def __init__(self, model: Any, solver: str, **settings: Any):
        import newton

        self._solver = getattr(newton.solvers, solver)(model, **settings)
        self._control = model.control()
        self._now, self._next = model.state(), model.state()

    def advance(self, dt: float, steps: int) -> None:
        """So many steps of dt."""
        for _ in range(steps):
            self._now.clear_forces()
            self._solver.step(self._now, self._next, self._control, None, dt)
            self._now, self._next = self._next, self._now

    def positions(self) -> np.ndarray:
        """(n, 3), float32."""
        x: np.ndarray = self._now.particle_q.numpy()
        return x

    def velocities(self) -> np.ndarray:
        """(n, 3), float32."""
        v: np.ndarray = self._now.particle_qd.numpy()
        return v
