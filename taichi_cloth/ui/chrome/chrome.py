"""The chrome around the world: what of it is open, where it is, and what a click on it means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from taichi_cloth.render.picture import Rect
from taichi_cloth.render.tiles import Panel
from taichi_cloth.ui.chrome import messages, strip, toolbar
from taichi_cloth.ui.chrome.contract import COLUMN, ROW, Part
from taichi_cloth.ui.chrome.layout import ROWS, Layout, Parts, arrange, at_start
from taichi_cloth.ui.chrome.strip import Row
from taichi_cloth.ui.chrome.toolbar import Button
from taichi_cloth.ui.inputs import Event


@dataclass(frozen=True)
class Contents:
    """The text around the world.

    rows: of the status, of which as many are shown as are open. buttons: of the tool bar.
    keys: lines of the key list (empty: closed), "key<tab>action" for two columns.
    banner: a message across the top (None: none). legends: what colours mean. hints: lines like
    those of the key list, at the foot of the world.
    """

    rows: tuple[Row, ...] = ()
    buttons: tuple[Button, ...] = ()
    keys: tuple[str, ...] = ()
    banner: str | None = None
    legends: Sequence[messages.Meanings] = ()
    hints: tuple[str, ...] = ()


def key_list(lines: tuple[str, ...], layout: Layout) -> Panel:
    """The key list: beside what is open, or over it where there is too little room."""
    return messages.keys(lines, layout.text, layout.world, layout.within)


class Chrome:
    """Knows what is open around the world of a window, or of a picture.

    windowed: whether it is a window, which has a tool bar. status: whether anything is open from
    the start. parts: what can be opened. text: the size of all text, in parts of the usual.
    opened: what is open from the start; None: what follows from the others.
    """

    def __init__(
        self,
        *,
        windowed: bool,
        status: bool,
        parts: Sequence[Part] = (),
        text: float = 1.0,
        opened: Parts | None = None,
    ) -> None:
        self._windowed = windowed
        self._open = opened or at_start(windowed=windowed, status=status, text=text)
        self._parts = {part.name: part for part in parts}
        self._order = [self._open.row, *self._open.columns]  # of what is open, the last one last
        self._held: Part | None = None  # whose the pointer is
        self._strip = lru_cache(maxsize=4)(strip.panels)
        self._bar = lru_cache(maxsize=4)(toolbar.panel)

    def next_status(self) -> None:
        """Show more of the status; after all of it nothing, so that the world has the window."""
        rows = (self._open.strip + 1) % (ROWS + 1)
        self._open = replace(self._open, strip=rows, bar=self._windowed and rows > 0)

    def toggle(self, name: str) -> bool:
        """Open or close the part of this name; whether there is one."""
        part = self._parts.get(name)
        if part is None:
            return False
        if part.place == ROW:
            self._open = replace(self._open, row="" if self._open.row == name else name)
        else:
            wanted = set(self._open.columns) ^ {name}
            columns = tuple(n for n, p in self._parts.items() if p.place == COLUMN and n in wanted)
            self._open = replace(self._open, columns=columns)
        self._order = [other for other in self._order if other != name] + [name]
        self._held = None
        return True

    def close_last(self, layout: Layout) -> bool:
        """Close what was opened last of the parts that are seen; whether there was one."""
        seen = {part.name for part, _ in self._placed(layout)}
        last = [name for name in self._order if name in seen][-1:]
        return any(self.toggle(name) for name in last)

    @property
    def opened(self) -> Parts:
        """All that is open."""
        return self._open

    def is_open(self, name: str) -> bool:
        """True if a part is open."""
        return name in (self._open.row, *self._open.columns)

    def lacks_room(self, name: str, layout: Layout) -> bool:
        """True if a part is open that a window is too small to show."""
        return self.is_open(name) and name not in {part.name for part, _ in self._placed(layout)}

    def layout(self, size: tuple[int, int]) -> Layout:
        """Arrange everything in a window of `size` (width, height)."""
        return arrange(size, self._open)

    def overlay(self, layout: Layout, contents: Contents) -> tuple[Panel, ...]:
        """All that is open, as panels; one that is equal to one before is the same object."""
        found: list[Panel] = []
        if layout.bar is not None:
            found.append(self._bar(contents.buttons, layout.bar, layout.text))
        if layout.strip is not None:
            rows = contents.rows[: self._open.strip]
            found += self._strip(rows, layout.strip, layout.text)
        found += [part.panel(rect, layout.text) for part, rect in self._placed(layout)]
        found += messages.legends(contents.legends, layout.world, layout.text)
        if contents.hints and not contents.keys:
            found += messages.hints(contents.hints, layout.world, layout.text)
        if contents.banner:
            found.append(messages.banner(contents.banner, layout.world, layout.text))
        if contents.keys:  # over all else
            found.append(key_list(contents.keys, layout))
        return tuple(found)

    def buttons(self) -> tuple[Button, ...]:
        """Those that open and close the parts."""
        return tuple(
            Button(part.key, part.label, chosen=self.is_open(name), right=True)
            for name, part in self._parts.items()
        )

    def take(self, event: Event, layout: Layout, buttons: Sequence[Button]) -> Event | None:
        """Take an event that may be for what is around the world; None: nothing more.

        A click on a button of the bar is its key; the pointer beside the world does nothing to it.
        """
        placed = self._placed(layout)
        if event.pos is None:
            for part, rect in placed:
                if part.take(event, rect, layout.text):
                    return None
            return event
        for part, rect in placed:
            if self._held is part or (self._held is None and rect.holds(event.pos)):
                self._held = part if part.take(event, rect, layout.text) else None
                return None
            if part.focused and event.kind == "press":
                part.take(event, rect, layout.text)  # a click elsewhere ends it
        if event.kind == "release" or layout.world.holds(event.pos):
            return event
        if event.kind == "press" and event.button == "left" and layout.bar is not None:
            button = toolbar.hit(buttons, layout.bar, layout.text, event.pos)
            return Event("press", key=button.key) if button else None
        return None

    def _placed(self, layout: Layout) -> list[tuple[Part, Rect]]:
        """The parts that are open, and where."""
        found = [(self._parts[name], rect) for name, rect in layout.columns.items()]
        if layout.row is not None:
            found.append((self._parts[self._open.row], layout.row))
        return found
