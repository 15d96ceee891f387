"""A mesh file by itself as a scene: its cloth hangs from its highest points, in SI units, y up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.files.meshes.surface import Surface
from taichi_cloth.scene.spheres import most_near
from taichi_cloth.scene.triangles import areas

GRAVITY = 9.81  # [m/s^2]
FRAME = 1 / 60  # [s]
DENSITY = 0.15  # of a cotton shirt [kg/m^2]
STRETCH = 80.0  # at least, of a soft knit [N/m]
BENDING = 1e-5  # at most, of a cotton shirt [N m]
# Stiffness against bending grows with the fourth power of a triangle's least height, that of
# springs with the square: with stretch height^2 / 30 at most no sliver needs shorter steps than
# springs do.
SLIVER = 30.0
SAG = 0.02  # part of its height by which cloth lengthens at most under its own weight
DRAG = 0.5  # of the air, beside mass: swings die away within seconds [1/s]
DAMPING_RATIO = 0.02  # of a spring between two particles of mean mass
HELD = 0.05  # the part of the height, from the top, that is held
RADIUS = 0.35  # of a particle, in mean edges
MOST_THICK = 20_000  # vertices of a mesh that keeps off itself unasked: steps take twice as long
MOST_NEAR = 48  # vertices within the reach of one, likewise: large triangles beside small ones
FLAT = 1e-6  # a sheet that is less high than this part of its size lies, and is stood upright


def table(path: Path, surface: Surface) -> dict[str, Any]:
    """What a scene file would say of the mesh at `path`, as a table of TOML; surface: the mesh's.

    The mesh is in metres, hangs in the middle of a world three times its size, and is held by all
    vertices within the highest twentieth of its height. A sheet that lies is stood upright. It does
    not pass through itself (`thickness`) where that is no matter of minutes.
    """
    x = surface.vertices
    size = np.ptp(x, axis=0)
    lies = bool(size[1] <= FLAT * size.max())
    if lies:  # y to z, and z to -y: 90 degrees about x
        x = np.stack([x[:, 0], -x[:, 2], x[:, 1]], axis=1)
        size = np.ptp(x, axis=0)
    low, reach = x.min(axis=0), float(size.max())
    # The lowest point stands one size above the ground, which leaves room to swing and to stretch.
    place = np.array([1.5 * reach, reach + size[1] / 2, 0.0]) - low - size / 2
    top = reach + size[1]
    corners = x[surface.triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    area = areas(x, surface.triangles)
    mass = DENSITY * float(area.sum()) / len(x)
    least = float((2 * area / edges.max(axis=1)).min())  # height of a triangle
    radius = RADIUS * float(edges.mean())
    stretch = max(STRETCH, DENSITY * GRAVITY * float(size[1]) / SAG)
    return {
        "world": {
            "size": [3 * reach, float(top + reach), 3 * reach],
            "up": "y",
            "gravity": [0.0, -GRAVITY, 0.0],
            "dt": FRAME,
            "substeps": "auto",
            "mouse": "blow",
        },
        "particle": {"radius": radius, "viscous": DRAG * mass},
        "meshes": [
            {
                "file": str(path.absolute()),
                "turn": [90.0 if lies else 0.0, 0.0, 0.0],
                "move": place.tolist(),
                "pinned": {"above": float(top - HELD * size[1])},
                "stretch": stretch,
                "density": DENSITY,
                **({"thickness": 2 * radius} if keeps_off_itself(x, surface.triangles) else {}),
                "damping": 2 * DAMPING_RATIO * float(np.sqrt(stretch * mass)),
                "bending": min(BENDING, stretch * least**2 / SLIVER),
            }
        ],
    }


def keeps_off_itself(x: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether a mesh has a thickness unasked: it is not so large, or uneven, that this would cost
    more than all the rest. x: its vertices, (n, 3)."""
    return len(x) <= MOST_THICK and most_near(x, triangles) <= MOST_NEAR
