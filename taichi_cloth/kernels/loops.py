"""Loops over packs, run in one of three ways by one source.

serial: a launch holds whole frames, on one thread.
threads: a launch holds whole frames, on all CPU threads; each takes its share of every loop, and
    they meet at a barrier after it. Starting a parallel loop takes Taichi some 50 us, a barrier
    less than one.
one launch per step: a launch is one step, every loop in it a top-level loop that Taichi makes parallel: GPUs,
    and scenes with collisions, whose sorting needs more than shares and barriers.

`t` is the number of the thread that runs a loop, 0 where one runs all of it.
"""

import functools

import taichi as ti

from taichi_cloth.kernels.grids import pitch_of, renew_halos
from taichi_cloth.kernels.packs import everywhere, folded, plus

# Taichi hands a top-level CPU loop out in pieces of at least 512 iterations, one piece a thread.
# A loop of 512 iterations a thread, of which one does the work, gives each thread its share.
PIECE = 512
# The counter at which threads wait has a cache line to itself.
COUNTER, COUNTER_SIZE = 32, 64


@ti.func
def share(spec: ti.template(), count, t):
    """First of thread t's share of `count` things; share(.., t + 1) is its end."""
    if ti.static(spec.threads == 1):
        return count * t
    else:
        return ti.cast(ti.cast(count, ti.i64) * t // spec.threads, ti.i32)


@ti.func
def barrier(spec: ti.template(), state: ti.template()):
    """Wait until all threads of a launch are here; nothing where there is but one, or loops are
    one launch per step.

    Each adds its arrival to a count, and a round is over when the count is a multiple of the
    number of threads. Reading by an atomic maximum keeps compilers from reading only once.
    """
    if ti.static(spec.threads > 1 and not spec.one_launch_per_step):
        arrived = ti.atomic_add(state.arrivals[COUNTER], 1)
        goal = (arrived // spec.threads + 1) * spec.threads
        while ti.atomic_max(state.arrivals[COUNTER], 0) < goal:
            pass


@ti.func
def each(spec: ti.template(), state: ti.template(), t, count, body: ti.template()):
    """Run body(spec, state, i) for every i below `count`."""
    if ti.static(spec.one_launch_per_step):
        for i in range(count):
            body(spec, state, i)
    else:
        for i in range(share(spec, count, t), share(spec, count, t + 1)):
            body(spec, state, i)
    barrier(spec, state)


@ti.func
def each_pack(spec: ti.template(), state: ti.template(), t, body: ti.template()):
    """Run body(spec, state, i) for every pack i that holds particles.

    A body that moves them is `each_pack_moving`'s, which renews the halos.
    """
    _each_pack(spec, state, t, body, False)


@ti.func
def each_pack_moving(spec: ti.template(), state: ti.template(), t, body: ti.template()):
    """Run body(spec, state, i), which changes what neighbours read, for every pack i."""
    _each_pack(spec, state, t, body, True)


@ti.func
def _each_pack(
    spec: ti.template(), state: ti.template(), t, body: ti.template(), moving: ti.template()
):
    if ti.static(spec.lanes == 1):
        each(spec, state, t, state.n_packs[None], body)
    else:
        each_row(spec, state, t, ti.static(_visiting(body, moving)))


@functools.cache
def _visiting(body, moving):
    @ti.func
    def row(spec: ti.template(), state: ti.template(), begin, width):
        for i in range(begin, begin + width):
            body(spec, state, i)
        if ti.static(moving):
            renew_halos(spec, state, begin, width)

    return row


@ti.func
def leave(spec: ti.template(), state: ti.template(), i):
    """A body that moves nothing: for the halos that a loop renews, or where none is wanted."""


@ti.func
def each_row(spec: ti.template(), state: ti.template(), t, body: ti.template()):
    """Run body(spec, state, begin, width) for every row of packs."""
    if ti.static(spec.one_launch_per_step):
        for i in range(spec.threads * PIECE):
            if i % PIECE == 0:
                _share_of_rows(spec, state, i // PIECE, body)
    else:
        _share_of_rows(spec, state, t, body)
        barrier(spec, state)


@ti.func
def _share_of_rows(spec: ti.template(), state: ti.template(), t, body: ti.template()):
    for g in range(state.n_grids[None]):
        first, rows, width = state.grid[g, 0], state.grid[g, 1], state.grid[g, 2]
        for r in range(share(spec, rows, t), share(spec, rows, t + 1)):
            body(spec, state, first + r * pitch_of(spec, state, g), width)


@ti.func
def add_up(spec: ti.template(), state: ti.template(), t, number: ti.template(), k: ti.template()):
    """state.sums[k, 0] = sum of number(spec, state, i), one for each lane, over all packs i.

    Row by row, on a graph piece by piece of packs, and then these in their order: the same bits
    for every number of threads. `State.add_sums` makes room for it. `number` may change its pack.
    """
    _join(spec, state, t, number, k, plus)


@ti.func
def find_largest(
    spec: ti.template(), state: ti.template(), t, number: ti.template(), k: ti.template()
):
    """state.sums[k, 0] = the largest number(spec, state, i), none of which is negative."""
    _join(spec, state, t, number, k, ti.max)


@ti.func
def _join(
    spec: ti.template(),
    state: ti.template(),
    t,
    number: ti.template(),
    k: ti.template(),
    op: ti.template(),
):
    if ti.static(spec.lanes == 1):
        each(spec, state, t, pieces_of(state), ti.static(_joining_piece(number, k, op)))
    else:
        each_row(spec, state, t, ti.static(_joining_row(number, k, op)))
    each(spec, state, t, 1, ti.static(_joining_parts(k, op)))


@ti.func
def pieces_of(state: ti.template()):
    return (state.n_packs[None] + PIECE - 1) // PIECE


@functools.cache
def _joining_piece(number, k, op):
    @ti.func
    def body(spec: ti.template(), state: ti.template(), piece):
        total = ti.cast(0.0, state.real)
        for i in range(piece * PIECE, ti.min((piece + 1) * PIECE, state.n_packs[None])):
            total = op(total, number(spec, state, i))
        state.sums[k, piece + 1] = total

    return body


@functools.cache
def _joining_row(number, k, op):
    @ti.func
    def row(spec: ti.template(), state: ti.template(), begin, width):
        total = everywhere(spec, ti.cast(0.0, state.real))
        for i in range(begin, begin + width):
            total = op(total, number(spec, state, i))
        state.sums[k, begin] = folded(op, total)

    return row


@functools.cache
def _joining_parts(k, op):
    @ti.func
    def body(spec: ti.template(), state: ti.template(), i):
        total = ti.cast(0.0, state.real)
        if ti.static(spec.lanes == 1):
            for part in range(pieces_of(state)):
                total = op(total, state.sums[k, part + 1])
        else:
            for g in range(state.n_grids[None]):
                for r in range(state.grid[g, 1]):
                    row = state.grid[g, 0] + r * pitch_of(spec, state, g)
                    total = op(total, state.sums[k, row])
        state.sums[k, 0] = total

    return body
