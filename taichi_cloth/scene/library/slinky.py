"""A hanging chain let go at its top: the bottom does not know yet, and stays where it is."""

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
from taichi_cloth.scene.palette import COLOR_CYCLE
from taichi_cloth.settings.parameters import Parameter

MASS = 1.0
# The fastest oscillation of a chain has frequency 2 sqrt(k/m) = 1, half of the 2/dt at which
# symplectic Euler with dt = 1 becomes unstable.
STIFFNESS = 0.25
WIDTH, HEIGHT, TOP = 400.0, 800.0, 30.0
EXTENSION = 120.0  # by how much its own weight stretches the whole chain
# Rest length over the longest extension of a spring. Above 1 no two particles ever pass each
# other before the wave arrives (below); the rest is room for the ripple behind the front.
MARGIN = 1.25


def scene(
    *,
    particles: Annotated[
        int, Parameter("particles in the chain", minimum=2, maximum=100_000)
    ] = 100,
) -> Scene:
    """A hanging chain let go at its top: the bottom stays until the collapse reaches it.

    It starts in the exact equilibrium of n masses m hanging from the first: spring j (0 the
    uppermost) carries the n-1-j masses below it, so it is longer than its rest length by
    (n-1-j) m g / k. Then all are free.

    Closed form (continuum limit; no drag, nothing in the way): the news travels down at
    sqrt(k/m) springs per time, so the bottom rests until t = n sqrt(m/k). Spring j, once passed,
    goes from that tension to the compression j m g / k: the solution of the wave equation with a
    free end (d'Alembert). The centre of mass falls by g t^2 / 2 from the start.
    See M. G. Calkin, "Motion of a falling spring", Am. J. Phys. 61 (1993) 261-264.
    """
    n = particles
    # sum over the springs of (n-1-j) m g / k = n (n-1) m g / (2 k) = EXTENSION
    gravity = 2 * EXTENSION * STIFFNESS / (MASS * n * (n - 1))
    carried = np.arange(n - 1, 0, -1)
    stretch = carried * (MASS * gravity / STIFFNESS)
    rest_length = MARGIN * stretch[0]
    y = TOP + np.concatenate([[0.0], np.cumsum(rest_length + stretch)])
    position = np.stack([np.full(n, WIDTH / 2), y], axis=1)
    particle = ParticleDefaults(mass=MASS, radius=4.0)
    spring = SpringDefaults(stiffness=STIFFNESS, rest_length=rest_length)
    return Scene(
        name="slinky",
        world=World(size=(WIDTH, HEIGHT), gravity=(0.0, gravity)),
        particles=Particles.build(
            position,
            defaults=particle,
            color=np.array(COLOR_CYCLE)[np.arange(n) * len(COLOR_CYCLE) // n],
        ),
        springs=Springs.build(
            np.stack([np.arange(n - 1), np.arange(1, n)], axis=1), position, defaults=spring
        ),
        particle_defaults=particle,
        spring_defaults=spring,
    )
