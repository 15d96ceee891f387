"""Surfaces as they are seen: normals, which side of a triangle faces us, and how bright it is.

All is in the camera's axes (x right, y down, z away from us), so lights stay where we are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from taichi_cloth.ui import style
from taichi_cloth.ui.camera import Camera

TILES = 24  # of a floor, at most so many along each side


@dataclass(frozen=True)
class Solid:
    """The surface of something that is no cloth: closed, seen from outside.

    vertex: (k, dim) world units. triangles: (m, 3) int, counterclockwise seen from outside.
    color: (k, 3) uint8.
    """

    vertex: np.ndarray
    triangles: np.ndarray
    color: np.ndarray


@dataclass(frozen=True)
class Topology:
    """Triangles, and in what order their normals are added up at their corners.

    triangles: (m, 3) int32. corner: (3m,) the triangles in the order of the particles at their
    corners. first: (c,) where each particle's triangles begin in it. particle: (c,) its number.
    """

    triangles: np.ndarray
    corner: np.ndarray
    first: np.ndarray
    particle: np.ndarray

    @classmethod
    def build(cls, triangles: np.ndarray) -> Topology:
        """The topology of `triangles` (m, 3) int."""
        flat = triangles.reshape(-1)
        order = np.argsort(flat, kind="stable")
        particle, first = np.unique(flat[order], return_index=True)
        return cls(np.ascontiguousarray(triangles, np.int32), order // 3, first, particle)

    def of_shown(self, shown: np.ndarray) -> Topology:
        """That of the triangles whose corners are all shown; shown: (n,) bool."""
        whole = shown[self.triangles].all(axis=1)
        return self if whole.all() else Topology.build(self.triangles[whole])

    def face_normals(self, position: np.ndarray) -> np.ndarray:
        """Normals of the triangles, (m, 3), as long as twice their area."""
        first, second, third = position.take(self.triangles.T, axis=0)
        a, b = second - first, third - first
        face: np.ndarray = np.empty_like(a)  # three times as fast as np.cross
        for x, y, z in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            face[:, x] = a[:, y] * b[:, z] - a[:, z] * b[:, y]
        return face

    def normals(self, position: np.ndarray, face: np.ndarray) -> np.ndarray:
        """Unit normals of the particles, (n, 3): of the sum of their triangles'; 0 without any.

        face: (m, 3), the triangles' own.
        """
        normal = np.zeros_like(position)
        if len(self.first):
            total = np.add.reduceat(face.take(self.corner, axis=0), self.first, axis=0)
            length = np.sqrt(np.einsum("ij,ij->i", total, total))[:, None]
            normal[self.particle] = total / np.maximum(length, np.finfo(total.dtype).tiny)
        return normal

    def faces_us(self, position: np.ndarray, face: np.ndarray, distance: float) -> np.ndarray:
        """Which triangles turn their front to the eye, at (0, 0, -distance); (m,) bool."""
        corner = position.take(self.triangles[:, 0], axis=0)
        towards = np.einsum("ij,ij->i", face, corner) + distance * face[:, 2]
        front: np.ndarray = towards < 0
        return front


def brightness(normal: np.ndarray) -> np.ndarray:
    """How bright a surface of the unit normals (..., 3) is under all lights, (...,) from 0 on."""
    lit: np.ndarray = np.full(normal.shape[:-1], style.AMBIENT, normal.dtype)
    for light, strength in style.LIGHTS:
        lit += strength * np.maximum(normal @ light.astype(normal.dtype), 0)
    return lit


def back_of(color: np.ndarray) -> np.ndarray:
    """The colours (n, 3) uint8 that the back of a surface has whose front has these."""
    usual, other = (np.array(lining, np.float64) for lining in style.BACKS)
    hue = color / np.maximum(color.sum(axis=1, keepdims=True), 1)
    like = np.abs(hue - usual / usual.sum()).max(axis=1, keepdims=True) < style.SAME_HUE
    mixed = style.BACK_SHARE * color + (1 - style.BACK_SHARE) * np.where(like, other, usual)
    return np.asarray(mixed, np.uint8)


def seen_normals(
    topology: Topology,
    camera: Camera,
    position: np.ndarray,
    face: np.ndarray,
    known: np.ndarray | None,
) -> np.ndarray:
    """Unit normals (n, 3) in the camera's axes.

    position: (n, 3) and face: (m, 3) in these, too. known: (n, 3), the normals in the world's axes;
    None: they are not known yet.
    """
    if known is None:
        return topology.normals(position, face)
    turned: np.ndarray = known.astype(np.float32) @ camera.rotation().T.astype(np.float32)
    return turned


def floor(
    height: float, centre: ArrayLike, radius: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A floor of tiles in two shades, which fades out around what is looked at.

    height: its y. centre: (3,) world units, what is looked at. radius: of what is to be seen there.

    Returns corners (t, 4, 3) in world units, their colours (t, 4, 3), floats 0..1, and their
    opacities (t, 4).
    """
    side, reach = floor_tiles(radius)
    centre = np.asarray(centre, np.float64)
    first = np.floor((centre[[0, 2]] - reach) / side).astype(int)
    count = int(np.ceil(2 * reach / side)) + 1
    i, j = np.divmod(np.arange(count * count), count)
    corner = (np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) + np.stack([i, j], 1)[:, None]) + first
    place = np.full((len(i), 4, 3), float(height))
    place[:, :, [0, 2]] = corner * side
    odd = (corner[:, 0].sum(axis=1) % 2)[:, None, None]
    color = np.where(odd, style.unit(style.TILES[0]), style.unit(style.TILES[1]))
    away = np.linalg.norm(place[:, :, [0, 2]] - centre[[0, 2]], axis=2) / reach
    opacity = np.clip(1.25 * (1 - away**2), 0, 1)
    seen = opacity.max(axis=1) > 0
    return place[seen], np.broadcast_to(color, place.shape)[seen], opacity[seen]


def floor_tiles(radius: float) -> tuple[float, float]:
    """The side of a floor's tiles, and how far it reaches, where so much is to be seen on it."""
    reach = 4.0 * radius
    return nice_length(2 * reach / TILES), reach


def nice_length(length: float) -> float:
    """The next length of 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(next(power * n for n in (1, 2, 5, 10) if power * n >= 0.999 * length))
