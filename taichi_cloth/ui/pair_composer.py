"""Two worlds beside each other in a GGUI window, each cut off at the line between them.

GGUI has one camera and one scene a window, and no part of it of its own: what is in space is moved
aside with its depth, as for any room of a window, and cut (`clipping.py`) before it is drawn.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from taichi_cloth.scene.model import World
from taichi_cloth.ui.camera import Camera
from taichi_cloth.ui.chrome.layout import Rect
from taichi_cloth.ui.clipping import Edge, clipped
from taichi_cloth.ui.composer import Composer
from taichi_cloth.ui.vertices import POSITION
from taichi_cloth.ui.views.contract import Half, Picture
from taichi_cloth.ui.window_map import WindowMap


class CutComposer(Composer):
    """Draws one of two worlds. edge: where it ends; None: nowhere."""

    def __init__(self, window: Any) -> None:
        super().__init__(window)
        self.edge: Edge | None = None
        self._camera: Camera | None = None

    def put(self, picture: Picture, world: World, camera: Camera | None, window: WindowMap) -> None:
        """Draw a picture's world, up to the edge."""
        self._camera = camera
        super().put(picture, world, camera, window)
        self._draw_triangles()

    def share(self, other: CutComposer) -> None:
        """Draw into the same scene as another one."""
        self._canvas, self._scene = other._canvas, other._scene

    def _on_canvas(self, vertex: np.ndarray) -> np.ndarray:
        """How far vertices of the canvas are beyond the edge, (k,)."""
        assert self.edge is not None
        return self.edge.beyond(self._size[0] * vertex[:, 0])

    def _in_space(self, vertex: np.ndarray) -> np.ndarray:
        """How far vertices in camera axes are beyond the edge, times their depth, (k,)."""
        assert self.edge is not None
        assert self._camera is not None
        focal = np.float32(self._camera.focal_length * self._map.scale)
        depth = vertex[:, POSITION][:, 2] + np.float32(self._camera.distance)
        aside = np.float32(self.edge.x - self._size[0] / 2)
        beyond: np.ndarray = focal * vertex[:, 0] - aside * depth
        return -beyond if self.edge.right else beyond

    def _triangles(self, vertex: np.ndarray, index: np.ndarray) -> None:
        super()._triangles(*clipped(vertex, index, self._on_canvas(vertex)))

    def _circles(self, vertex: np.ndarray) -> None:
        super()._circles(vertex[self._on_canvas(vertex) <= 0])

    def _mesh_3d(self, vertex: np.ndarray, index: np.ndarray) -> None:
        super()._mesh_3d(*clipped(vertex, index, self._in_space(vertex)))

    def _lines_3d(self, vertex: np.ndarray, width: float) -> None:
        there = (self._in_space(vertex) <= 0).reshape(-1, 2).all(axis=1)
        super()._lines_3d(vertex[there.repeat(2)], width)


class PairComposer:
    """Draws pictures of two worlds beside each other into a GGUI window."""

    def __init__(self, window: Any) -> None:
        self._left, self._right = (CutComposer(window) for _ in range(2))
        self._over = Composer(window)
        self._right.share(self._left)

    def compose(
        self,
        picture: Picture,
        half: Half,
        world: World,
        camera: Camera | None,
        window: WindowMap,
    ) -> None:
        """Draw a picture and the half beside it; the rest as for a `Composer`."""
        room = window.room or Rect(0, 0, *window.window)
        middle = (room.x + room.width + half.room.x) / 2
        self._left.edge, self._right.edge = Edge(middle, right=False), Edge(middle, right=True)
        self._left.put(picture, world, camera, window)
        self._right.put(half.picture, world, camera, replace(window, room=half.room))
        self._left.show(picture, camera)
        self._over.over(picture, window)
        self._over.over(replace(picture, overlay=(), pointer=half.picture.pointer), window)
