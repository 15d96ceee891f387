"""Files of triangles and polygons, a format a file: OBJ, PLY, STL, GLB; none knows a scene.

`read` finds the format by the file's suffix, and refuses in one line, with the file and the line or
the face, what is no sound surface (`surface.checked`).
"""

from __future__ import annotations

import hashlib
import importlib
from pathlib import Path
from typing import TYPE_CHECKING
from weakref import WeakValueDictionary

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.files.content import content

if TYPE_CHECKING:
    from taichi_cloth.files.meshes.surface import Polygons, Surface

# Each suffix is the module that reads it: `read(path, data)` gives `Polygons`.
FORMATS = ("obj", "ply", "stl", "glb")
# Surfaces that somebody still holds, by format and content: while it is, none is made twice.
_HELD: WeakValueDictionary[tuple[str, bytes], Surface] = WeakValueDictionary()


def format_of(path: Path) -> str:
    """The format that a file's suffix names. Raises InputError for one that is not read."""
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in FORMATS:
        known = [f".{name}" for name in FORMATS]
        hint = nearest(f".{suffix}", known) if suffix else f"known: {', '.join(known)}"
        raise InputError(f"{path}: is no mesh that can be read, by its suffix; {hint}")
    return suffix


def read(path: Path) -> Surface:
    """The surface in the file at `path`, checked.

    Vertices that lie at exactly the same place are one vertex in STL, which has no other way to
    say so, and in GLB, which parts them where textures or shading change. In OBJ and PLY vertices
    keep their numbers.

    Raises InputError for a file that cannot be read, that is too large (`LARGEST` of
    `files.content`), that is not of the format which its suffix names, or that has no sound
    surface.
    """
    from taichi_cloth.files.meshes.surface import checked  # with NumPy: not at a start

    name = format_of(path)
    data = content(path, "mesh")
    if not data.strip():
        raise InputError(f"{path}: is empty; a mesh has vertices and faces")
    known = name, hashlib.sha256(data).digest()
    surface = _HELD.get(known)
    if surface is None:
        reader = importlib.import_module(f"{__name__}.{name}")
        polygons: Polygons = reader.read(path, data)
        surface = _HELD[known] = checked(path, polygons)
    return surface
