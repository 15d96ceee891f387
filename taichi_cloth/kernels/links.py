"""Links, which are the springs of regular grids in packs: each is computed once, row by row.

`between(spec, state, value, i, j, numbers)` is whatever a spring gives its ends: see `springs.py`.
The *ring* (state.ring_forces) holds what it gave for the last rows, for a force or for a product
with the stiffness matrix alike.
"""

import operator
from collections.abc import Callable
from typing import NamedTuple

import taichi as ti

from taichi_cloth.kernels.grids import (
    grid_at,
    link_index,
    link_offset,
    pitch_of,
    renew_halos,
    renew_left_halo,
    renew_right_halo,
)
from taichi_cloth.kernels.loops import PIECE, barrier, leave, share
from taichi_cloth.kernels.packs import everywhere, folded, read, write, zeros
from taichi_cloth.kernels.spring_numbers import NUMBERS, fields_of, is_stored, takes_stiffness
from taichi_cloth.kernels.stencils import compute_lines

# --- numbers of links --------------------------------------------------------------------------


@ti.func
def link_stiffness(spec: ti.template(), state: ti.template(), s, i):
    """The stiffness of pack i's links of kind s; 0 where there is no link, or none any more."""
    return read(spec, state.link_k, link_index(state, s, i))


def _others(spec, state):
    """The declarations and fields of all numbers of links except the stiffness, in pairs."""
    return list(zip(NUMBERS, fields_of(spec, state, "link"), strict=True))[1:]


@ti.func
def link_numbers(spec: ti.template(), state: ti.template(), number: ti.template(), s, g, at, k):
    """The list of numbers (`spring_numbers.NUMBERS`) of links of kind s in grid g, of stiffness k.

    at: their index in the fields of links, for a pack (`grids.link_index`) or for a slot; number:
    reads such a field there, `packs.read` or `packs.slot_number`.
    """
    others = [
        _number_of_link(spec, declared, field, number, s, g, at, k)
        for declared, field in ti.static(_others(spec, state))
    ]
    return [k] + others


@ti.func
def _number_of_link(
    spec: ti.template(),
    declared: ti.template(),
    field: ti.template(),
    number: ti.template(),
    s,
    g,
    at,
    k,
):
    """One number of links: their own, the one of their kind and grid, or 0 where none is stored."""
    if ti.static(not is_stored(field)):
        return 0.0 * k
    elif ti.static(declared.own(spec)):
        return number(spec, field, at)
    elif ti.static(declared.void):  # an absent link, of stiffness 0, has no dashpot either
        return ti.select(k > 0.0, field[s, g], 0.0 * k)
    else:
        return field[s, g]


@ti.func
def link_value(
    spec: ti.template(), state: ti.template(), between: ti.template(), s, g, i, far, k, at
):
    """The share of pack i from its links of kind s to the later pack `far`.

    k: the stiffness of these links; at: the index of their other numbers in the fields of links.
    """
    if ti.static(takes_stiffness(between)):
        kept = [read(spec, field, at) for field in ti.static((state.link_axis, state.link_across))]
        return between.between(spec, state, read, i, far, kept)
    else:
        numbers = link_numbers(spec, state, read, s, g, at, k)
        return between(spec, state, read, i, far, numbers)


@ti.func
def _static_offset(spec: ti.template(), s: ti.template(), pitch):
    """`grids.link_offset` of a kind that is known as a kernel is compiled."""
    return ti.static(spec.links[s][0]) + ti.static(spec.links[s][1]) * pitch


@ti.func
def sum_of_links(spec: ti.template(), state: ti.template(), between: ti.template(), i):
    """The sum over all links of pack i, with each link computed from both of its ends: for GPUs.

    In an empty row, beyond which there may be nothing, a pack's neighbour is the pack itself, from
    which it gets nothing: over a branch no load would be moved, and all of them are one wait.
    """
    found = grid_at(spec, state, i)
    g, inside = ti.max(found, 0), found >= 0
    pitch = pitch_of(spec, state, g)
    total = zeros(spec, state)
    for s in ti.static(range(spec.kinds)):
        giver = i - ti.select(inside, _static_offset(spec, s, pitch), 0)
        k, at = link_stiffness(spec, state, s, giver), link_index(state, s, giver)
        total = total - link_value(spec, state, between, s, g, giver, i, k, at)
    for s in ti.static(spec.forward):
        far = i + ti.select(inside, _static_offset(spec, s, pitch), 0)
        k, at = link_stiffness(spec, state, s, i), link_index(state, s, i)
        total += link_value(spec, state, between, s, g, i, far, k, at)
    return total


# Places in state.joined of each thread: for so many numbers at most that a pass joins, fewer by as
# many as keep threads off each other's cache lines.
JOIN_ROOM = 16

# --- a pass over all links ---------------------------------------------------------------------

OUTER_ROWS, LAST_ROWS, REST = range(-1, 2)  # what a phase of a pass does: see `pass_over_rows`


def nothing(state):
    """The change by a `Pass` where neighbours read none of it."""
    return ()


class Pass(NamedTuple):
    """A pass over links: between, apart and consume as `springs.accumulate` takes them.

    move(spec, state, i): run for each pack of a row right before the first links that reach that
        row are computed; `loops.leave` moves nothing.
    numbers, ops: what is joined over all packs, as `loops.join` takes them; the numbers are read
        right after a pack's `consume`. The parts of each row are left to `loops.join_parts`.
    moved, consumed: (state) -> those fields of state.haloed that `move` and `consume` change;
        `nothing` where neighbours read none of what they do.
    """

    between: Callable
    apart: Callable
    consume: Callable
    move: Callable = leave
    numbers: Callable | None = None
    ops: tuple = ()
    moved: Callable = operator.attrgetter("haloed")
    consumed: Callable = operator.attrgetter("haloed")


@ti.func
def grid_share(spec: ti.template(), rows, t):
    """The first row of thread t's share of a grid; grid_share(.., t + 1) is the share's end.

    Where there are too few rows for all threads, thread 0 has them all.
    """
    first = share(spec, rows, t)
    if rows < spec.threads * spec.depth:
        first = ti.select(t == 0, 0, rows)
    return first


@ti.func
def carried_row(spec: ti.template(), state: ti.template(), g, t):
    """The place in the ring of the last rows of thread t's share of grid g, for the next thread.

    For t = -1 it is that of the rows of zeros, which a grid's first rows take as those above them.
    These lie at the ring's start, where a run with another number of threads has written nothing.
    """
    rows = spec.depth + spec.threads * spec.ring_depth + (g * spec.threads + t) * spec.depth
    return ti.select(t < 0, 0, rows) * state.row + spec.halo


@ti.func
def ring_row(spec: ti.template(), state: ti.template(), g, t, begin, end, r):
    """The place in the ring of row r, while thread t passes over rows begin .. end of grid g."""
    at = (spec.depth + t * spec.ring_depth + (r & (spec.ring_depth - 1))) * state.row + spec.halo
    if r < begin:
        at = carried_row(spec, state, g, t - 1) + (r - begin + spec.depth) * state.row
    elif spec.threads > 1 and r >= end - spec.depth:
        at = carried_row(spec, state, g, t) + (r - end + spec.depth) * state.row
    return at


@ti.func
def compute_links(
    spec: ti.template(), state: ti.template(), between: ti.template(), g, i, stiffness, pitch, to
):
    """Compute what pack i of grid g gets from its links to later packs, into the ring at `to`.

    stiffness: the pack whose links have the stiffness to be taken; i itself, or one whose links are
    known to be as stiff.
    """
    for s in range(spec.kinds):
        far, k = i + link_offset(state, s, pitch), link_stiffness(spec, state, s, stiffness)
        value = link_value(spec, state, between, s, g, i, far, k, link_index(state, s, i))
        write(spec, state.ring_forces, s * state.ring_size + to, value)


def _moves(move):
    """True if `move` changes anything, which is known when a kernel is compiled."""
    return move is not leave


@ti.func
def move_row(spec: ti.template(), state: ti.template(), g, r, of: ti.template()):
    """Move every pack of row r of grid g as the pass `of` does, and renew the row's halos."""
    begin, width = state.grid[g, 0] + r * pitch_of(spec, state, g), state.grid[g, 2]
    for i in range(begin, begin + width):
        of.move(spec, state, i)
    renew_halos(spec, begin, width, ti.static(of.moved(state)))


@ti.func
def _joined_at(t, k: ti.template()):
    """The place where thread t joins number k of a row."""
    return (t + 1) * JOIN_ROOM + k


@ti.func
def _begin_joins(spec: ti.template(), state: ti.template(), t, ops: ti.template()):
    """Begin to join the numbers of a row."""
    for k in ti.static(range(len(ops))):
        zero = everywhere(spec, ti.cast(0.0, state.real))
        write(spec, state.joined, _joined_at(t, k), zero)


@ti.func
def _join_pack(spec: ti.template(), state: ti.template(), t, i, of: ti.template()):
    """Join the numbers of pack i, in the pass `of`, with those of its row."""
    numbers = of.numbers(spec, state, i)
    for k, op in ti.static(enumerate(of.ops)):
        at = _joined_at(t, k)
        write(spec, state.joined, at, op(read(spec, state.joined, at), numbers[k]))


@ti.func
def _end_joins(spec: ti.template(), state: ti.template(), t, row, ops: ti.template()):
    """Keep what was joined of the row that begins with the pack `row`."""
    for k, op in ti.static(enumerate(ops)):
        state.sums[k, row] = folded(op, read(spec, state.joined, _joined_at(t, k)))


@ti.func
def pass_over_rows(
    spec: ti.template(),
    state: ti.template(),
    t,
    phase,
    of: ti.template(),
):
    """Run of.consume(spec, state, i, sum) for each pack i in thread t's share of grids.

    of: a `Pass`.

    The sum is that over its links, and over the stencils along lines that it is in.

    Each link is computed once, row by row. The links that begin in a row are computed before its
    turn, into the ring of rows. In its turn each pack adds up what it gets from the links that
    begin there and, negated, from those that end there, while the links of the next row are
    computed: the one waits for memory and the other computes. No row is read again after its turn,
    so `consume` may change what `between` reads of its pack. So that no thread changes what another
    one needs, it takes phases, with all threads at the same one: in OUTER_ROWS a share's first and
    last rows are moved, if the pass moves any, which its neighbours' links reach; in LAST_ROWS the
    links of a share's last rows, which reach into the next share, are computed; REST is all else. A
    thread that is alone has no LAST_ROWS.

    Stencils along lines are handled as links are: the pull of each is computed before its earliest
    row's turn, and taken once by the particle it begins at, minus twice by the next, once by the
    last.
    """
    for g in range(state.n_grids[None]):
        first, rows, width = state.grid[g, 0], state.grid[g, 1], state.grid[g, 2]
        linked, pitch = state.grid[g, 3] == 1, pitch_of(spec, state, g)
        begin, end = grid_share(spec, rows, t), grid_share(spec, rows, t + 1)
        start, turns, computed = begin, end, end  # the rows whose turn it is, and to be computed
        if ti.static(spec.threads > 1):
            computed = end - spec.depth
            if phase == LAST_ROWS:
                start, turns, computed = ti.max(begin, end - spec.depth), end - 1, end
        if phase == OUTER_ROWS:
            start, computed = begin - spec.depth, begin - spec.depth
        for r in range(start - 1, turns):
            if ti.static(_moves(of.move)):
                moving = r + 1 + spec.depth
                outer = moving < begin + spec.depth or moving >= end - spec.depth
                now = phase != LAST_ROWS and outer == (phase == OUTER_ROWS)
                if now and begin <= moving and moving < end:
                    move_row(spec, state, g, moving, of)
            row = first + r * pitch
            computes, consumes = linked and r + 1 < computed, phase == REST and r >= start
            here = ring_row(spec, state, g, t, begin, end, r)
            ahead = ring_row(spec, state, g, t, begin, end, r + 1)
            stiffness = row + pitch
            if ti.static(spec.rows_share_stiffness):
                # The first row's stiffness stays in the processor's caches.
                if r + 1 < rows - spec.depth:
                    stiffness = first
            # What a pack loses, then what it gets: of links, and of lines.
            from_above = ti.Vector([0 for _ in range(spec.kinds + 2 * spec.line_kinds)])
            from_here = ti.Vector([0 for _ in range(spec.kinds + 2 * spec.line_kinds)])
            for s in range(spec.kinds):  # at run time: it is compiled once
                giver = ring_row(spec, state, g, t, begin, end, r - state.link[s, 1])
                from_above[s] = s * state.ring_size + giver - state.link[s, 0]
                from_here[s] = state.forward[s] * state.ring_size + here
                if not linked:
                    from_above[s] = from_here[s] = carried_row(spec, state, g, -1)
            for h in ti.static(range(spec.line_kinds)):
                columns, down = ti.static(spec.lines[h])
                in_ring, n = (spec.kinds + h) * state.ring_size, spec.kinds + 2 * h
                one_back = ring_row(spec, state, g, t, begin, end, r - down)
                two_back = ring_row(spec, state, g, t, begin, end, r - 2 * down)
                from_here[n] = in_ring + here
                from_here[n + 1] = in_ring + two_back - 2 * columns
                from_above[n] = from_above[n + 1] = in_ring + one_back - columns
                if not linked:
                    from_here[n] = from_here[n + 1] = carried_row(spec, state, g, -1)
                    from_above[n] = from_above[n + 1] = from_here[n]
            if consumes:
                _begin_joins(spec, state, t, ti.static(of.ops))
            for i in range(width):
                if computes:
                    next_pack = row + pitch + i
                    compute_links(
                        spec, state, of.between, g, next_pack, stiffness + i, pitch, ahead + i
                    )
                    if ti.static(spec.line_kinds > 0):
                        compute_lines(spec, state, of.apart, next_pack, pitch, ahead + i)
                if consumes:
                    total = zeros(spec, state)
                    for s in range(spec.kinds + 2 * spec.line_kinds):
                        total = total - read(spec, state.ring_forces, from_above[s] + i)
                    for s in range(spec.kinds + 2 * spec.line_kinds):
                        total += read(spec, state.ring_forces, from_here[s] + i)
                    of.consume(spec, state, row + i, total)
                    if ti.static(len(of.ops) > 0):
                        _join_pack(spec, state, t, row + i, of)
            if computes:
                for s in range(spec.kinds + spec.line_kinds):
                    to, columns = s * state.ring_size + ahead, state.link[s, 0]
                    renew_left_halo(spec, state.ring_forces, to, width, columns)
                    renew_right_halo(spec, state.ring_forces, to, width, -columns)
            if consumes:
                _end_joins(spec, state, t, row, ti.static(of.ops))
                renew_halos(spec, row, width, ti.static(of.consumed(state)))


@ti.func
def pass_over_grids(spec: ti.template(), state: ti.template(), t, of: ti.template()):
    """Run the pass `of` on all threads, phase by phase: see `pass_over_rows`."""
    if ti.static(spec.one_launch_per_step):
        for phase in ti.static(_phases(spec, of.move)):
            for i in range(spec.threads * PIECE):
                if i % PIECE == 0:
                    pass_over_rows(spec, state, i // PIECE, phase, of)
    else:
        first, step = ti.static(_phases(spec, of.move).start, _phases(spec, of.move).step)
        # At run time: unrolled, it takes twice as long to compile.
        for k in range(ti.static(len(_phases(spec, of.move)))):
            if k > 0:
                barrier(spec, state, t)
            pass_over_rows(spec, state, t, first + k * step, of)
    barrier(spec, state, t)


def _phases(spec, move):
    """The phases of a pass, a range."""
    alone = spec.threads == 1 and not spec.one_launch_per_step
    first = OUTER_ROWS if _moves(move) else REST if alone else LAST_ROWS
    return range(first, REST + 1, REST - OUTER_ROWS if alone else 1)
