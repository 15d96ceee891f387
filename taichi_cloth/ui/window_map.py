"""The map between the world and a window of any size: one scale, centred."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from taichi_cloth.scene.model import World

# A window opened for a world of this many units or fewer per pixel is used as it is; worlds
# outside these limits are shown scaled, so that the window fits a screen and can be read.
SMALLEST_WINDOW = (480, 320)
LARGEST_WINDOW = (1600, 1000)


@dataclass(frozen=True)
class WindowMap:
    """The map from a world (w, h) to a window (width, height) in pixels.

    In a window of the world's own size one pixel is one world unit; any other window shows the
    same picture scaled by one factor and centred, so that a 2-D scene keeps its aspect.
    y_up: whether the world's y points up; a window's points down.
    """

    world: tuple[float, ...]
    window: tuple[int, int]
    y_up: bool = False

    @classmethod
    def of(cls, world: World, window: tuple[int, int]) -> WindowMap:
        """The map for a world, or for the pixels of its camera: these always count downwards."""
        return cls(world.size[:2], window, world.dim == 2 and world.up == "y")

    @property
    def scale(self) -> float:
        """Window pixels per world unit."""
        return min(self.window[0] / self.world[0], self.window[1] / self.world[1])

    @property
    def offset(self) -> np.ndarray:
        """Window pixel of the world's corner (0, 0), shape (2,)."""
        offset: np.ndarray = (np.array(self.window) - self.scale * np.array(self.world)) / 2
        return offset

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

    def to_canvas(self, pixels: ArrayLike) -> np.ndarray:
        """Window `pixels` (..., 2) in Taichi's canvas coordinates: 0..1, y up."""
        points: np.ndarray = np.asarray(pixels) / self.window * [1, -1] + [0, 1]
        return points

    def world_to_canvas(self, points: np.ndarray) -> np.ndarray:
        """World `points` (n, 2) in canvas coordinates and in their precision, in two passes."""
        offset = self.to_canvas(self.to_window([0.0, 0.0]))
        scale = self.scale / np.array(self.window) * [1, 1 if self.y_up else -1]
        out: np.ndarray = points * scale.astype(points.dtype) + offset.astype(points.dtype)
        return out

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
    world_size: Sequence[float], smallest: tuple[int, int] = SMALLEST_WINDOW
) -> tuple[int, int]:
    """The window for a world of (w, h[, d]): its own size where that is usable on a screen.

    smallest: a smaller world is shown so that it fills the width or the height of this.
    """
    w, h = float(world_size[0]), float(world_size[1])
    shrink = min(1.0, LARGEST_WINDOW[0] / w, LARGEST_WINDOW[1] / h)
    grow = max(1.0, min(smallest[0] / w, smallest[1] / h))
    scale = shrink if shrink < 1 else grow
    return max(round(w * scale), 160), max(round(h * scale), 120)
