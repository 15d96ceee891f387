"""Surfaces as they are seen: their normals, and how bright they are.

All is in the camera's axes (x right, y down, z away from us), so lights stay where we are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taichi_cloth.render import style

TILES = 24  # of a floor, at most so many along each side


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

    def unit_normals(self, position: np.ndarray) -> np.ndarray:
        """Unit normals of the particles, (n, 3): of the sum of their triangles'; 0 without any."""
        return self.normals(position, self.face_normals(position))


def brightness(normal: np.ndarray) -> np.ndarray:
    """The brightness of surfaces of unit normals (..., 3) under all lights, (...,) from 0 on."""
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


def floor_tiles(radius: float) -> tuple[float, float]:
    """The side of a floor's tiles, and how far it reaches, where so much is to be seen on it."""
    reach = 4.0 * radius
    return nice_length(2 * reach / TILES), reach


def nice_length(length: float) -> float:
    """The next length of 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(next(power * n for n in (1, 2, 5, 10) if power * n >= 0.999 * length))
