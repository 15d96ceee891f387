"""Pictures: one frame's contents as arrays, which know no scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.render.pointer import Pointer
from taichi_cloth.render.tiles import Panel


@dataclass(frozen=True)
class Rect:
    """A rectangle of window pixels; (x, y) is its upper left corner."""

    x: int
    y: int
    width: int
    height: int

    def holds(self, pixel: tuple[float, float]) -> bool:
        """True if a window pixel (x, y) lies in it."""
        x, y = pixel[0] - self.x, pixel[1] - self.y
        return 0 <= x < self.width and 0 <= y < self.height


class Bounds(Protocol):
    """The world that is drawn: its size, its walls' names, and which way is up ("y" or "")."""

    @property
    def size(self) -> tuple[float, ...]:
        """(w, h) or (w, h, d), world units."""

    @property
    def dim(self) -> int:
        """2 or 3."""

    @property
    def up(self) -> str:
        """ "y" where y points up, else ""."""

    @property
    def walls(self) -> Sequence[str]:
        """Names of the walls that there are."""


@dataclass(frozen=True)
class Solid:
    """The surface of something that is no cloth: closed, seen from outside.

    vertex: (k, dim) world units. triangles: (m, 3) int, counterclockwise seen from outside.
    color: (k, 3) uint8.
    """

    vertex: np.ndarray
    triangles: np.ndarray
    color: np.ndarray


@dataclass(frozen=True)
class Ghost:
    """A pale second cloth, a little behind its place, so that it is seen where it differs.

    position: (n, dim) of the picture's first n particles [world]. radius: (n,) [world].
    segments: (s, 2), triangles: (m, 3), as_spheres: (n,) bool, normals: (n, 3), as in a `Picture`.
    over: whether a plane has it over its own things, and not under them.
    """

    position: np.ndarray
    radius: np.ndarray
    segments: np.ndarray
    triangles: np.ndarray
    as_spheres: np.ndarray
    normals: np.ndarray | None
    over: bool = False

    @property
    def flat_color(self) -> tuple[int, ...]:
        """The colour in a plane: over things its own, under them as if one saw through it."""
        return style.GHOST if self.over else style.GHOST_ON_WORLD


@dataclass(frozen=True)
class Picture:
    """One frame's contents, as NumPy arrays.

    position: (n, dim) particle positions [world], an array that the next frame may overwrite.
    radius: (n,) [world]. color: (n, 3) uint8. surface_color: the same in surfaces; None: as color.
    segments: (s, 2) int, particle pairs of the springs that are alive.
    spring_color: that all springs have, 0..255, or (s, 3) uint8, that of each; None: they resemble
    their ends.
    triangles: (m, 3) int, particles at the corners of surfaces, of those that are to be drawn.
    normals: (n, 3) unit normals of these surfaces, as `position`; None: they are computed.
    as_spheres: (n,) bool, which particles are drawn as spheres or discs; None: all.
    solids: the surfaces of obstacles. ground: the height of a floor; None: there is none.
    overlay: what is laid over the frame, in this order.
    pointer: the pointer, where it is drawn. beside: a second world; None: there is none.
    ghost: what is drawn pale behind all of it; None: nothing.

    Radius, color, segments and triangles are the same objects as before while they are equal, so
    that they need not be prepared anew (`drawing.Cached`).
    """

    position: np.ndarray
    radius: np.ndarray
    color: np.ndarray
    segments: np.ndarray
    spring_color: tuple[int, int, int] | np.ndarray | None = None
    surface_color: np.ndarray | None = None
    triangles: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    normals: np.ndarray | None = None
    as_spheres: np.ndarray | None = None
    solids: Solid | None = None
    ground: float | None = None
    overlay: tuple[Panel, ...] = ()
    pointer: Pointer | None = None
    ghost: Ghost | None = None
    beside: Half | None = None

    @property
    def color_in_surfaces(self) -> np.ndarray:
        """The particles' colours in surfaces, (n, 3) uint8."""
        return self.color if self.surface_color is None else self.surface_color

    @property
    def has_surfaces(self) -> bool:
        """True if there is anything besides springs and particles."""
        return len(self.triangles) > 0 or self.solids is not None or self.ground is not None


@dataclass(frozen=True)
class Half:
    """A second world beside that of a picture, seen by the same camera.

    picture: of it, without an overlay. room: the part of the window that it is drawn in, as large
    as that of the first one, and at its right.
    """

    picture: Picture
    room: Rect
