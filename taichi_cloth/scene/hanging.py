"""A mesh file by itself as a scene: its cloth hangs from its highest points, in SI units, y up."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.files.meshes.surface import Surface
from taichi_cloth.scene.mesh import placed
from taichi_cloth.scene.spheres import most_near
from taichi_cloth.scene.triangles import areas
from taichi_cloth.settings import accepted

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
SMALL, LARGE = 0.1, 10.0  # sizes beyond which nobody wears it [m]
FLAT = 1e-6  # a sheet that is less high than this part of its size lies, and is stood upright


def table(path: Path, surface: Surface, given: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The scene file of the mesh at `path`, as a table of TOML; surface: the mesh's.

    The mesh is in metres, hangs in the middle of a world three times its size, and is held by all
    vertices within the highest twentieth of its height. A sheet that lies is stood upright; one
    that is turned so that it lies is held at its far side. It does not pass through itself
    (`thickness`) where that is no matter of minutes.

    given: keys by which the mesh is placed otherwise: scale, turn, move; what else the table says
    follows from where it is then. InputError for values that make no sense.
    """
    given = given or {}
    scale, turn = given.get("scale", 1.0), given.get("turn", [0.0, 0.0, 0.0])
    x = placed(surface.vertices, scale, turn, np.zeros(3))
    size = np.ptp(x, axis=0)
    lies = bool(size[1] <= FLAT * size.max())
    if lies and "turn" not in given:
        lies, turn = False, [90.0, 0.0, 0.0]  # y to z, and z to -y
        x = np.stack([x[:, 0], -x[:, 2], x[:, 1]], axis=1)
        size = np.ptp(x, axis=0)
    low, reach = x.min(axis=0), float(size.max())
    # The lowest point stands one size above the ground, which leaves room to swing and to stretch.
    place = np.array([1.5 * reach, reach + size[1] / 2, 0.0]) - low - size / 2
    world = np.array([3 * reach, 2 * reach + size[1], 3 * reach])
    if "move" in given:  # then as much room is around it as the world reaches there
        place = accepted.array("meshes: move", given["move"], (3,))
        high = low + place + size
        room = np.array([high[0], high[1], 2 * max(high[2], -low[2] - place[2])]) + reach
        world = np.maximum(world, room)
    top = float(low[1] + place[1] + size[1])
    held: Any = {"above": top - HELD * float(size[1])}
    if lies:  # as it was turned: its far side is held
        held = surface.number[x[:, 2] <= low[2] + HELD * size[2]].tolist()
    corners = x[surface.triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    area = areas(x, surface.triangles)
    mass = DENSITY * float(area.sum()) / len(x)
    least = float((2 * area / edges.max(axis=1)).min())  # height of a triangle
    radius = RADIUS * float(edges.mean())
    stretch = max(STRETCH, DENSITY * GRAVITY * float(size[1]) / SAG)
    return {
        "world": {
            "size": world.tolist(),
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
                "scale": scale,
                "turn": turn,
                "move": place.tolist(),
                "pinned": held,
                "stretch": stretch,
                "density": DENSITY,
                **({"thickness": 2 * radius} if keeps_off_itself(x, surface.triangles) else {}),
                "damping": 2 * DAMPING_RATIO * float(np.sqrt(stretch * mass)),
                "bending": min(BENDING, stretch * least**2 / SLIVER),
            }
        ],
    }


def note_of_size(x: np.ndarray, scale: float) -> str | None:
    """A note on a mesh (n, 3) that is no garment's size in metres: the scale that makes it so;
    None: it may be one. scale: that it has.
    """
    size = float(np.ptp(x, axis=0).max())
    if SMALL < size < LARGE:
        return None
    powers = {10.0**k: "" for k in range(-12, 13) if k}
    factors = powers | {0.001: "millimetres", 0.01: "centimetres", 0.0254: "inches"}
    best = min(factors, key=lambda factor: abs(np.log(factor * size)))
    unit = f"if it is in {factors[best]}, " if factors[best] and scale == 1 else ""
    return (
        f"it is {size:.3g} m large, and garments are about 1 m: {unit}"
        f"--set meshes[0].scale={scale * best:.6g} makes it {best * size:.3g} m"
    )


def keeps_off_itself(x: np.ndarray, triangles: np.ndarray) -> bool:
    """True if a mesh has a thickness unasked: it is not so large, or uneven, that this would cost
    more than all the rest. x: its vertices, (n, 3)."""
    return len(x) <= MOST_THICK and most_near(x, triangles) <= MOST_NEAR
