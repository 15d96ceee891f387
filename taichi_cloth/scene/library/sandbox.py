"""The seed's box in 2-D: discs bounce in it, and clicks add discs and chains.

Discs rest on each other. By the seed's rule, ``--set 'world.contact="original"'``, whose impulses
change velocities alone, they come to lie in each other.
"""

from __future__ import annotations

from typing import Annotated

from taichi_cloth.scene.model import ParticleDefaults, Particles, Scene, SpringDefaults, World
from taichi_cloth.scene.scatter import scattered
from taichi_cloth.settings.parameters import Parameter


def scene(
    *,
    particles: Annotated[
        int, Parameter("discs at the start, placed at random", minimum=0, maximum=10_000_000)
    ] = 0,
    radius: Annotated[float, Parameter("radius of a disc", unit="px", above=0)] = 30.0,
    seed: Annotated[int, Parameter("seed of the random placement", minimum=0)] = 0,
) -> Scene:
    """A flat box of bouncing discs to click into: free ones, fixed ones and chains."""
    particle = ParticleDefaults(mass=10.0, radius=radius, viscous=0.01, restitution=0.95)
    world = World(
        size=(600.0, 400.0),
        gravity=(0.0, 0.1),
        walls=("left", "right", "top", "bottom"),
        collisions=True,
        contact="resting",
        mouse="spawn",
    )
    return Scene(
        name="sandbox",
        world=world,
        particles=(
            scattered(world, particles, particle, seed) if particles else Particles.none(world.dim)
        ),
        particle_defaults=particle,
        spring_defaults=SpringDefaults(stiffness=0.01, rest_length=20.0, break_force=5.0),
    )
