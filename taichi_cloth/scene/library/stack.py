"""Five sheets that fall on each other, each turned against the one below."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from taichi_cloth.scene.cloth import grid, grid_stencils, grid_triangles
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.scene.scatter import jittered
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.settings.parameters import Parameter

WIDTH, THICKNESS, APART = 0.5, 0.01, 0.1  # of the sheets; from one to the next at the start [m]
TURN, TILT = 18.0, 4.0  # of each against the one below; out of the horizontal [degrees]
MATERIAL = Material(density=0.3, thickness=THICKNESS, stretch=15.0, shear=4.0, damping_time=4e-4)
BENDING = 2e-5  # N m
COLORS = ((188, 62, 84), (236, 170, 72), (96, 176, 110), (70, 128, 190), (150, 92, 176))


def scene(
    *,
    side: Annotated[int, Parameter("particles along a side", minimum=3, maximum=256)] = 31,
    sheets: Annotated[int, Parameter("how many", minimum=1, maximum=50)] = 5,
    friction: Annotated[float, Parameter("Coulomb coefficient of the floor", minimum=0)] = 0.5,
    seed: Annotated[int, Parameter("of differences at the start; 0: none", minimum=0)] = 1,
) -> Scene:
    """Five sheets fall on each other and onto the floor; SI units."""
    spacing, middle = WIDTH / (side - 1), np.array([0.5, 0.0, 0.0])
    particles, springs, stencils = Particles.none(3), Springs.none(), Stencils.none()
    triangles: list[np.ndarray] = [np.zeros((0, 3), np.int64)]
    for number in range(sheets):
        across, down = _directions(number)
        height = APART * (1 + number)
        corner = middle + [0, height, 0] - WIDTH / 2 * (np.array(across) + down)
        nodes, ties = grid(
            corner.tolist(),
            side,
            side,
            spacing,
            links=("structural", "shear"),
            across=across,
            down=down,
            material=MATERIAL,
        )
        first = len(particles)
        color = np.tile(np.array(COLORS[number % len(COLORS)], np.uint8), (side * side, 1))
        bends = grid_stencils(side, side, spacing, BENDING, across=across, down=down, first=first)
        particles = particles.joined(replace(nodes, color=color))
        springs = springs.joined(replace(ties, between=ties.between + first))
        stencils = stencils.joined(bends)
        triangles.append(grid_triangles(side, side, first)[:, ::-1])  # its front is above
    return Scene(
        name="stack",
        world=World(
            size=(1.0, max(0.7, 0.2 + APART * sheets), 1.0),
            up="y",
            gravity=(0.0, -9.81, 0.0),
            dt=1 / 60,
            substeps="auto",
            mouse="blow",
            ground=0.0,
            friction=friction,
            more={"air": {"density": 1.2, "drag": 1.0, "lift": 0.2}},
        ),
        particles=jittered(particles, 0.1 * THICKNESS, seed),
        springs=springs,
        triangles=np.concatenate(triangles),
        stencils=stencils,
    )


def _directions(number: int) -> tuple[list[float], list[float]]:
    """Unit vectors along the rows and the columns of a sheet, which are at right angles."""
    turn, tilt = np.radians(TURN * number), np.radians(TILT) * (-1.0) ** number
    along = np.array([np.cos(turn), 0.0, np.sin(turn)])
    beside = [-np.sin(turn), 0.0, np.cos(turn)]
    return (np.cos(tilt) * along + [0.0, np.sin(tilt), 0.0]).tolist(), beside
