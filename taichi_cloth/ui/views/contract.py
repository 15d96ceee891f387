"""What a view declares, what every view can do, and what it is given to draw."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.scene.model import World
from taichi_cloth.ui import style
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.chrome.layout import Rect
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.pointer import Pointer
from taichi_cloth.ui.surfaces import Solid
from taichi_cloth.ui.tiles import Panel
from taichi_cloth.ui.window_map import Look


@dataclass(frozen=True)
class Ghost:
    """What is drawn pale, a little behind where it is, so that it is seen where it differs.

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
    normals: (n, 3) unit normals of these surfaces, as `position`; None: the view computes them.
    as_spheres: (n,) bool, which particles are drawn as spheres or discs; None: all.
    solids: the surfaces of obstacles. ground: the height of a floor; None: there is none.
    overlay: what is laid over the frame, in this order.
    pointer: the pointer, where it is drawn. beside: a second world; None: there is none.
    ghost: what is drawn pale behind all of it; None: nothing.
    plain: whether what takes time may be left out, where a view draws planes in layers: smooth
    edges, and the discs of particles that have springs.

    Radius, color, segments and triangles are the same objects as before while they are equal, so
    that a view need not prepare them anew (`drawing.Cached`).
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
    plain: bool = False

    @property
    def color_in_surfaces(self) -> np.ndarray:
        """The particles' colours in surfaces, (n, 3) uint8."""
        return self.color if self.surface_color is None else self.surface_color

    @property
    def has_surfaces(self) -> bool:
        """Whether there is anything besides springs and particles."""
        return len(self.triangles) > 0 or self.solids is not None or self.ground is not None


@dataclass(frozen=True)
class Half:
    """A second world beside that of a picture, seen by the same camera.

    picture: of it, without an overlay. room: the part of the window that it is drawn in, as large
    as that of the first one, the view's `room`, and at its right.
    """

    picture: Picture
    room: Rect


class View(Protocol):
    """A place to draw, and where the user's events come from.

    name: of the kind of view. camera: of a 3-D world, else None; it is read at every draw.
    visible: False where the view draws into memory only, or not at all.
    has_wheel: whether it reports the mouse's wheel.
    closed: whether the window is gone.
    text_size: of what is written around the world, in parts of the usual.
    room: the part of the window that the world is drawn in; None: all of it. Read at every draw.
    look: which part of a 2-D world is seen there; None: all of it. Read at every draw.
    quicker: the flag of a view that draws quicker on this machine; "": none is known to.
    """

    name: str
    quicker: str
    camera: Camera | None
    room: Rect | None
    look: Look | None
    text_size: float
    visible: bool
    has_wheel: bool
    closed: bool

    @property
    def size(self) -> tuple[int, int]:
        """Current width and height in pixels."""

    def turn_to(self, world: World, camera: Camera | None) -> None:
        """Show another world from now on; camera: of a 3-D one."""

    def poll(self) -> list[Event]:
        """The user's events since the last call, oldest first."""

    def entitle(self, title: str) -> None:
        """Write a title over the window, if there is one."""

    def draw(self, picture: Picture) -> None:
        """Draw and present one frame."""

    def grab(self) -> np.ndarray:
        """The frame drawn last, (height, width, 3) uint8, row 0 on top."""

    def close(self) -> None:
        """Give the window back. May be called twice."""


def no_display() -> str | None:
    """Why no window can open here, whatever draws it; None: one can."""
    if runtime.display_available():
        return None
    return "there is no display (is DISPLAY set, and is its X server running?)"


class Open(Protocol):
    """Opens a view."""

    def __call__(self, world: World, size: tuple[int, int], title: str, *, visible: bool) -> View:
        """A view of `world`, `size` (width, height) pixels; visible: in a window of this title."""


@dataclass(frozen=True, kw_only=True)
class ViewKind:
    """A kind of view: what it can do, what it needs for that, and how one is opened.

    name: the file's name, and a word of the command line's `--view`.
    windows: whether it opens windows.
    lack: why it cannot be opened as it is meant here (with a window, if it opens any), in words
        for the user; None: it can.
    pictures: whether it can draw into memory here, without a window.
    several: whether there may be several at a time in one process.
    open: opens one; RuntimeError where a display or driver fails after all.
    """

    name: str
    windows: bool
    lack: Callable[[], str | None]
    pictures: Callable[[], bool]
    several: bool
    open: Open
