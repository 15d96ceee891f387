"""The window that events' positions refer to, which the world fills, and the one that is there."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.render.picture import Rect
from taichi_cloth.render.window_map import WindowMap
from taichi_cloth.scene.model import World
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.interaction import Log
from taichi_cloth.ui.view import View

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation


class LogWindow:
    """Converts places between a view as it is now and the window of a log.

    What the user does is applied and recorded in the log's window, so that resizing spoils no
    replay. size: (width, height) of that.

    right: where a second world is drawn beside the view's own; None: there is none. side: in which
    of the two the pointer is, or was as its button went down: 0 or 1.
    """

    def __init__(self, sim: Simulation, view: View, replay: Log | None) -> None:
        self._sim, self._view = sim, view
        self.right: Rect | None = None
        self.side, self._held = 0, False
        self.size = event_window(sim.scene.world, view, replay)

    @property
    def here(self) -> WindowMap:
        """The map between the world and the view."""
        view = self._view
        return WindowMap.of(self._sim.scene.world, view.size, view.room, view.look)

    @property
    def _there(self) -> WindowMap:
        return WindowMap.of(self._sim.scene.world, self.size)

    def on_first(self, event: Event) -> Event:
        """An event where the second of two worlds is as one at the same place of the first."""
        if self.right is None or event.pos is None:
            return event
        if not self._held:
            self.side = int(event.pos[0] >= self.right.x)
        if event.button is not None:
            self._held = event.kind == "press"
        x, y = event.pos
        return replace(event, pos=(x - self.side * self.apart, y))

    @property
    def apart(self) -> int:
        """The distance of the second world from the first, window pixels."""
        left = self._view.room or Rect(0, 0, *self._view.size)
        return self.right.x - left.x if self.right else 0

    def taken(self, event: Event) -> Event:
        """An event of the view as one of the log's window."""
        if event.pos is None:
            return event
        here, there = self.here, self._there
        if here.scale == there.scale and (here.offset == there.offset).all():
            return event
        x, y = there.to_window(here.to_world(event.pos))
        return replace(event, pos=(float(x), float(y)))

    def shown(self, place: np.ndarray) -> np.ndarray:
        """A place (2,) in the log's window as one in the view."""
        return self.here.to_window(self._there.to_world(place))


def event_window(world: World, view: View, replay: Log | None) -> tuple[int, int]:
    """The window (width, height) that events' positions refer to, which the world fills.

    That is the one a replayed log was recorded in, or where it does not say, the one in which
    one pixel is one world unit; without a log, the room of this view as it is now.
    """
    if replay is None:
        room = view.room or Rect(0, 0, *view.size)
        return int(room.width), int(room.height)
    said = replay.header.get("window")
    w, h = said or (max(round(world.size[0]), 1), max(round(world.size[1]), 1))
    return int(w), int(h)
