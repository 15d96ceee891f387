"""Checks values that a Python program passes: words, whole numbers, numbers, arrays, selections.

Each returns the value in the type that is worked with, or raises InputError with one line that
names the argument, what is wrong with it (an array's first bad element by its index), and what it
must be. A bool is no number here, NaN is none, and a NumPy scalar is as good as Python's own.
"""

from __future__ import annotations

import math
import operator
import os
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError, counted, nearest

LARGEST_WHOLE = 2**31 - 1  # what kernels count with


def shown(value: Any) -> str:
    """A value in a message: short, and numbers as a person would write them."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, int) and not isinstance(value, bool):
        return _short(value)
    text = " ".join(repr(value).split())
    return text if len(text) <= 40 else f"{text[:37]}..."


def word(name: str, value: Any, known: Collection[str]) -> str:
    """One of the words `known`."""
    if not isinstance(value, str):
        raise InputError(f"{name} must be one of {', '.join(known)}, is {shown(value)}")
    if value not in known:
        raise InputError(f"{name} {value}: unknown; {nearest(value, known)}")
    return value


def texts(name: str, value: Any) -> np.ndarray:
    """An array of words of any shape, whichever they are."""
    given = _as_array(name, value)
    if given.size == 0:
        return np.zeros(given.shape, "U1")
    if given.dtype.kind != "U":
        raise InputError(f"{name} must be words, is {_first(given)}")
    return given


def words(name: str, value: Any, known: Collection[str], count: int, of: str) -> np.ndarray:
    """Words out of `known`, one for all or one for each, (count,)."""
    given = _as_array(name, value)
    good = np.isin(given, list(known)) if given.dtype.kind == "U" else np.zeros(given.shape, bool)
    require(name, given, good, f"must be {' or '.join(map(repr, known))}")
    return fitted(name, given, (count,), of)


def path(name: str, value: Any) -> Path:
    """The place of a file."""
    if not isinstance(value, (str, os.PathLike)) or not isinstance(os.fspath(value), str):
        raise InputError(f"{name} must be a path, is {shown(value)}")
    return Path(value)


def flag(name: str, value: Any) -> bool:
    """True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"{name} must be True or False, is {shown(value)}")
    return bool(value)


def whole_number(
    name: str, value: Any, minimum: int | None = 0, maximum: int = LARGEST_WHOLE
) -> int:
    """A whole number from `minimum`, where there is one, to `maximum`; 2.0 is none."""
    must = f"{name} must be a whole number"
    must += "" if minimum is None else f" of at least {minimum}"
    if isinstance(value, (bool, np.bool_)):
        raise InputError(f"{must}, is {shown(value)}")
    try:
        whole = operator.index(value)
    except TypeError:
        raise InputError(f"{must}, is {shown(value)}") from None
    if minimum is not None and whole < minimum:
        raise InputError(f"{must}, is {_short(whole)}")
    if whole > maximum:
        raise InputError(f"{name} must be at most {maximum}, is {_short(whole)}")
    return whole


def power_of_two(name: str, value: Any, maximum: int) -> int:
    """1, 2, 4 and so on, to `maximum`."""
    whole = whole_number(name, value, 1, maximum)
    if whole & (whole - 1):
        below = 1 << (whole.bit_length() - 1)
        raise InputError(f"{name} must be a power of two, is {whole}; give {below} or {2 * below}")
    return whole


def _short(whole: int) -> str:
    """A whole number in a message: Python refuses to write more than some thousand digits."""
    return str(whole) if abs(whole) < 10**30 else f"{'-' * (whole < 0)}10^30 or beyond"


def listed(name: str, value: Any, must: str) -> list[Any]:
    """Make a list of what may be gone through but once; must: what it must be, in words."""
    if not isinstance(value, (str, bytes)):
        with suppress(TypeError):
            return list(value)
    raise InputError(f"{name} must be {must}, is {shown(value)}")


def plain(value: Any) -> Any:
    """A value as Python has it: scalars of NumPy's as its own, arrays and lists as tuples."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {name: plain(inner) for name, inner in value.items()}
    return tuple(map(plain, value)) if isinstance(value, (list, tuple)) else value


def take_types(table: Any, **wanted: type[np.generic]) -> None:
    """Have columns of a frozen table in the types that are worked with: np.float64, np.int64.

    Narrower whole numbers would overflow where pairs of them are made one number. What is no array
    of such numbers is left as it is, for who checks it.
    """
    for name, kind in wanted.items():
        column = getattr(table, name)
        kinds = "iu" if kind is np.int64 else "iuf"
        if isinstance(column, np.ndarray) and column.dtype.kind in kinds:
            object.__setattr__(table, name, column.astype(kind, copy=False))


def names(what: str, given: Iterable[str], known: Collection[str]) -> list[str]:
    """The names of what was given, all of which are known."""
    for name in given:
        if name not in known:
            raise InputError(f"{what}: unknown name '{name}'; {nearest(name, known)}")
    return list(given)


def number(
    name: str,
    value: Any,
    *,
    above: float | None = None,
    minimum: float | None = None,
    maximum: float | None = None,
) -> float:
    """A finite number, above, at least or at most a limit where one is given."""
    real = as_float(value)
    if real is None:
        raise InputError(f"{name} must be a number, is {shown(value)}")
    must = "must be a finite number"
    if math.isfinite(real) and above is not None:
        must = "must be positive" if above == 0 else f"must be above {above:g}"
    elif math.isfinite(real) and minimum is not None:
        must = f"must be at least {minimum:g}"
    good = math.isfinite(real) and (above is None or real > above)
    if not (good and (minimum is None or real >= minimum)):
        raise InputError(f"{name} {must}, is {real:g}")
    if maximum is not None and real > maximum:
        raise InputError(f"{name} must be at most {maximum:g}, is {real:g}")
    return real


def as_float(value: Any) -> float | None:
    """A number as a float, infinite where it is too large for one; None where it is no number."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, (bool, np.bool_)) or not isinstance(
        value, (int, float, np.integer, np.floating)
    ):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf


def numbers(name: str, value: Any, *, finite: bool = True, infinite: bool = False) -> np.ndarray:
    """An array of numbers of any shape, as float64.

    infinite: whether they may be; finite: whether that is looked at, and NaN, here at all.
    """
    given = _as_array(name, value)
    if given.dtype.kind == "O":
        given = _from_objects(name, given)
    if given.dtype.kind not in "iuf":
        raise InputError(f"{name} must be numbers, is {_first(given)}")
    real: np.ndarray = given.astype(np.float64)
    good = ~np.isnan(real) if infinite else np.isfinite(real)
    if finite:
        require(name, real, good, "must not be NaN" if infinite else "must be finite")
    return real


def require(name: str, given: np.ndarray, good: Any, must: str) -> None:
    """InputError for the first element of `given` that is not good, which `must` be."""
    if not np.all(good):
        raise InputError(f"{name} {must}, is {_first(given, np.asarray(good))}")


def array(name: str, value: Any, shape: tuple[int, ...], of: str = "") -> np.ndarray:
    """Finite numbers in an array of one shape, as float64; of: what its axes are, in messages."""
    real = numbers(name, value)
    if real.shape != shape:
        what = f"{counted(shape[0], 'number')}" if len(shape) == 1 else f"shape {shape}"
        raise InputError(f"{name} must have {what}{of and f' ({of})'}, has {_shape(real)}")
    return real


def broadcast(
    name: str, value: Any, shape: tuple[int, ...], of: str, *, infinite: bool = False
) -> np.ndarray:
    """Numbers for all or for each: an array that NumPy's rules bring to `shape`, as float64."""
    return fitted(name, numbers(name, value, infinite=infinite), shape, of)


def fitted(name: str, given: np.ndarray, shape: tuple[int, ...], of: str) -> np.ndarray:
    """A copy of an array, one value for all or one for each, in the shape for each."""
    whole = len(shape) - given.ndim
    if whole < 0 or given.shape not in ((), shape, shape[whole:]):
        one = "one number" if len(shape) == 1 else f"{counted(shape[-1], 'number')}"
        raise InputError(
            f"{name} must be {one} for all {of}, or an array of shape {shape}, one for each; "
            f"has {_shape(given)}"
        )
    return np.array(np.broadcast_to(given, shape))


def flags(name: str, value: Any, shape: tuple[int, ...], of: str) -> np.ndarray:
    """True or False, for all or for each, as an array of bool."""
    given = _as_array(name, value)
    if given.dtype.kind != "b" and given.size:
        raise InputError(f"{name} must be True or False, is {_first(given)}")
    return fitted(name, given.astype(bool), shape, of)


def colors(name: str, value: Any, count: int, of: str) -> np.ndarray:
    """Colours, three whole numbers from 0 to 255 for all or for each, (count, 3) uint8."""
    given = numbers(name, value)
    good = (given >= 0) & (given <= 255) & (given == np.floor(given))
    require(name, given, good, "must be whole numbers from 0 to 255")
    if given.ndim == 0:
        raise InputError(
            f"{name} must be three numbers, red, green and blue, is {shown(given[()])}"
        )
    return fitted(name, given, (count, 3), of).astype(np.uint8)


def pairs(name: str, value: Any) -> np.ndarray:
    """Pairs of whole numbers, (s, 2) int64; an empty list is no pair."""
    given = whole_numbers(name, value)
    if given.size == 0:
        return np.zeros((0, 2), np.int64)
    if given.ndim != 2 or given.shape[1] != 2:
        raise InputError(f"{name} must have shape (springs, 2), has {_shape(given)}")
    return given


def whole_numbers(name: str, value: Any) -> np.ndarray:
    """An array of whole numbers of any shape, as int64; 2.0 is one here."""
    given = numbers(name, value)
    good = (given == np.floor(given)) & (np.abs(given) <= 2**53)
    require(name, given, good, "must be whole numbers")
    return given.astype(np.int64)


def selection(name: str, value: Any, count: int, thing: str) -> np.ndarray:
    """Numbers of some of `count` things: an index, indices, or a mask (count,); (m,) int64."""
    if isinstance(value, slice):
        value = np.arange(count)[value]
    given = np.atleast_1d(_as_array(name, value))
    if given.dtype.kind == "b":
        if given.shape != (count,):
            raise InputError(
                f"{name}: a mask must have {counted(count, 'value')}, one a {thing}, "
                f"has {_shape(given)}"
            )
        return np.flatnonzero(given)
    if given.size == 0:
        return np.zeros(0, np.int64)
    if given.dtype.kind not in "iu" or given.ndim != 1:
        what = _first(given) if given.ndim == 1 else _shape(given)
        raise InputError(f"{name} must be an index, a list of them, or a mask, is {what}")
    good = (given >= 0) & (given < count)
    if not good.all():
        has = f"there are {thing}s 0 to {count - 1}" if count else f"there is no {thing}"
        raise InputError(f"{name}: no {thing} {int(given[np.argmin(good)])}; {has}")
    found, first = np.unique(given, return_index=True)
    if len(found) < len(given):
        again = int(given[np.setdiff1d(np.arange(len(given)), first)[0]])
        raise InputError(f"{name}: {thing} {again} is named twice")
    return given.astype(np.int64)


def _as_array(name: str, value: Any) -> np.ndarray:
    """A value as NumPy takes it, unless its rows are of different lengths."""
    try:
        return np.asarray(value)
    except (ValueError, TypeError, OverflowError):
        raise InputError(f"{name} must be an array, is {shown(value)}") from None


def _from_objects(name: str, given: np.ndarray) -> np.ndarray:
    """Numbers that NumPy has no type for, such as whole ones of more than 64 bits, as float64."""
    found = [as_float(value) for value in given.ravel().tolist()]
    good = np.reshape([value is not None for value in found], given.shape)
    if not good.all():
        raise InputError(f"{name} must be numbers, is {_first(given, good)}")
    return np.reshape(np.array(found, np.float64), given.shape)


def _first(given: np.ndarray, good: np.ndarray | None = None) -> str:
    """The first element that is not good, with its index where there are several."""
    if given.ndim == 0:
        return shown(given[()])
    if given.size == 0:
        return f"an empty array of {given.dtype}"
    at = 0 if good is None else int(np.argmin(good))
    place = ", ".join(str(int(k)) for k in np.unravel_index(at, given.shape))
    return f"{shown(given.ravel()[at])} at [{place}]"


def _shape(given: np.ndarray) -> str:
    return "a single value" if given.ndim == 0 else f"shape {given.shape}"
