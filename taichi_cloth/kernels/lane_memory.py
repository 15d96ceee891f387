"""The memory of packs seen as one array of vectors, with a number for each lane in each.

Taichi lowers every number of a field to some ten statements, and searches all of a kernel for each
of them that is there twice: of a pack's 24 numbers in space that was most of what lanes took to
compile. As an argument of a kernel the same memory is an array of vectors, of which a pack has one
for each component, read and written as a whole. Compiling takes a seventh to a half of the time
(docs/speed.md, "Start-up").

Kernels that hold steps take `State.lane_memory` as an argument of the type `lane_memory_type`,
and say so by `see` before all else. In them `packs.read` and its like go through it. Others read
fields. Never both in one kernel: Taichi takes an array and a field for different memory, and would
move what reads one past what writes the other.
"""

import ctypes

import numpy as np
import taichi as ti
from taichi.lang import impl


def lane_memory_type(lanes, real):
    """The annotation of a kernel's argument for State.lane_memory; of single lanes it is None."""
    if lanes == 1:
        return ti.template()
    return ti.types.ndarray(dtype=ti.types.vector(lanes, real), ndim=1)


def see(memory):
    """Let the kernel that is being compiled see packs through `memory`, its argument, or None.

    Kept with this start of Taichi: a kernel of the next one may have a former one's address, and
    would be taken for it.
    """
    runtime = impl.get_runtime()
    runtime.lane_memory = runtime.compiling_callable, memory


def sees(field):
    """Whether the kernel that is being compiled sees a field through the memory of lanes."""
    runtime = impl.get_runtime()
    kernel, memory = getattr(runtime, "lane_memory", (None, None))
    if memory is None or kernel is not runtime.compiling_callable:
        return False
    return hasattr(field, "first_vector")


def seen():
    """The memory of lanes of the kernel that is being compiled, as its argument."""
    return impl.get_runtime().lane_memory[1]


def rows_at(at, rows):
    """The rows of a pack in the memory of lanes, each a number for each lane, from vector `at` on.

    Returned in a tuple, as `ti.static` wants it.
    """
    builder = impl.get_runtime().compiling_callable.ast_builder()
    return tuple(impl.subscript(builder, seen(), at + row if row else at) for row in range(rows))


def open_lane_memory(fields, lanes, real):
    """The memory of fields of packs, all that are in one tree, as an array (vectors, lanes).

    Each gets an attribute first_vector: where it begins in the array.
    """
    size = 4 if real == ti.f32 else 8
    places = [_outermost(field.snode)._offset_bytes_in_parent_cell for field in fields]
    ends = [at + size * int(np.prod(field.shape)) for at, field in zip(places, fields, strict=True)]
    for field, at in zip(fields, places, strict=True):
        field.first_vector = at // (size * lanes)
    numbers = max(ends) // size
    whole = (ctypes.c_float if real == ti.f32 else ctypes.c_double) * numbers
    begin = _address(fields[0]) - places[0]
    return np.ctypeslib.as_array(whole.from_address(begin)).reshape(-1, lanes)


def _outermost(snode):
    """The ancestor of a field's node right below its tree's root."""
    while snode.parent().parent() is not None:
        snode = snode.parent()
    return snode


@ti.kernel
def _address(field: ti.template()) -> ti.u64:
    """Where the first number of a field lies in memory."""
    return ti.get_addr(field, [0, 0])
