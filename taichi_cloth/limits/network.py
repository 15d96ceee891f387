"""Particles and the springs that hold, at one moment: what a largest step is computed from."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field

import numpy as np

from taichi_cloth.kernels import forces
from taichi_cloth.kernels.forces.contract import ACCELERATION, CURVATURE, FORCE, TENSION, has
from taichi_cloth.limits import tractions
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.scene.triangles import corner_shares, springs_of_sides


@dataclass(frozen=True)
class Network:
    """Particles and the springs that hold, at one moment.

    position, velocity: (n, dim). world, particles, springs: those of the scene, the springs those
    that hold. number: (s,) int, what each of these is called. triangles: (m, 3), those that are
    whole; shares: (m, 3), their corners' of them. stencils: those that hold.
    """

    position: np.ndarray
    velocity: np.ndarray
    world: World
    particles: Particles
    springs: Springs
    number: np.ndarray
    triangles: np.ndarray
    shares: np.ndarray
    stencils: Stencils = field(default_factory=Stencils.none)

    @classmethod
    def from_scene(
        cls,
        scene: Scene,
        position: np.ndarray | None = None,
        holds: np.ndarray | None = None,
        velocity: np.ndarray | None = None,
    ) -> Network:
        """The network of a scene's particles, at its start or elsewhere, where only some springs
        may hold.

        position, velocity: (n, dim); absent: those of its start. holds: (s,) bool; absent: all
        springs do.
        """
        position = scene.particles.position if position is None else position
        velocity = scene.particles.velocity if velocity is None else velocity
        number = np.arange(len(scene.springs)) if holds is None else np.flatnonzero(holds)
        springs = scene.springs.select(number)
        triangles, shares = np.zeros((0, 3), np.int64), np.zeros((0, 3))
        if len(scene.triangles) and tractions.present(scene.world):
            triangles = scene.triangles
            shares = corner_shares(scene.particles.position, triangles)
            if holds is not None:
                sides = springs_of_sides(triangles, scene.springs.between)
                whole = np.append(holds, True)[sides].all(axis=1)
                triangles, shares = triangles[whole], shares[whole]
        return cls(
            position,
            velocity,
            scene.world,
            scene.particles,
            springs,
            number,
            triangles,
            shares,
            scene.stencils if holds is None else scene.stencils_among(holds),
        )

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
        return self._shares(len(self.springs), self.springs, (TENSION,))

    @functools.cached_property
    def on_particles(self) -> tuple[np.ndarray, np.ndarray]:
        """What forces on single particles, such as drag, add to K and C, (n,)."""
        kinds = (ACCELERATION, FORCE)
        return self._shares(len(self.particles), self.springs, kinds)

    @functools.cached_property
    def by_triangles(self) -> tuple[np.ndarray, np.ndarray]:
        """What forces on triangles add to K and C at most, whatever way these are turned, (n,)."""
        return tractions.bounds(
            self.position, self.velocity, self.world, self.triangles, self.shares
        )

    @functools.cached_property
    def damping_of_triangles(self) -> np.ndarray:
        """What forces on triangles add to C, in the geometry as it is: blocks (m, 3, 3).

        Each acts on the mean velocity of a triangle's corners. What they add to K is left out: it
        is no symmetric matrix, and what grows by it, such as a flag's flutter, is physics.
        """
        return tractions.damping_blocks(
            self.position, self.velocity, self.world, self.triangles, self.shares
        )

    @functools.cached_property
    def on_curvature(self) -> np.ndarray:
        """What forces on stencils add to K: times the squares of curvature vectors, (m,)."""
        return self._shares(len(self.stencils), self.stencils, (CURVATURE,))[0]

    def _shares(
        self, count: int, of: Springs | Stencils, kinds: tuple[str, ...]
    ) -> tuple[np.ndarray, np.ndarray]:
        """The sum of the shares that the terms of some kinds declare; of: what these are given."""
        stiffness, damping = np.zeros(count), np.zeros(count)
        for name in forces.TERMS:
            term = forces.load(name)
            if has(term.bound) and term.adds in kinds:
                k, c = term.bound(self.world, self.particles, of)
                stiffness, damping = stiffness + k, damping + c
        return stiffness, damping
