"""Pairs of cloth that act one after the other, in sweeps (Gauss-Seidel), on processors.

Each pair in its turn is taken apart whole, from what those before it left (successive impulses:
Moreau, "Numerical aspects of the sweeping process", 1999; positions likewise: Müller et al.,
"Position based dynamics", 2007). Each keeps momentum and loses energy, and so does the whole,
however many sweeps are done; what they leave is smaller than where all pairs act at once, with a
part of each particle's mass (`resting_pairs.py`). Their turns are those of colours
(`pair_colours.py`): the same for every number of threads.

From the second sweep on, pairs are left out whose particles did not change since their last turn.
After each sweep who was pushed into an obstacle is put onto it. Where they pushed somebody farther
than what was found allows for, another round finds who may touch whom now: it looks at them first,
and ends where none of them overlaps.

at, other: places in `state.in_patches`, whose particles are in state.sorted.
"""

import taichi as ti

from taichi_cloth.kernels.collision_grid import (
    slot_of,
    sorted_radius,
    sorted_v,
    sorted_w,
    sorted_x,
)
from taichi_cloth.kernels.kept_pairs import has_passed, other_of
from taichi_cloth.kernels.loops import barrier, each, share
from taichi_cloth.kernels.obstruction import is_free
from taichi_cloth.kernels.packs import slot_value
from taichi_cloth.kernels.pair_colours import COLOURS, colour_pairs, first_row
from taichi_cloth.kernels.pair_laws import (
    APPROACH,
    OVERLAP,
    clear_residual,
    impulse,
    may_touch,
    meeting,
    out_of_obstacles,
)
from taichi_cloth.kernels.patches import CLOTH_MARGIN

FEW = 32  # pairs of a colour, that one thread does


def is_swept(spec):
    """True if the pairs of a specialization act one after the other."""
    return spec.thick and not spec.one_launch_per_step


@ti.func
def sweep_pairs(
    spec: ti.template(), state: ti.template(), t, most: ti.template(), settled: ti.template()
):
    """Take the pairs that were found apart, with what contact and friction leave of velocities.

    most: sweeps at most, of all rounds; settled: the overlap and the approach, in parts of a pair's
    reach, at which they end.
    """
    first, looks, going = state.pair_iteration[None] + 1, 1, 1
    if state.pair_round[None] == 0:
        first = looks = 0
    each(spec, state, t, state.n[None], _forget)
    colour_pairs(spec, state, t)
    each(spec, state, t, state.n[None], _take_velocity)
    sweep, since = first, 0
    while going == 1:
        # Every thread writes the same, and none is still in the sweep before.
        state.pair_iteration[None] = sweep
        each(spec, state, t, 1, clear_residual)
        for colour in range(ti.static(COLOURS + 1)):
            _sweep_colour(spec, state, t, colour, sweep, since, looks)
        if ti.static(len(spec.obstacles) > 0):
            each(spec, state, t, state.n[None], _keep_out)
        k = sweep & 1
        worst = ti.max(state.pair_residual[k, OVERLAP], state.pair_residual[k, APPROACH])
        sweep += 1
        since = ti.select(looks == 1, 0, sweep)  # after a look all have a turn
        looks = 0
        if worst <= settled or sweep >= most:
            going = 0
    each(spec, state, t, state.n[None], _note_if_far)


@ti.func
def _forget(spec: ti.template(), state: ti.template(), at):
    state.colours_at[at] = state.changed[at] = 0
    if at == 0:
        state.pushed_far[None] = 0


@ti.func
def _note_if_far(spec: ti.template(), state: ti.template(), at):
    """Note if a particle was pushed so far that it may touch others than were found at first."""
    if state.changed[at] > 0:
        slot = slot_of(spec, state, state.in_patches[at])
        pushed = sorted_x(spec, state, at) - slot_value(spec, state.x, slot)
        far = CLOTH_MARGIN * sorted_radius(spec, state, at)
        if pushed.dot(pushed) > far * far:
            state.pushed_far[None] = 1


@ti.func
def _take_velocity(spec: ti.template(), state: ti.template(), at):
    if state.colours_at[at] != 0:
        v = slot_value(spec, state.v, slot_of(spec, state, state.in_patches[at]))
        for axis in ti.static(range(spec.dim)):
            state.sorted[at, ti.static(spec.dim + 1 + axis)] = v[axis]


@ti.func
def _sweep_colour(spec: ti.template(), state: ti.template(), t, colour, sweep, since, looks):
    """Do the pairs of a colour, of which few, and all of the rest, are one thread's.

    since: the sweep in which one of a pair's particles must have changed; looks: 1 to change none.
    """
    count, after = state.colour_size[colour], 0
    if colour < COLOURS:
        after = state.colour_size[colour + 1]
    begin, end = share(spec, count, t), share(spec, count, t + 1)
    together = (colour < COLOURS) & (count > FEW)
    if not together:
        begin, end = ti.select(t == 0, 0, count), count
    overlap, approach = ti.cast(0.0, state.real), ti.cast(0.0, state.real)
    first = first_row(state, colour)
    for row in range(first + begin, first + end):
        a, b = state.near_from[row], other_of(state.near[row])
        if ti.max(state.changed[a], state.changed[b]) >= since:
            left = _settle_pair(spec, state, row, a, b, sweep, looks)
            overlap, approach = ti.max(overlap, left[OVERLAP]), ti.max(approach, left[APPROACH])
    k = sweep & 1
    if overlap > 0.0:
        ti.atomic_max(state.pair_residual[k, OVERLAP], overlap)
    if approach > 0.0:
        ti.atomic_max(state.pair_residual[k, APPROACH], approach)
    # What one thread does needs no barrier before what it does next.
    if together or (after > FEW and colour + 1 < COLOURS) or colour == COLOURS:
        barrier(spec, state, t)


@ti.func
def _settle_pair(spec: ti.template(), state: ti.template(), row, a, b, sweep, looks):
    """Take a pair apart, but for one that is only looked at.

    Returns its overlap before, and its approach in a step, in parts of its reach.
    """
    left = ti.Vector.zero(state.real, 2)
    x, reach, passed = sorted_x(spec, state, a), state.near_reach[row], has_passed(state, row)
    d = sorted_x(spec, state, b) - x
    if may_touch(spec, state, x, d, reach) | passed:
        relative = sorted_v(spec, state, b) - sorted_v(spec, state, a)
        n, gap, u, overlaps, approaches = meeting(
            spec, state, a, b, x, d, relative, reach, ti.cast(passed, ti.i32)
        )
        if overlaps + approaches > 0:
            w, other_w = sorted_w(spec, state, a), sorted_w(spec, state, b)
            part = 1.0 / (w + other_w)
            dx, dv = 0.0 * n, 0.0 * n
            if overlaps > 0:
                dx += (part * gap) * n
                left[OVERLAP] = -1.0 * gap / reach
            if approaches > 0:
                change, taken = impulse(spec, state, a, b, n, relative, u)
                dt = state.dt[None]
                dx += (-1.0 * part * ti.static(state.position_weight) * dt) * taken
                dv += (-1.0 * part) * change
                left[APPROACH] = -1.0 * u * dt / reach
            if looks == 0:
                _push(spec, state, a, w, dx, dv, sweep)
                _push(spec, state, b, -1.0 * other_w, dx, dv, sweep)
    return left


@ti.func
def _push(spec: ti.template(), state: ti.template(), at, w, dx, dv, sweep):
    if w != 0.0:
        for axis in ti.static(range(spec.dim)):
            state.sorted[at, axis] = state.sorted[at, axis] + w * dx[axis]
            column = ti.static(spec.dim + 1 + axis)
            state.sorted[at, column] = state.sorted[at, column] + w * dv[axis]
        state.changed[at] = sweep + 1


@ti.func
def _keep_out(spec: ti.template(), state: ti.template(), at):
    """Put a particle that this sweep pushed into an obstacle onto that."""
    if state.changed[at] == state.pair_iteration[None] + 1:
        x = sorted_x(spec, state, at)
        if not is_free(spec, state, slot_of(spec, state, state.sorted_index[at]), x):
            x, v = out_of_obstacles(spec, state, at, x, sorted_v(spec, state, at))
            for axis in ti.static(range(spec.dim)):
                state.sorted[at, axis] = x[axis]
                state.sorted[at, ti.static(spec.dim + 1 + axis)] = v[axis]
