"""A chain of masses between two fixed ends, started in one of its normal modes."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.scene.model import (
    ParticleDefaults,
    Particles,
    Scene,
    SpringDefaults,
    Springs,
    World,
)
from taichi_cloth.settings.parameters import Parameter

LEFT, MIDDLE = 50.0, 100.0  # x of the first fixed end, y of the chain
LENGTH = 500.0  # between the two fixed ends
# Largest change of any spring's length over its rest length: neighbours never pass each other,
# so the springs stay linear and the closed form is exact.
STRAIN = 0.3


def scene(
    *,
    particles: Annotated[int, Parameter("free particles", minimum=1, maximum=100_000)] = 16,
    mode: Annotated[int, Parameter("number of the normal mode, 1 to particles", minimum=1)] = 1,
    stiffness: Annotated[float, Parameter("spring stiffness k", above=0)] = 0.1,
    mass: Annotated[float, Parameter("mass m", above=0)] = 1.0,
) -> Scene:
    """A chain along x between two fixed ends, swinging in one longitudinal normal mode.

    Closed form: with n free particles, particle j (1 to n) is displaced from its place of rest by
    A sin(pi p j / (n+1)) cos(w t), where p is `mode` and
    w = 2 sqrt(k/m) sin(pi p / (2 (n+1))). The scene starts at t = 0, at rest; A is the
    displacement of the particle(s) where the sine is 1. Springs are at their rest length when
    nothing moves, all motion is along x, and no gravity or drag acts, so this is exact.
    See A. L. Fetter, J. D. Walecka, "Theoretical Mechanics of Particles and Continua", section 24.
    """
    n, p = particles, mode
    if p > n:
        raise InputError(f"mode must be at most the number of particles, {n}; is {p}")
    spacing = LENGTH / (n + 1)
    # Neighbours' displacements differ by at most 2 A sin(pi p / (2 (n+1))).
    amplitude = STRAIN * spacing / (2 * math.sin(math.pi * p / (2 * (n + 1))))
    j = np.arange(n + 2)
    shape = np.sin(np.pi * p * j / (n + 1))
    shape[[0, -1]] = 0.0
    at_rest = LEFT + LENGTH * j / (n + 1)
    position = np.stack([at_rest + amplitude * shape, np.full(n + 2, MIDDLE)], axis=1)
    particle = ParticleDefaults(mass=mass, radius=min(8.0, spacing / 3))
    spring = SpringDefaults(stiffness=stiffness, rest_length=spacing)
    return Scene(
        name="chain",
        world=World(size=(LENGTH + 2 * LEFT, 2 * MIDDLE), gravity=(0.0, 0.0)),
        particles=Particles.build(position, defaults=particle, fixed=(j == 0) | (j == n + 1)),
        springs=Springs.build(np.stack([j[:-1], j[1:]], axis=1), position, defaults=spring),
        particle_defaults=particle,
        spring_defaults=spring,
    )


def solution(scene: Scene, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The closed form of `scene` at `times`: positions and velocities, (times, n + 2, 2).

    The frequency is the Rayleigh quotient of the shape at the start, which is the mode's own.
    """
    position, springs = scene.particles.position, scene.springs
    x = position[:, 0]
    at_rest = x[0] + np.concatenate([[0.0], np.cumsum(springs.rest_length)])
    shape = x - at_rest
    elastic = (springs.stiffness * np.diff(shape) ** 2).sum()
    omega = np.sqrt(elastic / (scene.particles.mass * shape**2).sum())
    along = np.stack([shape, np.zeros_like(shape)], axis=1)
    there = np.stack([at_rest, position[:, 1]], axis=1)
    cos, sin = np.cos(omega * times), np.sin(omega * times)
    return there + cos[:, None, None] * along, -omega * sin[:, None, None] * along
