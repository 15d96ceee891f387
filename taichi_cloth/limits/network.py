"""Particles and the springs that hold, at one moment: what a largest step is computed from."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from taichi_cloth.kernels import forces
from taichi_cloth.kernels.forces.contract import TENSION, has
from taichi_cloth.scene.model import Particles, Scene, Springs, World


@dataclass(frozen=True)
class Network:
    """Particles and the springs that hold, at one moment.

    position: (n, dim). world, particles, springs: those of the scene, the springs those that hold.
    number: (s,) int, what each of these is called.
    """

    position: np.ndarray
    world: World
    particles: Particles
    springs: Springs
    number: np.ndarray

    @classmethod
    def from_scene(
        cls, scene: Scene, position: np.ndarray | None = None, holds: np.ndarray | None = None
    ) -> Network:
        """The network of a scene's particles, at its start or elsewhere, where only some springs
        may hold.

        position: (n, dim); absent: that of its start. holds: (s,) bool; absent: all springs do.
        """
        position = scene.particles.position if position is None else position
        number = np.arange(len(scene.springs)) if holds is None else np.flatnonzero(holds)
        springs = scene.springs.select(number)
        return cls(position, scene.world, scene.particles, springs, number)

    @functools.cached_property
    def geometry(self) -> tuple[np.ndarray, np.ndarray]:
        """Unit vectors along the springs (s, dim), and their transverse shares (s,).

        The Hessian of a spring's energy is k [n n^T + t (I - n n^T)] with t = 1 - rest/length. It
        is taken as 0 where a spring is compressed: that it then buckles is physics, no
        instability of a method. A spring of length 0 counts as stiff in every direction.
        """
        a, b = self.springs.between.T
        d = self.position[b] - self.position[a]
        length = np.linalg.norm(d, axis=1)
        apart = length > 0
        along = d / np.where(apart, length, 1.0)[:, None]
        rest = self.springs.rest_length / np.where(apart, length, 1.0)
        return along, np.where(apart, np.maximum(0.0, 1.0 - rest), 1.0)

    @functools.cached_property
    def along_springs(self) -> tuple[np.ndarray, np.ndarray]:
        """What forces along springs add to K and C: stiffness and damping, (s,)."""
        return self._shares(True, len(self.springs))

    @functools.cached_property
    def on_particles(self) -> tuple[np.ndarray, np.ndarray]:
        """What forces on single particles, such as drag, add to K and C, (n,)."""
        return self._shares(False, len(self.particles))

    def _shares(self, along: bool, count: int) -> tuple[np.ndarray, np.ndarray]:
        """The sum of the shares that the terms along springs, or on particles, declare."""
        stiffness, damping = np.zeros(count), np.zeros(count)
        for name in forces.TERMS:
            term = forces.load(name)
            if has(term.bound) and (term.adds == TENSION) == along:
                k, c = term.bound(self.world, self.particles, self.springs)
                stiffness, damping = stiffness + k, damping + c
        return stiffness, damping
