"""The error meter of ``taichi-cloth run``: what it says while the run goes on, and at its end."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from taichi_cloth.settings.options import RunOptions

if TYPE_CHECKING:
    from taichi_cloth.error_meter.verdict import Verdict
    from taichi_cloth.simulation.simulation import Simulation


@contextlib.contextmanager
def measured(sim: Simulation, options: RunOptions, *, waits: bool) -> Iterator[Callable[[], float]]:
    """Measure the error of a run's seconds meanwhile, if the options ask for it.

    waits: whether the run waits for each second's error; for how many seconds it did is what the
    context's value returns.
    """
    if not options.error_meter:
        yield lambda: 0.0
        return
    from taichi_cloth.error_meter.meter import ErrorMeter

    in_metres = bool(sim.scene.world.up)

    def tell(verdict: Verdict) -> None:
        until = verdict.first + verdict.frames
        print(f"frame {until}: {verdict.describe(in_metres)}", flush=True)

    meter = ErrorMeter(sim, waits=waits, tell=None if options.quiet else tell)
    try:
        yield lambda: meter.waited
    finally:
        meter.close()
        if not options.quiet:
            print(meter.summary(), flush=True)
