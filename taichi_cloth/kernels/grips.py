"""Fixed particles that go with an obstacle: pins that move.

No force moves a fixed particle, so every method takes it straight on with the velocity that it has.
Here it gets, at a step's end, the mean velocity of the obstacle's point in the next step: so it is
where the obstacle is at both ends of every step, and dashpots see how fast it goes. Rounding does
not add up: where it is, is computed anew from the obstacle's pose.
"""

import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.loops import each, each_pack_moving
from taichi_cloth.kernels.packs import set_slot_value, slot_number, slot_value
from taichi_cloth.kernels.poses import (
    END,
    NEXT,
    centre_of,
    place_next,
    place_obstacles,
    to_world,
)


def needed(spec):
    """True if a specialization has obstacles that move and may hold particles."""
    return spec.held


@ti.func
def settle(spec: ti.template(), state: ti.template(), t):
    """Put what is held where its obstacle is at the step's end, and let it go on with it."""
    place_obstacles(spec, state, t)
    each(spec, state, t, state.n_obstacles[None], place_next)
    each_pack_moving(spec, state, t, _carry_pack)


@ti.func
def _carry_pack(spec: ti.template(), state: ti.template(), i):
    for lane in range(spec.lanes):
        slot = i * spec.lanes + lane
        by = ti.cast(slot_number(spec, state.held_by, slot), ti.i32)
        if by > 0 and slot_number(spec, state.w, slot) == 0.0:
            q = slot_value(spec, state.held_at, slot)
            x = centre_of(spec, state, by - 1, END) + to_world(spec, state, by - 1, END, q)
            v = centre_of(spec, state, by - 1, NEXT) + to_world(spec, state, by - 1, NEXT, q)
            set_slot_value(spec, state.x, slot, x)
            set_slot_value(spec, state.v, slot, v)
            if ti.static(spec.compensated):
                set_slot_value(spec, state.x_low, slot, 0.0 * x)
                set_slot_value(spec, state.v_low, slot, 0.0 * v)


@kernel
def begin_launch(spec: ti.template(), state: ti.template(), done: ti.i32):
    """Do the same before the step that comes after `done` of them."""
    state.step[None] = done
    settle(spec, state, 0)
