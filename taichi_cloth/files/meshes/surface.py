"""What is in a file of triangles and polygons, and the checks that make a sound surface of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from taichi_cloth.errors import InputError

# Vertices and faces, which take some 500 bytes each while a mesh is made into a cloth.
LARGEST_COUNT = 2**23
# Lengths that can still be told from each other in single precision beside the mesh's size.
LARGEST_COORDINATE = 1e12
# A triangle has an area if that is more than this part of its longest edge's square.
THINNEST = 1e-12


@dataclass(frozen=True)
class Polygons:
    """Faces of three or more corners, as a file has them.

    vertices: positions, (n, 3) float64.
    corners: numbers of vertices, face after face, (c,) int64.
    count: corners of each face, (f,) int64.
    lines: the file's line of each face, (f,) int64; None: the file has no lines.
    vertex_lines: likewise of each vertex, (n,).
    """

    vertices: np.ndarray
    corners: np.ndarray
    count: np.ndarray
    lines: np.ndarray | None = None
    vertex_lines: np.ndarray | None = None


@dataclass(frozen=True)
class Surface:
    """A sound surface: no face is degenerate or there twice, and an edge has two faces at most.

    vertices: positions, (n, 3) float64; each is a corner of some face.
    triangles: numbers of vertices, (m, 3) int64, each face cut into triangles: quads along their
        shorter diagonal, larger polygons from one corner.
    quads: the faces with four corners, (q, 4) int64, in the order of `quad_triangles`.
    quad_triangles: (q, 2) int64, the two triangles that each of them is cut into.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    quads: np.ndarray
    quad_triangles: np.ndarray


def check_counts(path: Path, vertices: int, faces: int) -> None:
    """Refuse a file that says, or shows, that it has more than can be taken in."""
    for count, things in ((vertices, "vertices"), (faces, "faces")):
        if count > LARGEST_COUNT:
            raise InputError(
                f"{path}: has {count} {things}, more than {LARGEST_COUNT}; reduce the mesh"
            )


def merged(polygons: Polygons) -> Polygons:
    """The same faces with one vertex where several lie at exactly the same place.

    Vertices keep their order, each where its first one was.
    """
    # Adding 0 makes 0 of -0.
    _, first, same = np.unique(
        polygons.vertices + 0.0, axis=0, return_index=True, return_inverse=True
    )
    rank = np.argsort(np.argsort(first, kind="stable"), kind="stable")
    return Polygons(
        vertices=polygons.vertices[np.sort(first)],
        corners=rank[same.ravel()][polygons.corners].astype(np.int64),
        count=polygons.count,
        lines=polygons.lines,
    )


class _Refusal:
    """Names the place of what is wrong with a file's faces."""

    def __init__(self, path: Path, polygons: Polygons):
        self.path, self.polygons = path, polygons

    def face(self, face: int, text: str) -> NoReturn:
        lines = self.polygons.lines
        line = f" line {lines[face]}" if lines is not None else ""
        raise InputError(f"{self.path}{line}: face {face} {text}")

    def vertex(self, vertex: int, text: str) -> NoReturn:
        lines = self.polygons.vertex_lines
        line = f" line {lines[vertex]}" if lines is not None else ""
        raise InputError(f"{self.path}{line}: vertex {vertex} {text}")


def checked(path: Path, polygons: Polygons) -> Surface:
    """The surface that a file's polygons make. Raises InputError, naming the line or the face.

    Faces and vertices are numbered from 0 in messages.
    """
    refusal = _Refusal(path, polygons)
    check_counts(path, len(polygons.vertices), len(polygons.count))
    if not len(polygons.vertices):
        raise InputError(f"{path}: has no vertices")
    if not len(polygons.count):
        raise InputError(f"{path}: has no faces; a cloth's springs are the edges of faces")
    _check_vertices(polygons, refusal)
    owner = np.repeat(np.arange(len(polygons.count)), polygons.count)
    _check_corners(polygons, owner, refusal)
    _check_twice(polygons, owner, refusal)
    surface, face_of = _triangulated(polygons)
    _check_areas(surface, face_of, refusal)
    _check_edges(polygons, owner, refusal)
    used = np.zeros(len(polygons.vertices), bool)
    used[polygons.corners] = True
    if not used.all():
        refusal.vertex(int(used.argmin()), "is a corner of no face; remove loose vertices")
    return surface


def _check_vertices(polygons: Polygons, refusal: _Refusal) -> None:
    finite = np.isfinite(polygons.vertices).all(axis=1)
    if not finite.all():
        at = int(finite.argmin())
        shown = ", ".join(f"{c:g}" for c in polygons.vertices[at])
        refusal.vertex(at, f"is not finite: ({shown})")
    near = (np.abs(polygons.vertices) <= LARGEST_COORDINATE).all(axis=1)
    if not near.all():
        at = int(near.argmin())
        most = np.abs(polygons.vertices[at]).max()
        refusal.vertex(at, f"lies at {most:g}, beyond {LARGEST_COORDINATE:g}; use other units")


def _check_corners(polygons: Polygons, owner: np.ndarray, refusal: _Refusal) -> None:
    """That each face has three corners or more, all there, and no two the same."""
    if (polygons.count < 3).any():
        face = int((polygons.count < 3).argmax())
        refusal.face(face, f"has {polygons.count[face]} corners; three are the fewest")
    wrong = (polygons.corners < 0) | (polygons.corners >= len(polygons.vertices))
    if wrong.any():
        at = int(wrong.argmax())
        has = f"the mesh has 0 to {len(polygons.vertices) - 1}"
        refusal.face(int(owner[at]), f"has no vertex {polygons.corners[at]}; {has}")
    order = np.lexsort((polygons.corners, owner))
    again = (np.diff(owner[order]) == 0) & (np.diff(polygons.corners[order]) == 0)
    if again.any():
        at = order[int(again.argmax())]
        refusal.face(int(owner[at]), f"is degenerate: it has vertex {polygons.corners[at]} twice")


def _check_twice(polygons: Polygons, owner: np.ndarray, refusal: _Refusal) -> None:
    """That no two faces have the same corners."""
    start = np.concatenate([[0], np.cumsum(polygons.count)])
    for corners in np.unique(polygons.count):
        faces = np.flatnonzero(polygons.count == corners)
        rows = np.sort(polygons.corners[start[faces, None] + np.arange(corners)], axis=1)
        order = np.lexsort((faces, *rows.T))
        same = (rows[order[1:]] == rows[order[:-1]]).all(axis=1)
        if same.any():
            at = int(same.argmax())
            refusal.face(int(faces[order[at + 1]]), f"is face {faces[order[at]]} again")


def _triangulated(polygons: Polygons) -> tuple[Surface, np.ndarray]:
    """All faces as triangles, in their order, and the face that each triangle is of, (m,)."""
    x, count = polygons.vertices, polygons.count
    start = np.concatenate([[0], np.cumsum(count)])
    first = np.concatenate([[0], np.cumsum(count - 2)])
    triangles = np.empty((first[-1], 3), np.int64)
    for corners in np.unique(count):
        faces = np.flatnonzero(count == corners)
        rows = polygons.corners[start[faces, None] + np.arange(corners)]
        if corners == 4:  # from the corner at which the shorter diagonal begins
            a, b, c, d = (x[rows[:, n]] for n in range(4))
            turned = ((b - d) ** 2).sum(axis=1) < ((a - c) ** 2).sum(axis=1)
            rows[turned] = np.roll(rows[turned], -1, axis=1)
        for n in range(corners - 2):
            triangles[first[faces] + n] = rows[:, [0, n + 1, n + 2]]
    quads = np.flatnonzero(count == 4)
    surface = Surface(
        vertices=x,
        triangles=triangles,
        quads=polygons.corners[start[quads, None] + np.arange(4)].reshape(-1, 4),
        quad_triangles=first[quads, None] + np.arange(2),
    )
    return surface, np.repeat(np.arange(len(count)), count - 2)


def _check_areas(surface: Surface, face_of: np.ndarray, refusal: _Refusal) -> None:
    a, b, c = (surface.vertices[surface.triangles[:, n]] for n in range(3))
    twice = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest2 = np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    flat = ~(twice > 2 * THINNEST * longest2)
    if flat.any():
        face = int(face_of[int(flat.argmax())])
        refusal.face(face, "is degenerate: its corners lie on a line, and it has no area")


def _check_edges(polygons: Polygons, owner: np.ndarray, refusal: _Refusal) -> None:
    """That an edge has two faces at most."""
    start = np.concatenate([[0], np.cumsum(polygons.count)])
    following = np.arange(len(owner)) + 1
    following[start[1:] - 1] = start[:-1]
    ends = np.sort(np.stack([polygons.corners, polygons.corners[following]], axis=1), axis=1)
    edge = ends[:, 0] * len(polygons.vertices) + ends[:, 1]
    order = np.argsort(edge, kind="stable")
    third = edge[order[2:]] == edge[order[:-2]]
    if third.any():
        at = int(order[2 + int(third.argmax())])
        a, b = ends[at]
        text = f"is the third at the edge of vertices {a} and {b}; an edge has two faces at most"
        refusal.face(int(owner[at]), text)
