"""Parts that all uploads share: where rows of numbers go, and what does not fit there."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.kernels.specialization import Specialization
from taichi_cloth.kernels.transfer import Transfer
from taichi_cloth.scene.solids import Solid
from taichi_cloth.simulation.launch import Launcher
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.simulation.storage.boxes import Real
from taichi_cloth.simulation.storage.placement import Placement, Placements


@dataclass(frozen=True)
class Filling:
    """The target of a snapshot: `state`, whose fields are of `spec`.

    placements: of its scene; placement: the one that is used. solids: what is in its way.
    needs: what the method asks of the host (`kernels.methods`). real: type of the device's numbers.
    """

    launcher: Launcher
    spec: Specialization
    state: Any
    snapshot: Snapshot
    placements: Placements
    placement: Placement
    solids: Sequence[Solid]
    needs: Collection[str]
    real: Real

    @cached_property
    def _to(self) -> Any:
        """The carrier of rows of numbers to the fields."""
        return Transfer(self.state)

    def _bring(self) -> None:
        self._to.bring(self.launcher.launch)

    def _of_kinds(self, field: Any, kinds: int, places: np.ndarray, values: np.ndarray) -> None:
        """Numbers (m,) of links or lines, into a field by kind and pack.

        places: (m, 2), the kind of each, and the slot where it begins.
        """
        packs = self.state.packs
        self._to.scatter(self.spec, field, kinds * packs, self._index(places), values)

    def _index(self, places: np.ndarray) -> np.ndarray:
        """Places of links or lines (m, 2) in fields by kind and pack, (m,)."""
        kind, slot = places.T.astype(np.int64)
        index: np.ndarray = kind * self.state.packs * self.spec.lanes + slot
        return index

    def _of_particle(self, field: Any, values: np.ndarray, elsewhere: Any = 0) -> None:
        """What each particle has, (n,) or (n, dim), into a field of packs; elsewhere: in the slots
        of none.
        """
        layout = self.placement.layout
        self._to.scatter(self.spec, field, layout.n_packs, layout.slot, values, elsewhere)


def as_real(real: Real, what: str | Sequence[str], *columns: np.ndarray) -> np.ndarray:
    """Columns side by side in the device's precision; InputError where one does not fit.

    what: for the message, "particle" or "spring", or what each of the rows is.
    """
    with np.errstate(all="ignore"):
        rows = np.column_stack(columns).astype(real)
    if not np.isfinite(rows).all():
        raise wrong_size(real, what, int(np.isfinite(rows).all(axis=1).argmin()))
    return rows


def wrong_size(real: Real, what: str | Sequence[str], index: int) -> InputError:
    place = f"{what} {index}" if isinstance(what, str) else what[index]
    wider = "; use --precision f64" if real is np.float32 else ""
    return InputError(
        f"{place} has a number too large or too small for {real.__name__}{wider} or other units"
    )
