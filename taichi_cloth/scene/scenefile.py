"""Scene files: TOML <-> Scene.

`load` reads the format, `save` and `dump` write it; its keys are the tables of `_TABLES` below.
Every refusal is one line with the file, the line in it where one is at fault, and what to change.
"""

from __future__ import annotations

import difflib
import math
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.scene.cloth import LINKS, grid
from taichi_cloth.scene.model import (
    FIXED_COLOR,
    MOUSE_MODES,
    PARTICLE_COLOR,
    WALLS,
    ParticleDefaults,
    Particles,
    Scene,
    SpringDefaults,
    Springs,
    World,
    validate,
)

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_PARTICLE_NUMBERS = ("mass", "radius", "viscous", "restitution")
_SPRING_NUMBERS = ("stiffness", "rest_length", "break_force", "damping")

# Each table's keys. `break_force = false` says unbreakable where [spring] gives a force.
_TABLES = {
    "": ("name", "world", "particle", "spring", "particles", "springs", "cloths"),
    "world": ("size", "gravity", "dt", "walls", "collisions", "mouse"),
    "particle": _PARTICLE_NUMBERS,
    "spring": _SPRING_NUMBERS,
    "particles": ("position", "velocity", "fixed", "color", *_PARTICLE_NUMBERS),
    "springs": ("between", *_SPRING_NUMBERS),
    "cloths": (
        *("origin", "columns", "rows", "spacing", "pinned", "links", "across", "down"),
        *_SPRING_NUMBERS,
    ),
}


def load(path: str | Path) -> Scene:
    """The scene in the TOML file at `path`, checked. Raises InputError for anything amiss."""
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file{_similar_file(path)}") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; name the scene file in it") from None
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: is not a text file in UTF-8 (byte {error.start}); save it as UTF-8"
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}") from None
    return parse(text, name=path.name, default_scene_name=path.stem)


def parse(text: str, name: str = "scene.toml", default_scene_name: str = "scene") -> Scene:
    """The scene that `text` describes, checked; `name` is the file's in messages."""
    text = text.removeprefix("\ufeff").replace("\r\n", "\n")
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(_parse_error(name, str(error), text)) from None
    except RecursionError:
        raise InputError(f"{name}: is nested too deeply to be a scene") from None
    except ValueError:  # the one thing tomllib passes on: int() refuses thousands of digits
        raise InputError(f"{name}: has a whole number with too many digits") from None
    return _Reader(name, text, default_scene_name).scene(table)


def save(scene: Scene, path: str | Path) -> None:
    """Write `scene` to `path`, whole or not at all. Raises InputError if that cannot be written."""
    text = dump(scene).encode()
    PendingFile(path).fill(lambda file: file.write(text))


def _similar_file(path: Path) -> str:
    try:
        names = [p.name for p in path.parent.glob("*.toml")]
    except OSError:
        return ""
    close = difflib.get_close_matches(path.name, names, n=1)
    return f"; did you mean '{path.parent / close[0]}'?" if close else ""


def _parse_error(name: str, error: str, text: str) -> str:
    """tomllib's message with the line moved to the front."""
    found = re.search(r" \(at line (\d+), column (\d+)\)$", error)
    if found:
        line, column = found.groups()
        return f"{name} line {line}: is not TOML: {error[: found.start()]} (column {column})"
    line = text.count("\n") + (not text.endswith("\n"))
    return f"{name} line {line}: is not TOML: {error.removesuffix(' (at end of document)')}"


def _lines(text: str) -> dict[tuple, int]:
    """Line numbers (from 1) of tables and keys: ("particles", 3) and ("particles", 3, "mass").

    Reads what people write: one header or key at the start of a line. Entries written in another
    way (a list of inline tables) are absent, and messages then name no line.
    """
    lines: dict[tuple, int] = {}
    count: dict[str, int] = {}
    inside: tuple = ()
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


@dataclass(frozen=True)
class _Source:
    """Where a run of particles or springs comes from: `table` and its index, and its keys."""

    first: int
    table: str
    index: int
    keys: frozenset[str]


class _Reader:
    """Turns parsed TOML into a Scene; knows the place of everything for messages."""

    def __init__(self, name: str, text: str, default_scene_name: str):
        self.name = name
        self.lines = _lines(text)
        self.default_scene_name = default_scene_name
        self.sources: dict[str, list[_Source]] = {"particle": [], "spring": []}

    # Places

    def place(self, *path) -> str:
        """'box.toml line 12: [[particles]] 3' for ("particles", 3, "mass"), as far as known."""
        line = next(
            (self.lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in self.lines), None
        )
        where = f"{self.name} line {line}" if line else self.name
        if path and path[0] in _TABLES:
            numbered = len(path) > 1 and isinstance(path[1], int)
            where += f": [[{path[0]}]] {path[1]}" if numbered else f": [{path[0]}]"
        return where

    def refuse(self, path: tuple, text: str):
        raise InputError(f"{self.place(*path)}: {text}")

    def place_of_fault(self, kind: str, index: int | None, field_name: str | None) -> str:
        """`scene.validate`'s places, in the words of the file."""
        if kind == "world":
            return self.place("world", field_name)
        if kind in ("particle defaults", "spring defaults"):
            return self.place(kind.split()[0], field_name)
        if index is None:
            return self.place(kind)
        source = next(s for s in reversed(self.sources[kind]) if s.first <= index)
        if source.table == "cloths":
            offset = f" particle {index - source.first}" if kind == "particle" else ""
            return self.place("cloths", source.index, field_name) + offset
        if field_name not in source.keys and (kind, field_name) in self.lines:
            return f"{self.place(kind, field_name)} for [[{source.table}]] {source.index}"
        return self.place(source.table, source.index, field_name)

    # Values

    def known_keys(self, table: dict, kind: str, path: tuple):
        for key in table:
            if key not in _TABLES[kind]:
                hint = nearest(key, _TABLES[kind])
                if kind and key in _TABLES[""]:
                    hint = f"'{key}' belongs above the first [table]"
                self.refuse((*path, key), f"unknown key '{key}'; {hint}")

    def value(self, table: dict, path: tuple, key: str, read: Callable, default: Any = None) -> Any:
        """``read`` of the value at `key`, or `default` where the key is absent."""
        if key not in table:
            return default
        try:
            return read(table[key])
        except _WrongType as wrong:
            self.refuse((*path, key), f"{key} must be {wrong}, is {_toml_kind(table[key])}")

    def required(self, table: dict, path: tuple, key: str, read: Callable) -> Any:
        if key not in table:
            self.refuse(path, f"'{key}' is missing")
        return self.value(table, path, key, read)

    def finite(self, path: tuple, key: str, value: Any) -> Any:
        """`value`, a number or a list of them, if all of it is finite."""
        if value is not None and not np.isfinite(value).all():
            self.refuse((*path, key), f"{key} must be finite, is {_show(value)}")
        return value

    def vector(self, table: dict, path: tuple, key: str, dim: int) -> list[float] | None:
        vector = self.finite(path, key, self.value(table, path, key, _numbers))
        if vector is not None and len(vector) != dim:
            self.refuse(
                (*path, key), f"{key} must have {dim} numbers in a {dim}-D world, has {len(vector)}"
            )
        return vector

    def subtable(self, table: dict, key: str) -> dict:
        inner = self.value(table, (), key, _table, {})
        self.known_keys(inner, key, (key,))
        return inner

    def entries(self, table: dict, key: str) -> list[dict]:
        entries = self.value(table, (), key, _tables, [])
        for index, entry in enumerate(entries):
            self.known_keys(entry, key, (key, index))
        return entries

    # Tables

    def scene(self, table: dict) -> Scene:
        self.known_keys(table, "", ())
        if "world" not in table:
            self.refuse((), "[world] is missing; it needs at least size = [width, height]")
        world = self.world(self.subtable(table, "world"))
        particle_defaults = self.particle_defaults(self.subtable(table, "particle"))
        spring_defaults = self.spring_defaults(self.subtable(table, "spring"))
        particles = self.particles(self.entries(table, "particles"), world, particle_defaults)
        cloths, links = [], []
        count = len(particles)
        spring_entries = self.entries(table, "springs")
        link_count = len(spring_entries)
        for index, entry in enumerate(self.entries(table, "cloths")):
            nodes, ties = self.cloth(entry, index, world, particle_defaults, spring_defaults)
            keys = frozenset(entry)
            self.sources["particle"].append(_Source(count, "cloths", index, keys))
            self.sources["spring"].append(_Source(link_count, "cloths", index, keys))
            ties.between[:] += count
            cloths.append(nodes)
            links.append(ties)
            count += len(nodes)
            link_count += len(ties)
        for nodes in cloths:
            particles = particles.joined(nodes)
        springs = self.springs(spring_entries, particles, spring_defaults)
        for ties in links:
            springs = springs.joined(ties)
        scene = Scene(
            name=self.value(table, (), "name", _text, self.default_scene_name),
            world=world,
            particles=particles,
            springs=springs,
            particle_defaults=particle_defaults,
            spring_defaults=spring_defaults,
        )
        return validate(scene, self.place_of_fault)

    def world(self, table: dict) -> World:
        path = ("world",)
        size = self.finite(path, "size", self.required(table, path, "size", _numbers))
        if len(size) not in (2, 3):
            self.refuse((*path, "size"), f"size must be 2 or 3 lengths, has {len(size)}")
        walls = self.value(table, path, "walls", _walls, False)
        if isinstance(walls, bool):
            walls = [name for name, (axis, _) in WALLS.items() if axis < len(size)] if walls else []
        return World(
            size=tuple(size),
            gravity=tuple(self.vector(table, path, "gravity", len(size)) or [0.0] * len(size)),
            dt=self.value(table, path, "dt", _number, 1.0),
            walls=tuple(dict.fromkeys(walls)),
            collisions=self.value(table, path, "collisions", _boolean, False),
            mouse=self.value(table, path, "mouse", _text, MOUSE_MODES[0]),
        )

    def particle_defaults(self, table: dict) -> ParticleDefaults:
        given = {key: self.value(table, ("particle",), key, _number) for key in table}
        return ParticleDefaults(**given)

    def spring_defaults(self, table: dict) -> SpringDefaults:
        given = {key: self.spring_number(table, ("spring",), key) for key in table}
        if given.get("break_force") == math.inf:
            given["break_force"] = None
        return SpringDefaults(**given)

    def spring_number(self, table: dict, path: tuple, key: str) -> float | None:
        """A spring's number, None where it is absent; inf for ``break_force = false``."""
        if key == "break_force" and table.get(key) is False:
            return math.inf
        return self.finite(path, key, self.value(table, path, key, _number))

    def particles(self, entries: list[dict], world: World, defaults: ParticleDefaults) -> Particles:
        dim = world.dim
        rows: dict[str, list] = {key: [] for key in _TABLES["particles"]}
        for index, entry in enumerate(entries):
            path = ("particles", index)
            self.sources["particle"].append(_Source(index, "particles", index, frozenset(entry)))
            if "position" not in entry:
                self.refuse(path, "'position' is missing")
            rows["position"].append(self.vector(entry, path, "position", dim))
            rows["velocity"].append(self.vector(entry, path, "velocity", dim) or [0.0] * dim)
            fixed = self.value(entry, path, "fixed", _boolean, False)
            rows["fixed"].append(fixed)
            default_color = FIXED_COLOR if fixed else PARTICLE_COLOR
            rows["color"].append(self.value(entry, path, "color", _color, default_color))
            for key in _PARTICLE_NUMBERS:
                rows[key].append(self.value(entry, path, key, _number, getattr(defaults, key)))
        if not entries:
            return Particles.none(dim)
        return Particles.build(**rows)

    def springs(
        self, entries: list[dict], particles: Particles, defaults: SpringDefaults
    ) -> Springs:
        if not entries:
            return Springs.none()
        between = []
        rows: dict[str, list] = {key: [] for key in _SPRING_NUMBERS}
        for index, entry in enumerate(entries):
            path = ("springs", index)
            # Before the cloths' sources: the list is in the order of the springs' numbers.
            source = _Source(index, "springs", index, frozenset(entry))
            self.sources["spring"].insert(index, source)
            pair = self.required(entry, path, "between", _pair)
            for i in pair:
                if not 0 <= i < len(particles):
                    has = f"0 to {len(particles) - 1}" if len(particles) else "none"
                    self.refuse(
                        (*path, "between"), f"there is no particle {i}; the scene's are {has}"
                    )
            between.append(pair)
            for key in _SPRING_NUMBERS:
                value = self.spring_number(entry, path, key)
                rows[key].append(getattr(defaults, key) if value is None else value)
        between = np.array(between, np.int64)
        distance = np.linalg.norm(
            particles.position[between[:, 0]] - particles.position[between[:, 1]], axis=1
        )
        rows["rest_length"] = [
            at_start if given is None else given
            for given, at_start in zip(rows["rest_length"], distance, strict=True)
        ]
        rows["break_force"] = [math.inf if f is None else f for f in rows["break_force"]]
        return Springs.build(between, particles.position, **rows)

    def cloth(
        self,
        entry: dict,
        index: int,
        world: World,
        particle_defaults: ParticleDefaults,
        spring_defaults: SpringDefaults,
    ) -> tuple[Particles, Springs]:
        path = ("cloths", index)
        if "origin" not in entry:
            self.refuse(path, "'origin' is missing")
        per_kind = {}
        for key in _SPRING_NUMBERS:
            values = self.value(entry, path, key, _table, {})
            for kind in values:
                if kind not in LINKS:
                    self.refuse(
                        (*path, key, kind), f"unknown kind '{kind}'; {nearest(kind, LINKS)}"
                    )
            per_kind[key] = {
                kind: self.kind_number(values, (*path, key), key, kind) for kind in values
            }
        try:
            return grid(
                self.vector(entry, path, "origin", world.dim),
                self.required(entry, path, "columns", _integer),
                self.required(entry, path, "rows", _integer),
                self.required(entry, path, "spacing", _number),
                pinned=self.value(entry, path, "pinned", _pairs, []),
                links=self.value(entry, path, "links", _texts, ["structural"]),
                across=self.vector(entry, path, "across", world.dim),
                down=self.vector(entry, path, "down", world.dim),
                particle_defaults=particle_defaults,
                spring_defaults=spring_defaults,
                **per_kind,
            )
        except InputError as error:
            message = str(error)
            if message.startswith(self.name):
                raise
            at_fault = next((key for key in entry if message.startswith(key)), None)
            raise InputError(f"{self.place(*path, at_fault)}: {message}") from None

    def kind_number(self, values: dict, path: tuple, key: str, kind: str) -> float:
        if key == "break_force" and values[kind] is False:
            return math.inf
        number = self.finite(path, kind, self.value(values, path, kind, _number))
        if number < 0 or (number == 0 and key == "break_force"):
            says = "positive" if key == "break_force" else "at least 0"
            self.refuse((*path, kind), f"{key} of {kind} links must be {says}, is {number:g}")
        return number


# Types of values. Each reader returns the value or raises _WrongType with what was expected.


class _WrongType(Exception):
    pass


def _toml_kind(value: Any) -> str:
    """What a value is, in TOML's words, with the value where it is short."""
    text = value if isinstance(value, str) else str(value)
    short = f" {text!r}" if isinstance(value, str) else f" {text}"
    short = short if len(short) <= 40 and not isinstance(value, dict) else ""
    if isinstance(value, bool):
        return "true" if value else "false"
    for type_, word in ((str, "the text"), ((int, float), "the number"), (list, "the list")):
        if isinstance(value, type_):
            return word + short if short else word.replace("the", "a")
    return "a table" if isinstance(value, dict) else "a date or time"


def _show(value: Any) -> str:
    return str(value) if isinstance(value, list) else f"{value:g}"


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise _WrongType("a number")
    try:
        return float(value)
    except OverflowError:
        raise _WrongType("a number that fits into double precision") from None


def _integer(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise _WrongType("a whole number")
    if abs(value) >= 2**31:
        raise _WrongType("a whole number below 2147483648")
    return value


def _boolean(value: Any) -> bool:
    if not isinstance(value, bool):
        raise _WrongType("true or false")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise _WrongType("a text in quotes")
    return value


def _table(value: Any) -> dict:
    if not isinstance(value, dict):
        raise _WrongType("a table")
    return value


def _list_of(read: Callable, words: str, length: int | None = None) -> Callable[[Any], list]:
    def read_list(value: Any) -> list:
        if not isinstance(value, list) or length not in (None, len(value)):
            raise _WrongType(words)
        try:
            return [read(item) for item in value]
        except _WrongType:
            raise _WrongType(words) from None

    return read_list


_numbers = _list_of(_number, "a list of numbers")
_texts = _list_of(_text, "a list of texts")
_tables = _list_of(_table, "a list of tables, each under its own [[...]]")
_pair = _list_of(_integer, "a list of two whole numbers", 2)
_pairs = _list_of(_pair, "a list of [column, row] pairs")


def _walls(value: Any) -> bool | list[str]:
    if isinstance(value, bool):
        return value
    return _list_of(_text, "true, false or a list of names")(value)


def _color(value: Any) -> list[int]:
    words = "three whole numbers from 0 to 255: red, green, blue"
    color = _list_of(_integer, words, 3)(value)
    if not all(0 <= c <= 255 for c in color):
        raise _WrongType(words)
    return color


# Writing


def dump(scene: Scene) -> str:
    """`scene` as TOML text that `parse` reads back as an equal scene (bit for bit).

    Cloths come out as single particles and springs; what equals the defaults is left out.
    """
    world, springs, particles = scene.world, scene.springs, scene.particles
    out = [
        f"name = {_quoted(scene.name)}",
        "",
        "[world]",
        f"size = {_listed(world.size)}",
        f"gravity = {_listed(world.gravity)}",
        f"dt = {float(world.dt)!r}",
        f"walls = [{', '.join(map(_quoted, world.walls))}]",
        f"collisions = {str(bool(world.collisions)).lower()}",
        f"mouse = {_quoted(world.mouse)}",
    ]
    for table, defaults, keys in (
        ("particle", scene.particle_defaults, _PARTICLE_NUMBERS),
        ("spring", scene.spring_defaults, _SPRING_NUMBERS),
    ):
        out += ["", f"[{table}]"]
        given = ((key, getattr(defaults, key)) for key in keys)
        out += [f"{key} = {float(value)!r}" for key, value in given if value is not None]
    for i in range(len(particles)):
        out += ["", "[[particles]]", f"position = {_listed(particles.position[i])}"]
        if particles.velocity[i].any() or np.signbit(particles.velocity[i]).any():
            out.append(f"velocity = {_listed(particles.velocity[i])}")
        if particles.fixed[i]:
            out.append("fixed = true")
        color = tuple(map(int, particles.color[i]))
        if color != (FIXED_COLOR if particles.fixed[i] else PARTICLE_COLOR):
            out.append(f"color = {list(color)}")
        for key in _PARTICLE_NUMBERS:
            value = float(getattr(particles, key)[i])
            if value != getattr(scene.particle_defaults, key):
                out.append(f"{key} = {value!r}")
    for i in range(len(springs)):
        out += ["", "[[springs]]", f"between = {list(map(int, springs.between[i]))}"]
        for key in _SPRING_NUMBERS:
            value, default = float(getattr(springs, key)[i]), getattr(scene.spring_defaults, key)
            if value == math.inf:
                out += ["break_force = false"] if default is not None else []
            elif value != default:
                out.append(f"{key} = {value!r}")
    return "\n".join(out) + "\n"


def _listed(values) -> str:
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"


def _quoted(text: str) -> str:
    """`text` as a TOML basic string."""
    escaped = "".join(
        f"\\{c}" if c in '"\\' else c if c.isprintable() else f"\\U{ord(c):08X}" for c in text
    )
    return f'"{escaped}"'
