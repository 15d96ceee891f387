"""The declaration of a physics term: all that the program must know of a force.

A term is one file in this folder with a `TERM = Term(...)`. No part has a default: one that a force
does not have is `Absent("because ...")`, one that is forgotten is an error when the file is loaded.

There are five kinds of term. They differ in what their law gives, and to what that is added:

- "acceleration" and "force" act on single particles. law(spec, state, i) gives the vectors of
  pack i. stiffness(spec, state, number, i) and damping(spec, state, number, i) give -df/dx and
  -df/dv, a number for each particle: the force's derivatives, taken as equal in every direction.
  `number` reads a field of numbers at i: `packs.read` at a pack, `packs.slot_number` at a slot.
- "tension" acts along springs. law(length, along, dv, numbers) gives the force with which springs
  pull their ends together: length and along are their length and unit direction, from one end to
  the other; dv is the velocity of that other end relative to the first; `numbers` is the list that
  `spring_numbers.NUMBERS` describes. stiffness(numbers) gives the law's derivative by length,
  damping(numbers) that by the rate at which a spring lengthens, and across(length, numbers, least)
  the stiffness across a spring, at least `least` times the one along it.
- "curvature" acts on stencils (`stencils.py`). law(curvature, k) gives the force on a particle of
  weight 1: curvature is the stencils' curvature vector, the weighted sum of positions, and k the
  number that multiplies it. It is linear in the vector; stiffness(k) gives by how much it falls
  with it. Such a term has no damping, no stiffness across, and always acts.

- "traction" acts on triangles (`kernels/surfaces.py`), in 3-D. law(spec, state, area, v) gives the
  force on a whole one, of which each corner gets its share: area is the area vector, the area times
  the unit normal (3,); v the corners' mean velocity (3,), by the same shares. The force is along
  the normal: -P area, with a pressure P(area, v). gradient(spec, state, area, v) gives the pressure
  and its derivatives by v and by the area vector, [P, (3,), (3,)], which is all that Newton's
  method needs. damping(spec, state, area, v) gives -df/dv along the normal, a number that is never
  negative: with it solvers weigh particles.

All other functions run on the host, in NumPy, and use no kernel. Their x and v are (n, dim); world,
particles and springs are those of a scene, without springs that are gone; scene is a whole one.
Those on curvature get, where others get springs, the stencils (`scene.stencils`) that hold.
"""

from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields
from typing import Any, TypeGuard, TypeVar

Part = TypeVar("Part")

KINDS = ("acceleration", "force", "tension", "traction", "curvature")
ACCELERATION, FORCE, TENSION, TRACTION, CURVATURE = KINDS
PARTICLE_NUMBER, PARTICLE_VECTOR, NUMBER, VECTOR, COUNT = SHAPES = (
    "particle number",  # one for each particle, or one for all where they share it
    "particle vector",
    "number",  # one for the scene
    "vector",
    "count",  # a whole number
)


@dataclass(frozen=True)
class Absent:
    """The declaration that a term does not have a part; reason: why, in words."""

    reason: str


@dataclass(frozen=True)
class Key:
    """A key of [world] in scene files, and of world.more in Python: a number, a vector, a table.

    help, unit: for documents. minimum, maximum: inclusive limits of each of its numbers; None: it
    has none. A scene that does not give it must not need the force.
    table: the keys of an inline table, if it is one; default: of a key in a table, what it is where
    it is absent; None: it must be given. whole: whether it is a whole number.
    needs: another key of [world] without which it says nothing, and is refused.
    in_space: whether it means something in 3-D alone, and is refused in a plane.
    """

    name: str
    help: str
    unit: str
    vector: bool = False
    minimum: float | None = None
    maximum: float | None = None
    table: tuple["Key", ...] = ()
    default: float | None = None
    whole: bool = False
    needs: str = ""
    in_space: bool = False


@dataclass(frozen=True)
class DeviceField:
    """A field on the device, state.<name>, one of `SHAPES`.

    value(world, particles): what is loaded into it: one number, (dim,), (n,) or (n, dim), by its
    shape; None where the term's own kernels fill it.
    """

    name: str
    shape: str
    value: Callable[[Any, Any], Any] | None = None


@dataclass(frozen=True)
class Variant:
    """A scene with one feature switched over, by which the feature's cost is measured.

    feature: the term's name for users; used: whether the original scene has it, so that this one
    does not; about: what the original scene has of it, or what this one was given; scene: this one.
    """

    feature: str
    used: bool
    about: str
    scene: Any


@dataclass(frozen=True, kw_only=True)
class Term:
    """The declaration of a force.

    adds: its kind, out of `KINDS`.
    keys: those keys of scene files that it declares itself.
    present(scene): whether the scene can ever need it, also after clicks.
    fields: those that it has on the device.
    law, stiffness, damping, across: see the head of this file; without a law it adds nothing.
    acts(state): whether it acts in a step, where that changes from frame to frame; on particles
        alone. While it does not, its stiffness and damping are 0.
    after_step(spec, state, t): what it does at the end of each step, a ti.func, such as changing
        springs' numbers: those that name it in `spring_numbers.SpringNumber.changed_by`.
    energy(x, v, world, particles, springs): its potential energy, of all particles, a number.
    twin: the law in NumPy, for references. On particles twin(x, v, world, particles) gives
        (n, dim); along springs twin(length, rate, springs) gives (s,), from their lengths and the
        rates at which they lengthen, both (s,). On triangles twin(area, v, time, world) gives
        (m, 3), from the same as the law, (m, 3) each, and the scene's time. On curvature
        twin(curvature, k), from (m, dim) and (m,), gives (m, dim).
    bound(world, particles, springs): its share of the stability limit: (stiffness, damping), each
        (n,), (s,) along springs or (m,) on curvature, at least the magnitude of the law's
        derivatives. On triangles
        bound(corners, v, world), from positions (m, 3, 3) and mean velocities (m, 3), gives (m,)
        each, whatever way a triangle is turned and at whatever time: of the derivative by v, and of
        that by the position of one corner.
    timed: whether its law asks for the scene's time (`kernels/clock.py`).
    steady(world): of a force that changes with time by itself: the world of a scene in which it is
        constantly at its strongest.
    prepare(spec, state, time): what it computes once before its law is asked in a stage of a step,
        a ti.func for one thread, of terms on triangles; time: the scene's then, of type state.wide.
    gradient: see the head of this file; of terms on triangles, which must have one.
    variant(scene): a `Variant`, the scene with the term switched over; None where that makes no
        sense.

    Raises ValueError where a part is none of these.
    """

    adds: str
    keys: tuple[Key, ...] | Absent
    present: Callable[[Any], bool]
    fields: tuple[DeviceField, ...] | Absent
    law: Callable | Absent
    acts: Callable | Absent
    after_step: Callable | Absent
    stiffness: Callable | Absent
    damping: Callable | Absent
    across: Callable | Absent
    energy: Callable | Absent
    twin: Callable | Absent
    bound: Callable | Absent
    variant: Callable | Absent
    timed: bool = False
    steady: Callable | Absent = Absent("it does not change with time by itself")
    prepare: Callable | Absent = Absent("its law needs nothing beside the state")
    gradient: Callable | Absent = Absent("its stiffness and damping say it")

    def __post_init__(self):
        if self.adds not in KINDS:
            raise ValueError(f"adds is {self.adds!r}; it must be one of {', '.join(KINDS)}")
        for part in fields(self):
            value = getattr(self, part.name)
            if isinstance(value, Absent) and (part.name == "present" or not value.reason):
                raise ValueError(f"{part.name} cannot be absent, or is so without a reason")
            if part.name in ("keys", "fields"):
                kind = Key if part.name == "keys" else DeviceField
                if not isinstance(value, Absent) and not (
                    isinstance(value, tuple) and value and all(isinstance(v, kind) for v in value)
                ):
                    raise ValueError(
                        f"{part.name} must be a tuple of {kind.__name__}, or Absent(reason)"
                    )
            elif part.name not in ("adds", "timed") and not (
                isinstance(value, Absent) or callable(value)
            ):
                raise ValueError(f"{part.name} must be a function, or Absent(reason)")
        if not has(self.law) and not has(self.after_step):
            raise ValueError("law and after_step cannot both be absent")
        if has(self.acts) and self.adds in (TENSION, TRACTION):
            raise ValueError("acts is for forces on particles")
        if (has(self.prepare) or has(self.gradient)) and self.adds != TRACTION:
            raise ValueError("prepare and gradient are for forces on triangles")
        if self.adds == TRACTION and has(self.law) and not has(self.gradient):
            raise ValueError("a law on triangles needs a gradient")
        if self.adds == CURVATURE:
            if has(self.damping) or has(self.across) or has(self.acts):
                raise ValueError("a term on curvature has no damping, across or acts")
            if has(self.law) != has(self.stiffness):
                raise ValueError("a law on curvature needs a stiffness")
        for field in () if isinstance(self.fields, Absent) else self.fields:
            if field.shape not in SHAPES:
                raise ValueError(f"field {field.name}: shape {field.shape!r} is none of {SHAPES}")


PARTS = tuple(part.name for part in fields(Term) if part.default is MISSING)


def has(part: Part | Absent) -> TypeGuard[Part]:
    """True if a term has a part: it is not declared absent."""
    return not isinstance(part, Absent)
