"""TOML as people write it: where its keys stand, and values by type.

A function of a type returns the value, or raises `WrongType` with what it should have been.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from datetime import date, time
from typing import Any, TypeVar

Keys = tuple[Any, ...]  # the way to a value, such as ("particles", 3, "mass")
Read = TypeVar("Read")


def parse_error(name: str, error: str, text: str) -> str:
    """tomllib's message with the line moved to the front."""
    found = re.search(r" \(at line (\d+), column (\d+)\)$", error)
    if found:
        line, column = found.groups()
        return f"{name} line {line}: is not TOML: {error[: found.start()]} (column {column})"
    line = text.count("\n") + (not text.endswith("\n"))
    return f"{name} line {line}: is not TOML: {error.removesuffix(' (at end of document)')}"


def lines_of(text: str) -> dict[Keys, int]:
    """Line numbers (from 1) of tables and keys: ("particles", 3) and ("particles", 3, "mass").

    Reads what people write: one header or key at the start of a line. Entries written in another
    way (a list of inline tables) are absent, and messages then name no line.
    """
    lines: dict[Keys, int] = {}
    count: dict[str, int] = {}
    inside: Keys = ()
    bare = r"[A-Za-z0-9_-]+"
    for number, line in enumerate(text.split("\n"), start=1):
        if header := re.match(rf"\s*\[\s*({bare}(?:\s*\.\s*{bare})*)\s*\]\s*(?:#.*)?$", line):
            inside = tuple(part.strip() for part in header[1].split("."))
            if inside[0] in count:  # [cloths.stiffness] belongs to the last [[cloths]]
                inside = (inside[0], count[inside[0]] - 1, *inside[1:])
            lines.setdefault(inside, number)
        elif header := re.match(rf"\s*\[\[\s*({bare})\s*\]\]", line):
            index = count[header[1]] = count.get(header[1], 0) + 1
            inside = (header[1], index - 1)
            lines.setdefault(inside, number)
            lines.setdefault(inside[:1], number)
        elif key := re.match(rf"\s*\"?({bare})\"?\s*(?:\.\s*({bare})\s*)?[=.]", line):
            lines.setdefault((*inside, key[1]), number)
            if key[2]:
                lines.setdefault((*inside, key[1], key[2]), number)
    return lines


def dotted(keys: Keys) -> str:
    """'cloths[0].columns' of ("cloths", 0, "columns")."""
    words = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys)
    return words.removeprefix(".")


class WrongType(Exception):
    """The value is of another type; the message says of which it must be."""


def written(value: Any) -> str:
    """A value as a scene file would have it: true, [1, 2], { above = 1.5 }."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        inner = ", ".join(f"{key} = {written(entry)}" for key, entry in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(written, value))}]"
    return repr(value) if isinstance(value, str) else str(value)


def describe(value: Any) -> str:
    """A value in TOML's words, with the value where it is short."""
    try:
        text = written(value)
    except ValueError:  # Python does not write a whole number of thousands of digits
        return "a number of thousands of digits"
    except RecursionError:
        return "nested too deeply"
    short = f" {text}" if len(text) < 40 else ""
    if isinstance(value, bool):
        return text
    kinds = ((str, "the text"), ((int, float), "the number"), ((list, tuple), "the list"))
    for type_, word in kinds:
        if isinstance(value, type_):
            return word + short if short else word.replace("the", "a")
    if isinstance(value, (date, time)):
        return "a date or time"
    return "a table" if isinstance(value, Mapping) else text  # of a Python program's own


def number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise WrongType("a number")
    try:
        return float(value)
    except OverflowError:
        raise WrongType("a number that fits into double precision") from None


def number_or_table(value: Any) -> float:
    """A number, where a table of numbers would do as well."""
    try:
        return number(value)
    except WrongType as wrong:
        raise WrongType(f"{wrong}, or a table with one for each kind") from None


def integer(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise WrongType("a whole number")
    if abs(value) >= 2**31:
        raise WrongType("a whole number below 2147483648")
    return value


def substeps(value: Any) -> int | str:
    """The number of steps that a frame has, or "auto": it is chosen."""
    if value == "auto":
        return "auto"
    try:
        return integer(value)
    except WrongType as wrong:
        raise WrongType(f'{wrong}, or "auto"') from None


def boolean(value: Any) -> bool:
    if not isinstance(value, bool):
        raise WrongType("true or false")
    return value


def text(value: Any) -> str:
    if not isinstance(value, str):
        raise WrongType("a text in quotes")
    return value


def table(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise WrongType("a table")
    return value


def list_of(
    read: Callable[[Any], Read], words: str, length: int | None = None
) -> Callable[[Any], list[Read]]:
    """A reader of a list of values, of `length` if one is given; words: what it must be."""

    def read_list(value: Any) -> list[Read]:
        if not isinstance(value, list) or length not in (None, len(value)):
            raise WrongType(words)
        try:
            return [read(item) for item in value]
        except WrongType:
            raise WrongType(words) from None

    return read_list


numbers = list_of(number, "a list of numbers")
integers = list_of(integer, "a list of whole numbers")
texts = list_of(text, "a list of texts")
tables = list_of(table, "a list of tables, each under its own [[...]]")
pair = list_of(integer, "a list of two whole numbers", 2)
pairs = list_of(pair, "a list of [column, row] pairs")
triples = list_of(
    list_of(integer, "a list of three whole numbers", 3),
    "a list of [i, j, k], three particles each",
)


def names_or_boolean(value: Any) -> bool | list[str]:
    if isinstance(value, bool):
        return value
    return list_of(text, "true, false or a list of names")(value)


def color(value: Any) -> tuple[int, int, int]:
    words = "three whole numbers from 0 to 255: red, green, blue"
    red, green, blue = list_of(integer, words, 3)(value)
    if not all(0 <= channel <= 255 for channel in (red, green, blue)):
        raise WrongType(words)
    return red, green, blue
