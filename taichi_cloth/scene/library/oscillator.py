"""One mass on one spring: the smallest scene with a closed form."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from taichi_cloth.scene.model import (
    ParticleDefaults,
    Particles,
    Scene,
    SpringDefaults,
    Springs,
    World,
)
from taichi_cloth.settings.parameters import Parameter

ANCHOR = (100.0, 100.0)
REST_LENGTH = 150.0


def scene(
    *,
    amplitude: Annotated[
        float, Parameter("stretch at the start", unit="px", minimum=-100, maximum=100)
    ] = 50.0,
    stiffness: Annotated[float, Parameter("spring stiffness k", above=0)] = 0.01,
    mass: Annotated[float, Parameter("mass m", above=0)] = 1.0,
) -> Scene:
    """One mass on one spring to a fixed particle; no gravity, no drag.

    Closed form: the mass, let go at rest A = `amplitude` beyond the spring's rest length L, moves
    along x as x(t) = 100 + L + A cos(w t) with w = sqrt(k/m); its energy stays k A^2 / 2.
    """
    particle = ParticleDefaults(mass=mass, radius=12.0)
    spring = SpringDefaults(stiffness=stiffness, rest_length=REST_LENGTH)
    position = [ANCHOR, (ANCHOR[0] + REST_LENGTH + amplitude, ANCHOR[1])]
    return Scene(
        name="oscillator",
        world=World(size=(400.0, 200.0), gravity=(0.0, 0.0)),
        particles=Particles.build(position, defaults=particle, fixed=[True, False]),
        springs=Springs.build([(0, 1)], position, defaults=spring),
        particle_defaults=particle,
        spring_defaults=spring,
    )


def solution(scene: Scene, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The closed form of `scene` at `times`: positions and velocities, (times, 2, 2)."""
    particles, springs = scene.particles, scene.springs
    omega = np.sqrt(springs.stiffness[0] / particles.mass[1])
    rest = particles.position[0] + [springs.rest_length[0], 0.0]
    amplitude = particles.position[1] - rest
    x = np.tile(particles.position, (len(times), 1, 1))
    v = np.zeros_like(x)
    x[:, 1] = rest + np.cos(omega * times)[:, None] * amplitude
    v[:, 1] = -omega * np.sin(omega * times)[:, None] * amplitude
    return x, v
