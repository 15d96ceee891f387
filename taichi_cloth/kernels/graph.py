"""Springs on a graph: half-springs in compressed rows, every spring seen from both of its ends.

Row p holds the half-springs csr_start[p] .. csr_start[p+1] of the particle in slot csr_slot[p],
each with the slot of its other end, csr_other. So every particle sums over its own half-springs and
nothing is scattered. Saad, Iterative Methods for Sparse Linear Systems, 2003, 3.4 (storage).
"""

import taichi as ti

from taichi_cloth.kernels.spring_numbers import fields_of, is_stored, takes_stiffness


@ti.func
def number(spec: ti.template(), field: ti.template(), s):
    """The number that a field holds for spring or half-spring s; 0 where there is no such field.

    Where all springs share their numbers, the field is 0-D.
    """
    value = 0.0
    if ti.static(is_stored(field) and spec.uniform_springs):
        value = field[None]
    elif ti.static(is_stored(field)):  # without it, Taichi would read both
        value = field[s]
    return value


# How many half-springs of a row are computed side by side, then how many of the rest: six are those
# of a vertex in a mesh of triangles. Measured: 0.7 of the time one by one; (4, 2, 1): 0.76.
TOGETHER = (6, 3, 1)


@ti.func
def sum_of_half_springs(
    spec: ti.template(), state: ti.template(), value: ti.template(), between: ti.template(), p, i
):
    """The sum of `between` over the half-springs of row p, in their order.

    i: the particle that they belong to, a pack or a slot as for `value`; between: see `springs.py`.
    On meshes several are computed at once, which a compiler turns into vectors: roots and divisions
    take most of the time one by one. They are added in their order all the same.
    """
    total = 0.0 * value(spec, state.x, i)
    if ti.static(spec.together):
        h, end = state.csr_start[p], state.csr_start[p + 1]
        for count in ti.static(TOGETHER):
            while h + count <= end:
                parts = [
                    half_spring(spec, state, value, between, h + k, i)
                    for k in ti.static(range(count))
                ]
                for k in ti.static(range(count)):
                    total += parts[k]
                h += count
    else:
        for h in range(state.csr_start[p], state.csr_start[p + 1]):
            total += half_spring(spec, state, value, between, h, i)
    return total


@ti.func
def half_spring(
    spec: ti.template(), state: ti.template(), value: ti.template(), between: ti.template(), h, i
):
    """What half-spring h gives its particle i."""
    if ti.static(takes_stiffness(between)):
        along = ti.Vector([state.csr_direction[h, axis] for axis in range(spec.dim)])
        kept = [along, state.csr_along[h], state.csr_across[h]]
        return between.between(spec, state, value, i, state.csr_other[h], kept)
    else:
        return between(spec, state, value, i, state.csr_other[h], numbers_of(spec, state, h))


@ti.func
def numbers_of(spec: ti.template(), state: ti.template(), h):
    """The list of numbers (`spring_numbers.NUMBERS`) of half-spring h."""
    return [number(spec, field, h) for field in ti.static(fields_of(spec, state, "csr"))]
