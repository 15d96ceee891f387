"""Solids of a scene: obstacles, the ground and resting walls, which may move.

Where they are at a time, how far points are from them, what begins inside them, and how they are
drawn. Their shapes (`kernels/obstacles/`) are imported, and Taichi with them, only where there are
any.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.scene.model import Scene, World
from taichi_cloth.scene.obstacles import keys_of

if TYPE_CHECKING:
    from taichi_cloth.kernels.obstacles.contract import Placed

ROUNDING = 1e-6  # of a particle's coordinates: a depth at the start that f32 may make of none
PUSHES = 64  # by which a particle that begins inside finds a place outside of all obstacles
SHARP = 2.0  # sides: what is rounder is at most a 23rd of its radius inside an unstretched one
THROUGH = 0.25  # of its side: what a triangle is inside by then that goes through an obstacle
OPPOSED = -0.5  # cosine between normals: more than that lets both ends of an edge out on one side
SECTIONS, GOLDEN = 48, 0.381966  # of a search along an edge
STUCK = 0.01  # of its radius or depth: what it may then be inside, where pushes converge slowly


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
        """True if it moves."""
        return bool(self.velocity.any() or self.spin.any())

    @property
    def nodes(self) -> int:
        """The nodes of its grid of distances; 0: it has none."""
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
    """The solids of a scene: its obstacles in their order, the ground, resting walls."""
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
    for name, point, normal in planes(scene.world):
        placed = _placed("plane", {"point": point, "normal": normal}, dim, margin)
        found.append(Solid(name, "plane", placed, scene.world.friction, None, *still))
    return found


def number_of_solids(scene: Scene) -> int:
    """The number of a scene's `solids`."""
    return len(scene.obstacles) + len(list(planes(scene.world)))


def held(
    scene: Scene, solids: Sequence[Solid], x: np.ndarray | None = None, time: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Which solid each particle goes with, (n,), -1: none, and where in its frame, (n, dim).

    Fixed particles go with a moving obstacle within whose grip they begin, the nearest if several.
    x: (n, dim), where they are at a time; absent: where they begin.
    """
    x = scene.particles.position if x is None else x
    fixed = scene.particles.fixed
    which, nearest_yet = np.full(len(x), -1), np.full(len(x), np.inf)
    local = np.zeros_like(x)
    for index, solid in enumerate(solids):
        if solid.grip is not None and solid.moving and fixed.any():
            (centre, turn), (distance, _) = solid.pose(time), solid.distances(x, time)
            mine = fixed & (distance <= solid.grip) & (distance < nearest_yet)
            which[mine], nearest_yet[mine] = index, distance[mine]
            local[mine] = (x[mine] - centre) @ turn
    return which, local


def met_by_faces(scene: Scene, solids: Sequence[Solid]) -> list[str]:
    """The names of those solids that are sharper than SHARP of a scene's sides are long.

    They could pass between a cloth's particles, or be far inside its sides.
    """
    if not solids:
        return []
    from taichi_cloth.kernels.obstacles.contract import FAR

    if all(solid.placed.round >= FAR for solid in solids):
        return []
    return [solid.name for solid in solids if solid.placed.round < SHARP * scene.longest_side]


def _placed(shape: str, values: Mapping[str, Any], dim: int, margin: float) -> Placed:
    from taichi_cloth.kernels import obstacles

    return obstacles.load(shape).place(values, dim, margin)


def planes(world: World) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
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
    of some solid wherever they are pushed. pushed: (k, dim), where that leaves them.
    """

    particles: np.ndarray
    solid: list[str]
    stuck: np.ndarray
    pushed: np.ndarray


def inside_at_start(scene: Scene, solids: Sequence[Solid]) -> Inside:
    """Which of a scene's free particles have to be pushed out of what is in their way at time 0."""
    return _inside(scene, solids, scene.particles.position, 0.0, ~scene.particles.fixed)


def _inside(
    scene: Scene, solids: Sequence[Solid], x: np.ndarray, time: float, asked: np.ndarray
) -> Inside:
    """Which of the particles that are asked for, (n,) bool, are inside of a solid at a time, at x.

    x: (n, dim), where the scene's particles are then.
    """
    radius = scene.particles.radius
    allowed = ROUNDING * (radius + np.abs(x).max(axis=1, initial=0.0))

    def deep(x: np.ndarray, radius: np.ndarray) -> np.ndarray:
        gaps = [radius - solid.distances(x, time)[0] for solid in solids]
        return np.array(gaps).reshape(len(solids), len(x))

    depth = deep(x, radius)
    found = np.flatnonzero((depth > allowed).any(axis=0) & asked)
    deepest = depth[:, found].argmax(axis=0) if len(found) else np.zeros(0, np.int64)
    radius = radius[found]
    x = _pushed_out(x[found], radius, solids, time)
    left = deep(x, radius).max(axis=0, initial=0.0)
    stuck = found[
        left > allowed[found] + STUCK * np.maximum(depth[:, found].max(axis=0, initial=0.0), radius)
    ]
    return Inside(found, [solids[s].name for s in deepest], stuck, x)


def _pushed_out(
    x: np.ndarray, radius: np.ndarray, solids: Sequence[Solid], time: float
) -> np.ndarray:
    """Places of balls of radius (n,) at x (n, dim) once all solids, by turns, have pushed them."""
    x = x.copy()
    for _ in range(PUSHES if len(x) else 0):
        for solid in solids:
            distance, normal = solid.distances(x, time)
            x -= np.minimum(distance - radius, 0.0)[:, None] * normal
    return x


def goes_through(
    scene: Scene, solids: Sequence[Solid], x: np.ndarray, time: float, asked: np.ndarray
) -> np.ndarray:
    """Which of a scene's `elements` go through a sharp solid once their corners are pushed out of
    where they are put, (m,) bool: these are then on several of its sides.

    x: (n, dim), where particles are put at a time; asked: (m,) bool, which elements are asked for.
    No push would take such a face out: pushes would go on for ever, and throw the cloth. What is
    less deep in it than THROUGH of its longest side, as on an edge, and does not go through its
    middle (`_is_split`) is none of them, and what has a fixed corner neither.
    """
    elements, put, fixed = scene.elements, x, scene.particles.fixed
    through, is_corner = np.zeros(len(elements), bool), np.zeros(len(put), bool)
    asked = asked & ~fixed[elements].any(axis=1)
    met = met_by_faces(scene, solids)
    sharp = [solid for solid in solids if solid.name in met]
    if not sharp or not asked.any():
        return through
    is_corner[elements[asked]] = True
    inside = _inside(scene, solids, put, time, is_corner)
    x, is_inside = put.copy(), np.zeros(len(put), bool)
    x[inside.particles], is_inside[inside.particles] = inside.pushed, True
    entered = asked & is_inside[elements].any(axis=1)
    began, corners = put[elements[entered]], x[elements[entered]]
    side = np.linalg.norm(began - np.roll(began, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    depth = np.full(len(corners), -np.inf)
    for shares in ((1, 1, 1), (1, 1, 0), (0, 1, 1), (1, 0, 1)):
        point = np.einsum("k,mkd->md", np.array(shares) / sum(shares), corners)
        for solid in sharp:
            depth = np.maximum(depth, -1.0 * solid.distances(point, time)[0])
    through[entered] = depth > THROUGH * side
    which = np.tile(np.flatnonzero(asked), 3)
    a, b = elements[asked].T.ravel(), np.roll(elements[asked], -1, axis=1).T.ravel()
    length = np.linalg.norm(x[b] - x[a], axis=1)
    for solid in sharp:
        gap = solid.distances(x, time)[0]
        reaches = length > gap[a] + gap[b]  # the others do not between their ends, either
        split = _is_split(solid, x[a[reaches]], x[b[reaches]], time)
        through[which[reaches][split]] = True
    return through


def _is_split(solid: Solid, a: np.ndarray, b: np.ndarray, time: float) -> np.ndarray:
    """Mark edges from a to b, (m, dim) each, that go through the middle of a solid, (m,) bool: what
    pushes their one part out of it would push the other the opposite way, as in a plate thinner
    than they are long.
    """

    def look(part: np.ndarray, aside: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        return solid.distances(a + part[:, None] * (b - a) + aside, time)

    low: np.ndarray = np.zeros(len(a))
    high: np.ndarray = np.ones(len(a))
    length = np.linalg.norm(b - a, axis=1)
    for _ in range(SECTIONS):  # of where it is deepest: there is one such place
        third = GOLDEN * (high - low)
        left, right = low + third, high - third
        at_left, at_right = look(left)[0], look(right)[0]
        nearer, beyond = at_left <= at_right, np.minimum(at_left, at_right)
        if (beyond > (high - low) * length).all():
            return np.zeros(len(a), bool)
        low, high = np.where(nearer, low, left), np.where(nearer, right, high)
    middle = (low + high) / 2
    depth = np.maximum(-1.0 * look(middle)[0], 0.0)
    before, after = (
        middle + side * depth / np.where(length > 0, length, 1.0) for side in (-0.25, 0.25)
    )
    split: np.ndarray = depth > ROUNDING * length
    # Also beside it: a rod has an axis, by whose side an edge gets out, and no such middle.
    normal = look(before)[1]
    for axis in np.eye(a.shape[1]):
        aside = 0.5 * depth[:, None] * (axis - (normal @ axis)[:, None] * normal)
        for shift in (aside, -1.0 * aside):
            facing = (look(before, shift)[1] * look(after, shift)[1]).sum(axis=1)
            split &= facing < OPPOSED
    return split


def depths(solids: Sequence[Solid], x: np.ndarray, radius: np.ndarray, time: float) -> np.ndarray:
    """Depths of particles in what is in their way, (n,); negative: how far from all of it.

    x: (n, dim); radius: (n,). They are infinitely far where nothing is in the way.
    """
    deepest = np.full(len(x), -np.inf)
    for solid in solids:
        distance, _ = solid.distances(x, time)
        deepest = np.maximum(deepest, radius - distance)
    return deepest
