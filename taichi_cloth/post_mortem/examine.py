"""A post-mortem: the last frames, the cause, and a setting that survives, one after the other."""

from __future__ import annotations

import shlex
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


@dataclass(frozen=True, repr=False)
class PostMortem:
    """The findings.

    words: of the command line that makes the run, but for its settings; none: Python made it.
    """

    trace: Trace
    cause: Cause
    search: Search
    words: Sequence[str]

    def __repr__(self) -> str:
        """Its line at a prompt or in a notebook's cell: its readings are 176 000 letters."""
        return f"<PostMortem: {self.line}>"

    @property
    def line(self) -> str:
        """The cause and what to do, in a line."""
        remedy = self.remedy if self.search.asked else self.search.says
        return f"{self.cause.says} ({self.cause.proof})" + f"; {remedy}" * bool(remedy)

    @property
    def remedy(self) -> str:
        """The setting that survives, in flags; "": there is none, or none is needed."""
        return f"{self.setting} survives" if self.setting else ""

    @property
    def setting(self) -> str:
        """The setting that survives, and what of what was done has to be left out with it."""
        best = self.search.best
        if best is None:
            return ""
        given = " ".join(flags(best.settings, self.trace.settings))
        acts = [f"{act.words} at frame {act.frame}" for act in self.search.without]
        more = f" and {len(acts) - 1} others" if len(acts) > 1 else ""
        return f"{given} without {acts[0]}{more}" if acts else given

    @property
    def command(self) -> str:
        """The command line that survives, or lines of Python; "": there is none."""
        best = self.search.best
        if best is None:
            return ""
        if not self.words:
            return _calls(best.settings, self.trace.settings)
        given = flags(best.settings, self.trace.settings, whole=True)
        return shlex.join([*PROGRAM.split(), "run", *self.words, *given])


def flags(settings: Settings, before: Settings, *, whole: bool = False) -> list[str]:
    """A setting as flags; whole: also what is as it was before."""
    found: list[str] = []
    pairs = {"--method": (settings.method, before.method)}
    if settings.follows:
        pairs["--dt"] = ("auto", "auto")
    else:
        dt = _exactly(settings.dt) if whole else f"{settings.dt:.6g}"
        pairs["--dt"] = (dt, f"{before.dt:.6g}")
        pairs["--substeps"] = (str(settings.substeps), str(before.substeps))
    for name, number in settings.solver.items():
        before_it = before.solver.get(name)
        pairs[f"--{name}"] = (f"{number:g}", "" if before_it is None else f"{before_it:g}")
    for name, (value, had) in pairs.items():
        if whole or value != had:
            found += [name, value]
    return found


def _exactly(number: float) -> str:
    """A number as one writes it for the same bits."""
    short = f"{number:.6g}"
    return short if float(short) == number else repr(number)


def _calls(settings: Settings, before: Settings) -> str:
    """A setting as what a script does before the first frame."""
    lines = []
    if settings.method != before.method:
        lines.append(f"sim.set_method({settings.method!r})")
    solver = {k: v for k, v in settings.solver.items() if v != before.solver.get(k)}
    if solver:
        lines.append(f"sim.set_solver({', '.join(f'{k}={v:g}' for k, v in solver.items())})")
    if not settings.follows:
        lines.append(f"sim.set_step(dt={settings.dt:.6g}, substeps={settings.substeps})")
    return "\n".join(lines)


def examine(
    sim: Simulation,
    *,
    words: Sequence[str] = (),
    draw: Callable[[], np.ndarray] | None = None,
    seconds: float = SECONDS,
    tell: Callable[[Settings], None] = lambda settings: None,
    untried: str = "",
) -> PostMortem:
    """Find out why a run failed; or, of one that did not, how it stands.

    words: of the command line after `run`, but for method, step and solver. draw: makes a picture
    of the simulation as it is; None: there are none. seconds: that trials may take. tell: called
    before each trial. untried: how to ask for trials, in a clause; there are none then, and what to
    do is what the failure itself says.
    The simulation is as it was afterwards, to the bit.
    """
    trace = traced(sim, seconds, draw)
    cause = cause_of(trace)
    if untried and trace.failure is not None:
        found = Search([], None, f"{trace.failure.remedy}; {untried}", asked=False)
    else:
        found = search(sim, trace, cause, seconds, tell)
    return PostMortem(trace, cause, found, words)
