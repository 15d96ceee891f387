"""The command ``taichi-cloth stability``: the largest stable step of each method on a scene.

Computed (`limits.py`), and found by bisection of runs. What is measured is stability alone: the
scene's particles, springs, dashpots and drag at their start, at rest. Gravity, walls, collisions
and the mouse are left out, springs do not break, and each particle is pushed by the force that
balances its springs, so that the start is an equilibrium whatever the springs' lengths. A spring
that starts compressed gets its length as its rest length: that it would buckle is physics.

A run starts from that state disturbed by a millionth of a spring's length, along the mode that is
expected to grow first, and by a thousandth of that in every direction at random, so that no other
mode is missed. It is looked at a number of times, at intervals chosen at random (no beat of a mode
hides in them): unstable is a run whose disturbance has more energy in the second half than ever in
the first, by more than a margin, or that grows ten-thousandfold, or that the watchdog ends.
"""

from __future__ import annotations

import csv
import io
import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.errors import InputError, SimulationFailure, nearest
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.kernels import methods
from taichi_cloth.limits import modes
from taichi_cloth.limits.auto_step import SAFETY
from taichi_cloth.limits.bounds import any_geometry, gershgorin, step_within
from taichi_cloth.limits.eigenmodes import Limit, stable_step
from taichi_cloth.limits.matrices import stiffness_and_damping
from taichi_cloth.limits.network import Network
from taichi_cloth.limits.rounding import Stall, f32_stall
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import StabilityOptions
from taichi_cloth.simulation import diagnostics
from taichi_cloth.simulation.simulation import Simulation

DISTURBANCE = 1e-6  # of a spring's length: so small that springs are linear
NOISE = 1e-3  # of the disturbance
EXPLODED = 1e4  # times the disturbance at the start
ACCURACY = 1e-3  # of the limit: where bisection ends
RUN_SECONDS = 0.25  # that a run of the bisection takes,
MOST_SECONDS = 2.0  # or, where what grows grows slowly, up to this
RUN_STEPS = 1_000, 1_000_000  # at least, and at most
PARALLEL_FROM = 20_000  # particles from which all threads are used


@dataclass(frozen=True)
class Look:
    """How a run is judged: its steps, how often it is looked at, the margin of growth."""

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
class Row:
    """One method's limits. Steps in the scene's time: inf where every step is stable, 0 where none
    is, None where it was not found out.
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


def main(source: SceneSource, options: StabilityOptions) -> int:
    """Do what the command asks for; the exit status. Ctrl-C keeps what is finished."""
    names = _methods(options.method)
    scene = source.build()
    folder = Path(options.output or f"stability-{scene.name}")
    _prepare(folder)
    np.seterr(all="ignore")  # numbers that overflow are the watchdog's to report
    runtime.start("cpu", "f64")
    prepared = at_rest(scene)
    network = Network.from_scene(prepared)
    rows = [_computed(name, network) for name in names]
    maps: list[Map] = []
    interrupted = None
    with _Progress(rows, options.quiet) as tell:
        try:
            for row in rows:
                _measure(prepared, row, maps, tell)
        except KeyboardInterrupt as interrupt:
            interrupted = interrupt
    stall = _stall(scene)
    written = _write(folder, scene, rows, maps, stall)
    if not options.quiet:
        _show(scene, rows, stall, options.method)
        print(f"\nwritten: {', '.join(map(str, written))}")
    if interrupted:
        raise interrupted
    return 0


def _methods(chosen: str | None) -> list[str]:
    """The methods that have a limit, or the one chosen."""
    limited = [m for m in methods.METHODS if _claimed(m) < math.inf]
    if chosen is None:
        return limited
    if chosen not in methods.METHODS:
        raise InputError(f"--method: unknown method '{chosen}'; {nearest(chosen, methods.METHODS)}")
    if chosen not in limited:
        raise InputError(
            f"--method {chosen}: it is stable at every step; those with a limit: "
            f"{', '.join(limited)}"
        )
    return [chosen]


def _claimed(name: str) -> float:
    return methods.load(name).claims.stability_limit


def _prepare(folder: Path) -> None:
    """See before the runs that results can be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--output {folder}: cannot be made: {error.strerror}") from None
    for name in FILES:
        PendingFile(folder / name).discard()


# --- computing and measuring -----------------------------------------------------------------


def at_rest(scene: Scene) -> Scene:
    """What is measured of a scene: see above."""
    particles, springs = scene.particles, scene.springs
    a, b = springs.between.T
    length = np.linalg.norm(particles.position[b] - particles.position[a], axis=1)
    compressed = length < springs.rest_length * (1 - 1e-9)
    return replace(
        scene.with_world(
            gravity=(0.0,) * scene.world.dim, walls=(), collisions=False, mouse="blow"
        ),
        particles=replace(particles, velocity=np.zeros_like(particles.velocity)),
        springs=replace(
            springs,
            rest_length=np.where(compressed, length, springs.rest_length),
            break_force=np.full(len(springs), np.inf),
        ),
    )


def _computed(name: str, network: Network) -> Row:
    method = methods.load(name)
    return Row(
        name,
        step_within(method, gershgorin(network)),
        step_within(method, any_geometry(network)),
        stable_step(method, network),
    )


class Runs:
    """Runs of one method on a scene `at_rest`, which may be replaced by one of the same features.

    All of them share one `Simulation`: a new one compiles anew.
    """

    def __init__(self, scene: Scene, name: str):
        many = len(scene.particles) >= PARALLEL_FROM
        path = "parallel" if many else "serial"
        self._sim = Simulation(scene, name, execution=path, topology="graph")
        self._use(scene)
        self.runs = self.steps = 0

    def replace(self, scene: Scene) -> None:
        """Run this scene from now on."""
        self._sim.scene = scene
        self._sim.reset()
        self._use(scene)

    def _use(self, scene):
        self._scene, particles = scene, scene.particles
        self._free = ~particles.fixed
        self._mass = np.sqrt(particles.mass[self._free])[:, None]
        network = Network.from_scene(scene)
        self._stiffness = stiffness_and_damping(network)[0]
        v = np.zeros_like(particles.position)
        self._force = -diagnostics.spring_forces(particles.position, v, scene.springs)
        a, b = scene.springs.between.T
        lengths = np.linalg.norm(particles.position[b] - particles.position[a], axis=1)
        lengths = lengths[lengths > 0]
        size = float(np.median(lengths)) if len(lengths) else min(scene.world.size) / 100
        self._disturbance = DISTURBANCE * size

    def seconds_a_step(self) -> float:
        """How long a step takes here."""
        sim = self._sim
        sim.set_step(1e-9, 100)
        sim.advance()  # compiles
        begin = time.perf_counter()
        sim.advance()
        return (time.perf_counter() - begin) / 100

    def is_unstable(self, h: float, limit: Limit, look: Look) -> bool:
        """Whether a disturbance grows at steps of h; limit: says along which mode it starts."""
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

    def _disturbed(self, limit, rng):
        """Positions and velocities of the disturbed state."""
        position = self._scene.particles.position
        rate = math.sqrt(limit.omega2) or limit.damping or 1.0
        x, v = np.zeros_like(position), np.zeros_like(position)
        if limit.mode is not None:
            largest = max(np.abs(limit.mode).max(), np.abs(limit.velocity).max() / rate)
            x, v = limit.mode / largest, limit.velocity / largest
        x = x + NOISE * rng.standard_normal(position.shape)
        v = v + NOISE * rate * rng.standard_normal(position.shape)
        free = self._free[:, None]
        return position + np.where(free, self._disturbance * x, 0.0), self._disturbance * v

    def _energy(self) -> float:
        """Of the disturbance: kinetic, and of the springs around the equilibrium."""
        x = self._sim.positions() - self._scene.particles.position
        q = (self._mass * x[self._free]).ravel()
        p = (self._mass * self._sim.velocities()[self._free]).ravel()
        return float(q @ (self._stiffness @ q) + p @ p)


def _measure(scene: Scene, row: Row, maps: list[Map], tell: Callable) -> None:
    """The real limit of one method, and its maps."""
    limit = row.limit
    if math.isinf(limit.dt):
        row.dt_measured, row.status = math.inf, "no limit: nothing can become unstable"
        return
    runs = Runs(scene, row.method)
    seconds = runs.seconds_a_step()
    look = _long_enough(methods.load(row.method), limit, seconds)
    try:
        row.dt_measured, row.status = bisect(runs, limit, look, lambda: tell(row.method))
    finally:
        row.runs, row.steps = runs.runs, runs.steps
    if _claimed(row.method) == 0:
        return  # what grows there does so in 1e5 steps: too many for every point of a map
    mesh = MESH if seconds * MESH.points * MESH.look.steps < MAP_SECONDS else COARSE_MESH
    for draw in (_stiffness_map, _mass_map):
        draw(scene, row, runs, mesh, maps, tell)


def _long_enough(method, limit, seconds) -> Look:
    """As many steps, of `seconds` each, as show what grows a little above the limit."""
    beyond = (1 + 2 * ACCURACY) * limit.dt
    rate = math.log(max(modes.growth(method, beyond, limit.omega2, limit.damping), 1 + 1e-12))
    needed = 3 * math.log(Look.margin) / rate
    steps = min(max(needed, min(RUN_SECONDS / seconds, 100_000)), MOST_SECONDS / seconds)
    return Look(int(np.clip(steps, *RUN_STEPS)))


def bisect(runs: Runs, limit: Limit, look: Look, tell=lambda: None) -> tuple[float, str]:
    """The step between stable and unstable runs, to within ACCURACY, and how it was found.

    0 where the disturbance grows at a hundredth of the step that would resolve the mode.
    """

    def unstable(h):
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


def _stiffness_map(scene, row, runs, mesh, maps, tell):
    """Every spring's stiffness times a factor."""

    def changed(factor):
        springs = scene.springs
        return replace(scene, springs=replace(springs, stiffness=factor * springs.stiffness))

    if len(scene.springs):
        drawn = Map(row.method, "stiffness")
        maps.append(drawn)
        _draw_map(drawn, np.logspace(-2, 2, mesh.columns), mesh, changed, runs, tell)


def _mass_map(scene, row, runs, mesh, maps, tell):
    """The mass of every second free particle times a factor."""
    second = np.flatnonzero(~scene.particles.fixed)[::2]

    def changed(factor):
        mass = scene.particles.mass.copy()
        mass[second] *= factor
        return replace(scene, particles=replace(scene.particles, mass=mass))

    drawn = Map(row.method, "mass")
    maps.append(drawn)
    _draw_map(drawn, np.logspace(-3, 3, mesh.columns), mesh, changed, runs, tell)


def _draw_map(drawn, factors, mesh, changed, runs, tell):
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


def _stall(scene: Scene) -> Stall:
    """Where f32 stops following the scene's own start, gravity included."""
    p = scene.particles
    with np.errstate(all="ignore"):
        force = diagnostics.spring_forces(p.position, p.velocity, scene.springs)
        force -= p.viscous[:, None] * p.velocity
        a = np.asarray(scene.world.gravity) + force / p.mass[:, None]
    return f32_stall(p.position, p.velocity, a, p.fixed, scene.world.dt)


# --- reporting -------------------------------------------------------------------------------

FILES = ("stability.csv", "stability-map.csv", "stability.png", "stability.svg")


def _write(folder, scene, rows, maps, stall) -> list[Path]:
    """The files, each whole or not at all; returns their paths."""
    table = [_record(scene, row, stall) for row in rows]
    points = [
        {
            "method": m.method,
            "map": m.kind,
            "factor": factor,
            "dt": h,
            "stable": "yes" if stable else "no",
            "dt_computed": m.line[m.factor.index(factor)],
        }
        for m in maps
        for factor, h, stable in m.points
    ]
    header = ["method", "map", "factor", "dt", "stable", "dt_computed"]
    contents = {
        FILES[0]: _csv(list(table[0]), table),
        FILES[1]: _csv(header, points),
    }
    figure = _figure(scene, rows, maps)
    for name, kind in ((FILES[2], "png"), (FILES[3], "svg")):
        buffer = io.BytesIO()
        figure.savefig(buffer, format=kind, dpi=130)
        contents[name] = buffer.getvalue()
    for name, content in contents.items():
        PendingFile(folder / name).fill(lambda file, content=content: file.write(content))
    return [folder / name for name in FILES]


def _record(scene, row, stall) -> dict:
    """One row of stability.csv."""
    limit = row.limit
    return {
        "scene": scene.name,
        "method": row.method,
        "dt_gershgorin": row.dt_gershgorin,
        "dt_any_geometry": row.dt_any_geometry,
        "dt_computed": limit.dt,
        "dt_measured": "" if row.dt_measured is None else row.dt_measured,
        "status": row.status,
        "omega": math.sqrt(limit.omega2),
        "damping_rate": limit.damping,
        "spring": limit.spring if limit.spring >= 0 else "",
        "spring_from": limit.ends[0] if limit.spring >= 0 else "",
        "spring_to": limit.ends[1] if limit.spring >= 0 else "",
        "spring_share": limit.share,
        "particle": limit.particle if limit.particle >= 0 else "",
        "dt_f32_stall": stall.dt,
        "f32_stall": stall.describe(),
        "runs": row.runs,
        "steps": row.steps,
    }


def _csv(header, records) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, header, lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return text.getvalue().encode()


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    if math.isinf(value):
        return "every"
    return "none" if value == 0 else f"{value:.4g}"


def _show(scene, rows, stall, chosen) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    # A pipe or a file has no width: give whole lines a place where they fit.
    console = Console() if sys.stdout.isatty() else Console(width=160)
    table = Table(
        box=box.SIMPLE_HEAD, header_style="bold", pad_edge=False,
        title=f"largest stable step, {scene.name}", title_justify="left",
    )  # fmt: skip
    table.add_column("method")
    for head in ("Gershgorin", "any geometry", "computed", "measured", "off by"):
        table.add_column(head, justify="right")
    table.add_column("set by")
    for row in rows:
        computed, measured = row.limit.dt, row.dt_measured
        both = measured and 0 < computed < math.inf and measured < math.inf
        difference = f"{100 * (measured / computed - 1):+.2f} %" if both else ""
        table.add_row(
            row.method,
            *map(_number, (row.dt_gershgorin, row.dt_any_geometry, computed, measured)),
            difference,
            f"spring {row.limit.spring}" if row.limit.spring >= 0 else row.limit.describe(),
        )
    console.print(table)
    for says in dict.fromkeys(row.limit.describe() for row in rows if row.limit.spring >= 0):
        console.print(says[0].upper() + says[1:] + ".", highlight=False)
    for row in rows:
        if row.status != "measured":
            console.print(f"{row.method}: {row.status}", highlight=False)
    dt = scene.world.dt
    says = f"The scene's frame is {dt:g}; --dt auto stays below {SAFETY} of 'any geometry'."
    console.print(says, highlight=False)
    if chosen is None:
        free = [m for m in methods.METHODS if math.isinf(_claimed(m))]
        if free:
            console.print(f"Stable at every step: {', '.join(free)}.", highlight=False)
    where = f" ({stall.describe()})" if stall.particle >= 0 else ""
    says = f"f32 stalls below a step of {stall.dt:.3g}" if stall.dt else "f32 stalls nowhere"
    console.print(f"{says}{where}.", highlight=False)


COLOURS = {True: "#2274a5", False: "#e8743b"}  # stable, unstable: apart for the colour-blind too


def _figure(scene, rows, maps):
    """Maps of dt by stiffness and by mass ratio, a column a method, with the computed line."""
    from matplotlib.figure import Figure

    drawn = [row for row in rows if any(m.method == row.method for m in maps)]
    count = f"{len(scene.particles)} particles, {len(scene.springs)} springs"
    title = f"Stable and unstable runs of {scene.name} ({count})"
    if not drawn:
        figure = Figure(figsize=(7, 3))
        lines = [f"{row.method}: {row.status}" for row in rows]
        figure.text(0.5, 0.5, "No map.\n" + "\n".join(lines), ha="center", va="center")
        figure.suptitle(title)
        return figure
    kinds = [kind for kind in ("stiffness", "mass") if any(m.kind == kind for m in maps)]
    figure = Figure(figsize=(1.2 + 3.6 * max(len(drawn), 2), 1.2 + 3.5 * len(kinds)))
    panels = figure.subplots(len(kinds), len(drawn), sharex="row", sharey="row", squeeze=False)
    names = {
        "stiffness": "stiffness of all springs / the scene's",
        "mass": "mass of every second particle / the scene's",
    }
    for i, kind in enumerate(kinds):
        for j, row in enumerate(drawn):
            panel = panels[i][j]
            for m in maps:
                if (m.method, m.kind) == (row.method, kind):
                    _panel(panel, m, row)
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.set_xlabel(names[kind])
            if i == 0:
                panel.set_title(row.method)
            if j == 0:
                panel.set_ylabel("step dt (the scene's time)")
            panel.grid(True, which="major", alpha=0.25, linewidth=0.6)
    handles = {}
    for panel in panels.ravel():
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(
        handles.values(), handles.keys(), loc="lower center", ncols=len(handles), frameon=False
    )
    figure.suptitle(title)
    figure.tight_layout(rect=(0, 0.06, 1, 0.98))
    return figure


def _panel(panel, drawn: Map, row: Row) -> None:
    marks = {True: ("o", "stable run"), False: ("x", "unstable run")}
    for stable, (marker, label) in marks.items():
        points = [(factor, h) for factor, h, was in drawn.points if was == stable]
        if points:
            style = {"facecolors": "none", "edgecolors": COLOURS[stable]} if stable else {}
            style = style or {"color": COLOURS[stable]}
            panel.scatter(*zip(*points, strict=True), marker=marker, s=22, label=label, **style)
    panel.plot(drawn.factor, drawn.line, color="black", linewidth=1.5, label="computed limit")
    if row.dt_measured:
        panel.scatter(
            [1.0], [row.dt_measured], marker="D", s=42, color="black", zorder=3,
            label="measured limit of the scene",
        )  # fmt: skip


class _Progress:
    """A progress bar with the time left, on a terminal's standard error; elsewhere nothing.

    Used as a context whose value is called before each run, with its method, and its map if it is
    for one.
    """

    BISECTION = 10  # runs, about, each as long as WEIGHT of a map's
    WEIGHT = 14

    def __init__(self, rows: list[Row], quiet: bool):
        self._bar = None
        if quiet or not sys.stderr.isatty():
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        self._bar = Progress(
            TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn(),
            console=Console(stderr=True), transient=True,
        )  # fmt: skip
        # What is done when a method begins, and all there is to do.
        self._begins, total = {}, 0
        for row in rows:
            self._begins[row.method] = total
            if not math.isinf(row.limit.dt):
                total += self.BISECTION * self.WEIGHT
                total += 2 * MESH.points * (_claimed(row.method) > 0)
        self._task = self._bar.add_task("computing", total=total)
        self._method = ""

    def __enter__(self):
        if self._bar:
            self._bar.start()
        return self._tell

    def _tell(self, method: str, map_: str = "") -> None:
        if not self._bar:
            return
        if method != self._method:
            self._method = method
            self._bar.update(self._task, completed=self._begins[method])
        text = f"{method}, map of {map_}" if map_ else f"{method}, bisection"
        self._bar.update(self._task, description=text, advance=1 if map_ else self.WEIGHT)

    def __exit__(self, *_):
        if self._bar:
            self._bar.stop()
