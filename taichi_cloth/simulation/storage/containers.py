"""Fields for a state on the device: how many are made, and what they are made for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import taichi as ti

from taichi_cloth.kernels.fields import Capacity
from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.kernels.state import State
from taichi_cloth.runtime import Device
from taichi_cloth.simulation.storage.boxes import Real
from taichi_cloth.simulation.storage.kept import KeptFields
from taichi_cloth.simulation.storage.surfaces import free_with

SPAWN_CAPACITY = 16384  # room for clicks before the fields must grow: some 10 MB
TIES = 1024  # room for springs of clicks among what obstacles meet, where they meet faces
PATCHES = 32  # room for patches of clicked particles, where cloths have a thickness


@dataclass(frozen=True)
class Container:
    """Fields, and what they were made for.

    spec: with parallel loops in one launch per step, for kernels beside the frames. kept: copies
    what steps keep.

    Their memory is given back when nobody holds it any more, the storage or a checkpoint.
    """

    state: Any
    spec: Specialization
    topology: str
    kept: KeptFields

    @classmethod
    def make(
        cls,
        spec: Specialization,
        topology: str,
        capacity: Capacity,
        method: Method,
        device: Device,
        real: Real,
    ) -> Container:
        """An empty one; it compiles every kernel that is launched with it.

        real: type of the device's numbers.
        """
        state: Any = State(spec, getattr(ti, device.real), capacity, method)
        container = cls(state, spec, topology, KeptFields(spec, state, method, real))
        # Taichi has room for 512 trees of fields, of which each state takes two.
        free_with(container, state, device)
        return container

    def fits(self, spec: Specialization, topology: str) -> bool:
        """True if the fields are those of `spec` in a topology, and more."""
        return self.topology == topology and self.spec.can_run(spec)


def with_room_to_spare(
    needed: Capacity, factor: int, *, takes_clicks: bool, thick: bool
) -> Capacity:
    """Make a container for what is `needed`.

    factor: how many times as much of what clicks may add. takes_clicks: whether they may add any.
    thick: whether cloths have a thickness.
    """
    room = SPAWN_CAPACITY if takes_clicks else 0
    return replace(
        needed,
        particles=factor * needed.particles + room,
        springs=factor * needed.springs + room,
        columns=factor * needed.columns + (room if needed.columns else 0),
        copies=factor * needed.copies + (room // 4 if needed.columns else 0),
        packs=factor * needed.packs + room,
        elements=factor * needed.elements + (TIES if takes_clicks and needed.elements else 0),
        closer=max(needed.closer, 16 * factor * needed.particles) if thick else 0,
        patches=factor * needed.patches + (PATCHES if takes_clicks and needed.patches else 0),
    )
