"""Conditions of a study: how its settings are run, beside what is compared."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from taichi_cloth.errors import InputError
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.solids import solids
from taichi_cloth.settings.sweeps import ComparisonOptions
from taichi_cloth.simulation.prediction import slow_to_compile
from taichi_cloth.simulation.storage import adjacency
from taichi_cloth.sweeps.within import Clock, clock
from taichi_cloth.trade import settings

# Of the time there is: what references may take, and, besides, what solves the equation; what
# timing all settings may take.
REFERENCES, TIMING = 0.15, 0.2


@dataclass(frozen=True)
class RunConditions:
    """Conditions of a study's runs, beside what is compared.

    topology, execution, threads: as in `run`, the first two never "auto": to measure which is
    fastest takes longer than a whole study. budget: seconds of timing for each setting;
    patience: seconds for the references. solver_errors: whether solvers are run converged, too.
    clock: when it has to end, and leave out the rest. accounts: whether what contacts do to the
    energy is accounted for. references: whether there is what to compare whole runs to. whole:
    whether settings run all frames asked for; else those before chance begins.
    """

    topology: str
    execution: str
    threads: int | None = None
    budget: float = 0.3
    patience: float = 20.0
    solver_errors: bool = True
    clock: Clock = field(default_factory=Clock)
    accounts: bool = True
    references: bool = True
    whole: bool = False

    def of_trial(self, process: settings.Process) -> dict[str, Any]:
        """The way a trial in a process of these kinds runs its scene, as its class takes it."""
        arch, precision, fast_math = process
        return {
            "arch": arch,
            "precision": precision,
            "fast_math": fast_math,
            "threads": self.threads if arch == "cpu" else None,
            "topology": self.topology,
            "execution": "parallel" if arch != "cpu" else self.execution,
            "accounts": self.accounts,
        }

    def words(self) -> list[str]:
        """The flags of `run` that stand for it."""
        words = ["--topology", self.topology, "--execution", self.execution]
        return words + (["--threads", str(self.threads)] if self.threads else [])


def conditions(
    scene: Scene, options: ComparisonOptions, settings_compared: int = 1
) -> RunConditions:
    """How a scene is run, from the command's settings, the scene's size, and how many settings are
    compared.
    """
    n = len(scene.particles)
    has_grid = bool(adjacency.find_grids(scene.springs.between, n))
    if options.topology == "lanes" and not has_grid:
        raise InputError(
            f"--topology lanes: the springs of scene '{scene.name}' form no regular grid; "
            "use --topology graph"
        )
    best = best_for(scene, options.threads)
    stored = best[0] if options.topology == "auto" else options.topology
    run = best[1] if options.execution == "auto" else options.execution
    made = RunConditions(stored, run, options.threads)
    end = clock(options.within, options.quick)
    if not end.limited:
        return made
    budget = min(max(TIMING * end.seconds / settings_compared, 0.01), made.budget)
    patience = min(REFERENCES * end.seconds, made.patience)
    return replace(made, budget=budget, patience=patience, clock=end)


def best_for(scene: Scene, threads: int | None) -> tuple[str, str]:
    """Topology and execution that suit a scene by its size, on so many threads (None: all)."""
    n = len(scene.particles)
    lanes = n >= settings.FEW_PARTICLES and bool(adjacency.find_grids(scene.springs.between, n))
    lanes = lanes and "lanes" not in slow_to_compile(scene, solids(scene))
    one = threads == 1 or (threads is None and n <= settings.SERIAL_BEST)
    return "lanes" if lanes else "graph", "serial" if one else "parallel"


def without_mouse(scene: Scene) -> Scene:
    """The scene that is compared: nobody moves a mouse. InputError where nothing can move."""
    if not (~scene.particles.fixed).any():
        raise InputError(
            f"scene '{scene.name}' has no particle that can move: there is nothing to compare"
        )
    return replace(scene, world=replace(scene.world, mouse="none"))
