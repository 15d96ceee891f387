"""Changes to a state from outside, while it runs: numbers, motion, springs, particles (NumPy).

Each takes a `Snapshot` and gives another one, or raises InputError; whatever it does not name stays
as it is. What may be set, and within which limits, is read from the declarations of properties
(`scene/properties.py`) and of the world's keys (`kernels/forces/`): a new one needs no line here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.kernels.state import ALIVE, GONE
from taichi_cloth.scene.cloth import LINKS
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.scene.properties import (
    NOT_NEGATIVE,
    PARTICLE_PROPERTIES,
    SPRING_PROPERTIES,
    Property,
    Rule,
    WorldKey,
    WorldNumber,
    WorldValue,
)
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.scene.world_keys import world_keys
from taichi_cloth.settings import accepted
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.storage import layouts

OF_PARTICLES = (*PARTICLE_PROPERTIES, "fixed", "color", "positions", "velocities")
OF_STENCILS = "bending"
OF_WORLD = ("gravity", "friction", "collisions")


def settable() -> list[str]:
    """The names of all that `with_values` takes."""
    return [*OF_PARTICLES, *SPRING_PROPERTIES, OF_STENCILS, *OF_WORLD, *world_keys()]


@dataclass(frozen=True)
class Selection:
    """Which particles and springs get values: indices or masks; None: all.

    kind: those springs of the scene's regular grids that are of this kind of link.
    """

    particles: Any = None
    springs: Any = None
    kind: str | None = None


def with_values(now: Snapshot, given: Mapping[str, Any], selection: Selection) -> Snapshot:
    """The state with other values, by name: one for all that are selected, or one for each."""
    if not given:
        raise InputError(f"set: nothing to set; known: {', '.join(settable())}")
    accepted.names("set", given, settable())
    of_particles = {name: given[name] for name in given if name in OF_PARTICLES}
    of_springs = {name: given[name] for name in given if name in SPRING_PROPERTIES}
    others = {*of_particles, *of_springs, OF_STENCILS}
    of_world = {name: given[name] for name in given if name not in others}
    chosen = _particles(now, selection, bool(of_particles))
    tied = _springs(now, selection, bool(of_springs))
    scene, x, v = now.scene, now.x, now.v
    if of_world:
        scene = scene.with_parts(world=_world(scene.world, of_world))
    if "friction" in of_world:
        scene = scene.with_parts(obstacles=_rubbing(scene.obstacles, of_world["friction"]))
    if of_particles:
        x, v = _motion(now, of_particles, chosen)
        scene = scene.with_parts(particles=_with_columns(scene.particles, of_particles, chosen))
    if "mass" in of_particles:
        scene = _weighing_more(scene, now.scene, chosen)
    if of_springs:
        scene = scene.with_parts(springs=_with_numbers(scene.springs, of_springs, tied, x))
    if OF_STENCILS in given:
        scene = scene.with_parts(stencils=_with_bending(scene, given[OF_STENCILS]))
    edited, before = replace(now.moved(x, v), scene=scene), now.scene.particles.fixed
    changed = scene.particles.fixed != before
    grips = edited.grips and edited.grips.but(changed)
    return replace(edited, judged=edited.judged.freed(changed & before), grips=grips)


def with_spring(now: Snapshot, i: int, j: int, given: Mapping[str, Any]) -> tuple[Snapshot, int]:
    """The state with particles i and j tied by a spring, and the spring's number.

    given: its numbers; the others are the scene's defaults, the rest length the distance that the
    two have now. A spring of theirs that is gone is whole again with these numbers.
    """
    what, count = "add_spring", len(now.x)
    ends = []
    for name, end in (("i", i), ("j", j)):
        ends.append(accepted.whole_number(f"{what}: particle {name}", end))
        if ends[-1] >= count:
            has = f"particles 0 to {count - 1}" if count else "none"
            raise InputError(f"{what}: there is no particle {ends[-1]}; the scene has {has}")
    if ends[0] == ends[1]:
        raise InputError(f"{what}: it ties particle {ends[0]} to itself; give two different ones")
    accepted.names(what, given, SPRING_PROPERTIES)
    single = {name: value for name, value in given.items() if value is not None}
    apart = float(np.linalg.norm(now.x[ends[1]] - now.x[ends[0]]))
    bare = Springs.build(
        [ends], now.x, defaults=now.scene.spring_defaults, **{"rest_length": apart}
    )
    tie = _with_numbers(bare, single, np.zeros(1, np.int64), now.x, what)
    scene, marks = now.scene, now.marks
    there = np.flatnonzero((np.sort(scene.springs.between, axis=1) == np.sort(ends)).all(axis=1))
    if len(there) == 0:
        joined = scene.springs.joined(tie)
        marks = np.concatenate([marks, np.array([[ALIVE, 0]], np.int32)])
        return replace(now, scene=replace(scene, springs=joined), marks=marks), len(joined) - 1
    s = int(there[0])
    if marks[s, 0] != GONE:
        raise InputError(f"{what}: spring {s} ties particles {ends[0]} and {ends[1]} already")
    columns = {name: column.copy() for name, column in vars(scene.springs).items()}
    for name, column in columns.items():
        column[s] = getattr(tie, name)[0]
    marks = marks.copy()
    marks[s] = ALIVE, 0
    return replace(now, scene=replace(scene, springs=Springs(**columns)), marks=marks), s


def with_cut(now: Snapshot, chosen: np.ndarray, steps: int) -> Snapshot:
    """The state in which some springs are gone, after `steps` steps; what is gone stays so."""
    marks = now.marks.copy()
    holding = chosen[marks[chosen, 0] != GONE]
    # In a step before the last one, so that a frame that is undone does not mend them.
    marks[holding] = GONE, steps - 1
    return replace(now, marks=marks)


def without(now: Snapshot, particles: np.ndarray) -> tuple[Snapshot, np.ndarray]:
    """The state without some particles and all that has one of them, and which particles are left.

    The latter by their numbers, (m,). What is left, springs, triangles and stencils, keeps its
    order.
    """
    count = len(now.x)
    gone = np.zeros(count, bool)
    gone[particles] = True
    left = np.flatnonzero(~gone)
    number = np.cumsum(~gone) - 1
    scene, between = now.scene, now.scene.springs.between
    holds = np.flatnonzero(~gone[between].any(axis=1))
    springs = scene.springs.select(holds)
    kept = Particles(**{name: rows[left] for name, rows in vars(scene.particles).items()})
    whole = ~gone[scene.triangles].any(axis=1)
    scene = replace(
        scene,
        particles=kept,
        springs=replace(springs, between=number[springs.between]),
        triangles=number[scene.triangles[whole]],
        stencils=scene.stencils.without(gone).renumbered(number),
    )
    judged = now.judged.without(gone)
    judged = replace(judged, elements=number[judged.elements])
    grips = now.grips and now.grips.select(left)
    return Snapshot(scene, now.x[left], now.v[left], now.marks[holds], judged, grips), left


def same(a: Snapshot, b: Snapshot) -> bool:
    """True if two states are equal, number by number."""

    def equal(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
        alike = (one[k] is other[k] or np.array_equal(one[k], other[k]) for k in one)
        return one.keys() == other.keys() and all(alike)

    worlds = [{**vars(now.scene.world), **now.scene.world.more, "more": 0} for now in (a, b)]
    return (
        equal(*worlds)
        and all(
            one is other for one, other in zip(a.scene.obstacles, b.scene.obstacles, strict=True)
        )
        and equal(vars(a.scene.particles), vars(b.scene.particles))
        and equal(vars(a.scene.springs), vars(b.scene.springs))
        and np.array_equal(a.scene.triangles, b.scene.triangles)
        and equal(vars(a.scene.stencils), vars(b.scene.stencils))
        and all(np.array_equal(getattr(a, k), getattr(b, k)) for k in ("x", "v", "marks"))
    )


# --- selections ------------------------------------------------------------------------------


def _particles(now: Snapshot, selection: Selection, wanted: bool) -> np.ndarray:
    """Indices of the particles that are selected."""
    if selection.particles is None:
        return np.arange(len(now.x))
    if not wanted:
        raise InputError("set: particles: none of what is set belongs to particles")
    return accepted.selection("set: particles", selection.particles, len(now.x), "particle")


def _springs(now: Snapshot, selection: Selection, wanted: bool) -> np.ndarray:
    """Indices of the springs that are selected."""
    name = "springs" if selection.springs is not None else "kind"
    if selection.springs is None and selection.kind is None:
        return np.arange(len(now.marks))
    if not wanted:
        raise InputError(f"set: {name}: none of what is set belongs to springs")
    if selection.kind is None:
        return accepted.selection("set: springs", selection.springs, len(now.marks), "spring")
    if selection.springs is not None:
        raise InputError("set: springs and kind both select; give one of them")
    kind = accepted.word("set: kind", selection.kind, LINKS)
    mine = layouts.springs_of_kind(kind, now.scene.springs.between, len(now.x))
    if not mine.any():
        raise InputError(f"set: kind: no regular grid of the scene has {kind} links")
    return np.flatnonzero(mine)


# --- values ----------------------------------------------------------------------------------


def _world(world: World, given: Mapping[str, Any]) -> World:
    """The world with other values of its keys."""
    more, gravity = dict(world.more), world.gravity
    for name, value in given.items():
        what, key = f"set: {name}", world_keys().get(name)
        if name == "friction":
            world = replace(world, friction=_friction(what, value))
        elif name == "collisions":
            world = replace(world, collisions=accepted.flag(what, value))
        elif key is None:
            gravity = _vector(what, value, None, world.dim)
        elif value is None:
            more.pop(name, None)
        elif key.table:
            more[name] = _table(what, value, key, world)
        else:
            more[name] = _world_number(what, value, key, world.dim)
    for name in more:
        needs = world_keys()[name].needs
        if needs and needs not in more:
            raise InputError(f"set: {name} does nothing without {needs}; set both")
    return replace(world, gravity=gravity, more=more)


def _friction(what: str, value: Any) -> float:
    """A Coulomb coefficient, checked."""
    number = accepted.number(what, value)
    _hold(what, np.array(number), NOT_NEGATIVE)
    return number


def _rubbing(obstacles: tuple[Obstacle, ...], value: Any) -> tuple[Obstacle, ...]:
    """The obstacles with one friction; what has it already is left as it is."""
    friction = float(value)
    changed = (
        of if of.value("friction") == friction
        else replace(of, values={**of.values, "friction": friction})
        for of in obstacles
    )  # fmt: skip
    return tuple(changed)


def _table(what: str, value: Any, key: WorldKey, world: World) -> WorldValue:
    """A table of [world] with other values of some of its keys."""
    if not isinstance(value, Mapping):
        known = ", ".join(key.table)
        raise InputError(f"{what} must be a mapping with {known}, is {accepted.shown(value)}")
    before = world.more.get(key.name, {})
    table = dict(before) if isinstance(before, Mapping) else {}
    for name, inner in value.items():
        if name not in key.table:
            raise InputError(f"{what}: unknown key '{name}'; {nearest(name, key.table)}")
        table[name] = _world_number(f"{what}.{name}", inner, key.table[name], world.dim)
    for name, part in key.table.items():
        if name not in table and not part.optional:
            raise InputError(f"{what}: '{name}' is missing")
    if key.in_space and world.dim != 3:
        raise InputError(f"{what}: a 2-D world has none")
    return table


def _world_number(what: str, value: Any, key: WorldKey, dim: int) -> WorldNumber:
    """A number or vector of [world], checked."""
    if key.vector:
        return _vector(what, value, key.rule, dim)
    number = accepted.number(what, value)
    _hold(what, np.array(number), key.rule)
    if key.whole and number != int(number):
        raise InputError(f"{what} must be a whole number, is {number:g}")
    return number


def _vector(what: str, value: Any, rule: Rule | None, dim: int) -> tuple[float, ...]:
    vector = accepted.array(what, value, (dim,), "one a dimension")
    _hold(what, vector, rule)
    return tuple(float(number) for number in vector)


def _motion(
    now: Snapshot, given: Mapping[str, Any], chosen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (n, dim) with those that are given."""
    x, v, shape = now.x, now.v, (len(chosen), now.scene.world.dim)
    if "velocities" in given:
        v = v.copy()
        v[chosen] = accepted.broadcast("set: velocities", given["velocities"], shape, "particles")
    if "positions" in given:
        x = x.copy()
        x[chosen] = accepted.broadcast("set: positions", given["positions"], shape, "particles")
        _check_inside(now.scene, x, now.x)
    return x, v


def _check_inside(scene: Scene, x: np.ndarray, before: np.ndarray) -> None:
    """InputError where a particle is put outside the world, in which it may have got by itself."""
    low, high = scene.world.low, scene.world.high
    outside = ((x < low) | (x > high)).any(axis=1) & (x != before).any(axis=1)
    if outside.any():
        i = int(outside.argmax())
        where, ends = (tuple(map(float, a)) for a in (x[i], np.append(low, high)))
        raise InputError(
            f"set: positions: particle {i} at {where} is outside the world, which reaches "
            f"from {ends[: len(low)]} to {ends[len(low) :]}"
        )


def _with_columns(particles: Particles, given: Mapping[str, Any], chosen: np.ndarray) -> Particles:
    """The particles with other numbers, `fixed` or `color` where they are chosen."""
    columns: dict[str, np.ndarray] = {}
    count = len(chosen)
    for name in given.keys() - {"positions", "velocities"}:
        what = f"set: {name}"
        if name == "fixed":
            new = accepted.flags(what, given[name], (count,), "particles")
        elif name == "color":
            new = accepted.colors(what, given[name], count, "particles")
        else:
            new = _column(what, PARTICLE_PROPERTIES[name], given[name], count, "particles")
        columns[name] = getattr(particles, name).copy()
        columns[name][chosen] = new
    return replace(particles, **columns)


def _weighing_more(scene: Scene, before: Scene, chosen: np.ndarray) -> Scene:
    """The scene after masses were set where what the mouse holds weighs as much more as before.

    It weighs what was set when it is let go.
    """
    held = before.world.held
    if held is None:
        return scene
    mine = np.isin(held.particles, chosen)
    which = held.particles[mine]
    own, mass = held.mass.copy(), scene.particles.mass.copy()
    own[mine] = mass[which]
    mass[which] += before.particles.mass[which] - held.mass[mine]
    return scene.with_parts(
        particles=replace(scene.particles, mass=mass),
        world=replace(scene.world, held=replace(held, mass=own)),
    )


def _with_numbers(
    springs: Springs,
    given: Mapping[str, Any],
    chosen: np.ndarray,
    x: np.ndarray,
    what: str = "set",
) -> Springs:
    """The springs with other numbers where they are chosen; x: (n, dim), where particles are."""
    columns = {}
    for name, value in given.items():
        about = SPRING_PROPERTIES[name]
        if value is None and about.at_start:
            a, b = springs.between[chosen].T
            new = np.linalg.norm(x[a] - x[b], axis=1)
        else:
            new = _column(f"{what}: {name}", about, value, len(chosen), "springs")
        columns[name] = getattr(springs, name).copy()
        columns[name][chosen] = new
    return replace(springs, **columns)


def _with_bending(scene: Scene, value: Any) -> Stencils:
    """The scene's stencils with another rigidity, one for all or one for each."""
    what, count = f"set: {OF_STENCILS}", len(scene.stencils)
    if count == 0:
        raise InputError(f"{what}: nothing in the scene has it; give its cloths bending")
    given = accepted.numbers(what, value)
    _hold(what, given, NOT_NEGATIVE)
    bending = accepted.fitted(what, given, (count,), "stencils")
    return replace(scene.stencils, bending=np.array(bending, np.float64))


def _column(what: str, about: Property, value: Any, count: int, of: str) -> np.ndarray:
    """A property's values (count,), for which None stands for `off` where it may be absent."""
    if value is None and about.off is not None:
        value = about.off
    if words := about.words:
        return accepted.words(what, value, words, count, of)
    infinite = about.off is not None and not np.isfinite(about.off)
    given = accepted.numbers(what, value, infinite=infinite)
    _hold(what, given, about.rule)
    return accepted.fitted(what, given, (count,), of)


def _hold(what: str, given: np.ndarray, rule: Rule | None) -> None:
    """InputError where a number breaks a rule."""
    if rule is not None:
        accepted.require(what, given, rule.holds(given), rule.says)
