"""From NumPy arrays into the fields of a `State` or a `Surface`, by rows.

Where the device is a processor, rows are the fields' own memory (`memory.py`), and no kernel is
compiled for them. Elsewhere they are arrays, and one kernel takes all of them to the device.
"""

import numpy as np
import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.field_rows import copy_row, is_whole, kind_of, width_of
from taichi_cloth.kernels.memory import TYPES, shape_of
from taichi_cloth.kernels.packs import is_by_component


class Transfer:
    """Rows of fields that the host writes, and `bring` takes to the device."""

    def __init__(self, owner):
        """owner: has the fields, their `memory` and `batches` (`fields.py`)."""
        self._memory, self._batches = owner.memory, owner.batches
        self._rows = {}  # by field

    def rows(self, field, count):
        """The first rows of a field, (count, *the rest of its shape): all are to be written.

        There stands what was written there since the last `bring`, or anything. A 0-D field has one
        row, of no shape.
        """
        if self._memory is not None:
            whole = self._memory.of(field)
            return whole[:count] if field.shape else whole
        if field not in self._rows:
            shape = (count, *shape_of(field)[1:]) if field.shape else ()
            self._rows[field] = np.zeros(shape, TYPES[field.dtype])
        return self._rows[field]

    def put(self, field, values):
        """Put values (count, ...) into the first rows of a field, or a number into a 0-D one."""
        self.rows(field, len(values) if field.shape else 1)[...] = values

    def put_shared(self, field, values):
        """Put values (m,) into a field; where that is one number for all, the first of them."""
        if field.shape:
            self.put(field, values)
        else:
            self.put(field, values[0] if len(values) else 0)

    def clear(self, field, count):
        """Put zeros into the first rows of a field."""
        self.rows(field, count)[...] = 0

    def scatter(self, spec, field, packs, slots, values, elsewhere=0):
        """Put what is at some slots, a number (n,) or a vector (n, dim), into a field of packs.

        elsewhere: what is put into all other slots of so many packs. Of a 0-D field there is one
        number for all slots.
        """
        other = np.reshape(elsewhere, (-1, 1))  # of each component
        if not field.shape:
            self.put_shared(field, values)
        elif values.ndim == 1:
            rows = self.rows(field, packs).reshape(-1)
            rows[...] = elsewhere
            rows[slots] = values
        elif is_by_component(spec, field):
            rows = self.rows(field, field.shape[0]).reshape(spec.dim, -1)
            rows[...] = other
            rows[:, slots] = values.T
        else:
            rows = self.rows(field, packs).reshape(packs, spec.dim, spec.lanes)
            rows[...] = other
            rows[slots // spec.lanes, :, slots % spec.lanes] = values

    def renew_halos(self, spec, field, grid):
        """Fill the halos of all rows of grids in a field of packs, of numbers or vectors.

        grid: (grids, 4), as in `State.grid`. Loops renew those of vectors as they move particles
        (`grids.py`).
        """
        packs = self.rows(field, field.shape[0]).reshape(field.shape[0], -1, spec.lanes)
        for first, count, width, _ in grid:
            rows = first + np.arange(count) * (width + 2 * spec.halo)
            for h in range(spec.halo):
                right, left = packs[rows + h], packs[rows + width - 1 - h]
                packs[rows + width + h, :, :-1], packs[rows + width + h, :, -1] = right[..., 1:], 0
                packs[rows - 1 - h, :, 1:], packs[rows - 1 - h, :, 0] = left[..., :-1], 0

    def bring(self, launch):
        """Take all that was written to the device; launch(kernel, ...) launches a kernel there."""
        if not self._rows:
            return
        fields, rows = tuple(self._rows), list(self._rows.values())
        if fields not in self._batches:
            self._batches[fields] = _Batch(fields)
        places, arrays = np.zeros((len(fields), 2), np.int32), []
        places[:, 1] = [len(of) if of.ndim else 1 for of in rows]
        for whole, none in ((True, np.zeros(1, np.int32)), (False, np.zeros(1, np.float32))):
            mine = [k for k, field in enumerate(fields) if is_whole(field) == whole]
            flat = [np.ravel(rows[k]) for k in mine]
            places[mine, 0] = np.cumsum([0, *map(len, flat)])[: len(mine)]
            arrays.append(np.concatenate([*flat, none]))  # a kernel takes no empty array
        launch(fill_rows, self._batches[fields], *arrays, places, int(places[:, 1].max()))
        self._rows = {}


class _Batch:
    """Fields that are filled at once: what is compiled into `fill_rows`."""

    def __init__(self, fields):
        self.rows = tuple(
            (k, field, kind_of(field), width_of(field), is_whole(field))
            for k, field in enumerate(fields)
        )


@kernel
def fill_rows(
    batch: ti.template(),
    counts: ti.types.ndarray(),
    reals: ti.types.ndarray(),
    places: ti.types.ndarray(),
    most: ti.i32,
):
    """Fill the first rows of fields from two arrays, of whole and of real numbers.

    places: (fields, 2): where each field's rows begin in the array, and how many there are; most:
    of any.
    """
    for i in range(most):
        for k, field, kind, width, whole in ti.static(batch.rows):
            if i < places[k, 1]:
                if ti.static(whole):
                    copy_row(field, kind, width, True, i, counts, places[k, 0] + i * width)
                else:
                    copy_row(field, kind, width, True, i, reals, places[k, 0] + i * width)
