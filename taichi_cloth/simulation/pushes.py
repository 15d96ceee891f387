"""Pushes from outside on a simulation's particles: a pointer's blow, a force that is held."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from taichi_cloth.errors import InputError
from taichi_cloth.kernels.forces import blow
from taichi_cloth.settings import accepted
from taichi_cloth.simulation.acts import act
from taichi_cloth.simulation.part import Part

ORIGINAL_REACH = blow.REACH  # world units: how far the pointer blows where nothing else is said


class Pushes(Part):
    """The part of a `Simulation` that pushes its particles."""

    def blow(self, pointer: ArrayLike, displacement: ArrayLike, reach: float | None = None) -> None:
        """Blow on particles near `pointer` (2-D, world units) through the next frame.

        displacement: how far the pointer moved since the last frame. reach: how far it blows, world
        units; right under it a particle of mean mass gains a tenth of the pointer's velocity in a
        frame. None: 50 units, with the original's force, whatever particles weigh. InputError in a
        scene whose mouse does not blow, and in a 3-D one, which takes `blow_ray`.
        """
        if self.scene.world.dim != 2:
            raise InputError("blow: the scene is 3-D; use blow_ray")
        pointer = accepted.array("blow: pointer", pointer, (2,))
        displacement = accepted.array("blow: displacement", displacement, (2,))
        self._push(pointer, np.zeros(2), displacement, reach)

    def blow_ray(
        self,
        origin: ArrayLike,
        direction: ArrayLike,
        displacement: ArrayLike,
        reach: float | None = None,
    ) -> None:
        """Blow in 3-D on particles near the line through `origin` along `direction`, all (3,).

        displacement, reach: as for `blow`.
        InputError in a scene whose mouse does not blow, and in a 2-D one, which takes `blow`.
        """
        if self.scene.world.dim != 3:
            raise InputError("blow_ray: the scene is 2-D; use blow")
        origin = accepted.array("blow_ray: origin", origin, (3,))
        along = accepted.array("blow_ray: direction", direction, (3,))
        displacement = accepted.array("blow_ray: displacement", displacement, (3,))
        largest = np.abs(along).max()
        if largest == 0:
            raise InputError("blow_ray: direction must not be zero")
        along = along / largest  # so that no square overflows
        self._push(origin, along / np.linalg.norm(along), displacement, reach)

    @act
    def hold(self, force: ArrayLike) -> None:
        """Push every particle with a constant force of its own, (n, dim), until the next push.

        A scene whose mouse does not blow refuses with InputError, as it does for `blow`.
        """
        self._check_blows()
        shape = self.particle_count, self.scene.world.dim
        self.storage.hold(accepted.array("hold: force", force, shape, "particles, dimensions"))

    @act
    def _push(
        self,
        origin: np.ndarray,
        direction: np.ndarray,
        displacement: np.ndarray,
        reach: float | None,
    ) -> None:
        self._check_blows()
        numbers = [blow.REACH, blow.STRENGTH]
        if reach is not None:
            reach = accepted.number("blow: reach", reach, above=0)
            particles = self.storage.scene.particles
            mass = particles.mass[~particles.fixed]
            mean = float(mass.mean()) if len(mass) else 1.0
            with np.errstate(all="ignore"):
                strength = float(blow.strength_of(np.float64(reach), mean, self.dt))
            if not strength <= np.finfo(self.storage.real).max:
                says = f"blow: reach {reach:g} is so small that its force is beyond all numbers"
                raise InputError(f"{says} of the precision; give a larger one")
            numbers = [reach, strength]
        self.storage.push(np.concatenate([origin, direction, displacement, numbers]))

    def _check_blows(self) -> None:
        mouse = self.scene.world.mouse
        if mouse != "blow" and not self.scene.world.tools:
            raise InputError(
                f"scene '{self.scene.name}': the mouse does not blow here "
                f"([world] mouse is '{mouse}'; set it to 'blow')"
            )
