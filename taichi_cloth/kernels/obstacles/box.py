"""A box (in 2-D a rectangle), which may be turned."""

import numpy as np
import taichi as ti

from taichi_cloth.kernels.obstacles.contract import (
    POINT,
    TURN,
    Key,
    Placed,
    Shape,
    turned,
)


@ti.func
def distance(spec: ti.template(), state: ti.template(), o, q):
    """From the nearest face, edge or corner; inside from the nearest face."""
    outside, side = 0.0 * q, 0.0 * q
    deepest, axis_of = q[0] - q[0], 0
    for axis in ti.static(range(spec.dim)):
        side[axis] = ti.select(q[axis] < 0.0, -1.0, 1.0)
        past = side[axis] * q[axis] - state.obstacle_sizes[o, axis]
        outside[axis] = ti.max(past, 0.0)
        if ti.static(axis == 0):
            deepest = past
        elif past > deepest:
            deepest, axis_of = past, axis
    length = ti.sqrt(outside.dot(outside))
    n, d = 0.0 * q, deepest
    for axis in ti.static(range(spec.dim)):
        if length > 0.0:
            n[axis] = side[axis] * outside[axis] / length
        elif axis_of == axis:
            n[axis] = side[axis]
    if length > 0.0:
        d = length
    return d, n


def refusal(values):
    """A box without a thickness has no inside."""
    if not (np.asarray(values["half"], np.float64) > 0).all():
        shown = ", ".join(f"{half:g}" for half in values["half"])
        return "half", f"half must be positive along each axis, is [{shown}]"
    return None


def place(values, dim, margin):
    """The box at time 0."""
    half = np.asarray(values["half"], np.float64)
    bound = float(np.linalg.norm(half / half.max()) * half.max())
    turn = turned(values["turn"], dim)
    centre = np.asarray(values["centre"], np.float64)
    sizes = tuple(half.tolist())
    return Placed(centre, turn, sizes, thin=float(half.min()), round=0.0, bound=bound)


def twin(placed, q):
    """The law in NumPy."""
    past = np.abs(q) - np.array(placed.sizes)
    side = np.where(q < 0, -1.0, 1.0)
    outside = np.maximum(past, 0.0)
    length = np.linalg.norm(outside, axis=1)
    inside = length == 0
    d = np.where(inside, past.max(axis=1), length)
    nearest = np.eye(q.shape[1])[past.argmax(axis=1)]
    n = side * np.where(inside[:, None], nearest, outside / np.where(inside, 1.0, length)[:, None])
    return d, n


def surface(placed, extent):
    """Its corners, and two triangles a face (in 2-D two in all)."""
    half, dim = np.array(placed.sizes), len(placed.centre)
    if dim == 2:
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return half * corners, np.array([[0, 1, 2], [0, 2, 3]])
    vertices, faces = [], []
    for axis in range(3):
        for side in (-1, 1):
            a, b = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            out, first = side * np.eye(3)[axis], len(vertices)
            ring = [out - a - b, out + side * (a - b), out + a + b, out + side * (b - a)]
            vertices += [half * corner for corner in ring]
            faces += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
    return np.array(vertices), np.array(faces)


SHAPE = Shape(
    keys=(
        Key("centre", POINT, "its middle", "length"),
        Key("half", POINT, "half its length along each of its axes", "length"),
        Key("turn", TURN, "of its axes, at time 0", "degrees", None),
    ),
    dims=(2, 3),
    convex=True,
    refusal=refusal,
    place=place,
    distance=distance,
    twin=twin,
    surface=surface,
)
