"""The matrix A of a Newton direction, A p = tau*M*residual: its products and its preconditioner.

A is that of `newton_cg.py`, never stored, only multiplied with vectors (`springs.accumulate`). The
preconditioner is its diagonal, with every spring counted along every axis. What solvers for such a
system share is here, too: how they begin, and how they hand over what they have found.
"""

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.accelerations import (
    binds,
    damping_of,
    resists,
    stiffness_of,
)
from taichi_cloth.kernels.forces import has_tractions
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
    FINISH,
    ITERATE,
    SHIFT,
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
from taichi_cloth.kernels.surfaces import compute_traction_product

FORCING = 0.1  # this part of the residual is left to the next direction


# --- products ------------------------------------------------------------------------------------


@ti.func
def multiply(spec: ti.template(), state: ti.template(), t):
    """Compute state.product, the product of A with state.direction."""
    compute_traction_product(spec, state, t)
    accumulate(spec, state, t, _product_between, _moved_apart, _store_product, _product_more)


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


# --- the preconditioner, where solvers begin and end --------------------------------------------


@ti.func
def preconditioned(spec: ti.template(), state: ti.template(), i, residual):
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
def first_energy(spec: ti.template(), state: ti.template(), i):
    """The energy of pack i's residual, which becomes tau*M times what it was; change becomes 0."""
    residual = momentum_of(spec, state, i, read(spec, state.residual, i))
    write(spec, state.residual, i, residual)
    write(spec, state.change, i, 0.0 * residual)
    return dot(residual, preconditioned(spec, state, i, residual))


@ti.func
def downhill(spec: ti.template(), state: ti.template(), i):
    """Set the first direction of conjugate gradients in pack i."""
    residual = read(spec, state.residual, i)
    write(spec, state.direction, i, preconditioned(spec, state, i, residual))


@ti.func
def curvature(spec: ti.template(), state: ti.template(), i):
    """The product of `direction` with A and itself, for pack i."""
    return dot(read(spec, state.direction, i), read(spec, state.product, i))


@ti.func
def go_along(spec: ti.template(), state: ti.template(), i, step):
    """Go a step along `direction` in pack i, and return the energy of its new residual."""
    change, direction = read(spec, state.change, i), read(spec, state.direction, i)
    residual, product = read(spec, state.residual, i), read(spec, state.product, i)
    write(spec, state.change, i, change + step * direction)
    residual = residual - step * product
    write(spec, state.residual, i, residual)
    return dot(residual, preconditioned(spec, state, i, residual))


def _least(state):
    """A million times the smallest normal number: the least energy that still means something."""
    return 1e6 * (2.0**-1022 if state.real == ti.f64 else 2.0**-126)


@ti.func
def begin_iterating(spec: ti.template(), state: ti.template(), i):
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
def take_change(state: ti.template()):
    """Go on to where `change` leads, the solution as far as it is found."""
    state.directions[None] += 1
    state.trials[None] = 0
    state.length[None], state.go[None] = 1.0, 1.0
    state.short[None], state.short_slope[None], state.long[None] = 0.0, state.slope[None], 0.0
    state.phase[None] = SHIFT
