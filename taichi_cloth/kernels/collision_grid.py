"""The collision grid: who is near whom, found by cells.

Particles are sorted by cell, and by index in each cell, by a counting sort (Green, "Particle
Simulation using CUDA", 2010). Cells follow each other along the first axis, so what is near a
particle lies in a few ranges of places, one a row of cells. Cells are narrow along the rows, which
costs nothing, and wide across them, so that few rows are read. The grid wraps around at its edges
and needs no bounds: its sizes are powers of two, and what is far away but in the same cell costs a
comparison. Few particles share a single cell: then all pairs are compared. A few that are much
larger than all others, as a ball that is thrown into a net, share a cell of their own after all
others, in which everybody looks: else everybody would look as far around as the largest reaches.

c in this file: a cell, by its integer coordinates (dim,) or by its index.
"""

import math

import taichi as ti

from taichi_cloth.kernels.loops import barrier, each, share
from taichi_cloth.kernels.packs import (
    epsilon,
    slot_number,
    slot_value,
)

CELLS_PER_PARTICLE = 8  # about, at most; more cells mean fewer comparisons, more clearing
CELLS_OF_CLOTH = 32  # the same where cloths have a thickness: it is not done in each step
BLOCK = 1024  # cells whose counts one iteration sums on a GPU
# Where threads sort, they first sort into bins of consecutive cells, then each bin by itself, so
# that what is written lies in the fastest caches. Each thread has a count for each bin.
MOST_BINS = 512
MOST_NEAR = 16  # particles that one keeps in a list, where pairs rest; others search the grid again
MOST_KEPT = 64  # likewise, from step to step, where cloths have a thickness
ALONE = 48  # so many particles share a single cell
MOST_LARGE = 64  # particles that share the cell of large ones
LARGER = 2.0  # at least so many times as large as all others


def most_cells(particles, thick=False):
    """The most cells of a grid of so many particles; thick: with a thickness."""
    cells = CELLS_OF_CLOTH if thick else CELLS_PER_PARTICLE
    return 2 ** round(math.log2(cells * max(particles, 1)))


@ti.func
def slot_of(spec: ti.template(), state: ti.template(), i):
    """The slot of the particle with index i."""
    if ti.static(spec.kinds > 0):
        return state.slot[i]
    else:
        return i


@ti.func
def _coordinate(state: ti.template(), place, axis: ti.template()):
    """The coordinate along an axis of the cell in which the coordinate `place` lies, unwrapped."""
    at = place * state.per_cell[axis]
    c = ti.cast(at, ti.i32)  # towards zero; `floor` is a call of a library on CPUs
    return c - ti.cast(at < ti.cast(c, state.real), ti.i32)


@ti.func
def _index(state: ti.template(), c: ti.template()):
    """The index of the cell with the coordinates c, a list, which it wraps."""
    dim = ti.static(len(c))
    index = c[dim - 1] & ((1 << state.grid_bits[dim - 1]) - 1)
    for axis in ti.static(range(dim - 2, -1, -1)):
        bits = state.grid_bits[axis]
        index = (index << bits) | (c[axis] & ((1 << bits) - 1))
    return index


@ti.func
def _cell_at(spec: ti.template(), state: ti.template(), x):
    """The index of the cell at position x."""
    return _index(state, [_coordinate(state, x[axis], axis) for axis in range(spec.dim)])


@ti.func
def _cell_of(spec: ti.template(), state: ti.template(), slot):
    """The index of the cell of the particle at a slot."""
    c = _cell_at(spec, state, slot_value(spec, state.x, slot))
    if _radius(spec, state, slot) > state.largest_radius[None]:
        c = cell_count(spec, state)
    return c


@ti.func
def _radius(spec: ti.template(), state: ti.template(), slot):
    """The radius with which the particle at a slot meets others."""
    if ti.static(spec.thick):
        return slot_number(spec, state.pair_radius, slot)
    else:
        return slot_number(spec, state.radius, slot)


@ti.func
def cell_count(spec: ti.template(), state: ti.template()):
    """The number of cells; the cell with this index is that of large particles."""
    bits = 0
    for axis in ti.static(range(spec.dim)):
        bits += state.grid_bits[axis]
    return 1 << bits


@ti.func
def sort_into_cells(spec: ti.template(), state: ti.template(), t):
    """Sort the particles by cell, and by index in each.

    It fills state.cell_end: cell_end[c + 1] is the place in this order at which cell c ends, and
    cell_end[c] that at which it begins; and, by place, sorted_index and sorted: position, radius,
    velocity and inverse mass.
    """
    if ti.static(spec.one_launch_per_step or spec.blocks > 0):
        _sort_on_gpu(spec, state, t)
    else:
        _sort_into_bins(spec, state, t)
        _sort_bins(spec, state, t)


@ti.func
def _sort_into_bins(spec: ti.template(), state: ti.template(), t):
    """Sort the particles by bin, and by index in each: thread t those of its share."""
    bins, bits = state.bins[None] + 1, state.bin_bits[None]  # the last one: of large particles
    begin, end = share(spec, state.n[None], t), share(spec, state.n[None], t + 1)
    mine = t * ti.static(MOST_BINS + 1)
    for b in range(bins):
        state.bin_fill[mine + b] = 0
    for i in range(begin, end):
        c = _cell_of(spec, state, slot_of(spec, state, i))
        state.cell_of[i] = c
        at = mine + (c >> bits)
        state.bin_fill[at] = state.bin_fill[at] + 1  # += would be atomic, and slower
    barrier(spec, state, t)
    # In each bin, what is of the threads before comes before.
    for b in range(share(spec, bins, t), share(spec, bins, t + 1)):
        total = 0
        for other in range(spec.threads):
            at = other * ti.static(MOST_BINS + 1) + b
            count = state.bin_fill[at]
            state.bin_fill[at] = total
            total += count
        state.bin_size[b] = total
    barrier(spec, state, t)
    start = 0
    for b in range(bins):
        state.bin_fill[mine + b] = state.bin_fill[mine + b] + start
        if t == 0:
            state.bin_start[b] = start
        start += state.bin_size[b]
    for i in range(begin, end):
        c, slot = state.cell_of[i], slot_of(spec, state, i)
        at = mine + (c >> bits)
        place = state.bin_fill[at]
        state.bin_fill[at] = place + 1
        state.binned_cell[place], state.binned_index[place] = c, i
        _copy_particle(spec, state, slot, ti.static(state.sorted_half) + place)
    barrier(spec, state, t)


@ti.func
def _sort_bins(spec: ti.template(), state: ti.template(), t):
    """Sort the particles of each bin by cell, in the order that they have: thread t some bins."""
    bins, n = state.bins[None], state.n[None]
    if t == 0:
        state.cell_end[0] = 0
    for b in range(bins):
        # Bins are shared out by their particles and their cells, in equal parts.
        before = state.bin_start[b] / ti.cast(ti.max(n, 1), ti.f32) + b / ti.cast(bins, ti.f32)
        if ti.min(ti.cast(0.5 * spec.threads * before, ti.i32), spec.threads - 1) == t:
            _sort_bin(spec, state, b)
    if t == 0:
        cells = cell_count(spec, state)
        state.cell_end[cells + 1] = n
        for at in range(state.bin_start[bins], n):  # as they are: they share one cell
            _take_from_bin(spec, state, at, at)
    barrier(spec, state, t)


@ti.func
def _sort_bin(spec: ti.template(), state: ti.template(), b):
    """Sort the particles of bin b by cell."""
    first_cell, cells = b << state.bin_bits[None], 1 << state.bin_bits[None]
    begin = state.bin_start[b]
    end = begin + state.bin_size[b]
    for c in range(first_cell, first_cell + cells):
        state.cell_end[c + 1] = 0
    for at in range(begin, end):
        c = state.binned_cell[at]
        state.cell_end[c + 1] = state.cell_end[c + 1] + 1
    start = begin
    for c in range(first_cell, first_cell + cells):
        count = state.cell_end[c + 1]
        state.cell_end[c + 1] = start
        start += count
    for at in range(begin, end):
        c = state.binned_cell[at]
        place = state.cell_end[c + 1]
        state.cell_end[c + 1] = place + 1
        _take_from_bin(spec, state, at, place)


@ti.func
def _take_from_bin(spec: ti.template(), state: ti.template(), at, place):
    """Take a particle from its place in the order by bins to that in the order by cells."""
    state.sorted_index[place] = state.binned_index[at]
    for k in ti.static(range(2 * spec.dim + 2)):
        state.sorted[place, k] = state.sorted[ti.static(state.sorted_half) + at, k]


@ti.func
def _copy_particle(spec: ti.template(), state: ti.template(), slot, at):
    """Copy position, radius, velocity and inverse mass of the particle at a slot to a place.

    Side by side, they are read with one access to memory.
    """
    x, v = slot_value(spec, state.x, slot), slot_value(spec, state.v, slot)
    for axis in ti.static(range(spec.dim)):
        state.sorted[at, axis], state.sorted[at, ti.static(spec.dim + 1 + axis)] = x[axis], v[axis]
    state.sorted[at, ti.static(spec.dim)] = _radius(spec, state, slot)
    state.sorted[at, ti.static(2 * spec.dim + 1)] = slot_number(spec, state.w, slot)


@ti.func
def _sort_on_gpu(spec: ti.template(), state: ti.template(), t):
    """Sort the particles by cell on very many threads."""
    each(spec, state, t, cell_count(spec, state) + 2, _clear_cell)
    each(spec, state, t, state.n[None], _count_in_cell)
    # An exclusive prefix sum in blocks: first over each block, then over these, then inside each.
    each(spec, state, t, _block_count(spec, state), _sum_block)
    each(spec, state, t, 1, _begin_blocks)
    each(spec, state, t, _block_count(spec, state), _begin_cells)
    each(spec, state, t, state.n[None], _put_in_cell)
    each(spec, state, t, cell_count(spec, state) + 1, _order_cell)
    each(spec, state, t, state.n[None], _copy_to_place)


@ti.func
def _clear_cell(spec: ti.template(), state: ti.template(), c):
    state.cell_end[c] = 0


@ti.func
def _count_in_cell(spec: ti.template(), state: ti.template(), i):
    c = _cell_of(spec, state, slot_of(spec, state, i))
    state.cell_of[i] = c
    ti.atomic_add(state.cell_end[c + 1], 1)


@ti.func
def _block_count(spec: ti.template(), state: ti.template()):
    return (cell_count(spec, state) + BLOCK - 1) // BLOCK


@ti.func
def _sum_block(spec: ti.template(), state: ti.template(), b):
    total = 0
    for c in range(b * BLOCK, ti.min((b + 1) * BLOCK, cell_count(spec, state))):
        total += state.cell_end[c + 1]
    state.block_start[b] = total


@ti.func
def _begin_blocks(spec: ti.template(), state: ti.template(), _):
    total = 0
    for b in range(_block_count(spec, state)):
        count = state.block_start[b]
        state.block_start[b] = total
        total += count
    state.cell_end[cell_count(spec, state) + 1] = total  # that of large particles begins there


@ti.func
def _begin_cells(spec: ti.template(), state: ti.template(), b):
    total = state.block_start[b]
    for c in range(b * BLOCK, ti.min((b + 1) * BLOCK, cell_count(spec, state))):
        count = state.cell_end[c + 1]
        state.cell_end[c + 1] = total
        total += count


@ti.func
def _put_in_cell(spec: ti.template(), state: ti.template(), i):
    state.sorted_index[ti.atomic_add(state.cell_end[state.cell_of[i] + 1], 1)] = i


@ti.func
def _order_cell(spec: ti.template(), state: ti.template(), c):
    """Sort a cell, which may have been filled in any order, by index: by insertion."""
    first = state.cell_end[c]
    for at in range(first + 1, state.cell_end[c + 1]):
        i = state.sorted_index[at]
        to = at
        while to > first and state.sorted_index[to - 1] > i:
            state.sorted_index[to] = state.sorted_index[to - 1]
            to -= 1
        state.sorted_index[to] = i


@ti.func
def _copy_to_place(spec: ti.template(), state: ti.template(), at):
    _copy_particle(spec, state, slot_of(spec, state, state.sorted_index[at]), at)


@ti.func
def sorted_x(spec: ti.template(), state: ti.template(), at):
    """The position (dim,) of the particle at place `at` in the order by cells."""
    return ti.Vector([state.sorted[at, axis] for axis in range(spec.dim)])


@ti.func
def sorted_radius(spec: ti.template(), state: ti.template(), at):
    """The radius of the particle at place `at` in the order by cells."""
    return state.sorted[at, ti.static(spec.dim)]


@ti.func
def sorted_v(spec: ti.template(), state: ti.template(), at):
    """The velocity (dim,) of the particle at place `at` in the order by cells."""
    return ti.Vector([state.sorted[at, spec.dim + 1 + axis] for axis in range(spec.dim)])


@ti.func
def sorted_w(spec: ti.template(), state: ti.template(), at):
    """The inverse mass of the particle at place `at` in the order by cells."""
    return state.sorted[at, ti.static(2 * spec.dim + 1)]


@ti.func
def _place_of_row(state: ti.template(), low, count, k, stride_bits, axis: ti.template()):
    """The part of the coordinate low + k across rows, wrapped, in the index of a row's first cell,
    and whether k is less than `count`, as 1 or 0.

    stride_bits: the binary logarithm of the cells between coordinates.
    """
    wrapped = (low + k) & ((1 << state.grid_bits[axis]) - 1)
    return wrapped << stride_bits, ti.select(k < count, 1, 0)


@ti.func
def _sum_over_block(
    spec: ti.template(),
    state: ti.template(),
    at,
    rows,
    read,
    begin,
    end,
    size: ti.template(),
    term: ti.template(),
):
    """The sum of term(spec, state, at, other) over what is in cells `begin` to `end` of rows.

    rows: the first cells of two rows, or in 3-D of two by two; read: which of them, 1 or 0. It is
    one loop over all rows: where loops over few end, processors guess wrong.
    """
    n_rows = ti.static(2 ** (spec.dim - 1))
    until, shift, count = ti.Vector([0] * n_rows), ti.Vector([0] * n_rows), 0
    for k in ti.static(range(n_rows)):
        first = state.cell_end[rows[k] + begin]
        shift[k] = first - count
        count += read[k] * (state.cell_end[rows[k] + end] - first)
        until[k] = count
    total = ti.Vector.zero(state.real, size)
    for n in range(count):
        other = n + shift[n_rows - 1]
        for k in ti.static(range(n_rows - 2, -1, -1)):
            other = ti.select(n < until[k], n + shift[k], other)
        total += term(spec, state, at, other)
    return total


@ti.func
def _span(state: ti.template(), x, reach, axis: ti.template()):
    """The coordinates of the first cell within `reach` of x along an axis, and how many they are.

    No cell is counted twice where the grid is small, or the reach too far for whole numbers.
    """
    rounding = ti.static(8.0 * epsilon(state))
    span = reach + rounding * (reach + ti.abs(x))
    low, cells = _coordinate(state, x - span, axis), 1 << state.grid_bits[axis]
    count = ti.min(_coordinate(state, x + span, axis) - low + 1, cells)
    return low, ti.select(2.0 * span * state.per_cell[axis] >= cells, cells, count)


@ti.func
def sum_over_near(
    spec: ti.template(),
    state: ti.template(),
    at,
    x,
    reach,
    size: ti.template(),
    term: ti.template(),
):
    """The sum of term(spec, state, at, other), vectors (size,), over the places near x.

    They are those of all particles within `reach` of x (dim,), of large ones, and of some that are
    farther away; their order is the same for every number of threads.
    """
    total = ti.Vector.zero(state.real, size)
    along, width = _span(state, x[0], reach, 0)
    low_1, count_1 = _span(state, x[1], reach, 1)
    low_2, count_2 = 0, 1
    if ti.static(spec.dim == 3):
        low_2, count_2 = _span(state, x[2], reach, 2)
    cells = 1 << state.grid_bits[0]
    begin = along & (cells - 1)
    end = ti.min(begin + width, cells)
    beyond = begin + width - cells  # cells after the row's last one, which wrap around
    bits_1, bits_2 = state.grid_bits[0], state.grid_bits[0] + state.grid_bits[1]
    blocks_1, blocks_2 = (count_1 + 1) >> 1, (count_2 + 1) >> 1  # mostly two by two rows are one
    of_large = cell_count(spec, state)
    large = ti.cast(state.cell_end[of_large + 1] > state.cell_end[of_large], ti.i32)
    for block_2 in range(blocks_2 + large):
        last = block_2 == blocks_2  # the cell of large particles
        for block_1 in range(ti.select(last, 1, blocks_1)):
            n_rows = ti.static(2 ** (spec.dim - 1))
            rows, read = ti.Vector([0] * n_rows), ti.Vector([0] * n_rows)
            for k in ti.static(range(n_rows)):
                row, there = _place_of_row(state, low_1, count_1, 2 * block_1 + k % 2, bits_1, 1)
                if ti.static(spec.dim == 3):
                    layer, here = _place_of_row(
                        state, low_2, count_2, 2 * block_2 + k // 2, bits_2, 2
                    )
                    row, there = row + layer, there * here
                rows[k], read[k] = row, there
                if last:
                    rows[k], read[k] = of_large, ti.static(1 if k == 0 else 0)
            for part in range(ti.select((beyond > 0) & (not last), 2, 1)):
                first, past = begin, end
                if part == 1:
                    first, past = 0, beyond
                if last:
                    first, past = 0, 1
                total += _sum_over_block(spec, state, at, rows, read, first, past, size, term)
    return total
