"""A window with other steps and by other methods: at which steps these are tried."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Trial:
    """A method that a window is to be made again with.

    equal: substeps of a frame that take as long as the window's own; tried first. least: the fewest
    with which it is stable; finest: the most that may be tried; None: as many as are equal.
    within: the error that is wanted, in parts of the window's motion; None: what rounding made of
    the window, as below that fewer steps are more accurate.
    """

    method: str
    equal: float
    least: int
    finest: int | None = None
    within: float | None = None

    def at(self, level: int) -> int | None:
        """The substeps that take 2**level times as long as the window's own; None: none such."""
        substeps = int(self.equal * 2**level * (1 + 1e-9))
        if substeps < max(self.least, 1):
            return None
        return substeps if level == 0 or substeps <= (self.finest or 0) else None

    def wants(self, rounding: float) -> float:
        """The error to be within; rounding: what that made of the window."""
        return rounding if self.within is None else self.within

    @property
    def levels(self) -> int:
        """The number of levels at which it may be tried."""
        finer = (self.finest or 0) / self.equal
        return 1 + max(0, math.floor(math.log2(finer) + 1e-9)) if finer > 0 else 1


def results(
    trials: Sequence[Trial], error: Callable[[str, int], float], rounding: float
) -> Iterator[tuple[str, int, float]]:
    """(method, substeps, error) of each try: finer until one is within, coarser while it is.

    All are tried at equal cost first. Those that are within go on with half as many substeps, and
    again half. Where none is, all go on at twice the cost, so the first one within is the cheapest.
    Those that are not go on once more than that, as one of a higher order may be worth more in a
    harder window; so does the first trial, of the window's own method.
    error: of a method with so many substeps, in parts of the motion; rounding: as of `Trial`.
    """
    going, last = list(trials), False
    for level in range(max((trial.levels for trial in trials), default=0)):
        within: list[tuple[Trial, int]] = []
        for trial in going:
            if (substeps := trial.at(level)) is None:
                continue
            found = error(trial.method, substeps)
            yield trial.method, substeps, found
            if found <= trial.wants(rounding):
                within.append((trial, substeps))
        for trial, substeps in within if level == 0 else ():
            while (fewer := max(substeps // 2, trial.least)) < substeps:
                found, substeps = error(trial.method, fewer), fewer
                yield trial.method, substeps, found
                if not found <= trial.wants(rounding):
                    break
        if last or trials[0] in [trial for trial, _ in within]:
            return
        if within:
            met = [trial for trial, _ in within]
            going, last = [trial for trial in trials if trial not in met], True
