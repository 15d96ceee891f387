"""A study: a scene in many settings, each (backend, precision, fast_math) in its own process.

Processes compile and compute side by side, but whenever one is timed the others wait.
"""

from __future__ import annotations

import contextlib
import pickle
import queue
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.console import Tell, tell_nobody
from taichi_cloth.errors import InputError
from taichi_cloth.measuring.timing import Quiet
from taichi_cloth.measuring.worker import Worker, WorkerFailed
from taichi_cloth.scene.model import Scene
from taichi_cloth.trade import ode, reference, settings
from taichi_cloth.trade.conditions import RunConditions
from taichi_cloth.trade.errors import Samples
from taichi_cloth.trade.outcomes import (
    LOST_REMEDY,
    REFUSED,
    Outcome,
    Result,
    StudyFailure,
    failed_by,
)
from taichi_cloth.trade.settings import Process, Setting

TRIAL = "taichi_cloth.trade.trial:Trial"
EXACT: Process = ("cpu", "f64", False)  # the process of the references
MAKING = 4  # how much longer compiling a method takes than running a setting, about
# Particles times steps times sweeps of a converged solver that are worth the wait: half a minute.
CONVERGED_WORK = 1e9
SWEEPS_TO_CONVERGE = 50  # of a solver that ends by its tolerance, about


class Stopped(Exception):
    """The study was interrupted: a thread ends."""


@dataclass(frozen=True)
class _RemoteTrial:
    """A method's `Trial` in a worker, known there by the method's name; about: what it says."""

    worker: Worker
    method: str
    about: dict[str, Any]


class _Course:
    """What is found out about one scene while the study runs."""

    def __init__(self, scene: Scene, closed: Callable[[np.ndarray], Samples | None]):
        self.scene, self.closed = scene, closed
        self.outcomes: dict[Setting, Outcome] = {}
        self.converged: dict[Setting, Outcome] = {}
        self.horizon: reference.Horizon | None = None
        self.horizon_known = threading.Event()
        self.fine: list[tuple[str, Samples]] = []
        self.smooth: ode.SmoothTrajectory | None = None

    def result(
        self, wanted: Sequence[Setting], dt: float, interrupted: KeyboardInterrupt | None
    ) -> Result:
        found = None
        if self.horizon:
            frames = self.horizon.frames
            times = np.arange(frames + 1) * dt
            closed, end = self.closed(times), float(times[-1])
            found = reference.decide(self.scene, frames, closed, self.smooth, end, self.fine)
        outcomes = [self.outcomes[setting] for setting in wanted if setting in self.outcomes]
        return Result(self.scene, outcomes, self.converged, self.horizon, found, interrupted)


class Study:
    """Runs settings of a scene, or of several that differ in numbers alone, compiled once.

    scenes: without a mouse. frames: the horizon asked for. how: what all runs share. closed: the
    first scene's closed form at given times, or None. tell, to be set: shown what is done.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        chosen: Sequence[Setting],
        frames: int,
        how: RunConditions,
        closed: Callable[[np.ndarray], Samples | None] = lambda times: None,
    ):
        self.settings, self.how = list(chosen), how
        self.tell: Tell = tell_nobody
        self._asked, self._dt = frames, self.settings[0].dt
        self._courses = [_Course(scene, lambda times: None) for scene in scenes]
        self._courses[0].closed = closed
        self._wanted = set(self.settings)
        self._folder = tempfile.TemporaryDirectory(prefix="taichi-cloth-trade-")
        self.folder = Path(self._folder.name)
        self._workers: list[Worker] = []
        self._quiet, self._stop = Quiet(), threading.Event()
        self._news: queue.Queue[tuple[str, int]] = queue.Queue()
        self._files = 0
        self._lock = threading.Lock()

    def close(self) -> None:
        """End all processes and remove what they wrote."""
        for worker in self._workers:
            worker.close()
        self._folder.cleanup()

    # --- the course of a study -----------------------------------------------------------

    def run(self) -> list[Result]:
        """Run everything; what was found for each scene. An interrupt ends it with what is done.

        Raises StudyFailure where not even a reference can be computed.
        """
        groups = self._groups()
        total = MAKING * sum(len(methods) for methods in groups.values())
        total += len(self._courses) * (
            2 * MAKING + sum(len(of) for methods in groups.values() for of in methods.values())
        )
        done = 0
        interrupted: KeyboardInterrupt | None = None
        failure: BaseException | None = None
        threads = 1 + min(len(groups), runtime.available_cores())
        with ThreadPoolExecutor(max_workers=threads) as pool:
            try:
                tasks = [pool.submit(self._solve)]
                tasks += [pool.submit(self._run_group, key, of) for key, of in groups.items()]
                self.tell("starting", 0, total)
                while any(not task.done() for task in tasks) or not self._news.empty():
                    with contextlib.suppress(queue.Empty):
                        text, units = self._news.get(timeout=0.1)
                        done += units
                        self.tell(text, min(done, total), total)
                    failed = [task.exception() for task in tasks if task.done()]
                    failure = next((f for f in failed if f is not None), None)
                    if failure:
                        break
            except KeyboardInterrupt as interrupt:
                interrupted = interrupt
            self._stop.set()
            for course in self._courses:
                course.horizon_known.set()
            for worker in list(self._workers):
                worker.kill()
        if isinstance(failure, WorkerFailed):
            if str(failure).startswith(REFUSED):
                raise InputError(str(failure).removeprefix(REFUSED))
            raise StudyFailure(f"the process of the references: {failure}; {LOST_REMEDY}")
        if failure:
            raise failure
        return [course.result(self.settings, self._dt, interrupted) for course in self._courses]

    def _groups(self) -> dict[Process, dict[str, list[Setting]]]:
        """Settings by process and method, that of the references first."""
        groups: dict[Process, dict[str, list[Setting]]] = {EXACT: {reference.fine_method(): []}}
        for setting in self.settings:
            of = groups.setdefault(setting.process, {}).setdefault(setting.method, [])
            of.append(setting)
        for setting in self.settings:
            exact = settings.converged(setting)
            if exact is None or not self.how.solver_errors:
                continue
            if self._cost_of(exact) > CONVERGED_WORK:
                continue
            of = groups[EXACT].setdefault(setting.method, [])
            if exact not in of:
                of.append(exact)
        return groups

    def _cost_of(self, exact: Setting) -> float:
        """Particles times steps times sweeps."""
        particles = len(self._courses[0].scene.particles)
        sweeps = exact.iterations or SWEEPS_TO_CONVERGE
        return float(particles) * self._asked * exact.substeps * sweeps

    # --- in threads ----------------------------------------------------------------------

    def _solve(self) -> None:
        """The smooth solutions, in this process."""
        times = np.arange(self._asked + 1) * self._dt

        def tell(done: float) -> None:
            if self._stop.is_set():
                raise Stopped

        with contextlib.suppress(Stopped):
            for course in self._courses:
                with self._quiet.working():
                    course.smooth = ode.solve(course.scene, times, self.how.patience, tell)
                self._news.put(("the differential equation is solved", MAKING))

    def _run_group(self, process: Process, methods: dict[str, list[Setting]]) -> None:
        """All of one process; the first one finds the references."""
        worker = self._start()
        try:
            for number, (method, of) in enumerate(methods.items()):
                finds_references = process == EXACT and number == 0
                try:
                    with self._quiet.working():
                        trial = self._make(worker, method, process)
                except WorkerFailed as failed:
                    if finds_references or self._stop.is_set():
                        raise
                    for course in self._courses:
                        for setting in of:
                            self._finish(course, failed_by(Outcome(setting), failed))
                    if not worker.alive:
                        worker = self._start()
                    continue
                if finds_references:
                    with self._quiet.working():
                        for course in self._courses:
                            self._find_references(trial, course)
                for course in self._courses:
                    self._run_settings(trial, of, course)
                if worker.alive:
                    worker.ask(drop=method)
                else:
                    worker = self._start()
        except (Stopped, WorkerFailed):
            if not self._stop.is_set():
                raise

    def _run_settings(self, trial: _RemoteTrial, of: list[Setting], course: _Course) -> None:
        """Errors of all settings of one method, then, alone, their times."""
        course.horizon_known.wait()
        if self._stop.is_set() or course.horizon is None:
            raise Stopped
        frames = course.horizon.frames
        outcomes = []
        with self._quiet.working():
            self._ask(trial, "load", scene=self._keep(course.scene))
            for setting in of:
                outcomes.append(self._sample(trial, setting, frames))
        with self._quiet.alone():
            for outcome in outcomes:
                if outcome.ok and outcome.setting in self._wanted:
                    self._time(trial, outcome, frames)
        for outcome in outcomes:
            self._finish(course, outcome)

    def _find_references(self, trial: _RemoteTrial, course: _Course) -> None:
        """The horizon, then fine runs within it."""
        scene, method = course.scene, trial.method
        substeps = reference.coarsest(scene, self._dt)

        def run(substeps: int, frames: int) -> Samples:
            outcome = self._sample(trial, Setting(method, self._dt, substeps), frames)
            if not outcome.ok:
                failed = outcome.status.removeprefix("failed: ")
                if outcome.lost:
                    raise StudyFailure(f"the reference was lost: {failed}; {LOST_REMEDY}")
                raise StudyFailure(
                    f"the reference ({method} in f64, {substeps} substeps) fails: {failed}; "
                    "use fewer --frames, a smaller --dt or softer springs"
                )
            return outcome.samples()

        self._ask(trial, "load", scene=self._keep(scene))
        first = run(substeps, self._asked)
        size = reference.DISTURBANCE * reference.extent(scene, first)[0]
        other = reference.disturbed(scene, size)
        self._ask(trial, "load", scene=self._keep(other))
        second = run(substeps, self._asked)
        self._ask(trial, "load", scene=self._keep(scene))
        horizon = course.horizon = reference.limit_horizon(scene, first, second)
        course.horizon_known.set()
        self._news.put((horizon.describe(), MAKING // 2))

        begin = last = time.perf_counter()

        def timed(substeps: int) -> Samples:
            nonlocal last
            last = time.perf_counter()
            samples = run(substeps, horizon.frames)
            course.fine.append((f"{method} in f64 with {substeps} substeps", samples))
            self._news.put((f"reference: {substeps} substeps", 0))
            return samples

        def enough(times_longer: float) -> bool:
            now = time.perf_counter()
            return now - begin + times_longer * (now - last) > self.how.patience

        reference.refine(timed, scene, substeps, enough)
        self._news.put(("the references are there", MAKING // 2))

    # --- one request each ----------------------------------------------------------------

    def _start(self) -> Worker:
        # Else libraries that start threads of their own would disturb what is timed.
        worker = Worker(self.folder, {"OMP_NUM_THREADS": "1"})
        with self._lock:
            self._workers.append(worker)
        if self._stop.is_set():
            worker.kill()
        return worker

    def _make(self, worker: Worker, method: str, process: Process) -> _RemoteTrial:
        arch, precision, fast_math = process
        arguments = {
            "scene": self._keep(self._courses[0].scene),
            "method": method,
            "arch": arch,
            "precision": precision,
            "fast_math": fast_math,
            "threads": self.how.threads if arch == "cpu" else None,
            "topology": self.how.topology,
            "execution": "parallel" if arch != "cpu" else self.how.execution,
        }
        about = worker.ask(make=TRIAL, **{"as": method, "with": arguments})["result"]
        self._news.put((f"{method}, {arch} {precision}", MAKING))
        return _RemoteTrial(worker, method, about)

    def _ask(self, trial: _RemoteTrial, do: str, **arguments: Any) -> Any:
        """What a method of the trial answers; raises Stopped once the study is to end."""
        if self._stop.is_set():
            raise Stopped
        try:
            return trial.worker.ask(of=trial.method, do=do, **{"with": arguments})["result"]
        except WorkerFailed:
            if self._stop.is_set():
                raise Stopped from None
            raise

    def _sample(self, trial: _RemoteTrial, setting: Setting, frames: int) -> Outcome:
        """A setting's samples and work; a run that fails is an outcome, too."""
        outcome, file = Outcome(setting, about=trial.about), self._new_file(".npz")
        try:
            found = self._ask(trial, "sample", **_step(setting), frames=frames, file=str(file))
        except WorkerFailed as failed:
            return failed_by(outcome, failed)
        outcome.file = file
        outcome.status = found["failed"] or "ok"
        outcome.force_evaluations = found["force_evaluations"]
        outcome.sweeps, outcome.unconverged = found["sweeps"], found["unconverged"]
        return outcome

    def _time(self, trial: _RemoteTrial, outcome: Outcome, frames: int) -> None:
        budget = self.how.budget
        try:
            outcome.seconds = self._ask(
                trial, "time", **_step(outcome.setting), frames=frames, budget=budget
            )
        except WorkerFailed as failed:
            failed_by(outcome, failed)

    def _finish(self, course: _Course, outcome: Outcome) -> None:
        """Keep an outcome: of a setting that is compared, of a converged solver, or of both."""
        if outcome.setting in self._wanted:
            course.outcomes[outcome.setting] = outcome
        if settings.converged(outcome.setting) == outcome.setting and outcome.ok:
            course.converged[outcome.setting] = outcome
        self._news.put((outcome.setting.describe(), 1))

    def _new_file(self, suffix: str) -> Path:
        with self._lock:
            self._files += 1
            return self.folder / f"{self._files}{suffix}"

    def _keep(self, scene: Scene) -> str:
        file = self._new_file(".pickle")
        file.write_bytes(pickle.dumps(scene))
        return str(file)


def _step(setting: Setting) -> dict[str, Any]:
    given = {"tolerance": setting.tolerance, "iterations": setting.iterations}
    solver = {name: value for name, value in given.items() if value is not None}
    return {"dt": setting.dt, "substeps": setting.substeps, "solver": solver}
