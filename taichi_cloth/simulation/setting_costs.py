"""Costs of each setting of a run: milliseconds of a frame, or room to the stable step.

Times are measured in the run, or predicted from what was measured there by how work compares
(`prediction.py`); parts of the stable step are computed from the springs as they are, along the
mode that is the first to grow. What neither says is said to be unknown, with what would tell it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.errors import counted
from taichi_cloth.kernels import methods
from taichi_cloth.limits.modes import largest_step
from taichi_cloth.limits.tracking import FastestMode, Shares
from taichi_cloth.simulation import live
from taichi_cloth.simulation.moment import Moments
from taichi_cloth.simulation.running_costs import FrameCost, RunningCosts, work_of

if TYPE_CHECKING:
    from taichi_cloth.limits.network import Network
    from taichi_cloth.simulation.live import Setting, Value
    from taichi_cloth.simulation.simulation import Simulation

EVERY = 1.0  # seconds between looks, and
AFTER_CHANGE = 0.2  # where something was set: a slider that is dragged changes at every frame
SHARE = 0.02  # of the time that goes by, what looks may take
AT_FIRST, IMPROVEMENTS = 30, 6  # products for the fastest mode: at first, and at later looks
SMALL = 0.02  # of a frame: a difference of two measured times below it is none
FREE, UNKNOWN = "free", "?"


@dataclass(frozen=True)
class Beside:
    """The text beside a setting. words: at most nine letters; "~" before a predicted time. said:
    the same in a sentence. used: the part of the stable step; None: it is not about that.
    """

    words: str
    said: str
    used: float | None = None


class SettingCosts:
    """Says what the settings of a simulation cost; looks at its state once a second at most.

    frames: what its frames took, method by method.
    """

    def __init__(
        self,
        sim: Simulation,
        frames: RunningCosts,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._sim, self._frames, self._clock = sim, frames, clock
        self._moments = Moments(sim, accounts=False)
        self._mode: tuple[str, FastestMode] | None = None
        self._shares: Shares | None = None
        self._network: Network | None = None
        self._looked, self._took = -math.inf, 0.0
        self._changed = False
        self._said: dict[str, tuple[Value, Beside]] = {}
        self.looks = 0  # that were taken
        self.frame = "not measured"  # what a frame took at the last one, in words

    def hurry(self) -> None:
        """Something was set: look again soon."""
        self._changed = True

    def look(self) -> None:
        """Look at the state, where that is due."""
        wait = AFTER_CHANGE if self._changed else EVERY
        begin, busy = self._clock(), time.thread_time()  # other programs' time is not counted
        if begin < self._looked + max(wait, self._took / SHARE):
            return
        self._said, self._changed, self._looked = {}, False, begin
        self.looks, self.frame = self.looks + 1, self._frames.now(self._sim).words()
        sim, first = self._sim, self._mode is None or self._mode[0] != self._sim.method
        if first:
            self._mode = sim.method, FastestMode(methods.load(sim.method))
        assert self._mode is not None
        self._network = self._moments.now().network
        mode, more = self._mode[1], AT_FIRST if first else IMPROVEMENTS
        found = mode.follow(self._network, sim.dt / sim.substeps, more)
        self._shares = None if found is None else mode.shares
        self._took = time.thread_time() - busy

    def of(self, one: Setting, value: Value) -> Beside:
        """The cost of a setting at its present value."""
        known = self._said.get(one.name)
        if known is None or known[0] != value:
            known = self._said[one.name] = value, self._found(one, value)
        return known[1]

    def option(self, one: Setting, word: str) -> Beside:
        """The cost of another method, and the substeps that it would need."""
        key = f"{one.name}:{word}"
        if key not in self._said:
            self._said[key] = word, self._of_method(one, word)
        return self._said[key][1]

    def advice(self, method: str) -> str:
        """When to take a method, in its own words."""
        return methods.load(method).claims.choose

    def least(self, method: str) -> str:
        """The least substeps with which a method is stable here, as an option says it."""
        steps = self._least(method)
        return {None: UNKNOWN, 0: "unstable", 1: "min 1"}.get(steps, f"min {steps}")

    # --- each kind of setting ----------------------------------------------------------------

    def _found(self, one: Setting, value: Value) -> Beside:
        if one.name == "method":
            return self._of_method(one, str(value))
        if one.name in ("dt", "substeps"):
            return self._of_step(one)
        if one.name == "iterations":
            return self._of_iterations()
        if one.name == "tolerance":
            work = self._sim.work()
            per_step = work.sweeps / max(work.steps, 1)
            return Beside(
                f"{per_step:.3g}/step" if work.steps else UNKNOWN,
                f"{per_step:.3g} passes over all springs a step so far, measured",
            )
        if one.group == "features":
            return self._of_feature(one, bool(value))
        if one.name == "thickness" and value:  # its pairs are what self-collision takes
            return self._of_feature(live.setting(self._sim, "self_collision"), True)
        part = self._part(one)
        if part is not None:
            return self._of_part(*part)
        return Beside(FREE, "any value takes the same time")

    def _of_method(self, one: Setting, method: str) -> Beside:
        cost = self._frames.of(self._sim, one, method, self._steps(method))
        return Beside(_time(cost), f"{cost.words()}; {self._stability(method)}")

    def _steps(self, method: str) -> int | None:
        """The substeps that a run that chooses them would have with a method; None: as they are."""
        sim = self._sim
        if not sim.follows or method == sim.method:
            return None
        here, there = self._longest(sim.method), self._longest(method)
        if here is None or there is None or there == 0 or math.isinf(here):
            return None
        return max(1, math.ceil(sim.substeps * here / there - 1e-9))

    def _stability(self, method: str) -> str:
        steps = self._least(method)
        if steps is None:
            return "its limit is not known yet"
        if math.isinf(self._longest(method) or 0.0):
            return "stable at every step"
        return f"stable from {counted(steps, 'substep')} on" if steps else "unstable at every step"

    def _of_step(self, one: Setting) -> Beside:
        sim, longest = self._sim, self._longest(self._sim.method)
        if longest is None:
            return Beside(UNKNOWN, "the stable step is not known yet")
        each = self._frames.now(sim)
        said = self._stability(sim.method)
        if one.name == "substeps":
            if each.seconds is not None:
                each = FrameCost(each.seconds / sim.substeps, each.how)
                said = f"{short(each.seconds or 0.0)} each, {each.how}; {said}"
            return Beside(self.least(sim.method), said, self._used(longest))
        if math.isinf(longest):
            return Beside("no limit", said)
        used = self._used(longest)
        if longest == 0:
            return Beside("unstable", said, used)
        return Beside(
            _limit(used),
            f"a step of {sim.dt / sim.substeps:.3g} is {_percent(used)} of the longest stable one, "
            f"{longest:.3g}",
            used,
        )

    def _of_iterations(self) -> Beside:
        now, sweeps = self._frames.now(self._sim), float(self._sim.solver["iterations"])
        if now.seconds is None:
            return Beside(UNKNOWN, now.how)
        seconds = now.seconds * sweeps / work_of(sweeps)
        return Beside(
            f"~{short(seconds)}", f"{short(seconds)} of a frame's {now.words()}: predicted"
        )

    def _of_feature(self, one: Setting, on: bool) -> Beside:
        now, other = self._frames.now(self._sim), self._frames.of(self._sim, one, not on)
        if now.seconds is None or other.seconds is None:
            why = "not measured: switch it and back, and both are compared"
            return Beside(UNKNOWN if on else FREE, why if on else f"off it takes no time; {why}")
        more = (now.seconds - other.seconds) * (1 if on else -1)
        words = f"{'~' if other.how == 'predicted' else ''}{short(more)}"
        if more <= SMALL * now.seconds:
            words = f"< {short(SMALL * now.seconds).strip('<')}"
        said = f"{words.strip('~')} of a frame, {other.how}"
        return Beside(words, said) if on else Beside(FREE, f"off it takes no time; on {said}")

    def _part(self, one: Setting) -> tuple[float, float] | None:
        """The part of a setting in omega^2 and d of the mode; None: it has none."""
        shares, network = self._shares, self._network
        kind = one.name.partition(".")[0]
        if shares is None or network is None:
            return None
        if kind in ("stiffness", "damping") and one.changes is not None:
            chosen = one.changes(self._sim, 1.0)["springs"]
            ours = np.isin(network.number, chosen)
            if kind == "stiffness":
                return float(shares.stiffness[ours].sum()), 0.0
            return 0.0, float(shares.damping[ours].sum())
        return {"viscous": (0.0, shares.drag), "bending": (shares.bending, 0.0)}.get(kind)

    def _of_part(self, omega2: float, damping: float) -> Beside:
        sim = self._sim
        step, method = sim.dt / sim.substeps, methods.load(sim.method)
        rate = f"h omega {step * math.sqrt(omega2):.3g}" if omega2 else f"h d {step * damping:.3g}"
        longest = largest_step(method, omega2, damping)
        if math.isinf(longest):
            said = f"{rate}: no step is too long for it"
            return Beside("no limit" if omega2 + damping else "lim 0 %", said)
        if longest == 0:
            return Beside("unstable", f"{rate}: {sim.method} grows at every step", math.inf)
        needs = max(1, math.ceil(sim.dt / longest * (1 - 1e-9)))
        said = f"{rate}: it alone needs {counted(needs, 'substep')}"
        return Beside(_limit(step / longest), said, step / longest)

    # --- the stable step ---------------------------------------------------------------------

    def _longest(self, method: str) -> float | None:
        """The longest stable step of a method, by the fastest mode; None before a look."""
        if self._network is None:
            return None
        if self._shares is None:
            return math.inf
        return largest_step(methods.load(method), self._shares.omega2, self._shares.d)

    def _least(self, method: str) -> int | None:
        """The least number of substeps with which a method is stable; 0: there is none."""
        longest = self._longest(method)
        if longest is None:
            return None
        return math.ceil(max(self._sim.dt / longest * (1 - 1e-9), 1e-9)) if longest else 0

    def _used(self, longest: float) -> float:
        return self._sim.dt / self._sim.substeps / longest if longest else math.inf


def short(seconds: float) -> str:
    """A time in milliseconds, in few letters."""
    ms = 1e3 * seconds
    if ms < 0.01:
        return "<0.01 ms"
    return f"{ms:.0f} ms" if ms >= 10 else f"{ms:.2g} ms"


def _time(cost: FrameCost) -> str:
    if cost.seconds is None:
        return UNKNOWN
    return ("~" if cost.how == "predicted" else "") + short(cost.seconds)


def _percent(part: float) -> str:
    return f"{100 * part:.0f} %" if part < 99.5 else ">9999 %"


def _limit(part: float) -> str:
    """The part of the longest stable step, in the few letters that the column of costs has."""
    if part < 9.995:
        return f"lim {100 * part:.0f} %"
    return f"lim {part:.0f}x" if part < 999.5 else "lim >999x"
