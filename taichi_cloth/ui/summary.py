"""The outcome of a run, for whoever started it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Refused:
    """Events of a log that the simulation refused: how many, and the first in words."""

    count: int = 0
    first: str = ""

    def with_one(self, words: str) -> Refused:
        """These and another one."""
        return Refused(self.count + 1, self.first or words)


@dataclass(frozen=True)
class Summary:
    """The outcome of a run.

    frames: advanced in this run. seconds: it took, from the first to the last. simulate: the part
    of these spent simulating, without the first frame, which compiles. draw: the part spent
    drawing. waited: the part spent waiting until the next frame was due. quit: whether the user
    ended it. refused: events of the log it replayed that the simulation refused.
    """

    frames: int
    seconds: float
    simulate: float
    draw: float
    waited: float
    quit: bool
    refused: Refused = Refused()
