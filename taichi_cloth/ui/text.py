"""Text as small opaque pictures, laid over the frame by every view in the same pixels.

Taichi's windows cannot blend, so each panel is rasterised here against its own paper; a view
either copies the pixels or draws `runs` of equal colour as rectangles.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.ui import style
from taichi_cloth.ui.views.contract import Picture

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont, ImageFont

Color = tuple[int, int, int]  # 0..255
SHADES = 6  # ink coverage levels: few enough for long runs, enough for smooth letters


@dataclass(frozen=True, eq=False)  # compared by identity: `panels` keeps what it made
class Panel:
    """Pixels (h, w, 3) uint8 whose top left corner is the window pixel (x, y)."""

    x: int
    y: int
    pixels: np.ndarray


def font_height(window_height: int) -> int:
    """Height of the text in pixels, readable in small windows and large."""
    return int(np.clip(round(window_height / 52), 12, 30))


@lru_cache(maxsize=8)
def _font(height: int) -> ImageFont | FreeTypeFont:
    from PIL import ImageFont

    return ImageFont.load_default(height)


def wrapped(line: str, width: int, height: int) -> list[str]:
    """`line` broken at spaces so that each part is at most `width` pixels wide."""
    font, out, current = _font(height), [], ""
    for word in line.split():
        longer = f"{current} {word}".strip()
        if current and font.getlength(longer) > width:
            out.append(current)
            current = word
        else:
            current = longer
    return [*out, current]


def rasterise(
    lines: Iterable[str],
    height: int,
    *,
    paper: Color,
    inks: tuple[Color, Color],
    width: int | None = None,
) -> np.ndarray:
    """`lines` as pixels (h, w, 3) uint8 on `paper`.

    A tab starts the second column. inks: a pair of colours, for what stands before and after the
    tab (the second for lines without one). width: of the panel in pixels; None: as needed.
    """
    from PIL import Image, ImageDraw

    font = _font(height)
    step, pad = round(1.27 * height), round(0.5 * height)
    parts = [line.split("\t", 1) for line in lines]
    column = max((font.getlength(p[0]) for p in parts if len(p) == 2), default=0.0)
    column = round(column + 1.2 * height) if column else 0
    needed = max((column * (len(p) == 2) + font.getlength(p[-1]) for p in parts), default=0.0)
    size = (width or round(needed) + 2 * pad, step * len(parts) + 2 * pad - (step - height))
    pixels = np.empty((size[1], size[0], 3), np.uint8)
    pixels[:] = paper
    for ink, chosen in zip(inks, (0, 1), strict=True):
        image = Image.new("L", size, 0)
        draw = ImageDraw.Draw(image)
        for row, part in enumerate(parts):
            y = pad + row * step - round(0.15 * height)
            if chosen == 1:
                draw.text((pad + column * (len(part) == 2), y), part[-1], fill=255, font=font)
            elif len(part) == 2:
                draw.text((pad, y), part[0], fill=255, font=font)
        share = np.asarray(image, np.float32)[:, :, None] / 255
        # A light gamma keeps thin strokes of bright letters from fading into dark paper.
        share = np.round(share**0.8 * (SHADES - 1)) / (SHADES - 1)
        pixels[:] = np.where(share > 0, pixels * (1 - share) + np.array(ink) * share, pixels)
    return pixels


def panels(picture: Picture, size: tuple[int, int]) -> tuple[Panel, ...]:
    """The overlay of a frame in a window of `size` (width, height): status, key list, banner."""
    return _panels(picture.text, picture.help, picture.banner, (int(size[0]), int(size[1])))


@lru_cache(maxsize=4)
def _panels(
    status: tuple[str, ...], keys: tuple[str, ...], banner: str | None, size: tuple[int, int]
) -> tuple[Panel, ...]:
    width, window_height = size
    out = []
    if status:
        # The status shrinks rather than leave a narrow window.
        height = font_height(window_height)
        while height > 9 and max(map(_font(height).getlength, status)) > width - height:
            height -= 1
        pixels = rasterise(status, height, paper=style.PAPER, inks=(style.FAINT_INK, style.INK))
        out.append(Panel(0, window_height - len(pixels), pixels))
    if keys:
        height = font_height(window_height)
        while True:
            pixels = rasterise(keys, height, paper=style.PAPER, inks=(style.KEY_INK, style.INK))
            fits = pixels.shape[0] <= window_height and pixels.shape[1] <= width
            if fits or height <= 8:
                break
            height -= 1
        for border in (pixels[:1], pixels[-1:], pixels[:, :1], pixels[:, -1:]):
            border[:] = style.WALL
        left, top = (width - pixels.shape[1]) // 2, (window_height - pixels.shape[0]) // 2
        out.append(Panel(left, top, pixels))
    if banner:
        height = font_height(window_height)
        room = width - 2 * height
        lines = [part for line in banner.split("\n") for part in wrapped(line, room, height)]
        pixels = rasterise(
            lines, height, paper=style.BANNER_PAPER, inks=(style.BANNER_INK,) * 2, width=width
        )
        out.append(Panel(0, 0, pixels))
    return tuple(_inside(panel, size) for panel in out)


def _inside(panel: Panel, size: tuple[int, int]) -> Panel:
    """The part of `panel` that lies in a window of `size`."""
    left, top = max(0, -panel.x), max(0, -panel.y)
    right, bottom = size[0] - panel.x, size[1] - panel.y
    return Panel(max(panel.x, 0), max(panel.y, 0), panel.pixels[top:bottom, left:right])


def runs(panel: Panel) -> tuple[np.ndarray, np.ndarray]:
    """`panel` as rectangles: corners (k, 4) window pixels x0, y0, x1, y1, and colours (k, 3).

    The first is the whole paper; the rest are horizontal runs of equal colour. Colours are
    floats 0..1.
    """
    pixels = panel.pixels.astype(np.int64)
    code = (pixels[:, :, 0] << 16) | (pixels[:, :, 1] << 8) | pixels[:, :, 2]
    h, w = code.shape
    paper = int(code[2, 2])  # inside any border, outside any letter
    key = ((np.arange(h)[:, None] << 24) | code).reshape(-1)
    start = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
    end = np.concatenate([start[1:], [h * w]])
    inked = code.reshape(-1)[start] != paper
    start, end = start[inked], end[inked]
    row, x0 = start // w, start % w
    corners = np.stack([x0, row, x0 + end - start, row + 1], axis=1)
    corners = np.concatenate([[[0, 0, w, h]], corners]) + [panel.x, panel.y, panel.x, panel.y]
    codes = np.concatenate([[paper], code.reshape(-1)[start]])
    colors = np.stack([codes >> 16, (codes >> 8) & 255, codes & 255], axis=1) / 255
    return corners, colors
