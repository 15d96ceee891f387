"""A window by GGUI, Taichi's Vulkan one, which shows an image on the device."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_cloth import runtime, vulkan
from taichi_cloth.errors import RunFailure
from taichi_cloth.ui import rescue, x11
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

NO_VULKAN = "GGUI needs Vulkan, which is not there (install a Vulkan driver, such as Mesa's)"
SOFTWARE = "its Vulkan is a program on the processor, with which ti.GUI shows pictures sooner"
SETTINGS = Path("imgui.ini")  # of GGUI's text library, which we do not use
ENTITLED = 0.03  # seconds after which a title is written again as a picture is shown
# Seconds after a look at whether the window is there in which `poll` does not look, too: each
# waits for the X server, which reads the last picture at that time.
LOOKED = 0.1


class GguiPresenter:
    """A GGUI window."""

    buffer = None

    def __init__(self, size: tuple[int, int], title: str):
        import taichi as ti

        self._ti: Any = ti
        self._had_settings = SETTINGS.exists()
        with x11.opening() as displays:
            # The app paces itself; GGUI's own limit would count as time spent drawing.
            self._window: Any = ti.ui.Window(title, size, vsync=False, fps_limit=1000)
        self._canvas = self._window.get_canvas()
        self._image: Any = None  # a field (w, h) of four bytes each
        self._tree: Any = None
        self._tap = x11.connect(title, displays)
        self._guard = rescue.Guard(self._gone) if self._tap else None
        if self._tap:
            self._tap.show_whole()  # GGUI begins 100 pixels from the screen's corner
        self._listens = bool(self._tap and self._tap.listen())
        self._pointer: tuple[float, float] | None = None
        self._held: set[str] = set()
        self._title, self._named = title, 0.0  # when it is due again
        self._looked = 0.0  # when the window was last known to be there
        self.has_wheel, self.closed = self._listens, False
        self._size = size

    @property
    def size(self) -> tuple[int, int]:
        """Current width and height in pixels."""
        if not self.closed:
            w, h = self._window.get_window_shape()
            if w > 0 and h > 0:  # a minimised window reports zero
                self._size = (int(w), int(h))
        return self._size

    def entitle(self, title: str) -> None:
        """Write a title over the window."""
        if title != self._title:
            self._title, self._named = title, 0.0
            if self._tap and not self.closed:
                self._tap.entitle(title)

    def poll(self) -> list[Event]:
        """The user's events since the last call, oldest first.

        Raises ConnectionCut where the window's connection to the display is cut.
        """
        if self.closed:
            return []
        if time.perf_counter() > self._looked + LOOKED and self._was_destroyed():
            return []
        if not self._window.running:
            self.close()
            return []
        if self._tap and self._listens:
            self._window.get_events()  # which came, and where, X says better
            events = [*said_by_x(self._tap.inputs(), self.size, self._held)]
            if self._tap.lost_focus():
                events += released(self._held)
            if self._tap.leaves():
                events.append(Event("leave"))
            return fewest_moves(events)
        return self._reported()

    def _reported(self) -> list[Event]:
        """The events as GGUI reports them: none has a position, and it knows no wheel."""
        ui = self._ti.ui
        # Presses come before releases: a click within one frame still arrives as a click.
        reported = [
            (kind, event.key)
            for tag, kind in ((ui.PRESS, "press"), (ui.RELEASE, "release"))
            for event in self._window.get_events(tag)
        ]
        # Only now, as the pointer may have moved right before a click.
        w, h = self.size
        x, y = self._window.get_cursor_pos()
        pointer = (round(x * w, 3), round((1 - y) * h, 3))  # to what a mouse resolves
        out: list[Event] = []
        if pointer != self._pointer and 0 <= x <= 1 and 0 <= y <= 1:
            # The position at the start is where the pointer happens to be, not a motion.
            if self._pointer is not None:
                out.append(Event("move", pos=pointer))
            self._pointer = pointer
        elif self._pointer is None:
            self._pointer = pointer
        for kind, key in reported:
            if key in BUTTON_NAMES:
                out.append(Event(kind, pos=pointer, button=BUTTON_NAMES[key]))
            elif name := key_name(key):
                out += changed(kind, name, self._held)
        return out

    def present(self, renderer: Renderer) -> None:
        """Show what a renderer drew last. Raises ConnectionCut, as `poll` does."""
        if self._was_destroyed():  # Vulkan would end the process
            return
        self._looked = time.perf_counter()
        width, height = renderer.size
        if self._image is None or self._image.shape != (width, height):
            ti = self._ti
            if self._tree is not None:
                self._tree.destroy()
            builder = ti.FieldsBuilder()
            self._image = ti.Vector.field(4, ti.u8)
            builder.dense(ti.ij, (width, height)).place(self._image)
            self._tree = builder.finalize()
        with runtime.usual_blocks():
            renderer.copy_to(self._image)
            self._canvas.set_image(self._image)
        self._show()

    def _show(self) -> None:
        """Show the canvas. GGUI writes a title of its own once a second as it does so."""
        self._window.show()
        now = time.perf_counter()
        if self._tap and now > self._named:
            self._named = now + ENTITLED
            self._tap.entitle(self._title)

    def _was_destroyed(self) -> bool:
        """True if the window is gone; it is closed then. Raises ConnectionCut where that is why."""
        if self._tap is None or not self._tap.is_gone():
            return False
        failure = self._cut()
        if failure is not None:
            raise failure
        self.close()
        return True

    def _cut(self) -> x11.ConnectionCut | None:
        """That the window's connection was cut, if it was; then it is closed, and left alone."""
        if self._tap is None or self.closed or not self._tap.is_cut():
            return None
        self.closed = True
        x11.keep(self._window)
        self._forget()
        return x11.ConnectionCut()

    def _gone(self) -> RunFailure | None:
        """Why Vulkan cannot draw any more; None: the window is there."""
        failure = self._cut()
        if failure is not None or self._tap is None or self.closed or not self._tap.is_gone():
            return failure
        self.closed = True
        x11.keep(self._window)
        self._forget()
        return x11.WindowDestroyed()

    def close(self) -> None:
        """Give the window back. May be called twice."""
        if not self.closed:
            self.closed = True
            self._window.destroy()
            self._forget()

    def _forget(self) -> None:
        """Give back what the window had besides."""
        if self._guard:
            self._guard.release()
        if self._tap:
            self._tap.close()
        # The text library behind GGUI leaves its settings in the current folder.
        if not self._had_settings:
            SETTINGS.unlink(missing_ok=True)


def _software() -> str | None:
    """Why `auto` leaves GGUI out: its device is no graphics card."""
    names = vulkan.devices()
    return SOFTWARE if names and all(map(vulkan.is_software, names)) else None


PRESENTER = Kind(
    name="ggui",
    rank=1,
    lack=lambda: no_display() or (None if runtime.vulkan_available() else NO_VULKAN),
    avoided=_software,
    open=GguiPresenter,
)
