"""The watchdog: is every particle finite and inside its bound at each step?"""

import taichi as ti

from taichi_cloth.kernels.loops import each_pack, each_pack_moving
from taichi_cloth.kernels.packs import (
    component,
    dot,
    over_lanes,
    read,
    slot_number,
    slot_value,
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
def checkpoint(spec: ti.template(), state: ti.template(), t):
    """Before a frame: copy the state, so that a frame that fails can be undone."""
    if t == 0:
        state.fault[None] = NO_FAULT
        state.watching[None] = 1
    each_pack(spec, state, t, _checkpoint_pack)


@ti.func
def _checkpoint_pack(spec: ti.template(), state: ti.template(), i):
    write(spec, state.saved_x, i, read(spec, state.x, i))
    write(spec, state.saved_v, i, read(spec, state.v, i))
    if ti.static(spec.compensated):
        write(spec, state.saved_x_low, i, read(spec, state.x_low, i))
        write(spec, state.saved_v_low, i, read(spec, state.v_low, i))


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
def commit(spec: ti.template(), state: ti.template(), i, x, v):
    """End of a step for a pack: store its state, and note it where that is at fault.

    fault is the lowest index of a particle that was not finite or too fast in the first step
    that had one. The values are at hand here; a pass of its own would read them all again.
    """
    write(spec, state.x, i, x)
    write(spec, state.v, i, v)
    limit2 = state.speed_limit[None] * state.speed_limit[None]
    # Sums are finite only if all of their parts are, and small only if no part is large.
    speed2, place = over_lanes(spec, dot(v, v)), component(x, 0)
    for axis in ti.static(range(1, spec.dim)):
        place += component(x, axis)
    if not is_finite(speed2 + over_lanes(spec, place)) or speed2 > limit2:
        for lane in range(spec.lanes):
            _note_fault(spec, state, i * spec.lanes + lane, limit2)


@ti.func
def _note_fault(spec: ti.template(), state: ti.template(), slot, limit2):
    x, v = slot_value(spec, state.x, slot), slot_value(spec, state.v, slot)
    speed2 = v.dot(v)
    if not (is_finite(speed2) and is_finite(x.sum())) or speed2 > limit2:
        if state.watching[None] == 1:
            ti.atomic_min(state.fault[None], slot_number(spec, state.particle, slot))


@ti.kernel
def checkpoint_launch(spec: ti.template(), state: ti.template()):
    checkpoint(spec, state, 0)


@ti.kernel
def last_fault(state: ti.template()) -> ti.i32:
    """Lowest index of a particle at fault in the frame before, or NO_FAULT."""
    return state.fault[None]


@ti.kernel
def restore(spec: ti.template(), state: ti.template()):
    """Undo a frame: the state is again the one that was kept."""
    each_pack_moving(spec, state, 0, _restore_pack)


@ti.func
def _restore_pack(spec: ti.template(), state: ti.template(), i):
    write(spec, state.x, i, read(spec, state.saved_x, i))
    write(spec, state.v, i, read(spec, state.saved_v, i))
    if ti.static(spec.compensated):
        write(spec, state.x_low, i, read(spec, state.saved_x_low, i))
        write(spec, state.v_low, i, read(spec, state.saved_v_low, i))
