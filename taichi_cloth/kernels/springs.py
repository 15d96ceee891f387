"""Spring forces, on both topologies: a graph (half-springs in rows) and regular grids (links).

Whatever a spring between two particles contributes is a ti.func `between(spec, state, value, i, j,
k, rest, c)`: what particle i gets from the spring to j, of which j gets the opposite. It reads
fields by `value(specialization, field, i)`: of whole packs of a grid, or of single particles of a graph.
`accumulate` sums it over the springs of each pack and hands the sum to `consume(spec, state, i,
sum)`. Forces are one such contribution, a product with the stiffness matrix is another. No atomics:
the same bits on every run, for every number of threads.
"""

import functools

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.compensated import difference
from taichi_cloth.kernels.loops import PIECE, barrier, each, leave, renew_halos, share
from taichi_cloth.kernels.packs import (
    link_index,
    link_offset,
    pitch_of,
    read,
    renew_left_halo,
    renew_right_halo,
    scaled,
    slot_value,
    write,
    zeros,
)


@ti.func
def accumulate(
    spec: ti.template(),
    state: ti.template(),
    t,
    between: ti.template(),
    consume: ti.template(),
    consume_graph: ti.template(),
):
    """For every pack i: consume(spec, state, i, sum over its springs).

    In lanes `consume` may already move its pack (see `sweep`); elsewhere it must leave what others
    read. consume_graph(spec, state, slot, sum): for the springs that no grid holds, in scenes with
    grids; it comes after all `consume`.
    """
    if ti.static(spec.lanes > 1):
        _sweep_grids(spec, state, t, leave, between, consume)
    else:
        each(spec, state, t, state.n_packs[None], ti.static(_summing(between, consume)))
    if ti.static(spec.springs and spec.kinds > 0):
        each(
            spec, state, t, state.n_csr_rows[None], ti.static(_summing_more(between, consume_graph))
        )


@ti.func
def move_and_accumulate(
    spec: ti.template(),
    state: ti.template(),
    t,
    move: ti.template(),
    between: ti.template(),
    consume: ti.template(),
):
    """In lanes alone: move(spec, state, i) for every pack, then, in the same pass over memory, for
    each one that receives: consume(spec, state, i, sum over its springs), which may move it again.
    """
    for g in range(state.n_grids[None]):
        begin = grid_share(spec, state.grid[g, 1], t)
        end = grid_share(spec, state.grid[g, 1], t + 1)
        # What others' links reach, and what is behind the row that a sweep moves first.
        for r in range(begin, ti.min(begin + spec.depth, end)):
            _move_row(spec, state, g, r, move)
        for r in range(ti.max(begin + spec.depth, end - spec.depth), end):
            _move_row(spec, state, g, r, move)
    barrier(spec, state)
    _sweep_grids(spec, state, t, move, between, consume)


@ti.func
def _sweep_grids(
    spec: ti.template(),
    state: ti.template(),
    t,
    move: ti.template(),
    between: ti.template(),
    consume: ti.template(),
):
    if ti.static(spec.one_launch_per_step):
        for phase in ti.static(range(2)):
            for i in range(spec.threads * PIECE):
                if i % PIECE == 0:
                    sweep(spec, state, i // PIECE, phase, move, between, consume)
    elif ti.static(spec.threads == 1):
        sweep(spec, state, t, 1, move, between, consume)
    else:
        for phase in range(2):  # at run time: unrolled, it takes twice as long to compile
            if phase == 1:
                barrier(spec, state)
            sweep(spec, state, t, phase, move, between, consume)
    barrier(spec, state)


def _moves(move):
    return move is not leave


@ti.func
def _move_row(spec: ti.template(), state: ti.template(), g, r, move: ti.template()):
    begin, width = state.grid[g, 0] + r * pitch_of(spec, state, g), state.grid[g, 2]
    for i in range(begin, begin + width):
        move(spec, state, i)
    renew_halos(spec, state, begin, width)


@functools.cache
def _summing(between, consume):
    @ti.func
    def body(spec: ti.template(), state: ti.template(), i):
        consume(spec, state, i, sum_at_pack(spec, state, between, i))

    return body


@functools.cache
def _summing_more(between, consume_graph):
    @ti.func
    def body(spec: ti.template(), state: ti.template(), p):
        slot = state.csr_slot[p]
        total = sum_of_half_springs(spec, state, slot_value, between, p, slot)
        consume_graph(spec, state, slot, total)

    return body


@ti.func
def sum_at_pack(spec: ti.template(), state: ti.template(), between: ti.template(), i):
    """Sum over the springs of pack i, each computed from both of its ends."""
    if ti.static(spec.kinds > 0):
        return sum_of_links(spec, state, between, i)
    elif ti.static(spec.springs):
        return sum_of_half_springs(spec, state, read, between, i, i)
    else:
        return zeros(spec, state)


@ti.func
def force_between(
    spec: ti.template(), state: ti.template(), value: ti.template(), i, j, k, rest, c
):
    """Force of a spring, with its dashpot, on i."""
    d = difference(spec, state, value, i, j)
    length = laws.length(d)
    along = laws.unit(d, length)
    tension = laws.spring_tension(length, k, rest)
    if ti.static(spec.dashpots):
        dv = value(spec, state.v, j) - value(spec, state.v, i)
        tension += laws.dashpot_tension(dv, along, c)
    return scaled(tension, along)


# --- on a graph ------------------------------------------------------------------------------


@ti.func
def number(spec: ti.template(), field: ti.template(), s):
    """A (half-)spring's k, rest, c or limit: its own, or the one that all of them share."""
    if ti.static(spec.uniform_springs):
        return field[None]
    else:  # without it, Taichi would read both
        return field[s]


@ti.func
def sum_of_half_springs(
    spec: ti.template(), state: ti.template(), value: ti.template(), between: ti.template(), p, i
):
    """Sum over the half-springs of the p-th row, which are those of particle i, in their order."""
    total = 0.0 * value(spec, state.x, i)
    for h in range(state.csr_start[p], state.csr_start[p + 1]):
        c = ti.cast(0.0, state.real)
        if ti.static(spec.dashpots):
            c = number(spec, state.csr_c, h)
        total += between(
            spec,
            state,
            value,
            i,
            state.csr_other[h],
            number(spec, state.csr_k, h),
            number(spec, state.csr_rest, h),
            c,
        )
    return total


# --- on grids --------------------------------------------------------------------------------


@ti.func
def link_stiffness(spec: ti.template(), state: ti.template(), s, i):
    """Stiffness of pack i's links of kind s; 0 where there is none, or none any more."""
    return read(spec, state.link_k, link_index(state, s, i))


@ti.func
def link_damping(spec: ti.template(), state: ti.template(), s, g, k):
    """Dashpots of links of kind s in grid g: a link without stiffness k has none either."""
    damping = 0.0 * k
    if ti.static(spec.dashpots):
        damping = ti.select(k > 0.0, state.link_c[s, g], 0.0 * k)
    return damping


@ti.func
def link_value(spec: ti.template(), state: ti.template(), between: ti.template(), s, g, i, far, k):
    """What pack i gets from its links of kind s, of stiffness k, to later particles at far."""
    damping = link_damping(spec, state, s, g, k)
    return between(spec, state, read, i, far, k, state.link_rest[s, g], damping)


@ti.func
def grid_share(spec: ti.template(), rows, t):
    """First row of thread t's share of a grid; too few rows for all threads are the first one's."""
    first = share(spec, rows, t)
    if rows < spec.threads * spec.depth:
        first = ti.select(t == 0, 0, rows)
    return first


@ti.func
def carried_row(spec: ti.template(), state: ti.template(), g, t):
    """Where the links of the last rows of thread t's share of grid g are kept; before thread 0's
    there are rows of zeros, for a grid's first rows: they come first, where a run with another
    number of threads has written nothing.
    """
    rows = spec.depth + spec.threads * spec.ring_depth + (g * spec.threads + t) * spec.depth
    return ti.select(t < 0, 0, rows) * state.row + spec.halo


@ti.func
def compute_links(
    spec: ti.template(), state: ti.template(), between: ti.template(), g, i, stiffness, pitch, to
):
    """Compute what pack i of grid g gets from its links to later particles, into state.ring_forces[to].

    stiffness: the pack whose links' stiffness is theirs.
    """
    for s in range(spec.kinds):
        far, k = i + link_offset(state, s, pitch), link_stiffness(spec, state, s, stiffness)
        value = link_value(spec, state, between, s, g, i, far, k)
        write(spec, state.ring_forces, s * state.ring_size + to, value)


@ti.func
def sweep(
    spec: ti.template(),
    state: ti.template(),
    t,
    phase,
    move: ti.template(),
    between: ti.template(),
    consume: ti.template(),
):
    """Each link once, row by row, in thread t's share of every grid.

    The links of a row are computed before its turn, into a ring of rows; in its turn its packs add
    up what they give and, negated, what is given to them, while those of the next row are computed:
    one waits for memory and the other computes. Rows above are never looked at again, so `consume`
    may change what `between` reads of its pack. So that no thread changes what another one needs,
    the last rows of a share, whose links reach into the next one, are computed before all else:
    that is phase 0, and phase 1 the rest; with one thread there is only phase 1.

    A row moves (`move_and_accumulate`) right before the first links that reach it are computed; the
    first and last rows of a share have moved already.
    """
    for g in range(state.n_grids[None]):
        first, rows, width = state.grid[g, 0], state.grid[g, 1], state.grid[g, 2]
        linked, pitch = state.grid[g, 3] == 1, pitch_of(spec, state, g)
        begin, end = grid_share(spec, rows, t), grid_share(spec, rows, t + 1)
        start, turns, computed = begin, end, end  # the rows whose turn it is, and to be computed
        if ti.static(spec.threads > 1):
            computed = end - spec.depth
            if phase == 0:
                start, turns, computed = ti.max(begin, end - spec.depth), end - 1, end
        for r in range(start - 1, turns):
            if ti.static(_moves(move)):
                next_row = r + 1 + spec.depth
                if phase == 1 and begin + spec.depth <= next_row and next_row < end - spec.depth:
                    _move_row(spec, state, g, next_row, move)
            row = first + r * pitch
            computes, consumes = linked and r + 1 < computed, phase == 1 and r >= start
            here = ring_row(spec, state, g, t, begin, end, r)
            ahead = ring_row(spec, state, g, t, begin, end, r + 1)
            stiffness = row + pitch
            if ti.static(
                spec.rows_share_stiffness
            ):  # the first row's, which stays in the processor's caches
                if r + 1 < rows - spec.depth:
                    stiffness = first
            from_above = ti.Vector([0 for _ in range(spec.kinds)])
            from_here = ti.Vector([0 for _ in range(spec.kinds)])
            for s in ti.static(range(spec.kinds)):
                giver = ring_row(spec, state, g, t, begin, end, r - spec.links[s][1])
                from_above[s] = s * state.ring_size + giver - spec.links[s][0]
                from_here[s] = spec.forward[s] * state.ring_size + here
                if not linked:
                    from_above[s] = from_here[s] = carried_row(spec, state, g, -1)
            for i in range(width):
                if computes:
                    next_pack = row + pitch + i
                    compute_links(
                        spec, state, between, g, next_pack, stiffness + i, pitch, ahead + i
                    )
                if consumes:
                    total = zeros(spec, state)
                    for s in range(spec.kinds):
                        total = total - read(spec, state.ring_forces, from_above[s] + i)
                    for s in range(spec.kinds):
                        total += read(spec, state.ring_forces, from_here[s] + i)
                    consume(spec, state, row + i, total)
            if computes:
                for s in range(spec.kinds):
                    to, columns = s * state.ring_size + ahead, state.link[s, 0]
                    renew_left_halo(spec, state.ring_forces, to, width, columns)
                    renew_right_halo(spec, state.ring_forces, to, width, -columns)
            if consumes:
                renew_halos(spec, state, row, width)


@ti.func
def ring_row(spec: ti.template(), state: ti.template(), g, t, begin, end, r):
    """Where the links of row r are kept while thread t sweeps rows begin .. end of grid g."""
    at = (spec.depth + t * spec.ring_depth + (r & (spec.ring_depth - 1))) * state.row + spec.halo
    if r < begin:
        at = carried_row(spec, state, g, t - 1) + (r - begin + spec.depth) * state.row
    elif spec.threads > 1 and r >= end - spec.depth:
        at = carried_row(spec, state, g, t) + (r - end + spec.depth) * state.row
    return at


@ti.func
def sum_of_links(spec: ti.template(), state: ti.template(), between: ti.template(), i):
    """Sum over the links of pack i, each computed from both of its ends: for GPUs."""
    g = state.grid_of[i]
    pitch = pitch_of(spec, state, ti.max(g, 0))
    total = zeros(spec, state)
    if g >= 0:  # not an empty row, beyond which there may be nothing
        for s in ti.static(range(spec.kinds)):
            giver = i - link_offset(state, s, pitch)
            total = total - link_value(
                spec, state, between, s, g, giver, i, link_stiffness(spec, state, s, giver)
            )
        for s in ti.static(spec.forward):
            far = i + link_offset(state, s, pitch)
            k = link_stiffness(spec, state, s, i)
            total += link_value(spec, state, between, s, g, i, far, k)
    return total
