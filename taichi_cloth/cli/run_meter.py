"""The error meter of ``taichi-cloth run``: what it says while the run goes on, and at its end."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.settings.options import RunOptions
from taichi_cloth.ui import style
from taichi_cloth.ui.chrome.errors import ErrorReading

if TYPE_CHECKING:
    from taichi_cloth.error_meter.meter import ErrorMeter
    from taichi_cloth.error_meter.verdict import Verdict
    from taichi_cloth.simulation.simulation import Simulation

SECOND = 60.0  # frames
MOST_SHOWN = 20  # seconds that were measured, in a graph of ten


class MeasuredErrors:
    """The error meter of a run, off at first: for the command line, and for a window's meters.

    waits: whether the run waits for each second's error. told: whether each is printed.
    waited: for how many seconds the run waited, until it was switched off.
    """

    def __init__(self, sim: Simulation, *, waits: bool, told: bool) -> None:
        self._sim, self._waits, self._told = sim, waits, told
        self._meter: ErrorMeter | None = None
        self.waited = 0.0
        self._in_metres = bool(sim.scene.world.up)

    @property
    def on(self) -> bool:
        """Whether it measures."""
        return self._meter is not None

    def switch(self) -> None:
        """Begin to measure, or end."""
        from taichi_cloth.error_meter.meter import ErrorMeter

        if self._meter is None:
            told = self._tell if self._told else None
            self._meter = ErrorMeter(self._sim, waits=self._waits, tell=told)
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
        """What there is to say now."""
        meter = self._meter
        if meter is None or meter.refused:
            return ErrorReading("not measured", (meter.refused,) if meter else ())
        last = meter.last
        if last is None:
            return ErrorReading("measuring", (meter.progress(),))
        age = f"{meter.age / SECOND:.0f} s old"
        if not last.known:
            return ErrorReading("not known", (age, last.trouble), style.WARN)
        shown = [verdict for verdict in meter.recent[-MOST_SHOWN:] if verdict.known]
        ends = np.array([verdict.first + verdict.frames for verdict in shown])
        begins = np.array([verdict.first for verdict in shown])
        now = self._sim.frame
        ages = np.column_stack([now - begins, now - ends - 1e-3]).ravel() / SECOND
        relative = np.repeat([math.nan if v.resting else v.relative for v in shown], 2)
        value, details = last.in_short(self._in_metres)
        state = style.WARN if last.trouble else style.INK
        return ErrorReading(value, (*details, age), state, ages, relative)


@contextlib.contextmanager
def measured(sim: Simulation, options: RunOptions, *, waits: bool) -> Iterator[MeasuredErrors]:
    """The error meter of a run, which is on from the start if the options ask for it."""
    errors = MeasuredErrors(sim, waits=waits, told=options.error_meter and not options.quiet)
    if options.error_meter:
        errors.switch()
    try:
        yield errors
    finally:
        errors.close()
