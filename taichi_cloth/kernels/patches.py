"""Patches of particles that began side by side: how long what is listed of two of them holds.

Each particle has an anchor: where it was when its patch was last anchored. Pairs of particles of
two patches are listed by the vectors between their anchors, plus the drift of these patches: how
far one of them had moved against the other, about the middle, when their pairs were listed. Who is
within its reach and a skin of another one so is in the list. So a list has all that may touch as
long as no particle of one patch has moved against one of the other by more than the skin besides
the drift, which the boxes around displacements say for all particles at once, at either end of a
step: on straight ways no difference of two is larger than at one of both ends (lists with a skin:
Verlet, "Computer experiments on classical fluids", 1967).

Where a list does not hold, the drift is made what it is, and that list is made anew; a patch that
has turned or stretched by more than ANCHORED is anchored anew, with all its lists. Where most
lists would be made anew, or a skin would get very wide, all are, by the collision grid.

a, b in this file: patches. Places are those of `state.in_patches`.
"""

import functools

import taichi as ti

from taichi_cloth.kernels.collision_grid import slot_of
from taichi_cloth.kernels.packs import slot_number, slot_value

CLOTH_MARGIN = 0.05  # of a pair's reach, within which particles may come to touch in a step
ANCHORED = 0.5  # of the skin: half the diagonal of the box around a patch's displacements
WIDER = 1.25  # than what a list needs is its skin, where that is more than the scene's
LEADS = 0.8  # of what its skin has to spare, a drift is ahead of where two patches are
WIDEST = 4.0  # skins of the scene: a list that needs more is found by the grid
MOST_STALE = 6  # lists of each patch, that are made anew one by one
# Boxes around a patch: of its anchors, how far it went in the step in which all were listed, how
# far it is from its anchors when this step begins and when it ends, and of all its places in it.
LISTED, WAY, BEGINS, ENDS, SWEPT = range(5)
BLOCK = 16  # places of a patch with a box of their own around their anchors
ANCHOR_ROWS = 4  # of a block in state.block_anchors: coordinates and radius, each of BLOCK places
NOWHERE = 1e18  # the coordinate of a place that a block does not have: its square is finite
# Of state.stale: a list that is to be made, and one that is when both patches are near each other.
STALE, LAPSED = 1, 2


@ti.func
def vector(spec: ti.template(), field: ti.template(), at):
    """The vector (dim,) in a row of a field."""
    return ti.Vector([field[at, axis] for axis in range(spec.dim)])


@ti.func
def bound_patch(spec: ti.template(), state: ti.template(), a):
    """Find how far a patch has come from its anchors, and anchor it where it lost its shape."""
    low, high = _nothing(state), -1.0 * _nothing(state)
    low_at_end, high_at_end = low, high
    low_swept, high_swept = low, high
    for at in range(state.patch_start[a], state.patch_start[a + 1]):
        slot, anchor = slot_of(spec, state, state.in_patches[at]), vector(spec, state.listed_x, at)
        from_x, to_x = slot_value(spec, state.begun_x, slot), slot_value(spec, state.x, slot)
        begun, come = from_x - anchor, to_x - anchor
        low_swept = ti.min(low_swept, from_x, to_x)
        high_swept = ti.max(high_swept, from_x, to_x)
        low, high = ti.min(low, begun), ti.max(high, begun)
        low_at_end, high_at_end = ti.min(low_at_end, come), ti.max(high_at_end, come)
    _store_box(state, a, ti.static(BEGINS), low, high)
    _store_box(state, a, ti.static(ENDS), low_at_end, high_at_end)
    _store_box(state, a, ti.static(SWEPT), low_swept, high_swept)
    most = ti.static(2.0 * ANCHORED) * state.skin[None]
    diagonal = high_at_end - low_at_end
    state.anchored[a] = ti.cast(diagonal.dot(diagonal) > most * most, ti.i32)
    if state.anchored[a] == 1:
        anchor_patch(spec, state, a)
        for axis in ti.static(range(3)):  # it began where it came from, and is at its anchors
            low[axis] = -1.0 * state.patch_box[a, ti.static(6 * WAY + 3 + axis)]
            high[axis] = -1.0 * state.patch_box[a, ti.static(6 * WAY + axis)]
        _store_box(state, a, ti.static(BEGINS), low, high)
        _store_box(state, a, ti.static(ENDS), 0.0 * low, 0.0 * low)


@ti.func
def anchor_patch(spec: ti.template(), state: ti.template(), a):
    """Anchor a patch where it is at the step's free end; the boxes around that and how it came."""
    low, high = _nothing(state), -1.0 * _nothing(state)
    low_way, high_way = low, high
    for block in range(blocks_of(state, a)):
        first, end = block_of(state, a, block)
        block_low, block_high = _nothing(state), -1.0 * _nothing(state)
        row = _row_of_block(a, first)
        for at in range(first, end):
            slot = slot_of(spec, state, state.in_patches[at])
            x = slot_value(spec, state.x, slot)
            way = x - slot_value(spec, state.begun_x, slot)
            block_low, block_high = ti.min(block_low, x), ti.max(block_high, x)
            low_way, high_way = ti.min(low_way, way), ti.max(high_way, way)
            for axis in ti.static(range(spec.dim)):
                state.listed_x[at, axis] = x[axis]
                state.block_anchors[row, at - first + ti.static(axis * BLOCK)] = x[axis]
            radius = slot_number(spec, state.pair_radius, slot)
            state.block_anchors[row, at - first + ti.static(3 * BLOCK)] = radius
        for k in range(end - first, BLOCK):
            state.block_anchors[row, k] = NOWHERE
        for axis in ti.static(range(3)):
            state.block_box[row, axis] = block_low[axis]
            state.block_box[row, ti.static(3 + axis)] = block_high[axis]
        low, high = ti.min(low, block_low), ti.max(high, block_high)
    _store_box(state, a, ti.static(LISTED), low, high)
    _store_box(state, a, ti.static(WAY), low_way, high_way)


@functools.cache
def by_patches(body):
    """The body of a loop over all patches that runs body(spec, state, a) for each: those of early
    and of late places by turns, as the early ones have most pairs with later ones."""

    @ti.func
    def folded(spec: ti.template(), state: ti.template(), i):
        a = i // 2
        if i & 1 == 1:
            a = state.n_patches[None] - 1 - a
        body(spec, state, a)

    return folded


@ti.func
def blocks_of(state: ti.template(), a):
    """The number of blocks of a patch."""
    return (state.patch_start[a + 1] - state.patch_start[a] + BLOCK - 1) // BLOCK


@ti.func
def block_of(state: ti.template(), a, block):
    """The first place of a block of a patch, and the first place behind it."""
    first = state.patch_start[a] + block * BLOCK
    return first, ti.min(first + BLOCK, state.patch_start[a + 1])


@ti.func
def _row_of_block(a, first):
    """The row of state.block_box and block_anchors of the block of a patch that begins at the
    place `first`."""
    # Patches are not whole blocks, so each has one row more than places say.
    return first // BLOCK + a


@ti.func
def hits_in_block(state: ti.template(), a, first, x, reach):
    """Whose anchors, in the block of a patch that begins at `first`, are within their radius and
    reach of x, as bits."""
    hits, row = 0, _row_of_block(a, first)
    for k in range(BLOCK):  # without branches, and along memory
        dx = state.block_anchors[row, k] - x[0]
        dy = state.block_anchors[row, k + ti.static(BLOCK)] - x[1]
        dz = state.block_anchors[row, k + ti.static(2 * BLOCK)] - x[2]
        far = reach + state.block_anchors[row, k + ti.static(3 * BLOCK)]
        hits |= ti.cast(dx * dx + dy * dy + dz * dz <= far * far, ti.i32) << k
    return hits


@ti.func
def block_is_near_patch(state: ti.template(), a, first, b, drift, reach):
    """True if anchors in a block of a patch may be within reach of those of b, with their drift."""
    low, high = _block_box(state, a, first)
    patch_low = ti.Vector([state.patch_box[b, 6 * LISTED + axis] for axis in range(3)])
    patch_high = ti.Vector([state.patch_box[b, 6 * LISTED + 3 + axis] for axis in range(3)])
    return _shortest2(patch_low - (high - drift), patch_high - (low - drift)) <= reach * reach


@ti.func
def blocks_are_near(state: ti.template(), a, first, b, other_first, drift, reach):
    """True if anchors in two blocks, with the drift of their patches, may be within reach."""
    low, high = _block_box(state, a, first)
    other_low, other_high = _block_box(state, b, other_first)
    return _shortest2(other_low - (high - drift), other_high - (low - drift)) <= reach * reach


@ti.func
def anchor_patch_anew(spec: ti.template(), state: ti.template(), a):
    """Anchor a patch where all are, and forget its drifts and what was stale."""
    anchor_patch(spec, state, a)
    for b in range(state.n_patches[None]):
        k = of_two(state, a, b)
        for axis in ti.static(range(3)):
            state.drift[k, axis] = 0.0
        state.drift[k, 3], state.stale[k] = state.skin[None], 0


@ti.func
def of_two(state: ti.template(), a, b):
    """The row of state.drift and state.stale that two patches have, of which a comes before b or is
    b: the drift is that of b against a."""
    return a * state.n_patches[None] + b


@ti.func
def _nothing(state: ti.template()):
    """The low corner of a box around nothing."""
    return ti.Vector([1e30, 1e30, 1e30], state.real)


@ti.func
def _store_box(state: ti.template(), a, box: ti.template(), low, high):
    for axis in ti.static(range(3)):
        state.patch_box[a, ti.static(6 * box + axis)] = low[axis]
        state.patch_box[a, ti.static(6 * box + 3 + axis)] = high[axis]


@ti.func
def _differences(state: ti.template(), a, b, box: ti.template()):
    """The smallest and largest differences between vectors in the box of one patch and in that of
    another: low and high corners."""
    low, high = _nothing(state), _nothing(state)
    for axis in ti.static(range(3)):
        first, last = ti.static(6 * box + axis), ti.static(6 * box + 3 + axis)
        low[axis] = state.patch_box[b, first] - state.patch_box[a, last]
        high[axis] = state.patch_box[b, last] - state.patch_box[a, first]
    return low, high


@ti.func
def _longest2(low, high):
    """The square of the longest vector in a box with 0 in it or not."""
    longest = ti.max(high, -1.0 * low)
    return longest.dot(longest)


@ti.func
def _shortest2(low, high):
    """The square of the shortest vector in a box."""
    shortest = ti.max(low, -1.0 * high, 0.0)
    return shortest.dot(shortest)


@ti.func
def _block_box(state: ti.template(), a, first):
    """The low and high corners of the box around the block of a patch that begins at `first`."""
    row = _row_of_block(a, first)
    low = ti.Vector([state.block_box[row, axis] for axis in range(3)])
    high = ti.Vector([state.block_box[row, 3 + axis] for axis in range(3)])
    return low, high


@ti.func
def are_near(state: ti.template(), a, b, reach):
    """True if anchors of two patches, with their drift, may be within `reach` of each other."""
    low, high = _differences(state, a, b, ti.static(LISTED))
    drift = ti.Vector([state.drift[of_two(state, a, b), axis] for axis in range(3)])
    return not (_shortest2(low + drift, high + drift) >= reach * reach)


@ti.func
def reach_of_most(state: ti.template()):
    """Nearer than this no pair may touch in a step."""
    return ti.static(2.0 * (1.0 + CLOTH_MARGIN)) * state.largest_radius[None]


@ti.func
def compare_patch(spec: ti.template(), state: ti.template(), a):
    """Find the lists of a patch that do not hold in this step: of each two one looks."""
    count = state.n_patches[None]
    for k in range(count // 2 + 1):
        b = a + k
        if b >= count:
            b -= count
        if (2 * k < count) | (a < b):
            _compare(state, ti.min(a, b), ti.max(a, b))


@ti.func
def _compare(state: ti.template(), a, b):
    row, anew = of_two(state, a, b), (state.anchored[a] | state.anchored[b]) == 1
    low_apart, high_apart = _differences(state, a, b, ti.static(SWEPT))
    if _shortest2(low_apart, high_apart) > reach_of_most(state) * reach_of_most(state):
        if anew:
            state.stale[row] = LAPSED
    else:
        drift = _nothing(state)
        for axis in ti.static(range(3)):
            drift[axis] = state.drift[row, axis]
        low_begun, high_begun = _differences(state, a, b, ti.static(BEGINS))
        low_end, high_end = _differences(state, a, b, ti.static(ENDS))
        low, high = ti.min(low_begun, low_end) - drift, ti.max(high_begun, high_end) - drift
        differ2 = _longest2(low, high)
        anew = anew | (state.stale[row] == LAPSED)
        if anew | (differ2 > state.drift[row, 3] * state.drift[row, 3]):
            if anew or are_near(state, a, b, reach_of_most(state) + ti.sqrt(differ2)):
                way = 0.5 * (low_end + high_end - low_begun - high_begun)
                _let_drift(state, a, b, drift + 0.5 * (low + high), 0.5 * (high - low), way)


@ti.func
def _let_drift(state: ti.template(), a, b, drift, half, way):
    """Note that the lists of two patches are stale, and by what drift and skin they are made.

    drift: the middle of how far b has come against a in this step; half: of the box around that;
    way: how far it comes in a step. Ahead of where they are, lists hold longer.
    """
    needed = ti.sqrt(half.dot(half))
    skin = ti.max(state.skin[None], WIDER * needed)
    way2 = way.dot(way)
    if way2 > 0.0:
        drift += (LEADS * (skin - needed) / ti.sqrt(way2)) * way
    row = of_two(state, a, b)
    for axis in ti.static(range(3)):
        state.drift[row, axis] = drift[axis]
    state.drift[row, 3], state.stale[row] = skin, STALE
    if are_near(state, a, b, reach_of_most(state) + skin):
        ti.atomic_add(state.n_stale[None], 1)
        if skin > WIDEST * state.skin[None]:
            state.outdated[None] = 1


@ti.func
def look_ahead(spec: ti.template(), state: ti.template(), a):
    """The distance from the places of a patch at a step's end within which it may meet others."""
    most = ti.cast(0.0, state.real)
    for b in range(state.n_patches[None]):
        low, high = _differences(state, a, b, ti.static(WAY))
        differ2 = _longest2(low, high)
        if differ2 > most * most:
            differ = ti.sqrt(differ2)
            if are_near(state, a, b, reach_of_most(state) + differ):
                most = differ
    state.patch_ahead[a] = most
