"""What runs in a worker: one method on one scene, in one precision, at any step.

A setting's error and its time are measured apart, so that reading positions is not timed.
"""

from __future__ import annotations

import pickle
import time
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.trade.settings import Process

MOST_REPEATS = 101

_started: dict[Process, runtime.Device] = {}


class Trial:
    """A simulation that is compiled once and run at many steps.

    scene: file of a pickled `Scene`, written by the parent.
    """

    def __init__(
        self,
        scene: str,
        method: str,
        arch: str,
        precision: str,
        fast_math: bool,
        threads: int | None,
        topology: str,
        execution: str,
    ):
        device = _start(arch, precision, fast_math, threads)
        self._sim = Simulation(_load(scene), method, topology=topology, execution=execution)
        self.about = {
            "device": device.describe(),
            "threads": device.threads if self._sim.execution == "parallel" else 1,
            "topology": self._sim.topology,
            "execution": self._sim.execution,
        }

    def load(self, scene: str) -> None:
        """Another scene with the same features and springs; nothing is compiled anew."""
        self._sim.load_scene(_load(scene))

    def sample(
        self, dt: float, substeps: int, solver: dict[str, Any], frames: int, file: str
    ) -> dict[str, Any]:
        """Run `frames` frames; the state at the start and after each goes to `file` (npz).

        Arrays x, v: (frames + 1, n, dim), alive: (frames + 1, s), rows of a run that fails end with
        its last good frame. Returns its work, and `failed`, how it ended: also one most of whose
        steps did not converge has failed.
        """
        sim = self._begin(dt, substeps, solver)
        breaks = sim.scene.features().fracture
        shape = (frames + 1, sim.particle_count, sim.scene.world.dim)
        x, v = np.zeros(shape), np.zeros(shape)
        alive = np.ones((frames + 1, sim.spring_count if breaks else 0), bool)
        failed = ""
        done = 0
        for frame in range(frames + 1):
            if frame:
                try:
                    sim.advance()
                except SimulationFailure as failure:
                    failed = f"failed: frame {failure.frame}, particle {failure.particle} " + (
                        f"{failure.what}; {failure.cause}"
                    )
                    break
            x[frame], v[frame] = sim.positions(), sim.velocities()
            if breaks:
                alive[frame] = sim.springs_alive()
            done = frame + 1
        if not failed and sim.work().mostly_unconverged:
            failed = f"failed: {sim.describe_convergence()}"
        # As the device has them: in f32 half as large, and the same numbers.
        real = np.float32 if runtime.current_device().precision == "f32" else np.float64
        np.savez(file, x=x[:done].astype(real), v=v[:done].astype(real), alive=alive[:done])
        work = sim.work()
        return {
            "failed": failed,
            "force_evaluations": work.force_evaluations,
            "sweeps": work.sweeps,
            "unconverged": work.unconverged,
        }

    def time(
        self, dt: float, substeps: int, solver: dict[str, Any], frames: int, budget: float
    ) -> list[float]:
        """Seconds of the whole run, several times, as many as fit into `budget` seconds (3 to 101,
        fewer where one run is longer than that).

        The first run warmed up in `sample`, which compiled everything.
        """
        sim = self._begin(dt, substeps, solver)
        seconds: list[float] = []
        while len(seconds) < MOST_REPEATS:
            if seconds:
                sim.reset()
            begin = time.perf_counter()
            sim.advance(frames)
            seconds.append(time.perf_counter() - begin)
            spent = sum(seconds)
            if spent > budget and (len(seconds) >= 3 or spent > 2 * budget):
                break
        return seconds

    def _begin(self, dt: float, substeps: int, solver: dict[str, Any]) -> Simulation:
        """The simulation at its start, with a step and its solver's settings."""
        sim = self._sim
        sim.set_step(dt, substeps)
        sim.solver.update(solver)
        sim.reset()
        return sim


def _start(arch: str, precision: str, fast_math: bool, threads: int | None) -> runtime.Device:
    """The device of this process, started once."""
    wanted = arch, precision, fast_math
    if wanted not in _started:
        if _started:
            raise InputError(f"this process runs {_started}, not {wanted}")
        _started[wanted] = runtime.start(arch, precision, threads, fast_math)
    return _started[wanted]


def _load(path: str) -> Scene:
    scene: Scene = pickle.loads(Path(path).read_bytes())
    return scene
