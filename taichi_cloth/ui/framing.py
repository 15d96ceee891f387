"""Where a scene is looked at from when it opens."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from taichi_cloth.scene.model import Scene, World
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.chrome.layout import NOTHING, Parts, arrange
from taichi_cloth.ui.window_map import SCREEN, default_window

SAMPLE = 500  # points among which the one farthest from what is held is sought
SAG = 0.35  # in lengths to what is held, at most: how deep hangs what is held all around
MARGIN = 0.08  # room around what there is at the start, in its largest extent


def points_up(world: World) -> bool:
    """Whether the world's y points up."""
    return world.up == "y"


def camera_of_world(world: World) -> Camera | None:
    """The camera that shows the whole of a 3-D world; None: it is 2-D.

    It is the original program's where that sees a world whose y points down.
    """
    if world.dim == 2:
        return None
    y_up = points_up(world)
    original = None if y_up else Camera.original(world.size)
    return original or Camera.framing(world.size, world.low, world.high, y_up=y_up)


def camera_of(scene: Scene) -> Camera | None:
    """The camera that shows what a 3-D scene has at its start, and where obstacles go; None: 2-D.

    Where y points down, or there is nothing yet, it shows the whole world.
    """
    world, particles = scene.world, scene.particles
    if world.dim == 2 or not points_up(world) or not len(particles):
        return camera_of_world(world)
    x, radius = particles.position, particles.radius[:, None]
    low, high = (x - radius).min(axis=0), (x + radius).max(axis=0)
    for points in _bounded(scene):
        low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    if world.ground is not None:
        low[1] = min(low[1], world.ground)
    largest = float((high - low).max())
    if world.ground is None and particles.fixed.any() and world.gravity[1] < 0:
        # What is held may come to hang from there.
        held = x[particles.fixed]
        low[1] = min(low[1], held[:, 1].max() - _deepest(x, held))
    room = MARGIN * largest
    return Camera.framing(world.size, low - room, high + room, y_up=True)


def _deepest(points: np.ndarray, held: np.ndarray) -> float:
    """About how far below what is held the points, both (n, 3), may come to hang.

    What lies beside what is held swings down by all of its distance; what lies between sags.
    """
    some, few = (a[:: max(1, len(a) // SAMPLE)] for a in (points, held))
    away = np.linalg.norm(some[:, None] - few, axis=2).min(axis=1)
    across = some[:, [0, 2]]
    low, high = held[:, [0, 2]].min(axis=0), held[:, [0, 2]].max(axis=0)
    between = ((across > low) & (across < high)).all(axis=1)
    return float(np.where(between, SAG * away, away).max())


def _bounded(scene: Scene) -> Iterator[np.ndarray]:
    """Points (k, 3) of each obstacle that has an end, where it is at time 0 and where it stops."""
    if scene.obstacles:
        from taichi_cloth.scene.solids import solids, surface

        for solid in solids(scene):
            if solid.shape != "plane":
                points = surface(solid, 1.0)[0]
                for time in (0.0, solid.stops if np.isfinite(solid.stops) else 0.0):
                    centre, turn = solid.pose(time)
                    yield centre + points @ turn.T


def window_of(
    world: World, parts: Parts = NOTHING, screen: tuple[int, int] | None = None
) -> tuple[int, int]:
    """The window (width, height) in pixels that a world is shown in unless a size is given.

    parts: what is open around the world. screen: its size in pixels; None: nobody says it.
    A camera that frames what there is fills any window; all others keep the world's aspect.
    """
    framed = world.dim == 3 and (points_up(world) or Camera.original(world.size) is None)
    return default_window(
        None if framed else world.size,
        around=lambda height: height - arrange((height, height), parts).world.height,
        screen=screen or SCREEN,
    )
