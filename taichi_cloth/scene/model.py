"""What is simulated: particles, springs and their world, as plain NumPy data.

A `Scene` knows no Taichi, no window and no method. Build one with the built-in
`scenes`, from a TOML file (`scenefile`), or by hand; `validate` refuses what cannot
be simulated, and `features` says which parts of the physics it needs.

Units are the scene's own (the seed scenes use pixels and frames); y points down.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from weakref import WeakValueDictionary

import numpy as np

from taichi_cloth.errors import InputError, nearest

WALLS = {  # name: (axis, side); side -1 is the wall at the axis's low end
    "left": (0, -1),
    "right": (0, +1),
    "top": (1, -1),
    "bottom": (1, +1),
    "front": (2, -1),
    "back": (2, +1),
}
MOUSE_MODES = ("none", "blow", "spawn")
PARTICLE_COLOR = (220, 60, 60)
FIXED_COLOR = (128, 128, 128)
COLOR_CYCLE = (  # colours of spawned particles, in turn
    (232, 66, 66),  # red
    (224, 84, 214),  # magenta
    (82, 122, 250),  # blue
    (64, 204, 220),  # cyan
    (84, 200, 104),  # green
    (242, 206, 74),  # yellow
)


@dataclass(frozen=True)
class World:
    """The space of a scene.

    size: 2 or 3 lengths. A 2-D world reaches from 0 to w and 0 to h; a 3-D one also
        from -d/2 to d/2 in z.
    gravity: acceleration, one number per dimension.
    dt: time of one frame (a substep is dt / substeps).
    walls: names out of `WALLS`; a particle bounces off these sides.
    collisions: whether particles bounce off each other.
    mouse: what the pointer does, out of `MOUSE_MODES`.
    """

    size: tuple[float, ...]
    gravity: tuple[float, ...]
    dt: float = 1.0
    walls: tuple[str, ...] = ()
    collisions: bool = False
    mouse: str = "none"

    @property
    def dim(self) -> int:
        return len(self.size)

    @property
    def low(self) -> np.ndarray:
        """Lower corner of the world, shape (dim,)."""
        return np.array([0.0, 0.0, -self.size[2] / 2] if self.dim == 3 else [0.0, 0.0])

    @property
    def high(self) -> np.ndarray:
        """Upper corner of the world, shape (dim,)."""
        return self.low + np.array(self.size)


@dataclass(frozen=True)
class ParticleDefaults:
    """What a particle has when nothing else is said (also: what a click spawns)."""

    mass: float = 1.0
    radius: float = 5.0
    viscous: float = 0.0  # drag coefficient c of the force -c*v
    restitution: float = 1.0


@dataclass(frozen=True)
class SpringDefaults:
    """What a spring has when nothing else is said (also: what a chain click adds)."""

    stiffness: float = 1.0
    rest_length: float | None = None  # None: the distance at the start
    break_force: float | None = None  # None: unbreakable
    damping: float = 0.0  # coefficient of the dashpot along the spring's axis


@dataclass(frozen=True)
class Particles:
    """State and properties of n particles, one row each; lengths in world units.

    position, velocity: (n, dim) float64; mass, radius, viscous, restitution: (n,) float64;
    fixed: (n,) bool (never moves; collides as infinite mass); color: (n, 3) uint8.
    """

    position: np.ndarray
    velocity: np.ndarray
    mass: np.ndarray
    radius: np.ndarray
    viscous: np.ndarray
    restitution: np.ndarray
    fixed: np.ndarray
    color: np.ndarray

    def __len__(self) -> int:
        return len(self.position)

    @classmethod
    def build(
        cls,
        position,
        velocity=None,
        *,
        defaults: ParticleDefaults | None = None,
        mass=None,
        radius=None,
        viscous=None,
        restitution=None,
        fixed=False,
        color=None,
    ) -> Particles:
        """Particles at `position` (n, dim); every other value is one for all or one for each."""
        defaults = defaults or ParticleDefaults()
        position = np.atleast_2d(np.asarray(position, np.float64))
        n = len(position)

        def column(value, default):
            return np.array(np.broadcast_to(default if value is None else value, (n,)), np.float64)

        fixed = np.array(np.broadcast_to(fixed, (n,)), bool)
        if color is None:
            color = np.where(fixed[:, None], FIXED_COLOR, PARTICLE_COLOR)
        velocity = np.zeros_like(position) if velocity is None else velocity
        return cls(
            position=position,
            velocity=np.array(np.broadcast_to(velocity, position.shape), np.float64),
            mass=column(mass, defaults.mass),
            radius=column(radius, defaults.radius),
            viscous=column(viscous, defaults.viscous),
            restitution=column(restitution, defaults.restitution),
            fixed=fixed,
            color=np.array(np.broadcast_to(color, (n, 3)), np.uint8),
        )

    @classmethod
    def none(cls, dim: int) -> Particles:
        return cls.build(np.zeros((0, dim)))

    def joined(self, other: Particles) -> Particles:
        """These particles followed by `other`."""
        return Particles(**{k: np.concatenate([v, vars(other)[k]]) for k, v in vars(self).items()})


@dataclass(frozen=True)
class Springs:
    """Springs between pairs of particles: between (s, 2) int64, the rest (s,) float64.

    break_force is inf for an unbreakable spring.
    """

    between: np.ndarray
    stiffness: np.ndarray
    rest_length: np.ndarray
    break_force: np.ndarray
    damping: np.ndarray

    def __len__(self) -> int:
        return len(self.between)

    @classmethod
    def build(
        cls,
        between,
        position,
        *,
        defaults: SpringDefaults | None = None,
        stiffness=None,
        rest_length=None,
        break_force=None,
        damping=None,
    ) -> Springs:
        """Springs `between` (s, 2) particles at `position` (n, dim).

        An absent rest length is the distance at the start; an absent break force is inf.
        """
        defaults = defaults or SpringDefaults()
        between = np.asarray(between, np.int64).reshape(-1, 2)
        position = np.asarray(position, np.float64)
        s = len(between)
        rest_length = defaults.rest_length if rest_length is None else rest_length
        if rest_length is None:
            a, b = between.T
            rest_length = np.linalg.norm(position[a] - position[b], axis=1)
        break_force = defaults.break_force if break_force is None else break_force

        def column(value):
            return np.array(np.broadcast_to(value, (s,)), np.float64)

        return cls(
            between=between,
            stiffness=column(defaults.stiffness if stiffness is None else stiffness),
            rest_length=column(rest_length),
            break_force=column(np.inf if break_force is None else break_force),
            damping=column(defaults.damping if damping is None else damping),
        )

    @classmethod
    def none(cls) -> Springs:
        return cls.build(np.zeros((0, 2)), np.zeros((0, 2)), rest_length=0.0)

    def of(self, chosen) -> Springs:
        """Some of these springs: a mask (s,) bool, or their numbers."""
        return Springs(**{k: v[chosen] for k, v in vars(self).items()})

    def joined(self, other: Springs) -> Springs:
        """These springs followed by `other`."""
        return Springs(**{k: np.concatenate([v, vars(other)[k]]) for k, v in vars(self).items()})


@dataclass(frozen=True)
class Features:
    """The parts of the physics a scene needs; what is False is neither compiled nor stored."""

    dim: int
    springs: bool
    uniform_springs: bool  # all springs share their numbers, which are then stored once
    uniform_particles: bool  # all particles share radius, restitution and viscous; likewise
    fracture: bool
    walls: tuple[tuple[int, int], ...]  # (axis, side) of each wall
    floor: bool
    collisions: bool

    def describe(self) -> str:
        """In words, such as '2-D, uniform springs, fracture, drag, 4 walls, floor'."""
        words = {name.replace("_", " "): has for name, has in vars(self).items()}
        words["springs"] = self.springs and not self.uniform_springs
        words["uniform springs"] = self.springs and self.uniform_springs
        words["walls"] = None
        if self.walls:
            words[f"{len(self.walls)} walls"] = True
        return ", ".join([f"{self.dim}-D", *(word for word, has in words.items() if has is True)])


@dataclass(frozen=True)
class Scene:
    """A whole scene: world, particles, springs, and what clicks and files default to."""

    name: str
    world: World
    particles: Particles
    springs: Springs = field(default_factory=Springs.none)
    particle_defaults: ParticleDefaults = field(default_factory=ParticleDefaults)
    spring_defaults: SpringDefaults = field(default_factory=SpringDefaults)

    def features(self) -> Features:
        """Which parts of the physics this scene can ever need (also after clicks)."""
        spawns = self.world.mouse == "spawn"
        springs, particles = self.springs, self.particles
        has_springs = spawns or len(springs) > 0
        defaults = self.spring_defaults
        return Features(
            dim=self.world.dim,
            springs=has_springs,
            uniform_springs=self._uniform_springs(),
            uniform_particles=self._uniform_particles(),
            fracture=bool(
                np.isfinite(springs.break_force).any()
                or (spawns and defaults.break_force is not None)
            ),
            walls=tuple(sorted(WALLS[name] for name in self.world.walls)),
            floor="bottom" in self.world.walls,
            collisions=self.world.collisions,
        )

    def _uniform_springs(self) -> bool:
        """Whether all springs, also those that clicks add, have the same numbers."""
        springs, defaults = self.springs, self.spring_defaults
        numbers = np.column_stack(
            [springs.stiffness, springs.rest_length, springs.damping, springs.break_force]
        )
        if self.world.mouse == "spawn":
            if defaults.rest_length is None:
                return False
            force = np.inf if defaults.break_force is None else defaults.break_force
            clicked = [defaults.stiffness, defaults.rest_length, defaults.damping, force]
            numbers = np.vstack([numbers, clicked])
        return bool((numbers == numbers[:1]).all())

    def _uniform_particles(self) -> bool:
        """Whether all particles, also those that clicks add, have the same numbers but mass."""
        particles, defaults = self.particles, self.particle_defaults
        names = "radius", "restitution", "viscous"
        numbers = np.column_stack([getattr(particles, name) for name in names])
        if self.world.mouse == "spawn":
            numbers = np.vstack([numbers, [getattr(defaults, name) for name in names]])
        return bool((numbers == numbers[:1]).all())

    def with_world(self, **changes) -> Scene:
        """The same scene with some of its world's values changed."""
        return replace(self, world=replace(self.world, **changes))


# What each number must satisfy: (requirement in words, where it holds). A comparison with NaN is
# False, so these also refuse NaN; `inf` passes only where nothing else is said about it.
_POSITIVE = ("must be positive", lambda a: a > 0)
_NOT_NEGATIVE = ("must not be negative", lambda a: a >= 0)
_FRACTION = ("must be between 0 and 1", lambda a: (a >= 0) & (a <= 1))
_PARTICLE_RULES = {
    "mass": _POSITIVE,
    "radius": _NOT_NEGATIVE,
    "viscous": _NOT_NEGATIVE,
    "restitution": _FRACTION,
}
_SPRING_RULES = {
    "stiffness": _NOT_NEGATIVE,
    "rest_length": _NOT_NEGATIVE,
    "break_force": _POSITIVE,
    "damping": _NOT_NEGATIVE,
}


def _plain_place(kind: str, index: int | None, field_name: str | None) -> str:
    """'particle 3': the place of a fault in a scene that comes from no file."""
    return kind if index is None else f"{kind} {index}"


def validate(
    scene: Scene, place: Callable[[str, int | None, str | None], str] = _plain_place
) -> Scene:
    """Return `scene` if it can be simulated, else raise InputError with one line that says why.

    place: names the place of a fault in the message: ``place(kind, index, field)`` with kind
        "world", "particle", "spring", "particle defaults" or "spring defaults", the index of the
        particle or spring (None for the rest) and the field at fault (None: the whole of it).
        A scene file names its line there.

    Raises InputError for: a NaN or infinite number (an infinite break force is allowed: it says
    unbreakable); mass, dt or break force not positive; negative radius, viscous, stiffness,
    rest length or damping; restitution outside 0..1; an unknown wall or mouse mode; arrays whose
    shapes do not fit each other or the world's dimension; a particle outside the world; a spring
    between missing or equal particles, or a second spring between the same two.
    """
    if _checked.get(id(scene)) is scene:
        return scene
    refusal = _Refusal(place)
    _check_world(scene.world, refusal)
    for kind, defaults, rules in (
        ("particle defaults", scene.particle_defaults, _PARTICLE_RULES),
        ("spring defaults", scene.spring_defaults, _SPRING_RULES),
    ):
        for name, rule in rules.items():
            value = getattr(defaults, name)
            if value is not None:
                refusal.check_number(kind, name, value, rule)
    _check_particles(scene.particles, scene.world, refusal)
    _check_springs(scene.springs, len(scene.particles), refusal)
    return scene


# The scenes that `mark_checked` was given, by id: arrays have no hash.
_checked: WeakValueDictionary[int, Scene] = WeakValueDictionary()


def mark_checked(scene: Scene) -> Scene:
    """Return a scene that `validate` has accepted, which does not look at it again.

    Only for a scene whose arrays nobody writes to, which a frozen scene does not exclude.
    """
    _checked[id(scene)] = scene
    return scene


def _show(value) -> str:
    """A number or a list of numbers as a person would write it: 0, 1.5, nan, (3, 4.5)."""
    array = np.asarray(value)
    if array.ndim:
        return "(" + ", ".join(_show(v) for v in array) + ")"
    return f"{array.item():.10g}" if array.dtype.kind == "f" else str(array.item())


class _Refusal:
    """Raises InputError for the first value that breaks a rule, naming its place."""

    def __init__(self, place):
        self.place = place

    def refuse(self, kind: str, index: int | None, field_name: str | None, text: str):
        raise InputError(f"{self.place(kind, index, field_name)}: {text}")

    def check_number(self, kind, name, value, rule=None):
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
            self.refuse(kind, None, name, f"{name} must be a number, is {value!r}")
        if not np.isfinite(value):
            self.refuse(kind, None, name, f"{name} must be a finite number, is {_show(value)}")
        if rule and not rule[1](value):
            self.refuse(kind, None, name, f"{name} {rule[0]}, is {_show(value)}")

    def check_rows(self, kind, name, values, rule=None, finite=True):
        """One value (or one vector) per particle or spring: the first bad row is named."""
        for says, holds in (
            ("must be a finite number" if values.ndim == 1 else "must be finite numbers", None),
            rule or (None, None),
        ):
            if says is None or (holds is None and not finite):
                continue
            good = np.isfinite(values) if holds is None else holds(values)
            if not good.all():
                row = int(np.argmin(good if good.ndim == 1 else good.all(axis=1)))
                self.refuse(kind, row, name, f"{name} {says}, is {_show(values[row])}")

    def check_shape(self, kind, name, values, shape):
        if np.shape(values) != shape:
            self.refuse(
                f"{kind}s",
                None,
                name,
                f"{name} must have shape {shape}, has {np.shape(values)}",
            )


def _check_world(world: World, refusal: _Refusal):
    if len(world.size) not in (2, 3):
        refusal.refuse(
            "world", None, "size", f"size must be 2 or 3 lengths, is {_show(world.size)}"
        )
    for value in world.size:
        refusal.check_number("world", "size", value, _POSITIVE)
    if len(world.gravity) != world.dim:
        refusal.refuse(
            "world",
            None,
            "gravity",
            f"gravity must have {world.dim} numbers in a {world.dim}-D world, "
            f"is {_show(world.gravity)}",
        )
    for value in world.gravity:
        refusal.check_number("world", "gravity", value)
    refusal.check_number("world", "dt", world.dt, _POSITIVE)
    walls = [name for name, (axis, _) in WALLS.items() if axis < world.dim]
    for name in world.walls:
        if name not in WALLS:
            refusal.refuse("world", None, "walls", f"unknown wall {name!r}; {nearest(name, walls)}")
        if name not in walls:
            refusal.refuse(
                "world", None, "walls", f"a 2-D world has no {name} wall; known: {', '.join(walls)}"
            )
    if world.mouse not in MOUSE_MODES:
        refusal.refuse(
            "world",
            None,
            "mouse",
            f"unknown mouse mode {world.mouse!r}; {nearest(world.mouse, MOUSE_MODES)}",
        )


def _check_particles(particles: Particles, world: World, refusal: _Refusal):
    n, dim = len(particles), world.dim
    for name, shape in (("position", (n, dim)), ("velocity", (n, dim)), ("color", (n, 3))):
        values = getattr(particles, name)
        if name != "color" and np.ndim(values) == 2 and np.shape(values)[1] != dim:
            refusal.refuse(
                "particles",
                None,
                name,
                f"{name} has {np.shape(values)[1]} numbers a particle in a {dim}-D world",
            )
        refusal.check_shape("particle", name, values, shape)
    refusal.check_shape("particle", "fixed", particles.fixed, (n,))
    for name, rule in _PARTICLE_RULES.items():
        refusal.check_shape("particle", name, getattr(particles, name), (n,))
        refusal.check_rows("particle", name, getattr(particles, name), rule)
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


def _check_springs(springs: Springs, particle_count: int, refusal: _Refusal):
    s = len(springs)
    refusal.check_shape("spring", "between", springs.between, (s, 2))
    for name, rule in _SPRING_RULES.items():
        refusal.check_shape("spring", name, getattr(springs, name), (s,))
        unbreakable = name == "break_force"
        refusal.check_rows("spring", name, getattr(springs, name), rule, finite=not unbreakable)
    if s == 0:
        return
    between = springs.between
    present = ((between >= 0) & (between < particle_count)).all(axis=1)
    if not present.all():
        i = int(np.argmin(present))
        a, b = between[i]
        missing = b if 0 <= a < particle_count else a
        refusal.refuse(
            "spring",
            i,
            "between",
            f"there is no particle {missing}; the scene has "
            + (f"particles 0 to {particle_count - 1}" if particle_count else "none"),
        )
    low, high = between.min(axis=1), between.max(axis=1)
    if (low == high).any():
        i = int(np.argmax(low == high))
        refusal.refuse(
            "spring", i, "between", f"it ties particle {low[i]} to itself; give two different ones"
        )
    pair = low * particle_count + high
    in_order = np.sort(pair)  # ten times as fast as np.unique, which hashes
    if (in_order[1:] == in_order[:-1]).any():
        first_of: dict[int, int] = {}
        for i, key in enumerate(pair.tolist()):
            first = first_of.setdefault(key, i)
            if first != i:
                refusal.refuse(
                    "spring",
                    i,
                    "between",
                    f"it ties particles {low[i]} and {high[i]}, as spring {first} already does",
                )
