"""Stencils: what curvature vectors give their particles, along the lines of grids and on the graph.

A stencil has a curvature vector, the weighted sum of its particles' positions. Those terms of the
scene that act on curvature (`forces/`) make of it a *pull*: each particle gets the pull times its
weight. That is linear, so a product with the stiffness matrix is the same sum over another field:
whoever sums says by apart(spec, state, value, i, j) which vectors, from i to j, are meant.

In grids, stencils of weights (1, -2, 1) lie along *lines*, of which there are two kinds: in rows
and in columns. Like a link, such a one is known by its kind and the pack of its earliest particle;
its pulls go through the ring (`links.pass_over_rows`). All others are listed, on the graph: first
all pulls are computed, then each particle sums over those that it is in. Nothing is scattered.
"""

import functools

import taichi as ti

from taichi_cloth.kernels.forces import load
from taichi_cloth.kernels.forces.contract import CURVATURE
from taichi_cloth.kernels.grids import link_index, pitch_of
from taichi_cloth.kernels.loops import each
from taichi_cloth.kernels.packs import read, slot_value, write, zeros

# --- the terms on curvature ----------------------------------------------------------------------


def _parts(spec, part):
    """The functions that are one part of the terms that act on curvature."""
    found = [load(name) for name in spec.terms]
    return [getattr(term, part) for term in found if term.adds == CURVATURE]


@ti.func
def pull_by(spec: ti.template(), curvature, k):
    """The force on a particle of weight 1 of stencils with these curvature vectors; k: theirs."""
    total = 0.0 * curvature
    for law in ti.static(_parts(spec, "law")):
        total += law(curvature, k)
    return total


@ti.func
def stiffness_by(spec: ti.template(), k):
    """By how much that force falls with the curvature vector."""
    total = 0.0 * k
    for stiffness in ti.static(_parts(spec, "stiffness")):
        total += stiffness(k)
    return total


# --- along the lines of grids --------------------------------------------------------------------


@ti.func
def line_step(state: ti.template(), h, pitch):
    """The number of packs from one particle of a line of kind h to the next."""
    return state.line[h, 0] + state.line[h, 1] * pitch


@ti.func
def line_curvature(
    spec: ti.template(), state: ti.template(), apart: ti.template(), value: ti.template(), i, step
):
    """The second difference of the vectors at i, i + step, i + 2 step, over weight of the first."""
    middle = i + step
    before = apart(spec, state, value, middle, i)
    return before + apart(spec, state, value, middle, middle + step)


@ti.func
def line_pull(spec: ti.template(), state: ti.template(), apart: ti.template(), h, i, step):
    """The pull on the outer particles of the stencils of kind h that begin at pack i."""
    curvature = line_curvature(spec, state, apart, read, i, step)
    return pull_by(spec, curvature, read(spec, state.line_k, link_index(state, h, i)))


@ti.func
def compute_lines(spec: ti.template(), state: ti.template(), apart: ti.template(), i, pitch, to):
    """Compute the pulls of the stencils that begin at pack i, into the ring at `to`."""
    for h in range(spec.line_kinds):
        value = line_pull(spec, state, apart, h, i, line_step(state, h, pitch))
        write(spec, state.ring_forces, (spec.kinds + h) * state.ring_size + to, value)


@ti.func
def sum_of_lines(spec: ti.template(), state: ti.template(), apart: ti.template(), i):
    """The sum over all lines at pack i, each pull computed by each of its particles: for GPUs."""
    g, total = state.grid_of[i], zeros(spec, state)
    if g >= 0:
        pitch = pitch_of(spec, state, g)
        for h in range(spec.line_kinds):
            step = line_step(state, h, pitch)
            for place in range(3):
                pull = line_pull(spec, state, apart, h, i - place * step, step)
                total += ti.select(place == 1, -2.0, 1.0) * pull
    return total


# --- on the graph --------------------------------------------------------------------------------


@ti.func
def curvature_of(spec: ti.template(), state: ti.template(), apart: ti.template(), m):
    """The curvature vector of the listed stencil m."""
    first = state.stencil_start[m]
    here = state.stencil_slot[first]
    total = ti.Vector.zero(state.real, spec.dim)
    for e in range(first + 1, state.stencil_start[m + 1]):
        away = apart(spec, state, slot_value, here, state.stencil_slot[e])
        total += state.stencil_weight[e] * away
    return total


@ti.func
def pull_listed(spec: ti.template(), state: ti.template(), t, apart: ti.template()):
    """Compute the pulls of all listed stencils: before any `sum_of_listed`."""
    if ti.static(spec.stencils):
        each(spec, state, t, state.n_stencils[None], ti.static(_pulling(apart)))


@functools.cache
def _pulling(apart):
    """The body of a loop over listed stencils that computes the pull of each."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), m):
        pull = pull_by(spec, curvature_of(spec, state, apart, m), state.stencil_k[m])
        for axis in ti.static(range(spec.dim)):
            state.stencil_pull[m, axis] = pull[axis]

    return body


@ti.func
def sum_of_listed(spec: ti.template(), state: ti.template(), p):
    """The sum of what the particle of row p of the compressed rows gets from listed stencils."""
    total = ti.Vector.zero(state.real, spec.dim)
    for e in range(state.row_stencils[p], state.row_stencils[p + 1]):
        m = state.row_stencil[e]
        for axis in ti.static(range(spec.dim)):
            total[axis] += state.row_weight[e] * state.stencil_pull[m, axis]
    return total


# --- particle by particle ------------------------------------------------------------------------


@ti.func
def with_lines(
    spec: ti.template(),
    state: ti.template(),
    apart: ti.template(),
    value: ti.template(),
    number_at: ti.template(),
    stride: ti.template(),
    g,
    i,
    pulled,
    stiff,
):
    """The force on i, and its stiffness in every direction, with those of all lines at i added.

    value, number_at: read fields of vectors and of numbers at i; stride: by how much i grows from
    one pack to the next: 1 where i is a pack, spec.lanes where it is a slot; g: its grid.
    """
    pitch = pitch_of(spec, state, g)
    total, along = pulled, stiff
    for q in range(3 * spec.line_kinds):
        h, place = q // 3, q % 3
        step = line_step(state, h, pitch) * stride
        begin = i - place * step
        k = number_at(spec, state.line_k, h * state.packs * stride + begin)
        weight = ti.select(place == 1, -2.0, 1.0)
        pull = pull_by(spec, line_curvature(spec, state, apart, value, begin, step), k)
        total += weight * pull
        along += weight * weight * stiffness_by(spec, k)
    return total, along


@ti.func
def with_listed(spec: ti.template(), state: ti.template(), apart: ti.template(), p, pulled, stiff):
    """The same with those of the listed stencils of row p of the compressed rows.

    Where pulls are kept, they are those of `pull_listed`, and each visit ends by `follow_listed`.
    """
    total, along = pulled, stiff
    for e in range(state.row_stencils[p], state.row_stencils[p + 1]):
        m, weight = state.row_stencil[e], state.row_weight[e]
        k = state.stencil_k[m]
        if ti.static(spec.keeps_pulls):
            for axis in ti.static(range(spec.dim)):
                total[axis] += weight * state.stencil_pull[m, axis]
        else:
            total += weight * pull_by(spec, curvature_of(spec, state, apart, m), k)
        along += weight * weight * stiffness_by(spec, k)
    return total, along


@ti.func
def follow_listed(spec: ti.template(), state: ti.template(), p, moved):
    """Change the pulls of the listed stencils of row p for the way that its particle has moved.

    Pulls are linear in positions. Particles of one stencil do not move at once, so nothing here
    is an atomic sum.
    """
    for e in range(state.row_stencils[p], state.row_stencils[p + 1]):
        m = state.row_stencil[e]
        change = pull_by(spec, state.row_weight[e] * moved, state.stencil_k[m])
        for axis in ti.static(range(spec.dim)):
            state.stencil_pull[m, axis] = state.stencil_pull[m, axis] + change[axis]
