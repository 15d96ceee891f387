"""The error meter of ``taichi-cloth run``: what it says while the run goes on, and at its end."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.settings.options import RunOptions
from taichi_cloth.simulation import history
from taichi_cloth.ui import timeline
from taichi_cloth.ui.chrome.errors import ErrorReading, GhostReading

if TYPE_CHECKING:
    from taichi_cloth.error_meter.ghost import Ghost
    from taichi_cloth.error_meter.meter import ErrorMeter
    from taichi_cloth.error_meter.others import Trial
    from taichi_cloth.error_meter.verdict import Verdict
    from taichi_cloth.simulation.simulation import Simulation

SECOND = 60.0  # frames
NO_GHOST, MAGNIFIED, TRUE = range(3)  # how the reference is drawn
# Of what the particles span: how far a magnified ghost is away at most, and what nobody sees.
APART, UNSEEN = 0.06, 0.002
# What is smaller than the last one shows is nothing that one should look at.
TIMES = [n * 10.0**power for power in range(3) for n in (1, 2, 5)] + [1e3]
OLDEST = 3.0  # seconds after the end of a reference, in which it says something of what is seen
GRAPH = history.SECONDS * SECOND  # frames that it shows


class MeasuredErrors:
    """The error meter of a run, off at first: for the command line, and for a window's meters.

    waits: whether the run waits for each second's error. told: whether each is printed.
    waited: for how many seconds the run waited, until it was switched off.
    """

    def __init__(self, sim: Simulation, *, waits: bool, told: bool) -> None:
        self._sim, self._waits, self._told = sim, waits, told
        self._meter: ErrorMeter | None = None
        self._trials: Callable[[], Sequence[Trial]] | None = None
        self.waited = 0.0
        self._ghost = NO_GHOST
        self._in_metres = bool(sim.scene.world.up)

    def next_ghost(self) -> str:
        """Show the reference as a ghost, magnified, then in its true size, then no more; what to
        tell the user. It switches the meter on.
        """
        if not self.on:
            self.switch()
        found = self._meter.ghost if self._meter else None
        plain = found is not None and magnification(found) == 1.0
        if self._ghost == MAGNIFIED and not plain:
            self._ghost = TRUE
            return "ghost: in its true size; y: off"
        self._ghost = MAGNIFIED if self._ghost == NO_GHOST else NO_GHOST
        if self._ghost == NO_GHOST:
            return "ghost: off"
        return "ghost: where the last second ends with finer steps"

    def ghost(self) -> GhostReading | None:
        """The ghost of the present frame; None: it is not asked for."""
        meter = self._meter
        if meter is None or self._ghost == NO_GHOST:
            return None
        if meter.refused:
            return GhostReading(f"no ghost: {meter.refused}")
        found, now = meter.ghost, self._sim.frame
        if found is None:
            return GhostReading(f"ghost: waits for a measured second ({meter.progress()})")
        away, old = found.at(now), (now - found.end) / SECOND
        if away is None or old > OLDEST:
            ago = f", {old:.0f} s ago" if old > OLDEST else ""
            ago += ": go back there (,)" if OLDEST < old < timeline.SECONDS else ""
            return GhostReading(f"ghost: known of frames {found.start} to {found.end}{ago}")
        times = magnification(found) if self._ghost == MAGNIFIED else 1.0
        when = f"as {old:.1f} s ago" if old > 0 else "at this frame"
        size = f"difference x{times:g}" if times > 1 else "true size"
        small = ", too small to see" if times * found.largest < UNSEEN * found.extent else ""
        words = f"ghost: the reference {when}, {size}{small}"
        return GhostReading(words, np.float32(times) * away, found.torn)

    @property
    def on(self) -> bool:
        """True if it measures."""
        return self._meter is not None

    @property
    def verdicts(self) -> Sequence[Verdict]:
        """Verdicts since it was switched on."""
        return self._meter.verdicts if self._meter else ()

    @property
    def refused(self) -> str:
        """The reason why nothing can be measured; "": it can."""
        return "the error meter is off" if self._meter is None else self._meter.refused

    def try_methods(self, trials: Callable[[], Sequence[Trial]] | None) -> None:
        """Make windows again as `trials` says at their ends, while it measures."""
        self._trials = trials
        if self._meter is not None:
            self._meter.trials = trials

    def rest(self, times: float) -> None:
        """Leave the processor to the run for so many times as long as each window took to judge."""
        if self._meter is not None:
            self._meter.rests = times

    def switch(self) -> None:
        """Begin to measure, or end."""
        from taichi_cloth.error_meter.meter import ErrorMeter

        if self._meter is None:
            told = self._tell if self._told else None
            self._meter = ErrorMeter(self._sim, waits=self._waits, tell=told)
            self._meter.trials = self._trials
        else:
            self.close()

    def close(self) -> None:
        """End, and say what all of it came to."""
        meter, self._meter = self._meter, None
        if meter is not None:
            meter.close()
            self.waited += meter.waited
            if self._told:
                print(meter.summary(), flush=True)

    def _tell(self, verdict: Verdict) -> None:
        until = verdict.first + verdict.frames
        print(f"frame {until}: {verdict.describe(self._in_metres)}", flush=True)

    def reading(self) -> ErrorReading:
        """Its words now."""
        meter = self._meter
        if meter is None or meter.refused:
            return ErrorReading("not measured", (meter.refused,) if meter else ())
        last = meter.last
        if last is None:
            return ErrorReading("measuring", (meter.progress(),))
        age = f"{meter.age / SECOND:.0f} s old"
        if not last.known:
            return ErrorReading("not known", (age, last.trouble), style.WARN)
        now = self._sim.frame
        shown = [verdict for verdict in meter.shown if verdict.known and now - verdict.end < GRAPH]
        ages, relative = _curve(shown, now)
        value, details = last.in_short(self._in_metres)
        state = style.WARN if last.trouble else style.INK
        return ErrorReading(value, (*details, age), state, ages, relative)


def _curve(verdicts: Sequence[Verdict], now: int) -> tuple[np.ndarray, np.ndarray]:
    """Ages and relative errors of seconds, as of `ErrorReading`: level over each, and nothing
    between them, after the last, and where nothing moved.

    now: the frame that is seen.
    """
    spans = np.array([(v.first, v.end - 1e-3, v.end - 5e-4) for v in verdicts])
    errors = [math.nan if v.resting else v.relative for v in verdicts]
    return (now - spans.ravel()) / SECOND, np.array([(e, e, math.nan) for e in errors]).ravel()


def of(sim: Simulation) -> MeasuredErrors:
    """The error meter of a window that a script opens, off at first."""
    return MeasuredErrors(sim, waits=False, told=False)


def magnification(ghost: Ghost) -> float:
    """1, 2, 5, 10, 20 ...: how many times as far away a ghost is best drawn."""
    times = APART * ghost.extent / ghost.largest if ghost.largest > 0 else 1.0
    return max((n for n in TIMES if n <= times), default=1.0)


@contextlib.contextmanager
def measured(sim: Simulation, options: RunOptions, *, waits: bool) -> Iterator[MeasuredErrors]:
    """The error meter of a run, which is on from the start if the options ask for it."""
    errors = MeasuredErrors(
        sim, waits=waits, told=(options.error_meter or options.ghost) and not options.quiet
    )
    if options.error_meter:
        errors.switch()
    if options.ghost:
        errors.next_ghost()
    try:
        yield errors
    finally:
        errors.close()
