"""Contestants: ours, Newton's and SciPy's solvers, each as something that runs a `Choice`."""

from __future__ import annotations

import pickle
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from bench import newton_model
from bench.contest import Bench
from bench.equal_error.problems import Problem
from bench.equal_error.search import Choice, Tried
from bench.equal_error.truth import Truth
from taichi_cloth.measuring.worker import Worker, WorkerFailed
from taichi_cloth.settings.options import default_fast_math
from taichi_cloth.sweeps.journal import Journal, key_of
from taichi_cloth.sweeps.within import TimeIsUp
from taichi_cloth.trade.errors import Samples
from taichi_cloth.trade.process import AGAIN

OURS = "ours"
HERE = "bench.equal_error"
# The solvers of `scipy_runs`, which is imported where they run.
SCIPY = {"SciPy, DOP853": "DOP853", "SciPy, Radau": "Radau", "SciPy, BDF": "BDF"}
FINEST = 1 << 16  # substeps, at most
ITERATIONS, QUICK_ITERATIONS = (1, 2, 5, 10, 20, 50), (2, 10)
TOLERANCES = tuple(10.0**-k for k in range(1, 13))
OUR_TOLERANCES, QUICK_TOLERANCES = (1.0, 1e-2, 1e-4, 1e-6), (1e-4,)  # of our implicit methods
CONTACTS = (1e3, 1e5)  # N/m
QUICK_METHODS = ("verlet", "rk4", "tr_bdf2")
# Seconds for timing a choice in the search, and of a run that is itself timing enough.
BUDGET, LONG = 0.1, 1.0
ALONE = 1  # threads of everyone in the search, and of peers always: they have no more


@dataclass(frozen=True)
class Kind:
    """A solver: its group, of whose members the cheapest counts; its name; its class in a process.

    ladders: choices to climb, each ladder coarsest first. package: what has to be installed. way:
    how it is run, in words, where the same bits can be had in more than one way.
    """

    group: str
    name: str
    trial: str
    arguments: dict[str, Any]
    ladders: tuple[tuple[Choice, ...], ...]
    precision: str = "f64"
    package: str = "taichi"
    way: str = ""

    @property
    def threads(self) -> int:
        """The number of its threads."""
        threads: int = self.arguments.get("threads", ALONE)
        return threads

    @property
    def material(self) -> str:
        """Our material in its numbers, where it takes other ones."""
        of_newton = self.package == "newton"
        return newton_model.material_of(self.arguments["solver"]) if of_newton else ""

    def other_way(self, threads: int) -> Kind | None:
        """The same with the same bits: ours on so many threads, Newton launched from Python."""
        arguments = self.arguments
        if "execution" in arguments and threads != self.threads:
            more, way = {"threads": threads, "execution": "parallel"}, f"{threads} threads"
        elif arguments.get("recorded"):
            more, way = {"recorded": False}, "launched"
        else:
            return None
        return replace(self, name=f"{self.name}, {way}", arguments=arguments | more, way=way)


def kinds(quick: bool, touching: bool = False) -> Iterator[Kind]:
    """All that take part; touching: in a scene with contacts.

    There each of Newton's solvers whose contacts are springs takes part with each of their
    stiffnesses.
    """
    yield from _ours(quick)
    counts = QUICK_ITERATIONS if quick else ITERATIONS
    for name, (solver, iterates) in newton_model.SOLVERS.items():
        ladders = [_steps(iterations=count) for count in (counts if iterates else (None,))]
        trial = f"{HERE}.newton_runs:NewtonTrial"
        for k in CONTACTS if touching and solver in newton_model.PENALTIES else (0.0,):
            arguments = {"solver": solver, "contact_stiffness": k, "recorded": True}
            full = f"{name}, contacts of {k:g} N/m" if k else name
            yield Kind(name, full, trial, arguments, tuple(ladders), "f32", "newton", "recorded")
    ladder = tuple(Choice(tolerance=tolerance) for tolerance in TOLERANCES)
    for name, solver in SCIPY.items():
        trial = f"{HERE}.scipy_runs:ScipyTrial"
        yield Kind(name, name, trial, {"solver": solver}, (ladder,), package="scipy")


def unfit(kind: Kind, problem: Problem) -> str:
    """Why a solver cannot take part in a scene; '': it can."""
    if kind.package == "newton":
        return newton_model.lacking(problem.scene, kind.arguments["solver"])
    if kind.package == "scipy" and problem.touching:
        return "contacts are no part of a differential equation"
    return ""


def _ours(quick: bool) -> Iterator[Kind]:
    from taichi_cloth.kernels import methods

    counts = QUICK_ITERATIONS if quick else ITERATIONS
    residuals = QUICK_TOLERANCES if quick else OUR_TOLERANCES
    # Those first that are likely to be the cheapest: the search then spares the others' dear runs.
    claimed = {name: methods.load(name).claims for name in methods.METHODS}
    likely = sorted(claimed, key=lambda name: (claimed[name].implicit, -claimed[name].order))
    for method in QUICK_METHODS if quick else likely:
        claims = claimed[method]
        ladders: tuple[tuple[Choice, ...], ...] = (_steps(),)
        if "iterations" in claims.settings:
            ladders = tuple(_steps(iterations=count) for count in counts)
        elif "tolerance" in claims.settings:
            ladders = tuple(_steps(tolerance=residual) for residual in residuals)
        # Methods of the first order do not come to where f32 ends.
        for precision in ("f32",) if claims.order < 2 else ("f32", "f64"):
            arguments = {
                "method": method,
                "arch": "cpu",
                "precision": precision,
                "fast_math": default_fast_math(precision),
                "threads": ALONE,
                "topology": "lanes",
                "execution": "serial",
                "accounts": False,
            }
            name, trial = f"{OURS}, {method}, {precision}", "taichi_cloth.trade.trial:Trial"
            yield Kind(OURS, name, trial, arguments, ladders, precision)


def _steps(**solver: Any) -> tuple[Choice, ...]:
    doublings = range(FINEST.bit_length())
    return tuple(Choice(substeps=1 << k, **solver) for k in doublings)


class CannotEnter(WorkerFailed):
    """A solver cannot be made for a scene, or its process is lost again and again."""


@dataclass
class Entrant:
    """A solver on a problem: called with a choice, it runs and times it, or reads that it has.

    patience: seconds that a run of a solver that chooses its own steps may take. journal: has what
    is finished, and gets it. about: what its process says of it. tried: all runs that were asked
    for, in their order. Its process begins with the first run that is not in the journal; where it
    is killed, what was asked of it is asked of another one, AGAIN times.
    """

    bench: Bench
    kind: Kind
    problem: Problem
    truth: Truth
    patience: float
    journal: Journal
    about: dict[str, Any] = field(default_factory=dict)
    tried: list[Tried] = field(default_factory=list)
    _worker: Worker | None = None

    def __call__(self, choice: Choice) -> Tried:
        """The outcome of a choice. Raises CannotEnter, or TimeIsUp."""
        kind = self.kind
        of = kind.name, kind.trial, kind.arguments, asdict(choice)
        key = key_of("run", self.problem.digest, *of)
        entry = self.journal.get(key)
        if entry is None:
            if self.bench.piece.clock.left() <= 0:  # where there is no timer
                raise TimeIsUp
            done = self._run(choice)
            result = {"error": done.error, "seconds": done.seconds, "failed": done.failed}
            entry = self.journal.add(key, result)
        self.tried.append(Tried(choice, **entry.result))
        return self.tried[-1]

    def of_kind(self, kind: Kind) -> Entrant:
        """Another solver on the same problem, which has still to be made in its process."""
        return replace(self, kind=kind, about={}, tried=[], _worker=None)

    def _run(self, choice: Choice) -> Tried:
        self.bench.tell(f"{self.problem.name}: {self.kind.name}, {choice.describe()}", 0, 1)
        file = self.bench.folder / "sample.npz"
        frames = self.truth.frames
        try:
            done = self._ask("sample", choice, file=str(file))
        except CannotEnter:
            raise
        except WorkerFailed as failure:
            return Tried(choice, failed=str(failure))
        try:
            if done["failed"]:
                gave_up = done["sampled_in"] / frames if done.get("gave_up") else None
                return Tried(choice, None, gave_up, done["failed"].removeprefix("failed: "))
            error = self.truth.error_of(Samples.read(file))
            if error is None:
                return Tried(choice, failed="is not finite")
        finally:
            file.unlink(missing_ok=True)
        if done["sampled_in"] > LONG:
            return Tried(choice, error, done["sampled_in"] / frames)
        return Tried(choice, error, min(self.time(choice, BUDGET)))

    def time(self, choice: Choice, budget: float = 0.0) -> list[float]:
        """Seconds a frame of runs of a choice: one, and more while there is budget."""
        seconds = self._ask("time", choice, budget=budget)
        return [whole / self.truth.frames for whole in seconds]

    def _ask(self, do: str, choice: Choice, **more: Any) -> Any:
        """Raises WorkerFailed, and where not the run alone is at fault, CannotEnter."""
        given = {"iterations": choice.iterations, "tolerance": choice.tolerance}
        asked: dict[str, Any] = {
            "dt": self.problem.scene.world.dt,
            "frames": self.truth.frames,
            "solver": {name: value for name, value in given.items() if value is not None},
        }
        if choice.substeps is not None:
            asked["substeps"] = choice.substeps
        lost = ""
        for _ in range(1 + AGAIN):
            worker = self.bench.worker(self.kind.package, self.kind.precision, self.kind.threads)
            try:
                if worker is not self._worker:
                    self._enter(worker)
                return worker.ask(of=self._key, do=do, **{"with": asked | more})["result"]
            except WorkerFailed as failure:
                if worker.alive:
                    raise
                lost = str(failure)
        raise CannotEnter(f"{choice.describe()}: {lost}, {1 + AGAIN} times in turn")

    @property
    def _key(self) -> str:
        return f"{self.problem.name}: {self.kind.name}"

    def _enter(self, worker: Worker) -> None:
        """Make the solver in its process."""
        self.bench.tell(f"{self.problem.name}: preparing {self.kind.name}", 0, 1)
        name = re.sub("[^a-z0-9]+", "-", self.problem.name.lower())
        file = self.bench.folder / f"{name}.pickle"
        if not file.exists():
            file.write_bytes(pickle.dumps(self.problem.scene))
        arguments = {"scene": str(file), **self.kind.arguments}
        if self.kind.package == "scipy":
            own = {"length": self.truth.scale, "speed": self.truth.speed, "patience": self.patience}
            arguments |= own
        made: dict[str, Any] = {"as": self._key, "with": arguments}
        try:
            self.about = worker.ask(make=self.kind.trial, **made)["result"]
        except WorkerFailed as failure:
            raise CannotEnter(str(failure)) if worker.alive else failure from None
        self._worker = worker
