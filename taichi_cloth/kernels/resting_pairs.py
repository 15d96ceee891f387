"""Pairs of particles that rest on each other: at a step's end none overlaps or approaches another.

From a step's free end the positions of pairs that overlap are moved apart and the velocities of
pairs that touch are changed until none closes in, with friction and restitution (`pair_laws.py`).
Pairs of cloths do so one after the other (`swept_pairs.py`), where loops need no launches of their
own. All other pairs act at once, by mass splitting (Tonge, Benevolenski, Voroshilov, "Mass
splitting for jitter-free parallel rigid body simulation", ACM Trans. Graphics 31, 2012): a particle
in m contacts takes part in each with 1/m of its mass, and goes on with the mean of what comes of
its parts. Each pair conserves momentum and loses energy, and a mean of velocities has at most their
mean energy: so does the whole, however many iterations are done. Positions move in proportion to
inverse masses, so the centre of mass of a free pair stays, and with it its height.

Obstacles and walls hold in every iteration: whoever is pushed into one is put onto it.
Iterations end when the deepest overlap and the fastest approach are small; after MOST_ITERATIONS
the step is counted as unsettled, where more than a hundredth of a pair's reach overlaps.

at, other in this file: places in the order by cells; side: the half of state.sorted that is read.
"""

import functools

import taichi as ti

from taichi_cloth.kernels.collision_grid import slot_of, sorted_w
from taichi_cloth.kernels.compensated import joined, owed_at, put_at
from taichi_cloth.kernels.kept_pairs import has_passed
from taichi_cloth.kernels.loops import each, each_pack_moving, leave, raise_to
from taichi_cloth.kernels.near_pairs import (
    finding,
    place_of,
    reach_of,
    sizes,
    sum_over_pairs,
)
from taichi_cloth.kernels.obstruction import is_free
from taichi_cloth.kernels.packs import slot_value
from taichi_cloth.kernels.pair_laws import (
    APPROACH,
    OVERLAP,
    clear_residual,
    impulse,
    may_touch,
    meeting,
    out_of_obstacles,
)
from taichi_cloth.kernels.swept_pairs import is_swept, sweep_pairs
from taichi_cloth.kernels.watchdog import note_fault

MOST_ITERATIONS = 96  # of a step; a column of ten needs about as many
LAUNCHED = 32  # where iterations are launches, which do not look at what came of one
SETTLED = 2e-4  # of a pair's reach: overlap, and approach in a step, at which iterations end
UNSETTLED = 1e-2  # of a pair's reach: an overlap that is counted
# The same where cloths have a thickness: their spheres are a quarter wider than they must be.
CLOTH_SWEEPS, CLOTH_SETTLED, CLOTH_UNSETTLED = 12, 2e-2, 0.1
# Bits of state.touch; above them the pair's place among those near its particle.
OVERLAPS, APPROACHES, TOUCH_BITS = 1, 2, 2


def unsettled(spec):
    """The overlap, in parts of a pair's reach, beyond which a step is counted."""
    return CLOTH_UNSETTLED if spec.thick else UNSETTLED


def needed(spec):
    """True if pairs rest on each other in a specialization."""
    return spec.resting


def acts(spec):
    """A function that takes all pairs apart, with what contact and friction leave of velocities, as
    ti.funcs(spec, state, t).

    With one launch per step it only ends what `find_pairs` and `iterate` began, in launches of
    their own: a launch cannot repeat loops that Taichi makes parallel.
    """
    if spec.one_launch_per_step:
        return [_end]
    return [*finding(spec), _sweep if is_swept(spec) else _iterate_all, _end]


@ti.func
def _sweep(spec: ti.template(), state: ti.template(), t):
    sweep_pairs(spec, state, t, ti.static(CLOTH_SWEEPS), ti.static(CLOTH_SETTLED))


@ti.func
def _iterate_all(spec: ti.template(), state: ti.template(), t):
    done, going = 0, 1
    while going == 1:
        iterate(spec, state, t, done)
        worst = ti.max(
            state.pair_residual[done % 2, OVERLAP], state.pair_residual[done % 2, APPROACH]
        )
        done += 1
        if worst <= ti.static(SETTLED) or done == ti.static(MOST_ITERATIONS):
            going = 0


@ti.func
def _end(spec: ti.template(), state: ti.template(), t):
    """Store what came of it."""
    if ti.static(is_swept(spec)):
        each(spec, state, t, state.n[None], _store)
        each(spec, state, t, 1, _count_round)
    else:
        _each_active(spec, state, t, _store)
        each(spec, state, t, 1, _judge)
    if ti.static(spec.halo > 0):
        each_pack_moving(spec, state, t, leave)


@ti.func
def _count_round(spec: ti.template(), state: ti.template(), i):
    """Begin another round of sweeps where these pushed somebody far, or judge what they left."""
    if state.pushed_far[None] == 1:
        state.pair_round[None] = state.pair_round[None] + 1
    else:
        state.pair_round[None] = 0
        _judge(spec, state, i)


@ti.func
def iterate(spec: ti.template(), state: ti.template(), t, done):
    """Do an iteration, after `done` of them; state.pair_residual[done % 2] says what was
    left before it."""
    if ti.static(spec.one_launch_per_step):
        for _ in range(1):
            _number(spec, state, done)
    else:  # every thread writes the same, and none is still in the iteration before
        state.pair_iteration[None] = done
    _each_active(spec, state, t, _count_touching)
    each(spec, state, t, 1, clear_residual)
    _each_active(spec, state, t, _move)


@ti.func
def _each_active(spec: ti.template(), state: ti.template(), t, body: ti.template()):
    """Run body(spec, state, at) for every place, or for those that others are near."""
    if ti.static(spec.thick):
        each(spec, state, t, state.n_active[None], ti.static(_at_active(body)))
    else:
        each(spec, state, t, state.n[None], body)


@functools.cache
def _at_active(body):
    @ti.func
    def active(spec: ti.template(), state: ti.template(), k):
        body(spec, state, state.active[k])

    return active


@ti.func
def _number(spec: ti.template(), state: ti.template(), done):
    state.pair_iteration[None] = done


@ti.func
def _judge(spec: ti.template(), state: ti.template(), i):
    """Count the step if some pair still overlaps much."""
    overlap, full = state.pair_residual[state.pair_iteration[None] % 2, OVERLAP], 0
    if ti.static(spec.thick):
        full = state.overfull[None]
        state.overfull[None] = 0
    if (overlap > ti.static(unsettled(spec))) | (full == 1):
        state.unsettled[None] = state.unsettled[None] + 1


# --- an iteration ----------------------------------------------------------------------------


@ti.func
def _value(spec: ti.template(), state: ti.template(), at, column: ti.template()):
    """The vector (dim,) that begins in a column, of the half from which this iteration reads."""
    row = at + (state.pair_iteration[None] & 1) * ti.static(state.sorted_half)
    return ti.Vector([state.sorted[row, column + axis] for axis in range(spec.dim)])


@ti.func
def _between(spec: ti.template(), state: ti.template(), at, pair, x, v):
    """A pair of the particle at x with v: normal towards the other one, gap, reach,
    relative velocity, its normal part, whether
    it overlaps and whether it approaches, as 1 or 0."""
    other = place_of(spec, state, pair)
    d = _value(spec, state, other, 0) - x
    reach = reach_of(spec, state, at, pair)
    passed = 0
    if ti.static(spec.thick):
        passed = ti.cast(has_passed(state, pair), ti.i32)
    relative = _velocity(spec, state, other) - v
    n, gap, u, overlaps, approaches = meeting(spec, state, at, other, x, d, relative, reach, passed)
    return n, gap, reach, relative, u, overlaps, approaches


@ti.func
def _velocity(spec: ti.template(), state: ti.template(), at):
    return _value(spec, state, at, ti.static(spec.dim + 1))


@ti.func
def _count_touching(spec: ti.template(), state: ti.template(), at):
    """Count the pairs of a particle that overlap, and those that touch and approach."""
    if _is_visited(spec, state, at):
        counts = ti.Vector.zero(state.real, ti.static(sizes(spec)))
        if ti.static(spec.thick):
            counts = _list_touching(spec, state, at)
        else:
            counts = sum_over_pairs(spec, state, at, _touching)
        for kind in ti.static((OVERLAP, APPROACH)):
            state.touching[at, kind] = counts[kind]


@ti.func
def _is_visited(spec: ti.template(), state: ti.template(), at):
    """True if a particle or one near it was changed in the last iteration: others stay."""
    if ti.static(spec.thick):
        return state.visited[at] >= state.pair_iteration[None]
    else:
        return True


@ti.func
def _touching(spec: ti.template(), state: ti.template(), at, pair):
    x, v = _value(spec, state, at, 0), _velocity(spec, state, at)
    _, _, _, _, _, overlaps, approaches = _between(spec, state, at, pair, x, v)
    counts = ti.Vector.zero(state.real, ti.static(sizes(spec)))
    counts[OVERLAP], counts[APPROACH] = float(overlaps), float(approaches)
    return counts


@ti.func
def _list_touching(spec: ti.template(), state: ti.template(), at):
    """List the pairs of a particle of cloth that touch, with normals and gaps, and count them."""
    counts = ti.Vector.zero(state.real, ti.static(sizes(spec)))
    start, listed = state.near_start[at], 0
    x, v = _value(spec, state, at, 0), _velocity(spec, state, at)
    for pair in range(start, start + state.near_count[at]):
        if _may_touch(spec, state, at, pair, x):
            n, gap, reach, relative, u, overlaps, approaches = _between(spec, state, at, pair, x, v)
            if overlaps + approaches > 0:
                code = ((pair - start) << TOUCH_BITS) + overlaps * OVERLAPS
                state.touch[start + listed] = code + approaches * APPROACHES
                for axis in ti.static(range(spec.dim)):
                    state.touch_normal[start + listed, axis] = n[axis]
                state.touch_normal[start + listed, ti.static(spec.dim)] = gap
                listed += 1
                counts[OVERLAP] += float(overlaps)
                counts[APPROACH] += float(approaches)
    state.touch_count[at] = listed
    return counts


@ti.func
def _may_touch(spec: ti.template(), state: ti.template(), at, pair, x):
    """True if a pair of cloth is near enough to be asked whether it touches; x: of `at`."""
    d = _value(spec, state, place_of(spec, state, pair), 0) - x
    reach = reach_of(spec, state, at, pair)
    return may_touch(spec, state, x, d, reach) | has_passed(state, pair)


@ti.func
def _move(spec: ti.template(), state: ti.template(), at):
    """Take a particle to the other half, with the mean of what its pairs do to its parts."""
    touches = state.touching[at, OVERLAP] + state.touching[at, APPROACH] > 0.0
    if ti.static(spec.thick):
        if _is_visited(spec, state, at):
            _take_to_other_half(spec, state, at, touches, touches)
        if touches:
            done = state.pair_iteration[None] + 1
            state.visited[at] = done
            start = state.near_start[at]
            for pair in range(start, start + state.near_count[at]):
                state.visited[place_of(spec, state, pair)] = done
    else:
        _take_to_other_half(spec, state, at, touches, True)


@ti.func
def _take_to_other_half(spec: ti.template(), state: ti.template(), at, touches, may_enter):
    """touches: whether any pair of it does; may_enter: an obstacle."""
    x, v = _value(spec, state, at, 0), _velocity(spec, state, at)
    if sorted_w(spec, state, at) > 0.0:
        if touches:
            change = ti.Vector.zero(state.real, ti.static(sizes(spec)))
            if ti.static(spec.thick):
                change = _change_by_touching(spec, state, at)
            else:
                change = sum_over_pairs(spec, state, at, _change)
            for axis in ti.static(range(spec.dim)):
                x[axis] += change[axis]
                v[axis] += change[ti.static(spec.dim + axis)]
        if ti.static(len(spec.obstacles) > 0):
            slot = slot_of(spec, state, state.sorted_index[at])
            if may_enter and not is_free(spec, state, slot, x):
                x, v = out_of_obstacles(spec, state, at, x, v)
    to = at + ((state.pair_iteration[None] + 1) & 1) * ti.static(state.sorted_half)
    for axis in ti.static(range(spec.dim)):
        state.sorted[to, axis], state.sorted[to, ti.static(spec.dim + 1 + axis)] = x[axis], v[axis]


@ti.func
def _change(spec: ti.template(), state: ti.template(), at, pair):
    """The change by a pair of position and velocity of the particle at `at`."""
    x, v = _value(spec, state, at, 0), _velocity(spec, state, at)
    n, gap, reach, relative, u, overlaps, approaches = _between(spec, state, at, pair, x, v)
    other = place_of(spec, state, pair)
    return _change_by(spec, state, at, other, n, gap, reach, relative, u, overlaps, approaches)


@ti.func
def _change_by_touching(spec: ti.template(), state: ti.template(), at):
    """The change by all listed pairs that touch of a particle of cloth."""
    change = ti.Vector.zero(state.real, ti.static(sizes(spec)))
    start, v = state.near_start[at], _velocity(spec, state, at)
    for k in range(start, start + state.touch_count[at]):
        code = state.touch[k]
        pair = start + (code >> TOUCH_BITS)
        other = place_of(spec, state, pair)
        n = ti.Vector([state.touch_normal[k, axis] for axis in range(spec.dim)])
        gap = state.touch_normal[k, ti.static(spec.dim)]
        relative = _velocity(spec, state, other) - v
        change += _change_by(
            spec,
            state,
            at,
            other,
            n,
            gap,
            reach_of(spec, state, at, pair),
            relative,
            relative.dot(n),
            code & OVERLAPS,
            code & APPROACHES,
        )
    return change


@ti.func
def _change_by(
    spec: ti.template(),
    state: ti.template(),
    at,
    other,
    n,
    gap,
    reach,
    relative,
    u,
    overlaps,
    approaches,
):
    """The change by a pair of the particle at `at`, by `_between`."""
    w, other_w, dt = sorted_w(spec, state, at), sorted_w(spec, state, other), state.dt[None]
    dx, dv = 0.0 * n, 0.0 * n
    if overlaps > 0:
        split = state.touching[at, OVERLAP] * w + state.touching[other, OVERLAP] * other_w
        dx += (gap * w / split) * n
        _note_residual(state, OVERLAP, -1.0 * gap / reach)
    if approaches > 0:
        split = state.touching[at, APPROACH] * w + state.touching[other, APPROACH] * other_w
        change, taken = impulse(spec, state, at, other, n, relative, u)
        part = -1.0 * w / split
        dx += (part * ti.static(state.position_weight) * dt) * taken
        dv += part * change
        _note_residual(state, APPROACH, -1.0 * u * dt / reach)
    found = ti.Vector.zero(state.real, ti.static(sizes(spec)))
    for axis in ti.static(range(spec.dim)):
        found[axis], found[ti.static(spec.dim + axis)] = dx[axis], dv[axis]
    return found


@ti.func
def _note_residual(state: ti.template(), kind: ti.template(), size):
    """Note how far a pair is from rest: the largest is kept, whatever the order."""
    raise_to(state, state.pair_residual[state.pair_iteration[None] & 1, kind], size)


@ti.func
def _store(spec: ti.template(), state: ti.template(), at):
    """Give a particle what all iterations changed."""
    slot = slot_of(spec, state, state.sorted_index[at])
    row, acted = at, 1
    if ti.static(is_swept(spec)):
        acted = ti.cast(state.changed[at] > 0, ti.i32)
    else:
        row += (state.pair_iteration[None] + 1) % 2 * ti.static(state.sorted_half)
    if acted:
        _store_row(spec, state, slot, row)


@ti.func
def _store_row(spec: ti.template(), state: ti.template(), slot, row):
    """Give a particle what is in a row of state.sorted."""
    x, v = slot_value(spec, state.x, slot), slot_value(spec, state.v, slot)
    dx, dv, moved = 0.0 * x, 0.0 * v, 0.0
    for axis in ti.static(range(spec.dim)):
        dx[axis] = state.sorted[row, axis] - x[axis]
        dv[axis] = state.sorted[row, ti.static(spec.dim + 1 + axis)] - v[axis]
        moved = ti.max(moved, ti.abs(dx[axis]), ti.abs(dv[axis]))
    if moved > 0.0:
        x_low, v_low = owed_at(spec, state, slot)
        x, x_low = joined(spec, state, x, x_low, dx)
        v, v_low = joined(spec, state, v, v_low, dv)
        put_at(spec, state, slot, x, x_low, v, v_low)
        note_fault(spec, state, slot)
