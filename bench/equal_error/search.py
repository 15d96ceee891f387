"""The search for the cheapest setting at each error, of anything that can be run in settings."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

LEVELS = (0.1, 0.01, 0.001, 0.0001)  # errors, coarsest first
STALLED = 3  # runs in turn that are no better than before: round-off, or the solver's own error
BETTER = 0.9  # of the least error so far: what counts as better
CLEARLY = 2.0  # times the seconds of another: longer by more than noise
HALVINGS = 2  # of the way between a setting that is too coarse and the next, which is not


@dataclass(frozen=True, order=True)
class Choice:
    """The space of the search: steps a frame, the solver's iterations in each, or its tolerance.

    None: it takes none.
    """

    substeps: int | None = None
    iterations: int | None = None
    tolerance: float | None = None

    def describe(self) -> str:
        """'16 substeps, 4 iterations', or 'tolerance 1e-06'."""
        words = [
            f"{count} {name}" if count > 1 else f"{count} {name[:-1]}"
            for name, count in (("substeps", self.substeps), ("iterations", self.iterations))
            if count is not None
        ]
        if self.tolerance is not None:
            words.append(f"tolerance {self.tolerance:.2g}")
        return ", ".join(words)

    def between(self, finer: Choice) -> Choice | None:
        """Half way to a finer one that differs in one number, or None where nothing is between."""
        if self.tolerance is not None and finer.tolerance is not None:
            if self.tolerance != finer.tolerance:
                return replace(self, tolerance=math.sqrt(self.tolerance * finer.tolerance))
        elif self.substeps is not None and finer.substeps is not None:
            middle = round(math.sqrt(self.substeps * finer.substeps))
            if self.substeps < middle < finer.substeps:
                return replace(self, substeps=middle)
        return None


@dataclass(frozen=True)
class Tried:
    """A run of a choice: its error, in parts of the scale, and the seconds of a frame.

    One that failed has no error, and seconds only where it took too long; failed: how it ended.
    """

    choice: Choice
    error: float | None = None
    seconds: float | None = None
    failed: str = ""

    def meets(self, level: float) -> bool:
        """True if it was run and timed, and its error is at most `level`."""
        return self.error is not None and self.seconds is not None and self.error <= level


Run = Callable[[Choice], Tried]


def climb(run: Run, ladder: Iterable[Choice], limit: float, finest: float) -> list[Tried]:
    """Runs of ever finer choices, until one meets the finest level, or `limit` seconds a frame are
    passed, or STALLED in turn are no better than what there was.
    """
    tried: list[Tried] = []
    least, stalled = math.inf, 0
    for choice in ladder:
        done = run(choice)
        tried.append(done)
        if done.meets(finest) or (done.seconds is not None and done.seconds > limit):
            break
        if done.error is None or done.error > 1:  # flew apart: steps may be too long as yet
            continue
        stalled = 0 if done.error < BETTER * least else stalled + 1
        least = min(least, done.error)
        if stalled >= STALLED:
            break
    return tried


def cheapest(tried: Iterable[Tried], level: float) -> Tried | None:
    """The one of the fewest seconds a frame that meets the level; None where none does."""
    return min((t for t in tried if t.meets(level)), key=lambda t: t.seconds or 0.0, default=None)


def refine(run: Run, series: Sequence[Tried], levels: Sequence[float]) -> list[Tried]:
    """Runs between neighbours of a series, each of which ends nearer to where a level is just met.

    series: of one ladder, coarsest first.
    """
    made: dict[Choice, Tried] = {}
    for level in levels:
        meets = next((k for k, t in enumerate(series) if t.meets(level)), 0)
        if meets == 0:
            continue
        below, above = series[meets - 1].choice, series[meets].choice
        for _ in range(HALVINGS):
            middle = below.between(above)
            if middle is None:
                break
            if middle not in made:
                made[middle] = run(middle)
            if made[middle].meets(level):
                above = middle
            else:
                below = middle
    return list(made.values())


def search_all(
    run: Run,
    ladders: Sequence[Sequence[Choice]],
    limit: float,
    levels: Sequence[float] = LEVELS,
    before: Sequence[Tried] = (),
) -> list[Tried]:
    """All runs: each ladder climbed, then refined where it has the cheapest run of a level.

    before: runs of other solvers, of which only the cheapest counts in the end. What takes clearly
    longer than a run that meets every level is the cheapest of none, nor is what is finer still.
    """
    everything: list[Tried] = []
    climbed = []
    for ladder in ladders:
        met = cheapest([*before, *everything], min(levels))
        longest = limit if met is None else min(limit, CLEARLY * (met.seconds or 0.0))
        climbed.append(climb(run, ladder, longest, min(levels)))
        everything += climbed[-1]
    best = [cheapest([*before, *everything], level) for level in levels]
    for series in climbed:
        mine = [level for level, done in zip(levels, best, strict=True) if done in series]
        everything += refine(run, series, mine)
    return everything
