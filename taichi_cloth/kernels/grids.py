"""Regular grids in packs: their rows, the links between particles, and halos, drawn in `packs.py`.

A *link* is a spring of a grid, known by its kind (columns and rows from its earlier end to the
later one) and the pack of its earlier end: there are no index lists. Whoever moves a row renews its
halos.
"""

import taichi as ti

from taichi_cloth.kernels.packs import (
    component,
    read,
    set_slot_number,
    slot_number,
    vectors,
    write,
)


@ti.func
def pitch_of(spec: ti.template(), state: ti.template(), g):
    """The number of packs from the start of a row of grid g to the start of the next."""
    return state.grid[g, 2] + 2 * spec.halo


@ti.func
def grid_at(spec: ti.template(), state: ti.template(), i):
    """The grid with links that pack i is in; -1: none. Where there is one grid, nothing is read of
    each pack: a step of a large cloth on a GPU waits for what is read.
    """
    if ti.static(state.capacity.grids == 1):
        first, rows = state.grid[0, 0], state.grid[0, 1]
        end = first + rows * pitch_of(spec, state, 0)
        return ti.select(state.grid[0, 3] == 1 and first <= i and i < end, 0, -1)
    else:
        return state.grid_of[i]


@ti.func
def link_offset(state: ti.template(), s, pitch):
    """The number of packs from a pack to the later end of its links of kind s."""
    return state.link[s, 0] + state.link[s, 1] * pitch


@ti.func
def link_index(state: ti.template(), s, i):
    """The index in the fields of links at which those of kind s lie that begin at pack i."""
    return s * state.packs + i


@ti.func
def _pushed(spec: ti.template(), a, first: ti.template()):
    """The vectors a one lane farther on; first: the components of those that come into lane 0."""
    return vectors(
        [
            ti.Vector([first[axis]] + [component(a, axis)[n] for n in range(spec.lanes - 1)])
            for axis in ti.static(range(spec.dim))
        ]
    )


@ti.func
def _pulled(spec: ti.template(), a, last: ti.template()):
    """The vectors a one lane farther back; last: the components of those in the last lane."""
    return vectors(
        [
            ti.Vector([component(a, axis)[n] for n in range(1, spec.lanes)] + [last[axis]])
            for axis in ti.static(range(spec.dim))
        ]
    )


@ti.func
def renew_left_halo(spec: ti.template(), field: ti.template(), first, width, reach):
    """Fill the halo left of a row with the columns that come before each strip's first one.

    field: one of vectors, in packs; first, width: the row's first pack and how many it has; reach:
    how many columns to fill.
    """
    for h in range(1, reach + 1):
        a = read(spec, field, first + width - h)
        write(spec, field, first - h, _pushed(spec, a, ti.static([0.0] * spec.dim)))


@ti.func
def renew_right_halo(spec: ti.template(), field: ti.template(), first, width, reach):
    """Fill the halo right of a row with the columns that come after each strip's last one.

    Parameters are those of `renew_left_halo`.
    """
    for h in range(reach):
        a = read(spec, field, first + h)
        write(spec, field, first + width + h, _pulled(spec, a, ti.static([0.0] * spec.dim)))


@ti.func
def return_left_halo(spec: ti.template(), field: ti.template(), first, width, reach):
    """Copy what was changed in a row's left halo back to the packs that hold its particles.

    Parameters are those of `renew_left_halo`, which copies the other way.
    """
    for h in range(1, reach + 1):
        a, b = read(spec, field, first - h), read(spec, field, first + width - h)
        last = [component(b, axis)[spec.lanes - 1] for axis in ti.static(range(spec.dim))]
        write(spec, field, first + width - h, _pulled(spec, a, last))


@ti.func
def return_right_halo(spec: ti.template(), field: ti.template(), first, width, reach):
    """Copy what was changed in a row's right halo back to the packs that hold its particles.

    Parameters are those of `renew_left_halo`; `renew_right_halo` copies the other way.
    """
    for h in range(reach):
        a, b = read(spec, field, first + width + h), read(spec, field, first + h)
        beyond = [component(b, axis)[0] for axis in ti.static(range(spec.dim))]
        write(spec, field, first + h, _pushed(spec, a, beyond))


@ti.func
def renew_number(spec: ti.template(), field: ti.template(), first, width, h, lane):
    """Fill place h of both halos of a row in one of its lanes but the last, of a field of numbers.

    That is in this lane to the right, and in the next one to the left.
    """
    right, left = (first + width + h) * spec.lanes, (first - 1 - h) * spec.lanes
    from_right, from_left = (first + h) * spec.lanes, (first + width - 1 - h) * spec.lanes
    set_slot_number(spec, field, right + lane, slot_number(spec, field, from_right + lane + 1))
    set_slot_number(spec, field, left + lane + 1, slot_number(spec, field, from_left + lane))


@ti.func
def renew_halos(spec: ti.template(), begin, width, fields: ti.template()):
    """Fill both halos of the row of packs at `begin` anew, in these fields of state.haloed."""
    for field in ti.static(fields):
        renew_left_halo(spec, field, begin, width, spec.left_reach)
        renew_right_halo(spec, field, begin, width, spec.right_reach)
