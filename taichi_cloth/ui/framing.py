"""The view of a scene when it opens."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.render.camera import Camera
from taichi_cloth.render.window_map import SCREEN, default_window
from taichi_cloth.scene.model import Scene, World
from taichi_cloth.settings import accepted
from taichi_cloth.ui.chrome.layout import NOTHING, Parts, arrange

SAMPLE = 500  # points among which the one farthest from what is held is sought
SAG = 0.35  # in lengths to what is held, at most: how deep hangs what is held all around
FILLED = 0.84  # share of the picture that what there is at the start may fill: it will move
FLAT = 0.1  # in its largest extent: what is lower is seen from higher up
FROM_ABOVE = 26.0  # degrees
NEAR = 1.3  # in radii of what is seen: an origin so near to its middle is seen, too
UP = np.array([0.0, 1.0, 0.0])


def points_up(world: World) -> bool:
    """True if the world's y points up."""
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
    """The camera that shows what a 3-D scene has at its start, and where that goes; None: 2-D.

    Obstacles go as they are told, what is held and nothing else holds swings down, and what is
    above a floor may fall there. Where y points down, or there is nothing yet, it shows the whole
    world.

    Raises InputError for what is no Scene.
    """
    if not isinstance(scene, Scene):
        raise InputError(f"camera_of: must be given a Scene, is {accepted.shown(scene)}")
    world, particles = scene.world, scene.particles
    if world.dim == 2 or not points_up(world) or not len(particles):
        return camera_of_world(world)
    x = particles.position
    seen = [x, *_bounded(scene)]
    if world.ground is not None:
        seen += [points * [1, 0, 1] + [0, world.ground, 0] for points in seen]
    elif particles.fixed.any() and world.gravity[1] < 0:
        seen += _hanging(x, x[particles.fixed])
    points, reach = np.concatenate(seen), float(particles.radius.max())
    ends = points.min(axis=0) - reach, points.max(axis=0) + reach
    camera = Camera.framing(world.size, *ends, y_up=True)
    if world.ground is None and np.ptp(x[:, 1]) < FLAT * np.ptp(x, axis=0).max():
        camera.rot_x = FROM_ABOVE
    if np.linalg.norm(camera.centre) < NEAR * camera.radius:
        points = np.concatenate([points, np.zeros((1, 3))])  # the axes' origin, drawn there
    camera.pose = camera.framed(points, reach, FILLED)
    return camera


def _hanging(points: np.ndarray, held: np.ndarray) -> list[np.ndarray]:
    """About where the points, (n, 3), may come to hang from those that are held, (k, 3).

    What lies beside what is held swings down by all of its distance; what lies between sags.
    """
    some, few = (a[:: max(1, len(a) // SAMPLE)] for a in (points, held))
    offset = some[:, None] - few
    nearest = np.linalg.norm(offset, axis=2).argmin(axis=1)
    away = np.linalg.norm(some - few[nearest], axis=1)
    across = some[:, [0, 2]]
    low, high = held[:, [0, 2]].min(axis=0), held[:, [0, 2]].max(axis=0)
    between = ((across > low) & (across < high)).all(axis=1)
    sags = some[between] - SAG * away[between, None] * UP
    hangs = few[nearest[~between]] - away[~between, None] * UP
    return [sags, hangs, (hangs + some[~between]) / 2]


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
    world: World,
    parts: Parts = NOTHING,
    screen: tuple[int, int] | None = None,
    worlds: int = 1,
) -> tuple[int, int]:
    """The window (width, height) in pixels that a world is shown in unless a size is given.

    parts: what is open around the world. screen: its size in pixels; None: nobody says it.
    worlds: how many are shown beside each other.
    A camera that frames what there is fills any window; all others keep the world's aspect.
    """
    framed = world.dim == 3 and (points_up(world) or Camera.original(world.size) is None)
    return default_window(
        None if framed else (worlds * world.size[0], *world.size[1:]),
        around=lambda height: height - arrange((height, height), parts).world.height,
        screen=screen or SCREEN,
    )
