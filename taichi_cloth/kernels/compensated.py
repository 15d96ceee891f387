"""Sums that keep what rounding takes from them: the precision `compensated`.

A position moves by far less than itself in a step: in f32, at 1.5 m and with 1000 substeps a frame,
by less than can be added to it. In this precision each position and velocity therefore has a low
part besides, which holds what its last sums lost and is added with the next change, so that both
together are as good as a number of 48 bits. Kahan, "Further remarks on reducing truncation errors",
Comm. ACM 8, 1965; the error of a sum is Knuth's, The Art of Computer Programming 2, 4.2.2,
theorem B: it does not ask which of both is larger.

Compilers that reorder floating-point operations would undo it. So `fast_math` is off in this
precision, and sums are multiplied by a factor that is 1 (state.one), which the compilers of Vulkan
and OpenGL do not know and so cannot reorder across.

In every other precision these functions are plain sums and differences, to the bit.
"""

import taichi as ti

from taichi_cloth.kernels.packs import read, set_slot_value, slot_value, write


@ti.func
def add_to_position(spec: ti.template(), state: ti.template(), i, x, change):
    """The sum x + change for pack i's positions x, with what state.x_low still owes them.

    In the precision `compensated` it updates state.x_low; the caller stores the sum in state.x.
    """
    if ti.static(spec.compensated):
        return _added(spec, state, state.x_low, i, x, change)
    else:
        return x + change


@ti.func
def add_to_velocity(spec: ti.template(), state: ti.template(), i, v, change):
    """The sum v + change for pack i's velocities v, with what state.v_low still owes them.

    In the precision `compensated` it updates state.v_low; the caller stores the sum in state.v.
    """
    if ti.static(spec.compensated):
        return _added(spec, state, state.v_low, i, v, change)
    else:
        return v + change


@ti.func
def _added(spec: ti.template(), state: ti.template(), low: ti.template(), i, value, change):
    """The sum value + change + low, whose own rounding error becomes the new low."""
    total, new_low = joined(spec, state, value, read(spec, low, i), change)
    write(spec, low, i, new_low)
    return total


@ti.func
def joined(spec: ti.template(), state: ti.template(), value, low, change):
    """The sum value + change + low, and what it loses to rounding, the new low.

    But for the precision `compensated` it is value + change, and low as it is.
    """
    if ti.static(spec.compensated):
        one = state.one[None]
        change_and_low = change + low
        total = one * (value + change_and_low)
        added = one * (total - value)
        return total, (value - (total - added)) + (change_and_low - added)
    else:
        return value + change, low


@ti.func
def difference(spec: ti.template(), state: ti.template(), value: ti.template(), i, j):
    """The vectors from the positions of i to those of j, which are packs or slots, as for `value`.

    In the precision `compensated` the low parts count too.
    """
    d = value(spec, state.x, j) - value(spec, state.x, i)
    if ti.static(spec.compensated):
        d += value(spec, state.x_low, j) - value(spec, state.x_low, i)
    return d


@ti.func
def forget_low(spec: ti.template(), low: ti.template(), slot, axis):
    """Clear the low part of a particle's vector on an axis.

    There it was set to a value and not changed by a sum, so nothing is owed to it.
    low: the field of these parts: state.x_low or state.v_low.
    """
    part = slot_value(spec, low, slot)
    part[axis] = 0.0
    set_slot_value(spec, low, slot, part)


@ti.func
def owed_at(spec: ti.template(), state: ti.template(), slot):
    """The low parts of position and velocity at a slot: x_low, v_low; 0 where there are none."""
    x_low = 0.0 * slot_value(spec, state.x, slot)
    v_low = x_low
    if ti.static(spec.compensated):
        x_low, v_low = slot_value(spec, state.x_low, slot), slot_value(spec, state.v_low, slot)
    return x_low, v_low


@ti.func
def put_at(spec: ti.template(), state: ti.template(), slot, x, x_low, v, v_low):
    """Store position and velocity at a slot, with what is to be added to them."""
    set_slot_value(spec, state.x, slot, x)
    set_slot_value(spec, state.v, slot, v)
    if ti.static(spec.compensated):
        set_slot_value(spec, state.x_low, slot, x_low)
        set_slot_value(spec, state.v_low, slot, v_low)
