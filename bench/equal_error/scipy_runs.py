"""SciPy's solvers as trials: a scene of ours as an ordinary differential equation (`trade.ode`)."""

from __future__ import annotations

import pickle
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse
from scipy.integrate import solve_ivp

from taichi_cloth.scene.model import Scene
from taichi_cloth.trade.ode import Forces

IMPLICIT = ("Radau", "BDF")


class _TookTooLong(Exception):
    """The patience is at its end."""


class ScipyTrial:
    """Runs in the contestants' process, asked as `trade.trial.Trial` is; it chooses its own steps.

    scene: file of a pickled `Scene`. length, speed: to what a tolerance is relative, of positions
    and of velocities. patience: seconds after which a run is given up.
    """

    def __init__(self, scene: str, solver: str, length: float, speed: float, patience: float):
        loaded: Scene = pickle.loads(Path(scene).read_bytes())
        self._forces, self._patience = Forces(loaded), patience
        particles = loaded.particles
        v = np.where(particles.fixed[:, None], 0.0, particles.velocity)
        self._start = np.stack([particles.position, v])
        self._scale = np.repeat([length, speed], particles.position.size)
        self._settings: dict[str, Any] = {"method": solver}
        if solver in IMPLICIT:
            self._settings["jac_sparsity"] = jacobian_pattern(loaded)

    def sample(self, dt: float, solver: dict[str, Any], frames: int, file: str) -> dict[str, Any]:
        """Solve for so many frames; their states go to `file` (npz), as those of a `Trial`."""
        begin = time.perf_counter()
        try:
            states = self._solve(np.arange(frames + 1) * dt, solver["tolerance"])
        except _TookTooLong:
            says = f"failed: took more than {self._patience:g} s"
            return {"failed": says, "sampled_in": self._patience, "gave_up": True}
        seconds = time.perf_counter() - begin
        failed = "" if len(states) == frames + 1 else f"failed: ended after frame {len(states) - 1}"
        x, v = states[:, 0], states[:, 1]
        np.savez(file, x=x, v=v, alive=np.ones((len(x), 0), bool), contacts=np.zeros((0, 3)))
        return {"failed": failed, "sampled_in": seconds}

    def time(self, dt: float, solver: dict[str, Any], frames: int, budget: float) -> list[float]:
        """Seconds of runs that keep the end alone, at least one, until `budget` are spent."""
        seconds: list[float] = []
        while not seconds or sum(seconds) < budget:
            begin = time.perf_counter()
            self._solve(np.array([0.0, frames * dt]), solver["tolerance"])
            seconds.append(time.perf_counter() - begin)
        return seconds

    def _solve(self, times: np.ndarray, tolerance: float) -> np.ndarray:
        """States (times, 2, n, dim) at `times`; fewer where the solver gives up."""
        end = time.perf_counter() + self._patience

        def slope(t: float, y: np.ndarray) -> np.ndarray:
            if time.perf_counter() > end:
                raise _TookTooLong
            return self._forces.slope(t, y)

        with np.errstate(all="ignore"):
            found = solve_ivp(
                slope,
                (times[0], times[-1]),
                self._start.ravel(),
                t_eval=times,
                rtol=tolerance,
                atol=tolerance * self._scale,
                **self._settings,
            )
        states: np.ndarray = found.y.T.reshape(-1, *self._start.shape)
        return states


def jacobian_pattern(scene: Scene) -> sparse.csr_matrix:
    """The places where the derivative of (v, a) by (x, v) can have entries, (2 n dim, 2 n dim).

    A particle's acceleration depends on its own state and on that of those that a spring ties to
    it; on their velocities only where there are dashpots.
    """
    n, dim = scene.particles.position.shape
    a, b = scene.springs.between.T
    tied = sparse.coo_matrix((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, a])), shape=(n, n))
    near = sparse.kron(tied + sparse.eye(n), np.ones((dim, dim)))
    damped = (scene.springs.damping != 0).any()
    return sparse.bmat(
        [[None, sparse.eye(n * dim)], [near, near if damped else sparse.eye(n * dim)]], "csr"
    )
