"""Wavefront OBJ: lines of text, vertices (`v`) and faces (`f`) of any number of corners.

Read here and not by a library: a refusal names the line, polygons stay whole, and a vertex keeps
its number, also where textures or normals part the corners that meet in it. Lines of other kinds
are passed over, and so is what follows a '#'; a note names kinds that are not textures, normals,
groups, materials and the like. Wavefront, "Advanced Visualizer Manual", appendix B1.
"""

from __future__ import annotations

import codecs
from pathlib import Path

import numpy as np

from taichi_cloth.errors import InputError, clipped, counted
from taichi_cloth.files.meshes.surface import Polygons, check_counts

# Beginnings of lines that say nothing about positions and faces: they are passed over unsaid.
KNOWN = {
    *("vt", "vn", "vp", "g", "o", "s", "mg", "usemtl", "mtllib", "usemap", "maplib", "l", "p"),
    *("bevel", "c_interp", "d_interp", "lod", "shadow_obj", "trace_obj"),
}
FACES = ("f", "fo")  # `fo` is what earlier versions of the format called them
MOST_KINDS = 5  # that a note names


def read(path: Path, data: bytes) -> Polygons:
    """The vertices and faces of an OBJ file's bytes. Raises InputError, naming the line."""
    if b"\0" in data:
        raise InputError(f"{path}: is not an OBJ file: it is binary")
    reader = _Reader(path)
    joined = ""
    # Of bytes: a text's lines would end at form feeds and U+2028, too, in the midst of comments.
    for number, read_line in enumerate(data.removeprefix(codecs.BOM_UTF8).splitlines(), start=1):
        line = read_line.decode("utf-8", "replace")
        text = joined + line.partition("#")[0]  # a comment that ends in '\' joins nothing
        joined = ""
        if text.endswith("\\"):
            joined = text[:-1] + " "
        elif words := text.split():
            reader.line(number, words)
    if words := joined.split():  # of a last line that says that another one follows
        reader.line(number, words)
    if not reader.known:
        raise InputError(f"{path}: is not an OBJ file: it has no line of vertices or faces")
    return reader.polygons()


class _Reader:
    """Takes an OBJ file's lines, one by one."""

    def __init__(self, path: Path):
        self.path, self.known = path, False
        self.vertices: list[tuple[float, float, float]] = []
        self.vertex_lines: list[int] = []
        self.corners: list[int] = []
        self.count: list[int] = []
        self.lines: list[int] = []
        self.others: dict[str, int] = {}  # lines of kinds that are not known
        self.first_other = 0

    def line(self, number: int, words: list[str]) -> None:
        kind = words[0]
        if kind == "v":
            self.known = True
            self.vertex(number, words)
        elif kind in FACES:
            self.known = True
            self.face(number, words)
        elif kind not in KNOWN:
            self.others[kind] = self.others.get(kind, 0) + 1
            self.first_other = self.first_other or number

    def vertex(self, number: int, words: list[str]) -> None:
        try:
            x, y, z = map(float, words[1:4])
        except ValueError:
            raise InputError(
                f"{self.path} line {number}: a vertex has three numbers, not "
                f"'{clipped(' '.join(words[1:]))}'"
            ) from None
        self.vertices.append((x, y, z))
        self.vertex_lines.append(number)
        if len(self.vertices) % 2**16 == 0:
            check_counts(self.path, len(self.vertices), 0)

    def face(self, number: int, words: list[str]) -> None:
        so_far = len(self.vertices)
        try:
            corners = [int(word.partition("/")[0]) for word in words[1:]]
        except ValueError:
            raise InputError(
                f"{self.path} line {number}: a face has numbers of vertices, not "
                f"'{clipped(' '.join(words[1:]))}'"
            ) from None
        if len(corners) < 3:
            raise InputError(
                f"{self.path} line {number}: face {len(self.count)} has {len(corners)} corners; "
                "three are the fewest"
            )
        if not all(1 <= corner < 2**62 or -so_far <= corner < 0 for corner in corners):
            self.refuse_corner(number, corners)
        # From 1; negative: back from the last one so far.
        self.corners += [c - 1 if c > 0 else so_far + c for c in corners]
        self.count.append(len(corners))
        self.lines.append(number)

    def refuse_corner(self, number: int, corners: list[int]) -> None:
        so_far = len(self.vertices)
        wrong = next(c for c in corners if not (1 <= c < 2**62 or -so_far <= c < 0))
        raise InputError(
            f"{self.path} line {number}: face {len(self.count)} has no vertex "
            f"{clipped(str(wrong))}; an OBJ file counts them from 1, or back from -1"
        )

    def polygons(self) -> Polygons:
        vertices = np.array(self.vertices, np.float64).reshape(-1, 3)
        corners = np.array(self.corners, np.int64)
        beyond = corners >= len(vertices)
        if beyond.any():  # in the file's own numbers
            at = int(beyond.argmax())
            face = int(np.searchsorted(np.cumsum(self.count), at, side="right"))
            raise InputError(
                f"{self.path} line {self.lines[face]}: face {face} has no vertex "
                f"{corners[at] + 1}; the file has 1 to {len(vertices)}"
            )
        return Polygons(
            vertices=vertices,
            corners=corners,
            count=np.array(self.count, np.int64),
            lines=np.array(self.lines, np.int64),
            vertex_lines=np.array(self.vertex_lines, np.int64),
            notes=self.notes(),
        )

    def notes(self) -> tuple[str, ...]:
        """A note on lines of kinds that are not known."""
        if not self.others:
            return ()
        shown = [f"'{clipped(kind)}'" for kind in list(self.others)[:MOST_KINDS]]
        more = len(self.others) - len(shown)
        kinds = ", ".join(shown) + (f" and {more} more" if more else "")
        count = counted(sum(self.others.values()), "line")
        return (f"{count} of kinds that are not read: {kinds}, from line {self.first_other} on",)
