"""What every view can do, and what it is given to draw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from taichi_cloth.files.events import Event
from taichi_cloth.scene.model import World
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.layout import default_window

# Names of keys in events, by the names that GGUI, ti.GUI and X use for them.
KEYS = {
    " ": "space",
    "Escape": "escape",
    "Control_L": "ctrl",
    "Control_R": "ctrl",
    "Control": "ctrl",
    "Shift_L": "shift",
    "Shift_R": "shift",
    "Shift": "shift",
    "Return": "return",
    "Tab": "tab",
    "BackSpace": "backspace",
    "Up": "up",
    "Down": "down",
    "Left": "left",
    "Right": "right",
    "F1": "f1",
    ".": ".",
    "KP_Decimal": ".",
    "+": "+",
    "=": "+",
    "KP_Add": "+",
    "-": "-",
    "KP_Subtract": "-",
}


@dataclass(frozen=True)
class Picture:
    """One frame's contents, as NumPy arrays.

    position: (n, dim) particle positions [world], an array that the next frame may overwrite;
    radius: (n,) [world]; color: (n, 3) uint8. segments: (s, 2) int, particle pairs of the springs
    that are alive. Radius, color and segments are the same objects as before while they are equal,
    so that a view need not prepare them anew (`Kept`).
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


class Kept:
    """A value that is made anew only when what it is made of changed."""

    def __init__(self):
        self._of, self._value = None, None

    def get(self, make, *of):
        """make(*of), or what it made last where `of` are the same arrays and equal other things."""
        if self._of is None or not all(map(_unchanged, self._of, of)):
            self._of, self._value = of, make(*of)
        return self._value


def _unchanged(before, now) -> bool:
    return before is now or (not isinstance(now, np.ndarray) and before == now)


def are_numbers(points: np.ndarray) -> np.ndarray:
    """Which of the points (n, dim) are finite, (n,) bool."""
    return np.isfinite(points @ np.ones(points.shape[1], points.dtype))


def between_shown(segments: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """The segments whose two particles are shown; shown: (n,) bool."""
    return segments if shown.all() else segments[shown[segments].all(axis=1)]


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
