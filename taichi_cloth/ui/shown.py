"""Parts of cloths that are drawn: surface, springs, particles, or several of these.

What lies in no surface (balls, chains, torn threads) is drawn as ever beside surfaces.
"""

from __future__ import annotations

import numpy as np

from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.palette import FIXED_COLOR

# What the key goes through, in turn.
CHOICES = (
    frozenset({"surface"}),
    frozenset({"surface", "springs"}),
    frozenset({"springs", "particles"}),
)
NONE = np.zeros((0, 3), np.int64)
TURNED = 0.5  # share by which more of a surface is seen from behind than from before
LEVEL = 0.8  # share of a surface that looks up, or down, where it lies level


def default_for(scene: Scene) -> frozenset[str]:
    """Parts of a scene's cloths that are drawn from the start."""
    return CHOICES[0 if scene.world.dim == 3 and len(scene.triangles) else 2]


def next_choice(parts: frozenset[str]) -> frozenset[str]:
    """The choice after `parts`, by the key."""
    return CHOICES[(CHOICES.index(parts) + 1) % len(CHOICES)] if parts in CHOICES else CHOICES[0]


def surface_colors(color: np.ndarray, fixed: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The colours (n, 3) uint8 that particles have in surfaces: those that are held, too.

    By themselves these are grey; in a surface they have the colour of what they hold.

    color: (n, 3) uint8. fixed: (n,) bool. triangles: (m, 3) int.
    """
    grey = fixed & (color == FIXED_COLOR).all(axis=1)
    if not grey.any():
        return color
    color = color.copy()
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = np.concatenate([edges, edges[:, ::-1]])
    while True:  # it spreads from corner to corner
        to, of = edges[grey[edges[:, 0]] & ~grey[edges[:, 1]]].T
        if not len(to):
            return color
        color[to] = color[of]
        grey[to] = False


def chosen(
    parts: frozenset[str], triangles: np.ndarray, segments: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """The triangles and springs that are drawn, and which particles are, as in a `Picture`.

    parts: words of `SHOWN`. triangles: (m, 3) and segments: (s, 2), those that hold.
    count: of the particles.
    """
    surface = "surface" in parts
    seen = triangles if surface else NONE
    if {"springs", "particles"} <= parts:
        return seen, segments, None
    in_surface = np.zeros(count, bool)
    in_surface[triangles] = True
    if "springs" not in parts:
        loose = ~in_surface[segments].all(axis=1)
        segments = segments[loose] if surface else segments[:0]
    as_spheres = None if "particles" in parts else ~in_surface if surface else in_surface & False
    return seen, segments, as_spheres


def turned_away(
    eye: np.ndarray, position: np.ndarray, triangles: np.ndarray, up: float = 1.0
) -> np.ndarray:
    """Which particles are in surfaces that turn their back to an eye (3,), (n,) bool.

    Surfaces are what triangles join. More than half of what is seen of one must be its back: closed
    bodies, of which half is seen from either side, keep theirs. One that lies level is seen from
    above once it has fallen: it is turned where its back is up.

    position: (n, 3). triangles: (m, 3) int. up: 1 where y points up, else -1.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(position)
    corner = position[triangles]
    ends = np.repeat(triangles[:, :1], 2, axis=1), triangles[:, 1:]
    joined = coo_array((np.ones(ends[0].size), tuple(end.ravel() for end in ends)), (count, count))
    surface = connected_components(joined, directed=False)[1]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    way = corner.mean(axis=1) - eye
    away = np.einsum("ij,ij->i", normal, way) / np.linalg.norm(way, axis=1) ** 3
    of = surface[triangles[:, 0]]
    whole = np.bincount(of, np.abs(away), count)
    behind = np.bincount(of, away, count) > TURNED * whole
    area = np.linalg.norm(normal, axis=1)
    risen = np.bincount(of, up * normal[:, 1], count)
    level = np.abs(risen) > LEVEL * np.bincount(of, area, count)
    turned: np.ndarray = np.where(level, risen < 0, behind)[surface]
    return turned


def turned_over(triangles: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """The triangles (m, 3) with those the other way round whose corners are `turned`, (n,) bool."""
    over = triangles.copy()
    over[turned[triangles[:, 0]]] = triangles[turned[triangles[:, 0]]][:, ::-1]
    return over
