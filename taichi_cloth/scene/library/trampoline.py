"""Three spheres that fall into a pinned net: two are thrown back, the heavy one tears it."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from taichi_cloth.scene.cloth import grid, grid_triangles
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import Particles, Scene, World
from taichi_cloth.settings.parameters import Parameter

WIDTH, HEIGHT, RIM = 4.0, 1.6, 0.1  # of the net; at which it hangs; width of its rim [m]
NET, EDGE, LIGHT, HEAVY = (96, 200, 170), (44, 74, 132), (242, 206, 74), (214, 66, 60)
# Where the spheres are above the net [m], and which part of the heavy one's mass each has.
SPHERES = ((-1.05, 0.8, 0.6, 1 / 30), (0.35, 1.2, -0.9, 1 / 15), (0.65, 1.7, 0.75, 1.0))
RADIUS = 0.2


def scene(
    *,
    side: Annotated[int, Parameter("knots along a side", minimum=9, maximum=256)] = 41,
    heavy: Annotated[float, Parameter("mass of the heavy sphere", unit="kg", above=0)] = 120.0,
    strength: Annotated[
        float,
        Parameter("pull on a width that tears it; inf: none", unit="N/m", above=0, infinite=True),
    ] = 1500.0,
) -> Scene:
    """Spheres fall into a pinned net; the heavy one tears it; SI units."""
    spacing = WIDTH / (side - 1)
    edge = [(i, j) for i in range(side) for j in range(side) if {i, j} & {0, side - 1}]
    net, springs = grid(
        (0.5, HEIGHT, -WIDTH / 2),
        side,
        side,
        spacing,
        pinned=edge,
        across=(1.0, 0.0, 0.0),
        down=(0.0, 0.0, 1.0),
        break_in="tension",
        material=Material(
            density=1.0,
            stretch=4000.0,
            damping_time=2e-4,
            strength=None if np.isinf(strength) else strength,
        ),
    )
    net = replace(net, radius=np.full(len(net), 0.3 * spacing))  # knots, between which one can see
    at = np.array([(0.5 + WIDTH / 2 + x, HEIGHT + y, z) for x, y, z, _ in SPHERES])
    mass = heavy * np.array([part for *_, part in SPHERES])
    spheres = Particles.build(
        at, mass=mass, radius=RADIUS, restitution=0.0, color=[LIGHT, LIGHT, HEAVY]
    )
    off = np.abs(net.position - [0.5 + WIDTH / 2, HEIGHT, 0.0]).max(axis=1)  # from the middle
    rim = (off > WIDTH / 2 - RIM - 1e-9)[:, None]
    return Scene(
        name="trampoline",
        world=World(
            size=(WIDTH + 1, 4.0, WIDTH + 1),
            up="y",
            gravity=(0.0, -9.81, 0.0),
            dt=1 / 60,
            substeps="auto",
            mouse="blow",
            ground=0.0,
            friction=0.5,
            collisions=True,
            contact="resting",
        ),
        particles=replace(net, color=np.where(rim, EDGE, NET).astype(np.uint8)).joined(spheres),
        springs=springs,
        triangles=grid_triangles(side, side)[:, ::-1],  # its front is above
    )
