"""The settings of a run that may be changed while it goes on, declared once: for panels and logs.

`settings_of` lists those that a simulation has, with limits, units and the scene's own values; all
of them go through the simulation's own functions (`set`, `set_step`, `set_solver`, `set_method`),
so what these refuse is refused, and nothing of the state is lost. `apply` sets one by its name, as
a log's event does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.kernels import methods
from taichi_cloth.scene.cloth import LINKS
from taichi_cloth.scene.properties import PARTICLE_PROPERTIES, SPRING_PROPERTIES
from taichi_cloth.scene.world_keys import world_keys
from taichi_cloth.settings.options import SOLVER_SETTINGS, RunOptions, parameters_of
from taichi_cloth.simulation import editing
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.storage import layouts

if TYPE_CHECKING:
    from taichi_cloth.scene.model import Scene, World
    from taichi_cloth.scene.properties import WorldKey
    from taichi_cloth.simulation.simulation import Simulation

NUMBER, COUNT, WORD, FLAG = KINDS = ("number", "count", "word", "flag")
Value = float | int | str | bool | None  # None: off, of a number that may be absent

SPAN = 100.0  # a slider reaches from a value's hundredth to its hundredfold
TIMES = "x"  # the unit of a factor: how many times the scene's own


@dataclass(frozen=True)
class Setting:
    """One setting, as it is declared for one scene.

    name: by which logs call it. group: "run", "material", "world" or "features". label, unit, help:
    in words. kind: out of `KINDS`. low, high: the ends of a slider; log: whether it goes by powers.
    Numbers beyond them may be typed, as far as a flag of the same name takes them. words: what a
    word may be. optional: whether None, off, is a value.
    read: its value in a simulation. own: the scene's, or that with which the run began. fixed: why
    it cannot be set here; "": it can.
    changes: what `Simulation.set` takes for a value; None: it goes another way, by `write`.
    """

    name: str
    group: str
    label: str
    unit: str
    help: str
    kind: str
    read: Callable[[Simulation], Value]
    own: Value
    low: float = 0.0
    high: float = 1.0
    log: bool = False
    words: tuple[str, ...] = ()
    optional: bool = False
    fixed: str = ""
    changes: Callable[[Simulation, Any], dict[str, Any]] | None = None
    write: Callable[[Simulation, Any], None] | None = None

    def checked(self, value: Any) -> Value:
        """The value, if it is one of this kind; else InputError. Limits are the simulation's."""
        if value is None and self.optional:
            return None
        if self.kind == WORD:
            if not isinstance(value, str):
                words = ", ".join(self.words)
                raise InputError(f"{self.name} must be one of {words}, is {value}")
            if value not in self.words:
                raise InputError(f"{self.name}: unknown '{value}'; {nearest(value, self.words)}")
        elif self.kind == FLAG:
            if not isinstance(value, bool):
                raise InputError(f"{self.name} must be true or false, is {value}")
        elif isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(f"{self.name} must be a number, is {value}")
        elif self.kind == COUNT and value != int(value):
            raise InputError(f"{self.name} must be a whole number, is {value:g}")
        checked: Value = int(value) if self.kind == COUNT else value
        return checked

    def set(self, sim: Simulation, value: Any) -> None:
        """Give it a value, from the next step on; InputError where it is refused."""
        value = self.checked(value)
        if self.fixed:
            raise InputError(f"{self.name}: {self.fixed}")
        if self.changes is not None:
            sim.set(**self.changes(sim, value))
        elif self.write is not None:
            self.write(sim, value)

    def compiles(self, sim: Simulation, value: Any) -> bool:
        """True if setting it to a value compiles kernels, and the window waits meanwhile."""
        if self.name == "method":
            return bool(value != sim.method)
        if self.changes is None or value == self.read(sim):
            return False
        try:
            return not sim.storage.fits(self._changed(sim, sim.storage.snapshot(), value))
        except InputError:
            return False

    def scene_with(self, sim: Simulation, value: Any) -> Scene | None:
        """The scene with another value; None where it goes another way, or is refused."""
        if self.changes is None:
            return None
        try:
            return self._changed(sim, Snapshot.at_start(sim.storage.scene), value).scene
        except InputError:
            return None

    def _changed(self, sim: Simulation, now: Snapshot, value: Any) -> Snapshot:
        assert self.changes is not None
        given = dict(self.changes(sim, self.checked(value)))
        selection = editing.Selection(given.pop("particles", None), given.pop("springs", None))
        return editing.with_values(now, given, selection)


def settings_of(sim: Simulation) -> list[Setting]:
    """The settings that a simulation has now, in the order of a panel."""
    return [*_of_run(sim), *_of_springs(sim), *_of_particles(sim), *_of_world(sim), *_features(sim)]


def setting(sim: Simulation, name: str) -> Setting:
    """One of them, by its name. InputError for one that the simulation has not."""
    known = {one.name: one for one in settings_of(sim)}
    if name not in known:
        raise InputError(f"set: '{sim.scene.name}' has no setting '{name}'; {nearest(name, known)}")
    return known[name]


def apply(sim: Simulation, name: str, value: Any) -> None:
    """Give a setting a value, as a log's event says."""
    setting(sim, name).set(sim, value)


# --- the run ---------------------------------------------------------------------------------


def _of_run(sim: Simulation) -> Iterator[Setting]:
    about, began = parameters_of(RunOptions), sim.began
    follows = "--dt auto chooses it" if sim.follows else ""
    yield Setting(
        "method", "run", "method", "", about["method"].help, WORD,
        lambda s: s.method, began["method"], words=tuple(methods.METHODS),
        write=lambda s, value: s.set_method(value),
    )  # fmt: skip
    dt = float(began["dt"])
    substeps = sim.substeps if sim.follows else began["substeps"]
    yield Setting(
        "dt", "run", "frame time", "time", "time of one frame", NUMBER,
        lambda s: s.dt, dt, dt / 10, dt * 10, log=True, fixed=follows,
        write=lambda s, value: s.set_step(dt=_as_flagged("dt", value)),
    )  # fmt: skip
    yield Setting(
        "substeps", "run", "substeps", "", about["substeps"].help, COUNT,
        lambda s: s.substeps, substeps, 1, 256, log=True, fixed=follows,
        write=lambda s, value: s.set_step(substeps=_as_flagged("substeps", value)),
    )  # fmt: skip
    if "tolerance" in sim.claims.settings:
        yield _of_solver(sim, "tolerance", NUMBER, 1e-10, 1.0)
    if "iterations" in sim.claims.settings:
        yield _of_solver(sim, "iterations", COUNT, 1, 200)


def _as_flagged(name: str, value: Any) -> Any:
    """The value, if the flag of that name takes it; else InputError. A frame of more substeps than
    that would last so long that a window does not answer.
    """
    return parameters_of(RunOptions)[name].check(f"--{name}", value)


def _of_solver(sim: Simulation, name: str, kind: str, low: float, high: float) -> Setting:
    def write(sim: Simulation, value: Any) -> None:
        sim.set_solver(**{name: _as_flagged(name, value)})

    return Setting(
        name, "run", name, "", parameters_of(RunOptions)[name].help, kind,
        lambda s: s.solver.get(name), sim.began.get(name, SOLVER_SETTINGS[name]),
        low, high, log=True, write=write,
    )  # fmt: skip


# --- numbers of springs and particles --------------------------------------------------------


@dataclass(frozen=True)
class _Column:
    """A number of springs or particles, for some of them: those that the scene came with.

    now, own: what they have, and had at the scene's start, (m,). chosen: which they are.
    """

    now: np.ndarray
    own: np.ndarray
    chosen: np.ndarray

    @property
    def alike(self) -> bool:
        """True if all are the same, now and in the scene: else a factor is what is set."""
        return bool((self.now == self.now[0]).all() and (self.own == self.own[0]).all())

    def value(self) -> Value:
        """The number of all, or how many times the scene's they have."""
        if self.alike:
            return None if np.isinf(self.now[0]) else float(self.now[0])
        usual = (self.own > 0) & np.isfinite(self.own) & np.isfinite(self.now)
        at = int(usual.argmax())
        return float(self.now[at] / self.own[at]) if usual.any() else 1.0

    def scene_value(self) -> Value:
        """The scene's own."""
        if self.alike:
            return None if np.isinf(self.own[0]) else float(self.own[0])
        return 1.0

    def given(self, value: float | None) -> Any:
        """The value set, one for all or (m,)."""
        if self.alike or value is None:
            return value
        return self.own * value


def _column(sim: Simulation, table: str, name: str, kind: str | None = None) -> _Column | None:
    """A column of the springs or particles that the scene came with, or of all, where it has others
    now, or came with none; None: there are none.
    """
    now, own = getattr(sim.storage.scene, table), getattr(sim.scene, table)
    key = "between" if table == "springs" else "position"
    count = len(own)
    same = 0 < count <= len(now) and np.array_equal(getattr(now, key)[:count], getattr(own, key))
    chosen = np.arange(len(own) if same else len(now))
    if kind is not None:
        mine = layouts.springs_of_kind(kind, now.between, len(sim.storage.scene.particles))
        chosen = chosen[mine[chosen]]
    if len(chosen) == 0:
        return None
    values = getattr(now, name)[chosen]
    if count == 0:
        return _Column(values, _clicked(sim.scene, table, name, len(chosen)), chosen)
    return _Column(values, getattr(own, name)[chosen] if same else values, chosen)


def _clicked(scene: Scene, table: str, name: str, count: int) -> np.ndarray:
    """The numbers of springs or particles added to a scene, (count,)."""
    springs = table == "springs"
    about = (SPRING_PROPERTIES if springs else PARTICLE_PROPERTIES)[name]
    default = getattr(scene.spring_defaults if springs else scene.particle_defaults, name)
    return about.column(about.off if default is None else default, count)


def _of_springs(sim: Simulation) -> Iterator[Setting]:
    if len(sim.storage.scene.springs) == 0:
        return
    yield from _column_setting(sim, "springs", "stiffness", "stiffness")
    kinds = [kind for kind in LINKS if _column(sim, "springs", "stiffness", kind) is not None]
    for kind in kinds if len(kinds) > 1 else ():
        yield from _column_setting(sim, "springs", "stiffness", f"{kind} stiffness", kind)
    for name in ("damping", "break_force"):
        yield from _column_setting(sim, "springs", name, name.replace("_", " "))


def _of_particles(sim: Simulation) -> Iterator[Setting]:
    if len(sim.storage.scene.particles) == 0:
        return
    yield from _column_setting(sim, "particles", "viscous", "drag")
    if sim.storage.scene.features().thick:
        yield from _column_setting(sim, "particles", "thickness", "thickness")
    if len(sim.storage.scene.stencils):
        own, now = sim.scene.stencils.bending, sim.storage.scene.stencils.bending
        typical = float(own.max(initial=0.0)) or float(now.max(initial=0.0)) or 1e-5
        yield Setting(
            "bending", "material", "bending", TIMES, "rigidity of its cloths", NUMBER,
            lambda s: float(s.storage.scene.stencils.bending.max() / typical),
            float(own.max() / typical) if len(own) == len(now) else 1.0, 1 / SPAN, SPAN, log=True,
            changes=lambda s, value: {"bending": _bending(s, typical, value)},
        )  # fmt: skip


def _bending(sim: Simulation, typical: float, value: float) -> Any:
    own, now = sim.scene.stencils.bending, sim.storage.scene.stencils.bending
    return own * value if len(own) == len(now) and own.any() else typical * value


def _column_setting(
    sim: Simulation, table: str, name: str, label: str, kind: str | None = None
) -> Iterator[Setting]:
    column = _column(sim, table, name, kind)
    if column is None:
        return
    about = (SPRING_PROPERTIES if table == "springs" else PARTICLE_PROPERTIES)[name]

    def now(sim: Simulation) -> _Column:
        found = _column(sim, table, name, kind)
        assert found is not None
        return found

    def changes(sim: Simulation, value: float | None) -> dict[str, Any]:
        there = now(sim)
        return {name: there.given(value), table: there.chosen}

    own = column.scene_value()
    middle = own if isinstance(own, float) and own > 0 else _typical(sim.scene, name)
    yield Setting(
        name if kind is None else f"{name}.{kind}",
        "material",
        label,
        about.unit if column.alike else TIMES,
        about.help,
        NUMBER,
        lambda s: now(s).value(),
        own,
        middle / SPAN,
        middle * SPAN,
        log=True,
        optional=about.off is not None,
        changes=changes,
    )


def _typical(scene: Scene, name: str) -> float:
    """A number of a size that shows in the scene, where it has 0 or none."""
    springs, particles = scene.springs, scene.particles
    ties = springs if len(springs) else scene.spring_defaults
    k = float(np.median(ties.stiffness))
    length = 1.0 if ties.rest_length is None else float(np.median(ties.rest_length))
    mass = float(np.median((particles if len(particles) else scene.particle_defaults).mass))
    by_name = {
        "damping": 0.2 * float(np.sqrt(k * mass)),
        "viscous": 0.1 * mass / (60 * scene.world.dt),
        "break_force": 0.5 * k * length,
        "thickness": 0.5 * length,
    }
    return by_name.get(name) or 1.0


# --- the world -------------------------------------------------------------------------------


def _of_world(sim: Simulation) -> Iterator[Setting]:
    world = sim.scene.world
    for axis in range(world.dim):
        yield _gravity(world, axis)
    if sim.can_touch() or world.contact == "resting":
        yield Setting(
            "friction", "world", "friction", "", "of ground, resting walls and obstacles", NUMBER,
            _friction, _friction_of(sim.scene), 0.0, 1.5,
            changes=lambda s, value: {"friction": value},
        )  # fmt: skip
    for name in sim.storage.scene.world.more:
        yield from _key_settings(sim, world_keys()[name])


def _gravity(world: World, axis: int) -> Setting:
    letter, own = "xyz"[axis], world.gravity
    size = float(np.abs(own).max()) or float(np.mean(world.size)) / (60 * world.dt) ** 2

    def changes(sim: Simulation, value: float) -> dict[str, Any]:
        return {"gravity": _with(sim.storage.scene.world.gravity, axis, value)}

    return Setting(
        f"gravity.{letter}", "world", f"gravity {letter}", "length / time^2", "acceleration",
        NUMBER, lambda s: s.storage.scene.world.gravity[axis], float(own[axis]),
        -3 * size, 3 * size, changes=changes,
    )  # fmt: skip


def _friction_of(scene: Scene) -> float:
    values = [float(of.value("friction")) for of in scene.obstacles]
    return max([float(scene.world.friction), *values])


def _friction(sim: Simulation) -> float:
    return _friction_of(sim.storage.scene)


def _with(vector: tuple[float, ...], axis: int, value: float) -> tuple[float, ...]:
    changed = list(vector)
    changed[axis] = value
    return tuple(changed)


def _key_settings(sim: Simulation, key: WorldKey) -> Iterator[Setting]:
    """The settings of a key of [world]: of each number in it."""
    parts = key.table.values() if key.table else (key,)
    for part in parts:
        if part.name == "seed":
            continue
        for axis in range(sim.scene.world.dim) if part.vector else (None,):
            yield _key_setting(sim, key, part, axis)


def _key_setting(sim: Simulation, key: WorldKey, part: WorldKey, axis: int | None) -> Setting:
    def found(world: World) -> Any:
        value = world.more.get(key.name)
        if key.table and isinstance(value, dict):
            value = value.get(part.name, (0.0,) * world.dim if part.vector else 0.0)
        return value

    def number(world: World) -> Value:
        value = found(world)
        if value is None:
            return 0.0
        return float(value if axis is None else value[axis])

    def changes(sim: Simulation, value: float) -> dict[str, Any]:
        new = value if axis is None else _with(found(sim.storage.scene.world), axis, value)
        return {key.name: {part.name: new} if key.table else new}

    letter = "" if axis is None else "xyz"[axis]
    words = [key.name, part.name] if key.table else [key.name]
    own = number(sim.scene.world)
    size = max(abs(float(own or 0.0)), 1.0)
    return Setting(
        ".".join([*words, *letter]), "world", " ".join([*words, *letter]), part.unit, part.help,
        NUMBER, lambda s: number(s.storage.scene.world), own, -5 * size if part.vector else 0.0,
        5 * size, changes=changes,
    )  # fmt: skip


# --- features --------------------------------------------------------------------------------


def _features(sim: Simulation) -> Iterator[Setting]:
    scene, now = sim.scene, sim.storage.scene
    yield _feature(
        sim, "collisions", "particles bounce off each other",
        lambda of: of.world.collisions, lambda s, on: {"collisions": on},
    )  # fmt: skip
    if len(now.springs):
        yield _feature(
            sim, "fracture", "springs break beyond their break force",
            _breaks,
            lambda s, on: _back(s, "springs", "break_force", on),
        )  # fmt: skip
    if scene.world.dim == 3 and len(now.triangles):
        yield _feature(
            sim, "self_collision", "cloth does not pass through itself",
            lambda of: of.features().thick, lambda s, on: _back(s, "particles", "thickness", on),
        )  # fmt: skip
        yield _feature(
            sim, "air", "drag, lift and wind on every triangle",
            lambda of: "air" in of.world.more, _air,
        )  # fmt: skip
    if len(now.stencils):
        yield _feature(
            sim, "bending_resistance", "cloth resists being bent",
            lambda of: bool((of.stencils.bending > 0).any()),
            lambda s, on: {"bending": _bending(s, 1e-5, 1.0 if on else 0.0)},
        )  # fmt: skip


def _feature(
    sim: Simulation,
    name: str,
    about: str,
    has: Callable[[Scene], bool],
    changes: Callable[[Simulation, bool], dict[str, Any]],
) -> Setting:
    return Setting(
        name, "features", name.replace("_", " "), "", about, FLAG,
        lambda s: has(s.storage.scene), has(sim.scene), changes=changes,
    )  # fmt: skip


def _breaks(scene: Scene) -> bool:
    """True if any of a scene's springs breaks; where it has none, any that is added."""
    springs = scene.springs
    limits = springs.break_force if len(springs) else _clicked(scene, "springs", "break_force", 1)
    return bool(np.isfinite(limits).any())


def _back(sim: Simulation, table: str, name: str, on: bool) -> dict[str, Any]:
    """A column off, or what it was in the scene, or typical where that had none."""
    column = _column(sim, table, name)
    assert column is not None
    off = np.inf if name == "break_force" else 0.0
    if not on:
        return {name: off, table: column.chosen}
    own = column.own if (column.own != off).any() else _typical(sim.scene, name)
    return {name: own, table: column.chosen}


def _air(sim: Simulation, on: bool) -> dict[str, Any]:
    if not on:
        return {"wind": None, "air": None}
    own = {name: value for name, value in sim.scene.world.more.items() if name in ("air", "wind")}
    return own or {"air": {"density": 1.2}}
