"""What is around the world: what of it is open, where it is, and what a click on it means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from taichi_cloth.ui.chrome import messages, strip, toolbar
from taichi_cloth.ui.chrome.layout import ROWS, Layout, arrange, at_start
from taichi_cloth.ui.chrome.strip import Row
from taichi_cloth.ui.chrome.toolbar import Button
from taichi_cloth.ui.text import Panel


@dataclass(frozen=True)
class Contents:
    """What is written around the world.

    rows: of the status, of which as many are shown as are open. buttons: of the tool bar.
    keys: lines of the key list (empty: closed), "key<tab>action" for two columns.
    banner: a message across the top (None: none).
    """

    rows: tuple[Row, ...] = ()
    buttons: tuple[Button, ...] = ()
    keys: tuple[str, ...] = ()
    banner: str | None = None


class Chrome:
    """Knows what is open around the world of a window, or of a picture.

    windowed: whether it is a window, which has a tool bar. status: whether anything is open from
    the start.
    """

    def __init__(self, *, windowed: bool, status: bool) -> None:
        self._windowed = windowed
        self._parts = at_start(windowed=windowed, status=status)
        self._strip = lru_cache(maxsize=4)(strip.panel)
        self._bar = lru_cache(maxsize=4)(toolbar.panel)

    def next_status(self) -> None:
        """Show more of the status; after all of it nothing, so that the world has the window."""
        rows = (self._parts.strip + 1) % (ROWS + 1)
        self._parts = replace(self._parts, strip=rows, bar=self._windowed and rows > 0)

    def layout(self, size: tuple[int, int]) -> Layout:
        """Where everything is in a window of `size` (width, height)."""
        return arrange(size, self._parts)

    def overlay(self, layout: Layout, contents: Contents) -> tuple[Panel, ...]:
        """All that is open, as panels; one that is equal to one before is the same object."""
        found: list[Panel] = []
        if layout.bar is not None:
            found.append(self._bar(contents.buttons, layout.bar, layout.text))
        if layout.strip is not None:
            rows = contents.rows[: self._parts.strip]
            found.append(self._strip(rows, layout.strip, layout.text))
        if contents.keys:
            found.append(messages.keys(contents.keys, layout.world, layout.text))
        if contents.banner:
            found.append(messages.banner(contents.banner, layout.world, layout.text))
        return tuple(found)

    def clicked(
        self, layout: Layout, buttons: Sequence[Button], pixel: tuple[float, float]
    ) -> Button | None:
        """The button of the tool bar under a window pixel; None: there is none."""
        if layout.bar is None:
            return None
        return toolbar.hit(buttons, layout.bar, layout.text, pixel)
