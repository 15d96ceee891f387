"""Spring forces, on both topologies: a graph (half-springs in rows) and regular grids (links).

Whatever a spring between two particles contributes is a ti.func `between(plan, state, value, i, j,
k, rest, c)`: what particle i gets from the spring to j, of which j gets the opposite. It reads
fields by `value(plan, field, i)`: of whole cells of a grid, or of single particles of a graph.
`accumulate` sums it over the springs of each cell and hands the sum to `receive(plan, state, c,
sum)`. Forces are one such contribution, a product with the stiffness matrix is another. No atomics:
the same bits on every run, for every number of threads.
"""

import functools

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.compensated import apart
from taichi_cloth.kernels.loops import PIECE, barrier, each, leave, renew_halos, share
from taichi_cloth.kernels.packs import (
    link_offset,
    of_kind,
    pitch_of,
    read,
    renew_left_halo,
    renew_right_halo,
    scaled,
    site_value,
    write,
    zeros,
)


@ti.func
def accumulate(
    plan: ti.template(),
    state: ti.template(),
    t,
    between: ti.template(),
    receive: ti.template(),
    receive_more: ti.template(),
):
    """For every cell c: receive(plan, state, c, sum over its springs).

    In lanes `receive` may already move its cell (see `sweep`); elsewhere it must leave what others
    read. receive_more(plan, state, site, sum): for the springs that no grid holds, in scenes with
    grids; it comes after all `receive`.
    """
    if ti.static(plan.lanes > 1):
        _sweep_grids(plan, state, t, leave, between, receive)
    else:
        each(plan, state, t, state.n_cells[None], ti.static(_summing(between, receive)))
    if ti.static(plan.springs and plan.kinds > 0):
        each(plan, state, t, state.n_near[None], ti.static(_summing_more(between, receive_more)))


@ti.func
def move_and_accumulate(
    plan: ti.template(),
    state: ti.template(),
    t,
    move: ti.template(),
    between: ti.template(),
    receive: ti.template(),
):
    """In lanes alone: move(plan, state, c) for every cell, then, in the same pass over memory, for
    each one that receives: receive(plan, state, c, sum over its springs), which may move it again.
    """
    for g in range(state.n_grids[None]):
        begin = grid_share(plan, state.grid[g, 1], t)
        end = grid_share(plan, state.grid[g, 1], t + 1)
        # What others' links reach, and what is behind the row that a sweep moves first.
        for r in range(begin, ti.min(begin + plan.depth, end)):
            _move_row(plan, state, g, r, move)
        for r in range(ti.max(begin + plan.depth, end - plan.depth), end):
            _move_row(plan, state, g, r, move)
    barrier(plan, state)
    _sweep_grids(plan, state, t, move, between, receive)


@ti.func
def _sweep_grids(
    plan: ti.template(),
    state: ti.template(),
    t,
    move: ti.template(),
    between: ti.template(),
    receive: ti.template(),
):
    if ti.static(plan.spread):
        for phase in ti.static(range(2)):
            for i in range(plan.threads * PIECE):
                if i % PIECE == 0:
                    sweep(plan, state, i // PIECE, phase, move, between, receive)
    elif ti.static(plan.threads == 1):
        sweep(plan, state, t, 1, move, between, receive)
    else:
        for phase in range(2):  # at run time: unrolled, it takes twice as long to compile
            if phase == 1:
                barrier(plan, state)
            sweep(plan, state, t, phase, move, between, receive)
    barrier(plan, state)


def _moves(move):
    return move is not leave


@ti.func
def _move_row(plan: ti.template(), state: ti.template(), g, r, move: ti.template()):
    begin, width = state.grid[g, 0] + r * pitch_of(plan, state, g), state.grid[g, 2]
    for c in range(begin, begin + width):
        move(plan, state, c)
    renew_halos(plan, state, begin, width)


@functools.cache
def _summing(between, receive):
    @ti.func
    def body(plan: ti.template(), state: ti.template(), c):
        receive(plan, state, c, sum_at_cell(plan, state, between, c))

    return body


@functools.cache
def _summing_more(between, receive_more):
    @ti.func
    def body(plan: ti.template(), state: ti.template(), p):
        site = state.near[p]
        total = sum_of_half_springs(plan, state, site_value, between, p, site)
        receive_more(plan, state, site, total)

    return body


@ti.func
def sum_at_cell(plan: ti.template(), state: ti.template(), between: ti.template(), c):
    """Sum over the springs of cell c, each computed from both of its ends."""
    if ti.static(plan.kinds > 0):
        return sum_of_links(plan, state, between, c)
    elif ti.static(plan.springs):
        return sum_of_half_springs(plan, state, read, between, c, c)
    else:
        return zeros(plan, state)


@ti.func
def force_between(
    plan: ti.template(), state: ti.template(), value: ti.template(), i, j, k, rest, c
):
    """Force of a spring, with its dashpot, on i."""
    d = apart(plan, state, value, i, j)
    length = laws.length(d)
    along = laws.unit(d, length)
    tension = laws.spring_tension(length, k, rest)
    if ti.static(plan.dashpots):
        dv = value(plan, state.v, j) - value(plan, state.v, i)
        tension += laws.dashpot_tension(dv, along, c)
    return scaled(tension, along)


# --- on a graph ------------------------------------------------------------------------------


@ti.func
def number(plan: ti.template(), of: ti.template(), s):
    """A (half-)spring's k, rest, c or limit: its own, or the one that all of them share."""
    if ti.static(plan.uniform_springs):
        return of[None]
    else:  # without it, Taichi would read both
        return of[s]


@ti.func
def sum_of_half_springs(
    plan: ti.template(), state: ti.template(), value: ti.template(), between: ti.template(), p, i
):
    """Sum over the half-springs of the p-th row, which are those of particle i, in their order."""
    total = 0.0 * value(plan, state.x, i)
    for h in range(state.near_row[p], state.near_row[p + 1]):
        c = ti.cast(0.0, state.real)
        if ti.static(plan.dashpots):
            c = number(plan, state.c, h)
        total += between(
            plan,
            state,
            value,
            i,
            state.far[h],
            number(plan, state.k, h),
            number(plan, state.rest, h),
            c,
        )
    return total


# --- on grids --------------------------------------------------------------------------------


@ti.func
def link_stiffness(plan: ti.template(), state: ti.template(), s, c):
    """Stiffness of cell c's links of kind s; 0 where there is none, or none any more."""
    return read(plan, state.link_k, of_kind(state, s, c))


@ti.func
def link_damping(plan: ti.template(), state: ti.template(), s, g, k):
    """Dashpots of links of kind s in grid g: a link without stiffness k has none either."""
    damping = 0.0 * k
    if ti.static(plan.dashpots):
        damping = ti.select(k > 0.0, state.link_c[s, g], 0.0 * k)
    return damping


@ti.func
def link_value(plan: ti.template(), state: ti.template(), between: ti.template(), s, g, c, far, k):
    """What cell c gets from its links of kind s, of stiffness k, to later particles at far."""
    damping = link_damping(plan, state, s, g, k)
    return between(plan, state, read, c, far, k, state.link_rest[s, g], damping)


@ti.func
def grid_share(plan: ti.template(), rows, t):
    """First row of thread t's share of a grid; too few rows for all threads are the first one's."""
    first = share(plan, rows, t)
    if rows < plan.threads * plan.depth:
        first = ti.select(t == 0, 0, rows)
    return first


@ti.func
def tail(plan: ti.template(), state: ti.template(), g, t):
    """Where the links of the last rows of thread t's share of grid g are kept; before thread 0's
    there are rows of zeros, for a grid's first rows: they come first, where a run with another
    number of threads has written nothing.
    """
    rows = plan.depth + plan.threads * plan.ring + (g * plan.threads + t) * plan.depth
    return ti.select(t < 0, 0, rows) * state.row + plan.halo


@ti.func
def give(
    plan: ti.template(), state: ti.template(), between: ti.template(), g, c, stiffness, pitch, to
):
    """Compute what cell c of grid g gets from its links to later particles, into state.given[to].

    stiffness: the cell whose links' stiffness is theirs.
    """
    for s in range(plan.kinds):
        far, k = c + link_offset(state, s, pitch), link_stiffness(plan, state, s, stiffness)
        value = link_value(plan, state, between, s, g, c, far, k)
        write(plan, state.given, s * state.given_size + to, value)


@ti.func
def sweep(
    plan: ti.template(),
    state: ti.template(),
    t,
    phase,
    move: ti.template(),
    between: ti.template(),
    receive: ti.template(),
):
    """Each link once, row by row, in thread t's share of every grid.

    The links of a row are computed before its turn, into a ring of rows; in its turn its cells add
    up what they give and, negated, what is given to them, while those of the next row are computed:
    one waits for memory and the other computes. Rows above are never looked at again, so `receive`
    may change what `between` reads of its cell. So that no thread changes what another one needs,
    the last rows of a share, whose links reach into the next one, are computed before all else:
    that is phase 0, and phase 1 the rest; with one thread there is only phase 1.

    A row moves (`move_and_accumulate`) right before the first links that reach it are computed; the
    first and last rows of a share have moved already.
    """
    for g in range(state.n_grids[None]):
        first, rows, width = state.grid[g, 0], state.grid[g, 1], state.grid[g, 2]
        linked, pitch = state.grid[g, 3] == 1, pitch_of(plan, state, g)
        begin, end = grid_share(plan, rows, t), grid_share(plan, rows, t + 1)
        start, turns, computed = begin, end, end  # the rows whose turn it is, and to be computed
        if ti.static(plan.threads > 1):
            computed = end - plan.depth
            if phase == 0:
                start, turns, computed = ti.max(begin, end - plan.depth), end - 1, end
        for r in range(start - 1, turns):
            if ti.static(_moves(move)):
                next_row = r + 1 + plan.depth
                if phase == 1 and begin + plan.depth <= next_row and next_row < end - plan.depth:
                    _move_row(plan, state, g, next_row, move)
            row = first + r * pitch
            gives, receives = linked and r + 1 < computed, phase == 1 and r >= start
            here = given_row(plan, state, g, t, begin, end, r)
            ahead = given_row(plan, state, g, t, begin, end, r + 1)
            stiffness = row + pitch
            if ti.static(plan.alike):  # the first row's, which stays in the processor's caches
                if r + 1 < rows - plan.depth:
                    stiffness = first
            from_above = ti.Vector([0 for _ in range(plan.kinds)])
            from_here = ti.Vector([0 for _ in range(plan.kinds)])
            for s in ti.static(range(plan.kinds)):
                giver = given_row(plan, state, g, t, begin, end, r - plan.links[s][1])
                from_above[s] = s * state.given_size + giver - plan.links[s][0]
                from_here[s] = plan.forward[s] * state.given_size + here
                if not linked:
                    from_above[s] = from_here[s] = tail(plan, state, g, -1)
            for i in range(width):
                if gives:
                    next_cell = row + pitch + i
                    give(plan, state, between, g, next_cell, stiffness + i, pitch, ahead + i)
                if receives:
                    total = zeros(plan, state)
                    for s in range(plan.kinds):
                        total = total - read(plan, state.given, from_above[s] + i)
                    for s in range(plan.kinds):
                        total += read(plan, state.given, from_here[s] + i)
                    receive(plan, state, row + i, total)
            if gives:
                for s in range(plan.kinds):
                    to, columns = s * state.given_size + ahead, state.link[s, 0]
                    renew_left_halo(plan, state.given, to, width, columns)
                    renew_right_halo(plan, state.given, to, width, -columns)
            if receives:
                renew_halos(plan, state, row, width)


@ti.func
def given_row(plan: ti.template(), state: ti.template(), g, t, begin, end, r):
    """Where the links of row r are kept while thread t sweeps rows begin .. end of grid g."""
    at = (plan.depth + t * plan.ring + (r & (plan.ring - 1))) * state.row + plan.halo
    if r < begin:
        at = tail(plan, state, g, t - 1) + (r - begin + plan.depth) * state.row
    elif plan.threads > 1 and r >= end - plan.depth:
        at = tail(plan, state, g, t) + (r - end + plan.depth) * state.row
    return at


@ti.func
def sum_of_links(plan: ti.template(), state: ti.template(), between: ti.template(), c):
    """Sum over the links of cell c, each computed from both of its ends: for GPUs."""
    g = state.grid_of[c]
    pitch = pitch_of(plan, state, ti.max(g, 0))
    total = zeros(plan, state)
    if g >= 0:  # not an empty row, beyond which there may be nothing
        for s in ti.static(range(plan.kinds)):
            giver = c - link_offset(state, s, pitch)
            total = total - link_value(
                plan, state, between, s, g, giver, c, link_stiffness(plan, state, s, giver)
            )
        for s in ti.static(plan.forward):
            far = c + link_offset(state, s, pitch)
            k = link_stiffness(plan, state, s, c)
            total += link_value(plan, state, between, s, g, c, far, k)
    return total
