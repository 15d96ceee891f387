"""A curtain on a rail: it hangs in folds from its rings, flies in the wind, and gusts tear it.

The fabric is rotten, and gusts tear it off its rings; only on the right its hem was sewn anew, and
holds.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from taichi_cloth.scene.cloth import grid, grid_stencils, grid_triangles
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import ParticleDefaults, Scene, World
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.settings.parameters import Parameter

WIDTH, TOP, FULLNESS = 1.8, 2.4, 1.5  # of the rail; its height [m]; cloth a width of rail
SEWN, HEM = 0.55, 3  # from this part of its width on the hem holds; rows of the hem
BENDING = 1e-5  # N m, of cotton
COLOR = (70, 128, 168)


def scene(
    *,
    columns: Annotated[int, Parameter("particles along the rail", minimum=9, maximum=1024)] = 49,
    wind: Annotated[float, Parameter("its mean velocity", unit="m/s", minimum=0)] = 3.0,
    gust: Annotated[float, Parameter("relative change of the wind", minimum=0)] = 0.6,
    strength: Annotated[
        float,
        Parameter("pull on a width that tears it; inf: none", unit="N/m", above=0, infinite=True),
    ] = 85.0,
    seed: Annotated[int, Parameter("of the gusts", minimum=0)] = 3,
) -> Scene:
    """A curtain on a rail, in a wind that tears it; SI units."""
    spacing = WIDTH * FULLNESS / (columns - 1)
    rows = 1 + round(2.1 / spacing)
    folds = max(2, (columns - 1) // 8)
    rings = [(round(i * (columns - 1) / folds), 0) for i in range(folds + 1)]
    across, down = (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)
    particles, springs = grid(
        (0.4, TOP, 0.0),
        columns,
        rows,
        spacing,
        pinned=rings,
        links=("structural", "shear"),
        across=across,
        down=down,
        break_in="tension",
        particle_defaults=ParticleDefaults(radius=0.002),
        material=Material(
            density=0.2,
            stretch=300.0,
            shear=15.0,
            damping_time=4e-4,
            strength=None if np.isinf(strength) else strength,
        ),
    )
    row, column = np.divmod(springs.between, columns)
    sewn = ((row < HEM) & (column >= SEWN * columns)).all(axis=1)
    springs = replace(springs, break_force=np.where(sewn, np.inf, springs.break_force))
    along, deep = folded(columns, folds)
    position = particles.position.copy()
    position[:, 0] = 0.4 + np.tile(along, rows)
    position[:, 2] = np.tile(deep, rows)
    rail = Obstacle.build(
        "capsule", ends=[[0.3, TOP + 0.04, 0.0], [0.5 + WIDTH, TOP + 0.04, 0.0]], radius=0.018
    )
    return Scene(
        name="curtain",
        world=World(
            size=(2.6, 2.8, 4.0),
            up="y",
            mouse="blow",
            gravity=(0.0, -9.81, 0.0),
            dt=1 / 60,
            substeps="auto",
            ground=0.0,
            friction=0.5,
            more={
                "air": {"density": 1.2, "drag": 1.0, "lift": 0.4},
                "wind": {
                    "velocity": (0.0, 0.0, -wind),
                    "gust": gust,
                    "period": 2.5,
                    "seed": float(seed),
                },
            },
        ),
        particles=replace(
            particles,
            position=position,
            color=np.tile(np.array(COLOR, np.uint8), (len(position), 1)),
        ),
        springs=springs,
        triangles=grid_triangles(columns, rows)[:, ::-1],  # its front is on our side
        obstacles=(rail,),
        stencils=grid_stencils(columns, rows, spacing, BENDING, across=across, down=down),
    )


def folded(columns: int, folds: int) -> tuple[np.ndarray, np.ndarray]:
    """Places of a row of particles along the rail and in depth, (columns,) each [m].

    It goes to and fro by angles like a sine, so that it is as long as the cloth is.
    """
    phase = np.pi * folds * (np.arange(columns - 1) + 0.5) / (columns - 1)
    low, high = 0.0, np.pi / 2
    for _ in range(50):  # the angle at which the row is as wide as the rail
        angle = (low + high) / 2
        wide = np.cos(angle * np.sin(phase)).mean() > 1 / FULLNESS
        low, high = (angle, high) if wide else (low, angle)
    step = WIDTH * FULLNESS / (columns - 1)
    along = np.concatenate([[0.0], np.cumsum(step * np.cos(angle * np.sin(phase)))])
    deep = np.concatenate([[0.0], np.cumsum(step * np.sin(angle * np.sin(phase)))])
    return along, deep - deep.mean()
