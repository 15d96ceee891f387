"""Frames given to writers of results, and the contract of these."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True)
class Clock:
    """When frames are.

    dt: time from one to the next [the scene's time]; every: of so many frames one is kept.
    """

    dt: float
    every: int

    @property
    def rate(self) -> float:
        """Frames in a unit of the scene's time: in a second, where the scene has seconds."""
        rate = 1 / self.dt
        # Files say dt = 0.0166667; film slowed for television, 24000 / 1001, is farther from whole.
        return float(round(rate)) if abs(rate - round(rate)) < 1e-5 * rate else rate


@dataclass(frozen=True)
class Frame:
    """One frame.

    number: as the simulation counts, the first step's end is 1. time: at its end.
    position: (n, 3). triangles: (m, 3) points; whole: which of them are not torn, (m,) bool.
    springs: (s, 2) points; held: which of them hold, (s,) bool.
    """

    number: int
    time: float
    position: np.ndarray
    triangles: np.ndarray
    whole: np.ndarray
    springs: np.ndarray
    held: np.ndarray

    def faces(self) -> np.ndarray:
        """The triangles that are not torn, (m, 3)."""
        faces: np.ndarray = self.triangles[self.whole]
        return faces

    def edges(self) -> np.ndarray:
        """The springs that hold, of a scene that has no surface, (s, 2)."""
        held = self.held if not len(self.triangles) else np.zeros_like(self.held)
        edges: np.ndarray = self.springs[held]
        return edges


class Writer(Protocol):
    """Writes frames, in the order of their numbers. Raises InputError where a disk is full."""

    def add(self, frame: Frame) -> None:
        """Write a frame, or keep it until `finish`."""

    def restart(self) -> None:
        """Forget all frames."""

    def rewind(self, frame: int) -> None:
        """Forget the frames after this number; there is one that is not."""

    def finish(self) -> None:
        """Give the files their names. Once only, and nothing after `discard`."""

    def discard(self) -> None:
        """Leave nothing behind, unless finished."""
