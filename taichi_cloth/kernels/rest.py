"""Rest: what lies on sharp obstacles, and has all but come to a stop, stands still.

Contacts of faces tremble: where a face lies along an edge its deepest place is not unique, and
impulses that are found anew in each step differ by what sweeps leave. So particles are at rest once
none has moved by more than `WAY` of a side in `SPAN` times as long as a fall through a side takes.
From then on each step puts them back to where it began (of particles one by one: Macklin, Mueller,
Chentanez, Kim, "Unified particle physics for real-time applications", 2014, 4.5).

At rest all steps begin alike. So their free ends have the same bits for as long as the same acts on
the particles. Once one has others, all go on: by a wind that turns, a blow, a hold, a cut. What is
loaded anew, as all that a program or a user changes in a scene is, ends a rest, too.
"""

import numpy as np
import taichi as ti

from taichi_cloth.kernels.compensated import put_at
from taichi_cloth.kernels.copies import keep
from taichi_cloth.kernels.loops import barrier, each, each_pack, each_pack_moving
from taichi_cloth.kernels.packs import set_slot_value, slot_number, slot_value
from taichi_cloth.kernels.phases import set_alone

WAY = 0.01  # of a side
SPAN = 14.0  # times sqrt(side / gravity): a second where a side is 5 cm
NEVER = 2**31 - 1  # steps

# state.rest_phase: all are stopped in one step, and the free end of the next one is noted.
MOVES, STOPS, NOTES, RESTS = range(4)


def needed(spec):
    """Tell if a specialization knows rest: of faces on obstacles that do not move."""
    return bool(spec.obstacles) and spec.faces and not spec.moving


def way_and_span(scene, dt):
    """The most that a particle at rest moves [length], and in how many steps of dt."""
    a, b = (scene.particles.position[scene.elements[:, k]] for k in (0, 1))
    side, g = np.linalg.norm(b - a, axis=1).mean(), np.linalg.norm(scene.world.gravity)
    steps = SPAN * np.sqrt(side / g) / dt if scene.world.rest and g > 0.0 else NEVER
    return WAY * side, int(min(np.ceil(steps), NEVER))


@ti.func
def settle(spec: ti.template(), state: ti.template(), t):
    """See whether all are at rest, and then put them back to where the step began."""
    set_alone(spec, state.stirred, t, 0)
    barrier(spec, state, t)
    each_pack(spec, state, t, _look)
    each(spec, state, t, 1, _judge)
    each_pack_moving(spec, state, t, _end_pack)


@ti.func
def hold(spec: ti.template(), state: ti.template(), t):
    """Put all that are at rest back again: pairs may have moved them."""
    each_pack_moving(spec, state, t, _put_back)


@ti.func
def is_at_rest(state: ti.template()):
    """Tell if the step ends where it began."""
    return state.rest_phase[None] != MOVES


@ti.func
def _look(spec: ti.template(), state: ti.template(), i):
    """Note in state.stirred whether a particle of pack i has moved too far, or ends elsewhere."""
    for slot in range(i * spec.lanes, (i + 1) * spec.lanes):
        if slot_number(spec, state.w, slot) > 0.0:
            if state.rest_phase[None] == MOVES:
                way = slot_value(spec, state.begun_x, slot) - slot_value(spec, state.rest_x, slot)
                if not way.dot(way) <= state.rest_way[None] * state.rest_way[None]:
                    state.stirred[None] = 1  # every thread writes the same
            elif state.rest_phase[None] >= NOTES:
                if _differs(spec, state.x, state.rest_x, slot):
                    state.stirred[None] = 1
                if _differs(spec, state.v, state.rest_v, slot):
                    state.stirred[None] = 1


@ti.func
def _differs(spec: ti.template(), a: ti.template(), b: ti.template(), slot):
    """Tell if two fields of vectors differ at a slot."""
    d, differs = slot_value(spec, a, slot) - slot_value(spec, b, slot), False
    for axis in ti.static(range(spec.dim)):
        if d[axis] != 0.0:
            differs = True
    return differs


@ti.func
def _judge(spec: ti.template(), state: ti.template(), i):
    """Say whether all are at rest from this step on."""
    if state.rest_phase[None] == MOVES:
        state.rest_steps[None] = ti.select(state.stirred[None] == 1, 0, state.rest_steps[None] + 1)
        if state.rest_steps[None] >= state.rest_span[None]:
            state.rest_phase[None] = STOPS
    elif state.rest_phase[None] == STOPS:
        state.rest_phase[None] = NOTES
    else:
        state.rest_phase[None] = ti.select(state.stirred[None] == 1, MOVES, RESTS)
        state.rest_steps[None] = 0


@ti.func
def _end_pack(spec: ti.template(), state: ti.template(), i):
    """Note where pack i is, from where it moves too far, or the free end of its rest."""
    if state.rest_phase[None] == MOVES:
        if state.rest_steps[None] == 0:
            for slot in range(i * spec.lanes, (i + 1) * spec.lanes):
                set_slot_value(spec, state.rest_x, slot, slot_value(spec, state.begun_x, slot))
    elif state.rest_phase[None] == NOTES:
        keep(spec, state, i, "rest")
    _put_back(spec, state, i)


@ti.func
def _put_back(spec: ti.template(), state: ti.template(), i):
    """Put pack i back to where the step began, at rest."""
    if is_at_rest(state):
        for slot in range(i * spec.lanes, (i + 1) * spec.lanes):
            if slot_number(spec, state.w, slot) > 0.0:
                begun = slot_value(spec, state.begun_x, slot)
                still, low = 0.0 * begun, 0.0 * begun
                if ti.static(spec.compensated):
                    low = slot_value(spec, state.begun_x_low, slot)
                put_at(spec, state, slot, begun, low, still, still)
