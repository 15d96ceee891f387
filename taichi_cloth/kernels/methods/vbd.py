"""Vertex block descent: backward Euler, particle by particle, in coloured sweeps.

Chen, Liu, Yang, Yuksel, "Vertex block descent", ACM Transactions on Graphics 43, 2024. First order,
stable at every dt. Backward Euler is the least of inertia and elastic energy (with what dashpots
and drag take); each visit moves one particle by a Newton step towards it while its neighbours stay
where they are:

    (1 + w*sum(dt*c + dt^2*K)) change = goal_v - v + dt*w*sum(T).

The sums are over the particle's springs, with their tension T as a vector and their stiffness
matrix K, whose negative eigenvalues are set to 0. Sweeps begin at the velocity without springs.
There are no multipliers: stiff springs between equal masses, and a heavy particle on a light one,
need many sweeps, and momentum is kept only as far as the sweeps have converged.
"""

import math

import taichi as ti

from taichi_cloth.kernels.compensated import difference
from taichi_cloth.kernels.graph import number
from taichi_cloth.kernels.grids import link_offset, pitch_of
from taichi_cloth.kernels.links import link_numbers
from taichi_cloth.kernels.methods.contract import Claims, Method, backward_euler
from taichi_cloth.kernels.packs import (
    component,
    read,
    slot_number,
    slot_value,
    with_component,
    zeros,
)
from taichi_cloth.kernels.solvers import gauss_seidel
from taichi_cloth.kernels.solvers.colours import (
    colours_of_particles,
    each_particle,
    renew_both_halos,
)
from taichi_cloth.kernels.solvers.gauss_seidel import (
    apart_at_end,
    mobility,
    relative_velocity,
    short_of_goal,
)
from taichi_cloth.kernels.spring_numbers import fields_of
from taichi_cloth.kernels.springs import pull, stiffness_across, stiffness_along
from taichi_cloth.kernels.stencils import follow_listed, pull_listed, with_lines, with_listed


@ti.func
def prepare(spec: ti.template(), state: ti.template(), t):
    """Compute what visits read: halos, and pulls of listed stencils, which follow each visit."""
    renew_both_halos(spec, state, t)
    if ti.static(spec.keeps_pulls):
        pull_listed(spec, state, t, apart_at_end)


@ti.func
def relax(spec: ti.template(), state: ti.template(), t, colour):
    """Visit all particles of one colour."""
    each_particle(spec, state, t, colour, relaxed_pack, relaxed_particle)


@ti.func
def relaxed_pack(spec: ti.template(), state: ti.template(), g, i):
    """The new velocities in pack i of grid g, by its links."""
    v, none = read(spec, state.v, i), zeros(spec, state)
    w = mobility(spec, state, read, i)
    pulled, hx, hy, hz = with_links(spec, state, read, read, 1, g, i, w, none, none, none, none)
    if ti.static(spec.line_kinds > 0):
        bent, k = with_lines(spec, state, apart_at_end, read, read, 1, g, i, none, 0.0 * w)
        pulled, hx, hy, hz = with_stencils(spec, state.dt[None], w, bent, k, pulled, hx, hy, hz)
    return v + solution(spec, hx, hy, hz, short_of_goal(spec, state, read, i) + pulled)


@ti.func
def relaxed_particle(spec: ti.template(), state: ti.template(), p):
    """The new velocity of the particle of row p of the compressed rows, by all its springs."""
    i, none = state.csr_slot[p], ti.Vector.zero(state.real, spec.dim)
    w = mobility(spec, state, slot_number, i)
    pulled, hx, hy, hz = none, none, none, none
    if ti.static(spec.kinds > 0):
        g = state.grid_of[i // spec.lanes]
        if g >= 0:
            pulled, hx, hy, hz = with_links(
                spec, state, slot_value, slot_number, spec.lanes, g, i, w, pulled, hx, hy, hz
            )
    for h in range(state.csr_start[p], state.csr_start[p + 1]):
        j = state.csr_other[h]
        if j != i:  # else the spring is gone
            d = difference(spec, state, slot_value, i, j)
            dv = relative_velocity(spec, state, slot_value, i, j)
            numbers = [number(spec, field, h) for field in ti.static(fields_of(spec, state, "csr"))]
            pulled, hx, hy, hz = with_spring(
                spec, state.dt[None], w, d, dv, numbers, pulled, hx, hy, hz
            )
    if ti.static(spec.line_kinds > 0 or spec.stencils):
        bent, k = none, 0.0 * w
        if ti.static(spec.line_kinds > 0):
            g = state.grid_of[i // spec.lanes]
            if g >= 0:
                bent, k = with_lines(
                    spec, state, apart_at_end, slot_value, slot_number, spec.lanes, g, i, bent, k
                )
        if ti.static(spec.stencils):
            bent, k = with_listed(spec, state, apart_at_end, p, bent, k)
        pulled, hx, hy, hz = with_stencils(spec, state.dt[None], w, bent, k, pulled, hx, hy, hz)
    b = short_of_goal(spec, state, slot_value, i) + pulled
    change = solution(spec, hx, hy, hz, b)
    if ti.static(spec.keeps_pulls):
        follow_listed(spec, state, p, state.dt[None] * change)
    return slot_value(spec, state.v, i) + change


@ti.func
def with_links(
    spec: ti.template(),
    state: ti.template(),
    value: ti.template(),
    number_at: ti.template(),
    stride: ti.template(),
    g,
    i,
    w,
    pulled,
    hx,
    hy,
    hz,
):
    """The sums pulled, hx, hy, hz of `with_spring`, with all links of i added.

    value, number_at: read fields of vectors and of numbers at i; stride: by how much i grows from
    one pack to the next: 1 where i is a pack, spec.lanes where it is a slot; g: its grid; w: its
    mobility.
    """
    pitch = pitch_of(spec, state, g)
    for q in range(2 * spec.kinds):  # in the order in which a graph has them
        s, j, owner = q, i, i
        if q < spec.kinds:
            j = i - link_offset(state, s, pitch) * stride
            owner = j
        else:
            s = state.forward[q - spec.kinds]
            j = i + link_offset(state, s, pitch) * stride
        at = s * state.packs * stride + owner
        k = number_at(spec, state.link_k, at)
        numbers = link_numbers(spec, state, number_at, s, g, at, k)
        d = difference(spec, state, value, i, j)
        dv = relative_velocity(spec, state, value, i, j)
        pulled, hx, hy, hz = with_spring(
            spec, state.dt[None], w, d, dv, numbers, pulled, hx, hy, hz
        )
    return pulled, hx, hy, hz


@ti.func
def with_spring(spec: ti.template(), dt, w, d, dv, numbers: ti.template(), pulled, hx, hy, hz):
    """The sums over a particle's springs, with one more spring added to them.

    w: the particle's mobility; d, dv: position at the step's start and present velocity of the
    spring's other end, relative to the particle. pulled: dt*w*sum(T); hx, hy, hz: the rows of
    w*sum(dt*c + dt^2*K), of which hz is only used in 3-D.
    """
    length, along, tension = pull(spec, d + dt * dv, dv, numbers)
    stiffness = stiffness_along(spec, dt, numbers)
    across = dt * dt * w * stiffness_across(spec, length, numbers, 0.0)
    more = (dt * w * stiffness - across) * along
    new_pull = pulled + dt * w * tension * along
    x, y, z = hx, hy, hz
    x += component(along, 0) * more
    x = with_component(x, 0, component(x, 0) + across)
    y += component(along, 1) * more
    y = with_component(y, 1, component(y, 1) + across)
    if ti.static(spec.dim == 3):
        z += component(along, 2) * more
        z = with_component(z, 2, component(z, 2) + across)
    return new_pull, x, y, z


@ti.func
def with_stencils(spec: ti.template(), dt, w, bent, k, pulled, hx, hy, hz):
    """The sums of `with_spring`, with what stencils add to them.

    bent: the force of a particle's stencils; k: their stiffness, in every direction.
    """
    across = dt * dt * w * k
    x, y, z = hx, hy, hz
    x = with_component(x, 0, component(x, 0) + across)
    y = with_component(y, 1, component(y, 1) + across)
    if ti.static(spec.dim == 3):
        z = with_component(z, 2, component(z, 2) + across)
    return pulled + dt * w * bent, x, y, z


@ti.func
def solution(spec: ti.template(), hx, hy, hz, b):
    """The solution x of (1 + H) x = b, where hx, hy, hz are the rows of the symmetric matrix H.

    It is found by the factors L D L^T of 1 + H (Golub, Van Loan, Matrix Computations, chapter 4).
    """
    d0 = 1.0 + component(hx, 0)
    l1 = component(hx, 1) / d0
    d1 = 1.0 + component(hy, 1) - l1 * component(hx, 1)
    y0 = component(b, 0)
    y1 = component(b, 1) - l1 * y0
    x = b
    if ti.static(spec.dim == 3):
        l2 = component(hx, 2) / d0
        m = component(hy, 2) - l1 * component(hx, 2)
        l3 = m / d1
        d2 = 1.0 + component(hz, 2) - l2 * component(hx, 2) - l3 * m
        x2 = (component(b, 2) - l2 * y0 - l3 * y1) / d2
        x1 = y1 / d1 - l3 * x2
        x = with_component(x, 2, x2)
        x = with_component(x, 1, x1)
        x = with_component(x, 0, y0 / d0 - l1 * x1 - l2 * x2)
    else:
        x1 = y1 / d1
        x = with_component(x, 1, x1)
        x = with_component(x, 0, y0 / d0 - l1 * x1)
    return x


METHOD = Method(
    claims=Claims(
        order=1,
        symplectic=False,
        implicit=True,
        stability_limit=math.inf,
        forces=0,
        settings=("iterations",),
        choose=(
            "Where too few sweeps should look like more inertia and not like softer springs; else "
            "xpbd, which gets nearer in the same time."
        ),
    ),
    position_weight=1.0,
    force_times=((0, 1.0),),
    phases=gauss_seidel.phases(colours_of_particles, relax, prepare),
    stability_function=backward_euler,  # once its sweeps have converged
    needs=("particle_colours",),
    **gauss_seidel.KEEPS,
)
