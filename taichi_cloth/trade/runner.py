"""A study: a scene in many settings, each (backend, precision, fast_math) in its own process.

Processes compile and compute side by side, but whenever one is timed the others wait.
"""

from __future__ import annotations

import contextlib
import math
import queue
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.console import Tell, tell_nobody
from taichi_cloth.errors import InputError
from taichi_cloth.measuring.timing import Quiet
from taichi_cloth.measuring.worker import WorkerFailed
from taichi_cloth.scene.model import Scene
from taichi_cloth.sweeps.journal import Journal
from taichi_cloth.sweeps.tasks import Elsewhere, Task, fill
from taichi_cloth.trade import ode, reference, settings
from taichi_cloth.trade.conditions import RunConditions
from taichi_cloth.trade.elsewhere import Sender
from taichi_cloth.trade.errors import Samples
from taichi_cloth.trade.outcomes import (
    LOST_REMEDY,
    UNTIMED,
    Outcome,
    Result,
    StudyFailure,
    failed_by,
)
from taichi_cloth.trade.pace import Pace, Share, left_out, rank
from taichi_cloth.trade.process import AGAIN, Stopped, TrialProcess
from taichi_cloth.trade.records import Records
from taichi_cloth.trade.settings import Process, Setting

EXACT: Process = ("cpu", "f64", False)  # the process of the references
MAKING = 4  # how much longer compiling a method takes than running a setting, about
# Particles times steps times sweeps of a converged solver that are worth the wait: half a minute.
CONVERGED_WORK = 1e9
FIRST = 1, 4  # frames of the first timing, whose second run counts
SWEEPS_TO_CONVERGE = 50  # of a solver that ends by its tolerance, about


class _Course:
    """The findings on one scene while the study runs."""

    def __init__(self, scene: Scene, closed: Callable[[np.ndarray], Samples | None]):
        self.scene, self.closed = scene, closed
        self.outcomes: dict[Setting, Outcome] = {}
        self.converged: dict[Setting, Outcome] = {}
        self.horizon: reference.Horizon | None = None
        self.frames: int | None = None  # that settings run
        self.frames_known = threading.Event()
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
        return Result(
            self.scene, outcomes, self.converged, self.horizon, found, interrupted, self.frames
        )


class Study:
    """Runs settings of a scene, or of several that differ in numbers alone, compiled once.

    scenes: without a mouse. frames: the horizon asked for. how: what all runs share. closed: the
    first scene's closed form at given times, or None. journal: has what is finished, and gets it;
    without one it is kept as long as the study. elsewhere: where errors are measured, but for the
    references, and times; None: all here. tell, to be set: shown what is done. lost: tasks that
    were lost elsewhere and done here instead, a line each.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        chosen: Sequence[Setting],
        frames: int,
        how: RunConditions,
        closed: Callable[[np.ndarray], Samples | None] = lambda times: None,
        journal: Journal | None = None,
        elsewhere: Elsewhere | None = None,
    ):
        self.settings, self.how = list(chosen), how
        self.tell: Tell = tell_nobody
        self._asked, self._dt = frames, self.settings[0].dt
        self._wished, self._planned = frames, threading.Event()
        self._computing = threading.Event()  # the reference is, so there is time to compile beside
        self._pace = Pace(how.clock)
        self._courses = [_Course(scene, lambda times: None) for scene in scenes]
        self._courses[0].closed = closed
        self._wanted = set(self.settings)
        self._folder = tempfile.TemporaryDirectory(prefix="taichi-cloth-trade-")
        self.folder = Path(self._folder.name)
        self._closes_journal = journal is None
        if journal is None:
            journal = Journal(self.folder, {}, within=how.clock.seconds)
        self._records = Records(journal)
        self._processes: list[TrialProcess] = []
        self._elsewhere, self._came = elsewhere, threading.Event()
        self.lost: list[str] = []
        self._sender = Sender(self._records, scenes[0], how)
        self._quiet, self._stop = Quiet(), threading.Event()
        self._news: queue.Queue[tuple[str, int]] = queue.Queue()

    def close(self) -> None:
        """End all processes and remove what they wrote."""
        if self._closes_journal:
            self._records.journal.discard()
        self._folder.cleanup()

    # --- the course of a study -----------------------------------------------------------

    def run(self) -> list[Result]:
        """Run everything; what was found for each scene. An interrupt ends it with what is done.

        Raises StudyFailure where not even a reference can be computed.
        """
        groups = self._groups()
        total = MAKING * sum(len(methods) for methods in groups.values())
        total += len(self._courses) * (
            2 * MAKING * self.how.references
            + sum(len(of) for methods in groups.values() for of in methods.values())
        )
        if not self.how.references:
            self._begin_at_once()
        done = 0
        interrupted: KeyboardInterrupt | None = None
        failure: BaseException | None = None
        threads = 2 + min(len(groups), runtime.available_cores())
        with ThreadPoolExecutor(max_workers=threads) as pool:
            try:
                tasks = [pool.submit(self._solve)] if self.how.references else []
                tasks.append(pool.submit(self._send, groups))
                tasks += [pool.submit(self._run_group, key, of) for key, of in groups.items()]
                total = max(total, 1)
                self.tell("starting", 0, total)
                while any(not task.done() for task in tasks) or not self._news.empty():
                    with contextlib.suppress(queue.Empty):
                        text, units = self._news.get(timeout=0.1)
                        done += units
                        self.tell(text, min(done, total), total)
                    failed = [task.exception() for task in tasks if task.done()]
                    failure = next((f for f in failed if f is not None), None)
                    if failure or self._pace.over(self._referenced):
                        break
            except KeyboardInterrupt as interrupt:
                interrupted = interrupt
            self._stop.set()
            self._planned.set()
            self._computing.set()
            for course in self._courses:
                course.frames_known.set()
            self._came.set()
            for process in list(self._processes):
                process.kill()
        if isinstance(failure, WorkerFailed):
            raise StudyFailure(f"a process of the study: {failure}; {LOST_REMEDY}")
        if failure:
            raise failure
        for course in self._courses:
            self._take_finished(course)
        found = [course.result(self.settings, self._dt, interrupted) for course in self._courses]
        for result in found:
            if not interrupted:
                self._say_left_out(result)
        return found

    @property
    def _referenced(self) -> bool:
        """True if there is what settings are compared to, where that is asked for."""
        return not self.how.references or len(self._courses[-1].fine) > 1

    def _begin_at_once(self) -> None:
        """Have settings run without waiting for references."""
        self._planned.set()
        self._computing.set()
        for course in self._courses:
            course.frames = self._wished
            course.frames_known.set()

    def _take_finished(self, course: _Course) -> None:
        """Take what an earlier run has finished and this one, in its time, did not come to."""
        if course.frames is None:
            return
        exact = filter(None, map(settings.converged, self.settings))
        for setting in {*self.settings, *exact} - course.outcomes.keys() - course.converged.keys():
            outcome = self._records.sampled(course.scene, setting, course.frames)
            if outcome is None:
                continue
            wanted = outcome.ok and setting in self._wanted
            if not wanted or self._records.timed(course.scene, outcome, course.frames):
                self._finish(course, outcome)

    def _say_left_out(self, result: Result) -> None:
        """Note in a result the time that there was, and what was left out for it."""
        result.clock, result.longest = self.how.clock, self._pace.longest
        result.left_out = left_out(result.clock, self.settings, result.outcomes)
        if self._asked < self._wished:
            lacking = f"frames {self._asked + 1} to {self._wished}"
            result.left_out.insert(0, f"{lacking}, for which references would take too long")

    def _groups(self) -> dict[Process, dict[str, list[Setting]]]:
        """Settings by process and method, that of the references first."""
        groups: dict[Process, dict[str, list[Setting]]] = {}
        if self.how.references:
            groups[EXACT] = {reference.fine_method(): []}
        for setting in self.settings:
            of = groups.setdefault(setting.process, {}).setdefault(setting.method, [])
            of.append(setting)
        if self.how.clock.limited:  # what compiles soonest first
            first = [reference.fine_method()] * self.how.references
            for kind, methods in groups.items():
                order = sorted(methods, key=lambda name: (name not in first, rank(name)))
                groups[kind] = {name: methods[name] for name in order}
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
        self._planned.wait()
        times = np.arange(self._asked + 1) * self._dt

        def tell(done: float) -> None:
            if self._stop.is_set():
                raise Stopped

        with contextlib.suppress(Stopped):
            for course in self._courses:
                course.smooth = self._records.solved(course.scene, times)
                if course.smooth is None:
                    with self._quiet.working():
                        patience = self._pace.patience(self.how.patience)
                        course.smooth = ode.solve(course.scene, times, patience, tell)
                    self._records.keep_solution(course.scene, times, course.smooth)
                self._news.put(("the differential equation is solved", MAKING))

    def _send(self, groups: dict[Process, dict[str, list[Setting]]]) -> None:
        """Have the samples of the processor taken elsewhere; what is lost there is run here."""
        tasks: list[Task] = []
        for course in self._courses if self._elsewhere else ():
            course.frames_known.wait()
            if self._stop.is_set() or course.frames is None:
                return
            frames = course.frames
            for kind, methods in groups.items():
                # GPUs differ by machine, and so do errors on them.
                for of in filter(None, methods.values() if kind[0] == "cpu" else ()):
                    tasks += self._sender.samples(kind, course.scene, of, frames)
        if self._elsewhere:
            self.lost = fill(
                self._records.journal,
                tasks,
                self._elsewhere.executor,
                lambda task: self._news.put((task.name, 0)),
                lambda: self._stop.is_set() or self.how.clock.left() < self._pace.timing,
                self._elsewhere.gone,
            )
        self._came.set()

    def _run_group(self, kind: Process, methods: dict[str, list[Setting]]) -> None:
        """All of one process; the first one finds the references."""
        first = self._courses[0].scene
        with TrialProcess(kind, first, self.how, self.folder, self._stop) as process:
            self._processes.append(process)
            process.tell_made = lambda method: self._news.put(
                (f"{method}, {' '.join(kind[:2])}", MAKING)
            )
            try:
                if kind != EXACT and not self._elsewhere:
                    self._compile_ahead(process, next(filter(None, methods.values())))
                for number, (method, of) in enumerate(methods.items()):
                    if kind == EXACT and number == 0 and self.how.references:
                        with self._quiet.working():
                            for course in self._courses:
                                self._find_references(process, method, course)
                    for course in self._courses:
                        self._run_settings(process, of, course, list(methods)[number + 1 :])
                    if not process.drop(method):
                        self._news.put((f"{method}, {' '.join(kind[:2])}", MAKING))
            except (Stopped, WorkerFailed):
                if not self._stop.is_set():
                    raise

    def _compile_ahead(self, process: TrialProcess, of: list[Setting]) -> None:
        """Compile a process's first method while the first frames of the reference are computed.

        Nothing else could: no setting runs before the horizon is known. Where the reference has
        been computed by an earlier run there is nothing to wait for.
        """
        course = self._courses[0]
        self._computing.wait()
        if course.frames_known.is_set() or self._stop.is_set():
            return
        begin = time.monotonic()
        # What cannot be compiled is an outcome of the settings that are asked for later.
        with self._quiet.working(), contextlib.suppress(WorkerFailed):
            process.ask(of[0], course.scene, "compile")
            self._pace.compiled(of[0].method, time.monotonic() - begin)

    def _run_settings(
        self, process: TrialProcess, of: list[Setting], course: _Course, later: Sequence[str]
    ) -> None:
        """Errors of all settings of one method, of what fits in the time, then, alone, their times.

        later: the methods of this process that are still to come: those that fit have a share, too.
        """
        course.frames_known.wait()
        self._came.wait()
        if self._stop.is_set() or course.frames is None:
            raise Stopped
        scene, frames = course.scene, course.frames
        with self._quiet.working():
            seconds = self._pace.share(1 + sum(map(self._pace.fits, later)))
            outcomes = self._sample_fitting(process, scene, of, frames, seconds)
        wanted = [of for of in outcomes if of.ok and of.setting in self._wanted]
        missing = [of for of in wanted if not self._records.timed(scene, of, frames)]
        for outcome in outcomes:
            if outcome not in missing:
                self._finish(course, outcome)
        if missing:
            with self._quiet.alone():
                for outcome in self._time(process, scene, missing, frames):
                    self._finish(course, outcome)

    def _sample_fitting(
        self,
        process: TrialProcess,
        scene: Scene,
        of: list[Setting],
        frames: int,
        seconds: float,
    ) -> list[Outcome]:
        """The samples of settings of one method: those that an earlier run has taken, and those
        that fit in so many seconds.
        """
        begin = time.monotonic()
        share = Share(seconds, self.how.budget)
        outcomes: list[Outcome] = []
        ran = False
        for setting in of:
            outcome = self._records.sampled(scene, setting, frames)
            if outcome is None:
                made = bool(process.about(setting.method))
                fits = share.fits(setting) if ran else self._pace.fits(setting.method, made)
                if not fits or (not ran and self._is_too_long(process, scene, setting, frames)):
                    continue
                outcome = self._sample(process, scene, setting, frames)
                if not made:
                    took = time.monotonic() - begin - outcome.sampled_in
                    self._pace.compiled(setting.method, took)
                share.took(outcome)
                ran = True
            outcomes.append(outcome)
        return outcomes

    def _is_too_long(
        self, process: TrialProcess, scene: Scene, setting: Setting, frames: int
    ) -> bool:
        """True if a run of the whole horizon ends after the time does, by its first frames."""
        if not (self.how.whole and self.how.clock.limited and frames > FIRST[-1]):
            return False
        few = self._sample(process, scene, setting, FIRST[-1])
        return self._pace.is_too_long(few.sampled_in / FIRST[-1] * frames)

    def _plan(self, process: TrialProcess, first: Setting) -> None:
        """Cut the horizon to what can be compared in the time there is, by a first timing; where a
        sweep goes on, to what it was cut to when it began.
        """
        journal = self._records.journal
        begun = journal.get("frames")
        if begun is None and math.isfinite(journal.within) and not self._planned.is_set():
            begun = journal.add("frames", self._fitting(process, first))
        if begun is not None:
            self._asked = begun.result
        self._planned.set()

    def _fitting(self, process: TrialProcess, first: Setting) -> int:
        """The frames that can be compared in the time there is."""
        if not self.how.clock.limited:
            return self._asked
        begin = time.monotonic()
        # The first run of a process compiles more than the method.
        few = [self._sample(process, self._courses[0].scene, first, n) for n in FIRST]
        self._pace.compiled(first.method, time.monotonic() - begin)
        return self._pace.frames(self._asked, few[-1].sampled_in / FIRST[-1])

    def _find_references(self, process: TrialProcess, method: str, course: _Course) -> None:
        """The horizon, then fine runs within it."""
        scene = course.scene
        substeps = reference.coarsest(scene, self._dt)

        def run(substeps: int, frames: int, of: Scene = scene) -> Outcome:
            outcome = self._sample(process, of, Setting(method, self._dt, substeps), frames)
            _check_reference(outcome)
            return outcome

        self._plan(process, Setting(method, self._dt, substeps))
        first = run(substeps, self._asked).samples()
        size = reference.DISTURBANCE * reference.extent(scene, first)[0]
        second = run(substeps, self._asked, reference.disturbed(scene, size)).samples()
        horizon = course.horizon = reference.limit_horizon(scene, first, second)
        course.frames = self._wished if self.how.whole else horizon.frames
        course.frames_known.set()
        self._computing.set()
        self._news.put((horizon.describe(), MAKING // 2))

        spent = last = 0.0

        def timed(substeps: int) -> Samples:
            nonlocal spent, last
            outcome = run(substeps, horizon.frames)
            spent, last = spent + outcome.sampled_in, outcome.sampled_in
            samples = outcome.samples()
            course.fine.append((f"{method} in f64 with {substeps} substeps", samples))
            self._news.put((f"reference: {substeps} substeps", 0))
            return samples

        def enough(times_longer: float) -> bool:
            return spent + times_longer * last > self._pace.patience(self.how.patience)

        reference.refine(timed, scene, substeps, enough)
        self._news.put(("the references are there", MAKING // 2))

    # --- one request each ----------------------------------------------------------------

    def _sample(
        self, process: TrialProcess, scene: Scene, setting: Setting, frames: int
    ) -> Outcome:
        """A setting's samples and work; a run that fails is an outcome, too."""
        outcome = self._records.sampled(scene, setting, frames)
        if outcome is not None:
            return outcome
        self._computing.set()
        file = self._records.journal.new_file(".npz")
        try:
            found = process.ask(setting, scene, "sample", frames=frames, file=str(file))
        except WorkerFailed as failed:
            outcome = failed_by(Outcome(setting, about=process.about(setting.method)), failed)
            self._records.keep_failure(scene, setting, frames, outcome)
            return outcome
        about = process.about(setting.method)
        return self._records.keep_sample(scene, setting, frames, found, about, file)

    def _time(
        self, process: TrialProcess, scene: Scene, outcomes: list[Outcome], frames: int
    ) -> Iterator[Outcome]:
        """Take the times of settings of one method, here or where times are taken; each outcome,
        as soon as it has them: an end of the time comes when it will.
        """
        if self._elsewhere and self._elsewhere.timing:
            self._time_elsewhere(self._elsewhere, process.kind, scene, outcomes, frames)
            yield from outcomes
            return
        budget = self.how.budget
        for outcome in outcomes:
            setting = outcome.setting
            try:
                seconds = process.ask(setting, scene, "time", frames=frames, budget=budget)
            except WorkerFailed as failed:
                failed_by(outcome, failed)
            else:
                about = process.about(setting.method)
                self._records.keep_times(scene, outcome, frames, seconds, about)
            yield outcome

    def _time_elsewhere(
        self, there: Elsewhere, kind: Process, scene: Scene, outcomes: list[Outcome], frames: int
    ) -> None:
        """The same on the machine that is timed; what is lost there is timed nowhere else."""
        assert there.timing
        of = [outcome.setting for outcome in outcomes]
        task = self._sender.times(kind, scene, of, frames, there.timed_on)
        lost = [""]
        for _ in range(1 + AGAIN):
            journal = self._records.journal
            lost = fill(journal, [task], there.timing, stop=self._stop.is_set, gone=there.gone)
            if self._stop.is_set():
                raise Stopped
            if not lost:
                break
        for outcome in outcomes:
            if not self._records.timed(scene, outcome, frames):
                failed_by(outcome, WorkerFailed(f"{UNTIMED}{there.timed_on} ({''.join(lost)})"))

    def _finish(self, course: _Course, outcome: Outcome) -> None:
        """Keep an outcome: of a setting that is compared, of a converged solver, or of both."""
        if outcome.setting in self._wanted:
            course.outcomes[outcome.setting] = outcome
            self._pace.found |= outcome.ok and bool(outcome.seconds)
        if settings.converged(outcome.setting) == outcome.setting and outcome.ok:
            course.converged[outcome.setting] = outcome
        self._news.put((outcome.setting.describe(), 1))


def _check_reference(outcome: Outcome) -> None:
    """Raise what a run of the reference failed by."""
    if outcome.ok:
        return
    if outcome.status.startswith("refused: "):
        raise InputError(outcome.status.removeprefix("refused: "))
    failed = outcome.status.removeprefix("failed: ")
    if outcome.lost:
        raise StudyFailure(f"the reference was lost: {failed}; {LOST_REMEDY}")
    setting = outcome.setting
    raise StudyFailure(
        f"the reference ({setting.method} in f64, {setting.substeps} substeps) fails: {failed}; "
        "use fewer --frames, a smaller --dt or softer springs"
    )
