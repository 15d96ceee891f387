"""A preconditioner of two levels for Newton directions (`newton_matrix.py`), on processors.

The fine level is what A does to each particle alone (`fine_level.py`). The coarse level moves
*blocks* of particles, at most `state.MOST_BLOCKS` of them, as rigidly as springs between them
allow: with P, which gives every free particle of a block the block's movement, it is
P (P^T A P)^-1 P^T (`coarse_level.py`). Both levels are added. Smith, Bjorstad, Gropp, "Domain
decomposition", 1996, 1.3 and 2.1; Nicolaides, "Deflation of conjugate gradients with applications
to boundary value problems", SIAM J. Numer. Anal. 24, 1987 (such a P).

P^T A P is made once a step, where springs are stiff, and inverted: it serves all directions of the
step. It leaves out negative stiffness, and each diagonal is a little larger, so that the inverse is
positive in spite of rounding. What conjugate gradients ask of the coarse level follows from the
steps that they make (`conjugate_gradients.py`), with one product by the inverse for each.
"""

import taichi as ti

from taichi_cloth.kernels.forces import has_tractions
from taichi_cloth.kernels.loops import each
from taichi_cloth.kernels.solvers.coarse_level import clear_downhill, invert, solving
from taichi_cloth.kernels.solvers.graph_blocks import sum_blocks_of_graph, summing_members
from taichi_cloth.kernels.solvers.grid_blocks import sum_blocks_of_grids, summing_grids
from taichi_cloth.kernels.state import STIFF_ON_GRAPH, block_packs

# (tau*omega)^2, of which springs' stiffness and masses give a bound, from which blocks pay where
# all springs are links of grids.
STIFF = 100.0


def has_two_levels(spec):
    """True if directions are preconditioned so: A is symmetric, and all springs are links of grids,
    or all are on a graph, where the host has found them stiff.
    """
    return (spec.only_links or spec.blocks_on_graph) and not has_tractions(spec)


def stiff_from(spec):
    """The bound from which they do here."""
    return STIFF_ON_GRAPH if spec.blocks_on_graph else STIFF


@ti.func
def coarsen(spec: ti.template(), state: ti.template(), t):
    """Make the coarse matrix, and invert it; it comes after `newton_matrix.keep_springs`."""
    if ti.static(spec.blocks_on_graph):
        sum_blocks_of_graph(spec, state, t)
    else:
        sum_blocks_of_grids(spec, state, t)
    invert(spec, state, t)


@ti.func
def begin_coarse(spec: ti.template(), state: ti.template(), t):
    """Begin with the coarse level of the residual."""
    each(spec, state, t, ti.static(block_packs(spec) + 1), clear_downhill)
    _sum_and_solve(spec, state, t, "residual", "coarse_residual", "coarse_downhill")


@ti.func
def coarse_product(spec: ti.template(), state: ti.template(), t):
    """Compute the coarse level of a product, and what the inverse makes of it."""
    _sum_and_solve(spec, state, t, "product", "coarse_product", "coarse_solved")


def _summing(spec, name, to):
    """The body of a loop over coarse packs that sums the vectors `name` of their particles."""
    return (summing_members if spec.blocks_on_graph else summing_grids)(name, to)


@ti.func
def _sum_and_solve(
    spec: ti.template(),
    state: ti.template(),
    t,
    name: ti.template(),
    total: ti.template(),
    solved: ti.template(),
):
    """Sum vectors of particles over blocks, and multiply the sums by the inverse, into fields."""
    each(spec, state, t, state.n_blocks[None], ti.static(_summing(spec, name, total)))
    each(spec, state, t, state.n_blocks[None], ti.static(solving(total, solved)))
