"""Surfaces: triangles between particles, whole or torn, and what they give their corners.

A triangle is gone when a spring along one of its sides is gone. That is asked of the springs
themselves whenever triangles are looked at, so it depends on no launch, and what is restored or
loaded needs nothing besides.

What triangles give their corners is computed once for each, then gathered particle by particle, in
the order of the triangles: no atomics, and the same bits for every number of threads and on both
topologies. Forces on triangles ("traction" in `forces/contract.py`) see one velocity, the mean of
their corners' by the share that each has of the triangle, and each corner gets its share of the
force: so what a force takes from that velocity it takes from the particles, no more and no less.
"""

import functools

import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.compensated import difference
from taichi_cloth.kernels.fields import Surface
from taichi_cloth.kernels.forces import has_tractions, load
from taichi_cloth.kernels.forces.contract import TRACTION, has
from taichi_cloth.kernels.loops import each, is_short
from taichi_cloth.kernels.packs import (
    set_slot_number,
    set_slot_value,
    slot_number,
    slot_value,
)
from taichi_cloth.kernels.state import GONE


def tractions(spec):
    """The terms of a specialization that act on triangles."""
    found = [load(name) for name in spec.terms]
    return [term for term in found if term.adds == TRACTION]


def _parts(spec, part):
    """The functions that are one part ("law", "damping", ...) of the terms that have this part."""
    return [getattr(term, part) for term in tractions(spec) if has(getattr(term, part))]


@ti.func
def is_whole(spec: ti.template(), state: ti.template(), surface: ti.template(), m):
    """True if none of the springs along the sides of triangle m is gone."""
    gone = 0
    if ti.static(spec.fracture):
        for k in ti.static(range(3)):
            if _is_gone(spec, state, surface.side[m, k]):
                gone = 1
    return gone == 0


@ti.func
def holds(spec: ti.template(), state: ti.template(), surface: ti.template(), m, k):
    """True if there is a spring along side k of triangle m that is not gone."""
    s = surface.side[m, k]
    return s != -1 and not _is_gone(spec, state, s)


@ti.func
def _is_gone(spec: ti.template(), state: ti.template(), s):
    """True if the spring of a side is gone; s: as `surface.side` has it, -1 where there is none."""
    gone = False
    if ti.static(spec.springs):
        if s >= 0 and state.status[s] == GONE:
            gone = True
    if ti.static(spec.kinds > 0):
        if s < -1 and slot_number(spec, state.link_status, -2 - s) == GONE:
            gone = True
    return gone


@ti.func
def cross(a, b):
    """The vector product of two vectors of three components."""
    return ti.Vector(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


@ti.func
def edge(spec: ti.template(), state: ti.template(), i, j):
    """The vector from the particle in slot i to that in slot j."""
    return difference(spec, state, slot_value, i, j)


@ti.func
def area_vector(a, b):
    """The area of a triangle times its normal, from two of its edges a and b (3,).

    The edges lead from one corner to the next and to the one after that.
    """
    return 0.5 * cross(a, b)


@ti.func
def in_space(spec: ti.template(), a):
    """A vector in three components, the last of them 0 in a plane."""
    if ti.static(spec.dim == 3):
        return a
    else:
        return ti.Vector([a[0], a[1], 0.0 * a[0]])


@ti.func
def gathered(state: ti.template(), surface: ti.template(), p, shared: ti.template()):
    """The sum of the vectors of the triangles at the particle of row p, in their order (3,).

    shared: whether it gets its share of each, or the whole.
    """
    total = ti.Vector.zero(state.real, 3)
    for h in range(surface.row_start[p], surface.row_start[p + 1]):
        m = surface.row_triangle[h]
        for axis in ti.static(range(3)):
            if ti.static(shared):
                total[axis] += surface.row_share[h] * surface.vector[m, axis]
            else:
                total[axis] += surface.vector[m, axis]
    return total


# --- forces on triangles -----------------------------------------------------------------------


@ti.func
def compute_tractions(
    spec: ti.template(), state: ti.template(), t, time: ti.template(), ahead: ti.template()
):
    """Compute state.traction, what the forces on triangles give each particle.

    It comes before forces are added up, with top-level loops where each step is a launch, and does
    nothing in a scene without such forces.
    time(state): the scene's time; ahead: whether particles are taken where their velocities bring
    them by the end of the step, as solvers do that keep positions until then.
    """
    if ti.static(has_tractions(spec)):
        each(spec, state, t, 1, ti.static(_preparing(time)))
        each(spec, state, t, state.surface.n_triangles[None], ti.static(_pulling(ahead)))
        each(spec, state, t, state.surface.n_rows[None], _gather)


@functools.cache
def _preparing(time):
    """The body of a loop, run once, that computes what the laws need besides the state."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), i):
        for prepare in ti.static(_parts(spec, "prepare")):
            prepare(spec, state, time(state))

    return body


@functools.cache
def _pulling(ahead):
    """The body of a loop over triangles that computes the force on each."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), m):
        force = ti.Vector.zero(state.real, 3)
        if is_whole(spec, state, state.surface, m):
            area, v = _area_and_velocity(spec, state, m, ahead)
            for law in ti.static(_parts(spec, "law")):
                force += law(spec, state, area, v)
        _set_vector(state, m, force)

    return body


@ti.func
def _set_vector(state: ti.template(), m, vector):
    for axis in ti.static(range(3)):
        state.surface.vector[m, axis] = vector[axis]


@ti.func
def _area_and_velocity(spec: ti.template(), state: ti.template(), m, ahead: ti.template()):
    """The area vector of triangle m and the mean velocity of its corners."""
    i, j, k = state.surface.corner[m, 0], state.surface.corner[m, 1], state.surface.corner[m, 2]
    v_i = _velocity(spec, state, i, ahead)
    v_j, v_k = _velocity(spec, state, j, ahead), _velocity(spec, state, k, ahead)
    a, b = edge(spec, state, i, j), edge(spec, state, i, k)
    if ti.static(ahead):
        a += state.dt[None] * (v_j - v_i)
        b += state.dt[None] * (v_k - v_i)
    return area_vector(a, b), _mean(state, m, v_i, v_j, v_k)


@ti.func
def _velocity(spec: ti.template(), state: ti.template(), i, ahead: ti.template()):
    """The velocity of the particle in slot i; ahead: as `gauss_seidel.py` has it in its sweeps."""
    v = slot_value(spec, state.v, i)
    if ti.static(ahead and spec.compensated):
        v += slot_value(spec, state.goal_v, i)
    return v


@ti.func
def _mean(state: ti.template(), m, at_i, at_j, at_k):
    """The mean of what the corners of triangle m have, by their shares of it."""
    share = ti.static(state.surface.share)
    return share[m, 0] * at_i + share[m, 1] * at_j + share[m, 2] * at_k


@ti.func
def _gather(spec: ti.template(), state: ti.template(), p):
    total = gathered(state, state.surface, p, True)
    set_slot_value(spec, state.traction, state.surface.row_slot[p], total)


@ti.func
def compute_traction_damping(spec: ti.template(), state: ti.template(), t):
    """Compute state.traction_damping, a bound on the damping of each particle by its triangles.

    That of a triangle acts on its mean velocity along its normal, and is shared by the products of
    its corners' shares: a matrix that is at most the diagonal one of each corner's share of it.
    """
    if ti.static(has_tractions(spec)):
        each(spec, state, t, state.surface.n_triangles[None], _damp)
        each(spec, state, t, state.surface.n_rows[None], _gather_damping)


@ti.func
def _damp(spec: ti.template(), state: ti.template(), m):
    damping = ti.Vector.zero(state.real, 3)
    if is_whole(spec, state, state.surface, m):
        area, v = _area_and_velocity(spec, state, m, False)
        damping[0] = _damping(spec, state, area, v)
    _set_vector(state, m, damping)


@ti.func
def _damping(spec: ti.template(), state: ti.template(), area, v):
    """The damping of a triangle's mean velocity along its normal, by all forces on triangles."""
    total = 0.0 * v[0]
    for damping in ti.static(_parts(spec, "damping")):
        total += damping(spec, state, area, v)
    return total


@ti.func
def _gather_damping(spec: ti.template(), state: ti.template(), p):
    total = gathered(state, state.surface, p, True)
    set_slot_number(spec, state.traction_damping, state.surface.row_slot[p], total[0])


@ti.func
def keep_tractions(spec: ti.template(), state: ti.template(), t):
    """Keep what `compute_traction_product` needs of the forces on triangles at the present state.

    It also computes state.traction_damping.
    """
    each(spec, state, t, state.surface.n_triangles[None], _keep_triangle)
    each(spec, state, t, state.surface.n_rows[None], _gather_damping)


@ti.func
def _keep_triangle(spec: ti.template(), state: ti.template(), m):
    pressure = ti.cast(0.0, state.real)
    area, by_v = ti.Vector.zero(state.real, 3), ti.Vector.zero(state.real, 3)
    a, b, by_area, damping = 0.0 * area, 0.0 * area, 0.0 * area, 0.0 * area
    if is_whole(spec, state, state.surface, m):
        area, v = _area_and_velocity(spec, state, m, False)
        damping[0] = _damping(spec, state, area, v)
        for gradient in ti.static(_parts(spec, "gradient")):
            p, p_by_v, p_by_area = gradient(spec, state, area, v)
            pressure += p
            by_v += p_by_v
            by_area += p_by_area
        i, j, k = state.surface.corner[m, 0], state.surface.corner[m, 1], state.surface.corner[m, 2]
        half = 0.5 * state.tau[None]
        a, b = half * edge(spec, state, i, j), half * edge(spec, state, i, k)
    kept = ti.static(state.surface.kept)
    for axis in ti.static(range(3)):
        kept[m, Surface.EDGE + axis], kept[m, Surface.OTHER_EDGE + axis] = a[axis], b[axis]
        kept[m, Surface.AREA + axis] = area[axis]
        kept[m, Surface.BY_V + axis], kept[m, Surface.BY_AREA + axis] = by_v[axis], by_area[axis]
    kept[m, Surface.PRESSURE] = pressure
    _set_vector(state, m, damping)


@ti.func
def _kept(state: ti.template(), m, first: ti.template()):
    """A vector of what is kept of triangle m."""
    return ti.Vector([state.surface.kept[m, first + axis] for axis in range(3)])


@ti.func
def compute_traction_product(spec: ti.template(), state: ti.template(), t):
    """Compute into state.traction by how much it falls along state.direction.

    That is a change of the velocities, which moves particles by state.tau times it. It comes after
    `keep_tractions`.
    """
    if ti.static(has_tractions(spec)):
        each(spec, state, t, state.surface.n_triangles[None], _change)
        each(spec, state, t, state.surface.n_rows[None], _gather)


@ti.func
def _change(spec: ti.template(), state: ti.template(), m):
    """By how much the force on triangle m, -P area, falls."""
    i, j, k = state.surface.corner[m, 0], state.surface.corner[m, 1], state.surface.corner[m, 2]
    moved = slot_value(spec, state.direction, i)
    moved_j, moved_k = slot_value(spec, state.direction, j), slot_value(spec, state.direction, k)
    a, b = _kept(state, m, Surface.EDGE), _kept(state, m, Surface.OTHER_EDGE)
    by_v, by_area = _kept(state, m, Surface.BY_V), _kept(state, m, Surface.BY_AREA)
    d_area = cross(moved_j - moved, b) + cross(a, moved_k - moved)
    d_pressure = by_v.dot(_mean(state, m, moved, moved_j, moved_k)) + by_area.dot(d_area)
    pressure = state.surface.kept[m, Surface.PRESSURE]
    _set_vector(state, m, d_pressure * _kept(state, m, Surface.AREA) + pressure * d_area)


# --- to the host --------------------------------------------------------------------------------


@kernel
def compute_normals(
    spec: ti.template(),
    state: ti.template(),
    surface: ti.template(),
    normals: ti.types.ndarray(),
):
    """Compute the unit normal of each particle at a triangle, in the rows of `normals` (n, 3).

    It is that of the sum of the area vectors of the whole triangles at it, each the normal times
    the area (Max, "Weights for computing vertex normals from facet normals", 1999, calls it the
    mean weighted by areas). Zero where none is whole, or where they cancel.
    """
    if ti.static(is_short(surface.corner.shape[0])):
        ti.loop_config(serialize=True)
    for m in range(surface.n_triangles[None]):
        area = ti.Vector.zero(state.real, 3)
        if is_whole(spec, state, surface, m):
            i, j, k = surface.corner[m, 0], surface.corner[m, 1], surface.corner[m, 2]
            a, b = edge(spec, state, i, j), edge(spec, state, i, k)
            area = area_vector(in_space(spec, a), in_space(spec, b))
        for axis in ti.static(range(3)):
            surface.vector[m, axis] = area[axis]
    # Else those at no triangle come back from Vulkan as what an earlier array left on the device.
    if ti.static(is_short(surface.corner.shape[0])):
        ti.loop_config(serialize=True)
    for i in range(normals.shape[0]):
        for axis in ti.static(range(3)):
            normals[i, axis] = 0.0
    if ti.static(is_short(surface.corner.shape[0])):
        ti.loop_config(serialize=True)
    for p in range(surface.n_rows[None]):
        total = gathered(state, surface, p, False)
        largest = ti.max(ti.max(ti.abs(total[0]), ti.abs(total[1])), ti.abs(total[2]))
        scale = ti.select(largest > 0.0, 1.0 / largest, 0.0)
        total = scale * total  # so that no square vanishes
        length = ti.sqrt(total[0] * total[0] + total[1] * total[1] + total[2] * total[2])
        scale = ti.select(largest > 0.0, 1.0 / length, 0.0)
        i = slot_number(spec, state.particle, surface.row_slot[p])
        for axis in ti.static(range(3)):
            normals[i, axis] = scale * total[axis]
