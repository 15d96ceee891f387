"""A mesh file as scenes take it: vertices and triangles, checked."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taichi_cloth.files import meshes
from taichi_cloth.files.meshes.seams import closed
from taichi_cloth.files.meshes.surface import Surface
from taichi_cloth.settings import accepted


def read(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """The vertices, (n, 3) float64, and triangles, (m, 3) int64, of an OBJ, PLY, STL or GLB file.

    Polygons are cut into triangles. A sound surface: finite vertices, each a corner of some
    triangle; no triangle without an area or there twice; two at most at an edge.

    Raises InputError, one line with the file and the line or face in it, for anything else.
    """
    surface = meshes.read(accepted.path("meshfile.read: path", path))
    return surface.vertices, surface.triangles


def read_body(path: Path) -> Surface:
    """The surface of a body in a file of such a mesh, as `read` has it; one that is parted where
    textures begin is closed there, and a note says so.
    """
    return closed(path, meshes.read(path))
