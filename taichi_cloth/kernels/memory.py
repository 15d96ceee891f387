"""The memory of fields as NumPy arrays, where the device is a processor: the host writes there.

A kernel that fills fields takes Taichi some 0.02 s to compile, and 0.006 more for each field, of
which a load fills dozens.
"""

import ctypes

import numpy as np
import taichi as ti

from taichi_cloth.front_end.mending import kernel


class Memory:
    """The memory of the fields of some trees; Taichi never moves a tree.

    A kernel on a processor has ended when its launch returns, and reads what was written before it.
    """

    def __init__(self, fields):
        """fields: those of the trees, at least one of each."""
        one_of_each = {field.snode._snode_tree_id: field for field in fields}
        self.fields = tuple(one_of_each.values())
        found = np.zeros(len(self.fields), np.uint64)
        _find(self, found)
        self._trees = {
            tree: int(at) - _offset(field)
            for (tree, field), at in zip(one_of_each.items(), found, strict=True)
        }
        self._arrays = {}  # by field

    def begin_of(self, field):
        """The address of a field's first number."""
        return self._trees[field.snode._snode_tree_id] + _offset(field)

    def of(self, field):
        """The memory of a field, of its `shape_of`."""
        if field not in self._arrays:
            at = self.begin_of(field), shape_of(field), TYPES[field.dtype]
            self._arrays[field] = array_at(*at)
        return self._arrays[field]


TYPES = {ti.f32: np.dtype(np.float32), ti.f64: np.dtype(np.float64), ti.i32: np.dtype(np.int32)}


def shape_of(field):
    """The shape of a field, where of vectors their components are a last axis."""
    return (*field.shape, field.n) if isinstance(field, ti.MatrixField) else field.shape


def array_at(address, shape, dtype):
    """The array at an address, of a shape and a type (`np.dtype`)."""
    count = int(np.prod(shape, dtype=np.int64))
    whole = (ctypes.c_char * (count * dtype.itemsize)).from_address(address)
    return np.frombuffer(whole, dtype).reshape(shape)


def _offset(field):
    """The offset of a field from the beginning of its tree, in bytes."""
    return _outermost(field.snode)._offset_bytes_in_parent_cell


def _outermost(snode):
    """The ancestor of a field's node right below its tree's root."""
    while snode.parent().parent() is not None:
        snode = snode.parent()
    return snode


@kernel
def _find(memory: ti.template(), found: ti.types.ndarray()):
    """Find where the first number of each of memory.fields lies."""
    for k, field in ti.static(enumerate(memory.fields)):
        found[k] = ti.get_addr(field, ti.static([0] * len(field.shape)))
