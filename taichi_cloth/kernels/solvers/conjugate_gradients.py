"""Conjugate gradients for a Newton direction: A p = tau*M*residual, where A is symmetric.

Their steps are made in one pass over memory, which computes the product of A with the direction and
all sums: the residual's energy after a step follows from sums of before it, so that the next
direction needs no pass of its own, and is then computed again, so that rounding does not add up.
Chen, Carson, "Predict-and-recompute conjugate gradient variants", SIAM J. Sci. Comput. 42, 2020
(PR-CG); Shewchuk, "An introduction to the conjugate gradient method without the agonizing pain",
1994, B3. The matrix and its preconditioner are those of `newton_matrix.py`.
"""

import taichi as ti

from taichi_cloth.kernels.links import Pass, nothing
from taichi_cloth.kernels.loops import add_up, each, each_pack
from taichi_cloth.kernels.packs import dot, plus, read, write
from taichi_cloth.kernels.solvers.coarse_level import coarse_dot, step_coarse
from taichi_cloth.kernels.solvers.fine_level import factor_particles
from taichi_cloth.kernels.solvers.newton_matrix import (
    PRODUCT,
    begin_iterating,
    energies_between,
    first_energy,
    keep_springs,
    moved_apart,
    preconditioned,
    product_more,
    store_product,
    take_change,
)
from taichi_cloth.kernels.solvers.stages import BEFORE, CLAMPED, JUST_NOW, SINGULAR
from taichi_cloth.kernels.solvers.two_levels import (
    begin_coarse,
    coarse_product,
    has_two_levels,
)
from taichi_cloth.kernels.springs import accumulate_and_join
from taichi_cloth.kernels.state import SWEEPS

SUMS = 4
CURVATURE, ENERGY, MIXED, OF_PRODUCT = range(SUMS)  # those of a step (`_sums`)


@ti.func
def direct(spec: ti.template(), state: ti.template(), t):
    """Begin conjugate gradients: no change yet."""
    if ti.static(has_two_levels(spec)):
        if state.coarsened[None] != JUST_NOW:
            keep_springs(spec, state, t)
        factor_particles(spec, state, t)
    else:
        keep_springs(spec, state, t)
    add_up(spec, state, t, first_energy, 0)
    if ti.static(has_two_levels(spec)):
        begin_coarse(spec, state, t)
    each_pack(spec, state, t, _begin_pack)
    each(spec, state, t, 1, _begin)


@ti.func
def _begin_pack(spec: ti.template(), state: ti.template(), i):
    """Make the first direction of pack i the one downhill: there is none before it."""
    none = 0.0 * read(spec, state.change, i)
    write(spec, state.direction, i, none)
    write(spec, state.product, i, none)


@ti.func
def _begin(spec: ti.template(), state: ti.template(), i):
    if ti.static(has_two_levels(spec)):
        on_blocks = coarse_dot(spec, state, state.coarse_residual, state.coarse_downhill)
        state.sums[0, 0] += on_blocks
        if state.coarsened[None] == JUST_NOW:
            state.coarsened[None] = BEFORE
    begin_iterating(spec, state, i)
    state.ahead[None], state.part[None] = 0.0, 0.0


@ti.func
def iterate(spec: ti.template(), state: ti.template(), t):
    """Make one step of conjugate gradients, and compute how far the next one goes."""
    accumulate_and_join(spec, state, t, ti.static(STEP), product_more)
    if ti.static(has_two_levels(spec)):
        coarse_product(spec, state, t)
    each(spec, state, t, 1, _count_iteration)


@ti.func
def _step(spec: ti.template(), state: ti.template(), i):
    """Go a step in pack i, and set its next direction."""
    ahead, direction = state.ahead[None], read(spec, state.direction, i)
    write(spec, state.change, i, read(spec, state.change, i) + ahead * direction)
    residual = read(spec, state.residual, i) - ahead * read(spec, state.product, i)
    write(spec, state.residual, i, residual)
    downhill = preconditioned(spec, state, i, residual)
    write(spec, state.direction, i, downhill + state.part[None] * direction)


@ti.func
def _sums(spec: ti.template(), state: ti.template(), i):
    """The terms of pack i in the sums of a step.

    CURVATURE is the product of `direction` with A and itself; then, preconditioned, ENERGY is that
    of the residual with itself, MIXED of the residual with the product of A and `direction`, and
    OF_PRODUCT of this with itself.
    """
    product = read(spec, state.product, i)
    curvature = dot(read(spec, state.direction, i), product)
    return [curvature] + energies_between(spec, state, i, read(spec, state.residual, i), product)


def _changed(state):
    """The changes by a step of what neighbours read."""
    return (state.direction,)


STEP = Pass(
    PRODUCT,
    moved_apart,
    store_product,
    move=_step,
    numbers=_sums,
    ops=(plus,) * SUMS,
    moved=_changed,
    consumed=nothing,
)


@ti.func
def _count_iteration(spec: ti.template(), state: ti.template(), i):
    """Count a step of conjugate gradients, and decide whether they end with it.

    The step itself, state.ahead times the direction, is made in the pass that comes next.
    """
    curvature, energy = state.sums[CURVATURE, 0], state.sums[ENERGY, 0]
    mixed, of_product = state.sums[MIXED, 0], state.sums[OF_PRODUCT, 0]
    if ti.static(has_two_levels(spec)):
        solved = ti.static(state.coarse_solved)
        energy += coarse_dot(spec, state, state.coarse_residual, state.coarse_downhill)
        mixed += coarse_dot(spec, state, state.coarse_residual, solved)
        of_product += coarse_dot(spec, state, state.coarse_product, solved)
    # 0 where A is not positive along the direction, or numbers are no longer finite.
    step = ti.select(curvature > 0.0, energy / ti.select(curvature > 0.0, curvature, 1.0), 0.0)
    after = energy + step * (step * of_product - 2.0 * mixed)
    state.ahead[None], state.energy[None] = step, ti.max(after, 0.0)
    state.part[None] = ti.select(energy > 0.0, ti.max(after, 0.0) / energy, 0.0)
    if ti.static(has_two_levels(spec)):
        step_coarse(spec, state, step)
    state.slope[None] = state.slope[None] + step * energy  # += would be atomic
    state.sweeps[None] += 1
    state.work[SWEEPS] += 1
    most = 2 * spec.dim * state.n[None] + 20
    ends = not (after > state.goal[None]) or state.sweeps[None] >= most
    if not (step > 0.0):
        # With the exact K, A may be indefinite; the change so far is downhill. With a clamped K it
        # is positive definite, unless numbers are no longer finite.
        ends, state.indefinite[None] = True, 1
        if state.least[None] == CLAMPED:
            state.outcome[None] = SINGULAR
    if ends:
        take_change(state)
