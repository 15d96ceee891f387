"""What is compiled and stored for a scene, and what each of its features costs, measured.

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
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import taichi as ti

from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.explain.variants import variants
from taichi_cloth.kernels.state import State
from taichi_cloth.scene.cloth import LINKS
from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation.simulation import Simulation

SHARE = 0.01  # seconds that a scene runs in a round, at least
MOST_FRAMES = 600  # frames after which it starts again
PATIENCE = 30.0  # seconds after which there are no more rounds than LEAST_ROUNDS
LEAST_ROUNDS = 5

Tell = Callable[[str, int, int], None]  # what is going on, done, in all


@dataclass(frozen=True)
class Stored:
    """A field on the device: its name, shape, type of number, and bytes."""

    name: str
    shape: tuple[int, ...]
    type: str
    bytes: int


@dataclass(frozen=True)
class Compiled:
    """What is compiled and stored for a simulation.

    plan: the switches of `kernels.plan.Plan`. links: each kind of link of the grids with the
    springs in lanes that are of it; on_graph: springs stored as lists. fields: the largest first;
    bytes: of all device memory, with what keeps fields apart.
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
    of the processor, until the first frame; rounds: that were counted.
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


@dataclass
class Contestant:
    """A scene that takes turns with others.

    how: arguments of its simulation. seconds: of a step, one for each round; compile_seconds: of
    each time it was compiled; failed: why it takes no part any more.
    """

    scene: Scene
    how: dict[str, Any]
    sim: Simulation | None = None
    seconds: list[float] = field(default_factory=list)
    compile_seconds: list[float] = field(default_factory=list)
    bytes: int = 0
    note: str = ""
    failed: str = ""

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
        seconds = 0.0
        for _ in range(repeats):
            self.sim.reset()
            begin = time.perf_counter()
            self.sim.advance(frames)
            ti.sync()
            seconds += time.perf_counter() - begin
        return seconds / (frames * repeats * self.sim.substeps)

    def take_turn(self, frames: int, repeats: int, counts: bool) -> None:
        """Run, and note the time if it counts."""
        try:
            seconds = self.run(frames, repeats)
        except SimulationFailure as failure:
            self.failed = str(failure)
            return
        if counts:
            self.seconds.append(seconds)


def race(contestants: Sequence[Contestant], rounds: int, compiles: int, tell: Tell) -> None:
    """Compile contestants and let them take turns; the first round warms up, and does not count.

    Each round begins with another one. Those that fail say so in `failed`.
    """
    total = len(contestants) * compiles + rounds + 1
    done = 0
    for _ in range(compiles):
        for contestant in contestants:
            tell("compiling", done, total)
            done += 1
            if not contestant.failed:
                contestant.compile()
    first = contestants[0]
    if first.failed:
        return
    pace = first.run(1, 1) * first.sim.substeps  # seconds a frame
    pace = min(pace, first.run(max(1, min(MOST_FRAMES, int(SHARE / pace))), 1) * first.sim.substeps)
    frames = max(1, min(MOST_FRAMES, int(SHARE / pace)))
    repeats = max(1, math.ceil(SHARE / (pace * frames)))
    deadline = time.perf_counter() + PATIENCE
    for number in range(rounds + 1):
        if number > LEAST_ROUNDS and time.perf_counter() > deadline:
            break
        tell("running", done + number, total)
        running = [c for c in contestants if not c.failed]
        start = number % len(running)
        for contestant in running[start:] + running[:start]:
            contestant.take_turn(frames, repeats, counts=number > 0)
        if first.failed:
            return


def explain(scene: Scene, how: dict[str, Any], quick: bool, tell: Tell) -> Explanation:
    """Measure a checked scene. how: arguments of `Simulation`. Raises SimulationFailure where the
    scene itself fails.
    """
    tell("finding the fastest way to run it", 0, 1)
    sim = Simulation(scene, **how)  # may measure; the first kernels of a process take longer
    sim.advance()
    how = how | {"topology": sim.topology, "execution": sim.execution}
    compiled = describe(sim)
    particles, springs = sim.particle_count, sim.spring_count
    dt, substeps, method = sim.dt, sim.substeps, sim.method
    del sim

    switched = list(variants(scene, on_graph=compiled.topology == "graph"))
    own = Contestant(scene, how)
    others = [Contestant(variant.scene, how) for variant in switched]
    race([own, *others], 7 if quick else 21, 1 if quick else 2, tell)
    if own.failed:
        Simulation(scene, **how).advance(MOST_FRAMES)  # says why, as a run would
        raise InputError(f"scene '{scene.name}': {own.failed}")
    lower, median, upper = quartiles(own.seconds)
    return Explanation(
        scene=scene.name,
        particles=particles,
        springs=springs,
        features=scene.features().describe(),
        method=method,
        dt=dt,
        substeps=substeps,
        compiled=compiled,
        seconds=median,
        lower=lower,
        upper=upper,
        compile_seconds=min(own.compile_seconds),
        rounds=len(own.seconds),
        costs=[_cost(v, own, other) for v, other in zip(switched, others, strict=True)],
    )


def _cost(variant, own: Contestant, other: Contestant) -> Cost:
    if other.failed:
        return Cost(variant.feature, variant.used, variant.about, failed=other.failed)
    more, less = (own, other) if variant.used else (other, own)
    differences = [a - b for a, b in zip(more.seconds, less.seconds, strict=True)]
    lower, median, upper = quartiles(differences)
    return Cost(
        feature=variant.feature,
        used=variant.used,
        about=variant.about,
        seconds_with=statistics.median(more.seconds),
        seconds_without=statistics.median(less.seconds),
        seconds=median,
        lower=lower,
        upper=upper,
        compile_seconds=min(more.compile_seconds) - min(less.compile_seconds),
        bytes=more.bytes - less.bytes,
        note=other.note,
    )


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """Lower quartile, median, upper quartile."""
    if len(values) == 1:
        return values[0], values[0], values[0]
    return tuple(statistics.quantiles(values, n=4, method="inclusive"))


# ------------------------------------------------------------------------------------------
# What is compiled and stored


def describe(sim: Simulation) -> Compiled:
    """What is compiled and stored for a simulation."""
    layout = sim.storage.layout
    kinds = [next(k for k, of in LINKS.items() if _backwards(link) in of) for link in layout.links]
    counts = {kind: 0 for kind in LINKS if kind in kinds}
    for number, kind in enumerate(kinds):
        counts[kind] += int((layout.kind == number).sum())
    return Compiled(
        plan=dict(vars(sim.storage.specialization)),
        topology=sim.topology,
        execution=sim.execution,
        grids=int((layout.grid[:, 3] == 1).sum()),
        links=counts,
        on_graph=int((layout.kind < 0).sum()),
        fields=fields_of(sim.storage.state),
        bytes=allocated_bytes(sim.storage.state),
    )


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
    cloths: dict[str, Scene], side: int, how: dict[str, Any], quick: bool, tell: Tell
) -> list[LinkCost]:
    """The cost of cloths that differ in their links, the first of which is the measure."""
    tell("finding the fastest way to run it", 0, 1)
    sim = Simulation(next(iter(cloths.values())), **how)
    how = how | {"topology": sim.topology, "execution": sim.execution}
    del sim
    contestants = [Contestant(scene, how) for scene in cloths.values()]
    race(contestants, 7 if quick else 21, 1 if quick else 2, tell)
    found = []
    for name, contestant in zip(cloths, contestants, strict=True):
        if contestant.failed:
            raise InputError(f"cloth {side} x {side}, {name}: {contestant.failed}")
        ratios = np.divide(contestant.seconds, contestants[0].seconds)
        ratio_lower, ratio, ratio_upper = quartiles(ratios.tolist())
        lower, median, upper = quartiles(contestant.seconds)
        found.append(
            LinkCost(
                side=side,
                links=name,
                springs=len(contestant.scene.springs),
                topology=how["topology"],
                execution=how["execution"],
                seconds=median,
                lower=lower,
                upper=upper,
                ratio=ratio,
                ratio_lower=ratio_lower,
                ratio_upper=ratio_upper,
                compile_seconds=min(contestant.compile_seconds),
                bytes=contestant.bytes,
            )
        )
    return found
