"""The substeps that a budget chooses from, between two limits, and what is said of a choice."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field

# Each is a quarter to a half more than the one before: what differs by less is not told apart from
# noise, and is not worth another step.
_OCTAVE = (4, 5, 6, 7)
RUNGS = (1, 2, 3, *(n << k for k in range(17) for n in _OCTAVE))


@dataclass(frozen=True)
class Limits:
    """Between which substeps a run may be.

    least: with which its steps are stable; most: with which its numbers still follow the motion.
    why_most: what is in the way of more.
    """

    least: int = 1
    most: int = RUNGS[-1]
    why_most: str = "there are no more"

    def rungs(self) -> list[int]:
        """The substeps to choose from, the fewest first; at least one."""
        first, end = bisect_left(RUNGS, self.least), bisect_right(RUNGS, max(self.most, self.least))
        found = list(RUNGS[first:end])
        if not found or found[0] != self.least:
            found.insert(0, self.least)
        return found

    def at_least(self, substeps: float) -> int | None:
        """The first rung with as many; None: there is none."""
        return next((n for n in self.rungs() if n >= substeps * (1 - 1e-9)), None)


@dataclass(frozen=True)
class Choice:
    """The substeps that are chosen. why: in words; short: in few. met: whether the goal is.

    solver: settings of what solves the steps, by name, where they are chosen, too. method: where it
    is to be another one; "": as now.
    """

    substeps: int
    why: str
    short: str
    met: bool = True
    solver: dict[str, float] = field(default_factory=dict)
    method: str = ""


def steps_in_words(count: int) -> str:
    """Such as "6 substeps"."""
    return f"{count} substep{'s' * (count != 1)}"
