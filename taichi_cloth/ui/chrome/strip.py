"""The status: a row under the world, and further rows where details are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taichi_cloth.ui import style, text
from taichi_cloth.ui.chrome.layout import Rect
from taichi_cloth.ui.text import Panel, Word

SEPARATOR = "   "  # between the words, where they are read as one line


@dataclass(frozen=True)
class Row:
    """A row of the status: what stands at its left and at its right end."""

    left: tuple[Word, ...]
    right: tuple[Word, ...] = ()


def panel(rows: Sequence[Row], rect: Rect, height: int) -> Panel:
    """The status in its rectangle; height: of the text, pixels."""
    pixels = np.empty((rect.height, rect.width, 3), np.uint8)
    pixels[:] = style.PAPER
    step, y = round(1.3 * height), round(0.4 * height)
    said = []
    for number, row in enumerate(rows):
        text.write_row(pixels, row.left, row.right, y + number * step, height)
        left, right = text.fitted(row.left, row.right, rect.width, height)
        said.append(SEPARATOR.join(word.text for word in (*left, *right)))
    return Panel(rect.x, rect.y, pixels, "\n".join(said))
