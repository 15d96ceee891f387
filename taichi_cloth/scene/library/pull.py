"""A table cloth that a bar draws from under four plates, so fast that they stay on the table.

The plates are of balls, tied to each other, with a larger ball on each.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from taichi_cloth.scene.cloth import grid, grid_stencils, grid_triangles
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.scene.scatter import jittered
from taichi_cloth.settings.parameters import Parameter

TABLE, TOP, DEEP = (0.4, 1.4), 0.72, 0.38  # from left to right; its top; half its depth [m]
LENGTH, WIDTH, THICKNESS, OVER = 1.02, 0.66, 0.006, 0.12  # of the cloth; beyond the table [m]
BAR, GAP = 0.02, 0.01  # radius of the bar; from its surface to the cloth [m]
WAY, BEGINS = 1.06, 0.4  # how far the bar goes [m]; when it begins [s]
BENDING = 2e-5  # N m
BALL, FRUIT, RINGS = 0.025, 0.05, 2  # radii [m]; rings of balls around the middle one of a plate
PLATES = ((0.66, -0.17), (0.66, 0.17), (1.06, -0.17), (1.06, 0.17))  # x, z of their middles [m]
CLOTH, PLATE = (200, 66, 76), (226, 226, 232)
FRUITS = ((236, 170, 72), (124, 176, 66), (214, 92, 60), (150, 92, 176))


def scene(
    *,
    columns: Annotated[int, Parameter("particles along the cloth", minimum=9, maximum=513)] = 35,
    speed: Annotated[float, Parameter("of the bar", unit="m/s", above=0)] = 2.5,
    friction: Annotated[
        float, Parameter("Coulomb coefficient of all that touches", minimum=0)
    ] = 0.15,
    seed: Annotated[int, Parameter("of differences at the start; 0: none", minimum=0)] = 1,
) -> Scene:
    """A table cloth is drawn from under plates of balls, which stay; SI units."""
    spacing = LENGTH / (columns - 1)
    rows = 1 + round(WIDTH / spacing)
    across, down = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    end = TABLE[1] + OVER
    cloth, springs = grid(
        (end - LENGTH, TOP + 0.6 * THICKNESS, -(rows - 1) * spacing / 2),
        columns,
        rows,
        spacing,
        pinned=[(columns - 1, row) for row in range(rows)],
        links=("structural", "shear"),
        across=across,
        down=down,
        material=Material(
            density=0.5, thickness=THICKNESS, stretch=150.0, shear=15.0, damping_time=1e-4
        ),
    )
    # Above the cloth, whose particles keep off others by half of what their spacing asks for.
    high = TOP + 0.6 * THICKNESS + max(THICKNESS, 1.25 * spacing) / 2 + BALL
    particles = replace(cloth, color=np.tile(np.array(CLOTH, np.uint8), (len(cloth), 1)))
    for (x, z), color in zip(PLATES, FRUITS, strict=True):
        balls, ties = _plate(np.array([x, high, z]), color)
        springs = springs.joined(replace(ties, between=ties.between + len(particles)))
        particles = particles.joined(balls)
    left, right = TABLE
    table = Obstacle.build(
        "box",
        centre=[(left + right) / 2, TOP / 2, 0.0],
        half=[(right - left) / 2, TOP / 2, DEEP],
        friction=friction,
    )
    at, wide = end + GAP + BAR, 0.55 * (rows - 1) * spacing
    bar = Obstacle.build(
        "capsule",
        ends=[[at, TOP + THICKNESS / 2, -wide], [at, TOP + THICKNESS / 2, wide]],
        radius=BAR,
        grip=1.5 * GAP,
        velocity=[speed, 0.0, 0.0],
        starts=BEGINS,
        stops=BEGINS + WAY / speed,
    )
    return Scene(
        name="pull",
        world=World(
            size=(3.4, 1.6, 1.6),
            up="y",
            gravity=(0.0, -9.81, 0.0),
            dt=1 / 60,
            substeps="auto",
            mouse="blow",
            ground=0.0,
            friction=friction,
            collisions=True,
            contact="resting",
            more={"air": {"density": 1.2, "drag": 1.0, "lift": 0.2}},
        ),
        particles=jittered(particles, 0.1 * THICKNESS, seed),
        springs=springs,
        triangles=grid_triangles(columns, rows)[:, ::-1],  # its front is above
        obstacles=(table, bar),
        stencils=grid_stencils(columns, rows, spacing, BENDING, across=across, down=down),
    )


def _plate(middle: np.ndarray, color: tuple[int, int, int]) -> tuple[Particles, Springs]:
    """Balls in a hexagon around `middle`, tied to those around them, and a larger one on them."""
    apart, number = 2.05 * BALL, np.arange(-RINGS, RINGS + 1)
    a, b = (of.ravel() for of in np.meshgrid(number, number))
    a, b = a[np.abs(a + b) <= RINGS], b[np.abs(a + b) <= RINGS]
    flat = apart * np.column_stack([a + b / 2, np.zeros(len(a)), b * np.sqrt(0.75)])
    near = np.linalg.norm(flat[:, None] - flat, axis=2)
    pairs = np.argwhere(np.triu((near > 0) & (near < 2.01 * apart)))
    springs = Springs.build(pairs, flat, stiffness=300.0, damping=0.05)
    # The larger one lies in the hollow between three.
    hollow = apart / np.sqrt(3)
    high = np.sqrt((BALL + FRUIT) ** 2 - hollow**2)
    fruit = [0.0, high, hollow]
    return Particles.build(
        middle + np.vstack([flat, fruit]),
        mass=[0.004] * len(flat) + [0.02],
        radius=[BALL] * len(flat) + [FRUIT],
        restitution=0.0,
        color=[PLATE] * len(flat) + [color],
    ), springs
