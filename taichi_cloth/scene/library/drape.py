"""A cloth that falls over a sphere and onto the floor."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from taichi_cloth.scene.cloth import grid, grid_stencils, grid_triangles
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import Scene, World
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.settings.parameters import Parameter

WIDTH, RADIUS = 1.6, 0.3  # of the cloth; of the sphere [m]
BENDING = 2e-5  # N m, of a light woollen fabric
COLOR = (188, 62, 84)


def scene(
    *,
    side: Annotated[int, Parameter("particles along a side", minimum=3, maximum=512)] = 49,
    friction: Annotated[
        float, Parameter("Coulomb coefficient of the sphere and the floor", minimum=0)
    ] = 0.4,
    spin: Annotated[float, Parameter("of the sphere", unit="degrees/s")] = 0.0,
) -> Scene:
    """A cloth falls over a sphere and onto the floor; SI units."""
    spacing = WIDTH / (side - 1)
    across, down = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    particles, springs = grid(
        (1.0 - WIDTH / 2, 2.2 * RADIUS, -WIDTH / 2 + 0.05),
        side,
        side,
        spacing,
        links=("structural", "shear"),
        across=across,
        down=down,
        material=Material(density=0.2, thickness=0.01, stretch=80.0, shear=10.0, damping_time=4e-4),
    )
    sphere = Obstacle.build(
        "sphere", centre=[1.0, RADIUS, 0.0], radius=RADIUS, friction=friction, spin=[0, spin, 0]
    )
    return Scene(
        name="drape",
        world=World(
            size=(2.0, 1.5, 2.0),
            up="y",
            mouse="blow",
            gravity=(0.0, -9.81, 0.0),
            dt=1 / 60,
            substeps="auto",
            ground=0.0,
            friction=friction,
            more={"air": {"density": 1.2, "drag": 1.0, "lift": 0.2}},
        ),
        particles=replace(particles, color=np.tile(np.array(COLOR, np.uint8), (side * side, 1))),
        springs=springs,
        triangles=grid_triangles(side, side)[:, ::-1],  # its front is above
        obstacles=(sphere,),
        stencils=grid_stencils(side, side, spacing, BENDING, across=across, down=down),
    )
