"""Regular grids in packs: rows, the links between their particles, and halos (`packs.py` draws them).

A *link* is a spring of a grid, known by its kind (columns and rows from its earlier end to the
later one) and the pack of its earlier end: no index lists. Halos are renewed by whoever moves a row.
"""

import taichi as ti

from taichi_cloth.kernels.packs import read, write


@ti.func
def pitch_of(spec: ti.template(), state: ti.template(), g):
    """Packs from a row of grid g to the next."""
    return state.grid[g, 2] + 2 * spec.halo


@ti.func
def link_offset(state: ti.template(), s, pitch):
    """Packs from a pack to the other end of its links of kind s."""
    return state.link[s, 0] + state.link[s, 1] * pitch


@ti.func
def link_index(state: ti.template(), s, i):
    """Where the fields of links keep those of kind s that begin at pack i."""
    return s * state.packs + i


@ti.func
def renew_left_halo(spec: ti.template(), field: ti.template(), first, width, reach):
    """Left of a row that begins at pack `first`: the columns before each strip's first one."""
    for h in range(1, reach + 1):
        a = read(spec, field, first + width - h)
        rows = [[0.0] + [a[i, lane] for lane in range(spec.lanes - 1)] for i in range(spec.dim)]
        write(spec, field, first - h, ti.Matrix(rows))


@ti.func
def renew_right_halo(spec: ti.template(), field: ti.template(), first, width, reach):
    """Right of it: the columns after each strip's last one."""
    for h in range(reach):
        a = read(spec, field, first + h)
        rows = [[a[i, lane] for lane in range(1, spec.lanes)] + [0.0] for i in range(spec.dim)]
        write(spec, field, first + width + h, ti.Matrix(rows))


@ti.func
def return_left_halo(spec: ti.template(), field: ti.template(), first, width, reach):
    """The other way: what was changed in the left halo goes to where its particles are."""
    for h in range(1, reach + 1):
        a, b = read(spec, field, first - h), read(spec, field, first + width - h)
        last = ti.static(spec.lanes - 1)
        rows = [[a[i, lane + 1] for lane in range(last)] + [b[i, last]] for i in range(spec.dim)]
        write(spec, field, first + width - h, ti.Matrix(rows))


@ti.func
def return_right_halo(spec: ti.template(), field: ti.template(), first, width, reach):
    """The same of the right halo."""
    for h in range(reach):
        a, b = read(spec, field, first + width + h), read(spec, field, first + h)
        rows = [[b[i, 0]] + [a[i, lane] for lane in range(spec.lanes - 1)] for i in range(spec.dim)]
        write(spec, field, first + h, ti.Matrix(rows))


@ti.func
def renew_halos(spec: ti.template(), state: ti.template(), begin, width):
    """Renew the halos beside the row of packs at `begin`, in every field that neighbours read."""
    for field in ti.static(state.haloed):
        renew_left_halo(spec, field, begin, width, spec.left_reach)
        renew_right_halo(spec, field, begin, width, spec.right_reach)
