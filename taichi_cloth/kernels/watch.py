"""The watchdog: is every particle finite and inside its bound at each step?"""

import taichi as ti

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
def keep(state: ti.template()):
    """Before a frame: copy the state, so that a frame that fails can be undone."""
    state.fault[None] = NO_FAULT
    state.watching[None] = 1
    for i in range(state.n[None]):
        state.good_x[i] = state.x[i]
        state.good_v[i] = state.v[i]


@ti.func
def look_up(state: ti.template()):
    """Before a step: once there is a fault, what it spreads to is no longer noted."""
    if state.fault[None] != NO_FAULT:
        state.watching[None] = 0


@ti.func
def store(state: ti.template(), i, x, v):
    """End of a particle's step: store its state, and note it where that is at fault.

    fault is the lowest index of a particle that was not finite or too fast in the first step
    that had one. The values are at hand here; a pass of its own would read them all again.
    """
    state.x[i] = x
    state.v[i] = v
    speed2 = v.dot(v)
    limit = state.speed_limit[None]
    if not (is_finite(speed2) and is_finite(x.sum())) or speed2 > limit * limit:
        if state.watching[None] == 1:
            ti.atomic_min(state.fault[None], i)


@ti.kernel
def keep_parallel(state: ti.template()):
    keep(state)


@ti.kernel
def last_fault(state: ti.template()) -> ti.i32:
    """Lowest index of a particle at fault in the frame before, or NO_FAULT."""
    return state.fault[None]


@ti.kernel
def put_back(state: ti.template()):
    """Undo a frame: the state is again the one that was kept."""
    for i in range(state.n[None]):
        state.x[i] = state.good_x[i]
        state.v[i] = state.good_v[i]
