"""Slow motion's pictures between frames: where things are on the way to the present frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation


@dataclass(frozen=True)
class _Left:
    """A frame that was left for the next: its number, its time, and what it looked like.

    position: (n, dim). normals: (n, 3); None: the scene has no surface.
    """

    frame: int
    time: float
    position: np.ndarray
    normals: np.ndarray | None


class Between:
    """Leads from the frame that was left to the present one.

    What comes next is not known, so such a picture lags behind the state by at most one frame.
    Springs, colours and sizes are the present ones. Where the present frame does not follow the one
    that was left, or has other particles, things are where they are.

    part: how far on the way, from 0, the frame that was left, to 1, the present one.
    """

    def __init__(self) -> None:
        self._left: _Left | None = None

    def leave(self, sim: Simulation) -> None:
        """The frame that a simulation is at is left: call before it is advanced by one."""
        surface = sim.scene.world.dim == 3 and len(sim.drawn_triangles()) > 0
        normals = sim.drawn_normals().copy() if surface else None
        self._left = _Left(sim.frame, sim.time, sim.drawn_positions().copy(), normals)

    def forget(self) -> None:
        """Lead nowhere: the present frame is drawn, until one is left."""
        self._left = None

    def time(self, sim: Simulation, part: float) -> float:
        """The scene's time then."""
        left = self._before(sim)
        return sim.time if left is None else left.time + part * (sim.time - left.time)

    def positions(self, sim: Simulation, part: float) -> np.ndarray:
        """Places of particles then, (n, dim); the next call may overwrite them."""
        now, left = sim.drawn_positions(), self._before(sim)
        return now if left is None else _mixed(left.position, now, part)

    def normals(self, sim: Simulation, part: float) -> np.ndarray:
        """Their unit normals then, (n, 3), 0 where there is none; the next call may overwrite."""
        now, left = sim.drawn_normals(), self._before(sim)
        if left is None or left.normals is None:
            return now
        mixed = _mixed(left.normals, now, part)
        length = np.sqrt(np.einsum("ij,ij->i", mixed, mixed))[:, None]
        np.divide(mixed, length, out=mixed, where=length > 0)
        return mixed

    def _before(self, sim: Simulation) -> _Left | None:
        """The frame that was left, if the present one follows it."""
        left = self._left
        if left is None or sim.frame != left.frame + 1 or len(left.position) != len(sim.fixed()):
            return None
        return left


def _mixed(before: np.ndarray, now: np.ndarray, part: float) -> np.ndarray:
    """The linear interpolation between two arrays, to the bit each of them at its end."""
    real = before.dtype.type
    mixed: np.ndarray = real(1.0 - part) * before + real(part) * now
    return mixed
