"""Opaque pictures that lie over the frame of every view, in the same pixels.

What is made of a tile is kept with it, so that words which stand elsewhere in the next frame, or
beside others, need not be made anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True, eq=False)  # compared by identity
class Tile:
    """Pixels (h, w, 3) uint8, which nobody changes any more."""

    pixels: np.ndarray

    @cached_property
    def packed(self) -> np.ndarray:
        """The pixels, (h, w) uint32, 0xRRGGBB."""
        red, green, blue = np.moveaxis(self.pixels.astype(np.uint32), 2, 0)
        packed: np.ndarray = red << 16 | green << 8 | blue
        return packed

    @cached_property
    def runs(self) -> tuple[np.ndarray, np.ndarray]:
        """The tile as rectangles: corners (k, 4) pixels x0, y0, x1, y1, and colours (k, 3).

        The first is the whole paper; the rest are runs of equal colour along rows, those that
        repeat from row to row as one. Colours are floats 0..1.
        """
        code = self.packed.astype(np.int64)
        h, w = code.shape
        paper = _commonest(code)
        key = ((np.arange(h)[:, None] << 24) | code).reshape(-1)
        start = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
        end = np.concatenate([start[1:], [h * w]])
        inked = code.reshape(-1)[start] != paper
        start, end = start[inked], end[inked]
        row, x0 = start // w, start % w
        boxes = np.stack([x0, row, x0 + end - start, row + 1, code.reshape(-1)[start]], axis=1)
        boxes = np.concatenate([[[0, 0, w, h, paper]], _stacked(boxes)])
        codes = boxes[:, 4]
        colors = np.stack([codes >> 16, (codes >> 8) & 255, codes & 255], axis=1) / 255
        return boxes[:, :4], colors


@dataclass(frozen=True, eq=False)
class Panel:
    """A tile whose top left corner is the window pixel (x, y). words: what is written there."""

    x: int
    y: int
    tile: Tile
    words: str = ""


def _commonest(code: np.ndarray) -> int:
    """The colour that most pixels have, of each fourth in each fourth row."""
    values, counts = np.unique(code[::4, ::4], return_counts=True)
    return int(values[counts.argmax()])


def _stacked(boxes: np.ndarray) -> np.ndarray:
    """Boxes (k, 5) x0, y0, x1, y1, colour, those that lie upon each other in one where they can."""
    if not len(boxes):
        return boxes
    x0, y0, x1, _, code = boxes.T
    boxes = boxes[np.lexsort((y0, code, x1, x0))]
    alike = (boxes[1:, [0, 2, 4]] == boxes[:-1, [0, 2, 4]]).all(axis=1)
    first = np.flatnonzero(np.concatenate([[True], ~alike | (boxes[1:, 1] != boxes[:-1, 3])]))
    last = np.concatenate([first[1:], [len(boxes)]]) - 1
    joined: np.ndarray = boxes[first].copy()
    joined[:, 3] = boxes[last, 3]
    return joined
