"""Springs and surfaces in the colours of what they bear: pushed blue, calm, pulled amber and red.

Where springs break that is their force in break forces, else their strain, of which a tenth counts
as full, or what the scene starts with (`simulation.strain`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.render.drawing import Cached
from taichi_cloth.simulation import strain
from taichi_cloth.ui.text import Color

if TYPE_CHECKING:
    from taichi_cloth.scene.model import Springs
    from taichi_cloth.simulation.simulation import Simulation

PUSHED, CALM, HALF, LIMIT = (64, 128, 255), (138, 146, 162), (246, 190, 66), (236, 52, 48)
SHADES = 24  # colours from calm to the limit: as many as one can tell


def palette() -> np.ndarray:
    """The colours from -1 to 1, (2 SHADES + 1, 3) uint8."""
    at = np.linspace(-1.0, 1.0, 2 * SHADES + 1)
    stops = np.array([PUSHED, CALM, HALF, LIMIT], np.float64)
    channels = [np.interp(at, [-1.0, 0.0, 0.5, 1.0], channel) for channel in stops.T]
    return np.round(np.stack(channels, axis=1)).astype(np.uint8)


PALETTE = palette()


def colors(borne: np.ndarray) -> np.ndarray:
    """The colours (s, 3) uint8 of what springs bear (s,), from -1 (pushed) to 1 (pulled)."""
    with np.errstate(invalid="ignore"):  # of springs whose ends are lost
        place = np.nan_to_num(np.clip(borne, -1.0, 1.0) * SHADES).astype(np.int64)
    found: np.ndarray = PALETTE.take(place + SHADES, axis=0)
    return found


class Strained:
    """The colours of a simulation's springs and particles, as it is now."""

    def __init__(self, sim: Simulation) -> None:
        self._sim = sim
        self._held = Cached(self._select)
        self._allowed = Cached(strain.allowed)
        self._rows = Cached(_rows_of)
        self._ends = Cached(_Ends)

    @property
    def _full(self) -> float:
        """The strain that counts as full where springs cannot break."""
        start = self._sim.scene
        return self._allowed(start.particles.position, start.springs)

    def legend(self) -> tuple[tuple[str, Color], ...]:
        """The legend of the colours, as words in them."""
        breaks = np.isfinite(self._sim.storage.scene.springs.break_force)
        limits = ("break force",) * bool(breaks.any())
        if not breaks.all() or not len(breaks):
            limits += (f"{100 * self._full:.0f} %",)
        full = " or ".join(limits)
        return (("pushed", PUSHED), ("calm", CALM), ("pulled: half", HALF), (full, LIMIT))

    def _select(self, springs: Springs, holding: np.ndarray) -> Springs:
        return springs.select(self._sim.springs_alive())

    def colors(
        self, position: np.ndarray, segments: np.ndarray, count: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """The colours of springs and of particles, (k, 3) and (count, 3) uint8.

        A particle has that of its spring which bears most.

        position: (n, dim), where particles are. segments: (k, 2), the springs that are drawn, some
        of those that hold, in their order. count: of particles.
        """
        holding = self._sim.drawn_springs()
        springs = self._held(self._sim.storage.scene.springs, holding)
        borne = strain.borne(strain.lengths(position, holding), springs, self._full)
        particle = colors(self._ends(holding, count).most(borne))
        if segments is holding:
            return colors(borne), particle
        return colors(borne[self._rows(holding, segments, count)]), particle


class _Ends:
    """The springs at each particle, for what is asked of all of them."""

    def __init__(self, between: np.ndarray, count: int) -> None:
        ends = between.T.ravel()
        self._spring = np.argsort(ends, kind="stable") % max(len(between), 1)
        self._particle, self._start = np.unique(np.sort(ends), return_index=True)
        self._count = count

    def most(self, borne: np.ndarray) -> np.ndarray:
        """The largest load of a spring at each particle, pulled or pushed, (count,)."""
        out = np.zeros(self._count)
        if len(self._particle):
            of_springs = borne[self._spring]
            pulled = np.maximum.reduceat(of_springs, self._start)
            pushed = np.minimum.reduceat(of_springs, self._start)
            out[self._particle] = np.where(pulled >= -pushed, pulled, pushed)
        return out


def _rows_of(holding: np.ndarray, segments: np.ndarray, count: int) -> np.ndarray:
    """Which of the springs that hold (s, 2) those that are drawn (k, 2) are, (k,)."""
    if len(segments) == len(holding):
        return np.arange(len(holding))
    keys = holding @ [count, 1]
    order = np.argsort(keys, kind="stable")
    rows: np.ndarray = order[np.searchsorted(keys[order], segments @ [count, 1])]
    return rows
