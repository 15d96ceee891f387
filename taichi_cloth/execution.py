"""Serial or parallel: which of the two ways to run a frame is faster for a scene on this machine.

Measured once on the scene itself, then kept in a file in the user's cache folder, by machine,
device, method, features and size.
"""

from __future__ import annotations

import json
import os
import platform
import statistics
import time
from pathlib import Path

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.kernels import run, watch
from taichi_cloth.options import PATHS
from taichi_cloth.runtime import current_device


def run_frames(path, method, features, state, done, frames, substeps) -> int:
    """Advance frames on a path, after `done` steps; return how many passed the watchdog."""
    if path == "serial":
        return run.frames_serial(method, features, state, done, frames, substeps)
    for frame in range(frames):
        watch.keep_parallel(state)
        for k in range(substeps):
            run.substep_parallel(method, features, state, done + frame * substeps + k + 1)
        if watch.last_fault(state) != watch.NO_FAULT:
            return frame
    return frames


def choose(requested: str, sim) -> str:
    """The path to use for the simulation `sim`: the requested one, or the measured best.

    On a GPU the serial path would be one slow thread, so "auto" is parallel there.
    Raises InputError for an unknown word.
    """
    if requested not in (*PATHS, "auto"):
        raise InputError(f"--execution {requested}: {nearest(requested, (*PATHS, 'auto'))}")
    if requested != "auto":
        return requested
    device = current_device()
    if device.arch != "cpu":
        return "parallel"
    key = "/".join([_machine(), device.describe(), sim.method, sim.describe_size()])
    table = _read()
    if key not in table:
        table[key] = {path: measure_path(sim, path) for path in PATHS}
        _write(table)
    return min(PATHS, key=lambda path: table[key][path])


def measure_path(sim, path: str) -> float:
    """Seconds a step takes on a path: median of at least three frames after a warm-up."""
    frame = sim.timed_frame(path)
    frame()  # compiles
    seconds, deadline = [], time.perf_counter() + 0.15
    while len(seconds) < 3 or (time.perf_counter() < deadline and len(seconds) < 50):
        begin = time.perf_counter()
        frame()
        seconds.append(time.perf_counter() - begin)
    return statistics.median(seconds) / sim.substeps


def cache_file() -> Path:
    """Where the measurements are kept."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "taichi-cloth" / "execution.json"


def _machine() -> str:
    return f"{platform.node()}, {platform.machine()}, {os.cpu_count()} cores"


def _read() -> dict:
    try:
        return json.loads(cache_file().read_text())
    except (OSError, ValueError):
        return {}  # nothing measured yet, or not readable: measure again


def _write(table: dict) -> None:
    path = cache_file()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}.part")
        part.write_text(json.dumps(table, indent=1, sort_keys=True))
        part.replace(path)
    except OSError:
        pass  # a cache that cannot be written costs a measurement at the next start
