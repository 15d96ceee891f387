"""The timeline in the row above the status: the last seconds, to be gone through by the pointer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.render.picture import Rect
from taichi_cloth.render.tiles import Panel, Tile
from taichi_cloth.ui import text
from taichi_cloth.ui.chrome.contract import ROW
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.schedule import FRAME_RATE
from taichi_cloth.ui.timeline import Timeline


class TimelineRow:
    """Shows which of the last frames is seen; a click or a drag goes to another.

    timeline: what is shown. go: goes to a frame. slowness: how much slower than real time it plays.
    """

    name, label, key, place, focused = "timeline", "timeline", "l", ROW, False

    def __init__(
        self, timeline: Timeline, go: Callable[[int], None], slowness: Callable[[], int]
    ) -> None:
        self._timeline, self._go, self._slowness = timeline, go, slowness
        self._pressed = False
        self._drawn: tuple[object, Panel] | None = None

    def panel(self, rect: Rect, height: int) -> Panel:
        """The row in its rectangle; height: of the text, pixels."""
        frames, slow = self._timeline.frames, self._slowness()
        behind = (frames.stop - 1 - self._timeline.frame) / FRAME_RATE if frames else 0.0
        there = len(frames) / FRAME_RATE
        state = (rect, height, round(behind, 2), round(there, 1), slow)
        if self._drawn is None or self._drawn[0] != state:
            self._drawn = state, self._anew(rect, height, behind, there, slow)
        return self._drawn[1]

    def take(self, event: Event, rect: Rect, height: int) -> bool:
        """Go where the pointer is while the left button is held."""
        if event.key is not None:
            return False
        if event.kind in ("press", "release"):
            self._pressed = event.kind == "press" and event.button == "left"
        frames = self._timeline.frames
        if self._pressed and frames and event.pos is not None:
            first, wide = _track(rect, height)
            share = float(np.clip((event.pos[0] - rect.x - first) / wide, 0, 1))
            self._go(frames[0] + round(share * (len(frames) - 1)))
        return self._pressed

    def _anew(self, rect: Rect, height: int, behind: float, there: float, slow: int) -> Panel:
        pixels = np.empty((rect.height, rect.width, 3), np.uint8)
        pixels[:] = style.PAPER
        first, wide = _track(rect, height)
        middle, thick = rect.height // 2, max(2, height // 5)
        pixels[middle - thick : middle + thick, first : first + wide] = style.BUTTON
        share = 1.0 if there == 0 else 1 - behind / there
        at = first + round(share * wide)
        pixels[middle - thick : middle + thick, first:at] = style.CHOSEN
        tall, half = round(0.7 * height), max(2, height // 4)
        left = min(max(at - half, 0), rect.width - 2 * half)
        pixels[middle - tall : middle + tall, left : left + 2 * half] = style.KEY_INK
        y = (rect.height - height) / 2
        said = f"{-behind:.2f} s" if behind else "now"
        kept = f"of {there:.1f} s" + (f"   1/{slow} speed" if slow > 1 else "")
        color = style.WARN if behind else style.GOOD
        text.write(pixels, said, (text.gap(height), y), height, color)
        x = text.gap(height) + 4.2 * height
        text.write(pixels, kept, (x, y), height, style.MUTED)
        hint = HINT if rect.width > 60 * height else ""
        wide_hint = text.length(hint, height)
        x = rect.width - wide_hint - text.gap(height)
        text.write(pixels, hint, (x, y), height, style.MUTED)
        return Panel(rect.x, rect.y, Tile(pixels), f"{said} {kept} {hint}")


HINT = "left right: a frame   q: slower   p: go on from here"


def _track(rect: Rect, height: int) -> tuple[int, int]:
    """The begin of the track of frames in the row, and its length, pixels."""
    first = round(15 * height)
    room = round(text.length(HINT, height)) + 2 * height if rect.width > 60 * height else height
    return first, max(rect.width - first - room, 1)
