"""A preconditioner of two levels for Newton directions on grids in lanes (`newton_matrix.py`).

The fine level is what A does to each particle alone, a block of dim x dim numbers. It is factored
as L D L^T, and no pivot is less than the particle's mass, as without rounding none would be; so it
stays positive definite however stiff springs are. The coarse level moves *blocks* of particles, at
most MOST of them, as rigidly as springs between them allow: with P, which gives every free particle
of a block the block's movement, it is P (P^T A P)^-1 P^T. Both levels are added. Smith, Bjorstad,
Gropp, "Domain decomposition", 1996, 1.3 and 2.1; Nicolaides, "Deflation of conjugate gradients with
applications to boundary value problems", SIAM J. Numer. Anal. 24, 1987 (such a P).

A block is some rows of a grid by some columns of its strips, so each of its packs gives every lane
a block of its own, and a *coarse pack* holds these, as packs hold particles. P^T A P is made once a
step, where springs are stiff, and inverted: it serves all directions of the step. It leaves out
negative stiffness, and each diagonal is a little larger, so that the inverse is positive in spite
of rounding. What conjugate gradients ask of the coarse level follows from the steps that they make
(`conjugate_gradients.py`), with one product by the inverse for each.
"""

import functools

import taichi as ti

from taichi_cloth.kernels.forces import has_tractions
from taichi_cloth.kernels.grids import (
    link_index,
    link_offset,
    pitch_of,
    renew_left_halo,
    renew_right_halo,
)
from taichi_cloth.kernels.loops import barrier, each, each_pack, each_row, share
from taichi_cloth.kernels.packs import (
    component,
    dot,
    epsilon,
    everywhere,
    number_in_pack,
    over_lanes,
    read,
    set_number_in_pack,
    set_slot_number,
    slot_number,
    vectors,
    where_positive,
    write,
    zeros,
)
from taichi_cloth.kernels.solvers.stages import own_diagonal, whole_diagonal
from taichi_cloth.kernels.state import block_packs

ALONG = 8  # blocks of a grid along each of its sides, where there is room for them
# (tau*omega)^2, of which springs' stiffness and masses give a bound, from which blocks pay.
STIFF = 100.0
LIFTED = 128.0  # by so many epsilons diagonals of P^T A P are larger


def has_two_levels(spec):
    """Whether directions are preconditioned so: A is symmetric, and all springs are links."""
    return spec.only_links and not has_tractions(spec)


# --- the fine level ------------------------------------------------------------------------------


@ti.func
def factor_particles(spec: ti.template(), state: ti.template(), t):
    """Factor what A does to each particle alone; it comes after `newton_matrix.keep_springs`.

    Where springs are soft, and blocks do not pay, the diagonal with every spring counted along
    every axis stands for it, which costs less than it needs sweeps.
    """
    if state.coarsened[None] == 1:
        each_row(spec, state, t, _renew_kept)
        each_row(spec, state, t, _factor_row)
    else:
        each_pack(spec, state, t, _take_diagonal)


@ti.func
def _renew_kept(spec: ti.template(), state: ti.template(), begin, width):
    """Renew the halos of what is kept of the links of a row."""
    for s in range(spec.kinds):
        first, columns = link_index(state, s, begin), state.link[s, 0]
        renew_left_halo(spec, state.link_axis, first, width, columns)
        renew_right_halo(spec, state.link_axis, first, width, -columns)
        for h in range(1, columns + 1):
            a = read(spec, state.link_across, first + width - h)
            write(spec, state.link_across, first - h, _from_lane(spec, state, a, -1))
        for h in range(-columns):
            a = read(spec, state.link_across, first + h)
            write(spec, state.link_across, first + width + h, _from_lane(spec, state, a, 1))


@ti.func
def _factor_row(spec: ti.template(), state: ti.template(), begin, width):
    """Factor what A does to each particle of a row."""
    g = state.grid_of[begin]
    pitch = pitch_of(spec, state, g)
    row = (begin - state.grid[g, 0]) // pitch
    for i in range(begin, begin + width):
        on, beside = zeros(spec, state), zeros(spec, state)
        if state.grid[g, 3] == 1:
            for end in range(2 * spec.kinds):  # links that begin at the pack, then those that end
                s = end % spec.kinds
                at = link_index(state, s, i)
                if end >= spec.kinds:
                    at -= link_offset(state, s, pitch)
                if end < spec.kinds or row >= state.link[s, 1]:
                    a = read(spec, state.link_axis, at)
                    c = ti.max(read(spec, state.link_across, at), 0.0)
                    on += a * a + c  # too much along springs that push
                    beside += a * _turned(spec, a)
        _factor_pack(spec, state, i, on, beside)


@ti.func
def _take_diagonal(spec: ti.template(), state: ti.template(), i):
    """Take `stages.whole_diagonal` for what A does to each particle of pack i alone."""
    w = read(spec, state.w, i)
    over = ti.select(w > 0.0, 1.0 / whole_diagonal(spec, state, i), 0.0 * w)
    write(spec, state.over_pivots, i, vectors([over for _ in ti.static(range(spec.dim))]))
    write(spec, state.below, i, zeros(spec, state))


@ti.func
def _turned(spec: ti.template(), u):
    """The vectors u with each component where the one before it was."""
    return vectors([component(u, (k + 1) % spec.dim) for k in ti.static(range(spec.dim))])


@ti.func
def _factor_pack(spec: ti.template(), state: ti.template(), i, on, beside):
    """Factor A of each particle of pack i, from the sums over its springs.

    on: the diagonal; beside: what stands beside it, xy, and in space yz and zx.
    """
    w, tau = read(spec, state.w, i), state.tau[None]
    least = ti.select(w > 0.0, own_diagonal(spec, state, i), 0.0 * w + 1.0)
    k = tau * tau
    xy = k * component(beside, 0)
    p0 = least + ti.max(k * component(on, 0), 0.0)
    below = xy / p0
    p1 = ti.max(least + k * component(on, 1) - below * xy, least)
    none = 0.0 * w
    over0, over1 = ti.select(w > 0.0, 1.0 / p0, none), ti.select(w > 0.0, 1.0 / p1, none)
    if ti.static(spec.dim == 2):
        write(spec, state.over_pivots, i, vectors([over0, over1]))
        write(spec, state.below, i, vectors([below, none]))
    else:
        zx = k * component(beside, 2)
        yz = k * component(beside, 1) - below * zx
        below2, below1 = zx / p0, yz / p1
        p2 = ti.max(least + k * component(on, 2) - below2 * zx - below1 * yz, least)
        over2 = ti.select(w > 0.0, 1.0 / p2, none)
        write(spec, state.over_pivots, i, vectors([over0, over1, over2]))
        write(spec, state.below, i, vectors([below, below1, below2]))


@ti.func
def _lowered(spec: ti.template(), below, r):
    """L^-1 r for pack i's vectors r."""
    first = component(r, 0)
    second = component(r, 1) - component(below, 0) * first
    if ti.static(spec.dim == 2):
        return vectors([first, second])
    else:
        third = component(r, 2) - component(below, 2) * first - component(below, 1) * second
        return vectors([first, second, third])


@ti.func
def fine_energies(spec: ti.template(), state: ti.template(), i, a, b):
    """The products of the vectors a with a, a with b, and b with b, for pack i, preconditioned by
    the fine level.
    """
    below, over = read(spec, state.below, i), read(spec, state.over_pivots, i)
    low_a, low_b = _lowered(spec, below, a), _lowered(spec, below, b)
    return [dot(low_a, over * low_a), dot(low_a, over * low_b), dot(low_b, over * low_b)]


@ti.func
def downhill(spec: ti.template(), state: ti.template(), i, residual):
    """The residual of pack i, preconditioned by both levels; 0 where particles are fixed."""
    below = read(spec, state.below, i)
    over = read(spec, state.over_pivots, i)
    z = over * _lowered(spec, below, residual)
    coarse = read(spec, state.coarse_downhill, state.block_of[i])
    if ti.static(spec.dim == 2):
        second = component(z, 1)
        first = component(z, 0) - component(below, 0) * second
        z = vectors([first, second])
    else:
        third = component(z, 2)
        second = component(z, 1) - component(below, 1) * third
        first = component(z, 0) - component(below, 0) * second - component(below, 2) * third
        z = vectors([first, second, third])
    return z + where_positive(component(over, 0), coarse, 0.0 * coarse)


# --- the coarse level: its matrix and inverse ----------------------------------------------------


def unknowns(spec):
    """How many numbers the coarse level has at most."""
    return block_packs(spec) * spec.dim * spec.lanes


@ti.func
def _entry(spec: ti.template(), state: ti.template(), row, column):
    """Where the number at `row` and `column` of the coarse matrix is, before it is inverted."""
    return (_half(spec, state, 0) + row) * ti.static(unknowns(spec)) + column


@ti.func
def _unknown(spec: ti.template(), b, axis, lane):
    """The number of what a block moves along an axis: that in a lane of coarse pack b."""
    return (b * spec.dim + axis) * spec.lanes + lane


@ti.func
def coarsen(spec: ti.template(), state: ti.template(), t):
    """Make the coarse matrix, and invert it; it comes after `newton_matrix.keep_springs`."""
    each(spec, state, t, 1, _lay_out)
    each_row(spec, state, t, _note_blocks)
    each_row(spec, state, t, _renew_kept)
    each(spec, state, t, state.n_blocks[None], _sum_block)
    n = state.n_blocks[None] * spec.dim
    pairs = n * ti.static(spec.lanes // 2)
    for k in range(n):
        if t == 0:
            _invert_pivots(spec, state, k)
        barrier(spec, state, t)
        for pair in range(share(spec, pairs, t), share(spec, pairs, t + 1)):
            _eliminate(spec, state, pair, k, n)
        barrier(spec, state, t)


@ti.func
def _lay_out(spec: ti.template(), state: ti.template(), _):
    """Choose how many rows and columns of coarse packs each grid has, and number them."""
    grids, last = 0, 0
    for g in range(state.n_grids[None]):
        grids += state.grid[g, 3]
    room = ti.static(block_packs(spec)) // ti.max(grids, 1)
    for g in range(state.n_grids[None]):
        rows, width = state.grid[g, 1], state.grid[g, 2]
        columns = ti.min(ti.max(ti.static(ALONG // spec.lanes), 1), width)
        along = 0
        if state.grid[g, 3] == 1:
            along = ti.min(ti.min(ALONG, rows), room // columns)
        state.blocks[g, 0], state.blocks[g, 1], state.blocks[g, 2] = last, along, columns
        last += along * columns
    state.n_blocks[None] = last


@ti.func
def _note_blocks(spec: ti.template(), state: ti.template(), begin, width):
    """Note of each pack of a row which coarse pack it is in, and whether any of it is fixed."""
    g = state.grid_of[begin]
    rows, along = state.grid[g, 1], state.blocks[g, 1]
    row = (begin - state.grid[g, 0]) // pitch_of(spec, state, g)
    for p in range(width):
        columns = state.blocks[g, 2]
        at = state.blocks[g, 0] + (row * along // rows) * columns + p * columns // width
        if along == 0:
            at = ti.static(block_packs(spec))  # one that never moves
        state.block_of[begin + p] = at
        w = read(spec, state.w, begin + p)
        fixed = over_lanes(spec, ti.select(w > 0.0, 0.0 * w, 0.0 * w + 1.0))
        state.holds_fixed[begin + p] = ti.select(fixed > 0.0, 1, 0)


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
    n = state.n_blocks[None] * spec.dim
    for row in range(_unknown(spec, b, 0, 0), _unknown(spec, b + 1, 0, 0)):
        for h in range(n):
            at = _entry(spec, state, row, h * spec.lanes) // spec.lanes
            write(spec, state.coarse, at, everywhere(spec, ti.cast(0.0, state.real)))
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
                    _add_to_rows(spec, state, b, -1.0 * tied_on, -1.0 * tied_beside, to, shift)
                    to, shift = state.block_of[other], over
                    tied_on, tied_beside = 0.0 * tied_on, 0.0 * tied_beside
                w, far = read(spec, state.w, i), read(spec, state.w, other)
                far = _from_lane(spec, state, far, over)
                counts = ti.select(w > 0.0, 0.0 * w + 1.0, 0.0 * w)
                ties = ti.select(far > 0.0, counts, 0.0 * w)
                if not leaves:
                    counts, ties = counts - ties, 0.0 * w
                link_on, link_beside = _own_part(spec, state, link_index(state, s, i) - begins)
                on += counts * link_on
                beside += counts * link_beside
                tied_on += ties * link_on
                tied_beside += ties * link_beside
    _add_to_rows(spec, state, b, -1.0 * tied_on, -1.0 * tied_beside, to, shift)
    return on, beside


@ti.func
def _from_lane(spec: ti.template(), state: ti.template(), a, shift):
    """The numbers a, of each lane those of the lane `shift` farther; 0 where there is none."""
    later = ti.Vector([a[lane] for lane in range(1, spec.lanes)] + [0.0])
    earlier = ti.Vector([0.0] + [a[lane] for lane in range(spec.lanes - 1)])
    to = 0.0 * a + ti.cast(shift, state.real)
    return ti.select(to > 0.0, later, ti.select(to < 0.0, earlier, a))


@ti.func
def _own_part(spec: ti.template(), state: ti.template(), at):
    """What the links at `at` add to A on their ends' diagonals, and beside them (xy, yz, zx)."""
    a, across = read(spec, state.link_axis, at), read(spec, state.link_across, at)
    square, tau = dot(a, a), state.tau[None]
    # Without negative stiffness across, the stiffness along the axis stays what it is.
    one = 0.0 * across + 1.0
    part = ti.max(square + across, 0.0) / ti.select(across < 0.0, square, one)
    more = ti.select(across < 0.0, part, one)
    k, c = tau * tau * more, tau * tau * ti.max(across, 0.0)
    return k * (a * a) + c, k * (a * _turned(spec, a))


@ti.func
def _add_to_rows(spec: ti.template(), state: ti.template(), b, on, beside, to, shift):
    """Add a symmetric matrix for each lane to the rows of coarse pack b.

    on, beside: what is on its diagonal and beside that (xy, yz, zx); to, shift: it goes to the
    columns of coarse pack `to`, lanes `shift` farther.
    """
    write(spec, state.coarse_product, b, on)  # which nobody needs yet, for its numbers one by one
    write(spec, state.coarse_solved, b, beside)
    for lane in range(ti.max(0, -shift), spec.lanes - ti.max(0, shift)):
        for a in range(spec.dim):
            for k in range(spec.dim):
                number = number_in_pack(spec, state.coarse_product, b, a * spec.lanes + lane)
                if a != k:
                    which = ti.select((a + 1) % spec.dim == k, a, k)
                    which = which * spec.lanes + lane
                    number = number_in_pack(spec, state.coarse_solved, b, which)
                to_column = _unknown(spec, to, k, lane + shift)
                at = _entry(spec, state, _unknown(spec, b, a, lane), to_column)
                number += slot_number(spec, state.coarse, at)
                set_slot_number(spec, state.coarse, at, number)


@ti.func
def _invert_pivots(spec: ti.template(), state: ti.template(), k):
    """Invert what pack k of unknowns does to itself: pack m of pivots is row m of the inverse.

    What no particle moves, or rounding has left no stiffness, becomes 0 (Gauss, Jordan).
    """
    first = _half(spec, state, k) + k * spec.lanes
    for m in range(spec.lanes):
        write(spec, state.pivots, m, read(spec, state.coarse, _pack_of(spec, first + m) + k))
    for m in range(spec.lanes):
        pivot = number_in_pack(spec, state.pivots, m, m)
        over = ti.select(pivot > 0.0, 1.0 / ti.select(pivot > 0.0, pivot, 1.0), 0.0)
        own = over * read(spec, state.pivots, m)
        for j in range(spec.lanes):
            if j != m:
                factor = number_in_pack(spec, state.pivots, j, m)
                write(spec, state.pivots, j, read(spec, state.pivots, j) - factor * own)
                set_number_in_pack(spec, state.pivots, j, m, -over * factor)
        write(spec, state.pivots, m, own)
        set_number_in_pack(spec, state.pivots, m, m, over)


@ti.func
def _eliminate(spec: ti.template(), state: ti.template(), pair, k, n):
    """Take pack k of unknowns out of a pair of rows, from one half of the room to the other.

    After all n packs the rows are those of the inverse, in the first half (Gauss, Jordan, by
    blocks; Golub, Van Loan, "Matrix Computations", 4th ed., 2013, 3.2.10). What is taken from two
    rows at once is read once for both.
    """
    j = 2 * pair
    own = _pack_of(spec, _half(spec, state, k) + j)
    by = _pack_of(spec, _half(spec, state, k) + k * spec.lanes)
    to = _pack_of(spec, _half(spec, state, k + 1) + j)
    keep = ti.select(j // spec.lanes == k, 0.0, 1.0)
    a, b = _taken(spec, state, j, k), _taken(spec, state, j + 1, k)
    for h in range(n):
        first = keep * read(spec, state.coarse, own + h)
        second = keep * read(spec, state.coarse, own + ti.static(_pitch(spec)) + h)
        for m in ti.static(range(spec.lanes)):
            taken = read(spec, state.coarse, by + ti.static(m * _pitch(spec)) + h)
            first, second = first + a[m] * taken, second + b[m] * taken
        if h == k:
            first, second = a, b
        write(spec, state.coarse, to + h, first)
        write(spec, state.coarse, to + ti.static(_pitch(spec)) + h, second)


@ti.func
def _taken(spec: ti.template(), state: ti.template(), j, k):
    """How much of each row of pack k of unknowns row j gets, as they are taken out of it."""
    factors = read(spec, state.pivots, j % spec.lanes)
    if j // spec.lanes != k:
        mine = read(spec, state.coarse, _pack_of(spec, _half(spec, state, k) + j) + k)
        factors = 0.0 * mine
        for m in ti.static(range(spec.lanes)):
            factors = factors - mine[m] * read(spec, state.pivots, m)
    return factors


@ti.func
def _half(spec: ti.template(), state: ti.template(), k):
    """The first row of the half of the room that has the coarse matrix before pack k is out.

    As all are out, it is the first half.
    """
    return ((state.n_blocks[None] * spec.dim - k) & 1) * ti.static(unknowns(spec))


def _pitch(spec):
    """How many packs a row of the coarse matrix has room for."""
    return unknowns(spec) // spec.lanes


@ti.func
def _pack_of(spec: ti.template(), row):
    """The first pack of a row of the coarse matrix."""
    return row * ti.static(_pitch(spec))


# --- what conjugate gradients ask of the coarse level -------------------------------------------


@ti.func
def begin_coarse(spec: ti.template(), state: ti.template(), t):
    """Begin with the coarse level of the residual."""
    each(spec, state, t, ti.static(block_packs(spec) + 1), _clear)
    each(spec, state, t, state.n_blocks[None], ti.static(_summing("residual", "coarse_residual")))
    each(
        spec,
        state,
        t,
        state.n_blocks[None],
        ti.static(_solving("coarse_residual", "coarse_downhill")),
    )


@ti.func
def _clear(spec: ti.template(), state: ti.template(), b):
    write(spec, state.coarse_downhill, b, zeros(spec, state))


@ti.func
def coarse_product(spec: ti.template(), state: ti.template(), t):
    """Compute the coarse level of a product, and what the inverse makes of it."""
    each(spec, state, t, state.n_blocks[None], ti.static(_summing("product", "coarse_product")))
    each(
        spec,
        state,
        t,
        state.n_blocks[None],
        ti.static(_solving("coarse_product", "coarse_solved")),
    )


@functools.cache
def _summing(name, to):
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


@functools.cache
def _solving(name, to):
    """The body of a loop over coarse packs that multiplies the vectors `name` by the inverse."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), b):
        field = ti.static(getattr(state, name))
        total = zeros(spec, state)
        numbers = ti.static(spec.dim * spec.lanes)
        for other in range(state.n_blocks[None]):
            for k in range(numbers):
                at = _pack_of(spec, other * numbers + k) + b * spec.dim
                number = number_in_pack(spec, field, other, k)
                rows = [read(spec, state.coarse, at + axis) for axis in ti.static(range(spec.dim))]
                total += number * vectors(rows)
        write(spec, ti.static(getattr(state, to)), b, total)

    return body


@ti.func
def coarse_dot(spec: ti.template(), state: ti.template(), a: ti.template(), b: ti.template()):
    """The scalar product of two fields of vectors of the coarse level."""
    total = ti.cast(0.0, state.real)
    for k in range(state.n_blocks[None]):
        total += over_lanes(spec, dot(read(spec, a, k), read(spec, b, k)))
    return total


@ti.func
def step_coarse(spec: ti.template(), state: ti.template(), step):
    """Go a step of so many directions, on the coarse level."""
    for b in range(state.n_blocks[None]):
        r = read(spec, state.coarse_residual, b) - step * read(spec, state.coarse_product, b)
        z = read(spec, state.coarse_downhill, b) - step * read(spec, state.coarse_solved, b)
        write(spec, state.coarse_residual, b, r)
        write(spec, state.coarse_downhill, b, z)
