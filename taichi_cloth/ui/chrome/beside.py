"""A second run beside a window's own, as the window sees it. Who makes it is said from above."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.ui.text import Color, Word

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation


@dataclass(frozen=True)
class DistanceReading:
    """The distance of two runs, in words, and in the last seconds.

    value: now; details: of it; state: the colour of both. age: of frames [s], the oldest first;
    rms, largest: of a particle's distance then, in parts of the motion, (k,).
    """

    value: str
    details: tuple[str, ...]
    state: Color = style.INK
    age: np.ndarray = field(default_factory=lambda: np.zeros(0))
    rms: np.ndarray = field(default_factory=lambda: np.zeros(0))
    largest: np.ndarray = field(default_factory=lambda: np.zeros(0))


class Second(Protocol):
    """A second run of a scene, which goes along with the first.

    sim: it. spent: seconds that its last frame took. took: with all that goes with it.
    """

    @property
    def sim(self) -> Simulation: ...

    @property
    def spent(self) -> float: ...

    @property
    def took(self) -> float: ...

    def names(self) -> tuple[str, str]:
        """Names of the first and the second run, by what they differ in."""

    def stopped(self) -> str:
        """Why the second one stands still; "": it does not."""

    def reading(self) -> DistanceReading:
        """Their distance, in words."""

    def finding(self) -> Word | None:
        """The first difference, if there is one."""
