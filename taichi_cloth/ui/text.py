"""Text as small opaque pictures, each on its own paper, laid over the frame."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING
from unicodedata import combining, normalize

import numpy as np

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont, ImageFont

Color = tuple[int, int, int]  # 0..255
ELLIPSIS = "\N{HORIZONTAL ELLIPSIS}"  # in the place of what is left out
NO_LETTER = "\uffff"  # in any font
SHORTEST_PATH = 24  # letters: one that is longer may lose its middle


@lru_cache(maxsize=8)
def _font(height: int) -> ImageFont | FreeTypeFont:
    from PIL import ImageFont

    return ImageFont.load_default(height)


@lru_cache(maxsize=2048)
def _advance(word: str, height: int) -> float:
    pieces = _pieces(word)
    wide = sum(_font(height).getlength(piece) for piece in pieces)
    return float(wide + (len(pieces) - 1) * _apart(height))


def _pieces(word: str) -> list[str]:
    """A word cut between hyphens, of which the font would make one dash: "--view"."""
    return re.split("(?<=-)(?=-)", _in_font(word))


def _apart(height: int) -> int:
    """Pixels between the pieces of a word."""
    return max(round(height / 12), 1)


def _in_font(word: str) -> str:
    """A word in letters that the font has: of others the letter without its accent, else a "?"."""
    return word if word.isascii() else "".join(map(_letter_in_font, word))


@lru_cache(maxsize=1024)
def _letter_in_font(letter: str) -> str:
    parts = [part for part in normalize("NFKD", letter) if not combining(part)]
    return letter if _has(letter) else "".join(part if _has(part) else "?" for part in parts)


def _has(letter: str) -> bool:
    """True if the font has a letter; others it draws as it draws no letter."""
    drawn, none = (bytes(_font(16).getmask(which)) for which in (letter, NO_LETTER))
    return letter.isascii() or drawn != none


@lru_cache(maxsize=2048)
def _ink(word: str, height: int) -> np.ndarray:
    """The share of each pixel that a word covers, (h, w, 1) float32; it starts at column 1.

    A status changes in a word or two from frame to frame: the others are here.
    """
    from PIL import Image, ImageDraw

    font, pieces, x = _font(height), _pieces(word), 1.0
    _, _, right, bottom = font.getbbox("".join(pieces))
    right += (len(pieces) - 1) * _apart(height)
    image = Image.new("L", (int(right) + 3, int(bottom) + 1), 0)
    for piece in pieces:
        ImageDraw.Draw(image).text((x, 0), piece, fill=255, font=font)
        x += font.getlength(piece) + _apart(height)
    share = np.asarray(image, np.float32)[:, :, None] / 255
    # A light gamma keeps thin strokes of bright letters from fading into dark paper.
    inked: np.ndarray = share**0.8
    return inked


@lru_cache(maxsize=256)
def shortened(line: str, width: float, height: int) -> str:
    """`line`, or what is at most `width` pixels wide of it: a path loses its middle, then the end
    of all is left out. height: of the text, pixels.
    """

    def most(make: Callable[[int], str], least: int, whole: int) -> str:
        sizes = range(least, whole)
        fit = bisect_right(sizes, width, key=lambda n: length(make(n), height))
        return make(sizes[max(fit - 1, 0)])

    if length(line, height) <= width:
        return line
    path = max((word for word in line.split(" ") if "/" in word), key=len, default="")
    if len(path) > SHORTEST_PATH:
        before, _, after = line.partition(path)
        line = most(lambda n: before + _without_middle(path, n) + after, SHORTEST_PATH, len(path))
    if length(line, height) <= width or not line:
        return line
    return most(lambda n: line[:n].rstrip() + ELLIPSIS, 0, len(line))


def _without_middle(path: str, count: int) -> str:
    """A path in so many letters; its end, the name, matters more than where it begins."""
    head = count // 4
    return path[:head] + ELLIPSIS + path[len(path) - (count - 1 - head) :]


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
    """`line` broken at spaces, or shortened, so that each part is at most `width` pixels wide."""
    out, current = [], ""
    for word in line.split():
        word = shortened(word, width, height)
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
    parts = _columns(lines)
    column, size = _second_column(parts, height), _extent(parts, height)
    pixels = np.empty((size[1], width or size[0], 3), np.uint8)
    pixels[:] = paper
    for ink, chosen in zip(inks, (0, 1), strict=True):
        share = np.zeros((*pixels.shape[:2], 1), np.float32)
        for row, part in enumerate(parts):
            y = margin + row * step - rise(height)
            if chosen == 1:
                _write(share, part[-1], (margin + column * (len(part) == 2), y), height)
            elif len(part) == 2:
                _write(share, part[0], (margin, y), height)
        _lay(pixels, share, ink)
    return pixels


def extent(lines: Iterable[str], height: int) -> tuple[int, int]:
    """The (width, height) in pixels of what `rasterise` makes of lines, where no width is given."""
    return _extent(_columns(lines), height)


def _columns(lines: Iterable[str]) -> list[list[str]]:
    return [line.split("\t", 1) for line in lines]


def _second_column(parts: list[list[str]], height: int) -> int:
    """The start of what stands after tabs, pixels from the margin."""
    first = max((length(part[0], height) for part in parts if len(part) == 2), default=0.0)
    return round(first + 1.2 * height) if first else 0


def _extent(parts: list[list[str]], height: int) -> tuple[int, int]:
    column, step, margin = _second_column(parts, height), _step(height), pad(height)
    needed = max((column * (len(p) == 2) + length(p[-1], height) for p in parts), default=0.0)
    return round(needed) + 2 * margin, step * len(parts) + 2 * margin - (step - height)


def _step(height: int) -> int:
    """Pixels from a line's top to the next one's."""
    return round(1.27 * height)


def pad(height: int) -> int:
    """Pixels of paper around the lines."""
    return round(0.5 * height)


def rise(height: int) -> int:
    """Pixels by which a font's letters begin below the top of its box."""
    return round(0.15 * height)


@dataclass(frozen=True)
class Word:
    """Words in one colour, part of a row. rank: where room is scarce, the highest are left out;
    what is left last is shortened.
    """

    text: str
    color: Color
    rank: int = 0


def fitted(
    left: Sequence[Word], right: Sequence[Word], width: int, height: int
) -> tuple[list[Word], list[Word]]:
    """The words of a row that fit into `width` pixels, at its left and right end.

    height: of the text, pixels. Of what is most important as much stays as there is room for: of
    two words of one rank the longer one is shortened, if half of the row is left for it.
    """
    kept = [*((word, 0) for word in left), *((word, 1) for word in right)]
    while kept and _row_length([word for word, _ in kept], height) > width:
        longest = max(range(len(kept)), key=lambda n: length(kept[n][0].text, height))
        (word, side), others = kept[longest], kept[:longest] + kept[longest + 1 :]
        room = width - _row_length([other for other, _ in others], height) - gap(height)
        equal = len(kept) == 2 and others[0][0].rank == word.rank
        if not others or (equal and room >= width / 2):
            kept[longest] = replace(word, text=shortened(word.text, room, height)), side
            break
        kept.pop(max(range(len(kept)), key=lambda n: (kept[n][0].rank, n)))
    return [w for w, side in kept if side == 0], [w for w, side in kept if side == 1]


def _row_length(words: Sequence[Word], height: int) -> float:
    """The width of words beside each other, with their gaps and the row's margins, pixels."""
    return sum(length(word.text, height) + gap(height) for word in words) + gap(height)


def gap(height: int) -> int:
    """Pixels between the words of a row, and at its ends."""
    return round(0.9 * height)


def placed(
    left: Sequence[Word], right: Sequence[Word], width: int, height: int
) -> list[tuple[Word, int]]:
    """Those words of a row that fit into `width` pixels, and where each begins, pixels.

    left, right: those at its left and at its right end.
    """
    left, right = fitted(left, right, width, height)
    found, x = [], float(gap(height))
    for word in left:
        found.append((word, round(x)))
        x += length(word.text, height) + gap(height)
    at, x = len(found), float(width)
    for word in reversed(right):
        x -= length(word.text, height) + gap(height)
        found.insert(at, (word, round(x)))
    return found


def write(
    pixels: np.ndarray, line: str, corner: tuple[float, float], height: int, color: Color
) -> None:
    """Write a line onto pixels (h, w, 3) uint8 from its top left corner (x, y); changes them."""
    x, y = corner[0], corner[1] - rise(height)
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
