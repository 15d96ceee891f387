"""Sizes, colours and prepared parts that planes and space share in drawing."""

from __future__ import annotations

from collections.abc import Callable
from numbers import Number
from typing import Generic, ParamSpec, TypeVar

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.render.camera import Camera
from taichi_cloth.render.picture import Bounds, Picture

LIFTED = 1e-3  # by this share of the way to the eye springs are seen before their surface
SMALLEST_DISC = 0.8  # pixels of its radius
RIM = 0.45  # of a disc's colour is that of its rim
AXES_LENGTH = 0.16  # in radii of what the camera frames
PLAIN = (str, Number, tuple, frozenset, type(None))  # whose equality is one truth

P = ParamSpec("P")
T = TypeVar("T")


class Cached(Generic[P, T]):
    """The last value of a function, for drawing again what has not changed since."""

    def __init__(self, make: Callable[P, T]):
        self._make = make
        self._made: tuple[tuple[object, ...], T] | None = None

    def __call__(self, *inputs: P.args, **named: P.kwargs) -> T:
        """The function's value; the one returned last if all inputs are what they were.

        A number, a word or a tuple of them is what it was while it is equal, anything else while it
        is the same object.
        """
        given = (*inputs, *named.values())
        if self._made is None or not all(map(_unchanged, self._made[0], given)):
            self._made = given, self._make(*inputs, **named)
        return self._made[1]


def _unchanged(before: object, now: object) -> bool:
    plain = isinstance(now, PLAIN) and isinstance(before, PLAIN)
    return before is now or (plain and before == now)


def are_numbers(points: np.ndarray) -> np.ndarray:
    """Which of the points (n, dim) are finite, (n,) bool."""
    finite: np.ndarray = np.isfinite(points @ np.ones(points.shape[1], points.dtype))
    return finite


def between_shown(segments: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """The segments, or triangles, whose particles are all shown; shown: (n,) bool."""
    return segments if shown.all() else segments[shown[segments].all(axis=1)]


def scenery(world: Bounds, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The lines of a 3-D world: ends (k, 2, 3) in world units, colours (k, 3), floats 0..1.

    They are its edges and the axes at its origin with their names; where y points up, edges only
    of walls.
    """
    edges = style.box_edges(world.size)
    if camera.y_up and not world.walls:
        edges = edges[:0]
    length = AXES_LENGTH * camera.radius
    parts, colors = [edges], [np.tile(style.unit(style.EDGE), (len(edges), 1))]
    for axis, (name, color) in enumerate(zip("xyz", style.AXES, strict=True)):
        end = length * np.eye(3)[axis]
        above = [0.0, 0.09 * length if camera.y_up else 0.0, 0.0]  # a floor at the origin
        letter = 1.25 * end + above + 0.14 * length * _strokes(name) @ camera.rotation()
        parts += [np.stack([np.zeros(3), end])[None], letter]
        colors.append(np.tile(style.unit(color), (1 + len(letter), 1)))
    return np.concatenate(parts), np.concatenate(colors)


def _strokes(name: str) -> np.ndarray:
    """The strokes of an axis's name, (k, 2, 3) in camera axes, about 1 high."""
    left, right, low, high = -0.35, 0.35, 0.5, -0.5
    strokes = {
        "x": [((left, high), (right, low)), ((right, high), (left, low))],
        "y": [((left, high), (0, 0)), ((right, high), (0, 0)), ((0, 0), (0, low))],
        "z": [
            ((left, high), (right, high)),
            ((right, high), (left, low)),
            ((left, low), (right, low)),
        ],
    }
    flat = np.array(strokes[name], np.float64)
    return np.concatenate([flat, np.zeros((*flat.shape[:2], 1))], axis=2)


def shown_particles(
    place: np.ndarray, picture: Picture, shown: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (k, dim), radii (k,) and colours (k, 3) of the particles that are shown.

    place: (n, dim), where the picture's particles are. shown: (n,) bool.
    """
    if shown.all():
        return place, picture.radius, picture.color
    return place[shown], picture.radius[shown], picture.color[shown]


def line_width(height: int) -> float:
    """The width of lines of a 2-D world, in pixels, in a room of this height."""
    return max(1.4, height / 480)


def disc_layers(
    radius: np.ndarray, color: np.ndarray, scale: float
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Radius in pixels and colour (floats 0..1) of the particles' rims, and of their discs.

    A darker rim under each disc keeps neighbours of one colour apart.

    radius: (n,) world units. color: (n, 3) uint8. scale: pixels per world unit.
    """
    radius, color = np.maximum(radius * scale, SMALLEST_DISC), color / 255
    return (radius, RIM * color), (np.maximum(radius - 1.2, 0.6 * radius), color)


def spring_width(height: int) -> float:
    """The width of springs in 3-D, in pixels of a window of this height."""
    return max(2.0, height / 260)


def spring_width_on(picture: Picture, segments: np.ndarray, pixels: float, height: int) -> float:
    """The width of a picture's springs in 3-D, in pixels: so that one sees what is between.

    segments: (s, 2), those that are drawn. pixels: that a world unit has where one looks.
    """
    if not len(picture.triangles):
        return spring_width(height)
    a, b = segments[:: max(1, len(segments) // 500)].T
    length = np.linalg.norm(picture.position[a] - picture.position[b], axis=1)
    return float(np.clip(0.15 * pixels * np.median(length), 1.0, spring_width(height)))


def edge_width(height: int) -> float:
    """The width of the world's edges, in pixels of a window of this height."""
    return max(1.6, height / 500)
