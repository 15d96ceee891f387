"""Values of a scene file's tables, each with the place that a message names.

`tables` says which tables there are; `cloth_tables` and `mesh_tables` read the entries that stand
for many particles, through the same `TableReader`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar, overload

import numpy as np

from taichi_cloth.errors import InputError, counted, nearest
from taichi_cloth.files.meshes.seams import FilePoints
from taichi_cloth.scene import toml
from taichi_cloth.scene.assignments import Assignment
from taichi_cloth.scene.model import (
    ParticleDefaults,
    Particles,
    SpringDefaults,
    Springs,
    World,
)
from taichi_cloth.scene.properties import SPRING_PROPERTIES
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.scene.toml import Keys
from taichi_cloth.scene.world_keys import world_keys

Table = dict[str, Any]
Value = TypeVar("Value")
Default = TypeVar("Default")
Finite = TypeVar("Finite", float, "float | None", list[float], "list[float] | None")


@dataclass(frozen=True)
class Common:
    """Shared parts of all entries: the world, and defaults of particles and springs."""

    world: World
    particle: ParticleDefaults
    spring: SpringDefaults


@dataclass(frozen=True)
class Sheet:
    """The parts of an entry, numbered from 0: particles, springs, triangles (m, 3), stencils.

    file: the mesh file that it is of, and file_points, the vertices that this has; number: the
    number that each particle has in it, (n,).
    """

    particles: Particles
    springs: Springs
    triangles: np.ndarray
    stencils: Stencils
    file: Path | None = None
    file_points: FilePoints | None = None
    number: np.ndarray | None = None


class TableReader:
    """Reads values of parsed TOML, or refuses them with their place in the file.

    name: the file's, in messages; text: what was parsed. folder: to which the files that a scene
        names are relative. keys: those of each table, by the table's name; "": of none.
    """

    def __init__(self, name: str, text: str, folder: Path, keys: Mapping[str, tuple[str, ...]]):
        self.name, self.folder, self.keys = name, folder, keys
        self.lines = toml.lines_of(text)
        self.assigned: set[Keys] = set()
        self.notes: list[str] = []

    def note(self, file: Path, clauses: Iterable[str]) -> None:
        """Keep what is to be said of a file that the scene names, a clause each."""
        for clause in clauses:
            if (note := f"{file}: {clause}") not in self.notes:
                self.notes.append(note)

    # Places

    def place(self, *path: Any) -> str:
        """'box.toml line 12: [[particles]] 3' for ("particles", 3, "mass"), as far as known."""
        ways = [path[:n] for n in range(len(path), 0, -1)]
        if path and path not in self.lines:  # perhaps a table that an assignment made
            ways[1:1] = [keys for keys in self.assigned if keys[: len(path)] == path]
        found = next((way for way in ways if way in self.lines or way in self.assigned), None)
        if found in self.assigned:
            return f"--set {toml.dotted(found)}"
        where = f"{self.name} line {self.lines[found]}" if found else self.name
        if path and path[0] in self.keys:
            numbered = len(path) > 1 and isinstance(path[1], int)
            where += f": [[{path[0]}]] {path[1]}" if numbered else f": [{path[0]}]"
        return where

    def refuse(self, path: Keys, text: str) -> NoReturn:
        """Raise InputError: `text`, after the place of what is at fault."""
        raise InputError(f"{self.place(*path)}: {text}")

    @contextmanager
    def blaming(self, path: Keys, entry: Table, file: Path | None = None) -> Iterator[None]:
        """Gives a refusal without a place that of the entry's key which its words begin with.

        path: to the entry. file: the one that the entry's key 'file' names, whose own refusals
        begin with its path.
        """
        try:
            yield
        except InputError as error:
            message = str(error)
            if message.startswith((self.name, "--set")):
                raise
            at_fault = next((key for key in entry if message.startswith(key)), None)
            if at_fault is None and file is not None and message.startswith(str(file)):
                at_fault = "file"
            raise InputError(f"{self.place(*path, at_fault)}: {message}") from None

    # Assignments

    def assign(self, table: Table, assignment: Assignment) -> None:
        """Put an assignment's value into the file's table, in the place of what is there."""
        keys = assignment.keys
        self.assigned.add(keys)
        inside: Any = table
        for n, key in enumerate(keys):
            here = toml.dotted(keys[:n])
            if isinstance(key, int):
                if not isinstance(inside, list):
                    self.refuse(keys, f"'{here}' is no list")
                if key >= len(inside):
                    has = counted(len(inside), "entry").replace("entrys", "entries")
                    self.refuse(keys, f"'{here}' has {has}, numbered from 0")
            elif isinstance(inside, list):
                self.refuse(keys, f"name one entry of the list, such as {here}[0].{key}")
            elif not isinstance(inside, dict):
                self.refuse(keys, f"'{here}' is no table")
            if n == len(keys) - 1:
                inside[key] = assignment.value
            elif isinstance(inside, dict):
                inside = inside.setdefault(key, [] if isinstance(keys[n + 1], int) else {})
            else:
                inside = inside[key]

    # Values

    def known_keys(self, table: Table, kind: str, path: Keys) -> None:
        """Refuse a key that a table of a kind ("cloths", "": the whole file) does not have."""
        for key in table:
            known = self.keys[kind]
            if key not in known and kind == "world":
                known = (*known, *world_keys())
            if key not in known:
                hint = nearest(key, known)
                if kind and key in self.keys[""]:
                    hint = f"'{key}' belongs above the first [table]"
                homes = [home for home in ("world", "particle", "spring") if key in self.keys[home]]
                if not kind and homes:
                    hint = f"did you mean '{homes[0]}.{key}'?"
                self.refuse((*path, key), f"unknown key '{key}'; {hint}")

    @overload
    def value(
        self, table: Table, path: Keys, key: str, read: Callable[[Any], Value]
    ) -> Value | None: ...

    @overload
    def value(
        self, table: Table, path: Keys, key: str, read: Callable[[Any], Value], default: Default
    ) -> Value | Default: ...

    def value(
        self,
        table: Table,
        path: Keys,
        key: str,
        read: Callable[[Any], Value],
        default: Default | None = None,
    ) -> Value | Default | None:
        """``read`` of the value at `key`, or `default` where the key is absent."""
        if key not in table:
            return default
        try:
            return read(table[key])
        except toml.WrongType as wrong:
            shown = toml.describe(table[key])
            self.refuse((*path, key), f"{_named(path, key)} must be {wrong}, is {shown}")

    def required(self, table: Table, path: Keys, key: str, read: Callable[[Any], Value]) -> Value:
        """``read`` of the value at `key`, which may not be absent."""
        value = self.value(table, path, key, read)
        if value is None:  # what TOML reads is never None
            self.refuse(path, f"'{key}' is missing")
        return value

    def finite(self, path: Keys, key: str, value: Finite) -> Finite:
        """`value` if all of it is finite."""
        if value is not None and not np.isfinite(value).all():
            shown = str(value) if isinstance(value, list) else f"{value:g}"
            self.refuse((*path, key), f"{_named(path, key)} must be finite, is {shown}")
        return value

    def vector(self, table: Table, path: Keys, key: str, dim: int) -> list[float] | None:
        """The `dim` finite numbers at `key`, None where it is absent."""
        vector = self.finite(path, key, self.value(table, path, key, toml.numbers))
        if vector is not None and len(vector) != dim:
            must = f"must have {dim} numbers in a {dim}-D world, has {len(vector)}"
            self.refuse((*path, key), f"{_named(path, key)} {must}")
        return vector

    def subtable(self, table: Table, key: str) -> Table:
        """The table under [key], with known keys alone; empty where it is absent."""
        inner = self.value(table, (), key, toml.table) or {}
        self.known_keys(inner, key, (key,))
        return inner

    def entries(self, table: Table, key: str) -> list[Table]:
        """The tables under [[key]], with known keys alone."""
        entries = self.value(table, (), key, toml.tables) or []
        for index, entry in enumerate(entries):
            self.known_keys(entry, key, (key, index))
        return entries

    def spring_value(
        self, table: Table, path: Keys, key: str, read: Callable[[Any], float] = toml.number
    ) -> float | str | None:
        """A spring's number or word, None where it is absent; ``false``: what its property says."""
        about = SPRING_PROPERTIES[key]
        if about.off is not None and table.get(key) is False:
            return about.off
        if about.words:
            return self.value(table, path, key, toml.text)
        return self.finite(path, key, self.value(table, path, key, read))


def _named(path: Keys, key: str) -> str:
    """A key as a message names it: of a table within a table or an entry, both, 'wind.gust'."""
    return toml.dotted((*(part for part in path[1:] if isinstance(part, str)), key))
