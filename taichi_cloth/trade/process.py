"""The process of one backend, precision and fast_math, in which settings of its methods run."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from taichi_cloth.measuring.worker import Worker, WorkerFailed
from taichi_cloth.scene.model import Scene
from taichi_cloth.trade.conditions import RunConditions
from taichi_cloth.trade.settings import Process, Setting

TRIAL = "taichi_cloth.trade.trial:Trial"
AGAIN = 3  # times that what a process was killed at is asked of another one


class Stopped(Exception):
    """The study was interrupted: a thread ends."""


class TrialProcess:
    """A worker that compiles a method when it is first asked for a run of it.

    scene: that methods are compiled for; runs are of it, or of one that differs in numbers alone.
    folder: temporary, of the study. stop: set where the study is to end. Where the process is
    killed, what was asked of it is asked of another one, AGAIN times.
    """

    def __init__(
        self,
        process: Process,
        scene: Scene,
        how: RunConditions,
        folder: Path,
        stop: threading.Event,
    ):
        self.kind, self._scene, self._how = process, scene, how
        self._folder, self._stop, self._again = folder, stop, AGAIN
        self._worker: Worker | None = None
        self._about: dict[str, dict[str, Any]] = {}  # by method, what its trial says
        self._failed: dict[str, WorkerFailed] = {}  # of methods that cannot be made
        self._loaded: dict[str, Scene] = {}
        self._files: dict[int, tuple[Scene, str]] = {}
        self.tell_made: Callable[[str], None] = lambda method: None

    def __enter__(self) -> TrialProcess:
        return self

    def __exit__(self, *_: object) -> None:
        if self._worker:
            self._worker.close()

    def kill(self) -> None:
        """End the process; a thread that waits for it gets Stopped."""
        if self._worker:
            self._worker.kill()

    def about(self, method: str) -> dict[str, Any]:
        """The words of a method's trial on itself; none where there never was one."""
        return self._about.get(method, {})

    def drop(self, method: str) -> bool:
        """Free a method, of which no more runs are asked; whether it was ever compiled."""
        made = method in self._about
        if self._loaded.pop(method, None) and self._worker and self._worker.alive:
            self._worker.ask(drop=method)
        return made

    def ask(self, setting: Setting, scene: Scene, do: str, **arguments: Any) -> Any:
        """The answer of a `Trial` to a run of a setting on a scene.

        Raises WorkerFailed, or Stopped once the study is to end.
        """
        method = setting.method
        while True:
            try:
                self._prepare(method, scene)
                assert self._worker
                asked = step_of(setting) | arguments
                return self._worker.ask(of=method, do=do, **{"with": asked})["result"]
            except WorkerFailed:
                if self._stop.is_set():
                    raise Stopped from None
                alive = self._worker is not None and self._worker.alive
                if alive or not self._again:
                    raise
                self._again -= 1

    def _prepare(self, method: str, scene: Scene) -> None:
        """See that the process runs, and that a method is compiled in it, with this scene."""
        if self._stop.is_set():
            raise Stopped
        if method in self._failed:
            raise self._failed[method]
        if self._worker is None or not self._worker.alive:
            self._start()
        assert self._worker
        if method not in self._loaded:
            try:
                self._make(method)
            except WorkerFailed as failed:
                if self._worker.alive:
                    self._failed[method] = failed
                raise
        if self._loaded[method] is not scene:
            self._worker.ask(of=method, do="load", **{"with": {"scene": self._file_of(scene)}})
            self._loaded[method] = scene

    def _start(self) -> None:
        if self._worker:
            self._worker.close()
        self._loaded.clear()
        # Else libraries that start threads of their own would disturb what is timed.
        self._worker = Worker(self._folder, {"OMP_NUM_THREADS": "1"})
        if self._stop.is_set():
            self._worker.kill()

    def _make(self, method: str) -> None:
        arguments = {"scene": self._file_of(self._scene), "method": method}
        asked = arguments | self._how.of_trial(self.kind)
        assert self._worker
        about = self._worker.ask(make=TRIAL, **{"as": method, "with": asked})["result"]
        self._about[method], self._loaded[method] = about, self._scene
        self.tell_made(method)

    def _file_of(self, scene: Scene) -> str:
        """A file with a pickled scene, written once."""
        if id(scene) not in self._files:
            name = f"{'-'.join(map(str, self.kind))}-{len(self._files)}.pickle"
            file = self._folder / name
            file.write_bytes(pickle.dumps(scene))
            self._files[id(scene)] = scene, str(file)
        return self._files[id(scene)][1]


def step_of(setting: Setting) -> dict[str, Any]:
    """A setting's step and its solver's numbers, as a trial takes them."""
    given = {"tolerance": setting.tolerance, "iterations": setting.iterations}
    solver = {name: value for name, value in given.items() if value is not None}
    return {"dt": setting.dt, "substeps": setting.substeps, "solver": solver}
