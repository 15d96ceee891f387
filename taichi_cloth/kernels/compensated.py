"""Sums that keep what rounding takes from them: the precision `compensated`.

A position moves by far less than itself in a step: in f32, at 1.5 m and with 1000 substeps a frame,
by less than can be added to it. There each position and velocity has a low part besides, which
holds what its last sums lost and is added with the next change, so that they are as good as numbers
of 48 bits. Kahan, "Further remarks on reducing truncation errors", Comm. ACM 8, 1965; the error of
a sum is Knuth's, The Art of Computer Programming 2, 4.2.2, theorem B: it does not ask which of both
is larger. Compilers that reorder floating-point operations would undo it: `fast_math` is off there,
and what Vulkan's and OpenGL's do regardless is kept from them by factors of which they do not know
that they are one.

In every other precision these functions are plain sums and differences, to the bit.
"""

import taichi as ti

from taichi_cloth.kernels.packs import component, read, with_component, write


@ti.func
def add_to_position(spec: ti.template(), state: ti.template(), i, x, change):
    """Pack i's positions x, changed: x + change, with what state.x_low still owes them."""
    if ti.static(spec.compensated):
        return _added(spec, state, state.x_low, i, x, change)
    else:
        return x + change


@ti.func
def add_to_velocity(spec: ti.template(), state: ti.template(), i, v, change):
    """The same for its velocities v."""
    if ti.static(spec.compensated):
        return _added(spec, state, state.v_low, i, v, change)
    else:
        return v + change


@ti.func
def _added(spec: ti.template(), state: ti.template(), low: ti.template(), i, value, change):
    one = state.one[None]
    change_and_low = change + read(spec, low, i)
    total = one * (value + change_and_low)
    added = one * (total - value)
    write(spec, low, i, (value - (total - added)) + (change_and_low - added))
    return total


@ti.func
def difference(spec: ti.template(), state: ti.template(), value: ti.template(), i, j):
    """Vector from i to j, of whole packs or of particles as `value` reads them."""
    d = value(spec, state.x, j) - value(spec, state.x, i)
    if ti.static(spec.compensated):
        d += value(spec, state.x_low, j) - value(spec, state.x_low, i)
    return d


@ti.func
def forget_low(spec: ti.template(), state: ti.template(), i, axis: ti.template(), where):
    """Where the numbers `where` are positive, positions were set on an axis, not changed."""
    low = read(spec, state.x_low, i)
    part = component(low, axis)
    none = ti.select(where > 0.0, 0.0 * part, part)
    write(spec, state.x_low, i, with_component(low, axis, none))
