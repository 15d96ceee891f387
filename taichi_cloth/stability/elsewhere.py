"""A method's limit and maps as a task (`sweeps.tasks`): what is sent, and what is done with it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.limits.network import Network
from taichi_cloth.scene.model import Scene
from taichi_cloth.stability import experiment
from taichi_cloth.stability.experiment import StepLimits, TellRun
from taichi_cloth.sweeps.journal import Journal
from taichi_cloth.sweeps.tasks import Elsewhere, Finished, Task, fill, finished_by


def measure(
    scene: Scene,
    limits: Sequence[StepLimits],
    tell: TellRun,
    journal: Journal,
    there: Elsewhere,
    stop: Callable[[], bool] = lambda: False,
) -> list[str]:
    """Have a journal filled with what `experiment.measure` of each method finds.

    Takes what that takes, and stop: whether to leave the rest. Returns why tasks were lost, a line
    each.
    """
    tasks = [_task(scene, of.method, journal) for of in limits if not math.isinf(of.limit.dt)]
    return fill(journal, tasks, there.executor, lambda task: tell(task.name, ""), stop, there.gone)


def _task(scene: Scene, method: str, journal: Journal) -> Task:
    keys = experiment.keys_of(scene, method)
    known = {key: entry.result for key in keys if (entry := journal.get(key))}
    arguments = {"scene": scene, "method": method, "known": known}
    return Task(method, f"{__name__}:measured", keys, arguments)


def measured(scene: Scene, method: str, known: dict[str, Any]) -> list[Finished]:
    """Findings of `experiment.measure` on a method; known: those known already, by key."""
    np.seterr(all="ignore")  # numbers that overflow are the watchdog's to report
    runtime.start("cpu", "f64")
    limits = experiment.computed(method, Network.from_scene(scene))

    def work(journal: Journal) -> None:
        experiment.measure(scene, limits, [], lambda *_: None, journal)

    return finished_by(work, known)
