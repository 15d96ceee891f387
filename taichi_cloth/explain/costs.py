"""Costs of a scene: kernels, memory, and each of its features, measured.

A feature's cost is measured by switching it: the scene runs with it and without it, in one process
and in turns, each round from the scene's start. A round's cost is the difference of its two times,
so that a drift of the machine meets both; medians and quartiles are over the rounds. Times to
compile are the processor's, with kernels of earlier runs left aside, the least of a few.
"""

from __future__ import annotations

import gc
import math
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import taichi as ti

from taichi_cloth.console import Tell
from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.explain.variants import variants
from taichi_cloth.kernels import forces
from taichi_cloth.kernels.forces.contract import Variant
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.kernels.state import State
from taichi_cloth.measuring.timing import quartiles, turns
from taichi_cloth.scene.cloth import LINKS
from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.sweeps.within import Clock

SHARE = 0.01  # seconds that a scene runs in a round, at least
MOST_FRAMES = 600  # frames after which it starts again
PATIENCE = 30.0  # seconds after which there are no more rounds than LEAST_ROUNDS
LEAST_ROUNDS = 5
RUNNING = 0.15  # of the time that there is: what is left for turns, once all is compiled


@dataclass(frozen=True)
class Stored:
    """A field on the device: its name, shape, type of number, and bytes."""

    name: str
    shape: tuple[int, ...]
    type: str
    bytes: int


@dataclass(frozen=True)
class Compiled:
    """Kernels and memory of a simulation.

    plan: the switches of `kernels.specialization`. links: each kind of link of the grids with the
    springs in lanes that are of it; on_graph: springs stored as lists. fields: the largest
    first; bytes: of all device memory, with what keeps fields apart.
    """

    plan: dict[str, Any]
    topology: str
    execution: str
    grids: int
    links: dict[str, int]
    on_graph: int
    fields: list[Stored]
    bytes: int


@dataclass(frozen=True)
class Cost:
    """A feature, and what it costs: times of a step with and without it, and their difference.

    used: whether the scene has it; if not, the cost is what it would add. seconds, lower, upper:
    median and quartiles of the rounds' differences; negative: it saves. compile_seconds, bytes:
    what it adds. note: what else differs. failed: why there are no times.
    """

    feature: str
    used: bool
    about: str
    seconds_with: float | None = None
    seconds_without: float | None = None
    seconds: float | None = None
    lower: float | None = None
    upper: float | None = None
    compile_seconds: float | None = None
    bytes: int | None = None
    note: str = ""
    failed: str = ""


@dataclass(frozen=True)
class Explanation:
    """All that is known of a scene. seconds, lower, upper: of a step as it is; compile_seconds:
    of the processor, until the first frame; rounds: that were counted. left_out: features for
    which there was no time. assumed: keys that the scene's file leaves open, with what was taken.
    """

    scene: str
    particles: int
    springs: int
    features: str
    method: str
    dt: float
    substeps: int
    compiled: Compiled
    seconds: float
    lower: float
    upper: float
    compile_seconds: float
    rounds: int
    costs: list[Cost]
    left_out: list[str] = field(default_factory=list)
    assumed: dict[str, str] = field(default_factory=dict)


@dataclass(eq=False)  # each is itself alone: arrays of scenes have no truth to be compared by
class Candidate:
    """A scene that takes turns with others.

    how: arguments of its simulation. seconds: of a step, one for each round; compile_seconds: of
    each time it was compiled; failed: why it takes no part any more. left_out: whether that is for
    want of time.
    """

    scene: Scene
    how: dict[str, Any]
    sim: Simulation | None = None
    seconds: list[float] = field(default_factory=list)
    compile_seconds: list[float] = field(default_factory=list)
    bytes: int = 0
    note: str = ""
    failed: str = ""
    left_out: bool = False

    def compile(self) -> None:
        """Make it ready to run anew, and note the processor's time until the first frame."""
        self.sim = None
        gc.collect()  # what it held is given back
        begin = time.process_time()
        try:
            self.sim = self._made()
            self.sim.advance()
            compiled = time.process_time()
            self.sim.reset()
            self.sim.advance()
        except (InputError, SimulationFailure) as error:
            self.failed, self.sim = str(error), None
            return
        again = time.process_time() - compiled
        self.compile_seconds.append(max(compiled - begin - again, 0.0))
        self.bytes = allocated_bytes(self.sim.storage.state)

    def leave_out(self) -> None:
        """Take no part, for want of time, unless it is compiled already."""
        if self.sim is None and not self.failed:
            self.failed, self.left_out = "there was no time for it", True

    def _made(self) -> Simulation:
        try:
            return Simulation(self.scene, **self.how)
        except InputError:
            if self.how["topology"] == "graph":
                raise
            # Without the links that make it a regular grid there are no lanes.
            self.note = "there is no regular grid: it runs on the graph"
            return Simulation(self.scene, **(self.how | {"topology": "graph"}))

    def run(self, frames: int, repeats: int) -> float:
        """Seconds of a step, over `repeats` runs of `frames` frames from the scene's start."""
        sim = self.compiled
        seconds = 0.0
        for _ in range(repeats):
            sim.reset()
            begin = time.perf_counter()
            sim.advance(frames)
            ti.sync()
            seconds += time.perf_counter() - begin
        return seconds / (frames * repeats * sim.substeps)

    def pace(self) -> float:
        """About how many seconds a frame takes."""
        substeps = self.compiled.substeps
        rough = self.run(1, 1) * substeps
        return min(rough, self.run(max(1, min(MOST_FRAMES, int(SHARE / rough))), 1) * substeps)

    @property
    def compiled(self) -> Simulation:
        """Its simulation, once it is compiled."""
        assert self.sim is not None
        return self.sim


def race(candidates: Sequence[Candidate], clock: Clock, tell: Tell) -> None:
    """Compile candidates and let them take turns; the first of them is what all are compared to.

    Those that fail say so in `failed`; where the first one does, the race is over. Those that the
    clock leaves no time to compile are left out, the last ones first.
    """
    rounds, compiles = (7, 1) if clock.short else (21, 2)
    longest = 0.0
    total = len(candidates) * compiles + rounds + 1
    done = 0
    for _ in range(compiles):
        for candidate in candidates:
            tell("compiling", done, total)
            done += 1
            began, rest = clock.left(), RUNNING * clock.seconds if clock.limited else 0.0
            if began - longest < rest and candidate is not candidates[0]:
                candidate.leave_out()
            elif not candidate.failed:
                candidate.compile()
                longest = max(longest, began - clock.left() if clock.limited else 0.0)
    first = candidates[0]
    if first.failed:
        return
    pace = first.pace()
    frames = max(1, min(MOST_FRAMES, int(SHARE / pace)))
    repeats = max(1, math.ceil(SHARE / (pace * frames)))
    running = [candidate for candidate in candidates if not candidate.failed]
    for number, candidate in turns(
        running,
        rounds,
        rotate=True,
        patience=min(PATIENCE, clock.left()),
        least=1 if clock.limited else LEAST_ROUNDS,
    ):
        tell("running", done + number, total)
        try:
            seconds = candidate.run(frames, repeats)
        except SimulationFailure as failure:
            candidate.failed = str(failure)
            running.remove(candidate)
            if candidate is first:
                return
            continue
        if number > 0:
            candidate.seconds.append(seconds)


def explain(
    scene: Scene, how: dict[str, Any], clock: Clock, tell: Tell, *, switch: bool = True
) -> Explanation:
    """Measure a checked scene. how: arguments of `Simulation`; clock: when it has to end; switch:
    whether its features are switched one by one, too. Raises SimulationFailure where the scene
    itself fails.
    """
    tell("finding the fastest way to run it", 0, 1)
    sim = Simulation(scene, **how)  # the first kernels of a process take longer
    sim.advance()
    how = how | {"topology": sim.topology, "execution": sim.execution}
    compiled = describe(sim)
    particles, springs = sim.particle_count, sim.spring_count
    dt, substeps, method = sim.dt, sim.substeps, sim.method
    del sim

    switched = list(variants(scene, on_graph=compiled.topology == "graph")) if switch else []
    if clock.limited:  # what it has comes before what it lacks
        switched.sort(key=lambda variant: not variant.used)
    own = Candidate(scene, how)
    others = [Candidate(variant.scene, how) for variant in switched]
    race([own, *others], clock, tell)
    if own.failed:
        Simulation(scene, **how).advance(MOST_FRAMES)  # says why, as a run would
        raise InputError(f"scene '{scene.name}': {own.failed}")
    step = quartiles(own.seconds)
    return Explanation(
        scene=scene.name,
        particles=particles,
        springs=springs,
        features=forces.describe(scene),
        method=method,
        dt=dt,
        substeps=substeps,
        compiled=compiled,
        seconds=step.median,
        lower=step.lower,
        upper=step.upper,
        compile_seconds=min(own.compile_seconds),
        rounds=len(own.seconds),
        costs=[
            _cost(v, own, other)
            for v, other in zip(switched, others, strict=True)
            if not other.left_out
        ],
        assumed=dict(scene.assumed),
        left_out=[v.feature for v, of in zip(switched, others, strict=True) if of.left_out],
    )


def _cost(variant: Variant, own: Candidate, other: Candidate) -> Cost:
    if other.failed:
        return Cost(variant.feature, variant.used, variant.about, failed=other.failed)
    more, less = (own, other) if variant.used else (other, own)
    differences = [a - b for a, b in zip(more.seconds, less.seconds, strict=True)]
    difference = quartiles(differences)
    return Cost(
        feature=variant.feature,
        used=variant.used,
        about=variant.about,
        seconds_with=statistics.median(more.seconds),
        seconds_without=statistics.median(less.seconds),
        seconds=difference.median,
        lower=difference.lower,
        upper=difference.upper,
        compile_seconds=min(more.compile_seconds) - min(less.compile_seconds),
        bytes=more.bytes - less.bytes,
        note=other.note,
    )


# ------------------------------------------------------------------------------------------
# What is compiled and stored


def describe(sim: Simulation) -> Compiled:
    """Kernels and memory of a simulation."""
    layout = sim.storage.layout
    kinds = [next(k for k, of in LINKS.items() if _backwards(link) in of) for link in layout.links]
    counts = {kind: 0 for kind in LINKS if kind in kinds}
    for number, kind in enumerate(kinds):
        counts[kind] += int((layout.kind == number).sum())
    return Compiled(
        plan=switches(sim.storage.specialization),
        topology=sim.topology,
        execution=sim.execution,
        grids=int((layout.grid[:, 3] == 1).sum()),
        links=counts,
        on_graph=int((layout.kind < 0).sum()),
        fields=fields_of(sim.storage.state),
        bytes=allocated_bytes(sim.storage.state),
    )


def switches(spec: Specialization) -> dict[str, Any]:
    """The switches of a specialization by name, and whether it has each of the forces."""
    return {name: name in spec.terms for name in forces.TERMS} | vars(spec)


def _backwards(link: tuple[int, int]) -> tuple[int, int]:
    return -link[0], -link[1]


def fields_of(state: State) -> list[Stored]:
    """Every field of a container, the largest first."""
    found = []
    for name, of in vars(state).items():
        if not isinstance(of, ti.Field):
            continue
        numbers = math.prod(of.shape) * getattr(of, "n", 1)
        size = 8 if of.dtype == ti.f64 else 4
        shape = (*of.shape, of.n) if isinstance(of, ti.MatrixField) else of.shape
        found.append(Stored(name, tuple(shape), str(of.dtype), numbers * size))
    return sorted(found, key=lambda f: -f.bytes)


def allocated_bytes(state: State) -> int:
    """Device memory of a container, by Taichi's own count: the sizes of its trees."""
    roots = {}
    for of in vars(state).values():
        if isinstance(of, ti.Field):
            node = of.snode.ptr
            while node.parent is not None:
                node = node.parent
            roots[node.id] = node.cell_size_bytes
    return sum(roots.values())


# ------------------------------------------------------------------------------------------
# Links of a cloth


@dataclass(frozen=True)
class LinkCost:
    """A cloth of side x side particles with some kinds of link.

    seconds, lower, upper: median and quartiles of a step's time; ratio, and its quartiles: to the
    structural cloth's, round by round. compile_seconds, bytes: as in `Explanation`.
    """

    side: int
    links: str
    springs: int
    topology: str
    execution: str
    seconds: float
    lower: float
    upper: float
    ratio: float
    ratio_lower: float
    ratio_upper: float
    compile_seconds: float
    bytes: int


def compare_links(
    cloths: dict[str, Scene], side: int, how: dict[str, Any], clock: Clock, tell: Tell
) -> list[LinkCost]:
    """The cost of cloths that differ in their links, the first of which is the measure."""
    tell("finding the fastest way to run it", 0, 1)
    sim = Simulation(next(iter(cloths.values())), **how)
    how = how | {"topology": sim.topology, "execution": sim.execution}
    del sim
    candidates = [Candidate(scene, how) for scene in cloths.values()]
    race(candidates, clock, tell)
    found = []
    for name, candidate in zip(cloths, candidates, strict=True):
        if candidate.failed:
            raise InputError(f"cloth {side} x {side}, {name}: {candidate.failed}")
        ratio = quartiles(np.divide(candidate.seconds, candidates[0].seconds).tolist())
        step = quartiles(candidate.seconds)
        found.append(
            LinkCost(
                side=side,
                links=name,
                springs=len(candidate.scene.springs),
                topology=how["topology"],
                execution=how["execution"],
                seconds=step.median,
                lower=step.lower,
                upper=step.upper,
                ratio=ratio.median,
                ratio_lower=ratio.lower,
                ratio_upper=ratio.upper,
                compile_seconds=min(candidate.compile_seconds),
                bytes=candidate.bytes,
            )
        )
    return found
