"""The coarse level of a preconditioner (`two_levels.py`): P^T A P of blocks, its inverse, vectors.

A *coarse pack* holds a block in each lane, as packs hold particles. Which particles a block has,
and what they add to the matrix, say `grid_blocks.py` and `graph_blocks.py`.
"""

import functools

import taichi as ti

from taichi_cloth.kernels.loops import barrier, share
from taichi_cloth.kernels.packs import (
    dot,
    everywhere,
    lane_of,
    number_in_pack,
    over_lanes,
    read,
    set_number_in_pack,
    turned,
    vectors_of,
    write,
    zeros,
)
from taichi_cloth.kernels.state import block_packs

LIFTED = 128.0  # by so many epsilons diagonals of P^T A P are larger


def unknowns(spec):
    """The number of numbers that the coarse level has at most."""
    return block_packs(spec) * spec.dim * spec.lanes


@ti.func
def entry(spec: ti.template(), state: ti.template(), row, column):
    """The place of a number of the coarse matrix, before it is inverted."""
    return (_half(spec, state, 0) + row) * ti.static(unknowns(spec)) + column


@ti.func
def unknown(spec: ti.template(), b, axis, lane):
    """The number of what a block moves along an axis: that in a lane of coarse pack b."""
    return (b * spec.dim + axis) * spec.lanes + lane


@ti.func
def clear_rows(spec: ti.template(), state: ti.template(), b):
    """Set the rows of the coarse matrix that belong to coarse pack b to 0."""
    n = state.n_blocks[None] * spec.dim
    for row in range(unknown(spec, b, 0, 0), unknown(spec, b + 1, 0, 0)):
        for h in range(n):
            at = entry(spec, state, row, h * spec.lanes) // spec.lanes
            write(spec, state.coarse, at, everywhere(spec, ti.cast(0.0, state.real)))


@ti.func
def part_of_springs(spec: ti.template(), state: ti.template(), axis, across):
    """The terms of springs in A on their ends' diagonals, and beside them (xy, yz, zx).

    axis, across: of their stiffness (`laws.stiffness_axis`), of which what pulls counts.
    """
    along, positive = _pulling_part(axis, across)
    tau = state.tau[None]
    k, c = tau * tau * along, tau * tau * positive
    return k * (axis * axis) + c, k * (axis * turned(spec, axis))


@ti.func
def _pulling_part(axis, across):
    """Stiffness matrices of springs (`laws.stiffness_axis`) without negative stiffness.

    Returns by how much what `axis` stands for is multiplied, and the stiffness across: without a
    negative one, the stiffness along the axis stays what it is.
    """
    square, one = dot(axis, axis), 0.0 * across + 1.0
    part = ti.max(square + across, 0.0) / ti.select(across < 0.0, square, one)
    return ti.select(across < 0.0, part, one), ti.max(across, 0.0)


@ti.func
def invert(spec: ti.template(), state: ti.template(), t):
    """Invert the coarse matrix of state.n_blocks coarse packs."""
    n = state.n_blocks[None] * spec.dim
    pairs = n * spec.lanes // 2
    for k in range(n):
        if t == 0:
            _invert_pivots(spec, state, k)
        barrier(spec, state, t)
        for pair in range(share(spec, pairs, t), share(spec, pairs, t + 1)):
            _eliminate(spec, state, pair, k, n)
        barrier(spec, state, t)


@ti.func
def _invert_pivots(spec: ti.template(), state: ti.template(), k):
    """Invert what pack k of unknowns does to itself: pack m of pivots is row m of the inverse.

    What no particle moves, or rounding has left no stiffness, becomes 0 (Gauss, Jordan).
    """
    first = _half(spec, state, k) + k * spec.lanes
    if ti.static(spec.lanes == 1):
        state.pivots[0] = _over(state.coarse[_pack_of(spec, first) + k])
    else:
        for m in range(spec.lanes):
            write(spec, state.pivots, m, read(spec, state.coarse, _pack_of(spec, first + m) + k))
        for m in range(spec.lanes):
            over = _over(number_in_pack(spec, state.pivots, m, m))
            own = over * read(spec, state.pivots, m)
            for j in range(spec.lanes):
                if j != m:
                    factor = number_in_pack(spec, state.pivots, j, m)
                    write(spec, state.pivots, j, read(spec, state.pivots, j) - factor * own)
                    set_number_in_pack(spec, state.pivots, j, m, -over * factor)
            write(spec, state.pivots, m, own)
            set_number_in_pack(spec, state.pivots, m, m, over)


@ti.func
def _over(pivot):
    """One over a pivot; 0 where it is none."""
    return ti.select(pivot > 0.0, 1.0 / ti.select(pivot > 0.0, pivot, 1.0), 0.0)


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
    keep_first = ti.select(j // spec.lanes == k, 0.0, 1.0)
    keep_second = ti.select((j + 1) // spec.lanes == k, 0.0, 1.0)
    a, b = _taken(spec, state, j, k), _taken(spec, state, j + 1, k)
    for h in range(n):
        first = keep_first * read(spec, state.coarse, own + h)
        second = keep_second * read(spec, state.coarse, own + ti.static(_pitch(spec)) + h)
        for m in ti.static(range(spec.lanes)):
            taken = read(spec, state.coarse, by + ti.static(m * _pitch(spec)) + h)
            first, second = (
                first + lane_of(spec, a, m) * taken,
                second + lane_of(spec, b, m) * taken,
            )
        if h == k:
            first, second = a, b
        write(spec, state.coarse, to + h, first)
        write(spec, state.coarse, to + ti.static(_pitch(spec)) + h, second)


@ti.func
def _taken(spec: ti.template(), state: ti.template(), j, k):
    """The share of each row of pack k of unknowns that row j gets, as they are taken out."""
    factors = read(spec, state.pivots, j % spec.lanes)
    if j // spec.lanes != k:
        mine = read(spec, state.coarse, _pack_of(spec, _half(spec, state, k) + j) + k)
        factors = 0.0 * mine
        for m in ti.static(range(spec.lanes)):
            factors = factors - lane_of(spec, mine, m) * read(spec, state.pivots, m)
    return factors


@ti.func
def _half(spec: ti.template(), state: ti.template(), k):
    """The first row of the half of the room that has the coarse matrix before pack k is out.

    As all are out, it is the first half.
    """
    return ((state.n_blocks[None] * spec.dim - k) & 1) * ti.static(unknowns(spec))


def _pitch(spec):
    """The packs that a row of the coarse matrix has room for."""
    return unknowns(spec) // spec.lanes


@ti.func
def _pack_of(spec: ti.template(), row):
    """The first pack of a row of the coarse matrix."""
    return row * ti.static(_pitch(spec))


@ti.func
def clear_downhill(spec: ti.template(), state: ti.template(), b):
    write(spec, state.coarse_downhill, b, zeros(spec, state))


@ti.func
def _part_of_row(spec: ti.template(), state: ti.template(), row, b):
    """The product of a row of the inverse with coarse pack b, along each axis."""
    at = _pack_of(spec, row) + b * spec.dim
    return vectors_of(
        spec, [read(spec, state.coarse, at + axis) for axis in ti.static(range(spec.dim))]
    )


@functools.cache
def solving(name, to):
    """The body of a loop over coarse packs that multiplies the vectors `name` by the inverse."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), b):
        field = ti.static(getattr(state, name))
        total = zeros(spec, state)
        numbers = ti.static(spec.dim * spec.lanes)
        for other in range(state.n_blocks[None]):
            if ti.static(spec.lanes == 1):
                for k in ti.static(range(numbers)):
                    total += field[other][k] * _part_of_row(spec, state, other * numbers + k, b)
            else:
                for k in range(numbers):
                    number = number_in_pack(spec, field, other, k)
                    total += number * _part_of_row(spec, state, other * numbers + k, b)
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
