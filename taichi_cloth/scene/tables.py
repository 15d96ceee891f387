"""What the tables of a scene file say: a `Scene`, or a refusal that names the place at fault.

`scenefile` reads a file's text; the keys of its tables are those of `_TABLES` below.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar, overload

import numpy as np

from taichi_cloth.errors import InputError, counted, nearest
from taichi_cloth.scene import mesh_tables, toml
from taichi_cloth.scene.assignments import Assignment
from taichi_cloth.scene.checks import validate
from taichi_cloth.scene.cloth import LINKS, grid, grid_stencils, grid_triangles
from taichi_cloth.scene.material import KEYS as MATERIAL_KEYS
from taichi_cloth.scene.material import Material
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
)
from taichi_cloth.scene.obstacles import CONTACTS, Obstacle
from taichi_cloth.scene.properties import (
    PARTICLE_PROPERTIES,
    SPRING_PROPERTIES,
    WorldKey,
    WorldNumber,
    WorldValue,
)
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.scene.toml import Keys
from taichi_cloth.scene.world_keys import world_keys

# Each table's keys, besides further ones of [world] (`world_keys`). `break_force = false` says
# unbreakable where [spring] gives a force.
_TABLES = {
    "": (
        "name",
        "triangles",
        "world",
        "particle",
        "spring",
        "particles",
        "springs",
        "stencils",
        "cloths",
        "meshes",
        "obstacles",
    ),
    "world": (
        "size",
        "up",
        "gravity",
        "dt",
        "walls",
        "collisions",
        "mouse",
        "ground",
        "friction",
        "contact",
    ),
    "particle": tuple(PARTICLE_PROPERTIES),
    "spring": (*SPRING_PROPERTIES, "color"),
    "particles": ("position", "velocity", "fixed", "color", *PARTICLE_PROPERTIES),
    "springs": ("between", *SPRING_PROPERTIES),
    "stencils": ("between", "weights", "bending"),
    "obstacles": ("shape",),  # and what its shape declares (`kernels/obstacles/`)
    "cloths": (
        *("origin", "columns", "rows", "spacing", "pinned", "links", "across", "down", "bending"),
        *MATERIAL_KEYS,
        *SPRING_PROPERTIES,
    ),
    "meshes": mesh_tables.KEYS,
}

Table = dict[str, Any]
Value = TypeVar("Value")
Default = TypeVar("Default")
Finite = TypeVar("Finite", float, "float | None", list[float], "list[float] | None")


@dataclass(frozen=True)
class _Source:
    """Where a run of particles, springs or stencils comes from: `table`, its index and its keys."""

    first: int
    table: str
    index: int
    keys: frozenset[str]


class TableReader:
    """Turns parsed TOML into a Scene; knows the place of everything for messages.

    folder: to which the files that a scene names are relative.
    """

    def __init__(self, name: str, text: str, default_scene_name: str, folder: Path):
        self.name, self.folder = name, folder
        self.lines = toml.lines_of(text)
        self.assigned: set[Keys] = set()
        self.default_scene_name = default_scene_name
        self.sources: dict[str, list[_Source]] = {"particle": [], "spring": [], "stencil": []}

    # Places

    def place(self, *path: Any) -> str:
        """'box.toml line 12: [[particles]] 3' for ("particles", 3, "mass"), as far as known."""
        ways = [path[:n] for n in range(len(path), 0, -1)]
        found = next((way for way in ways if way in self.lines or way in self.assigned), None)
        if not found and path:  # a table that an assignment made
            found = next((keys for keys in self.assigned if keys[: len(path)] == path), None)
        if found in self.assigned:
            return f"--set {toml.dotted(found)}"
        where = f"{self.name} line {self.lines[found]}" if found else self.name
        if path and path[0] in _TABLES:
            numbered = len(path) > 1 and isinstance(path[1], int)
            where += f": [[{path[0]}]] {path[1]}" if numbered else f": [{path[0]}]"
        return where

    def refuse(self, path: Keys, text: str) -> NoReturn:
        raise InputError(f"{self.place(*path)}: {text}")

    def place_of_fault(self, kind: str, index: int | None, field_name: str | None) -> str:
        """`checks.validate`'s places, in the words of the file."""
        if kind == "world":
            return self.place("world", *(field_name or "").split("."))
        if kind in ("particle defaults", "spring defaults"):
            return self.place(kind.split()[0], field_name)
        if index is None:
            return self.place(kind)
        if kind == "obstacle":
            return self.place("obstacles", index, field_name)
        if kind == "triangle":
            return f"{self.place('triangles')}: triangle {index}"
        if kind == "stencil":
            made = [s for s in self.sources[kind] if s.first <= index]
            if made:
                return self.place(made[-1].table, made[-1].index, "bending")
            return self.place("stencils", index, field_name)
        source = next(s for s in reversed(self.sources[kind]) if s.first <= index)
        if source.table in ("cloths", "meshes"):
            offset = f" particle {index - source.first}" if kind == "particle" else ""
            return self.place(source.table, source.index, field_name) + offset
        default = (kind, field_name)
        if field_name not in source.keys and (default in self.lines or default in self.assigned):
            return f"{self.place(kind, field_name)} for [[{source.table}]] {source.index}"
        return self.place(source.table, source.index, field_name)

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
        for key in table:
            known = _TABLES[kind]
            if key not in known and kind == "world":
                known = (*known, *world_keys())
            if key not in known:
                hint = nearest(key, known)
                if kind and key in _TABLES[""]:
                    hint = f"'{key}' belongs above the first [table]"
                homes = [home for home in ("world", "particle", "spring") if key in _TABLES[home]]
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
            self.refuse((*path, key), f"{key} must be {wrong}, is {toml.describe(table[key])}")

    def required(self, table: Table, path: Keys, key: str, read: Callable[[Any], Value]) -> Value:
        value = self.value(table, path, key, read)
        if value is None:  # what TOML reads is never None
            self.refuse(path, f"'{key}' is missing")
        return value

    def finite(self, path: Keys, key: str, value: Finite) -> Finite:
        """`value` if all of it is finite."""
        if value is not None and not np.isfinite(value).all():
            shown = str(value) if isinstance(value, list) else f"{value:g}"
            self.refuse((*path, key), f"{key} must be finite, is {shown}")
        return value

    def vector(self, table: Table, path: Keys, key: str, dim: int) -> list[float] | None:
        vector = self.finite(path, key, self.value(table, path, key, toml.numbers))
        if vector is not None and len(vector) != dim:
            self.refuse(
                (*path, key), f"{key} must have {dim} numbers in a {dim}-D world, has {len(vector)}"
            )
        return vector

    def subtable(self, table: Table, key: str) -> Table:
        inner = self.value(table, (), key, toml.table) or {}
        self.known_keys(inner, key, (key,))
        return inner

    def entries(self, table: Table, key: str) -> list[Table]:
        entries = self.value(table, (), key, toml.tables) or []
        for index, entry in enumerate(entries):
            self.known_keys(entry, key, (key, index))
        return entries

    # Tables

    def scene(self, table: Table) -> Scene:
        self.known_keys(table, "", ())
        if "world" not in table:
            self.refuse((), "[world] is missing; it needs at least size = [width, height]")
        world = self.world(self.subtable(table, "world"))
        particle_defaults = self.particle_defaults(self.subtable(table, "particle"))
        spring_table = self.subtable(table, "spring")
        spring_defaults = self.spring_defaults(spring_table)
        spring_color = self.value(spring_table, ("spring",), "color", toml.color)
        particles = self.particles(self.entries(table, "particles"), world, particle_defaults)
        cloths, links = [], []
        surfaces = [self.triangles(table)]
        count = len(particles)
        stencils = self.stencils(self.entries(table, "stencils"))
        spring_entries = self.entries(table, "springs")
        link_count = len(spring_entries)
        defaults = world, particle_defaults, spring_defaults
        for kind, read in (("cloths", self.cloth), ("meshes", self.mesh)):
            for index, entry in enumerate(self.entries(table, kind)):
                nodes, ties, triangles, bent = read(entry, index, *defaults)
                keys = frozenset(entry)
                self.sources["particle"].append(_Source(count, kind, index, keys))
                self.sources["spring"].append(_Source(link_count, kind, index, keys))
                self.sources["stencil"].append(_Source(len(stencils), kind, index, keys))
                ties.between[:] += count
                surfaces.append(count + triangles)
                stencils = stencils.joined(bent.renumbered(count + np.arange(len(nodes))))
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
            name=self.value(table, (), "name", toml.text, self.default_scene_name),
            world=world,
            particles=particles,
            springs=springs,
            particle_defaults=particle_defaults,
            spring_defaults=spring_defaults,
            spring_color=spring_color,
            obstacles=self.obstacles(table),
            triangles=np.concatenate(surfaces),
            stencils=stencils,
        )
        return validate(scene, self.place_of_fault)

    def world(self, table: Table) -> World:
        path = ("world",)
        size = self.finite(path, "size", self.required(table, path, "size", toml.numbers))
        if len(size) not in (2, 3):
            self.refuse((*path, "size"), f"size must be 2 or 3 lengths, has {len(size)}")
        walls = self.value(table, path, "walls", toml.names_or_boolean, False)
        if walls is True:
            walls = [name for name, (axis, _) in WALLS.items() if axis < len(size)]
        return World(
            size=tuple(size),
            gravity=tuple(self.vector(table, path, "gravity", len(size)) or [0.0] * len(size)),
            dt=self.value(table, path, "dt", toml.number, 1.0),
            walls=tuple(dict.fromkeys(walls or ())),
            collisions=self.value(table, path, "collisions", toml.boolean, False),
            mouse=self.value(table, path, "mouse", toml.text, MOUSE_MODES[0]),
            ground=self.value(table, path, "ground", toml.number),
            friction=self.value(table, path, "friction", toml.number, 0.0),
            contact=self.value(table, path, "contact", toml.text, CONTACTS[0]),
            more=self.further_keys(table, len(size)),
            up=self.value(table, path, "up", toml.text, ""),
        )

    def further_keys(self, table: Table, dim: int) -> dict[str, WorldValue]:
        """The values of those keys of [world] that not every scene has."""
        more: dict[str, WorldValue] = {}
        for name in table:
            if name in _TABLES["world"]:
                continue
            key, path = world_keys()[name], ("world", name)
            if key.table:
                inner = self.required(table, ("world",), name, toml.table)
                for part in inner:
                    if part not in key.table:
                        hint = nearest(part, key.table)
                        self.refuse((*path, part), f"{name}: unknown key '{part}'; {hint}")
                values = {
                    part: self.world_value(inner, path, key.table[part], dim) for part in inner
                }
                more[name] = values
            else:
                more[name] = self.world_value(table, ("world",), key, dim)
        return more

    def world_value(self, table: Table, path: Keys, key: WorldKey, dim: int) -> WorldNumber:
        """The number or vector that a table has for a key."""
        if key.vector:
            return tuple(self.vector(table, path, key.name, dim) or ())
        return self.required(table, path, key.name, toml.number)

    def triangles(self, table: Table) -> np.ndarray:
        """The triangles that are listed one by one, (m, 3) int64, those of no cloth."""
        listed = self.value(table, (), "triangles", toml.triples, [])
        return np.array(listed, np.int64).reshape(-1, 3)

    def obstacles(self, table: Table) -> tuple[Obstacle, ...]:
        """The obstacles; `checks.validate` says what is wrong with the values of their keys."""
        found = []
        for index, entry in enumerate(self.value(table, (), "obstacles", toml.tables) or []):
            shape = self.required(entry, ("obstacles", index), "shape", toml.text)
            values = {key: value for key, value in entry.items() if key != "shape"}
            obstacle = Obstacle.build(shape, **values)
            if "file" in values:
                obstacle = obstacle.with_file(self.folder)
            found.append(obstacle)
        return tuple(found)

    def particle_defaults(self, table: Table) -> ParticleDefaults:
        given = {key: self.required(table, ("particle",), key, toml.number) for key in table}
        return ParticleDefaults(**given)

    def spring_defaults(self, table: Table) -> SpringDefaults:
        given: dict[str, Any] = {}
        for key in table.keys() & SPRING_PROPERTIES.keys():
            value = self.spring_value(table, ("spring",), key)
            given[key] = None if value == SPRING_PROPERTIES[key].off else value
        return SpringDefaults(**given)

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

    def particles(
        self, entries: list[Table], world: World, defaults: ParticleDefaults
    ) -> Particles:
        dim = world.dim
        rows: dict[str, list] = {key: [] for key in _TABLES["particles"]}
        for index, entry in enumerate(entries):
            path = ("particles", index)
            self.sources["particle"].append(_Source(index, "particles", index, frozenset(entry)))
            if "position" not in entry:
                self.refuse(path, "'position' is missing")
            rows["position"].append(self.vector(entry, path, "position", dim))
            rows["velocity"].append(self.vector(entry, path, "velocity", dim) or [0.0] * dim)
            fixed = self.value(entry, path, "fixed", toml.boolean, False)
            rows["fixed"].append(fixed)
            default_color = FIXED_COLOR if fixed else PARTICLE_COLOR
            rows["color"].append(self.value(entry, path, "color", toml.color, default_color))
            for key in PARTICLE_PROPERTIES:
                default = getattr(defaults, key)
                rows[key].append(self.value(entry, path, key, toml.number, default))
        if not entries:
            return Particles.none(dim)
        return Particles.build(rows.pop("position"), rows.pop("velocity"), defaults=None, **rows)

    def springs(
        self, entries: list[Table], particles: Particles, defaults: SpringDefaults
    ) -> Springs:
        if not entries:
            return Springs.none()
        pairs = []
        rows: dict[str, list[float | str | None]] = {key: [] for key in SPRING_PROPERTIES}
        for index, entry in enumerate(entries):
            path = ("springs", index)
            # Before the cloths' sources: the list is in the order of the springs' numbers.
            source = _Source(index, "springs", index, frozenset(entry))
            self.sources["spring"].insert(index, source)
            pair = self.required(entry, path, "between", toml.pair)
            for i in pair:
                if not 0 <= i < len(particles):
                    has = f"0 to {len(particles) - 1}" if len(particles) else "none"
                    self.refuse(
                        (*path, "between"), f"there is no particle {i}; the scene's are {has}"
                    )
            pairs.append(pair)
            for key, values in rows.items():
                value = self.spring_value(entry, path, key)
                values.append(getattr(defaults, key) if value is None else value)
        between, x = np.array(pairs, np.int64), particles.position
        distance = np.linalg.norm(x[between[:, 0]] - x[between[:, 1]], axis=1)
        columns = {
            key: about.column(about.filled(rows[key], distance), len(pairs))
            for key, about in SPRING_PROPERTIES.items()
        }
        return Springs(between=between, **columns)

    def cloth(
        self,
        entry: Table,
        index: int,
        world: World,
        particle_defaults: ParticleDefaults,
        spring_defaults: SpringDefaults,
    ) -> tuple[Particles, Springs, np.ndarray, Stencils]:
        """The particles, springs, triangles and stencils of a cloth, numbered from 0."""
        path = ("cloths", index)
        if "origin" not in entry:
            self.refuse(path, "'origin' is missing")
        links = self.value(entry, path, "links", toml.texts, ["structural"])
        per_kind = {key: self.of_kinds(entry, path, key, links) for key in SPRING_PROPERTIES}
        material = {key: self.value(entry, path, key, toml.number) for key in MATERIAL_KEYS}
        try:
            columns = self.required(entry, path, "columns", toml.integer)
            rows = self.required(entry, path, "rows", toml.integer)
            nodes, ties = grid(
                self.vector(entry, path, "origin", world.dim) or [],
                columns,
                rows,
                self.required(entry, path, "spacing", toml.number),
                pinned=self.value(entry, path, "pinned", toml.pairs, []),
                links=links,
                across=self.vector(entry, path, "across", world.dim),
                down=self.vector(entry, path, "down", world.dim) or world.downward,
                material=Material(**material),
                particle_defaults=particle_defaults,
                spring_defaults=spring_defaults,
                **per_kind,
            )
            bent = self.cloth_stencils(entry, path, world)
            return nodes, ties, grid_triangles(columns, rows), bent
        except InputError as error:
            message = str(error)
            if message.startswith((self.name, "--set")):
                raise
            at_fault = next((key for key in entry if message.startswith(key)), None)
            raise InputError(f"{self.place(*path, at_fault)}: {message}") from None

    def mesh(
        self,
        entry: Table,
        index: int,
        world: World,
        particle_defaults: ParticleDefaults,
        spring_defaults: SpringDefaults,
    ) -> tuple[Particles, Springs, np.ndarray, Stencils]:
        """The particles, springs, triangles and stencils of a mesh, numbered from 0."""
        return mesh_tables.read(self, entry, index, world, particle_defaults, spring_defaults)

    def cloth_stencils(self, entry: Table, path: Keys, world: World) -> Stencils:
        """What resists bending in a cloth, whose first particle has the number 0."""
        bending = self.value(entry, path, "bending", toml.number)
        if bending is None:
            return Stencils.none()
        across, down = (self.vector(entry, path, key, world.dim) for key in ("across", "down"))
        size = entry["columns"], entry["rows"], entry["spacing"]
        return grid_stencils(*size, bending, across=across, down=down)

    def stencils(self, entries: list[Table]) -> Stencils:
        """The stencils that are listed one by one."""
        found = []
        for index, entry in enumerate(entries):
            path = ("stencils", index)
            between = self.required(entry, path, "between", toml.integers)
            weights = self.finite(
                path, "weights", self.required(entry, path, "weights", toml.numbers)
            )
            if len(weights) != len(between):
                has = f"has {len(weights)} for {counted(len(between), 'particle')}"
                self.refuse((*path, "weights"), f"weights must be one for each particle, {has}")
            bending = self.required(entry, path, "bending", toml.number)
            one = np.array([between], np.int64), np.array([weights], np.float64)
            found.append(Stencils.build(*one, bending))
        return Stencils.concatenated(found)

    def of_kinds(
        self, entry: Table, path: Keys, key: str, links: list[str]
    ) -> dict[str, float | str]:
        """A cloth's numbers or words by kind of link: of some kinds, or one for all its `links`."""
        values = entry.get(key, {})
        if not isinstance(values, dict):
            value = self.spring_value(entry, path, key, toml.number_or_table)
            return {} if value is None else dict.fromkeys(links, value)
        for kind in values:
            if kind not in LINKS:
                self.refuse((*path, key, kind), f"unknown kind '{kind}'; {nearest(kind, LINKS)}")
        return {kind: self.kind_value(values, (*path, key), key, kind) for kind in values}

    def kind_value(self, values: Table, path: Keys, key: str, kind: str) -> float | str:
        """The number or word that links of a kind have."""
        about = SPRING_PROPERTIES[key]
        if about.off is not None and values[kind] is False:
            return about.off
        value: float | str
        if about.words:
            value = self.required(values, path, kind, toml.text)
        else:
            value = self.finite(path, kind, self.required(values, path, kind, toml.number))
        if not about.rule.holds(value):
            shown = repr(value) if isinstance(value, str) else f"{value:g}"
            self.refuse((*path, kind), f"{key} of {kind} links {about.rule.of_links}, is {shown}")
        return value
