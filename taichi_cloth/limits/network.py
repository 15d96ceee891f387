"""Particles and the springs that hold, at one moment: what a largest step is computed from."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from taichi_cloth.kernels import forces
from taichi_cloth.kernels.forces.contract import ACCELERATION, CURVATURE, FORCE, TENSION, has
from taichi_cloth.limits import tractions
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.scene.triangles import corner_shares, springs_of_sides

T = TypeVar("T")


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
    # What depends neither on positions nor on velocities, by name: `once`.
    _kept: dict[str, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

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

    def moved(self, position: np.ndarray, velocity: np.ndarray) -> Network:
        """The same network with particles elsewhere, at other velocities, (n, dim) each.

        It shares with this one what `once` has computed for either.
        """
        other = replace(self, position=position, velocity=velocity)
        object.__setattr__(other, "_kept", self._kept)
        return other

    def once(self, name: str, compute: Callable[[], T]) -> T:
        """Return compute()'s value, made when this name is first asked for, of this network
        or of one that it was `moved` from: it must depend on no position and no velocity.
        """
        if name not in self._kept:
            self._kept[name] = compute()
        found: T = self._kept[name]
        return found

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

    @property
    def along_springs(self) -> tuple[np.ndarray, np.ndarray]:
        """Terms of forces along springs in K and C: stiffness and damping, (s,)."""
        return self.once(
            "along_springs", lambda: self._shares(len(self.springs), self.springs, (TENSION,))
        )

    @property
    def on_particles(self) -> tuple[np.ndarray, np.ndarray]:
        """Terms of forces on single particles, such as drag, in K and C, (n,)."""
        kinds = (ACCELERATION, FORCE)
        return self.once(
            "on_particles", lambda: self._shares(len(self.particles), self.springs, kinds)
        )

    @functools.cached_property
    def by_triangles(self) -> tuple[np.ndarray, np.ndarray]:
        """The most that forces on triangles add to K and C, whatever way these are turned, (n,)."""
        return tractions.bounds(
            self.position, self.velocity, self.world, self.triangles, self.shares
        )

    @functools.cached_property
    def damping_of_triangles(self) -> np.ndarray:
        """Terms of forces on triangles in C, in the geometry as it is: blocks (m, 3, 3).

        Each acts on the mean velocity of a triangle's corners. What they add to K is left out: it
        is no symmetric matrix, and what grows by it, such as a flag's flutter, is physics.
        """
        return tractions.damping_blocks(
            self.position, self.velocity, self.world, self.triangles, self.shares
        )

    @property
    def on_curvature(self) -> np.ndarray:
        """Terms of forces on stencils in K: times the squares of curvature vectors, (m,)."""
        return self.once(
            "on_curvature", lambda: self._shares(len(self.stencils), self.stencils, (CURVATURE,))[0]
        )

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


class Networks:
    """The networks of one state after the other, as `Network.from_scene` makes them.

    What stays as it is while the same springs of the same scene hold is not made anew.
    """

    def __init__(self) -> None:
        self._of: tuple[object, ...] = ()
        self._holds = np.zeros(0, bool)
        self._last: Network | None = None

    def of(
        self, scene: Scene, position: np.ndarray, holds: np.ndarray, velocity: np.ndarray
    ) -> Network:
        """The network of a state; what is given is as in `Network.from_scene`."""
        of = scene.world, scene.particles, scene.springs, scene.triangles, scene.stencils
        same = len(self._of) == len(of) and all(map(operator.is_, of, self._of))
        if same and self._last is not None and np.array_equal(holds, self._holds):
            return self._last.moved(position, velocity)
        self._of, self._holds = of, holds
        self._last = Network.from_scene(scene, position, holds, velocity)
        return self._last
