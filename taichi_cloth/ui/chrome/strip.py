"""The status: a row under the world, and further rows where details are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.render.picture import Rect
from taichi_cloth.render.tiles import Panel, Tile
from taichi_cloth.ui import text
from taichi_cloth.ui.text import Word

SEPARATOR = "   "  # between the words, where they are read as one line


@dataclass(frozen=True)
class Row:
    """A row of the status: what stands at its left and at its right end."""

    left: tuple[Word, ...]
    right: tuple[Word, ...] = ()


def panels(rows: Sequence[Row], rect: Rect, height: int) -> tuple[Panel, ...]:
    """The status in its rectangle: its paper, whose words are all that is said, and upon it a tile
    for each of them, as few of them change from frame to frame. height: of the text, pixels.
    """
    step, top = round(1.3 * height), round(0.4 * height)
    words, said = [], []
    for number, row in enumerate(rows):
        placed = text.placed(row.left, row.right, rect.width, height)
        said.append(SEPARATOR.join(word.text for word, _ in placed))
        y = top + number * step - text.rise(height)
        for word, x in placed:
            room = rect.width - x + 1, min(step, rect.height - y)
            tile = _tile(word.text, word.color, height, room)
            words.append(Panel(rect.x + x - 1, rect.y + y, tile))
    return Panel(rect.x, rect.y, _paper(rect.width, rect.height), "\n".join(said)), *words


@lru_cache(maxsize=4)
def _paper(width: int, height: int) -> Tile:
    return Tile(np.full((height, width, 3), style.PAPER, np.uint8))


@lru_cache(maxsize=256)
def _tile(said: str, color: text.Color, height: int, room: tuple[int, int]) -> Tile:
    """Words from the second column on. room: width and height that there are at most, pixels."""
    wide = min(round(text.length(said, height)) + 3, room[0])
    pixels = np.full((room[1], wide, 3), style.PAPER, np.uint8)
    text.write(pixels, said, (1, text.rise(height)), height, color)
    return Tile(pixels)
