"""Contacts with walls and between particles, as changes of velocity, which all methods share.

All changes are computed from the state at the start of the step.
"""

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.collision_grid import (
    slot_of,
    sort_into_cells,
    sorted_radius,
    sorted_v,
    sorted_w,
    sorted_x,
    sum_over_near,
)
from taichi_cloth.kernels.compensated import forget_low
from taichi_cloth.kernels.loops import each
from taichi_cloth.kernels.packs import (
    component,
    epsilon,
    largest,
    read,
    set_slot_value,
    set_vector_of_lane,
    slot_number,
    vector_of_lane,
    where_positive,
    with_component,
    write,
    zeros,
)
from taichi_cloth.kernels.watchdog import note_lost


@ti.func
def _bounce_off(spec: ti.template(), state: ti.template(), at, other):
    """The velocity change of the particle at place `at` by a collision with that at `other`.

    A pair's restitution is the product of both.
    """
    d = sorted_x(spec, state, other) - sorted_x(spec, state, at)
    reach = sorted_radius(spec, state, at) + sorted_radius(spec, state, other)
    change = 0.0 * d
    if (d.dot(d) <= reach * reach) & (other != at):  # `and` would be two branches to guess
        a = slot_of(spec, state, state.sorted_index[at])
        b = slot_of(spec, state, state.sorted_index[other])
        change = laws.pair_bounce(
            d,
            sorted_v(spec, state, at),
            sorted_v(spec, state, other),
            sorted_w(spec, state, at),
            sorted_w(spec, state, other),
            reach,
            slot_number(spec, state.restitution, a) * slot_number(spec, state.restitution, b),
        )
    return change


@ti.func
def _bounce_particle(spec: ti.template(), state: ti.template(), at):
    """Compute state.jump, which is zero, of the particle at place `at` in the order by cells."""
    reach = sorted_radius(spec, state, at) + state.largest_radius[None]
    jump = sum_over_near(
        spec, state, at, sorted_x(spec, state, at), reach, ti.static(spec.dim), _bounce_off
    )
    most = ti.abs(jump[0])
    for axis in ti.static(range(1, spec.dim)):
        most = ti.max(most, ti.abs(jump[axis]))
    if most != 0.0:  # most are zero, and written one by one they would take long
        set_slot_value(spec, state.jump, slot_of(spec, state, state.sorted_index[at]), jump)


@ti.func
def _clear_jump(spec: ti.template(), state: ti.template(), i):
    set_slot_value(spec, state.jump, slot_of(spec, state, i), ti.Vector.zero(state.real, spec.dim))


@ti.func
def compute_pair_bounces(spec: ti.template(), state: ti.template(), t):
    """Compute state.jump, the change of each particle's velocity by all its collisions.

    All collisions see the state at the start of the step, as if they happened at once.
    """
    each(spec, state, t, state.n[None], _clear_jump)
    sort_into_cells(spec, state, t)
    # Cell by cell, so that successive ones read the same memory.
    each(spec, state, t, state.n[None], _bounce_particle)


def has_impulses(spec):
    """True if walls or pairs act by impulses at a step's start."""
    return bool(spec.walls or (spec.collisions and not spec.resting))


@ti.func
def compute_contacts(spec: ti.template(), state: ti.template(), t):
    """Compute the collisions of a step at its start; it does nothing in a scene without them."""
    if ti.static(spec.collisions and not spec.resting):
        compute_pair_bounces(spec, state, t)


@ti.func
def wall_gap(state: ti.template(), x, radius, axis: ti.template(), side: ti.template()):
    """The gaps from particles at x to a wall [length]; negative: past it.

    axis, side: the wall, of which side is 1 at state.high and -1 at state.low. All that ask use
    this one formula, because rounding decides where a particle rests on the floor.
    """
    bound = state.high[axis] if ti.static(side > 0) else state.low[axis]
    return float(side) * (bound - component(x, axis)) - radius


@ti.func
def place_on_wall(state: ti.template(), radius, axis: ti.template(), side: ti.template()):
    """The place along its axis where a wall holds a particle; one too wide is in the middle."""
    low, high = state.low[axis], state.high[axis]
    bound = high if ti.static(side > 0) else low
    return bound - float(side) * ti.min(radius, 0.5 * (high - low))


@ti.func
def _outside_inner_box(state: ti.template(), x, axis: ti.template(), side: ti.template()):
    """The distances of positions x past the face of the inner box before a wall [length]."""
    if ti.static(side > 0):
        return component(x, axis) - state.inner_high[axis]
    else:
        return state.inner_low[axis] - component(x, axis)


@ti.func
def near_wall(spec: ti.template(), state: ti.template(), x):
    """True if any of a pack's positions x is outside of the inner box.

    Whoever is inside is past no wall, whatever its radius: most packs ask no more than this, and it
    is all that walls cost them.
    """
    first = ti.static(spec.walls[0])
    outside = _outside_inner_box(state, x, first[0], first[1])
    for axis, side in ti.static(spec.walls[1:]):
        outside = ti.max(outside, _outside_inner_box(state, x, axis, side))
    return largest(spec, outside) > 0.0


@ti.func
def velocity_jump(spec: ti.template(), state: ti.template(), i, x, v):
    """The change of pack i's velocities by walls and pairs.

    x, v: the pack's positions and velocities at the start of the step. `compute_contacts` comes
    before.
    """
    jump = zeros(spec, state)
    if ti.static(len(spec.walls) > 0):
        if near_wall(spec, state, x):
            radius = read(spec, state.radius, i)
            restitution = read(spec, state.restitution, i)
            for axis, side in ti.static(spec.walls):
                gap, vn = wall_gap(state, x, radius, axis, side), float(side) * component(v, axis)
                bounce = float(side) * laws.wall_bounce(gap, vn, restitution)
                jump = with_component(jump, axis, component(jump, axis) + bounce)
            jump = where_positive(read(spec, state.w, i), jump, zeros(spec, state))
    if ti.static(spec.collisions and not spec.resting):
        jump += read(spec, state.jump, i)
    return jump


@ti.func
def store_held_by_walls(
    spec: ti.template(), state: ti.template(), i, x, v, new_x, new_v, store: ti.template()
):
    """Run store(spec, state, i, x, v) with new_x and new_v, and again as the walls let them be.

    x, v: positions and velocities at the start of the step; new_x, new_v: those at its end.
    Bounces are changes of velocity at a step's start (`velocity_jump`), which alone neither keep a
    particle from crossing a wall nor hold one that is pressed against it. So what `_held_by_wall`
    says comes after, for the walls that a particle of the pack is past. What they change is stored
    anew: joined with what most packs store, it would take their vectors through memory.
    """
    store(spec, state, i, new_x, new_v)
    if ti.static(len(spec.walls) > 0):
        if near_wall(spec, state, new_x):
            if ti.static(spec.lanes == 1):
                kept_x, kept_v = _held_by_walls(spec, state, i, x, v, new_x, new_v)
                if ti.static(spec.accounts_contacts):
                    _note_held(spec, state, i, kept_x - new_x, kept_v - new_v)
                store(spec, state, i, kept_x, kept_v)
            else:
                # Lane by lane, from copies: few packs come here, and what is compiled for all walls
                # would be as many times larger as a pack has lanes.
                begin_x, begin_v, kept_x, kept_v = 1.0 * x, 1.0 * v, 1.0 * new_x, 1.0 * new_v
                for lane in range(spec.lanes):
                    lane_x, lane_v = _held_by_walls(
                        spec,
                        state,
                        i * spec.lanes + lane,
                        vector_of_lane(begin_x, lane),
                        vector_of_lane(begin_v, lane),
                        vector_of_lane(kept_x, lane),
                        vector_of_lane(kept_v, lane),
                    )
                    set_vector_of_lane(kept_x, lane, lane_x)
                    set_vector_of_lane(kept_v, lane, lane_v)
                if ti.static(spec.accounts_contacts):
                    _note_held(spec, state, i, kept_x - new_x, kept_v - new_v)
                store(spec, state, i, kept_x, kept_v)


@ti.func
def turned_by_walls(spec: ti.template(), state: ti.template(), slot, x, v, new_x, new_v, jump):
    """The change of a particle's velocity by walls at both ends of a step, and by pairs, (dim,).

    x, v: where the step began; new_x, new_v: what walls left of its end; jump: `velocity_jump`.
    What came to a wall and was put onto it has all of its change along the normal from there.
    """
    turned, radius = 1.0 * jump, slot_number(spec, state.radius, slot)
    for axis, side in ti.static(spec.walls):
        if new_x[axis] == place_on_wall(state, radius, axis, side):
            if wall_gap(state, x, radius, axis, side) > 0.0:
                turned[axis] = new_v[axis] - v[axis]
    return turned


@ti.func
def _note_held(spec: ti.template(), state: ti.template(), i, dx, dv):
    """Note for the account of contacts what walls change of where pack i would end a step."""
    if state.accounting[None] == 1:
        write(spec, state.held_x, i, read(spec, state.held_x, i) + dx)
        write(spec, state.held_v, i, read(spec, state.held_v, i) + dv)


def _is_floor(spec, axis, side):
    """True if a wall is the floor of the original program, where y points down."""
    return spec.floor and (axis, side) == (1, 1)


@ti.func
def _rounding_of_gap(
    spec: ti.template(), state: ti.template(), radius, axis: ti.template(), side: ti.template()
):
    """The distance short of a wall that counts as past it, of what lies there.

    What was put onto a wall counts as past it, whatever rounding makes of its gap; on the floor it
    does not, in the original.
    """
    bound = state.high[axis] if ti.static(side > 0) else state.low[axis]
    parts = 0.0 if ti.static(_is_floor(spec, axis, side)) else ti.static(8.0 * epsilon(state))
    return parts * (ti.abs(bound) + radius)


@ti.func
def _held_by_walls(spec: ti.template(), state: ti.template(), slot, x, v, new_x, new_v):
    """Position and velocity as the walls let the particle at a slot have them: all (dim,).

    Parameters are those of `store_held_by_walls`.
    """
    kept_x, kept_v = new_x, new_v
    radius = slot_number(spec, state.radius, slot)
    for axis, side in ti.static(spec.walls):
        gap = wall_gap(state, kept_x, radius, axis, side)
        if gap - _rounding_of_gap(spec, state, radius, axis, side) < 0.0:
            kept_x, kept_v = _held_by_wall(
                spec, state, slot, x, v, kept_x, kept_v, radius, axis, side
            )
    return kept_x, kept_v


@ti.func
def _held_by_wall(
    spec: ti.template(),
    state: ti.template(),
    slot,
    x,
    v,
    new_x,
    new_v,
    radius,
    axis: ti.template(),
    side: ti.template(),
):
    """Position and velocity as one wall lets a particle have them, for `_held_by_walls`.

    A particle that is pressed against the wall is put onto it: one that hits it, that the bounce
    does not send back, and that was past it already a step before. So a bounce is left to itself in
    its first step, where the particle dips into the wall and comes back. The floor (where y points
    down) holds already then what still moves down, and leaves its velocity to gravity, as the
    original program did.
    A particle that a step takes farther out than its radius is put onto the wall, too, and leaves
    with restitution times the speed that it met it with; but one that crosses more than the world
    in the step is lost, and the watchdog names it. Not where particles collide: a crowd that is put
    into one place flies apart at any speed, by impulses that act at once, and is held.
    """
    low, high = state.low[axis], state.high[axis]
    gap = wall_gap(state, x, radius, axis, side)
    new_gap = wall_gap(state, new_x, radius, axis, side)
    vn, new_vn = float(side) * v[axis], float(side) * new_v[axis]
    no_nearer = vn >= 0.0 and new_vn >= 0.0 and vn + new_vn > 0.0
    slack = _rounding_of_gap(spec, state, radius, axis, side)
    if vn - (new_vn - vn) > 0.0:  # it comes with more than what a step gives to what lies there
        slack = 0.0 * slack
    pressed = no_nearer and slack - gap - state.dt[None] * vn > 0.0
    if ti.static(_is_floor(spec, axis, side)):
        pressed = pressed or (gap < 0.0 and vn > 0.0 and new_vn > 0.0)
    far = -1.0 * new_gap - 2.0 * radius > 0.0
    way = float(side) * (new_x[axis] - x[axis])
    if slot_number(spec, state.w, slot) == 0.0:
        pressed, far = False, False
    if ti.static(not spec.collisions):
        # A world narrower than the particle holds what crosses less than the particle.
        if far and way - ti.max(high - low, 2.0 * radius) > 0.0:
            note_lost(spec, state, slot)
            far = False
    kept_x, kept_v = new_x, new_v
    if pressed or far:
        kept_x[axis] = place_on_wall(state, radius, axis, side)
        if ti.static(spec.compensated):
            forget_low(spec, state.x_low, slot, axis)
        normal_v = new_vn
        if pressed and ti.static(not _is_floor(spec, axis, side)):
            normal_v = 0.0 * new_vn
        elif not pressed and new_vn > 0.0:
            # Of the step, after which it met the wall.
            part = gap / way if gap > 0.0 else 0.0 * gap
            met_with = vn + part * (new_vn - vn)
            normal_v = -1.0 * slot_number(spec, state.restitution, slot) * ti.max(met_with, 0.0)
        kept_v[axis] = float(side) * normal_v
        if ti.static(spec.compensated):
            if ti.static(not _is_floor(spec, axis, side)) or not pressed:
                forget_low(spec, state.v_low, slot, axis)
    return kept_x, kept_v
