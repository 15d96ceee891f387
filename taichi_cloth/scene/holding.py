"""Mouse tools in a scene: whether they are at hand, and what one holds at the moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Hold:
    """Particles that the mouse holds, each by a spring and a dashpot of its own to a place.

    particles: (m,) int64. offset: (m, dim), where each is held, from the pointer's place [length].
    place: (dim,), the pointer's [length], which is written to as the pointer moves.
    stiffness: (m,) [force / length]. damping: (m,) [force / velocity]. mass: (m,), what they weigh
    when they are let go: the step may need them to weigh more until then (`limits/holding.py`).
    """

    particles: np.ndarray
    offset: np.ndarray
    place: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    mass: np.ndarray

    @classmethod
    def nobody(cls, dim: int) -> Hold:
        """A hold of no particle."""
        none = np.zeros(0)
        return cls(np.zeros(0, np.int64), np.zeros((0, dim)), np.zeros(dim), none, none, none)

    @property
    def targets(self) -> np.ndarray:
        """The places where particles are held, (m, dim)."""
        targets: np.ndarray = self.offset + self.place
        return targets

    def among(self, count: int, column: str) -> np.ndarray:
        """A column for all particles of a scene, (count,) or (count, dim): 0 where not held."""
        values = getattr(self, column)
        out = np.zeros((count, *values.shape[1:]))
        out[self.particles] = values
        return out
