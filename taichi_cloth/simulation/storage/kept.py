"""A state on the device as the host keeps it, whole: what later steps depend on, bit for bit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.kernels import persistence
from taichi_cloth.kernels.methods.contract import Method
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.simulation.launch import Launcher
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.storage.placement import Placement


@dataclass(frozen=True)
class Kept:
    """A copy of what `Storage` had on the device at one moment.

    taken: the state that was loaded last: the scene of then, and its springs' marks of then.
    fields: all that is kept from step to step, by the names of `kernels.state.State`, flat.
    topology, spec: how it was stored, and for what its kernels are compiled.
    pushed, held, altered: whether a push lasts until the frame's end, whether one acts, and
    whether what the method keeps is to be computed anew.
    loaded: the load itself, in the storage that it was of; None where it comes from a file.
    """

    taken: Snapshot
    fields: Mapping[str, np.ndarray]
    topology: str
    spec: Specialization
    pushed: bool
    held: bool
    altered: bool
    loaded: Any = None

    def __getstate__(self) -> dict[str, Any]:
        """Pickle it without the load, which is in the memory of this process."""
        return vars(self) | {"loaded": None}


class KeptFields:
    """Copies what is kept of one container's fields to NumPy and back.

    Two copies in a row share the arrays of fields that did not change.
    """

    def __init__(self, spec: Specialization, state: Any, method: Method, real: type) -> None:
        self._state, self._real = state, real
        self._fields = persistence.kept(spec, state, method)
        state.kept_groups = persistence.groups_of(self._fields)
        self._groups = list(dict.fromkeys((f.room, f.blocks) for f in self._fields))
        self._last: dict[str, np.ndarray] = {}
        self._reals: np.ndarray = np.zeros(0, real)
        self._counts: np.ndarray = np.zeros(0, np.int32)

    def read(self, launcher: Launcher, placement: Placement, patches: int) -> dict[str, np.ndarray]:
        """All that is kept, by the names of fields: flat arrays that nobody may write to.

        patches: how many there are of what is stored in `placement`.
        """
        spans, rows, begins = self._places(placement, patches)
        self._copy(launcher, False, rows, begins)
        for f in self._fields:
            array, before = self._array(f.whole)[spans[f.name]], self._last.get(f.name)
            if before is None or not np.array_equal(before, array):
                self._last[f.name] = array.copy()
        return dict(self._last)

    def write(
        self,
        launcher: Launcher,
        placement: Placement,
        patches: int,
        kept: Mapping[str, np.ndarray],
    ) -> None:
        """Put what was kept of the same placement back, which may have had another capacity.

        InputError where it is not of such fields.
        """
        self.check(kept)
        spans, rows, begins = self._places(placement, patches)
        for f in self._fields:
            span, array = spans[f.name], kept[f.name]
            count = min(len(array), span.stop - span.start)
            self._array(f.whole)[span.start : span.start + count] = array[:count]
        self._copy(launcher, True, rows, begins)

    def check(self, kept: Mapping[str, np.ndarray]) -> None:
        """InputError where what was kept is not of such fields."""
        for f in self._fields:
            if f.name not in kept:
                raise InputError(f"restore: it lacks '{f.name}', which this version keeps")

    def _array(self, whole: bool) -> np.ndarray:
        return self._counts if whole else self._reals

    def _copy(self, launcher: Launcher, back: bool, rows: np.ndarray, begins: np.ndarray) -> None:
        arrays = self._reals, self._counts, rows, begins
        launcher.launch(persistence.copy_kept, self._state, back, *arrays)

    def _places(
        self, placement: Placement, patches: int
    ) -> tuple[dict[str, slice], np.ndarray, np.ndarray]:
        """The place of each field in the two arrays, which get the size that they need.

        Also (groups, 2) and (fields,), as `persistence.copy_kept` takes them.
        """
        layout = placement.layout
        used = persistence.in_use(
            self._state, layout.n_packs, len(layout.slot), len(placement.graph_springs), patches
        )
        spans, begins, ends = {}, [], [0, 0]
        for f in self._fields:
            begin = ends[f.whole]
            ends[f.whole] = begin + f.blocks * used.get(f.room, f.room) * f.width
            spans[f.name] = slice(begin, ends[f.whole])
            begins.append(begin)
        if (len(self._reals), len(self._counts)) != (max(ends[0], 1), max(ends[1], 1)):
            self._reals = np.zeros(max(ends[0], 1), self._real)  # a kernel takes no empty array
            self._counts = np.zeros(max(ends[1], 1), np.int32)
        rows = [
            (used.get(room, room), blocks * used.get(room, room)) for room, blocks in self._groups
        ]
        return spans, np.array(rows, np.int32), np.array(begins, np.int32)


def with_own_hold(taken: Snapshot) -> Snapshot:
    """The same state, with a copy of where the mouse holds it: that follows the pointer."""
    held = taken.scene.world.held
    if held is None:
        return taken
    own = replace(held, place=held.place.copy())
    return replace(taken, scene=taken.scene.with_world(held=own))
