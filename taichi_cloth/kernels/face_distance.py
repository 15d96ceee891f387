"""The point of a triangle, or of an edge, that is nearest to an obstacle or deepest in it.

The point is looked for along the sides by bisection, then inwards by cutting planes (Kelley, "The
cutting-plane method for solving convex programs", 1960). The distance from what is convex is
nowhere below its tangents. Three of them, or sides of the triangle, bound it, and where they meet
is looked next. The new tangent takes the place of one of them, by a step of the dual simplex
method. The search ends once their bound is reached. Steps down the slope would not get there: over
a box's corner a face is nearly level, and the distance rises steeply beyond each edge.

Then come, for what is not convex, turns to the nearest point of the obstacle and back, and
projected gradients, with steps that grow while they lead nearer and shrink where they do not
(Macklin, Erleben, Mueller, Chentanez, Jeschke, Corse, "Local optimization for robust signed
distance field collision", 2020).
"""

import taichi as ti

from taichi_cloth.kernels.obstacles import load
from taichi_cloth.kernels.obstacles.contract import ROUND
from taichi_cloth.kernels.obstruction import ROUNDINGS
from taichi_cloth.kernels.packs import epsilon
from taichi_cloth.kernels.poses import signed_distance

ALONG = 4  # looks in search of the nearest point that come before those along sides
SIDE_TURNS = 4  # looks along each side
INWARDS = ALONG + 3 * SIDE_TURNS
DOWNWARDS = INWARDS + 20  # looks where planes meet end, and those down the slope begin
TURNS = DOWNWARDS + 16  # looks in all
REACHED = (
    4e-6  # of the longest side: a distance that is above the planes' bound by less is the least
)


@ti.func
def point_of(share, a, b, c):
    """The point of a triangle that has these shares (3,) of its corners."""
    return share[0] * a + share[1] * b + share[2] * c


@ti.func
def nearest(spec: ti.template(), state: ti.template(), o, p, q, r, radii, w, side):
    """The least distance of the triangle p, q, r from obstacle o, the shares of that point, and n.

    Then come whether it is held, and what no distance of the triangle from a convex obstacle is
    below: such a distance is a convex function, which is nowhere below its tangents.

    It is looked for at the corners, along the sides, then from the best of these inwards: distances
    from convex obstacles have no other minimum. It is held (1, else 0) if a fixed corner is inside
    by more than its radius allows, as what is clamped may be: then the triangle is not tested.
    radii, w: of its corners; side: the longest of its sides.
    """
    zero = 0.0 * side
    least, stride, held, share, n = 1e30 + zero, 0.3 * side, 0, 0.0 * radii, 0.0 * p
    corner_d, n_p, n_q, n_r, middle = 0.0 * radii, n, n, n, zero
    # A side's bracket: where along it, the distance and its slope, on either side of the minimum.
    low, low_d, low_slope, high, high_d, high_slope = zero, zero, zero, zero, zero, zero
    # Planes (`_first_planes`), and the one that enters them next; height: -1, there is none.
    planes, at_last, entering = ti.Matrix.zero(state.real, 3, 3), 0.0 * radii, 0.0 * radii
    inverse, base, bound, height = planes, zero, zero, zero - 1.0
    turns, trial = 0, 0.0 * radii + 1.0 / 3.0
    if ti.static(spec.dim == 2):
        trial[0], trial[1], trial[2] = 0.5, 0.5, 0.0
    while turns < TURNS:
        e = ti.min((turns - ALONG) // SIDE_TURNS, 2)
        here, there = _corner_shares(radii, e), _corner_shares(radii, (e + 1) % 3)
        edge = point_of(there - here, p, q, r)
        if turns >= ALONG and turns < INWARDS:
            if (turns - ALONG) % SIDE_TURNS == 0:
                low, low_d = zero, corner_d.dot(here)
                low_slope = point_of(here, n_p, n_q, n_r).dot(edge)
                high, high_d = zero + 1.0, corner_d.dot(there)
                high_slope = point_of(there, n_p, n_q, n_r).dot(edge)
            if not (low_slope < 0.0 and high_slope > 0.0):
                turns = ALONG + (e + 1) * SIDE_TURNS  # the least is at one of its ends
                continue
            at = _between(low, low_d, low_slope, high, high_d, high_slope, turns % 2 == 0)
            trial = here + at * (there - here)
        elif turns >= INWARDS and turns < DOWNWARDS:
            across = r - q
            if across.dot(across) == 0.0:  # an edge
                turns = DOWNWARDS
                continue
            if turns == INWARDS:
                base = least
                planes, at_last = _first_planes(_tangent(zero, n, share, p, q, r) / side)
            for _ in range(4):
                if height >= 0.0:
                    planes, at_last = _exchanged(planes, inverse, at_last, entering, height)
                inverse = planes.inverse()
                trial, bound = _where_planes_meet(inverse, at_last)
                height = zero - 1.0
                if not trial.min() < -1e-6:
                    break
                # It is beyond a side that is none of them, which becomes one.
                beyond = ti.select(trial[1] < trial[0], 1, 0)
                if trial[2] < ti.min(trial[0], trial[1]):
                    beyond = 2
                entering, height = -1.0 * _corner_shares(trial, beyond), zero
            trial = ti.max(trial, 0.0)
            total = trial.sum()
            if not (total > 0.5 and total < 1e6):  # what rounding left of planes that hardly meet
                turns = DOWNWARDS
                continue
            trial /= total
        elif turns >= DOWNWARDS:
            step = stride
            if turns % 2 == 0:  # to the nearest point of the obstacle, and from there back
                step = ti.max(least, 0.0) + state.obstacle_numbers[o, ROUND] + 1e-4 * side
            trial = shares_of_nearest(point_of(share, p, q, r) - step * n, p, q, r)
            moved = trial - share
            if turns % 2 == 1 and moved.dot(moved) < 1e-12:
                break
        elif turns > 0:
            trial = _corner_shares(radii, turns - 1)
        d, new_n = signed_distance(spec, state, o, point_of(trial, p, q, r))
        nearer = d < least
        if turns == 0:
            middle = d
            if d > 2.0 * side + radii[0] + radii[1] + radii[2]:
                least, share, turns = d - side, trial, TURNS  # it is this far at least
        elif turns < ALONG:
            if w.dot(trial) == 0.0 and d < trial.dot(radii):
                held, turns = 1, TURNS
            corner_d += d * trial
            n_p, n_q, n_r = n_p + trial[0] * new_n, n_q + trial[1] * new_n, n_r + trial[2] * new_n
        elif turns < INWARDS:
            at = trial.dot(there)
            if new_n.dot(edge) < 0.0:
                low, low_d, low_slope = at, d, new_n.dot(edge)
            else:
                high, high_d, high_slope = at, d, new_n.dot(edge)
        elif turns < DOWNWARDS:
            if ti.min(d, least) - base - side * bound <= REACHED * side:
                turns = ti.select(_is_convex(spec, state, o), TURNS - 1, DOWNWARDS - 1)
            else:
                entering = _tangent(d - base, new_n, trial, p, q, r) / side
                height = zero + 1.0
        if turns >= DOWNWARDS and turns % 2 == 1:
            stride *= ti.select(nearer, 1.2, 0.4)
        if nearer and turns < TURNS:
            least, share, n = d, trial, new_n
        if turns == ALONG - 1:
            same = ti.min(n_p.dot(n_q), n_p.dot(n_r)) >= 1.0 - ti.static(ROUNDINGS * epsilon(state))
            bulge = 3.0 * middle - corner_d.dot(0.0 * radii + 1.0)
            if ti.static(spec.dim == 2):
                bulge = 2.0 * middle - corner_d[0] - corner_d[1]
            if same and ti.max(bulge, -1.0 * bulge) <= 1e-3 * ti.max(least, -1.0 * least):
                turns = TURNS  # over a plane face: the least is at a corner
        turns += 1
    at = point_of(share, p, q, r)
    lowest = least + ti.min(n.dot(p - at), n.dot(q - at), n.dot(r - at))
    return least, share, n, held, lowest


@ti.func
def _is_convex(spec: ti.template(), state: ti.template(), o):
    """True if obstacle o is convex."""
    convex = False
    for s in ti.static(range(len(spec.obstacles))):
        if state.obstacle_shape[o] == s:
            convex = ti.static(load(spec.obstacles[s]).convex)
    return convex


@ti.func
def _tangent(d, n, share, p, q, r):
    """The values (3,) at the corners p, q, r of what is d at a point of theirs, and has slope n."""
    at = point_of(share, p, q, r)
    return ti.Vector([d + n.dot(p - at), d + n.dot(q - at), d + n.dot(r - at)])


# Three planes bound a distance t from below. Of a plane with the values g at the corners, points
# with the shares s have t >= g.s if it is a tangent, and 0 >= g.s if it is a side. Column i of
# `planes` is g0 - g2, g1 - g2, and 1 for a tangent or 0, and at_last[i] is g2: where they meet,
# (s0, s1, -t) times that column is -g2. The last column of the inverse has their weights in the
# bound, none of which is negative.


@ti.func
def _first_planes(g):
    """The tangent g (3,), and the two sides that meet in its lowest corner, as planes."""
    lowest = ti.select(g[1] < g[0], 1, 0)
    if g[2] < ti.min(g[0], g[1]):
        lowest = 2
    # Whole vectors have no unary minus (`packs.py`).
    one = -1.0 * _corner_shares(g, (lowest + 1) % 3)
    other = -1.0 * _corner_shares(g, (lowest + 2) % 3)
    columns = ti.Matrix.cols(
        [_column(g, 1.0 + 0.0 * g[0]), _column(one, 0.0 * g[0]), _column(other, 0.0 * g[0])]
    )
    return columns, ti.Vector([g[2], one[2], other[2]])


@ti.func
def _column(g, height):
    return ti.Vector([g[0] - g[2], g[1] - g[2], height])


@ti.func
def _where_planes_meet(inverse, at_last):
    """The shares (3,) of the point where three planes meet, and their height there."""
    s = inverse.transpose() @ (-1.0 * at_last)
    return ti.Vector([s[0], s[1], 1.0 - s[0] - s[1]]), -1.0 * s[2]


@ti.func
def _exchanged(planes, inverse, at_last, g, height):
    """The planes with a new one in the place of that whose weight it takes up first.

    g: its values (3,) at the corners; height: 1 of a tangent, 0 of a side.
    """
    column = _column(g, height)
    takes = inverse @ column
    leaves, least = 0, 1e30 + 0.0 * g[0]
    for i in ti.static(range(3)):
        if takes[i] > 1e-6:
            ratio = ti.max(inverse[i, 2], 0.0) / takes[i]
            if ratio < least:
                leaves, least = i, ratio
    new, new_last = 1.0 * planes, 1.0 * at_last
    for i in ti.static(range(3)):
        if leaves == i:
            new_last[i] = g[2]
            for row in ti.static(range(3)):
                new[row, i] = column[row]
    return new, new_last


@ti.func
def _between(low, low_d, low_slope, high, high_d, high_slope, by_tangents):
    """Where, between two places along a side, the distance from an obstacle may be least.

    low_d, high_d: the distances there, which fall from low and rise to high by their slopes.
    """
    at = low - low_slope * (high - low) / (high_slope - low_slope)
    if by_tangents:  # where they meet: exact where the side crosses an edge
        at = (high_d - high_slope * high - low_d + low_slope * low) / (low_slope - high_slope)
    margin = 0.02 * (high - low)
    return ti.min(ti.max(at, low + margin), high - margin)


@ti.func
def _corner_shares(like, k):
    """The shares (3,) of corner k."""
    share = 0.0 * like
    for corner in ti.static(range(3)):
        share[corner] = ti.select(k == corner, 1.0, 0.0)
    return share


@ti.func
def shares_of_nearest(p, a, b, c):
    """The shares (3,) of the corners a, b, c in the point of their triangle that is nearest to p.

    In 2-D, and where b and c are one, it is the edge from a to b. Ericson, Real-Time Collision
    Detection, 5.1.5.
    """
    ab, ac, bc = b - a, c - a, c - b
    d1, d2 = ab.dot(p - a), ac.dot(p - a)
    d3, d4 = ab.dot(p - b), ac.dot(p - b)
    d5, d6 = ab.dot(p - c), ac.dot(p - c)
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    edge = bc.dot(bc) == 0.0
    zero = 0.0 * d1
    share = ti.Vector([zero, zero, zero])
    total = va + vb + vc
    if d1 <= 0.0 and d2 <= 0.0:
        share[0] = 1.0
    elif d3 >= 0.0 and d4 <= d3:
        share[1] = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        share[2] = 1.0
    elif (vc <= 0.0 or edge) and d1 >= 0.0 and d3 <= 0.0 and d1 - d3 > 0.0:
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
