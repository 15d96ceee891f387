"""Faces to pass over: those that have not moved far enough to meet an obstacle.

Most of a cloth is far from what is sharp. Where a face is looked at (`faces.py`), a lower bound of
what it may move from the step's end before it can touch anything is kept as its clearance,
state.face_clear; none where it may have met something on its way there. In each search that is
lowered by the longest way of its corners since the search before: no point of a face goes farther
than a corner. While it is positive a look would find nothing, neither where the step ends nor along
its path, and the face is left out. So the same contacts are found, with the same bits.

Ways are measured from where corners were seen last to where the step begins, and from there to its
end: whatever moved them meanwhile, another contact, a hand, a return to an earlier moment, counts.
A load, and what may have left no number to measure from, has all faces looked at once
(state.face_unseen). Where obstacles move, nothing is left out.
"""

import taichi as ti

from taichi_cloth.kernels.loops import each
from taichi_cloth.kernels.obstacles import load
from taichi_cloth.kernels.obstruction import NEAR, size_of
from taichi_cloth.kernels.packs import epsilon, slot_value

MORE = 1.01  # times a way: by as much sides, rooms and roundings may have grown with it
ROUNDED = 8.0  # slacks of a look, and as many epsilons of a clearance each time that it is lowered
# What is far from the ball around an obstacle is compared by its corners' ways, each of which
# changes both sides of that: `faces._is_near`.
SHARE_OF_FAR = 0.24


def kept(spec):
    """True if a specialization keeps clearances."""
    return not spec.moving


@ti.func
def note_ways(spec: ti.template(), state: ti.template(), t):
    """Note how far each corner has gone since the last search."""
    if ti.static(kept(spec)):
        each(spec, state, t, state.elements.n_rows[None], _note_way)


@ti.func
def _note_way(spec: ti.template(), state: ti.template(), p):
    slot = state.elements.row_slot[p]
    x = slot_value(spec, state.x, slot)
    seen = ti.Vector([state.face_seen[p, axis] for axis in range(spec.dim)])
    way = size_of(x - seen)
    if state.face_finds[None] == 1:
        begun = slot_value(spec, state.begun_x, slot)
        way = size_of(begun - seen) + size_of(x - begun)
    state.face_way[p] = way
    for axis in ti.static(range(spec.dim)):
        state.face_seen[p, axis] = x[axis]


@ti.func
def is_clear(spec: ti.template(), state: ti.template(), m):
    """True if triangle m cannot have met anything; `note_ways` comes before."""
    clear = False
    if ti.static(kept(spec)):
        left = 0.0 * state.dt[None]
        if state.face_unseen[None] == 0 or state.face_finds[None] > 1:
            left = state.face_clear[m]
            way = state.face_way[state.face_row[m, 0]]
            for k in ti.static((1, 2)):
                way = ti.max(way, state.face_way[state.face_row[m, k]])
            # Rounding may not keep what is large from getting smaller.
            left -= MORE * way + ti.static(ROUNDED * epsilon(state)) * ti.abs(left)
        state.face_clear[m] = left
        clear = left > 0.0
    return clear


@ti.func
def of_far(state: ti.template(), beyond, x):
    """The clearance of a triangle that is `beyond` the ball around an obstacle and its own way; x:
    where it is."""
    rounding = ti.static(ROUNDED * epsilon(state)) * (beyond + 2.0 * size_of(x))
    return SHARE_OF_FAR * beyond - rounding


@ti.func
def of_looked_at(spec: ti.template(), state: ti.template(), o, lowest, way, room, slack):
    """The clearance of a triangle that is looked at from obstacle o.

    lowest: what none of its gaps at the step's end is below if the obstacle is convex; else nothing
    is known. way: of its corners in the step: what may have met something along it is looked at in
    the step's next search, too. room, slack: as the look has them: a path that comes as near as
    NEAR rooms may touch.
    """
    clear = 0.0 * lowest
    for s in ti.static(range(len(spec.obstacles))):
        if ti.static(load(spec.obstacles[s]).convex):
            if state.obstacle_shape[o] == s:
                clear = lowest - 2.0 * NEAR * room - ROUNDED * slack
    if clear <= MORE * way:
        clear = 0.0 * lowest
    return clear
