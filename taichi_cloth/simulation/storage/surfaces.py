"""A scene's triangles for whoever reads them: which are whole, and normals of the particles."""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from taichi_cloth.kernels import surfaces
from taichi_cloth.kernels.fields import Surface
from taichi_cloth.runtime import Device, still_runs
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.triangles import springs_of_sides
from taichi_cloth.simulation.storage.upload import Upload


@dataclass(frozen=True)
class _OnDevice:
    """Triangles on the device, and room for a normal of each particle (n, 3).

    placement, state: of what they were put there. free: gives their memory back; None: they are the
    state's own, because its forces know of them.
    """

    placement: Any
    state: Any
    surface: Any
    normals: np.ndarray
    free: weakref.finalize | None

    def holds(self, triangles: int, particles: int) -> bool:
        """True if the fields are no one else's, and there is room for so many."""
        room = self.surface.capacity
        return self.free is not None and room[0] >= triangles and room[1] >= particles


class Surfaces:
    """Reads the triangles of one storage.

    Where the scene's forces know of no triangles they are put on the device when normals are first
    asked for: whoever does not ask pays nothing.
    """

    def __init__(self) -> None:
        self._there: _OnDevice | None = None
        self._sides: tuple[Scene, np.ndarray] | None = None

    def whole(self, scene: Scene, springs_alive: np.ndarray) -> np.ndarray:
        """Which triangles are whole, (m,) bool; springs_alive: (s,) bool."""
        if self._sides is None or self._sides[0] is not scene:
            sides = springs_of_sides(scene.triangles, scene.springs.between)
            self._sides = scene, sides
        alive = np.append(springs_alive, True)  # a side without a spring does not break
        whole: np.ndarray = alive[self._sides[1]].all(axis=1)
        return whole

    def normals(self, upload: Upload) -> np.ndarray:
        """Unit normals of the particles, (n, 3), the same array at each call.

        upload: says what is on the device now, and where.
        """
        there = self._there
        if there is None or not (
            there.placement is upload.placement and there.state is upload.state
        ):
            there = self._there = self._put_there(upload)
        if len(there.normals) and len(upload.snapshot.scene.triangles):
            arguments = upload.spec, upload.state, there.surface, there.normals
            upload.launcher.launch(surfaces.compute_normals, *arguments)
        return there.normals

    def _put_there(self, upload: Upload) -> _OnDevice:
        scene, device, old = upload.snapshot.scene, upload.launcher.device, self._there
        surface, free = getattr(upload.state, "surface", None), None
        if surface is None:
            needed = len(scene.triangles), len(scene.particles)
            if old is not None and old.holds(*needed):
                surface, free = old.surface, old.free
            else:
                if old is not None and old.free is not None:
                    old.free()
                surface = Surface.alone(getattr(ti, device.real), *needed)
                free = free_with(self, surface, device)
            upload.surface_alone(surface, scene.triangles)
        normals = np.zeros((len(scene.particles), 3), upload.real)
        return _OnDevice(upload.placement, upload.state, surface, normals, free)


def free_with(owner: object, fields: Any, device: Device) -> weakref.finalize:
    """A finalizer that gives the memory of fields back when nobody holds `owner` any more.

    Taichi has room for 512 trees of fields.
    """
    free = weakref.finalize(owner, _free, fields, device)
    free.atexit = False
    return free


def _free(fields: Any, device: Device) -> None:
    """Give the memory back, unless Taichi was started anew since, or cannot (OpenGL)."""
    if still_runs(device) and device.arch != "opengl":
        fields.free()
