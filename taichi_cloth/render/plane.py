"""A world in a plane, drawn into a room of an image."""

from __future__ import annotations

from typing import Any

import numpy as np

from taichi_cloth.render import drawing, painter, style
from taichi_cloth.render.drawing import Cached
from taichi_cloth.render.painter import Painter, Shapes
from taichi_cloth.render.picture import Bounds, Ghost, Picture, Rect
from taichi_cloth.render.pointer import Pointer
from taichi_cloth.render.rasterizer import NOWHERE
from taichi_cloth.render.window_map import WindowMap

WALL_WIDTH = 1.5  # pixels


class Plane:
    """Draws one world; what has not changed is kept. room: where in an image."""

    def __init__(self, room: Rect):
        self._room = room
        self._springs, self._discs = Cached(_prepared_springs), Cached(_prepared_discs)
        self._faces = Cached(_prepared_faces), Cached(_prepared_faces)
        self._box: tuple[int, ...] = ()
        self._painter: Painter | None = None

    def draw(
        self,
        image: Any,
        width: int,
        picture: Picture,
        bounds: Bounds,
        window: WindowMap,
        again: tuple[int, ...] = NOWHERE,
    ) -> None:
        """Draw a picture into an image (h * width,) int32.

        window: where the world is in it. again: columns and rows of the image, from and to, in
        which something else was drawn meanwhile.
        """
        room = self._room
        low, high = (np.round(corner - [room.x, room.y]) for corner in window.box())
        box = tuple(int(n) for n in np.clip([*low, *high], 0, [room.width, room.height] * 2))
        if self._painter is None or box != self._box:
            paper = _paper(room, box, window.walls(bounds.walls))
            self._box, self._painter = box, Painter(room, paper)
        self._painter.draw(image, width, self._shapes(picture, window), again)

    def _shapes(self, picture: Picture, window: WindowMap) -> list[Shapes]:
        """Shapes to paint: solids, surfaces, springs, particles, and the pointer."""
        found: list[Shapes] = []
        width = drawing.line_width(self._room.height)
        veil = [] if picture.ghost is None else _ghost(picture.ghost, window, width)
        if picture.ghost is not None and not picture.ghost.over:
            found, veil = found + veil, []
        if picture.solids is not None:
            faces = picture.solids.triangles
            corner = window.to_window(picture.solids.vertex).take(faces, axis=0)
            found.append(painter.triangles(corner, *self._faces[1](faces, picture.solids.color)))
        place = window.to_window(picture.position)
        shown = drawing.are_numbers(place)
        faces = drawing.between_shown(picture.triangles, shown)
        if len(faces):
            corner = place.take(faces, axis=0)
            colored = self._faces[0](faces, picture.color_in_surfaces)
            found.append(painter.triangles(corner, *colored))
        segments = drawing.between_shown(picture.segments, shown)
        if len(segments):
            first, second, color = self._springs(segments, picture.color, picture.spring_color)
            ends = place.take(first, axis=0), place.take(second, axis=0)
            found.append(painter.lines(*ends, width, color))
        if picture.as_spheres is not None:
            shown &= picture.as_spheres
        if shown.any():
            place, radius, color = drawing.shown_particles(place, picture, shown)
            rims, discs = self._discs(radius, color, window.scale)
            found.append(painter.discs(place, *rims, discs[0]))
            found.append(painter.discs(place, *discs))
        return [*found, *veil, *pointer_shapes(picture.pointer)]


def pointer_shapes(drawn: Pointer | None) -> list[Shapes]:
    """The pointer, if it is drawn: its lines, on wider dark ones."""
    if drawn is None:
        return []
    first, second = drawn.lines().transpose(1, 0, 2)
    return [
        painter.lines(first, second, wide, style.packed_one(color)) for color, wide in style.POINTER
    ]


def _paper(room: Rect, box: tuple[int, ...], walls: np.ndarray) -> np.ndarray:
    """Paint what stands still: the world's paper, a darker one beside it, walls; (h, w) int32.

    box: x0, y0, x1, y1 of the world in the room.
    """
    x0, y0, x1, y1 = box
    under = np.full((room.height, room.width), style.packed_one(style.SURROUND), np.int32)
    under[y0:y1, x0:x1] = style.packed_one(style.WORLD)
    ends = walls - [room.x, room.y]
    lines = painter.lines(ends[:, 0], ends[:, 1], WALL_WIDTH, style.packed_one(style.WALL))
    Painter(Rect(0, 0, room.width, room.height)).draw(under.reshape(-1), room.width, [lines])
    return under


def _ghost(ghost: Ghost, window: WindowMap, width: float) -> list[Shapes]:
    """A ghost, in a colour that seems to be seen through; width: of lines, pixels."""
    place, color = window.to_window(ghost.position), style.packed_one(ghost.flat_color)
    shown = drawing.are_numbers(place)
    corner = place[drawing.between_shown(ghost.triangles, shown)]
    first, second = place[drawing.between_shown(ghost.segments, shown)].swapaxes(0, 1)
    seen = shown & ghost.as_spheres
    radius = np.maximum(ghost.radius[seen] * window.scale, drawing.SMALLEST_DISC)
    return [
        painter.triangles(corner, 0, color),
        painter.lines(first, second, width, color),
        painter.discs(place[seen], radius, color),
    ]


def _prepared_faces(triangles: np.ndarray, color: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which sides of flat triangles are the surface's edge, and packed colours."""
    return painter.outline(triangles), style.packed(style.flat_colors(color, triangles))


def _prepared_springs(
    segments: np.ndarray, color: np.ndarray, given: tuple[int, int, int] | np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First ends, second ends, packed colours; for the rest `style.spring_colors`."""
    first, second = np.ascontiguousarray(segments.T)
    return first, second, style.packed(style.spring_colors(color, segments, given))


def _prepared_discs(
    radius: np.ndarray, color: np.ndarray, scale: float
) -> list[tuple[np.ndarray, np.ndarray]]:
    """(radius in pixels, packed colour) of the particles' darker rims, then of their discs."""
    layers = drawing.disc_layers(radius, color, scale)
    return [(pixels, style.packed(rgb)) for pixels, rgb in layers]
