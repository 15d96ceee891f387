"""What frames cost with the settings that a run has had, and what they would with others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from taichi_cloth.kernels import methods
from taichi_cloth.runtime import current_device
from taichi_cloth.simulation.prediction import predict

if TYPE_CHECKING:
    from taichi_cloth.simulation.live import Setting
    from taichi_cloth.simulation.simulation import Simulation

RECENT = 0.1  # weight of a frame in the mean
WARM = 3  # frames after a change, that compile or fill caches


@dataclass(frozen=True)
class FrameCost:
    """What a frame costs. seconds: None where nothing is known. how: "measured", "predicted" or
    "not measured".
    """

    seconds: float | None
    how: str

    def words(self) -> str:
        """Such as "0.42 ms a frame, measured"."""
        if self.seconds is None:
            return self.how
        return f"{1e3 * self.seconds:.3g} ms a frame, {self.how}"


class RunningCosts:
    """Notes what frames take, by method, substeps, sweeps and features of the run."""

    def __init__(self) -> None:
        self._mean: dict[tuple[Any, ...], float] = {}
        self._frames: dict[tuple[Any, ...], int] = {}

    def note(self, sim: Simulation, seconds: float) -> None:
        """A frame took so many seconds to simulate."""
        way = _way(sim)
        count = self._frames[way] = self._frames.get(way, 0) + 1
        if count > WARM:
            mean = self._mean.get(way, seconds)
            self._mean[way] = mean + max(RECENT, 1 / (count - WARM)) * (seconds - mean)

    def now(self, sim: Simulation) -> FrameCost:
        """What a frame costs as the run is."""
        seconds = self._mean.get(_way(sim))
        return FrameCost(seconds, "not measured" if seconds is None else "measured")

    def of(self, sim: Simulation, setting: Setting, value: Any) -> FrameCost:
        """What a frame would cost with another value of a setting.

        Measured where the run had it; predicted from the present cost where steps, sweeps or the
        method say by how much it differs. Numbers that change no work cost what they cost now.
        """
        now = self.now(sim)
        way = _way(sim, **{setting.name: value})
        if way == _way(sim) and setting.group != "features":
            return now
        if way in self._mean and setting.group != "features":
            return FrameCost(self._mean[way], "measured")
        factor = _factor(sim, setting.name, value)
        if now.seconds is None or factor is None:
            return FrameCost(None, "not measured")
        return FrameCost(now.seconds * factor, "predicted")


def _way(sim: Simulation, **other: Any) -> tuple[Any, ...]:
    """What decides the work of a frame."""
    sweeps = other.get("iterations", sim.solver.get("iterations"))
    tolerance = other.get("tolerance", sim.solver.get("tolerance"))
    method = other.get("method", sim.method)
    if method != sim.method:
        settings = methods.load(method).claims.settings
        sweeps = sweeps if "iterations" in settings else None
        tolerance = tolerance if "tolerance" in settings else None
    steps = other.get("substeps", sim.substeps)
    return method, steps, sweeps, tolerance, sim.describe_size()


def _factor(sim: Simulation, name: str, value: Any) -> float | None:
    """By how much a frame's work changes with a setting; None: nobody knows."""
    if name == "substeps":
        return float(value) / sim.substeps
    if name == "iterations":  # beside the sweeps, each step has about the work of one
        return (1 + float(value)) / (1 + float(sim.solver["iterations"]))
    if name == "method":
        scene, device = sim.storage.scene, current_device()
        here, there = (
            predict(scene, methods.load(of), device, sim.topology, sim.execution).of(sim.substeps)
            for of in (sim.method, value)
        )
        return there / here
    return None
