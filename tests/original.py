"""The rules of the original cloth in NumPy, spring by spring: a twin that shares no code with ours.

It has no walls and no collisions. Its sums are in an order of their own, so that round-off grows
apart from ours where cloth is pulled.
"""

import numpy as np

REACH, STRENGTH = 50.0, 0.002  # of the pointer


class Original:
    """Steps a 2-D scene. x, v: (n, 2), positions and velocities; holds: (s,) bool, springs that
    have not been over their limit; squeezed: how many of the others were shorter than at rest.
    """

    def __init__(self, scene):
        self.scene = scene
        self.x, self.v = scene.particles.position.copy(), scene.particles.velocity.copy()
        self.v[scene.particles.fixed] = 0.0
        self.pulls = np.ones(len(scene.springs), bool)
        self.squeezed = 0
        self._look()

    def step(self, pointer=None, displacement=None):
        """One step of symplectic Euler, with a push where there is a pointer."""
        world, particles, springs = self.scene.world, self.scene.particles, self.scene.springs
        force = -particles.viscous[:, None] * self.v
        a, b = springs.between.T
        d = self.x[b] - self.x[a]
        length = np.linalg.norm(d, axis=1)
        along = d / length[:, None]
        rate = ((self.v[b] - self.v[a]) * along).sum(axis=1)
        tension = springs.stiffness * (length - springs.rest_length) + springs.damping * rate
        pull = np.where(self.pulls, tension, 0.0)[:, None] * along
        np.add.at(force, a, pull)
        np.add.at(force, b, -pull)
        if pointer is not None:
            near = REACH - np.linalg.norm(self.x - pointer, axis=1)
            force += STRENGTH * np.maximum(near, 0.0)[:, None] * displacement
        free = ~particles.fixed[:, None]
        self.v += free * world.dt * (np.array(world.gravity) + force / particles.mass[:, None])
        self.x += world.dt * self.v
        self.pulls = self.holds  # what was over its limit has acted once more
        self._look()

    def _look(self):
        """Find the springs that are over their limit now."""
        springs = self.scene.springs
        a, b = springs.between.T
        length = np.linalg.norm(self.x[b] - self.x[a], axis=1)
        force = springs.stiffness * (length - springs.rest_length)
        over = np.where(springs.break_in == "tension", force, np.abs(force)) > springs.break_force
        self.holds = self.pulls & ~over
        self.squeezed += int((self.pulls & over & (force < 0)).sum())


def storm(seed, frames, low, high):
    """Pointer positions (frames, 2), anywhere between two corners: a wild log."""
    return np.random.default_rng(seed).uniform(low, high, (frames, 2))
