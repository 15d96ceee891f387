"""The watchdog: whether every particle is finite, below the speed limit and in the world.

It looks at each step. In the world is what no wall has lost (`contact.store_held_by_walls`).

Each frame begins with a checkpoint of the state, to which a frame that fails is restored.
"""

import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.copies import keep, return_to
from taichi_cloth.kernels.loops import each_pack, each_pack_moving
from taichi_cloth.kernels.packs import (
    component,
    dot,
    over_lanes,
    slot_number,
    slot_value,
    write,
)

NO_FAULT = 2147483647
EXPONENT_F32 = 0x7F800000  # all ones: infinity or NaN


@ti.func
def is_finite(a):
    """True if the number a is finite, by its bits: compilers may assume that none is a NaN.

    The bits are those of its f32 value, because OpenGL cannot take f64 apart; what overflows f32
    counts as infinite.
    """
    bits = ti.bit_cast(ti.cast(a, ti.f32), ti.i32)
    return (bits & EXPONENT_F32) != EXPONENT_F32


@ti.func
def checkpoint(spec: ti.template(), state: ti.template(), t):
    """Copy the state before a frame, so that `restore` can undo the frame, and forget any fault."""
    if t == 0:
        state.fault[None] = NO_FAULT
        state.watching[None] = 1
    each_pack(spec, state, t, _checkpoint_pack)


@ti.func
def _checkpoint_pack(spec: ti.template(), state: ti.template(), i):
    keep(spec, state, i, "saved")
    if ti.static(spec.keeps_begun):
        keep(spec, state, i, "begun")  # where the next step begins (`settling.py`)


@ti.func
def begin_step(state: ti.template(), step):
    """Begin step number `step`; if there is a fault already, no further ones are noted.

    So state.fault is of the first step that had one, and not of what it spread to.
    """
    state.step[None] = step
    if state.fault[None] != NO_FAULT:
        state.watching[None] = 0


@ti.func
def all_well(state: ti.template()):
    """True if no particle is at fault so far; an atomic read, which no compiler can leave out."""
    return ti.atomic_max(state.fault[None], -1) == NO_FAULT


@ti.func
def commit(spec: ti.template(), state: ti.template(), i, x, v):
    """Store the new state of pack i at the end of a step, and note the particles at fault in it.

    x, v: its new positions and velocities. state.fault becomes the lowest index of a particle that
    was not finite or too fast in the first step that had one. The values are at hand here; another
    loop would read them all again.
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
    """Note the particle at a slot if it is not finite or too fast; limit2: speed limit squared."""
    x, v = slot_value(spec, state.x, slot), slot_value(spec, state.v, slot)
    speed2 = v.dot(v)
    if not (is_finite(speed2) and is_finite(x.sum())) or speed2 > limit2:
        note_lost(spec, state, slot)


@ti.func
def note_fault(spec: ti.template(), state: ti.template(), slot):
    """Note the particle at a slot if it is not finite or too fast."""
    _note_fault(spec, state, slot, state.speed_limit[None] * state.speed_limit[None])


@ti.func
def note_lost(spec: ti.template(), state: ti.template(), slot):
    """Note the particle at a slot as one at fault, such as one that a wall has lost."""
    if state.watching[None] == 1:
        ti.atomic_min(state.fault[None], slot_number(spec, state.particle, slot))


@kernel
def checkpoint_launch(spec: ti.template(), state: ti.template()):
    """Run `checkpoint` in a launch by itself."""
    checkpoint(spec, state, 0)


@kernel
def last_fault(state: ti.template()) -> ti.i32:
    """The lowest index of a particle at fault in the last frame, or NO_FAULT."""
    return state.fault[None]


@kernel
def restore(spec: ti.template(), state: ti.template()):
    """Undo a frame: set the state back to that of the last checkpoint."""
    each_pack_moving(spec, state, 0, _restore_pack)


@ti.func
def _restore_pack(spec: ti.template(), state: ti.template(), i):
    return_to(spec, state, i, "saved")
