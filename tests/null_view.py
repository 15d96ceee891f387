"""A view for tests, which neither draws nor shows anything."""

from __future__ import annotations

import numpy as np

from taichi_cloth.render.camera import Camera
from taichi_cloth.render.picture import Picture, Rect
from taichi_cloth.render.window_map import Look, default_window
from taichi_cloth.scene.model import World
from taichi_cloth.ui.framing import camera_of_world
from taichi_cloth.ui.inputs import Event


class NullView:
    """A view that reports no events and draws nothing."""

    name = "none"
    visible = False
    has_wheel = False
    closed = False

    def __init__(
        self,
        world: World,
        size: tuple[int, int] | None = None,
        title: str = "",
        *,
        visible: bool = False,
    ):
        self.size = size or default_window(world.size)
        self.camera: Camera | None = camera_of_world(world)
        self.room: Rect | None = None
        self.look: Look | None = None
        self.text_size = 1.0

    def turn_to(self, world: World, camera: Camera | None) -> None:
        """Have the camera of another world."""
        self.camera, self.look = camera, None

    def poll(self) -> list[Event]:
        """No events: there is nobody to make them."""
        return []

    def entitle(self, title: str) -> None:
        """There is no window to write it over."""

    def draw(self, picture: Picture) -> None:
        """Nothing is drawn."""

    def grab(self) -> np.ndarray:
        """There is no picture: open the view with ``pictures=True`` for that."""
        raise RuntimeError("this view draws no pictures")

    def close(self) -> None:
        """There is nothing to give back."""
