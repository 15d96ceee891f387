"""The pace of a study: the part that fits in its time, told from how long the finished took.

Methods come in the order of what they take to compile, each with its share of the time that is
left, in which its settings run from the longest step to the shortest. What does not fit is left
out, and said; what is running when the time is over is left out, too. The reference always runs,
and until there is a row to show nothing begins that might keep the first one from its timing.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from typing import Any

from taichi_cloth.sweeps.within import Clock
from taichi_cloth.trade.conditions import REFERENCES
from taichi_cloth.trade.outcomes import Outcome
from taichi_cloth.trade.settings import Setting

FEWEST_FRAMES = 4  # of a horizon that is cut
# Runs as long as the coarsest of the fine ones that finding the references takes: that, a disturbed
# one, and one at a quarter of the step.
COARSE_RUNS = 6
EXPLICIT, SWEEPS, SOLVES = range(3)  # kinds of methods; the first compiles soonest
SLOWER = (1.0, 2.0, 3.0)  # times as long as the first, until one of them was compiled
GREED = 1.5  # even shares of the time left that a method may take: the next ones may take less
CONVERGED = 8.0  # times as long as a run that is not, about
ELSEWHERE = 0.4  # of the time: for timing here, with compiling, what was run elsewhere
HOPE = 0.6  # of the time that a method is expected to compile in, that it may do with
PAST = 0.1  # of the time, by which the reference and the first row alone may exceed it
HALF = 0.5  # of the time left, that references take at most: rows have to follow


def rank(method: str) -> tuple[int, bool]:
    """Which methods come first: those that compile soonest, of these what is ever stable."""
    from taichi_cloth.kernels import methods

    return kind_of(method), methods.load(method).claims.stability_limit == 0


def kind_of(method: str) -> int:
    """A method's way of a step: it is EXPLICIT, makes SWEEPS, or SOLVES the equations."""
    from taichi_cloth.kernels import methods

    claims = methods.load(method).claims
    if not claims.implicit:
        return EXPLICIT
    return SWEEPS if "iterations" in claims.settings else SOLVES


class Pace:
    """Times of things in a study, and the part that fits until its clock's end."""

    def __init__(self, clock: Clock):
        self.clock = clock
        self._lock = threading.Lock()
        self._compiled: dict[int, float] = {}  # by kind, the longest seconds so far
        self.longest = 0.0  # seconds of a run that is known beforehand not to fit
        self.found = False  # whether there is a row to show: a setting with its error and its time

    @property
    def timing(self) -> float:
        """Seconds that are kept for timing here what was run elsewhere."""
        return ELSEWHERE * self.clock.seconds if self.clock.limited else 0.0

    def frames(self, asked: int, seconds_a_frame: float) -> int:
        """The frames to compare, out of those asked for; seconds: of the coarsest fine run's."""
        if not self.clock.limited:
            return asked
        fitting = self.patience(math.inf) / (COARSE_RUNS * max(seconds_a_frame, 1e-9))
        return min(asked, max(FEWEST_FRAMES, int(fitting)))

    def patience(self, most: float) -> float:
        """Seconds that references may take from now on, of `most` where time is no matter."""
        if not self.clock.limited:
            return most
        return min(most, REFERENCES * self.clock.seconds, max(HALF * self.clock.left(), 0.0))

    def over(self, referenced: bool) -> bool:
        """True if the study is to end, which is later while there is nothing to show.

        referenced: whether there is what to compare to.
        """
        late = 0.0 if referenced and self.found else -PAST * self.clock.seconds
        return self.clock.limited and self.clock.left() < late

    def compiled(self, method: str, seconds: float) -> None:
        """Take note of how long a method took to compile."""
        with self._lock:
            kind = kind_of(method)
            self._compiled[kind] = max(seconds, self._compiled.get(kind, 0.0))

    def to_compile(self, method: str) -> float:
        """Seconds that a method is expected to take to compile."""
        kind = kind_of(method)
        with self._lock:
            known = self._compiled.get(kind)
            guessed = [of * SLOWER[kind] / SLOWER[k] for k, of in self._compiled.items()]
        return known if known is not None else max(guessed, default=0.0)

    def fits(self, method: str, made: bool = False) -> bool:
        """True if a method may be compiled in time. made: whether it is compiled already.

        One that is not done in time has cost nothing but the time that nothing else would have
        used: unless what is finished waits for its timing until then, and is not timed at all.
        """
        if made or not self.clock.limited:
            return not self.over(True)
        hope = HOPE if self.found else 1.0
        return hope * self.to_compile(method) < self.clock.left()

    def is_too_long(self, run: float) -> bool:
        """True if a run of so many seconds ends after the time does; note it, if so."""
        with self._lock:
            late = self.clock.limited and run > self.clock.left()
            if late:
                self.longest = min(run, self.longest or run)
        return late

    def share(self, methods: int) -> float:
        """Seconds that the first of so many methods of a process may take."""
        return GREED * self.clock.left() / methods if methods > 1 else self.clock.left()


class Share:
    """A method's share of the time: what its settings took, and whether a further one fits.

    budget: seconds of timing for each.
    """

    def __init__(self, seconds: float, budget: float):
        self._left, self._budget = seconds, budget
        self._done: list[Outcome] = []

    def fits(self, setting: Setting) -> bool:
        """True if a setting fits, by those that ran; the first one always does."""
        return not self._done or self._cost(*self.expected(setting)) <= self._left

    def took(self, outcome: Outcome) -> None:
        """Take note of a setting that ran."""
        self._done.append(outcome)
        self._left -= self._cost(outcome.sampled_in - outcome.read_in, outcome.read_in)

    def _cost(self, run: float, read: float) -> float:
        """Of a run, of reading its states and of its timing, which takes no less than a run."""
        return run + read + max(self._budget, run)

    def expected(self, setting: Setting) -> tuple[float, float]:
        """Seconds of a run, from those that are most like it, at so many substeps and sweeps; and
        of reading its states, which takes the same whatever runs.
        """
        same = [of for of in self._done if of.setting.series == setting.series]
        runs = [(of.sampled_in - of.read_in) / of.setting.substeps for of in same or self._done]
        seconds, read = min(runs), min(of.read_in for of in self._done)
        last = (same or self._done)[-1].setting
        sweeps = (setting.iterations or 1) / (last.iterations or 1)
        harder = setting.tolerance is not None and last.tolerance is None
        return setting.substeps * seconds * max(sweeps, CONVERGED if harder else 1.0), read


def left_out(clock: Clock, chosen: Sequence[Setting], outcomes: Sequence[Outcome]) -> list[str]:
    """The settings left out, a line for each method in each precision."""
    if not clock.limited:
        return []
    done = {outcome.setting for outcome in outcomes}
    groups: dict[tuple[Any, ...], list[Setting]] = {}
    for setting in chosen:
        groups.setdefault((setting.method, *setting.process), []).append(setting)
    said = []
    for (method, arch, precision, _), of in groups.items():
        lacking = [setting for setting in of if setting not in done]
        if not lacking:
            continue
        name = f"{method}, {arch} {precision}"
        if len(lacking) == len(of):
            said.append(f"{name}: all of it")
            continue
        steps = []
        for setting in lacking:
            solver = setting.describe_solver()
            steps.append(f"{setting.substeps}{f' with {solver}' if solver else ''}")
        said.append(f"{name}: substeps {', '.join(steps)}")
    return said
