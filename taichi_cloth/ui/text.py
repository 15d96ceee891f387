"""Text as small opaque pictures, laid over the frame by every view in the same pixels.

Taichi's windows cannot blend, so each panel is rasterised here against its own paper; a view
either copies the pixels or draws `runs` of equal colour as rectangles.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont, ImageFont

Color = tuple[int, int, int]  # 0..255
SHADES = 4  # ink coverage levels: few enough for long runs, enough for smooth letters


@dataclass(frozen=True, eq=False)  # compared by identity: what was made of one is kept
class Panel:
    """Pixels (h, w, 3) uint8 whose top left corner is the window pixel (x, y).

    words: what is written on it.
    """

    x: int
    y: int
    pixels: np.ndarray
    words: str = ""


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


def length(line: str, height: int) -> float:
    """The width of a line in pixels."""
    words = line.split(" ")
    return sum(_advance(word, height) for word in words) + (len(words) - 1) * _advance(" ", height)


def _write(
    share: np.ndarray,
    line: str,
    corner: tuple[float, float],
    height: int,
    origin: tuple[int, int] = (0, 0),
) -> None:
    """Lay a line's ink, from its top left corner (x, y), onto share (h, w, 1).

    origin: where share begins.
    """
    x, y = corner
    for word in line.split(" "):
        ink = _ink(word, height)
        left, top = round(x) - 1 - origin[0], round(y) - origin[1]
        under = share[top : top + len(ink), left : left + ink.shape[1]]
        np.maximum(under, ink[: under.shape[0], : under.shape[1]], out=under)
        x += _advance(word, height) + _advance(" ", height)


def wrapped(line: str, width: int, height: int) -> list[str]:
    """`line` broken at spaces so that each part is at most `width` pixels wide."""
    out, current = [], ""
    for word in line.split():
        longer = f"{current} {word}".strip()
        if current and length(longer, height) > width:
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
    step, margin = _step(height), pad(height)
    parts = [line.split("\t", 1) for line in lines]
    column: float = max((length(p[0], height) for p in parts if len(p) == 2), default=0)
    column = round(column + 1.2 * height) if column else 0
    needed = max((column * (len(p) == 2) + length(p[-1], height) for p in parts), default=0)
    size = (width or round(needed) + 2 * margin, step * len(parts) + 2 * margin - (step - height))
    pixels = np.empty((size[1], size[0], 3), np.uint8)
    pixels[:] = paper
    for ink, chosen in zip(inks, (0, 1), strict=True):
        share = np.zeros((size[1], size[0], 1), np.float32)
        for row, part in enumerate(parts):
            y = margin + row * step - _rise(height)
            if chosen == 1:
                _write(share, part[-1], (margin + column * (len(part) == 2), y), height)
            elif len(part) == 2:
                _write(share, part[0], (margin, y), height)
        _lay(pixels, share, ink)
    return pixels


def _step(height: int) -> int:
    """Pixels from a line's top to the next one's."""
    return round(1.27 * height)


def pad(height: int) -> int:
    """Pixels of paper around the lines."""
    return round(0.5 * height)


def _rise(height: int) -> int:
    """Pixels by which a font's letters begin below the top of its box."""
    return round(0.15 * height)


@dataclass(frozen=True)
class Word:
    """Words in one colour, part of a row. rank: where room is scarce, the highest are left out."""

    text: str
    color: Color
    rank: int = 0


def fitted(
    left: Sequence[Word], right: Sequence[Word], width: int, height: int
) -> tuple[list[Word], list[Word]]:
    """The words of a row that fit into `width` pixels, at its left and right end.

    height: of the text, pixels. Of what is most important as much stays as there is room for.
    """
    kept = [*((word, 0) for word in left), *((word, 1) for word in right)]
    while len(kept) > 1 and _row_length([word for word, _ in kept], height) > width:
        worst = max(range(len(kept)), key=lambda n: (kept[n][0].rank, n))
        kept.pop(worst)
    return [w for w, side in kept if side == 0], [w for w, side in kept if side == 1]


def _row_length(words: Sequence[Word], height: int) -> float:
    """The width of words beside each other, with their gaps and the row's margins, pixels."""
    return sum(length(word.text, height) + gap(height) for word in words) + gap(height)


def gap(height: int) -> int:
    """Pixels between the words of a row, and at its ends."""
    return round(0.9 * height)


def write_row(
    pixels: np.ndarray, left: Sequence[Word], right: Sequence[Word], y: float, height: int
) -> None:
    """Write words onto pixels (h, w, 3) uint8, with the top of their text at y.

    What does not fit is left out, by rank.
    """
    width = pixels.shape[1]
    left, right = fitted(left, right, width, height)
    x: float = gap(height)
    for word in left:
        write(pixels, word.text, (x, y), height, word.color)
        x += length(word.text, height) + gap(height)
    x = width
    for word in reversed(right):
        x -= length(word.text, height) + gap(height)
        write(pixels, word.text, (x, y), height, word.color)


def write(
    pixels: np.ndarray, line: str, corner: tuple[float, float], height: int, color: Color
) -> None:
    """Write a line onto pixels (h, w, 3) uint8 from its top left corner (x, y); changes them."""
    x, y = corner[0], corner[1] - _rise(height)
    left, top = max(round(x) - 1, 0), max(round(y), 0)
    # What it covers alone: a status has ten words, and is as wide as its window.
    here = pixels[top : top + 2 * height, left : left + round(length(line, height)) + height]
    share = np.zeros((*here.shape[:2], 1), np.float32)
    _write(share, line, (x, y), height, (left, top))
    _lay(here, share, color)


def _lay(pixels: np.ndarray, share: np.ndarray, color: Color) -> None:
    """Lay ink of a colour over pixels (h, w, 3); share: (h, w, 1), how much of each it covers."""
    inked = share[:, :, 0] > 0
    over = share[inked]
    pixels[inked] = pixels[inked] * (1 - over) + np.array(color) * over


def layers(panels: Iterable[Panel]) -> list[list[Panel]]:
    """Panels that lie over each other in this order, in layers of such as do not overlap."""
    out: list[list[Panel]] = []
    for panel in panels:
        if not out or any(_overlap(panel, other) for other in out[-1]):
            out.append([])
        out[-1].append(panel)
    return out


def _overlap(one: Panel, other: Panel) -> bool:
    (h, w), (h2, w2) = one.pixels.shape[:2], other.pixels.shape[:2]
    beside = one.x + w <= other.x or other.x + w2 <= one.x
    return not (beside or one.y + h <= other.y or other.y + h2 <= one.y)


def runs(panel: Panel) -> tuple[np.ndarray, np.ndarray]:
    """`panel` as rectangles: corners (k, 4) window pixels x0, y0, x1, y1, and colours (k, 3).

    The first is the whole paper; the rest are runs of equal colour along rows, those that repeat
    from row to row as one. Colours are floats 0..1.
    """
    pixels = panel.pixels.astype(np.int64)
    code = (pixels[:, :, 0] << 16) | (pixels[:, :, 1] << 8) | pixels[:, :, 2]
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
    corners, codes = boxes[:, :4] + [panel.x, panel.y, panel.x, panel.y], boxes[:, 4]
    colors = np.stack([codes >> 16, (codes >> 8) & 255, codes & 255], axis=1) / 255
    return corners, colors


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
