"""Depths of particles where they should not be: in obstacles, past walls, in each other."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.obstacles import CONTACTS
from taichi_cloth.scene.solids import ROUNDING, Solid, depths

TURN = 1.5  # frames: how long what bounces takes to come and go; forces make it more than one


def touches(scene: Scene, solids: Sequence[Solid]) -> bool:
    """True if particles of a scene can touch anything; solids: what is in its way."""
    return bool(scene.world.walls or scene.collides or solids)


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
    if scene.collides:
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
    _, overlap = _near_pairs(scene, x, free, 0.0)
    return float(overlap.max(initial=0.0))


def _near_pairs(
    scene: Scene, x: np.ndarray, free: np.ndarray, slack: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (p, 2) of which one is free and that may touch, and by how much each overlaps, (p,).

    slack: how far apart they may be to be among them [length].
    """
    from scipy.spatial import cKDTree

    thick, n = scene.thick, len(x)
    radius = scene.spheres.radius if thick else scene.particles.radius
    widest = 2.0 * radius.max(initial=0.0) + slack
    pairs = cKDTree(x).query_pairs(widest, output_type="ndarray")
    pairs = pairs[free[pairs].any(axis=1) & (radius[pairs] >= 0).all(axis=1)]
    i, j = pairs.T
    reach = radius[i] + radius[j]
    if thick and len(scene.spheres.other):  # pairs that started nearer keep what they started with
        spheres = scene.spheres
        nearer = np.repeat(np.arange(n), np.diff(spheres.start)) * n + spheres.other
        order = np.argsort(nearer)
        place = np.searchsorted(nearer[order], i * n + j).clip(max=len(nearer) - 1)
        known = nearer[order][place] == i * n + j
        reach = np.where(known, spheres.reach[order][place], reach)
    overlap: np.ndarray = reach - np.linalg.norm(x[i] - x[j], axis=1)
    return pairs, overlap


@dataclass(frozen=True)
class Moment:
    """Positions and velocities (n, dim) of a scene's particles at a time.

    gaps: of each thing in the way, once `touching` has asked: how far they are from it, and how
    fast they leave it, (n,) each.
    """

    x: np.ndarray
    v: np.ndarray
    time: float
    gaps: list[tuple[str, tuple[np.ndarray, np.ndarray]]] = field(default_factory=list, repr=False)


@dataclass(frozen=True)
class Touching:
    """Find what touches: each free particle and the thing that it touches, and pairs.

    things: {name of an obstacle, the ground or a wall: particles (k,)}; pairs: (p, 2).
    """

    things: Mapping[str, np.ndarray]
    pairs: np.ndarray


def touching(
    scene: Scene, solids: Sequence[Solid], now: Moment, before: Moment | None = None
) -> Touching:
    """Find what touches now, or is past what it touches, but for rounding in f32.

    before: a frame earlier; what bounced since then, and left, touches, too: it came, it goes, and
    both ways together take no more time than `TURN` frames. What turns by itself as near to a
    surface as that passes for it. Particles alone are looked at, not what sharp obstacles do to the
    triangles between them.
    """
    particles = scene.particles
    free, radius = ~particles.fixed, particles.radius
    slack = ROUNDING * (radius + functools.reduce(np.maximum, np.abs(now.x).T))
    for at in (now, before):
        if at is not None and not at.gaps:
            at.gaps.extend(_gaps(scene, solids, at))
    earlier = {} if before is None else dict(before.gaps)
    things: dict[str, np.ndarray] = {}
    for name, (gap, speed) in now.gaps:
        touched = gap <= slack
        if before is not None:
            touched |= _turned(*earlier[name], gap, speed, now.time - before.time)
        things.setdefault(name, np.flatnonzero(touched & free))
    pairs = np.zeros((0, 2), np.int64)
    if scene.collides:
        pairs = _touching_pairs(scene, now, before, slack)
    return Touching(things, pairs)


def _gaps(
    scene: Scene, solids: Sequence[Solid], at: Moment
) -> Iterator[tuple[str, tuple[np.ndarray, np.ndarray]]]:
    """Of each thing in the way: its name, how far particles are from it, how fast they leave it."""
    world, radius = scene.world, scene.particles.radius
    for solid in solids:
        distance, normal = solid.distances(at.x, at.time)
        of_surface = solid.velocities(at.x - solid.pose(at.time)[0], at.time)
        yield solid.name, (distance - radius, ((at.v - of_surface) * normal).sum(axis=1))
    for wall in world.walls if world.contact == CONTACTS[0] else ():
        axis, side = world.side(wall)
        bound = world.high[axis] if side > 0 else world.low[axis]
        yield f"{wall} wall", (side * (bound - at.x[:, axis]) - radius, -side * at.v[:, axis])


def _touching_pairs(
    scene: Scene, now: Moment, before: Moment | None, slack: np.ndarray
) -> np.ndarray:
    """The pairs (p, 2) that touch, of which one is free; pairs that rest do not bounce."""
    free, reach = ~scene.particles.fixed, 2.0 * float(slack.max(initial=0.0))
    bounces = before is not None and scene.world.contact == CONTACTS[0]
    bounces = bounces and not scene.thick
    if bounces and before is not None:
        fastest = np.linalg.norm(now.v, axis=1).max(initial=0.0)
        reach += 2.0 * float(fastest) * (now.time - before.time)
    near, overlap = _near_pairs(scene, now.x, free, reach)
    touched = overlap >= -slack[near].sum(axis=1)
    if bounces and before is not None:
        i, j = near.T

        def going(at: Moment) -> tuple[np.ndarray, np.ndarray]:
            d, apart = at.x[j] - at.x[i], np.linalg.norm(at.x[j] - at.x[i], axis=1)
            speed = ((at.v[j] - at.v[i]) * d).sum(axis=1) / np.where(apart > 0, apart, 1.0)
            return apart - scene.particles.radius[near].sum(axis=1), speed

        touched |= _turned(*going(before), *going(now), now.time - before.time)
    found: np.ndarray = np.sort(near[touched], axis=1)
    return found


def _turned(
    gap: np.ndarray, speed: np.ndarray, new_gap: np.ndarray, new_speed: np.ndarray, time: float
) -> np.ndarray:
    """Which of what came and now goes can have touched in between; speeds are those of leaving."""
    turned: np.ndarray = (speed < 0) & (new_speed > 0)
    which = np.flatnonzero(turned)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        taken = gap[which] / -speed[which] + new_gap[which] / new_speed[which]
    turned[which] = taken <= TURN * time
    return turned
