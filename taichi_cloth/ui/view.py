"""A place to draw: a renderer, and a window that shows what it draws, if there is one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.render.camera import Camera
from taichi_cloth.render.picture import Picture, Rect
from taichi_cloth.render.window_map import Look
from taichi_cloth.runtime import refuse_other_threads
from taichi_cloth.scene.model import World
from taichi_cloth.ui.framing import camera_of_world
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.presenters.contract import Presenter

if TYPE_CHECKING:
    from taichi_cloth.render.renderer import Renderer


class View:
    """Draws pictures of a world, and says where the user's events come from.

    name: of the kind of presenter. camera: of a 3-D world, else None; it is read at every draw.
    room: the part of the window that the world is drawn in; None: all of it. look: which part of a
    2-D world is seen there; None: all of it. Both are read at every draw.
    text_size: of what is written around the world, in parts of the usual.
    presenter: the window; None: pictures are in memory alone. size: (width, height) of these.
    draws: whether there are any.
    """

    def __init__(
        self,
        name: str,
        world: World,
        size: tuple[int, int],
        presenter: Presenter | None = None,
        *,
        draws: bool = True,
    ):
        self.name, self.world, self._size, self._presenter = name, world, size, presenter
        self._draws = draws
        self.camera: Camera | None = camera_of_world(world)
        self.room: Rect | None = None
        self.look: Look | None = None
        self.text_size = 1.0
        self._renderer: Renderer | None = None
        self._buffer: np.ndarray | None = None
        self._drawn = False
        self._closed = False

    @property
    def visible(self) -> bool:
        """True if there is a window."""
        return self._presenter is not None

    @property
    def has_wheel(self) -> bool:
        """True if the mouse's wheel is reported."""
        return self._presenter is not None and self._presenter.has_wheel

    @property
    def closed(self) -> bool:
        """True if the window is gone."""
        return self._presenter.closed if self._presenter else self._closed

    @property
    def size(self) -> tuple[int, int]:
        """Current width and height in pixels."""
        return self._presenter.size if self._presenter else self._size

    def turn_to(self, world: World, camera: Camera | None) -> None:
        """Show another world from now on; camera: of a 3-D one."""
        self.world, self.camera, self.look = world, camera, None

    def poll(self) -> list[Event]:
        """The user's events since the last call, oldest first; RunFailure where it was cut off."""
        return self._presenter.poll() if self._presenter else []

    def entitle(self, title: str) -> None:
        """Write a title over the window, if there is one."""
        if self._presenter:
            self._presenter.entitle(title)

    def draw(self, picture: Picture) -> None:
        """Draw and present one frame."""
        if self.closed or not self._draws:
            return
        refuse_other_threads()  # kernels draw it
        renderer = self._renderer_now()
        renderer.draw(picture, self.world, self.camera, self.room, self.look)
        self._drawn = True
        if self._presenter:
            self._presenter.present(renderer)

    def _renderer_now(self) -> Renderer:
        """The renderer, made anew where the window has another size."""
        from taichi_cloth.render.renderer import Renderer  # which needs Taichi

        buffer = self._presenter.buffer if self._presenter else None
        size = self.size
        if self._renderer is None or self._renderer.size != size or buffer is not self._buffer:
            self._renderer, self._buffer = Renderer(size, buffer), buffer
        return self._renderer

    def grab(self) -> np.ndarray:
        """The frame drawn last, (height, width, 3) uint8, row 0 on top."""
        if not self._drawn or self._renderer is None:
            raise RuntimeError("nothing has been drawn yet")
        frame = self._renderer.pixels()
        return np.stack([(frame >> place).astype(np.uint8) for place in (16, 8, 0)], axis=2)

    def close(self) -> None:
        """Give the window back. May be called twice."""
        self._closed = True
        if self._presenter:
            self._presenter.close()
