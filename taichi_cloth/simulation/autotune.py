"""Lanes or graph, serial or parallel: which is fastest for a scene on this machine.

Measured once on the scene itself, then kept in a file in the user's cache folder, by machine,
device, method, features and size.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Protocol

from taichi_cloth import __version__
from taichi_cloth.errors import InputError, nearest
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.settings.options import PATHS, TOPOLOGIES

# Seconds in which one thread has done a frame before the others are awake: to measure all of them
# would only cost the time to compile.
WAKING = 50e-6

Table = dict[str, dict[str, float]]  # seconds a step by "topology execution", by kind of scene


class Candidates(Protocol):
    """The ways in which a scene can be run, each of which can be timed.

    scene_name: for messages. key: device, method, features and size, which decide what is fastest.
    paths: the paths worth a look here; substeps: steps a frame.
    """

    scene_name: str
    key: str
    paths: tuple[str, ...]
    substeps: int

    def topologies(self) -> list[str]:
        """The topologies that the scene can be stored in."""

    def time_candidate(self, topology: str, path: str) -> float:
        """Seconds a step takes in a topology, on a path."""


@dataclass(frozen=True)
class Choice:
    """How a scene is run. alone: seconds a step takes on one thread, where that was measured."""

    topology: str
    execution: str
    alone: float | None = None


def choose(topology: str, execution: str, candidates: Candidates) -> Choice:
    """How to run a scene: as requested, else the fastest of the candidates.

    Raises InputError for an unknown word, and for lanes where the scene has no regular grid.
    """
    for flag, word, words in (
        ("--topology", topology, TOPOLOGIES),
        ("--execution", execution, PATHS),
    ):
        if word not in (*words, "auto"):
            raise InputError(f"{flag} {word}: {nearest(word, (*words, 'auto'))}")
    topologies = candidates.topologies()
    if topology == "lanes" and "lanes" not in topologies:
        raise InputError(
            f"--topology lanes: the springs of scene '{candidates.scene_name}' form no regular "
            "grid; use --topology graph"
        )
    if topology != "auto":
        topologies = [topology]
    paths = candidates.paths if execution == "auto" else (execution,)
    choices = [(t, p) for t in topologies for p in paths]
    if len(choices) == 1:
        return Choice(*choices[0])
    measured = _measure(choices, candidates)
    best = fastest({f"{t} {p}": measured[f"{t} {p}"] for t, p in choices if f"{t} {p}" in measured})
    where, path = best.split()
    alone = measured.get(f"{where} serial") if execution == "auto" else None
    return Choice(where, path, alone)


def _measure(choices: list[tuple[str, str]], candidates: Candidates) -> dict[str, float]:
    """Seconds a step by "topology execution": from the cache file, else timed and put there.

    What cannot win is not timed, and absent.
    """
    table = _read()
    measured = table.setdefault(f"{_machine()}/{candidates.key}", {})
    before = dict(measured)
    for topology, path in choices:
        alone = measured.get(f"{topology} serial", 1.0)
        hopeless = path == "parallel" and alone * candidates.substeps < WAKING
        if f"{topology} {path}" not in measured and not hopeless:
            measured[f"{topology} {path}"] = candidates.time_candidate(topology, path)
    if measured != before:
        _write(table)
    return measured


def fastest(seconds: dict[str, float]) -> str:
    """The fastest of "topology execution"; of those within a tenth of it lanes before the graph,
    one thread before several: launches hide what they gain, and they gain where frames share one.
    """
    near = [choice for choice in seconds if seconds[choice] <= 1.1 * min(seconds.values())]
    order = [f"{t} {p}" for t in TOPOLOGIES for p in PATHS]
    return min(near, key=order.index)


class Pace:
    """Whether all threads together are slower than one alone would be.

    They wait for each other several times a step, so where other programs want the cores they may
    be. Both ways give the same bits, so a run may change over.

    alone: seconds a step takes on one thread; None: not known, and never lost.
    """

    PATIENCE = 0.3  # seconds that are looked at together
    SLOWER = 1.5  # times slower than alone

    def __init__(self, alone: float | None) -> None:
        self.alone = alone
        self._compiled = False  # the first launch compiles, and does not count
        self._seconds, self._steps = 0.0, 0

    def lost(self, seconds: float, steps: int) -> bool:
        """Note a launch; True when it is time to change over."""
        if self.alone is None:
            return False
        if not self._compiled:
            self._compiled = True
            return False
        self._seconds, self._steps = self._seconds + seconds, self._steps + steps
        if self._seconds < self.PATIENCE:
            return False
        slow = self._seconds > self.SLOWER * self.alone * self._steps
        self._seconds, self._steps = 0.0, 0
        return slow


# --- the cache file --------------------------------------------------------------------------


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


def _read() -> Table:
    try:
        table: Table = json.loads(cache_file().read_text())
    except (OSError, ValueError):
        return {}  # nothing measured yet, or not readable: measure again
    return table


def _write(table: Table) -> None:
    text = json.dumps(table, indent=1).encode()
    path = cache_file()
    # A cache that cannot be written costs a measurement at the next start.
    with contextlib.suppress(OSError, InputError):
        path.parent.mkdir(parents=True, exist_ok=True)
        PendingFile(path).fill(functools.partial(_put, text))


def _put(text: bytes, file: BinaryIO) -> None:
    file.write(text)
