"""The largest stable step of each method on a scene: computed (`limits`), and found by runs.

What is measured is stability alone: the scene's particles, springs, dashpots and drag at their
start, at rest. Gravity, walls, obstacles, collisions and the mouse are left out, no spring breaks,
and each particle is pushed by the force that balances its springs, so that the start is an
equilibrium whatever the springs' lengths. A spring that starts compressed gets its length as its
rest length: that it would buckle is physics. So is what wind makes flutter, which grows at every
step. Of air and wind therefore only the damping is kept: as a drag on each particle, that of its
triangles if they stood across the wind at its strongest (`tractions.bounds`).

A run starts from that state disturbed by a millionth of a spring's length, along the mode that is
expected to grow first, and by a thousandth of that in every direction at random, so that no other
mode is missed. It is looked at a number of times, at intervals chosen at random (no beat of a mode
hides in them): unstable is a run whose disturbance has more energy in the second half than ever in
the first, by more than a margin, or that grows ten-thousandfold, or that the watchdog ends.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.kernels import methods
from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.limits import modes, rounding, tractions
from taichi_cloth.limits.bounds import any_geometry, gershgorin, step_within
from taichi_cloth.limits.eigenmodes import Limit, stable_step
from taichi_cloth.limits.matrices import stiffness_and_damping
from taichi_cloth.limits.network import Network
from taichi_cloth.scene.fingerprint import scene_hash
from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation import diagnostics
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.sweeps.journal import Journal, key_of

DISTURBANCE = 1e-6  # of a spring's length: so small that springs are linear
NOISE = 1e-3  # of the disturbance
EXPLODED = 1e4  # times the disturbance at the start
ACCURACY = 1e-3  # of the limit: where bisection ends
RUN_SECONDS = 0.25  # that a run of the bisection takes,
MOST_SECONDS = 2.0  # or, where what grows grows slowly, up to this
RUN_STEPS = 1_000, 1_000_000  # at least, and at most
MOST_RATE = 1e150  # of a mode: larger ones overflow where squared, or where maps are stiffer
PARALLEL_FROM = 20_000  # particles from which all threads are used

TellRun = Callable[
    [str, str], None
]  # called before each run: its method, the kind of its map or ""


@dataclass(frozen=True)
class Look:
    """The judgement of a run: its steps, how often it is looked at, the margin of growth."""

    steps: int
    times: int = 200
    margin: float = 1.02


@dataclass(frozen=True)
class Mesh:
    """The points of a map: columns, one for each factor, of steps; and how their runs are judged.

    Most points are far from the line, so that few steps decide them.
    """

    columns: int
    steps: int
    look: Look

    @property
    def points(self) -> int:
        return self.columns * self.steps


MESH = Mesh(11, 13, Look(steps=600, times=40, margin=2.0))
COARSE_MESH = Mesh(5, 7, Look(steps=200, times=20, margin=2.0))
MAP_SECONDS = 10.0  # of stepping that a map may take, before it becomes coarse


@dataclass
class StepLimits:
    """The limits of one method's step, in the scene's time.

    A limit is inf where every step is stable, 0 where none is, None where it was not found out.
    dt_gershgorin, dt_any_geometry: by the bounds of these names; limit: of the scene as it starts;
    dt_measured: by runs. runs, steps: that finding it took. status: how it was found, or why not.
    """

    method: str
    dt_gershgorin: float
    dt_any_geometry: float
    limit: Limit
    dt_measured: float | None = None
    runs: int = 0
    steps: int = 0
    status: str = "not measured"


@dataclass
class Map:
    """Runs at many steps, of a scene changed by many factors.

    factor, line: (columns,), the change, and the computed limit; points: (factor, dt, stable).
    """

    method: str
    kind: str
    factor: list[float] = field(default_factory=list)
    line: list[float] = field(default_factory=list)
    points: list[tuple[float, float, bool]] = field(default_factory=list)


def claimed(method: str) -> float:
    """The largest stable dt times omega that a method claims: 0 never stable, inf always."""
    limit: float = methods.load(method).claims.stability_limit
    return limit


def at_rest(scene: Scene) -> Scene:
    """The scene of which stability is measured: its start as an equilibrium, free of events."""
    particles, springs = scene.particles, scene.springs
    particles = replace(particles, velocity=np.zeros_like(particles.velocity))
    particles = replace(particles, viscous=particles.viscous + drag_of_wind(scene))
    a, b = springs.between.T
    length = np.linalg.norm(particles.position[b] - particles.position[a], axis=1)
    compressed = length < springs.rest_length * (1 - 1e-9)
    return replace(
        replace(scene, world=tractions.without(scene.world)).with_world(
            gravity=(0.0,) * scene.world.dim,
            walls=(),
            collisions=False,
            mouse="blow",
            ground=None,
            friction=0.0,
        ),
        obstacles=(),
        particles=particles,
        springs=replace(
            springs,
            rest_length=np.where(compressed, length, springs.rest_length),
            break_force=np.full(len(springs), np.inf),
        ),
    )


def drag_of_wind(scene: Scene) -> np.ndarray:
    """The damping of each particle by its triangles, across the wind at its strongest, (n,)."""
    still = np.zeros_like(scene.particles.velocity)
    return Network.from_scene(scene, velocity=still).by_triangles[1]


def as_it_starts(scene: Scene, names: Sequence[str]) -> dict[str, float]:
    """By method, the limit with the drag that triangles have as they stand at the start."""
    network = Network.from_scene(scene)
    return {name: stable_step(methods.load(name), network, exact=False).dt for name in names}


def check_rates(scene: Scene, network: Network) -> None:
    """Raise InputError where the modes of a scene are too fast for what is computed of them."""
    bounds = gershgorin(network)
    fastest = float(np.max([np.sqrt(bounds.omega2), bounds.damping]))
    if not fastest <= MOST_RATE:
        raise InputError(
            f"scene '{scene.name}': its springs are too stiff, or damped too much, for its masses: "
            f"the fastest rate is {fastest:.3g}, and the most is {MOST_RATE:g}; use softer springs "
            "or larger masses"
        )


def computed(name: str, network: Network, exact: bool = True) -> StepLimits:
    """The limits of a method that follow from the springs, before any run; exact: see
    `stable_step`.
    """
    method = methods.load(name)
    return StepLimits(
        name,
        step_within(method, gershgorin(network)),
        step_within(method, any_geometry(network)),
        stable_step(method, network, exact=exact),
    )


class Runs:
    """Runs of one method on a scene `at_rest`, which may be replaced by one of the same features.

    All of them share one `Simulation`: a new one compiles anew.
    """

    def __init__(self, scene: Scene, name: str):
        many = len(scene.particles) >= PARALLEL_FROM
        path = "parallel" if many else "serial"
        self._sim = Simulation(scene, name, substeps=1, execution=path, topology="graph")
        self._use(scene)
        self.runs = self.steps = 0

    def replace(self, scene: Scene) -> None:
        """Run this scene from now on."""
        self._sim.load_scene(scene, substeps=1)
        self._use(scene)

    def _use(self, scene: Scene) -> None:
        self._scene, particles = scene, scene.particles
        self._free = ~particles.fixed
        self._mass = np.sqrt(particles.mass[self._free])[:, None]
        network = Network.from_scene(scene)
        self._stiffness = stiffness_and_damping(network)[0]
        v = np.zeros_like(particles.position)
        self._force = -diagnostics.spring_forces(particles.position, v, scene.springs)
        self._force -= diagnostics.stencil_forces(
            particles.position, scene.stencils, particles.fixed
        )
        a, b = scene.springs.between.T
        lengths = np.linalg.norm(particles.position[b] - particles.position[a], axis=1)
        lengths = lengths[lengths > 0]
        size = float(np.median(lengths)) if len(lengths) else min(scene.world.size) / 100
        self._disturbance = DISTURBANCE * size

    def seconds_a_step(self, limit: Limit) -> float:
        """The time of a step here, in which nothing moves; limit: says how fast things are."""
        sim = self._sim
        sim.set_step(1e-9 / _rate(limit), 100)
        sim.advance()  # compiles
        begin = time.perf_counter()
        sim.advance()
        return (time.perf_counter() - begin) / 100

    def is_unstable(self, h: float, limit: Limit, look: Look) -> bool:
        """True if a disturbance grows at steps of h; limit: says along which mode it starts."""
        sim, rng = self._sim, np.random.default_rng(0)
        sim.load_as(sim.topology, sim.execution, *self._disturbed(limit, rng))
        sim.hold(self._force)
        self.runs += 1
        start = self._energy()
        half, largest = look.times // 2, [start, 0.0]
        mean = max(look.steps / look.times, 1.0)
        for k in range(look.times):
            steps = 1 + int(rng.integers(0, max(1, round(2 * mean - 1))))
            sim.set_step(h * steps, steps)
            try:
                sim.advance()
            except SimulationFailure:
                return True
            self.steps += steps
            energy = self._energy()
            if not energy <= EXPLODED**2 * start:
                return True
            largest[k >= half] = max(largest[k >= half], energy)
        return largest[1] > look.margin**2 * largest[0]

    def _disturbed(self, limit: Limit, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities (n, dim) of the disturbed state."""
        position = self._scene.particles.position
        rate = _rate(limit)
        x, v = np.zeros_like(position), np.zeros_like(position)
        if limit.mode is not None and limit.velocity is not None:
            largest = max(np.abs(limit.mode).max(), np.abs(limit.velocity).max() / rate)
            x, v = limit.mode / largest, limit.velocity / largest
        x = x + NOISE * rng.standard_normal(position.shape)
        v = v + NOISE * rate * rng.standard_normal(position.shape)
        free = self._free[:, None]
        return position + np.where(free, self._disturbance * x, 0.0), self._disturbance * v

    def _energy(self) -> float:
        """The disturbance's energy: kinetic, and of the springs around the equilibrium."""
        x = self._sim.positions() - self._scene.particles.position
        q = (self._mass * x[self._free]).ravel()
        p = (self._mass * self._sim.velocities()[self._free]).ravel()
        return float(q @ (self._stiffness @ q) + p @ p)


def _rate(limit: Limit) -> float:
    """That of the first mode that grows."""
    return math.sqrt(limit.omega2) or limit.damping or 1.0


def measure(
    scene: Scene, limits: StepLimits, maps: list[Map], tell: TellRun, journal: Journal
) -> None:
    """Find the real limit of one method, and its maps, which are added to `maps`.

    scene: `at_rest`. What is found stays in `limits` and `maps` however this ends; journal: has
    what an earlier run has found, a limit or a whole map each, and gets the rest.
    """
    runs = Started(scene, limits.method)
    measure_limit(runs, limits, tell, journal)
    draw_maps(runs, maps, tell, journal)


class Started:
    """The `Runs` of a method on a scene `at_rest`, which compile it where anything is to be run."""

    def __init__(self, scene: Scene, name: str):
        self.scene, self.name = scene, name
        self._runs: Runs | None = None

    def get(self) -> Runs:
        """The runs, of the scene as it was given."""
        if self._runs is None:
            self._runs = Runs(self.scene, self.name)
        return self._runs


def measure_limit(runs: Started, limits: StepLimits, tell: TellRun, journal: Journal) -> None:
    """Find the real limit of one method; see `measure`."""
    if math.isinf(limits.limit.dt):
        limits.dt_measured, limits.status = math.inf, "no limit: nothing can become unstable"
        return
    key = _limit_key(scene_hash(runs.scene), runs.name)
    found = journal.get(key)
    if found is None:
        seconds = _bisect_runs(limits, runs.get(), tell)
        values = {field: getattr(limits, field) for field in MEASURED}
        journal.add(key, values | {"seconds": seconds})
    else:
        for field in MEASURED:
            setattr(limits, field, found.result[field])


def draw_maps(runs: Started, maps: list[Map], tell: TellRun, journal: Journal) -> None:
    """Draw the maps of one method whose limit is measured; see `measure`."""
    name, digest = runs.name, scene_hash(runs.scene)
    found = journal.get(_limit_key(digest, name))
    if found is None or claimed(name) == 0:
        return  # what grows there does so in 1e5 steps: too many for every point of a map
    seconds = found.result["seconds"]
    mesh = MESH if seconds * MESH.points * MESH.look.steps < MAP_SECONDS else COARSE_MESH
    for kind, (factors, changed) in _changes(runs.scene, mesh.columns).items():
        found = journal.get(_map_key(digest, name, kind))
        if found is not None:
            maps.append(Map(name, kind, **found.result))
            continue
        drawn = Map(name, kind)
        maps.append(drawn)
        _fill_map(drawn, factors, mesh, changed, runs.get(), tell)
        values = {"factor": drawn.factor, "line": drawn.line, "points": drawn.points}
        journal.add(_map_key(digest, name, kind), values)


def left_out(scene: Scene, limits: Sequence[StepLimits], journal: Journal) -> list[str]:
    """The lacks of a journal for methods that have a limit, a line for each method."""
    said = []
    for of in limits:
        if math.isinf(of.limit.dt):
            continue
        lacking = [key for key in keys_of(scene, of.method) if journal.get(key) is None]
        # Of a key ("limit", digest, method) or ("map", digest, method, kind).
        parts = [json.loads(key) for key in lacking]
        names = [" of ".join([what, *kind]) for what, _, _, *kind in parts]
        if names:
            said.append(f"{of.method}: {', '.join(names)}")
    return said


def take_finished(
    scene: Scene, limits: Sequence[StepLimits], maps: list[Map], journal: Journal
) -> None:
    """Put what a journal has of limits and maps that were not come to into `limits` and `maps`."""
    digest = scene_hash(scene)
    for of in limits:
        if of.dt_measured is None and journal.get(_limit_key(digest, of.method)):
            measure_limit(Started(scene, of.method), of, lambda *_: None, journal)
        drawn = {found.kind for found in maps if found.method == of.method}
        for kind in _changes(scene, MESH.columns):
            entry = journal.get(_map_key(digest, of.method, kind))
            if entry and kind not in drawn:
                maps.append(Map(of.method, kind, **entry.result))


def keys_of(scene: Scene, name: str) -> list[str]:
    """The keys of what `measure` puts into a journal of a method that has a limit; see there."""
    digest = scene_hash(scene)
    kinds = _changes(scene, MESH.columns) if claimed(name) > 0 else ()
    return [_limit_key(digest, name), *(_map_key(digest, name, kind) for kind in kinds)]


def map_key(scene: Scene, drawn: Map) -> str:
    """The key of a map in a journal, which has it once it is whole."""
    return _map_key(scene_hash(scene), drawn.method, drawn.kind)


def _limit_key(digest: str, name: str) -> str:
    return key_of("limit", digest, name)


def _map_key(digest: str, name: str, kind: str) -> str:
    return key_of("map", digest, name, kind)


MEASURED = ("dt_measured", "status", "runs", "steps")  # of a method's limits, by runs


def _bisect_runs(limits: StepLimits, runs: Runs, tell: TellRun) -> float:
    """Bisect; what is found is kept in `limits`, the seconds that a step takes are returned."""
    seconds = runs.seconds_a_step(limits.limit)
    look = _long_enough(methods.load(limits.method), limits.limit, seconds)
    try:
        limits.dt_measured, limits.status = bisect(
            runs, limits.limit, look, lambda: tell(limits.method, "")
        )
    finally:
        limits.runs, limits.steps = runs.runs, runs.steps
    return seconds


def _long_enough(method: Method, limit: Limit, seconds: float) -> Look:
    """The way that runs of steps of `seconds` each show what grows a little above the limit."""
    beyond = (1 + 2 * ACCURACY) * limit.dt
    rate = math.log(max(modes.growth(method, beyond, limit.omega2, limit.damping), 1 + 1e-12))
    needed = 3 * math.log(Look.margin) / rate
    steps = min(max(needed, min(RUN_SECONDS / seconds, 100_000)), MOST_SECONDS / seconds)
    return Look(int(np.clip(steps, *RUN_STEPS)))


def bisect(
    runs: Runs, limit: Limit, look: Look, tell: Callable[[], None] = lambda: None
) -> tuple[float, str]:
    """The step between stable and unstable runs, to within ACCURACY, and how it was found.

    0 where the disturbance grows at a hundredth of the step that would resolve the mode.
    """

    def unstable(h: float) -> bool:
        tell()
        return runs.is_unstable(h, limit, look)

    rate = max(math.sqrt(limit.omega2), limit.damping)
    if limit.dt == 0:
        low = 0.01 / rate
        if unstable(low):
            return 0.0, f"grows at {low:.3g} already"
        high = 2 * low
    else:
        low, high = limit.dt / 1.07, limit.dt * 1.04
    tries = 40
    while unstable(low):
        low, high, tries = low / 1.25, low, tries - 1
        if not tries:
            return 0.0, f"grows at {low:.3g} already"
    while not unstable(high):
        low, high, tries = high, high * 1.25, tries - 1
        if not tries:
            return math.inf, f"does not grow at {low:.3g}"
    while high > low * (1 + ACCURACY):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if unstable(middle) else (middle, high)
    return math.sqrt(low * high), "measured"


# The factors along a map, and the scene that each makes.
Change = tuple[np.ndarray, Callable[[float], Scene]]


def _changes(scene: Scene, columns: int) -> dict[str, Change]:
    """Numbers that a scene's maps vary, by kind: the stiffness of every spring, if it has any,
    and the mass of every second free particle.
    """
    second = np.flatnonzero(~scene.particles.fixed)[::2]

    def stiffened(factor: float) -> Scene:
        springs = scene.springs
        return replace(scene, springs=replace(springs, stiffness=factor * springs.stiffness))

    def weighted(factor: float) -> Scene:
        mass = scene.particles.mass.copy()
        mass[second] *= factor
        return replace(scene, particles=replace(scene.particles, mass=mass))

    changes: dict[str, Change] = {}
    if len(scene.springs):
        changes["stiffness"] = np.logspace(-2, 2, columns), stiffened
    changes["mass"] = np.logspace(-3, 3, columns), weighted
    return changes


def _fill_map(
    drawn: Map,
    factors: np.ndarray,
    mesh: Mesh,
    changed: Callable[[float], Scene],
    runs: Runs,
    tell: TellRun,
) -> None:
    """Fill a map: the line first, then runs at steps below, around and above it."""
    method = methods.load(drawn.method)
    scenes = [changed(factor) for factor in factors]
    found = [stable_step(method, Network.from_scene(scene), exact=False) for scene in scenes]
    drawn.factor, drawn.line = factors.tolist(), [limit.dt for limit in found]
    steps = np.geomspace(min(drawn.line) / 2.2, max(drawn.line) * 2.2, mesh.steps)
    for factor, scene, limit in zip(drawn.factor, scenes, found, strict=True):
        runs.replace(scene)
        for h in steps.tolist():
            tell(drawn.method, drawn.kind)
            drawn.points.append((factor, h, not runs.is_unstable(h, limit, mesh.look)))


def stall(scene: Scene) -> rounding.Stall:
    """The place where f32 stops following the scene's own start, gravity included."""
    p, a = scene.particles, diagnostics.acceleration_at_start(scene)
    return rounding.stall(p.position, p.velocity, a, p.fixed, scene.world.dt)
