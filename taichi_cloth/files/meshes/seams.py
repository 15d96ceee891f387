"""Seams of a surface: where borders come near each other without being joined, and joining them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.files.meshes.ears import cut
from taichi_cloth.files.meshes.surface import Polygons, Surface, checked, components

# A border's vertex is near another border within this part of its shortest edge there.
NEAR = 0.25


@dataclass(frozen=True)
class Welded:
    """A surface whose seams are joined.

    surface: vertices and triangles of what is joined; joined vertices lie in their middle.
    joined: the surface's vertex that each of the file's is, (n,) int64, without those that are left
        out. number: the numbers that these have in the file, (n,).
    corners: which of them are at the corners of the surface's triangles, (m, 3) int64.
    """

    surface: Surface
    joined: np.ndarray
    number: np.ndarray
    corners: np.ndarray


@dataclass(frozen=True, eq=False)
class FilePoints:
    """The vertices that mesh files have, of which welding made one particle of several.

    particle: of each point, (p,) int64. corners: the points at the corners of the surfaces'
    triangles, (m, 3) int64.
    """

    particle: np.ndarray
    corners: np.ndarray

    @property
    def first(self) -> np.ndarray:
        """The first point of each particle, (n,)."""
        points: np.ndarray = np.unique(self.particle, return_index=True)[1]
        return points

    @classmethod
    def of_sheets(
        cls, listed: np.ndarray, count: int, sheets: Sequence[FilePoints]
    ) -> FilePoints | None:
        """Those of `count` particles by themselves, then of sheets; listed: triangles
        (m, 3) that come first, by particles. None where each particle has one.
        """
        points, corners, size = [np.arange(count)], [np.zeros((0, 3), np.int64)], count
        for sheet in sheets:
            corners.append(sum(map(len, points)) + sheet.corners)
            points.append(size + sheet.particle)
            size += len(sheet.first)
        whole = cls(np.concatenate(points), np.concatenate(corners))
        if len(whole.particle) == size:
            return None
        return cls(whole.particle, np.concatenate([whole.first[listed], whole.corners]))


@dataclass(frozen=True)
class Gaps:
    """Vertices of borders that lie near others, or near the edges of others.

    pairs: (p, 2) vertices, the smaller first; apart: their distances, (p,).
    at_edges: (t, 4) a vertex, both ends of the edge, the edge's triangle; off: their distances (t,)
    and along: how far along the edge, in (0, 1).
    """

    pairs: np.ndarray
    apart: np.ndarray
    at_edges: np.ndarray
    off: np.ndarray
    along: np.ndarray


def gaps(surface: Surface, reach: float | np.ndarray) -> Gaps:
    """Find borders nearer to each other than `reach`, one length or one of each vertex."""
    from scipy.spatial import cKDTree

    x = surface.vertices
    edges, face = _borders(surface)
    rim = np.unique(edges)
    reach = np.broadcast_to(np.asarray(reach, np.float64), (len(x),))
    none = np.zeros(0)
    if not len(rim):
        return Gaps(np.zeros((0, 2), np.int64), none, np.zeros((0, 4), np.int64), none, none)
    tree, most = cKDTree(x[rim]), float(reach[rim].max())
    pairs = np.sort(rim[tree.query_pairs(most, output_type="ndarray")], axis=1).reshape(-1, 2)
    apart = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    near = apart <= np.minimum(reach[pairs[:, 0]], reach[pairs[:, 1]])
    order = np.lexsort(pairs[near].T[::-1])
    pairs, apart = pairs[near][order], apart[near][order]
    # Vertices in the ball around an edge, then those near the edge itself, and away from its ends.
    a, b = x[edges[:, 0]], x[edges[:, 1]]
    length = np.linalg.norm(b - a, axis=1)
    found = tree.query_ball_point((a + b) / 2, length / 2 + most, return_sorted=True)
    of = np.repeat(np.arange(len(edges)), [len(one) for one in found])
    vertex = rim[np.concatenate([np.asarray(one, np.int64) for one in found])]
    p = x[vertex]
    along = ((p - a[of]) * (b - a)[of]).sum(axis=1) / length[of] ** 2
    off = np.linalg.norm(p - a[of] - along[:, None] * (b - a)[of], axis=1)
    ends = np.minimum(np.linalg.norm(p - a[of], axis=1), np.linalg.norm(p - b[of], axis=1))
    own = (surface.triangles[face[of]] == vertex[:, None]).any(axis=1)
    beside = (off <= reach[vertex]) & (ends > reach[vertex]) & (along > 0) & (along < 1) & ~own
    at = np.column_stack([vertex, edges[of], face[of]])[beside]
    order = np.lexsort((at[:, 3], at[:, 0]))
    return Gaps(pairs, apart, at[order], off[beside][order], along[beside][order])


def usual_reach(surface: Surface) -> np.ndarray:
    """The reach of a border's vertex for a seam, by its shortest edge there, (n,)."""
    edges = _borders(surface)[0]
    length = np.linalg.norm(np.diff(surface.vertices[edges], axis=1)[:, 0], axis=1)
    shortest = np.full(len(surface.vertices), np.inf)
    np.minimum.at(shortest, edges[:, 0], length)
    np.minimum.at(shortest, edges[:, 1], length)
    return np.where(np.isfinite(shortest), NEAR * shortest, 0.0)


def _borders(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """The edges with one triangle, (b, 2) as it goes round them, and that triangle, (b,)."""
    edges, first, count = _edges(surface.triangles, len(surface.vertices))
    alone = np.sort(first[count == 1])
    return edges[alone], alone // 3


def _edges(triangles: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The sides of triangles (m, 3) between n vertices as they go round, (3 m, 2); of each edge, by
    its vertices, the first of these that is one, (e,); and how many there are, (e,).
    """
    sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2)
    key = sides.min(axis=1) * n + sides.max(axis=1)
    _, first, count = np.unique(key, return_index=True, return_counts=True)
    return sides, first, count


def welded(path: Path, surface: Surface, weld: float, scale: float = 1.0) -> Welded:
    """The surface with borders joined where they are no farther apart than `weld`, a length once
    the surface is scaled: a vertex to vertices, else to the edges near it, which end there then.

    InputError for a length that joins vertices of one face, or leaves no sound surface.
    """
    found = gaps(surface, weld / scale)
    n = len(surface.vertices)
    count, group = components(found.pairs, n)
    first = np.full(count, n)
    np.minimum.at(first, group, np.arange(n))
    one = first[group]  # of each vertex, the first of those that it is joined to
    corners, of = _split(surface, found, one)
    _check_faces(surface, one, weld, scale)
    vertices = surface.vertices.copy()
    offset = surface.vertices - surface.vertices[one]
    moved = np.stack([np.bincount(one, column, n) for column in offset.T], axis=1)
    vertices += moved / np.maximum(np.bincount(one, minlength=n), 1)[:, None]
    rows = one[corners]
    _check_edges(rows, surface.number, weld)
    polygons = Polygons(vertices, rows.ravel(), np.full(len(rows), 3, np.int64))
    try:
        whole = checked(path, polygons, loose=True)
    except InputError as error:
        raise InputError(f"weld {weld:g} makes no sound surface: {error}") from None
    turned = (whole.triangles != rows).any(axis=1)
    corners[turned] = corners[turned][:, [0, 2, 1]]
    used, number = np.unique(one, return_inverse=True)
    # Quads stay where neither of their triangles was split.
    parts = np.bincount(of, minlength=len(surface.triangles))
    start = np.concatenate([[0], np.cumsum(parts)])
    kept = (parts[surface.quad_triangles] == 1).all(axis=1)
    joined = number.ravel().astype(np.int64)
    result = replace(
        whole,
        vertices=vertices[used],
        triangles=joined[whole.triangles],
        quads=joined[surface.quads[kept]],
        quad_triangles=start[surface.quad_triangles[kept]],
        notes=surface.notes,
    )
    return Welded(result, joined, surface.number, corners)


def closed(path: Path, surface: Surface) -> Surface:
    """The surface, closed where its borders lie at exactly the same place, as a writer parts a body
    where textures begin; unchanged where that does not close it.
    """
    if surface.is_closed():
        return surface
    try:
        whole = welded(path, surface, 0.0).surface
    except InputError:  # what is joined is no sound surface
        return surface
    joined = len(surface.vertices) - len(whole.vertices)
    if not whole.is_closed():
        return surface
    lie = "vertex that lies" if joined == 1 else "vertices that lie"
    note = f"{joined} {lie} exactly on others are joined to them, and the body is closed"
    return replace(whole, notes=(*surface.notes, note))


def _split(surface: Surface, found: Gaps, one: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The triangles, those whose edges have vertices beside them cut there; and of which triangle
    each is, (m,). Corners are vertices of the file.
    """
    at, along = found.at_edges, found.along
    other = (one[at[:, :1]] != one[surface.triangles[at[:, 3]]]).all(axis=1)
    at, along = at[other], along[other]  # not a corner's, by way of what that is joined to
    # Of vertices that are one, an edge takes the first.
    key = np.column_stack([at[:, 1:3], one[at[:, 0]]])
    _, chosen = np.unique(key, axis=0, return_index=True)
    at, along = at[chosen], along[chosen]
    rows = [row[None] for row in surface.triangles]
    x = surface.vertices
    for face in np.unique(at[:, 3]).tolist():
        ring: list[int] = []
        place: list[np.ndarray] = []
        a, b, c = surface.triangles[face].tolist()
        for begin, end in ((a, b), (b, c), (c, a)):
            on = np.flatnonzero((at[:, 1] == begin) & (at[:, 2] == end))
            on = on[np.argsort(along[on], kind="stable")]
            ring += [begin, *at[on, 0].tolist()]
            # Cut as if they lay on the edge: no triangle is between the edge and its vertices.
            place += [x[begin], *(x[begin] + along[on, None] * (x[end] - x[begin]))]
        rows[face] = np.array(ring)[cut(np.array(place))]
    of = np.repeat(np.arange(len(rows)), [len(row) for row in rows])
    return np.concatenate(rows), of


def _check_faces(surface: Surface, one: np.ndarray, weld: float, scale: float) -> None:
    """That no face has two corners that are joined."""
    t = surface.triangles
    edges = np.stack([t, np.roll(t, -1, axis=1)], axis=-1).reshape(-1, 2)
    same = one[edges[:, 0]] == one[edges[:, 1]]
    if same.any():
        a, b = edges[int(same.argmax())]
        length = scale * np.linalg.norm(surface.vertices[a] - surface.vertices[b])
        raise InputError(
            f"weld {weld:g} joins vertices {surface.number[a]} and {surface.number[b]} of one "
            f"face; give less than {min(weld, length):.3g}"
        )


def _check_edges(triangles: np.ndarray, number: np.ndarray, weld: float) -> None:
    """That no edge of triangles (m, 3) has more than two of them; number: the vertices' own."""
    sides, first, count = _edges(triangles, len(number))
    many = first[count > 2]
    if len(many):
        a, b = number[np.sort(sides[many[0]])]
        at = "at the edge" if len(many) == 1 else f"at {len(many)} edges, the first"
        raise InputError(
            f"weld {weld:g} joins three faces or more {at} of vertices {a} and {b}, and an edge "
            "has two at most; move the third panel away and tie it by [[springs]], or leave it out"
        )
