"""A post-mortem: the last frames, the cause, and a setting that survives, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.post_mortem.causes import Cause, cause_of
from taichi_cloth.post_mortem.survivors import Search, search
from taichi_cloth.post_mortem.trace import Trace, traced
from taichi_cloth.settings.options import PROGRAM
from taichi_cloth.simulation.past import Settings

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

SECONDS = 20.0  # that the trials may take; going back, as many


@dataclass(frozen=True)
class PostMortem:
    """What was found out. words: of the command line that makes the run, without the settings."""

    trace: Trace
    cause: Cause
    search: Search
    words: Sequence[str]

    @property
    def line(self) -> str:
        """The cause and what to do, in a line."""
        remedy = f"; {self.remedy}" if self.remedy else ""
        return f"{self.cause.says} ({self.cause.proof}){remedy}"

    @property
    def remedy(self) -> str:
        """The setting that survives, in flags; "": there is none, or none is needed."""
        best = self.search.best
        if best is None:
            return ""
        return f"{' '.join(flags(best.settings, self.trace.settings))} survives"

    @property
    def command(self) -> str:
        """The command line that survives; "": there is none."""
        best = self.search.best
        if best is None:
            return ""
        given = flags(best.settings, self.trace.settings, whole=True)
        return " ".join([PROGRAM, "run", *self.words, *given])


def flags(settings: Settings, before: Settings, *, whole: bool = False) -> list[str]:
    """A setting as flags; whole: also what is as it was before."""
    found: list[str] = []
    pairs = {
        "--method": (settings.method, before.method),
        "--dt": (f"{settings.dt:.6g}", f"{before.dt:.6g}"),
        "--substeps": (str(settings.substeps), str(before.substeps)),
    }
    for name, number in settings.solver.items():
        before_it = before.solver.get(name)
        pairs[f"--{name}"] = (f"{number:g}", "" if before_it is None else f"{before_it:g}")
    for name, (value, had) in pairs.items():
        if whole or value != had:
            found += [name, value]
    return found


def examine(
    sim: Simulation,
    *,
    words: Sequence[str] = (),
    draw: Callable[[], np.ndarray] | None = None,
    seconds: float = SECONDS,
    tell: Callable[[Settings], None] = lambda settings: None,
) -> PostMortem:
    """Find out why a run failed; or, of one that did not, how it stands.

    words: the scene as after `run`, for the command line. draw: makes a picture of the simulation
    as it is; None: there are none. seconds: that trials may take. tell: called before each trial.
    The simulation is as it was afterwards, to the bit.
    """
    trace = traced(sim, seconds, draw)
    cause = cause_of(trace)
    return PostMortem(
        trace, cause, search(sim, trace, cause, seconds, tell), words or [trace.scene]
    )
