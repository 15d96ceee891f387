"""Surfaces: triangles between particles, whole or torn, and what they add up at their corners.

A triangle is gone when a spring along one of its sides is gone. That is asked of the springs
themselves whenever triangles are looked at, so it depends on no launch, and what is restored or
loaded needs nothing besides.

What triangles give their corners is gathered particle by particle, in the order of the triangles:
no atomics, and the same bits for every number of threads and on both topologies.
"""

import taichi as ti

from taichi_cloth.kernels.compensated import difference
from taichi_cloth.kernels.packs import slot_number, slot_value
from taichi_cloth.kernels.state import GONE


@ti.func
def is_whole(spec: ti.template(), state: ti.template(), surface: ti.template(), m):
    """Whether none of the springs along the sides of triangle m is gone."""
    gone = 0
    if ti.static(spec.fracture):
        for k in ti.static(range(3)):
            s = surface.side[m, k]
            if ti.static(spec.springs):
                if s >= 0 and state.status[s] == GONE:
                    gone = 1
            if ti.static(spec.kinds > 0):
                if s < -1 and slot_number(spec, state.link_status, -2 - s) == GONE:
                    gone = 1
    return gone == 0


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
def gathered(state: ti.template(), surface: ti.template(), p):
    """The sum of the vectors of the triangles at the particle of row p, in their order (3,)."""
    total = ti.Vector.zero(state.real, 3)
    for h in range(surface.row_start[p], surface.row_start[p + 1]):
        m = surface.row_triangle[h]
        for axis in ti.static(range(3)):
            total[axis] += surface.vector[m, axis]
    return total


@ti.kernel
def load_surface(
    surface: ti.template(),
    corners: ti.types.ndarray(),
    rows: ti.types.ndarray(),
    start: ti.types.ndarray(),
    at: ti.types.ndarray(),
    triangle_count: ti.i32,
    row_count: ti.i32,
):
    """Load the triangles.

    corners: (m, 6), slots of the corners, then what `Surface.side` has; rows, start, at: row_slot,
    row_start and row_triangle. triangle_count, row_count: how many count of m and of rows.
    """
    for _ in range(1):
        surface.n_triangles[None] = triangle_count
        surface.n_rows[None] = row_count
    for m in range(triangle_count):
        for k in ti.static(range(3)):
            surface.corner[m, k] = corners[m, k]
            surface.side[m, k] = corners[m, 3 + k]
    for p in range(row_count):
        surface.row_slot[p] = rows[p]
    for p in range(start.shape[0]):
        surface.row_start[p] = start[p]
    for h in range(3 * triangle_count):
        surface.row_triangle[h] = at[h]


@ti.kernel
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
    for m in range(surface.n_triangles[None]):
        area = ti.Vector.zero(state.real, 3)
        if is_whole(spec, state, surface, m):
            i, j, k = surface.corner[m, 0], surface.corner[m, 1], surface.corner[m, 2]
            a, b = edge(spec, state, i, j), edge(spec, state, i, k)
            area = area_vector(in_space(spec, a), in_space(spec, b))
        for axis in ti.static(range(3)):
            surface.vector[m, axis] = area[axis]
    for p in range(surface.n_rows[None]):
        total = gathered(state, surface, p)
        largest = ti.max(ti.max(ti.abs(total[0]), ti.abs(total[1])), ti.abs(total[2]))
        scale = ti.select(largest > 0.0, 1.0 / largest, 0.0)
        total = scale * total  # so that no square vanishes
        length = ti.sqrt(total[0] * total[0] + total[1] * total[1] + total[2] * total[2])
        scale = ti.select(largest > 0.0, 1.0 / length, 0.0)
        i = slot_number(spec, state.particle, surface.row_slot[p])
        for axis in ti.static(range(3)):
            normals[i, axis] = scale * total[axis]
