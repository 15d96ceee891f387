"""The trial in a worker: one method on one scene, in one precision, at any step.

A setting's error and its time are measured apart, so that reading positions is not timed.
"""

from __future__ import annotations

import contextlib
import json
import pickle
import time
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.trade.errors import CONTACTS
from taichi_cloth.trade.seconds import SECOND, arrays_of_start
from taichi_cloth.trade.settings import Process

MOST_REPEATS = 101

_started: dict[Process, runtime.Device] = {}


class Trial:
    """A simulation that is compiled once and run at many steps.

    scene: file of a pickled `Scene`, written by the parent. accounts: whether what contacts do to
    the energy is accounted for, where there can be any.
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
        accounts: bool = True,
    ):
        device = _start(arch, precision, fast_math, threads)
        made = _load(scene)
        account = accounts and arch == "cpu"  # on a GPU it takes too many launches
        self._sim = Simulation(
            made,
            method,
            substeps=1,  # of each trial those that it is given
            topology=topology,
            execution=execution,
            accounts_contacts=account,
        )
        self._ran: set[str] = set()  # what was run here, so that it is compiled and warm
        self.about = {
            "device": device.describe(),
            "threads": device.threads if self._sim.execution == "parallel" else 1,
            "topology": self._sim.topology,
            "execution": self._sim.execution,
        }

    def load(self, scene: str) -> None:
        """Another scene with the same features and springs; nothing is compiled anew."""
        self._sim.load_scene(_load(scene), substeps=1)

    def compile(self, dt: float, substeps: int, solver: dict[str, Any]) -> None:
        """Compile what samples are taken with, by a frame."""
        self._begin(dt, substeps, solver)
        self._warm_up("compiled", 1)

    def sample(
        self, dt: float, substeps: int, solver: dict[str, Any], frames: int, file: str
    ) -> dict[str, Any]:
        """Run `frames` frames; the state at the start and after each goes to `file` (npz).

        Arrays are those of `errors.Samples`, and of each second's start (`seconds`); rows of
        a run that fails end with its last good frame.
        Returns its work, its seconds, those of them in which states were read, and `failed`, how it
        ended: also one most of whose steps did not converge has failed.
        """
        self.compile(dt, substeps, solver)
        start = time.perf_counter()
        read_in = 0.0
        sim = self._begin(dt, substeps, solver)
        breaks = sim.scene.features().fracture
        shape = (frames + 1, sim.particle_count, sim.scene.world.dim)
        x, v = np.zeros(shape), np.zeros(shape)
        contacts = np.zeros((frames + 1, len(CONTACTS)))
        deepest = 0.0
        sim.account_contacts()
        alive = np.ones((frames + 1, sim.spring_count if breaks else 0), bool)
        starts: dict[str, Any] = {}
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
            reading = time.perf_counter()
            x[frame], v[frame] = sim.positions(), sim.velocities()
            if breaks:
                alive[frame] = sim.springs_alive()
            if frame and sim.can_touch():
                deepest = max(deepest, sim.penetration())
            contacts[frame] = self._contacts(deepest)
            if frame % SECOND == 0 and frame < frames:
                starts |= arrays_of_start(frame, sim.start())
            read_in += time.perf_counter() - reading
            done = frame + 1
        if not failed and sim.work().mostly_unconverged:
            failed = f"failed: {sim.describe_convergence()}"
        # As the device has them: in f32 half as large, and the same numbers.
        real = np.float32 if runtime.current_device().precision == "f32" else np.float64
        kept_x, kept_v = x[:done].astype(real), v[:done].astype(real)
        kept: dict[str, Any] = {
            "x": kept_x,
            "v": kept_v,
            "alive": alive[:done],
            "contacts": contacts[:done],
        }
        kept |= starts | {"solver": json.dumps(dict(sim.solver))}
        np.savez(file, **kept)
        self._ran.add(_run_of(dt, substeps, solver))
        work = sim.work()
        return {
            "failed": failed,
            "force_evaluations": work.force_evaluations,
            "sweeps": work.sweeps,
            "unconverged": work.unconverged,
            "sampled_in": time.perf_counter() - start,
            "read_in": read_in,
        }

    def _warm_up(self, key: str, frames: int) -> None:
        """Compile, and run what is to be timed, where nothing like it was run here before."""
        if key in self._ran:
            return
        self._ran.add(key)
        sim = self._sim
        sim.account_contacts()  # until the next reset
        with contextlib.suppress(SimulationFailure):
            sim.advance(frames)
        # What reads a state is compiled, too, and is no part of a run's seconds.
        sim.positions(), sim.velocities(), sim.contact_account()
        if sim.can_touch():
            sim.penetration()

    def _contacts(self, deepest: float) -> list[float]:
        """The numbers of `errors.CONTACTS`, until now; deepest: the first of it."""
        account = self._sim.contact_account()
        if not self._sim.can_touch():
            return [np.nan] * len(CONTACTS)
        if account is None:
            return [deepest, np.nan, np.nan]
        first = account.first_touch
        return [deepest, account.gained, np.nan if first is None else first]

    def time(
        self, dt: float, substeps: int, solver: dict[str, Any], frames: int, budget: float
    ) -> list[float]:
        """Seconds of the whole run, several times, as many as fit into `budget` seconds (3 to 101,
        fewer where one run is longer than that).

        A first one, that of `sample` or one that is not counted, has compiled everything.
        """
        sim = self._begin(dt, substeps, solver)
        self._warm_up(_run_of(dt, substeps, solver), frames)
        sim.reset()
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
        self._sim.set_step(dt, substeps)
        self._sim.solver.update(solver)
        self._sim.reset()
        return self._sim


def _run_of(dt: float, substeps: int, solver: dict[str, Any]) -> str:
    return f"{dt} {substeps} {solver}"


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
