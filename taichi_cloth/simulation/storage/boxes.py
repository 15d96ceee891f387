"""Boxes by the size of a world: the grid of collisions, and where walls are far."""

from __future__ import annotations

from typing import Any

import numpy as np

from taichi_cloth.kernels.collision_grid import ALONE, LARGER, MOST_BINS, MOST_LARGE, most_cells
from taichi_cloth.scene.model import Particles, World

Real = type[np.floating]  # the device's precision: np.float32 or np.float64


def collision_grid(world: World, radii: np.ndarray, thick: bool = False) -> dict[str, Any]:
    """The numbers of the collision grid (`kernels.collision_grid`), by the names of their fields.

    thick: whether a cloth has a thickness. Along rows a cell is at least as wide as the largest
    particle but for those few that are far larger, across them twice that: then few rows lie near
    a particle. The grid wraps around, so where the world has more cells than the container holds,
    it is made smaller: far particles then share a cell, at the cost of comparisons. Cells are wide
    enough that their coordinates are whole numbers of 32 bits.
    """
    size, count, most = np.array(world.size), len(radii), most_cells(len(radii), thick)
    largest = float(size.max())
    # Lists that are kept from step to step go by the largest of all.
    radius = float(radii.max(initial=0.0)) if thick or count <= ALONE else _usual(radii)
    # Points never meet: of cells as many as there may be.
    width = max(2.0 * radius or largest / most ** (1 / world.dim), largest / 2**24)
    widths = np.full(world.dim, 2.01 * width)
    widths[0] = width
    # About as many cells as fit into the world.
    bits = np.round(np.log2(np.maximum(size / widths, 1.0))).astype(int)
    widths = np.maximum(size / 2.0**bits, widths)
    while 2.0 ** bits.sum() > most:
        bits[bits.argmax()] -= 1
    if count <= ALONE:
        bits[:] = 0
    cells = int(bits.sum())
    bins = min(int(np.log2(max(count // 64, 1))), cells, int(np.log2(MOST_BINS)))
    return {
        "grid_bits": bits,
        "per_cell": 1.0 / widths,
        "bins": 2**bins,
        "bin_bits": cells - bins,
        "largest_radius": radius,
    }


def _usual(radii: np.ndarray) -> float:
    """The largest radius but for a few that are much larger than it."""
    most = min(MOST_LARGE + 1, len(radii))
    top = np.sort(np.partition(radii, len(radii) - most)[-most:])[::-1]
    falls = np.flatnonzero(top[1:] * LARGER <= top[:-1])
    return float(top[falls[-1] + 1] if len(falls) else top[0])


def inner_box(world: World, particles: Particles, real: Real) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner of where every particle is past no wall, each of shape (dim,).

    The largest radius and a few roundings lie between it and the walls: kernels compare positions
    with it before they ask exactly. Where particles are as large as the world it is inside out.
    """
    radius = particles.radius.max(initial=0.0)
    roundings = 4.0 * float(np.finfo(real).eps)
    at_low, at_high = (
        radius + roundings * (np.abs(corner) + radius) for corner in (world.low, world.high)
    )
    return world.low + at_low, world.high - at_high
