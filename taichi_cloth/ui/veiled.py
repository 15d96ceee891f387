"""Ghosts as `rasterizer.py` and `painter.py` draw them: things through which one sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taichi_cloth import painter
from taichi_cloth.painter import Shapes
from taichi_cloth.rasterizer import Balls, Lines, Mesh
from taichi_cloth.ui import drawing, in_space, style
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.drawing import Cached
from taichi_cloth.ui.surfaces import Topology
from taichi_cloth.ui.views.contract import Ghost
from taichi_cloth.ui.window_map import WindowMap


def shapes(ghost: Ghost, window: WindowMap, width: float) -> list[Shapes]:
    """A ghost in a plane, in a colour that seems to be seen through; width: of lines, pixels."""
    place, color = window.to_window(ghost.position), style.packed_one(ghost.flat_color)
    shown = drawing.are_numbers(place)
    corner = place[drawing.between_shown(ghost.triangles, shown)]
    first, second = place[drawing.between_shown(ghost.segments, shown)].swapaxes(0, 1)
    seen = shown & ghost.as_spheres
    radius = np.maximum(ghost.radius[seen] * window.scale, drawing.SMALLEST_DISC)
    return [
        painter.triangles(corner, 0, color),
        painter.lines(first, second, width, color),
        painter.discs(place[seen], radius, color),
    ]


class Veils:
    """Ghosts in space; what has not changed is kept from one to the next."""

    def __init__(self) -> None:
        self._topology = Cached(Topology.build)

    def of(
        self, ghost: Ghost, camera: Camera, width: float
    ) -> tuple[list[Mesh], list[Balls], list[Lines]]:
        """What is drawn of a ghost, a little behind where it is; width: of lines, pixels."""
        eye = np.array([0.0, 0.0, camera.distance])
        position = (1 + drawing.LIFTED) * (camera.rotate_points(ghost.position) + eye)
        position = np.asarray(position, np.float32)
        shown = drawing.are_numbers(position)
        color = np.tile(np.array(style.unit(style.GHOST), np.float32), (len(position), 1))
        meshes = []
        if len(ghost.triangles):
            topology = self._topology(ghost.triangles).of_shown(shown)
            mesh = in_space.mesh(topology, camera, position, color, color, ghost.normals)
            meshes.append(replace(mesh, veil=True))
        segments = drawing.between_shown(ghost.segments, shown)
        widths = np.full(len(segments), width, np.float32)
        end, own = position[segments.reshape(-1)], color[segments[:, 0]]
        seen = shown & ghost.as_spheres
        radius = np.asarray(ghost.radius[seen], np.float32)
        balls = Balls(position[seen], radius, color[seen], veil=True)
        return meshes, [balls], [Lines(end, own, widths, -drawing.LIFTED)]
