"""The hanging cloth: pinned at three particles of its first row, blown and torn by the mouse."""

from __future__ import annotations

import math
from typing import Annotated

from taichi_cloth.scene.cloth import grid
from taichi_cloth.scene.model import ParticleDefaults, Scene, SpringDefaults, World
from taichi_cloth.settings.options import Parameter

LEFT, TOP = 100.0, 20.0  # where the first particle hangs
RIGHT_MARGIN, BOTTOM_MARGIN = 125.0, 105.0  # room to swing beside and below the cloth


def scene(
    *,
    columns: Annotated[int, Parameter("particles in a row", minimum=1, maximum=4096)] = 16,
    rows: Annotated[int, Parameter("particles in a column", minimum=1, maximum=4096)] = 12,
    spacing: Annotated[float, Parameter("distance of neighbours", unit="px", above=0)] = 25.0,
    shear: Annotated[float, Parameter("stiffness of springs across, 0: none", minimum=0)] = 0.0,
    bend: Annotated[float, Parameter("that of springs to the next but one", minimum=0)] = 0.0,
    damping: Annotated[float, Parameter("dashpot of every spring", minimum=0)] = 0.0,
) -> Scene:
    """A cloth hanging from its first row's two ends and middle; the mouse blows and tears it.

    Without shear, bend and damping it is the cloth of the first program, bit for bit.
    """
    particle = ParticleDefaults(mass=1.0, radius=5.0, viscous=0.05, restitution=0.0)
    spring = SpringDefaults(stiffness=0.5, rest_length=spacing, break_force=5.0, damping=damping)
    stiffness = {kind: k for kind, k in (("shear", shear), ("bend", bend)) if k > 0}
    at_rest = {"shear": math.sqrt(2) * spacing, "bend": 2 * spacing}
    particles, springs = grid(
        (LEFT, TOP),
        columns,
        rows,
        spacing,
        links=("structural", *stiffness),
        stiffness=stiffness,
        rest_length={kind: at_rest[kind] for kind in stiffness},
        pinned=[(0, 0), (columns // 2, 0), (columns - 1, 0)],
        particle_defaults=particle,
        spring_defaults=spring,
    )
    return Scene(
        name="cloth",
        world=World(
            size=(
                max(600.0, LEFT + (columns - 1) * spacing + RIGHT_MARGIN),
                max(400.0, TOP + (rows - 1) * spacing + BOTTOM_MARGIN),
            ),
            gravity=(0.0, 0.05),
            walls=("top", "bottom", "left", "right"),
            mouse="blow",
        ),
        particles=particles,
        springs=springs,
        particle_defaults=particle,
        spring_defaults=spring,
    )
