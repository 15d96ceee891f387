"""STL: triangles without numbered vertices, as text or binary; equal corners become one vertex.

3D Systems, "Stereolithography Interface Specification", 1989. Binary: 80 bytes of header, the
number of triangles, and 50 bytes for each.
"""

from __future__ import annotations

import codecs
import struct
from pathlib import Path

import numpy as np

from taichi_cloth.errors import InputError, clipped, counted
from taichi_cloth.files.meshes.surface import Polygons, check_counts, merged

HEADER = 84
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# Words of lines of text beside "vertex".
AROUND = {"solid", "facet", "outer", "endloop", "endfacet", "endsolid"}


def read(path: Path, data: bytes) -> Polygons:
    """The triangles of an STL file's bytes. Raises InputError, naming the line or the facet."""
    said = struct.unpack("<I", data[80:HEADER])[0] if len(data) >= HEADER else -1
    # Binary files may begin with the word of text ones; their length tells.
    if len(data) == HEADER + said * FACET.itemsize:
        return _binary(path, data, said)
    data = data.removeprefix(codecs.BOM_UTF8)  # which some editors put before a text
    if data.lstrip()[:5].lower() == b"solid" and b"\0" not in data[:HEADER]:
        return _text(path, data)
    if said < 0:
        raise InputError(f"{path}: is not an STL file: it has {len(data)} bytes")
    has, more = divmod(len(data) - HEADER, FACET.itemsize)
    amiss = "is cut short" if has < said else "goes on past its end"
    after = f" and {counted(more, 'byte')}" if has >= said and more else ""
    raise InputError(
        f"{path}: {amiss}, or not an STL file: its header says {said} triangles, and there "
        f"is room for {has}{after}"
    )


def _binary(path: Path, data: bytes, count: int) -> Polygons:
    check_counts(path, 0, count)
    facets = np.frombuffer(data, FACET, count, HEADER)
    return _of_triangles(path, facets["corners"].astype(np.float64), None)


def _text(path: Path, data: bytes) -> Polygons:
    corners: list[list[float]] = []
    lines: list[int] = []
    ended = False
    for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), start=1):
        words = line.split()
        kind = words[0].lower() if words else ""
        if kind == "vertex":
            try:
                x, y, z = map(float, words[1:])
            except ValueError:
                raise InputError(
                    f"{path} line {number}: a vertex has three numbers, not "
                    f"'{clipped(' '.join(words[1:]))}'"
                ) from None
            corners.append([x, y, z])
            if len(corners) % 3 == 1:
                lines.append(number)
        elif kind and kind not in AROUND:
            shown = clipped(words[0])
            raise InputError(f"{path} line {number}: is not of an STL file: '{shown}'")
        elif kind == "endloop" and len(corners) % 3:
            raise InputError(f"{path} line {number}: a facet has three vertices")
        ended = ended or kind == "endsolid"
    if not ended:
        raise InputError(f"{path}: is cut short: there is no 'endsolid'")
    if len(corners) % 3:
        raise InputError(f"{path} line {lines[-1]}: a facet has three vertices")
    points = np.array(corners, np.float64).reshape(-1, 3, 3)
    return _of_triangles(path, points, np.array(lines, np.int64))


def _of_triangles(path: Path, points: np.ndarray, lines: np.ndarray | None) -> Polygons:
    """Triangles of corners (f, 3, 3), which meet where these are equal."""
    finite = np.isfinite(points).all(axis=(1, 2))
    if not finite.all():
        face = int(finite.argmin())
        where = f" line {lines[face]}" if lines is not None else ""
        raise InputError(f"{path}{where}: face {face} has a corner that is not finite")
    return merged(
        Polygons(
            vertices=points.reshape(-1, 3),
            corners=np.arange(3 * len(points)),
            count=np.full(len(points), 3, np.int64),
            lines=lines,
        )
    )
