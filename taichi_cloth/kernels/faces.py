"""Faces and edges of a cloth against obstacles that would pass between its particles.

Where an obstacle is sharper than twice the sides of a scene's triangles (`scene/solids.py`), each
triangle (in 2-D each of its sides, and everywhere the springs of ropes, and of a torn triangle the
sides that hold) is tested against it: the point of the triangle with the least distance is put onto
the obstacle's surface, with what contact, restitution and friction leave of that point's velocity
(`obstruction.py`). Its corners move by their shares of that point and their inverse masses
(Bridson, Fedkiw, Anderson, "Robust treatment of collisions, contact and friction for cloth
animation", 2002, 6.2). All triangles act at once, by mass splitting, as resting pairs do: a corner
in m contacts takes part in each with 1/m of its mass and goes on with the mean, so energy never
grows. This is repeated until all are outside. What bounces does so all at once, by the velocities
that all came with; a contact only pushes, but takes back what is too much once others have pushed
(Moreau, "Unilateral contact and dry friction in finite freedom dynamics", 1988): so there, too,
energy does not grow, but for what sweeps leave.

`face_distance.py` finds that point; who need not be looked at, `face_clearance.py` says. Where a
step is longer than the obstacle is sharp, its whole path is looked at, by steps of the distance, as
the obstacle sees it. What that leads to may be deep in the obstacle elsewhere: then its end counts.
"""

import taichi as ti

from taichi_cloth.kernels import face_clearance, laws, obstruction, rest
from taichi_cloth.kernels.compensated import joined, owed_at, put_at
from taichi_cloth.kernels.contact import has_impulses
from taichi_cloth.kernels.contact_fields import FACE_COLUMNS, FACE_CONTACTS
from taichi_cloth.kernels.face_distance import nearest, point_of
from taichi_cloth.kernels.loops import each, each_pack_moving, leave, raise_to
from taichi_cloth.kernels.obstacles.contract import (
    BOUND,
    FACES_TOO,
    FAR,
    FRICTION,
    RESTITUTION,
    ROUND,
    THIN,
)
from taichi_cloth.kernels.obstruction import (
    BOUND_MARGIN,
    bounce,
    judge_look,
    jump_of,
    kick_of,
    part_before,
    slack_of,
    weight_of_meeting,
)
from taichi_cloth.kernels.packs import set_slot_value, slot_number, slot_value
from taichi_cloth.kernels.phases import DONE, go_to, set_alone, stepping
from taichi_cloth.kernels.poses import (
    END,
    START,
    centre_of,
    place_obstacles,
    to_local,
    to_world,
    velocity_at,
)
from taichi_cloth.kernels.surfaces import holds, is_whole
from taichi_cloth.kernels.watchdog import note_fault

FINDS = 8  # searches for contacts in a step, at most
SWEEPS = 32  # at most, after each: what corners share is spread
AT_ONCE = 8  # sweeps in a launch, after which the host asks what is next
SETTLED = 1e-3  # of the room that a contact has: depth, and approach in a step, at which sweeps end
UNSETTLED = 0.5  # of that room: a depth that is counted
OPPOSED = -0.01  # cosine between normals up to which one would push back what another lets through
LEAST_ROOM = 0.02  # of the longest side: the room of what has no radius and is no thinner
LEAST_HALF = 0.01  # of the longest side: what is thinner is met as if it were that thick
MOST_LOOKS = 64  # along the path of a step

# Columns of state.face: what was found for a triangle, then what it does to its corners.
# OFFSET: how far along the normal faces are to move its point in the step; TARGET: velocity there;
# WEIGHT: of what friction changes, in the position [time]; ROOM: radius and roundness [length];
# GIVEN: the impulse along the normal so far, of what bounces. Which of a triangle's rows have a
# contact, the bits of state.face_hits say.
OFFSET, TARGET, MU, WEIGHT, ROOM, GIVEN = range(6)
SHARE, NORMAL, SURFACE_V, DX, DV = range(6, FACE_COLUMNS, 3)

WHOLE = 0  # piece of a triangle that is all of it; 1 to 3 are its sides, in their order


def needed(spec):
    """True if a specialization has triangles or edges with sharp obstacles in their way."""
    return bool(spec.obstacles) and spec.faces


# Phases (`phases.py`): contacts are searched for, counted, swept until they are at rest, and
# searched for again. Where sweeps were given up, or an obstacle then took a particle far, so that
# the faces at it went along, one more search only judges what is left.
BEGIN, FIND, COUNT, SWEEP, LEAVE = range(5)


@ti.func
def _begin(spec: ti.template(), state: ti.template(), t):
    """Phase BEGIN: place what moves."""
    if ti.static(spec.moving):
        place_obstacles(spec, state, t)
    set_alone(spec, state.face_finds, t, 0)
    first = FIND
    if ti.static(rest.needed(spec)):
        if rest.is_at_rest(state):
            first = DONE
    go_to(spec, state, t, first)


@ti.func
def _find(spec: ti.template(), state: ti.template(), t):
    """Phase FIND: find all contacts; state.face_left says whether there is any."""
    each(spec, state, t, 1, _begin_find)
    face_clearance.note_ways(spec, state, t)
    each(spec, state, t, state.elements.n_triangles[None], _look)
    each(spec, state, t, 1, _end_find)


@ti.func
def _begin_find(spec: ti.template(), state: ti.template(), i):
    state.face_finds[None] += 1
    state.face_left[None] = 0.0
    state.face_deep[None] = 0.0


@ti.func
def _end_find(spec: ti.template(), state: ti.template(), i):
    state.phase[None] = ti.select(state.face_left[None] > 0.0, COUNT, LEAVE)
    if state.face_finds[None] > FINDS:
        state.face_finds[None] -= FINDS + 1
        _judge(state)


@ti.func
def _count(spec: ti.template(), state: ti.template(), t):
    """Phase COUNT: count the contacts of each particle."""
    each(spec, state, t, state.elements.n_rows[None], _count_of)
    each(spec, state, t, 1, _begin_sweeps)


@ti.func
def _begin_sweeps(spec: ti.template(), state: ti.template(), i):
    state.face_sweeps[None] = 0
    state.phase[None] = SWEEP


@ti.func
def _sweep(spec: ti.template(), state: ti.template(), t):
    """Phase SWEEP: do to all corners what their contacts do; state.face_left: the worst of them."""
    for _ in ti.static(range(AT_ONCE if spec.one_launch_per_step else 1)):
        each(spec, state, t, _if_sweeping(spec, state, 1), _begin_sweep)
        contacts = FACE_CONTACTS * state.elements.n_triangles[None]
        each(spec, state, t, _if_sweeping(spec, state, contacts), _want)
        each(spec, state, t, _if_sweeping(spec, state, state.elements.n_rows[None]), _give)
        each(spec, state, t, _if_sweeping(spec, state, 1), _end_sweep)


@ti.func
def _if_sweeping(spec: ti.template(), state: ti.template(), count):
    """The turns that a loop takes: none in a launch after the last of its sweeps."""
    if ti.static(spec.one_launch_per_step):
        return ti.select(state.phase[None] == SWEEP, count, 0)
    else:
        return count


@ti.func
def _begin_sweep(spec: ti.template(), state: ti.template(), i):
    state.face_sweeps[None] += 1
    state.face_left[None] = 0.0


@ti.func
def _end_sweep(spec: ti.template(), state: ti.template(), i):
    if state.face_left[None] > SETTLED and state.face_sweeps[None] < SWEEPS:
        state.phase[None] = SWEEP
    elif state.face_finds[None] < FINDS:
        state.phase[None] = FIND
    else:
        state.phase[None] = LEAVE
        state.face_left[None] = ti.cast(1.0, state.raised)  # who knows


@ti.func
def _leave(spec: ti.template(), state: ti.template(), t):
    """Phase LEAVE: renew the halos, and have obstacles put particles onto themselves."""
    each_pack_moving(spec, state, t, leave)
    obstruction.settle(spec, state, t)
    each(spec, state, t, 1, _end_leave)


PHASES = _begin, _find, _count, _sweep, _leave
settle = stepping(PHASES)  # takes the faces of the scene's triangles and particles out of obstacles


@ti.func
def _end_leave(spec: ti.template(), state: ti.template(), i):
    """End, or look at what is left; whether more than one search found something, stays known."""
    state.face_unseen[None] = 0
    if state.face_left[None] > 0.0:
        state.face_finds[None] += FINDS
        state.phase[None] = FIND
    else:
        _judge(state)


@ti.func
def _judge(state: ti.template()):
    """Count the step if the last search saw a face deep in an obstacle, and end."""
    if state.face_deep[None] > UNSETTLED:
        state.faces_unsettled[None] = state.faces_unsettled[None] + 1
    state.phase[None] = DONE


# --- what meets what ---------------------------------------------------------------------------


@ti.func
def _look(spec: ti.template(), state: ti.template(), m):
    """Find where triangle m has entered an obstacle: the deepest place of all.

    What earlier searches of the step have found stays: so a face that lies on an edge does not
    turn about one point of it. Of a torn triangle those sides are looked at that still hold: as
    threads they are in the way, too.
    """
    if state.face_finds[None] == 1:
        state.face_hits[m] = 0
    if not face_clearance.is_clear(spec, state, m):
        deepest, clear = 0.0 * state.dt[None], FAR + 0.0 * state.dt[None]
        first, last = WHOLE, WHOLE + 1
        if ti.static(spec.fracture):
            if not is_whole(spec, state, state.elements, m):
                first, last = WHOLE + 1, WHOLE + 4
        for piece in range(first, last):
            there = True
            if ti.static(spec.fracture):
                if piece > WHOLE:  # no `or`, both sides of which read their fields: there is no -1
                    there = holds(spec, state, state.elements, m, piece - 1)
            if there:
                for o in range(state.n_obstacles[None]):
                    if state.obstacle_numbers[o, FACES_TOO] > 0.0:
                        deepest, free = _look_at(spec, state, o, m, piece, deepest)
                        clear = ti.min(clear, free)
        state.face_clear[m] = clear


@ti.func
def _look_at(spec: ti.template(), state: ti.template(), o, m, piece, deepest):
    """Note where a piece of triangle m (`_piece`) has entered obstacle o, if deeper than `deepest`.

    Returns the deepest place then, and its clearance (`face_clearance.py`).
    """
    reached = deepest
    free, near = _is_near(spec, state, o, m)
    if near:
        gap, gap_before, part, share, n, room, slack, own, deep = _meet(spec, state, o, m, piece)
        free = own
        if deep > UNSETTLED * room:
            raise_to(state, state.face_deep[None], deep / room)
        if -1.0 * gap > ti.max(deepest, _least(state, room, slack)):
            reached = -1.0 * gap
            state.face[_now(state, m), ROOM] = room
            _note_contact(spec, state, o, m, gap, gap_before > slack, part, share, n)
    return reached, free


@ti.func
def _least(state: ti.template(), room, slack):
    """The depth up to which a search lets a triangle be."""
    return ti.select(state.face_finds[None] == 1, slack, slack + SETTLED * room)


@ti.func
def _now(state: ti.template(), m):
    """The number of the contact that triangle m finds in the present search."""
    return m * FACE_CONTACTS + (state.face_finds[None] - 1) % FACE_CONTACTS


@ti.func
def _corner(state: ti.template(), m, k: ti.template()):
    return state.elements.corner[m, k]


@ti.func
def _piece(spec: ti.template(), state: ti.template(), m, piece):
    """The three corners of a piece of triangle m: all of it (WHOLE), or side piece - 1.

    A side is a triangle whose last corners are one.
    """
    i, j, k = _corner(state, m, 0), _corner(state, m, 1), _corner(state, m, 2)
    if ti.static(spec.fracture):
        if piece > WHOLE:
            i = state.elements.corner[m, piece - 1]
            j = state.elements.corner[m, piece % 3]
            k = j
    return i, j, k


@ti.func
def _shares(spec: ti.template(), piece, share):
    """The shares of a triangle's corners, from those of the corners of its piece."""
    of = 1.0 * share
    if ti.static(spec.fracture):
        if piece > WHOLE:
            for corner in ti.static(range(3)):
                ahead = ti.select(piece % 3 == corner, share[1] + share[2], 0.0 * share[0])
                of[corner] = ti.select(piece - 1 == corner, share[0], ahead)
    return of


@ti.func
def _is_near(spec: ti.template(), state: ti.template(), o, m):
    """Its clearance (`face_clearance.py`) from obstacle o if triangle m cannot have touched it in
    this step, and whether it may have.
    """
    x = slot_value(spec, state.x, _corner(state, m, 0))
    reach, way, least = 0.0 * x[0], 0.0 * x[0], FAR + 0.0 * x[0]
    for k in ti.static(range(3)):
        slot = _corner(state, m, k)
        least = ti.min(least, slot_number(spec, state.radius, slot))
        at = slot_value(spec, state.x, slot)
        d, moved = at - x, at - slot_value(spec, state.begun_x, slot)
        if ti.static(spec.moving):
            moved += centre_of(spec, state, o, START) - centre_of(spec, state, o, END)
        reach = ti.max(reach, laws.length(d) + slot_number(spec, state.radius, slot))
        way = ti.max(way, laws.length(moved))
    reach += _padding(state, o, least, 2.0 * reach)  # no side is longer than that
    away = laws.length(x - centre_of(spec, state, o, END))
    beyond = away - BOUND_MARGIN * (state.obstacle_numbers[o, BOUND] + reach)
    return face_clearance.of_far(state, beyond - way, x), beyond <= way


@ti.func
def _ends(spec: ti.template(), state: ti.template(), o, slot):
    """The begin and end of a particle's step, in the frame of obstacle o."""
    began = slot_value(spec, state.begun_x, slot) - centre_of(spec, state, o, START)
    ends = slot_value(spec, state.x, slot) - centre_of(spec, state, o, END)
    if ti.static(spec.compensated):
        began += slot_value(spec, state.begun_x_low, slot)
        ends += slot_value(spec, state.x_low, slot)
    return to_local(spec, state, o, START, began), to_local(spec, state, o, END, ends)


@ti.func
def _meet(spec: ti.template(), state: ti.template(), o, m, piece):
    """The meeting of a piece of triangle m with obstacle o, as `obstruction.meet` has it of a
    particle.

    Returns gap, gap_before, part, the shares (3,) of the triangle's corners in its nearest point,
    the normal there, of the world, what `_room` says, its clearance (`face_clearance.py`), and how
    deep its step ends in the obstacle, or past where its path met it, if that can be pushed.
    """
    i, j, k = _piece(spec, state, m, piece)
    a0, a1 = _ends(spec, state, o, i)
    b0, b1 = _ends(spec, state, o, j)
    c0, c1 = _ends(spec, state, o, k)
    radii = ti.Vector([slot_number(spec, state.radius, slot) for slot in ti.static((i, j, k))])
    way = ti.max(laws.length(a1 - a0), laws.length(b1 - b0), laws.length(c1 - c0))
    side = ti.max(laws.length(b1 - a1), laws.length(c1 - b1), laws.length(a1 - c1))
    room, slack = _room(spec, state, o, i, radii, side)
    padding = _padding(state, o, radii.max(), side)
    fast = way > room
    best_share, best_n, end_share, end_n = 0.0 * radii, 0.0 * a1, 0.0 * radii, 0.0 * a1
    gap, gap_before, met, clear = 0.0 * way, 0.0 * way, -1.0 + 0.0 * way, 0.0 * way
    deep, end_gap = 0.0 * way, 0.0 * way
    # The first look is at the end, the second at the start: one loop, so that the laws of all
    # shapes are compiled once.
    w = ti.Vector([slot_number(spec, state.w, slot) for slot in ti.static((i, j, k))])
    looks, at, going = 0, 1.0 + 0.0 * way, True
    while going:
        p, q, r = a0 + at * (a1 - a0), b0 + at * (b1 - b0), c0 + at * (c1 - c0)
        least, share, n, held, low = nearest(spec, state, o, p, q, r, radii - slack, w, side)
        here = least - share.dot(radii) - padding
        inward = n.dot(point_of(share, a1 - a0, b1 - b0, c1 - c0))
        if looks == 0:
            low -= radii.max() + padding
            clear = face_clearance.of_looked_at(spec, state, o, low, way, room, slack)
        if held == 1:  # wherever on its way: nothing of it is tested
            gap, end_gap, deep, going = 0.0 * gap, 0.0 * gap, 0.0 * gap, False
        else:
            if looks == 0:
                gap, best_share, best_n = here, share, n
                end_gap, end_share, end_n = here, share, n
                deep = _deep(here, share, w)
            if looks <= 1:
                gap_before = here
            found, past, meets_at, at, going = judge_look(
                looks, at, here, inward, slack, slack, 0.5 * room, room, fast, way, MOST_LOOKS
            )
            if found:
                gap, best_share, best_n, met = past, share, n, meets_at
                deep = ti.max(deep, _deep(past, share, w))
        looks += 1
    part = part_before(met, gap, gap_before)
    if -1.0 * gap <= _least(state, room, slack) and -1.0 * end_gap > UNSETTLED * room:
        # It ends outside of where its path met the obstacle, and yet elsewhere deep in it.
        if end_n.dot(best_n) > OPPOSED:
            gap, best_share, best_n = end_gap, end_share, end_n
    n = to_world(spec, state, o, END, best_n)
    return gap, gap_before, part, _shares(spec, piece, best_share), n, room, slack, clear, deep


@ti.func
def _deep(gap, share, w):
    """The depth of a point of such shares (3,) of corners of inverse masses w; 0 if fixed."""
    return ti.select((share * share).dot(w) > 0.0, -1.0 * gap, 0.0 * gap)


@ti.func
def _room(spec: ti.template(), state: ti.template(), o, slot, radii, side):
    """The depth in obstacle o at which a triangle of such a side may be through; and how large a
    gap is rounding."""
    radius = ti.max(radii[0], radii[1], radii[2])
    room = ti.max(radius + state.obstacle_numbers[o, ROUND], LEAST_ROOM * side)
    thick = radius + state.obstacle_numbers[o, THIN] + _padding(state, o, radius, side)
    room = ti.min(room, thick)  # beyond that it is through
    x = slot_value(spec, state.x, slot)
    return room, slack_of(spec, state, o, x, radius + side)  # no point of it is farther than a side


@ti.func
def _padding(state: ti.template(), o, radius, side):
    """By how much obstacle o is too thin for a triangle of that radius and side to be kept out."""
    return ti.max(LEAST_HALF * side - (radius + state.obstacle_numbers[o, THIN]), 0.0 * side)


# --- what comes of it --------------------------------------------------------------------------


@ti.func
def _velocity(spec: ti.template(), state: ti.template(), slot):
    v = slot_value(spec, state.v, slot)
    if ti.static(spec.compensated):
        v += slot_value(spec, state.v_low, slot)
    return v


@ti.func
def _pushed(spec: ti.template(), state: ti.template(), slot):
    """The way that faces have moved a corner in the step so far, (dim,)."""
    pushed = 0.0 * slot_value(spec, state.begun_v, slot)
    if state.face_finds[None] > 1:
        pushed += slot_value(spec, state.face_push, slot)
    return pushed


@ti.func
def _jump(spec: ti.template(), state: ti.template(), slot):
    """The change by walls and pairs of a corner's velocity in the step, (dim,)."""
    jump = slot_value(spec, state.face_jump, slot)
    if state.face_finds[None] == 1:
        jump = jump_of(spec, state, slot)
    return jump


@ti.func
def _note_contact(spec: ti.template(), state: ti.template(), o, m, gap, meets, part, share, n):
    """Note where the point of triangle m is to be, and how fast, by obstacle o.

    meets: whether it came to the obstacle in this step, after `part` of it.
    """
    p, way, v, begun_v, kick, mobility = 0.0 * n, 0.0 * n, 0.0 * n, 0.0 * n, 0.0 * n, 0.0 * gap
    for k in ti.static(range(3)):
        slot = _corner(state, m, k)
        at = slot_value(spec, state.x, slot) - centre_of(spec, state, o, END)
        pushed = _pushed(spec, state, slot)
        if ti.static(spec.compensated):
            at += slot_value(spec, state.x_low, slot)
        p, way = p + share[k] * at, way + share[k] * pushed
        v += share[k] * _velocity(spec, state, slot)
        begun_v += share[k] * slot_value(spec, state.begun_v, slot)
        if ti.static(has_impulses(spec)):  # it came with these
            begun_v += share[k] * _jump(spec, state, slot)
        kick += share[k] * kick_of(spec, state, slot)
        mobility += slot_number(spec, state.w, slot) * share[k] * share[k]
    if mobility > 0.0:
        surface_v = velocity_at(spec, state, o, p - gap * n)
        dt, u = state.dt[None], (v - surface_v).dot(n)
        push, target, weight = -1.0 * gap, 0.0 * gap, ti.static(state.position_weight) * dt
        u_before = (begun_v - surface_v).dot(n)
        if meets and state.face_finds[None] == 1 and u < 0.0:
            weight = weight_of_meeting(weight, u_before, u, part, dt)
        e = state.obstacle_numbers[o, RESTITUTION]
        free_u = u - kick.dot(n)  # as if it were alone: all bounce at once
        if meets and e > 0.0 and free_u < 0.0:
            new_u, lift = bounce(u_before, free_u, part, e, state.position_weight, dt)
            target = new_u
            push += lift
        c = _now(state, m)
        state.face_hits[m] = state.face_hits[m] | (1 << (c - m * FACE_CONTACTS))
        state.face[c, OFFSET] = n.dot(way) + push
        state.face[c, TARGET], state.face[c, WEIGHT] = target, weight
        state.face[c, GIVEN] = 0.0
        state.face[c, MU] = state.obstacle_numbers[o, FRICTION]
        for k in ti.static(range(3)):
            state.face[c, SHARE + k] = share[k]
        for axis in ti.static(range(spec.dim)):
            state.face[c, NORMAL + axis] = n[axis]
            state.face[c, SURFACE_V + axis] = surface_v[axis]
        raise_to(state, state.face_left[None], 1.0)


@ti.func
def _has(state: ti.template(), c):
    """True if row c of state.face has a contact."""
    return (state.face_hits[c // FACE_CONTACTS] >> (c % FACE_CONTACTS)) & 1 == 1


@ti.func
def _count_of(spec: ti.template(), state: ti.template(), p):
    """Count the contacts of the particle of row p, which have not kicked it before the first."""
    if state.face_finds[None] == 1:
        slot = state.elements.row_slot[p]
        x = slot_value(spec, state.x, slot)
        set_slot_value(spec, state.face_free, slot, x)
        set_slot_value(spec, state.face_push, slot, 0.0 * x)
        set_slot_value(spec, state.face_kick, slot, 0.0 * x)
        if ti.static(has_impulses(spec)):  # before it is pushed off the wall that holds it
            set_slot_value(spec, state.face_jump, slot, jump_of(spec, state, slot))
    count = 0
    for h in range(state.elements.row_start[p], state.elements.row_start[p + 1]):
        m = state.elements.row_triangle[h]
        for c in range(m * FACE_CONTACTS, (m + 1) * FACE_CONTACTS):
            if _has(state, c):
                count += 1
    state.face_count[p] = count


@ti.func
def _of(spec: ti.template(), state: ti.template(), c, column: ti.template()):
    """The vector (dim,) that begins in a column of state.face."""
    return ti.Vector([state.face[c, column + axis] for axis in range(spec.dim)])


@ti.func
def _want(spec: ti.template(), state: ti.template(), c):
    """Compute what contact c does to its triangle's corners, for shares and inverse masses of 1."""
    if _has(state, c):
        m = c // FACE_CONTACTS
        n, surface_v = _of(spec, state, c, NORMAL), _of(spec, state, c, SURFACE_V)
        way, v, mobility = 0.0 * n, 0.0 * n, 0.0 * state.dt[None]
        for k in ti.static(range(3)):
            slot, share = _corner(state, m, k), state.face[c, SHARE + k]
            way += share * slot_value(spec, state.face_push, slot)
            v += share * _velocity(spec, state, slot)
            count = ti.cast(state.face_count[state.face_row[m, k]], state.real)
            mobility += count * slot_number(spec, state.w, slot) * share * share
        depth, relative = state.face[c, OFFSET] - n.dot(way), v - surface_v
        u = relative.dot(n)
        lost = 0.0 * u
        if depth >= -1.0 * SETTLED * state.face[c, ROOM]:  # it touches
            lost = ti.max(state.face[c, TARGET] - u, 0.0)
        given = state.face[c, GIVEN]
        if state.face[c, TARGET] > 0.0:
            # What others then send away faster gives back what was too much: else energy grows.
            if given > 0.0:
                lost = ti.max(state.face[c, TARGET] - u, -1.0 * given * mobility)
            state.face[c, GIVEN] = given + lost / mobility
        taken, _ = laws.friction(relative - u * n, ti.max(lost, 0.0), state.face[c, MU])
        push = ti.max(depth, 0.0)
        dx, dv = push * n + state.face[c, WEIGHT] * taken, lost * n + taken
        for axis in ti.static(range(spec.dim)):
            state.face[c, DX + axis] = dx[axis] / mobility
            state.face[c, DV + axis] = dv[axis] / mobility
        left = ti.max(push, ti.abs(lost) * state.dt[None]) / state.face[c, ROOM]
        raise_to(state, state.face_left[None], left)


@ti.func
def _give(spec: ti.template(), state: ti.template(), p):
    """Give the particle of row p what its triangles do to it."""
    if state.face_count[p] > 0:
        slot = state.elements.row_slot[p]
        x, v = slot_value(spec, state.x, slot), slot_value(spec, state.v, slot)
        dx, dv, w = 0.0 * x, 0.0 * v, slot_number(spec, state.w, slot)
        for h in range(state.elements.row_start[p], state.elements.row_start[p + 1]):
            m = state.elements.row_triangle[h]
            for c in range(m * FACE_CONTACTS, (m + 1) * FACE_CONTACTS):
                if _has(state, c):
                    share = 0.0 * w
                    for k in ti.static(range(3)):
                        if _corner(state, m, k) == slot:
                            share += state.face[c, SHARE + k]
                    dx += (w * share) * _of(spec, state, c, DX)
                    dv += (w * share) * _of(spec, state, c, DV)
        x_low, v_low = owed_at(spec, state, slot)
        pushed = slot_value(spec, state.face_push, slot) + dx
        set_slot_value(spec, state.face_push, slot, pushed)
        if ti.static(not spec.compensated):  # rounded once, however many sweeps there are
            x, dx = slot_value(spec, state.face_free, slot), pushed
        new_x, new_x_low = joined(spec, state, x, x_low, dx)
        new_v, new_v_low = joined(spec, state, v, v_low, dv)
        put_at(spec, state, slot, new_x, new_x_low, new_v, new_v_low)
        note_fault(spec, state, slot)
        kick = slot_value(spec, state.face_kick, slot)
        set_slot_value(spec, state.face_kick, slot, kick + dv)  # for `obstruction.py`
