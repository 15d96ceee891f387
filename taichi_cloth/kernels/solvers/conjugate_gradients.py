"""Conjugate gradients for a Newton direction: A p = tau*M*residual, matrix-free.

A is that of `newton_cg.py`, never stored, only multiplied with vectors (`springs.accumulate`). The
preconditioner is its diagonal, with every spring counted along every axis. Shewchuk, "An
introduction to the conjugate gradient method without the agonizing pain", 1994, B3.
"""

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.accelerations import (
    binds,
    damping_of,
    resists,
    stiffness_of,
)
from taichi_cloth.kernels.loops import add_up, each, each_pack_moving
from taichi_cloth.kernels.packs import (
    dot,
    read,
    scaled,
    set_slot_value,
    slot_number,
    slot_value,
    where_positive,
    write,
)
from taichi_cloth.kernels.solvers.stages import (
    CLAMPED,
    FINISH,
    ITERATE,
    SHIFT,
    SINGULAR,
    mass_of,
    momentum_of,
    outcome_of_rounding,
    wanted_residual,
)
from taichi_cloth.kernels.springs import (
    accumulate,
    reads_velocity,
    stiffness_product,
)
from taichi_cloth.kernels.state import SWEEPS, has_tractions
from taichi_cloth.kernels.surfaces import compute_damping_product, compute_traction_damping

FORCING = 0.1  # this part of the residual is left to the next direction


@ti.func
def direct(spec: ti.template(), state: ti.template(), t):
    """Begin conjugate gradients: no change yet, the first direction is downhill."""
    compute_traction_damping(spec, state, t)
    add_up(spec, state, t, _first_energy, 0)
    each_pack_moving(spec, state, t, _downhill)
    each(spec, state, t, 1, _begin_iterating)


@ti.func
def _first_energy(spec: ti.template(), state: ti.template(), i):
    """The energy of pack i's residual, which becomes tau*M times what it was; change becomes 0."""
    residual = momentum_of(spec, state, i, read(spec, state.residual, i))
    write(spec, state.residual, i, residual)
    write(spec, state.change, i, 0.0 * residual)
    return dot(residual, _preconditioned(spec, state, i, residual))


@ti.func
def _downhill(spec: ti.template(), state: ti.template(), i):
    """Set the first direction of conjugate gradients in pack i."""
    residual = read(spec, state.residual, i)
    write(spec, state.direction, i, _preconditioned(spec, state, i, residual))


@ti.func
def _preconditioned(spec: ti.template(), state: ti.template(), i, residual):
    """The residual of pack i over the diagonal of A; 0 where particles are fixed."""
    tau = state.tau[None]
    w = read(spec, state.w, i)
    diagonal = mass_of(spec, state, i) + tau * tau * read(spec, state.summed_k, i)
    if ti.static(binds(spec)):
        diagonal = diagonal + tau * tau * stiffness_of(spec, state, read, i)
    if ti.static(resists(spec)):
        diagonal = diagonal + tau * damping_of(spec, state, read, i)
    if ti.static(has_tractions(spec)):
        diagonal = diagonal + tau * read(spec, state.traction_damping, i)
    if ti.static(reads_velocity(spec)):
        diagonal = diagonal + tau * read(spec, state.summed_c, i)
    return scaled(ti.select(w > 0.0, 1.0 / diagonal, 0.0 * w), residual)


@ti.func
def iterate(spec: ti.template(), state: ti.template(), t):
    """Make one step of conjugate gradients."""
    compute_damping_product(spec, state, t)
    accumulate(spec, state, t, _product_between, _moved_apart, _store_product, _product_more)
    add_up(spec, state, t, _curvature, 0)
    add_up(spec, state, t, _approach, 1)
    each_pack_moving(spec, state, t, _turn)
    each(spec, state, t, 1, _count_iteration)


@ti.func
def _product_between(
    spec: ti.template(), state: ti.template(), value: ti.template(), i, j, numbers: ti.template()
):
    """What i gets from the spring to j in the product of K and dashpots with `direction`."""
    d = value(spec, state.x, j) - value(spec, state.x, i)
    length = laws.length(d)
    along = laws.unit(d, length)
    moved = value(spec, state.direction, j) - value(spec, state.direction, i)
    least = state.least[None]
    return stiffness_product(spec, moved, length, along, state.tau[None], numbers, least)


@ti.func
def _moved_apart(spec: ti.template(), state: ti.template(), value: ti.template(), i, j):
    """By how much `direction` moves j more than i: a product's vectors for stencils."""
    return value(spec, state.direction, j) - value(spec, state.direction, i)


@ti.func
def _store_product(spec: ti.template(), state: ti.template(), i, pulled):
    """Store the product of A with `direction` in pack i; pulled: what it gets from its springs."""
    tau = state.tau[None]
    direction = read(spec, state.direction, i)
    diagonal = mass_of(spec, state, i)
    if ti.static(binds(spec)):
        diagonal = diagonal + tau * tau * stiffness_of(spec, state, read, i)
    if ti.static(resists(spec)):
        diagonal = diagonal + tau * damping_of(spec, state, read, i)
    product = scaled(diagonal, direction) - (tau * tau) * pulled
    if ti.static(has_tractions(spec)):
        product += tau * read(spec, state.traction, i)
    w = read(spec, state.w, i)
    write(spec, state.product, i, where_positive(w, product, 0.0 * product))


@ti.func
def _product_more(spec: ti.template(), state: ti.template(), slot, pulled):
    """Add what one particle gets from those springs that no grid holds to the product."""
    if slot_number(spec, state.w, slot) > 0.0:
        tau = state.tau[None]
        product = slot_value(spec, state.product, slot) - (tau * tau) * pulled
        set_slot_value(spec, state.product, slot, product)


@ti.func
def _approach(spec: ti.template(), state: ti.template(), i):
    """Go a step along `direction` in pack i, and return the energy of its new residual."""
    step = _step_length(state)
    change, direction = read(spec, state.change, i), read(spec, state.direction, i)
    residual, product = read(spec, state.residual, i), read(spec, state.product, i)
    write(spec, state.change, i, change + step * direction)
    residual = residual - step * product
    write(spec, state.residual, i, residual)
    return dot(residual, _preconditioned(spec, state, i, residual))


@ti.func
def _turn(spec: ti.template(), state: ti.template(), i):
    """Set the next direction of conjugate gradients in pack i."""
    part = state.sums[1, 0] / state.energy[None]
    residual = _preconditioned(spec, state, i, read(spec, state.residual, i))
    write(spec, state.direction, i, residual + part * read(spec, state.direction, i))


def _least(state):
    """A million times the smallest normal number: the least energy that still means something."""
    return 1e6 * (2.0**-1022 if state.real == ti.f64 else 2.0**-126)


@ti.func
def _begin_iterating(spec: ti.template(), state: ti.template(), i):
    """Set the energy at which conjugate gradients end, and go to their first step."""
    energy = state.sums[0, 0]
    part = ti.min(ti.max(0.3 * wanted_residual(state) / state.residual_max[None], FORCING), 0.5)
    state.energy[None], state.goal[None] = energy, part * part * energy
    state.slope[None] = 0.0
    state.sweeps[None] = 0
    state.phase[None] = ITERATE
    if energy < ti.static(_least(state)):  # what is left is too small to be squared
        state.outcome[None] = outcome_of_rounding(state)
        state.step_outcome[None] = ti.max(state.step_outcome[None], state.outcome[None])
        state.phase[None] = FINISH


@ti.func
def _curvature(spec: ti.template(), state: ti.template(), i):
    """The product of `direction` with A and itself, for pack i."""
    return dot(read(spec, state.direction, i), read(spec, state.product, i))


@ti.func
def _step_length(state: ti.template()):
    """The length of a step of conjugate gradients.

    It is 0 where A is not positive along the direction, or numbers are no longer finite.
    """
    curvature = state.sums[0, 0]
    return ti.select(curvature > 0.0, state.energy[None] / curvature, 0.0)


@ti.func
def _count_iteration(spec: ti.template(), state: ti.template(), i):
    """Count a step of conjugate gradients, and decide whether they end with it."""
    energy, step = state.sums[1, 0], _step_length(state)
    state.slope[None] += step * state.energy[None]
    state.energy[None] = energy
    state.sweeps[None] += 1
    state.work[SWEEPS] += 1
    most = 2 * spec.dim * state.n[None] + 20
    ends = not (energy > state.goal[None]) or state.sweeps[None] >= most
    if not (step > 0.0):
        # With the exact K, A may be indefinite; the change so far is downhill. With a clamped K it
        # is positive definite, unless numbers are no longer finite.
        ends, state.indefinite[None] = True, 1
        if state.least[None] == CLAMPED:
            state.outcome[None] = SINGULAR
    if ends:
        state.directions[None] += 1
        state.trials[None] = 0
        state.length[None], state.go[None] = 1.0, 1.0
        state.short[None], state.short_slope[None], state.long[None] = 0.0, state.slope[None], 0.0
        state.phase[None] = SHIFT
