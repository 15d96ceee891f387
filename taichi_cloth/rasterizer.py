"""Draws triangles, balls and lines into a picture in memory, on the device that is running.

For the view that has nothing else to draw with; a picture has the same bits on every run.
"""

from __future__ import annotations

import weakref
from dataclasses import dataclass, field

import numpy as np
import taichi as ti
from taichi.lang import impl
from taichi.lang._ndarray import ScalarNdarray

from taichi_cloth.kernels import raster

NO_VECTORS = np.zeros((0, 3), np.float32)
NO_NUMBERS = np.zeros(0, np.float32)
# The homography, the shade and its room of a picture without one (`kernels/raster.py`).
UNSHADED = np.zeros(9, np.float32), np.zeros((1, 1), np.float32), np.zeros(4, np.int32)


@dataclass(frozen=True)
class Mesh:
    """Triangles. All floats are float32, places in the camera's axes with the eye as their origin.

    place: (n, 3) vertices [world units]. normal: (n, 3), of any length. corner: (m, 3) int32.
    front, back: (n, 3) colours 0..1 of the vertices, seen from where their triangles go round
    counterclockwise, and from behind. veil: whether one sees through it, as if it were half there.
    """

    place: np.ndarray
    normal: np.ndarray
    corner: np.ndarray
    front: np.ndarray
    back: np.ndarray
    veil: bool = False


@dataclass(frozen=True)
class Balls:
    """Spheres. centre: (k, 3) and radius: (k,) world units; color: (k, 3) 0..1, all float32.

    veil: as of a `Mesh`.
    """

    centre: np.ndarray = field(default_factory=NO_VECTORS.copy)
    radius: np.ndarray = field(default_factory=NO_NUMBERS.copy)
    color: np.ndarray = field(default_factory=NO_VECTORS.copy)
    veil: bool = False


@dataclass(frozen=True)
class Lines:
    """Lines. end: (2 l, 3), their ends in pairs; color: (l, 3) 0..1; width: (l,) pixels; float32.

    lift: by this share of the way to the eye they are seen before where they are.
    """

    end: np.ndarray = field(default_factory=NO_VECTORS.copy)
    color: np.ndarray = field(default_factory=NO_VECTORS.copy)
    width: np.ndarray = field(default_factory=NO_NUMBERS.copy)
    lift: float = 0.0


@dataclass(frozen=True, eq=False)  # compared by identity: what was drawn of one is kept
class Still:
    """What stands still, seen from one place: it is drawn once, and kept."""

    meshes: list[Mesh]
    lines: list[Lines]


def _ends(numbers: np.ndarray) -> tuple[int, int]:
    """Beyond the least and the largest of some numbers."""
    return int(numbers.min()) - 1, int(numbers.max()) + 1


@dataclass(frozen=True)
class Shade:
    """How dark a floor is in places.

    low: (2,), the floor's coordinates of the first corner of a grid. cell: the side of its cells,
    world units. dark: (k, k) float32, along both axes, at the corners of cells: the part of the
    floor's light that is lacking there, which somewhere is more than 0.
    """

    low: np.ndarray
    cell: float
    dark: np.ndarray

    def room(self, homography: np.ndarray, h: int, w: int) -> np.ndarray:
        """The rows and columns of a picture, from and to, in which it may be seen: (4,) int32.

        homography: (3, 3), from pixels to cells. h, w: of the picture.
        """
        rows, columns = np.nonzero(self.dark > 0)
        cells = np.array([(i, j, 1) for i in _ends(rows) for j in _ends(columns)])
        seen = cells @ np.linalg.inv(homography).T
        if not (seen[:, 2] > 0).all():  # some of it is behind us
            return np.array([0, h, 0, w], np.int32)
        pixel = seen[:, [1, 0]] / seen[:, 2:]
        low, high = np.floor(pixel.min(axis=0)), np.ceil(pixel.max(axis=0)) + 1
        room: np.ndarray = np.stack([low, high], axis=1).clip(0, [[h], [w]]).astype(np.int32)
        return room.reshape(-1)


@dataclass(frozen=True)
class Floor:
    """A floor of tiles in two colours, which fades out.

    above: how far the eye is above it. axes: its unit normal and its two axes, (3,) each, as seen
    in the camera's axes. eye, middle: where the eye is along these two, and what is looked at.
    side: of a tile. reach: from the middle to where it ends, all in world units.
    colors: of both kinds of tile, floats 0..1.
    shade: on it; None: it has all of its light.
    """

    above: float
    axes: tuple[np.ndarray, np.ndarray, np.ndarray]
    eye: tuple[float, float]
    middle: tuple[float, float]
    side: float
    reach: float
    colors: tuple[np.ndarray, np.ndarray]
    shade: Shade | None = None

    def numbers(self) -> np.ndarray:
        """As `kernels/raster.py` takes them."""
        given = (*self.axes, self.eye, self.middle, (self.side, self.reach), *self.colors)
        return np.concatenate([[self.above], *given]).astype(np.float32)

    def shading(
        self, lens: np.ndarray, h: int, w: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The homography, the shade and its room, as `kernels/raster.py` takes them.

        lens: (3,) or more, as there, for the picture's own pixels. h, w: of the picture.
        """
        shade = self.shade
        if shade is None:
            return UNSHADED
        up, along, across = self.axes
        sight = np.array(
            [[1, 0, 0.5 - lens[1]], [0, 1, 0.5 - lens[2]], [0, 0, lens[0]]], np.float64
        )
        aside = (np.array(self.eye) - shade.low) / shade.cell
        place = self.above / shade.cell * np.stack([along, across]) - aside[:, None] * up
        homography = np.sign(self.above) * np.stack([*place, -up]) @ sight
        room = shade.room(homography, h, w)
        return homography.astype(np.float32).reshape(-1), shade.dark, room


class Image(ScalarNdarray):  # type: ignore[misc]  # Taichi says nothing of its types
    """Pixels (h, w) int32 on the device, all 0; they are gone where Taichi is started anew.

    Taichi takes back whatever lies where an array lay when Python drops it: were it made before a
    new start, that would be an array of after it, at the same address, which others draw in.
    """

    def __init__(self, *shape: int):
        self._made_in = weakref.ref(impl.get_runtime().prog)
        super().__init__(ti.i32, shape)

    def __del__(self) -> None:
        if impl is not None and self._made_in() is impl.get_runtime().prog:  # None: Python ends
            super().__del__()


class Rasterizer:
    """Pictures of `size` (width, height) pixels, each the mean of samples x samples."""

    def __init__(self, size: tuple[int, int], samples: int):
        self._samples = samples
        shape = samples * size[1], samples * size[0]
        tiles = tuple(-(-n // tile) for n, tile in zip(shape, raster.TILE, strict=True))
        self._drawn = Image(*shape), Image(*shape), Image(*tiles)
        self._behind = Image(*shape), Image(*shape)
        self._laid = Image(size[1], size[0])
        self._under: Image | None = None  # what is seen through veils
        self._wanted: bytes | None = None  # what lies behind everything, and
        self._still: Still | None = None

    def draw(
        self,
        picture: np.ndarray,
        focal_length: float,
        middle: tuple[float, float],
        nearest: float,
        lights: np.ndarray,
        background: tuple[float, float, float],
        *,
        meshes: list[Mesh],
        balls: list[Balls],
        lines: list[Lines],
        floor: Floor | None = None,
        still: Still | None = None,
    ) -> None:
        """Draw the whole of a picture (h, w) uint32, 0xRRGGBB, row 0 on top.

        focal_length: pixels per unit of slope. middle: the pixel (x right, y down) looked at.
        nearest: the least depth that is drawn. lights: (k + 1, 4) float32, as `kernels/raster.py`
        has them. still: what is drawn besides, made with this lens and these lights.
        """
        fine = float(self._samples)
        lens = np.array(
            [fine * focal_length, fine * middle[0], fine * middle[1], nearest], np.float32
        )
        self._lay(lens, lights, np.array(background, np.float32), floor, still)
        self._put(lens, lights, meshes, balls, lines)
        shading = UNSHADED if floor is None else floor.shading(lens / fine, *picture.shape)
        image = picture.view(np.int32)
        raster.resolve(self._samples, *self._drawn, *self._behind, self._laid, image, *shading)

    def _put(
        self,
        lens: np.ndarray,
        lights: np.ndarray,
        meshes: list[Mesh],
        balls: list[Balls],
        lines: list[Lines],
    ) -> None:
        """Draw things before what is there; veils last, of which the nearest is seen."""
        firm = [m for m in meshes if not m.veil], [b for b in balls if not b.veil]
        veils = [m for m in meshes if m.veil], [b for b in balls if b.veil]
        for stage in (0, 1):
            self._draw(stage, lens, lights, *firm, lines)
        if not any(veils):
            return
        if self._under is None:
            self._under = Image(*self._drawn[1].shape)
        _, color, touched = self._drawn
        self._draw(0, lens, lights, *veils, [])
        raster.set_back(color, touched, self._under)
        self._draw(1, lens, lights, *veils, [])
        raster.see_through(color, touched, self._under)

    def _draw(
        self,
        stage: int,
        lens: np.ndarray,
        lights: np.ndarray,
        meshes: list[Mesh],
        balls: list[Balls],
        lines: list[Lines],
    ) -> None:
        """Do one of the two stages of drawing things; see `kernels/raster.py`."""
        target = self._drawn
        for m in meshes:
            if len(m.corner):
                shape = m.place, m.normal, m.corner, m.front, m.back
                raster.triangles(stage, *target, *shape, lens, lights)
        for b in balls:
            if len(b.centre):
                raster.balls(stage, *target, b.centre, b.radius, b.color, lens, lights)
        for line in lines:
            if len(line.color):
                wide = np.float32(self._samples) * line.width
                raster.lines(stage, *target, line.end, line.color, wide, lens, line.lift)

    def _lay(
        self,
        lens: np.ndarray,
        lights: np.ndarray,
        background: np.ndarray,
        floor: Floor | None,
        still: Still | None,
    ) -> None:
        """Have what lies behind everything ready; it is made anew where it changed."""
        numbers = NO_NUMBERS if floor is None else floor.numbers()
        parts = [background, numbers]
        if floor is not None or still is not None:
            parts += [lens, lights]
        wanted = b"".join(part.tobytes() for part in parts)
        if wanted != self._wanted or still is not self._still:
            raster.lay_floor(*self._drawn[:2], lens, background, numbers)
            if still is not None:
                self._put(lens, lights, still.meshes, [], still.lines)
            raster.lay(self._samples, *self._drawn, *self._behind, self._laid)
            self._wanted, self._still = wanted, still
