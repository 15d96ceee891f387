"""The colours of the picture, the same in every view. All are (r, g, b), 0..255."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

SURROUND = (15, 17, 23)  # outside a 2-D world, and behind the text
WORLD = (23, 26, 35)  # inside a 2-D world, and behind a 3-D one
WALL = (92, 104, 128)
EDGE = (86, 98, 122)  # the wireframe of a 3-D world
NEUTRAL = (205, 212, 226)  # what springs are mixed with
INK = (226, 231, 240)
KEY_INK = (255, 203, 107)
MUTED = (146, 156, 178)  # text of less weight
GOOD, WARN, BAD = (126, 200, 138), (240, 186, 92), (236, 104, 98)  # states, from fine to not
PAPER = (19, 22, 30)
BUTTON, CHOSEN = (36, 41, 54), (56, 92, 150)  # of the tool bar; the one in use
BANNER_PAPER = (132, 28, 36)
BANNER_INK = (255, 240, 238)
GHOST, GHOST_SHARE = (150, 205, 255), 0.5  # so much of it is seen, and so much what is behind it
GHOST_ON_WORLD = tuple(round((a + b) / 2) for a, b in zip(GHOST, WORLD, strict=True))
RECORDING = (232, 64, 64)
POINTER = (((15, 17, 23), 3.4), ((236, 239, 244), 1.4))  # its lines, pixels wide, upon each other

AMBIENT = 0.38  # share of a sphere's colour that needs no light
LIGHT = np.array([-0.45, -0.65, -0.62])  # direction to the light: left, above, towards us
LIGHT /= np.linalg.norm(LIGHT)
FILL = np.array([0.8, -0.3, -0.35])  # to a second one, for surfaces: their folds have no dark side
FILL /= np.linalg.norm(FILL)
FILL_STRENGTH = 0.22
LIGHTS = ((LIGHT, 1 - AMBIENT), (FILL, FILL_STRENGTH))  # of surfaces: direction, strength

SHEEN = 0.10  # of light that a fabric's fibres add where one sees it along its surface

# A surface's back is a lining in the first of these colours; in the second, where its front has
# about the same hue and could be a back in the shade. BACK_SHARE: the part that is the front's.
BACKS, BACK_SHARE, SAME_HUE = ((190, 166, 122), (112, 140, 180)), 0.18, 0.06
SOLID = (168, 176, 190)  # of obstacles
PLANE = (104, 112, 130)  # of endless ones
TILES = ((52, 57, 71), (42, 46, 59))  # of the floor
AXES = ((214, 92, 92), (104, 190, 110), (96, 140, 232))  # x, y, z


def spring_colors(
    color: np.ndarray, segments: np.ndarray, given: Sequence[int] | np.ndarray | None
) -> np.ndarray:
    """One colour a spring, (s, 3) float 0..1: the one that is given, for all or for each.

    Where none is, and where some springs are not drawn because their ends are lost, it is its ends'
    mean, mixed half and half with neutral.

    color: of the particles, (n, 3) uint8; segments: (s, 2) int. given: 0..255.
    """
    if isinstance(given, np.ndarray):
        if len(given) == len(segments):
            own: np.ndarray = given.astype(np.float32) / 255
            return own
    elif given is not None:
        return np.tile(np.array(unit(given), np.float32), (len(segments), 1))
    c = np.asarray(color, np.float32) / 255
    mean = (c[segments[:, 0]] + c[segments[:, 1]]) / 2
    mixed: np.ndarray = 0.5 * mean + 0.5 * np.array(NEUTRAL, np.float32) / 255
    return mixed


def flat_colors(color: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """One colour a triangle of a 2-D surface, (m, 3) float 0..1: its corners' mean, darker.

    color: of the particles, (n, 3) uint8; triangles: (m, 3) int.
    """
    mean: np.ndarray = color[triangles].mean(axis=1) / 255
    return 0.62 * mean


def unit(color: Sequence[int]) -> tuple[float, float, float]:
    """`color` as floats 0..1."""
    red, green, blue = (float(c) / 255 for c in color)
    return red, green, blue


def packed(color: ArrayLike) -> np.ndarray:
    """Float colours (n, 3) in 0..1 as 0xRRGGBB integers, shape (n,)."""
    c = np.clip(np.asarray(color) * 255 + 0.5, 0, 255).astype(np.uint32)
    codes: np.ndarray = (c[:, 0] << 16) | (c[:, 1] << 8) | c[:, 2]
    return codes


def packed_one(color: Sequence[int]) -> int:
    """One 0..255 colour as a 0xRRGGBB integer."""
    return (int(color[0]) << 16) | (int(color[1]) << 8) | int(color[2])


def box_edges(world_size: Sequence[float]) -> np.ndarray:
    """The twelve edges of a 3-D world, (12, 2, 3) world units."""
    w, h, d = world_size
    corner = np.array(
        [(x, y, z) for x in (0, w) for y in (0, h) for z in (-d / 2, d / 2)], np.float64
    )
    pairs = [(a, a | bit) for a in range(8) for bit in (1, 2, 4) if not a & bit]
    edges: np.ndarray = corner[np.array(pairs)]
    return edges
