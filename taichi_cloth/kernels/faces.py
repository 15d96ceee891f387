"""Faces and edges of a cloth against obstacles that would pass between its particles.

Where an obstacle is thinner than the sides of a scene's triangles are long, the point of each
triangle that is deepest in it is put onto its surface, with what contact and friction leave of that
point's velocity (`obstruction.py`): its corners move by their shares of it and their inverse masses
(Bridson, Fedkiw, Anderson, 2002, 6.2). All triangles are looked at in the same state and the
corners take the mean of what their triangles want, weighted by their shares; this is repeated
`ROUNDS` times, so it ends near the surface, not on it. Where a step is longer than the obstacle is
thick, the path is looked at in pieces.

The deepest point is found by turns: from a point of the triangle to the middle of the obstacle, and
back to the point of the triangle nearest to that. Faces do not bounce.
"""

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.compensated import joined
from taichi_cloth.kernels.loops import each, each_pack_moving, leave
from taichi_cloth.kernels.obstacles.contract import BOUND, FACES_TOO, FRICTION, THIN
from taichi_cloth.kernels.packs import set_slot_value, slot_number, slot_value
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
from taichi_cloth.kernels.surfaces import is_whole

ROUNDS = 4
TURNS = 5  # between triangle and obstacle, in search of the deepest point
MOST_PIECES = 64  # of a step's path
PIECE = 0.5  # length of one, in parts of how thin the obstacle is


def needed(spec):
    """Whether a specialization has triangles with thin obstacles in their way."""
    return bool(spec.obstacles) and spec.faces


@ti.func
def settle(spec: ti.template(), state: ti.template(), t):
    """Take the faces of the scene's triangles out of thin obstacles."""
    if ti.static(spec.moving):
        place_obstacles(spec, state, t)
    if ti.static(spec.one_launch_per_step):  # whose loops must be top-level ones
        for _ in ti.static(range(ROUNDS)):
            _round(spec, state, t)
    else:
        for _ in range(ROUNDS):
            _round(spec, state, t)
    each_pack_moving(spec, state, t, leave)


@ti.func
def _round(spec: ti.template(), state: ti.template(), t):
    each(spec, state, t, state.surface.n_triangles[None], _look)
    each(spec, state, t, state.surface.n_rows[None], _give)


@ti.func
def _look(spec: ti.template(), state: ti.template(), m):
    """Find what triangle m wants of its corners, for all obstacles that are thin: the deepest."""
    for k in ti.static(range(9)):
        state.face_hit[m, k] = 0.0
    if is_whole(spec, state, state.surface, m):
        deepest = 0.0 * state.dt[None]
        for o in range(state.n_obstacles[None]):
            if state.obstacle_numbers[o, FACES_TOO] > 0.0 and _is_near(spec, state, o, m):
                depth, share, n, p = _meet(spec, state, o, m)
                if depth > deepest:
                    deepest = depth
                    _want(spec, state, o, m, depth, share, n, p)


@ti.func
def _is_near(spec: ti.template(), state: ti.template(), o, m):
    """Whether triangle m may have touched obstacle o in this step."""
    first = state.surface.corner[m, 0]
    x = slot_value(spec, state.x, first)
    reach, way = 0.0 * x[0], 0.0 * x[0]
    for k in ti.static(range(3)):
        slot = state.surface.corner[m, k]
        at = slot_value(spec, state.x, slot)
        d, moved = at - x, at - slot_value(spec, state.begun_x, slot)
        if ti.static(spec.moving):
            moved += centre_of(spec, state, o, START) - centre_of(spec, state, o, END)
        reach = ti.max(reach, laws.length(d) + slot_number(spec, state.radius, slot))
        way = ti.max(way, laws.length(moved))
    away = laws.length(x - centre_of(spec, state, o, END))
    return away <= 1.001 * (state.obstacle_numbers[o, BOUND] + reach) + way


@ti.func
def _meet(spec: ti.template(), state: ti.template(), o, m):
    """How deep triangle m ends in obstacle o, its corners' shares, the normal, and the point.

    The normal and the point are of the world, at the step's end; the depth is 0 where it is not in
    it.
    """
    a, b, c = state.surface.corner[m, 0], state.surface.corner[m, 1], state.surface.corner[m, 2]
    a0, a1 = _ends(spec, state, o, a)
    b0, b1 = _ends(spec, state, o, b)
    c0, c1 = _ends(spec, state, o, c)
    thin = state.obstacle_numbers[o, THIN]
    longest = ti.max(laws.length(a1 - a0), laws.length(b1 - b0), laws.length(c1 - c0))
    pieces = ti.min(ti.cast(longest / (PIECE * thin), ti.i32) + 1, MOST_PIECES)
    depth, found = 0.0 * thin, 0
    share, n = 0.0 * a1 + 1.0 / 3.0, 0.0 * a1
    for piece in range(pieces):
        if found == 0:
            part = ti.cast(piece + 1, state.real) / pieces
            p, q, r = a0 + part * (a1 - a0), b0 + part * (b1 - b0), c0 + part * (c1 - c0)
            share = 0.0 * a1 + 1.0 / 3.0
            gap, point = 0.0 * thin, p
            for _ in range(TURNS):
                point = share[0] * p + share[1] * q + share[2] * r
                d, normal = signed_distance(spec, state, o, point)
                gap, n = d, normal
                share = shares_of_nearest(point - (d + thin) * normal, p, q, r)
            point = share[0] * p + share[1] * q + share[2] * r
            d, normal = signed_distance(spec, state, o, point)
            gap, n = d, normal
            gap -= (
                share[0] * slot_number(spec, state.radius, a)
                + share[1] * slot_number(spec, state.radius, b)
                + share[2] * slot_number(spec, state.radius, c)
            )
            if gap < 0.0:
                end = share[0] * a1 + share[1] * b1 + share[2] * c1
                depth = ti.max(-1.0 * gap - n.dot(end - point), 0.0)
                found = 1
    end = share[0] * a1 + share[1] * b1 + share[2] * c1
    place = centre_of(spec, state, o, END) + to_world(spec, state, o, END, end)
    return depth, share, to_world(spec, state, o, END, n), place


@ti.func
def _ends(spec: ti.template(), state: ti.template(), o, slot):
    """Where the step of the particle at a slot begins and ends, in the frame of obstacle o."""
    began = slot_value(spec, state.begun_x, slot) - centre_of(spec, state, o, START)
    ends = slot_value(spec, state.x, slot) - centre_of(spec, state, o, END)
    if ti.static(spec.compensated):
        began += slot_value(spec, state.begun_x_low, slot)
        ends += slot_value(spec, state.x_low, slot)
    return to_local(spec, state, o, START, began), to_local(spec, state, o, END, ends)


@ti.func
def shares_of_nearest(p, a, b, c):
    """The shares (3,) of the corners a, b, c in the point of their triangle that is nearest to p.

    Ericson, Real-Time Collision Detection, 5.1.5.
    """
    ab, ac, bc = b - a, c - a, c - b
    d1, d2 = ab.dot(p - a), ac.dot(p - a)
    d3, d4 = ab.dot(p - b), ac.dot(p - b)
    d5, d6 = ab.dot(p - c), ac.dot(p - c)
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    share = 0.0 * p
    total = va + vb + vc
    if d1 <= 0.0 and d2 <= 0.0:
        share[0] = 1.0
    elif d3 >= 0.0 and d4 <= d3:
        share[1] = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        share[2] = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0 and d1 - d3 > 0.0:
        share[1] = d1 / (d1 - d3)
        share[0] = 1.0 - share[1]
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0 and d2 - d6 > 0.0:
        share[2] = d2 / (d2 - d6)
        share[0] = 1.0 - share[2]
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0 and bc.dot(bc) > 0.0:
        share[2] = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        share[1] = 1.0 - share[2]
    elif total > 0.0:
        share[1], share[2] = vb / total, vc / total
        share[0] = 1.0 - share[1] - share[2]
    else:
        share[0] = 1.0
    return share


@ti.func
def _want(spec: ti.template(), state: ti.template(), o, m, depth, share, n, p):
    """Note what triangle m wants of its corners, whose point p is `depth` deep in obstacle o."""
    v, mobility = 0.0 * n, 0.0 * depth
    for k in ti.static(range(3)):
        slot = state.surface.corner[m, k]
        own = slot_value(spec, state.v, slot)
        if ti.static(spec.compensated):
            own += slot_value(spec, state.v_low, slot)
        v += share[k] * own
        mobility += slot_number(spec, state.w, slot) * share[k] * share[k]
    if mobility > 0.0:
        surface_v = velocity_at(spec, state, o, p - centre_of(spec, state, o, END) + depth * n)
        u = (v - surface_v).dot(n)
        lost = ti.max(-1.0 * u, 0.0)
        slide = v - surface_v - u * n
        taken, _ = laws.friction(slide, lost, state.obstacle_numbers[o, FRICTION])
        dv = lost * n + taken
        dx = depth * n + (ti.static(state.position_weight) * state.dt[None]) * taken
        for k in ti.static(range(3)):
            w = slot_number(spec, state.w, state.surface.corner[m, k])
            state.face_hit[m, k] = w * share[k] / mobility
            state.face_hit[m, 3 + k] = dx[k]
            state.face_hit[m, 6 + k] = dv[k]


@ti.func
def _give(spec: ti.template(), state: ti.template(), p):
    """Give the particle of row p the mean of what its triangles want of it."""
    slot = state.surface.row_slot[p]
    dx, dv = ti.Vector.zero(state.real, 3), ti.Vector.zero(state.real, 3)
    total = 0.0 * state.dt[None]
    for h in range(state.surface.row_start[p], state.surface.row_start[p + 1]):
        m = state.surface.row_triangle[h]
        part = 0.0 * total
        for k in ti.static(range(3)):
            if state.surface.corner[m, k] == slot:
                part = state.face_hit[m, k]
        if part > 0.0:
            total += part
            for axis in ti.static(range(3)):
                dx[axis] += part * part * state.face_hit[m, 3 + axis]
                dv[axis] += part * part * state.face_hit[m, 6 + axis]
    if total > 0.0:
        x, v = slot_value(spec, state.x, slot), slot_value(spec, state.v, slot)
        x_low, v_low = 0.0 * x, 0.0 * v
        if ti.static(spec.compensated):
            x_low, v_low = slot_value(spec, state.x_low, slot), slot_value(spec, state.v_low, slot)
        new_x, new_x_low = joined(spec, state, x, x_low, (1.0 / total) * dx)
        new_v, new_v_low = joined(spec, state, v, v_low, (1.0 / total) * dv)
        set_slot_value(spec, state.x, slot, new_x)
        set_slot_value(spec, state.v, slot, new_v)
        if ti.static(spec.compensated):
            set_slot_value(spec, state.x_low, slot, new_x_low)
            set_slot_value(spec, state.v_low, slot, new_v_low)
