"""The numbers of particles and springs, and the words that a spring may have, each declared once.

A field of `ParticleProperties` or `SpringProperties` is all that one needs: from it are made
its column in `Particles` or `Springs`, its default, what `checks` demands of it, its key in scene
files (also per kind of link in cloths), and what `dump` writes. Those classes stand for both the
columns and the defaults, so that a type checker knows each value in either.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Generic, TypeVar

import numpy as np


@dataclass(frozen=True)
class Rule:
    """Properties that numbers, or words, must satisfy.

    says: the requirement in words; of_links: the words for the value of one kind of link.
    holds: whether it is satisfied, value by value. A comparison with NaN is False, so rules
        refuse NaN; `inf` passes where nothing else is said about it.
    """

    says: str
    of_links: str
    holds: Callable[[Any], Any]


POSITIVE = Rule("must be positive", "must be positive", lambda a: a > 0)
NOT_NEGATIVE = Rule("must not be negative", "must be at least 0", lambda a: a >= 0)
FRACTION = Rule("must be between 0 and 1", "must be between 0 and 1", lambda a: (a >= 0) & (a <= 1))


def one_of(*words: str) -> Rule:
    """The rule for a value that is one of some words."""
    says = "must be " + " or ".join(f"'{word}'" for word in words)
    return Rule(says, says, lambda a: np.logical_or.reduce([a == word for word in words]))


@dataclass(frozen=True)
class Property:
    """One number, or word, of a particle or spring: its default, limits, unit and meaning.

    default: its value where nothing else is said; None: it is then absent, which means `off`, or
        with `at_start` the length that the spring starts with.
    rule, unit, help: its limits, unit and meaning.
    off: what `false` means in a scene file; None: `false` is refused. Where it is infinite, the
        number itself may be.
    shared: whether it is stored once where all particles or all springs have the same.
    words: what it may be, if it is a word; none: it is a number.

    Two things hold for every property: what a click adds has the scene's defaults, and a cloth may
    give it per kind of link.
    """

    default: float | str | None
    rule: Rule
    unit: str
    help: str
    off: float | None = None
    at_start: bool = False
    shared: bool = True
    words: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.default is None and self.off is None and not self.at_start:
            raise TypeError(f"'{self.help}' may be absent: say by off or at_start what that means")

    def filled(self, values: Sequence[Any], length: Sequence[float]) -> list[Any]:
        """The values, where None what absence means; length: of the springs at the start."""
        absent = length if self.at_start else [self.off] * len(values)
        return [a if v is None else v for v, a in zip(values, absent, strict=True)]

    def column(self, values: Any, count: int) -> np.ndarray:
        """One value for all or one for each as an array of its own, (count,).

        Numbers are float64; words have room for the longest one, so that each can be changed.
        """
        if not self.words:
            return np.array(np.broadcast_to(values, (count,)), np.float64)
        text = np.asarray(values, dtype=str)
        kind = np.promote_types(text.dtype, np.array(self.words).dtype)
        return np.array(np.broadcast_to(text, (count,)), kind)


def declared(
    default: float | str | None,
    rule: Rule,
    unit: str,
    help_: str,
    *,
    off: float | None = None,
    at_start: bool = False,
    shared: bool = True,
    words: tuple[str, ...] = (),
) -> Any:
    """A dataclass field with its `Property` in its metadata."""
    about = Property(default, rule, unit, help_, off, at_start, shared, words)
    return field(default=default, metadata={"property": about})


def properties_of(columns_or_defaults: type) -> dict[str, Property]:
    """The declared properties of a dataclass, by field name."""
    found = fields(columns_or_defaults)
    return {f.name: f.metadata["property"] for f in found if "property" in f.metadata}


Number = TypeVar("Number")  # float in defaults, an array with one per particle or spring in columns
Absent = TypeVar("Absent")  # likewise, but float | None in defaults
Word = TypeVar("Word")  # likewise, but str in defaults


@dataclass(frozen=True)
class ParticleProperties(Generic[Number]):
    """The numbers of a particle; further ones are added at the end."""

    mass: Number = declared(1.0, POSITIVE, "mass", "inertia", shared=False)
    radius: Number = declared(5.0, NOT_NEGATIVE, "length", "of the disc or sphere that collides")
    viscous: Number = declared(
        0.0, NOT_NEGATIVE, "force / speed", "drag coefficient c of the force -c*v"
    )
    restitution: Number = declared(
        1.0, FRACTION, "1", "part of the normal speed kept at walls; multiplied for two particles"
    )
    thickness: Number = declared(
        0.0, NOT_NEGATIVE, "length", "of its cloth; in 3-D that keeps off itself; 0: it does not",
        shared=False,
    )  # fmt: skip


# What breaks a spring: a force along it, either way (as in the original), or a pull alone, as for
# threads that buckle.
BREAK_IN = ("both", "tension")


@dataclass(frozen=True)
class SpringProperties(Generic[Number, Absent, Word]):
    """The numbers of a spring, and how it breaks; further ones are added at the end."""

    stiffness: Number = declared(1.0, NOT_NEGATIVE, "force / length", "k of the force k*(l - rest)")
    rest_length: Absent = declared(
        None, NOT_NEGATIVE, "length", "at which it neither pulls nor pushes", at_start=True
    )
    break_force: Absent = declared(
        None, POSITIVE, "force", "beyond which it breaks; off: unbreakable", off=math.inf
    )
    damping: Number = declared(
        0.0, NOT_NEGATIVE, "force / speed", "coefficient of the dashpot along the spring's axis"
    )
    break_in: Word = declared(
        BREAK_IN[0], one_of(*BREAK_IN), "", "which force breaks it: pull and push, or pull alone",
        words=BREAK_IN,
    )  # fmt: skip


PARTICLE_PROPERTIES = properties_of(ParticleProperties)
SPRING_PROPERTIES = properties_of(SpringProperties)


@dataclass(frozen=True)
class WorldKey:
    """A key of `[world]` that a term of the physics declares; `World.more` carries its value.

    rule: what each of its numbers satisfies besides being finite; None: nothing.
    vector: whether it has one number per dimension, rather than a single one.
    whole: whether it is a whole number.
    table: the keys of the inline table that it is, by name; none: it is no table.
    optional: of a key in a table, whether it may be absent.
    needs: another key of [world] without which it says nothing; "": none.
    in_space: whether it means something in 3-D alone.
    """

    name: str
    unit: str
    help: str
    rule: Rule | None = None
    vector: bool = False
    whole: bool = False
    table: Mapping[str, WorldKey] = field(default_factory=dict, hash=False)
    optional: bool = False
    needs: str = ""
    in_space: bool = False


# The value of a key of [world]: a number, a vector, or a table of them by name.
WorldNumber = float | tuple[float, ...]
WorldValue = WorldNumber | Mapping[str, WorldNumber]
