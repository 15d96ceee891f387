"""What a window is told of a second run beside its own. Who makes that is said from above."""

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
    """How far two runs are apart, in words, and in the last seconds.

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
        """What the first and the second run are called, by what they differ in."""

    def stopped(self) -> str:
        """Why the second one stands still; "": it does not."""

    def reading(self) -> DistanceReading:
        """How far they are apart."""

    def finding(self) -> Word | None:
        """What differed first, if anything did."""
