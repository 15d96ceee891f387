"""The cost of a scene's steps in each way of running it, predicted from its size.

Only how ways compare is asked of it. The numbers were measured on one processor of 2 cores: on
another one all of them are faster or slower, and what was remembered there corrects them
(`autotune.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from taichi_cloth.kernels import forces
from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.runtime import Device
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.solids import Solid, met_by_faces, number_of_solids
from taichi_cloth.settings.options import PATHS
from taichi_cloth.simulation.launch import Launcher
from taichi_cloth.simulation.storage.storage import Storage

LAUNCH = 30e-6  # seconds to launch a kernel
COUNT = 90e-6  # to ask a solver, after each launch of frames, how much it worked
WAKE = 50e-6  # until all threads are awake
WAKE_AGAIN = 20e-6  # soon after, between the launches of one step
SPREAD_LOOP = 50e-6  # of a loop that Taichi spreads over threads
MEETING = 1.5e-6  # of threads at the barriers of a pass over all springs
SHARED = 0.55  # part of the work that remains for each of two threads
# Seconds a particle and a spring, in a pass over all of them; on a graph one by one: where its rows
# are packed it takes some 0.25 to 0.5 of that, which is more than in lanes and changes no choice.
PASS = {"lanes": (2.4e-9, 0.8e-9), "graph": (2.0e-9, 4.4e-9)}
# Seconds a stencil of bending and a triangle in air, in each pass; a spring that may break, a step.
BENDING = {"lanes": 4e-9, "graph": 5e-9}
AIR = {"lanes": 15e-9, "graph": 19e-9}
FRACTURE = {"lanes": 0.4e-9, "graph": 1.4e-9}
# Seconds a particle and obstacle, a step: 9e-9 where they touch, 1e-9 where they are far apart.
OBSTRUCTED = 5e-9
# How much longer it takes in other precisions than f32.
LONGER = {
    "f32": {"lanes": 1.0, "graph": 1.0},
    "f64": {"lanes": 1.5, "graph": 1.15},
    "compensated": {"lanes": 3.0, "graph": 1.5},
}
# Passes of a solver's step, typically, by the setting that it takes.
SOLVER_PASSES = {"tolerance": 26, "iterations": 18}
HANDOVERS = 15  # launches of a step whose solver takes several kernels, typically
HANDOVER = 5e-6  # seconds from one of them to the next, which are prepared (`prepared.py`)
COLLIDING = 50e-9  # seconds a particle to sort it into cells and find whom it meets
COLLISION_LOOPS = 8  # loops that do it
RESTING_ITERATIONS = 10  # of pairs that rest on each other, typically
RESTING = 40e-9  # seconds a particle, in each


@dataclass(frozen=True)
class Cost:
    """The cost of a way of running.

    launch: seconds for each launch, whatever it does. step: seconds for each step besides.
    """

    launch: float
    step: float

    def of(self, steps: int) -> float:
        """Seconds that a launch of so many steps takes."""
        return self.launch + steps * self.step


class Prediction:
    """The candidates of `autotune` for what `storage` took: none of them is run.

    substeps: of a frame. name, method: of the method.
    On a GPU one thread would be slow, so there only "parallel" is worth a look.
    """

    def __init__(
        self, storage: Storage, launcher: Launcher, substeps: int, name: str, method: Method
    ) -> None:
        self._storage, self._device, self._method = storage, launcher.device, method
        self._scene, self.substeps = storage.scene, substeps
        self.scene_name = storage.scene.name
        self.key = "/".join([launcher.device.describe(), name, describe_size(storage.scene)])
        self.slow_to_compile = slow_to_compile(storage.scene, storage.solids)
        self.paths: tuple[str, ...] = PATHS if launcher.device.arch == "cpu" else ("parallel",)

    def topologies(self) -> list[str]:
        """The topologies that the scene can be stored in."""
        return self._storage.topologies()

    def predict(self, topology: str, path: str) -> Cost:
        """The cost of the scene in a topology, on a path."""
        return predict(self._scene, self._method, self._device, topology, path)


def predict(scene: Scene, method: Method, device: Device, topology: str, path: str) -> Cost:
    """The cost of a scene under a method, on a device, in a topology and on a path."""
    passes = method.claims.forces or max(
        SOLVER_PASSES.get(setting, 1) for setting in ("", *method.claims.settings)
    )
    features = scene.features()
    particle, spring = PASS[topology]
    work = particle * len(scene.particles) + spring * len(scene.springs)
    work += BENDING[topology] * int((scene.stencils.bending > 0).sum())
    if "air" in scene.world.more:
        work += AIR[topology] * len(scene.triangles)
    work = passes * work + FRACTURE[topology] * features.fracture * len(scene.springs)
    work += OBSTRUCTED * number_of_solids(scene) * len(scene.particles)
    work *= LONGER[device.precision][topology]
    collisions = features.collisions
    if collisions:
        work += COLLIDING * len(scene.particles)
    iterations = RESTING_ITERATIONS * features.resting
    work += iterations * RESTING * len(scene.particles)
    counts = COUNT if method.claims.forces == 0 else 0.0
    handovers = HANDOVERS * HANDOVER if topology == "lanes" and method.launches else 0.0
    if path == "serial":
        return Cost(LAUNCH + counts, work + handovers)
    shared = work * (SHARED if device.threads > 1 else 1.0) * 2 / max(device.threads, 2)
    if device.arch != "cpu":  # where there is nothing to choose from but topologies
        loops = passes * 2 + COLLISION_LOOPS * collisions + 3 * iterations
        return Cost(counts, shared + loops * SPREAD_LOOP)
    # Where each step takes several launches, the threads are woken for each.
    woken = HANDOVERS * WAKE_AGAIN if handovers else 0.0
    meetings = passes + COLLISION_LOOPS * collisions + 3 * iterations
    return Cost(LAUNCH + counts + WAKE, shared + handovers + woken + meetings * MEETING)


def slow_to_compile(scene: Scene, solids: Sequence[Solid]) -> tuple[str, ...]:
    """The topologies that take longer to compile than their steps are worth (docs/design.md).

    solids: what is in the scene's way. That is lanes where a cloth's faces meet it, or pairs rest.
    """
    slow = scene.features().resting or bool(met_by_faces(scene, solids))
    return ("lanes",) if slow else ()


def describe_size(scene: Scene) -> str:
    """A key of a step's cost besides the device: features, and sizes by powers of two."""
    sizes = len(scene.particles).bit_length(), len(scene.springs).bit_length()
    return f"{forces.describe(scene)}; 2^{sizes[0]} particles, 2^{sizes[1]} springs"
