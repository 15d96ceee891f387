"""A setting as a person meets it: what it does, its unit, its limits, and how it is written."""

from __future__ import annotations

import builtins
import math
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, TypeVar

from taichi_cloth.errors import InputError, clipped, nearest

Number = TypeVar("Number", int, float)


@dataclass(frozen=True)
class Parameter:
    """One setting: its help, unit and limits; type and default are filled in where it is used.

    minimum, maximum: inclusive limits; above: exclusive lower limit; infinite: whether inf is
        allowed, too.
    choices: the words allowed, if only some are; of a number, those allowed in its place.
    metavar: stands for the value in help texts.
    repeated: whether the flag may be given several times, each with a value.
    """

    help: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    above: float | None = None
    infinite: bool = False
    choices: tuple[str, ...] = ()
    metavar: str = ""
    repeated: bool = False
    type: type = str
    default: Any = None

    def with_type(self, type_: builtins.type, default: Any) -> Parameter:
        """The parameter with the type and default that it has where it is used."""
        return replace(self, type=type_, default=default)

    def check(self, name: str, value: Any) -> Any:
        """Return `value` if it is allowed for the setting called `name`, else raise InputError.

        None is allowed where it is the default, which then follows from other settings.
        """
        if value is None and self.default is None:
            return value
        if self.type in (int, float) and value not in self.choices:
            number = isinstance(value, Real) and not isinstance(value, bool)
            if number and hasattr(value, "item"):
                value = value.item()  # a scalar of NumPy's
            broken = isinstance(value, float) and math.isfinite(value) and not value.is_integer()
            if not number or (self.type is int and broken):
                kind = "a whole number" if self.type is int else "a number"
                raise InputError(f"{name} must be {kind}, is {value!r}")
            finite = abs(value) <= sys.float_info.max or (self.infinite and value == math.inf)
            for broken, says in (
                (not finite, "must be a finite number"),
                (
                    self.above is not None and not value > self.above,
                    f"must be above {self.above}" if self.above else "must be positive",
                ),
                (
                    self.minimum is not None and not value >= self.minimum,
                    f"must be at least {self.minimum}",
                ),
                (
                    self.maximum is not None and not value <= self.maximum,
                    f"must be at most {self.maximum}",
                ),
            ):
                if broken:
                    raise InputError(f"{name} {says}, is {_shown(value)}")
        elif self.choices and value not in self.choices:
            hint = nearest(str(value), self.choices)
            raise InputError(f"{name}: unknown value '{clipped(str(value))}'; {hint}")
        return value

    def parse(self, name: str, text: str) -> Any:
        """The value that `text` stands for; raises InputError if it is none or not allowed."""
        if self.type in (int, float) and text not in self.choices:
            try:
                value = number_of(self.type, text)
            except ValueError:
                kind = "a whole number" if self.type is int else "a number"
                kind += "".join(f" or {word}" for word in self.choices)
                raise InputError(f"{name} must be {kind}, is '{clipped(text)}'") from None
            return self.check(name, value)
        if self.type is tuple:
            return _parse_size(name, text)
        return self.check(name, text)

    def describe(self) -> str:
        """Help, unit, limits and default in one line."""
        notes = [self.unit] if self.unit else []
        if self.above is not None:
            notes.append(f"above {self.above:g}" if self.above else "positive")
        if self.minimum is not None and self.maximum is not None:
            notes.append(f"{_written(self.minimum)} to {_written(self.maximum)}")
        elif self.minimum is not None:
            notes.append(f"at least {_written(self.minimum)}")
        elif self.maximum is not None:
            notes.append(f"at most {_written(self.maximum)}")
        if self.default not in (None, False, True):
            notes.append(f"default {self.default}")
        return f"{self.help} ({', '.join(notes)})" if notes else self.help


def number_of(type_: Callable[[str], Number], text: str) -> Number:
    """The number that a person wrote, by `int` or `float`, in the digits 0 to 9 and no others.

    Raises ValueError where it is none. Python's own functions also take digits of every script,
    underscores between them, and spaces around them.
    """
    if not re.fullmatch(r"[-+.0-9a-zA-Z]+", text):
        raise ValueError(f"'{text}' is not a number")
    return type_(text)


def positive(flag: str, text: str, says: str, given: str) -> float:
    """The number above zero that `text` is.

    Raises InputError where it is none: `given` is not what it `says`.
    """
    try:
        number = number_of(float, text.strip())
    except ValueError:
        number = math.nan
    if not 0 < number < math.inf:
        raise InputError(f"{flag} must be {says}; is '{clipped(given)}'")
    return number


def error_limit(flag: str, given: str) -> tuple[float, bool]:
    """A limit of an error, 'X' or 'X%': the number, of which 1 is 100 %, and whether it had a %."""
    text = given.strip()
    number = text.removesuffix("%")
    value = positive(flag, number, "a number above 0, or one with %, such as 1%", given)
    return (value / 100, True) if number != text else (value, False)


def _shown(value: float) -> str:
    """A number as it is, cut where it is long; Python does not write one of 4301 digits."""
    try:
        return clipped(str(value))
    except ValueError:
        return "one of thousands of digits"


def _written(limit: float) -> str:
    """A limit as one writes it: 100000, not 1e+05."""
    return str(limit) if isinstance(limit, int) else f"{limit:g}"


def _parse_size(name: str, text: str) -> tuple[int, int]:
    """'800x600' as (800, 600); raises InputError for anything else, or a size no window has."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(re.fullmatch("[0-9]{1,30}", part) for part in parts):
        says = "must be WIDTHxHEIGHT in pixels, such as 800x600"
        raise InputError(f"{name} {says}; is '{clipped(text)}'")
    width, height = map(int, parts)
    if not (min(width, height) >= 16 and max(width, height) <= 8192):
        raise InputError(f"{name}: width and height must be 16 to 8192 pixels, are {clipped(text)}")
    return width, height
