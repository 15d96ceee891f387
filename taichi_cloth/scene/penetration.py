"""How deep particles are where they should not be: in obstacles, past walls, in each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.solids import Solid, depths


def touches(scene: Scene, solids: Sequence[Solid]) -> bool:
    """Whether particles of a scene can touch anything; solids: what is in its way."""
    return bool(scene.world.walls or scene.features().collisions or solids)


def deepest(scene: Scene, solids: Sequence[Solid], x: np.ndarray, time: float) -> float:
    """The deepest penetration of a free particle at x (n, dim) [length]; 0 where there is none.

    Into obstacles and the ground, past walls, and what a pair that collides overlaps by: of cloths
    with a thickness the spheres by which they keep apart.
    """
    world, particles = scene.world, scene.particles
    free, radius = ~particles.fixed, particles.radius
    found = [0.0]
    if free.any():
        found.append(float(depths(solids, x[free], radius[free], time).max()))
        for wall in world.walls:
            axis, side = world.side(wall)
            bound = world.high[axis] if side > 0 else world.low[axis]
            found.append(float((radius + side * (x[:, axis] - bound))[free].max()))
    if scene.features().collisions:
        found.append(_deepest_pair(scene, x, free))
    return max(found)


def overlapping(scene: Scene) -> np.ndarray:
    """The pairs (k, 2) of particles that would overlap at the start, if all collided."""
    from scipy.spatial import cKDTree

    x, radius, free = scene.particles.position, scene.particles.radius, ~scene.particles.fixed
    pairs = cKDTree(x).query_pairs(2.0 * radius.max(initial=0.0), output_type="ndarray")
    i, j = pairs.T
    near = np.linalg.norm(x[i] - x[j], axis=1) < radius[i] + radius[j]
    found: np.ndarray = pairs[near & free[pairs].any(axis=1)]
    return found


def _deepest_pair(scene: Scene, x: np.ndarray, free: np.ndarray) -> float:
    """The largest overlap of two particles of which one is free."""
    from scipy.spatial import cKDTree

    thick, n = scene.features().thick, len(x)
    radius = scene.spheres.radius if thick else scene.particles.radius
    pairs = cKDTree(x).query_pairs(2.0 * radius.max(initial=0.0), output_type="ndarray")
    i, j = pairs[free[pairs].any(axis=1) & (radius[pairs] >= 0).all(axis=1)].T
    reach = radius[i] + radius[j]
    if thick and len(scene.spheres.other):  # pairs that started nearer keep what they started with
        spheres = scene.spheres
        nearer = np.repeat(np.arange(n), np.diff(spheres.start)) * n + spheres.other
        order = np.argsort(nearer)
        place = np.searchsorted(nearer[order], i * n + j).clip(max=len(nearer) - 1)
        known = nearer[order][place] == i * n + j
        reach = np.where(known, spheres.reach[order][place], reach)
    overlap = reach - np.linalg.norm(x[i] - x[j], axis=1)
    return float(overlap.max(initial=0.0))
