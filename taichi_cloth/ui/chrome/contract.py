"""The contract of a part that may be opened beside the world: settings, meters, a timeline."""

from __future__ import annotations

from typing import Protocol

from taichi_cloth.render.picture import Rect
from taichi_cloth.render.tiles import Panel
from taichi_cloth.ui.inputs import Event

COLUMN, ROW = "column", "row"  # places: in the column at the right, or under the world


class Part(Protocol):
    """Something that is opened and closed by a key, and drawn beside the world.

    name: the command of its key. label: the word for it in the tool bar. key: that opens and closes
    it. place: `COLUMN` or `ROW`. focused: whether something in it is chosen; a press elsewhere ends
    that.
    """

    name: str
    label: str
    key: str
    place: str
    focused: bool

    def panel(self, rect: Rect, height: int) -> Panel:
        """It as it is now, in its rectangle; the same object while nothing changed.

        height: of the text, pixels.
        """

    def take(self, event: Event, rect: Rect, height: int) -> bool:
        """React to an event in its rectangle, or to one of a drag that began there.

        Keys come from anywhere while it is open. Returns whether the pointer is its own until the
        button is released, or whether a key means something to it.
        """
