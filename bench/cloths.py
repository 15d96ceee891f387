"""The cloths that contestants simulate, as scenes of ours."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from taichi_cloth.files.meshes.surface import Surface
from taichi_cloth.scene.cloth import grid, grid_triangles
from taichi_cloth.scene.library import build
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.mesh import stiffness_by_shape
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.scene.obstacles import Obstacle

# The scene `warp` as Warp's benchmark takes it (warp/examples/benchmarks/benchmark_cloth.py).
WARP = "taichi_cloth.scene.library.warp:scene"
WARP_FRAME, WARP_SUBSTEPS = 1 / 60, 16

# The structural cloth is advanced in frames of this many steps of 1, its scene's unit of time.
STRUCTURAL_SUBSTEPS = 16
STRUCTURAL_FRAME: dict[str, Any] = {
    "dt": float(STRUCTURAL_SUBSTEPS),
    "substeps": STRUCTURAL_SUBSTEPS,
}
STRUCTURAL_SCENE = "bench.cloths:structural"

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


def draping(side: int, upright: bool = False) -> Scene:
    """A sheet of 1 m with a thickness, `side` x `side`, that eight steps of 1/480 s can take.

    It falls onto a sphere, or upright onto the ground, where it crumples. Gravity falls with the
    square of `side`, as its stiffness does, so that it stretches as much at every size.
    """
    spacing, finer = 1.0 / (side - 1), (128 / side) ** 2
    material = Material(
        density=3.0, thickness=0.004, stretch=12 * finer, shear=2 * finer, damping_time=4e-4
    )
    particles, springs = grid(
        (1.0, 0.75, -0.5),
        side,
        side,
        spacing,
        links=("structural", "shear"),
        across=(1.0, 0.0, 0.0),
        down=(0.0, 0.0, 1.0),
        material=material,
    )
    jitter = np.random.default_rng(1).uniform(-1e-3, 1e-3, particles.position.shape) * spacing
    position = particles.position + jitter
    if upright:
        height = position[:, 2] + 0.5
        position[:, 1], position[:, 2] = 0.05 + height, 0.02 * np.sin(9 * height)
    sphere = Obstacle.build("sphere", centre=[1.5, 0.4, 0.0], radius=0.25, friction=0.3)
    return Scene(
        name="draping",
        world=World(
            size=(3.0, 3.0, 3.0),
            gravity=(0.0, -1.5 * finer, 0.0),
            dt=1 / 60,
            ground=0.0,
            friction=0.3,
            up="y",
            contact="resting",
        ),
        particles=replace(particles, position=position),
        springs=springs,
        triangles=grid_triangles(side, side),
        obstacles=() if upright else (sphere,),
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
