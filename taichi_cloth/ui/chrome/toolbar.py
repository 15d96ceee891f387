"""The tool bar: a button for each tool, and one for each thing that can be opened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.render.picture import Rect
from taichi_cloth.render.tiles import Panel, Tile
from taichi_cloth.ui import text


@dataclass(frozen=True)
class Button:
    """Something to click.

    key: what a click does, too; it is written before the label. label: what is written on it.
    chosen: whether it is in use. right: whether it stands at the bar's right end.
    """

    key: str
    label: str
    chosen: bool = False
    right: bool = False


def placed(buttons: Sequence[Button], rect: Rect, height: int) -> list[tuple[Button, Rect, bool]]:
    """Places of the buttons in the bar's rectangle, and whether their labels are written.

    Where there is too little room, labels are written as far as it goes: of those in use, of the
    tools, and then one by one of those at the right, first of the last, which says what the keys
    do; where there is none for all keys, buttons at the right are left out: the last but one
    first, then tools. height: of the text, pixels.
    """
    labelled = [False] * len(buttons)
    widths = [_width(b, False, height) for b in buttons]
    for group in _groups(buttons):
        more = [shown or b in group for b, shown in zip(buttons, labelled, strict=True)]
        wide = [_width(b, shown, height) for b, shown in zip(buttons, more, strict=True)]
        if sum(wide) + _gap(height) * (len(buttons) + 2) <= rect.width:
            labelled, widths = more, wide
    gap, margin = _gap(height), round(0.2 * height)
    each = list(zip(buttons, labelled, widths, strict=True))
    tools = [one for one in each if not one[0].right]
    right = [one for one in each if one[0].right]
    kept, room = [], rect.width - gap
    for one in right[-1:] + tools + right[:-1]:
        if one[2] + gap > room:
            break
        kept.append(one)
        room -= one[2] + gap
    found, x = [], rect.x + gap
    for one in each:
        if one not in kept:
            continue
        button, shown, width = one
        if button.right:
            x, room = x + room, 0
        found.append((button, Rect(x, rect.y + margin, width, rect.height - 2 * margin), shown))
        x += width + gap
    return found


def panel(buttons: Sequence[Button], rect: Rect, height: int) -> Panel:
    """The bar in its rectangle; height: of the text, pixels."""
    pixels = np.empty((rect.height, rect.width, 3), np.uint8)
    pixels[:] = style.PAPER
    said = []
    for button, box, shown in placed(buttons, rect, height):
        left, top = box.x - rect.x, box.y - rect.y
        block = pixels[top : top + box.height, left : left + box.width]
        block[:] = style.CHOSEN if button.chosen else style.BUTTON
        y = (box.height - height) / 2
        pad = _pad(height)
        text.write(block, button.key, (pad, y), height, style.KEY_INK)
        said.append(button.key)
        if shown:
            x = pad + text.length(button.key + " ", height)
            text.write(block, button.label, (x, y), height, style.INK)
            said.append(button.label)
    return Panel(rect.x, rect.y, Tile(pixels), " ".join(said))


def hit(
    buttons: Sequence[Button], rect: Rect, height: int, pixel: tuple[float, float]
) -> Button | None:
    """The button under a window pixel; None: there is none."""
    for button, box, _ in placed(buttons, rect, height):
        if box.holds(pixel):
            return button
    return None


def _groups(buttons: Sequence[Button]) -> list[list[Button]]:
    """Buttons whose labels are written together, those that need it most first."""
    right = [b for b in buttons if b.right]
    tools = [b for b in buttons if not b.right]
    return [[b for b in buttons if b.chosen], tools, *([b] for b in right[-1:] + right[:-1])]


def _width(button: Button, labelled: bool, height: int) -> int:
    said = f"{button.key} {button.label}" if labelled else button.key
    return round(text.length(said, height)) + 2 * _pad(height)


def _pad(height: int) -> int:
    """Pixels between a button's ends and its words."""
    return round(0.55 * height)


def _gap(height: int) -> int:
    """Pixels between buttons."""
    return round(0.3 * height)
