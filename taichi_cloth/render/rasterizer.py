"""Triangles, balls and lines in space, drawn into a room of an image."""

from __future__ import annotations

import weakref
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import taichi as ti
from taichi.lang import impl
from taichi.lang._ndarray import ScalarNdarray

from taichi_cloth import runtime
from taichi_cloth.kernels.render import floor as behind
from taichi_cloth.kernels.render import frame, raster, sight

ROWS, SQUARE = 16, 8  # of a tile: rows of the whole width on a CPU; elsewhere pixels of a side
NO_ROWS = np.zeros((0, 3), np.float32)
NO_INDICES = np.zeros((0, 3), np.int32)
NO_NUMBERS = np.zeros(0, np.float32)
UNSHADED = np.zeros((1, 1), np.float32)
NOWHERE = (frame.ABSENT, -frame.ABSENT) * 2


class Image(ScalarNdarray):  # type: ignore[misc]  # Taichi says nothing of its types
    """Numbers on the device, all 0; they are gone where Taichi is started anew.

    Taichi takes back whatever lies where an array lay when Python drops it: were it made before a
    new start, that would be an array of after it, at the same address, which others draw in.
    """

    def __init__(self, dtype: Any, *shape: int):
        self._made_in = weakref.ref(impl.get_runtime().prog)
        super().__init__(dtype, shape)

    def __del__(self) -> None:
        if impl is not None and self._made_in() is impl.get_runtime().prog:  # None: Python ends
            super().__del__()


def on_device(*shape: int, real: bool = False) -> Any:
    """An array of zeros where kernels run, int32 or float32: on a processor one of NumPy's."""
    if runtime.current_device().arch == "cpu":
        return np.zeros(shape, np.float32 if real else np.int32)
    return Image(ti.f32 if real else ti.i32, *shape)


def tile_of(width: int) -> tuple[int, int]:
    """Rows and columns of a tile of an image so wide."""
    on_cpu = runtime.current_device().arch == "cpu"
    return (ROWS, max(width, 1)) if on_cpu else (SQUARE, SQUARE)


@dataclass(frozen=True)
class Group:
    """Numbers of a `Things` in one layer.

    width: of lines, pixels. lift: by this share of the way to the eye lines are seen before where
    they are.
    """

    triangles: int = 0
    balls: int = 0
    lines: int = 0
    width: float = 1.0
    lift: float = 0.0


@dataclass(frozen=True)
class Things:
    """Things drawn at a time; `kernels/render/frame.py` says what the arrays are.

    place: (n, 3) float32 [world]. normal: (k, 3) float32, of the first k vertices, which surfaces
    have, and side: (k, 2) int32, the colours of both their sides. corner: (m, 3), ball: (b, 3),
    line: (l, 3) int32. beside: (m, 3) int32, the triangles that share a triangle's sides, -1 where
    none does. firm: the first of these; veil: the rest, through which one sees.
    """

    place: np.ndarray = field(default_factory=NO_ROWS.copy)
    normal: np.ndarray = field(default_factory=NO_ROWS.copy)
    side: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.int32))
    corner: np.ndarray = field(default_factory=NO_INDICES.copy)
    beside: np.ndarray = field(default_factory=NO_INDICES.copy)
    ball: np.ndarray = field(default_factory=NO_INDICES.copy)
    line: np.ndarray = field(default_factory=NO_INDICES.copy)
    firm: Group = Group()
    veil: Group = Group()


@dataclass(frozen=True)
class Lens:
    """An eye, its lens and its lights.

    eye: (3,) [world]. turn: (3, 3), to the camera's axes. focal: pixels per unit of slope.
    middle: the pixel (x, y) of the room that is looked at. nearest: the least depth [world] drawn.
    lights: (3, 4), unit directions and strengths of two, then the ambient one's strength last.
    sheen: what fabric adds where it is seen along its surface.
    """

    eye: np.ndarray
    turn: np.ndarray
    focal: float
    middle: tuple[float, float]
    nearest: float
    lights: np.ndarray
    sheen: float

    def numbers(self, *layers: Group) -> np.ndarray:
        """As kernels take them, with the widths of both layers' lines."""
        found = np.zeros(frame.NUMBERS, np.float32)
        found[frame.EYE :][:3] = self.eye
        found[frame.TURN :][:9] = self.turn.reshape(-1)
        found[frame.LENS :][:4] = self.focal, *self.middle, self.nearest
        found[frame.LIGHTS :][:10] = [*self.lights[:2].reshape(-1), self.lights[2, 3], self.sheen]
        widths = [number for layer in layers for number in (layer.width, layer.lift)]
        found[frame.WIDTHS :][: len(widths)] = widths
        return found


@dataclass(frozen=True)
class Shade:
    """The shade on a floor.

    low: (2,), the floor's coordinates of the first corner of a grid. cell: the side of its cells,
    world units. dark: (k, k) float32, along both axes, at the corners of cells: the part of the
    floor's light that is lacking there, which somewhere is more than 0.
    """

    low: np.ndarray
    cell: float
    dark: np.ndarray

    def spans(self, homography: np.ndarray, w: int, h: int, tall: int) -> np.ndarray:
        """The columns of each row of tiles, from and to, in which it may be seen: (rows, 2) int32.

        homography: (3, 3), from pixels to cells. w, h: of the picture. tall: rows of a tile.
        """
        rows = -(-h // tall)
        # Of each row of cells the first and the last that are dark: what is between, is between.
        dark = self.dark > 0
        i = np.flatnonzero(dark.any(axis=1))
        ends = dark[i].argmax(axis=1) - 1, dark.shape[1] - dark[i, ::-1].argmax(axis=1)
        i, j = np.concatenate([i, i, i, i]), np.concatenate([*ends, *ends])
        i[: len(i) // 2] -= 1
        i[len(i) // 2 :] += 1
        seen = np.stack([i, j, np.ones_like(i)], axis=1) @ np.linalg.inv(homography).T
        if not (seen[:, 2] > 0).all():  # some of it is behind us
            return np.tile(np.array([0, w], np.int32), (rows, 1))
        pixel = seen[:, :2] / seen[:, 2:]
        row = np.floor(pixel[:, 1] / tall)
        low, high = np.full(rows + 2, w), np.zeros(rows + 2, np.int64)
        at = np.clip(row + 1, 0, rows + 1).astype(int)
        column = np.clip(pixel[:, 0], 0, w).astype(int)
        np.minimum.at(low, at, column)
        np.maximum.at(high, at, column + 1)
        # What goes through a row has corners in this one, or beside it.
        while True:
            between = (low[1:-1] >= w) & (np.minimum.accumulate(low)[:-2] < w)
            between &= np.minimum.accumulate(low[::-1])[::-1][2:] < w
            if not between.any():
                break
            where = 1 + np.flatnonzero(between)
            low[where] = np.minimum(low[where - 1], low[where + 1])
            high[where] = np.maximum(high[where - 1], high[where + 1])
        low = np.minimum(np.minimum(low[:-2], low[1:-1]), low[2:])
        high = np.maximum(np.maximum(high[:-2], high[1:-1]), high[2:])
        return np.stack([low, np.minimum(high, w)], 1).astype(np.int32)


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
        """As `kernels/render/frame.py` takes them."""
        given = (*self.axes, self.eye, self.middle, (self.side, self.reach), *self.colors)
        return np.concatenate([[self.above], *given]).astype(np.float32)

    def homography(self, shade: Shade, lens: Lens) -> np.ndarray:
        """The matrix (3, 3) that takes (column, row, 1) of a pixel to its place in a shade's cells,
        times a number that is positive before us.
        """
        up, along, across = self.axes
        x, y = lens.middle
        sight = np.array([[1, 0, 0.5 - x], [0, 1, 0.5 - y], [0, 0, lens.focal]], np.float64)
        aside = (np.array(self.eye) - shade.low) / shade.cell
        place = self.above / shade.cell * np.stack([along, across]) - aside[:, None] * up
        found: np.ndarray = np.sign(self.above) * np.stack([*place, -up]) @ sight
        return found


class Rasterizer:
    """Draws into a room of `width` x `height` pixels, and remembers what it left there."""

    def __init__(self, width: int, height: int):
        self.width, self.height = width, height
        self._tile = tile_of(width)
        tall, wide = self._tile
        self._across = -(-width // wide)
        self._rows = -(-height // tall)
        self._tiles = self._across * self._rows
        self._under = on_device(2 * width * height)
        self._near = on_device(3 * (width + 2) * (height + 2) + 2 * self._tiles * tall)
        self._near.fill(-1)
        self._box = self._boxes(64)
        self._vertex, self._globe = on_device(5), on_device(4, real=True)
        self._kinds: tuple[bool, ...] = (False, False, True)
        self.fresh = True  # whether all pixels are to be written

    def _boxes(self, chunks: int) -> Any:
        return on_device(frame.LAYERS * self._tiles + chunks, 4)

    def lay(self, background: int, floor: Floor | None, lens: Lens) -> None:
        """Have what lies behind everything: a floor, or none. background: 0xRRGGBB."""
        numbers = NO_NUMBERS if floor is None else floor.numbers()
        looked = np.array([lens.focal, *lens.middle, 0.0], np.float32)
        w, h = self.width, self.height
        behind.lay(background, numbers, looked, w, h, h * behind.ROWS, self._under)
        self.fresh = True

    def stand(self, things: Things, lens: Lens) -> None:
        """Have things stand still before what was laid."""
        w, h = self.width, self.height
        self._launch(things, lens, self._under, w, (0, h), stands=True)
        self.fresh = True

    def draw(
        self,
        image: Any,
        width: int,
        corner: tuple[int, int],
        things: Things,
        lens: Lens,
        floor: Floor | None,
        shade: Shade | None,
        again: tuple[int, ...],
    ) -> None:
        """Draw things into an image.

        image: (h * width,) int32, in which the room's upper left pixel is `corner`. shade: on the
        floor. again: columns and rows, from and to, in which something else was drawn meanwhile.
        """
        self._launch(things, lens, image, width, corner, floor, shade, again)
        self.fresh = False

    def _launch(
        self,
        things: Things,
        lens: Lens,
        image: Any,
        width: int,
        corner: tuple[int, int],
        floor: Floor | None = None,
        shade: Shade | None = None,
        again: tuple[int, ...] = NOWHERE,
        *,
        stands: bool = False,
    ) -> None:
        number, dark = lens.numbers(things.firm, things.veil), UNSHADED
        count = np.zeros(frame.COUNTS + 2 * self._rows, np.int32)
        count[frame.COUNTS :: 2] = frame.ABSENT
        if shade is not None and floor is not None:
            homography = floor.homography(shade, lens)
            number[frame.SHADE :][:9] = homography.reshape(-1)
            spans = shade.spans(homography, self.width, self.height, self._tile[0])
            count[frame.COUNTS :] = spans.reshape(-1)
            dark = shade.dark
        chunks = self._count(count, things)
        self._grow(things, chunks)
        count[frame.ROOM :][:4] = *corner, self.width, self.height
        count[frame.TILE :][:4] = *self._tile, self._across, self._tiles
        count[frame.STANDS], count[frame.FRESH] = stands, stands or self.fresh
        count[frame.AGAIN :][:4] = again
        count[frame.WORKERS] = runtime.current_device().threads
        count[frame.WIDTH] = width
        there = bool(len(things.corner)), bool(len(things.ball)), bool(len(things.line))
        self._kinds = tuple(a or b for a, b in zip(self._kinds, there, strict=True))
        places, normals, sides, triangles, beside, balls, lines = (
            np.ascontiguousarray(of).reshape(-1)
            for of in (
                *(things.place, things.normal, things.side),
                *(things.corner, things.beside, things.ball, things.line),
            )
        )
        sight.see(
            self._kinds, places, normals, sides, triangles, balls, lines, number, count,
            self._vertex, self._globe, self._box,
        )  # fmt: skip
        for layer in range(2 if things.veil != Group() else 1):
            count[frame.NEXT :][:2] = 0
            raster.draw(
                self._kinds, layer, triangles, beside, balls, lines, number, count, self._vertex,
                self._globe, self._box, self._near, self._under, dark, image,
            )  # fmt: skip

    def _count(self, count: np.ndarray, things: Things) -> int:
        """Fill in how many things there are, and in which chunks; how many of these."""
        count[frame.VERTICES] = len(things.place)
        firm, veil = things.firm, things.veil
        chunk, at = 0, frame.GROUPS
        begins = (0, 0, 0), (firm.triangles, firm.balls, firm.lines)
        for begin, group in zip(begins, (firm, veil), strict=True):
            for first, number in zip(
                begin, (group.triangles, group.balls, group.lines), strict=True
            ):
                count[at : at + 3] = first, first + number, chunk
                chunk += -(-number // frame.CHUNK)
                at += 3
        count[frame.CHUNKS] = chunk
        return chunk

    def _grow(self, things: Things, chunks: int) -> None:
        """Have room for things."""
        if self._vertex.shape[0] < 5 * len(things.place):
            self._vertex = on_device(5 * len(things.place))
        if self._globe.shape[0] < 4 * len(things.ball):
            self._globe = on_device(4 * 2 * len(things.ball), real=True)
        if self._box.shape[0] < frame.LAYERS * self._tiles + chunks:
            self._box, self.fresh = self._boxes(2 * chunks), True
