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
DOT = "\u25cf "  # before a line of `marks`: a red disc stands in its place
SHADES = 6  # ink coverage levels: few enough for long runs, enough for smooth letters


@dataclass(frozen=True, eq=False)  # compared by identity: what was made of one is kept
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


@lru_cache(maxsize=2048)
def _advance(word: str, height: int) -> float:
    return float(_font(height).getlength(word))


@lru_cache(maxsize=2048)
def _ink(word: str, height: int) -> np.ndarray:
    """How much of each pixel a word covers, (h, w, 1) float32 from 0 to 1; it starts at column 1.

    A status changes in a word or two from frame to frame: the others are here.
    """
    from PIL import Image, ImageDraw

    font = _font(height)
    _, _, right, bottom = font.getbbox(word)
    image = Image.new("L", (int(right) + 3, int(bottom) + 1), 0)
    ImageDraw.Draw(image).text((1, 0), word, fill=255, font=font)
    share = np.asarray(image, np.float32)[:, :, None] / 255
    # A light gamma keeps thin strokes of bright letters from fading into dark paper.
    inked: np.ndarray = np.round(share**0.8 * (SHADES - 1)) / (SHADES - 1)
    return inked


def _length(line: str, height: int) -> float:
    """The width of a line in pixels."""
    words = line.split(" ")
    return sum(_advance(word, height) for word in words) + (len(words) - 1) * _advance(" ", height)


def _write(share: np.ndarray, line: str, corner: tuple[float, float], height: int) -> None:
    """Lay a line's ink, from its top left corner (x, y), onto share (h, w, 1)."""
    x, y = corner
    for word in line.split(" "):
        ink = _ink(word, height)
        left, top = round(x) - 1, round(y)
        under = share[top : top + len(ink), left : left + ink.shape[1]]
        np.maximum(under, ink[: under.shape[0], : under.shape[1]], out=under)
        x += _advance(word, height) + _advance(" ", height)


def wrapped(line: str, width: int, height: int) -> list[str]:
    """`line` broken at spaces so that each part is at most `width` pixels wide."""
    out, current = [], ""
    for word in line.split():
        longer = f"{current} {word}".strip()
        if current and _length(longer, height) > width:
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
    step, pad = _step(height), _pad(height)
    parts = [line.split("\t", 1) for line in lines]
    column: float = max((_length(p[0], height) for p in parts if len(p) == 2), default=0)
    column = round(column + 1.2 * height) if column else 0
    needed = max((column * (len(p) == 2) + _length(p[-1], height) for p in parts), default=0)
    size = (width or round(needed) + 2 * pad, step * len(parts) + 2 * pad - (step - height))
    pixels = np.empty((size[1], size[0], 3), np.uint8)
    pixels[:] = paper
    for ink, chosen in zip(inks, (0, 1), strict=True):
        share = np.zeros((size[1], size[0], 1), np.float32)
        for row, part in enumerate(parts):
            y = pad + row * step - _rise(height)
            if chosen == 1:
                _write(share, part[-1], (pad + column * (len(part) == 2), y), height)
            elif len(part) == 2:
                _write(share, part[0], (pad, y), height)
        inked = share[:, :, 0] > 0
        over = share[inked]
        pixels[inked] = pixels[inked] * (1 - over) + np.array(ink) * over
    return pixels


def _step(height: int) -> int:
    """Pixels from a line's top to the next one's."""
    return round(1.27 * height)


def _pad(height: int) -> int:
    """Pixels of paper around the lines."""
    return round(0.5 * height)


def _rise(height: int) -> int:
    """Pixels by which a font's letters begin below the top of its box."""
    return round(0.15 * height)


@lru_cache(maxsize=16)
def _status_row(line: str, y: int, width: int, height: int, first: bool, last: bool) -> Panel:
    """A line of the status as a panel of its own: only the lines that change are made anew.

    y: of its letters in the window. first, last: there the paper goes on above and below.
    """
    inks = (style.INK, style.INK)
    pixels = rasterise([line], height, paper=style.PAPER, inks=inks, width=width)
    letters = _pad(height) - _rise(height)
    start, end = 0 if first else letters, len(pixels) if last else letters + _step(height)
    return Panel(0, y - letters + start, pixels[start:end])


def _status(lines: tuple[str, ...], size: tuple[int, int]) -> list[Panel]:
    """The status, bottom left; it shrinks rather than leave a narrow window."""
    width, height = size[0], font_height(size[1])
    while height > 9 and max(_length(line, height) for line in lines) > width - height:
        height -= 1
    needed = round(max(_length(line, height) for line in lines)) + 2 * _pad(height)
    below, last = height + _pad(height) + _rise(height), len(lines) - 1
    return [
        _status_row(
            line,
            size[1] - below - (last - row) * _step(height),
            needed,
            height,
            row == 0,
            row == last,
        )  # fmt: skip
        for row, line in enumerate(lines)
    ]


def panels(picture: Picture, size: tuple[int, int]) -> tuple[Panel, ...]:
    """The overlay of a frame in a window of `size` (width, height): status, key list, banner.

    A panel that is equal to one of the frame before is the same object.
    """
    size = int(size[0]), int(size[1])
    status = _status(picture.text, size) if picture.text else []
    return (
        *(_inside(panel, size) for panel in status),
        *_panels(picture.help, picture.banner, size),
    )


@lru_cache(maxsize=4)
def _panels(keys: tuple[str, ...], banner: str | None, size: tuple[int, int]) -> tuple[Panel, ...]:
    width, window_height = size
    out = []
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


@lru_cache(maxsize=4)
def marks(lines: tuple[str, ...], size: tuple[int, int]) -> tuple[Panel, ...]:
    """Lines in the top right corner of a window of `size`, smaller where they are too long.

    One that begins with `DOT` has a red disc there.
    """
    out, top, height = [], 0, font_height(size[1])
    for line in lines:
        fitting = height
        while fitting > 9 and _length(line, fitting) > size[0] - 2 * fitting:
            fitting -= 1
        red, said = line.startswith(DOT), line.removeprefix(DOT)
        pixels = rasterise([said], fitting, paper=style.PAPER, inks=(style.INK, style.INK))
        if red:
            pixels = np.concatenate([_red_disc(len(pixels)), pixels[:, _pad(fitting) // 2 :]], 1)
        out.append(_inside(Panel(size[0] - pixels.shape[1], top, pixels), size))
        top += len(pixels)
    return tuple(out)


def _red_disc(side: int) -> np.ndarray:
    """A red disc on paper, (side, side, 3) uint8, with smooth edges."""
    away = np.hypot(*(np.mgrid[:side, :side] + 0.5 - side / 2))
    share = np.round(np.clip(0.28 * side + 0.5 - away, 0, 1) * 4)[:, :, None] / 4
    disc: np.ndarray = share * np.array(style.RECORDING) + (1 - share) * np.array(style.PAPER)
    return disc.astype(np.uint8)


@lru_cache(maxsize=32)
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
