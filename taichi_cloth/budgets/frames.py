"""A frame's time as a budget: the most substeps with which frames are in time.

A frame's work is a + b substeps to simulate, and what does not depend on these: drawing, events. Of
each of the last frames it is told what it would have taken with other substeps, so what is chosen
is that with which as many as are wanted would have been in time. Frames that would have been late
with the fewest substeps, too, are a busy machine's, or drawing's: few of them count, as no choice
is better for them.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from taichi_cloth.budgets.choice import RUNGS, Choice, Limits, steps_in_words
from taichi_cloth.console import percent
from taichi_cloth.errors import milliseconds

LATELY = 120  # frames that are looked at
WARM = 3  # frames after a change, which compile or fill caches, and say nothing
FEW, ENOUGH = 20, 90  # frames with the present substeps before there may be fewer, or more
AT_FIRST = 40  # before there may be more for the first times
IN_TIME = 0.97  # of the frames, with what is chosen; and with what is kept:
KEPT = 0.955
DOWN, UP = 0.94, 0.92  # of the time: what is aimed at where there have to be fewer, or may be more
USUALLY = 0.85  # of the time: what half of the frames may take, where there may be more
SAME = 0.005  # of the frames: so many more that are late are no difference
NOT_OURS = 0.02  # of the frames: that are late with the fewest, too, and count
RELEASED = 600  # frames for which what was too much is not tried again; each time twice as many
MOST_RELEASED = 32 * RELEASED
FORGOTTEN = 1800  # frames after which a time with other substeps says nothing any more
STEEPEST = 2.0  # times: at most so many more substeps at once, while the law is a guess
FLATTEST = 0.2  # of what a step takes on average: the least that another one may
NEAR = 9  # frames, of which the median is what is usual now
MOST_OWN = 1.5  # times what is usual now: what is above held a frame up, whatever its substeps
TYPICAL = 25.0  # percentile of the times of a scene with some substeps: others are the machine's


@dataclass(frozen=True)
class Frame:
    """The time of a frame, seconds. rest: all but to simulate."""

    substeps: int
    simulate: float
    rest: float

    @property
    def whole(self) -> float:
        """All of it."""
        return self.simulate + self.rest


class FrameTimes:
    """Times of the last frames, and with other substeps.

    budget: seconds of a frame.
    """

    def __init__(self, budget: float) -> None:
        self.budget = budget
        self._frames: deque[Frame] = deque(maxlen=LATELY)
        self._levels: dict[int, tuple[float, int]] = {}  # typical seconds, and at which frame
        self._count = self._since = 0  # frames in all, and with the present substeps
        self._present = 0
        self._changes = 0
        self._too_many: dict[int, tuple[int, int]] = {}  # until which frame; for how many frames
        self._costs: tuple[float, np.ndarray, np.ndarray] | None = None  # of the last frames

    def note(self, frame: Frame) -> None:
        """A frame was made."""
        self._count, self._costs = self._count + 1, None
        if frame.substeps != self._present:
            self._present, self._since = frame.substeps, 0
            self._changes += 1
        self._since += 1
        if self._since <= WARM:
            return
        self._frames.append(frame)
        if self._since % 10 == 0 or self._since == FEW:
            lately = [f.simulate for f in self._frames if f.substeps == self._present]
            self._levels[self._present] = float(np.percentile(lately, TYPICAL)), self._count

    @property
    def slope(self) -> tuple[float, bool]:
        """b in parts of what the average step takes, and whether it was measured."""
        here = self._levels.get(self._present)
        others = [
            (n, seconds)
            for n, (seconds, when) in self._levels.items()
            if n != self._present and self._count - when < FORGOTTEN
        ]
        if here is None or here[0] <= 0 or not others:
            return 1.0, False
        n, seconds = min(others, key=lambda level: abs(np.log(level[0] / self._present)))
        b = (here[0] - seconds) / (self._present - n) / (here[0] / self._present)
        return float(np.clip(b, FLATTEST, 1.0)), True

    def would_take(self, substeps: int) -> np.ndarray:
        """Times of the last frames with other substeps, seconds (k,)."""
        offset, each, besides = self._costs = self._costs or self._of_frames()
        taken: np.ndarray = each * (offset + substeps) + besides
        return taken

    def _of_frames(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Of the last frames: a / b in substeps; b (k,); and what no substeps change (k,),
        seconds.
        """
        simulate = np.array([f.simulate for f in self._frames])
        rest = np.array([f.rest for f in self._frames])
        had = np.array([f.substeps for f in self._frames], float)
        slope, _ = self.slope
        offset = (1 / slope - 1) * self._present  # a / b, in substeps
        each = simulate / (offset + had)
        own = np.minimum(each, MOST_OWN * _local(each))
        return offset, own, (each - own) * (offset + had) + rest

    def most_within(self) -> int | None:
        """The most substeps that half of the frames have time for, drawn or not; None: unknown."""
        if len(self._frames) < FEW:
            return None
        rest = np.array([f.rest for f in self._frames])
        takes = (float(np.median(self.would_take(n) - rest)) for n in RUNGS)
        return max((n for n, t in zip(RUNGS, takes, strict=True) if t <= self.budget), default=1)

    def too_slow(self, substeps: int) -> bool:
        """True if frames with so many substeps are late because they take long to simulate."""
        if len(self._frames) < FEW or self.late(substeps) <= 1 - KEPT:
            return False
        usual = self._usual(substeps) > USUALLY * self.budget
        return usual and self.usual_rest < self.budget / 2

    @property
    def usual_rest(self) -> float:
        """The most that half of the last frames took besides to simulate, seconds."""
        return float(np.median([f.rest for f in self._frames]))

    def in_time(self, substeps: int, least: int, part: float = 1.0) -> float:
        """The part of the frames that would have taken at most so much of the time.

        Of those that the fewest substeps would not have had in time, only few count.
        """
        always = self.late(least)
        return 1.0 - max(self.late(substeps, part) - always, 0.0) - min(always, NOT_OURS)

    def late(self, substeps: int, part: float = 1.0) -> float:
        """The part of the frames that would have taken more than so much of the time."""
        return float((self.would_take(substeps) > part * self.budget).mean())

    def choose(self, now: int, limits: Limits) -> Choice:
        """The substeps of the next frame, where those of the last were `now`."""
        rungs, least = limits.rungs(), limits.least
        chosen = min(max(now, least), max(limits.most, least))
        if now == chosen and now == self._present and self._since >= FEW + WARM:
            if self.in_time(now, least) < KEPT:
                chosen = self._fewer(now, [n for n in rungs if n < now], least)
            elif self._since >= (AT_FIRST if self._changes <= 4 else ENOUGH) + WARM:
                chosen = self._more(now, [n for n in rungs if n > now], least)
        return self.said(chosen, limits)

    def _fewer(self, now: int, rungs: list[int], least: int) -> int:
        """As many of the rungs below as would do."""
        if not rungs:
            return now
        _, lasted = self._too_many.get(now, (0, RELEASED // 2))
        lasts = min(2 * lasted, MOST_RELEASED)
        self._too_many[now] = self._count + lasts, lasts
        found = [self.in_time(n, least, DOWN) for n in rungs]
        enough = min(IN_TIME, found[0] - SAME)  # what is late anyway asks for no fewer
        return max(n for n, part in zip(rungs, found, strict=True) if part >= enough)

    def _more(self, now: int, rungs: list[int], least: int) -> int:
        """As many of the rungs above as have room, of which none was too much a short while ago."""
        chosen, measured = now, self.slope[1]
        for n in rungs:
            far = not measured and n > STEEPEST * now
            usual = self._usual(n) <= USUALLY * self.budget
            fits = usual and self.in_time(n, least, UP) >= IN_TIME
            if self._barred(n) or far or not fits:
                break
            chosen = n
        return chosen

    def said(self, chosen: int, limits: Limits) -> Choice:
        """A choice of so many substeps, and what there is to say of it."""
        steps = steps_in_words(chosen)
        of = f"of {milliseconds(self.budget)} ms"
        if len(self._frames) < FEW:
            return Choice(chosen, f"{steps}: nothing measured yet", "measuring")
        usual, late = milliseconds(self._usual(chosen), 2), self.late(chosen)
        short, why = f"{usual} {of}", f"{steps}: {usual} ms {of}"
        if late > 1 - KEPT:
            short += f", {percent(late, 2)} late"
            why += f", {percent(late, 2)} late"
            if chosen > limits.least:
                fewest = percent(self.late(limits.least), 2)
                why += f", and {fewest} with the fewest, {limits.least}"
            else:
                why += f": {self._in_the_way(chosen)}"
            return Choice(chosen, why, short, met=False)
        finer = next((n for n in limits.rungs() if n > chosen), None)
        if finer is None:
            why += f"; no more: {limits.why_most}"
        else:
            why += f"; next finer, {finer}, would take {milliseconds(self._usual(finer), 2)}"
            late = self.late(finer, UP)
            if self._barred(finer):
                why += ", and was late a while ago"
            elif late > 1 - IN_TIME:
                why += f", {percent(late, 2)} nearly late or late"
        return Choice(chosen, why, short)

    def _in_the_way(self, least: int) -> str:
        """Why there are not fewer substeps, or what else takes the time."""
        if self._usual(least) <= USUALLY * self.budget:
            return "other programs hold these up"
        if self.usual_rest > self.budget / 2:
            return f"drawing takes {milliseconds(self.usual_rest, 2)}"
        return "fewer are not stable" if least > 1 else "there are no fewer"

    def _usual(self, substeps: int) -> float:
        """The most that half of the frames would take with so many substeps, seconds."""
        return float(np.median(self.would_take(substeps)))

    def _barred(self, n: int) -> bool:
        """True if so many substeps were too much a short while ago."""
        return any(n >= m and until > self._count for m, (until, _) in self._too_many.items())


def _local(values: np.ndarray) -> np.ndarray:
    """The median of each value (k,) and those just before it."""
    if len(values) == 0:
        return values
    padded = np.pad(values, (NEAR - 1, 0), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, NEAR)
    median: np.ndarray = np.median(windows, axis=1)
    return median
