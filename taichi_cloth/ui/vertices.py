"""What GGUI draws, as its vertex buffers: lines, discs, spheres, surfaces.

GGUI's Python layer copies Taichi fields into vertex buffers with one compiled kernel for every
field. The buffers are NumPy arrays, so they are filled here directly: nothing is compiled, and
the number of things drawn may change at every frame. They are kept: a frame fills in positions,
and colours and sizes only where these changed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from taichi_cloth.ui import drawing, style
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.surfaces import Topology, back_of, seen_normals

# Columns of a GGUI vertex: position, normal (a circle's or particle's radius in its first),
# texture, colour with its opacity.
POSITION, NORMAL, RADIUS, COLOR, ALPHA, STRIDE = slice(0, 3), slice(3, 6), 3, slice(8, 11), 11, 12

# Layers of a line in a plane: pixels wider, and share of the colour.
FADING = ((1.0, 0.3), (0.3, 0.62), (-0.4, 1.0))
PLAIN = ((0.3, 1.0),)  # which software draws in half the time
THIN = 16  # pixels up to which a row of them is one triangle: longer ones would be too sharp


def icosphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """The unit sphere as triangles: vertices (v, 3) float32 and corners (t, 3) int32."""
    p = (1 + 5**0.5) / 2
    start = [
        (-1, p, 0), (1, p, 0), (-1, -p, 0), (1, -p, 0), (0, -1, p), (0, 1, p),
        (0, -1, -p), (0, 1, -p), (p, 0, -1), (p, 0, 1), (-p, 0, -1), (-p, 0, 1),
    ]  # fmt: skip
    triangle = [
        (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4),
        (11, 10, 2), (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8),
        (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1),
    ]  # fmt: skip
    vertex: list[np.ndarray] = [np.array(v) / np.linalg.norm(v) for v in start]
    for _ in range(subdivisions):
        middles: dict[tuple[int, int], int] = {}

        def middle(a: int, b: int, middles: dict[tuple[int, int], int] = middles) -> int:
            key = (min(a, b), max(a, b))
            if key not in middles:
                point = vertex[a] + vertex[b]
                vertex.append(point / np.linalg.norm(point))
                middles[key] = len(vertex) - 1
            return middles[key]

        finer = []
        for a, b, c in triangle:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        triangle = finer
    return np.array(vertex, np.float32), np.array(triangle, np.int32)


def vertices(color: ArrayLike) -> np.ndarray:
    """Vertices (k, STRIDE) float32 in the colours (k, 3), floats 0..1, nowhere yet."""
    color = np.asarray(color)
    vertex = np.zeros((len(color), STRIDE), np.float32)
    vertex[:, COLOR], vertex[:, ALPHA] = color, 1
    return vertex


def quads(count: int) -> np.ndarray:
    """The corners, int32, of the two triangles of each of so many four vertices that go round."""
    corner = 4 * np.arange(count, dtype=np.int32)[:, None] + np.array([0, 1, 2, 0, 2, 3], np.int32)
    return corner.reshape(-1)


def rectangles(corner: np.ndarray, color: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rectangles of whole pixels as triangles: points (v, 2) in pixels, their vertices (v, STRIDE)
    float32, nowhere yet, and the triangles' corners (3t,) int32.

    corner: (k, 4) x0, y0, x1, y1. color: (k, 3), floats 0..1. First are those that two triangles
    make. What is a pixel wide or high, and no longer than THIN, is one: around the middles of its
    pixels and of no others. Letters have thousands of these, and software takes some 0.5 µs for a
    triangle, however small it is.
    """
    size = corner[:, 2:] - corner[:, :2]
    thin = (size.min(axis=1) == 1) & (size.max(axis=1) <= THIN)
    rows, columns = thin & (size[:, 1] == 1), thin & (size[:, 1] > 1)
    x0, y0, x1, y1 = corner[~thin].T
    corners = np.stack([x0, y0, x1, y0, x1, y1, x0, y1], axis=1)
    points: list[np.ndarray] = [corners.reshape(-1, 2)]
    for chosen, along in ((rows, 0), (columns, 1)):
        begin, end = corner[chosen][:, along], corner[chosen][:, along + 2]
        side = corner[chosen][:, 1 - along]
        first, last = begin - 0.25, end + 0.25
        ends = np.stack([first, side - 0.4, first, side + 1.4, last, side + 0.5], axis=1)
        points.append(ends.reshape(-1, 2)[:, :: 1 if along == 0 else -1])
    place = np.concatenate(points)
    colors = [
        color[~thin].repeat(4, axis=0),
        *(color[c].repeat(3, axis=0) for c in (rows, columns)),
    ]
    wide = quads(len(points[0]) // 4)
    index = np.concatenate([wide, np.arange(len(points[0]), len(place), dtype=np.int32)])
    return place, vertices(np.concatenate(colors)), index


class Triangles:
    """Triangles that are drawn together, in the order in which they were added."""

    def __init__(self) -> None:
        self._parts: list[tuple[np.ndarray, np.ndarray]] = []
        self._count = 0

    def add(self, vertex: np.ndarray, index: np.ndarray) -> None:
        """Add those of the vertices (k, STRIDE) float32 whose numbers are in index (3m,) int32."""
        self._parts.append((vertex, index + self._count if self._count else index))
        self._count += len(vertex)

    def taken(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Their vertices and numbers, once; nothing where there are none."""
        parts, self._parts, self._count = self._parts, [], 0
        if sum(len(index) for _, index in parts):
            vertex, index = zip(*parts, strict=True)
            yield (
                (vertex[0], index[0])
                if len(parts) == 1
                else (np.concatenate(vertex), np.concatenate(index))
            )


@dataclass
class FlatLines:
    """Lines of a plane as one mesh of quads. From frame to frame only the positions are filled in.

    They lie in layers, the widest and faintest first, so that their edges fade: what GGUI draws in
    a plane does not blend.
    vertex: (layers, count, 4, STRIDE). index: of the triangles' corners. half: (layers,), half of
    their widths in pixels.
    """

    vertex: np.ndarray
    index: np.ndarray
    half: np.ndarray

    @classmethod
    def build(
        cls, color: np.ndarray, width: float, layers: tuple[tuple[float, float], ...] = FADING
    ) -> FlatLines:
        """Lines without positions.

        color: (count, 3), floats 0..1. width: in pixels. layers: how many pixels each is wider, and
        its share of the colour.
        """
        ground = np.array(style.unit(style.WORLD))
        vertex = np.zeros((len(layers), len(color), 4, STRIDE), np.float32)
        vertex[..., ALPHA] = 1
        for layer, (_, share) in zip(vertex, layers, strict=True):
            layer[..., COLOR] = (ground + share * (color - ground))[:, None]
        wide = np.maximum([width + more for more, _ in layers], 1.0)
        return cls(vertex, quads(len(layers) * len(color)), 0.5 * wide)

    def fill(self, ends: np.ndarray, size: tuple[int, int]) -> None:
        """Put the lines at their ends (2 count, 2), on a canvas of this size in pixels."""
        first, second = ends[0::2], ends[1::2]
        along = (second - first) * size
        length = np.sqrt(np.einsum("ij,ij->i", along, along))
        along /= np.maximum(length, np.finfo(np.float32).tiny)[:, None]
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / size
        for layer, half in zip(self.vertex, self.half, strict=True):
            side = half * normal
            for corner, place in enumerate(
                (first - side, second - side, second + side, first + side)
            ):
                layer[:, corner, :2] = place


def disc_vertices(
    radius: np.ndarray, color: np.ndarray, scale: float, height: int, plain: bool = False
) -> np.ndarray:
    """Vertices (layers, n, STRIDE), nowhere yet, of the particles' rims and, to be drawn over
    them, of their discs; the edges of both fade in two steps, unless they are plain.

    radius: (n,) world units. color: (n, 3) uint8. scale: pixels per world unit.
    height: of the window in pixels.
    """
    ground = np.array(style.unit(style.WORLD))
    (rim, dark), (disc, full) = drawing.disc_layers(radius, color, scale)
    layers: tuple[tuple[np.ndarray, np.ndarray], ...] = ((rim, dark), (disc, full))
    if not plain:
        layers = (
            (rim + 0.4, 0.5 * dark + 0.5 * ground),
            (rim - 0.2, dark),
            (disc + 0.4, 0.5 * (dark + full)),
            (disc - 0.2, full),
        )
    vertex = vertices(np.concatenate([rgb for _, rgb in layers]))
    vertex[:, RADIUS] = np.concatenate([pixels for pixels, _ in layers]) / height
    return vertex.reshape(len(layers), -1, STRIDE)


@dataclass
class LineMesh:
    """Lines as one mesh of strips that face us and fade towards their sides: GGUI's own lines have
    steps. From frame to frame only the positions are filled in anew.

    A strip has three vertices at each end: faded, full, faded, from one side to the other. Software
    takes as long for a triangle as for hundreds of pixels, so there are no more.
    vertex: (count, 2, 3, STRIDE). index: of the triangles' corners.
    color: (count, 3) floats 0..1, which the vertices have; None: none yet.
    """

    vertex: np.ndarray
    index: np.ndarray
    color: np.ndarray | None = None

    @classmethod
    def build(cls, count: int) -> LineMesh:
        """Meshes without colours and positions."""
        vertex = np.zeros((count, 2, 3, STRIDE), np.float32)
        vertex[..., NORMAL] = style.LIGHT  # where we look from they are as bright as their colour
        quad = np.concatenate([np.array([0, 1, 4, 0, 4, 3]) + n for n in range(2)])
        index = (6 * np.arange(count)[:, None] + quad).astype(np.int32).reshape(-1)
        return cls(vertex, index)

    def fill(
        self,
        ends: np.ndarray,
        color: np.ndarray,
        width: float,
        focal: float,
        distance: float,
        *,
        bright: float = 1.0,
    ) -> None:
        """Put the lines at their ends (count, 2, 3), in camera axes, with z from what is looked at.

        color: (count, 3), floats 0..1. width: in pixels, as wide as they seem to be: a strip that
        fades from its middle to its sides is twice as wide.
        focal: pixels per unit of slope. distance: from the eye to what is looked at.
        bright: that the lights give what faces the first of them; colours are divided by it.
        """
        if self.color is not color:
            self.vertex[..., COLOR] = (color / bright)[:, None, None, :]
            self.vertex[..., 1, ALPHA] = 1
            self.color = color
        depth = ends[..., 2] + np.float32(distance)
        seen = ends[..., :2] / depth[..., None]
        along = seen[:, 1] - seen[:, 0]
        length = np.sqrt(np.einsum("ij,ij->i", along, along))
        along /= np.maximum(length, np.finfo(along.dtype).tiny)[:, None]
        side = depth * np.float32(width / focal)  # world units
        aside = np.stack([-along[:, 1], along[:, 0]], axis=1)[:, None] * side[..., None]
        self.vertex[..., POSITION] = ends[:, :, None]
        self.vertex[:, :, 0, 0:2] -= aside
        self.vertex[:, :, 2, 0:2] += aside


@dataclass
class SphereMeshes:
    """Spheres as one mesh. From frame to frame only the positions are filled in anew.

    count, level: of spheres; of their subdivisions.
    unit: (v, 3), the unit sphere. vertex: (count, v, STRIDE). index: of the triangles' corners.
    color: (count, 3) uint8, which the vertices have; None: none yet.
    """

    count: int
    level: int
    unit: np.ndarray
    vertex: np.ndarray
    index: np.ndarray
    color: np.ndarray | None = None

    @classmethod
    def build(cls, count: int, level: int) -> SphereMeshes:
        """Meshes without colours and positions."""
        unit, corner = icosphere(level)
        vertex = np.zeros((count, len(unit), STRIDE), np.float32)
        vertex[:, :, NORMAL] = unit
        vertex[:, :, ALPHA] = 1
        index = corner.reshape(-1) + (len(unit) * np.arange(count, dtype=np.int32))[:, None]
        return cls(count, level, unit, vertex, np.ascontiguousarray(index.reshape(-1), np.int32))

    def fill(self, centre: np.ndarray, radius: np.ndarray, color: np.ndarray) -> None:
        """Put the spheres at `centre` (count, 3); radius (count,); color (count, 3) uint8."""
        if self.color is None or not np.array_equal(self.color, color):
            self.vertex[:, :, COLOR] = (color / 255)[:, None, :]
            self.color = color.copy()
        centre, radius = centre.astype(np.float32), radius.astype(np.float32)
        self.vertex[:, :, POSITION] = centre[:, None, :] + radius[:, None, None] * self.unit


@dataclass
class SurfaceMesh:
    """A surface as one mesh, whose vertices are there twice: of the front, and of the back.

    A triangle takes its corners from the side that faces us, so each side has its own colour, and
    normals that point to us. vertex: (2n, STRIDE), the front's first.
    color: (n, 3) uint8, which the vertices have; None: none yet.
    """

    vertex: np.ndarray
    color: np.ndarray | None = None

    @classmethod
    def build(cls, count: int) -> SurfaceMesh:
        """A mesh of `count` particles, without colours and positions."""
        return cls(vertices(np.zeros((2 * count, 3))))

    def fill(
        self,
        topology: Topology,
        camera: Camera,
        position: np.ndarray,
        color: np.ndarray,
        normal: np.ndarray | None,
        *,
        two_sided: bool,
        one_layer: bool = False,
    ) -> np.ndarray:
        """Put the surface at `position`; the numbers of its triangles' corners, int32.

        position: (n, 3) float32 camera axes. color: (n, 3) uint8, of the front. normal: (n, 3),
        unit normals in the world's axes; None: they are computed here.
        two_sided: whether the back has a colour of its own. one_layer: whether one sees through it,
        but not the layers behind the first: nearer triangles come first, so the depth buffer keeps
        those off.
        """
        count = len(position)
        front, back = self.vertex[:count], self.vertex[count:]
        if self.color is not color:
            front[:, COLOR] = color / 255
            back[:, COLOR] = (back_of(color) if two_sided else color) / 255
            self.color = color
        face = topology.face_normals(position)
        normal = seen_normals(topology, camera, position, face, normal)
        front[:, POSITION] = back[:, POSITION] = position
        front[:, NORMAL], back[:, NORMAL] = normal, -normal
        side = np.where(topology.faces_us(position, face, camera.distance), 0, count).astype(
            np.int32
        )
        corners: np.ndarray = topology.triangles + side[:, None]
        if one_layer:
            depth = position[:, 2].take(topology.triangles).sum(axis=1)
            corners = corners[np.argsort(depth, kind="stable")]
        return corners.reshape(-1)


def floor_vertices(
    corner: np.ndarray, color: np.ndarray, opacity: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (4t, STRIDE) of a floor's tiles, and the numbers of their triangles' corners.

    corner: (t, 4, 3) camera axes. color: (t, 4, 3) floats 0..1. opacity: (t, 4). normal: (3,).
    """
    vertex = vertices(color.reshape(-1, 3))
    vertex[:, POSITION], vertex[:, NORMAL] = corner.reshape(-1, 3), normal
    vertex[:, ALPHA] = opacity.reshape(-1)
    index = 4 * np.arange(len(corner), dtype=np.int32)[:, None] + np.array([0, 1, 2, 0, 2, 3])
    return vertex, index.astype(np.int32).reshape(-1)


def ghost_colors(count: int) -> np.ndarray:
    """The colours of a ghost's particles, (count, 3) uint8."""
    return np.tile(np.array(style.GHOST, np.uint8), (count, 1))


def ghost_lines(count: int, width: float, color: tuple[int, ...]) -> FlatLines:
    """So many springs of a ghost in a plane, of a width in pixels."""
    return FlatLines.build(np.tile(style.unit(color), (count, 1)), width)


def flat_lines(
    color: np.ndarray,
    segments: np.ndarray,
    given: tuple[int, int, int] | np.ndarray | None,
    walls: int,
    width: float,
    plain: bool = False,
) -> FlatLines:
    """Walls and then springs, of a width in pixels, whose edges fade unless they are plain; for the
    rest `spring_colors`.
    """
    springs = style.spring_colors(color, segments, given)
    of_walls = np.tile(style.unit(style.WALL), (walls, 1))
    return FlatLines.build(np.concatenate([of_walls, springs]), width, PLAIN if plain else FADING)
