"""Who may touch whom in a step: pairs of particles near each other, listed by place.

Where no cloth has a thickness, all pairs within 1 + MARGIN of their reach at the step's free end
are listed anew in each step; who has more of them than MOST_NEAR looks into the grid again.

Where one has (`spec.thick`), pairs within their reach and a skin are kept from step to step, in
the order by cells of the step that listed them, until particles have moved apart by the skin
(Verlet, "Computer experiments on classical fluids", 1967). What all have in common does not
count: the box around all displacements is compared. The skin is at least what the step's ways
differ by, so a pair that has passed through each other within the step is among them. In each step
the list is narrowed to the pairs that come near each other on the straight ways of the step. What
has passed through is marked: its normal is that of the step's start.

at, other: places in the order by cells. A code: the place of the other one times 4, plus PASSED,
plus CLOSER for pairs that keep less than the sum of their radii (`state.closer_...`).
"""

import functools

import taichi as ti

from taichi_cloth.kernels.collision_grid import (
    MOST_KEPT,
    MOST_NEAR,
    slot_of,
    sort_into_cells,
    sorted_radius,
    sorted_w,
    sorted_x,
    sum_over_near,
)
from taichi_cloth.kernels.loops import each
from taichi_cloth.kernels.packs import slot_value

MARGIN = 0.25  # of a pair's reach, within which particles may come to touch in a step
PASSED, CLOSER = 1, 2
LONGEST = 4.0  # skins, at most, for what moves fast


@ti.func
def find_pairs(spec: ti.template(), state: ti.template(), t):
    """Find who may touch whom at the end of this step."""
    if ti.static(not spec.thick):
        sort_into_cells(spec, state, t)
        each(spec, state, t, state.n[None], _begin)
    else:
        if ti.static(spec.one_launch_per_step):
            each(spec, state, t, state.n[None], _note_way)
            _keep_pairs(spec, state, t)
        else:
            each(spec, state, t, state.n[None], _gather)
            if _outdated(spec, state):
                _keep_pairs(spec, state, t)
        each(spec, state, t, state.n[None], _narrow)
        each(spec, state, t, 1, _forget_ways)


def sizes(spec):
    """How many numbers the sums over pairs have: changes of position and of velocity."""
    return 2 * spec.dim


# --- without thickness: anew in each step ----------------------------------------------------


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
    if ti.static(spec.thick):
        x = _vector(spec, state.listed_x, at)
        reach = sorted_radius(spec, state, at) + state.largest_radius[None] + state.skin_now[None]
        return sum_over_near(
            spec, state, at, x, reach, ti.static(sizes(spec)), ti.static(_if_touching(term))
        )
    else:
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
    """The sum of term(spec, state, at, pair) over all that are near at the step's free end.

    pair: a place, or a code where a cloth has a thickness.
    """
    total = ti.Vector.zero(state.real, ti.static(sizes(spec)))
    count = state.near_count[at]
    if count <= MOST_NEAR:
        for k in range(count):
            total += term(spec, state, at, state.near[at, k])
    else:
        total = _sum_over_grid(spec, state, at, term)
    return total


# --- with thickness: kept from step to step --------------------------------------------------


@ti.func
def _vector(spec: ti.template(), field: ti.template(), at):
    return ti.Vector([field[at, axis] for axis in range(spec.dim)])


@ti.func
def _gather(spec: ti.template(), state: ti.template(), at):
    """Take a particle's state to its place, and note how far it is from where it was listed."""
    slot = slot_of(spec, state, state.sorted_index[at])
    x, v = slot_value(spec, state.x, slot), slot_value(spec, state.v, slot)
    begun = slot_value(spec, state.begun_x, slot)
    for axis in ti.static(range(spec.dim)):
        for half in ti.static(range(2)):
            row = ti.static(half * state.sorted_half) + at
            state.sorted[row, axis] = x[axis]
            state.sorted[row, ti.static(spec.dim + 1 + axis)] = v[axis]
        state.listed_begun[at, axis] = begun[axis]
        listed = state.listed_x[at, axis]
        _note_extremes(state, ti.static(2 * axis), x[axis] - listed, begun[axis] - listed)
        way = x[axis] - begun[axis]
        _note_extremes(state, ti.static(2 * (spec.dim + axis)), way, way)


@ti.func
def _note_way(spec: ti.template(), state: ti.template(), i):
    """Note how far a particle goes in this step."""
    slot = slot_of(spec, state, i)
    x, begun = slot_value(spec, state.x, slot), slot_value(spec, state.begun_x, slot)
    for axis in ti.static(range(spec.dim)):
        way = x[axis] - begun[axis]
        _note_extremes(state, ti.static(2 * (spec.dim + axis)), way, way)


@ti.func
def _note_extremes(state: ti.template(), k: ti.template(), a, b):
    """Note the smallest and the largest of all numbers: no order changes them."""
    if ti.min(a, b) < state.extremes[k]:
        ti.atomic_min(state.extremes[k], ti.min(a, b))
    if ti.max(a, b) > state.extremes[k + 1]:
        ti.atomic_max(state.extremes[k + 1], ti.max(a, b))


@ti.func
def _forget_ways(spec: ti.template(), state: ti.template(), i):
    for k in ti.static(range(2 * spec.dim)):
        state.extremes[2 * k], state.extremes[2 * k + 1] = 1e30, -1e30


@ti.func
def _across(spec: ti.template(), state: ti.template(), first: ti.template()):
    """The diagonal of the box around the displacements whose extremes begin at `first`: two
    particles come no farther apart by them."""
    total = ti.cast(0.0, state.real)
    for axis in ti.static(range(spec.dim)):
        k = ti.static(first + 2 * axis)
        width = ti.max(state.extremes[k + 1] - state.extremes[k], 0.0)
        total += width * width
    return ti.sqrt(total)


@ti.func
def _outdated(spec: ti.template(), state: ti.template()):
    """Whether a pair that is not listed may have come to touch; a state that is not finite, too."""
    return not (_across(spec, state, 0) <= state.skin_now[None])


@ti.func
def _keep_pairs(spec: ti.template(), state: ti.template(), t):
    """List all pairs within their reach and a skin, by where they are at the step's free end."""
    sort_into_cells(spec, state, t)
    each(spec, state, t, 1, _choose_skin)
    each(spec, state, t, state.n[None], _keep)


@ti.func
def _choose_skin(spec: ti.template(), state: ti.template(), i):
    skin = state.skin[None]
    way = _across(spec, state, ti.static(2 * spec.dim))
    state.skin_now[None] = ti.min(ti.max(skin, way), LONGEST * skin)


@ti.func
def _keep(spec: ti.template(), state: ti.template(), at):
    begun = slot_value(spec, state.begun_x, slot_of(spec, state, state.sorted_index[at]))
    for k in ti.static(range(2 * spec.dim + 2)):
        state.sorted[ti.static(state.sorted_half) + at, k] = state.sorted[at, k]
    for axis in ti.static(range(spec.dim)):
        state.listed_x[at, axis] = state.sorted[at, axis]
        state.listed_begun[at, axis] = begun[axis]
    state.kept_count[at] = 0
    radius = sorted_radius(spec, state, at)
    if sorted_w(spec, state, at) > 0.0 and radius >= 0.0:
        reach = radius + state.largest_radius[None] + state.skin_now[None]
        x = sorted_x(spec, state, at)
        sum_over_near(spec, state, at, x, reach, ti.static(1), _keep_near)


@ti.func
def _keep_near(spec: ti.template(), state: ti.template(), at, other):
    d = sorted_x(spec, state, other) - sorted_x(spec, state, at)
    other_radius = sorted_radius(spec, state, other)
    reach = sorted_radius(spec, state, at) + other_radius + state.skin_now[None]
    if (d.dot(d) <= reach * reach) & (other != at) & (other_radius >= 0.0):
        full = sorted_radius(spec, state, at) + other_radius
        mine, closer = _own_reach(spec, state, at, other, full)
        reach += mine - full
        if d.dot(d) <= reach * reach:
            count = state.kept_count[at]
            if count < MOST_KEPT:
                state.kept[at, count] = other * 4 + closer * CLOSER
            state.kept_count[at] = count + 1
    return ti.Vector.zero(state.real, 1)


@ti.func
def _own_reach(spec: ti.template(), state: ti.template(), at, other, full):
    """How near a pair may come, and whether that is less than the sum of its radii."""
    i, j = state.sorted_index[at], state.sorted_index[other]
    reach, closer = full, 0
    for k in range(state.closer_start[i], state.closer_start[i + 1]):
        if state.closer_other[k] == j:
            reach, closer = state.closer_reach[k], 1
    return reach, closer


@ti.func
def reach_of(spec: ti.template(), state: ti.template(), at, pair):
    """How near a pair may come: the sum of its radii, or what is its own."""
    if ti.static(spec.thick):
        other = pair >> 2
        reach = sorted_radius(spec, state, at) + sorted_radius(spec, state, other)
        if (pair & CLOSER) != 0:
            reach, _ = _own_reach(spec, state, at, other, reach)
        return reach
    else:
        return sorted_radius(spec, state, at) + sorted_radius(spec, state, pair)


@ti.func
def _narrow(spec: ti.template(), state: ti.template(), at):
    """List of the pairs that are kept those that may touch in this step."""
    kept = state.kept_count[at]
    count = 0
    if kept > MOST_KEPT:
        count = MOST_NEAR + 1
    else:
        for k in range(kept):
            pair, near = _on_the_way(spec, state, at, state.kept[at, k])
            if near:
                if count < MOST_NEAR:
                    state.near[at, count] = pair
                count += 1
    state.near_count[at] = count


@ti.func
def _on_the_way(spec: ti.template(), state: ti.template(), at, pair):
    """The code of a pair, marked if it passed through, and whether it comes near in this step."""
    other = pair >> 2
    reach = (1.0 + MARGIN) * reach_of(spec, state, at, pair)
    before = _vector(spec, state.listed_begun, other) - _vector(spec, state.listed_begun, at)
    now = sorted_x(spec, state, other) - sorted_x(spec, state, at)
    way = now - before
    way2, there = way.dot(way), ti.cast(1.0, state.real)
    if way2 > 0.0:
        there = ti.max(ti.min(-1.0 * before.dot(way) / way2, 1.0), 0.0)
    nearest = before + there * way
    near = nearest.dot(nearest) <= reach * reach
    marked = pair
    if before.dot(now) < 0.0:
        marked = pair | PASSED
    return marked, near


@functools.cache
def _if_touching(term):
    """The term for codes of pairs that come near in this step, and zeros for others."""

    @ti.func
    def touching(spec: ti.template(), state: ti.template(), at, other):
        found = ti.Vector.zero(state.real, ti.static(sizes(spec)))
        if (other != at) & (sorted_radius(spec, state, other) >= 0.0):
            full = sorted_radius(spec, state, at) + sorted_radius(spec, state, other)
            _, closer = _own_reach(spec, state, at, other, full)
            pair, near = _on_the_way(spec, state, at, other * 4 + closer * CLOSER)
            if near:
                found = term(spec, state, at, pair)
        return found

    return touching


@ti.func
def place_of(spec: ti.template(), pair):
    """The place of the other one of a pair."""
    if ti.static(spec.thick):
        return pair >> 2
    else:
        return pair


@ti.func
def before_of(spec: ti.template(), state: ti.template(), at, pair):
    """From a particle to the other one of its pair, where the step began."""
    return _vector(spec, state.listed_begun, pair >> 2) - _vector(spec, state.listed_begun, at)
