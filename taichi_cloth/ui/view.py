"""What every view can do, and what it is given to draw."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.errors import InputError, nearest
from taichi_cloth.events import Event
from taichi_cloth.scene import World
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.layout import default_window


@dataclass(frozen=True)
class Picture:
    """One frame's contents, as NumPy arrays.

    position: (n, dim) particle positions [world]; radius: (n,) [world]; color: (n, 3) uint8.
    segments: (s, 2) int, particle pairs of the springs that are alive.
    text: lines of the status, bottom left, where the scenes leave most room (empty: hidden);
    help: lines of the key list (empty: hidden), "key<tab>action" for two columns;
    banner: a message across the top, wrapped as needed (None: no banner).
    """

    position: np.ndarray
    radius: np.ndarray
    color: np.ndarray
    segments: np.ndarray
    text: tuple[str, ...] = ()
    help: tuple[str, ...] = ()
    banner: str | None = None


class View(Protocol):
    """A place to draw, and where the user's events come from."""

    name: str
    size: tuple[int, int]  # current width and height in pixels
    camera: Camera | None  # of a 3-D world; turned by the tools, read at every draw
    visible: bool  # False: drawn into memory only
    has_wheel: bool
    closed: bool

    def poll(self) -> list[Event]:
        """The user's events since the last call, oldest first."""

    def draw(self, picture: Picture) -> None:
        """Draw and present one frame."""

    def grab(self) -> np.ndarray:
        """The frame drawn last, (height, width, 3) uint8, row 0 on top."""

    def close(self) -> None:
        """Give the window back. May be called twice."""


class NullView:
    """The view of a run without a window and without pictures: no events, nothing drawn."""

    name = "none"
    visible = False
    has_wheel = False
    closed = False

    def __init__(self, world: World, size: tuple[int, int] | None = None):
        self.size = size or default_window(world.size)
        self.camera = Camera(world.size) if world.dim == 3 else None

    def poll(self) -> list[Event]:
        """No events: there is nobody to make them."""
        return []

    def draw(self, picture: Picture) -> None:
        """Nothing is drawn."""

    def grab(self) -> np.ndarray:
        """There is no picture: open the view with ``pictures=True`` for that."""
        raise RuntimeError("this view draws no pictures")

    def close(self) -> None:
        """There is nothing to give back."""


KINDS = ("auto", "ggui", "gui", "none")
_DISPLAY = "there is no display (is DISPLAY set, and is its X server running?)"
_VULKAN = "GGUI needs Vulkan, which is not there (install a Vulkan driver, such as Mesa's)"


def usable_views() -> dict[str, str | None]:
    """Every kind of view: None if it can open here, else why not. Taichi is imported."""
    display = None if runtime.display_available() else _DISPLAY
    return {
        "ggui": display or (None if runtime.vulkan_available() else _VULKAN),
        "gui": display,
        "none": None,
    }


def open_view(
    kind: str,
    world: World,
    *,
    size: tuple[int, int] | None = None,
    title: str = "taichi-cloth",
    pictures: bool = False,
) -> View:
    """Open a view of `world`; `runtime.start` must have been called unless kind is "none".

    kind: "ggui", "gui", "none", or "auto": GGUI where a display and Vulkan are there, else
        ti.GUI where a display is, else none, with one line on standard error that says so.
    size: (width, height) in pixels; None: the world's own size where a screen allows it.
    pictures: whether a view without a window must still draw (for images and films); it uses
        GGUI where Vulkan is there, else ti.GUI, both off-screen.

    Raises InputError where the kind that was asked for cannot be had.
    """
    if kind not in KINDS:
        raise InputError(f"unknown view '{kind}'; {nearest(kind, KINDS)}")
    if kind == "none" and not pictures:
        return NullView(world, size)
    size = tuple(size or default_window(world.size))
    from taichi_cloth.ui.ggui_view import GguiView
    from taichi_cloth.ui.gui_view import GuiView

    if kind != "none":
        usable = usable_views()
        if kind == "auto":
            kind = next(name for name, reason in usable.items() if reason is None)
            if kind == "none":
                print(f"no window: {_DISPLAY}; running headless", file=sys.stderr)
                return open_view("none", world, size=size, title=title, pictures=pictures)
        elif usable[kind] is not None:
            raise InputError(f"--view {kind}: {usable[kind]}; --view none runs without a window")
    visible = kind != "none"
    if kind == "ggui" or (kind == "none" and runtime.vulkan_available()):
        return GguiView(world, size, title, visible=visible)
    return GuiView(world, size, title, visible=visible)
