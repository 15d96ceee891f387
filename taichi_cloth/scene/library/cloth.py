"""The hanging cloth: held at some particles of its first row, blown and torn by the mouse.

A larger cloth hangs as the first program's does. Its pins are as near to each other (at least every
8th particle of the first row is one), and where it has more than 12 rows gravity is less by as
much, so that a column pulls at the first row with the weight of 12. The pull of each spring is then
about that of the first program's, in any size: none breaks as the cloth falls into its shape, the
mouse tears it as easily, and the step that is stable stays the same. (Stronger springs would hold a
large cloth, too, but stretched to several times its length, and no mouse could tear them; stiffer
ones would need shorter steps.)
"""

from __future__ import annotations

import math
from typing import Annotated

from taichi_cloth.errors import InputError
from taichi_cloth.scene.cloth import grid, grid_triangles
from taichi_cloth.scene.model import ParticleDefaults, Scene, SpringDefaults, World
from taichi_cloth.settings.parameters import Parameter

LEFT, TOP = 100.0, 20.0  # where the first particle hangs
WHITE = (255, 255, 255)
RIGHT_MARGIN, BOTTOM_MARGIN = 125.0, 105.0  # room to swing beside and below the cloth
STRETCH = 1.2  # further room below for each row beyond ROWS [px]: twice what it adds at rest

# The size of the first program's cloth, and what it hangs from and by.
COLUMNS, ROWS, SPACING = 16, 12, 25.0
STIFFNESS, BREAK_FORCE, GRAVITY = 0.5, 5.0, 0.05
PINS, PIN_DISTANCE = 3, 8  # how many pins; at most how many columns from one to the next


def scene(
    *,
    columns: Annotated[int, Parameter("particles in a row", minimum=1, maximum=4096)] = COLUMNS,
    rows: Annotated[int, Parameter("particles in a column", minimum=1, maximum=4096)] = ROWS,
    spacing: Annotated[float, Parameter("distance of neighbours", unit="px", above=0)] = SPACING,
    pins: Annotated[
        int | None,
        Parameter(
            "particles of the top row that are held, evenly spread: 2 the corners, as many as "
            "columns the row (default: 3, and at least every 8th)",
            minimum=0,
            maximum=4096,
        ),
    ] = None,
    gravity: Annotated[
        float | None,
        Parameter("acceleration downwards (default: 0.05, and above 12 rows 0.6 / rows)"),
    ] = None,
    stiffness: Annotated[
        float, Parameter("stiffness of springs between neighbours", minimum=0)
    ] = STIFFNESS,
    break_force: Annotated[
        float,
        Parameter("force that breaks a spring; inf: none does", above=0, infinite=True),
    ] = BREAK_FORCE,
    shear: Annotated[float, Parameter("stiffness of springs across, 0: none", minimum=0)] = 0.0,
    bend: Annotated[float, Parameter("that of springs to the next but one", minimum=0)] = 0.0,
    damping: Annotated[float, Parameter("dashpot of every spring", minimum=0)] = 0.0,
) -> Scene:
    """A cloth hanging from some particles of its first row; the mouse blows and tears it.

    In its own size, without shear, bend and damping, it is that of the first program, bit for bit.
    """
    if pins is None:
        pins = min(columns, max(PINS, 1 + math.ceil((columns - 1) / PIN_DISTANCE)))
    if pins > columns:
        raise InputError(f"pins must be at most the columns, {columns}, is {pins}")
    if gravity is None:
        gravity = GRAVITY * min(1.0, ROWS / rows)
    particle = ParticleDefaults(mass=1.0, radius=5.0, viscous=0.05, restitution=0.0)
    spring = SpringDefaults(
        stiffness=stiffness,
        rest_length=spacing,
        break_force=None if math.isinf(break_force) else break_force,
        damping=damping,
    )
    further = {kind: k for kind, k in (("shear", shear), ("bend", bend)) if k > 0}
    at_rest = {"shear": math.sqrt(2) * spacing, "bend": 2 * spacing}
    particles, springs = grid(
        (LEFT, TOP),
        columns,
        rows,
        spacing,
        links=("structural", *further),
        stiffness=further,
        rest_length={kind: at_rest[kind] for kind in further},
        pinned=[(column, 0) for column in _spread(pins, columns)],
        particle_defaults=particle,
        spring_defaults=spring,
    )
    below = BOTTOM_MARGIN + STRETCH * max(0, rows - ROWS)
    return Scene(
        name="cloth",
        world=World(
            size=(
                max(600.0, LEFT + (columns - 1) * spacing + RIGHT_MARGIN),
                max(400.0, TOP + (rows - 1) * spacing + below),
            ),
            gravity=(0.0, gravity),
            walls=("top", "bottom", "left", "right"),
            mouse="blow",
        ),
        spring_color=WHITE,
        particles=particles,
        springs=springs,
        particle_defaults=particle,
        spring_defaults=spring,
        triangles=grid_triangles(columns, rows),
    )


def _spread(count: int, columns: int) -> list[int]:
    """The columns of `count` pins, both ends among them; of a single one, the middle."""
    if count == 1:
        return [columns // 2]
    # Halves are rounded up: the middle one of 16 columns is the 8th.
    return [(2 * i * (columns - 1) + count - 1) // (2 * (count - 1)) for i in range(count)]
