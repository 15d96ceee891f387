"""The error meter's process: a window, made again in f64 at finer steps.

The error, the reference's method and the converged solver are those of `trade`.
"""

from __future__ import annotations

import math
import pickle
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.error_meter import ghost
from taichi_cloth.error_meter.others import Trial, results
from taichi_cloth.error_meter.verdict import AIM, GREW, MILLIONTH, REST, THIRD, Verdict
from taichi_cloth.error_meter.window import (
    FEW,
    FRAMES,
    GHOST,
    LEAST,
    SCENE,
    STAGE,
    STRIDE,
    WAITING,
    WINDOW,
    Window,
)
from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation.acts import do_again
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.start import Start
from taichi_cloth.trade import conditions, errors, reference, settings

FINER = 2  # from one reference to the next
# Steps in 1 / omega of the coarsest reference: of fourth order, that is a thousandth or so.
RESOLUTION = 2


class TooSlow(Exception):
    """A run takes longer than its window may."""


@dataclass(frozen=True)
class _Plan:
    """A way to run a window once more."""

    method: str
    substeps: list[int]
    solver: dict[str, float]
    start: Start


@dataclass(frozen=True)
class _Reference:
    """A run at a fine step beside that of half as many, both with as many samples.

    finest, before: both; substeps: of the former. sure: in how many samples from the start on they
    differ by little enough, 0 where these are too few. springs: (s, 2) at each sample.
    """

    finest: errors.Samples
    before: errors.Samples
    substeps: int
    sure: int
    springs: list[np.ndarray]

    @property
    def worth(self) -> tuple[int, int]:
        """The share of the window that it can tell, and has."""
        return self.sure, len(self.finest)


@dataclass(frozen=True)
class _Measured:
    """A window whose error is known, as what parts that needs it.

    shown: what the run showed; finest, coarsest: the last reference, and the first, of `substeps`
    a frame; as many samples of each as were judged.
    """

    window: Window
    verdict: Verdict
    shown: errors.Samples
    finest: errors.Samples
    coarsest: errors.Samples
    substeps: int

    @property
    def free(self) -> np.ndarray:
        """Which particles move, (n,) bool."""
        free: np.ndarray = ~self.window.start.snapshot.scene.particles.fixed
        return free


def started(threads: int | None) -> Judge:
    """A judge in a process of its own, whose device this starts."""
    runtime.start("cpu", "f64", threads, fast_math=False)
    return Judge(threads)


class Judge:
    """Measures the errors of windows, one after the other; what was compiled for one stays.

    It needs a device in f64. threads: that it computes on; None: as many as there are, where there
    are enough particles.
    """

    def __init__(self, threads: int | None) -> None:
        self._threads = threads
        self._sims: dict[str, Simulation] = {}
        self._scene: Scene | None = None
        self._until = math.inf
        self._folder = Path()
        self._springs: list[np.ndarray] = []  # at each sample of the last run
        self._next: Start | None = None  # of the second that is surveyed next
        # Seconds that a method took to compile at most; until when others may be compiled.
        self._compiling, self._compiles_until = 0.0, math.inf
        self._measured: _Measured | None = None

    def measure(
        self, folder: str, patience: float, within: float = math.inf, floor: float = 0.0
    ) -> dict[str, Any]:
        """The verdict on the window in a folder, as a dictionary; the reference is put there, too.

        What the error comes from is left to `part`. patience: seconds that the references may take,
        compiling left out. within: an error, in parts of the motion, that these are to tell, too,
        where the window's own is larger. floor: an error below which nobody asks how small it is.
        """
        self._folder, self._measured = Path(folder), None
        window, begin = self._read(self._folder / WINDOW), time.perf_counter()
        size = float(np.linalg.norm(window.start.snapshot.scene.world.size))
        own = window.substeps[0] if len(set(window.substeps)) == 1 else 0
        verdict = Verdict(
            window.first, window.frames, window.precision, size=size, method=window.method,
            own_substeps=own, acted=any(window.acts.values()),
        )  # fmt: skip
        try:
            verdict = self._verdict(window, verdict, patience, within, floor)
        except TooSlow as slow:
            verdict = replace(verdict, trouble=str(slow))
        except (SimulationFailure, InputError) as failure:
            verdict = replace(verdict, trouble=f"the reference fails: {failure}")
        return asdict(replace(verdict, seconds=time.perf_counter() - begin))

    def part(self, patience: float, trials: Sequence[dict[str, Any]] = ()) -> dict[str, Any]:
        """The same verdict with how disturbances grow, and with what made the error.

        patience: seconds for that, compiling left out; what takes longer stays unknown. trials: of
        other steps and methods, as dictionaries of `Trial`.
        """
        measured, begin = self._measured, time.perf_counter()
        if measured is None:
            raise InputError("no error is known that could be parted")
        verdict = measured.verdict
        self._until = time.perf_counter() + patience
        with suppress(TooSlow, SimulationFailure, InputError):
            verdict = self._grown(measured, verdict)
            verdict = self._parted(measured, verdict)
        if trials and verdict.own_substeps:
            verdict = self._tried(measured, verdict, [Trial(**trial) for trial in trials])
        return asdict(replace(verdict, seconds=verdict.seconds + time.perf_counter() - begin))

    def survey(
        self, folder: str, dt: float, patience: float, within: float, relative: bool,
        trials: Sequence[dict[str, Any]], limit: float = math.inf,
    ) -> dict[str, Any]:  # fmt: skip
        """Errors of other settings in the next second of a scene's own motion, in f64.

        Seconds follow each other, from the start of the scene that lies in the folder, along the
        coarsest reference. Each has one reference for all settings, no finer than it takes to tell
        an error of `within`: in parts of the second's motion where `relative`, else in world units.
        patience: seconds for the references, and again for the settings. trials: as of `part`, none
        for a second that is passed over; their errors are what is wanted. limit: seconds; methods
        that would be compiled later than that are left out.
        Returns `tries`, by method (substeps, error / within) of each; `trouble`, why there are
        none; `slow`, whether that is for want of time; `resting`, whether nothing moved;
        `compiled`, the seconds that a method took to compile at most; `seconds`.
        """
        self._folder, begin = Path(folder), time.perf_counter()
        self._compiles_until = begin + limit
        found: dict[str, Any] = {"tries": {}, "trouble": "", "slow": False, "resting": False}
        try:
            found |= self._surveyed(dt, patience, within, relative, trials)
        except TooSlow as slow:
            found |= {"trouble": str(slow), "slow": True}
        except (SimulationFailure, InputError) as failure:
            found["trouble"] = f"the reference fails: {failure}"
        self._compiles_until = math.inf
        return found | {"compiled": self._compiling, "seconds": time.perf_counter() - begin}

    def _surveyed(
        self, dt: float, patience: float, within: float, relative: bool,
        trials: Sequence[dict[str, Any]],
    ) -> dict[str, Any]:  # fmt: skip
        method = reference.fine_method()
        if self._next is None:
            given = pickle.loads((self._folder / SCENE).read_bytes())
            sim = self._sim(method, given)
            sim.load_scene(given, dt, 1)
            self._next = sim.start()
        start = self._next
        scene = start.snapshot.scene
        substeps = reference.coarsest(scene, dt, RESOLUTION)
        stride = 1 if len(start.snapshot.x) <= FEW else STRIDE
        window = Window(start, 0, method, dt, {}, "f64", stride, [substeps] * FRAMES)
        plan = _Plan(method, window.substeps, {}, start)
        self._compile(window, plan, "the reference")
        self._until = time.perf_counter() + patience
        coarsest = self._reference(window, plan)
        if len(coarsest) <= FRAMES // stride:
            raise TooSlow(f"{patience:g} s do not make a second again at {substeps} substeps")
        self._next = self._sims[method].start()
        if not trials:
            return {}
        scale = errors.displacement(coarsest, ~scene.particles.fixed)
        if scale < REST * float(np.linalg.norm(scene.world.size)):
            return {"resting": True}
        part = within if relative else within / scale
        found = self._refined(window, plan, coarsest, coarsest, part, part)
        if not found.sure:
            return {"trouble": "references differ"}
        finest, first = found.finest.first(found.sure), coarsest.first(found.sure)
        scale = reference.extent(scene, finest)[0]
        part = within if relative else within / scale
        error = errors.distance(first, finest, ~scene.particles.fixed).trajectory
        verdict = Verdict(
            0, FRAMES, error=error, scale=scale, own_substeps=substeps, judged=found.sure * stride
        )
        measured = _Measured(window, verdict, first, finest, first, substeps)
        self._until = time.perf_counter() + patience
        wanted = [replace(Trial(**trial), within=part) for trial in trials]
        tries = self._tried(measured, verdict, wanted).others
        return {"tries": {name: [(n, e / part) for n, e in of] for name, of in tries.items()}}

    def _tell(self, stage: str) -> None:
        """Have the parent know what is done now."""
        (self._folder / STAGE).write_text(stage)

    def _read(self, file: Path) -> Window:
        parts = pickle.loads(file.read_bytes())
        start, snapshot = parts["start"], parts["start"]["snapshot"]
        if snapshot["scene"] is not None:
            self._scene = snapshot["scene"]
        taken = Snapshot(**{**snapshot, "scene": self._scene})
        return Window(**{**parts, "start": Start(**{**start, "snapshot": taken})})

    def _verdict(
        self, window: Window, verdict: Verdict, patience: float, within: float, floor: float
    ) -> Verdict:
        """The verdict with the error; TooSlow where too few frames can be made again in time."""
        start, shown = window.start, _samples(np.asarray(window.shown, np.float64))
        scene, method = start.snapshot.scene, reference.fine_method()
        free = ~scene.particles.fixed
        substeps = reference.coarsest(scene, window.dt, RESOLUTION)
        plan = _Plan(method, [substeps] * window.frames, {}, start)
        self._compile(window, plan, "the reference")
        begin = time.perf_counter()
        self._until = begin + patience / (1 + FINER)
        coarsest = self._reference(window, plan)
        least, made = _least(window), len(coarsest) - 1
        if made < least:
            took = (time.perf_counter() - begin) / max(made, 1) * least * (1 + FINER)
            raise TooSlow(
                f"{LEAST / FRAMES:g} s of it would take {took:.3g} s to make again at finer steps, "
                f"and {patience:g} s are there: a smaller scene"
                + ", or a headless run, which waits longer"
                * (patience < WAITING)
            )
        self._until = begin + patience
        found = self._refined(window, plan, coarsest, shown, within, floor)
        samples = found.sure or len(found.finest) - 1
        finest, seen = found.finest.first(samples), shown.first(samples)
        scale, _ = reference.extent(scene, finest)
        by_frame = errors.rms_by_frame(seen, finest, free)[1:].tolist()
        error = errors.distance(seen, finest, free).trajectory
        apart = errors.distance(found.before.first(samples), finest, free).trajectory
        verdict = replace(
            verdict, error=error, scale=scale, apart=apart, substeps=found.substeps,
            judged=samples * window.stride, by_frame=by_frame,
        )  # fmt: skip
        if not found.sure:
            what = f"two references differ by {apart / scale:.1e} of the motion"
            verdict = replace(verdict, trouble=f"{what}, and {patience:g} s allow no finer one")
        elif samples < len(found.finest) - 1:
            verdict = replace(verdict, further="further on references differ")
        elif samples < len(shown) - 1:
            verdict = replace(verdict, further=f"{patience:g} s allow no more")
        torn = _missing(found.springs[0], found.springs[samples])
        ghost.write(self._folder / GHOST, finest.x, seen.x, torn)
        self._measured = _Measured(
            window, verdict, seen, finest, coarsest.first(samples), substeps
        )  # fmt: skip
        return verdict

    def _reference(self, window: Window, plan: _Plan) -> errors.Samples:
        self._tell(f"the reference in {plan.substeps[0]} steps a frame")
        return self._run(window, plan)

    def _refined(
        self,
        window: Window,
        plan: _Plan,
        coarsest: errors.Samples,
        shown: errors.Samples,
        within: float,
        floor: float,
    ) -> _Reference:
        """The reference, and how far it is one, in the time that there is.

        It is refined until it differs from the one before by a fifth of the error, or of the one
        that others are to be within, or by nothing but round-off: across contacts and breaks that
        is about what the finer one is wrong by, else far more. Chance, too, ends it: where
        disturbances grow, finer steps come no nearer to each other, and what they share is a
        beginning. The longest of these is kept.
        """
        free = ~window.start.snapshot.scene.particles.fixed
        least, best, before = _least(window), None, coarsest
        while True:
            plan = replace(plan, substeps=[FINER * n for n in plan.substeps])
            begin = time.perf_counter()
            frames = (len(before) - 1) * window.stride
            finer = self._reference(window, replace(plan, substeps=plan.substeps[:frames]))
            made, now = len(finer) - 1, time.perf_counter()
            if made < least and best is not None:
                return best
            if made < 1:
                raise TooSlow("the second reference takes too long")
            before = before.first(made)
            sure, enough = _agreement(shown.first(made), finer, before, free, within, floor)
            sure = sure if sure >= least else 0
            found = _Reference(finer, before, plan.substeps[0], sure, self._springs)
            best = found if best is None or found.worth >= best.worth else best
            before = finer
            more = int((self._until - now) / (FINER * (now - begin)) * made)  # finer ones of these
            if enough or more < max(least, min(best.sure + 1, made)):
                return best

    def _grown(self, measured: _Measured, verdict: Verdict) -> Verdict:
        """The verdict with how a disturbance of a millionth grows."""
        start = _disturbed(measured.window.start, MILLIONTH * verdict.scale)
        substeps = [measured.substeps] * verdict.judged
        self._tell("how disturbances grow")
        plan = _Plan(reference.fine_method(), substeps, {}, start)
        other = self._whole(measured.window, plan)
        apart = errors.rms_by_frame(measured.coarsest, other, measured.free)
        parted = errors.distance(measured.coarsest, other, measured.free).trajectory
        return replace(verdict, growth=_rate(apart) / measured.window.stride, parted=parted)

    def _parted(self, measured: _Measured, verdict: Verdict) -> Verdict:
        """The verdict with what solver and rounding made of the error."""
        window, free, plan = measured.window, measured.free, _own(measured)
        exact = settings.converged(settings.Setting(window.method, window.dt, 1))
        if exact is None and window.precision == "f64":
            return verdict
        self._compile(window, plan, f"{window.method} in f64")
        same = measured.shown
        if window.precision != "f64":
            self._tell("what rounding does")
            same = self._whole(window, plan)
            rounding = errors.distance(measured.shown, same, free).trajectory
            verdict = replace(verdict, rounding=rounding)
        if exact is not None:
            given = {"tolerance": exact.tolerance, "iterations": exact.iterations}
            solver = {name: value for name, value in given.items() if value is not None}
            self._tell("what the solver leaves")
            with suppress(TooSlow):
                converged = self._whole(window, replace(plan, solver={**plan.solver, **solver}))
                apart = errors.distance(same, converged, free).trajectory
                verdict = replace(verdict, solver=apart)
        return verdict

    def _tried(self, measured: _Measured, verdict: Verdict, trials: Sequence[Trial]) -> Verdict:
        """The verdict with the errors of other steps and methods: as many as there is time for."""
        window, count = measured.window, verdict.judged
        found: dict[str, list[tuple[int, float]]] = {}
        exact = window.precision == "f64"

        def error(method: str, substeps: int) -> float:
            own = method == window.method
            if exact and own and substeps == verdict.own_substeps:
                return verdict.relative  # as it was shown
            plan = _Plan(method, [substeps] * count, window.solver if own else {}, window.start)
            try:
                self._compile(window, plan, method)
                self._tell(f"{method} in {substeps} steps a frame")
                made = self._whole(window, plan)
            except (SimulationFailure, InputError):
                return math.inf
            apart = errors.distance(made, measured.finest, measured.free).trajectory
            return apart / verdict.scale

        with suppress(TooSlow):
            rounding = (verdict.rounding or 0.0) / verdict.scale
            for method, substeps, result in results(trials, error, rounding):
                if math.isfinite(result):
                    found.setdefault(method, []).append((substeps, result))
        return replace(verdict, others={**found})

    # --- runs ------------------------------------------------------------------------------

    def _compile(self, window: Window, plan: _Plan, what: str) -> None:
        """Have all kernels ready by a frame, which does not count for the patience."""
        begin = time.perf_counter()
        if plan.method not in self._sims:
            if begin + self._compiling > self._compiles_until:
                raise InputError(f"there is no time to compile {plan.method}")
            self._tell(f"compiling {what}")
        before, self._until = self._until, math.inf
        self._run(window, replace(plan, substeps=plan.substeps[:1]))
        took = time.perf_counter() - begin
        self._compiling = max(self._compiling, took)
        self._until = before + took

    def _whole(self, window: Window, plan: _Plan) -> errors.Samples:
        """All of a plan's frames; TooSlow where there is no time for them."""
        made = self._run(window, plan)
        if len(made) <= len(plan.substeps) // window.stride:
            raise TooSlow(f"{plan.method} takes too long")
        return made

    def _run(self, window: Window, plan: _Plan) -> errors.Samples:
        """The window's frames and acts in another way: so many as there is time for."""
        scene, count = plan.start.snapshot.scene, len(plan.start.snapshot.x)
        sim = self._sim(plan.method, scene)
        sim.solver.update({k: v for k, v in plan.solver.items() if k in sim.claims.settings})
        sim.begin_from(plan.start, window.dt, plan.substeps[0])
        x, self._springs = [sim.positions()], [sim.drawn_springs()]
        for frame, substeps in enumerate(plan.substeps):
            if time.perf_counter() > self._until:
                break
            for act in window.acts.get(frame, ()):
                do_again(sim, act)
            if substeps != sim.substeps:
                sim.set_step(substeps=substeps)
            sim.advance()
            if (frame + 1) % window.stride == 0:
                x.append(sim.positions()[:count])
                self._springs.append(sim.drawn_springs())
        return _samples(np.array(x))

    def _sim(self, method: str, scene: Scene) -> Simulation:
        """The simulation that runs by a method; it is compiled for the first scene."""
        if method not in self._sims:
            stored, run = conditions.best_for(scene, self._threads)
            self._sims[method] = Simulation(
                scene, method, substeps=1, topology=stored, execution=run
            )
        return self._sims[method]


def _least(window: Window) -> int:
    """Count the samples of a window that say something."""
    return -(-LEAST // window.stride)


def _own(measured: _Measured) -> _Plan:
    """The window's own steps, as far as it was judged."""
    window = measured.window
    substeps = window.substeps[: measured.verdict.judged]
    return _Plan(window.method, substeps, window.solver, window.start)


def _agreement(
    shown: errors.Samples,
    finer: errors.Samples,
    before: errors.Samples,
    free: np.ndarray,
    within: float,
    floor: float,
) -> tuple[int, bool]:
    """For how many samples two references differ by at most a third of the error, or by round-off;
    and whether over all of them by so little that no finer one is needed.

    within: the error, in parts of the motion, that is to be told, too. floor: one below which none
    is to be.
    """
    apart, error = (
        _trajectory(errors.rms_by_frame(other, finer, free)) for other in (before, shown)
    )
    scale = errors.displacement(finer, free) or 1.0
    error = np.maximum(error, floor * scale)
    rounding, told = reference.ENOUGH * scale, min(error[-1], within * scale)
    good = np.flatnonzero((apart <= THIRD * error) | (apart <= rounding))
    sure = int(good[-1]) + 1 if len(good) else 0
    return sure, bool(apart[-1] <= AIM * told or apart[-1] <= rounding)


def _trajectory(rms: np.ndarray) -> np.ndarray:
    """The root of the mean square over the samples up to each, after the first, which is the start:
    (samples + 1,) to (samples,).
    """
    count = np.arange(1, len(rms))
    whole: np.ndarray = np.sqrt(np.cumsum(rms[1:] ** 2) / count)
    return whole


def _samples(x: np.ndarray) -> errors.Samples:
    """Positions (samples, n, dim) as samples; nobody asks for what else these have."""
    count = len(x)
    return errors.Samples(x, np.zeros((count, 0, 0)), np.ones((count, 0), bool))


def _missing(before: np.ndarray, now: np.ndarray) -> np.ndarray:
    """The pairs of particles (k, 2) of those before (s, 2) that are not among those of now."""
    left = set(map(tuple, now.tolist()))
    gone = [pair for pair in map(tuple, before.tolist()) if pair not in left]
    return np.array(gone, np.int64).reshape(-1, 2)


def _disturbed(start: Start, size: float) -> Start:
    """The start with its free particles moved at random by `size`."""
    snapshot = start.snapshot
    here = replace(snapshot.scene.particles, position=snapshot.x)
    moved = reference.disturbed(replace(snapshot.scene, particles=here), size)
    return replace(start, snapshot=replace(snapshot, x=moved.particles.position))


def _rate(apart: np.ndarray) -> float:
    """The rate at which a distance grew [1 / sample]; 0 where that cannot be told."""
    grown = float(apart.max()) / float(apart[0]) if apart[0] > 0 else 1.0
    return math.log(grown) / (len(apart) - 1) if grown > GREW else 0.0
