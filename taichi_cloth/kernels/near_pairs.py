"""Who may touch whom in a step: pairs of particles near each other, listed by place.

Where no cloth has a thickness, all pairs within 1 + MARGIN of their reach at the step's free end
are listed anew in each step; who has more of them than MOST_NEAR looks into the grid again.

Where one has (`spec.thick`), pairs within their reach and a skin are kept from step to step, in
the order by cells of the step that listed them, until some have come nearer by the skin (Verlet,
"Computer experiments on classical fluids", 1967). That is asked of patches of particles that began
side by side, two by two: of the boxes around their displacements when the step begins and when it
ends, unless they were listed farther apart than that. Where pairs are listed, those that came near
each other on the straight ways of that step are listed, too, however far these went; the boxes
around the ways of patches say how far to look. So in each step the list has all that may touch, and
is narrowed to those. What has passed through is marked: its normal is that of the step's start. Who
has more than MOST_KEPT in its list keeps the first ones, and the step is counted as unsettled.

at, other: places in the order by cells. A code of `state.kept`: the place of the other one; in its
last CODE_BITS, for pairs that keep less than the sum of their radii, CLOSER times one more than how
many of the particle's rows of `state.closer_...` come before theirs, or times LATER if that is
less. One of `state.near`: twice the place, plus PASSED.
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
CLOTH_MARGIN = 0.05  # the same where cloths have a thickness
CLOSER_SKIN = 0.25  # of the skin: for neighbours in a cloth, whose springs keep them apart
PASSED, CLOSER, LATER, CODE_BITS = 1, 2, 31, 6
# Boxes around a patch: where it was listed, how far it went in that step, and how far it has come
# since when this step begins and when it ends.
LISTED, WAY, BEGINS, ENDS = range(4)


@ti.func
def find_pairs(spec: ti.template(), state: ti.template(), t):
    """Find who may touch whom at the end of this step."""
    if ti.static(not spec.thick):
        sort_into_cells(spec, state, t)
        each(spec, state, t, state.n[None], _begin)
    else:
        if ti.static(spec.one_launch_per_step):
            _keep_pairs(spec, state, t)
        else:
            each(spec, state, t, state.n_patches[None], _bound_patch)
            each(spec, state, t, state.n_patches[None], _compare_patch)
            if state.outdated[None] == 1:
                _keep_pairs(spec, state, t)
            else:
                each(spec, state, t, state.n[None], _refresh)
        each(spec, state, t, 1, _begin_lists)
        each(spec, state, t, state.n[None], _narrow)


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

    pair: a place, or where a cloth has a thickness which one of the list it is.
    """
    total = ti.Vector.zero(state.real, ti.static(sizes(spec)))
    count = state.near_count[at]
    if ti.static(spec.thick):
        for k in range(count):
            total += term(spec, state, at, k)
    elif count <= MOST_NEAR:
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
def _bound_patch(spec: ti.template(), state: ti.template(), patch):
    """The boxes around how far a patch of particles has come since it was listed."""
    low, high = _nothing(state), -1.0 * _nothing(state)
    low_at_end, high_at_end = low, high
    for k in range(state.patch_start[patch], state.patch_start[patch + 1]):
        i = state.in_patches[k]
        slot, listed = slot_of(spec, state, i), _vector(spec, state.listed_x, i)
        begun = slot_value(spec, state.begun_x, slot) - listed
        come = slot_value(spec, state.x, slot) - listed
        low, high = ti.min(low, begun), ti.max(high, begun)
        low_at_end, high_at_end = ti.min(low_at_end, come), ti.max(high_at_end, come)
    _store_box(state, patch, ti.static(BEGINS), low, high)
    _store_box(state, patch, ti.static(ENDS), low_at_end, high_at_end)


@ti.func
def _bound_listed_patch(spec: ti.template(), state: ti.template(), patch):
    """The boxes around where a patch of particles is at the step's free end, and how it came."""
    low, high = _nothing(state), -1.0 * _nothing(state)
    low_way, high_way = low, high
    for k in range(state.patch_start[patch], state.patch_start[patch + 1]):
        slot = slot_of(spec, state, state.in_patches[k])
        x = slot_value(spec, state.x, slot)
        way = x - slot_value(spec, state.begun_x, slot)
        low, high = ti.min(low, x), ti.max(high, x)
        low_way, high_way = ti.min(low_way, way), ti.max(high_way, way)
    _store_box(state, patch, ti.static(LISTED), low, high)
    _store_box(state, patch, ti.static(WAY), low_way, high_way)


@ti.func
def _nothing(state: ti.template()):
    """The low corner of a box around nothing."""
    return ti.Vector([1e30, 1e30, 1e30], state.real)


@ti.func
def _store_box(state: ti.template(), patch, box: ti.template(), low, high):
    for axis in ti.static(range(3)):
        state.box[patch, ti.static(6 * box + axis)] = low[axis]
        state.box[patch, ti.static(6 * box + 3 + axis)] = high[axis]


@ti.func
def _apart2(state: ti.template(), a, b, box: ti.template()):
    """The square of the distance between the boxes of two patches."""
    total = ti.cast(0.0, state.real)
    for axis in ti.static(range(3)):
        low, high = ti.static(6 * box + axis), ti.static(6 * box + 3 + axis)
        gap = ti.max(state.box[b, low] - state.box[a, high], state.box[a, low] - state.box[b, high])
        gap = ti.max(gap, 0.0)
        total += gap * gap
    return total


@ti.func
def _differ2(state: ti.template(), a, b, box: ti.template()):
    """The square of the longest difference between a vector in the box of one patch and one in
    that of another."""
    total = ti.cast(0.0, state.real)
    for axis in ti.static(range(3)):
        low, high = ti.static(6 * box + axis), ti.static(6 * box + 3 + axis)
        most = ti.max(
            state.box[b, high] - state.box[a, low], state.box[a, high] - state.box[b, low]
        )
        total += most * most
    return total


@ti.func
def _compare_patch(spec: ti.template(), state: ti.template(), patch):
    """Note if a particle of this patch may touch one that is not in its list."""
    skin2 = state.skin[None] * state.skin[None]
    reach = ti.static(2.0 * (1.0 + CLOTH_MARGIN)) * state.largest_radius[None]
    for k in range(state.n_patches[None] // 2 + 1):  # each pair once or twice; threads get as much
        other = patch + k
        if other >= state.n_patches[None]:
            other -= state.n_patches[None]
        # Along straight ways no difference is larger than at one of both ends.
        differ2 = ti.max(
            _differ2(state, patch, other, ti.static(BEGINS)),
            _differ2(state, patch, other, ti.static(ENDS)),
        )
        if differ2 > skin2:
            far = reach + ti.sqrt(differ2)
            if not (_apart2(state, patch, other, ti.static(LISTED)) >= far * far):
                state.outdated[None] = 1


@ti.func
def _look_ahead(spec: ti.template(), state: ti.template(), patch):
    """How far from the places of a patch at a step's end those are that it may meet on its way."""
    reach = ti.static(2.0 * (1.0 + CLOTH_MARGIN)) * state.largest_radius[None]
    most = ti.cast(0.0, state.real)
    for other in range(state.n_patches[None]):
        differ2 = _differ2(state, patch, other, ti.static(WAY))
        if differ2 > most * most:
            differ = ti.sqrt(differ2)
            far = reach + differ
            if _apart2(state, patch, other, ti.static(LISTED)) <= far * far:
                most = differ
    state.ahead[patch] = most


@ti.func
def _refresh(spec: ti.template(), state: ti.template(), at):
    """Take a particle to its place in the order that is kept."""
    slot = slot_of(spec, state, state.sorted_index[at])
    x, begun = slot_value(spec, state.x, slot), slot_value(spec, state.begun_x, slot)
    for axis in ti.static(range(spec.dim)):
        state.sorted[at, axis], state.listed_begun[at, axis] = x[axis], begun[axis]


@ti.func
def _begin_lists(spec: ti.template(), state: ti.template(), i):
    """The lists of the next step are those of this one, as far as is known; and none is active."""
    state.outdated[None] = state.n_active[None] = 0


@ti.func
def _keep_pairs(spec: ti.template(), state: ti.template(), t):
    """List all pairs within their reach and a skin at the step's free end, or near on its ways."""
    each(spec, state, t, state.n_patches[None], _bound_listed_patch)
    each(spec, state, t, state.n_patches[None], _look_ahead)
    sort_into_cells(spec, state, t)
    each(spec, state, t, state.n[None], _take_along)
    each(spec, state, t, state.n[None], _keep)


@ti.func
def _take_along(spec: ti.template(), state: ti.template(), at):
    """Fill what a place has besides what is sorted."""
    i = state.sorted_index[at]
    begun = slot_value(spec, state.begun_x, slot_of(spec, state, i))
    for axis in ti.static(range(spec.dim)):
        state.listed_x[i, axis] = state.sorted[at, axis]
        state.listed_begun[at, axis] = begun[axis]


@ti.func
def _keep(spec: ti.template(), state: ti.template(), at):
    """List the pairs of the particle at a place."""
    state.kept_count[at] = 0
    radius = sorted_radius(spec, state, at)
    if (sorted_w(spec, state, at) > 0.0) & (radius >= 0.0):
        ahead = state.ahead[state.patch_of[state.sorted_index[at]]]
        beyond = ti.max(
            state.skin[None], ahead + ti.static(2.0 * CLOTH_MARGIN) * state.largest_radius[None]
        )
        state.far[at] = ti.cast(beyond > state.skin[None], ti.i32)
        reach = radius + state.largest_radius[None] + beyond
        x = sorted_x(spec, state, at)
        sum_over_near(spec, state, at, x, reach, ti.static(1), _keep_near)


@ti.func
def _keep_near(spec: ti.template(), state: ti.template(), at, other):
    full = sorted_radius(spec, state, at) + sorted_radius(spec, state, other)
    d = sorted_x(spec, state, other) - sorted_x(spec, state, at)
    d2 = d.dot(d)
    there = _within(d2, full + state.skin[None])
    if (not there) & (state.far[at] == 1):
        there = _within(_nearest2(spec, state, at, other), (1.0 + CLOTH_MARGIN) * full)
    if there & (other != at) & (sorted_radius(spec, state, other) >= 0.0):
        row = _row_of(state, at, other)
        if row >= 0:
            mine = state.closer_reach[row]
            there = _within(d2, mine + CLOSER_SKIN * state.skin[None])
            if (not there) & (state.far[at] == 1):
                there = _within(_nearest2(spec, state, at, other), (1.0 + CLOTH_MARGIN) * mine)
        if there:
            count = state.kept_count[at]
            if count < MOST_KEPT:
                place = 0
                if row >= 0:
                    first = state.closer_start[state.sorted_index[at]]
                    place = ti.min(row - first + 1, LATER)
                state.kept[at, count] = (other << CODE_BITS) + place * CLOSER
            state.kept_count[at] = count + 1
    return ti.Vector.zero(state.real, 1)


@ti.func
def _row_of(state: ti.template(), at, other):
    """The row of a pair among those that keep less than the sum of their radii; -1: it does not."""
    i, j = state.sorted_index[at], state.sorted_index[other]
    row, k, end = -1, state.closer_start[i], state.closer_start[i + 1]
    while k < end:
        if state.closer_other[k] == j:
            row, k = k, end
        k += 1
    return row


@ti.func
def reach_of(spec: ti.template(), state: ti.template(), at, pair):
    """How near a pair may come: the sum of its radii, or what is its own."""
    if ti.static(spec.thick):
        return state.near_reach[at, pair]
    else:
        return sorted_radius(spec, state, at) + sorted_radius(spec, state, pair)


@ti.func
def _kept_reach(spec: ti.template(), state: ti.template(), at, code):
    """How near a pair that is kept may come."""
    other, place = code >> CODE_BITS, (code >> 1) & LATER
    reach = sorted_radius(spec, state, at) + sorted_radius(spec, state, other)
    if place != 0:
        row = state.closer_start[state.sorted_index[at]] + place - 1
        if place == LATER:
            row = _row_of(state, at, other)
        reach = state.closer_reach[row]
    return reach


@ti.func
def _narrow(spec: ti.template(), state: ti.template(), at):
    """List of the pairs that are kept those that may touch in this step."""
    count, kept = 0, state.kept_count[at]
    if kept > MOST_KEPT:
        state.overfull[None] = 1
    for k in range(ti.min(kept, MOST_KEPT)):
        code = state.kept[at, k]
        other, reach = code >> CODE_BITS, _kept_reach(spec, state, at, code)
        if _within(_nearest2(spec, state, at, other), (1.0 + CLOTH_MARGIN) * reach):
            now = sorted_x(spec, state, other) - sorted_x(spec, state, at)
            passed = ti.cast(before_of(spec, state, at, other).dot(now) < 0.0, ti.i32)
            state.near[at, count] = other * 2 + passed * PASSED
            state.near_reach[at, count] = reach
            count += 1
    state.near_count[at] = count
    if count > 0:
        state.active[ti.atomic_add(state.n_active[None], 1)] = at
        state.visited[at] = 0
    else:
        state.touching[at, 0], state.touching[at, 1] = 0.0, 0.0
    if (count > 0) | (sorted_w(spec, state, at) == 0.0):  # what iterations read besides
        v = slot_value(spec, state.v, slot_of(spec, state, state.sorted_index[at]))
        other_half = ti.static(state.sorted_half) + at
        for axis in ti.static(range(spec.dim)):
            state.sorted[other_half, axis] = state.sorted[at, axis]
            state.sorted[at, ti.static(spec.dim + 1 + axis)] = v[axis]
            state.sorted[other_half, ti.static(spec.dim + 1 + axis)] = v[axis]


@ti.func
def _within(distance2, reach):
    return distance2 <= reach * reach


@ti.func
def _nearest2(spec: ti.template(), state: ti.template(), at, other):
    """The square of the distance of two particles where they are nearest on the step's ways."""
    before = before_of(spec, state, at, other)
    now = sorted_x(spec, state, other) - sorted_x(spec, state, at)
    way = now - before
    nearest2, along, way2 = ti.min(before.dot(before), now.dot(now)), -before.dot(way), way.dot(way)
    if (along > 0.0) & (along < way2):
        nearest = before + along / way2 * way
        nearest2 = nearest.dot(nearest)
    return nearest2


@ti.func
def place_of(spec: ti.template(), state: ti.template(), at, pair):
    """The place of the other one of a pair."""
    if ti.static(spec.thick):
        return state.near[at, pair] >> 1
    else:
        return pair


@ti.func
def has_passed(state: ti.template(), at, pair):
    """Whether a pair has passed through each other in this step."""
    return (state.near[at, pair] & PASSED) != 0


@ti.func
def before_of(spec: ti.template(), state: ti.template(), at, other):
    """From a particle to another one, where the step began."""
    return _vector(spec, state.listed_begun, other) - _vector(spec, state.listed_begun, at)
