"""Pairs that may touch in a step, where cloths have a thickness: kept from step to step.

Pairs within their reach and a skin are kept as long as `patches.py` says that none beyond can
touch. Where all are listed, by the collision grid, those that came near each other on the straight
ways of that step are listed, too, however far these went; the boxes around the ways of patches say
how far to look. So in each step the list has all that may touch, and is narrowed to those, in the
order of their places: what comes of a step does not depend on when lists were made, but for
neighbours in a cloth (CLOSER_SKIN). What has passed through is marked: its normal is that of the
step's start. A pair is kept by the end with the earlier place, and found by it; with one launch
per step what may touch is then listed from both ends. Who has more than MOST_KEPT in its list keeps
the first ones, the step is counted as unsettled, and the next one lists all pairs again.

at, other: places in `state.in_patches`, which hold for a whole run, but for functions on the grid
(`grid_at`, `grid_other`). A code of `state.kept`: the place of the other one; in its last
CODE_BITS, for pairs that keep less than the sum of their radii, how many of the particle's rows of
`state.closer_...` come before theirs and one more, or LATER if that is less. One of `state.near`:
the place of the other one; in its last bit whether they have passed through each other.
"""

import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.collision_grid import (
    MOST_KEPT,
    slot_of,
    sort_into_cells,
    sorted_radius,
    sorted_w,
    sorted_x,
    sum_over_near,
)
from taichi_cloth.kernels.loops import each
from taichi_cloth.kernels.packs import slot_number, slot_value
from taichi_cloth.kernels.patches import (
    CLOTH_MARGIN,
    MOST_STALE,
    STALE,
    anchor_patch_anew,
    are_near,
    block_is_near_patch,
    block_of,
    blocks_are_near,
    blocks_of,
    bound_patch,
    by_patches,
    compare_patch,
    hits_in_block,
    look_ahead,
    of_two,
    reach_of_most,
    vector,
)

CLOSER_SKIN = 0.35  # of the skin: for neighbours in a cloth, whose springs keep them apart
LATER, CODE_BITS = 31, 5
PASSED, NEAR_BITS = 1, 1
TURNED = 0.5**0.5  # cosine of the angle from which on a pair inside each other has passed


def finding(spec):
    """Functions that find pairs that may touch at the end of a step: ti.funcs, in turn."""
    if spec.one_launch_per_step:
        return [_list_all, _narrow_all]
    return [_compare_patches, _list_anew, _narrow_all]


@ti.func
def _compare_patches(spec: ti.template(), state: ti.template(), t):
    """Find the patches whose lists no longer hold."""
    each(spec, state, t, state.n_patches[None], bound_patch)
    each(spec, state, t, state.n_patches[None], compare_patch)


@ti.func
def _list_anew(spec: ti.template(), state: ti.template(), t):
    """List anew what no longer holds."""
    if state.n_stale[None] > MOST_STALE * state.n_patches[None] or state.outdated[None] == 1:
        _list_all(spec, state, t)
    elif state.n_stale[None] > 0:
        each(spec, state, t, state.n_patches[None], ti.static(by_patches(_renew_patch)))


@ti.func
def _narrow_all(spec: ti.template(), state: ti.template(), t):
    """List who may touch whom, of those who are near."""
    each(spec, state, t, 1, _begin_lists)
    each(spec, state, t, state.n[None], _refresh)
    each(spec, state, t, state.n_patches[None], ti.static(by_patches(_narrow_patch)))
    if ti.static(spec.one_launch_per_step):
        _list_both_ends(spec, state, t)


@ti.func
def _begin_lists(spec: ti.template(), state: ti.template(), i):
    """The lists of the next step are those of this one, as far as is known; and none is active."""
    state.outdated[None] = state.n_stale[None] = 0
    if ti.static(spec.one_launch_per_step):
        state.n_active[None] = 0


@ti.func
def _refresh(spec: ti.template(), state: ti.template(), at):
    """Take a particle to its place."""
    slot = slot_of(spec, state, state.in_patches[at])
    x, begun = slot_value(spec, state.x, slot), slot_value(spec, state.begun_x, slot)
    for axis in ti.static(range(spec.dim)):
        state.sorted[at, axis], state.listed_begun[at, axis] = x[axis], begun[axis]


# --- all lists, by the grid ------------------------------------------------------------------


@ti.func
def _list_all(spec: ti.template(), state: ti.template(), t):
    """List all pairs within their reach and a skin at the step's free end, or near on its ways."""
    each(spec, state, t, state.n_patches[None], anchor_patch_anew)
    each(spec, state, t, state.n_patches[None], look_ahead)
    sort_into_cells(spec, state, t)
    each(spec, state, t, state.n[None], _take_along)
    each(spec, state, t, state.n[None], _list_particle)
    each(spec, state, t, state.n[None], _take_place)


@ti.func
def _take_along(spec: ti.template(), state: ti.template(), grid_at):
    """Fill what a place in the grid has besides what is sorted."""
    begun = slot_value(spec, state.begun_x, slot_of(spec, state, state.sorted_index[grid_at]))
    for axis in ti.static(range(spec.dim)):
        state.listed_begun[grid_at, axis] = begun[axis]


@ti.func
def _list_particle(spec: ti.template(), state: ti.template(), grid_at):
    """List the pairs of the particle at a place in the grid."""
    at = state.patch_place[state.sorted_index[grid_at]]
    state.kept_count[at] = 0
    radius = sorted_radius(spec, state, grid_at)
    if radius >= 0.0:
        ahead = state.patch_ahead[state.patch_of[at]]
        beyond = ti.max(
            state.skin[None], ahead + ti.static(2.0 * CLOTH_MARGIN) * state.largest_radius[None]
        )
        state.far[grid_at] = ti.cast(beyond > state.skin[None], ti.i32)
        reach = radius + state.largest_radius[None] + beyond
        x = sorted_x(spec, state, grid_at)
        sum_over_near(spec, state, grid_at, x, reach, ti.static(1), _list_near)


@ti.func
def _list_near(spec: ti.template(), state: ti.template(), grid_at, grid_other):
    reach = sorted_radius(spec, state, grid_at) + sorted_radius(spec, state, grid_other)
    d = sorted_x(spec, state, grid_other) - sorted_x(spec, state, grid_at)
    d2 = d.dot(d)
    way2 = d2
    if (state.far[grid_at] == 1) & (not _within(d2, reach + state.skin[None])):
        way2 = _nearest2(spec, state, grid_at, grid_other)
    at = state.patch_place[state.sorted_index[grid_at]]
    other = state.patch_place[state.sorted_index[grid_other]]
    if (other > at) & (sorted_radius(spec, state, grid_other) >= 0.0):
        _list_pair(state, at, other, reach, d2, way2, state.skin[None])
    return ti.Vector.zero(state.real, 1)


@ti.func
def _take_place(spec: ti.template(), state: ti.template(), at):
    """Take a particle from the grid to its place."""
    state.sorted_index[at] = state.in_patches[at]
    slot = slot_of(spec, state, state.in_patches[at])
    state.sorted[at, ti.static(spec.dim)] = slot_number(spec, state.pair_radius, slot)
    state.sorted[at, ti.static(2 * spec.dim + 1)] = slot_number(spec, state.w, slot)


@kernel
def take_places(spec: ti.template(), state: ti.template()):
    """Fill what a place has of its particle, beside where that is: for lists from a checkpoint."""
    for at in range(state.n[None]):
        _take_place(spec, state, at)


# --- lists of two patches --------------------------------------------------------------------


@ti.func
def _renew_patch(spec: ti.template(), state: ti.template(), a):
    """Make those lists of a patch anew that do not hold."""
    stale = 0
    for b in range(a, state.n_patches[None]):
        stale |= state.stale[of_two(state, a, b)]
    if stale & STALE:
        for at in range(state.patch_start[a], state.patch_start[a + 1]):
            _drop_stale(state, a, at)
        for b in range(a, state.n_patches[None]):
            row = of_two(state, a, b)
            if state.stale[row] == STALE:
                state.stale[row] = 0
                if are_near(state, a, b, reach_of_most(state) + state.drift[row, 3]):
                    _list_two(spec, state, a, b, row)


@ti.func
def _drop_stale(state: ti.template(), a, at):
    """Drop those pairs of a particle whose lists are stale."""
    count = 0
    for k in range(ti.min(state.kept_count[at], MOST_KEPT)):
        code = state.kept[at, k]
        if state.stale[of_two(state, a, state.patch_of[code >> CODE_BITS])] == 0:
            state.kept[at, count] = code
            count += 1
    state.kept_count[at] = count


@ti.func
def _list_two(spec: ti.template(), state: ti.template(), a, b, row):
    """List the pairs of the particles of a patch with those of another; row: of both patches."""
    drift, skin = vector(spec, state.drift, row), state.drift[row, 3]
    reach = reach_of_most(state) + skin
    for block in range(blocks_of(state, a)):
        first, end = block_of(state, a, block)
        if block_is_near_patch(state, a, first, b, drift, reach):
            for other_block in range(blocks_of(state, b)):
                other_first, other_end = block_of(state, b, other_block)
                if (other_end > first) and blocks_are_near(
                    state, a, first, b, other_first, drift, reach
                ):
                    for at in range(first, end):
                        if sorted_radius(spec, state, at) >= 0.0:
                            _list_of_block(spec, state, at, b, other_first, other_end, drift, skin)


@ti.func
def _list_of_block(spec: ti.template(), state: ti.template(), at, b, first, end, drift, skin):
    """List the pairs of a particle with those of a block of a patch."""
    x, radius = vector(spec, state.listed_x, at) - drift, sorted_radius(spec, state, at)
    hits = hits_in_block(state, b, first, x, radius + skin)
    if hits != 0:
        hits &= ~_list_closer(spec, state, at, first, end, x, skin)
        for k in range(end - first):
            if ((hits >> k) & 1) & ti.cast(first + k > at, ti.i32):
                _put(state, at, first + k, 0)


@ti.func
def _anchor_apart2(state: ti.template(), at, x):
    """The square of the distance of an anchor from x."""
    d2 = ti.cast(0.0, state.real)
    for axis in ti.static(range(3)):
        d = state.listed_x[at, axis] - x[axis]
        d2 += d * d
    return d2


@ti.func
def _list_closer(spec: ti.template(), state: ti.template(), at, first, end, x, skin):
    """List the pairs of a particle that keep less than the sum of their radii, with those of a
    block; a bit for each particle of the block that is in such a pair."""
    closer, start = 0, state.closer_start[at]
    for row in range(start, state.closer_start[at + 1]):
        other = state.closer_other[row]
        if (other >= first) & (other < end):
            closer |= 1 << (other - first)
            reach = state.closer_reach[row] + CLOSER_SKIN * skin
            near = _anchor_apart2(state, other, x) <= reach * reach
            if near & (other > at):
                _put(state, at, other, ti.min(row - start + 1, LATER))
    return closer


# --- both ------------------------------------------------------------------------------------


@ti.func
def _list_pair(state: ti.template(), at, other, reach, d2, way2, skin):
    """Put a pair into the list of the particle at a place, if it may touch before lists are stale.

    reach: the sum of its radii; d2, way2: the squares of its distance and, where the step went far,
    of that on its ways; skin: of its list.
    """
    if _within(d2, reach + skin) | _within(way2, (1.0 + CLOTH_MARGIN) * reach):
        row, there = _row_of(state, at, other), True
        if row >= 0:
            mine = state.closer_reach[row]
            there = _within(d2, mine + CLOSER_SKIN * skin)
            there = there | _within(way2, (1.0 + CLOTH_MARGIN) * mine)
        if there:
            _put(
                state,
                at,
                other,
                ti.select(row < 0, 0, ti.min(row - state.closer_start[at] + 1, LATER)),
            )


@ti.func
def _put(state: ti.template(), at, other, place):
    """Put a pair into the list of the particle at a place, and count it, also where it is full."""
    count = state.kept_count[at]
    if count < MOST_KEPT:
        state.kept[at, count] = (other << CODE_BITS) + place
    state.kept_count[at] = count + 1


@ti.func
def _row_of(state: ti.template(), at, other):
    """The row of a pair among those that keep less than the sum of their radii; -1: it does not."""
    row = -1
    for k in range(state.closer_start[at], state.closer_start[at + 1]):  # to its end: no guesses
        row = ti.max(row, ti.select(state.closer_other[k] == other, k, -1))
    return row


@ti.func
def _kept_reach(spec: ti.template(), state: ti.template(), at, code):
    """The distance that a kept pair keeps."""
    other, place = code >> CODE_BITS, code & LATER
    row = state.closer_start[at] + ti.max(place - 1, 0)
    if place == LATER:
        row = _row_of(state, at, other)
    reach = sorted_radius(spec, state, at) + sorted_radius(spec, state, other)
    return ti.select(place != 0, state.closer_reach[row], reach)


@ti.func
def _narrow_patch(spec: ti.template(), state: ti.template(), a):
    """Find of the pairs that a patch keeps those that may touch in this step."""
    start = state.patch_start[a] * MOST_KEPT
    for at in range(state.patch_start[a], state.patch_start[a + 1]):
        start += _narrow(spec, state, at, start)


@ti.func
def _narrow(spec: ti.template(), state: ti.template(), at, start):
    """Find who of those that a particle keeps may touch it, in the order of places, from the row
    `start` on; how many they are."""
    count, kept = 0, state.kept_count[at]
    if kept > MOST_KEPT:
        state.overfull[None] = state.outdated[None] = 1
    x, begun = sorted_x(spec, state, at), vector(spec, state.listed_begun, at)
    for k in range(ti.min(kept, MOST_KEPT)):
        code = state.kept[at, k]
        other, reach = code >> CODE_BITS, _kept_reach(spec, state, at, code)
        before = vector(spec, state.listed_begun, other) - begun
        now = sorted_x(spec, state, other) - x
        # Without branches, which are mostly guessed wrong here: the next pair takes its row.
        state.found[start + count] = (other << NEAR_BITS) + _passed(before, now, reach) * PASSED
        state.found_reach[start + count] = reach
        count += ti.cast(_within(_shortest2(before, now), (1.0 + CLOTH_MARGIN) * reach), ti.i32)
    for k in range(start + 1, start + count):
        code, reach, to = state.found[k], state.found_reach[k], k
        while to > start and state.found[to - 1] > code:
            state.found[to], state.found_reach[to] = state.found[to - 1], state.found_reach[to - 1]
            to -= 1
        state.found[to], state.found_reach[to] = code, reach
    state.found_start[at], state.found_count[at] = start, count
    return count


# --- what may touch, from both ends, where all act at once ------------------------------------


@ti.func
def _list_both_ends(spec: ti.template(), state: ti.template(), t):
    """List what was found from both its ends, in the order of places."""
    for at in range(state.n[None]):
        state.near_start[at], state.near_count[at] = at * MOST_KEPT, 0
    for at in range(state.patch_start[state.n_patches[None]]):
        for k in range(state.found_start[at], state.found_start[at] + state.found_count[at]):
            other = other_of(state.found[k])
            _put_near(spec, state, at, k, other)
            _put_near(spec, state, other, k, at)
    for at in range(state.n[None]):
        _sort_near(state, at)
    each(spec, state, t, state.n[None], _begin_iterations)


@ti.func
def _put_near(spec: ti.template(), state: ti.template(), at, k, other):
    """Put the pair found in row k into the list of one of its ends, but of one that is fixed."""
    if sorted_w(spec, state, at) > 0.0:
        count = ti.atomic_add(state.near_count[at], 1)
        if count < MOST_KEPT:
            to = state.near_start[at] + count
            state.near[to] = (other << NEAR_BITS) + (state.found[k] & PASSED)
            state.near_reach[to] = state.found_reach[k]
        else:
            state.overfull[None] = 1


@ti.func
def _sort_near(state: ti.template(), at):
    """Put the list of a particle, which threads filled in any order, into that of places."""
    start = state.near_start[at]
    state.near_count[at] = ti.min(state.near_count[at], MOST_KEPT)
    for k in range(start + 1, start + state.near_count[at]):
        code, reach, to = state.near[k], state.near_reach[k], k
        while to > start and state.near[to - 1] > code:
            state.near[to], state.near_reach[to] = state.near[to - 1], state.near_reach[to - 1]
            to -= 1
        state.near[to], state.near_reach[to] = code, reach


@ti.func
def _begin_iterations(spec: ti.template(), state: ti.template(), at):
    """Note who has others near, and fill what iterations read."""
    count = state.near_count[at]
    if count > 0:
        state.active[ti.atomic_add(state.n_active[None], 1)] = at
        state.visited[at] = 0
    else:
        state.touching[at, 0], state.touching[at, 1] = 0.0, 0.0
    if (count > 0) | (sorted_w(spec, state, at) == 0.0):  # what iterations read besides
        v = slot_value(spec, state.v, slot_of(spec, state, state.in_patches[at]))
        other_half = ti.static(state.sorted_half) + at
        for axis in ti.static(range(spec.dim)):
            state.sorted[other_half, axis] = state.sorted[at, axis]
            state.sorted[at, ti.static(spec.dim + 1 + axis)] = v[axis]
            state.sorted[other_half, ti.static(spec.dim + 1 + axis)] = v[axis]


@ti.func
def _within(distance2, reach):
    return distance2 <= reach * reach


@ti.func
def _passed(before, now, reach):
    """True if a pair has passed through each other on the way from `before` to `now`, as 1 or 0.

    So has one that is inside each other and more beside than before where it came from: of sheets
    that a step takes into each other it would push particles along the sheets, and not apart.
    """
    along, now2 = before.dot(now), now.dot(now)
    turned = along * along < ti.static(TURNED * TURNED) * before.dot(before) * now2
    inside = now2 < reach * reach
    return ti.cast(along < 0.0, ti.i32) | (ti.cast(turned, ti.i32) & ti.cast(inside, ti.i32))


@ti.func
def _nearest2(spec: ti.template(), state: ti.template(), at, other):
    """The square of the distance of two particles where they are nearest on the step's ways."""
    now = sorted_x(spec, state, other) - sorted_x(spec, state, at)
    return _shortest2(before_of(spec, state, at, other), now)


@ti.func
def _shortest2(before, now):
    """The square of the shortest vector on the straight way from `before` to `now`."""
    way = now - before
    way2 = way.dot(way)
    part = ti.select(way2 > 0.0, -before.dot(way) / way2, 0.0 * way2)
    nearest = before + ti.min(ti.max(part, 0.0), 1.0) * way
    return ti.min(nearest.dot(nearest), now.dot(now))


@ti.func
def other_of(code):
    """The place of the other one of a pair, of its number in state.near or state.found."""
    return code >> NEAR_BITS


@ti.func
def has_passed(state: ti.template(), pair):
    """True if a pair, by its row of state.near, has passed through each other in this step."""
    return (state.near[pair] & PASSED) != 0


@ti.func
def before_of(spec: ti.template(), state: ti.template(), at, other):
    """From a particle to another one, where the step began."""
    return vector(spec, state.listed_begun, other) - vector(spec, state.listed_begun, at)
