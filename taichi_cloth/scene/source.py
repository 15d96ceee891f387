"""Which scene is meant: a built-in one with its parameters, a scene file, or a mesh file."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_cloth.errors import InputError
from taichi_cloth.files.meshes import FORMATS
from taichi_cloth.settings.options import flag_words

if TYPE_CHECKING:
    import numpy as np

    from taichi_cloth.scene.assignments import Assignment
    from taichi_cloth.scene.model import Scene

# What reads and builds scenes is imported in functions: it takes NumPy, and with that longer than
# all the rest of a start that only prints help.

DEFAULT_SCENE = "cloth"
PLACING = (("scale",), ("turn",), ("move",))  # keys of a mesh that say where it is, and how large
MESHES = tuple(f".{name}" for name in FORMATS)  # suffixes of files that are no scene files


@dataclass(frozen=True)
class SceneSource:
    """The source of a scene, before it is built.

    name: of a built-in scene, of a scene file, or of a mesh file, which hangs (`hanging`).
    parameters: values of the built-in scene's parameters, by name; the rest have their defaults.
    assignments: values in the place of the scene's own, by keys of scene files; the last one of a
        key holds.
    """

    name: str = DEFAULT_SCENE
    parameters: Mapping[str, Any] = field(default_factory=dict)
    assignments: tuple[Assignment, ...] = ()

    @property
    def is_file(self) -> bool:
        return names_file(self.name)

    @property
    def is_mesh(self) -> bool:
        return self.is_file and self.name.lower().endswith(MESHES)

    def build(self) -> Scene:
        """The scene, checked. Raises InputError where there is none, or it cannot be simulated."""
        import numpy as np

        from taichi_cloth.scene import library, scenefile
        from taichi_cloth.scene.checks import mark_checked
        from taichi_cloth.scene.reassignment import reassigned

        if self.is_mesh:
            return mark_checked(self._hung())
        if self.is_file:
            return mark_checked(scenefile.load(self.name, self.assignments))
        with np.errstate(all="ignore"):  # what overflows is refused
            built = library.build(self.name, **self.parameters)
            return mark_checked(reassigned(built, self.assignments))

    def _hung(self) -> Scene:
        from taichi_cloth.files import meshes
        from taichi_cloth.scene import hanging, scenefile

        path = Path(self.name)
        surface = meshes.read(path)  # held, so that the table and the scene's mesh are made of it

        def scene_of(table: dict[str, Any]) -> Scene:
            return scenefile.parse_table(table, path.name, "", path.stem, self.assignments)

        try:
            table = hanging.table(path, surface, self._placed())
        except InputError:
            scene_of(hanging.table(path, surface))  # which names the assignment at fault
            raise
        scene, scale = scene_of(table), table["meshes"][0].get("scale", 1.0)
        note = hanging.note_of_size(scene.particles.position, scale)
        return replace(scene, notes=(*scene.notes, f"{path}: {note}")) if note else scene

    def _placed(self) -> dict[str, Any]:
        """The keys by which assignments place its mesh; nonsense is left to be refused."""
        given: dict[str, Any] = {}
        for entry in self.assignments:
            if entry.keys[:2] == ("meshes", 0) and entry.keys[2:] in PLACING:
                given[str(entry.keys[2])] = entry.value
        return given

    def solution(self) -> Callable[..., tuple[np.ndarray, np.ndarray]] | None:
        """The scene's closed form, a function of times; None without one.

        With assignments there is none: it holds for what the scene's parameters can say.
        """
        from taichi_cloth.scene import library

        return None if self.is_file or self.assignments else library.solution(self.name)

    def words(self) -> list[str]:
        """The scene, its parameters and assignments, as one would write them after a command."""
        return [self.name, *self.flags()]

    def flags(self) -> list[str]:
        """The flags alone that give the scene its parameters and assignments."""
        assigned = (word for entry in self.assignments for word in ("--set", entry.text))
        return [*flag_words(self.parameters), *assigned]

    def as_json(self) -> dict[str, Any]:
        """It as JSON values, of which `from_json` makes it again."""
        assigned = [entry.text for entry in self.assignments]
        return {"name": self.name, "parameters": dict(self.parameters), "assignments": assigned}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> SceneSource:
        """The source that `as_json` wrote. InputError, KeyError or TypeError where it wrote none.

        A parameter that the scene lacks, or a value that it refuses, shows when it is built.
        """
        from taichi_cloth.scene import assignments

        given = tuple(map(assignments.read, values["assignments"]))
        return cls(str(values["name"]), dict(values["parameters"]), given)

    def following(self, other: SceneSource) -> SceneSource:
        """This scene with parameters and assignments of `other` where it has none of its own."""
        return replace(
            self,
            parameters={**other.parameters, **self.parameters},
            assignments=(*other.assignments, *self.assignments),
        )


def names_file(word: str) -> bool:
    """True if a word names a scene file or a mesh file rather than a built-in scene."""
    from taichi_cloth.scene import library

    if word in library.names() or not word:
        return False
    # os.path.exists takes a word too long for a file's name; Path.exists does not.
    suffix = word.lower().endswith((".toml", *MESHES))
    return suffix or os.sep in word or "/" in word or os.path.exists(word)
