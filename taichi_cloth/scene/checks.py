"""Refuses scenes that cannot be simulated: one line that says what, where, and what is allowed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn
from weakref import WeakValueDictionary

import numpy as np

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.scene.model import (
    MOUSE_MODES,
    UPWARD,
    WALLS,
    ParticleDefaults,
    Particles,
    Scene,
    SpringDefaults,
    Springs,
    World,
)
from taichi_cloth.scene.obstacles import CONTACTS, fault
from taichi_cloth.scene.properties import (
    NOT_NEGATIVE,
    PARTICLE_PROPERTIES,
    POSITIVE,
    SPRING_PROPERTIES,
    Rule,
    WorldKey,
)
from taichi_cloth.scene.stencils import IN_ROW, Stencils
from taichi_cloth.scene.world_keys import world_keys
from taichi_cloth.settings import accepted
from taichi_cloth.settings.options import MOST_SUBSTEPS

# Lengths of worlds whose squares, and these times a stiffness, are numbers of double precision.
SMALLEST_LENGTH, LARGEST_LENGTH = 1e-100, 1e100
AT_ONCE = 2**14  # stencils that are checked together, inside a processor's cache

Place = Callable[[str, "int | None", "str | None"], str]


def _plain_place(kind: str, index: int | None, field_name: str | None) -> str:
    """'particle 3': the place of a fault in a scene that comes from no file."""
    return kind if index is None else f"{kind} {index}"


def validate(scene: Scene, place: Place = _plain_place) -> Scene:
    """Return `scene` if it can be simulated, else raise InputError with one line that says why.

    place: names the place of a fault in the message: ``place(kind, index, field)`` with kind
        "world", "particle", "spring", "triangle", "stencil", "obstacle", "particle defaults" or
        "spring defaults", the index of the particle, spring and so on (None for the rest) and the
        field at fault (None: the whole of it).
        A scene file names its line there.

    Raises InputError for: a NaN or infinite number (an infinite break force is allowed: it says
    unbreakable); a number that breaks its rule (`properties`); dt not positive; an unknown wall,
    mouse mode or further key of the world; an obstacle of an unknown shape, or with a key or number
    that this cannot have; arrays whose shapes do not fit each other or the world's dimension; a
    particle outside the world; a spring between missing or equal particles, or a second spring
    between the same two; a triangle with a missing corner or with two equal ones; a stencil
    with a missing particle or one twice, or with weights that do not add up to 0.
    """
    if not isinstance(scene, Scene):
        raise InputError(f"scene must be a Scene, is {accepted.shown(scene)}; build or load one")
    if _checked.get(id(scene)) is scene:
        return scene
    refusal = _Refusal(place)
    _check_types(scene, refusal)
    _check_world(scene.world, refusal)
    for kind, defaults, properties in (
        ("particle defaults", scene.particle_defaults, PARTICLE_PROPERTIES),
        ("spring defaults", scene.spring_defaults, SPRING_PROPERTIES),
    ):
        for name, about in properties.items():
            value = getattr(defaults, name)
            if about.words:
                refusal.check_word(kind, name, value, about.rule)
            elif value is not None:
                refusal.check_number(kind, name, value, about.rule)
    _check_particles(scene.particles, scene.world, refusal)
    _check_springs(scene.springs, len(scene.particles), refusal)
    _check_obstacles(scene, refusal)
    _check_triangles(scene.triangles, len(scene.particles), refusal)
    _check_stencils(scene.stencils, len(scene.particles), refusal)
    if scene.spring_color is not None:
        color: Any = scene.spring_color
        listed = isinstance(color, tuple) and len(color) == 3
        if not listed or not all(type(c) is int and 0 <= c <= 255 for c in color):
            text = "color must be three whole numbers from 0 to 255: red, green, blue"
            refusal.refuse("spring defaults", None, "color", text)
    return scene


# The scenes that `mark_checked` was given, by id: arrays have no hash.
_checked: WeakValueDictionary[int, Scene] = WeakValueDictionary()


def mark_checked(scene: Scene) -> Scene:
    """Return a scene that `validate` has accepted, which does not look at it again.

    Only for a scene whose arrays nobody writes to, which a frozen scene does not exclude.
    """
    _checked[id(scene)] = scene
    return scene


def _show(value: Any) -> str:
    """A number or a list of numbers as a person would write it: 0, 1.5, nan, (3, 4.5)."""
    array = np.asarray(value)
    if array.ndim:
        return "(" + ", ".join(_show(v) for v in array) + ")"
    if array.dtype.kind == "U":
        return f"'{array}'"
    return f"{array.item():.10g}" if array.dtype.kind == "f" else str(array.item())


class _Refusal:
    """Raises InputError for the first value that breaks a rule, naming its place."""

    def __init__(self, place: Place):
        self.place = place

    def refuse(self, kind: str, index: int | None, name: str | None, text: str) -> NoReturn:
        raise InputError(f"{self.place(kind, index, name)}: {text}")

    def check_number(self, kind: str, name: str, value: Any, rule: Rule | None = None) -> None:
        real = accepted.as_float(value)
        if real is None:
            self.refuse(kind, None, name, f"{name} must be a number, is {accepted.shown(value)}")
        if not np.isfinite(real):
            self.refuse(kind, None, name, f"{name} must be a finite number, is {real:g}")
        if rule and not rule.holds(value):
            self.refuse(kind, None, name, f"{name} {rule.says}, is {_show(value)}")

    def check_word(self, kind: str, name: str, value: Any, rule: Rule) -> None:
        if not (isinstance(value, str) and rule.holds(value)):
            self.refuse(kind, None, name, f"{name} {rule.says}, is {value!r}")

    def check_rows(
        self,
        kind: str,
        name: str,
        values: np.ndarray,
        rule: Rule | None = None,
        finite: bool = True,
    ) -> None:
        """One value (or one vector) per particle or spring: the first bad row is named."""
        if finite:
            says = "must be a finite number" if values.ndim == 1 else "must be finite numbers"
            self._check_good(kind, name, values, np.isfinite(values), says)
        if rule:
            self._check_good(kind, name, values, rule.holds(values), rule.says)

    def _check_good(
        self, kind: str, name: str, values: np.ndarray, good: np.ndarray, says: str
    ) -> None:
        if not good.all():
            row = int(np.argmin(good if good.ndim == 1 else good.all(axis=1)))
            self.refuse(kind, row, name, f"{name} {says}, is {_show(values[row])}")

    def check_shape(self, kind: str, name: str, values: Any, shape: tuple[int, ...]) -> None:
        if np.shape(values) != shape:
            text = f"{name} must have shape {shape}, has {np.shape(values)}"
            self.refuse(f"{kind}s", None, name, text)


def _check_types(scene: Scene, refusal: _Refusal) -> None:
    """That each part of a scene is of its kind, which the other checks rely on."""
    for part, kind in (
        ("name", str),
        ("world", World),
        ("particles", Particles),
        ("springs", Springs),
        ("particle_defaults", ParticleDefaults),
        ("spring_defaults", SpringDefaults),
        ("stencils", Stencils),
    ):
        value = getattr(scene, part)
        if not isinstance(value, kind):
            raise InputError(
                f"scene: {part} must be of type {kind.__name__}, is {accepted.shown(value)}"
            )
    for of, table, whole in (
        ("particles", scene.particles, {"fixed": "b", "color": "iu"}),
        ("springs", scene.springs, {"between": "iu"}),
        ("stencils", scene.stencils, {"start": "iu", "particle": "iu"}),
    ):
        for name, column in vars(table).items():
            words = getattr(SPRING_PROPERTIES.get(name), "words", ())
            kinds = "U" if words else whole.get(name, "iuf")
            listed = isinstance(column, np.ndarray) and column.ndim > 0
            if not listed or column.dtype.kind not in kinds:
                has = column.dtype if listed else accepted.shown(column)
                says = {"b": "bool", "iu": "whole numbers", "U": "words"}.get(kinds, "numbers")
                refusal.refuse(of, None, name, f"{name} must be an array of {says}, is {has}")


def _check_world_types(world: World, refuse: Callable[[str, str], NoReturn]) -> None:
    for name in ("size", "gravity", "walls"):
        value = getattr(world, name)
        if isinstance(value, (str, bytes)) or not isinstance(value, Sequence):
            of = "names" if name == "walls" else "numbers"
            refuse(name, f"{name} must be a list of {of}, is {accepted.shown(value)}")
    for name in ("collisions", "rest", "tools"):
        if not isinstance(getattr(world, name), bool):
            has = accepted.shown(getattr(world, name))
            refuse(name, f"{name} must be True or False, is {has}")
    for name, word in (
        ("up", world.up),
        ("mouse", world.mouse),
        *(("walls", wall) for wall in world.walls),
    ):
        if not isinstance(word, str):
            refuse(name, f"{name}: a name is expected, not {accepted.shown(word)}")
    if not isinstance(world.more, Mapping):
        refuse("more", f"more must be a mapping of keys to values, is {accepted.shown(world.more)}")


def _check_world(world: World, refusal: _Refusal) -> None:
    def refuse(name: str, text: str) -> NoReturn:
        refusal.refuse("world", None, name, text)

    _check_world_types(world, refuse)
    if len(world.size) not in (2, 3):
        refuse("size", f"size must be 2 or 3 lengths, is {_show(world.size)}")
    for value in world.size:
        refusal.check_number("world", "size", value, POSITIVE)
        if not SMALLEST_LENGTH <= value <= LARGEST_LENGTH:
            limits = f"{SMALLEST_LENGTH:g} to {LARGEST_LENGTH:g}"
            refuse("size", f"size must be from {limits}, is {_show(value)}; use other units")
    _check_vector(world, "gravity", world.gravity, None, refusal)
    refusal.check_number("world", "dt", world.dt, POSITIVE)
    steps: Any = world.substeps
    if steps != "auto" and not (type(steps) is int and 1 <= steps <= MOST_SUBSTEPS):
        must = f'must be a whole number from 1 to {MOST_SUBSTEPS}, or "auto"'
        refuse("substeps", f"substeps {must}, is {accepted.shown(steps)}")
    walls = [name for name, (axis, _) in WALLS.items() if axis < world.dim]
    for name in world.walls:
        if name not in WALLS:
            refuse("walls", f"unknown wall {name!r}; {nearest(name, walls)}")
        if name not in walls:
            refuse("walls", f"a 2-D world has no {name} wall; known: {', '.join(walls)}")
    if world.up not in UPWARD:
        refuse("up", f"up must be 'y', or absent where y points down, is {world.up!r}")
    if world.ground is not None:
        refusal.check_number("world", "ground", world.ground)
    refusal.check_number("world", "friction", world.friction, NOT_NEGATIVE)
    if world.contact not in CONTACTS:
        hint = nearest(str(world.contact), CONTACTS)
        refuse("contact", f"unknown contact {accepted.shown(world.contact)}; {hint}")
    if world.friction > 0 and world.ground is None and world.contact == CONTACTS[0]:
        refuse(
            "friction", "friction acts on a ground and on resting walls; set contact = 'resting'"
        )
    if world.mouse not in MOUSE_MODES:
        refuse("mouse", f"unknown mouse mode {world.mouse!r}; {nearest(world.mouse, MOUSE_MODES)}")
    for name, further in world.more.items():
        if name not in world_keys():
            refuse(name, f"unknown key {name!r}; {nearest(name, world_keys())}")
        key = world_keys()[name]
        if key.in_space and world.dim != 3:
            refuse(name, f"{name}: a 2-D world has none; give size three lengths")
        if key.needs and key.needs not in world.more:
            refuse(name, f"{name} does nothing without {key.needs}; give both")
        _check_key(world, name, key, further, refusal)


def _check_key(world: World, name: str, key: WorldKey, value: Any, refusal: _Refusal) -> None:
    """A further key of the world, or one in its table; name: what it is called in messages."""
    place = name.partition(".")[0]
    if key.table:
        if not isinstance(value, Mapping):
            words = f"{name} must be a table with {', '.join(key.table)}"
            refusal.refuse("world", None, place, f"{words}, is {accepted.shown(value)}")
        for part in value:
            if part not in key.table:
                text = f"{name}: unknown key {part!r}; {nearest(part, key.table)}"
                refusal.refuse("world", None, place, text)
        for part, declared in key.table.items():
            if part in value:
                _check_key(world, f"{name}.{part}", declared, value[part], refusal)
            elif not declared.optional:
                refusal.refuse("world", None, place, f"{name}: '{part}' is missing")
    elif key.vector:
        _check_vector(world, name, value, key.rule, refusal)
    else:
        refusal.check_number("world", name, value, key.rule)
        if key.whole and float(value) != int(value):
            refusal.refuse("world", None, name, f"{name} must be a whole number, is {value:g}")


def _check_vector(
    world: World, name: str, vector: Any, rule: Rule | None, refusal: _Refusal
) -> None:
    listed = isinstance(vector, (list, tuple, np.ndarray)) and np.shape(vector[:1]) == (1,)
    if not listed or len(vector) != world.dim:
        shown = accepted.shown(vector)
        text = f"must have {world.dim} numbers in a {world.dim}-D world, is {shown}"
        refusal.refuse("world", None, name, f"{name} {text}")
    for value in vector:
        refusal.check_number("world", name, value, rule)


def _check_particles(particles: Particles, world: World, refusal: _Refusal) -> None:
    n, dim = len(particles), world.dim
    for name, shape in (("position", (n, dim)), ("velocity", (n, dim)), ("color", (n, 3))):
        values = getattr(particles, name)
        if name != "color" and np.ndim(values) == 2 and np.shape(values)[1] != dim:
            has = np.shape(values)[1]
            text = f"{name} has {has} numbers a particle in a {dim}-D world"
            refusal.refuse("particles", None, name, text)
        refusal.check_shape("particle", name, values, shape)
    refusal.check_shape("particle", "fixed", particles.fixed, (n,))
    if particles.color.dtype != np.uint8:
        whole = "must be whole numbers from 0 to 255"
        rule = Rule(whole, whole, lambda a: (a >= 0) & (a <= 255))
        refusal.check_rows("particle", "color", particles.color, rule)
    for name, about in PARTICLE_PROPERTIES.items():
        refusal.check_shape("particle", name, getattr(particles, name), (n,))
        refusal.check_rows("particle", name, getattr(particles, name), about.rule)
    refusal.check_rows("particle", "position", particles.position)
    refusal.check_rows("particle", "velocity", particles.velocity)
    inside = ((particles.position >= world.low) & (particles.position <= world.high)).all(axis=1)
    if not inside.all():
        i = int(np.argmin(inside))
        refusal.refuse(
            "particle",
            i,
            "position",
            f"position {_show(particles.position[i])} is outside the world, which reaches "
            f"from {_show(world.low)} to {_show(world.high)}",
        )


def _check_obstacles(scene: Scene, refusal: _Refusal) -> None:
    listed: Any = scene.obstacles
    if not isinstance(listed, tuple):
        shown = accepted.shown(listed)
        raise InputError(f"scene: obstacles must be a list of Obstacle, is {shown}")
    for index, obstacle in enumerate(scene.obstacles):
        found = fault(obstacle, scene.world.dim)
        if found:
            refusal.refuse("obstacle", index, *found)


def _check_springs(springs: Springs, particle_count: int, refusal: _Refusal) -> None:
    s = len(springs)
    refusal.check_shape("spring", "between", springs.between, (s, 2))
    for name, about in SPRING_PROPERTIES.items():
        refusal.check_shape("spring", name, getattr(springs, name), (s,))
        finite = not about.words and (about.off is None or np.isfinite(about.off))
        refusal.check_rows("spring", name, getattr(springs, name), about.rule, finite)
    if s > 0:
        _check_ends(springs.between, particle_count, refusal)


def _check_triangles(triangles: Any, particle_count: int, refusal: _Refusal) -> None:
    def refuse(triangle: int | None, text: str) -> NoReturn:
        refusal.refuse("triangles" if triangle is None else "triangle", triangle, None, text)

    if not isinstance(triangles, np.ndarray) or triangles.dtype.kind not in "iu":
        has = triangles.dtype if isinstance(triangles, np.ndarray) else accepted.shown(triangles)
        refuse(None, f"must be an array of whole numbers, is {has}")
    if triangles.ndim != 2 or triangles.shape[1] != 3:
        refuse(None, f"must have shape (m, 3), has {triangles.shape}")
    present = ((triangles >= 0) & (triangles < particle_count)).all(axis=1)
    if not present.all():
        at = int(np.argmin(present))
        missing = next(i for i in triangles[at].tolist() if not 0 <= i < particle_count)
        has = f"particles 0 to {particle_count - 1}" if particle_count else "none"
        refuse(at, f"there is no particle {missing}; the scene has {has}")
    twice = (triangles == np.roll(triangles, 1, axis=1)).any(axis=1)
    if twice.any():
        at = int(np.argmax(twice))
        refuse(at, f"two of its corners {_show(triangles[at])} are one particle; give three")


def _check_stencils(stencils: Stencils, particle_count: int, refusal: _Refusal) -> None:
    m, k = len(stencils), len(stencils.particle)
    shapes = {"start": (m + 1,), "particle": (k,), "weight": (k,), "bending": (m,)}
    for name, shape in shapes.items():
        refusal.check_shape("stencil", name, getattr(stencils, name), shape)
    sizes = stencils.sizes
    if stencils.start[0] != 0 or stencils.start[-1] != k or (sizes < IN_ROW).any():
        few = int(np.argmax(sizes < IN_ROW)) if m else None
        refusal.refuse("stencil", few, "between", f"between must have at least {IN_ROW} particles")
    refusal.check_rows("stencil", "bending", stencils.bending, NOT_NEGATIVE)
    for mine, at in stencils.by_size():
        for first in range(0, len(mine), AT_ONCE):
            chunk = slice(first, first + AT_ONCE)
            _check_alike(stencils, mine[chunk], at[chunk], particle_count, refusal)


def _check_alike(
    stencils: Stencils, mine: np.ndarray, at: np.ndarray, particle_count: int, refusal: _Refusal
) -> None:
    """Check stencils of one size: their numbers (g,), and where their particles are (g, size)."""
    ends, weight = stencils.particle[at], stencils.weight[at]
    in_order = np.sort(ends, axis=1)
    has = f"particles 0 to {particle_count - 1}" if particle_count else "none"
    most = np.abs(weight).sum(axis=1)
    for wrong, name, says in (
        ((ends < 0) | (ends >= particle_count), "between", f"the scene has {has}, not all of"),
        (in_order[:, 1:] == in_order[:, :-1], "between", "a particle is twice in"),
        (~np.isfinite(weight), "weights", "weights must be finite numbers, are"),
        (np.abs(weight.sum(axis=1)) > 1e-9 * most, "weights", "weights must add up to 0, are"),
    ):
        bad = wrong if wrong.ndim == 1 else wrong.any(axis=1)
        if bad.any():
            i = int(bad.argmax())
            shown = _show((ends if name == "between" else weight)[i])
            refusal.refuse("stencil", int(mine[i]), name, f"{says} {shown}")


def _check_ends(between: np.ndarray, particle_count: int, refusal: _Refusal) -> None:
    def refuse(spring: int, text: str) -> NoReturn:
        refusal.refuse("spring", spring, "between", text)

    present = ((between >= 0) & (between < particle_count)).all(axis=1)
    if not present.all():
        i = int(np.argmin(present))
        a, b = between[i]
        missing = b if 0 <= a < particle_count else a
        has = f"particles 0 to {particle_count - 1}" if particle_count else "none"
        refuse(i, f"there is no particle {missing}; the scene has {has}")
    low, high = between.min(axis=1), between.max(axis=1)
    if (low == high).any():
        i = int(np.argmax(low == high))
        refuse(i, f"it ties particle {low[i]} to itself; give two different ones")
    pair = low * particle_count + high
    in_order = np.sort(pair)  # ten times as fast as np.unique, which hashes
    if (in_order[1:] == in_order[:-1]).any():
        first_of: dict[int, int] = {}
        for i, key in enumerate(pair.tolist()):
            first = first_of.setdefault(key, i)
            if first != i:
                ends = f"particles {low[i]} and {high[i]}"
                refuse(i, f"it ties {ends}, as spring {first} already does")
