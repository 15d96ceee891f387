"""Picking: the particle under the pointer that one means, and springs that a path crosses."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.render.camera import Camera
from taichi_cloth.render.window_map import WindowMap
from taichi_cloth.ui.solids import Solids

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

NEAR = 12.0  # pixels from a particle at which one still means it
# The same in a plane, where a press beside all particles means nothing else: a cell of a cloth.
NEAR_IN_PLANE = 40.0


def seen(
    points: np.ndarray, camera: Camera | None, window: WindowMap
) -> tuple[np.ndarray, np.ndarray]:
    """Project points (n, dim): window pixels (n, 2), and depths (n,), 0 in a plane.

    A depth of 0 or less is behind the eye: its pixel is NaN.
    """
    if camera is None:
        return window.to_window(points), np.zeros(len(points))
    pixels, _, depth = camera.project(points)
    places = window.to_window(pixels)
    places[~(depth > 0)] = np.nan
    return places, np.where(depth > 0, depth, np.inf)


class Front:
    """The front of a 3-D scene, as a camera sees it: surfaces, spheres, obstacles, a floor.

    places: (n, 2) pixels and depth: (n,) of the particles (`seen`); radius: (n,), in pixels.
    """

    def __init__(self, sim: Simulation, camera: Camera, window: WindowMap) -> None:
        self._sim, self._camera, self._window = sim, camera, window
        self.places, self.depth = seen(sim.positions(), camera, window)
        self._radii = sim.radii()
        self.radius = self._radii * window.scale * camera.focal_length / self.depth
        self._solid = Solids().of(sim, sim.time)
        if self._solid is not None:
            self._solid_seen = seen(self._solid.vertex, camera, window)

    def triangle(self, pixel: np.ndarray) -> tuple[np.ndarray | None, float]:
        """The corners (3,) of the triangle in front at a pixel (2,), and how deep it is there."""
        return _in_front(self._sim.drawn_triangles(), self.places, self.depth, pixel)

    def sphere(self, pixel: np.ndarray, *, loose: bool) -> tuple[int | None, float]:
        """The sphere in front, and how deep it is there. loose: only those in no surface."""
        away = np.linalg.norm(self.places - pixel, axis=1)
        inside = away <= self.radius
        if loose:
            inside[self._sim.drawn_triangles()] = False
        found = np.flatnonzero(inside)
        if len(found) == 0:
            return None, np.inf
        high = np.sqrt(1 - (away[found] / self.radius[found]) ** 2)
        top = self.depth[found] - high * self._radii[found]
        return int(found[top.argmin()]), float(top.min())

    def solid(self, pixel: np.ndarray) -> tuple[np.ndarray | None, float]:
        """The corners (3,) of an obstacle's triangle in front, and how deep it is there."""
        if self._solid is None:
            return None, np.inf
        return _in_front(self._solid.triangles, *self._solid_seen, pixel, outside=True)

    def hides(self, particle: int) -> bool:
        """True if an obstacle is before all of a particle."""
        top = self.depth[particle] - self._radii[particle]
        return bool(self.solid(self.places[particle])[1] < top)

    def narrow(self, start: np.ndarray, end: np.ndarray) -> None:
        """Leave out obstacles' triangles that are away from the box of two pixels (2,)."""
        if self._solid is not None:
            corner = self._solid_seen[0][self._solid.triangles]
            with np.errstate(invalid="ignore"):
                inside = corner.min(axis=1) <= np.maximum(start, end) + 1
                inside &= corner.max(axis=1) >= np.minimum(start, end) - 1
            triangles = self._solid.triangles[inside.all(axis=1)]
            self._solid = replace(self._solid, triangles=triangles)

    def hides_spring(self, ends: np.ndarray, start: np.ndarray, end: np.ndarray) -> bool:
        """True if an obstacle is before a spring where a way between pixels (2,) crosses it.

        ends: (2,), its particles.
        """
        a, b = self.places[ends]
        one, other = abs(_side(start, end, a)), abs(_side(start, end, b))
        part = float(one / (one + other)) if one + other else 0.5
        deep = 1 / float((1 - part) / self.depth[ends[0]] + part / self.depth[ends[1]])
        top = deep - float(self._radii[ends].max())
        return bool(self.solid(a + part * (b - a))[1] < top)

    def at(self, pixel: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The point (3,) that is seen at a pixel, and the unit normal (3,) of its surface, on our
        side; None: nothing is.
        """
        eye, along = self._camera.ray(self._window.to_world(pixel))
        ahead = float(along @ self._camera.rotation()[2])
        corners, deep = self.triangle(pixel)
        ball, top = self.sphere(pixel, loose=corners is not None)
        faces, behind = self.solid(pixel)
        height = self._sim.scene.world.ground
        below = np.inf
        if height is not None and self._camera.is_above(height):
            away = (height - eye[1]) / along[1] if along[1] else -1.0
            below = ahead * away if away > 0 else np.inf
        nearest = min(deep, top, behind, below)
        if not np.isfinite(nearest):
            return None
        point, x = eye + along * (nearest / ahead), self._sim.positions()
        if nearest == below:
            return point, np.array([0.0, -np.sign(along[1]), 0.0])
        if nearest == top:  # which is that of a disc, and nearly on the sphere
            normal = (point - x[ball]) / np.linalg.norm(point - x[ball])
            return x[ball] + self._radii[ball] * normal, normal
        solid = self._solid
        a, b, c = x[corners] if nearest == deep or solid is None else solid.vertex[faces]
        normal = np.cross(b - a, c - a)
        normal = normal / np.linalg.norm(normal)
        return point, -normal if normal @ along > 0 else normal


def particle_at(
    sim: Simulation,
    camera: Camera | None,
    window: WindowMap,
    pixel: np.ndarray,
    among: np.ndarray | None = None,
    near: float = NEAR,
) -> int | None:
    """The particle that a click at a pixel (2,) means; None: it means none.

    In space it is what is in front: the nearest corner of a surface's triangle, or a sphere. Else,
    and in a plane, it is the nearest of those whose disc the pixel is in, or which are `near`.
    What an obstacle hides is not meant.
    among: (n,) bool, those that may be meant; None: all. near: pixels.
    """
    if sim.particle_count == 0:
        return None
    mine = np.ones(sim.particle_count, bool) if among is None else among
    if camera is None:
        away = np.linalg.norm(seen(sim.positions(), None, window)[0] - pixel, axis=1)
        away[~(np.isfinite(away) & mine)] = np.inf
        nearest = int(away.argmin())
        return nearest if away[nearest] <= max(near, sim.radii()[nearest] * window.scale) else None
    front = Front(sim, camera, window)
    corners, deep = front.triangle(pixel)
    ball, top = front.sphere(pixel, loose=corners is not None)
    behind = front.solid(pixel)[1]
    away = np.linalg.norm(front.places - pixel, axis=1)
    if ball is not None and top < min(deep, behind):
        if mine[ball]:
            return ball
        if front.radius[ball] > near:  # which hides what is behind it
            return None
    elif corners is not None and deep <= behind:
        free = corners[mine[corners]]
        if len(free):
            return int(free[away[free].argmin()])
    close = np.flatnonzero(mine & (away <= np.maximum(near, front.radius)))
    for particle in close[away[close].argsort()]:
        if not front.hides(particle):
            return int(particle)
    return None


def _in_front(
    triangles: np.ndarray,
    places: np.ndarray,
    depth: np.ndarray,
    pixel: np.ndarray,
    *,
    outside: bool = False,
) -> tuple[np.ndarray | None, float]:
    """The corners (3,) of the triangle in front at a pixel, and its depth there; None, inf: none.

    outside: whether those that are seen from behind are left out.
    """
    if len(triangles) == 0:
        return None, np.inf
    a, b, c = places[triangles].transpose(1, 0, 2)
    sides = np.stack([_side(b, c, pixel), _side(c, a, pixel), _side(a, b, pixel)])
    with np.errstate(invalid="ignore"):
        inside = (sides <= 0).all(axis=0)
        if not outside:
            inside |= (sides >= 0).all(axis=0)
        inside &= sides.sum(axis=0) != 0
    hit = np.flatnonzero(inside)
    if len(hit) == 0:
        return None, np.inf
    weight = sides[:, hit] / sides[:, hit].sum(axis=0)
    deep = 1 / (weight / depth[triangles[hit]].T).sum(axis=0)
    front: np.ndarray = triangles[hit[deep.argmin()]]
    return front, float(deep.min())


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
    """Numbers of the springs that hold and cross the way from one pixel (2,) to another.

    In space those that an obstacle hides there are left out.
    """
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
    if camera is None or len(crossed) == 0:
        return crossed
    front = Front(sim, camera, window)
    front.narrow(start, end)
    return crossed[[not front.hides_spring(ends, start, end) for ends in sim.springs()[crossed]]]
