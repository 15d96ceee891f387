"""Extended position-based dynamics: backward Euler, spring by spring, in coloured sweeps.

Macklin, Mueller, Chentanez, "XPBD: position-based simulation of compliant constrained dynamics",
2016; many small steps of few sweeps: Macklin et al., "Small steps in physics simulation", 2019.
First order, stable at every dt. One spring is solved by the first visit; many need more sweeps, the
more the stiffer they are and the more unequal the masses.

A spring of stiffness k = 1/compliance, damping c and tension T pulls its ends together by an
impulse p, the paper's multiplier over dt. It begins at zero and is kept from sweep to sweep, so
that the number of sweeps does not change the material. A visit changes it by the paper's formula,
with numerator and denominator divided by compliance/dt:

    p += (dt*T - p) / (1 + dt*(dt*k + c)*(w_i + w_j)).

The paper keeps only the multiplier's size, as if it had always pointed along the spring as it is
now. Here p is a vector, and its part across the spring is replaced too, with the stiffness across
the spring in the place of k. The first sweep is the paper's; many sweeps end at the solution of
backward Euler.

A stencil is a constraint whose curvature vector is to vanish. Its impulse, too, is a vector, which
a visit changes, p += (dt*pull - p) / (1 + dt^2*k*sum(weight^2*w)), for all of its particles.
"""

import math

import taichi as ti

from taichi_cloth.kernels.compensated import difference
from taichi_cloth.kernels.graph import number
from taichi_cloth.kernels.grids import link_index
from taichi_cloth.kernels.links import link_numbers, link_stiffness
from taichi_cloth.kernels.methods.contract import Claims, Method, backward_euler
from taichi_cloth.kernels.packs import (
    dot,
    read,
    set_slot_value,
    slot_number,
    slot_value,
    write,
    zeros,
)
from taichi_cloth.kernels.solvers import gauss_seidel
from taichi_cloth.kernels.solvers.colours import (
    colours_of_springs,
    colours_of_stencils,
    each_spring,
    each_stencil,
)
from taichi_cloth.kernels.solvers.gauss_seidel import apart_at_end, mobility, relative_velocity
from taichi_cloth.kernels.spring_numbers import fields_of
from taichi_cloth.kernels.springs import pull, stiffness_across, stiffness_along
from taichi_cloth.kernels.state import GONE
from taichi_cloth.kernels.stencils import curvature_of, line_curvature, pull_by, stiffness_by


@ti.func
def project(spec: ti.template(), state: ti.template(), t, colour):
    """Visit all springs, or all stencils, of one colour."""
    each_spring(spec, state, t, colour, project_links, project_spring)
    if ti.static(spec.line_kinds > 0 or spec.stencils):
        after = colour - colours_of_springs(spec, state)
        each_stencil(spec, state, t, after, project_lines, project_stencil)


@ti.func
def colours(spec: ti.template(), state: ti.template()):
    """The number of colours: those of springs, then those of stencils."""
    return colours_of_springs(spec, state) + colours_of_stencils(spec, state)


@ti.func
def project_links(spec: ti.template(), state: ti.template(), s, g, i, far, stiffness):
    """Visit the links of kind s in grid g between pack i and the later pack `far`.

    stiffness: the pack whose links have the stiffness that is theirs.
    """
    k = link_stiffness(spec, state, s, stiffness)
    at, p = link_index(state, s, i), zeros(spec, state)
    numbers = link_numbers(spec, state, read, s, g, at, k)
    if state.sweep[None] > 0:
        p = read(spec, state.link_impulse, at)
    v, far_v = read(spec, state.v, i), read(spec, state.v, far)
    w, far_w = mobility(spec, state, read, i), mobility(spec, state, read, far)
    d, dv = difference(spec, state, read, i, far), relative_velocity(spec, state, read, i, far)
    change = impulse_change(spec, state.dt[None], d, dv, w + far_w, numbers, p)
    if state.sweep[None] + 1 < state.iterations[None]:
        write(spec, state.link_impulse, at, p + change)
    write(spec, state.v, i, v + w * change)
    write(spec, state.v, far, far_v - far_w * change)


@ti.func
def project_spring(spec: ti.template(), state: ti.template(), s):
    """Visit spring s on the graph."""
    holds = True
    if ti.static(spec.fracture):
        holds = state.status[s] != GONE
    if holds:
        i, j = state.ends[s, 0], state.ends[s, 1]
        p = ti.Vector.zero(state.real, spec.dim)
        if state.sweep[None] > 0:
            for axis in ti.static(range(spec.dim)):
                p[axis] = state.impulse[s, axis]
        v, far_v = slot_value(spec, state.v, i), slot_value(spec, state.v, j)
        w, far_w = mobility(spec, state, slot_number, i), mobility(spec, state, slot_number, j)
        d = difference(spec, state, slot_value, i, j)
        dv = relative_velocity(spec, state, slot_value, i, j)
        numbers = [number(spec, field, s) for field in ti.static(fields_of(spec, state, "spring"))]
        change = impulse_change(spec, state.dt[None], d, dv, w + far_w, numbers, p)
        if state.sweep[None] + 1 < state.iterations[None]:
            for axis in ti.static(range(spec.dim)):
                state.impulse[s, axis] = p[axis] + change[axis]
        set_slot_value(spec, state.v, i, v + w * change)
        set_slot_value(spec, state.v, j, far_v - far_w * change)


@ti.func
def project_lines(spec: ti.template(), state: ti.template(), h, i, step):
    """Visit the stencils along lines of kind h that begin at pack i."""
    at, p, middle, last = link_index(state, h, i), zeros(spec, state), i + step, i + 2 * step
    if state.sweep[None] > 0:
        p = read(spec, state.line_impulse, at)
    k, dt = read(spec, state.line_k, at), state.dt[None]
    curvature = line_curvature(spec, state, apart_at_end, read, i, step)
    w, middle_w = mobility(spec, state, read, i), mobility(spec, state, read, middle)
    last_w = mobility(spec, state, read, last)
    resists = 1.0 + dt * dt * stiffness_by(spec, k) * (w + 4.0 * middle_w + last_w)
    change = (1.0 / resists) * (dt * pull_by(spec, curvature, k) - p)
    if state.sweep[None] + 1 < state.iterations[None]:
        write(spec, state.line_impulse, at, p + change)
    write(spec, state.v, i, read(spec, state.v, i) + w * change)
    moved = read(spec, state.v, middle) - 2.0 * middle_w * change
    write(spec, state.v, middle, moved)
    write(spec, state.v, last, read(spec, state.v, last) + last_w * change)


@ti.func
def project_stencil(spec: ti.template(), state: ti.template(), m):
    """Visit the listed stencil m."""
    p, dt, k = ti.Vector.zero(state.real, spec.dim), state.dt[None], state.stencil_k[m]
    if state.sweep[None] > 0:
        for axis in ti.static(range(spec.dim)):
            p[axis] = state.stencil_impulse[m, axis]
    curvature = curvature_of(spec, state, apart_at_end, m)
    moved = 0.0 * k
    for e in range(state.stencil_start[m], state.stencil_start[m + 1]):
        w = mobility(spec, state, slot_number, state.stencil_slot[e])
        moved += w * state.stencil_weight[e] * state.stencil_weight[e]
    resists = 1.0 + dt * dt * stiffness_by(spec, k) * moved
    change = (1.0 / resists) * (dt * pull_by(spec, curvature, k) - p)
    if state.sweep[None] + 1 < state.iterations[None]:
        for axis in ti.static(range(spec.dim)):
            state.stencil_impulse[m, axis] = p[axis] + change[axis]
    for e in range(state.stencil_start[m], state.stencil_start[m + 1]):
        i = state.stencil_slot[e]
        w = mobility(spec, state, slot_number, i)
        v = slot_value(spec, state.v, i) + w * state.stencil_weight[e] * change
        set_slot_value(spec, state.v, i, v)


@ti.func
def impulse_change(spec: ti.template(), dt, d, dv, w, numbers: ti.template(), p):
    """The change by a visit of the impulse p that pulls a spring's ends together.

    d: vectors from one end to the other at the step's start; dv: velocity of the other end relative
    to the first, as the sweeps have it; w: sum of their mobilities [1 / mass]; p: the impulse so
    far [force * time].
    """
    length, along, tension = pull(spec, d + dt * dv, dv, numbers)
    along_part = 1.0 / (1.0 + dt * w * stiffness_along(spec, dt, numbers))
    across = stiffness_across(spec, length, numbers, 0.0)
    across_part = 1.0 / (1.0 + dt * dt * w * across)
    # A stiff spring's tension is far larger than the impulse: it stays one number along the spring
    # and must not be taken apart into axes.
    has = dot(p, along)
    more = along_part * (dt * tension - has) + across_part * has
    return more * along - across_part * p


METHOD = Method(
    claims=Claims(
        order=1,
        symplectic=False,
        implicit=True,
        stability_limit=math.inf,
        forces=0,
        settings=("iterations",),
        choose=(
            "Stiff scenes whose frames must take a fixed time, masses alike: many substeps of few "
            "sweeps. Too few look like softer springs."
        ),
    ),
    position_weight=1.0,
    force_times=((0, 1.0),),
    phases=gauss_seidel.phases(colours, project),
    stability_function=backward_euler,  # once its sweeps have converged
    needs=("spring_colours",),
    **gauss_seidel.KEEPS,
)
