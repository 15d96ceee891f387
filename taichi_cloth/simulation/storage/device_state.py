"""One state on the device: what was put there last, and what is known of it since."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_cloth.kernels import readback
from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.runtime import Device
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.solids import Solid, met_by_faces, solids
from taichi_cloth.simulation.launch import Launcher
from taichi_cloth.simulation.numbers import Numbers
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.storage.boxes import Real
from taichi_cloth.simulation.storage.containers import Container
from taichi_cloth.simulation.storage.layouts import Layout
from taichi_cloth.simulation.storage.placement import Placement, Placements
from taichi_cloth.simulation.storage.surfaces import Surfaces
from taichi_cloth.simulation.storage.upload import Upload


@dataclass(frozen=True)
class Loaded:
    """The products of the last load.

    number: which load of its state it was, `of`. placements, solids: those of the scene loaded.
    """

    number: int
    of: weakref.ref[DeviceState]
    container: Container
    placement: Placement
    specialization: Specialization
    numbers: Numbers
    placements: Placements
    solids: Sequence[Solid]


class DeviceState:
    """A state on the device, as all parts of a `Storage` know it.

    solids: what is in the way of the scene that was taken last (`scene.solids`).
    real: type of the device's numbers. topology, path: how it was loaded. loads: how often anything
    was. pushed: whether a push lasts until the frame's end. accounts_contacts: whether
    `account_contacts` may be called.
    """

    def __init__(
        self,
        method: Method,
        lanes: int,
        launcher: Launcher,
        snapshot: Snapshot,
        accounts_contacts: bool = False,
    ) -> None:
        self._method, self._lanes, self._launcher = method, lanes, launcher
        self._needs = method.needs
        self.accounts_contacts = accounts_contacts
        self.real: Real = np.float64 if launcher.device.real == "f64" else np.float32
        self._taken = snapshot
        self.solids = solids(snapshot.scene)
        self._placements = self._placements_of(snapshot.scene)
        self.topology = self.path = ""
        self.loads = 0
        self.pushed = self._held = False
        self._loaded: Loaded | None = None
        self._altered = True  # from outside, so that what the method keeps must be computed anew
        # What a window draws: see `Download`.
        self._drawn_positions = np.zeros((0, 0))
        self._drawn_springs: np.ndarray | None = None  # they are to be asked for anew
        self._drawn_triangles: np.ndarray | None = None
        self._drawn_broken = 0
        self._surfaces = Surfaces()

    def _placements_of(self, scene: Scene) -> Placements:
        """Finds the placements of a scene, of which self.solids are."""
        return Placements(scene, self._needs, self._lanes, self._may_pack(scene))

    def _may_pack(self, scene: Scene) -> bool:
        """True if rows of a graph may be packed here, in a scene of which self.solids are.

        Solvers go through springs in ways of their own. Where a cloth's faces meet what is in its
        way, most of a step is that, and packs would take seconds more to compile.
        """
        explicit = self._launcher.device.arch == "cpu" and self._method.claims.forces > 0
        return explicit and not met_by_faces(scene, self.solids)

    @property
    def device(self) -> Device:
        """Its device."""
        return self._launcher.device

    @property
    def altered(self) -> bool:
        """True if the state was changed from outside since the last step."""
        return self._altered

    @property
    def scene(self) -> Scene:
        """The scene with all that was spawned, every particle where it began."""
        return self._taken.scene

    @property
    def state(self) -> Any:
        """The fields, a `kernels.state.State`."""
        return self._now.container.state

    @property
    def layout(self) -> Layout:
        """The placement of particles and springs."""
        return self._now.placement.layout

    @property
    def specialization(self) -> Specialization:
        """The specialization that advances frames."""
        return self._now.specialization

    @property
    def _now(self) -> Loaded:
        if self._loaded is None:
            raise RuntimeError("nothing is on the device before `load`")
        return self._loaded

    def _launch(self, kernel: Any, *arguments: Any) -> Any:
        container = self._now.container
        return self._launcher.launch(kernel, container.spec, container.state, *arguments)

    def _read_field(self, of: Any) -> np.ndarray:
        out = np.zeros((len(self.scene.particles), self.scene.world.dim), self.real)
        self._read_vectors(of, out)
        values: np.ndarray = out.astype(np.float64)
        return values

    def _read_vectors(self, of: Any, out: np.ndarray) -> None:
        """Copy a field of vectors in packs to `out` (n, dim), in the order of the particles."""
        container = self._now.container
        if len(out) == 0:
            return  # a kernel takes no empty array
        if readback.is_by_host(container.state, len(out)):
            readback.vectors_in_memory(container.spec, container.state, of, out)
        else:
            self._launch(readback.read_vectors, of, out)

    def through(self) -> int:
        """The number of elements that go through an obstacle since they were put there."""
        return int(self._taken.judged.through.sum())

    def carried(self) -> np.ndarray:
        """Which of `solids` each particle goes with, (n,), -1: none."""
        grips = self._taken.grips
        return np.full(len(self._taken.x), -1) if grips is None else grips.by

    def _upload(self) -> Upload:
        now = self._now
        return Upload(
            launcher=self._launcher,
            spec=now.container.spec,
            state=now.container.state,
            snapshot=self._taken,
            placements=self._placements,
            placement=now.placement,
            solids=self.solids,
            needs=self._needs,
            real=self.real,
        )
