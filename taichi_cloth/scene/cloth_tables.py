"""`[[cloths]]` of a scene file: a grid, what its links are, and what its cloth is made of."""

from __future__ import annotations

from taichi_cloth.errors import nearest
from taichi_cloth.scene import toml
from taichi_cloth.scene.cloth import LINKS, grid, grid_stencils, grid_triangles
from taichi_cloth.scene.material import KEYS as MATERIAL_KEYS
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.properties import SPRING_PROPERTIES
from taichi_cloth.scene.reading import Common, Sheet, Table, TableReader
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.scene.toml import Keys

KEYS = (
    *("origin", "columns", "rows", "spacing", "pinned", "links", "across", "down", "bending"),
    "color",
    *MATERIAL_KEYS,
    *SPRING_PROPERTIES,
)


def read(reader: TableReader, entry: Table, index: int, common: Common) -> Sheet:
    """The cloth of an entry. Raises InputError, naming the entry's line, for what makes none."""
    path, dim = ("cloths", index), common.world.dim
    if "origin" not in entry:
        reader.refuse(path, "'origin' is missing")
    links = reader.value(entry, path, "links", toml.texts, ["structural"])
    per_kind = {key: _of_kinds(reader, entry, path, key, links) for key in SPRING_PROPERTIES}
    material = {key: reader.value(entry, path, key, toml.number) for key in MATERIAL_KEYS}
    with reader.blaming(path, entry):
        columns = reader.required(entry, path, "columns", toml.integer)
        rows = reader.required(entry, path, "rows", toml.integer)
        particles, springs = grid(
            reader.vector(entry, path, "origin", dim) or [],
            columns,
            rows,
            reader.finite(path, "spacing", reader.required(entry, path, "spacing", toml.number)),
            pinned=reader.value(entry, path, "pinned", toml.pairs, []),
            links=links,
            across=reader.vector(entry, path, "across", dim),
            down=reader.vector(entry, path, "down", dim) or common.world.downward,
            up="",  # `down` says it
            material=Material(**material),
            particle_defaults=common.particle,
            spring_defaults=common.spring,
            **per_kind,
        )
        bent = _stencils(reader, entry, path, dim)
        return Sheet(particles, springs, grid_triangles(columns, rows), bent)


def _stencils(reader: TableReader, entry: Table, path: Keys, dim: int) -> Stencils:
    """Bending of a cloth, whose first particle has the number 0."""
    bending = reader.finite(path, "bending", reader.value(entry, path, "bending", toml.number))
    if bending is None:
        return Stencils.none()
    across, down = (reader.vector(entry, path, key, dim) for key in ("across", "down"))
    size = entry["columns"], entry["rows"], entry["spacing"]
    return grid_stencils(*size, bending, across=across, down=down)


def _of_kinds(
    reader: TableReader, entry: Table, path: Keys, key: str, links: list[str]
) -> dict[str, float | str]:
    """A cloth's numbers or words by kind of link: of some kinds, or one for all its `links`."""
    values = entry.get(key, {})
    if not isinstance(values, dict):
        value = reader.spring_value(entry, path, key, toml.number_or_table)
        return {} if value is None else dict.fromkeys(links, value)
    for kind in values:
        if kind not in LINKS:
            reader.refuse((*path, key, kind), f"unknown kind '{kind}'; {nearest(kind, LINKS)}")
    return {kind: _kind_value(reader, values, (*path, key), key, kind) for kind in values}


def _kind_value(reader: TableReader, values: Table, path: Keys, key: str, kind: str) -> float | str:
    """The number or word that links of a kind have."""
    about = SPRING_PROPERTIES[key]
    if about.off is not None and values[kind] is False:
        return about.off
    value: float | str
    if about.words:
        value = reader.required(values, path, kind, toml.text)
    else:
        value = reader.finite(path, kind, reader.required(values, path, kind, toml.number))
    if not about.rule.holds(value):
        shown = repr(value) if isinstance(value, str) else f"{value:g}"
        reader.refuse((*path, kind), f"{key} of {kind} links {about.rule.of_links}, is {shown}")
    return value
