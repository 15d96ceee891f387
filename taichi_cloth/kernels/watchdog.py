"""The watchdog: is every particle finite and inside its bound at each step?"""

import taichi as ti

from taichi_cloth.kernels.loops import each_cell, each_cell_moving
from taichi_cloth.kernels.packs import (
    component,
    dot,
    over_lanes,
    read,
    site_number,
    site_value,
    write,
)

NO_FAULT = 2147483647
EXPONENT_F32 = 0x7F800000  # all ones: infinity or NaN


@ti.func
def is_finite(a):
    """By the bit pattern: compilers may assume that comparisons never see a NaN.

    Of the f32 value, because OpenGL cannot take f64 apart; what overflows f32 counts as infinite.
    """
    bits = ti.bit_cast(ti.cast(a, ti.f32), ti.i32)
    return (bits & EXPONENT_F32) != EXPONENT_F32


@ti.func
def keep(plan: ti.template(), state: ti.template(), t):
    """Before a frame: copy the state, so that a frame that fails can be undone."""
    if t == 0:
        state.fault[None] = NO_FAULT
        state.watching[None] = 1
    each_cell(plan, state, t, _keep_cell)


@ti.func
def _keep_cell(plan: ti.template(), state: ti.template(), c):
    write(plan, state.good_x, c, read(plan, state.x, c))
    write(plan, state.good_v, c, read(plan, state.v, c))
    if ti.static(plan.compensated):
        write(plan, state.good_x_low, c, read(plan, state.x_low, c))
        write(plan, state.good_v_low, c, read(plan, state.v_low, c))


@ti.func
def begin_step(state: ti.template(), step):
    """Before step number `step`: once there is a fault, what it spreads to is no longer noted."""
    state.step[None] = step
    if state.fault[None] != NO_FAULT:
        state.watching[None] = 0


@ti.func
def all_well(state: ti.template()):
    """Whether no particle is at fault so far; read so that no compiler keeps an older answer."""
    return ti.atomic_max(state.fault[None], -1) == NO_FAULT


@ti.func
def store(plan: ti.template(), state: ti.template(), c, x, v):
    """End of a step for a cell: store its state, and note it where that is at fault.

    fault is the lowest index of a particle that was not finite or too fast in the first step
    that had one. The values are at hand here; a pass of its own would read them all again.
    """
    write(plan, state.x, c, x)
    write(plan, state.v, c, v)
    limit2 = state.speed_limit[None] * state.speed_limit[None]
    # Sums are finite only if all of their parts are, and small only if no part is large.
    speed2, place = over_lanes(plan, dot(v, v)), component(x, 0)
    for axis in ti.static(range(1, plan.dim)):
        place += component(x, axis)
    if not is_finite(speed2 + over_lanes(plan, place)) or speed2 > limit2:
        for lane in range(plan.lanes):
            _note_fault(plan, state, c * plan.lanes + lane, limit2)


@ti.func
def _note_fault(plan: ti.template(), state: ti.template(), site, limit2):
    x, v = site_value(plan, state.x, site), site_value(plan, state.v, site)
    speed2 = v.dot(v)
    if not (is_finite(speed2) and is_finite(x.sum())) or speed2 > limit2:
        if state.watching[None] == 1:
            ti.atomic_min(state.fault[None], site_number(plan, state.particle, site))


@ti.kernel
def keep_spread(plan: ti.template(), state: ti.template()):
    keep(plan, state, 0)


@ti.kernel
def last_fault(state: ti.template()) -> ti.i32:
    """Lowest index of a particle at fault in the frame before, or NO_FAULT."""
    return state.fault[None]


@ti.kernel
def put_back(plan: ti.template(), state: ti.template()):
    """Undo a frame: the state is again the one that was kept."""
    each_cell_moving(plan, state, 0, _put_back_cell)


@ti.func
def _put_back_cell(plan: ti.template(), state: ti.template(), c):
    write(plan, state.x, c, read(plan, state.good_x, c))
    write(plan, state.v, c, read(plan, state.good_v, c))
    if ti.static(plan.compensated):
        write(plan, state.x_low, c, read(plan, state.good_x_low, c))
        write(plan, state.v_low, c, read(plan, state.good_v_low, c))
