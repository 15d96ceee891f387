"""The engine of a scene, and its exchange for another while the scene goes on."""

from __future__ import annotations

from typing import Any

from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods
from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.kernels.state import FORCES
from taichi_cloth.settings import accepted
from taichi_cloth.settings.options import SOLVER_SETTINGS
from taichi_cloth.simulation.acts import act
from taichi_cloth.simulation.auto_substeps import AutoSubsteps
from taichi_cloth.simulation.launch import Launcher
from taichi_cloth.simulation.numbers import solver_settings
from taichi_cloth.simulation.part import Part
from taichi_cloth.simulation.prediction import slow_to_compile
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.storage.storage import Storage

MOST_ENGINES = 3  # methods that a run has had, whose fields and kernels are kept for their return
# Why a change that compiles makes a window wait (`compiles_in_background`).
ALONE = (
    "Taichi compiles in the thread that started it, and knows what is in its cache "
    "from when it started"
)


def compiles_in_background() -> str:
    """Why kernels cannot be compiled while a run goes on; "": they can.

    Taichi 1.7 refuses to work in a second thread, and reads the list of what other processes have
    compiled once, when it starts: what another process compiles meanwhile is compiled again.
    """
    return ALONE


class Engine(Part):
    """The part of a `Simulation` that has the method, and changes it."""

    # All that is the method's, or was chosen for it; a checkpoint goes back to it.
    ENGINE = (
        *("method", "_module", "claims", "_launcher", "_storage", "execution", "topology"),
        *("_preferred", "_requested", "_watch", "held_up", "changes_over", "_ready"),
    )

    @act
    def set_solver(self, tolerance: float | None = None, iterations: int | None = None) -> None:
        """From now on solve steps to a relative residual, or with so many sweeps; absent: as now.

        InputError where the method does not take it, or it is out of its limits.
        """
        solver_settings(
            self.method, self.claims, tolerance, iterations
        )  # refuses what is not taken
        given = {"tolerance": tolerance, "iterations": iterations}
        self.solver |= {name: value for name, value in given.items() if value is not None}
        self.storage.set_numbers(self._numbers())

    @act
    def set_method(self, method: str) -> None:
        """Go on with another method: where particles are, time, what broke and all else stays.

        Settings that the new method takes stay as they were, where the old one took them, too; what
        it keeps from step to step is computed anew. With dt "auto" the substeps are chosen for it.
        It compiles the method's kernels, as at a start. In which topology, is no matter of what the
        machine knows of costs, so that a log's replay does the same: in lanes where the run has
        lanes, unless these take long to compile (`prediction.slow_to_compile`), else on the graph.
        A method that the run had before compiles nothing, unless it would be stored otherwise now;
        the first one goes back to how it was.
        InputError for an unknown one, and for one that dt "auto" refuses; all is then as it was.
        """
        accepted.word("--method", method, methods.METHODS)
        if method == self.method:
            return
        names = (*self.ENGINE, "solver", "dt", "substeps", "speed_limit", "_since", "_auto")
        before = {name: getattr(self, name) for name in names} | {"_engines": {**self._engines}}
        now, storage = self.storage.snapshot(), self.storage
        held, pushed = storage.held(), storage.pushed
        counted = self.work().force_evaluations, self.steps
        self._take_unsettled()
        try:
            self._take_method(method, now)
            self._store(now)
        except InputError:
            for name, value in before.items():
                setattr(self, name, value)
            raise
        self._counted, self._work[FORCES] = counted, 0
        self.storage.hold_again(held, pushed)

    def topology_of(self, method: str) -> str:
        """The topology that the run has under a method, or would have after `set_method`."""
        accepted.word("--method", method, methods.METHODS)
        if method == self.method:
            return self.topology
        kept = self._kept(method)
        return str(kept["topology"]) if kept else self._topology_of_others()

    def _kept(self, method: str) -> dict[str, Any] | None:
        """The kept part of a method; None also if it would be made in another topology now, as by
        the replay of a log that knows nothing of frames which a run went back from.
        """
        kept = self._engines.get(method)
        first = method == self.began["method"]
        same = kept is None or first or kept["topology"] == self._topology_of_others()
        return kept if same else None

    def _topology_of_others(self) -> str:
        """The topology of a method that the run has not had yet."""
        slow = slow_to_compile(self.storage.scene, self.storage.solids)
        return "graph" if self.topology in slow else self.topology

    def _take_method(self, method: str, now: Snapshot) -> None:
        module, solver = methods.load(method), self.solver
        self._engines[self.method] = {name: getattr(self, name) for name in self.ENGINE}
        kept = self._kept(method)
        self._engines.pop(method, None)
        if kept:
            for name, value in kept.items():
                setattr(self, name, value)
        else:
            self._make_engine(method, module, now)
        while len(self._engines) > MOST_ENGINES:
            del self._engines[next(iter(self._engines))]
        self.solver = {
            name: solver.get(name, SOLVER_SETTINGS[name]) for name in self.claims.settings
        }
        if self._auto:
            self._auto = AutoSubsteps(method, module, self.dt)
            self._take_substeps(self._auto.for_state(now))

    def _make_engine(self, method: str, module: Method, now: Snapshot) -> None:
        device, accounts = self._launcher.device, self.storage.accounts_contacts
        topology = self._topology_of_others()
        self.method, self._module, self.claims = method, module, module.claims
        self._launcher = Launcher(module, device, soon=self._launcher.soon)
        lanes = self._lanes_for(module)
        # A run in sixteen lanes may go on with a method that takes but eight.
        lanes = min(lanes, module.most_lanes(now.scene.world.dim) or lanes)
        self._storage = Storage(module, lanes, self._launcher, now, accounts)
        self.execution = self.topology = ""  # `_store` chooses them
        self._watch = self.held_up = None
        self.changes_over = self._ready = False
        if topology not in self.storage.topologies():
            topology = "graph"
        self._requested = topology, self._requested[1]
