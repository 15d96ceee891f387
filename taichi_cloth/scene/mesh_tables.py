"""`[[meshes]]` of a scene file: a mesh file, where it lies, and what its cloth is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from taichi_cloth.files.meshes.seams import FilePoints
from taichi_cloth.scene import toml
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.mesh import OF_THE_MESH, of_surface, sewn
from taichi_cloth.scene.properties import NOT_NEGATIVE, SPRING_PROPERTIES
from taichi_cloth.scene.reading import Common, Sheet, Table, TableReader
from taichi_cloth.scene.seam_notes import open_seams
from taichi_cloth.scene.stencils import Stencils, mesh_stencils
from taichi_cloth.scene.toml import Keys

# Numbers and words of springs that are given for a mesh's springs alone.
SPRING_KEYS = tuple(name for name in SPRING_PROPERTIES if name not in OF_THE_MESH)
MATERIAL_KEYS = ("density", "thickness", "stretch", "damping_time", "strength")
KEYS = (
    *("file", "scale", "turn", "move", "weld", "pinned", "parts", "color"),
    *MATERIAL_KEYS,
    "bending",
    *SPRING_KEYS,
)


def read(reader: TableReader, entry: Table, index: int, common: Common) -> Sheet:
    """The cloth of an entry.

    Raises InputError, naming the entry's line, and the mesh file's where that is at fault.
    """
    path = ("meshes", index)
    if common.world.dim != 3:
        reader.refuse(path, "a mesh needs a 3-D world: size = [width, height, depth]")
    file = reader.folder / reader.required(entry, path, "file", toml.text)
    parts = reader.value(entry, path, "parts", toml.integer)
    if parts is not None and parts < 1:
        reader.refuse((*path, "parts"), f"parts must be at least 1, is {parts}")
    numbers = {key: reader.spring_value(entry, path, key) for key in SPRING_KEYS}
    material = {key: reader.value(entry, path, key, toml.number) for key in MATERIAL_KEYS}
    bending = reader.finite(path, "bending", reader.value(entry, path, "bending", toml.number))
    if bending is not None and not NOT_NEGATIVE.holds(bending):
        reader.refuse((*path, "bending"), f"bending {NOT_NEGATIVE.says}, is {bending:g}")
    scale = reader.finite(path, "scale", reader.value(entry, path, "scale", toml.number, 1.0))
    weld = reader.value(entry, path, "weld", toml.number, 0.0)
    with reader.blaming(path, entry, file):
        of_file = sewn(file, scale, reader.finite(path, "weld", weld))
        particles, springs, triangles = of_surface(
            of_file,
            file,
            scale=scale,
            turn=reader.vector(entry, path, "turn", 3) or (0.0, 0.0, 0.0),
            move=reader.vector(entry, path, "move", 3) or (0.0, 0.0, 0.0),
            pinned=_pins(reader, entry, path),
            parts=parts,
            material=Material(**material),
            up=1 if common.world.up else -1,
            particle_defaults=common.particle,
            spring_defaults=common.spring,
            **{key: value for key, value in numbers.items() if value is not None},
        )
        stencils = Stencils.none()
        if bending is not None:
            stencils = mesh_stencils(particles.position, triangles, bending)
        points = FilePoints(of_file.joined, of_file.corners)
        reader.note(file, of_file.surface.notes)
        placed = replace(of_file.surface, vertices=particles.position)
        number = of_file.number[points.first]
        reader.note(file, open_seams(placed, number, index))
        return Sheet(particles, springs, triangles, stencils, file, points, number)


def _pins(reader: TableReader, entry: Table, path: Keys) -> list[int] | Mapping[str, float]:
    """The vertices that never move: by number, or all from a height on."""
    words = "a list of vertices, by number, or { above = height }"

    def read(value: Any) -> list[int] | Table:
        if isinstance(value, dict) and set(value) == {"above"}:
            return value
        return toml.list_of(toml.integer, words)(value)

    found = reader.value(entry, path, "pinned", read, [])
    if isinstance(found, dict):
        inside = (*path, "pinned")
        above = reader.required(found, inside, "above", toml.number)
        return {"above": reader.finite(inside, "above", above)}
    return found
