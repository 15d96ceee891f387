"""Assignments to a built-in scene, which has no entries by number.

Its world takes the keys of `[world]`; all its particles and springs, and those that clicks add,
take the numbers of `[particle]` and `[spring]`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.scene import scenefile
from taichi_cloth.scene.assignments import Assignment
from taichi_cloth.scene.checks import validate
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.properties import PARTICLE_PROPERTIES, SPRING_PROPERTIES
from taichi_cloth.scene.toml import dotted

# What a file lists of a scene's particles, and of what is between them.
LISTED = ("particles", "springs", "triangles", "stencils", "cloths", "meshes")


def reassigned(scene: Scene, assignments: Sequence[Assignment]) -> Scene:
    """A built-in scene with these assignments, checked. Raises InputError as a scene file would."""
    if not assignments:
        return scene
    has = "a built-in scene has no entries by number; its flags set what it is built of"
    for entry in assignments:
        if entry.keys[0] in LISTED:
            raise InputError(f"--set {dotted(entry.keys)}: {has}")
    frame = scenefile.parse_table(
        scenefile.table_of(scene), f"scene '{scene.name}'", assignments=assignments
    )
    given = {kind: _names(kind, assignments) for kind in ("particle", "spring")}
    numbers, ties = frame.particle_defaults, frame.spring_defaults
    columns = {
        name: np.full(len(scene.particles), getattr(numbers, name))
        for name in PARTICLE_PROPERTIES
        if name in given["particle"]
    }
    tied = {}
    for name, about in SPRING_PROPERTIES.items():
        value = getattr(ties, name)
        if name in given["spring"]:
            tied[name] = np.full(len(scene.springs), about.off if value is None else value)

    def place(kind: str, index: int | None, name: str | None) -> str:
        if name in given.get(kind, ()):
            return f"--set {kind}.{name}"
        return f"scene '{scene.name}': {kind}" + (f" {index}" if index is not None else "")

    changed = replace(
        frame,
        particles=replace(scene.particles, **columns),
        springs=replace(scene.springs, **tied),
        triangles=scene.triangles,
        stencils=scene.stencils,
    )
    return validate(changed, place)


def _names(kind: str, assignments: Sequence[Assignment]) -> set[str]:
    """The keys of the table `kind` that are assigned, by themselves or with the whole table."""
    names: set[str] = set()
    for entry in assignments:
        if entry.keys[0] == kind:
            names |= {entry.keys[1]} if len(entry.keys) > 1 else set(entry.value)
    return names
