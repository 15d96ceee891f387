"""Obstacles as they are drawn: one surface of all of them, where they are now."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.render import style
from taichi_cloth.render.picture import Solid
from taichi_cloth.scene.model import Scene, World

if TYPE_CHECKING:
    from taichi_cloth.scene.solids import Drawn
    from taichi_cloth.simulation.simulation import Simulation

PLANE_CELLS = 16  # along each side of a plane: what is behind us is left out cell by cell
CREASE = 30.0  # degrees between a face and the mean of those around a corner that make an edge
ROUND = ("sphere", "capsule")  # shapes whose turning would not be seen
FLOOR_TILES = 8  # along the longer side of a box
STRIPES = 0.16  # by so much the stripes of what turns are darker or brighter


class Solids:
    """Keeps what obstacles look like from frame to frame; those at rest are made once."""

    def __init__(self) -> None:
        self._scene: Scene | None = None
        self._moving = False
        self._made: Solid | None = None

    def of(self, sim: Simulation, time: float) -> Solid | None:
        """The surface of the obstacles at a time; None: there are none besides a floor."""
        scene = sim.scene
        if self._scene is scene and not self._moving:
            return self._made
        flat = scene.world.dim == 2 and scene.world.ground is not None
        if not scene.obstacles and not flat and not has_box_floor(scene.world):
            self._scene, self._made, self._moving = scene, None, False
            return None
        drawn = [d for d in sim.obstacles(time) if d.name != "ground" or scene.world.dim == 2]
        floor = [box_floor(scene.world)] if has_box_floor(scene.world) else []
        now = joined([*floor, *(_part(d, scene) for d in drawn)])
        before = self._made
        if before is not None and np.array_equal(before.triangles, now.triangles):
            now = Solid(now.vertex, before.triangles, before.color)
        self._scene, self._made = scene, now
        self._moving = any(
            np.any(o.values.get("velocity", 0.0)) or turns(scene, n)
            for n, o in enumerate(scene.obstacles)
        )
        return now


def turns(scene: Scene, number: int) -> bool:
    """True if an obstacle turns."""
    return bool(np.any(scene.obstacles[number].values.get("spin", 0.0)))


def has_box_floor(world: World) -> bool:
    """True if a 3-D world is a box with a bottom, which is seen as its floor."""
    return world.dim == 3 and world.up != "y" and "bottom" in world.walls and world.ground is None


def box_floor(world: World) -> Solid:
    """The bottom of a box as a floor of tiles in two shades."""
    w, h, d = world.size
    count = np.maximum(np.round(np.array([w, d]) / (max(w, d) / FLOOR_TILES)).astype(int), 1)
    i, j = (part.ravel() for part in np.meshgrid(*map(np.arange, count), indexing="ij"))
    corner = np.stack([i, j], 1)[:, None] + [(0, 0), (1, 0), (1, 1), (0, 1)]
    across = corner / count * [w, d] - [0, d / 2]
    vertex = np.stack([across[..., 0], np.full(corner.shape[:2], float(h)), across[..., 1]], -1)
    color = np.where(((i + j) % 2)[:, None], style.TILES[0], style.TILES[1]).repeat(4, axis=0)
    faces = 4 * np.arange(len(i))[:, None, None] + [(0, 1, 2), (0, 2, 3)]
    return Solid(vertex.reshape(-1, 3), faces.reshape(-1, 3), color.astype(np.uint8))


def joined(parts: list[Solid]) -> Solid:
    """Several solids as one."""
    first = np.cumsum([0, *(len(part.vertex) for part in parts)])
    return Solid(
        np.concatenate([part.vertex for part in parts]),
        np.concatenate([part.triangles + n for part, n in zip(parts, first, strict=False)]),
        np.concatenate([part.color for part in parts]),
    )


def _part(drawn: Drawn, scene: Scene) -> Solid:
    """One obstacle; what is round and turns has stripes, so that one sees it."""
    vertex, faces = drawn.vertices, drawn.faces
    if drawn.shape == "plane" and scene.world.dim == 3:
        vertex, faces = _in_cells(vertex)
    if scene.world.dim == 3:
        vertex, faces = creased(vertex, faces)
    flat = drawn.shape == "plane" and scene.world.dim == 3
    color = np.full((len(vertex), 3), style.PLANE if flat else style.SOLID, np.float64)
    number = int(drawn.name.rpartition(" ")[2]) if drawn.name.startswith("obstacle") else None
    if (
        drawn.shape in ROUND
        and scene.world.dim == 3
        and number is not None
        and turns(scene, number)
    ):
        stripe = np.where(np.sin(3 * np.arctan2(vertex[:, 2], vertex[:, 1])) >= 0, 1, -1)
        color *= 1 + STRIPES * (stripe * np.where(vertex[:, 0] >= 0, 1, -1))[:, None]
    place = drawn.centre + vertex @ drawn.turn.T
    return Solid(place, faces, np.clip(color, 0, 255).astype(np.uint8))


def creased(vertex: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A surface whose corners at sharp edges are there once a face: each face then looks flat.

    vertex: (k, 3). faces: (m, 3) int. What is round keeps its common corners, and looks round.
    """
    corner = vertex[faces]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    mean = np.zeros_like(vertex)
    for k in range(3):
        np.add.at(mean, faces[:, k], area)
    length = np.linalg.norm(area, axis=1)[:, None] * np.linalg.norm(mean, axis=1)[faces]
    sharp = np.einsum("mi,mki->mk", area, mean[faces]) < np.cos(np.radians(CREASE)) * length
    new = faces.copy()
    new[sharp] = len(vertex) + np.arange(sharp.sum())
    return np.concatenate([vertex, vertex[faces[sharp]]]), new


def _in_cells(corner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A rectangle of four corners (4, 3), counterclockwise, as cells of two triangles each."""
    n = PLANE_CELLS + 1
    i, j = np.divmod(np.arange(n * n), n)
    along, across = corner[1] - corner[0], corner[3] - corner[0]
    vertex = corner[0] + np.outer(i / PLANE_CELLS, along) + np.outer(j / PLANE_CELLS, across)
    a = np.arange(n * n).reshape(n, n)[:-1, :-1].ravel()
    faces = np.concatenate([np.stack([a, a + n, a + n + 1], 1), np.stack([a, a + n + 1, a + 1], 1)])
    return vertex, faces
