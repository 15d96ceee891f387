"""A strip that two bars turn by its ends, until it is a rope that coils around itself."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from taichi_cloth.scene.cloth import grid, grid_stencils, grid_triangles
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import Scene, World
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.scene.scatter import jittered
from taichi_cloth.settings.parameters import Parameter

LENGTH, WIDTH, THICKNESS, HEIGHT = 1.6, 0.2, 0.006, 0.5  # of the strip; of its middle [m]
BAR, GAP = 0.02, 0.012  # radius of the bars; from their surfaces to the strip [m]
BENDING = 2e-5  # N m
COLORS = ((226, 120, 52), (60, 140, 176))  # of its two halves


def scene(
    *,
    columns: Annotated[int, Parameter("particles along it", minimum=17, maximum=1025)] = 81,
    turns: Annotated[float, Parameter("of one end against the other")] = 4.0,
    seconds: Annotated[float, Parameter("that turning takes", unit="s", above=0)] = 8.0,
    contraction: Annotated[
        float,
        Parameter("part of its length by which its ends come closer", minimum=0, maximum=0.5),
    ] = 0.1,
    seed: Annotated[int, Parameter("of differences at the start; 0: none", minimum=0)] = 1,
) -> Scene:
    """A strip is turned by its ends four times, and coils up; SI units."""
    spacing = LENGTH / (columns - 1)
    rows = 1 + round(WIDTH / spacing)
    wide = (rows - 1) * spacing
    left = 0.4
    across, down = (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)
    particles, springs = grid(
        (left, HEIGHT + wide / 2, 0.0),
        columns,
        rows,
        spacing,
        pinned=[(column, row) for column in (0, columns - 1) for row in range(rows)],
        links=("structural", "shear"),
        across=across,
        down=down,
        material=Material(
            density=0.2, thickness=THICKNESS, stretch=60.0, shear=10.0, damping_time=1e-4
        ),
    )
    half = (np.arange(rows) * 2 // rows).repeat(columns)
    bars = []
    for x, side in ((left, -1.0), (left + LENGTH, 1.0)):
        at = x + side * (BAR + GAP)
        bars.append(
            Obstacle.build(
                "capsule",
                ends=[[at, HEIGHT - 0.6 * wide, 0.0], [at, HEIGHT + 0.6 * wide, 0.0]],
                radius=BAR,
                grip=1.5 * GAP,
                spin=[side * 180.0 * turns / seconds, 0.0, 0.0],
                velocity=[-0.5 * side * contraction * LENGTH / seconds, 0.0, 0.0],
                stops=seconds,
            )
        )
    return Scene(
        name="twist",
        world=World(
            size=(LENGTH + 2 * left, 1.2, 1.0),
            up="y",
            gravity=(0.0, -9.81, 0.0),
            dt=1 / 60,
            substeps="auto",
            mouse="blow",
            ground=0.0,
            friction=0.5,
            more={"air": {"density": 1.2, "drag": 1.0, "lift": 0.2}},
        ),
        particles=jittered(
            replace(particles, color=np.array(COLORS, np.uint8)[half]), 0.1 * THICKNESS, seed
        ),
        springs=springs,
        triangles=grid_triangles(columns, rows)[:, ::-1],  # its front is on our side
        obstacles=tuple(bars),
        stencils=grid_stencils(columns, rows, spacing, BENDING, across=across, down=down),
    )
