"""A flag on its pole, in a wind that comes in gusts."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from taichi_cloth.scene.cloth import grid, grid_stencils, grid_triangles
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import ParticleDefaults, Scene, World
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.settings.parameters import Parameter

LENGTH, TOP, POLE = 1.8, 2.6, 0.3  # of the flag; its upper edge; where the pole stands [m]
BENDING = 5e-6  # N m, of a thin polyester
STRIPES = ((214, 48, 58), (240, 240, 236), (44, 88, 168))


def scene(
    *,
    columns: Annotated[int, Parameter("particles along it", minimum=3, maximum=1024)] = 49,
    wind: Annotated[float, Parameter("its mean velocity", unit="m/s", minimum=0)] = 7.0,
    gust: Annotated[float, Parameter("relative change of the wind", minimum=0)] = 0.3,
    seed: Annotated[int, Parameter("of the gusts", minimum=0)] = 1,
) -> Scene:
    """A flag on its pole, in a wind that comes in gusts; SI units."""
    spacing = LENGTH / (columns - 1)
    rows = 1 + round(2 / 3 * (columns - 1))
    # A straight flag would not know to which side to flutter.
    across, down = (1.0, 0.0, 0.02), (0.0, -1.0, 0.0)
    particles, springs = grid(
        (POLE + 0.04, TOP, 0.0),
        columns,
        rows,
        spacing,
        pinned=[(0, row) for row in range(rows)],
        links=("structural", "shear"),
        across=across,
        down=down,
        particle_defaults=ParticleDefaults(radius=0.002),
        material=Material(density=0.12, stretch=80.0, shear=10.0, damping_time=4e-4),
    )
    stripe = np.minimum(np.arange(rows) * 3 // rows, 2).repeat(columns)
    pole = Obstacle.build(
        "capsule", ends=[[POLE, 0.0, 0.0], [POLE, TOP + 0.1, 0.0]], radius=0.025, friction=0.3
    )
    return Scene(
        name="flag",
        world=World(
            size=(2.6, 3.0, 2.0),
            up="y",
            mouse="blow",
            gravity=(0.0, -9.81, 0.0),
            dt=1 / 60,
            substeps="auto",
            ground=0.0,
            friction=0.5,
            more={
                "air": {"density": 1.2, "drag": 1.0, "lift": 0.6},
                "wind": {
                    "velocity": (wind, 0.0, 0.12 * wind),
                    "gust": gust,
                    "period": 1.5,
                    "seed": float(seed),
                },
            },
        ),
        particles=replace(particles, color=np.array(STRIPES, np.uint8)[stripe]),
        springs=springs,
        triangles=grid_triangles(columns, rows)[:, ::-1],  # its front is on our side
        obstacles=(pole,),
        stencils=grid_stencils(columns, rows, spacing, BENDING, across=across, down=down),
    )
