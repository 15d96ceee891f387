"""A plane (in 2-D a line) with everything behind it: what its normal points to is free."""

import numpy as np
import taichi as ti

from taichi_cloth.kernels.obstacles.contract import (
    DIRECTION,
    FAR,
    POINT,
    Key,
    Placed,
    Shape,
    along,
)


@ti.func
def distance(spec: ti.template(), state: ti.template(), o, q):
    """Local points are measured along the first axis, the plane's normal."""
    n = 0.0 * q
    n[0] = 1.0
    return q[0], n


def place(values, dim, margin):
    """The plane at time 0."""
    normal = np.asarray(values["normal"], np.float64)
    largest = np.abs(normal).max()  # so that no square overflows
    normal = normal / largest
    turn = along(normal / np.linalg.norm(normal))
    point = np.asarray(values["point"], np.float64)
    return Placed(point, turn, (), thin=FAR, round=FAR, bound=FAR)


def twin(placed, q):
    """The law in NumPy."""
    n = np.zeros_like(q)
    n[:, 0] = 1.0
    return q[:, 0].copy(), n


def surface(placed, extent):
    """A square in 3-D; in 2-D what is behind the line, as deep as the world is large."""
    if len(placed.centre) == 2:
        corners = [[0, -1], [0, 1], [-1, 1], [-1, -1]]
    else:
        corners = [[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]
    return extent * np.array(corners, np.float64), np.array([[0, 1, 2], [0, 2, 3]])


SHAPE = Shape(
    keys=(
        Key("point", POINT, "a point of the plane", "length"),
        Key("normal", DIRECTION, "points to the free side", "1"),
    ),
    dims=(2, 3),
    convex=True,
    refusal=lambda values: None,
    place=place,
    distance=distance,
    twin=twin,
    surface=surface,
)
