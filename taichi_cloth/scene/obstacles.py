"""Obstacles of a scene: what particles rest on, slide along and bounce off, and never move.

Their shapes are declared in `kernels/obstacles/`, one file each; reading those imports Taichi, so
it is done only where a scene has an obstacle, a ground or resting walls.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.errors import nearest
from taichi_cloth.scene.triangles import springs_of_sides
from taichi_cloth.settings import accepted

if TYPE_CHECKING:
    from taichi_cloth.kernels.obstacles.contract import Key, Placed
    from taichi_cloth.scene.model import Scene, World

CONTACTS = ("original", "resting")  # how walls and pairs of particles treat positions
FAR = 1e15  # as in `kernels.obstacles.contract`, which is not imported where there is none
ROUNDING = 1e-6  # of a particle's coordinates: a depth at the start that f32 may make of none
PUSHES = 64  # by which a particle that begins inside finds a place outside of all obstacles
STUCK = 0.01  # of its radius or depth: what it may then be inside, where pushes converge slowly
MOST_ROWS = 4_000_000  # of a list of points or faces


@dataclass(frozen=True)
class Obstacle:
    """One obstacle: the name of its shape, and values of its keys, which are those of scene files.

    Points are tuples of numbers, lists of them tuples of tuples. What is absent has its default.
    """

    shape: str
    values: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @classmethod
    def build(cls, shape: str, **values: Any) -> Obstacle:
        """An obstacle from numbers, lists and arrays, such as build("sphere", centre=[0, 1, 0],
        radius=0.3, friction=0.4); `checks.validate` says what is wrong with them.
        """
        return cls(shape, {name: _plain(value) for name, value in values.items()})

    def with_file(self, folder: Path) -> Obstacle:
        """This obstacle with what its file has, in the place of the file's name.

        folder: where a relative name begins. InputError where the file has no sound mesh.
        """
        from taichi_cloth.scene import meshfile

        name = self.values.get("file")
        if not isinstance(name, str) or self.shape != "mesh":
            return self  # `fault` says so
        vertices, faces = meshfile.read(folder / name)
        values = {key: value for key, value in self.values.items() if key != "file"}
        return Obstacle.build(self.shape, vertices=vertices, faces=faces, **values)

    def value(self, name: str) -> Any:
        """The value of a key, its default where it is absent."""
        return self.values.get(name, keys_of(self.shape)[name].default)


def _plain(value: Any) -> Any:
    """Lists and arrays as tuples."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return tuple(_plain(v) for v in value)
    return value


def shapes() -> tuple[str, ...]:
    """The names of the shapes that there are."""
    from taichi_cloth.kernels import obstacles

    return obstacles.SHAPES


def keys_of(shape: str) -> dict[str, Key]:
    """The keys of a shape and those that all obstacles have, by name."""
    from taichi_cloth.kernels import obstacles
    from taichi_cloth.kernels.obstacles.contract import COMMON

    return {key.name: key for key in (*obstacles.load(shape).keys, *COMMON)}


# --- what is refused -------------------------------------------------------------------------


def fault(obstacle: Any, dim: int) -> tuple[str | None, str] | None:
    """What is wrong with an obstacle in a world of `dim` dimensions: (key or None, words)."""
    from taichi_cloth.kernels import obstacles
    from taichi_cloth.kernels.obstacles.contract import REQUIRED

    if not isinstance(obstacle, Obstacle):
        return None, f"must be an Obstacle, is {accepted.shown(obstacle)}"
    if not isinstance(obstacle.shape, str) or obstacle.shape not in shapes():
        return (
            "shape",
            f"unknown shape {obstacle.shape!r}; {nearest(str(obstacle.shape), shapes())}",
        )
    shape, known = obstacles.load(obstacle.shape), keys_of(obstacle.shape)
    if dim not in shape.dims:
        return "shape", f"a {dim}-D world has no {obstacle.shape}"
    for name in obstacle.values:
        if name not in known:
            return name, f"unknown key '{name}' of a {obstacle.shape}; {nearest(name, known)}"
    for name, key in known.items():
        if name in obstacle.values:
            words = _fault_of_value(key, obstacle.values[name], dim)
            if words:
                return name, f"{name} {words}"
        elif key.default == REQUIRED:
            return None, f"'{name}' is missing"
    values = {name: obstacle.value(name) for name in known}
    if values["stops"] is not None and values["stops"] < values["starts"]:
        return "stops", f"stops must not be before starts, {values['starts']:g}"
    return shape.refusal(values)


def _fault_of_value(key: Key, value: Any, dim: int) -> str | None:
    """What is wrong with a value of a key, in words that follow its name."""
    from taichi_cloth.kernels.obstacles import contract

    if key.kind == contract.TEXT:
        return None if isinstance(value, str) else f"must be a text, is {accepted.shown(value)}"
    if key.kind in (contract.TURN, contract.SPIN):
        shape: tuple[int, ...] = () if dim == 2 else (3,)
        must = "a number of degrees" if dim == 2 else "three numbers"
    elif key.kind == contract.NUMBER:
        shape, must = (), "a number"
    elif key.kind in (contract.POINT, contract.DIRECTION):
        shape, must = (dim,), f"{dim} numbers in a {dim}-D world"
    else:
        count = np.shape(value)[:1] or (0,)
        shape = (*((key.count,) if key.count else count), 3 if key.kind == contract.FACES else dim)
        must = f"a list of {key.count or ''}{' ' * bool(key.count)}points of {dim} numbers"
        if key.kind == contract.FACES:
            must = "a list of three whole numbers each"
    try:
        numbers = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        return f"must be {must}, is {accepted.shown(value)}"
    if isinstance(value, (bool, str)) or numbers.shape != shape:
        return f"must be {must}, is {accepted.shown(value)}"
    if not np.isfinite(numbers).all():
        return f"must be finite, is {accepted.shown(value)}"
    if key.kind == contract.FACES and (numbers != np.floor(numbers)).any():
        return f"must be {must}"
    if np.abs(numbers).max(initial=0.0) > contract.FAR / 1e3:
        return f"must be at most {contract.FAR / 1e3:g} in size; use other units"
    if key.kind == contract.DIRECTION and not numbers.any():
        return "must not be zero"
    for words, limit, holds in (
        ("at least", key.minimum, key.minimum is None or (numbers >= key.minimum).all()),
        ("more than", key.above, key.above is None or (numbers > key.above).all()),
        ("at most", key.maximum, key.maximum is None or (numbers <= key.maximum).all()),
    ):
        if not holds:
            return f"must be {words} {limit:g}, is {accepted.shown(value)}"
    return None


# --- what is in the way ----------------------------------------------------------------------


@dataclass(frozen=True)
class Solid:
    """Something in the way: an obstacle, the ground, or a wall that is resting.

    name: 'obstacle 0', 'ground', 'left wall'. placed: where it is at time 0. restitution: None:
    that of each particle. velocity: (dim,); spin: radians a unit of time, (1,) in 2-D, (3,) in 3-D.
    starts, stops: between which times it moves. grip: distance from its surface at time 0 within
    which fixed particles go with it; None: it holds none.
    """

    name: str
    shape: str
    placed: Placed
    friction: float
    restitution: float | None
    velocity: np.ndarray
    spin: np.ndarray
    starts: float = 0.0
    stops: float = np.inf
    grip: float | None = None

    @property
    def moving(self) -> bool:
        """Whether it moves."""
        return bool(self.velocity.any() or self.spin.any())

    @property
    def nodes(self) -> int:
        """How many nodes its grid of distances has; 0: it has none."""
        return 0 if self.placed.nodes is None else self.placed.nodes[..., 0].size

    def pose(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Its centre (dim,) and the matrix (dim, dim) of its axes at a time."""
        from taichi_cloth.kernels.obstacles.contract import about

        dim = len(self.velocity)
        rotation, moved = np.zeros(3), min(max(time, self.starts), self.stops) - self.starts
        rotation[3 - len(self.spin) :] = moved * self.spin
        turn = about(rotation)[:dim, :dim] @ self.placed.turn
        return self.placed.centre + moved * self.velocity, turn

    def velocities(self, r: np.ndarray, time: float) -> np.ndarray:
        """The velocities (n, dim) of its points that are at r (n, dim) from its centre."""
        if not self.starts <= time < self.stops:
            return np.zeros_like(r)
        if len(self.spin) == 1:
            turning = self.spin[0] * np.column_stack([-1.0 * r[:, 1], r[:, 0]])
        else:
            turning = np.cross(self.spin, r)
        total: np.ndarray = self.velocity + turning
        return total

    def distances(self, x: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
        """The signed distances (n,) of its surface from points x (n, dim), and its normals there.

        Distances are negative inside; normals (n, dim) point out of it.
        """
        from taichi_cloth.kernels import obstacles

        centre, turn = self.pose(time)
        d, n = obstacles.load(self.shape).twin(self.placed, (x - centre) @ turn)
        return d, n @ turn.T


def solids(scene: Scene) -> list[Solid]:
    """What is in the way in a scene: its obstacles in their order, the ground, resting walls."""
    dim = scene.world.dim
    still = np.zeros(dim), np.zeros(1 if dim == 2 else 3)
    margin = float(scene.particles.radius.max(initial=scene.particle_defaults.radius))
    found = []
    for index, obstacle in enumerate(scene.obstacles):
        values = {name: obstacle.value(name) for name in keys_of(obstacle.shape)}
        velocity, spin = values["velocity"], values["spin"]
        found.append(
            Solid(
                f"obstacle {index}",
                obstacle.shape,
                _placed(obstacle.shape, values, dim, margin),
                float(values["friction"]),
                float(values["restitution"]),
                still[0] if velocity is None else np.asarray(velocity, np.float64),
                still[1] if spin is None else np.radians(np.atleast_1d(spin).astype(np.float64)),
                float(values["starts"]),
                np.inf if values["stops"] is None else float(values["stops"]),
                None if values["grip"] is None else float(values["grip"]),
            )
        )
    for name, point, normal in _planes(scene.world):
        placed = _placed("plane", {"point": point, "normal": normal}, dim, margin)
        found.append(Solid(name, "plane", placed, scene.world.friction, None, *still))
    return found


def held(scene: Scene, solids: Sequence[Solid]) -> tuple[np.ndarray, np.ndarray]:
    """Which solid each particle goes with, (n,), -1: none, and where in its frame, (n, dim).

    Fixed particles go with a moving obstacle within whose grip they begin, the nearest if several.
    """
    x, fixed = scene.particles.position, scene.particles.fixed
    which, nearest_yet = np.full(len(x), -1), np.full(len(x), np.inf)
    local = np.zeros_like(x)
    for index, solid in enumerate(solids):
        if solid.grip is not None and solid.moving and fixed.any():
            (centre, turn), (distance, _) = solid.pose(0.0), solid.distances(x, 0.0)
            mine = fixed & (distance <= solid.grip) & (distance < nearest_yet)
            which[mine], nearest_yet[mine] = index, distance[mine]
            local[mine] = (x[mine] - centre) @ turn
    return which, local


def elements(scene: Scene) -> np.ndarray:
    """What of a scene's cloths is tested against sharp obstacles, as triangles (m, 3).

    In 3-D the triangles, in 2-D the springs along their sides; in both the springs between
    particles that are in no triangle, such as those of ropes. Springs are triangles whose last
    corners are one. Links to the next but one are left out: they are in no cloth's surface.
    """
    between = scene.springs.between
    in_triangle = np.zeros(len(scene.particles), bool)
    in_triangle[scene.triangles.ravel()] = True
    as_edge = ~in_triangle[between].any(axis=1)
    if scene.world.dim == 2:
        sides = springs_of_sides(scene.triangles, between)
        as_edge[sides[sides >= 0]] = True
    edges = between[as_edge][:, [0, 1, 1]]
    found = edges if scene.world.dim == 2 else np.concatenate([scene.triangles, edges])
    return found.astype(np.int64)


def met_by_faces(scene: Scene, solids: Sequence[Solid]) -> list[str]:
    """The names of those solids that are sharper than a scene's `elements` are long.

    They could pass between a cloth's particles.
    """
    if all(solid.placed.round >= FAR for solid in solids):
        return []
    x = scene.particles.position[elements(scene)]
    longest = float(np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(initial=0.0))
    return [solid.name for solid in solids if solid.placed.round < longest]


def _placed(shape: str, values: Mapping[str, Any], dim: int, margin: float) -> Placed:
    from taichi_cloth.kernels import obstacles

    return obstacles.load(shape).place(values, dim, margin)


def _planes(world: World) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Name, a point and the normal of the ground and of resting walls."""
    if world.ground is not None:
        normal = -1.0 * np.array(world.downward)
        yield "ground", np.abs(normal) * world.ground, normal
    if world.contact == "resting":
        for name in world.walls:
            axis, side = world.side(name)
            corner = world.high if side > 0 else world.low
            inwards = -float(side) * np.eye(world.dim)[axis]
            yield f"{name} wall", np.abs(inwards) * corner, inwards


@dataclass(frozen=True)
class Drawn:
    """An obstacle as it is drawn: local vertices (k, dim), triangles (m, 3), and its pose now."""

    name: str
    shape: str
    vertices: np.ndarray
    faces: np.ndarray
    centre: np.ndarray
    turn: np.ndarray

    def points(self) -> np.ndarray:
        """The vertices in the world, (k, dim)."""
        points: np.ndarray = self.centre + self.vertices @ self.turn.T
        return points


def surface(solid: Solid, extent: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (k, dim), in a solid's own frame, and triangles (m, 3) to draw it by.

    extent: a length that reaches through the world, for what is endless. Seen from outside the
    corners of each triangle go round counterclockwise.
    """
    from taichi_cloth.kernels import obstacles

    return obstacles.load(solid.shape).surface(solid.placed, extent)


@dataclass(frozen=True)
class Inside:
    """Which free particles begin inside a solid: all of them, (k,), in ascending order.

    solid: (k,) the name of the one in which each is deepest. stuck: those of them that are inside
    of some solid wherever they are pushed.
    """

    particles: np.ndarray
    solid: list[str]
    stuck: np.ndarray


def inside_at_start(scene: Scene, solids: Sequence[Solid]) -> Inside:
    """Which of a scene's free particles have to be pushed out of what is in their way at time 0."""
    particles = scene.particles
    x, radius = particles.position.copy(), particles.radius
    allowed = ROUNDING * (radius + np.abs(x).max(axis=1, initial=0.0))

    def deep(x: np.ndarray, radius: np.ndarray) -> np.ndarray:
        gaps = [radius - solid.distances(x, 0.0)[0] for solid in solids]
        return np.array(gaps).reshape(len(solids), len(x))

    depth = deep(x, radius)
    found = np.flatnonzero((depth > allowed).any(axis=0) & ~particles.fixed)
    deepest = depth[:, found].argmax(axis=0) if len(found) else np.zeros(0, np.int64)
    x, radius = x[found], radius[found]
    for _ in range(PUSHES if len(found) else 0):
        for solid in solids:
            distance, normal = solid.distances(x, 0.0)
            x -= np.minimum(distance - radius, 0.0)[:, None] * normal
    left = deep(x, radius).max(axis=0, initial=0.0)
    stuck = found[
        left > allowed[found] + STUCK * np.maximum(depth[:, found].max(axis=0, initial=0.0), radius)
    ]
    return Inside(found, [solids[s].name for s in deepest], stuck)


def depths(solids: Sequence[Solid], x: np.ndarray, radius: np.ndarray, time: float) -> np.ndarray:
    """How deep particles are in what is in their way, (n,); negative: how far from all of it.

    x: (n, dim); radius: (n,). They are infinitely far where nothing is in the way.
    """
    deepest = np.full(len(x), -np.inf)
    for solid in solids:
        distance, _ = solid.distances(x, time)
        deepest = np.maximum(deepest, radius - distance)
    return deepest
