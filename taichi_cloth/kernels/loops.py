"""Loops over packs, written once and run in one of four ways.

serial (spec.threads is 1): a launch holds whole frames, on one thread.
threads (spec.threads is more): a launch holds whole frames, on all CPU threads; each takes its
    share of every loop, and they meet at a barrier after it. Starting a parallel loop takes Taichi
    some 50 us, a barrier less than one.
blocks that stay (spec.blocks is more than 0): a launch holds whole frames on a CUDA GPU, whose
    multiprocessors can hold that many blocks of BLOCK threads at once. They take turns at each
    loop, and meet at a barrier after it (2.1 us on an H100; to start a loop takes Taichi some 9).
    Where a program beside this one holds multiprocessors for good, they would wait for ever.
one launch per step (spec.one_launch_per_step): a launch is one step, and every loop in it is a
    top-level loop that Taichi makes parallel. Other GPUs are run so; on CUDA what is large, or
    has cloths that rest on each other.

Xiao, Feng, "Inter-block GPU communication via fast barrier synchronization", IPDPS 2010 (blocks
that stay).
"""

import functools
import math

import taichi as ti

from taichi_cloth.kernels.grids import pitch_of, renew_halos
from taichi_cloth.kernels.packs import everywhere, folded, plus

# Taichi hands a top-level CPU loop out in pieces of at least 512 iterations, one piece a thread.
# A loop of 512 iterations a thread, of which one does the work, gives each thread its share.
PIECE = 512
# A top-level loop of at most so many rows runs on the processor's calling thread: to wake others
# takes as long as some 10 000 rows, and milliseconds where other programs have the cores.
SHORT = 20_000
# Threads in a block that stays: a multiprocessor has room for one, whatever registers these take.
BLOCK = 256
# The counter at which threads wait has a cache line to itself.
COUNTER, COUNTER_SIZE = 32, 64


def is_short(rows):
    """True if a top-level loop of so many rows, that a field has room for, is one thread's."""
    return rows <= SHORT and ti.cfg.arch == ti.cpu


def in_blocks(spec):
    """True if threads are those of a GPU's blocks; in tests a CPU's take turns as these do."""
    stay = spec.blocks > 0 and spec.threads > 1 and not spec.one_launch_per_step
    return stay and ti.cfg.arch != ti.cpu


@ti.func
def share(spec: ti.template(), count, t):
    """The first of thread t's share of `count` things; share(.., t + 1) is the share's end."""
    if ti.static(spec.threads == 1):
        return count * t
    else:  # C's division, as nothing is negative here: Taichi floors `//` by further statements
        return ti.cast(ti.raw_div(ti.cast(count, ti.i64) * t, ti.i64(spec.threads)), ti.i32)


@ti.func
def barrier(spec: ti.template(), state: ti.template(), t):
    """Wait as thread t until all threads of a launch are here.

    It does nothing on one thread, and with one launch per step, where Taichi ends each loop itself.
    Each thread adds its arrival to a count, and a round is over when the count is a multiple of the
    number of threads. Reading by an atomic maximum keeps compilers from reading only once. Of each
    block that stays on a GPU the first thread does so, for all of it, and makes what they wrote
    known to the others.

    A block's threads must meet at one and the same place of its code. Taichi's compiler does not
    know: where a branch that depends on the thread comes before and after they meet, it makes two
    ways of it, a meeting on each, and they wait for ever. So between two such branches is always
    one on a number that it cannot know.
    """
    if ti.static(in_blocks(spec)):
        zero = ti.simt.block.sync_any_nonzero(ti.cast(0, ti.i32))
        if ti.static(spec.blocks > 1):
            if t % BLOCK == zero:
                ti.simt.grid.memfence()
                _meet_of_blocks(state, spec.blocks)
                ti.simt.grid.memfence()
            ti.simt.block.sync()
        elif zero != 0:  # never
            state.arrivals[COUNTER] = zero
    elif ti.static(spec.threads > 1 and not spec.one_launch_per_step):
        arrived = ti.atomic_add(state.arrivals[COUNTER], 1)
        goal = (ti.raw_div(arrived, spec.threads) + 1) * spec.threads
        while ti.atomic_max(state.arrivals[COUNTER], 0) < goal:
            pass


@ti.func
def _meet_of_blocks(state: ti.template(), blocks: ti.template()):
    """Arrive for a block, and wait for all the others, of which there is a power of two.

    The count goes on from launch to launch, and may overflow: to set it back takes a task. So all
    launches on a state must be of as many blocks, until a load sets it back.
    """
    goal = (ti.atomic_add(state.arrivals[COUNTER], 1) | (blocks - 1)) + 1
    while ti.atomic_add(state.arrivals[COUNTER], 0) - goal < 0:
        pass


@ti.func
def turns_of(count, first, step):
    """Count those of first, first + step, first + 2*step, ... below `count`."""
    return ti.raw_div(ti.max(count - first, 0) + step - 1, step)


@ti.func
def each(spec: ti.template(), state: ti.template(), t, count, body: ti.template()):
    """Run body(spec, state, i) for every i below `count`."""
    if ti.static(spec.one_launch_per_step or spec.threads == 1):
        for i in range(count):
            body(spec, state, i)
    elif ti.static(spec.blocks > 0):  # neighbours in memory at once
        for turn in range(turns_of(count, t, spec.threads)):
            body(spec, state, t + turn * spec.threads)
    else:
        for i in range(share(spec, count, t), share(spec, count, t + 1)):
            body(spec, state, i)
    barrier(spec, state, t)


@ti.func
def each_pack(spec: ti.template(), state: ti.template(), t, body: ti.template()):
    """Run body(spec, state, i) for every pack i that holds particles.

    A body that changes what neighbours read belongs in `each_pack_moving`, which renews the halos.
    """
    _each_pack(spec, state, t, body, False)


@ti.func
def each_pack_moving(spec: ti.template(), state: ti.template(), t, body: ti.template()):
    """Run body(spec, state, i) for every pack i that holds particles, and renew the halos.

    The body may change what neighbours read (state.haloed) of its own pack.
    """
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
    """The body of a loop over rows that runs `body` for each pack of a row."""

    @ti.func
    def row(spec: ti.template(), state: ti.template(), begin, width):
        for i in range(begin, begin + width):
            body(spec, state, i)
        if ti.static(moving):
            renew_halos(spec, begin, width, ti.static(state.haloed))

    return row


@ti.func
def leave(spec: ti.template(), state: ti.template(), i):
    """A body that does nothing, for loops that are run only because they renew the halos.

    Where a function takes another one that moves packs, it stands for none.
    """


@ti.func
def each_row(spec: ti.template(), state: ti.template(), t, body: ti.template()):
    """Run body(spec, state, begin, width) for every row of packs that holds particles.

    begin: the row's first pack; width: how many packs it has.
    """
    if ti.static(spec.one_launch_per_step):
        for i in range(spec.threads * PIECE):
            if i % PIECE == 0:
                _share_of_rows(spec, state, i // PIECE, body)
    else:
        _share_of_rows(spec, state, t, body)
        barrier(spec, state, t)


@ti.func
def _share_of_rows(spec: ti.template(), state: ti.template(), t, body: ti.template()):
    """Run body(spec, state, begin, width) for the rows of thread t's share of every grid."""
    for g in range(state.n_grids[None]):
        first, rows, width = state.grid[g, 0], state.grid[g, 1], state.grid[g, 2]
        for r in range(share(spec, rows, t), share(spec, rows, t + 1)):
            body(spec, state, first + r * pitch_of(spec, state, g), width)


@ti.func
def raise_to(state: ti.template(), number: ti.template(), size):
    """Raise a number out of a field of `State.raised` to a size, if that is larger.

    Of those of many threads the largest stays, whatever their order.
    """
    if size > number:
        ti.atomic_max(number, ti.cast(size, state.raised))


@ti.func
def add_up(spec: ti.template(), state: ti.template(), t, number: ti.template(), k: ti.template()):
    """Sum number(spec, state, i), one for each lane, over all packs i into state.sums[k, 0].

    First each row is summed, or on a graph each piece of consecutive packs, then these sums in
    their order: so the result has the same bits for every number of threads. On a GPU packs are
    summed in three levels (`levels_of`). `number` may change its pack. `State.add_sums` makes the
    room.
    """
    if ti.static(spec.lanes == 1):
        each(spec, state, t, pieces_of(state), ti.static(_joining_piece(number, k)))
    else:
        each_row(spec, state, t, ti.static(_joining_row(number, k, plus)))
    if ti.static(in_three_levels()):
        each(spec, state, t, state.n_groups[None], ti.static(_joining_groups((plus,), k)))
    each(spec, state, t, 1, ti.static(_joining_parts(k, plus)))


@ti.func
def join(spec: ti.template(), state: ti.template(), t, numbers: ti.template(), ops: ti.template()):
    """Join several numbers over all packs in one loop, the one at place k into state.sums[k, 0].

    numbers(spec, state, i), which only reads, gives a list of them, each as `add_up` takes it; they
    are summed where their op of `ops` is `packs.plus`, and the largest is found where it is ti.max,
    of which none may be negative.
    """
    if ti.static(spec.lanes == 1):
        each(spec, state, t, pieces_of(state), ti.static(_joining_piece_at_once(numbers, ops)))
    else:
        for k, op in ti.static(enumerate(ops)):
            each_row(spec, state, t, ti.static(_joining_row(_one_of(numbers, k), k, op)))
    join_parts(spec, state, t, ops)


@ti.func
def join_parts(spec: ti.template(), state: ti.template(), t, ops: ti.template()):
    """Join what `join`, or a pass over links, has joined of each row or piece."""
    if ti.static(in_three_levels()):
        each(spec, state, t, state.n_groups[None], ti.static(_joining_groups(ops)))
    each(spec, state, t, ti.static(len(ops)), ti.static(_joining_all_parts(ops)))


@functools.cache
def _one_of(numbers, k):
    """A function that gives the number at place k of those that `numbers` gives."""

    @ti.func
    def number(spec: ti.template(), state: ti.template(), i):
        return numbers(spec, state, i)[k]

    return number


@functools.cache
def _joining_piece_at_once(numbers, ops):
    """The body of a loop over pieces that joins all numbers of one in sums[k, piece + 1]."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), piece):
        totals = ti.Vector.zero(state.real, ti.static(len(ops)))
        if ti.static(in_three_levels()):
            pieces = state.n_pieces[None]
            for n in range(turns_of(state.n_packs[None], piece, pieces)):
                found = numbers(spec, state, piece + n * pieces)
                for k, op in ti.static(enumerate(ops)):
                    totals[k] = op(totals[k], found[k])
        else:
            for i in range(piece * PIECE, ti.min((piece + 1) * PIECE, state.n_packs[None])):
                found = numbers(spec, state, i)
                for k, op in ti.static(enumerate(ops)):
                    totals[k] = op(totals[k], found[k])
        for k in ti.static(range(len(ops))):
            state.sums[k, piece + 1] = totals[k]

    return body


@functools.cache
def _joining_all_parts(ops):
    """The body of a loop over numbers that joins the parts of each."""
    bodies = [(k, _joining_parts(k, op)) for k, op in enumerate(ops)]

    @ti.func
    def body(spec: ti.template(), state: ti.template(), i):
        for k, of_one in ti.static(bodies):
            if i == k:
                of_one(spec, state, i)

    return body


def in_three_levels():
    """True if packs are joined in three levels: on GPUs, whose threads are many and slow."""
    return ti.cfg.arch != ti.cpu


def levels_of(packs):
    """The number of pieces in which so many packs are joined, and of groups of these, on GPUs.

    The numbers that are joined at once, by one thread, are about as many at each of three levels.
    """
    fan = max(1, math.ceil(packs ** (1 / 3)))
    pieces = -(-packs // fan)
    return pieces, -(-pieces // fan)


@ti.func
def pieces_of(state: ti.template()):
    """The number of pieces of packs: on a CPU of at most PIECE consecutive ones."""
    if ti.static(in_three_levels()):
        return state.n_pieces[None]
    else:
        return (state.n_packs[None] + PIECE - 1) // PIECE


@functools.cache
def _joining_piece(number, k):
    """The body of a loop over pieces that adds up the numbers of a piece in sums[k, piece + 1]."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), piece):
        total = ti.cast(0.0, state.real)
        if ti.static(in_three_levels()):
            pieces = state.n_pieces[None]
            for n in range(turns_of(state.n_packs[None], piece, pieces)):
                total += number(spec, state, piece + n * pieces)
        else:
            for i in range(piece * PIECE, ti.min((piece + 1) * PIECE, state.n_packs[None])):
                total += number(spec, state, i)
        state.sums[k, piece + 1] = total

    return body


@functools.cache
def _joining_groups(ops, first=0):
    """The body of a loop over groups of pieces that joins the parts of each, of each number from
    `first` on.
    """

    @ti.func
    def body(spec: ti.template(), state: ti.template(), group):
        pieces, groups = state.n_pieces[None], state.n_groups[None]
        for k, op in ti.static(enumerate(ops, first)):
            total = ti.cast(0.0, state.real)
            for n in range(turns_of(pieces, group, groups)):
                total = op(total, state.sums[k, group + n * groups + 1])
            state.sums[k, pieces + group + 1] = total

    return body


@functools.cache
def _joining_row(number, k, op):
    """The body of a loop over rows that joins the numbers of a row in sums[k, its first pack]."""

    @ti.func
    def row(spec: ti.template(), state: ti.template(), begin, width):
        total = everywhere(spec, ti.cast(0.0, state.real))
        for i in range(begin, begin + width):
            total = op(total, number(spec, state, i))
        state.sums[k, begin] = folded(op, total)

    return row


@functools.cache
def _joining_parts(k, op):
    """The body of a loop, run once, that joins the parts in their order in sums[k, 0]."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), i):
        total = ti.cast(0.0, state.real)
        if ti.static(in_three_levels()):
            for group in range(state.n_groups[None]):
                total = op(total, state.sums[k, state.n_pieces[None] + group + 1])
        elif ti.static(spec.lanes == 1):
            for part in range(pieces_of(state)):
                total = op(total, state.sums[k, part + 1])
        else:
            for g in range(state.n_grids[None]):
                for r in range(state.grid[g, 1]):
                    row = state.grid[g, 0] + r * pitch_of(spec, state, g)
                    total = op(total, state.sums[k, row])
        state.sums[k, 0] = total

    return body
