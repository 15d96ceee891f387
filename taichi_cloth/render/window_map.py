"""The map between the world and a window of any size: one scale, centred."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from taichi_cloth.render.picture import Bounds, Rect

# The size that a window has at least, where a screen has so much room.
SMALLEST_WINDOW = (1280, 800)
SCREEN = (1440, 900)  # pixels of a screen that nobody says the size of
USABLE = (0.96, 0.88)  # of a screen: the rest is for a window's frame and the desktop's bars


@dataclass(frozen=True)
class Look:
    """Which part of a plane is seen: `zoom` times as large as the whole of it.

    middle: what is in the middle of the room, (x, y) world units, with y counted downwards.
    """

    middle: tuple[float, float]
    zoom: float


@dataclass(frozen=True)
class WindowMap:
    """The map from a world (w, h) to a window (width, height) in pixels.

    In a window of the world's own size one pixel is one world unit; any other window shows the
    same picture scaled by one factor and centred, so that a 2-D scene keeps its aspect.
    y_up: whether the world's y points up; a window's points down.
    room: the part of the window that the world is shown in; None: all of it.
    look: which part of a plane is seen there; None: all of it.
    """

    world: tuple[float, ...]
    window: tuple[int, int]
    y_up: bool = False
    room: Rect | None = None
    look: Look | None = None

    @classmethod
    def of(
        cls,
        world: Bounds,
        window: tuple[int, int],
        room: Rect | None = None,
        look: Look | None = None,
    ) -> WindowMap:
        """The map for a world, or for the pixels of its camera: these always count downwards."""
        return cls(world.size[:2], window, world.dim == 2 and world.up == "y", room, look)

    @property
    def _room(self) -> Rect:
        return self.room or Rect(0, 0, *self.window)

    @property
    def scale(self) -> float:
        """Window pixels per world unit."""
        whole = min(self._room.width / self.world[0], self._room.height / self.world[1])
        return whole * self.look.zoom if self.look else whole

    @property
    def offset(self) -> np.ndarray:
        """Window pixel of the world's corner (0, 0), shape (2,)."""
        room = self._room
        if self.look:
            middle = np.array([room.x + room.width / 2, room.y + room.height / 2])
            corner: np.ndarray = middle - self.scale * np.array(self.look.middle)
            return corner
        free: np.ndarray = [room.width, room.height] - self.scale * np.array(self.world)
        return free / 2 + [room.x, room.y]

    def to_window(self, points: ArrayLike) -> np.ndarray:
        """World `points` (..., 2) in window pixels, origin top left."""
        pixels: np.ndarray = self._turned(np.asarray(points, np.float64)) * self.scale + self.offset
        return pixels

    def to_world(self, pixels: ArrayLike) -> np.ndarray:
        """Window `pixels` (..., 2) in world units."""
        return self._turned((np.asarray(pixels, np.float64) - self.offset) / self.scale)

    def _turned(self, points: np.ndarray) -> np.ndarray:
        """`points` (..., 2) with y counted from the other end, where it points up."""
        return points * [1, -1] + [0, self.world[1]] if self.y_up else points

    def shows(self, points: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Which discs around world points (n, 2) reach into the room, (n,) bool."""
        room, pixels = self._room, self.to_window(points)
        reach = self.scale * np.asarray(radius, np.float64)[:, None]
        low, high = (
            np.array([room.x, room.y]),
            np.array([room.x + room.width, room.y + room.height]),
        )
        with np.errstate(invalid="ignore"):  # what is not finite is nowhere
            inside = (pixels + reach >= low) & (pixels - reach <= high)
        return np.asarray(inside.all(axis=1))

    def looking_at(self, points: np.ndarray, filled: float) -> Look:
        """The look that has world points (n, 2) in the middle of the room, never nearer than the
        whole world is seen.

        filled: share of the room that they may fill.
        """
        whole, places = replace(self, look=None), self._turned(np.asarray(points, np.float64))
        low, high = places.min(axis=0), places.max(axis=0)
        room = np.array([self._room.width, self._room.height])
        with np.errstate(divide="ignore"):
            zoom = float((filled * room / (whole.scale * (high - low))).min())
        x, y = (low + high) / 2
        return Look((float(x), float(y)), min(zoom, 1.0))

    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Upper left and lower right corner of the world, (2,) window pixels each."""
        return self.offset, self.offset + self.scale * np.array(self.world)

    def walls(self, names: Iterable[str]) -> np.ndarray:
        """Lines of the walls called `names`, just inside the world, (k, 2, 2) window pixels."""
        low, high = self.box()
        square = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
        square += [[0.75, 0.75], [-0.75, 0.75], [-0.75, -0.75], [0.75, -0.75]]
        ends = {"left": (0, 3), "right": (1, 2), "top": (0, 1), "bottom": (3, 2)}
        return square[[ends[name] for name in names]].reshape(-1, 2, 2)


def default_window(
    world_size: Sequence[float] | None,
    *,
    around: Callable[[int], int] = lambda height: 0,
    screen: tuple[int, int] = SCREEN,
) -> tuple[int, int]:
    """The window (width, height) in which a world of (w, h[, d]) is shown with its own aspect.

    It is at least `SMALLEST_WINDOW` wide and high, where the screen has room, else what fits.
    world_size: None for a world that fills any window. around: how many rows of pixels a window of
    a height has above and below the world.
    """
    low, high = SMALLEST_WINDOW, [round(n * part) for n, part in zip(screen, USABLE, strict=True)]
    wide, tall = low
    if world_size is not None:
        w, h = float(world_size[0]), float(world_size[1])
        scale = max(wide / w, (tall - around(tall)) / h)
        wide, tall = round(w * scale), round(h * scale)
        tall += around(tall + around(tall))
    return min(wide, high[0]), min(tall, high[1])
