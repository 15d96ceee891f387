"""Triangles and polygons of a file, and the checks that make a sound surface of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NoReturn

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.files.meshes.ears import crosses, cut

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
    notes: what a reader has to say, a clause each.
    """

    vertices: np.ndarray
    corners: np.ndarray
    count: np.ndarray
    lines: np.ndarray | None = None
    vertex_lines: np.ndarray | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Surface:
    """A sound surface: no face is degenerate or there twice, and an edge has two faces at most.

    vertices: positions, (n, 3) float64; each is a corner of some face.
    left_out: numbers of the file's vertices that are a corner of none, (l,) int64, rising.
    triangles: numbers of vertices, (m, 3) int64, each face cut into triangles: quads along their
        shorter diagonal that lies inside, larger polygons from a corner, or ear by ear. All are
        wound alike where that can be (a Moebius strip cannot), as most of the file's are.
    quads: the convex faces with four corners, (q, 4) int64.
    quad_triangles: (q, 2) int64, the two triangles that each of them is cut into.
    notes: what the file's reader has to say of it, a clause each.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    quads: np.ndarray
    quad_triangles: np.ndarray
    notes: tuple[str, ...] = ()
    left_out: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    @property
    def number(self) -> np.ndarray:
        """The numbers that its vertices have in the file, (n,)."""
        return np.delete(np.arange(len(self.vertices) + len(self.left_out)), self.left_out)

    def is_closed(self) -> bool:
        """True if each edge has two faces: then the surface is a body's."""
        begin, end = self.triangles.ravel(), np.roll(self.triangles, -1, axis=1).ravel()
        return bool((np.unique(_edge_keys(begin, end), return_counts=True)[1] == 2).all())

    def parts(self) -> int:
        """The number of parts that no edge joins."""
        ends = self.triangles[:, [0, 1, 1, 2]].reshape(-1, 2)
        return int(components(ends, len(self.vertices))[0])


def check_counts(path: Path, vertices: int, faces: int) -> None:
    """Refuse a file that says, or shows, that it has more than can be taken in."""
    for count, things in ((vertices, "vertices"), (faces, "faces")):
        if count > LARGEST_COUNT:
            raise InputError(
                f"{path}: has {count} {things}, more than {LARGEST_COUNT}; reduce the mesh"
            )


def merged(polygons: Polygons) -> Polygons:
    """The same faces with one vertex where several lie at exactly the same place, and without
    vertices that no face has.

    Vertices keep their order, each where its first one was.
    """
    used, corners = np.unique(polygons.corners, return_inverse=True)
    vertices = polygons.vertices[used]
    # Adding 0 makes 0 of -0.
    _, first, same = np.unique(vertices + 0.0, axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first, kind="stable"), kind="stable")
    return Polygons(
        vertices=vertices[np.sort(first)],
        corners=rank[same.ravel()][corners.ravel()].astype(np.int64),
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


def checked(path: Path, polygons: Polygons, loose: bool = False) -> Surface:
    """The surface that a file's polygons make. Raises InputError, naming the line or the face.

    Vertices that are corners of no face are left out, and a note says so; loose: they stay. Faces
    and vertices are numbered from 0 in messages.
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
    _check_twice(polygons, refusal)
    _check_lengths(polygons, owner, refusal)
    surface, face_of, crossing = _triangulated(polygons)
    _check_areas(surface, face_of, refusal)
    _check_edges(polygons, owner, refusal)
    surface = replace(surface, triangles=_wound_alike(surface.triangles))
    used = np.zeros(len(polygons.vertices), bool)
    used[polygons.corners] = True
    notes = [*polygons.notes, *_crossing_note(polygons, crossing)]
    if not (loose or used.all()):
        surface = _without(surface, used)
        notes.append(_left_out_note(polygons, surface.left_out))
    return replace(surface, notes=tuple(notes))


def _without(surface: Surface, used: np.ndarray) -> Surface:
    """A surface of those vertices alone that are used, (n,) bool."""
    number = np.cumsum(used) - 1
    return replace(
        surface,
        vertices=surface.vertices[used],
        triangles=number[surface.triangles],
        quads=number[surface.quads],
        left_out=np.flatnonzero(~used),
    )


def _left_out_note(polygons: Polygons, left_out: np.ndarray) -> str:
    first = f"vertex {left_out[0]}{_line(polygons.vertex_lines, left_out)}"
    if len(left_out) == 1:
        return f"{first} is a corner of no face, and is left out"
    return (
        f"{len(left_out)} vertices are corners of no face, and are left out: the first is {first}"
    )


def _crossing_note(polygons: Polygons, crossing: np.ndarray) -> Iterator[str]:
    """A clause on faces that cross themselves, by their numbers, if there are any."""
    if len(crossing) == 0:
        return
    first, cross = (
        f"face {crossing[0]}{_line(polygons.lines, crossing)}",
        "1 face crosses or meets itself",
    )
    if len(crossing) > 1:
        first, cross = f"the first is {first}", f"{len(crossing)} faces cross or meet themselves"
    yield f"{cross}, and no cut into triangles is right there: {first}; part it"


def _line(lines: np.ndarray | None, which: np.ndarray) -> str:
    """The line of the first of some faces or vertices, in brackets; "": the file has none."""
    return "" if lines is None else f" (line {lines[which[0]]})"


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


def _check_twice(polygons: Polygons, refusal: _Refusal) -> None:
    """That no two faces have the same corners."""
    # Sums of numbers drawn for vertices are equal where corners are, and hardly ever elsewhere.
    number = np.random.default_rng(0).integers(2**63, size=len(polygons.vertices), dtype=np.uint64)
    start = np.concatenate([[0], np.cumsum(polygons.count)])
    for corners in np.unique(polygons.count):
        faces = np.flatnonzero(polygons.count == corners)
        rows = polygons.corners[start[faces, None] + np.arange(corners)]
        sums = np.sort(number[rows].sum(axis=1))
        if not (sums[1:] == sums[:-1]).any():
            continue
        rows = np.sort(rows, axis=1)
        order = np.lexsort((faces, *rows.T))
        same = (rows[order[1:]] == rows[order[:-1]]).all(axis=1)
        if same.any():
            at = int(same.argmax())
            refusal.face(int(faces[order[at + 1]]), f"is face {faces[order[at]]} again")


def _triangulated(polygons: Polygons) -> tuple[Surface, np.ndarray, np.ndarray]:
    """All faces as triangles, in their order, the face that each triangle is of, (m,), and the
    faces that cross themselves.
    """
    x, count = polygons.vertices, polygons.count
    start = np.concatenate([[0], np.cumsum(count)])
    first = np.concatenate([[0], np.cumsum(count - 2)])
    triangles = np.empty((first[-1], 3), np.int64)
    quads, convex = np.zeros((0, 4), np.int64), np.zeros(0, np.int64)
    crossing = []
    for corners in np.unique(count):
        faces = np.flatnonzero(count == corners)
        rows = polygons.corners[start[faces, None] + np.arange(corners)]
        n = np.arange(corners - 2)
        fan = np.stack([0 * n, n + 1, n + 2], axis=1)
        if corners == 4:
            turned, whole = _diagonals(x[rows])
            quads, convex = rows[whole], faces[whole]
            rows[turned] = np.roll(rows[turned], -1, axis=1)
        triangles[first[faces, None] + n] = rows[:, fan]
        folds = _folds(x[rows])
        for f in np.flatnonzero(folds | _winds(x[rows])) if corners > 3 else ():
            cuts = cut(x[rows[f]]) if corners > 4 and folds[f] else fan
            triangles[first[faces[f]] : first[faces[f] + 1]] = rows[f][cuts]
            if crosses(x[rows[f]], cuts):
                crossing.append(int(faces[f]))
    surface = Surface(
        vertices=x,
        triangles=triangles,
        quads=quads,
        quad_triangles=first[convex, None] + np.arange(2),
    )
    return surface, np.repeat(np.arange(len(count)), count - 2), np.sort(crossing)


def _normals(x: np.ndarray) -> np.ndarray:
    """The normals of the triangles of which polygons (f, c, 3) are cut from their first corner,
    (f, c - 2, 3), as long as twice their areas.
    """
    spokes = x[:, 1:] - x[:, :1]
    normals: np.ndarray = np.cross(spokes[:, :-1], spokes[:, 1:])
    return normals


def _folds(x: np.ndarray) -> np.ndarray:
    """Which polygons (f, c, 3) have a triangle that faces the other way, so cut; (f,) bool."""
    normals = _normals(x)
    folds: np.ndarray = ((normals * normals.sum(axis=1, keepdims=True)).sum(axis=2) <= 0).any(
        axis=1
    )
    return folds


def _winds(x: np.ndarray) -> np.ndarray:
    """Which polygons (f, c, 3) go more than once around their first corner; (f,) bool."""
    spokes = x[:, 1:] - x[:, :1]
    along = (spokes[:, :-1] * spokes[:, 1:]).sum(axis=2)
    angles = np.arctan2(np.linalg.norm(_normals(x), axis=2), along)
    winds: np.ndarray = angles.sum(axis=1) > 2 * np.pi
    return winds


def _diagonals(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which quads (f, 4, 3) are cut from the second corner instead of the first, and which are
    convex: either diagonal lies inside them; (f,) bool each.
    """
    here, there = _folds(x), _folds(np.roll(x, -1, axis=1))
    shorter = ((x[:, 1] - x[:, 3]) ** 2).sum(axis=1) < ((x[:, 0] - x[:, 2]) ** 2).sum(axis=1)
    return np.where(here == there, shorter, here), ~here & ~there


def _edge_keys(begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """A number for each pair of vertices, (e,), the same whichever is first."""
    keys: np.ndarray = np.minimum(begin, end) * LARGEST_COUNT + np.maximum(begin, end)
    return keys


def components(ends: np.ndarray, count: int) -> tuple[int, np.ndarray]:
    """Count the parts of `count` things that the pairs `ends` (e, 2) leave, and name each one's."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    joined = coo_array((np.ones(len(ends), bool), tuple(ends.T)), shape=(count, count))
    found: tuple[int, np.ndarray] = connected_components(joined, directed=False)
    return found


def _wound_alike(triangles: np.ndarray) -> np.ndarray:
    """The triangles, some turned over, so that neighbours agree which side is which.

    Each triangle stands twice, as it is and turned over; neighbours join those that agree. A part
    that can be wound alike then falls into two, of which the one with more as they are is taken.
    """
    m = len(triangles)
    begin, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    edge = _edge_keys(begin, end)
    order = np.argsort(edge, kind="stable")
    shared = np.flatnonzero(edge[order[1:]] == edge[order[:-1]])
    one, other = order[shared], order[shared + 1]
    f, g = one // 3, other // 3
    against = (begin[one] == begin[other]) * m  # both go along the edge the same way
    if not against.any():
        return triangles
    pairs = np.concatenate(
        [np.stack([f, g + against], axis=1), np.stack([f + m, g + m - against], axis=1)]
    )
    count, part = components(pairs, 2 * m)
    as_they_are = np.bincount(part[:m], minlength=count)
    turned = as_they_are[part[:m]] < as_they_are[part[m:]]
    # Of two as large ones the first triangle's own.
    even = (as_they_are[part[:m]] == as_they_are[part[m:]]) & (part[:m] > part[m:])
    flip = turned | even
    alike: np.ndarray = triangles.copy()
    alike[flip] = alike[flip][:, [0, 2, 1]]
    return alike


def _check_areas(surface: Surface, face_of: np.ndarray, refusal: _Refusal) -> None:
    a, b, c = (surface.vertices[surface.triangles[:, n]] for n in range(3))
    twice = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest2 = np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    flat = ~(twice > 2 * THINNEST * longest2)
    if flat.any():
        face = int(face_of[int(flat.argmax())])
        refusal.face(face, "is degenerate: its corners lie on a line, and it has no area")


def _following(polygons: Polygons) -> np.ndarray:
    """The vertex that follows each corner in its face, (c,)."""
    start = np.concatenate([[0], np.cumsum(polygons.count)])
    following = np.arange(len(polygons.corners)) + 1
    following[start[1:] - 1] = start[:-1]
    vertices: np.ndarray = polygons.corners[following]
    return vertices


def _check_lengths(polygons: Polygons, owner: np.ndarray, refusal: _Refusal) -> None:
    """That no two corners that follow each other lie at one place."""
    a, b = polygons.corners, _following(polygons)
    none = (polygons.vertices[a] == polygons.vertices[b]).all(axis=1)
    if none.any():
        at = int(none.argmax())
        text = f"is degenerate: its vertices {a[at]} and {b[at]} lie at one place"
        refusal.face(int(owner[at]), text)


def _check_edges(polygons: Polygons, owner: np.ndarray, refusal: _Refusal) -> None:
    """That an edge has two faces at most."""
    ends = np.sort(np.stack([polygons.corners, _following(polygons)], axis=1), axis=1)
    edge = ends[:, 0] * len(polygons.vertices) + ends[:, 1]
    order = np.argsort(edge, kind="stable")
    third = edge[order[2:]] == edge[order[:-2]]
    if third.any():
        at = int(order[2 + int(third.argmax())])
        a, b = ends[at]
        text = f"is the third at the edge of vertices {a} and {b}; an edge has two faces at most"
        refusal.face(int(owner[at]), text)
