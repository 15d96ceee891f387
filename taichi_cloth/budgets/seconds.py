"""The error of each second as a budget: the fewest substeps with which it is small enough.

Each second that was measured says how many substeps it would have taken, by e ~ h^p: p is the order
that was measured in that second where finer steps are asked for, and at least the method's claim
where coarser ones are, so that what is not known makes steps finer. What is chosen is enough for
the worst of the last seconds but one in fifty, with a margin: a second to come may be worse.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from taichi_cloth.budgets.choice import Choice, Limits, steps_in_words
from taichi_cloth.console import percent

LATELY = 60  # seconds that are looked at
MISSED = 0.02  # of these, which may ask for more than is chosen
MARGIN = 0.5  # of the error that is wanted: what is aimed at
FIRST = 8  # times the fewest: until a second was measured
UNSEEN = 2  # times as many while springs tear, until a second was measured in which they do
FARTHEST = 4.0  # times: by how much a single second may ask for more
LOWEST = 0.6  # order that is counted on at least
HELPLESS = 0.4  # order below which finer steps are no help
UNTOLD = 0.1  # of an error: what steps have made of it may be so much less than what is told
PATIENCE = 8  # seconds with as many substeps before there may be fewer, at least half
UNSURE = 3  # seconds in a row without a sure error: then there is none to keep to


@dataclass(frozen=True)
class Second:
    """What was measured of a second (or less).

    substeps: that it had. error: in parts of its motion; rounding: what rounding made of it, and
    solver what is left where equations are not solved to the end. order: that its own method has
    shown in it; None: unknown. trouble: why it is not sure; "": it is.
    """

    substeps: int
    error: float
    rounding: float = 0.0
    order: float | None = None
    trouble: str = ""
    solver: float = 0.0

    @property
    def steps(self) -> float:
        """The part of the error that finer steps make smaller."""
        return max(self.error - self.rounding - self.solver, 0.0)


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

    @property
    def sure(self) -> list[Second]:
        """Those whose errors are known."""
        return [second for second in self._lately if not second.trouble]

    def would_be(self, second: Second, substeps: float) -> float:
        """The error of a second with other substeps, on the safe side."""
        ratio = second.substeps / substeps
        by: float = ratio ** self._order(second, ratio > 1)
        solver = second.solver * max(by, 1.0)  # larger steps are harder to solve
        return float(second.steps * by + solver + second.rounding)

    def _order(self, second: Second, coarser: bool) -> float:
        measured = 1.0 if second.order is None else second.order
        if coarser:
            return max(measured, float(self.claimed))
        return min(max(measured, LOWEST), float(self.claimed))

    def needs(self, second: Second) -> float:
        """The substeps that a second would have taken, for what is aimed at."""
        aim = MARGIN * self.goal
        n, aim = second.substeps, aim - second.rounding - min(second.solver, aim / 2)
        if second.error <= 0 or aim <= 0:
            return n
        ratio = second.steps / aim
        untold = UNTOLD * second.error
        if second.steps < untold:  # all is rounding's or the solver's: at most coarser steps do
            ratio = min(untold / aim, 1.0)
        if ratio > 1 and second.order is not None and second.order < HELPLESS:
            return n
        more: float = ratio ** (1 / self._order(second, ratio < 1))
        return n * min(more, FARTHEST)

    @property
    def needed(self) -> float | None:
        """The substeps that are enough for the last seconds but few; None: none was measured."""
        sure = self.sure
        return self._worst(map(self.needs, sure)) if sure else None

    def best(self) -> float | None:
        """The substeps with which steps and rounding together are wrong by least; None: unknown.

        The error of steps falls by h^p; that of rounding grows with their number. So with too few
        steps a second is wrong by p times as many powers as with too many, and p seconds of p + 1
        have enough.
        """
        found = []
        for second in self.sure:
            if second.rounding > 0 and second.steps > 0:
                p = self._order(second, second.steps < second.rounding)
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
        needed = (self.needed or 1.0) * (UNSEEN if self._alarm else 1)
        wanted = limits.at_least(needed) or limits.rungs()[-1]
        floor = now
        last = self._lately[-1]
        if self._since >= PATIENCE and last.substeps == now and not last.trouble:
            floor = limits.at_least(now / 2) or now
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
            helpless = any(s.error > self.goal and self.needs(s) <= s.substeps for s in sure)
            way = "finer steps bring it no nearer: chance decides what touches or breaks"
            if not helpless and chosen < limits.rungs()[-1]:
                way = f"a second may ask for {FARTHEST:g} times as many at most"
            elif not helpless:
                way = limits.why_most
            return Choice(chosen, f"{why}, above {goal}: {way}", short, met=False)
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
