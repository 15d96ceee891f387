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

import numpy as np
import taichi as ti
from taichi.lang import impl

from taichi_cloth.front_end import mending
from taichi_cloth.kernels.memory import TYPES, array_at


def lane_memory_type(lanes, real):
    """The annotation of a kernel's argument for State.lane_memory; of single lanes it is None."""
    if lanes == 1:
        return ti.template()
    return ti.types.ndarray(dtype=ti.types.vector(lanes, real), ndim=1)


def see(memory):
    """Let the kernel that is being compiled see packs through `memory`, its argument, or None.

    Kept no longer than it is compiled: a later one may have its address, and would be taken for it.
    """
    mending.notes()["lane_memory"] = impl.get_runtime().compiling_callable, memory


def sees(field):
    """True if the kernel that is being compiled sees a field through the memory of lanes."""
    kernel, memory = mending.notes().get("lane_memory", (None, None))
    if memory is None or kernel is not impl.get_runtime().compiling_callable:
        return False
    return hasattr(field, "first_vector")


def seen():
    """The memory of lanes of the kernel that is being compiled, as its argument."""
    return mending.notes()["lane_memory"][1]


def rows_at(at, rows):
    """The rows of a pack in the memory of lanes, each a number for each lane, from vector `at` on.

    Returned in a tuple, as `ti.static` wants it.
    """
    builder = impl.get_runtime().compiling_callable.ast_builder()
    return tuple(impl.subscript(builder, seen(), at + row if row else at) for row in range(rows))


def open_lane_memory(memory, fields, lanes, real):
    """The memory of fields of packs, all that are in one tree, as an array (vectors, lanes).

    memory: the `memory.Memory` of that tree. Each gets an attribute first_vector: where it begins
    in the array.
    """
    numbers = TYPES[real]
    begin = min(memory.begin_of(field) for field in fields)
    end = begin
    for field in fields:
        at = memory.begin_of(field)
        field.first_vector = (at - begin) // (numbers.itemsize * lanes)
        end = max(end, at + numbers.itemsize * int(np.prod(field.shape)))
    return array_at(begin, ((end - begin) // (numbers.itemsize * lanes), lanes), numbers)
