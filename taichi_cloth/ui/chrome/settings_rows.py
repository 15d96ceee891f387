"""The rows of the panel of settings: what is written in each, how tall it is, and its pixels.

A row has a label, a value, and at the right, in a column of its own, what the value costs. Where
label and value do not fit beside each other, the value stands under the label.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.simulation import live
from taichi_cloth.ui import text
from taichi_cloth.ui.text import Color

if TYPE_CHECKING:
    from taichi_cloth.simulation.live import Setting, Value

LINE = 1.5  # text heights that a row takes, and
MORE = 1.25  # with its value under its label, and
SLIDER = 0.75  # with a slider
HEADING = 1.7
WIDEST = "~8888 ms"  # of the column of costs
MARKS = "\u2039 \u203a"  # around a word that may be another one
OPEN = "open"  # on the button that opens a scene
NEAR, AT = 0.9, 1.0  # parts of the stable step from which on a cost is coloured


@dataclass(frozen=True)
class Row:
    """A heading, a setting, the scene, or one of the words that a choice may be.

    name: by which the keys find it; "": a heading. label, value, cost: what is written; used: the
    part of the stable step that the cost says. setting: which; number: its value. option: the word
    of a choice that this row is; "": it is none. fixed: whether it cannot be changed. changed:
    whether it is not the scene's own. button: whether its cost is a button.
    """

    name: str
    label: str
    value: str = ""
    cost: str = ""
    used: float | None = None
    setting: Setting | None = field(default=None, compare=False)
    number: Value = None
    option: str = ""
    fixed: bool = False
    changed: bool = False
    button: bool = False

    @property
    def has_slider(self) -> bool:
        """True if it is a number that can be dragged."""
        kinds = (live.NUMBER, live.COUNT)
        return bool(self.setting and not self.option and self.setting.kind in kinds) and (
            not self.fixed
        )


@dataclass(frozen=True)
class Placed:
    """A row at its place. top, tall: pixels from the panel's first line on. label, words: that and
    its value as they are written there; under: whether that stands under the label.
    """

    row: Row
    top: int
    tall: int
    label: str
    words: str
    under: bool


def place(rows: list[Row], width: int, height: int) -> list[Placed]:
    """Rows under each other, in a panel of so many pixels' width. height: of the text, pixels."""
    found, top = [], 0
    for row in rows:
        words, under = _fitted(row, width, height)
        lines = HEADING if not row.name else LINE + MORE * under + SLIDER * row.has_slider
        room = _left(width, height)[1] - _indent(row, height)
        label = text.shortened(row.label, room, height) if row.name else row.label
        found.append(Placed(row, top, round(lines * height), label, words, under))
        top += found[-1].tall
    return found


def _fitted(row: Row, width: int, height: int) -> tuple[str, bool]:
    """A value as there is room for it: without its unit where that helps, else under its label."""
    room = _left(width, height)[1] - _indent(row, height) - pad(height)
    for words in (row.value, row.value.split(" ")[0]) if row.has_slider else (row.value,):
        if not words or text.length(row.label, height) + text.length(words, height) <= room:
            return words, False
    # What it costs stands above that line, which has the room of both columns.
    return _within(row.value, cost_column(width, height)[1] - pad(height), height), True


def _within(words: str, room: int, height: int) -> str:
    """A value in so many pixels; where it has marks it keeps these."""
    if not words.startswith(MARKS[0]):
        return text.shortened(words, room, height)
    marks = round(text.length(marked(""), height))
    return marked(text.shortened(words[2:-2], room - marks, height))


def value_start(words: str, width: int, height: int) -> float:
    """The begin of a value, which ends where the left column does: pixels of the panel."""
    return _left(width, height)[1] - text.length(words, height)


def pad(height: int) -> int:
    """Pixels of paper at both ends of a row."""
    return round(0.7 * height)


def cost_column(width: int, height: int) -> tuple[int, int]:
    """The begin and end of the column of costs, pixels of the panel."""
    end = width - pad(height)
    return end - round(text.length(WIDEST, height)), end


def _left(width: int, height: int) -> tuple[int, int]:
    """The begin and end of what is beside the costs."""
    return pad(height), cost_column(width, height)[0] - pad(height)


def _indent(row: Row, height: int) -> int:
    return pad(height) + (height if row.option else 0)


def track(width: int, height: int) -> tuple[int, int]:
    """The begin of a slider in the panel, and its length, pixels."""
    first, end = _left(width, height)
    half = max(2, height // 5)
    return first + half, max(end - first - 2 * half, 1)


def is_on_slider(placed: Placed, y: float, height: int) -> bool:
    """True if so many pixels under a row's top are on its slider."""
    return placed.row.has_slider and y > placed.tall - (SLIDER + 0.4) * height


def draw(
    placed: Placed, width: int, height: int, chosen: bool, typed: str
) -> tuple[np.ndarray, str]:
    """A row's pixels (tall, width, 3) uint8, and what is written there.

    height: of the text. chosen: whether the keys change it. typed: what was typed for it.
    """
    row, block = placed.row, np.empty((placed.tall, width, 3), np.uint8)
    block[:] = style.PAPER
    block[:, :1] = style.WALL
    if not row.name:
        y = placed.tall - 1.3 * height
        text.write(block, row.label, (pad(height), y), height, style.KEY_INK)
        _write_cost(block, row, y, height)
        return block, f"{row.label} {row.cost}".strip()
    if chosen:
        block[:, 1:] = style.BUTTON
    ink = style.MUTED if row.fixed else style.KEY_INK if row.changed else style.INK
    y, words = 0.25 * height, f"{typed}_" if typed else placed.words
    label = style.INK if chosen or row.option else style.MUTED
    text.write(block, placed.label, (_indent(row, height), y), height, label)
    x = value_start(words, width, height)
    below = MORE * height if placed.under and not typed else 0.0
    text.write(block, words, (max(x, pad(height)), y + below), height, ink)
    _write_cost(block, row, y, height)
    if row.has_slider:
        _draw_slider(block, row, height, ink)
    return block, " ".join(part for part in (placed.label, words, row.cost) if part)


def _write_cost(block: np.ndarray, row: Row, y: float, height: int) -> None:
    first, end = cost_column(block.shape[1], height)
    color: Color = style.MUTED
    if row.used is not None and row.used > NEAR:
        color = style.BAD if row.used > AT * (1 + 1e-6) else style.WARN
    if row.button:
        top, bottom = round(0.1 * height), round(1.4 * height)
        block[top:bottom, first : end + pad(height) // 2] = style.CHOSEN
        end, color = round((first + end + text.length(row.cost, height)) / 2), style.INK
    text.write(block, row.cost, (end - text.length(row.cost, height), y), height, color)


def _draw_slider(block: np.ndarray, row: Row, height: int, ink: Color) -> None:
    first, wide = track(block.shape[1], height)
    middle, thick = len(block) - round((SLIDER - 0.15) * height), max(1, height // 10)
    rows = slice(middle - thick, middle + thick)
    block[rows, first : first + wide] = style.WALL
    if row.number is None or row.setting is None:
        return
    at = first + round(share(row.setting, float(row.number)) * wide)
    block[rows, first:at] = ink
    half = max(2, height // 5)
    block[middle - 2 * half : middle + 2 * half, at - half : at + half] = ink


def share(one: Setting, value: float) -> float:
    """The place of a value along its slider, 0 to 1."""
    low, high = one.low, one.high
    if one.log and value > 0:
        low, high, value = np.log(low), np.log(high), np.log(value)
    return float(np.clip((value - low) / (high - low), 0, 1))


def at(one: Setting, part: float) -> Value:
    """The value at a place of its slider, to three digits."""
    part = float(np.clip(part, 0, 1))
    if one.log:
        value = one.low * (one.high / one.low) ** part
    else:
        value = one.low + part * (one.high - one.low)
        if abs(value) < 0.005 * (one.high - one.low):
            value = 0.0  # a slider that goes through zero stops there
    return round(value) if one.kind == live.COUNT else float(f"{value:.3g}")


def shown(one: Setting, value: Value) -> str:
    """A value as it is written; its unit is said at the foot."""
    if value is None:
        return "off"
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, str):
        return marked(value)
    return f"{value:.4g} {live.TIMES}" if one.unit == live.TIMES else f"{value:.4g}"


def marked(word: str) -> str:
    """A word that may be another one."""
    return f"{MARKS[0]} {word} {MARKS[-1]}"


def same(a: Value, b: Value) -> bool:
    """True if two values are one."""
    if isinstance(a, (int, float)) and isinstance(b, (int, float)):
        return bool(np.isclose(float(a), float(b), rtol=1e-6, atol=0))
    return a == b
