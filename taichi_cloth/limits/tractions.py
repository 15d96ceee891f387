"""Forces on triangles in NumPy: what they give particles, and their shares of K and C."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from taichi_cloth.kernels import forces
from taichi_cloth.kernels.forces.contract import TRACTION, has
from taichi_cloth.scene.model import World
from taichi_cloth.scene.triangles import area_vectors, at_corners

SMALL = 1e-6  # part of a speed by which it is changed for a derivative


def _terms() -> Iterator[Any]:
    found = (forces.load(name) for name in forces.TERMS)
    return (term for term in found if term.adds == TRACTION)


def present(world: World) -> bool:
    """True if a scene in this world could have forces on triangles: one in space that asks."""
    return world.dim == 3 and any(
        key.name in world.more for term in _terms() if has(term.keys) for key in term.keys
    )


def mean_velocities(v: np.ndarray, triangles: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """The mean velocity of each triangle's corners (m, 3) by their shares (m, 3); v: (n, 3)."""
    mean: np.ndarray = (v[triangles] * shares[:, :, None]).sum(axis=1)
    return mean


def forces_on_particles(
    x: np.ndarray,
    v: np.ndarray,
    time: float,
    world: World,
    triangles: np.ndarray,
    shares: np.ndarray,
) -> np.ndarray:
    """The sum of all forces on triangles at x with v (n, 3), as particles get it, (n, 3).

    triangles: (m, 3), those that are whole; shares: (m, 3), `corner_shares` at the scene's start.
    """
    if len(triangles) == 0 or not present(world):
        return np.zeros_like(x)
    area, mean = area_vectors(x, triangles), mean_velocities(v, triangles, shares)
    force = sum(term.twin(area, mean, time, world) for term in _terms() if has(term.twin))
    return at_corners(shares[:, :, None] * np.asarray(force)[:, None, :], triangles, len(x))


def bounds(
    x: np.ndarray, v: np.ndarray, world: World, triangles: np.ndarray, shares: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds on the stiffness and damping of each particle by its triangles, (n,) each.

    Diagonal matrices that are at least those of all triangles, whatever way these are turned.
    """
    stiffness, damping = np.zeros(len(x)), np.zeros(len(x))
    if len(triangles) == 0 or not present(world):
        return stiffness, damping
    mean = mean_velocities(v, triangles, shares)
    for term in _terms():
        if has(term.bound):
            k, c = term.bound(x[triangles], mean, world)
            # Each corner's force depends on the position of all three.
            stiffness += at_corners(shares * 3.0 * k[:, None], triangles, len(x))
            damping += at_corners(shares * c[:, None], triangles, len(x))
    return stiffness, damping


def damping_blocks(
    x: np.ndarray, v: np.ndarray, world: World, triangles: np.ndarray, shares: np.ndarray
) -> np.ndarray:
    """-df/dv of the force on each triangle by its mean velocity, the symmetric part, (m, 3, 3).

    It is what takes energy. In the strongest wind; by differences of the forces' twins.
    """
    blocks = np.zeros((len(triangles), 3, 3))
    if len(triangles) == 0 or not present(world):
        return blocks
    area, mean = area_vectors(x, triangles), mean_velocities(v, triangles, shares)
    world = at_their_strongest(world)
    for term in _terms():
        if not has(term.twin):
            continue
        h = SMALL * (np.abs(mean).max(initial=0.0) + _speed_known(term, x[triangles], world))
        for way in h * np.eye(3):
            slower, faster = (term.twin(area, mean + s * way, 0.0, world) for s in (-1, 1))
            blocks += ((slower - faster) / (2 * h * h))[:, :, None] * way
    symmetric: np.ndarray = (blocks + blocks.transpose(0, 2, 1)) / 2
    return symmetric


def _speed_known(term: Any, corners: np.ndarray, world: World) -> float:
    """A speed that a force's share of the limit knows of, such as that of the wind; else 1."""
    at_rest = np.zeros((len(corners), 3))
    still = np.max(term.bound(corners, at_rest, world)[1], initial=0.0)
    moving = np.max(term.bound(corners, at_rest + np.eye(3)[0], world)[1], initial=0.0)
    return float(still / (moving - still)) or 1.0 if moving > still else 1.0


def at_their_strongest(world: World) -> World:
    """A world in which what changes with time is constantly at its strongest."""
    for term in _terms():
        if has(term.steady):
            world = term.steady(world)
    return world


def without(world: World) -> World:
    """A world without the keys of forces on triangles."""
    keys = {key.name for term in _terms() if has(term.keys) for key in term.keys}
    if not keys & world.more.keys():
        return world
    return replace(world, more={name: v for name, v in world.more.items() if name not in keys})
