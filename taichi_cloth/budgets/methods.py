"""The method as a budget's first setting: another explicit one, where it is clearly better.

The error meter makes the seconds that it measures again by the other explicit methods, at steps of
equal cost, and judges each by the same reference. Under an error each goes on with finer steps
until one has met it, and with coarser ones while it does. What is chosen is better by a clear
factor in the last seconds, or in the last one where the present method has missed the error. After
each change more seconds have to say so, so that a run does not go to and fro. Implicit methods are
not tried: what their steps cost depends on the state, and they take seconds to compile.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from taichi_cloth.budgets.choice import RUNGS, Limits
from taichi_cloth.budgets.seconds import (
    FARTHEST,
    MARGIN,
    RECENT,
    TRIED,
    Second,
    SecondErrors,
)
from taichi_cloth.error_meter.others import Trial
from taichi_cloth.kernels import methods

CLEAR = 2.0  # times: by how much another method errs less in the same time, to be chosen
CHEAPER = 1.25  # times: by how much it is cheaper where an error is held: a rung
ENOUGH = 5  # seconds that have to say so: at first; twice as many after each change, and at most
LATELY = 20  # as many as are looked at
SURELY = 0.75  # of these: in so many errors are smaller by that factor
# Seconds in each of which others are tried, and far finer steps where an error is held; after
# them in each fourth.
OFTEN, SELDOM = 8, 4


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
    """Another method. cost: of its step, in steps of the present one; least: stable substeps.

    most: substeps that frames have time for, and that the precision follows.
    """

    name: str
    cost: float
    least: int
    most: int = RUNGS[-1]

    @property
    def limits(self) -> Limits:
        """Between which substeps it may be."""
        return Limits(self.least, max(self.most, self.least))


@dataclass(frozen=True)
class Found:
    """A method to go on with. why: in words. errors: of the last seconds, as they would have been.

    substeps: that it begins with: as many as take the frame's time, or meet the error.
    """

    method: str
    substeps: int
    why: str
    errors: SecondErrors


class Rivals:
    """Other methods in the last seconds of a present one.

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

    def trials(
        self, now: int, limits: Limits, rivals: Sequence[Rival], *, missed: bool = False
    ) -> list[Trial]:
        """The setting with which the window that ends, of `now` substeps, is made again.

        limits: of the present method, which is tried, too: where an error is held with finer and
        coarser steps; else with half as long ones, for the order that it shows. missed: whether the
        window before missed the error.
        """
        self._ended += 1
        seldom = self._ended > OFTEN and self._ended % SELDOM and not missed
        if self._goal is None:
            found = [Trial(self.present, 2 * now, now, within=math.inf)]
            for rival in () if seldom else rivals:
                if (equal := now / rival.cost * (1 + 1e-9)) >= rival.least:
                    found.append(Trial(rival.name, equal, rival.least))
        else:
            within, times = MARGIN * self._goal, FARTHEST if seldom else TRIED
            finest = min(int(times * now), limits.most)
            found = [Trial(self.present, now, limits.least, finest, within)]
            for rival in rivals:
                equal = now / rival.cost
                most = min(int(times * equal), rival.most)
                found.append(Trial(rival.name, equal, rival.least, most, within))
        return [trial for trial in found if trial.method not in self._refused]

    def note(
        self, second: Second, others: Mapping[str, Sequence[tuple[int, float]]], torn: bool
    ) -> None:
        """A second was measured, and made again: of each try (substeps, error)."""
        if second.trouble:
            return
        for name, tries in others.items():
            if tries and name != self.present:
                self._note(name, second, tries, torn)

    def _note(
        self, name: str, second: Second, tries: Sequence[tuple[int, float]], torn: bool
    ) -> None:
        if name not in self._errors:
            claimed = methods.load(name).claims.order
            self._errors[name] = SecondErrors(self._goal or 1.0, claimed)
            self._ratios[name] = deque(maxlen=LATELY)
        found = [_as_second(second, *one) for one in tries]
        best = min(found, key=lambda one: one.error)
        if second.error > 0:
            ratios = best.error / second.error, best.substeps / second.substeps
            self._ratios[name].append(ratios)
        if self._goal is not None:
            met = [one for one in found if one.error <= MARGIN * self._goal]
            best = min(met, key=lambda one: one.substeps, default=best)
            best = replace(best, tries=tries)
        self._errors[name].note(best, torn)

    def refuse(self, name: str) -> None:
        """A method could not be taken: it is tried no more."""
        self._refused.add(name)

    def _seconds(self, pressed: bool = False) -> int:
        """The number that must say that another method is better.

        pressed: whether the present one misses the error, or is to take far more substeps.
        """
        most = LATELY if self._goal is None else RECENT
        return min((1 if pressed else ENOUGH) << self.changes, most)

    def _seen(self, name: str) -> int:
        """The seconds of a method that say something."""
        return len(self._ratios[name]) if self._goal is None else len(self._errors[name].sure)

    def better(
        self, own: SecondErrors, now: int, limits: Limits, rivals: Sequence[Rival]
    ) -> Found | None:
        """The best other method, if it is clearly better than the present one.

        own: the errors of the present one, which has `now` substeps. limits: of that.
        """
        found = []
        needed = own.needed or 0.0
        harder = own.missed or own.restless or needed > FARTHEST * now
        pressed = self._goal is not None and harder
        for rival in rivals:
            errors = self._errors.get(rival.name)
            if errors is None or rival.name in self._refused:
                continue
            if self._seen(rival.name) >= self._seconds(pressed):
                by = self._by_error if self._goal is not None else self._by_time
                found.append(by(rival, errors, own, now, limits))
        gain, best = max(filter(None, found), key=lambda one: one[0], default=(0.0, None))
        return best if gain >= (CLEAR if self._goal is None else CHEAPER) else None

    def _by_error(
        self, rival: Rival, errors: SecondErrors, own: SecondErrors, now: int, limits: Limits
    ) -> tuple[float, Found] | None:
        """The factor by which a method is cheaper at the error, and with how many substeps."""
        needed, worth = own.needed, errors.worth(math.inf)
        if needed is None or worth is None or not all(map(errors.met, errors.sure)):
            return None
        # Where worse seconds are to come, a higher order is worth more than substeps can say.
        there = rival.limits.at_least(max(errors.wanted(rival.limits), worth))
        if there is None:
            return None
        tried = max((s.finest[0] for s in own.sure if not own.met(s)), default=0)
        # With twice as many as were tried in vain it might do, and no sooner.
        here = max(limits.at_least(needed) or needed, 2 * tried)
        why = f"{self.present} would take " + (f"more than {tried}" if tried else f"{here:.0f}")
        gain = max(here, own.worth(math.inf) or 1.0) / (rival.cost * there)
        return gain, Found(rival.name, there, why, errors)

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
        """The others in words; "": none was tried."""
        words, seconds = [], 0
        for rival in rivals:
            errors, ratios = self._errors.get(rival.name), self._ratios.get(rival.name)
            if errors is None or not ratios:
                continue
            seconds = max(seconds, self._seen(rival.name))
            if self._goal is None:
                usual = float(np.median([ratio for ratio, _ in ratios]))
                words.append(f"{rival.name} errs {usual:.2g} times as much")
            elif (needed := errors.needed) is not None:
                there = rival.limits.at_least(needed) or RUNGS[-1]
                unmet = [second.finest[0] for second in errors.sure if not errors.met(second)]
                most = f"more than {max(unmet)}" if unmet else f"{there}"
                words.append(f"{rival.name} would take {most}")
        if not words:
            return ""
        said = f"{'in the same time ' if self._goal is None else ''}{', '.join(words)}"
        if seconds < self._seconds():
            return f"in {seconds} of {self._seconds()} seconds to compare, {said}"
        return f"no other method is clearly better: {said}"


def _as_second(second: Second, substeps: int, error: float) -> Second:
    """A second as another method would have made it, where it has `error` in f64.

    Rounding grows with the number of steps.
    """
    rounding = second.rounding * substeps / second.substeps
    return replace(second, substeps=substeps, error=error + rounding, rounding=rounding, solver=0.0)
