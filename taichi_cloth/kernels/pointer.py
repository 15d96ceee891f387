"""What the pointer does to particles."""

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.loops import each_cell
from taichi_cloth.kernels.packs import (
    component,
    dot,
    read,
    scaled,
    set_site_value,
    with_component,
    write,
)


@ti.kernel
def compute_push(plan: ti.template(), state: ti.template(), numbers: ti.types.ndarray()):
    """push: the pointer's force on each particle, by its distance to the pointer's line.

    numbers: per axis a point of the line, its unit direction (zero: the line is a point, as in
    2-D), the pointer's displacement; then reach and strength.
    """
    for _ in range(1):
        state.pushing[None] = 1
        for i in ti.static(range(3)):
            for axis in ti.static(range(plan.dim)):
                state.pointer[i, axis] = numbers[i * plan.dim + axis]
        state.pointer_reach[None] = numbers[3 * plan.dim]
        state.pointer_strength[None] = numbers[3 * plan.dim + 1]
    each_cell(plan, state, 0, _push_cell)


@ti.func
def _push_cell(plan: ti.template(), state: ti.template(), c):
    x = read(plan, state.x, c)
    d, ray = 0.0 * x, 0.0 * x
    for axis in ti.static(range(plan.dim)):
        from_pointer = component(x, axis) - state.pointer[0, axis]
        d = with_component(d, axis, from_pointer)
        ray = with_component(ray, axis, 0.0 * from_pointer + state.pointer[1, axis])
    d = d - scaled(dot(d, ray), ray)  # not -=, which whole vectors do not take
    reach, strength = state.pointer_reach[None], state.pointer_strength[None]
    distance, push = laws.length(d), 0.0 * x
    for axis in ti.static(range(plan.dim)):
        force = laws.blow_force(distance, state.pointer[2, axis], reach, strength)
        push = with_component(push, axis, force)
    write(plan, state.push, c, push)


@ti.kernel
def clear_push(state: ti.template()):
    """No pointer force."""
    for _ in range(1):
        state.pushing[None] = 0


@ti.kernel
def hold_push(plan: ti.template(), state: ti.template(), forces: ti.types.ndarray()):
    """push: a force for each particle, forces (n, dim), instead of the pointer's."""
    for _ in range(1):
        state.pushing[None] = 1
    for i in range(forces.shape[0]):
        force = ti.Vector.zero(state.real, ti.static(plan.dim))
        for axis in ti.static(range(plan.dim)):
            force[axis] = forces[i, axis]
        set_site_value(plan, state.push, state.site[i], force)
