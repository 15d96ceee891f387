"""Extended position-based dynamics: backward Euler, spring by spring, in coloured sweeps.

Macklin, Mueller, Chentanez, "XPBD: position-based simulation of compliant constrained dynamics",
2016; many small steps of few sweeps: Macklin et al., "Small steps in physics simulation", 2019.
First order, stable at every dt. One spring is solved by the first visit; many need more sweeps, the
more the stiffer they are and the more unequal the masses.

A spring of stiffness k = 1/compliance, dashpot c and tension T pulls its ends together by an
impulse p, the paper's multiplier over dt, which begins at zero and is kept from sweep to sweep: so
the number of sweeps does not change the material. In the paper's terms, over compliance/dt,

    p += (dt*T - p) / (1 + dt*(dt*k + c)*(w_i + w_j)).

- The paper keeps the multiplier's size, as if it had always pointed along the spring as it is now.
  Here p is a vector, and what it has across the spring is replaced too, with the stiffness across
  in the place of k. The first sweep is the paper's; many end at the solution of backward Euler.
- The unknown is the velocity: x stays where the step began, springs are computed at x + dt*v. Set
  from positions, as in the paper, velocities would lose gravity to rounding in f32.
"""

import math

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.colours import colour_count, each_of_colour
from taichi_cloth.kernels.contact import compute_contacts, kept_above_floor, velocity_jump
from taichi_cloth.kernels.forces import acceleration
from taichi_cloth.kernels.lanes import (
    dot,
    of_kind,
    read,
    scaled,
    set_site_value,
    site_number,
    site_value,
    write,
    zeros,
)
from taichi_cloth.kernels.loops import each, each_cell, each_cell_moving
from taichi_cloth.kernels.methods.claims import Claims
from taichi_cloth.kernels.phases import DONE, go_to
from taichi_cloth.kernels.springs import link_stiffness, number
from taichi_cloth.kernels.state import GONE, SWEEPS
from taichi_cloth.kernels.watch import store

CLAIMS = Claims(
    order=1,
    symplectic=False,
    implicit=True,
    stability_limit=math.inf,
    forces=0,
    settings=("iterations",),
)
VECTORS = ("old_v",)
COUNTS = ("colour", "sweep")
NEEDS = ("spring_colours",)
BEGIN, SWEEP, FINISH = range(3)  # phases


@ti.func
def begin_step(plan: ti.template(), state: ti.template(), t):
    compute_contacts(plan, state)
    each_cell(plan, state, t, predict)
    each(plan, state, t, 1, _begin_sweeps)


@ti.func
def predict(plan: ti.template(), state: ti.template(), c):
    """Velocity after the step without springs; drag acts on the new one."""
    x, v = read(plan, state.x, c), read(plan, state.v, c)
    write(plan, state.old_v, c, v)
    v += velocity_jump(plan, state, c, x, v)
    write(plan, state.v, c, v)
    a = acceleration(plan, state, c, zeros(plan, state))
    if ti.static(plan.drag):
        viscous, w = read(plan, state.viscous, c), read(plan, state.w, c)
        a = scaled(laws.drag_factor(w, viscous, state.dt[None]), a)
    write(plan, state.v, c, v + state.dt[None] * a)


@ti.func
def _begin_sweeps(plan: ti.template(), state: ti.template(), i):
    state.colour[None], state.sweep[None] = 0, 0
    state.phase[None] = ti.select(colour_count(plan, state) > 0, SWEEP, FINISH)


@ti.func
def sweep(plan: ti.template(), state: ti.template(), t):
    """One colour of a sweep, a launch each, where loops are spread; else all sweeps."""
    if ti.static(plan.spread):
        each_of_colour(plan, state, t, state.colour[None], project_links, project_spring)
        each(plan, state, t, 1, _next_colour)
    else:
        for k in range(state.iterations[None]):
            # By every thread alike, none of which is still in the sweep before.
            state.sweep[None] = k
            for colour in range(colour_count(plan, state)):
                each_of_colour(plan, state, t, colour, project_links, project_spring)
        go_to(plan, state, t, FINISH)


@ti.func
def _next_colour(plan: ti.template(), state: ti.template(), i):
    state.colour[None] += 1
    if state.colour[None] == colour_count(plan, state):
        state.colour[None] = 0
        state.sweep[None] += 1
        if state.sweep[None] == state.iterations[None]:
            state.phase[None] = FINISH


@ti.func
def project_links(plan: ti.template(), state: ti.template(), s, g, c, far, stiffness):
    """The springs of kind s between cell c and cell `far`."""
    k = link_stiffness(plan, state, s, stiffness)
    damping = 0.0 * k
    if ti.static(plan.dashpots):
        damping = ti.select(k > 0.0, state.link_c[s, g], 0.0 * k)
    at, p = of_kind(state, s, c), zeros(plan, state)
    if state.sweep[None] > 0:
        p = read(plan, state.link_impulse, at)
    v, far_v = read(plan, state.v, c), read(plan, state.v, far)
    w, far_w = mobility(plan, state, read, c), mobility(plan, state, read, far)
    d, rest = read(plan, state.x, far) - read(plan, state.x, c), state.link_rest[s, g]
    change = impulse_change(plan, state.dt[None], d, far_v - v, w + far_w, k, rest, damping, p)
    if state.sweep[None] + 1 < state.iterations[None]:
        write(plan, state.link_impulse, at, p + change)
    write(plan, state.v, c, v + scaled(w, change))
    write(plan, state.v, far, far_v - scaled(far_w, change))


@ti.func
def project_spring(plan: ti.template(), state: ti.template(), s):
    """Spring s on the graph."""
    k, rest = number(plan, state.spring_k, s), number(plan, state.spring_rest, s)
    damping = 0.0 * k
    if ti.static(plan.dashpots):
        damping = number(plan, state.spring_c, s)
    if ti.static(plan.fracture):
        if state.status[s] == GONE:
            k, damping = 0.0, 0.0
    i, j = state.ends[s, 0], state.ends[s, 1]
    p = ti.Vector.zero(state.real, plan.dim)
    if state.sweep[None] > 0:
        for axis in ti.static(range(plan.dim)):
            p[axis] = state.impulse[s, axis]
    v, far_v = site_value(plan, state.v, i), site_value(plan, state.v, j)
    w, far_w = mobility(plan, state, site_number, i), mobility(plan, state, site_number, j)
    d = site_value(plan, state.x, j) - site_value(plan, state.x, i)
    change = impulse_change(plan, state.dt[None], d, far_v - v, w + far_w, k, rest, damping, p)
    if state.sweep[None] + 1 < state.iterations[None]:
        for axis in ti.static(range(plan.dim)):
            state.impulse[s, axis] = p[axis] + change[axis]
    set_site_value(plan, state.v, i, v + w * change)
    set_site_value(plan, state.v, j, far_v - far_w * change)


@ti.func
def mobility(plan: ti.template(), state: ti.template(), number: ti.template(), i):
    """Inverse masses, of which drag is a part."""
    w = number(plan, state.w, i)
    if ti.static(plan.drag):
        w *= laws.drag_factor(w, number(plan, state.viscous, i), state.dt[None])
    return w


@ti.func
def impulse_change(plan: ti.template(), dt, d, dv, w, k, rest, c, p):
    """What a visit adds to the impulse p that pulls a spring's ends together.

    d: from one end to the other where the step began; dv: velocity of the other one relative to it;
    w: sum of their mobilities.
    """
    d += dt * dv
    length = laws.length(d)
    along = laws.unit(d, length)
    tension = laws.spring_tension(length, k, rest)
    stiffness = dt * k
    if ti.static(plan.dashpots):
        tension += laws.dashpot_tension(dv, along, c)
        stiffness += c
    missing = scaled(dt * tension, along) - p
    along_part = 1.0 / (1.0 + dt * w * stiffness)
    across_stiffness = laws.spring_stiffness_across(length, k, rest, 0.0)
    across_part = 1.0 / (1.0 + dt * dt * w * across_stiffness)
    more = (along_part - across_part) * dot(missing, along)
    return scaled(across_part, missing) + scaled(more, along)


@ti.func
def finish(plan: ti.template(), state: ti.template(), t):
    each_cell_moving(plan, state, t, move)
    each(plan, state, t, 1, _end_step)


@ti.func
def move(plan: ti.template(), state: ti.template(), c):
    x, v = read(plan, state.x, c), read(plan, state.v, c)
    old_v = read(plan, state.old_v, c)
    new_x = x + state.dt[None] * v
    store(plan, state, c, kept_above_floor(plan, state, c, x, old_v, new_x, v), v)


@ti.func
def _end_step(plan: ti.template(), state: ti.template(), i):
    state.work[SWEEPS] += state.iterations[None]
    state.phase[None] = DONE


PHASES = begin_step, sweep, finish
