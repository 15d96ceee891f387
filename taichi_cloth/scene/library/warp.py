"""The cloth of NVIDIA Warp's benchmark, which `taichi-cloth bench warp` races against Warp's own.

Structural, shear and bend springs with k 1000 and axial dashpots 10, mass 0.1, spacing 0.1, flat in
x and z, held at two corners (warp/examples/benchmarks/benchmark_cloth.py). Its benchmark takes 16
steps a frame of 1/60 s.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from taichi_cloth.scene.cloth import grid, grid_triangles
from taichi_cloth.scene.model import ParticleDefaults, Scene, SpringDefaults, World
from taichi_cloth.settings.parameters import Parameter

SPACING, MASS, STIFFNESS, DAMPING = 0.1, 0.1, 1000.0, 10.0
COLOR = (118, 185, 0)


def scene(
    *,
    side: Annotated[int, Parameter("particles along a side", minimum=2, maximum=2048)] = 32,
    gravity: Annotated[float, Parameter("acceleration downwards", unit="m/s2")] = 9.81,
) -> Scene:
    """The cloth of Warp's benchmark: flat at first, it swings down from two corners; SI units."""
    particles, springs = grid(
        (0.0, 0.0, 0.0),
        side,
        side,
        SPACING,
        pinned=[(0, 0), (side - 1, 0)],
        links=("structural", "shear", "bend"),
        across=(1.0, 0.0, 0.0),
        down=(0.0, 0.0, 1.0),
        particle_defaults=ParticleDefaults(mass=MASS, radius=0.0),
        spring_defaults=SpringDefaults(stiffness=STIFFNESS, damping=DAMPING),
    )
    reach = 4 * SPACING * side
    return Scene(
        name="warp",
        world=World(
            size=(reach,) * 3,
            up="y",
            gravity=(0.0, -gravity, 0.0),
            dt=1 / 60,
            substeps="auto",
        ),
        particles=replace(particles, color=np.tile(np.array(COLOR, np.uint8), (side * side, 1))),
        springs=springs,
        triangles=grid_triangles(side, side)[:, ::-1],  # its front is above
    )
