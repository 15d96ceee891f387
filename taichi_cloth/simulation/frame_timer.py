"""Times frames of a scene in each way that it can be run, for `autotune`."""

from __future__ import annotations

import time

from taichi_cloth.kernels import forces
from taichi_cloth.scene.model import Scene
from taichi_cloth.settings.options import PATHS
from taichi_cloth.simulation.launch import Launcher
from taichi_cloth.simulation.numbers import Numbers
from taichi_cloth.simulation.storage import Storage


class FrameTimer:
    """The candidates of `autotune` for what `storage` took, which must be loaded anew after it.

    substeps: of a frame. method: its name.
    On a GPU one thread would be slow, so there only "parallel" is worth a look.
    """

    def __init__(
        self,
        storage: Storage,
        launcher: Launcher,
        numbers: Numbers,
        substeps: int,
        method: str,
    ) -> None:
        self._storage, self._launcher = storage, launcher
        self._numbers, self.substeps = numbers, substeps
        self.scene_name = storage.scene.name
        size = describe_size(storage.scene)
        self.key = "/".join([launcher.device.describe(), method, size])
        self.paths: tuple[str, ...] = PATHS if launcher.device.arch == "cpu" else ("parallel",)

    def topologies(self) -> list[str]:
        """The topologies that the scene can be stored in."""
        return self._storage.topologies()

    def time_candidate(self, topology: str, path: str) -> float:
        """Seconds a step takes, undisturbed: the least of at least three frames after a warm-up."""
        self._storage.load(topology, path, self._numbers)
        self._advance()  # compiles
        seconds: list[float] = []
        deadline = time.perf_counter() + 0.15
        while len(seconds) < 3 or (time.perf_counter() < deadline and len(seconds) < 50):
            begin = time.perf_counter()
            self._advance()
            seconds.append(time.perf_counter() - begin)
        self._storage.take_work()  # none of it is the run's
        return min(seconds) / self.substeps

    def _advance(self) -> None:
        storage = self._storage
        storage.begin()
        self._launcher.advance(storage.specialization, storage.state, 0, 1, self.substeps)


def describe_size(scene: Scene) -> str:
    """What decides a step's cost besides the device: features, and sizes by powers of two."""
    sizes = len(scene.particles).bit_length(), len(scene.springs).bit_length()
    return f"{forces.describe(scene)}; 2^{sizes[0]} particles, 2^{sizes[1]} springs"
