"""A capsule: all points within a radius of the line between two ends."""

import numpy as np
import taichi as ti

from taichi_cloth.kernels.obstacles.contract import (
    NUMBER,
    POINTS,
    Key,
    Placed,
    Shape,
    along,
    normals_of,
    round_surface,
)


@ti.func
def distance(spec: ti.template(), state: ti.template(), o, q):
    """From the line along the first local axis; on it the normal is that of the last axis."""
    reach = state.obstacle_sizes[o, 1]
    d = q
    d[0] = q[0] - ti.min(ti.max(q[0], -1.0 * reach), reach)
    length = ti.sqrt(d.dot(d))
    n = 0.0 * q
    n[ti.static(spec.dim - 1)] = 1.0
    if length > 0.0:
        n = (1.0 / length) * d
    return length - state.obstacle_sizes[o, 0], n


def refusal(values):
    """Both ends in one place are a sphere."""
    first, last = np.asarray(values["ends"], np.float64)
    if (first == last).all():
        return "ends", "ends must be two different points; for one use shape = 'sphere'"
    return None


def place(values, dim, margin):
    """The capsule at time 0, in the middle of its ends."""
    first, last = np.asarray(values["ends"], np.float64)
    radius, half = float(values["radius"]), 0.5 * (last - first)
    largest = np.abs(half).max()
    reach = largest * float(np.linalg.norm(half / largest))
    centre = first + half
    turn, sizes = along(half / reach), (radius, reach)
    return Placed(centre, turn, sizes, thin=radius, round=radius, bound=radius + reach)


def twin(placed, q):
    """The law in NumPy."""
    radius, reach = placed.sizes
    d = q.copy()
    d[:, 0] = q[:, 0] - np.clip(q[:, 0], -reach, reach)
    length = np.linalg.norm(d, axis=1)
    return length - radius, normals_of(d, length)


def surface(placed, extent):
    """Vertices and triangles to draw it by."""
    radius, reach = placed.sizes
    vertices, faces = round_surface(reach / radius, len(placed.centre))
    return radius * vertices, faces


SHAPE = Shape(
    keys=(
        Key("ends", POINTS, "both ends of its middle line", "length", count=2),
        Key("radius", NUMBER, "around that line", "length", above=0.0),
    ),
    dims=(2, 3),
    convex=True,
    refusal=refusal,
    place=place,
    distance=distance,
    twin=twin,
    surface=surface,
)
