"""Particles and the springs that hold, at one moment: what a largest step is computed from."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from taichi_cloth.scene.model import Particles, Scene, Springs


@dataclass(frozen=True)
class Network:
    """Particles and the springs that hold, at one moment.

    position: (n, dim); particles: their masses, drag, and which are fixed; springs: those that
    hold; number: (s,) int, what each of these is called.
    """

    position: np.ndarray
    particles: Particles
    springs: Springs
    number: np.ndarray

    @classmethod
    def from_particles(
        cls,
        particles: Particles,
        springs: Springs,
        position: np.ndarray | None = None,
        holds: np.ndarray | None = None,
    ) -> Network:
        """The network of particles and springs, where only some may hold.

        position: (n, dim); absent: that of `particles`. holds: (s,) bool; absent: all springs do.
        """
        position = particles.position if position is None else position
        number = np.arange(len(springs)) if holds is None else np.flatnonzero(holds)
        return cls(position, particles, springs.select(number), number)

    @classmethod
    def from_scene(cls, scene: Scene) -> Network:
        """The network of a scene's start."""
        return cls.from_particles(scene.particles, scene.springs)

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
