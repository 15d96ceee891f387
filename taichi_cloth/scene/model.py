"""The scene: particles, springs and their world, as plain NumPy data.

A `Scene` knows no Taichi, no window and no method. Build one with the built-in
`scenes`, from a TOML file (`scenefile`), or by hand; `checks.validate` refuses what cannot
be simulated, and `features` says which parts of the physics it needs. The numbers of particles
and springs are declared in `properties`.

Units are the scene's own (the seed's: pixels and frames); y points down, or up where it says so.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from taichi_cloth.errors import InputError, counted
from taichi_cloth.files.meshes.seams import FilePoints
from taichi_cloth.scene.equality import ByValue, Rows
from taichi_cloth.scene.features import Features
from taichi_cloth.scene.holding import Hold
from taichi_cloth.scene.obstacles import CONTACTS, Obstacle
from taichi_cloth.scene.palette import FIXED_COLOR, PARTICLE_COLOR
from taichi_cloth.scene.properties import (
    PARTICLE_PROPERTIES,
    SPRING_PROPERTIES,
    ParticleProperties,
    Property,
    SpringProperties,
    WorldValue,
)
from taichi_cloth.scene.spheres import Spheres, spheres
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.scene.triangles import elements, longest_side
from taichi_cloth.settings import accepted

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# name: (axis, side) where y points down; side -1 is the wall at the axis's low end
WALLS = {
    "left": (0, -1),
    "right": (0, +1),
    "top": (1, -1),
    "bottom": (1, +1),
    "front": (2, -1),
    "back": (2, +1),
}
MOUSE_MODES = ("none", "blow", "spawn")
UPWARD = ("", "y")


def _take_plain(of: World | ParticleDefaults | SpringDefaults, names: Iterable[str]) -> None:
    """Have values in Python's types, which are compared, asked whether they are, and written."""
    for name in names:
        object.__setattr__(of, name, accepted.plain(getattr(of, name)))


@dataclass(frozen=True)
class World:
    """The space of a scene.

    size: 2 or 3 lengths. A 2-D world reaches from 0 to w and 0 to h; a 3-D one also
        from -d/2 to d/2 in z.
    gravity: acceleration, one number per dimension.
    dt: time of one frame.
    substeps: steps that a frame is cut into, each of dt / substeps; "auto": as many as are stable.
    walls: names out of `WALLS`; a particle bounces off these sides.
    collisions: whether particles bounce off each other.
    mouse: what the pointer does, out of `MOUSE_MODES`.
    ground: height, along y, of a plane that particles rest on; None: there is none.
    friction: Coulomb coefficient of the ground and of resting walls.
    rest: whether what has come to a stop on sharp obstacles stands still (`kernels/rest.py`).
    contact: how walls and pairs of particles treat positions, out of `obstacles.CONTACTS`.
    more: values of further keys (`world_keys`), those that a scene gives.
    up: "y" where y points up; "": it points down, as in the original programs.
    tools: whether any mouse tool may be taken up at once (a window). held: what one holds now.

    The walls "bottom" and "top" are at the ends of y, "left" and "right" at those of x. "front" is
    the one near to who looks, with x to the right: it is at the end of z where y points up.
    """

    size: tuple[float, ...]
    gravity: tuple[float, ...]
    dt: float = 1.0
    walls: tuple[str, ...] = ()
    collisions: bool = False
    mouse: str = "none"
    ground: float | None = None
    friction: float = 0.0
    contact: str = CONTACTS[0]
    more: Mapping[str, WorldValue] = field(default_factory=dict, hash=False)
    up: str = ""
    tools: bool = False
    held: Hold | None = field(default=None, compare=False)
    # Digests of scenes are made of the words of the others.
    substeps: int | str = field(default=1, repr=False)
    rest: bool = field(default=True, repr=False)

    def __post_init__(self) -> None:
        _take_plain(self, [name for name in vars(self) if name != "held"])

    @property
    def takes_clicks(self) -> bool:
        """True if clicks may add particles and springs."""
        return self.tools or self.mouse == "spawn"

    @property
    def dim(self) -> int:
        """The number of dimensions: 2 or 3."""
        return len(self.size)

    @property
    def low(self) -> np.ndarray:
        """Lower corner of the world, shape (dim,)."""
        return np.array([0.0, 0.0, -self.size[2] / 2] if self.dim == 3 else [0.0, 0.0])

    @property
    def high(self) -> np.ndarray:
        """Upper corner of the world, shape (dim,)."""
        high: np.ndarray = self.low + np.array(self.size)
        return high

    @property
    def downward(self) -> tuple[float, ...]:
        """The direction that points down, a unit vector (dim,)."""
        return (0.0, -1.0 if self.up else 1.0, 0.0)[: self.dim]

    def side(self, wall: str) -> tuple[int, int]:
        """The place of a wall, out of `WALLS`: (axis, side); side -1 is the low end of the axis."""
        axis, side = WALLS[wall]
        return axis, -side if self.up and axis > 0 else side


@dataclass(frozen=True)
class ParticleDefaults(ParticleProperties[float]):
    """The default of a particle (also: what a click spawns)."""

    def __post_init__(self) -> None:
        _take_plain(self, PARTICLE_PROPERTIES)


@dataclass(frozen=True)
class SpringDefaults(SpringProperties[float, "float | None", str]):
    """The default of a spring (also: what a chain click adds).

    An absent rest length is the distance at the start; an absent break force: unbreakable.
    """

    def __post_init__(self) -> None:
        _take_plain(self, SPRING_PROPERTIES)


_Rows = TypeVar("_Rows", "Particles", "Springs")


def _joined(first: _Rows, second: _Rows) -> _Rows:
    """The rows of one table followed by those of another."""
    columns = {k: np.concatenate([v, vars(second)[k]]) for k, v in vars(first).items()}
    return type(first)(**columns)


def _columns(
    owner: str,
    properties: Mapping[str, Property],
    given: Mapping[str, ArrayLike | None],
    defaults: ParticleDefaults | SpringDefaults,
    count: int,
    length: Callable[[], np.ndarray] | None = None,
) -> dict[str, np.ndarray]:
    """A column (count,) for each of the properties: what is given, else the default.

    given: by name, one value for all or one for each. length: of springs at the start. Raises
    TypeError, as a call of `owner` would, for a name that is no property, and InputError for values
    that are no numbers, or not one for all or for each; `checks` knows their limits.
    """
    given, things = dict(given), owner.partition(".")[0].lower()
    for name in given:
        if name not in properties:
            raise TypeError(f"{owner}() got an unexpected keyword argument '{name}'")
        if given[name] is not None:
            words, what = properties[name].words, f"{owner}: {name}"
            column = (
                accepted.texts(what, given[name])
                if words
                else accepted.numbers(what, given[name], finite=False)
            )
            given[name] = accepted.fitted(what, column, (count,), things)
    kind = ParticleDefaults if things == "particles" else SpringDefaults
    if not isinstance(defaults, kind):
        must = f"must be of type {kind.__name__}"
        raise InputError(f"{owner}: defaults {must}, is {accepted.shown(defaults)}")
    columns = {}
    for name, about in properties.items():
        value: Any = given.get(name)
        if value is None:
            value = getattr(defaults, name)
        if value is None:
            value = length() if length and about.at_start else about.off
        columns[name] = about.column(value, count)
    return columns


def _points(name: str, position: ArrayLike, pairs: np.ndarray) -> np.ndarray:
    """Positions (n, dim) which have all particles of the pairs; else InputError."""
    x = accepted.numbers(name, position, finite=False)
    if x.ndim != 2 and len(pairs):
        raise InputError(f"{name} must have shape (n, dim), has {x.shape}")
    missing = (pairs < 0) | (pairs >= len(x))
    if missing.any():
        s, particle = int(missing.any(axis=1).argmax()), int(pairs[missing][0])
        raise InputError(f"{name} has no particle {particle}, which spring {s} ties")
    return x


def _refuse_single_values(table: Particles | Springs, properties: Mapping[str, Property]) -> None:
    """InputError where a column was left out of a constructor, which leaves its default there."""
    single = [name for name in properties if not isinstance(getattr(table, name), np.ndarray)]
    if single:
        owner = type(table).__name__
        raise InputError(f"{owner}: no array for {', '.join(single)}; {owner}.build fills them in")


@dataclass(frozen=True)
class _Motion:
    position: np.ndarray
    velocity: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class Particles(Rows, ParticleProperties[np.ndarray], _Motion):
    """State and properties of n particles, one row each; lengths in world units.

    position, velocity: (n, dim) float64; mass, radius and the other numbers of
    `ParticleProperties`: (n,) float64; fixed: (n,) bool (never moves; collides as infinite mass);
    color: (n, 3) uint8.
    """

    ONE = "particle"
    fixed: np.ndarray = field(kw_only=True)
    color: np.ndarray = field(kw_only=True)

    def __post_init__(self) -> None:
        _refuse_single_values(self, PARTICLE_PROPERTIES)
        numbers = dict.fromkeys(PARTICLE_PROPERTIES, np.float64)
        accepted.take_types(self, position=np.float64, velocity=np.float64, **numbers)
        color: Any = self.color
        whole = isinstance(color, np.ndarray) and color.dtype.kind in "iu"
        if whole and ((color >= 0) & (color <= 255)).all():
            object.__setattr__(self, "color", color.astype(np.uint8, copy=False))

    def __len__(self) -> int:
        return len(self.position)

    @classmethod
    def build(
        cls,
        position: ArrayLike,
        velocity: ArrayLike | None = None,
        *,
        defaults: ParticleDefaults | None = None,
        fixed: ArrayLike = False,
        color: ArrayLike | None = None,
        **numbers: ArrayLike | None,
    ) -> Particles:
        """Particles at `position` (n, dim); every other value is one for all or one for each.

        numbers: mass, radius and the others of `ParticleProperties`; absent: those of `defaults`.
        """
        what = "Particles.build"
        given = accepted.numbers(f"{what}: position", position, finite=False)
        position = np.atleast_2d(given)
        if position.ndim != 2 or given.shape in ((), (0,)):
            none = "; Particles.none(dim) are none" if given.size == 0 else ""
            raise InputError(f"{what}: position must have shape (n, dim), has {given.shape}{none}")
        n = len(position)
        fixed = accepted.flags(f"{what}: fixed", fixed, (n,), "particles")
        if color is None:
            color = np.where(fixed[:, None], FIXED_COLOR, PARTICLE_COLOR)
        given = accepted.numbers(
            f"{what}: velocity", 0.0 if velocity is None else velocity, finite=False
        )
        defaults = ParticleDefaults() if defaults is None else defaults
        return cls(
            position=position,
            velocity=accepted.fitted(f"{what}: velocity", given, position.shape, "particles"),
            fixed=fixed,
            color=accepted.colors(f"{what}: color", color, n, "particles"),
            **_columns("Particles.build", PARTICLE_PROPERTIES, numbers, defaults, n),
        )

    @classmethod
    def none(cls, dim: int) -> Particles:
        """No particles, in `dim` dimensions."""
        return cls.build(np.zeros((0, dim)))

    def joined(self, other: Particles) -> Particles:
        """These particles followed by `other`."""
        return _joined(self, other)


@dataclass(frozen=True)
class _Ends:
    between: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class Springs(Rows, SpringProperties[np.ndarray, np.ndarray, np.ndarray], _Ends):
    """Springs between pairs of particles: between (s, 2) int64, the numbers (s,) float64.

    break_force is inf for an unbreakable spring. break_in: (s,) str, "both" or "tension".
    """

    ONE = "spring"

    def __post_init__(self) -> None:
        _refuse_single_values(self, SPRING_PROPERTIES)
        accepted.take_types(self, between=np.int64, **dict.fromkeys(SPRING_PROPERTIES, np.float64))

    def __len__(self) -> int:
        return len(self.between)

    @classmethod
    def build(
        cls,
        between: ArrayLike,
        position: ArrayLike,
        *,
        defaults: SpringDefaults | None = None,
        **numbers: ArrayLike | None,
    ) -> Springs:
        """Springs `between` (s, 2) particles at `position` (n, dim).

        numbers: stiffness, rest_length and the others of `SpringProperties`, also the word
        break_in, one for all or one for each; absent: those of `defaults`, whose absent rest length
        is the distance at the start, and whose absent break force is inf.
        """
        pairs = accepted.pairs("Springs.build: between", between)

        def length() -> np.ndarray:
            x, (a, b) = _points("Springs.build: position", position, pairs), pairs.T
            apart: np.ndarray = np.linalg.norm(x[a] - x[b], axis=1)
            return apart

        defaults = SpringDefaults() if defaults is None else defaults
        owner = "Springs.build"
        columns = _columns(owner, SPRING_PROPERTIES, numbers, defaults, len(pairs), length)
        return cls(between=pairs, **columns)

    @classmethod
    def none(cls) -> Springs:
        """No springs."""
        return cls.build(np.zeros((0, 2)), np.zeros((0, 2)), rest_length=0.0)

    def lengths_held(self) -> tuple[np.ndarray, np.ndarray]:
        """The shortest and the longest length [length] at which springs hold, (s,) each.

        Beyond them the magnitude of the force k*(l - rest) exceeds the break force. The longest is
        inf where nothing breaks it; the shortest is 0 where no length is short enough for it.
        """
        with np.errstate(all="ignore"):
            stretch = self.break_force / self.stiffness
            pushed = np.where(self.break_in == "tension", 0.0, self.rest_length - stretch)
            return np.maximum(pushed, 0.0), self.rest_length + stretch

    def select(self, chosen: np.ndarray) -> Springs:
        """Some of these springs: a mask (s,) bool, or their numbers."""
        try:
            rows = np.arange(len(self))[chosen]
        except (IndexError, TypeError, ValueError):
            rows = np.zeros((0, 0))
        if rows.ndim != 1:
            must = f"a mask of {len(self)}, or indices below that"
            raise InputError(f"Springs.select: must be {must}, is {accepted.shown(chosen)}")
        return Springs(**{k: v[rows] for k, v in vars(self).items()})

    def joined(self, other: Springs) -> Springs:
        """These springs followed by `other`."""
        return _joined(self, other)


@dataclass(frozen=True, eq=False, repr=False)
class Scene(ByValue):
    """A whole scene: world, particles, springs, and what clicks and files default to.

    spring_color: in which all springs are drawn, red, green, blue, 0..255; None: each has that of
        its ends, paler.
    triangles: (m, 3) int64, the particles at the corners of the surfaces. Seen from the side that
        their normal points to, the corners of each go round counterclockwise.
    obstacles: what particles rest on, slide along and bounce off.
    stencils: where they resist being bent.
    file_points: vertices of its mesh files, where particles are fewer: what exports write.
    notes: what was passed over, or joined, as its files were read; no part of its physics.
    assumed: keys of its file that this left open, each with what was taken, in words.
    of_meshes: keys that its file gives for meshes, of which it has made particles and stencils.

    Lists of triangles and obstacles are taken, too. Two scenes are equal where all of this is.
    """

    name: str
    world: World
    particles: Particles
    springs: Springs = field(default_factory=Springs.none)
    particle_defaults: ParticleDefaults = field(default_factory=ParticleDefaults)
    spring_defaults: SpringDefaults = field(default_factory=SpringDefaults)
    spring_color: tuple[int, int, int] | None = None
    triangles: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    obstacles: tuple[Obstacle, ...] = ()
    stencils: Stencils = field(default_factory=Stencils.none)
    file_points: FilePoints | None = field(default=None, compare=False)
    notes: tuple[str, ...] = field(default=(), compare=False)
    assumed: Mapping[str, str] = field(default_factory=dict, compare=False)
    of_meshes: frozenset[str] = field(default=frozenset(), compare=False)

    def __post_init__(self) -> None:
        triangles: Any = self.triangles
        if isinstance(triangles, (list, tuple)):
            with suppress(ValueError):  # rows of different lengths, which `checks` refuses
                array = np.array(triangles) if len(triangles) else np.zeros((0, 3), np.int64)
                object.__setattr__(self, "triangles", array)
        accepted.take_types(self, triangles=np.int64)
        with suppress(TypeError):  # what is no list is refused there, too
            object.__setattr__(self, "obstacles", tuple(self.obstacles))
        object.__setattr__(self, "spring_color", accepted.plain(self.spring_color))

    def __repr__(self) -> str:
        """Its line at a prompt or in a notebook's cell: how much of what, not its arrays."""
        numbers = {
            "spring": len(self.springs),
            "triangle": len(self.triangles),
            "stencil": len(self.stencils),
            "obstacle": len(self.obstacles),
        }
        rest = "".join(f", {counted(number, one)}" for one, number in numbers.items() if number)
        return f"<Scene: {self.name!r}, {counted(len(self.particles), 'particle')}{rest}>"

    @property
    def thick(self) -> bool:
        """True if a cloth has a thickness, so that it does not pass through itself."""
        return self.world.dim == 3 and bool((self.particles.thickness > 0).any())

    @property
    def collides(self) -> bool:
        """True if particles collide with each other."""
        return self.world.collisions or self.thick

    def features(self) -> Features:
        """Which parts of the physics this scene can ever need (also after clicks)."""
        spawns, springs = self.world.takes_clicks, self.springs
        # Stencils are summed with the springs on the graph, if there are any or not.
        has_springs = spawns or len(springs) > 0 or len(self.stencils) > 0
        defaults = self.spring_defaults
        walls = self.world.walls if self.world.contact == CONTACTS[0] else ()
        thick = self.thick
        planes = self.world.ground is not None or len(walls) < len(self.world.walls)
        shapes = {obstacle.shape for obstacle in self.obstacles} | ({"plane"} if planes else set())
        moving = [
            obstacle
            for obstacle in self.obstacles
            if any(np.any(obstacle.values.get(name, 0.0)) for name in ("velocity", "spin"))
        ]
        return Features(
            dim=self.world.dim,
            springs=has_springs,
            uniform_springs=self._uniform_springs(),
            uniform_particles=self._uniform_particles(),
            fracture=bool(
                np.isfinite(springs.break_force).any()
                or (spawns and defaults.break_force is not None)
                or self.world.tools
            ),
            walls=tuple(sorted(map(self.world.side, walls))),
            floor="bottom" in walls and not self.world.up,
            collisions=self.collides,
            obstacles=tuple(sorted(shapes)),
            moving=bool(moving),
            held=any("grip" in obstacle.values for obstacle in moving),
            resting=thick or (self.world.collisions and self.world.contact == "resting"),
            thick=thick,
        )

    @functools.cached_property
    def spheres(self) -> Spheres:
        """By which particles keep apart, where a cloth has a thickness (`features().thick`)."""
        return spheres(
            self.particles.position,
            self.particles.radius,
            self.particles.thickness,
            self.triangles,
            self.springs.between,
            self.springs.rest_length,
            self.world.collisions,
        )

    @functools.cached_property
    def elements(self) -> np.ndarray:
        """Parts of cloths that are tested against sharp obstacles, as triangles (m, 3)."""
        between, count = self.springs.between, len(self.particles)
        return elements(self.triangles, between, count, self.world.dim)

    @functools.cached_property
    def longest_side(self) -> float:
        """The length of the longest side of `elements`, at the start or, if longer, of its spring
        at rest; 0 where there are none.
        """
        springs = self.springs
        x, rest = self.particles.position, springs.rest_length
        return longest_side(x, self.elements, springs.between, rest)

    @functools.cached_property
    def stencil_sides(self) -> tuple[np.ndarray, np.ndarray]:
        """The springs that stencils need: pairs of stencil and spring, (q,) each."""
        return self.stencils.sides(self.springs.between)

    def stencils_among(self, pulling: np.ndarray) -> Stencils:
        """The stencils that hold while only some springs pull, (s,) bool: those with all theirs."""
        if len(self.stencils) == 0:
            return self.stencils
        of, spring = self.stencil_sides
        missing = np.bincount(of, ~pulling[spring], len(self.stencils))
        return self.stencils.select(missing == 0)

    def seal(self) -> Scene:
        """Return it with arrays that nobody can write to any more: what was worked out of them, and
        what a run has of them elsewhere, would be outdated, and say nothing.
        """
        for table in (self, self.particles, self.springs, self.stencils):
            for name, column in list(vars(table).items()):
                if isinstance(column, np.ndarray) and column.flags.writeable:
                    shown = column.view()  # whose array it was, may write to that
                    shown.flags.writeable = False
                    object.__setattr__(table, name, shown)
        return self

    def _uniform_springs(self) -> bool:
        """True if all springs, also those that clicks add, have the same numbers."""
        return self._uniform(self.springs, self.spring_defaults, SPRING_PROPERTIES)

    def _uniform_particles(self) -> bool:
        """True if all particles, also those that clicks add, have the same numbers but mass."""
        alike = self._uniform(self.particles, self.particle_defaults, PARTICLE_PROPERTIES)
        return alike and not self.world.tools

    def _uniform(
        self,
        columns: Particles | Springs,
        defaults: ParticleDefaults | SpringDefaults,
        properties: Mapping[str, Property],
    ) -> bool:
        """True if all rows, also those that clicks add, have the same shared numbers."""
        for name, about in properties.items():
            if not about.shared:
                continue
            column = getattr(columns, name)
            first = column[:1]
            if self.world.takes_clicks:
                clicked = getattr(defaults, name)
                if clicked is None and about.at_start:
                    return False
                first = about.column(about.off if clicked is None else clicked, 1)
            if not (column == first).all():
                return False
        return True

    def with_world(self, **changes: Any) -> Scene:
        """This scene with some of its world's values changed."""
        return self.with_parts(world=replace(self.world, **changes))

    def with_parts(self, **parts: Any) -> Scene:
        """This scene with other parts, by name; what was worked out of those that stay is kept."""
        changed = replace(self, **parts)
        for name, inputs in DERIVED.items():
            if name in vars(self) and all(of(self) is of(changed) for of in inputs):
                vars(changed)[name] = vars(self)[name]
        return changed


# What a scene works out once, and of what: `Scene.with_parts`.
OF_SIDES = [*map(attrgetter, ("particles.position", "springs.between", "triangles"))]
DERIVED = {
    "spheres": [
        *map(attrgetter, ("particles.position", "particles.radius", "particles.thickness")),
        *map(attrgetter, ("springs.between", "springs.rest_length")),
        *map(attrgetter, ("triangles", "world.collisions")),
    ],
    "stencil_sides": [attrgetter("stencils"), attrgetter("springs.between")],
    "elements": OF_SIDES,
    "longest_side": [*OF_SIDES, attrgetter("springs.rest_length")],
}
