"""Springs on a graph: half-springs in compressed rows, every spring seen from both of its ends.

Row p holds the half-springs csr_start[p] .. csr_start[p+1] of the particle in slot csr_slot[p],
each with the slot of its other end, csr_other. So every particle sums over its own half-springs and
nothing is scattered. Saad, Iterative Methods for Sparse Linear Systems, 2003, 3.4 (storage).

*Packed rows* (spec.packed_rows): in most nets particles that follow each other in memory have
neighbours that do so too. A pack is spec.lanes such particles; its half-springs lie in columns
csr_start[i] .. csr_start[i+1], in each at most one of each particle, in the order of its row:
number c * spec.lanes + lane is that of column c and a lane. The other ends of column c are the
slots csr_run[c], csr_run[c] + 1, ..., so one read gets all of them. Where those of a column do not
follow each other, copies of them do: beyond all other packs, pack first_copy + e has what
neighbours read of the particles in the slots csr_other[e * spec.lanes + lane]. A lane without a
half-spring, or with that of a spring that is gone, has numbers of 0. Half-springs are added in the
order of a particle's row, so f64 has the bits of rows that are not packed.
Kreutzer et al., "A unified sparse matrix data format for efficient general sparse matrix-vector
multiplication on modern processors with wide SIMD units", SIAM J. Sci. Comput. 36, 2014 (columns of
packs: SELL-C-sigma).
"""

import taichi as ti

from taichi_cloth.kernels.packs import PACKS, SLOTS, lanes_from, set_slot_value, slot_value
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
    """The force of half-spring h on its particle i."""
    if ti.static(takes_stiffness(between)):
        axis = ti.Vector([state.csr_axis[h, k] for k in range(spec.dim)])
        kept = [axis, state.csr_across[h]]
        return between.between(spec, state, value, i, state.csr_other[h], kept)
    else:
        return between(spec, state, value, i, state.csr_other[h], numbers_of(spec, state, h))


@ti.func
def numbers_of(spec: ti.template(), state: ti.template(), h):
    """The list of numbers (`spring_numbers.NUMBERS`) of half-spring h."""
    return [number(spec, field, h) for field in ti.static(fields_of(spec, state, "csr"))]


# --- packed rows ---------------------------------------------------------------------------------


@ti.func
def copy_ends(spec: ti.template(), state: ti.template(), e):
    """Copy what neighbours read of the other ends of a column, that do not follow each other.

    It comes before every sum: they move.
    """
    for h in range(e * spec.lanes, (e + 1) * spec.lanes):
        to, of = state.first_copy[None] * spec.lanes + h, state.csr_other[h]
        for field in ti.static(state.haloed):
            set_slot_value(spec, field, to, slot_value(spec, field, of))


@ti.func
def sum_of_columns(spec: ti.template(), state: ti.template(), between: ti.template(), i):
    """The sum of `between` over the half-springs of pack i, each particle's in their order."""
    near = (i & PACKS) * spec.lanes
    total = 0.0 * lanes_from(spec, state.x, near)
    for c in range(state.csr_start[i], state.csr_start[i + 1]):
        numbers = [
            column_number(spec, field, (c & PACKS) * spec.lanes)
            for field in ti.static(fields_of(spec, state, "csr"))
        ]
        total += between(spec, state, lanes_from, near, state.csr_run[c] & SLOTS, numbers)
    return total


@ti.func
def column_number(spec: ti.template(), field: ti.template(), h):
    """The number that a field holds for each half-spring of a column, from number h on."""
    if ti.static(is_stored(field)):
        return ti.Vector([field[h + lane] for lane in range(spec.lanes)])
    else:
        return 0.0
