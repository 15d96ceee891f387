"""Settings of a study as tasks (`sweeps.tasks`): what is sent, and what is done with it there."""

from __future__ import annotations

import pickle
import platform
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_cloth.errors import one_line
from taichi_cloth.measuring.worker import WorkerFailed
from taichi_cloth.scene.model import Scene
from taichi_cloth.sweeps.tasks import Finished, Task
from taichi_cloth.trade.conditions import RunConditions
from taichi_cloth.trade.outcomes import Outcome, failed_by
from taichi_cloth.trade.process import step_of
from taichi_cloth.trade.records import Records, failure_of, result_of, times_of
from taichi_cloth.trade.settings import Process, Setting

if TYPE_CHECKING:
    from taichi_cloth.trade.trial import Trial

MOST_BYTES = 64_000_000  # of the states that a task sends back, about


class Sender:
    """Makes tasks of settings. compiled: the scene that methods are compiled for, as everywhere."""

    def __init__(self, records: Records, compiled: Scene, how: RunConditions):
        self._records, self._compiled, self._how = records, compiled, how

    def samples(
        self, kind: Process, scene: Scene, of: Sequence[Setting], frames: int
    ) -> Iterator[Task]:
        """Tasks for the samples of settings of one method, several where these are large."""
        size = 16 * (frames + 1) * scene.particles.position.size
        count = max(1, MOST_BYTES // size)
        missing = [s for s in of if self._records.sampled(scene, s, frames) is None]
        for begin in range(0, len(missing), count):
            some = missing[begin : begin + count]
            keys = [self._records.sample_key(scene, setting, frames) for setting in some]
            yield self._task("samples", kind, scene, some, keys, {"frames": frames})

    def times(
        self, kind: Process, scene: Scene, of: Sequence[Setting], frames: int, host: str
    ) -> Task:
        """The task of timing settings of one method, on the machine of this name."""
        keys = [self._records.time_key(scene, setting, frames) for setting in of]
        more = {"frames": frames, "budget": self._how.budget, "host": host}
        return self._task("times", kind, scene, of, keys, more)

    def _task(
        self,
        do: str,
        kind: Process,
        scene: Scene,
        of: Sequence[Setting],
        keys: list[str],
        more: dict[str, Any],
    ) -> Task:
        arguments = {
            "compiled": self._compiled,
            "scene": None if scene is self._compiled else scene,
            "how": {"method": of[0].method, **self._how.of_trial(kind)},
            "asked": list(zip(keys, of, strict=True)),
        }
        name = f"{of[0].method}, {' '.join(kind[:2])}"
        return Task(name, f"{__name__}:{do}", keys, arguments | more)


def samples(
    compiled: Scene,
    scene: Scene | None,
    how: dict[str, Any],
    asked: list[tuple[str, Setting]],
    frames: int,
) -> list[Finished]:
    """The findings of `Trial.sample` on each setting; one that fails by the machine is left out."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file = folder / "samples.npz"
        try:
            trial = _made(compiled, scene, how, folder)
        except Exception as error:
            return [done for one in asked for done in _failed(*one, error, {})]
        found = []
        for key, setting in asked:
            try:
                result = trial.sample(**step_of(setting), frames=frames, file=str(file))
                found.append(Finished(key, result_of(result, trial.about), file.read_bytes()))
            except Exception as error:
                found += _failed(key, setting, error, trial.about)
        return found


def times(
    compiled: Scene,
    scene: Scene | None,
    how: dict[str, Any],
    asked: list[tuple[str, Setting]],
    frames: int,
    budget: float,
    host: str,
) -> list[Finished]:
    """The seconds of each setting's runs on this machine, which has to be the one of this name."""
    if platform.node() != host:
        raise RuntimeError(f"times are taken on {host}, and this is {platform.node()}")
    with tempfile.TemporaryDirectory() as folder:
        trial = _made(compiled, scene, how, Path(folder))
        found = []
        for key, setting in asked:
            seconds = trial.time(**step_of(setting), frames=frames, budget=budget)
            found.append(Finished(key, times_of(seconds, trial.about)))
        return found


def _made(compiled: Scene, scene: Scene | None, how: dict[str, Any], folder: Path) -> Trial:
    """A trial of a scene, which is compiled for another one that differs in numbers, if at all."""
    from taichi_cloth.trade.trial import Trial

    (folder / "compiled").write_bytes(pickle.dumps(compiled))
    trial = Trial(str(folder / "compiled"), **how)
    if scene is not None:
        (folder / "scene").write_bytes(pickle.dumps(scene))
        trial.load(str(folder / "scene"))
    return trial


def _failed(key: str, setting: Setting, error: Exception, about: dict[str, Any]) -> list[Finished]:
    """The kept part of a setting that failed: nothing where the machine was at fault."""
    outcome = failed_by(Outcome(setting, about=about), WorkerFailed(one_line(error)))
    return [] if outcome.lost else [Finished(key, failure_of(outcome))]
