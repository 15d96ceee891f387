"""The cheapest setting with which a run survives, found by running it with the same acts.

The scene is never changed: neither stiffness nor mass. First more substeps, by the limit that holds
in every geometry, then other methods that are expected to cost less, at last a shorter frame.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.kernels import methods
from taichi_cloth.limits.auto_step import MOST, substeps_needed
from taichi_cloth.limits.bounds import any_geometry, gershgorin, step_within
from taichi_cloth.limits.network import Network
from taichi_cloth.post_mortem.causes import ENERGY, PUSH, SPEED, Cause
from taichi_cloth.post_mortem.trace import Trace
from taichi_cloth.runtime import current_device
from taichi_cloth.settings.options import SOLVER_SETTINGS
from taichi_cloth.simulation.acts import do_again
from taichi_cloth.simulation.past import Past, Place, Settings, go_to
from taichi_cloth.simulation.prediction import predict

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

AFTER = 60  # frames past the one that failed, for which a setting has to hold
MOST_TRIES = 12
EXPLICIT, IMPLICIT = "symplectic_euler", "implicit_euler"
SETTINGS = frozenset(("set_step", "set_method", "set_solver"))  # acts that a trial leaves out
SHORTER = 1000  # times, at most, that a frame is made


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
    """What was tried. best: the cheapest that survived; None: none did. says: why there is none,
    or what the trials were."""

    trials: list[Trial]
    best: Trial | None
    says: str


def search(
    sim: Simulation,
    trace: Trace,
    cause: Cause,
    seconds: float,
    tell: Callable[[Settings], None] = lambda settings: None,
) -> Search:
    """Look for it; the simulation is as it was afterwards.

    seconds: that trials may take; the first one is made in any case. tell: called before each.
    """
    past = sim.past
    if past is None or trace.failure is None:
        return Search([], None, "the run did not fail")
    place = _place(past, sim, seconds)
    if place is None:
        return Search([], None, "where the run came from is not known, so nothing could be tried")
    until = time.perf_counter() + seconds
    trials: list[Trial] = []
    with np.errstate(all="ignore"), past.resting(sim):
        tries = _Tries(sim, past, place, trace.failure.frame)
        for settings in _wanted(trace, cause, trials, sim):
            if trials and (time.perf_counter() > until or len(trials) >= MOST_TRIES):
                break
            tell(settings)
            trials.append(tries.run(settings, until if trials else math.inf))
    survived = [trial for trial in trials if trial.survived]
    best = min(survived, key=lambda trial: trial.seconds / trial.settings.dt, default=None)
    return Search(trials, best, _words(trials, best, place, trace))


def _place(past: Past, sim: Simulation, seconds: float) -> Place | None:
    """From where trials go: the start of the run, if there is time for that; else of the ring."""
    places = past.places()
    if not places:
        return None
    begin = time.perf_counter()
    with past.resting(sim):
        go_to(sim, places[-1])
        try:
            sim.advance()
        except SimulationFailure:
            return places[0]
        begin = time.perf_counter()
        try:
            sim.advance()
        except SimulationFailure:
            return places[0]
    a_frame = time.perf_counter() - begin
    frames = sim.frame - places[0].frame
    return places[0] if 10 * a_frame * frames < seconds else places[min(1, len(places) - 1)]


# --- a trial ---------------------------------------------------------------------------------


class _Tries:
    """Runs a simulation from a place with other settings, and the same acts."""

    def __init__(self, sim: Simulation, past: Past, place: Place, failed: int) -> None:
        self._sim, self._place, self._acts = sim, place, past.acts_since(place)
        self._first, self._last = place.frame, failed + AFTER

    def run(self, settings: Settings, until: float) -> Trial:
        """Try one; until: when no more frames are made, by the clock."""
        sim, done, spent = self._sim, 0, 0.0
        wanted, says = self._last - self._first, ""
        scaled = self._place.settings.dt / settings.dt  # of frames, where they are shorter
        wanted = math.ceil(wanted * scaled)
        try:
            go_to(sim, self._place, settings)
            first = sim.frame
            while done < wanted:
                for frame in self._due(done, scaled):
                    for act in self._acts.get(frame, ()):
                        do_again(sim, act, SETTINGS)
                begin = time.perf_counter()
                sim.advance()
                spent += (time.perf_counter() - begin) * (done > 0)
                done = sim.frame - first
                if time.perf_counter() > until:
                    says = "there was no time for more"
                    break
            if sim.work().mostly_unconverged:
                says = sim.describe_convergence()
        except (SimulationFailure, InputError) as failure:
            says = str(failure)
        a_frame = spent / max(done - 1, 1)
        return Trial(settings, not says, done, wanted, a_frame, says)

    def _due(self, done: int, scaled: float) -> range:
        """The frames of the run whose acts come before the next one of the trial."""
        begin = self._first + math.ceil(done / scaled - 1e-9)
        return range(begin, self._first + math.ceil((done + 1) / scaled - 1e-9))


# --- what is tried ---------------------------------------------------------------------------


def _wanted(trace: Trace, cause: Cause, trials: list[Trial], sim: Simulation) -> Iterator[Settings]:
    """What to try next, by what came of the trials so far."""
    now = trace.settings
    if cause.kind in (SPEED, PUSH, ENERGY):
        yield from _shorter_frames(trace, trials)
        return
    own = methods.load(now.method).claims.stability_limit
    first = now if own > 0 else replace(now, method=EXPLICIT, solver={})
    if math.isinf(own):
        yield from _harder(now, trials)
    else:
        yield from _finer(trace, first, trials)
    best = _cheapest(trials)
    solver = {"tolerance": SOLVER_SETTINGS["tolerance"]}
    other = [replace(now, method=IMPLICIT, solver=solver, substeps=n) for n in (1, 2, 4, 8)]
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
    if _cheapest(trials) is None:
        yield from _shorter_frames(trace, trials)


def _cheapest(trials: list[Trial]) -> Trial | None:
    return next((trial for trial in trials if trial.survived), None)


def _finer(trace: Trace, first: Settings, trials: list[Trial]) -> Iterator[Settings]:
    """More substeps: those of the limit where the trace begins, and where it ends, and doubled."""
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
        yield replace(first, substeps=tried)
        if trials[-1].survived:
            return


def _harder(now: Settings, trials: list[Trial]) -> Iterator[Settings]:
    """Of a method that solves equations: more steps, each of which is easier, and more sweeps."""
    for factor in (2, 4, 8, 16):
        solver = dict(now.solver)
        if "iterations" in solver and factor > 2:
            solver["iterations"] = min(solver["iterations"] * factor / 2, 200)
        yield replace(now, substeps=now.substeps * factor, solver=solver)
        if trials[-1].survived:
            return


def _shorter_frames(trace: Trace, trials: list[Trial]) -> Iterator[Settings]:
    """Frames of less time: what is lost is what crosses the world too often in one of them."""
    speed = max((s.speed for s in trace.samples if math.isfinite(s.speed)), default=0.0)
    factor = max(2.0, 2 ** math.ceil(math.log2(max(2.0 * speed / trace.speed_limit, 2.0))))
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
    """What came of it, in a sentence."""
    whence = "the start" if place.checkpoint is None else f"frame {place.frame}"
    if best is None:
        last = f"; the last of {len(trials)}: {trials[-1].says}" if trials else ""
        return f"no setting that was tried survives from {whence}{last}"
    shorter = best.settings.dt < trace.settings.dt
    slower = ", in which less time passes" if shorter else ""
    return (
        f"run from {whence} with the same events, it survives {best.frames} frames{slower}, "
        f"{AFTER} past the failure"
        if not shorter
        else f"run from {whence} with the same events, it survives {best.frames} frames{slower}"
    )
