"""PLY: a header that declares elements and their properties, and these as text or binary.

Read here and not by a library: faces of any numbers of corners stay whole, and a refusal names the
line or the element. Turk, "The PLY Polygon File Format", 1994.
"""

from __future__ import annotations

import codecs
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from taichi_cloth.errors import InputError, clipped
from taichi_cloth.files.meshes.surface import Polygons, check_counts

TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
CORNERS = ("vertex_indices", "vertex_index")  # names of a face's list


@dataclass
class Element:
    """A kind of element: how many there are, and its properties.

    properties: (name, type of a list's length or "", type), with NumPy's names of types.
    """

    name: str
    count: int
    properties: list[tuple[str, str, str]] = field(default_factory=list)


def read(path: Path, data: bytes) -> Polygons:
    """The vertices and faces of a PLY file's bytes. Raises InputError, naming the place."""
    data = data.removeprefix(codecs.BOM_UTF8)  # which some editors put before a text
    order, elements, begin, line = _header(path, data)
    by_name = {element.name: element for element in elements}
    for name in ("vertex", "face"):
        if name not in by_name:
            raise InputError(f"{path}: has no {'vertices' if name == 'vertex' else 'faces'}")
    check_counts(path, by_name["vertex"].count, by_name["face"].count)
    for element in elements:
        if element.count > len(data):
            raise InputError(f"{path}: is cut short: it says {element.count} x '{element.name}'")
    if order:
        return _of_elements(path, _binary(path, data[begin:], order, elements), None)
    rows = data[begin:].decode("ascii", "replace").splitlines()
    return _of_elements(path, *_text(path, rows, line, elements))


# An element's properties by name: a number of each element, or of lists their lengths and, one
# after the other, their entries.
Columns = dict[str, "np.ndarray | tuple[np.ndarray, np.ndarray]"]
Values = dict[str, Columns]
# A property's name, the type of its list's length (None: it is a single number), and its type.
Kinds = list[tuple[str, "np.dtype | None", np.dtype]]


def _header(path: Path, data: bytes) -> tuple[str, list[Element], int, int]:
    """The byte order ("": text), the elements, where they begin, and the header's lines."""
    if data[:3] != b"ply" or data[3:4] not in (b"\n", b"\r"):
        raise InputError(f"{path}: is not a PLY file: it does not begin with 'ply'")
    end = data.find(b"end_header", 0, 2**20)
    # Binary data may begin with a byte of 10: what ends the first line ends the last one.
    ending = b"\r" if data[3:4] == b"\r" and data[4:5] != b"\n" else b"\n"
    after = data.find(ending, end)
    if end < 0 or after < 0:
        raise InputError(f"{path}: is cut short: its header has no 'end_header'")
    order: str | None = None
    elements: list[Element] = []
    lines = data[:end].decode("ascii", "replace").splitlines()
    for number, line in enumerate(lines, start=1):
        words = line.split()
        try:
            if not words or words[0] in ("ply", "comment", "obj_info"):
                continue
            if words[0] == "format":
                order = ORDERS[words[1]]
            elif words[0] == "element":
                elements.append(Element(words[1], int(words[2])))
                if elements[-1].count < 0:
                    raise ValueError
            elif words[0] == "property" and words[1] == "list":
                kinds = TYPES[words[2]], TYPES[words[3]]
                elements[-1].properties.append((words[4], *kinds))
            elif words[0] == "property":
                elements[-1].properties.append((words[2], "", TYPES[words[1]]))
            else:
                raise ValueError
        except (ValueError, KeyError, IndexError):
            shown = clipped(line)
            raise InputError(f"{path} line {number}: is not of a PLY header: '{shown}'") from None
    if order is None:
        raise InputError(f"{path}: is not a PLY file: its header names no format")
    return order, elements, after + 1, len(lines) + 1


def _text(
    path: Path, rows: list[str], line: int, elements: list[Element]
) -> tuple[Values, dict[str, np.ndarray]]:
    """The values of elements written as text, and each element's line; line: the header's last."""
    given = [(line + n, row.split()) for n, row in enumerate(rows, start=1) if row.strip()]
    values: Values = {}
    lines: dict[str, np.ndarray] = {}
    at = 0
    for element in elements:
        if len(given) - at < element.count:
            has = f"{len(given) - at} of {element.count}"
            raise InputError(f"{path}: is cut short: it has {has} x '{element.name}'")
        mine = given[at : at + element.count]
        at += element.count
        lines[element.name] = np.array([number for number, _ in mine], np.int64)
        values[element.name] = _text_element(path, element, mine)
    return values, lines


def _text_element(path: Path, element: Element, rows: list[tuple[int, list[str]]]) -> Columns:
    single: dict[str, list[float]] = {}
    listed: dict[str, tuple[list[int], list[float]]] = {}
    for name, length, _ in element.properties:
        if length:
            listed[name] = [], []
        else:
            single[name] = []
    for number, words in rows:
        try:
            place = 0
            for name, length, _ in element.properties:
                if not length:
                    single[name].append(float(words[place]))
                    place += 1
                    continue
                count = int(words[place])
                entries = words[place + 1 : place + 1 + count]
                if len(entries) != count:
                    raise ValueError
                listed[name][0].append(count)
                listed[name][1].extend(map(float, entries))
                place += 1 + count
            if place != len(words):
                raise ValueError
        except (ValueError, IndexError):
            shown = clipped(" ".join(words))
            raise InputError(f"{path} line {number}: is no '{element.name}': '{shown}'") from None
    return {
        **{name: np.array(column, np.float64) for name, column in single.items()},
        **{
            name: (np.array(counts, np.int64), np.array(entries, np.float64))
            for name, (counts, entries) in listed.items()
        },
    }


def _binary(path: Path, data: bytes, order: str, elements: list[Element]) -> Values:
    """The values of elements written in binary."""
    values: Values = {}
    at = 0
    for element in elements:
        values[element.name], at = _binary_element(path, data, at, order, element)
    return values


def _binary_element(
    path: Path, data: bytes, at: int, order: str, element: Element
) -> tuple[Columns, int]:
    """An element's values, and where the next one begins."""
    kinds: Kinds = [
        (name, np.dtype(order + length) if length else None, np.dtype(order + kind))
        for name, length, kind in element.properties
    ]

    def cut_short(has: int) -> InputError:
        return InputError(
            f"{path}: is cut short: it has {has} of {element.count} x '{element.name}'"
        )

    # All lists as long as those of the first element: one array of rows. The usual case.
    counts = _counts_at(data, at, kinds)
    if counts is None and element.count:
        raise cut_short(0)
    fields: list[tuple[str, np.dtype] | tuple[str, np.dtype, tuple[int]]] = []
    for n, (_, length, kind) in enumerate(kinds):
        if length is None:
            fields.append((f"{n}", kind))
        else:
            fields += [(f"length {n}", length), (f"{n}", kind, ((counts or {}).get(n, 0),))]
    row = np.dtype(fields)
    whole = (len(data) - at) // row.itemsize if row.itemsize else element.count
    table = np.frombuffer(data, row, min(whole, element.count), at)
    alike = all((table[f"length {n}"] == count).all() for n, count in (counts or {}).items())
    if not counts and len(table) < element.count:
        raise cut_short(len(table))
    if alike and len(table) == element.count:
        columns: Columns = {}
        for n, (name, length, _) in enumerate(kinds):
            if length is None:
                columns[name] = table[f"{n}"].astype(np.float64)
            else:
                columns[name] = (
                    table[f"length {n}"].astype(np.int64),
                    table[f"{n}"].ravel().astype(np.float64),
                )
        return columns, at + element.count * row.itemsize
    return _one_by_one(data, at, kinds, element, cut_short)


def _counts_at(data: bytes, at: int, kinds: Kinds) -> dict[int, int] | None:
    """The length of each list, by its property's number, of the element at a place; or None."""
    counts: dict[int, int] = {}
    for n, (_, length, kind) in enumerate(kinds):
        if length is not None:
            if at + length.itemsize > len(data):
                return None
            counts[n] = int(np.frombuffer(data, length, 1, at)[0])
            if not 0 <= counts[n] <= len(data):
                return None
            at += length.itemsize + counts[n] * kind.itemsize
        else:
            at += kind.itemsize
    return counts if at <= len(data) else None


def _one_by_one(
    data: bytes,
    at: int,
    kinds: Kinds,
    element: Element,
    cut_short: Callable[[int], InputError],
) -> tuple[Columns, int]:
    """Elements whose lists have different lengths."""
    single: dict[str, list[float]] = {name: [] for name, length, _ in kinds if length is None}
    listed: dict[str, tuple[list[int], list[np.ndarray]]] = {
        name: ([], []) for name, length, _ in kinds if length is not None
    }
    for done in range(element.count):
        counts = _counts_at(data, at, kinds)
        if counts is None:
            raise cut_short(done)
        for n, (name, length, kind) in enumerate(kinds):
            if length is None:
                single[name].append(float(np.frombuffer(data, kind, 1, at)[0]))
                at += kind.itemsize
            else:
                at += length.itemsize
                listed[name][0].append(counts[n])
                listed[name][1].append(np.frombuffer(data, kind, counts[n], at))
                at += counts[n] * kind.itemsize
    columns: Columns = {name: np.array(values, np.float64) for name, values in single.items()}
    lists: Columns = {
        name: (
            np.array(lengths, np.int64),
            np.concatenate([*entries, np.zeros(0)]).astype(np.float64),
        )
        for name, (lengths, entries) in listed.items()
    }
    return {**columns, **lists}, at


def _of_elements(path: Path, values: Values, lines: dict[str, np.ndarray] | None) -> Polygons:
    vertex, face = values["vertex"], values["face"]
    axes = [vertex.get(axis) for axis in "xyz"]
    if not all(isinstance(axis, np.ndarray) for axis in axes):
        raise InputError(f"{path}: its vertices have no x, y and z")
    found = next((face[name] for name in CORNERS if name in face), None)
    if not isinstance(found, tuple):
        raise InputError(f"{path}: its faces have no list 'vertex_indices'")
    count, corners = found
    broken = ~(np.abs(corners) < 2**62) | (corners != np.floor(corners))
    if broken.any():
        at = int(broken.argmax())
        face_at = int(np.searchsorted(np.cumsum(count), at, side="right"))
        line = "" if lines is None else f" line {lines['face'][face_at]}"
        shown = f"{corners[at]:g}"
        raise InputError(f"{path}{line}: face {face_at} has no vertex {shown}; give whole numbers")
    return Polygons(
        vertices=np.stack([a for a in axes if isinstance(a, np.ndarray)], axis=1),
        corners=corners.astype(np.int64),
        count=count,
        lines=None if lines is None else lines["face"],
        vertex_lines=None if lines is None else lines["vertex"],
    )
