"""What a physics term declares: everything that the rest of the program must know of a force.

A term is one file in this folder with a `TERM = Term(...)`. No part has a default: one that a force
does not have is `Absent("because ...")`, one that is forgotten is an error when the file is loaded.

Three kinds of term differ in what their law gives, and to what it is added:

- "acceleration" and "force" act on single particles. law(spec, state, i) gives the vectors of pack i.
  stiffness and damping(spec, state, number, i) give -df/dx and -df/dv, a number for each particle
  (the force's derivative, taken as the same in every direction); `number` reads a field of numbers
  at i: `packs.read` of a pack, `packs.slot_number` of a slot.
- "tension" acts along springs. law(length, along, dv, numbers) gives the pull of the ends on each
  other: of springs of that length and direction, whose far ends move at dv relative to the near
  ones; `numbers` are those of `spring_numbers.NUMBERS`. stiffness(numbers) gives its derivative by
  length, damping(numbers) that by the rate at which it lengthens, and across(length, numbers,
  least) the stiffness across the spring, at least `least` times the one along it.

On the host all is NumPy, and knows no kernel: x, v (n, dim); world, particles, springs as in a
scene, the springs those that hold; `scene` a whole one.
"""

from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields
from typing import Any, TypeGuard, TypeVar

Part = TypeVar("Part")

ACCELERATION, FORCE, TENSION = KINDS = ("acceleration", "force", "tension")
PARTICLE_NUMBER, PARTICLE_VECTOR, NUMBER, VECTOR, COUNT = SHAPES = (
    "particle number",  # one for each particle, or one for all where they share it
    "particle vector",
    "number",  # one for the scene
    "vector",
    "count",  # a whole number
)


@dataclass(frozen=True)
class Absent:
    """A part that a term does not have; reason: why, in words."""

    reason: str


@dataclass(frozen=True)
class Key:
    """A key of [world] in scene files, and of world.more in Python: a number, or a vector.

    help, unit: for documents. minimum, maximum: inclusive limits of each of its numbers; None: it
    has none. A scene that does not give it must not need the force.
    """

    name: str
    help: str
    unit: str
    vector: bool = False
    minimum: float | None = None
    maximum: float | None = None


@dataclass(frozen=True)
class DeviceField:
    """A field on the device, state.<name>, one of `SHAPES`.

    value(world, particles): what it holds, (), (dim,), (n,); None where nothing is loaded into it:
    the term's own kernels fill it.
    """

    name: str
    shape: str
    value: Callable[[Any, Any], Any] | None = None


@dataclass(frozen=True)
class Variant:
    """A scene with one feature switched over, by which the feature's cost is measured.

    feature: its name for users; used: whether the scene itself has it, and this one does not.
    about: what the scene has, or what this one was given.
    """

    feature: str
    used: bool
    about: str
    scene: Any


@dataclass(frozen=True, kw_only=True)
class Term:
    """A force, declared (see the head of this file).

    adds: out of `KINDS`. keys: of scene files that it declares, beside those that `scene` has.
    present(scene): whether the scene can ever need it, also after clicks. fields: on the device.
    law, stiffness, damping, across: as above. energy(x, v, world, particles, springs): of all
    particles. twin: the law in NumPy, for references: twin(x, v, world, particles) of a term on
    particles, (n, dim); twin(length, rate, springs) of one along springs, (s,). bound(world,
    particles, springs): its share of the stability limit, (stiffness, damping), both (n,), or (s,)
    of a term along springs, at least the magnitude of the law's derivatives. variant(scene): the
    scene with the term switched over, None where that makes no sense.
    """

    adds: str
    keys: tuple[Key, ...] | Absent
    present: Callable[[Any], bool]
    fields: tuple[DeviceField, ...] | Absent
    law: Callable
    stiffness: Callable | Absent
    damping: Callable | Absent
    across: Callable | Absent
    energy: Callable | Absent
    twin: Callable | Absent
    bound: Callable | Absent
    variant: Callable | Absent

    def __post_init__(self):
        if self.adds not in KINDS:
            raise ValueError(f"adds is {self.adds!r}; it must be one of {', '.join(KINDS)}")
        for part in fields(self):
            value = getattr(self, part.name)
            if isinstance(value, Absent) and (part.name in ("present", "law") or not value.reason):
                raise ValueError(f"{part.name} cannot be absent, or is so without a reason")
            if part.name in ("keys", "fields"):
                kind = Key if part.name == "keys" else DeviceField
                if not isinstance(value, Absent) and not (
                    isinstance(value, tuple) and value and all(isinstance(v, kind) for v in value)
                ):
                    raise ValueError(
                        f"{part.name} must be a tuple of {kind.__name__}, or Absent(reason)"
                    )
            elif part.name != "adds" and not (isinstance(value, Absent) or callable(value)):
                raise ValueError(f"{part.name} must be a function, or Absent(reason)")
        for field in () if isinstance(self.fields, Absent) else self.fields:
            if field.shape not in SHAPES:
                raise ValueError(f"field {field.name}: shape {field.shape!r} is none of {SHAPES}")


PARTS = tuple(part.name for part in fields(Term) if part.default is MISSING)


def has(part: Part | Absent) -> TypeGuard[Part]:
    """Whether a term has a part: it is not declared absent."""
    return not isinstance(part, Absent)


def counted(count: int, thing: str) -> str:
    """'1 spring', '2 springs'."""
    return f"{count} {thing}{'s' * (count != 1)}"
