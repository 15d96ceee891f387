"""The blocks of grids in lanes, and the coarse matrix that their links make.

A block is some rows of a grid by some columns of its strips, so each of its packs gives every lane
a block of its own.
"""

import functools

import taichi as ti

from taichi_cloth.kernels.grids import link_index, link_offset, pitch_of
from taichi_cloth.kernels.loops import each, each_row
from taichi_cloth.kernels.packs import (
    epsilon,
    number_in_pack,
    over_lanes,
    read,
    set_slot_number,
    slot_number,
    write,
    zeros,
)
from taichi_cloth.kernels.solvers.coarse_level import (
    LIFTED,
    clear_rows,
    entry,
    part_of_springs,
    unknown,
    unknowns,
)
from taichi_cloth.kernels.solvers.kept_links import from_lane, renew_kept
from taichi_cloth.kernels.solvers.stages import own_diagonal, roughness
from taichi_cloth.kernels.state import block_packs

ACROSS = 8  # blocks of a grid beside each other, where there is room for them
# Blocks of a grid in space for each 1 of the root of its particles' number. To invert the matrix of
# 64 takes as long as 15 sweeps over 64 x 64 particles, and as more over fewer than they spare. In
# the plane it takes a third of that, and a grid has all the rows that there is room for.
BLOCKS_PER_ROOT = 1.0
# Rows of blocks for rough solutions, of a cloth of any size: with fewer these would leave up to
# three times as much.
ROUGHLY = 4


@ti.func
def sum_blocks_of_grids(spec: ti.template(), state: ti.template(), t):
    """Lay the blocks out, and make the coarse matrix."""
    each(spec, state, t, 1, _lay_out)
    each_row(spec, state, t, _note_blocks)
    each_row(spec, state, t, renew_kept)
    each(spec, state, t, state.n_blocks[None], _sum_block)


@ti.func
def _lay_out(spec: ti.template(), state: ti.template(), _):
    """Choose how many rows and columns of coarse packs each grid has, and number them."""
    grids, last = 0, 0
    for g in range(state.n_grids[None]):
        grids += state.grid[g, 3]
    room = ti.static(block_packs(spec)) // ti.max(grids, 1)
    for g in range(state.n_grids[None]):
        rows, width = state.grid[g, 1], state.grid[g, 2]
        columns = ti.min(ti.max(ti.static(ACROSS // spec.lanes), 1), width)
        along = 0
        if state.grid[g, 3] == 1:
            along = ti.min(_rows_of_blocks(spec, state, rows, width, columns), room // columns)
        state.blocks[g, 0], state.blocks[g, 1], state.blocks[g, 2] = last, along, columns
        last += along * columns
    state.n_blocks[None] = last


@ti.func
def _rows_of_blocks(spec: ti.template(), state: ti.template(), rows, width, columns):
    """The rows of blocks of a grid of so many rows and packs in each: see `BLOCKS_PER_ROOT`.

    columns: of coarse packs in each row of blocks.
    """
    along = 0 + ti.static(ACROSS)
    if ti.static(spec.dim == 3):
        particles = ti.cast(rows * width * spec.lanes, state.real)
        in_row = ti.cast(columns * spec.lanes, state.real)
        along = ti.max(ti.cast(BLOCKS_PER_ROOT * ti.sqrt(particles) / in_row + 0.5, ti.i32), 1)
    return ti.min(ti.select(roughness(state) > 1.0, ROUGHLY, along), rows)


@ti.func
def _note_blocks(spec: ti.template(), state: ti.template(), begin, width):
    """Note of each pack of a row which coarse pack it is in, and whether any of it is fixed."""
    for p in range(width):
        state.block_of[begin + p] = _block_in_row(spec, state, begin, p)
        w = read(spec, state.w, begin + p)
        fixed = over_lanes(spec, ti.select(w > 0.0, 0.0 * w, 0.0 * w + 1.0))
        state.holds_fixed[begin + p] = ti.select(fixed > 0.0, 1, 0)


@ti.func
def _block_in_row(spec: ti.template(), state: ti.template(), begin, p):
    """Which coarse pack the pack number p of a row is in; on no grid: one that never moves."""
    at = 0 + ti.static(block_packs(spec))
    g = state.grid_of[begin]
    if g >= 0:
        along, columns = state.blocks[g, 1], state.blocks[g, 2]
        if along > 0:
            row = (begin - state.grid[g, 0]) // pitch_of(spec, state, g)
            row = row * along // state.grid[g, 1]
            at = state.blocks[g, 0] + row * columns + p * columns // state.grid[g, 2]
    return at


@ti.func
def _first_of(part, whole, parts):
    """The first of `whole` things that falls to one of so many parts."""
    return (part * whole + parts - 1) // parts


@ti.func
def _box(state: ti.template(), b, g):
    """The rows and the columns of packs of grid g that are in coarse pack b: from, to, from, to.

    There are none where the pack is of another grid.
    """
    along, columns, k = state.blocks[g, 1], state.blocks[g, 2], b - state.blocks[g, 0]
    rows, width = state.grid[g, 1], state.grid[g, 2]
    box = ti.Vector([0, 0, 0, 0])
    if k >= 0 and k < along * columns:
        row, column = k // columns, k % columns
        top, bottom = _first_of(row, rows, along), _first_of(row + 1, rows, along)
        left, right = _first_of(column, width, columns), _first_of(column + 1, width, columns)
        box = ti.Vector([top, bottom, left, right])
    return box


@ti.func
def _sum_block(spec: ti.template(), state: ti.template(), b):
    """Make the rows of the coarse matrix that belong to coarse pack b."""
    clear_rows(spec, state, b)
    on, beside = zeros(spec, state), zeros(spec, state)
    for g in range(state.n_grids[None]):
        box = _box(state, b, g)
        for r in range(box[0], box[1]):
            row = state.grid[g, 0] + r * pitch_of(spec, state, g)
            for i in range(row + box[2], row + box[3]):
                w = read(spec, state.w, i)
                alone = ti.select(w > 0.0, own_diagonal(spec, state, i), 0.0 * w)
                on += alone
        if box[1] > box[0]:
            for end in range(2 * spec.kinds):
                held_on, held_beside = _sum_ends(spec, state, b, g, box, end)
                on += held_on
                beside += held_beside
    lifted = ti.static(1.0 + LIFTED * epsilon(state))
    _add_to_rows(spec, state, b, lifted * on, beside, b, 0)


@ti.func
def _sum_ends(spec: ti.template(), state: ti.template(), b, g, box, end):
    """Sum those links of coarse pack b that leave their block, or hold it, of one kind and end.

    box: `_box`; end: links of kind `end` begin in it, those of kind `end` - spec.kinds end there.
    What the block's movement makes of their forces on it is returned (`_own_part`), what that of
    other blocks does is added to the coarse matrix.
    """
    s, first, pitch = end % spec.kinds, state.grid[g, 0], pitch_of(spec, state, g)
    down, aside, begins = state.link[s, 1], state.link[s, 0], 0
    if end >= spec.kinds:
        down, aside, begins = -down, -aside, link_offset(state, s, pitch)
    width = state.grid[g, 2]
    on, beside = zeros(spec, state), zeros(spec, state)
    # What other blocks do is that of lanes `shift` farther in coarse pack `to`, one after another.
    to, shift = b, 0
    tied_on, tied_beside = zeros(spec, state), zeros(spec, state)
    for r in range(ti.max(box[0], -down), ti.min(box[1], state.grid[g, 1] - down)):
        for p in range(box[2], box[3]):
            i, column, over = first + r * pitch + p, p + aside, 0
            if column >= width:
                column, over = column - width, 1
            elif column < 0:
                column, over = column + width, -1
            other = first + (r + down) * pitch + column
            leaves = over != 0 or state.block_of[other] != b
            if leaves or state.holds_fixed[other] == 1:
                if leaves and (to != state.block_of[other] or shift != over):
                    _add_tied(spec, state, b, tied_on, tied_beside, to, shift)
                    to, shift = state.block_of[other], over
                    tied_on, tied_beside = 0.0 * tied_on, 0.0 * tied_beside
                w, far = read(spec, state.w, i), read(spec, state.w, other)
                far = from_lane(spec, state, far, over)
                counts = ti.select(w > 0.0, 0.0 * w + 1.0, 0.0 * w)
                ties = ti.select(far > 0.0, counts, 0.0 * w)
                if not leaves:
                    counts, ties = counts - ties, 0.0 * w
                link_on, link_beside = _own_part(spec, state, link_index(state, s, i) - begins)
                on += counts * link_on
                beside += counts * link_beside
                tied_on += ties * link_on
                tied_beside += ties * link_beside
    _add_tied(spec, state, b, tied_on, tied_beside, to, shift)
    return on, beside


@ti.func
def _add_tied(spec: ti.template(), state: ti.template(), b, on, beside, to, shift):
    """Add what lanes `shift` farther in coarse pack `to` do to coarse pack b, if they are others
    than its own: of these nothing was summed.
    """
    if to != b or shift != 0:
        _add_to_rows(spec, state, b, -1.0 * on, -1.0 * beside, to, shift)


@ti.func
def _own_part(spec: ti.template(), state: ti.template(), at):
    """The terms of the links at `at` in A on their ends' diagonals, and beside them."""
    axis, across = read(spec, state.link_axis, at), read(spec, state.link_across, at)
    return part_of_springs(spec, state, axis, across)


@ti.func
def _add_to_rows(spec: ti.template(), state: ti.template(), b, on, beside, to, shift):
    """Add a symmetric matrix for each lane to the rows of coarse pack b.

    on, beside: what is on its diagonal and beside that (xy, yz, zx); to, shift: it goes to the
    columns of coarse pack `to`, lanes `shift` farther.
    """
    write(spec, state.coarse_product, b, on)  # which nobody needs yet, for its numbers one by one
    write(spec, state.coarse_solved, b, beside)
    for a in range(spec.dim):
        for k in range(spec.dim):
            first = entry(spec, state, unknown(spec, b, a, 0), unknown(spec, to, k, shift))
            which = ti.select((a + 1) % spec.dim == k, a, k) * spec.lanes
            for lane in range(ti.max(0, -shift), spec.lanes - ti.max(0, shift)):
                number = number_in_pack(spec, state.coarse_product, b, a * spec.lanes + lane)
                if a != k:
                    number = number_in_pack(spec, state.coarse_solved, b, which + lane)
                at = first + lane * ti.static(unknowns(spec) + 1)
                number += slot_number(spec, state.coarse, at)
                set_slot_number(spec, state.coarse, at, number)


@functools.cache
def summing_grids(name, to):
    """The body of a loop over coarse packs that sums the vectors `name` of their particles."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), b):
        total = zeros(spec, state)
        for g in range(state.n_grids[None]):
            box = _box(state, b, g)
            for r in range(box[0], box[1]):
                row = state.grid[g, 0] + r * pitch_of(spec, state, g)
                for i in range(row + box[2], row + box[3]):
                    total += read(spec, ti.static(getattr(state, name)), i)
        write(spec, ti.static(getattr(state, to)), b, total)

    return body
