"""The seconds of a study's settings, judged as the error meter judges those of a run."""

from __future__ import annotations

import math
import pickle
import tempfile
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.advice.choice import TimeOver
from taichi_cloth.error_meter.meter import JUDGE, PATIENCE
from taichi_cloth.error_meter.others import Trial
from taichi_cloth.error_meter.verdict import Verdict
from taichi_cloth.error_meter.window import (
    FEW,
    FRAMES,
    LEAST,
    SCENE,
    STRIDE,
    WAITING,
    WINDOW,
    Window,
)
from taichi_cloth.measuring.worker import Worker, WorkerFailed
from taichi_cloth.scene.fingerprint import scene_hash
from taichi_cloth.scene.model import Scene
from taichi_cloth.sweeps.journal import Journal, key_of
from taichi_cloth.sweeps.within import Clock
from taichi_cloth.trade.outcomes import Outcome
from taichi_cloth.trade.seconds import Second, read_starts
from taichi_cloth.trade.settings import Setting

MOST_JUDGES = 2  # processes: each has to compile the references for itself
WAITS = 0.1  # of a limited time: what a second that is not known soon may take


class _Judge:
    """A process that judges windows; it is started when it is first asked."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="taichi-cloth-seconds-")
        self._worker: Worker | None = None
        self._known: Scene | None = None  # what the process has

    def measure(self, window: Window, patience: float, floor: float) -> Verdict:
        """The verdict on a window; one without an error where the process fails."""
        folder = Path(self._folder.name)
        try:
            worker = self._running()
            window.write(folder / WINDOW, self._known)
            self._known = window.start.snapshot.scene
            given = {"folder": str(folder), "patience": patience, "floor": floor}
            answer = worker.ask(of="judge", do="measure", **{"with": given})
            return Verdict(**answer["result"])
        except WorkerFailed as failure:
            return Verdict(window.first, window.frames, trouble=str(failure))

    def survey(self, scene: Scene, clock: Clock, patience: float, **given: Any) -> dict[str, Any]:
        """The next second of a scene's survey (`error_meter.judge.Judge.survey`)."""
        folder = Path(self._folder.name)
        worker = self._running()
        (folder / SCENE).write_bytes(pickle.dumps(scene))
        left = clock.left()
        asked = {"folder": str(folder), "patience": min(patience, max(left, 1.0)), "limit": left}
        asked |= given
        result: dict[str, Any] = worker.ask(of="judge", do="survey", **{"with": asked})["result"]
        return result

    def _running(self) -> Worker:
        """The process, started where there is none."""
        if self._worker is None or not self._worker.alive:
            self.close_worker()
            self._worker = Worker(Path(self._folder.name), {"OMP_NUM_THREADS": "1"})
            self._worker.ask(make=JUDGE, **{"as": "judge", "with": {"threads": None}})
        return self._worker

    def close_worker(self) -> None:
        """End the process."""
        if self._worker is not None:
            self._worker.close()
        self._worker, self._known = None, None

    def close(self) -> None:
        """End the process, and remove what it wrote."""
        self.close_worker()
        self._folder.cleanup()


class Judges:
    """Judges the seconds of settings' runs, some at once.

    journal: has the verdicts that are known, and gets them. floor: an error, in parts of a second's
    motion, below which nobody asks how small it is: that takes no finer reference. within: the time
    of the whole sweep, which bounds what one second may take. spent, windows: seconds that it took
    so far, and how many windows were judged in them. compiled: that a method took to compile.
    """

    def __init__(self, journal: Journal, floor: float = 0.0, within: float = math.inf):
        count = min(MOST_JUDGES, runtime.available_cores())
        self._judges = [_Judge() for _ in range(count)]
        self._pool = ThreadPoolExecutor(count)
        self._journal, self._floor = journal, floor
        self._hashes: dict[int, tuple[Scene, str]] = {}
        self._within, self._waiting = within, min(WAITING, max(PATIENCE, WAITS * within))
        self.spent, self.windows, self.compiled = 0.0, 0, 0.0

    def __enter__(self) -> Judges:
        return self

    def __exit__(self, *_: object) -> None:
        for judge in self._judges:
            judge.close_worker()
        self._pool.shutdown(cancel_futures=True)
        for judge in self._judges:
            judge.close()

    def survey(
        self,
        scene: Scene,
        dt: float,
        seconds: Collection[int],
        trials: Callable[[list[dict[str, Any]]], Sequence[Trial]],
        clock: Clock,
        *,
        error: float,
        relative: bool,
    ) -> list[dict[str, Any]]:
        """The demands of some seconds of a scene, up to the clock's end: in one process.

        trials: of a second, after what was found in those before. error, relative: as `within` and
        `relative` of `Judge.survey`. Fewer seconds where time ends, or the process.
        """
        asked = dt, list(seconds), [asdict(trial) for trial in trials([])], error, relative
        key = key_of("survey", self._hash(scene), *asked)
        entry = self._journal.get(key)
        if entry is not None:
            return list(entry.result)
        found: list[dict[str, Any]] = []
        patience, judge = PATIENCE, self._judges[0]
        for second in range(max(seconds) + 1):
            if clock.left() < 0:
                return found
            of = [asdict(trial) for trial in (trials(found) if second in seconds else ())]
            given: dict[str, Any] = {"dt": dt, "within": error, "relative": relative, "trials": of}
            try:
                result = judge.survey(scene, clock, patience, **given)
                if result["slow"] and patience < WAITING:
                    patience = WAITING
                    result = judge.survey(scene, clock, patience, **given)
            except WorkerFailed:
                return found
            self.compiled = float(result["compiled"])
            if self.compiled > WAITS * self._within:  # another process would have to, too
                for other in self._judges[1:]:
                    other.close()
                self._judges = [judge]
            if second in seconds:
                found.append(result)
            if result["slow"]:
                return found
        self._journal.add(key, found)
        return found

    def seconds(
        self,
        scene: Scene,
        outcome: Outcome,
        clock: Clock,
        *,
        begin: int = 0,
        count: int | None = None,
        fails: Callable[[Second], bool] = lambda second: False,
        thorough: bool = True,
    ) -> list[Second]:
        """The seconds of a setting's run from a frame on, up to the first that fails.

        count: of them at most. thorough: whether a second that cannot be told in the time that a
        window's has is given that of a headless run, as far as the whole time allows. Raises
        TimeOver at the clock's end.
        """
        windows = [w for w in windows_of(scene, outcome) if w.first >= begin][:count]
        now = time.perf_counter()
        try:
            found: dict[int, Second] = {}
            for patience in (PATIENCE, self._waiting)[: 1 + thorough]:
                left = [window for window in windows if not _is_sure(found.get(window.first))]
                self._judge(scene, outcome.setting, left, clock, patience, fails, found)
                if any(map(fails, found.values())):
                    break
        finally:
            self.spent += time.perf_counter() - now
        return [found[first] for first in sorted(found)]

    def _judge(
        self,
        scene: Scene,
        setting: Setting,
        windows: Sequence[Window],
        clock: Clock,
        patience: float,
        fails: Callable[[Second], bool],
        found: dict[int, Second],
    ) -> None:
        """Judge windows, as many at once as there are judges, up to one that fails."""
        step = len(self._judges)
        for begin in range(0, len(windows), step):
            if clock.limited and clock.left() < 0:
                raise TimeOver
            some = windows[begin : begin + step]
            patient = min(patience, max(clock.left(), 1.0))

            def one(judge: _Judge, window: Window, patient: float = patient) -> Second:
                return self._second(scene, setting, window, judge, patience, patient)

            self.windows += len(some)
            for second in self._pool.map(one, self._judges, some):
                found[second.first] = second
            if any(fails(found[window.first]) for window in some):
                return

    def _second(
        self,
        scene: Scene,
        setting: Setting,
        window: Window,
        judge: _Judge,
        patience: float,
        patient: float,
    ) -> Second:
        """A second, from the journal where it is known; patient: seconds that there are for it."""
        key = key_of(
            *("second", self._hash(scene), *astuple(setting), window.first, window.frames),
            *(patience, self._floor),
        )
        entry = self._journal.get(key)
        if entry is not None:
            return Second(**entry.result)
        second = second_of(judge.measure(window, patient, self._floor))
        if patient == patience:
            self._journal.add(key, vars(second))
        return second

    def _hash(self, scene: Scene) -> str:
        if id(scene) not in self._hashes:
            self._hashes[id(scene)] = scene, scene_hash(scene)
        return self._hashes[id(scene)][1]


def _is_sure(second: Second | None) -> bool:
    """True if a second is known as a whole."""
    return second is not None and not second.trouble


def second_of(verdict: Verdict) -> Second:
    """A verdict's numbers on its second: no error where that is not sure.

    Where the error is that of its first part alone, `trouble` says why.
    """
    if not verdict.known or verdict.trouble:
        return Second(verdict.first, trouble=verdict.trouble or "nothing is known of it")
    relative = 0.0 if verdict.resting else verdict.relative
    return Second(verdict.first, verdict.error, relative, verdict.further)


def windows_of(scene: Scene, outcome: Outcome) -> list[Window]:
    """The seconds of a setting's run as the error meter of that run notes them.

    One at its end that is too short to say anything is left out.
    """
    if outcome.file is None:
        return []
    setting, windows = outcome.setting, []
    starts, solver = read_starts(outcome.file, scene)
    with np.load(outcome.file) as file:
        x: np.ndarray = file["x"]
    stride = 1 if len(scene.particles) <= FEW else STRIDE
    of: dict[str, Any] = {"method": setting.method, "dt": setting.dt, "solver": solver}
    for first, start in sorted(starts.items()):
        frames = min(FRAMES, len(x) - 1 - first)
        if frames < LEAST:
            continue
        window = Window(start, first, **of, precision=setting.precision, stride=stride)
        window.substeps = [setting.substeps] * frames
        window.shown = [start.snapshot.x.astype(window.real)]
        window.shown += list(x[first + stride : first + frames + 1 : stride].astype(window.real))
        windows.append(window)
    return windows
