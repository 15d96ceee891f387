"""The pointer as it is drawn over a picture: a cross, and a ring around what a tool reaches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CROSS = (4.0, 11.0)  # pixels from the pointer, from where to where its lines reach
CORNERS = 56  # of the ring


@dataclass(frozen=True)
class Pointer:
    """The pointer, as it is drawn.

    place: (2,) window pixels. ring: radius of the ring, window pixels; None: there is none.
    cross: whether the place itself is marked.
    """

    place: np.ndarray
    ring: float | None
    cross: bool

    def lines(self) -> np.ndarray:
        """The ends of its lines, (k, 2, 2) window pixels."""
        found = []
        if self.cross:
            ways = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
            found.append(np.stack([near * ways for near in CROSS], axis=1))
        if self.ring is not None:
            turn = np.linspace(0.0, 2 * np.pi, CORNERS + 1)
            circle = self.ring * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            found.append(np.stack([circle[:-1], circle[1:]], axis=1))
        lines: np.ndarray = self.place + np.concatenate([np.zeros((0, 2, 2)), *found])
        return lines
