"""GLB, the binary form of glTF 2.0: all meshes of its scene joined, each moved as the scene says.

Khronos Group, "glTF 2.0 Specification", 4.4 (12 bytes of header: 'glTF', version, length). The
scene's graph, buffers and kinds of primitive are read by trimesh.
"""

from __future__ import annotations

import logging
import struct
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError, clipped
from taichi_cloth.files.meshes.surface import Polygons, check_counts, merged

HEADER = 12


def read(path: Path, data: bytes) -> Polygons:
    """The triangles of a GLB file's bytes. Raises InputError."""
    if data[:4] != b"glTF":
        raise InputError(f"{path}: is not a GLB file: it does not begin with 'glTF'")
    if len(data) < HEADER:
        raise InputError(f"{path}: is cut short: it has {len(data)} bytes")
    version, length = struct.unpack("<II", data[4:HEADER])
    if version != 2:
        raise InputError(f"{path}: is of glTF version {version}; export it as version 2")
    if length > len(data):
        raise InputError(f"{path}: is cut short: it says {length} bytes and has {len(data)}")
    meshes = _placed(path, data)
    if not meshes:
        raise InputError(f"{path}: has no faces; a cloth's springs are the edges of faces")
    first = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    corners = [faces + begin for (_, faces), begin in zip(meshes, first[:-1], strict=True)]
    joined = np.concatenate(corners).astype(np.int64)
    check_counts(path, int(first[-1]), len(joined))
    polygons = Polygons(
        vertices=np.concatenate([vertices for vertices, _ in meshes]),
        corners=joined.ravel(),
        count=np.full(len(joined), 3, np.int64),
    )
    wrong = (joined < 0) | (joined >= first[-1])
    return polygons if wrong.any() else merged(polygons)


def _placed(path: Path, data: bytes) -> list[tuple[np.ndarray, np.ndarray]]:
    """Vertices (n, 3) and triangles (m, 3) of each mesh of the scene, in the scene's places."""
    import io

    import trimesh

    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # the refusal says it, in one line
    try:
        # Raw: with `process`, vertices would be merged within rounding and faces dropped.
        scene: Any = trimesh.load_scene(io.BytesIO(data), file_type="glb", process=False)
        found = []
        for node in sorted(scene.graph.nodes_geometry):
            transform, name = scene.graph[node]
            mesh = scene.geometry[name]
            if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
                continue
            vertices = np.asarray(mesh.vertices, np.float64)
            moved = vertices @ np.asarray(transform)[:3, :3].T + np.asarray(transform)[:3, 3]
            found.append((moved, np.asarray(mesh.faces, np.int64)))
        return found
    except Exception as error:  # whatever a library makes of what somebody's file has
        what = clipped(f"{type(error).__name__}: {error}", 120)
        raise InputError(f"{path}: is damaged, or not a GLB file: {what}") from None
