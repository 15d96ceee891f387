"""Contestants that take turns: each in a process of its library, precision and thread count.

A round lets every contestant do its share of work once, so that a drift of the machine meets them
all. The first round warms up and is not counted.
"""

from __future__ import annotations

import contextlib
import statistics
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.report import Measurement
from taichi_cloth import runtime
from taichi_cloth.console import Tell, tell_nobody
from taichi_cloth.measuring import machine
from taichi_cloth.measuring.timing import quartiles, turns
from taichi_cloth.measuring.worker import Worker, WorkerFailed
from taichi_cloth.sweeps.within import Clock

FINER = 16  # the reference's steps are this many times shorter


@dataclass(frozen=True)
class Piece:
    """A piece of a part that takes hours, and has a journal.

    scenes: only these, by their keys; none: all. clock: when it has to end. resume: whether it goes
    on with what an earlier piece has finished.
    """

    scenes: Sequence[str] = ()
    clock: Clock = field(default_factory=Clock)
    resume: bool = False


@dataclass
class Contestant:
    """One setting that is timed. A unit of its work is `steps` steps of `particles` particles.

    units: work in a round. method: what is called with the number of units. about: what the
    process says of it: execution, topology, threads, note. seconds: of each counted round, one
    unit. marks: positions by the units done when they were read.
    """

    name: str
    worker: Worker
    key: str
    size: str
    precision: str
    particles: int
    steps: int
    units: int
    packages: tuple[str, ...] = ()
    method: str = "advance"
    about: dict[str, Any] = field(default_factory=dict)
    seconds: list[float] = field(default_factory=list)
    marks: dict[int, np.ndarray] = field(default_factory=dict)
    done: int = 0

    def advance(self, units: int) -> float:
        """Do so many units of work; return the seconds that one took."""
        answer = self.worker.ask(of=self.key, do=self.method, **{"with": {"units": units}})
        self.done += units
        seconds: float = answer["seconds"]
        return seconds / units

    def mark(self) -> None:
        """Keep the positions as they are now."""
        path = Path(self.worker.ask(of=self.key, do="positions", **{"with": {}})["result"])
        self.marks[self.done] = np.load(path).astype(np.float64)
        path.unlink()

    @property
    def step_seconds(self) -> float:
        """Median seconds of a step."""
        return statistics.median(self.seconds) / self.steps

    def drop(self) -> None:
        """Free what it holds in its process."""
        with contextlib.suppress(WorkerFailed):
            self.worker.ask(drop=self.key)


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance of a particle in `a` from the same one in `b`, (n, dim) or wider."""
    dim = min(a.shape[1], b.shape[1])
    return float(np.linalg.norm(a[:, :dim] - b[:, :dim], axis=1).max())


class Bench:
    """One run of the benchmark: its settings, its processes, and what it left out.

    rounds: counted rounds of each contest. quick: smaller sizes. arch: backend of the part `gpu`,
    None for all there are. tell: shown what is going on. results: the folder of the results, where
    a part keeps files of its own; None: nothing is kept. piece: of a part that takes hours.
    against: the Python of an earlier build, beside which the part `windows` draws.

    scenes: of a part that is measured in pieces, which sets it: the names of all that it has, and
    whether this run has measured them, or the file of results is to keep the rows it had.
    """

    def __init__(
        self,
        rounds: int = 7,
        quick: bool = False,
        arch: str | None = None,
        tell: Tell = tell_nobody,
        results: Path | None = None,
        piece: Piece | None = None,
        against: str | None = None,
    ):
        self.against = against
        self.rounds, self.quick, self.arch, self.tell = rounds, quick, arch, tell
        self.results, self.piece = results, piece or Piece()
        self.scenes: dict[str, bool] = {}
        self.threads = runtime.available_cores()
        self.left_out: list[Measurement] = []
        self._folder = tempfile.TemporaryDirectory(prefix="taichi-cloth-bench-")
        self.folder = Path(self._folder.name)
        self._workers: dict[tuple[str, str, int], Worker] = {}
        self._made = 0

    def worker(self, library: str, precision: str, threads: int) -> Worker:
        """The process for a library, precision and number of threads."""
        key = library, precision, threads
        if key in self._workers and not self._workers[key].alive:
            self._workers.pop(key).close()
        if key not in self._workers:
            environment = {
                "OMP_NUM_THREADS": str(threads),
                "OMP_PROC_BIND": "true",  # ours are pinned, too
                # Warp's benchmark empties the cache of kernels: not the user's.
                **({"WARP_CACHE_PATH": str(self.folder / "warp")} if library == "warp" else {}),
            }
            self._workers[key] = Worker(self.folder, environment)
        return self._workers[key]

    def end_workers(self) -> None:
        """End all processes; the next part starts its own."""
        for worker in self._workers.values():
            worker.close()
        self._workers.clear()

    def close(self) -> None:
        """End all processes and remove what they wrote."""
        self.end_workers()
        self._folder.cleanup()

    def leave_out(self, part: str, name: str, size: str, why: str) -> None:
        """Note that something is not measured, and why."""
        row = Measurement(part=part, contestant=name, size=size, note=f"left out: {why}")
        if row not in self.left_out:
            self.left_out.append(row)

    def enter(
        self,
        part: str,
        name: str,
        kind: str,
        arguments: dict[str, Any],
        *,
        library: str,
        precision: str,
        threads: int,
        size: str,
        particles: int,
        steps: int,
        units: int,
        packages: tuple[str, ...] = (),
    ) -> Contestant | None:
        """Make a contestant of class `kind` ("module:Class") in its process; None if that fails."""
        self.tell(f"{size}: preparing {name}", 0, 1)
        self._made += 1
        key = str(self._made)
        worker = self.worker(library, precision, threads)
        try:
            about = worker.ask(make=kind, **{"as": key, "with": arguments})["result"]
        except WorkerFailed as failure:
            self.leave_out(part, name, size, str(failure))
            return None
        return Contestant(
            name=name,
            worker=worker,
            key=key,
            size=size,
            precision=precision,
            particles=particles,
            steps=steps,
            units=units,
            packages=packages,
            about={"threads": threads} | about,
        )

    def race(
        self,
        part: str,
        contestants: Sequence[Contestant | None],
        marks: Iterable[int] = (),
        rounds: int | None = None,
    ) -> list[Contestant]:
        """Let contestants take turns; return those that came through.

        marks: units of work after which positions are kept; a round's units must divide them.
        """
        rounds = rounds or self.rounds
        running = [contestant for contestant in contestants if contestant]
        marks = set(marks)
        for number, contestant in turns(running, rounds):
            self.tell(f"{contestant.size}: {contestant.name}", number, rounds + 1)
            try:
                seconds = contestant.advance(contestant.units)
                if contestant.done in marks:
                    contestant.mark()
            except WorkerFailed as failure:
                self.leave_out(part, contestant.name, contestant.size, str(failure))
                running.remove(contestant)
                continue
            if number > 0:
                contestant.seconds.append(seconds)
        return running

    def mark_after(
        self, part: str, contestants: Sequence[Contestant | None], units: int
    ) -> list[Contestant]:
        """Let each do `units` of work and keep its positions; return those that came through."""
        running = [contestant for contestant in contestants if contestant]
        for contestant in list(running):
            self.tell(f"{contestant.size}: {contestant.name}", 0, 1)
            try:
                contestant.advance(units)
                contestant.mark()
            except WorkerFailed as failure:
                self.leave_out(part, contestant.name, contestant.size, str(failure))
                running.remove(contestant)
        return running

    def rows(
        self,
        part: str,
        contestants: Iterable[Contestant],
        references: dict[int, np.ndarray],
        against: str,
    ) -> list[Measurement]:
        """A row for each contestant: its speed, and its distance from the reference.

        references: positions by the units of work after which they stand.
        """
        rows = []
        for contestant in contestants:
            at = [units for units in references if units in contestant.marks]
            low, middle, high = quartiles(contestant.seconds)
            rows.append(
                Measurement(
                    part=part,
                    contestant=contestant.name,
                    size=contestant.size,
                    precision=contestant.precision,
                    threads=contestant.about.get("threads"),
                    execution=contestant.about.get("execution", ""),
                    topology=contestant.about.get("topology", ""),
                    seconds=middle / contestant.steps,
                    lower=low / contestant.steps,
                    upper=high / contestant.steps,
                    rate=contestant.particles * contestant.steps / middle,
                    unit="particle-steps/s",
                    error=distance(contestant.marks[at[0]], references[at[0]]) if at else None,
                    against=against if at else "",
                    rounds=len(contestant.seconds),
                    note=contestant.about.get("note", ""),
                    versions=machine.versions(contestant.packages),
                )
            )
        return rows


def compare(
    part: str,
    size: str,
    name: str,
    fast: Contestant | None,
    slow: Contestant | None,
    target: str = "",
) -> list[Measurement]:
    """The row that says how many times the speed of `slow` `fast` has; none if one is missing."""
    if not (fast and slow and fast.seconds and slow.seconds):
        return []
    per_particle = [c.step_seconds / c.particles for c in (fast, slow)]
    return [
        Measurement(
            part=part,
            contestant=name,
            size=size,
            rate=per_particle[1] / per_particle[0],
            unit="times",
            target=target,
        )
    ]


def separation(
    part: str,
    one: Contestant | None,
    other: Contestant | None,
    units: int,
    unit: str,
    target: str = "",
) -> list[Measurement]:
    """The row that says how far two contestants are apart after `units` of work, in `unit`."""
    if not (one and other and units in one.marks and units in other.marks):
        return []
    names = [f"{c.name} {c.precision}" for c in (one, other)]
    return [
        Measurement(
            part=part,
            contestant=f"{names[0]}, farthest from {names[1]}",
            size=one.size,
            rate=distance(one.marks[units], other.marks[units]),
            unit=unit,
            target=target,
        )
    ]
