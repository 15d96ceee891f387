"""The view of GGUI, Taichi's Vulkan window: depth-buffered, fast, also off-screen.

`composer.py` draws into it; here are the window and its events.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.errors import RunFailure
from taichi_cloth.scene.model import World
from taichi_cloth.ui import descriptor_pools, drawing, rescue, shaders, x11
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.chrome.layout import Rect
from taichi_cloth.ui.composer import Composer
from taichi_cloth.ui.framing import camera_of_world
from taichi_cloth.ui.inputs import (
    BUTTON_NAMES,
    Event,
    changed,
    fewest_moves,
    key_name,
    released,
    said_by_x,
)
from taichi_cloth.ui.pair_composer import PairComposer
from taichi_cloth.ui.views.contract import Picture, ViewKind, no_display
from taichi_cloth.ui.window_map import Look, WindowMap

NO_VULKAN = "GGUI needs Vulkan, which is not there (install a Vulkan driver, such as Mesa's)"
SETTINGS = Path("imgui.ini")  # of GGUI's text library, which we do not use
ENTITLED = 0.03  # seconds after which a title is written again as a picture is shown
# Seconds after a look at whether the window is there in which `poll` does not look, too: each
# waits for the X server, which reads the last picture at that time.
LOOKED = 0.1


class GguiView:
    """A GGUI window, or with `visible` False the same picture in memory."""

    name = "ggui"

    def __init__(self, world: World, size: tuple[int, int], title: str, *, visible: bool = True):
        import taichi as ti

        self._ti: Any = ti
        self.world, self.visible = world, visible
        self.camera: Camera | None = camera_of_world(world)
        self.room: Rect | None = None
        self.look: Look | None = None
        self.text_size = 1.0
        self._had_settings = SETTINGS.exists()
        with x11.opening() as displays:
            self._window = shaders.open_window(title, size, visible=visible)
        # Which is done where Mesa's software driver draws: ti.GUI's kernels take less than that.
        self.quicker = "--view gui" if descriptor_pools.limit() else ""
        self._composer = Composer(self._window)
        self._pair: PairComposer | None = None  # of two worlds beside each other
        self._tap = x11.connect(title, displays) if visible else None
        self._guard = rescue.Guard(self._gone) if self._tap else None
        if self._tap:
            self._tap.show_whole()  # GGUI begins 100 pixels from the screen's corner
        self._listens = bool(self._tap and self._tap.listen())
        self._pointer: tuple[float, float] | None = None
        self._held: set[str] = set()
        self._last: Picture | None = None
        self._fresh = False  # whether what was drawn last can still be taken from the window
        self._title, self._named = title, 0.0  # when it is due again
        self._looked = 0.0  # when the window was last known to be there
        self.has_wheel = self._listens
        self.closed = False
        self._size = size

    @property
    def size(self) -> tuple[int, int]:
        """Current width and height in pixels."""
        if self.closed or not self.visible:
            return self._size
        w, h = self._window.get_window_shape()
        if w > 0 and h > 0:  # a minimised window reports zero
            self._size = (int(w), int(h))
        return self._size

    def turn_to(self, world: World, camera: Camera | None) -> None:
        """Show another world from now on; camera: of a 3-D one."""
        self.world, self.camera, self.look = world, camera, None
        self._last, self._fresh = None, False

    def entitle(self, title: str) -> None:
        """Write a title over the window."""
        if title != self._title:
            self._title, self._named = title, 0.0
            if self._tap and not self.closed:
                self._tap.entitle(title)

    def _present(self) -> None:
        """Show what was drawn. GGUI writes a title of its own once a second as it does so."""
        self._window.show()
        now = time.perf_counter()
        if self._tap and now > self._named:
            self._named = now + ENTITLED
            self._tap.entitle(self._title)

    # Events

    def poll(self) -> list[Event]:
        """The user's events since the last call, oldest first.

        Raises ConnectionCut where the window's connection to the display is cut.
        """
        if self.closed or not self.visible:
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
            out += self._translated(kind, key, pointer)
        return out

    def _translated(self, kind: str, key: str, pointer: tuple[float, float]) -> list[Event]:
        if key in BUTTON_NAMES:
            return [Event(kind, pos=pointer, button=BUTTON_NAMES[key])]
        name = key_name(key)
        return changed(kind, name, self._held) if name else []

    # Drawing

    def draw(self, picture: Picture) -> None:
        """Draw and present one frame. Raises ConnectionCut, as `poll` does."""
        if self.closed:
            return
        self._last = picture
        self._compose(picture)
        if self.visible:
            if self._was_destroyed():  # Vulkan would end the process
                return
            self._looked = time.perf_counter()
            self._present()
        self._fresh = not self.visible

    def _compose(self, picture: Picture) -> None:
        window = WindowMap.of(self.world, self.size, self.room, self.look)
        if picture.beside is None:
            self._composer.compose(picture, self.world, self.camera, window)
            return
        if self._pair is None:
            self._pair = PairComposer(self._window)
        self._pair.compose(picture, picture.beside, self.world, self.camera, window)

    def grab(self) -> np.ndarray:
        """The frame drawn last, (height, width, 3) uint8, row 0 on top."""
        if self._last is None:
            raise RuntimeError("nothing has been drawn yet")
        if not self._fresh:
            # What was shown or taken is gone; the same picture is drawn again.
            self._compose(self._last)
        self._fresh = False
        pixels = drawing.as_image(self._window.get_image_buffer_as_numpy())
        if self.visible and not self._was_destroyed():
            # Else it would be shown in the place of the next frame, which would be drawn over it.
            self._present()
        return pixels

    def _was_destroyed(self) -> bool:
        """Whether the window is gone; it is closed then. Raises ConnectionCut where that is why."""
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


VIEW = ViewKind(
    name="ggui",
    windows=True,
    lack=lambda: no_display() or (None if runtime.vulkan_available() else NO_VULKAN),
    pictures=runtime.vulkan_available,
    several=False,  # a second GGUI window in a process ends it
    open=GguiView,
)
