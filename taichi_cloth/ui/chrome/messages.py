"""What is laid over the world for a while: a list of keys, a banner where a run stopped."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from taichi_cloth.ui import style, text
from taichi_cloth.ui.chrome.layout import Rect
from taichi_cloth.ui.tiles import Panel, Tile

Meanings = tuple[tuple[str, text.Color], ...]  # of colours, in words

SMALLEST = 8  # pixels of text that is shrunk to fit


@lru_cache(maxsize=4)
def keys(lines: tuple[str, ...], room: Rect, height: int) -> Panel:
    """The list of keys, "key<tab>action", in the middle of the world's room.

    height: of the text, pixels; less where the list would not fit.
    """
    while height > SMALLEST:
        wide, tall = text.extent(lines, height)
        if wide <= room.width and tall <= room.height:
            break
        height -= 1
    pixels = text.rasterise(lines, height, paper=style.PAPER, inks=(style.KEY_INK, style.INK))
    for border in (pixels[:1], pixels[-1:], pixels[:, :1], pixels[:, -1:]):
        border[:] = style.WALL
    pixels = pixels[: room.height, : room.width]
    left = room.x + (room.width - pixels.shape[1]) // 2
    top = room.y + (room.height - pixels.shape[0]) // 2
    return Panel(left, top, Tile(pixels), "\n".join(lines))


def legends(rows: list[Meanings], room: Rect, height: int) -> tuple[Panel, ...]:
    """What colours mean, at the lower left of the world's room, a row above the other."""
    panels: list[Panel] = []
    for row in rows:
        panels.append(_legend(row, room, height))
        room = replace(room, height=panels[-1].y - room.y)
    return tuple(panels)


@lru_cache(maxsize=4)
def _legend(meanings: Meanings, room: Rect, height: int) -> Panel:
    """One row of them: words, each beside its colour; in smaller letters where they are many."""
    gap, box = round(0.6 * height), round(0.7 * height)
    widths = [box + gap // 2 + round(text.length(words, height)) for words, _ in meanings]
    if sum(widths) + gap * (len(widths) + 1) > room.width and height > SMALLEST:
        return _legend(meanings, room, height - 1)
    pixels = np.empty((round(1.8 * height), sum(widths) + gap * (len(widths) + 1), 3), np.uint8)
    pixels[:] = style.PAPER
    x, top = gap, (len(pixels) - box) // 2
    for (words, color), width in zip(meanings, widths, strict=True):
        pixels[top : top + box, x : x + box] = color
        text.write(pixels, words, (x + box + gap // 2, 0.4 * height), height, style.INK)
        x += width + gap
    pixels = pixels[: room.height, : room.width]
    words = " ".join(words for words, _ in meanings)
    return Panel(room.x, room.y + room.height - len(pixels), Tile(pixels), words)


@lru_cache(maxsize=4)
def banner(message: str, room: Rect, height: int) -> Panel:
    """A message across the top of the world's room, wrapped as needed."""
    width = room.width - 2 * height
    lines = [part for line in message.split("\n") for part in text.wrapped(line, width, height)]
    pixels = text.rasterise(
        lines, height, paper=style.BANNER_PAPER, inks=(style.BANNER_INK,) * 2, width=room.width
    )
    return Panel(room.x, room.y, Tile(pixels[: room.height]), message)
