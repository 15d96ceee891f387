"""Which scene is meant: a built-in one with its parameters, or a scene file."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from taichi_cloth.settings.options import flag_words

if TYPE_CHECKING:
    import numpy as np

    from taichi_cloth.scene.model import Scene

# What reads and builds scenes is imported in functions: it takes NumPy, and with that longer than
# all the rest of a start that only prints help.

DEFAULT_SCENE = "cloth"


@dataclass(frozen=True)
class SceneSource:
    """Where a scene comes from, before it is built.

    name: of a built-in scene, or of a scene file.
    parameters: values of the built-in scene's parameters, by name; the rest have their defaults.
    """

    name: str = DEFAULT_SCENE
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_file(self) -> bool:
        return names_file(self.name)

    def build(self) -> Scene:
        """The scene, checked. Raises InputError where there is none, or it cannot be simulated."""
        from taichi_cloth.scene import library, scenefile
        from taichi_cloth.scene.checks import mark_checked

        if self.is_file:
            return mark_checked(scenefile.load(self.name))
        return mark_checked(library.build(self.name, **self.parameters))

    def solution(self) -> Callable[..., tuple[np.ndarray, np.ndarray]] | None:
        """What gives the scene's closed form at given times; None without one."""
        from taichi_cloth.scene import library

        return None if self.is_file else library.solution(self.name)

    def words(self) -> list[str]:
        """The scene and its parameters, as one would write them after a command."""
        return [self.name, *flag_words(self.parameters)]


def names_file(word: str) -> bool:
    """Whether a word names a scene file rather than a built-in scene."""
    from taichi_cloth.scene import library

    if word in library.names() or not word:
        return False
    # os.path.exists takes a word too long for a file's name; Path.exists does not.
    return word.endswith(".toml") or os.sep in word or "/" in word or os.path.exists(word)
