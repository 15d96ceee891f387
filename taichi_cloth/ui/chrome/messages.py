"""What is laid over the world for a while: a list of keys, a banner where a run stopped, marks."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from taichi_cloth.ui import style, text
from taichi_cloth.ui.chrome.layout import Rect
from taichi_cloth.ui.text import Panel

SMALLEST = 8  # pixels of text that is shrunk to fit
DOT = "\u25cf "  # before a line of `marks`: a red disc stands in its place


@lru_cache(maxsize=4)
def keys(lines: tuple[str, ...], room: Rect, height: int) -> Panel:
    """The list of keys, "key<tab>action", in the middle of the world's room.

    height: of the text, pixels; less where the list would not fit.
    """
    while True:
        pixels = text.rasterise(lines, height, paper=style.PAPER, inks=(style.KEY_INK, style.INK))
        fits = pixels.shape[0] <= room.height and pixels.shape[1] <= room.width
        if fits or height <= SMALLEST:
            break
        height -= 1
    for border in (pixels[:1], pixels[-1:], pixels[:, :1], pixels[:, -1:]):
        border[:] = style.WALL
    pixels = pixels[: room.height, : room.width]
    left = room.x + (room.width - pixels.shape[1]) // 2
    top = room.y + (room.height - pixels.shape[0]) // 2
    return Panel(left, top, pixels, "\n".join(lines))


@lru_cache(maxsize=4)
def banner(message: str, room: Rect, height: int) -> Panel:
    """A message across the top of the world's room, wrapped as needed."""
    width = room.width - 2 * height
    lines = [part for line in message.split("\n") for part in text.wrapped(line, width, height)]
    pixels = text.rasterise(
        lines, height, paper=style.BANNER_PAPER, inks=(style.BANNER_INK,) * 2, width=room.width
    )
    return Panel(room.x, room.y, pixels[: room.height], message)


@lru_cache(maxsize=4)
def marks(lines: tuple[str, ...], room: Rect, height: int) -> tuple[Panel, ...]:
    """Lines in the top right corner of the world's room, smaller where they are too long.

    One that begins with `DOT` has a red disc there.
    """
    out, top = [], room.y
    for line in lines:
        fitting = height
        while fitting > SMALLEST and text.length(line, fitting) > room.width - 2 * fitting:
            fitting -= 1
        red, said = line.startswith(DOT), line.removeprefix(DOT)
        pixels = text.rasterise([said], fitting, paper=style.PAPER, inks=(style.INK, style.INK))
        if red:
            disc = _red_disc(len(pixels))
            pixels = np.concatenate([disc, pixels[:, text.pad(fitting) // 2 :]], 1)
        pixels = pixels[:, : room.width]
        out.append(Panel(room.x + room.width - pixels.shape[1], top, pixels, line))
        top += len(pixels)
    return tuple(out)


def _red_disc(side: int) -> np.ndarray:
    """A red disc on paper, (side, side, 3) uint8, with smooth edges."""
    away = np.hypot(*(np.mgrid[:side, :side] + 0.5 - side / 2))
    share = np.round(np.clip(0.28 * side + 0.5 - away, 0, 1) * 4)[:, :, None] / 4
    disc: np.ndarray = share * np.array(style.RECORDING) + (1 - share) * np.array(style.PAPER)
    return disc.astype(np.uint8)
