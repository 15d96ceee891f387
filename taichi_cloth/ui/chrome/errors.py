"""The error of what is seen, as the meters see it. Who measures it is said from above."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.ui.text import Color


@dataclass(frozen=True)
class ErrorReading:
    """The error of the last second that was measured, in words, and those before.

    value: now; details: what it comes from, and how old it is; state: the colour of both that says
    whether it is sure. age, relative: of the ends of each second [s], the oldest first, and its
    error in parts of the motion, (k,); NaN where none is known.
    """

    value: str
    details: tuple[str, ...]
    state: Color = style.MUTED
    age: np.ndarray = field(default_factory=lambda: np.zeros(0))
    relative: np.ndarray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class GhostReading:
    """The reference of a second that was measured, beside what is seen.

    words: what it is, and how old. away: by how much it is away from the first n particles, (n,
    dim) [world], as it is drawn; None: there is none to draw. torn: (k, 2), between which particles
    it has no springs.
    """

    words: str
    away: np.ndarray | None = None
    torn: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.int64))


class Errors(Protocol):
    """Measures the error of each second, while it is switched on."""

    @property
    def on(self) -> bool:
        """True if it measures."""

    def switch(self) -> None:
        """Begin to measure, or end."""

    def reading(self) -> ErrorReading:
        """Its words now."""

    def next_ghost(self) -> str:
        """Show the reference as a ghost, magnified, then in its true size, then no more; what to
        tell the user. It switches the meter on.
        """

    def ghost(self) -> GhostReading | None:
        """The ghost of the present frame; None: it is not asked for."""
