"""Lanes or graph, serial or parallel: which is fastest for a scene on this machine.

A run starts at once in the way that is predicted from the scene's size (`prediction.py`): each
further way would have to be compiled, which takes longer than most runs gain by it. What a run's
own launches then cost is kept in a file in the user's cache folder, by machine, device, method,
features and size, and corrects the predictions of runs to come. The cost of a launch and of a step
are kept apart, because substeps and frames that share a launch change from run to run.
"""

from __future__ import annotations

import math
import os
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.settings.options import PATHS, TOPOLOGIES
from taichi_cloth.simulation import cache
from taichi_cloth.simulation.prediction import Cost
from taichi_cloth.version import __version__

# Lanes are taken where the graph would take more than so many times as long: they take 2 to 7 times
# as long to compile.
TIE = 1.18
SEVERAL = 1.1  # all threads are taken where one would take more than so many times as long

FILE = "execution.json"

Costs = dict[str, Cost]  # by "topology execution"


class Candidates(Protocol):
    """The ways in which a scene can be run.

    scene_name: for messages. key: device, method, features and size, which decide what is fastest.
    paths: the paths worth a look here; substeps: steps a frame. slow_to_compile: topologies that
    take longer to compile than their steps are worth: who does not ask for them gets none.
    """

    scene_name: str
    key: str
    paths: tuple[str, ...]
    substeps: int
    slow_to_compile: tuple[str, ...]

    def topologies(self) -> list[str]:
        """The topologies that the scene can be stored in."""

    def predict(self, topology: str, path: str) -> Cost:
        """The predicted cost of a way."""


@dataclass(frozen=True)
class Choice:
    """The way in which a scene is run.

    forced: whether the path was asked for. costs: of both paths in that topology, as expected.
    """

    topology: str
    execution: str
    forced: bool
    costs: Costs


def choose(topology: str, execution: str, candidates: Candidates) -> Choice:
    """Choose how to run a scene: as requested, else by expected speed. Nothing is run.

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
    if topology == "auto":
        topologies = [t for t in topologies if t not in candidates.slow_to_compile] or topologies
    else:
        topologies = [topology]
    costs = expected(candidates, topologies)
    paths = candidates.paths if execution == "auto" else (execution,)
    seconds = {
        f"{t} {p}": costs[f"{t} {p}"].of(candidates.substeps) for t in topologies for p in paths
    }
    where, path = fastest(seconds).split()
    known = {p: costs[f"{where} {p}"] for p in {*candidates.paths, path}}
    return Choice(where, path, execution != "auto", known)


def expected(candidates: Candidates, topologies: list[str]) -> Costs:
    """The expected cost of each way: as remembered, else as predicted.

    Where other ways of the same kind of scene are remembered, predictions are as much too short or
    too long as theirs were.
    """
    predicted = {
        f"{t} {p}": candidates.predict(t, p)
        for t in topologies
        for p in {*candidates.paths, *PATHS}
    }
    remembered = _entry(_read(), candidates.key)
    every = {way: candidates.predict(*way.split()) for way in remembered}
    steps = candidates.substeps
    ratios = [math.log(remembered[w].of(steps) / every[w].of(steps)) for w in remembered]
    factor = math.exp(sum(ratios) / len(ratios)) if ratios else 1.0
    return {
        way: remembered.get(way) or Cost(factor * cost.launch, factor * cost.step)
        for way, cost in predicted.items()
    }


def fastest(seconds: dict[str, float]) -> str:
    """The fastest of "topology execution" by the seconds of a frame, but for what gains too little.

    Several threads must gain SEVERAL over one, and lanes TIE over the graph.
    """
    best: dict[str, tuple[float, str]] = {}
    for topology in TOPOLOGIES:
        paths = {p: seconds[f"{topology} {p}"] for p in PATHS if f"{topology} {p}" in seconds}
        if paths:
            path = min(paths, key=paths.__getitem__)
            if paths.get("serial", math.inf) <= SEVERAL * paths[path]:
                path = "serial"
            best[topology] = paths[path], path
    graph, lanes = best.get("graph"), best.get("lanes")
    if lanes and not (graph and graph[0] <= TIE * lanes[0]):
        return f"lanes {lanes[1]}"
    assert graph is not None  # there is always one of both
    return f"graph {graph[1]}"


# --- while a run goes on -----------------------------------------------------------------------


class Watch:
    """The cost of a run's launches, and whether all threads together are slower than one.

    They wait for each other several times a step, so where other programs want the cores they may
    be. Both paths give the same bits, so a run may change over. But the other way may have to be
    compiled, so it does once it has lost as much time as it took to compile this one: whatever
    comes then, it has lost at most twice what was needed (Karlin et al., Algorithmica 3, 1988).

    Steps also take longer because there is more to do, such as contacts, and then threads have
    their cores all the same. What they cost while they have them, is what one thread is compared
    with.

    choice: how it is run; substeps: of a frame.
    alone, together: once threads only wait, seconds a step on one, as estimated, and on all.
    """

    ENOUGH = 20  # launches from which the cost of one is told
    PATIENCE = 0.3  # seconds that are looked at together
    SLOWER = 1.25  # times slower than alone
    OWN = 0.93  # part of the processor's time from which on threads have their cores for themselves
    REGRET = 1.0  # times what compiling took: time that is lost before a run changes over

    def __init__(self, choice: Choice, substeps: int) -> None:
        self.choice = choice
        costs = choice.costs
        self._gain = math.inf  # how many times as fast as one all threads are, undisturbed
        if choice.execution == "parallel" and "serial" in costs:
            self._gain = costs["serial"].of(substeps) / costs["parallel"].of(substeps)
        self._compiled = False  # the first launch compiles, and does not count
        self._launches: list[tuple[float, int]] = []
        self._seconds, self._steps, self._processor = 0.0, 0, 0.0
        self._undisturbed, self._least = math.inf, math.inf  # seconds a step
        self._compiling = self._lost = 0.0  # seconds
        self.alone = self.together = 0.0

    def enough(self, seconds: float, steps: int) -> bool:
        """Note a launch of so many steps; True once, when what one costs can be told."""
        if not self._compiled or len(self._launches) >= self.ENOUGH:
            return False
        self._launches.append((seconds, steps))
        return len(self._launches) == self.ENOUGH

    def cost(self, launch: float) -> Cost | None:
        """The cost by the least disturbed launch. launch: seconds of one without steps.

        None where steps take less than half of it: they are the difference of two times, each of
        which another program may have lengthened, and nothing could be said of more substeps.
        """
        seconds, steps = min(self._launches, key=lambda noted: noted[0] / noted[1])
        return Cost(launch, (seconds - launch) / steps) if seconds >= 2 * launch else None

    def lost(self, seconds: float, steps: int, had: float) -> bool:
        """Note a launch of so many steps; True when one thread would do better.

        had: the part of the processor's time on their cores that threads had meanwhile.

        How fast one would be, show the last launches in which they had their cores; where there
        were none yet, the least disturbed one.
        """
        if not self._compiled:
            self._compiled, self._compiling = True, seconds
            return False
        self._seconds, self._steps = self._seconds + seconds, self._steps + steps
        self._processor += had * seconds
        self._least = min(self._least, seconds / steps)
        if self._seconds < self.PATIENCE:
            return False
        together, passed, had = self._seconds / self._steps, self._steps, self._processor
        own = had >= self.OWN * self._seconds
        self._seconds, self._steps, self._processor = 0.0, 0, 0.0
        if own:
            self._undisturbed = together
            return False
        known = math.isfinite(self._undisturbed)
        alone = self._gain * (self._undisturbed if known else self._least)
        if together <= self.SLOWER * alone:
            return False
        self.alone, self.together = alone, together
        self._lost += (together - alone) * passed
        return self.choice.forced or self._lost >= self.REGRET * self._compiling


# --- the cache file ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Measured:
    """Measured costs of one kind of scene, by 'topology execution'."""

    what: str
    costs: Costs


def measurements() -> list[Measured]:
    """Contents of the cache for this machine and version, the newest last."""
    prefix, table = _machine() + "/", _read()
    keys = [key.removeprefix(prefix) for key in table if key.startswith(prefix)]
    kinds = [Measured(key, _entry(table, key)) for key in keys]
    return [kind for kind in kinds if kind.costs]


def remember(key: str, way: str, cost: Cost) -> None:
    """Keep what a way, "topology execution", was measured to cost, unless it was cheaper before."""
    table = _read()
    costs = _entry(table, key)
    before = costs.get(way)
    if before and cost.of(1) >= before.of(1) and cost.step >= before.step:
        return
    if before:
        cost = Cost(min(cost.launch, before.launch), min(cost.step, before.step))
    table.pop(f"{_machine()}/{key}", None)  # the newest come last
    table[f"{_machine()}/{key}"] = {
        name: [kept.launch, kept.step] for name, kept in {**costs, way: cost}.items()
    }
    cache.write(FILE, table)


def cache_file() -> Path:
    """The folder of the measurements."""
    return cache.folder() / FILE


def _machine() -> str:
    return f"{__version__}, {platform.node()}, {platform.machine()}, {os.cpu_count()} cores"


def _entry(table: dict[str, Any], key: str) -> Costs:
    """The costs of one kind of scene; what is not written as this version does is left out."""
    entry = table.get(f"{_machine()}/{key}")
    if not isinstance(entry, dict):
        return {}
    ways = [f"{topology} {path}" for topology in TOPOLOGIES for path in PATHS]
    return {way: Cost(*entry[way]) for way in ways if _is_cost(entry.get(way))}


def _is_cost(pair: object) -> bool:
    """True if this is what `remember` writes: two numbers of seconds."""
    return (
        isinstance(pair, list)
        and len(pair) == 2
        and all(type(number) in (int, float) and math.isfinite(number) for number in pair)
        and pair[0] >= 0 < pair[1]
    )


def _read() -> dict[str, Any]:
    table = cache.read(FILE)
    return table if isinstance(table, dict) else {}
