"""What is laid over the world for a while: a list of keys, a banner where a run stopped."""

from __future__ import annotations

from functools import lru_cache

from taichi_cloth.ui import style, text
from taichi_cloth.ui.chrome.layout import Rect
from taichi_cloth.ui.text import Panel

SMALLEST = 8  # pixels of text that is shrunk to fit


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
