"""Rows of `docs/matrix.md`: every method on all scenes, on both topologies, in all precisions;
how wrong each is, or why it does not run.

Each scene has a process for each precision. All cells of a scene are run over the same few frames
in the same steps, short ones that every explicit method follows, with a method's own default
settings. Nearly all of the time goes into compiling, so that leaves out what would only make longer
runs shorter (`runtime.compiled_soon`): with everything in lanes a quarter of a minute. What takes
longer than PATIENCE all the same is not measured, nor what is left of a scene that has taken its
BUDGET.
"""

from __future__ import annotations

import contextlib
import signal
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.kernels import forces, methods
from taichi_cloth.measuring.worker import Worker, WorkerFailed
from taichi_cloth.scene import library, scenefile
from taichi_cloth.scene.model import Scene
from taichi_cloth.settings.options import PRECISIONS, TOPOLOGIES
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.storage import adjacency
from taichi_cloth.sweeps.journal import Journal, key_of
from taichi_cloth.sweeps.tasks import Finished, Task, finished_by
from taichi_cloth.trade.errors import Samples, displacement, rms_by_frame
from taichi_cloth.trade.pace import EXPLICIT, kind_of
from taichi_cloth.trade.reference import coarsest, fine_method

# Of each scene: parameters with which it is small, and the frames in which what it shows begins.
SCENES: dict[str, tuple[dict[str, Any], int]] = {
    "oscillator": ({}, 60),
    "chain": ({}, 60),
    "slinky": ({}, 30),
    "cloth": ({}, 40),
    "sandbox": ({"particles": 30}, 20),
    "box": ({"particles": 40}, 20),
    "net": ({"side": 12}, 15),
    "warp": ({"side": 8}, 10),
    "flag": ({"columns": 10}, 12),
    "curtain": ({"columns": 13}, 12),
    "shirt": ({}, 2),
    "drape": ({"side": 11}, 12),
    "stack": ({"side": 5, "sheets": 2}, 12),
    "twist": ({"columns": 17}, 12),
    "pull": ({"columns": 9}, 8),
    "trampoline": ({"side": 9}, 30),
    "everything": ({}, 12),
}
# A cloth with all features that a scene can ask for; it is in no library, as it looks like nothing.
EVERYTHING = """
[world]
size = [2.0, 2.0, 2.0]
up = "y"
gravity = [0.0, -9.81, 0.0]
dt = 0.0166666666666666666
ground = 0.0
friction = 0.3
collisions = true
contact = "resting"
air = { density = 1.2, drag = 1.0, lift = 0.6 }
wind = { velocity = [2.0, 0.0, 1.0], gust = 0.4, period = 0.5, seed = 1 }
[particle]
radius = 0.02
viscous = 0.001
restitution = 0.2
[[cloths]]
origin = [0.6, 0.5, -0.4]
columns = 9
rows = 7
spacing = 0.1
across = [1.0, 0.0, 0.0]
down = [0.0, 0.0, 1.0]
links = ["structural", "shear"]
density = 0.2
stretch = 60.0
shear = 8.0
damping_time = 4e-4
strength = 60.0
bending = 2e-4
pinned = [[0, 0]]
[[particles]]
position = [1.0, 0.62, -0.1]
radius = 0.1
mass = 0.5
[[obstacles]]
shape = "sphere"
centre = [1.0, 0.2, -0.1]
radius = 0.25
friction = 0.4
spin = [0.0, 180.0, 0.0]
[[obstacles]]
shape = "capsule"
ends = [[0.4, 0.44, -0.2], [0.9, 0.44, -0.2]]
radius = 0.03
velocity = [0.0, 0.3, 0.0]
[[obstacles]]
shape = "box"
centre = [1.3, 0.3, 0.1]
half = [0.1, 0.15, 0.1]
restitution = 0.3
"""
RELATIVE = 4  # the scenes' steps are so many times those of the coarsest reference
LANES = 2  # particles in a pack: few compile much sooner, and what they hold is the same
FINER = 4  # steps of the reference in one of the coarsest
PATIENCE = 300.0  # seconds of the processor that a cell may take, nearly all of them to compile
BUDGET = 3600.0  # those that a scene may take before its last cell


def built(name: str) -> Scene:
    """A scene of the table."""
    if name in library.names():
        return library.build(name, **SCENES[name][0])
    return scenefile.parse(EVERYTHING)


def substeps(scene: Scene) -> int:
    """The substeps of all cells of a scene."""
    return max(1, coarsest(scene, scene.world.dt) // RELATIVE)


class Cells:
    """The cells of one precision, in a worker."""

    def __init__(self, precision: str):
        self.about = {"device": runtime.start("cpu", precision, threads=1).describe()}
        self._settings = contextlib.ExitStack()  # as long as the process lasts
        self._settings.enter_context(runtime.compiled_soon())

    def exact(self, name: str) -> np.ndarray:
        """Positions by the reference method in fine steps, (frames + 1, n, dim)."""
        scene = built(name)
        fine = FINER * coarsest(scene, scene.world.dt)
        return _positions(Simulation(scene, fine_method(), None, fine, **ON_GRAPH), name)

    def timed(self, patience: float, **asked: str) -> tuple[dict[str, Any], float]:
        """A cell, and the seconds of the processor that it took; `patience` ends the process."""
        begin = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, patience)  # whose signal ends the process
        try:
            return self.cell(**asked), time.process_time() - begin
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)

    def cell(self, name: str, method: str, topology: str, exact: str) -> dict[str, Any]:
        """The outcome of a run: its error in parts of the largest displacement, or why it ended.

        exact: the file of the reference's positions.
        """
        scene = built(name)
        how: dict[str, Any] = {"topology": topology, "execution": "serial", "lanes": LANES}
        try:
            sim = Simulation(scene, method, None, substeps(scene), **how)
            if sim.topology != topology:
                return NO_GRID
            x = _positions(sim, name)
        except (InputError, SimulationFailure) as refusal:
            return {"refused": str(refusal)}  # the table says of whom
        free, reference = ~scene.particles.fixed, _samples(np.load(exact))
        error = rms_by_frame(_samples(x), reference, free)[-1]
        return {"error": float(error / displacement(reference, free))}


NO_GRID = {"refused": "no regular grid, which lanes are for: it is run on the graph"}
ON_GRAPH: dict[str, Any] = {"topology": "graph", "execution": "serial"}


def _positions(sim: Simulation, name: str) -> np.ndarray:
    """Positions at the start and after each frame of a scene, (frames + 1, n, dim)."""
    found = [sim.positions()]
    for _ in range(SCENES[name][1]):
        sim.advance()
        found.append(sim.positions())
    return np.array(found)


def _samples(x: np.ndarray) -> Samples:
    return Samples(x, np.zeros_like(x), np.ones((len(x), 0), bool))


def matrix(
    scenes: Sequence[str] = tuple(SCENES),
    names: Sequence[str] = methods.METHODS,
    precisions: Sequence[str] = PRECISIONS,
    topologies: Sequence[str] = TOPOLOGIES,
    budget: float = BUDGET,
    kept: Mapping[str, Any] | None = None,
    journal: Journal | None = None,
) -> dict[str, Any]:
    """All cells, by scene, method, and "topology precision"; how each scene was run.

    A cell has an `error`, or says why it was `refused` or `not measured`. budget: seconds of the
    processor that a scene may take before its last cell. kept: earlier results, whose errors are
    taken over where the scene is run as it was then. journal: has the cells that are finished.
    """
    ways = [(topology, precision) for topology in sorted(topologies) for precision in precisions]
    return {
        name: _row(name, names, ways, budget, (kept or {}).get(name, {}), journal)
        for name in scenes
    }


def _row(
    name: str,
    names: Sequence[str],
    ways: Sequence[tuple[str, str]],
    budget: float,
    kept: Mapping[str, Any],
    journal: Journal | None,
) -> dict[str, Any]:
    """The cells of a scene, and how it was run. ways: topologies with precisions."""
    cells: dict[str, dict[str, Any]] = {method: {} for method in names}
    slow: set[tuple[str, int]] = set()  # topologies and kinds of methods that compile too long
    about = _about(name)
    same = {key: kept.get(key) for key in about} == about
    has = kept["cells"] if same else {}
    spent, scene = 0.0, built(name)
    has_grid = adjacency.find_grids(scene.springs.between, len(scene.particles))
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        processes = {
            precision: stack.enter_context(_Process(Path(folder), precision))
            for precision in {"f64", *(precision for _, precision in ways)}
        }
        exact = ""
        for topology, precision in ways:
            for method in sorted(names, key=kind_of):
                earlier = has.get(method, {}).get(f"{topology} {precision}", {})
                key = key_of("cell", name, method, topology, precision)
                finished = journal.get(key) if journal is not None else None
                if "error" in earlier:
                    made = earlier
                elif finished:
                    made, took = finished.result
                    spent += took
                elif topology == "lanes" and not has_grid:
                    made = NO_GRID
                elif slow & {(topology, EXPLICIT), (topology, kind_of(method))}:
                    made = TOO_SLOW
                elif spent > budget:
                    made = _too_much(budget)
                else:
                    exact = exact or processes["f64"].exact(name)
                    asked = {"method": method, "topology": topology, "exact": exact}
                    made, took = processes[precision].cell(name=name, **asked)
                    spent += took
                    if journal is not None:
                        journal.add(key, [made, took])
                if made == TOO_SLOW:
                    slow.add((topology, kind_of(method)))
                cells[method][f"{topology} {precision}"] = made
    if journal is not None:
        journal.once(_row_key(name), lambda: "whole")
    return about | {"cells": cells}


def _row_key(name: str) -> str:
    return key_of("row", name)


def tasks(journal: Journal, kept: Mapping[str, Any]) -> list[Task]:
    """The scenes of the whole matrix as tasks (`sweeps.tasks`); kept: see `matrix`."""
    found = []
    for name in SCENES:
        begins = key_of("cell", name)[:-1]
        cells = [key for key in journal.finished() if key.startswith(f"{begins},")]
        known = {key: entry.result for key in cells if (entry := journal.get(key))}
        asked = {"name": name, "known": known, "kept": kept}
        found.append(Task(f"matrix, {name}", f"{__name__}:finished", [_row_key(name)], asked))
    return found


def finished(name: str, known: Mapping[str, Any], kept: Mapping[str, Any]) -> list[Finished]:
    """The results that `matrix` puts into a journal of a scene; known: finished cells, by key."""
    return finished_by(lambda journal: matrix([name], kept=kept, journal=journal), known)


TOO_SLOW = {
    "not measured": f"more than {PATIENCE:g} s of the processor, nearly all to compile; where "
    "a method takes so long, those that compile no sooner are not tried"
}


def _too_much(budget: float) -> dict[str, Any]:
    said = f"the scene's cells before this one took {budget:g} s of the processor together"
    return {"not measured": said}


def _about(name: str) -> dict[str, Any]:
    scene = built(name)
    return {
        "parameters": SCENES[name][0],
        "frames": SCENES[name][1],
        "substeps": substeps(scene),
        "particles": len(scene.particles),
        "features": forces.describe(scene),
    }


class _Process:
    """A worker with the `Cells` of one precision; another one where that ends with its process."""

    def __init__(self, folder: Path, precision: str):
        self._folder, self._precision = folder, precision
        self._start()

    def __enter__(self) -> _Process:
        return self

    def __exit__(self, *_: object) -> None:
        self._worker.close()

    def _start(self) -> None:
        self._worker = Worker(self._folder, {})
        made = {"precision": self._precision}
        self._worker.ask(make=f"{__name__}:Cells", **{"as": "cells", "with": made})

    def exact(self, name: str) -> str:
        file: str = self._worker.ask(of="cells", do="exact", **{"with": {"name": name}})["result"]
        return file

    def cell(self, **asked: str) -> tuple[dict[str, Any], float]:
        """A cell and the processor's seconds; what goes wrong unforeseen is refused, too."""
        try:
            given = {"patience": PATIENCE, **asked}
            answer = self._worker.ask(of="cells", do="timed", **{"with": given})
            made, took = answer["result"]
        except WorkerFailed as failure:
            made, took = {"refused": f"{asked['name']}: {asked['method']}: {failure}"}, 0.0
            if not self._worker.alive:
                if self._worker.ended_by == signal.SIGPROF:
                    made, took = TOO_SLOW, PATIENCE
                self._worker.close()
                self._start()
        return made, took
