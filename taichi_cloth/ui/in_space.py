"""What `rasterizer.py` draws of a world in space: surfaces, lights, a floor, seen by a camera."""

from __future__ import annotations

import numpy as np

from taichi_cloth.rasterizer import Floor, Mesh
from taichi_cloth.ui import shade, style, surfaces
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.surfaces import Topology
from taichi_cloth.ui.views.contract import Picture


def mesh(
    topology: Topology,
    camera: Camera,
    place: np.ndarray,
    front: np.ndarray,
    back: np.ndarray,
    normal: np.ndarray | None,
) -> Mesh:
    """A surface as it is drawn.

    place: (n, 3), from the eye in camera axes. front, back: (n, 3) floats 0..1. normal: (n, 3),
    unit normals in the world's axes; None: they are computed here.
    """
    place = place.astype(np.float32)
    if normal is None:
        normal = topology.normals(place, topology.face_normals(place))
    else:
        normal = normal.astype(np.float32) @ camera.rotation().T.astype(np.float32)
    return Mesh(place, np.ascontiguousarray(normal), topology.triangles, front, back)


def lights(count: int) -> np.ndarray:
    """The first lights as they are drawn with, (count + 1, 4)."""
    lights = [[*light, strength] for light, strength in style.LIGHTS[:count]]
    return np.array([*lights, [0.0, 0.0, 0.0, style.AMBIENT]], np.float32)


def floor(picture: Picture, camera: Camera) -> Floor | None:
    """The floor of a picture, as it is drawn; None: there is none to be seen."""
    height = picture.ground
    if height is None or not camera.is_above(height):
        return None
    side, reach = surfaces.floor_tiles(camera.radius)
    up, along, across = camera.rotation()[:, [1, 0, 2]].T
    eye = camera.eye
    bright = surfaces.brightness(up)
    return Floor(
        above=float(eye[1] - height),
        axes=(up, along, across),
        eye=(eye[0], eye[2]),
        middle=(camera.centre[0], camera.centre[2]),
        side=side,
        reach=reach,
        colors=(
            bright * np.array(style.unit(style.TILES[0])),
            bright * np.array(style.unit(style.TILES[1])),
        ),
        shade=shade.of(picture, height, camera),
    )


def cut(ends: np.ndarray, parts: int) -> np.ndarray:
    """Lines (k, 2, 3) cut into equal `parts`, (k * parts, 2, 3)."""
    t = np.linspace(0, 1, parts + 1)[:, None]
    points = ends[:, None, 0] * (1 - t) + ends[:, None, 1] * t
    return np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3)
