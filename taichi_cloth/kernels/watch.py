"""The watchdog: is every particle finite and inside its bound at a frame's end?"""

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
    for i in range(state.n[None]):
        state.good_x[i] = state.x[i]
        state.good_v[i] = state.v[i]


@ti.func
def watch(state: ti.template()):
    """After a frame: fault = lowest index of a particle not finite or too fast, else NO_FAULT."""
    for _ in range(1):
        state.fault[None] = NO_FAULT
    for i in range(state.n[None]):
        x, v = state.x[i], state.v[i]
        speed2 = v.dot(v)
        limit = state.speed_limit[None]
        if not (is_finite(speed2) and is_finite(x.sum())) or speed2 > limit * limit:
            ti.atomic_min(state.fault[None], i)


@ti.kernel
def keep_parallel(state: ti.template()):
    keep(state)


@ti.kernel
def watch_parallel(state: ti.template()) -> ti.i32:
    """The check at a frame's end; returns the fault."""
    watch(state)
    return state.fault[None]


@ti.kernel
def last_fault(state: ti.template()) -> ti.i32:
    """The fault of the check before."""
    return state.fault[None]


@ti.kernel
def put_back(state: ti.template()):
    """Undo a frame: the state is again the one that was kept."""
    for i in range(state.n[None]):
        state.x[i] = state.good_x[i]
        state.v[i] = state.good_v[i]
