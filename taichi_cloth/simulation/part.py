"""The shared base of a simulation's parts: the run as it is, and what changes it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.kernels.methods.contract import Claims, Method
from taichi_cloth.limits.network import Network
from taichi_cloth.runtime import still_runs
from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation import autotune, diagnostics
from taichi_cloth.simulation.acts import Listener
from taichi_cloth.simulation.auto_substeps import AutoSubsteps
from taichi_cloth.simulation.launch import Launcher
from taichi_cloth.simulation.numbers import Numbers
from taichi_cloth.simulation.past import Past
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.storage.storage import Storage


class Part(ABC):
    """A part of a `Simulation`: what it may use of the others.

    scene: as it was given, with what tools switched on in its world; _given: without.
    listeners: who is told of acts and frames (`acts.py`), in this order. past: what led here.
    _module: the method's declaration. _auto: what chooses the substeps with dt "auto", else None.
    _requested: topology and execution as asked for; _preferred: the topology of the next load.
    _watch: what times launches. _engines: of methods that the run had, by name (`Engine.ENGINE`).
    began: method, dt, substeps and solver settings that the run of its scene began with.
    _ready: whether what only the pointer needs is compiled.
    _since: frame, time and steps when the step last changed.
    _work: counts of the solver's work (`kernels.state.WORK`), evaluations of forces since the
    method last changed; _counted: how many of these, and steps, there were then; _first: the steps
    that were done by another run, from which this one goes on.
    _unsettled: counts of the steps that ended with pairs that overlap and with faces inside
    obstacles, but for those that the device has counted since its last load.
    """

    scene: Scene
    _given: Scene
    method: str
    claims: Claims
    solver: dict[str, float]
    frame: int
    dt: float
    substeps: int
    speed_limit: float
    execution: str
    topology: str
    held_up: tuple[float, float] | None
    changes_over: bool
    aside: str
    listeners: tuple[Listener, ...] = ()
    past: Past | None
    _module: Method
    _launcher: Launcher
    _storage: Storage
    _auto: AutoSubsteps | None
    _requested: tuple[str, str]
    _preferred: str
    _watch: autotune.Watch | None
    _engines: dict[str, dict[str, Any]]
    began: dict[str, Any]
    _ready: bool
    _since: tuple[int, float, int]
    _work: np.ndarray
    _counted: tuple[int, int]
    _first: int
    _unsettled: np.ndarray

    @property
    def storage(self) -> Storage:
        """The state on the device, to look at.

        InputError where Taichi was started anew since: its memory is another's by now, and to read
        or write it would end the process.
        """
        if not still_runs(self._launcher.device):
            raise InputError(
                f"the simulation of '{self.scene.name}' is gone with the start of Taichi that it "
                "was made on; make it anew after the last `start`"
            )
        return self._storage

    @property
    @abstractmethod
    def steps(self) -> int:
        """Steps done since the start."""

    @property
    @abstractmethod
    def time(self) -> float:
        """Simulated time, in the scene's units."""

    @property
    @abstractmethod
    def particle_count(self) -> int:
        """The number of particles."""

    @property
    @abstractmethod
    def spring_count(self) -> int:
        """The number of springs, broken ones included."""

    @abstractmethod
    def network(self) -> Network:
        """The particles where they are, and the springs that pull."""

    @abstractmethod
    def work(self) -> diagnostics.Work:
        """Acts since the start."""

    @abstractmethod
    def _lanes_for(self, module: Method) -> int:
        """The number of particles that a pack has under a method."""

    @abstractmethod
    def _store(self, snapshot: Snapshot) -> None:
        """Put a state on the device; the first time, choose how it is run."""

    @abstractmethod
    def _take_unsettled(self) -> None:
        """Take over what the device has counted of unsettled steps: a load begins at 0."""

    @abstractmethod
    def _change_step(self, dt: float, substeps: int) -> None:
        """Go on counting with another step."""

    @abstractmethod
    def _take_substeps(self, chosen: int) -> bool:
        """Go on with as many substeps a frame, as dt "auto" wants; whether that is a change."""

    @abstractmethod
    def _numbers(self) -> Numbers:
        """The run's settings, as numbers for the device."""

    @abstractmethod
    def _edit(
        self,
        now: Snapshot,
        edited: Snapshot,
        left: np.ndarray | None = None,
        topology: str | None = None,
    ) -> None:
        """Go on from an edited state; left: which of the particles are left, all where absent.

        topology: in which it is stored from now on; absent: as it is.
        """
