"""Newton's solvers as trials: a scene of ours, run in any number of steps and iterations."""

from __future__ import annotations

import pickle
import time
from pathlib import Path
from typing import Any

import numpy as np

from bench.newton_model import Stepper, model_of

LEAST = 3  # runs that are timed at once, as of ours


class NewtonTrial:
    """Runs in the contestants' process, asked as `trade.trial.Trial` is.

    scene: file of a pickled `Scene`. solver: the name of Newton's class. contact_stiffness: of its
    contacts, where they are springs. recorded: whether steps are recorded and replayed.
    """

    def __init__(
        self, scene: str, solver: str, contact_stiffness: float = 0.0, recorded: bool = True
    ):
        self._scene = pickle.loads(Path(scene).read_bytes())
        self._solver, self._recorded = solver, recorded
        self._model = model_of(self._scene, solver, contact_stiffness)
        self._compiled = False

    def sample(
        self, dt: float, substeps: int, solver: dict[str, Any], frames: int, file: str
    ) -> dict[str, Any]:
        """Run so many frames; their states go to `file` (npz), as those of a `Trial`.

        Its seconds are those of the frames: to record them is no part of a run.
        """
        self._warm_up(dt / substeps, solver)
        stepper, dim = self._begin(solver), self._scene.world.dim
        states = [_state(stepper, dim)]
        seconds, failed = 0.0, ""
        for frame in range(1, frames + 1):
            stepper.prepare(dt / substeps, substeps)
            begin = time.perf_counter()
            stepper.advance(dt / substeps, substeps)
            seconds += time.perf_counter() - begin
            states.append(_state(stepper, dim))
            if not np.isfinite(states[-1]).all():
                failed = f"failed: frame {frame} is not finite"
                break
        x, v = np.stack(states, axis=1)
        np.savez(file, x=x, v=v, alive=np.ones((len(x), 0), bool), contacts=np.zeros((0, 3)))
        return {"failed": failed, "sampled_in": seconds}

    def time(
        self, dt: float, substeps: int, solver: dict[str, Any], frames: int, budget: float
    ) -> list[float]:
        """Seconds of runs of so many frames, at least LEAST, until `budget` seconds are spent, to
        record them, too: that takes a hundred times as long as a short run.
        """
        self._warm_up(dt / substeps, solver)
        seconds: list[float] = []
        end = time.perf_counter() + budget
        while len(seconds) < LEAST or time.perf_counter() < end:
            stepper = self._begin(solver)
            stepper.prepare(dt / substeps, substeps * frames)
            begin = time.perf_counter()
            stepper.advance(dt / substeps, substeps * frames)
            seconds.append(time.perf_counter() - begin)
        return seconds

    def _warm_up(self, h: float, solver: dict[str, Any]) -> None:
        """See that what a step of h needs is compiled."""
        if not self._compiled:
            self._begin(solver).advance(h, 1)
            self._compiled = True

    def _begin(self, settings: dict[str, Any]) -> Stepper:
        return Stepper(self._model, self._solver, self._recorded, **settings)


def _state(stepper: Stepper, dim: int) -> np.ndarray:
    """Positions and velocities (2, n, dim)."""
    return np.stack([stepper.positions(), stepper.velocities()])[:, :, :dim]
