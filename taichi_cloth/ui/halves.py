"""Two worlds beside each other in a window: where each is, and what is written above them."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.errors import milliseconds
from taichi_cloth.render import style
from taichi_cloth.render.picture import Half, Rect
from taichi_cloth.render.pointer import Pointer
from taichi_cloth.render.tiles import Panel, Tile
from taichi_cloth.ui import text
from taichi_cloth.ui.chrome.beside import Second
from taichi_cloth.ui.depiction import Depiction
from taichi_cloth.ui.text import Word
from taichi_cloth.ui.tools.contract import Marks

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

SMALLEST = 8  # pixels of a name that is shrunk to fit
LATELY = 45  # frames of whose costs the middle one is told
RENEWED = 12  # frames between two readings of them: faster cannot be read


@dataclass(frozen=True)
class Halves:
    """The world's room, cut. names: a row above both worlds; left, right: where these are."""

    names: Rect
    left: Rect
    right: Rect


def halves(room: Rect, height: int) -> Halves:
    """The two halves of a room; height: of the text, pixels."""
    row, gap = min(round(1.8 * height), room.height // 4), max(2, height // 6)
    width = max((room.width - gap) // 2, 1)
    left = Rect(room.x, room.y + row, width, room.height - row)
    right = replace(left, x=room.x + room.width - width)
    return Halves(Rect(room.x, room.y, room.width, row), left, right)


class Pair:
    """Shows a second run beside the first, as that one is shown.

    second: it. depiction: of the first. windowed: whether it says what frames take, which without
    a window would be another picture each time.
    """

    def __init__(self, second: Second, depiction: Depiction, *, windowed: bool) -> None:
        self.second, self._first, self._windowed = second, depiction, windowed
        self._depiction = Depiction(second.sim, depiction.show)
        self._costs: deque[tuple[float, float]] = deque(maxlen=LATELY)
        self._said: tuple[str, str] = ("", "")
        self._until_said, self._compiled = 0, False
        self._panel = lru_cache(maxsize=4)(_names_panel)

    @property
    def sim(self) -> Simulation:
        """The second run's simulation."""
        return self.second.sim

    def note(self, simulate: float) -> None:
        """Take note of the seconds that both took to make a frame; the first one compiles."""
        if not self._compiled:
            self._compiled = True
            return
        self._costs.append((max(simulate - self.second.took, 0.0), self.second.spent))
        self._until_said -= 1
        if self._windowed and self._until_said <= 0:
            self._until_said = RENEWED
            first, second = (milliseconds(cost, 2) for cost in np.median(self._costs, axis=0))
            self._said = f"{first} ms a frame", f"{second} ms a frame"

    def leave(self) -> None:
        """The frame that it is at is left for the next."""
        self._depiction.between.leave(self.sim)

    def forget(self) -> None:
        """There is no frame that was left."""
        self._depiction.between.forget()

    def half(self, room: Rect, marks: Marks | None, part: float, pointer: Pointer | None) -> Half:
        """The second world. room: where. The rest: as for the first one's picture."""
        depiction = self._depiction
        depiction.show, depiction.strain = self._first.show, self._first.strain
        picture = replace(depiction.picture(marks, part), pointer=pointer)
        return Half(picture, room)

    def panels(self, cut: Halves, height: int) -> tuple[Panel, ...]:
        """Their names, and a line between them; height: of the text, pixels."""
        words = []
        for name, cost in zip(self.second.names(), self._said, strict=True):
            words.append(
                (Word(name, style.INK), *((Word(cost, style.KEY_INK, 1),) if cost else ()))
            )
        if self.second.stopped():
            words[1] = (*words[1], Word("stopped", style.BAD, 0))
        end = cut.left.x + cut.left.width
        between = Rect(end, cut.left.y, cut.right.x - end, cut.left.height)
        return self._panel((words[0], words[1]), cut.names, height), _line(between)


@lru_cache(maxsize=4)
def _line(rect: Rect) -> Panel:
    pixels = np.empty((rect.height, rect.width, 3), np.uint8)
    pixels[:] = style.PAPER
    return Panel(rect.x, rect.y, Tile(pixels))


def _names_panel(
    words: tuple[tuple[Word, ...], tuple[Word, ...]], rect: Rect, height: int
) -> Panel:
    """The row above the two worlds, in letters as high as fit; height: at most, pixels."""
    pixels = np.empty((rect.height, rect.width, 3), np.uint8)
    pixels[:] = style.PAPER
    width, said = rect.width // 2, []
    for side, some in enumerate(words):
        size = height
        while size > SMALLEST and text.length(some[0].text, size) + 2 * text.gap(size) > width:
            size -= 1
        block = pixels[:, side * (rect.width - width) :][:, :width]
        for word, x in text.placed(some, (), width, size):
            text.write(block, word.text, (x, (rect.height - size) / 2), size, word.color)
        said += [word.text for word in some]
    return Panel(rect.x, rect.y, Tile(pixels), ", ".join(said))
