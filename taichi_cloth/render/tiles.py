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


@dataclass(frozen=True, eq=False)
class Panel:
    """A tile whose top left corner is the window pixel (x, y). words: what is written there."""

    x: int
    y: int
    tile: Tile
    words: str = ""
