"""BiCGSTAB for a Newton direction: A p = tau*M*residual, where A is not symmetric, as in air.

van der Vorst, "Bi-CGSTAB: a fast and smoothly converging variant of Bi-CG for the solution of
nonsymmetric linear systems", 1992, with inner products in the norm of the preconditioner
(`newton_matrix.py`). An iteration of two products is made in two halves, each with one: the first
goes along a conjugate direction, the second to where the residual along itself is least.

A half goes over all particles twice: it makes the step that the half before it has found, and sets
its direction; then it computes the product of A with that, and all sums. What these are after its
own step follows from them, as in `conjugate_gradients.py`, and is computed again in the next half.

It ends, too, where the symmetric part of A is found to be not positive along a direction: what was
found so far is then taken, as in conjugate gradients (Steihaug, "The conjugate gradient method and
trust regions in large scale optimization", 1983).
"""

import taichi as ti

from taichi_cloth.kernels.links import Pass, nothing
from taichi_cloth.kernels.loops import add_up, each, each_pack, each_pack_moving
from taichi_cloth.kernels.packs import dot, plus, read, write
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
from taichi_cloth.kernels.springs import accumulate_and_join
from taichi_cloth.kernels.state import SWEEPS
from taichi_cloth.kernels.surfaces import compute_traction_product, keep_tractions

VECTORS = ("shadow", "search", "searched")  # the first residual; a first half's direction; A of it
SCALARS = ("rho", "alpha")  # shadow times residual; the step of the first half
COUNTS = ("second_half",)  # of an iteration: 0 or 1
SUMS = 8
# Those of a half (`_sums`).
CURVATURE, BY_SHADOW, MIXED, OF_PRODUCT, ENERGY, SHADOWED, GONE, SLOPE = range(SUMS)
MOST_PRODUCTS = 1000
ANY = 1e30  # a slope beside which every other is small


@ti.func
def direct(spec: ti.template(), state: ti.template(), t):
    """Begin: no change yet, the first direction is downhill."""
    keep_springs(spec, state, t)
    keep_tractions(spec, state, t)
    add_up(spec, state, t, first_energy, 0)
    each_pack(spec, state, t, _begin_pack)
    each(spec, state, t, 1, _begin)


@ti.func
def _begin_pack(spec: ti.template(), state: ti.template(), i):
    residual = read(spec, state.residual, i)
    write(spec, state.shadow, i, residual)
    for field in ti.static((state.search, state.searched, state.direction, state.product)):
        write(spec, field, i, 0.0 * residual)


@ti.func
def _begin(spec: ti.template(), state: ti.template(), i):
    begin_iterating(spec, state, i)
    state.rho[None], state.second_half[None] = state.sums[0, 0], 0
    state.ahead[None], state.part[None] = 0.0, 0.0


@ti.func
def iterate(spec: ti.template(), state: ti.template(), t):
    """Make one half of an iteration."""
    each_pack_moving(spec, state, t, _step)  # all of it before the product with what triangles give
    compute_traction_product(spec, state, t)
    accumulate_and_join(spec, state, t, ti.static(HALF), product_more)
    each(spec, state, t, 1, _count_half)


@ti.func
def _step(spec: ti.template(), state: ti.template(), i):
    """Make the last half's step in pack i, and set the direction of this one.

    That of a first half is `search`, made anew of the one before, of which state.part is taken over
    as the second half's step, state.ahead, has left it.
    """
    ahead, direction = state.ahead[None], read(spec, state.direction, i)
    product = read(spec, state.product, i)
    write(spec, state.change, i, read(spec, state.change, i) + ahead * direction)
    residual = read(spec, state.residual, i) - ahead * product
    write(spec, state.residual, i, residual)
    along = residual
    if state.second_half[None] == 1:
        write(spec, state.searched, i, product)
    else:
        search, searched = read(spec, state.search, i), read(spec, state.searched, i)
        along = residual + state.part[None] * (search - ahead * searched)
        write(spec, state.search, i, along)
    write(spec, state.direction, i, preconditioned(spec, state, i, along))


@ti.func
def _sums(spec: ti.template(), state: ti.template(), i):
    """The terms of pack i in the sums of a half.

    CURVATURE is the product of `direction` with A and itself. Preconditioned are BY_SHADOW, MIXED
    and OF_PRODUCT, of the product (that of A and `direction`) with the shadow, the residual and
    itself, and ENERGY and SHADOWED, of the residual with itself and the shadow. GONE and SLOPE are
    those of `change` and of `direction` with the first residual.
    """
    product, residual = read(spec, state.product, i), read(spec, state.residual, i)
    shadow, direction = read(spec, state.shadow, i), read(spec, state.direction, i)
    of_product = preconditioned(spec, state, i, product)
    of_residual = preconditioned(spec, state, i, residual)
    return [
        dot(direction, product),
        dot(shadow, of_product),
        dot(residual, of_product),
        dot(product, of_product),
        dot(residual, of_residual),
        dot(shadow, of_residual),
        dot(read(spec, state.change, i), shadow),
        dot(direction, shadow),
    ]


HALF = Pass(
    PRODUCT,
    moved_apart,
    store_product,
    numbers=_sums,
    ops=(plus,) * SUMS,
    consumed=nothing,
)


@ti.func
def _count_half(spec: ti.template(), state: ti.template(), i):
    """Count a half, and decide whether the iterations end with it.

    Its step, state.ahead times the direction, is made in the pass that comes next.
    """
    curvature, by_shadow = state.sums[CURVATURE, 0], state.sums[BY_SHADOW, 0]
    mixed, of_product = state.sums[MIXED, 0], state.sums[OF_PRODUCT, 0]
    energy, shadowed = state.sums[ENERGY, 0], state.sums[SHADOWED, 0]
    first = state.second_half[None] == 0
    # The product of the residual with that of A and itself is the curvature, in the second half.
    along = ti.select(first, state.rho[None], curvature)
    over = ti.select(first, by_shadow, of_product)
    # 0 where A is not positive along the direction, or something overflows.
    goes = curvature > 0.0 and (over > 0.0 or over < 0.0)
    step = ti.select(goes, along / ti.select(goes, over, 1.0), 0.0)
    after = energy + step * (step * of_product - 2.0 * mixed)
    if first:
        state.alpha[None], state.second_half[None] = step, 1
    else:
        rho, before = shadowed - step * by_shadow, state.rho[None] * step
        defined = before > 0.0 or before < 0.0
        state.part[None] = ti.select(
            defined, rho * state.alpha[None] / ti.select(defined, before, 1.0), 0.0
        )
        state.rho[None], state.second_half[None] = rho, 0
    state.ahead[None], state.energy[None] = step, ti.max(after, 0.0)
    state.slope[None] = state.sums[GONE, 0] + step * state.sums[SLOPE, 0]
    state.sweeps[None] += 1
    state.work[SWEEPS] += 1
    ends = not (after > state.goal[None]) or state.sweeps[None] >= MOST_PRODUCTS
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
