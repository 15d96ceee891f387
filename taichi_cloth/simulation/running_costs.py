"""Costs of frames with the settings that a run has had, and with others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from taichi_cloth.errors import milliseconds
from taichi_cloth.kernels import methods
from taichi_cloth.runtime import current_device
from taichi_cloth.simulation.prediction import describe_size, predict

if TYPE_CHECKING:
    from taichi_cloth.scene.model import Scene
    from taichi_cloth.simulation.live import Setting
    from taichi_cloth.simulation.simulation import Simulation

RECENT = 0.1  # weight of a frame in the mean
WARM = 3  # frames after a change, that compile or fill caches


@dataclass(frozen=True)
class FrameCost:
    """The cost of a frame. seconds: None where nothing is known. how: "measured", "predicted" or
    "not measured".
    """

    seconds: float | None
    how: str

    def words(self) -> str:
        """Such as "0.42 ms a frame, measured"."""
        if self.seconds is None:
            return self.how
        return f"{milliseconds(self.seconds)} ms a frame, {self.how}"


class RunningCosts:
    """Notes what frames take, by method, substeps, sweeps and features of the run."""

    def __init__(self) -> None:
        self._mean: dict[tuple[Any, ...], float] = {}
        self._frames: dict[tuple[Any, ...], int] = {}
        self._paths: dict[tuple[Any, ...], str] = {}  # serial or parallel, of what is measured
        self._last: tuple[tuple[Any, ...], int] = (), 0  # the last frame's way, and how many had it
        self._sized: tuple[Scene, str] | None = None  # it lasts: to describe it takes up to 0.3 ms

    def note(self, sim: Simulation, seconds: float) -> None:
        """A frame took so many seconds to simulate."""
        way = self._way(sim)
        if self._paths.get(way) != sim.execution:  # what it took on other threads says nothing
            self._mean.pop(way, None)
            self._frames.pop(way, None)
            self._paths[way], self._last = sim.execution, ((), 0)
        lately = self._last[1] + 1 if way == self._last[0] else 1
        self._last = way, lately
        if lately > WARM:
            count = self._frames[way] = self._frames.get(way, 0) + 1
            mean = self._mean.get(way, seconds)
            self._mean[way] = mean + max(RECENT, 1 / count) * (seconds - mean)

    def now(self, sim: Simulation) -> FrameCost:
        """The cost of a frame as the run is."""
        seconds = self._mean.get(self._way(sim))
        return FrameCost(seconds, "not measured" if seconds is None else "measured")

    def of(
        self, sim: Simulation, setting: Setting, value: Any, substeps: int | None = None
    ) -> FrameCost:
        """The cost of a frame with another value of a setting.

        Measured where the run had it; predicted from the present cost where steps, sweeps, the
        method or features say by how much it differs. Numbers that change no work cost what they
        cost now. substeps: what a run that chooses them would have; None: as many as now.
        """
        now = self.now(sim)
        scene = setting.scene_with(sim, value) if setting.group == "features" else None
        way = self._way(sim, scene, **{setting.name: value})
        if way == self._way(sim):
            return now
        if way in self._mean:
            return FrameCost(self._mean[way], "measured")
        if now.seconds is None:
            return now
        if scene is not None:
            return FrameCost(_with_features(sim, scene, now.seconds), "predicted")
        factor = _factor(sim, setting.name, value, substeps)
        if factor is None:
            return FrameCost(None, "not measured")
        return FrameCost(now.seconds * factor, "predicted")

    def _way(self, sim: Simulation, scene: Scene | None = None, **other: Any) -> tuple[Any, ...]:
        """A key of the work of a frame; scene: in the place of the present one."""
        sweeps = other.get("iterations", sim.solver.get("iterations"))
        tolerance = other.get("tolerance", sim.solver.get("tolerance"))
        method = other.get("method", sim.method)
        if method != sim.method:
            settings = methods.load(method).claims.settings
            sweeps = sweeps if "iterations" in settings else None
            tolerance = tolerance if "tolerance" in settings else None
        steps = other.get("substeps", "auto" if sim.follows else sim.substeps)
        return method, steps, sweeps, tolerance, self._size(scene or sim.storage.scene)

    def _size(self, scene: Scene) -> str:
        if self._sized is None or self._sized[0] is not scene:
            self._sized = scene, describe_size(scene)
        return self._sized[1]


def _with_features(sim: Simulation, scene: Scene, now: float) -> float:
    """Seconds of a frame with the features of a scene, where it takes `now` with the present ones.

    What is predicted for both is taken off each other: a frame has work beside it that stays. A
    machine that is faster than the predicted one is so with a feature, too; a frame that takes
    longer may have other reasons than the machine.
    """
    method, device = methods.load(sim.method), current_device()
    here, there = (
        predict(of, method, device, sim.topology, sim.execution).of(sim.substeps)
        for of in (sim.storage.scene, scene)
    )
    return max(0.0, now + (there - here) * min(1.0, now / here))


def work_of(sweeps: float) -> float:
    """The work of a step with so many sweeps, in sweeps: beside these it has about that of one."""
    return 1 + sweeps


def _factor(sim: Simulation, name: str, value: Any, substeps: int | None) -> float | None:
    """By how much a frame's work changes with a setting; None: nobody knows."""
    if name == "substeps":
        return float(value) / sim.substeps
    if name == "iterations":
        return work_of(float(value)) / work_of(float(sim.solver["iterations"]))
    if name == "method":
        scene, device = sim.storage.scene, current_device()
        here, there = (
            predict(scene, methods.load(of), device, sim.topology, sim.execution).of(steps)
            for of, steps in ((sim.method, sim.substeps), (value, substeps or sim.substeps))
        )
        return there / here
    return None
