"""A circus net of 256 x 256 knots, held along its four edges, that bounces without end.

It is here for its speed: nothing but springs, all alike, on one regular grid. Nothing takes energy
from it, so what a method adds or takes shows in the status of `taichi-cloth trade net`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from taichi_cloth.scene.cloth import grid, grid_triangles
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import ParticleDefaults, Scene, World
from taichi_cloth.settings.parameters import Parameter

WIDTH, HEIGHT = 12.8, 5.0  # of the net; at which it hangs [m]
COLOR = (236, 170, 72)


def scene(
    *,
    side: Annotated[int, Parameter("knots along a side", minimum=3, maximum=2048)] = 256,
    stretch: Annotated[
        float, Parameter("stiffness of a width of net", unit="N/m", above=0)
    ] = 400.0,
    density: Annotated[float, Parameter("mass of an area", unit="kg/m2", above=0)] = 0.25,
) -> Scene:
    """A net of 256 x 256 knots bounces between its four edges: many particles, fast; SI units."""
    edge = [(i, j) for i in range(side) for j in range(side) if {i, j} & {0, side - 1}]
    particles, springs = grid(
        (1.0, HEIGHT, -WIDTH / 2),
        side,
        side,
        WIDTH / (side - 1),
        pinned=edge,
        across=(1.0, 0.0, 0.0),
        down=(0.0, 0.0, 1.0),
        particle_defaults=ParticleDefaults(radius=0.01),
        material=Material(density=density, stretch=stretch),
    )
    return Scene(
        name="net",
        world=World(
            size=(WIDTH + 2, 2 * HEIGHT, WIDTH + 2),
            up="y",
            mouse="blow",
            gravity=(0.0, -9.81, 0.0),
            dt=1 / 60,
            substeps="auto",
        ),
        particles=replace(particles, color=np.tile(np.array(COLOR, np.uint8), (side * side, 1))),
        springs=springs,
        triangles=grid_triangles(side, side)[:, ::-1],  # its front is above
    )
