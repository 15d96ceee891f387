"""Which of a study's settings meet a target: found with as few judged seconds as will do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from taichi_cloth.console import duration
from taichi_cloth.errors import counted
from taichi_cloth.kernels import methods
from taichi_cloth.trade.rows import Row
from taichi_cloth.trade.seconds import Second

# Times as large as what is wanted: an error that is expected to be so is not judged.
HOPELESS = 3.0
SMALL = 0.1  # of what is wanted: an error below which nobody asks how small it is


class TimeOver(Exception):
    """The time ended before all seconds of a setting were judged."""


@dataclass(frozen=True)
class Target:
    """The goal of a choice: an error of each second, a frame's time in seconds, or neither; a
    penetration, alone or besides.

    error: in world units, or in parts of the second's motion where `relative`. penetration: the
    deepest one that is allowed, in world units.
    """

    error: float | None = None
    relative: bool = True
    frame_seconds: float | None = None
    penetration: float | None = None

    @property
    def floor(self) -> float:
        """An error, in parts of a second's motion, below which nobody asks how small it is."""
        return SMALL * self.error if self.error is not None and self.relative else 0.0

    def describe(self) -> str:
        words = []
        if self.frame_seconds is not None:
            words.append(f"--frame-time {duration(self.frame_seconds)}")
        if self.error is not None:
            shown = f"{100 * self.error:g} %" if self.relative else f"{self.error:g}"
            words.append(f"--error {shown}")
        if self.penetration is not None:
            words.append(f"--penetration {self.penetration:g}")
        return " ".join(words)

    def remedy(self) -> str:
        """Advice where nothing holds."""
        if self.frame_seconds is not None:
            return "ask for a longer --frame-time, or measure while the machine does nothing else"
        larger = "--error" if self.error is not None else "--penetration"
        return f"compare more --substeps or other --methods, or ask for a larger {larger}"

    def met_by(self, found: Figures) -> bool:
        if self.frame_seconds is not None and found.frame_seconds > self.frame_seconds:
            return False
        if self.error is not None:
            error = found.error_relative if self.relative else found.error
            if error > self.error:
                return False
        return self.penetration is None or found.is_within(self.penetration)

    def refuses(self, second: Second) -> bool:
        """True if a second is known to be more wrong than is wanted."""
        error = second.relative if self.relative else second.error
        return self.error is not None and error is not None and error > self.error


@dataclass(frozen=True)
class Figures:
    """The showing of a setting: the error of its worst second (world units, and in parts of its
    motion); a frame's time in seconds; its deepest penetration (world units), None where nothing
    can touch; of how many seconds the error is known, and of how many it is not.
    """

    error: float
    error_relative: float
    frame_seconds: float
    penetration: float | None = None
    seconds_known: int = 1
    seconds_unknown: int = 0

    @classmethod
    def of(cls, row: Row) -> Figures:
        """The figures of a row that was timed and has an error."""
        error, relative = row.told()
        frame_seconds = row.a_frame(row.wall_seconds)
        assert error is not None and relative is not None and frame_seconds is not None
        known = row.seconds_known or 1
        unknown = max(row.seconds - known, 0)
        return cls(error, relative, frame_seconds, row.penetration_max, known, unknown)

    def is_within(self, penetration: float) -> bool:
        """True if its deepest penetration is at most this."""
        return self.penetration is not None and self.penetration <= penetration

    def describe(self) -> str:
        seconds = counted(self.seconds_known, "second")
        if self.seconds_unknown:
            seconds += f" ({self.seconds_unknown} more cannot be known)"
        deep = "" if self.penetration is None else f", penetration {self.penetration:.3g}"
        return (
            f"error {100 * self.error_relative:.3g} % ({self.error:.3g}) in the worst of "
            f"{seconds}, {duration(self.frame_seconds)} a frame{deep}"
        )


class Choice:
    """The rows that meet a target: the cheapest first, or of those that fit a time the best first.

    A row fits a time by the upper quartile of its own. made: of a study, not judged yet. judge: a
    row with its seconds judged, as many as are said (None: all), up to the first that the target
    refuses where that is said; it raises TimeOver.
    usable: rows that were timed; judged: of how many of them it is known; late: whether the time
    ended before all were that might be better.
    """

    def __init__(
        self,
        made: Sequence[Row],
        target: Target,
        judge: Callable[[Row, int | None, bool], Row] = lambda row, count, fails: row,
    ):
        self._made, self._target, self._judge = made, target, judge
        self.usable = [row for row in made if row.ok and row.wall_seconds is not None]
        self._seen: list[Row] = []
        self.late = False

    @property
    def judged(self) -> int:
        return len(self._seen)

    @property
    def left(self) -> int:
        """The number of rows that nobody has looked at."""
        return len(self.usable) - len(self._seen)

    def candidates(self) -> Iterator[Row]:
        """The rows that meet the target, each judged when it is asked for."""
        if self._target.frame_seconds is not None:
            yield from self._fitting(self._target.frame_seconds)
            return
        for row in sorted(self.usable, key=_time_then_error):
            judged = row
            if self._is_within(row) and not self._is_hopeless(row):
                try:
                    judged = self._judge(row, None, True)
                except TimeOver:
                    self.late = True
                    return
            self._seen.append(judged)
            if is_measured(judged) and self._target.met_by(Figures.of(judged)):
                yield judged

    def _is_within(self, row: Row) -> bool:
        """True if a row keeps to the penetration that is allowed."""
        deepest = self._target.penetration
        return deepest is None or (row.penetration_max or 0.0) <= deepest

    def _is_hopeless(self, row: Row) -> bool:
        """True if a row is expected to miss the target by far, by those that were judged.

        With more substeps an error falls by the method's order at most; in f32 it is no smaller
        than in f64.
        """
        wanted, mine = self._target.error, row.setting
        if wanted is None:
            return False
        for seen in self._seen:
            of, error = seen.setting, seen.told()[0 if not self._target.relative else 1]
            same = (of.method, of.iterations, of.tolerance, of.dt)
            alike = same == (mine.method, mine.iterations, mine.tolerance, mine.dt)
            exact = of.precision in (mine.precision, "f64")
            if not (seen.judged and error and alike and exact and mine.substeps >= of.substeps):
                continue
            order = methods.load(mine.method).claims.order
            if error * (of.substeps / mine.substeps) ** order > HOPELESS * wanted:
                return True
        return False

    def _fitting(self, seconds: float) -> Iterator[Row]:
        """Those that fit a time: all by their first second, then the best by all of theirs."""
        fitting: list[Row] = []
        for row in self.usable:
            fits = _slow_frame(row) <= seconds and self._is_within(row)
            (fitting if fits else self._seen).append(row)
        whole: list[Row] = []
        try:
            first = [self._judge(row, 1, False) for row in fitting]
            left = [row for row in first if is_measured(row)]
            self._seen += [row for row in first if not is_measured(row)]
            while left or whole:
                best = min(left + whole, key=_error_then_time)
                if best in left:
                    left.remove(best)
                    self._seen.append(self._judge(best, None, False))
                    whole.append(self._seen[-1])
                    continue
                whole.remove(best)
                if self._target.met_by(Figures.of(best)):
                    yield best
        except TimeOver:
            self.late = True
            met = (row for row in whole if self._target.met_by(Figures.of(row)))
            yield from sorted(met, key=_error_then_time)

    def refusal(self) -> str:
        """Why there is no candidate, with the best there is."""
        asked, judged = self._target.describe(), [row for row in self._seen if is_measured(row)]
        if not judged:
            failed = (row for row in self._made if not row.ok)
            why = next((f"{r.setting.describe()}: {r.status}" for r in failed), "")
            unknown = (
                second for row in self._seen for second in row.judged or () if second.trouble
            )
            why = why or next((second.trouble for second in unknown), "")
            first = f"; the first: {why}" if why else ""
            return f"{asked}: no setting could be measured{first}"
        best = _best(judged, self._target)
        return (
            f"{asked}: none of {len(judged)} settings meets it; the best is "
            f"{best.setting.describe()}: {Figures.of(best).describe()}"
        )


def is_measured(row: Row) -> bool:
    """True if it has figures."""
    return row.ok and row.told()[0] is not None and row.wall_seconds is not None


def _best(usable: Sequence[Row], target: Target) -> Row:
    """The row that comes nearest to a target that none meets."""
    within = usable
    if target.penetration is not None:
        least = min(Figures.of(row).penetration or 0.0 for row in usable)
        most = max(least, target.penetration)
        within = [row for row in usable if Figures.of(row).is_within(most)]
    return min(within, key=_slow_frame if target.frame_seconds is not None else _error_then_time)


def _slow_frame(row: Row) -> float:
    """The upper quartile of a frame's seconds."""
    seconds = row.a_frame(row.wall_upper)
    return np.inf if seconds is None else seconds


def _error_then_time(row: Row) -> tuple[float, float]:
    """Errors that a reference cannot tell from none are alike."""
    found = Figures.of(row)
    return 0.0 if row.untold else found.error_relative, found.frame_seconds


def _time_then_error(row: Row) -> tuple[float, float]:
    """The error as it came out, also where the reference cannot tell it from none."""
    return row.a_frame(row.wall_seconds) or 0.0, row.error_trajectory or 0.0
