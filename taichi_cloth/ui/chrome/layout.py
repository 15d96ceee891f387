"""The layout of a window: the world, and what is around it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from taichi_cloth.render.picture import Rect

SIDE_SHARE = 0.27  # of the window's width that a column beside the world takes
SIDE_WIDTH = (15.0, 26.0)  # in text heights: below it labels do not fit, above it is mostly empty
SMALLEST_TEXT = 8  # pixels
SMALLEST_ROOM = 64  # pixels that the world keeps along each side, whatever is open


@dataclass(frozen=True)
class Parts:
    """The parts that are open beside the world.

    bar: the tool bar. strip: rows of the status. row: the name of what stands in the row above it
    ("": nothing). columns: the names of what stands in the column at the right, from the top down.
    text: the size of all text, in parts of the usual.
    """

    bar: bool = False
    strip: int = 0
    row: str = ""
    columns: tuple[str, ...] = ()
    text: float = 1.0


NOTHING = Parts()
ROWS = 2  # of a status: counts, then settings


def at_start(*, windowed: bool, status: bool, text: float = 1.0) -> Parts:
    """The parts open from the start, where a status is wanted: in a window a tool bar and the first
    row of the status; in a picture, which nobody can ask for more, the whole status.

    text: the size of all text, in parts of the usual.
    """
    if not status:
        return Parts(text=text)
    return Parts(bar=True, strip=1, text=text) if windowed else Parts(strip=ROWS, text=text)


@dataclass(frozen=True)
class Layout:
    """Arrange everything in a window of `size` (width, height) whose text is `text` pixels high.

    world: where the world is shown. bar, strip, row: None where they are not open.
    columns: by name, what stands at the right.
    """

    size: tuple[int, int]
    text: int
    world: Rect
    bar: Rect | None
    strip: Rect | None
    row: Rect | None
    columns: dict[str, Rect]

    @property
    def within(self) -> Rect:
        """The room between the bar and the status: the world, and all that is open beside it."""
        below = self.strip.y if self.strip else self.size[1]
        return Rect(0, self.world.y, self.size[0], below - self.world.y)


def text_height(window_height: int) -> int:
    """Height of the text in pixels, readable in small windows and large."""
    return int(np.clip(round(window_height / 52), 12, 30))


def bar_height(text: int) -> int:
    """Height of the tool bar, pixels."""
    return round(2.1 * text)


def strip_height(rows: int, text: int) -> int:
    """Height of the status with so many rows, pixels."""
    return round(1.3 * text) * rows + round(0.6 * text) if rows else 0


def row_height(text: int) -> int:
    """Height of the row above the status, pixels."""
    return round(2.6 * text)


def arrange(size: tuple[int, int], parts: Parts) -> Layout:
    """Cut a window of `size` (width, height) into the world's room and what is open beside it.

    Where the world would have too little, what matters least is left out.
    """
    width, height = int(size[0]), int(size[1])
    text = max(SMALLEST_TEXT, round(text_height(height) * parts.text))
    parts = _fitting(parts, width, height, text)
    top, bottom, line = _heights(parts, text)
    side = _side(width, text) if parts.columns else 0
    free = height - top - bottom - line
    columns, y = {}, top
    for number, name in enumerate(parts.columns):
        tall = (top + free - y) // (len(parts.columns) - number)
        columns[name] = Rect(width - side, y, side, tall)
        y += tall
    return Layout(
        size=(width, height),
        text=text,
        world=Rect(0, top, width - side, free),
        bar=Rect(0, 0, width, top) if parts.bar else None,
        strip=Rect(0, height - bottom, width, bottom) if parts.strip else None,
        row=Rect(0, top + free, width, line) if parts.row else None,
        columns=columns,
    )


def _fitting(parts: Parts, width: int, height: int, text: int) -> Parts:
    """Of the parts as many as leave the world its room."""
    if parts.columns and width - _side(width, text) < SMALLEST_ROOM:
        parts = replace(parts, columns=())
    for fewer in ({}, {"row": ""}, {"strip": min(1, parts.strip)}, {"strip": 0}):
        parts = replace(parts, **fewer)
        if height - sum(_heights(parts, text)) >= SMALLEST_ROOM:
            return parts
    return NOTHING


def _heights(parts: Parts, text: int) -> tuple[int, int, int]:
    """Heights of the bar, the status and the row above it, pixels; 0 where they are not open."""
    return (
        bar_height(text) if parts.bar else 0,
        strip_height(parts.strip, text),
        row_height(text) if parts.row else 0,
    )


def _side(width: int, text: int) -> int:
    """Width of the column at the right, pixels."""
    least, most = (round(n * text) for n in SIDE_WIDTH)
    return int(np.clip(round(SIDE_SHARE * width), least, most))
