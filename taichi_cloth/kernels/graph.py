"""Springs on a graph: half-springs in compressed rows, every spring seen from both of its ends.

Row p holds the half-springs csr_start[p] .. csr_start[p+1] of the particle at csr_slot[p], each with
the slot of its other end, csr_other. So every particle sums over its own and nothing is scattered.
"""

import taichi as ti

from taichi_cloth.kernels.spring_numbers import fields_of, is_stored


@ti.func
def number(spec: ti.template(), field: ti.template(), s):
    """A (half-)spring's number: its own, or the one that all of them share; 0 where none is stored."""
    value = 0.0
    if ti.static(is_stored(field) and spec.uniform_springs):
        value = field[None]
    elif ti.static(is_stored(field)):  # without it, Taichi would read both
        value = field[s]
    return value


@ti.func
def sum_of_half_springs(
    spec: ti.template(), state: ti.template(), value: ti.template(), between: ti.template(), p, i
):
    """Sum over the half-springs of row p, which are those of particle i, in their order."""
    total = 0.0 * value(spec, state.x, i)
    for h in range(state.csr_start[p], state.csr_start[p + 1]):
        numbers = [number(spec, field, h) for field in ti.static(fields_of(spec, state, "csr"))]
        total += between(spec, state, value, i, state.csr_other[h], numbers)
    return total
