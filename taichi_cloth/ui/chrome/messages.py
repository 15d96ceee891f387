"""Messages over the world for a while: a list of keys, a banner where a run stopped."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.render.picture import Rect
from taichi_cloth.render.tiles import Panel, Tile
from taichi_cloth.ui import text

Meanings = tuple[tuple[str, text.Color], ...]  # of colours, in words

SMALLEST = 8  # pixels of text that is shrunk to fit


@lru_cache(maxsize=4)
def keys(lines: tuple[str, ...], height: int, *rooms: Rect) -> Panel:
    """The list of keys, "key<tab>action", in the middle of the first of some rooms, each wider than
    the one before, in which it is the easiest to read.

    height: of the text, pixels; less where the list would not fit, in one block or in two beside
    each other. Where neither fits, its end says that there is more.
    """
    ways = [(room, blocks) for room in rooms for blocks in ([lines], _halved(lines))]
    room, blocks = max(ways, key=lambda way: _fitting(way[1], way[0], height))
    fitting = _fitting(blocks, room, height)
    if not fitting:
        fitting, room = SMALLEST, rooms[-1]
        lines = _begun(lines, room)
        blocks = [lines]
    tall = max(text.extent(block, fitting)[1] for block in blocks)
    inks = style.KEY_INK, style.INK
    drawn = [text.rasterise(block, fitting, paper=style.PAPER, inks=inks) for block in blocks]
    gap = _gap(blocks, fitting)
    wide = sum(one.shape[1] for one in drawn) + gap
    pixels = np.full((tall, wide, 3), style.PAPER, np.uint8)
    x = 0
    for one in drawn:
        pixels[: len(one), x : x + one.shape[1]] = one
        x += one.shape[1] + gap
    for border in (pixels[:1], pixels[-1:], pixels[:, :1], pixels[:, -1:]):
        border[:] = style.WALL
    pixels = pixels[: room.height, : room.width]
    left = room.x + (room.width - pixels.shape[1]) // 2
    top = room.y + (room.height - pixels.shape[0]) // 2
    return Panel(left, top, Tile(pixels), "\n".join(lines))


@lru_cache(maxsize=4)
def hints(lines: tuple[str, ...], room: Rect, height: int) -> tuple[Panel, ...]:
    """Lines "key<tab>action" in the middle of the world's foot; none where they do not fit."""
    fitting = _fitting([lines], room, height)
    if not fitting:
        return ()
    inks = style.KEY_INK, style.INK
    pixels = text.rasterise(lines, fitting, paper=style.PAPER, inks=inks)
    tall, wide = pixels.shape[:2]
    left = room.x + (room.width - wide) // 2
    top = room.y + max(room.height - tall - 3 * height, 0)
    return (Panel(left, top, Tile(pixels), "\n".join(lines)),)


Blocks = list[tuple[str, ...]]  # lines, in columns beside each other


def _halved(lines: tuple[str, ...]) -> Blocks:
    half = (len(lines) + 1) // 2
    return [lines[:half], lines[half:]]


def _gap(blocks: Blocks, height: int) -> int:
    """Pixels between two blocks."""
    return height if len(blocks) > 1 else 0


def _fitting(blocks: Blocks, room: Rect, height: int) -> int:
    """The height of text, at most `height`, at which blocks fit into a room; 0: at none."""

    def fits(size: int) -> bool:
        wide, tall = zip(*(text.extent(block, size) for block in blocks), strict=True)
        return bool(sum(wide) + _gap(blocks, size) <= room.width and max(tall) <= room.height)

    sizes = range(height, SMALLEST - 1, -1)
    found = bisect_left(sizes, True, key=fits)  # not one by one: large text takes long to measure
    return sizes[found] if found < len(sizes) else 0


def _begun(lines: tuple[str, ...], room: Rect) -> tuple[str, ...]:
    """As many lines of the smallest text as a room holds, and one that says that there are more."""
    count = len(lines)
    while count > 1 and text.extent(lines[:count], SMALLEST)[1] > room.height:
        count -= 1
    if count == len(lines):
        return lines
    return *lines[: count - 1], f"{text.ELLIPSIS}\tmore in a larger window"


def legends(rows: Sequence[Meanings], room: Rect, height: int) -> tuple[Panel, ...]:
    """Legends of colours, at the lower left of the world's room, a row above the other."""
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
    across = sum(widths) + gap * (len(widths) + 1)
    if across > room.width and height > SMALLEST:
        return _legend(meanings, room, height - 1)
    pixels: np.ndarray = np.empty((round(1.8 * height), across, 3), np.uint8)
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
