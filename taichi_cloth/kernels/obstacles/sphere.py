"""A ball (in 2-D a disc)."""

import numpy as np
import taichi as ti

from taichi_cloth.kernels.obstacles.contract import (
    NUMBER,
    POINT,
    Key,
    Placed,
    Shape,
    normals_of,
    round_surface,
)


@ti.func
def distance(spec: ti.template(), state: ti.template(), o, q):
    """From the ball; its middle has the normal of the last axis."""
    length = ti.sqrt(q.dot(q))
    n = 0.0 * q
    n[ti.static(spec.dim - 1)] = 1.0
    if length > 0.0:
        n = (1.0 / length) * q
    return length - state.obstacle_sizes[o, 0], n


def place(values, dim, margin):
    """The ball at time 0."""
    radius = float(values["radius"])
    centre = np.asarray(values["centre"], np.float64)
    return Placed(centre, np.eye(dim), (radius,), thin=radius, round=radius, bound=radius)


def twin(placed, q):
    """The law in NumPy."""
    length = np.linalg.norm(q, axis=1)
    return length - placed.sizes[0], normals_of(q, length)


def surface(placed, extent):
    """Vertices and triangles to draw it by."""
    vertices, faces = round_surface(0.0, len(placed.centre))
    return placed.sizes[0] * vertices, faces


SHAPE = Shape(
    keys=(
        Key("centre", POINT, "its middle", "length"),
        Key("radius", NUMBER, "of the ball", "length", above=0.0),
    ),
    dims=(2, 3),
    convex=True,
    refusal=lambda values: None,
    place=place,
    distance=distance,
    twin=twin,
    surface=surface,
)
