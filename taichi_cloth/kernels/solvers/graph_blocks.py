"""The blocks of a graph, which the host chooses, and the coarse matrix that its springs make.

They are as many particles each, tied to each other as far as may be (`adjacency.blocks`). Springs
between free particles of a block do nothing to its movement as one. What those to other blocks and
to fixed particles do is summed, and what stencils do.
"""

import functools

import taichi as ti

from taichi_cloth.kernels.loops import each
from taichi_cloth.kernels.packs import epsilon, zeros
from taichi_cloth.kernels.solvers.coarse_level import LIFTED, clear_rows, entry, part_of_springs
from taichi_cloth.kernels.solvers.stages import own_diagonal
from taichi_cloth.kernels.stencils import stiffness_by


@ti.func
def sum_blocks_of_graph(spec: ti.template(), state: ti.template(), t):
    """Make the coarse matrix."""
    each(spec, state, t, 1, _lay_out)
    each(spec, state, t, state.n_blocks[None], _sum_block)


@ti.func
def _lay_out(spec: ti.template(), state: ti.template(), _):
    state.n_blocks[None] = state.graph_blocks[None]


@ti.func
def _sum_block(spec: ti.template(), state: ti.template(), b):
    """Make the rows of the coarse matrix that belong to block b."""
    clear_rows(spec, state, b)
    on, beside = zeros(spec, state), zeros(spec, state)
    for m in range(state.members_start[b], state.members_start[b + 1]):
        i = state.members[m]
        if state.w[i] > 0.0:
            on += own_diagonal(spec, state, i)
            for h in range(state.csr_start[i], state.csr_start[i + 1]):
                other = state.csr_other[h]
                leaves, free = state.block_of[other] != b, state.w[other] > 0.0
                if leaves or not free:
                    axis = ti.Vector([state.csr_axis[h, k] for k in range(spec.dim)])
                    spring_on, spring_beside = part_of_springs(
                        spec, state, axis, state.csr_across[h]
                    )
                    on += spring_on
                    beside += spring_beside
                    if leaves and free:
                        to = state.block_of[other]
                        _add_to_rows(spec, state, b, -1.0 * spring_on, -1.0 * spring_beside, to)
            if ti.static(spec.stencils):
                for e in range(state.row_stencils[i], state.row_stencils[i + 1]):
                    on += _sum_stencil(spec, state, b, e)
    _add_to_rows(spec, state, b, ti.static(1.0 + LIFTED * epsilon(state)) * on, beside, b)


@ti.func
def _sum_stencil(spec: ti.template(), state: ti.template(), b, e):
    """The effect of block b's movement on part e of a stencil, on the diagonal; that of other
    blocks does is added to the coarse matrix.

    A stencil's weights add up to 0: so the first is what the weights outside the block lack.
    """
    own, none = zeros(spec, state), zeros(spec, state)
    m, tau = state.row_stencil[e], state.tau[None]
    k = tau * tau * stiffness_by(spec, state.stencil_k[m]) * state.row_weight[e]
    for place in range(state.stencil_start[m], state.stencil_start[m + 1]):
        other = state.stencil_slot[place]
        leaves, free = state.block_of[other] != b, state.w[other] > 0.0
        if leaves or not free:
            part = none + k * state.stencil_weight[place]
            own = own - part
            if leaves and free:
                _add_to_rows(spec, state, b, part, none, state.block_of[other])
    return own


@ti.func
def _add_to_rows(spec: ti.template(), state: ti.template(), b, on, beside, to):
    """Add a symmetric matrix to the rows of block b, in the columns of block `to`.

    on, beside: what is on its diagonal and beside that (xy, yz, zx).
    """
    for a, k in ti.static(ti.ndrange(spec.dim, spec.dim)):
        number = on[a]
        if ti.static(a != k):
            number = beside[a if (a + 1) % spec.dim == k else k]
        at = entry(spec, state, b * spec.dim + a, to * spec.dim + k)
        state.coarse[at] = state.coarse[at] + number  # += would be atomic


@functools.cache
def summing_members(name, to):
    """The body of a loop over blocks that sums the vectors `name` of their particles."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), b):
        total = zeros(spec, state)
        for m in range(state.members_start[b], state.members_start[b + 1]):
            total += ti.static(getattr(state, name))[state.members[m]]
        ti.static(getattr(state, to))[b] = total

    return body
