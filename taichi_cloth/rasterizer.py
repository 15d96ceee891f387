"""Draws triangles, balls and lines into a picture in memory, on the device that is running.

For the view that has nothing else to draw with; a picture has the same bits on every run.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import taichi as ti

from taichi_cloth.kernels import raster

NO_VECTORS = np.zeros((0, 3), np.float32)
NO_NUMBERS = np.zeros(0, np.float32)


@dataclass(frozen=True)
class Mesh:
    """Triangles. All floats are float32, places in the camera's axes with the eye as their origin.

    place: (n, 3) vertices [world units]. normal: (n, 3), of any length. corner: (m, 3) int32.
    front, back: (n, 3) colours 0..1 of the vertices, seen from where their triangles go round
    counterclockwise, and from behind.
    """

    place: np.ndarray
    normal: np.ndarray
    corner: np.ndarray
    front: np.ndarray
    back: np.ndarray


@dataclass(frozen=True)
class Balls:
    """Spheres. centre: (k, 3) and radius: (k,) world units; color: (k, 3) 0..1, all float32."""

    centre: np.ndarray = field(default_factory=NO_VECTORS.copy)
    radius: np.ndarray = field(default_factory=NO_NUMBERS.copy)
    color: np.ndarray = field(default_factory=NO_VECTORS.copy)


@dataclass(frozen=True)
class Lines:
    """Lines. end: (2 l, 3), their ends in pairs; color: (l, 3) 0..1; width: (l,) pixels; float32.

    lift: by this share of the way to the eye they are seen before where they are.
    """

    end: np.ndarray = field(default_factory=NO_VECTORS.copy)
    color: np.ndarray = field(default_factory=NO_VECTORS.copy)
    width: np.ndarray = field(default_factory=NO_NUMBERS.copy)
    lift: float = 0.0


@dataclass(frozen=True)
class Floor:
    """A floor of tiles in two colours, which fades out.

    above: how far the eye is above it. axes: its unit normal and its two axes, (3,) each, as seen
    in the camera's axes. eye, middle: where the eye is along these two, and what is looked at.
    side: of a tile. reach: from the middle to where it ends, all in world units.
    colors: of both kinds of tile, floats 0..1.
    """

    above: float
    axes: tuple[np.ndarray, np.ndarray, np.ndarray]
    eye: tuple[float, float]
    middle: tuple[float, float]
    side: float
    reach: float
    colors: tuple[np.ndarray, np.ndarray]

    def numbers(self) -> np.ndarray:
        """As `kernels/raster.py` takes them."""
        given = (*self.axes, self.eye, self.middle, (self.side, self.reach), *self.colors)
        return np.concatenate([[self.above], *given]).astype(np.float32)


class Rasterizer:
    """A picture of `size` (width, height) pixels, each the mean of samples x samples."""

    def __init__(self, size: tuple[int, int], samples: int):
        self._samples = samples
        shape = tuple(samples * length for length in size)
        self._depth, self._color = ti.ndarray(ti.i32, shape), ti.ndarray(ti.i32, shape)
        self._behind = ti.ndarray(ti.i32, shape), ti.ndarray(ti.i32, shape)
        self._laid: bytes | None = None  # what lies behind everything
        self.pixels = np.zeros((*size, 4), np.float32)  # column by column, from the bottom up

    def draw(
        self,
        focal_length: float,
        middle: tuple[float, float],
        nearest: float,
        lights: np.ndarray,
        background: tuple[float, float, float],
        *,
        meshes: list[Mesh],
        balls: Balls,
        lines: list[Lines],
        floor: Floor | None = None,
    ) -> np.ndarray:
        """The picture (width, height, 4), floats 0..1, column by column from the bottom up.

        focal_length: pixels per unit of slope. middle: the pixel (x right, y up) looked at.
        nearest: the least depth that is drawn. lights: (k + 1, 4) float32, as `kernels/raster.py`
        has them. The array is the same at every call.
        """
        fine = float(self._samples)
        lens = np.array(
            [fine * focal_length, fine * middle[0], fine * middle[1], nearest], np.float32
        )
        self._lay(lens, np.array(background, np.float32), floor)
        target = self._depth, self._color
        raster.clear(*target, *self._behind)
        for stage in (0, 1):
            for m in meshes:
                if len(m.corner):
                    raster.triangles(
                        stage, *target, m.place, m.normal, m.corner, m.front, m.back, lens, lights
                    )
            if len(balls.centre):
                raster.balls(stage, *target, balls.centre, balls.radius, balls.color, lens, lights)
            for line in lines:
                if len(line.color):
                    wide = np.float32(fine) * line.width
                    raster.lines(stage, *target, line.end, line.color, wide, lens, line.lift)
        raster.resolve(self._samples, self._color, self.pixels)
        return self.pixels

    def _lay(self, lens: np.ndarray, background: np.ndarray, floor: Floor | None) -> None:
        """Have what lies behind everything ready; it is made anew where it changed."""
        numbers = NO_NUMBERS if floor is None else floor.numbers()
        wanted = b"".join(a.tobytes() for a in (lens, background, numbers))
        if wanted != self._laid:
            raster.lay_floor(*self._behind, lens, background, numbers)
            self._laid = wanted
