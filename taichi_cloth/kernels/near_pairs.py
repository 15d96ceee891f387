"""Pairs of particles that may touch in a step, listed by place.

Where no cloth has a thickness, all pairs within 1 + MARGIN of their reach at the step's free end
are listed anew in each step; who has more of them than MOST_NEAR looks into the grid again.

Where one has (`spec.thick`), `kept_pairs.py` finds them.

at, other: places in the order by cells, or with a thickness in `state.in_patches`.
"""

import functools

import taichi as ti

from taichi_cloth.kernels import kept_pairs
from taichi_cloth.kernels.collision_grid import (
    MOST_NEAR,
    slot_of,
    sort_into_cells,
    sorted_radius,
    sorted_w,
    sum_over_near,
)
from taichi_cloth.kernels.kept_pairs import other_of
from taichi_cloth.kernels.loops import each
from taichi_cloth.kernels.packs import slot_value

MARGIN = 0.25  # of a pair's reach, within which particles may come to touch in a step


def finding(spec):
    """Functions that find pairs that may touch at the end of a step: ti.funcs, in turn."""
    return kept_pairs.finding(spec) if spec.thick else [_list_all]


@ti.func
def find_pairs(spec: ti.template(), state: ti.template(), t):
    """Find who may touch whom at the end of this step."""
    for act in ti.static(finding(spec)):
        act(spec, state, t)


def sizes(spec):
    """The size of sums over pairs: changes of position and of velocity."""
    return 2 * spec.dim


# --- without thickness: anew in each step ----------------------------------------------------


@ti.func
def _list_all(spec: ti.template(), state: ti.template(), t):
    sort_into_cells(spec, state, t)
    each(spec, state, t, state.n[None], _begin)


@ti.func
def _begin(spec: ti.template(), state: ti.template(), at):
    """List the particles near the one at a place, and what the other half's place keeps."""
    for k in ti.static(range(2 * spec.dim + 2)):
        state.sorted[ti.static(state.sorted_half) + at, k] = state.sorted[at, k]
    state.near_count[at] = 0
    if sorted_w(spec, state, at) > 0.0:  # what is fixed is asked by others, and asks none
        _sum_over_grid(spec, state, at, _list_near)


@ti.func
def _sum_over_grid(spec: ti.template(), state: ti.template(), at, term: ti.template()):
    """The sum of term(spec, state, at, other) over all that are near at the step's free end."""
    x = slot_value(spec, state.x, slot_of(spec, state, state.sorted_index[at]))
    reach = (1.0 + MARGIN) * (sorted_radius(spec, state, at) + state.largest_radius[None])
    return sum_over_near(
        spec, state, at, x, reach, ti.static(sizes(spec)), ti.static(_if_near(term))
    )


@functools.cache
def _if_near(term):
    """The term for pairs that are near at the step's free end, and zeros for others."""

    @ti.func
    def near(spec: ti.template(), state: ti.template(), at, other):
        x = slot_value(spec, state.x, slot_of(spec, state, state.sorted_index[at]))
        other_x = slot_value(spec, state.x, slot_of(spec, state, state.sorted_index[other]))
        d = other_x - x
        reach = (1.0 + MARGIN) * (
            sorted_radius(spec, state, at) + sorted_radius(spec, state, other)
        )
        found = ti.Vector.zero(state.real, ti.static(sizes(spec)))
        if (d.dot(d) <= reach * reach) & (other != at):
            found = term(spec, state, at, other)
        return found

    return near


@ti.func
def _list_near(spec: ti.template(), state: ti.template(), at, other):
    """Put `other` into the list of the particle at `at`, and count it, also where it is full."""
    count = state.near_count[at]
    if count < MOST_NEAR:
        state.near[at, count] = other
    state.near_count[at] = count + 1
    return ti.Vector.zero(state.real, ti.static(sizes(spec)))


@ti.func
def sum_over_pairs(spec: ti.template(), state: ti.template(), at, term: ti.template()):
    """The sum of term(spec, state, at, other) over all that are near at the step's free end."""
    total = ti.Vector.zero(state.real, ti.static(sizes(spec)))
    count = state.near_count[at]
    if count <= MOST_NEAR:
        for k in range(count):
            total += term(spec, state, at, state.near[at, k])
    else:
        total = _sum_over_grid(spec, state, at, term)
    return total


@ti.func
def reach_of(spec: ti.template(), state: ti.template(), at, pair):
    """The distance that a pair keeps: the sum of its radii, or its own.

    pair: the other one's place, or where a cloth has a thickness its row of state.near.
    """
    if ti.static(spec.thick):
        return state.near_reach[pair]
    else:
        return sorted_radius(spec, state, at) + sorted_radius(spec, state, pair)


@ti.func
def place_of(spec: ti.template(), state: ti.template(), pair):
    """The place of the other one of a pair."""
    if ti.static(spec.thick):
        return other_of(state.near[pair])
    else:
        return pair
