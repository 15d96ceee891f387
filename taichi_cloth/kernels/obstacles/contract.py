"""The declaration of an obstacle's shape: all that the program must know of it.

A shape is one file in this folder with a `SHAPE = Shape(...)`. It is described in a frame of its
own, the *local* one, which the obstacle's pose takes to the world: x = centre + turn q. A distance
is signed: negative inside; a normal is of unit length and points out of the obstacle.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

NUMBER, POINT, DIRECTION, POINTS, FACES, TURN, SPIN, TEXT = KINDS = (
    "number",
    "point",  # one number a dimension
    "direction",  # likewise, and not zero
    "points",  # a list of points
    "faces",  # a list of three whole numbers each
    "turn",  # degrees: one in 2-D; in 3-D three, about x, then y, then z
    "spin",  # degrees a unit of time: one in 2-D; in 3-D a vector along the axis
    "text",
)
REQUIRED = "required"  # the default of a key that must be given
FAR = 1e15  # a length beyond all scenes whose square f32 holds
# Columns of state.obstacle_numbers. THIN and BOUND: as in `Placed`; SCALE: size of the numbers that
# the law takes differences of; RESTITUTION: negative: that of the particle; CELL: of its grid;
# FACES_TOO: 1: the faces of triangles are tested against it, not only particles; ROUND: `Placed`'s.
FRICTION, RESTITUTION, THIN, BOUND, SCALE, CELL, FACES_TOO, ROUND = NUMBERS = range(8)
SIZES = 4  # numbers of a shape that its law reads on the device


@dataclass(frozen=True)
class Key:
    """A key of [[obstacles]].

    kind: out of `KINDS`. default: REQUIRED, or what stands for an absent one; None: the shape says.
    minimum: inclusive limit of a number; above: exclusive one. count: of `points`, where it is
    given.
    """

    name: str
    kind: str
    help: str
    unit: str
    default: Any = REQUIRED
    minimum: float | None = None
    above: float | None = None
    maximum: float | None = None
    count: int | None = None


COMMON = (  # keys of every obstacle, beside `shape`
    Key("friction", NUMBER, "Coulomb coefficient", "1", 0.0, minimum=0.0),
    Key("restitution", NUMBER, "part of the normal speed kept", "1", 0.0, minimum=0.0, maximum=1.0),
    Key("velocity", POINT, "of its centre", "length / time", None),
    Key("spin", SPIN, "about its centre", "degrees / time", None),
    Key("starts", NUMBER, "when it begins to move", "time", 0.0, minimum=0.0),
    Key("stops", NUMBER, "when it stops; absent: never", "time", None, minimum=0.0),
    Key("grip", NUMBER, "fixed particles as near as this go with it", "length", None, minimum=0.0),
)


@dataclass(frozen=True)
class Placed:
    """An obstacle as its values have it at time 0.

    centre: (dim,), about which it turns; turn: (dim, dim). sizes: at most `SIZES` numbers for the
    law. thin: the length below which particles could pass through it between two looks; `FAR`: it
    has none. round: the radius of its sharpest edge or corner, which could pass between a cloth's
    particles where it is smaller than the cells. bound: radius of a ball about the centre that
    holds it. low: (3,), cell, nodes: (nx, ny, nz, 4), of a grid of distances and normals, where it
    has one; vertices, faces: of what that was made from, to draw it by. rounded: a local point (3,)
    where that tapers off and is rounded most, and by how much; None: nowhere.
    """

    centre: np.ndarray
    turn: np.ndarray
    sizes: tuple[float, ...]
    thin: float
    round: float
    bound: float
    low: np.ndarray | None = None
    cell: float = 0.0
    nodes: np.ndarray | None = None
    vertices: np.ndarray | None = None
    faces: np.ndarray | None = None
    rounded: tuple[np.ndarray, float] | None = None


Values = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Shape:
    """The declaration of a shape.

    keys: its own keys of scene files. dims: the dimensions of worlds that can have it. convex:
        whether what was put onto its surface is nowhere past it.
    refusal(values): what is wrong with values whose types are right, as (key, words), or None.
    place(values, dim, margin): a `Placed`; margin: the largest radius of a particle [length].
    distance(spec, state, o, q): a ti.func: distance of the surface of obstacle o from the local
        point q (dim,), and its normal there.
    twin(placed, q): the same in NumPy, for many points (n, dim): (n,) and (n, dim).
    surface(placed, extent): vertices (n, dim), local, and triangles (m, 3) to draw it by; extent: a
        length that reaches through the world.

    Raises ValueError where a part is none of these.
    """

    keys: tuple[Key, ...]
    dims: tuple[int, ...]
    convex: bool
    refusal: Callable[[Values], tuple[str, str] | None]
    place: Callable[[Values, int, float], Placed]
    distance: Callable[..., Any]
    twin: Callable[[Placed, np.ndarray], tuple[np.ndarray, np.ndarray]]
    surface: Callable[[Placed, float], tuple[np.ndarray, np.ndarray]]

    def __post_init__(self) -> None:
        if not self.keys or not all(isinstance(key, Key) for key in self.keys):
            raise ValueError("keys must be a tuple of Key")
        for key in self.keys:
            if key.kind not in KINDS:
                raise ValueError(f"key {key.name}: {key.kind!r} is none of {', '.join(KINDS)}")
        if not self.dims or not set(self.dims) <= {2, 3}:
            raise ValueError(f"dims is {self.dims}; a world has 2 or 3")
        if not isinstance(self.convex, bool):
            raise ValueError("convex must be True or False")
        for part in fields(self)[3:]:
            if not callable(getattr(self, part.name)):
                raise ValueError(f"{part.name} must be a function")


def turned(degrees: Any, dim: int) -> np.ndarray:
    """The matrix (dim, dim) of a turn, as the kind `TURN` has it; None: of no turn."""
    if degrees is None:
        return np.eye(dim)
    angles = np.radians(np.atleast_1d(np.asarray(degrees, np.float64)))
    if dim == 2:
        return about(np.zeros(3) + [0, 0, angles[0]])[:2, :2]
    x, y, z = (about(angle * axis) for angle, axis in zip(angles, np.eye(3), strict=True))
    whole: np.ndarray = z @ y @ x
    return whole


def about(rotation: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) of a rotation vector (3,) [radians].

    Rodrigues, 1840; Goldstein, Classical Mechanics, 4.7.
    """
    angle = float(np.linalg.norm(rotation))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = rotation / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: np.ndarray = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
    return matrix


def along(direction: np.ndarray) -> np.ndarray:
    """A turn (dim, dim) whose first column is a unit vector (dim,)."""
    dim = len(direction)
    rest = np.eye(dim)[np.argsort(np.abs(direction))[: dim - 1]]
    whole, _ = np.linalg.qr(np.column_stack([direction, *rest]))
    whole[:, 0] = direction
    if np.linalg.det(whole) < 0:
        whole[:, -1] = -1.0 * whole[:, -1]
    matrix: np.ndarray = whole
    return matrix


def normals_of(d: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Unit vectors (n, dim) along d, whose lengths (n,) are known; along the last axis where 0."""
    n = np.zeros_like(d)
    n[:, -1] = 1.0
    there = length > 0.0
    n[there] = d[there] / length[there, None]
    return n


def round_surface(reach: np.ndarray, dim: int, rings: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """A ball of radius 1 whose halves are moved apart along the first axis by +-reach.

    Vertices (n, dim) and triangles (m, 3): a disc's fan in 2-D.
    """
    if dim == 2:
        angle = np.linspace(0.0, 2.0 * np.pi, 2 * rings, endpoint=False)
        rim = np.column_stack([np.cos(angle), np.sin(angle)])
        rim[:, 0] += np.where(rim[:, 0] >= -1e-12, reach, -reach)
        k = np.arange(2 * rings)
        faces = np.column_stack([np.zeros_like(k), 1 + k, 1 + (k + 1) % len(k)])
        return np.vstack([np.zeros(2), rim]), faces
    half = np.linspace(0.0, np.pi / 2, rings // 2 + 1)
    theta = np.concatenate([half, np.pi - half[::-1]])
    shift = np.concatenate([np.full(len(half), 1.0), np.full(len(half), -1.0)]) * reach
    phi = np.linspace(0.0, 2.0 * np.pi, 2 * rings, endpoint=False)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    x = np.cos(t) + shift[:, None]
    vertices = np.stack([x, np.sin(t) * np.cos(p), np.sin(t) * np.sin(p)], axis=2).reshape(-1, 3)
    return vertices, grid_faces(len(theta), len(phi))


def grid_faces(rows: int, columns: int) -> np.ndarray:
    """Triangles (m, 3) of a sheet of rows x columns vertices whose columns close on themselves."""
    r, c = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    a, b = r * columns + c, r * columns + (c + 1) % columns
    faces = np.stack([a, a + columns, b, b, a + columns, b + columns], axis=2)
    return faces.reshape(-1, 3)
