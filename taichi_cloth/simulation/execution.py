"""Lanes or graph, serial or parallel: which is fastest for a scene on this machine.

Measured once on the scene itself, then kept in a file in the user's cache folder, by machine,
device, method, features and size.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import time
from dataclasses import dataclass, replace
from pathlib import Path

from taichi_cloth import __version__
from taichi_cloth.errors import InputError, nearest
from taichi_cloth.files.pending import write_whole
from taichi_cloth.kernels import stepping, watchdog
from taichi_cloth.kernels.solvers import phases
from taichi_cloth.runtime import current_device, sums_in_order, whole_vectors
from taichi_cloth.settings.options import PATHS, TOPOLOGIES

# Seconds in which one thread has done a frame before the others are awake: to measure all of them
# would only cost the time to compile.
WAKING = 50e-6


def run_begin(method, plan, state) -> None:
    """What a method computes before its first step, and after the state was changed from outside.

    method: its module; plan: one whose loops are spread.
    """
    if method.begin:
        with _compiling(method, plan):
            stepping.begin_launch(method.begin, plan, state)


def run_frames(method, plan, state, done, frames, substeps) -> int:
    """Advance frames as planned, after `done` steps; return how many passed the watchdog.

    method: its module.
    """
    phased = method.phases
    by_phases = phased and (plan.one_launch_per_step or (plan.lanes > 1 and method.launches))
    with _compiling(method, plan):
        if not (plan.one_launch_per_step or by_phases):
            step = phases.stepping(phased) if phased else method.step
            return stepping.frames_in_one_launch(step, plan, state, done, frames, substeps)
        spread = replace(plan, one_launch_per_step=True)
        for frame in range(frames):
            watchdog.checkpoint_launch(spread, state)
            for step in range(done + frame * substeps + 1, done + (frame + 1) * substeps + 1):
                if by_phases:
                    _run_phases(method, plan, state, step)
                else:
                    stepping.substep_launch(method.step, plan, state, step)
            if watchdog.last_fault(state) != watchdog.NO_FAULT:
                return frame
        return frames


def _run_phases(method, plan, state, step):
    """One step, in several launches."""
    stepping.begin_step_launch(state, step)
    phase = 0
    while phase != phases.DONE:
        if plan.one_launch_per_step:
            phase = stepping.phase_launch(method.phases[phase], plan, state)
        else:
            these = next(these for these in method.launches if phase in these)
            phase = stepping.phases_in_one_launch(method.phases, these, plan, state)
    if plan.fracture:
        stepping.end_step_launch(replace(plan, one_launch_per_step=True), state)


@contextlib.contextmanager
def _compiling(method, plan):
    """How a method's kernels on a plan's cells are compiled."""
    with contextlib.ExitStack() as settings:
        if plan.lanes > 1:
            settings.enter_context(whole_vectors())
        if method.sums:
            settings.enter_context(sums_in_order())
        yield


@dataclass(frozen=True)
class Choice:
    """How a scene is run. alone: seconds a step takes on one thread, where that was measured."""

    topology: str
    execution: str
    alone: float | None = None


def choose(topology: str, execution: str, sim, x, v) -> Choice:
    """How to run the simulation `sim` from x, v: as requested, else the fastest way.

    On a GPU one thread would be slow, so "auto" is parallel there. Raises InputError for an unknown
    word, and for lanes where the scene has no regular grid.
    """
    for flag, word, words in (
        ("--topology", topology, TOPOLOGIES),
        ("--execution", execution, PATHS),
    ):
        if word not in (*words, "auto"):
            raise InputError(f"{flag} {word}: {nearest(word, (*words, 'auto'))}")
    topologies, paths = sim.topologies(), PATHS
    if topology == "lanes" and "lanes" not in topologies:
        raise InputError(
            f"--topology lanes: the springs of scene '{sim.scene.name}' form no regular grid; "
            "use --topology graph"
        )
    if topology != "auto":
        topologies = [topology]
    if execution != "auto":
        paths = [execution]
    elif current_device().arch != "cpu":
        paths = ["parallel"]
    choices = [f"{t} {p}" for t in topologies for p in paths]
    if len(choices) == 1:
        return Choice(*choices[0].split())
    key = "/".join([_machine(), current_device().describe(), sim.method, sim.describe_size()])
    table = _read()
    measured = table.setdefault(key, {})
    before = dict(measured)
    for choice in choices:
        where, path = choice.split()
        alone = measured.get(f"{where} serial", 1.0)
        hopeless = path == "parallel" and alone * sim.substeps < WAKING
        if choice not in measured and not hopeless:
            sim.load_as(where, path, x, v)
            measured[choice] = _measure(sim)
    if measured != before:
        _write(table)
    best = fastest({choice: measured[choice] for choice in choices if choice in measured}).split()
    alone = measured.get(f"{best[0]} serial") if execution == "auto" else None
    return Choice(*best, alone)


def fastest(seconds: dict[str, float]) -> str:
    """The fastest of "topology execution"; of those within a tenth of it lanes before the graph,
    one thread before several: launches hide what they gain, and they gain where frames share one.
    """
    near = [choice for choice in seconds if seconds[choice] <= 1.1 * min(seconds.values())]
    order = [f"{t} {p}" for t in TOPOLOGIES for p in PATHS]
    return min(near, key=order.index)


def _measure(sim) -> float:
    """Seconds a step takes, undisturbed: the least of at least three frames after a warm-up."""
    sim.timed_frame()  # compiles
    seconds, deadline = [], time.perf_counter() + 0.15
    while len(seconds) < 3 or (time.perf_counter() < deadline and len(seconds) < 50):
        begin = time.perf_counter()
        sim.timed_frame()
        seconds.append(time.perf_counter() - begin)
    return min(seconds) / sim.substeps


@dataclass(frozen=True)
class Measured:
    """What was measured for one kind of scene: seconds a step by 'topology execution'."""

    what: str
    seconds: dict[str, float]


def measurements() -> list[Measured]:
    """What the cache holds for this machine and version, the newest last."""
    prefix = _machine() + "/"
    return [
        Measured(key.removeprefix(prefix), seconds)
        for key, seconds in _read().items()
        if key.startswith(prefix)
    ]


def cache_file() -> Path:
    """Where the measurements are kept."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "taichi-cloth" / "execution.json"


def _machine() -> str:
    return f"{__version__}, {platform.node()}, {platform.machine()}, {os.cpu_count()} cores"


def _read() -> dict:
    try:
        return json.loads(cache_file().read_text())
    except (OSError, ValueError):
        return {}  # nothing measured yet, or not readable: measure again


def _write(table: dict) -> None:
    path = cache_file()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(table, indent=1).encode())
    except (OSError, InputError):
        pass  # a cache that cannot be written costs a measurement at the next start
