"""Looks at a 2-D world: pan, zoom, all of it again, and back to the look before.

Where nothing is in the world any more, all of it is what there is.

That is the window's alone: logs have positions as if all of the world were seen, so a replay needs
to know nothing of it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.render.camera import FILLED
from taichi_cloth.render.window_map import Look, WindowMap
from taichi_cloth.ui.camera_moves import MOST_POSES, ZOOM_STEP, gathered
from taichi_cloth.ui.inputs import BACK_KEY, FARTHER_KEYS, FRAME_KEY, HOME_KEY, NEARER_KEYS, Event

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

PANS = "middle", "right"  # the buttons whose drags pan; the left one is the tools'
ZOOMS = 0.25, 400.0  # between which one may zoom: a quarter of the picture; a pixel fills it


class PlaneMoves:
    """Moves a look at a simulation's world. look: the present one; None: all of it is seen."""

    def __init__(self, sim: Simulation, look: Look | None = None) -> None:
        self.look = look
        self._sim, world = sim, sim.scene.world
        self._whole = Look((float(world.size[0]) / 2, float(world.size[1]) / 2), 1.0)
        self._before: list[Look | None] = []
        self._dragged: tuple[float, float] | None = None  # where the pointer was, window pixels
        self._zooming = False

    def take(self, event: Event, here: WindowMap, *, free: bool) -> bool:
        """React to an event; returns whether it was for the look alone.

        here: the window's map as it is now. free: whether a press is not meant for the tool.
        """
        pos = event.pos
        if event.kind == "wheel" and pos is not None:
            self._zoom(event.delta, np.array(pos), here)
            return True
        if event.kind == "press" and pos is not None and free:
            self._note()
            self._dragged = pos
            return True
        if self._dragged is not None and pos is not None:
            self._pan(np.array(pos) - self._dragged, here)
            self._dragged = None if event.kind == "release" else pos
            return True
        if event.kind == "press" and event.key is not None:
            self._key(event.key, here)
        return False

    def _key(self, key: str, here: WindowMap) -> None:
        middle = here.offset + here.scale * np.array((self.look or self._whole).middle)
        if key in NEARER_KEYS:
            self._zoom(1, middle, here)
        elif key in FARTHER_KEYS:
            self._zoom(-1, middle, here)
        elif key == FRAME_KEY:
            self._note()
            self.look = self._framing(here)
        elif key == HOME_KEY:
            self._note()
            self.look = None
        elif key == BACK_KEY and self._before:
            self.look = self._before.pop()
            self._zooming = False

    def _framing(self, here: WindowMap) -> Look | None:
        """All of the world, or all particles where none is in it."""
        whole, (x, radius) = replace(here, look=None), gathered(self._sim)
        if not len(x) or whole.shows(x, np.full(len(x), radius)).any():
            return None
        return here.looking_at(x, FILLED)

    def _note(self) -> None:
        """Remember the look before a move."""
        self._before = [*self._before[-MOST_POSES:], self.look]
        self._zooming = False

    def _zoom(self, notches: float, pixel: np.ndarray, here: WindowMap) -> None:
        """Come nearer by so many notches; what is under a window pixel (2,) stays there."""
        if not self._zooming:
            self._note()
        self._zooming = True
        now = self.look or self._whole
        wanted = now.zoom * ZOOM_STEP ** float(np.clip(notches, -100, 100))
        # What is framed may be seen from farther.
        zoom = float(np.clip(wanted, min(ZOOMS[0], now.zoom), ZOOMS[1]))
        under = (pixel - here.offset) / here.scale
        x, y = under + (np.array(now.middle) - under) * (now.zoom / zoom)
        self.look = Look((float(x), float(y)), zoom)

    def _pan(self, pixels: np.ndarray, here: WindowMap) -> None:
        now = self.look or self._whole
        x, y = np.array(now.middle) - pixels / here.scale
        self.look = Look((float(x), float(y)), now.zoom)
