"""A window by ti.GUI, Taichi's plain one, which shows a buffer in memory: no Vulkan needed."""

from __future__ import annotations

import os
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.ui import x11
from taichi_cloth.ui.inputs import (
    BUTTON_NAMES,
    Event,
    changed,
    fewest_moves,
    key_name,
    released,
    said_by_x,
)
from taichi_cloth.ui.presenters.contract import Kind, no_display

if TYPE_CHECKING:
    from taichi_cloth.render.renderer import Renderer

SETTLED = 0.2  # seconds a new size must last before the window follows it
OPAQUE = 0xFF000000


class GuiPresenter:
    """A ti.GUI window."""

    _opened = 0

    def __init__(self, size: tuple[int, int], title: str):
        self._title = title
        self.has_wheel, self.closed = True, False
        self._held: set[str] = set()
        self._wanted: tuple[tuple[int, int], float] | None = None
        self._open(size)

    def _open(self, size: tuple[int, int]) -> None:
        import taichi as ti

        # ti.GUI opens with a name of its own, by which it is found on X11, and is then renamed.
        GuiPresenter._opened += 1
        name = f"taichi-cloth {os.getpid()}.{GuiPresenter._opened}"
        with x11.opening() as displays:
            self._gui: Any = ti.GUI(name, size, fast_gui=True)
        self._gui.fps_limit = None  # the app paces itself
        self.size = size
        self.buffer = _frame_of(self._gui.img.reshape(size[::-1]))
        self._gui.show()  # only now does the window have its name
        self._tap = x11.connect(name, displays)
        self._listens = bool(self._tap and self._tap.listen())
        self._gui.core.title = self._title

    def entitle(self, title: str) -> None:
        """Write a title over the window."""
        if title != self._title and not self.closed:
            self._title = self._gui.core.title = title

    def _follow_resize(self) -> None:
        """Open the window anew at the size the user gave it.

        ti.GUI's canvas keeps its first size: the rest of a larger window stays empty, and a
        smaller one cuts the picture off.
        """
        tap = self._tap
        size = tap.size() if tap else None
        if tap is None or size is None or size == self.size or min(size) < 64:
            self._wanted = None
            return
        now = time.perf_counter()
        if self._wanted is None or self._wanted[0] != size:
            self._wanted = (size, now)
        elif now - self._wanted[1] >= SETTLED:
            position = tap.position()
            tap.close()
            self._gui.close()
            self._open(size)
            if self._tap is not None:
                self._tap.move(position)
            self._wanted = None

    def poll(self) -> list[Event]:
        """The user's events since the last call, oldest first.

        Raises ConnectionCut where the window's connection to the display is cut.
        """
        if self.closed:
            return []
        if self._tap and self._tap.is_gone():
            cut = self._tap.is_cut()
            self.close()
            if cut:
                raise x11.ConnectionCut
            return []
        if self._tap and self._listens:
            closes = any(event.key == self._gui.EXIT for event in self._gui.get_events())
            out = [*said_by_x(self._tap.inputs(), self.size, self._held)]
        else:
            closes, out = self._reported()
        if closes or not self._gui.running:
            self.close()
            return []
        if self._tap and self._tap.lost_focus():
            out += released(self._held)
        if self._tap and self._tap.leaves():
            out.append(Event("leave"))
        self._follow_resize()
        return fewest_moves(out)

    def _reported(self) -> tuple[bool, list[Event]]:
        """True if ti.GUI says that the window closes, and the events that it reports."""
        gui, out = self._gui, list[Event]()
        for event in gui.get_events():
            pointer, name = self._pixel(*event.pos), key_name(event.key)
            kind = "press" if event.type == gui.PRESS else "release"
            if event.key == gui.EXIT:
                return True, []
            if event.key == gui.WHEEL:
                out.append(Event("wheel", pos=pointer, delta=event.delta[1] / 120))
            elif event.type == gui.MOTION:
                if 0 <= event.pos[0] <= 1 and 0 <= event.pos[1] <= 1:
                    out.append(Event("move", pos=pointer))
            elif event.key in BUTTON_NAMES:
                out.append(Event(kind, pos=pointer, button=BUTTON_NAMES[event.key]))
            elif name:
                out += changed(kind, name, self._held)
        return False, out

    def _pixel(self, x: float, y: float) -> tuple[float, float]:
        """A position of ti.GUI's events in window pixels: it counts rows from the last one up."""
        return round(x * self.size[0], 3), round((1 - y) * self.size[1] - 1, 3)

    def present(self, renderer: Renderer) -> None:
        """Show what a renderer drew last."""
        pixels = renderer.pixels()
        if pixels.ctypes.data != self.buffer.ctypes.data:  # drawn on a device
            self.buffer[:] = pixels
        if sys.platform == "darwin":
            self._gui.img[:] = _turned(self.buffer).reshape(-1)
        self._gui.show()

    def close(self) -> None:
        """Give the window back. May be called twice."""
        if not self.closed:
            self.closed = True
            if self._tap:
                self._tap.close()
            self._gui.close()


def _frame_of(buffer: np.ndarray) -> np.ndarray:
    """The picture (h, w) uint32, 0xRRGGBB, row 0 on top, that is drawn for a window's buffer.

    It is the buffer itself, but for macOS, whose windows have bytes in another order.
    """
    return np.zeros_like(buffer) if sys.platform == "darwin" else buffer


def _turned(frame: np.ndarray) -> np.ndarray:
    """A picture of 0xRRGGBB as macOS shows it: opaque, with red and blue in each other's places."""
    turned: np.ndarray = (frame & 255) << 16 | (frame & 0xFF00) | (frame >> 16 & 255) | OPAQUE
    return turned


PRESENTER = Kind(name="gui", rank=2, lack=no_display, open=GuiPresenter)
