"""Films and pictures of a run: one film of all of it, and those that keys take."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

from taichi_cloth.render.picture import Rect
from taichi_cloth.ui.film import Film
from taichi_cloth.ui.shutter import Shutter


class Takes:
    """The films of a run, and the picture that a key asked for: who wants the frame last drawn.

    film: of the whole view; None: none is made. shutter: what keys take, of the world's room alone.
    """

    def __init__(self, film: Film | None, shutter: Shutter) -> None:
        self.shutter = shutter
        self._films: list[Film | Shutter] = [shutter] if film is None else [film, shutter]
        self._waiting: list[Film | Shutter] = []  # what the frame last drawn goes into

    def turn(self, advanced: bool) -> None:
        """Ask the films whether they want this turn's frame; advanced: whether it is a new one."""
        self._waiting = [film for film in self._films if advanced and film.wants()]

    @property
    def filming(self) -> bool:
        """True if a film is being made, of whatever frame comes next."""
        return len(self._films) > 1 or self.shutter.state is not None

    @property
    def due(self) -> bool:
        """True if the frame that is drawn now is wanted."""
        return bool(self._waiting) or self.shutter.due

    @property
    def of_world(self) -> bool:
        """True if what is drawn now goes into a picture or a film of the world's room alone."""
        return self.shutter.due or self.shutter in self._waiting

    def take(self, pixels: np.ndarray, room: Rect) -> None:
        """Put a frame (h, w, 3) uint8 into what wants it; room: where the world is in it."""
        world = pixels[room.y : room.y + room.height, room.x : room.x + room.width]
        while self._waiting:
            film = self._waiting.pop()
            film.add(world if film is self.shutter else pixels)
        if self.shutter.due:
            self.shutter.take(world)

    @property
    def missing(self) -> bool:
        """True if a film still wants the frame last drawn, because the window went meanwhile."""
        return bool(self._waiting)

    def save(self, files: ExitStack) -> None:
        """Have the films saved when `files` is closed, each whatever becomes of the others."""
        for film in self._films:
            files.callback(film.save)
