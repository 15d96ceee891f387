"""From a picture to an image: the world, or two beside each other, and what is laid over them."""

from __future__ import annotations

from typing import Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.kernels.render import paint
from taichi_cloth.render import style
from taichi_cloth.render.camera import Camera
from taichi_cloth.render.painter import Painter
from taichi_cloth.render.picture import Bounds, Picture, Rect
from taichi_cloth.render.plane import Plane, pointer_shapes
from taichi_cloth.render.pointer import Pointer
from taichi_cloth.render.rasterizer import NOWHERE, on_device
from taichi_cloth.render.space import Space
from taichi_cloth.render.tiles import Panel, Tile
from taichi_cloth.render.window_map import Look, WindowMap


class Renderer:
    """Draws pictures of `size` (width, height) pixels; what has not changed is left as it was.

    image: (h * w,) int32, 0xRRGGBB, row 0 on top: an array of NumPy's where a processor draws, else
    one on the device. buffer: what is to be the image where a processor draws, (h, w) uint32.
    """

    def __init__(self, size: tuple[int, int], buffer: np.ndarray | None = None):
        self.size = size
        on_cpu = runtime.current_device().arch == "cpu"
        if buffer is not None and on_cpu:
            self.image: Any = buffer.reshape(-1).view(np.int32)
        else:
            self.image = on_device(size[0] * size[1])
        self._of: tuple[Any, ...] = ()  # the rooms and worlds that it draws
        self._bounds: Bounds | None = None  # of these worlds; kept, for an id can be given again
        self._worlds: list[Space | Plane] = []
        self._pointers: list[Painter] = []
        self._pointed: list[tuple[int, ...]] = []  # where each pointer was
        self._laid: dict[tuple[int, int], Panel] = {}

    def draw(
        self,
        picture: Picture,
        bounds: Bounds,
        camera: Camera | None,
        room: Rect | None,
        look: Look | None,
    ) -> None:
        """Draw a picture.

        bounds: of its world. camera: of a world in space. room: where the world is drawn; None:
        everywhere. look: which part of a plane is seen; None: all.
        """
        room = room or Rect(0, 0, *self.size)
        drawn = [(picture, room)]
        if picture.beside is not None:
            drawn.append((picture.beside.picture, picture.beside.room))
        rooms = [room for _, room in drawn]
        self._open(rooms, bounds, camera)
        width, gone = self.size[0], [_rect(panel) for panel in self._gone(picture.overlay)]
        for rect in gone:
            if not any(_is_within(rect, room) for room in rooms):
                self._wipe(rect)
        for n, (some, there) in enumerate(drawn):
            world, window = self._worlds[n], WindowMap.of(bounds, self.size, there, look)
            over = [rect for rect in gone if _meet(rect, _bounds(there))]
            again = _around([*over, self._pointed[n]])
            if isinstance(world, Space):
                assert camera is not None
                inside = tuple(
                    at - origin
                    for at, origin in zip(again, (there.x, there.x, there.y, there.y), strict=True)
                )
                world.draw(self.image, width, some, bounds, camera, window, inside)
                self._pointed[n] = _reach(some.pointer)
                self._pointers[n].draw(self.image, width, pointer_shapes(some.pointer))
            else:
                world.draw(self.image, width, some, bounds, window, again)
        self._lay(picture.overlay, [*map(_bounds, rooms), *gone])

    def pixels(self) -> np.ndarray:
        """The image, (h, w) uint32; where it lies on a device, a copy."""
        w, h = self.size
        if isinstance(self.image, np.ndarray):
            found: np.ndarray = self.image.view(np.uint32).reshape(h, w)
            return found
        found = self.image.to_numpy().view(np.uint32).reshape(h, w)
        return found

    def copy_to(self, shown: Any) -> None:
        """Copy the image on the device into a field (w, h) of four bytes each, row 0 last."""
        w, h = self.size
        paint.as_bytes(self.image, w, h, _parts(w, h), shown)

    def _open(self, rooms: list[Rect], bounds: Bounds, camera: Camera | None) -> None:
        """Have something to draw each world with; all is drawn anew where that changes."""
        wanted = (*rooms, id(bounds), camera is None)
        if wanted == self._of:
            return
        self._of, self._bounds, self._laid = wanted, bounds, {}
        self.image.fill(style.packed_one(style.PAPER))
        height = self.size[1]
        self._worlds = [Plane(room) if camera is None else Space(room, height) for room in rooms]
        self._pointers = [Painter(room) for room in rooms]
        self._pointed = [NOWHERE for _ in rooms]

    # Panels

    def _gone(self, overlay: tuple[Panel, ...]) -> list[Panel]:
        """The panels that lie over the image and are to lie there no more."""
        there = {(panel.x, panel.y): panel.tile for panel in overlay}
        return [p for at, p in self._laid.items() if there.get(at) is not p.tile]

    def _lay(self, overlay: tuple[Panel, ...], drawn: list[tuple[int, ...]]) -> None:
        """Lay panels over the image: those that are new, and those over what was drawn."""
        for panel in overlay:
            before, rect = self._laid.get((panel.x, panel.y)), _rect(panel)
            new = before is None or before.tile is not panel.tile
            if new or any(_meet(rect, other) for other in drawn):
                self._put(panel)
                drawn = [*drawn, rect]
        self._laid = {(panel.x, panel.y): panel for panel in overlay}

    def _wipe(self, rect: tuple[int, ...]) -> None:
        """Have nothing in a rectangle."""
        x0, x1, y0, y1 = rect
        paper = np.empty((y1 - y0, x1 - x0, 3), np.uint8)
        paper[:] = style.PAPER
        self._put(Panel(x0, y0, Tile(paper)))

    def _put(self, panel: Panel) -> None:
        packed = panel.tile.packed
        h, w = packed.shape
        h, w = min(h, self.size[1] - panel.y), min(w, self.size[0] - panel.x)
        packed = packed[:h, :w]
        if isinstance(self.image, np.ndarray):
            rows = self.image.view(np.uint32).reshape(self.size[::-1])
            rows[panel.y : panel.y + h, panel.x : panel.x + w] = packed
        else:
            pixels = np.ascontiguousarray(packed).view(np.int32)
            paint.put(pixels, panel.x, panel.y, self.size[0], _parts(w, h), self.image)


def _parts(w: int, h: int) -> int:
    """The pieces of rows in which kernels copy an image."""
    return -(-w // paint.PART) * h


def _rect(panel: Panel) -> tuple[int, ...]:
    """The rectangle of a panel: columns from and to, rows from and to."""
    tall, wide = panel.tile.packed.shape
    return panel.x, panel.x + wide, panel.y, panel.y + tall


def _bounds(room: Rect) -> tuple[int, ...]:
    """A room as such a rectangle."""
    return room.x, room.x + room.width, room.y, room.y + room.height


def _meet(one: tuple[int, ...], other: tuple[int, ...]) -> bool:
    """True if two such rectangles have a pixel in common."""
    across = one[0] < other[1] and other[0] < one[1]
    return across and one[2] < other[3] and other[2] < one[3]


def _is_within(rect: tuple[int, ...], room: Rect) -> bool:
    x0, x1, y0, y1 = _bounds(room)
    return rect[0] >= x0 and rect[1] <= x1 and rect[2] >= y0 and rect[3] <= y1


def _around(rects: list[tuple[int, ...]]) -> tuple[int, ...]:
    """The rectangle around others; each: columns from and to, rows from and to."""
    x0, x1, y0, y1 = zip(*rects, strict=True)
    return min(x0), max(x1), min(y0), max(y1)


def _reach(drawn: Pointer | None) -> tuple[int, ...]:
    """The rectangle of a pointer."""
    if drawn is None or not len(ends := drawn.lines().reshape(-1, 2)):
        return NOWHERE
    low, high = np.clip([ends.min(axis=0) - 4, ends.max(axis=0) + 5], -1e8, 1e8).astype(int)
    return int(low[0]), int(high[0]), int(low[1]), int(high[1])
