"""Who may touch whom in a step: pairs of particles near each other, listed by place.

Where no cloth has a thickness, all pairs within 1 + MARGIN of their reach at the step's free end
are listed anew in each step; who has more of them than MOST_NEAR looks into the grid again.

Where one has (`spec.thick`), pairs within their reach and a skin are kept from step to step, in
the order by cells of the step that listed them, until some have come nearer by the skin (Verlet,
"Computer experiments on classical fluids", 1967). That is asked of patches of particles that began
side by side, two by two: of the boxes around their displacements, at both ends of the step, unless
they were listed farther apart than that. Where pairs are listed, those that came near each other on
the straight ways of that step are listed, too, however far these went; the boxes around the ways of
patches say how far to look. So in each step the list has all that may touch, and is narrowed to
those. What has
passed through is marked: its normal is that of the step's start. Who has more than MOST_KEPT in its
list keeps the first ones, and the step is counted as unsettled.

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
CLOTH_MARGIN = 0.05  # the same where cloths have a thickness
CLOSER_SKIN = 0.25  # of the skin: for neighbours in a cloth, whose springs keep them apart
PASSED, CLOSER = 1, 2
LISTED, COME, NOW, WAY = range(4)  # boxes of a patch: of positions and of displacements


@ti.func
def find_pairs(spec: ti.template(), state: ti.template(), t):
    """Find who may touch whom at the end of this step."""
    if ti.static(not spec.thick):
        sort_into_cells(spec, state, t)
        each(spec, state, t, state.n[None], _begin)
    else:
        if ti.static(spec.one_launch_per_step):
            each(spec, state, t, state.n_patches[None], _bound_patch)
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

    pair: a place, or a code where a cloth has a thickness.
    """
    total = ti.Vector.zero(state.real, ti.static(sizes(spec)))
    count = state.near_count[at]
    if ti.static(spec.thick):
        for k in range(count):
            total += term(spec, state, at, state.near[at, k])
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
    """The boxes around a patch of particles: where they were listed, how far they have come since
    at both ends of this step, where they are, and how far they go in this step."""
    big = ti.Vector([1e30, 1e30, 1e30], state.real)
    listed_low, come_low, x_low, way_low = big, big, big, big
    listed_high, come_high, x_high, way_high = -1.0 * big, -1.0 * big, -1.0 * big, -1.0 * big
    for k in range(state.patch_start[patch], state.patch_start[patch + 1]):
        i = state.in_patches[k]
        slot = slot_of(spec, state, i)
        x, begun = slot_value(spec, state.x, slot), slot_value(spec, state.begun_x, slot)
        listed = _vector(spec, state.listed_x, i)
        come, came, way = x - listed, begun - listed, x - begun
        listed_low, listed_high = ti.min(listed_low, listed), ti.max(listed_high, listed)
        come_low, come_high = ti.min(come_low, come, came), ti.max(come_high, come, came)
        x_low, x_high = ti.min(x_low, x), ti.max(x_high, x)
        way_low, way_high = ti.min(way_low, way), ti.max(way_high, way)
    for axis in ti.static(range(3)):
        for box, low, high in ti.static(
            (
                (LISTED, listed_low, listed_high),
                (COME, come_low, come_high),
                (NOW, x_low, x_high),
                (WAY, way_low, way_high),
            )
        ):
            state.box[patch, 6 * box + axis] = low[axis]
            state.box[patch, 6 * box + 3 + axis] = high[axis]


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
    for other in range(patch, state.n_patches[None]):
        differ2 = _differ2(state, patch, other, ti.static(COME))
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
            if _apart2(state, patch, other, ti.static(NOW)) <= (reach + differ) * (reach + differ):
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
        mine, closer = _own_reach(spec, state, at, other, full)
        if closer == 1:
            there = _within(d2, mine + CLOSER_SKIN * state.skin[None])
            if (not there) & (state.far[at] == 1):
                there = _within(_nearest2(spec, state, at, other), (1.0 + CLOTH_MARGIN) * mine)
        if there:
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
    k, end = state.closer_start[i], state.closer_start[i + 1]
    while k < end:
        if state.closer_other[k] == j:
            reach, closer = state.closer_reach[k], 1
            k = end
        k += 1
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
    count, kept = 0, state.kept_count[at]
    if kept > MOST_KEPT:
        state.overfull[None] = 1
    for k in range(ti.min(kept, MOST_KEPT)):
        pair = state.kept[at, k]
        reach = (1.0 + CLOTH_MARGIN) * reach_of(spec, state, at, pair)
        if _within(_nearest2(spec, state, at, pair >> 2), reach):
            now = sorted_x(spec, state, pair >> 2) - sorted_x(spec, state, at)
            if before_of(spec, state, at, pair).dot(now) < 0.0:
                pair = pair | PASSED
            state.near[at, count] = pair
            count += 1
    state.near_count[at] = count
    if count > 0:
        state.active[ti.atomic_add(state.n_active[None], 1)] = at
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
    before = before_of(spec, state, at, other * 4)
    way = sorted_x(spec, state, other) - sorted_x(spec, state, at) - before
    way2, there = way.dot(way), ti.cast(1.0, state.real)
    if way2 > 0.0:
        there = ti.max(ti.min(-1.0 * before.dot(way) / way2, 1.0), 0.0)
    nearest = before + there * way
    return nearest.dot(nearest)


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
