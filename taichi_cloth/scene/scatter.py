"""Random placement of particles that do not overlap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.scene.model import ParticleDefaults, Particles, World
from taichi_cloth.scene.palette import COLOR_CYCLE

# Velocities of spawned particles are drawn from these ranges [world units per unit of time].
VELOCITY_LOW = (-10.0, -10.0, 0.0)
VELOCITY_HIGH = (10.0, 0.0, 10.0)


def scattered(world: World, count: int, defaults: ParticleDefaults, seed: int) -> Particles:
    """`count` free particles inside `world`, none touching another or a wall.

    The world is cut into cubic cells at least one diameter wide; a random choice of the cells
    gets one particle each, at a random place inside its cell. Same seed, same particles.
    Raises InputError if that many do not fit.
    """
    rng = np.random.default_rng(seed)
    size, diameter = np.array(world.size), 2 * defaults.radius
    cell = _widest_cell(size, count)
    if cell < diameter:
        raise InputError(
            f"{count} particles of radius {defaults.radius:g} do not fit into the world of "
            f"{' x '.join(f'{length:g}' for length in size)}; "
            f"use a radius of {cell / 2:.3g} or less, or fewer particles"
        )
    cells = _cells_along(size, cell)
    index = np.unravel_index(rng.permutation(int(np.prod(cells)))[:count], cells)
    corner = world.low + (size - cells * cell) / 2
    jitter = rng.uniform(defaults.radius, cell - defaults.radius, (count, world.dim))
    return Particles.build(
        np.clip(corner + np.stack(index, axis=1) * cell + jitter, world.low, world.high),
        rng.uniform(VELOCITY_LOW[: world.dim], VELOCITY_HIGH[: world.dim], (count, world.dim)),
        defaults=defaults,
        color=np.array(COLOR_CYCLE)[np.arange(count) % len(COLOR_CYCLE)],
    )


def _cells_along(size: np.ndarray, cell: float) -> np.ndarray:
    # The allowance makes a cell that was computed as length / n fit n times despite round-off.
    return np.floor(size / cell * (1 + 1e-12)).astype(np.int64)


def _widest_cell(size: np.ndarray, count: int) -> float:
    """Edge of the largest cubic cell of which at least `count` fit into a box of `size`."""
    low, high = 0.0, float(size.min())
    if count <= np.prod(_cells_along(size, high)):
        return high
    for _ in range(60):  # bisection: the number that fits never grows with the edge
        middle = (low + high) / 2
        if np.prod(_cells_along(size, middle).astype(float)) >= count:
            low = middle
        else:
            high = middle
    return low


def jittered(particles: Particles, most: float, seed: int) -> Particles:
    """The free ones of `particles` moved at random, by at most `most` along each axis [length].

    Same seed, same particles; 0: none is moved. It makes runs of one scene differ.
    """
    if seed == 0:
        return particles
    rng = np.random.default_rng(seed)
    by = rng.uniform(-most, most, particles.position.shape)
    by[particles.fixed] = 0.0
    return replace(particles, position=particles.position + by)
