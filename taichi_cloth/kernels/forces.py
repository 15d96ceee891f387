"""Force accumulation: everything that acts on a particle, as one acceleration."""

import functools

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.loops import each_cell_moving
from taichi_cloth.kernels.packs import (
    component,
    read,
    scaled,
    set_site_value,
    site_number,
    site_value,
    where_positive,
    with_component,
    write,
)
from taichi_cloth.kernels.springs import accumulate, force_between, move_and_accumulate


@ti.func
def compute_acceleration(plan: ti.template(), state: ti.template(), t):
    """a = g + w*f for every particle, from the positions and velocities as they stand.

    Positions and velocities are only read, so no loop has a race.
    """
    accumulate(plan, state, t, force_between, _store_acceleration, _accelerate_more)


@ti.func
def accelerate_then(plan: ti.template(), state: ti.template(), t, move: ti.template()):
    """Run move(plan, state, c, a) for every cell c with its acceleration a at the step's start.

    A special case that is measured to pay: in lanes a cell that has its acceleration can move at
    once, which saves storing and reading it. All else takes two loops.
    """
    if ti.static(plan.lanes > 1 and not plan.springs):
        accumulate(plan, state, t, force_between, ti.static(_moving(move)), _accelerate_more)
    else:
        compute_acceleration(plan, state, t)
        each_cell_moving(plan, state, t, ti.static(_moving_with_stored(move)))


def kicks_at_once(plan):
    """Whether `kick_after` kicks a cell when it has its forces, and leaves state.a to that."""
    if plan.lanes > 1:
        return not plan.springs and not plan.spread
    # Neighbours read positions, which a kick leaves, and for dashpots velocities.
    return not plan.dashpots and not (plan.springs and plan.kinds > 0)


@ti.func
def kick_after(
    plan: ti.template(), state: ti.template(), t, move: ti.template(), kick: ti.template()
):
    """Run move(plan, state, c) for every cell, then kick(plan, state, c, a) with its acceleration
    where it is now, which changes its velocity alone. In lanes that is one pass over memory.
    """
    if ti.static(not kicks_at_once(plan)):
        each_cell_moving(plan, state, t, move)
        accelerate_then(plan, state, t, kick)
    elif ti.static(plan.lanes > 1):
        move_and_accumulate(plan, state, t, move, force_between, ti.static(_moving(kick)))
    else:
        each_cell_moving(plan, state, t, move)
        accumulate(plan, state, t, force_between, ti.static(_moving(kick)), _accelerate_more)


@functools.cache
def _moving(move):
    @ti.func
    def receive(plan: ti.template(), state: ti.template(), c, f):
        move(plan, state, c, acceleration(plan, state, c, f))

    return receive


@functools.cache
def _moving_with_stored(move):
    @ti.func
    def body(plan: ti.template(), state: ti.template(), c):
        move(plan, state, c, read(plan, state.a, c))

    return body


@ti.func
def _store_acceleration(plan: ti.template(), state: ti.template(), c, f):
    write(plan, state.a, c, acceleration(plan, state, c, f))


@ti.func
def acceleration(plan: ti.template(), state: ti.template(), c, f):
    """Acceleration of cell c under the spring forces f and all that acts on single particles.

    The order of the sums is that of the reference trajectories: a pulled cloth amplifies round-off
    1e8 times in 600 frames.
    """
    w, v = read(plan, state.w, c), read(plan, state.v, c)
    none = 0.0 * v
    a, total = none, f
    for axis in ti.static(range(plan.dim)):
        a = with_component(a, axis, component(a, axis) + state.gravity[axis])
    if ti.static(plan.drag):
        a += scaled(w, laws.drag_force(v, read(plan, state.viscous, c)))
    if ti.static(plan.blow):
        if state.pushing[None] == 1:
            total += read(plan, state.push, c)
    return where_positive(w, a + scaled(w, total), none)


@ti.func
def _accelerate_more(plan: ti.template(), state: ti.template(), site, f):
    """Acceleration by springs that no grid holds."""
    w = site_number(plan, state.w, site)
    set_site_value(plan, state.a, site, site_value(plan, state.a, site) + w * f)
