"""The method as a budget's first setting: another explicit one, where it is clearly better.

The error meter makes the seconds that it measures again by the other explicit methods, at steps of
equal cost, or cheaper ones with which the error that is held is still met, and judges each by the
same reference. What is chosen is better by a clear factor in the last seconds; after each change
more seconds have to say so, so that a run does not go to and fro. Implicit methods are not tried:
what their steps cost depends on the state, and they take seconds to compile.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from taichi_cloth.budgets.choice import RUNGS, Limits
from taichi_cloth.budgets.seconds import HELPLESS, MARGIN, Second, SecondErrors
from taichi_cloth.error_meter.others import Trial
from taichi_cloth.kernels import methods

CLEAR = 2.0  # times: by how much another method is better, to be chosen
ENOUGH = 5  # seconds that have to say so: at first; twice as many after each change, and at most
LATELY = 20  # as many as are looked at
SURELY = 0.75  # of these: in so many errors are smaller by that factor
OFTEN, SELDOM = 8, 4  # seconds in each of which others are tried; after them, in each fourth


def explicit() -> list[str]:
    """The methods that are chosen from: explicit ones that are stable without drag, too."""
    claims = {name: methods.load(name).claims for name in methods.METHODS}
    return [
        name
        for name, of in claims.items()
        if not of.implicit and not of.settings and of.stability_limit > 0
    ]


@dataclass(frozen=True)
class Rival:
    """Another method. cost: of its step, in steps of the present one; least: stable substeps."""

    name: str
    cost: float
    least: int


@dataclass(frozen=True)
class Found:
    """A method to go on with. why: in words. errors: of the last seconds, as they would have been.

    substeps: that it begins with: as many as take the frame's time, or at least half of it where an
    error is held, as coarser steps come one after the other, each after seconds that were measured.
    """

    method: str
    substeps: int
    why: str
    errors: SecondErrors


class Rivals:
    """What other methods would have done in the last seconds of a present one.

    present: its name. goal: the error that is held; None: a frame's time is. changes: that there
    were before, each of which makes the next one wait for longer.
    """

    def __init__(self, present: str, goal: float | None, changes: int = 0) -> None:
        self.present, self._goal = present, goal
        self.changes = changes
        self._errors: dict[str, SecondErrors] = {}
        # Of the smallest error in the same time, and of the substeps that have it, to the present.
        self._ratios: dict[str, deque[tuple[float, float]]] = {}
        self._refused: set[str] = set()
        self._ended = 0  # windows

    def trials(self, now: int, rivals: Sequence[Rival]) -> list[Trial]:
        """What the window that ends, which had `now` substeps, is to be made again with."""
        self._ended += 1
        if self._ended > OFTEN and self._ended % SELDOM:
            return []
        found = []
        for rival in rivals:
            most = int(now / rival.cost * (1 + 1e-9))
            gain = 1.0 if self._goal is None else CLEAR  # cheaper than that it has to be possible
            if rival.name not in self._refused and most >= gain * rival.least:
                within = None if self._goal is None else MARGIN * self._goal
                found.append(Trial(rival.name, most, rival.least, within))
        return found

    def note(
        self, second: Second, others: Mapping[str, Sequence[tuple[int, float]]], torn: bool
    ) -> None:
        """A second was measured, and made again: of each try (substeps, error)."""
        if second.trouble:
            return
        for name, tries in others.items():
            if tries:
                self._note(name, second, [_as_second(second, *one) for one in tries], torn)

    def _note(self, name: str, second: Second, tries: list[Second], torn: bool) -> None:
        if name not in self._errors:
            claimed = methods.load(name).claims.order
            self._errors[name] = SecondErrors(self._goal or 1.0, claimed)
            self._ratios[name] = deque(maxlen=LATELY)
        best = min(tries, key=lambda one: one.error)
        if second.error > 0:
            ratios = best.error / second.error, best.substeps / second.substeps
            self._ratios[name].append(ratios)
        met = [one for one in tries if self._goal and one.error <= MARGIN * self._goal]
        self._errors[name].note(met[-1] if met else best, torn)

    def refuse(self, name: str) -> None:
        """A method could not be taken: it is tried no more."""
        self._refused.add(name)

    @property
    def _seconds(self) -> int:
        """How many have to say that another method is better."""
        return min(ENOUGH << self.changes, LATELY)

    def better(
        self, own: SecondErrors, now: int, limits: Limits, rivals: Sequence[Rival]
    ) -> Found | None:
        """The best other method, if it is clearly better than the present one.

        own: the errors of the present one, which has `now` substeps. limits: of that.
        """
        found = []
        for rival in rivals:
            errors = self._errors.get(rival.name)
            if errors is None or rival.name in self._refused:
                continue
            if len(errors.sure) >= self._seconds:
                by = self._by_error if self._goal is not None else self._by_time
                found.append(by(rival, errors, own, now, limits))
        gain, best = max(filter(None, found), key=lambda one: one[0], default=(0.0, None))
        return best if gain >= CLEAR else None

    def _by_error(
        self, rival: Rival, errors: SecondErrors, own: SecondErrors, now: int, limits: Limits
    ) -> tuple[float, Found] | None:
        """How many times as cheap a method meets the error, and with how many substeps."""
        needed, theirs = own.needed, errors.needed
        if needed is None or theirs is None:
            return None
        there = replace(limits, least=rival.least).at_least(theirs)
        if there is None:
            return None
        here = limits.at_least(needed) or round(needed)
        first = max(there, limits.at_least(now / CLEAR / rival.cost) or there)  # not all at once
        why = f"{self.present} would take {here}"
        return here / (rival.cost * there), Found(rival.name, first, why, errors)

    def _by_time(
        self, rival: Rival, errors: SecondErrors, own: SecondErrors, now: int, limits: Limits
    ) -> tuple[float, Found] | None:
        """By how much errors are smaller in the same time, and with how many substeps."""
        if not self._ratios[rival.name]:
            return None
        ratios, parts = np.array(self._ratios[rival.name]).T
        rungs = [n for n in RUNGS if n <= now * np.median(parts) * (1 + 1e-9)]
        there = max(rival.least, min(rungs[-1] if rungs else 1, limits.most))
        usual, mostly = (max(float(np.quantile(ratios, part)), 1e-9) for part in (0.5, SURELY))
        why = f"in the same time {self.present} errs {1 / usual:.2g} times as much"
        return 1 / mostly, Found(rival.name, there, why, errors)

    def said(self, rivals: Sequence[Rival]) -> str:
        """What the others would have done, in words; "": none was tried."""
        words, seconds = [], 0
        for rival in rivals:
            errors, ratios = self._errors.get(rival.name), self._ratios.get(rival.name)
            if errors is None or not ratios:
                continue
            seconds = max(seconds, len(errors.sure))
            if self._goal is None:
                usual = float(np.median([ratio for ratio, _ in ratios]))
                words.append(f"{rival.name} errs {usual:.2g} times as much")
            elif (needed := errors.needed) is not None:
                there = Limits(least=rival.least).at_least(needed) or RUNGS[-1]
                words.append(f"{rival.name} would take {there}")
        if not words:
            return ""
        said = f"{'in the same time ' if self._goal is None else ''}{', '.join(words)}"
        if seconds < self._seconds:
            return f"in {seconds} of {self._seconds} seconds to compare, {said}"
        return f"no other method is clearly better: {said}"


def _as_second(second: Second, substeps: int, error: float) -> Second:
    """A second as another method would have made it, where it has `error` in f64.

    Rounding grows with the number of steps. The order is the method's own matter, but where finer
    steps were no help in that second, they are none for any.
    """
    rounding = second.rounding * substeps / second.substeps
    helpless = second.order is not None and second.order < HELPLESS
    order = second.order if helpless else None
    return Second(substeps, error + rounding, rounding, order)
