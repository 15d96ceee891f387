"""The cheapest setting with which a run survives, found by running it with the same acts.

The scene is never changed: neither stiffness nor mass. First more substeps, by the limit that holds
in every geometry (where these would take too long, xpbd), then other methods that are expected to
cost less, at last a shorter frame.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.kernels import methods
from taichi_cloth.limits.auto_step import MOST, substeps_needed
from taichi_cloth.limits.bounds import any_geometry, gershgorin, step_within
from taichi_cloth.limits.network import Network
from taichi_cloth.post_mortem.causes import ENERGY, MOTION, PUSH, RANGE, SPEED, Cause
from taichi_cloth.post_mortem.done import Act, act_of
from taichi_cloth.post_mortem.trace import Trace
from taichi_cloth.runtime import current_device
from taichi_cloth.settings.options import SOLVER_SETTINGS
from taichi_cloth.simulation.acts import do_again
from taichi_cloth.simulation.past import Past, Place, Settings, go_to
from taichi_cloth.simulation.prediction import predict

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

AFTER = 60  # frames past the one that failed, for which a setting has to hold
SHORT = 2000  # frames of a run that is made again though nobody knows how long one takes
MOST_TRIES = 12
FIRST = 3.0  # times as long as all others together may take, the first trial may
EXPLICIT, IMPLICIT = "symplectic_euler", "implicit_euler"
RIGID = "xpbd"  # for what is stiffer than equations can be solved for
SETTINGS = frozenset(("set_step", "set_method", "set_solver"))  # acts that a trial leaves out
MOST_SWEEPS = 200  # a step, that are tried
SHORTER = 1 << 16  # times, at most, that a frame is made


@dataclass(frozen=True)
class Trial:
    """A setting that was tried. frames: how many it made; survived: whether these were all.

    wanted: how many there should have been. seconds: that a frame took. says: how it ended.
    """

    settings: Settings
    survived: bool
    frames: int
    wanted: int
    seconds: float
    says: str


@dataclass(frozen=True)
class Search:
    """The trials.

    best: the cheapest that survived; None: none did. says: why there is none, or what the trials
    were. without: acts that set the run's settings, which the trials left out. asked: whether any
    were asked for.
    """

    trials: list[Trial]
    best: Trial | None
    says: str
    without: tuple[Act, ...] = ()
    asked: bool = True


def search(
    sim: Simulation,
    trace: Trace,
    cause: Cause,
    seconds: float,
    tell: Callable[[Settings], None] = lambda settings: None,
) -> Search:
    """Look for it; the simulation is as it was afterwards.

    seconds: that trials may take; the first one has a few times as long. tell: called before each.
    """
    past = sim.past
    if past is None or trace.failure is None:
        return Search([], None, "the run did not fail")
    place = _place(past, sim, seconds)
    if place is None:
        return Search([], None, "where the run came from is not known, so nothing could be tried")
    trials: list[Trial] = []
    with np.errstate(all="ignore"), past.resting(sim):
        tries = _Tries(sim, past, place, trace.failure.frame)
        tries.until = time.perf_counter() + FIRST * seconds
        wait = seconds / 2 / (trace.failure.frame - place.frame + AFTER)
        for settings in _wanted(trace, cause, trials, sim, wait, tries.fits):
            if trials and (time.perf_counter() > tries.until or len(trials) >= MOST_TRIES):
                break
            if settings.follows and any(_same(settings, trial.settings) for trial in trials):
                continue  # it would choose the same steps
            tell(settings)
            trials.append(tries.run(settings))
            if len(trials) == 1:
                tries.until = time.perf_counter() + seconds
    survived = [trial for trial in trials if trial.survived]
    best = min(survived, key=lambda trial: trial.seconds / trial.settings.dt, default=None)
    return Search(trials, best, _words(trials, best, place, trace), tries.without())


def _same(one: Settings, other: Settings) -> bool:
    """True if runs that choose their steps themselves are the same with either."""
    return (one.method, dict(one.solver)) == (other.method, dict(other.solver))


def _place(past: Past, sim: Simulation, seconds: float) -> Place | None:
    """From where trials go: the start of the run, if there is time for that; else of the ring."""
    places = past.places()
    if not places:
        return None
    frames, a_frame = sim.frame - places[0].frame, 0.0
    with past.resting(sim), suppress(SimulationFailure):
        go_to(sim, places[0])
        sim.advance()  # compiles
        begin = time.perf_counter()
        sim.advance()
        a_frame = time.perf_counter() - begin
    near = 10 * a_frame * frames < seconds and (a_frame > 0 or frames < SHORT)
    return places[0] if near else places[min(1, len(places) - 1)]


# --- a trial ---------------------------------------------------------------------------------


class _Tries:
    """Runs a simulation from a place with other settings, and the same acts.

    until: when no more frames are made, by the clock; what compiles does not count.
    """

    def __init__(self, sim: Simulation, past: Past, place: Place, failed: int) -> None:
        self._sim, self._place, self._acts = sim, place, past.acts_since(place)
        self._first, self._failed = place.frame, failed
        self.until = math.inf

    def run(self, settings: Settings) -> Trial:
        """Try one, as long as there is time."""
        sim, spent, says = self._sim, 0.0, ""
        scaled = self._place.settings.dt / settings.dt  # of frames, where they are shorter
        wanted = math.ceil((self._failed - self._first) * scaled) + AFTER
        first = done = 0
        try:
            first = self._begin(settings, scaled)
            done = sim.frame - first
            while done < wanted and not sim.work().mostly_unconverged:
                begin = time.perf_counter()
                self._advance(done, scaled)
                spent += time.perf_counter() - begin
                done = sim.frame - first
                # What is half done costs less to finish than it did so far.
                if time.perf_counter() > self.until and 2 * done < wanted:
                    says = "there was no time for more"
                    break
            if sim.work().mostly_unconverged:
                says = sim.describe_convergence()
        except (SimulationFailure, InputError) as failure:
            says = str(failure)
        return Trial(settings, not says, done, wanted, spent / max(done - 1, 1), says)

    def fits(self, seconds: float) -> bool:
        """True if there is time for a trial of as many frames, each of which takes so long."""
        frames = self._failed - self._first + AFTER
        return time.perf_counter() + seconds * frames < self.until

    def without(self) -> tuple[Act, ...]:
        """Changes of the settings during the run, which no trial makes again."""
        done = (act_of(frame, act) for frame, acts in self._acts.items() for act in acts)
        return tuple(act for act in done if act.name in SETTINGS)

    def _begin(self, settings: Settings, scaled: float) -> int:
        """Go to the place and make a first frame, which compiles; the number of frames there."""
        begin = time.perf_counter()
        try:
            go_to(self._sim, self._place, settings)
            first: int = self._sim.frame
            self._advance(0, scaled)
        finally:
            self.until += time.perf_counter() - begin
        return first

    def _advance(self, done: int, scaled: float) -> None:
        """Make the frame after so many, with what was done before it."""
        for frame in self._due(done, scaled):
            for act in self._acts.get(frame, ()):
                do_again(self._sim, act, SETTINGS)
        self._sim.advance()

    def _due(self, done: int, scaled: float) -> range:
        """The frames of the run whose acts come before the next one of the trial."""
        begin = self._first + math.ceil(done / scaled - 1e-9)
        return range(begin, self._first + math.ceil((done + 1) / scaled - 1e-9))


# --- what is tried ---------------------------------------------------------------------------


def _wanted(
    trace: Trace,
    cause: Cause,
    trials: list[Trial],
    sim: Simulation,
    wait: float,
    fits: Callable[[float], bool],
) -> Iterator[Settings]:
    """The next trial, by the outcomes so far.

    wait: seconds for a frame; where more substeps take longer, other methods are tried before.
    fits: whether there is time for a trial whose frames take so many.
    """
    now = trace.settings
    if cause.kind in (SPEED, MOTION, PUSH, ENERGY):
        yield from _shorter_frames(trace, cause, trials)
        return
    own = methods.load(now.method).claims.stability_limit
    first = now if own > 0 else replace(now, method=EXPLICIT, solver={})
    finer = math.isfinite(own) and cause.kind != RANGE
    slow = finer and _cost(sim, replace(first, substeps=_most(trace, first))) > wait
    if math.isinf(own):
        yield from _harder(now, trials)
    elif finer and not slow:
        yield from _finer(trace, first, trials, fits)
    rigid = replace(now, method=RIGID, solver={"iterations": SOLVER_SETTINGS["iterations"]})
    if slow and now.method != RIGID:  # so stiff that equations may have no solution in a precision
        yield rigid
    best = _cheapest(trials)
    solver = {"tolerance": SOLVER_SETTINGS["tolerance"]}
    counts = (1,) if cause.kind == RANGE else (1, 2, 4, 8)
    other = [replace(now, method=IMPLICIT, solver=solver, substeps=n) for n in counts]
    if math.isinf(own):
        other = [s for s in other if now.method != IMPLICIT]
        stable = _stable(trace, EXPLICIT, trace.before)
        if stable is not None:
            other.append(replace(now, method=EXPLICIT, solver={}, substeps=stable))
    for settings in other:
        if best is None or _cost(sim, settings) < _cost(sim, best.settings):
            yield settings
            if trials[-1].survived:
                return
    if slow and _cheapest(trials) is None:
        yield from _finer(trace, first, trials, fits)
    if _cheapest(trials) is None and now.method != RIGID and not slow:
        yield rigid
    if _cheapest(trials) is None:
        yield from _shorter_frames(trace, cause, trials)


def _cheapest(trials: list[Trial]) -> Trial | None:
    return next((trial for trial in trials if trial.survived), None)


def _finer(
    trace: Trace, first: Settings, trials: list[Trial], fits: Callable[[float], bool]
) -> Iterator[Settings]:
    """More substeps: those of the limit where the trace begins, and where it ends, and doubled.

    They are doubled as long as there is time for twice as many, beside other methods.
    """
    tried = first.substeps if first.method == trace.settings.method else 0
    for network in (trace.before, trace.last):
        needed = _stable(trace, first.method, network)
        if needed is not None and needed > tried:
            tried = needed
            yield replace(first, substeps=needed)
            if trials[-1].survived:
                return
    for _ in range(4):
        tried = max(2 * tried, 2)
        if tried > MOST or tried > 1000 * trace.settings.substeps:
            return
        if trials and not fits(2 * trials[-1].seconds):
            return
        yield replace(first, substeps=tried)
        if trials[-1].survived:
            return


def _most(trace: Trace, first: Settings) -> int:
    """The substeps of the limit, where the trace begins or where it ends."""
    of = (_stable(trace, first.method, network) for network in (trace.before, trace.last))
    return max((needed for needed in of if needed is not None), default=1)


def _harder(now: Settings, trials: list[Trial]) -> Iterator[Settings]:
    """Of a method that solves equations: more steps, each of which is easier, and more sweeps."""
    for factor in (2, 4, 8, 16):
        solver = dict(now.solver)
        if "iterations" in solver and factor > 2:
            sweeps = int(solver["iterations"])
            solver["iterations"] = max(sweeps, min(sweeps * factor // 2, MOST_SWEEPS))
        yield replace(now, substeps=now.substeps * factor, solver=solver)
        if trials[-1].survived:
            return


def _shorter_frames(trace: Trace, cause: Cause, trials: list[Trial]) -> Iterator[Settings]:
    """Frames of less time: what is lost is what crosses the world too often in one of them.

    A speed that is there is so as much less often; what a force gives within one falls, too.
    """
    speed = max((s.speed for s in trace.samples if math.isfinite(s.speed)), default=0.0)
    times = max(2.0 * speed / trace.speed_limit, 2.0)
    factor = 2 ** math.ceil(math.log2(math.sqrt(times) if cause.kind == PUSH else times))
    while factor <= SHORTER and len(trials) < MOST_TRIES:
        yield replace(trace.settings, dt=trace.settings.dt / factor)
        if trials[-1].survived:
            return
        factor *= 4


def _stable(trace: Trace, method: str, network: Network) -> int | None:
    """Substeps of a frame that are stable however springs turn; None: there is no such number."""
    module = methods.load(method)
    rough = step_within(module, gershgorin(network))
    if not rough > 0:
        return None
    limit = rough
    if substeps_needed(trace.settings.dt, rough) > 1 and len(network.springs):
        limit = step_within(module, any_geometry(network))
    needed = substeps_needed(trace.settings.dt, limit)
    return needed if needed <= MOST else None


def _cost(sim: Simulation, settings: Settings) -> float:
    """Seconds that a frame is predicted to take."""
    module, path = methods.load(settings.method), sim.execution
    scene = sim.storage.scene
    return predict(scene, module, current_device(), sim.topology, path).of(settings.substeps)


# --- words -----------------------------------------------------------------------------------


def _words(trials: list[Trial], best: Trial | None, place: Place, trace: Trace) -> str:
    """Its outcome, in a clause."""
    whence = "the start" if place.checkpoint is None else f"frame {place.frame}"
    if best is None:
        last = f"; the last of {len(trials)}: {trials[-1].says}" if trials else ""
        return f"no setting that was tried survives from {whence}{last}"
    shorter = best.settings.dt < trace.settings.dt
    slower = ", in each of which less time passes" if shorter else ""
    return (
        f"run from {whence} with the same events, it survives {best.frames} frames, {AFTER} past "
        f"the failure{slower}"
    )
