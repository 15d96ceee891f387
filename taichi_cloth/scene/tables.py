"""Read the tables of a scene file: a `Scene`, or a refusal that names the place at fault.

`scenefile` reads a file's text; the keys of its tables are those of `TABLES` below.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.errors import counted, nearest
from taichi_cloth.files.meshes.seams import FilePoints
from taichi_cloth.scene import cloth_tables, mesh_tables, toml
from taichi_cloth.scene.assignments import Assignment
from taichi_cloth.scene.checks import validate
from taichi_cloth.scene.model import (
    MOUSE_MODES,
    WALLS,
    ParticleDefaults,
    Particles,
    Scene,
    SpringDefaults,
    Springs,
    World,
)
from taichi_cloth.scene.obstacles import Obstacle, usual_contact
from taichi_cloth.scene.palette import FIXED_COLOR, PARTICLE_COLOR
from taichi_cloth.scene.properties import (
    PARTICLE_PROPERTIES,
    SPRING_PROPERTIES,
    WorldKey,
    WorldNumber,
    WorldValue,
)
from taichi_cloth.scene.reading import Common, Sheet, Table, TableReader
from taichi_cloth.scene.seam_notes import loose_parts
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.scene.toml import Keys
from taichi_cloth.scene.world_keys import world_keys

# Each table's keys, besides further ones of [world] (`world_keys`). `break_force = false` says
# unbreakable where [spring] gives a force.
TABLES = {
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
        "rate",
        "substeps",
        "walls",
        "collisions",
        "mouse",
        "ground",
        "friction",
        "contact",
        "rest",
    ),
    "particle": tuple(PARTICLE_PROPERTIES),
    "spring": (*SPRING_PROPERTIES, "color"),
    "particles": ("position", "velocity", "fixed", "color", *PARTICLE_PROPERTIES),
    "springs": ("between", *SPRING_PROPERTIES),
    "stencils": ("between", "weights", "bending"),
    "obstacles": ("shape",),  # and what its shape declares (`kernels/obstacles/`)
    "cloths": cloth_tables.KEYS,
    "meshes": mesh_tables.KEYS,
}


FRAMES_A_SECOND = 60  # of scenes in metres and seconds that say no dt


@dataclass(frozen=True)
class _Source:
    """The origin of a run of particles, springs or stencils: `table`, its index and its keys."""

    first: int
    table: str
    index: int
    keys: frozenset[str]


class SceneReader(TableReader):
    """Turns parsed TOML into a Scene.

    sources: where particles, springs and stencils come from, in the order of their numbers.
    files: those that have the vertices and faces of obstacles, by the obstacle's number.
    """

    def __init__(self, name: str, text: str, default_scene_name: str, folder: Path):
        super().__init__(name, text, folder, TABLES)
        self.default_scene_name = default_scene_name
        self.files: dict[int, Path] = {}
        self.sources: dict[str, list[_Source]] = {"particle": [], "spring": [], "stencil": []}

    def scene(self, table: Table) -> Scene:
        """The scene that a whole file describes, checked."""
        self.known_keys(table, "", ())
        if "world" not in table:
            self.refuse((), "[world] is missing; it needs at least size = [width, height]")
        world = self.world(self.subtable(table, "world"), tables=table)
        particle_table = self.subtable(table, "particle")
        particle_defaults = self.particle_defaults(particle_table, world)
        spring_table = self.subtable(table, "spring")
        spring_defaults = self.spring_defaults(spring_table)
        spring_color = self.value(spring_table, ("spring",), "color", toml.color)
        particles = self.particles(self.entries(table, "particles"), world, particle_defaults)
        sheets = []
        points, begins = [], []
        listed = len(particles)
        surfaces = [self.triangles(table)]
        count = len(particles)
        stencils = self.stencils(self.entries(table, "stencils"))
        spring_entries = self.entries(table, "springs")
        spring_count = len(spring_entries)
        common = Common(world, particle_defaults, spring_defaults)
        of_meshes: frozenset[str] = frozenset()
        for kind, read in (("cloths", cloth_tables.read), ("meshes", mesh_tables.read)):
            for index, entry in enumerate(self.entries(table, kind)):
                sheet, keys = read(self, entry, index, common), frozenset(entry)
                if kind == "meshes":
                    of_meshes |= keys
                self.sources["particle"].append(_Source(count, kind, index, keys))
                self.sources["spring"].append(_Source(spring_count, kind, index, keys))
                self.sources["stencil"].append(_Source(len(stencils), kind, index, keys))
                sheet.springs.between[:] += count
                surfaces.append(count + sheet.triangles)
                numbers = count + np.arange(len(sheet.particles))
                stencils = stencils.joined(sheet.stencils.renumbered(numbers))
                own = FilePoints(np.arange(len(numbers)), sheet.triangles)
                points.append(sheet.file_points or own)
                begins.append(count)
                sheets.append(replace(sheet, particles=self.colored(sheet, entry, (kind, index))))
                count += len(sheet.particles)
                spring_count += len(sheet.springs)
        for sheet in sheets:
            particles = particles.joined(sheet.particles)
        springs = self.springs(spring_entries, particles, spring_defaults)
        for sheet in sheets:
            springs = springs.joined(sheet.springs)
        for sheet, begin in zip(sheets, begins, strict=True):
            if sheet.file is not None:
                self.note(sheet.file, loose_parts(sheet, begin, particles, springs))
        assumed = self.assumed(table, world)
        if "particle.radius" in assumed:
            given = self.with_own_radius(len(particles))
            radius, words = assumed_radius(particle_defaults, particles, springs, world, given)
            assumed["particle.radius"] = words
            particle_defaults = replace(particle_defaults, radius=radius)
            particles = replace(particles, radius=np.where(given, particles.radius, radius))
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
            file_points=FilePoints.of_sheets(surfaces[0], listed, points),
            notes=tuple(self.notes),
            assumed=assumed,
            of_meshes=of_meshes,
        )
        return validate(scene, self.place_of_fault)

    def colored(self, sheet: Sheet, entry: Table, path: Keys) -> Particles:
        """The particles of a cloth or a mesh, in its `color` if it has one; those held are grey."""
        color = self.value(entry, path, "color", toml.color)
        if color is None:
            return sheet.particles
        shades = np.where(sheet.particles.fixed[:, None], FIXED_COLOR, color)
        return replace(sheet.particles, color=shades.astype(np.uint8))

    def world(self, table: Table, tables: Table) -> World:
        """Read [world]; tables: all of the file."""
        path = ("world",)
        size = self.finite(path, "size", self.required(table, path, "size", toml.numbers))
        if len(size) not in (2, 3):
            self.refuse((*path, "size"), f"size must be 2 or 3 lengths, has {len(size)}")
        walls = self.value(table, path, "walls", toml.names_or_boolean, False)
        if walls is True:
            walls = [name for name, (axis, _) in WALLS.items() if axis < len(size)]
        metres = bool(table.get("up") or tables.get("meshes"))
        return World(
            size=tuple(size),
            gravity=tuple(self.vector(table, path, "gravity", len(size)) or [0.0] * len(size)),
            dt=self.frame(table, 1 / FRAMES_A_SECOND if metres else 1.0),
            substeps=self.value(table, path, "substeps", toml.substeps, "auto" if metres else 1),
            walls=tuple(dict.fromkeys(walls or ())),
            collisions=self.value(table, path, "collisions", toml.boolean, False),
            mouse=self.value(table, path, "mouse", toml.text, MOUSE_MODES[0]),
            ground=self.value(table, path, "ground", toml.number),
            friction=self.value(table, path, "friction", toml.number, 0.0),
            contact=self.value(table, path, "contact", toml.text, usual_contact({*table, *tables})),
            more=self.further_keys(table, len(size)),
            rest=self.value(table, path, "rest", toml.boolean, True),
            up=self.value(table, path, "up", toml.text, ""),
        )

    def frame(self, table: Table, default: float) -> float:
        """The time of a frame, which [world] says as `dt`, or as 1 / `rate`."""
        path = ("world",)
        dt = self.value(table, path, "dt", toml.number)
        rate = self.finite(path, "rate", self.value(table, path, "rate", toml.number))
        if rate is None:
            return default if dt is None else dt
        if dt is not None:
            self.refuse((*path, "rate"), "rate stands for dt = 1 / rate; give one of the two")
        if not rate > 0 or not np.isfinite(1 / rate):
            self.refuse((*path, "rate"), f"rate must be positive, is {rate:g}")
        return 1 / rate

    def assign(self, table: Table, assignment: Assignment) -> None:
        """As for any table; of `rate` and `dt` the one that is assigned stands for the other."""
        super().assign(table, assignment)
        others = {("world", "rate"): "dt", ("world", "dt"): "rate"}
        other = others.get(assignment.keys)
        if other is not None and ("world", other) not in self.assigned:
            table["world"].pop(other, None)

    def further_keys(self, table: Table, dim: int) -> dict[str, WorldValue]:
        """The values of those keys of [world] that not every scene has."""
        more: dict[str, WorldValue] = {}
        for name in table:
            if name in TABLES["world"]:
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
            path = ("obstacles", index)
            shape = self.required(entry, path, "shape", toml.text)
            values = {key: value for key, value in entry.items() if key != "shape"}
            obstacle = Obstacle.build(shape, **values)
            if isinstance(file := values.get("file"), str):
                with self.blaming(path, entry, self.folder / file):
                    obstacle, notes = obstacle.with_file(self.folder)
                self.note(self.folder / file, notes)
                if "file" not in obstacle.values:
                    self.files[index] = self.folder / file
            found.append(obstacle)
        return tuple(found)

    def particle_defaults(self, table: Table, world: World) -> ParticleDefaults:
        """The values that [particle] gives; in metres nothing bounces by itself."""
        given = {key: self.required(table, ("particle",), key, toml.number) for key in table}
        return ParticleDefaults(**({"restitution": 0.0} if world.up else {}) | given)

    def assumed(self, table: Table, world: World) -> dict[str, str]:
        """Values that scenes in metres take by themselves, by key; the radius comes later."""
        metres = bool(world.up or table.get("meshes"))
        steps = "as many as are stable"
        taken = {
            "world.dt": (metres and "rate" not in table["world"], f"1/{FRAMES_A_SECOND}"),
            "world.substeps": (metres, f'"{world.substeps}": {steps}'),
            "particle.radius": (bool(world.up), ""),
            "particle.restitution": (bool(world.up), "0"),
        }
        found = {}
        for key, (applies, words) in taken.items():
            kind, name = key.split(".")
            if applies and name not in table.get(kind, {}):
                found[key] = words
        return found

    def with_own_radius(self, count: int) -> np.ndarray:
        """The particles with a radius of their own, or of their cloth's thickness, (n,) bool."""
        own = np.zeros(count, bool)
        for source in self.sources["particle"]:  # in the order of their numbers
            own[source.first :] = bool({"radius", "thickness"} & source.keys)
        return own

    def spring_defaults(self, table: Table) -> SpringDefaults:
        """Read [spring], but for the colour."""
        given: dict[str, Any] = {}
        for key in table.keys() & SPRING_PROPERTIES.keys():
            value = self.spring_value(table, ("spring",), key)
            given[key] = None if value == SPRING_PROPERTIES[key].off else value
        return SpringDefaults(**given)

    def particles(
        self, entries: list[Table], world: World, defaults: ParticleDefaults
    ) -> Particles:
        """The particles that are listed one by one."""
        dim = world.dim
        rows: dict[str, list] = {key: [] for key in TABLES["particles"]}
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
        """The springs that are listed one by one, between any of the scene's particles."""
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

    def place_of_fault(self, kind: str, index: int | None, field_name: str | None) -> str:
        """`checks.validate`'s places, in the words of the file."""
        if kind == "world":
            return self.place("world", *(field_name or "").split("."))
        if kind in ("particle defaults", "spring defaults"):
            return self.place(kind.split()[0], field_name)
        if index is None:
            return self.place(kind)
        if kind == "obstacle":
            if field_name in ("vertices", "faces") and index in self.files:
                return f"{self.place('obstacles', index, 'file')}: {self.files[index]}"
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


def assumed_radius(
    defaults: ParticleDefaults,
    particles: Particles,
    springs: Springs,
    world: World,
    own: np.ndarray,
) -> tuple[float, str]:
    """The radius of a scene in metres that gives none, and where it is from, in words.

    own: (n,) bool, which particles have one all the same.
    """
    if 0 < defaults.thickness < np.inf:  # else it is refused, by its own line
        radius = defaults.thickness / 2
        return radius, f"{radius:g}, half the thickness"
    ends = particles.position[springs.between]
    lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    lengths = lengths[lengths > 0]
    if len(lengths):
        radius = float(f"{lengths.min() / 10:.6g}")  # as it is told, without round-off
        words = f"{radius:g}, a tenth of the least spacing"
    else:
        radius = min(world.size) / 100
        words = f"{radius:g}, a hundredth of the world's least side"
    return radius, f"half the thickness where cloth has one, else {words}" if own.any() else words
