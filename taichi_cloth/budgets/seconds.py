"""The error of each second as a budget: the fewest substeps with which it is small enough.

Each second is made again with other substeps, finer until the error is what is aimed at and coarser
while it is. So each says how many substeps it would have taken. Beyond what was tried the error
goes as h^p: with the order that was measured, and for finer steps at most the method's claim, for
coarser ones at least, so that what is not known makes steps finer. What is chosen is enough for the
worst of the last seconds, with a margin: a second to come may be worse.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from taichi_cloth.budgets.choice import Choice, Limits, steps_in_words
from taichi_cloth.console import percent

LATELY = 60  # seconds that are looked at, where somebody acted in them, who may do so again;
RECENT = 10  # of the others
MISSED = 0.02  # of these, which may ask for more than is chosen
MARGIN = 0.5  # of the error that is wanted: what is aimed at
FIRST = 8  # times the fewest: until a second was measured
UNSEEN = 2  # times as many while springs tear, until a second was measured in which they do
FARTHEST = 4.0  # times: by how much a single second may ask for more than was tried
TRIED = 64  # times the present substeps: up to which finer ones are tried
LOWEST = 0.6  # order that is counted on at least
UNTOLD = 0.1  # of an error: what steps have made of it may be so much less than what is told
HELPED = 0.5  # of an error: finer steps that leave more of it were no help
PATIENCE = 4  # seconds with as many substeps before there may be fewer
UNSURE = 3  # seconds in a row without a sure error: then there is none to keep to
# Where a disturbance grows by more than CALM times in a second, errors grow so, too, and seconds to
# come may be worse by about the rest.
CALM = 50.0
MOST_SPARED = 6.0  # times as many substeps, at most, as the seconds that were seen asked for


@dataclass(frozen=True)
class Second:
    """Measurements of a second (or less).

    substeps: that it had. error: in parts of its motion; rounding: what rounding made of it, and
    solver what is left where equations are not solved to the end. tries: (substeps, error) without
    rounding, of the same second made again. trouble: why it is not sure; "": it is. growth: how
    many times as large a small disturbance got. acted: whether somebody acted in it.
    """

    substeps: int
    error: float
    rounding: float = 0.0
    tries: Sequence[tuple[int, float]] = ()
    trouble: str = ""
    solver: float = 0.0
    growth: float = 1.0
    acted: bool = False

    @property
    def steps(self) -> float:
        """The part of the error that finer steps make smaller."""
        return max(self.error - self.rounding - self.solver, 0.0)

    @property
    def curve(self) -> list[tuple[int, float]]:
        """The effect of steps on the error with so many substeps, the fewest first."""
        points = {self.substeps: max(self.steps, UNTOLD * self.error)}
        for substeps, error in self.tries:
            points[substeps] = max(error - self.solver, UNTOLD * error)
        return sorted((n, e) for n, e in points.items() if e > 0)

    @property
    def finest(self) -> tuple[int, float]:
        """The most substeps that were tried, and the error."""
        return max([(self.substeps, self.error), *self.tries])

    @property
    def helpless(self) -> bool:
        """True if steps that are much finer were tried and were no help."""
        substeps, error = self.finest
        return substeps >= FARTHEST * self.substeps and error > HELPED * self.error


def _slope(points: Sequence[tuple[int, float]], at: int) -> float | None:
    """The order between a point and the next one of two at an end; None: there is one alone."""
    if len(points) < 2:
        return None
    (n, e), (m, f) = points[at : at + 2] if at == 0 else points[-2:]
    return float(math.log(e / f) / math.log(m / n))


class SecondErrors:
    """The errors of the last seconds, and what they would be with other substeps.

    goal: the error that each may have. claimed: the order of the method.
    """

    def __init__(self, goal: float, claimed: int) -> None:
        self.goal, self.claimed = goal, claimed
        self._lately: deque[Second] = deque(maxlen=LATELY)
        self._since = 0  # seconds with the present substeps
        self._alarm = self._torn = False

    def note(self, second: Second, torn: bool) -> None:
        """A second was measured; torn: whether springs broke in it."""
        before = self._lately[-1].substeps if self._lately else 0
        self._since = self._since + 1 if second.substeps == before else 1
        self._lately.append(second)
        if torn:
            self._torn, self._alarm = True, False

    def tear(self) -> None:
        """Springs break: which no second may have shown yet."""
        self._alarm = not self._torn

    def solve_otherwise(self) -> None:
        """From now on the solver leaves something else, which the next second shows."""
        others = [replace(s, error=s.error - s.solver, solver=0.0) for s in self._lately]
        self._lately = deque(others, maxlen=LATELY)
        self._since = 0

    def rest(self, substeps: int) -> None:
        """Nothing moved in a second: it takes no more than the fewest."""
        self.note(Second(substeps, 0.0), torn=False)

    @property
    def sure(self) -> list[Second]:
        """Those whose errors are known, and that may come again."""
        first = len(self._lately) - RECENT
        seen = enumerate(self._lately)
        return [second for k, second in seen if (k >= first or second.acted) and not second.trouble]

    @property
    def missed(self) -> bool:
        """True if the last second was wrong by more than the goal."""
        last = self._lately[-1] if self._lately else None
        return last is not None and not last.trouble and last.error > self.goal

    def would_be(self, second: Second, substeps: float) -> float:
        """The error of a second with other substeps, on the safe side."""
        by = max(second.substeps / substeps, 1.0)  # larger steps are harder to solve
        solver: float = second.solver * by ** float(self.claimed)
        return self._of_steps(second, substeps) + solver + second.rounding

    def _of_steps(self, second: Second, substeps: float) -> float:
        points = second.curve
        if not points:
            return 0.0
        if substeps <= points[0][0] or substeps >= points[-1][0]:
            n, error = points[0] if substeps <= points[0][0] else points[-1]
            by: float = (n / substeps) ** self._order(points, substeps < n)
            return error * by
        k = bisect_left(points, (substeps, 0.0))
        (n, e), (m, f) = points[k - 1 : k + 1]
        return float(e * (f / e) ** (math.log(substeps / n) / math.log(m / n)))

    def _order(self, points: Sequence[tuple[int, float]], coarser: bool) -> float:
        """The order that is counted on beyond what was tried."""
        measured = _slope(points, 0 if coarser else -1)
        measured = 1.0 if measured is None else measured
        if coarser:
            return max(measured, float(self.claimed))
        return min(max(measured, LOWEST), float(self.claimed))

    def needs(self, second: Second) -> float:
        """The substeps that a second would have taken, for what is aimed at."""
        aim = MARGIN * self.goal
        n, aim = second.substeps, aim - second.rounding - min(second.solver, aim / 2)
        if second.error <= 0:
            return 1.0
        if aim <= 0:
            return n
        points = second.curve
        untold = second.steps < UNTOLD * second.error
        if untold and points[-1][1] > aim:  # all is the solver's: finer steps are no help
            return n
        met: tuple[int, float] | None = None
        for there, error in reversed(points):
            if error > aim:
                if met is None:
                    return self._beyond(second, points, aim)
                part = math.log(error / aim) / math.log(error / met[1])
                return float(there * (met[0] / there) ** part)
            met = there, error
        there, error = points[0]
        return float(there * (error / aim) ** (1 / self._order(points, coarser=True)))

    def _beyond(self, second: Second, points: Sequence[tuple[int, float]], aim: float) -> float:
        """The substeps for an error that none of those that were tried has met."""
        if second.helpless:
            return second.substeps
        n, error = points[-1]
        more = (error / aim) ** (1 / self._order(points, coarser=False))
        return float(n * min(more, FARTHEST))

    def met(self, second: Second) -> bool:
        """True if some of the substeps that were tried had the error that is aimed at."""
        return second.curve[-1][1] <= MARGIN * self.goal if second.curve else True

    @property
    def _grew(self) -> list[float]:
        """By how much more than is calm a disturbance grew in each sure second, as a logarithm."""
        return [max(math.log(max(s.growth, 1.0) / CALM), 0.0) for s in self.sure]

    @property
    def restless(self) -> bool:
        """True if disturbances grow, so that seconds to come may be far worse."""
        return any(self._grew)

    def spare(self, most: float = MOST_SPARED) -> list[float]:
        """The factor of substeps that each sure second is worth, as others may be worse.

        most: how many at most.
        """
        return [min(math.exp(log / self.claimed), most) for log in self._grew]

    def worth(self, most: float = MOST_SPARED) -> float | None:
        """The substeps for the last seconds but few, and for worse ones, by at most so many times
        as many; None: none was measured.
        """
        found = zip(map(self.needs, self.sure), self.spare(most), strict=True)
        return self._worst(need * spare for need, spare in found) if self.sure else None

    @property
    def needed(self) -> float | None:
        """The substeps that are enough for the last seconds but few; None: none was measured."""
        return self.worth()

    def wanted(self, limits: Limits) -> float:
        """The substeps that are wanted now: enough for the last seconds but few, more while springs
        tear, and, where disturbances grow, as many as at first until more seconds were seen.
        """
        needed = (self.needed or 1.0) * (UNSEEN if self._alarm else 1)
        early = self.restless and len(self._lately) < RECENT
        return max(needed, FIRST * limits.least) if early else needed

    @property
    def _spared(self) -> float:
        """The factor of substeps that the worst second is worth."""
        found = zip(map(self.needs, self.sure), self.spare(), strict=True)
        return max(((need * spare, spare) for need, spare in found), default=(0.0, 1.0))[1]

    def best(self) -> float | None:
        """The substeps with which steps and rounding together are wrong by least; None: unknown.

        The error of steps falls by h^p; that of rounding grows with their number. So with too few
        steps a second is wrong by p times as many powers as with too many, and p seconds of p + 1
        have enough.
        """
        found = []
        for second in self.sure:
            if second.rounding > 0 and second.steps > 0:
                p = self._order(second.curve, second.steps < second.rounding)
                ratio = p * second.steps / second.rounding
                found.append(second.substeps * ratio ** (1 / (p + 1)))
        return float(np.quantile(found, self.claimed / (self.claimed + 1))) if found else None

    def choose(self, now: int, limits: Limits) -> Choice:
        """The substeps from now on, where there are `now` as many."""
        sure, goal = self.sure, f"{100 * self.goal:g} %"
        if not sure:
            if len(self._lately) >= UNSURE:
                return self._undefined(now, limits)
            first = limits.at_least(max(FIRST * limits.least, now if self._lately else 0))
            chosen = first or limits.rungs()[-1]
            return Choice(
                chosen, f"{steps_in_words(chosen)} until a second is measured", "measuring"
            )
        if len(self._lately) >= UNSURE and all(s.trouble for s in list(self._lately)[-UNSURE:]):
            return self._undefined(now, limits)
        wanted = limits.at_least(self.wanted(limits)) or limits.rungs()[-1]
        floor = now
        last = self._lately[-1]
        if self._since >= PATIENCE and last.substeps == now and not last.trouble:
            met = [n for n, error in last.tries if error <= MARGIN * self.goal]
            floor = limits.at_least(min([now / 2, *met])) or now
        chosen = max(wanted, min(floor, limits.rungs()[-1]), limits.least)
        return self._said(chosen, limits, goal)

    def _worst(self, values: Iterable[float]) -> float:
        """The largest but those few that may be missed."""
        found = sorted(values)
        return found[-1 - int(MISSED * len(found))]

    def _undefined(self, now: int, limits: Limits) -> Choice:
        chosen = limits.at_least(now) or limits.rungs()[-1]
        trouble = self._lately[-1].trouble
        why = f"{steps_in_words(chosen)}: no error to keep to: {trouble}"
        return Choice(chosen, why, "error not known", met=False)

    def _said(self, chosen: int, limits: Limits, goal: str) -> Choice:
        sure, steps = self.sure, steps_in_words(chosen)
        worst = self._worst(self.would_be(second, chosen) for second in sure)
        kept = len(sure) - int(MISSED * len(sure))
        seconds = "the second" if len(sure) == 1 else f"{len(sure)} seconds"
        of = seconds if kept == len(sure) else f"{kept} of {seconds}"
        why = f"{steps}: at most {percent(worst, 2)} in {of} measured"
        short = f"error {percent(worst, 2)}"  # the goal is written before it
        rounding = max(second.rounding for second in sure)
        if rounding > MARGIN * self.goal:
            why = f"{steps}: rounding alone makes {percent(rounding, 2)}; use --precision f64"
            return Choice(chosen, why, short, met=False)
        if worst > self.goal:
            way = f"a second may ask for {FARTHEST:g} times as many at most"
            if any(s.helpless and self.needs(s) > chosen * (1 - 1e-9) for s in sure):
                substeps, error = max((s for s in sure if s.helpless), key=lambda s: s.error).finest
                way = f"finer steps are no help: {substeps} still make {percent(error, 2)}"
            elif chosen >= limits.rungs()[-1]:
                way = limits.why_most
            return Choice(chosen, f"{why}, above {goal}: {way}", short, met=False)
        if self._spared > 1.1:
            why += f"; {self._spared:.2g} times as many as these took, as small disturbances grow"
        cheaper = [n for n in limits.rungs() if n < chosen]
        if self._alarm:
            why += f"; {UNSEEN} times as many while springs tear, which none of them shows"
        elif not cheaper:
            why += "; fewer are not stable" if limits.least > 1 else "; there are no fewer"
        else:
            other = self._worst(self.would_be(second, cheaper[-1]) for second in sure)
            beyond = other > MARGIN * self.goal
            aimed = (
                f", and {percent(MARGIN * self.goal, 2)} is aimed at" if beyond else ", tried next"
            )
            why += f"; next cheaper, {cheaper[-1]}, would make {percent(other, 2)}{aimed}"
        return Choice(chosen, why, short)
