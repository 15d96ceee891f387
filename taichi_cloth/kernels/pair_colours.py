"""Pairs of cloth in colours: no two of a colour have a particle in common.

So those of one colour may act in any order, or on any number of threads, and what comes of them has
the same bits. A pair gets the first colour that neither of its particles has, in the order in which
pairs were found, which does not depend on threads; particles that have all COLOURS leave a rest,
which one thread does, one pair after the other.

at, other: places in `state.in_patches`. Colour c has the rows of state.near from `first_row` on.
"""

import taichi as ti

from taichi_cloth.kernels.collision_grid import MOST_KEPT, sorted_w
from taichi_cloth.kernels.kept_pairs import other_of
from taichi_cloth.kernels.loops import barrier

COLOURS = 16  # as bits of state.colours_at; the next bit is that of the rest
ALL = (1 << COLOURS) - 1


@ti.func
def first_row(state: ti.template(), colour):
    """The first row of the pairs of a colour: one has at most half as many as there are places."""
    return colour * (state.n[None] // 2)


@ti.func
def colour_pairs(spec: ti.template(), state: ti.template(), t):
    """List the pairs that may touch in this step by colours. One thread does: they are few."""
    if t == 0:
        for colour in range(ti.static(COLOURS + 1)):
            state.colour_size[colour] = 0
        for at in range(state.patch_start[state.n_patches[None]]):
            for k in range(state.found_start[at], state.found_start[at] + state.found_count[at]):
                _colour(spec, state, at, k)
    barrier(spec, state, t)


@ti.func
def _colour(spec: ti.template(), state: ti.template(), at, k):
    """Put the pair in row k of state.found into the list of its colour, unless both are fixed."""
    other = other_of(state.found[k])
    if sorted_w(spec, state, at) + sorted_w(spec, state, other) > 0.0:
        free = ~(state.colours_at[at] | state.colours_at[other]) & ALL
        lowest = ti.select(free == 0, ti.static(1 << COLOURS), free & -free)
        colour = ti.math.popcnt(lowest - 1)
        state.colours_at[at] = state.colours_at[at] | lowest
        state.colours_at[other] = state.colours_at[other] | lowest
        row = first_row(state, colour) + state.colour_size[colour]
        if row < state.n[None] * MOST_KEPT:
            state.colour_size[colour] = state.colour_size[colour] + 1
            state.near_from[row] = at
            state.near[row], state.near_reach[row] = state.found[k], state.found_reach[k]
        else:
            state.overfull[None] = 1
