"""What runs in the error meter's process: a window, made again in f64 at finer steps.

The error, the reference's method and the converged solver are those of `trade`.
"""

from __future__ import annotations

import math
import pickle
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.error_meter import ghost
from taichi_cloth.error_meter.verdict import AIM, GREW, MILLIONTH, THIRD, Verdict
from taichi_cloth.error_meter.window import GHOST, STAGE, WINDOW, Window
from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation.acts import do_again
from taichi_cloth.simulation.prediction import slow_to_compile
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
    """How a window is run once more."""

    method: str
    substeps: list[int]
    solver: dict[str, float]
    start: Start


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
        # Between which particles springs broke: in the last run, and in the reference.
        self._broke = self._torn = np.zeros((0, 2), np.int64)
        self._orders = False

    def measure(self, folder: str, patience: float, order: bool = False) -> dict[str, Any]:
        """The verdict on the window in a folder, as a dictionary; the reference is put there, too.

        patience: seconds that the references may take, compiling left out; as many again are there
        for what parts the error. order: whether the window's own order is measured, too.
        """
        self._folder = Path(folder)
        window, begin = self._read(self._folder / WINDOW), time.perf_counter()
        size = float(np.linalg.norm(window.start.snapshot.scene.world.size))
        own = window.substeps[0] if len(set(window.substeps)) == 1 else 0
        verdict = Verdict(
            window.first, window.frames, window.precision, size=size, method=window.method,
            own_substeps=own,
        )  # fmt: skip
        self._orders = order and own > 0
        try:
            verdict = self._verdict(window, verdict, patience)
        except TooSlow:
            trouble = f"the scene is too large to make it again in {patience:g} s"
            verdict = replace(verdict, trouble=trouble)
        except (SimulationFailure, InputError) as failure:
            verdict = replace(verdict, trouble=f"the reference fails: {failure}")
        return asdict(replace(verdict, seconds=time.perf_counter() - begin))

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

    def _verdict(self, window: Window, verdict: Verdict, patience: float) -> Verdict:
        free = ~window.start.snapshot.scene.particles.fixed
        shown = _samples(np.asarray(window.shown, np.float64))
        method = reference.fine_method()
        substeps = reference.coarsest(window.start.snapshot.scene, window.dt, RESOLUTION)

        def run(substeps: int, start: Start = window.start) -> errors.Samples:
            self._tell(f"the reference in {substeps} steps a frame")
            return self._run(window, _Plan(method, [substeps] * window.frames, {}, start))

        plan = _Plan(method, [substeps] * window.frames, {}, window.start)
        self._compile(window, plan, "the reference")
        self._until = time.perf_counter() + patience
        coarsest = run(substeps)
        scale, _ = reference.extent(window.start.snapshot.scene, coarsest)
        finest, finest_substeps, apart = self._refined(run, coarsest, substeps, shown, free)
        error = errors.distance(shown, finest, free).trajectory
        verdict = replace(verdict, error=error, scale=scale, apart=apart, substeps=finest_substeps)
        if apart > THIRD * error:
            what = f"two references differ by {apart / scale:.1e} of the motion"
            what = what if math.isfinite(apart) else "nothing tells what the reference is worth"
            verdict = replace(verdict, trouble=f"{what}, and {patience:g} s allow no finer one")
        ghost.write(self._folder / GHOST, finest.x, shown.x, self._torn)
        self._until = time.perf_counter() + patience
        with suppress(TooSlow):
            other = run(substeps, _disturbed(window.start, MILLIONTH * scale))
            grown = errors.rms_by_frame(coarsest, other, free)
            verdict = replace(verdict, growth=_rate(grown) / window.stride)
            if self._orders:
                verdict = self._ordered(window, verdict, finest, free)
            verdict = self._parted(window, verdict, shown, free)
        return verdict

    def _refined(
        self,
        run: Callable[[int], errors.Samples],
        coarsest: errors.Samples,
        substeps: int,
        shown: errors.Samples,
        free: np.ndarray,
    ) -> tuple[errors.Samples, int, float]:
        """The reference, its substeps, and by how much it differs from the one before.

        It is refined until that is a fifth of the error, or nothing but round-off: across contacts
        and breaks it is about what the finer one is wrong by, else far more.
        """
        finest, apart, self._torn = coarsest, math.inf, self._broke
        with suppress(TooSlow):
            while True:
                finer = run(substeps * FINER)
                apart = errors.distance(finer, finest, free).trajectory
                finest, substeps = finer, substeps * FINER
                self._torn = self._broke
                error = errors.distance(shown, finest, free).trajectory
                scale = errors.displacement(finest, free) or 1.0
                if apart <= AIM * error or apart <= reference.ENOUGH * scale:
                    break
        return finest, substeps, apart

    def _ordered(
        self, window: Window, verdict: Verdict, finest: errors.Samples, free: np.ndarray
    ) -> Verdict:
        """The verdict with the order that the window's own method shows in it.

        Its settings are run in f64, and with twice as many substeps.
        """
        plan = _Plan(window.method, window.substeps, window.solver, window.start)
        self._compile(window, plan, "its order")
        twice = replace(plan, substeps=[2 * n for n in plan.substeps])
        coarse, fine = (
            errors.distance(self._run(window, one), finest, free).trajectory
            for one in (plan, twice)
        )
        if not min(coarse, fine) > 0:
            return verdict
        return replace(verdict, order=math.log2(coarse / fine))

    def _parted(
        self, window: Window, verdict: Verdict, shown: errors.Samples, free: np.ndarray
    ) -> Verdict:
        """The verdict with what solver and rounding made of the error."""
        plan = _Plan(window.method, window.substeps, window.solver, window.start)
        exact = settings.converged(settings.Setting(window.method, window.dt, 1))
        if exact is None and window.precision == "f64":
            return verdict
        self._compile(window, plan, f"{window.method} in f64")
        same = shown
        if window.precision != "f64":
            self._tell("what rounding does")
            same = self._run(window, plan)
            rounding = errors.distance(shown, same, free).trajectory
            verdict = replace(verdict, rounding=rounding)
        if exact is not None:
            given = {"tolerance": exact.tolerance, "iterations": exact.iterations}
            solver = {name: value for name, value in given.items() if value is not None}
            self._tell("what the solver leaves")
            converged = self._run(window, replace(plan, solver={**plan.solver, **solver}))
            verdict = replace(verdict, solver=errors.distance(same, converged, free).trajectory)
        return verdict

    # --- runs ------------------------------------------------------------------------------

    def _compile(self, window: Window, plan: _Plan, what: str) -> None:
        """Have all kernels ready by a frame, which does not count for the patience."""
        if plan.method not in self._sims:
            self._tell(f"compiling {what}")
        before, self._until = self._until, math.inf
        begin = time.perf_counter()
        self._run(window, replace(plan, substeps=plan.substeps[:1]))
        self._until = before + time.perf_counter() - begin

    def _run(self, window: Window, plan: _Plan) -> errors.Samples:
        """The window's frames and acts in another way; TooSlow where they take too long."""
        scene, count = plan.start.snapshot.scene, len(plan.start.snapshot.x)
        sim = self._sims.get(plan.method)
        if sim is None:
            stored, run = conditions.best_for(scene, self._threads)
            if stored in slow_to_compile(scene):
                stored = "graph"
            sim = Simulation(scene, plan.method, topology=stored, execution=run)
            self._sims[plan.method] = sim
        sim.solver.update({k: v for k, v in plan.solver.items() if k in sim.claims.settings})
        sim.begin_from(plan.start, window.dt, plan.substeps[0])
        x, springs = [sim.positions()], sim.drawn_springs()
        for frame, substeps in enumerate(plan.substeps):
            if time.perf_counter() > self._until:
                raise TooSlow
            for act in window.acts.get(frame, ()):
                do_again(sim, act)
            if substeps != sim.substeps:
                sim.set_step(substeps=substeps)
            sim.advance()
            if (frame + 1) % window.stride == 0:
                x.append(sim.positions()[:count])
        self._broke = _missing(springs, sim.drawn_springs())
        return _samples(np.array(x))


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
