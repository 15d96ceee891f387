"""The fine level of a preconditioner (`two_levels.py`): what A does to each particle alone.

That is a block of dim x dim numbers. It is factored as L D L^T, and no pivot is less than the
particle's mass, as without rounding none would be; so it stays positive definite however stiff
springs are.
"""

import taichi as ti

from taichi_cloth.kernels.grids import link_index, link_offset, pitch_of
from taichi_cloth.kernels.loops import each, each_pack, each_row
from taichi_cloth.kernels.packs import component, dot, read, turned, vectors_of, write, zeros
from taichi_cloth.kernels.solvers.kept_links import renew_kept
from taichi_cloth.kernels.solvers.stages import NOT_YET, own_diagonal, whole_diagonal
from taichi_cloth.kernels.stencils import stiffness_by


@ti.func
def factor_particles(spec: ti.template(), state: ti.template(), t):
    """Factor what A does to each particle alone; it comes after `newton_matrix.keep_springs`.

    Where springs are soft, and blocks do not pay, the diagonal with every spring counted along
    every axis stands for it, which costs less than it needs sweeps.
    """
    if state.coarsened[None] != NOT_YET:
        if ti.static(spec.blocks_on_graph):
            each(spec, state, t, state.n_packs[None], _factor_particle)
        else:
            each_row(spec, state, t, renew_kept)
            each_row(spec, state, t, _factor_row)
    else:
        each_pack(spec, state, t, _take_diagonal)


@ti.func
def _factor_row(spec: ti.template(), state: ti.template(), begin, width):
    """Factor what A does to each particle of a row."""
    g = state.grid_of[begin]
    for i in range(begin, begin + width):
        on, beside = zeros(spec, state), zeros(spec, state)
        if g >= 0:  # on no grid nothing but masses and drag acts
            pitch = pitch_of(spec, state, g)
            row = (begin - state.grid[g, 0]) // pitch
            for end in range(2 * spec.kinds):  # links that begin at the pack, then those that end
                s = end % spec.kinds
                at = link_index(state, s, i)
                if end >= spec.kinds:
                    at -= link_offset(state, s, pitch)
                if end < spec.kinds or row >= state.link[s, 1]:
                    a = read(spec, state.link_axis, at)
                    c = ti.max(read(spec, state.link_across, at), 0.0)
                    on += a * a + c  # too much along springs that push
                    beside += a * turned(spec, a)
        _factor_pack(spec, state, i, on, beside)


@ti.func
def _factor_particle(spec: ti.template(), state: ti.template(), i):
    """Factor what A does to particle i of a graph."""
    on, beside = zeros(spec, state), zeros(spec, state)
    for h in range(state.csr_start[i], state.csr_start[i + 1]):
        if state.csr_other[h] != i:  # not gone
            a = ti.Vector([state.csr_axis[h, k] for k in range(spec.dim)])
            on += a * a + ti.max(state.csr_across[h], 0.0)
            beside += a * turned(spec, a)
    if ti.static(spec.stencils):
        for e in range(state.row_stencils[i], state.row_stencils[i + 1]):
            k = stiffness_by(spec, state.stencil_k[state.row_stencil[e]])
            on += k * state.row_weight[e] * state.row_weight[e]
    _factor_pack(spec, state, i, on, beside)


@ti.func
def _take_diagonal(spec: ti.template(), state: ti.template(), i):
    """Take `stages.whole_diagonal` for what A does to each particle of pack i alone."""
    w = read(spec, state.w, i)
    over = ti.select(w > 0.0, 1.0 / whole_diagonal(spec, state, i), 0.0 * w)
    write(spec, state.over_pivots, i, vectors_of(spec, [over for _ in ti.static(range(spec.dim))]))
    write(spec, state.below, i, zeros(spec, state))


@ti.func
def _factor_pack(spec: ti.template(), state: ti.template(), i, on, beside):
    """Factor A of each particle of pack i, from the sums over its springs.

    on: the diagonal; beside: what stands beside it, xy, and in space yz and zx.
    """
    w, tau = read(spec, state.w, i), state.tau[None]
    least = ti.select(w > 0.0, own_diagonal(spec, state, i), 0.0 * w + 1.0)
    k = tau * tau
    xy = k * component(beside, 0)
    p0 = least + ti.max(k * component(on, 0), 0.0)
    below = xy / p0
    p1 = ti.max(least + k * component(on, 1) - below * xy, least)
    none = 0.0 * w
    over0, over1 = ti.select(w > 0.0, 1.0 / p0, none), ti.select(w > 0.0, 1.0 / p1, none)
    if ti.static(spec.dim == 2):
        write(spec, state.over_pivots, i, vectors_of(spec, [over0, over1]))
        write(spec, state.below, i, vectors_of(spec, [below, none]))
    else:
        zx = k * component(beside, 2)
        yz = k * component(beside, 1) - below * zx
        below2, below1 = zx / p0, yz / p1
        p2 = ti.max(least + k * component(on, 2) - below2 * zx - below1 * yz, least)
        over2 = ti.select(w > 0.0, 1.0 / p2, none)
        write(spec, state.over_pivots, i, vectors_of(spec, [over0, over1, over2]))
        write(spec, state.below, i, vectors_of(spec, [below, below1, below2]))


@ti.func
def _lowered(spec: ti.template(), below, r):
    """L^-1 r for pack i's vectors r."""
    first = component(r, 0)
    second = component(r, 1) - component(below, 0) * first
    if ti.static(spec.dim == 2):
        return vectors_of(spec, [first, second])
    else:
        third = component(r, 2) - component(below, 2) * first - component(below, 1) * second
        return vectors_of(spec, [first, second, third])


@ti.func
def fine_energies(spec: ti.template(), state: ti.template(), i, a, b):
    """The products of the vectors a with a, a with b, and b with b, for pack i, preconditioned by
    the fine level.
    """
    below, over = read(spec, state.below, i), read(spec, state.over_pivots, i)
    low_a, low_b = _lowered(spec, below, a), _lowered(spec, below, b)
    return [dot(low_a, over * low_a), dot(low_a, over * low_b), dot(low_b, over * low_b)]


@ti.func
def fine_downhill(spec: ti.template(), state: ti.template(), i, residual):
    """The residual of pack i, preconditioned by the fine level; 0 where particles are fixed."""
    below = read(spec, state.below, i)
    over = read(spec, state.over_pivots, i)
    z = over * _lowered(spec, below, residual)
    if ti.static(spec.dim == 2):
        second = component(z, 1)
        first = component(z, 0) - component(below, 0) * second
        z = vectors_of(spec, [first, second])
    else:
        third = component(z, 2)
        second = component(z, 1) - component(below, 1) * third
        first = component(z, 0) - component(below, 0) * second - component(below, 2) * third
        z = vectors_of(spec, [first, second, third])
    return z
