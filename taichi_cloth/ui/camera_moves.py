"""Moves of the camera of a 3-D scene: turn, pan, zoom, frame what there is, go back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.render.camera import Camera
from taichi_cloth.ui.inputs import ORBIT

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation

DEGREES_A_PIXEL = 0.1  # while ctrl is held
DEGREES_A_DRAG = 0.3  # a pixel that is dragged
ZOOM_STEP = 1.1  # factor a wheel notch or key press
STRAY = 0.02  # share of the particles at each end of an axis that may have flown off
FAR = 1.0  # in diagonals of the box of all others: what is farther from it has
MOST_POSES = 100  # that one can go back


class CameraMoves:
    """Moves a camera, and knows its poses before each move.

    home: its pose at the start. drags: what the button that is down does (`inputs.DRAGS`,
    `ORBIT`); None: nothing.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera, self.home = camera, camera.pose
        self._poses: list[tuple[float, ...]] = []
        self._last = ""  # the move that goes on while nothing else is done
        self.drags: str | None = None

    def memory(self) -> tuple[tuple[float, ...], list[tuple[float, ...]], str, str | None]:
        """Its pose, those before, and what goes on; `recall` takes it."""
        return self._camera.pose, self._poses, self._last, self.drags

    def recall(
        self, memory: tuple[tuple[float, ...], list[tuple[float, ...]], str, str | None]
    ) -> None:
        """Go back to such a memory."""
        self._camera.pose, self._poses, self._last, self.drags = memory

    def _note(self, move: str) -> None:
        """Remember the pose before a move that is not the last one going on."""
        if move != self._last:
            self._poses = [*self._poses[-MOST_POSES:], self._camera.pose]
        self._last = move

    @property
    def zooms(self) -> bool:
        """True if what was done last was to come nearer, or farther."""
        return self._last == "zoom"

    def zoom(self, notches: float, about: tuple[float, ...] | None = None) -> None:
        """Come nearer by so many notches. about: to which point (3,); None: what is looked at."""
        self._note("zoom")
        self._camera.zoom(ZOOM_STEP ** float(np.clip(notches, -100, 100)), about)

    def turn(self, pixels: np.ndarray) -> None:
        """Turn so that the side that faces us follows the pointer, which moved by pixels (2,).

        Beyond a pole it goes against it to the side, as in the original program and its logs.
        """
        self._note("turn")
        self._turn(pixels * DEGREES_A_PIXEL)

    def begin(self, drag: str) -> None:
        """A drag begins, as `drags` has it."""
        self.end()
        self.drags = drag

    def drag(self, pixels: np.ndarray, scale: float) -> None:
        """Go on with the drag, by pixels (2,) of a window with so many for one of the camera's."""
        self._note("drag")
        if self.drags == "pan":
            self._camera.pan(pixels / scale)
        else:  # what stands on its head is turned the other way about its own axis
            across = -1 if self._camera.upright or self.drags == ORBIT else 1
            self._turn(pixels * DEGREES_A_DRAG, across)

    def _turn(self, degrees: np.ndarray, across: int = -1) -> None:
        self._camera.rotate(across * degrees[0], degrees[1])

    def end(self) -> None:
        """The drag is over, or the zoom: what comes next is another move."""
        self.drags, self._last = None, ""

    def framing(self, sim: Simulation) -> tuple[float, ...] | None:
        """The pose in which the particles that there are fill the picture; None: there are none."""
        x, radius = gathered(sim)
        return self._camera.framed(x, radius) if len(x) else None

    def to(self, pose: tuple[float, ...]) -> None:
        """Take a pose."""
        self.end()
        self._note("to")
        self.end()
        self._camera.pose = pose

    def back(self) -> None:
        """Take the pose before the last move."""
        self.end()
        if self._poses:
            *self._poses, self._camera.pose = self._poses


def gathered(sim: Simulation) -> tuple[np.ndarray, float]:
    """Places of particles, (n, dim), and the largest radius, world units.

    A few that flew off, such as pieces of a torn net, are left out.
    """
    x, radius = sim.positions(), float(sim.radii().max(initial=0.0))
    x = x[np.isfinite(x).all(axis=1)]
    if len(x) == 0:
        return x, radius
    low, high = np.quantile(x, [STRAY, 1 - STRAY], axis=0)
    room = FAR * float(np.linalg.norm(high - low)) + radius
    return x[((x >= low - room) & (x <= high + room)).all(axis=1)], radius
