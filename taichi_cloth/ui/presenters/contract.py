"""The declaration of a presenter, and the methods of all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.ui.inputs import Event

if TYPE_CHECKING:
    from taichi_cloth.render.renderer import Renderer


class Presenter(Protocol):
    """A window that shows images, and from which the user's events come.

    closed: whether it is gone. has_wheel: whether it reports the mouse's wheel.
    """

    closed: bool
    has_wheel: bool

    @property
    def size(self) -> tuple[int, int]:
        """Current width and height in pixels."""

    @property
    def buffer(self) -> np.ndarray | None:
        """The pixels that it shows, (h, w) uint32, 0xRRGGBB; None: it takes a renderer's image."""

    def poll(self) -> list[Event]:
        """The user's events since the last call, oldest first; RunFailure where it was cut off."""

    def entitle(self, title: str) -> None:
        """Write a title over it."""

    def present(self, renderer: Renderer) -> None:
        """Show what a renderer drew last."""

    def close(self) -> None:
        """Give the window back. May be called twice."""


def no_display() -> str | None:
    """Why no window can open here, whatever draws it; None: one can."""
    if runtime.display_available():
        return None
    return "there is no display (is DISPLAY set, and is its X server running?)"


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of presenter.

    name: the file's name, and a word of the command line's `--view`.
    rank: `--view auto` takes the first that can open here, and is not `avoided`.
    lack: why it cannot open here, in words for the user; None: it can.
    avoided: why `auto` leaves it out here, though it can open; None: it does not.
    open: opens a window of a size (width, height) and a title; RuntimeError where a display or
        driver fails after all. None: there is no window.
    """

    name: str
    rank: int
    lack: Callable[[], str | None]
    avoided: Callable[[], str | None] = lambda: None
    open: Callable[[tuple[int, int], str], Presenter] | None
