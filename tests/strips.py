"""Strips of cloth that are clamped at one end, as grids and as meshes: for any precision."""

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.scene.cloth import grid, grid_stencils, grid_triangles
from taichi_cloth.scene.model import Scene, SpringDefaults, World
from taichi_cloth.scene.stencils import mesh_stencils
from taichi_cloth.simulation.simulation import Simulation

RIGIDITY, LENGTH, DENSITY = 2e-3, 1.0, 0.2  # N m, m, kg/m2


def strip(cells, rows=2, dim=3, load=0.0, stiffness=2e4, mesh=False):
    """A strip of cloth along x, clamped at x = 1, whose free part is LENGTH long.

    load: its weight per area, times LENGTH^3 over the rigidity. It acts along y, across the cloth.
    """
    spacing = LENGTH / cells
    columns, down = cells + 2, (0.0, 0.0, 1.0) if dim == 3 else None
    particles, springs = grid(
        (1.0 - spacing, 2.0, 0.0)[:dim],
        columns,
        rows,
        spacing,
        pinned=[(column, row) for column in (0, 1) for row in range(rows)],
        down=down,
        spring_defaults=SpringDefaults(stiffness=stiffness),
    )
    area = np.full((rows, columns), spacing**2)
    area[:, -1] /= 2
    area[[0, -1]] /= 1 if rows == 1 else 2
    particles.mass[:] = DENSITY * area.ravel()
    if mesh:
        stencils = mesh_stencils(particles.position, grid_triangles(columns, rows), RIGIDITY)
    else:
        stencils = grid_stencils(columns, rows, spacing, RIGIDITY, down=down)
    gravity = (0.0, load * RIGIDITY / (DENSITY * LENGTH**3), 0.0)[:dim]
    world = World((4.0, 4.0, 4.0)[:dim], gravity=gravity, dt=0.01)
    return Scene("strip", world, particles, springs, stencils=stencils)


def tips(cases, load):
    """Where the free ends of strips (mesh, method) of 8 cells come to rest: (along, down)."""
    found = []
    for mesh, method in cases:
        long = method == "implicit_euler"
        scene = strip(8, 2, load=load, stiffness=2.0, mesh=mesh).with_world(dt=5.0 if long else 0.5)
        scene.particles.viscous[:] = 2 * scene.particles.mass  # swings die away
        substeps, frames = (1, 40) if long else (200, 60)
        sim = Simulation(scene, method, substeps=substeps, topology="graph", execution="serial")
        sim.advance(frames)
        found.append(sim.positions().reshape(2, -1, 3)[:, -1, :2].mean(axis=0).tolist())
    return found


def tips_in(precision, cases, load):
    """The same in another precision: for a process of its own."""
    runtime.start("cpu", precision, threads=2)
    return tips(cases, load)
