"""The cloths that contestants simulate, as scenes of ours."""

from __future__ import annotations

from typing import Any

import numpy as np

from taichi_cloth.files.meshes.surface import Surface
from taichi_cloth.scene.cloth import grid_triangles
from taichi_cloth.scene.library import build
from taichi_cloth.scene.mesh import stiffness_by_shape
from taichi_cloth.scene.model import Particles, Scene, Springs, World

# The scene `warp` as Warp's benchmark takes it (warp/examples/benchmarks/benchmark_cloth.py).
WARP = "taichi_cloth.scene.library.warp:scene"
WARP_FRAME, WARP_SUBSTEPS = 1 / 60, 16

# The structural cloth is advanced in frames of this many steps of 1, its scene's unit of time.
STRUCTURAL_SUBSTEPS = 16
STRUCTURAL_FRAME: dict[str, Any] = {
    "dt": float(STRUCTURAL_SUBSTEPS),
    "substeps": STRUCTURAL_SUBSTEPS,
}

# A sheet of triangles, 1 m x 1 m: of cotton; a step is this time divided by its vertices in a row.
SHEET_DENSITY, SHEET_STRETCH, SHEET_STEP = 0.15, 80.0, 0.005

# The function that makes a scene, "module:name", and its arguments.
SceneCall = tuple[str, dict[str, Any]]


def structural(columns: int, rows: int) -> Scene:
    """The scene `cloth` without walls, fracture and mouse, disturbed by velocities of 0.3.

    Pins and gravity are those of the first program in any size, as contestants have them.
    """
    full = build("cloth", columns=columns, rows=rows, pins=3, gravity=0.05)
    velocity = np.random.default_rng(0).normal(0, 0.3, full.particles.velocity.shape)
    full.particles.velocity[:] = np.where(full.particles.fixed[:, None], 0.0, velocity)
    springs = full.springs
    return Scene(
        name="structural",
        world=full.with_world(mouse="none", walls=()).world,
        particles=full.particles,
        springs=Springs.build(
            springs.between,
            full.particles.position,
            stiffness=springs.stiffness,
            rest_length=springs.rest_length,
        ),
    )


def sheet(side: int, order: str = "shuffled") -> Scene:
    """A sheet of triangles in space, held at two corners: some `side` x `side` vertices, jittered.

    order: of the vertices' numbers: "rows" of the sheet, or "shuffled", as no mesh is worse.
    """
    rng = np.random.default_rng(0)
    h = 1.0 / (side - 1)
    row, column = np.divmod(np.arange(side * side), side)
    flat = np.stack([column * h, row * h], axis=1) + rng.uniform(-0.2 * h, 0.2 * h, (side**2, 2))
    position = np.column_stack([0.5 + flat[:, 0], 0.5 + flat[:, 1], np.zeros(side**2)])
    velocity = np.asarray(rng.normal(0, 0.05, position.shape))
    triangles = grid_triangles(side, side)
    fixed = (row == side - 1) & ((column == 0) | (column == side - 1))
    if order == "shuffled":
        where = rng.permutation(side * side)
        number = np.argsort(where)
        position, velocity, fixed = position[where], velocity[where], fixed[where]
        triangles = number[triangles]
    none = np.zeros((0, 4), np.int64), np.zeros((0, 2), np.int64)
    surface = Surface(position, triangles, *none)
    between, shares = stiffness_by_shape(surface, position)
    mass = SHEET_DENSITY / side**2
    return Scene(
        name="sheet",
        world=World(size=(2.0, 2.0, 2.0), gravity=(0.0, -9.81, 0.0), dt=SHEET_STEP / side),
        particles=Particles.build(
            position, np.where(fixed[:, None], 0.0, velocity), fixed=fixed, mass=mass, radius=0.0,
            viscous=0.1 * mass,
        ),
        springs=Springs.build(between, position, stiffness=SHEET_STRETCH * shares),
        triangles=triangles,
    )  # fmt: skip
