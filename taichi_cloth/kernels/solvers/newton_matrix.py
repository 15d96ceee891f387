"""The matrix A of a Newton direction, A p = tau*M*residual: its products and its preconditioner.

A is that of `newton_cg.py`, never stored, only multiplied with vectors (`springs.accumulate`). All
products for a direction have the same springs, so these are computed once, when it is begun: the
direction of each, its stiffness along that and across it. The preconditioner is that of
`two_levels.py`, or else the diagonal of A with every spring counted along every axis. What solvers
for such a system share is here, too: how they begin, and how they hand over what they have found.
"""

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.forces import has_tractions
from taichi_cloth.kernels.graph import numbers_of
from taichi_cloth.kernels.grids import link_index, link_offset, pitch_of
from taichi_cloth.kernels.links import link_numbers, link_stiffness
from taichi_cloth.kernels.loops import each, each_pack, raise_to
from taichi_cloth.kernels.packs import (
    component,
    dot,
    everywhere,
    largest,
    read,
    set_slot_value,
    slot_number,
    slot_value,
    where_positive,
    write,
)
from taichi_cloth.kernels.solvers.fine_level import fine_downhill, fine_energies
from taichi_cloth.kernels.solvers.stages import (
    EVALUATE,
    FINISH,
    ITERATE,
    apart,
    momentum_of,
    outcome_of_rounding,
    own_diagonal,
    reachable_residual,
    roughness,
    whole_diagonal,
)
from taichi_cloth.kernels.solvers.two_levels import has_two_levels
from taichi_cloth.kernels.spring_numbers import OfStiffness
from taichi_cloth.kernels.springs import stiffness_of_springs

# This part of the residual is left to the next direction; of rough solutions up to ROUGHEST.
FORCING, ROUGHEST = 0.03, 0.2


# --- what is kept for all products of a direction -------------------------------------------------


@ti.func
def keep_springs(spec: ti.template(), state: ti.template(), t):
    """Keep the stiffness matrix of every spring, for `PRODUCT`."""
    if ti.static(spec.kinds > 0):
        each_pack(spec, state, t, _keep_links)
    if ti.static(spec.springs):
        each(spec, state, t, state.n_csr_rows[None], _keep_half_springs)


@ti.func
def _keep_links(spec: ti.template(), state: ti.template(), i):
    """Keep the stiffness matrices of the links that begin at pack i."""
    g = state.grid_of[i]
    if g >= 0:
        pitch = pitch_of(spec, state, g)
        longest = everywhere(spec, ti.cast(0.0, state.real))
        for s in range(spec.kinds):
            far, at = i + link_offset(state, s, pitch), link_index(state, s, i)
            k = link_stiffness(spec, state, s, i)
            numbers = link_numbers(spec, state, read, s, g, at, k)
            d = apart(spec, state, read, i, far)
            axis, across = _stiffness(spec, state, d, numbers)
            write(spec, state.link_axis, at, axis)
            write(spec, state.link_across, at, across)
            longest = ti.max(longest, ti.select(k > 0.0, laws.length(d), 0.0 * k))
        raise_to(state, state.longest[None], largest(spec, longest))


@ti.func
def _keep_half_springs(spec: ti.template(), state: ti.template(), p):
    """Keep the stiffness matrices of the half-springs of row p of the compressed rows."""
    slot = state.csr_slot[p]
    for h in range(state.csr_start[p], state.csr_start[p + 1]):
        d = apart(spec, state, slot_value, slot, state.csr_other[h])
        axis, across = _stiffness(spec, state, d, numbers_of(spec, state, h))
        for k in ti.static(range(spec.dim)):
            state.csr_axis[h, k] = axis[k]
        state.csr_across[h] = across
        raise_to(state, state.longest[None], laws.length(d))


@ti.func
def _stiffness(spec: ti.template(), state: ti.template(), d, numbers: ti.template()):
    """The axis of springs' stiffness matrices, and the stiffness across it."""
    return stiffness_of_springs(spec, d, state.tau[None], numbers, state.least[None])


# --- products ------------------------------------------------------------------------------------


@ti.func
def _product_between(
    spec: ti.template(), state: ti.template(), value: ti.template(), i, j, kept: ti.template()
):
    """The share of i from the spring to j in the product of K and dashpots with `direction`."""
    moved = value(spec, state.direction, j) - value(spec, state.direction, i)
    return laws.stiffness_product(moved, kept[0], kept[1])


PRODUCT = OfStiffness(_product_between)


@ti.func
def moved_apart(spec: ti.template(), state: ti.template(), value: ti.template(), i, j):
    """By how much `direction` moves j more than i: a product's vectors for stencils."""
    return value(spec, state.direction, j) - value(spec, state.direction, i)


@ti.func
def store_product(spec: ti.template(), state: ti.template(), i, pulled):
    """Store the product of A with `direction` in pack i; pulled: what it gets from its springs."""
    tau = state.tau[None]
    direction = read(spec, state.direction, i)
    product = own_diagonal(spec, state, i) * direction - (tau * tau) * pulled
    if ti.static(has_tractions(spec)):
        product += tau * read(spec, state.traction, i)
    w = read(spec, state.w, i)
    write(spec, state.product, i, where_positive(w, product, 0.0 * product))


@ti.func
def product_more(spec: ti.template(), state: ti.template(), slot, pulled):
    """Add what one particle gets from those springs that no grid holds to the product."""
    if slot_number(spec, state.w, slot) > 0.0:
        tau = state.tau[None]
        product = slot_value(spec, state.product, slot) - (tau * tau) * pulled
        set_slot_value(spec, state.product, slot, product)


# --- the preconditioner, where solvers begin and end --------------------------------------------


@ti.func
def preconditioned(spec: ti.template(), state: ti.template(), i, residual):
    """The residual of pack i, preconditioned; 0 where particles are fixed.

    Of two levels the coarse one has made its part of it, state.coarse_downhill, before.
    """
    if ti.static(has_two_levels(spec)):
        over = component(read(spec, state.over_pivots, i), 0)
        fine = fine_downhill(spec, state, i, residual)
        moved = read(spec, state.coarse_downhill, state.block_of[i])
        return fine + where_positive(over, moved, 0.0 * moved)
    else:
        return read(spec, state.over_diagonal, i) * residual


@ti.func
def energies_between(spec: ti.template(), state: ti.template(), i, a, b):
    """The products of the vectors a with a, a with b, and b with b, preconditioned, for pack i.

    Of two levels it is the fine one. The coarse one's products are those of all particles together
    (`coarse_level.coarse_dot`).
    """
    if ti.static(has_two_levels(spec)):
        return fine_energies(spec, state, i, a, b)
    else:
        over = read(spec, state.over_diagonal, i)
        return [dot(a, over * a), dot(a, over * b), dot(b, over * b)]


@ti.func
def _keep_over_diagonal(spec: ti.template(), state: ti.template(), i):
    """Keep one over the diagonal of A for pack i; 0 where particles are fixed."""
    tau = state.tau[None]
    w = read(spec, state.w, i)
    diagonal = whole_diagonal(spec, state, i)
    if ti.static(has_tractions(spec)):
        diagonal = diagonal + tau * read(spec, state.traction_damping, i)
    write(spec, state.over_diagonal, i, ti.select(w > 0.0, 1.0 / diagonal, 0.0 * w))


@ti.func
def first_energy(spec: ti.template(), state: ti.template(), i):
    """The energy of pack i's residual, which becomes tau*M times what it was; change becomes 0."""
    if ti.static(not has_two_levels(spec)):
        _keep_over_diagonal(spec, state, i)
    residual = momentum_of(spec, state, i, read(spec, state.residual, i))
    write(spec, state.residual, i, residual)
    write(spec, state.change, i, 0.0 * residual)
    return energies_between(spec, state, i, residual, residual)[0]


def _least(state):
    """A million times the smallest normal number: the least energy that still means something."""
    return 1e6 * (2.0**-1022 if state.real == ti.f64 else 2.0**-126)


@ti.func
def begin_iterating(spec: ti.template(), state: ti.template(), i):
    """Set the energy at which the iterations end, and go to their first step."""
    energy = state.sums[0, 0]
    least = ti.min(FORCING * roughness(state), ROUGHEST)
    part = ti.min(ti.max(0.3 * reachable_residual(state) / state.residual_max[None], least), 0.5)
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
    """Go on to where `change` leads, the solution as far as it is found.

    What of it is still to be added, state.ahead times `direction`, is added there.
    """
    state.directions[None] += 1
    state.trials[None] = 0
    state.length[None], state.go[None] = 1.0, 1.0
    state.short[None], state.short_slope[None], state.long[None] = 0.0, state.slope[None], 0.0
    state.phase[None] = EVALUATE
