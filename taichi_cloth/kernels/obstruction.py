"""Obstacles: particles neither enter them nor slide along them for nothing.

From a step's free end (x, v) a particle that has entered an obstacle is put onto its surface. The
velocity relative to the surface loses what points into it, and friction takes from what is left at
most the coefficient times that, at most all of it (Coulomb, 1785). The position gets the method's
weight times dt of what friction changes (`settling.py`), so on a slope it is where the method has
it under a constant acceleration, and what sticks stays, to the bit where nothing moves. What sticks
to an obstacle that moves goes with it as a part of it, so it does not creep there either.

Who meets an obstacle with a restitution bounces off where the step meets the surface, and goes on
for the rest of the step; a bounce that ends within the step is rest. Where a step goes farther than
the obstacle is thick, its whole path is looked at, as the obstacle sees it, by steps of the
distance to it (sphere tracing; Hart, The Visual Computer 12, 1996).

Where all obstacles are at rest, a particle that touches none keeps a ball around it that is free of
them: while its steps stay within it nothing is asked, as nothing would change, to the bit.

Distances count from the surface of the particle. Walls are obstacles too where they are `resting`.
"""

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.compensated import joined, owed_at, put_at
from taichi_cloth.kernels.contact import has_impulses, turned_by_walls, velocity_jump
from taichi_cloth.kernels.loops import each_pack_moving, raise_to
from taichi_cloth.kernels.obstacles import load
from taichi_cloth.kernels.obstacles.contract import BOUND, FAR, FRICTION, RESTITUTION, SCALE, THIN
from taichi_cloth.kernels.packs import (
    epsilon,
    read,
    slot_number,
    slot_value,
    vector_of_lane,
)
from taichi_cloth.kernels.poses import (
    END,
    START,
    centre_of,
    place_obstacles,
    signed_distance,
    to_local,
    to_world,
    velocity_at,
)
from taichi_cloth.kernels.watchdog import note_fault

ROUNDS = 8  # in which a particle that several obstacles touch finds where all let it be
BOUND_MARGIN = 1.001  # of what obstacles are within, so that no rounding makes them larger
ROUNDINGS = 8.0  # of the lengths in a distance, that count as touching
MOST_LOOKS = 128  # along the path of a step that is not longer than as many thicknesses
MOST_OF_THIN = 4096  # along any
LEAST_STEP = 0.25  # of a look, in parts of how thin the obstacle is
NEAR = 0.01  # distance, in the same parts, at which a path has met the obstacle
FAR_PUSH = 0.4  # of its radius: by less no obstacle pushes a face so deep that it is counted
# Of a free ball: of its radius, of the particle's radius, and roundings, that it is smaller.
BALL_MARGIN, BALL_ROUNDINGS = 1e-3, 4.0


def needed(spec):
    """True if a specialization has obstacles."""
    return bool(spec.obstacles)


@ti.func
def settle(spec: ti.template(), state: ti.template(), t):
    """Take all particles out of all obstacles, with what contact and friction leave of v."""
    if ti.static(spec.moving):
        place_obstacles(spec, state, t)
    each_pack_moving(spec, state, t, _settle_pack)


@ti.func
def _settle_pack(spec: ti.template(), state: ti.template(), i):
    for lane in range(spec.lanes):
        slot = i * spec.lanes + lane
        if slot_number(spec, state.w, slot) > 0.0:
            x, begun = slot_value(spec, state.x, slot), slot_value(spec, state.begun_x, slot)
            if not (is_free(spec, state, slot, x) and is_free(spec, state, slot, begun)):
                _settle_particle(spec, state, slot)


def keeps_balls(spec):
    """True if particles keep balls that are free of obstacles."""
    return bool(spec.obstacles) and not spec.moving


@ti.func
def is_free(spec: ti.template(), state: ti.template(), slot, x):
    """True if x is in the ball in which the particle at a slot touches nothing."""
    free = False
    if ti.static(keeps_balls(spec)):
        d2 = ti.cast(0.0, state.real)
        for axis in ti.static(range(spec.dim)):
            d = x[axis] - state.free_ball[slot, axis]
            d2 += d * d
        free = d2 < state.free_ball[slot, ti.static(spec.dim)]
    return free


@ti.func
def _keep_ball(spec: ti.template(), state: ti.template(), slot, x, radius):
    """Keep the ball around x that is free of obstacles, if there is any."""
    clear = FAR + 0.0 * radius
    for o in range(state.n_obstacles[None]):
        d = x - centre_of(spec, state, o, END)
        gap = ti.sqrt(d.dot(d)) - BOUND_MARGIN * state.obstacle_numbers[o, BOUND]
        for s in ti.static(range(len(spec.obstacles))):
            if ti.static(load(spec.obstacles[s]).convex):
                if state.obstacle_shape[o] == s:
                    local = to_local(spec, state, o, END, d)
                    gap, _ = ti.static(load(spec.obstacles[s]).distance)(spec, state, o, local)
        gap -= (1.0 + BALL_MARGIN) * radius + BALL_ROUNDINGS * slack_of(spec, state, o, x, radius)
        if 2.0 * gap > state.obstacle_numbers[o, THIN]:  # a step within may be followed on its path
            gap -= 2.0 * NEAR * state.obstacle_numbers[o, THIN]
        clear = ti.min(clear, (1.0 - BALL_MARGIN) * gap)
    for axis in ti.static(range(spec.dim)):
        state.free_ball[slot, axis] = x[axis]
    state.free_ball[slot, ti.static(spec.dim)] = clear * ti.max(clear, 0.0)


@ti.func
def slack_of(spec: ti.template(), state: ti.template(), o, x, radius):
    """The rounding in the distance from obstacle o of a ball of that radius around x."""
    size = size_of(x) + size_of(centre_of(spec, state, o, END))
    return (
        ROUNDINGS * ti.static(epsilon(state)) * (size + radius + state.obstacle_numbers[o, SCALE])
    )


def _are_convex(shapes):
    """True if what was put onto the surface of any of these shapes is nowhere past it."""
    return all(load(shape).convex for shape in shapes)


@ti.func
def _settle_particle(spec: ti.template(), state: ti.template(), slot):
    """Run all obstacles on the particle at a slot, until none changes it."""
    x, v = slot_value(spec, state.x, slot), slot_value(spec, state.v, slot)
    x_low, v_low = owed_at(spec, state, slot)
    radius = slot_number(spec, state.radius, slot)
    touched, changing, steady, last = 0, 1, 1, -1
    came_v = 1.0 * v
    for _ in range(ROUNDS):
        if changing == 1:
            changing = 0
            for o in range(state.n_obstacles[None]):
                # The one that it was just put onto has nothing to say before another one has.
                if o != last and is_near(spec, state, o, slot, x, radius):
                    new_x, new_x_low, new_v, new_v_low, changed, steady = obstructed(
                        spec, state, o, slot, x, x_low, v, v_low, radius, steady, came_v, touched
                    )
                    if changed == 1:
                        x, x_low, v, v_low = new_x, new_x_low, new_v, new_v_low
                        changing, touched = 1, 1
                        if ti.static(_are_convex(spec.obstacles)):
                            last = o
    if touched == 1:
        if ti.static(spec.faces):
            if laws.length(x - slot_value(spec, state.x, slot)) > FAR_PUSH * radius:
                raise_to(state, state.face_left[None], 1.0)
        put_at(spec, state, slot, x, x_low, v, v_low)
        note_fault(spec, state, slot)
    elif ti.static(keeps_balls(spec)):
        _keep_ball(spec, state, slot, x, radius)


@ti.func
def given_before(spec: ti.template(), state: ti.template(), slot):
    """The change by walls, pairs and faces of a velocity, before obstacles, (dim,).

    It is asked for where something bounces, and not of each particle, for which lanes take long.
    """
    given = kick_of(spec, state, slot)
    if ti.static(has_impulses(spec)):
        jump = jump_of(spec, state, slot)
        if ti.static(spec.faces):  # which may have pushed it off the wall that holds it
            if given.dot(given) > 0.0:
                jump = slot_value(spec, state.face_jump, slot)
        given += jump
    return given


@ti.func
def kick_of(spec: ti.template(), state: ti.template(), slot):
    """The change by faces of a particle's velocity in the step so far, (dim,)."""
    kick = 0.0 * slot_value(spec, state.begun_v, slot)
    if ti.static(spec.faces):
        if state.face_finds[None] > 1:  # they have met something in this step
            kick += slot_value(spec, state.face_kick, slot)
    return kick


@ti.func
def jump_of(spec: ti.template(), state: ti.template(), slot):
    """The change by walls and pairs of a particle's velocity in the step, (dim,)."""
    pack = slot // spec.lanes
    x, v = read(spec, state.begun_x, pack), read(spec, state.begun_v, pack)
    jump = _of_slot(spec, velocity_jump(spec, state, pack, x, v), slot)
    if ti.static(len(spec.walls) > 0):
        jump = turned_by_walls(
            spec,
            state,
            slot,
            slot_value(spec, state.begun_x, slot),
            slot_value(spec, state.begun_v, slot),
            slot_value(spec, state.x, slot),
            slot_value(spec, state.v, slot) - kick_of(spec, state, slot),
            jump,
        )
    return jump


@ti.func
def _of_slot(spec: ti.template(), value: ti.template(), slot):
    """The vector (dim,) at a slot out of that of its pack."""
    if ti.static(spec.lanes == 1):
        return value
    else:
        return vector_of_lane(value, slot % spec.lanes)


@ti.func
def is_near(spec: ti.template(), state: ti.template(), o, slot, x, radius):
    """True if a particle may have touched obstacle o in this step: most have not."""
    d, way = x - centre_of(spec, state, o, END), x - slot_value(spec, state.begun_x, slot)
    if ti.static(spec.moving):
        way += centre_of(spec, state, o, START) - centre_of(spec, state, o, END)
    reach = state.obstacle_numbers[o, BOUND] + radius
    return ti.sqrt(d.dot(d)) <= BOUND_MARGIN * reach + ti.sqrt(way.dot(way))


@ti.func
def obstructed(
    spec: ti.template(),
    state: ti.template(),
    o,
    slot,
    x,
    x_low,
    v,
    v_low,
    radius,
    steady,
    came_v,
    touched,
):
    """A particle's end of a step after obstacle o: x, x_low, v, v_low.

    Then come 1 if it changed them, and `steady`: 1 while all that the particle has touched in this
    step is at rest. slot: where the particle is; x_low, v_low: what is to be added to x and v
    (`compensated.py`). came_v: the velocity before any obstacle; touched: whether others have
    changed it since.
    """
    new_x, new_x_low, new_v, new_v_low, changed, still = x, x_low, v, v_low, 0, steady
    began = slot_value(spec, state.begun_x, slot)
    centre, dt = centre_of(spec, state, o, END), state.dt[None]
    d = x - centre + x_low
    slack = slack_of(spec, state, o, x, radius)
    gap, n, gap_before, part = meet(spec, state, o, slot, d, radius, slack)
    surface_v = velocity_at(spec, state, o, d - gap * n)  # where the particle's middle will be
    relative = v - surface_v + v_low
    u = relative.dot(n)
    touches, push = gap <= slack and (gap < 0.0 or u < 0.0), ti.max(-1.0 * gap, 0.0)
    if ti.static(state.position_weight == 0.0):
        # Its positions follow the velocity that a step begins with, so that what lies on a round
        # surface leaves it along the tangent; its new velocity shows whether it stays.
        if u < 0.0 and gap > slack and gap_before <= slack and gap + dt * u <= slack:
            touches, push = True, -1.0 * gap
    if touches:
        weight = ti.static(state.position_weight) * dt
        new_u = ti.max(u, 0.0)
        e = state.obstacle_numbers[o, RESTITUTION]
        if e < 0.0:
            e = slot_number(spec, state.restitution, slot)
        meets = gap_before > slack
        if meets:
            u_before = (slot_value(spec, state.begun_v, slot) - surface_v).dot(n)
            if u < 0.0:
                weight = weight_of_meeting(weight, u_before, u, part, dt)
            if e > 0.0:
                # What other contacts gave is no acceleration: it came with that.
                if touched == 1:
                    u_before += (v - came_v).dot(n)
                u_before += given_before(spec, state, slot).dot(n)
                new_u, lift = bounce(u_before, u, part, e, state.position_weight, dt)
                push += lift
        slide = relative - u * n
        taken, stops = laws.friction(
            slide, ti.max(new_u - u, 0.0), state.obstacle_numbers[o, FRICTION]
        )
        if surface_v.dot(surface_v) > 0.0:
            still = 0
        new_x, new_x_low = joined(spec, state, x, x_low, push * n + weight * taken)
        new_v, new_v_low = joined(spec, state, v, v_low, (new_u - u) * n + taken)
        if stops:
            new_v, new_v_low = surface_v + new_u * n, 0.0 * v_low
            begun_v = slot_value(spec, state.begun_v, slot)
            lay = steady == 1 and new_u == 0.0 and not meets and gap_before > -1.0 * slack
            if lay and still == 1 and begun_v.dot(begun_v) == 0.0:
                new_x = began  # to the bit, however often rounding would have moved it
                if ti.static(spec.compensated):
                    new_x_low = slot_value(spec, state.begun_x_low, slot)
            if ti.static(spec.moving):
                way, goes_along = along(spec, state, o, slot, began, begun_v, slack)
                if lay and still == 0 and goes_along:
                    began_low = 0.0 * began
                    if ti.static(spec.compensated):
                        began_low = slot_value(spec, state.begun_x_low, slot)
                    way += (-1.0 * gap_before) * n
                    new_x, new_x_low = joined(spec, state, began, began_low, way)
                # Where it ends, so that it begins the next step as a part of the obstacle.
                new_v = velocity_at(spec, state, o, new_x - centre + new_x_low) + new_u * n
        changed = 1
    return new_x, new_x_low, new_v, new_v_low, changed, still


@ti.func
def along(spec: ti.template(), state: ti.template(), o, slot, began, begun_v, slack):
    """The place where obstacle o takes the step begun at `began` as a part of it, from there; and
    whether that had the obstacle's velocity, to rounding."""
    d = began - centre_of(spec, state, o, START)
    if ti.static(spec.compensated):
        d += slot_value(spec, state.begun_x_low, slot)
    turned = to_world(spec, state, o, END, to_local(spec, state, o, START, d))
    way = centre_of(spec, state, o, END) - centre_of(spec, state, o, START) + turned - d
    off = begun_v - velocity_at(spec, state, o, d)
    return way, size_of(off) * state.dt[None] <= slack


@ti.func
def size_of(a):
    """The sum of the sizes of a vector's components."""
    total = ti.abs(a[0])
    for axis in ti.static(range(1, a.n)):
        total += ti.abs(a[axis])
    return total


@ti.func
def weight_of_meeting(weight, u_before, u, part, dt):
    """The time for which a change of velocity moves what meets a surface in its step.

    What it came with is lost where it meets the surface, the rest through the step.
    weight: that time of a change through the step; u_before, u, part: see `bounce`; u is negative.
    """
    came = ti.min(ti.max(u_before / u, 0.0), 1.0)
    return weight + came * ((1.0 - part) * dt - weight)


@ti.func
def bounce(u_before, u, part, e, position_weight: ti.template(), dt):
    """The normal velocity after a bounce in a step, and how far it leads from the surface.

    u_before, u: normal velocities at the step's start and at its free end; part: of the step, after
    which the surface is met. The velocity it is met with is between both, so that energy does not
    grow: under a constant acceleration it is at most that of the fall. It is the first of both for
    methods whose positions follow that one.
    """
    met = u_before
    if ti.static(position_weight > 0.0):
        met = u_before + part * (u - u_before)
    met = ti.min(met, 0.0)
    rest = (1.0 - part) * (u - u_before)
    new_u = rest - e * met
    lift = (1.0 - part) * dt * (0.5 * rest - e * met)
    if new_u <= 0.0 or lift < 0.0:
        new_u, lift = ti.max(u, 0.0), 0.0 * lift
    return ti.max(new_u, u), lift  # a surface only pushes: what a wall has turned away leaves so


@ti.func
def meet(spec: ti.template(), state: ti.template(), o, slot, d, radius, slack):
    """The meeting of a particle's step with obstacle o: (gap, n, gap_before, part).

    d: where it ends, from the obstacle's centre. gap: how far the particle's surface then is from
    the obstacle's, negative: past it; n: the normal there, of the world. Where the step is longer
    than the obstacle is thick, both are those of the plane that touches it where the path meets it.
    gap_before: the gap at the step's start; part: of the step, after which the surface is met.
    """
    began = slot_value(spec, state.begun_x, slot) - centre_of(spec, state, o, START)
    if ti.static(spec.compensated):
        began += slot_value(spec, state.begun_x_low, slot)
    start = to_local(spec, state, o, START, began)
    way, thin = to_local(spec, state, o, END, d) - start, state.obstacle_numbers[o, THIN]
    length = ti.sqrt(way.dot(way))
    fast = length > thin
    n, gap, gap_before, met = 0.0 * d, 0.0 * radius, 0.0 * radius, -1.0 + 0.0 * radius
    # The first look is at the end, the second at the start: one loop, so that the laws of all
    # shapes are compiled once.
    looks, at, going = 0, 1.0 + 0.0 * radius, True
    while going:
        here_d, here_n = signed_distance(spec, state, o, start + at * way)
        here = here_d - radius
        if looks == 0:
            gap, n = here, here_n
        if looks <= 1:
            gap_before = here
        near = slack
        if ti.static(state.position_weight == 0.0):
            near += length  # see `obstructed`
        found, past, meets_at, at, going = judge_look(
            looks, at, here, here_n.dot(way), near, slack, slack, thin, fast, length, MOST_LOOKS
        )
        if found:
            gap, n, met = past, here_n, meets_at
        looks += 1
    part = part_before(met, gap, gap_before)
    return gap, to_world(spec, state, o, END, n), gap_before, part


@ti.func
def judge_look(
    looks, at, here, inward, near, slack, inside, thin, fast, length, most_looks: ti.template()
):
    """The result of a look at an obstacle on the path of a step, and where to look next.

    The first is at the step's end, the second at its start; further ones follow its path where it
    is longer than the obstacle is thick (`fast`), until one meets the surface from outside.
    looks: how many there were before; at: the part of the step at which this one is; here: the gap
    there; inward: how fast the gap grows along the step; near: the gap at its end up to which its
    start is looked at; slack: what is rounding; inside: how deep what starts is left as it ends;
    thin: the length below which a path may pass through; length: of the step.

    Returns whether the path meets the surface, the gap at the step's end to the plane that touches
    it there, after which part of the step, where to look next, and whether to look again.
    """
    found, past, meets_at, next_at, going = False, here, at, 0.0 * at, True
    if looks == 0:
        going = here <= near or fast
    else:
        if not fast or (looks == 1 and here < -1.0 * inside):
            going = False
        elif here <= NEAR * thin + slack and inward < 0.0:
            past = here + (1.0 - at) * inward
            if past < 0.0:
                found, meets_at, going = True, at - here / inward, False
        least = ti.max(LEAST_STEP * thin, ti.min(length / most_looks, thin))
        next_at = at + ti.max(here, least) / length
        most = ti.min(ti.max(length / thin, most_looks), MOST_OF_THIN)
        if next_at >= 1.0 or looks > most:
            going = False
    return found, past, meets_at, next_at, going


@ti.func
def part_before(met, gap, gap_before):
    """The part of a step after which a surface is met, from the gaps at its end and its start.

    met: that part as its path has it, where this was looked at; else negative.
    """
    part = 1.0 + 0.0 * met
    if met >= 0.0:
        part = ti.min(met, 1.0)
    elif gap < 0.0 and gap_before > 0.0:
        part = gap_before / (gap_before - gap)
    return part
