"""BiCGSTAB for a Newton direction: A p = tau*M*residual, where A is not symmetric, as in air.

van der Vorst, "Bi-CGSTAB: a fast and smoothly converging variant of Bi-CG for the solution of
nonsymmetric linear systems", 1992, with inner products in the norm of the preconditioner
(`newton_matrix.py`). An iteration of two products is made in two halves, each with one: the first
goes along a conjugate direction, the second to where the residual along itself is least.

It ends, too, where the symmetric part of A is found to be not positive along a direction: what was
found so far is then taken, as in conjugate gradients (Steihaug, "The conjugate gradient method and
trust regions in large scale optimization", 1983).
"""

import taichi as ti

from taichi_cloth.kernels.loops import add_up, each, each_pack_moving
from taichi_cloth.kernels.packs import dot, read, write
from taichi_cloth.kernels.solvers.newton_matrix import (
    PRODUCT,
    begin_iterating,
    first_energy,
    keep_springs,
    moved_apart,
    preconditioned,
    product_more,
    store_product,
    take_change,
)
from taichi_cloth.kernels.solvers.stages import CLAMPED, SINGULAR
from taichi_cloth.kernels.springs import accumulate
from taichi_cloth.kernels.state import SWEEPS
from taichi_cloth.kernels.surfaces import compute_traction_damping, compute_traction_product

VECTORS = ("shadow", "search", "searched")  # the first residual; both halves' direction; A times it
SCALARS = ("rho", "alpha")  # shadow times residual; the step of the first half
COUNTS = ("second_half",)  # of a step: 0 or 1
MOST_PRODUCTS = 1000
ANY = 1e30  # a slope beside which every other is small


@ti.func
def direct(spec: ti.template(), state: ti.template(), t):
    """Begin: no change yet, the first direction is downhill."""
    keep_springs(spec, state, t)
    compute_traction_damping(spec, state, t)
    add_up(spec, state, t, first_energy, 0)
    each_pack_moving(spec, state, t, _begin_pack)
    each(spec, state, t, 1, _begin)


@ti.func
def _begin_pack(spec: ti.template(), state: ti.template(), i):
    residual = read(spec, state.residual, i)
    write(spec, state.shadow, i, residual)
    write(spec, state.search, i, residual)
    write(spec, state.direction, i, preconditioned(spec, state, i, residual))


@ti.func
def _begin(spec: ti.template(), state: ti.template(), i):
    begin_iterating(spec, state, i)
    state.rho[None], state.second_half[None] = state.sums[0, 0], 0
    state.ahead[None] = 0.0  # each half's step is made at once


@ti.func
def iterate(spec: ti.template(), state: ti.template(), t):
    """Make one half of an iteration."""
    compute_traction_product(spec, state, t)
    accumulate(spec, state, t, PRODUCT, moved_apart, store_product, product_more)
    add_up(spec, state, t, _along_itself, 0)  # in the second half: the residual's with A and itself
    add_up(spec, state, t, _tested, 1)
    add_up(spec, state, t, _approach, 2)
    add_up(spec, state, t, _shadowed, 3)
    add_up(spec, state, t, _slope, 4)
    each_pack_moving(spec, state, t, _turn)
    each(spec, state, t, 1, _count_half)


@ti.func
def _along_itself(spec: ti.template(), state: ti.template(), i):
    """The product of `direction` with A and itself, for pack i."""
    return dot(read(spec, state.direction, i), read(spec, state.product, i))


@ti.func
def _tested(spec: ti.template(), state: ti.template(), i):
    """What the length of a step is divided by: the product with the shadow, then with itself."""
    product = read(spec, state.product, i)
    other = read(spec, state.shadow, i)
    if state.second_half[None] == 1:
        other = product
    return dot(other, preconditioned(spec, state, i, product))


@ti.func
def _step_length(state: ti.template()):
    """The length of a half's step; 0 where A is not positive along it, or something overflows."""
    along_itself, tested = state.sums[0, 0], state.sums[1, 0]
    along = ti.select(state.second_half[None] == 0, state.rho[None], along_itself)
    goes = along_itself > 0.0 and (tested > 0.0 or tested < 0.0)
    return ti.select(goes, along / ti.select(goes, tested, 1.0), 0.0)


@ti.func
def _approach(spec: ti.template(), state: ti.template(), i):
    """Go a half in pack i, and return the energy of its new residual."""
    if state.second_half[None] == 0:
        write(spec, state.searched, i, read(spec, state.product, i))
    step = _step_length(state)
    change, direction = read(spec, state.change, i), read(spec, state.direction, i)
    residual, product = read(spec, state.residual, i), read(spec, state.product, i)
    write(spec, state.change, i, change + step * direction)
    residual = residual - step * product
    write(spec, state.residual, i, residual)
    return dot(residual, preconditioned(spec, state, i, residual))


@ti.func
def _shadowed(spec: ti.template(), state: ti.template(), i):
    """The product of the shadow with the residual, for pack i."""
    residual = preconditioned(spec, state, i, read(spec, state.residual, i))
    return dot(read(spec, state.shadow, i), residual)


@ti.func
def _slope(spec: ti.template(), state: ti.template(), i):
    """The product of `change` with the first residual, for pack i."""
    return dot(read(spec, state.change, i), read(spec, state.shadow, i))


@ti.func
def _turn(spec: ti.template(), state: ti.template(), i):
    """Set the direction of the next half in pack i."""
    along = read(spec, state.residual, i)
    if state.second_half[None] == 1:
        omega = _step_length(state)
        rho_omega = state.rho[None] * omega
        defined = rho_omega > 0.0 or rho_omega < 0.0
        beta = ti.select(defined, state.sums[3, 0] * state.alpha[None] / rho_omega, 0.0)
        search, searched = read(spec, state.search, i), read(spec, state.searched, i)
        along = along + beta * (search - omega * searched)
        write(spec, state.search, i, along)
    write(spec, state.direction, i, preconditioned(spec, state, i, along))


@ti.func
def _count_half(spec: ti.template(), state: ti.template(), i):
    """Count a half, and decide whether the iterations end with it."""
    step, energy = _step_length(state), state.sums[2, 0]
    if state.second_half[None] == 0:
        state.alpha[None], state.second_half[None] = step, 1
    else:
        state.rho[None], state.second_half[None] = state.sums[3, 0], 0
    state.slope[None] = state.sums[4, 0]
    state.energy[None] = energy
    state.sweeps[None] += 1
    state.work[SWEEPS] += 1
    ends = not (energy > state.goal[None]) or state.sweeps[None] >= MOST_PRODUCTS
    if step == 0.0:
        ends, state.indefinite[None] = True, 1
    if ends:
        go = 1.0
        # Where the change leads away: stay, and try the clamped K, if it was not.
        if not (state.slope[None] > 0.0):
            go, state.slope[None], state.indefinite[None] = 0.0, ANY, 1
            if state.least[None] == CLAMPED:
                state.outcome[None] = SINGULAR
        take_change(state)
        state.length[None], state.go[None] = go, go
