"""What is under the pointer: the particle that one means, and the springs that a path crosses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.window_map import WindowMap

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

NEAR = 12.0  # pixels from a particle at which one still means it
# The same in a plane, where a press beside all particles means nothing else: a cell of a cloth.
NEAR_IN_PLANE = 40.0


def seen(
    points: np.ndarray, camera: Camera | None, window: WindowMap
) -> tuple[np.ndarray, np.ndarray]:
    """Where points (n, dim) are in the window, (n, 2) pixels, and how deep, (n,); 0 in a plane.

    A depth of 0 or less is behind the eye: its pixel is NaN.
    """
    if camera is None:
        return window.to_window(points), np.zeros(len(points))
    pixels, _, depth = camera.project(points)
    places = window.to_window(pixels)
    places[~(depth > 0)] = np.nan
    return places, np.where(depth > 0, depth, np.inf)


def particle_at(
    sim: Simulation,
    camera: Camera | None,
    window: WindowMap,
    pixel: np.ndarray,
    among: np.ndarray | None = None,
    near: float = NEAR,
) -> int | None:
    """The particle that a click at a pixel (2,) means; None: it means empty space.

    Where the pixel is in a surface, it is the nearest corner of the triangle in front. Else it is
    the nearest of those whose disc the pixel is in, or which are `near`; of discs the one in front.
    among: (n,) bool, those that may be meant; None: all. near: pixels.
    """
    x = sim.positions()
    if len(x) == 0:
        return None
    places, depth = seen(x, camera, window)
    corners = _triangle_at(sim, places, depth, pixel) if camera else None
    away = np.linalg.norm(places - pixel, axis=1)
    away[~np.isfinite(away)] = np.inf
    if among is not None:
        away[~among] = np.inf
    if corners is not None and np.isfinite(away[corners]).any():
        return int(corners[away[corners].argmin()])
    radius = sim.radii() * window.scale
    if camera:
        radius = radius * camera.focal_length / depth
    inside = away <= radius
    if inside.any() and camera:
        return int(np.where(inside, depth, np.inf).argmin())
    nearest = int(away.argmin())
    return nearest if away[nearest] <= max(near, radius[nearest]) else None


def _triangle_at(
    sim: Simulation, places: np.ndarray, depth: np.ndarray, pixel: np.ndarray
) -> np.ndarray | None:
    """The corners (3,) of the triangle in front at a pixel; None: there is none."""
    triangles = sim.drawn_triangles()
    if len(triangles) == 0:
        return None
    a, b, c = places[triangles].transpose(1, 0, 2)
    sides = np.stack([_side(a, b, pixel), _side(b, c, pixel), _side(c, a, pixel)])
    with np.errstate(invalid="ignore"):
        inside = (sides >= 0).all(axis=0) | (sides <= 0).all(axis=0)
    hit = np.flatnonzero(inside)
    if len(hit) == 0:
        return None
    front: np.ndarray = triangles[hit[depth[triangles[hit]].mean(axis=1).argmin()]]
    return front


def _side(a: np.ndarray, b: np.ndarray, point: np.ndarray) -> np.ndarray:
    """On which side of the lines from a to b points lie: twice the area of the triangle."""
    d, e = b - a, point - a
    side: np.ndarray = d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0]
    return side


def particles_within(
    sim: Simulation, camera: Camera | None, middle: np.ndarray, reach: float
) -> np.ndarray:
    """Numbers of the free particles within a distance of a point: in 3-D, of its line of sight."""
    x = sim.positions() - middle
    if camera is not None:
        eye = camera.ray(camera.project(middle[None])[0][0])[1]
        deep = x @ eye
        x = x - deep[:, None] * eye
        x[np.abs(deep) > reach] = np.inf
    with np.errstate(invalid="ignore"):
        near = np.linalg.norm(x, axis=1) <= reach
    return np.flatnonzero(near & ~sim.fixed())


def springs_across(
    sim: Simulation,
    camera: Camera | None,
    window: WindowMap,
    start: np.ndarray,
    end: np.ndarray,
) -> np.ndarray:
    """Numbers of the springs that hold and cross the way from one pixel (2,) to another."""
    mine = np.flatnonzero(sim.springs_alive())
    if len(mine) == 0 or (start == end).all():
        return mine[:0]
    places, _ = seen(sim.positions(), camera, window)
    a, b = places[sim.springs()[mine]].transpose(1, 0, 2)
    with np.errstate(invalid="ignore"):
        apart = _side(a, b, start) * _side(a, b, end) <= 0
        apart &= _side(start, end, a) * _side(start, end, b) <= 0
    touches = (np.minimum(a, b) <= np.maximum(start, end)).all(axis=1)
    touches &= (np.maximum(a, b) >= np.minimum(start, end)).all(axis=1)
    crossed: np.ndarray = mine[apart & touches]
    return crossed
