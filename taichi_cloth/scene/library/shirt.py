"""A shirt of our own making, held at its collar: what `run shirt.obj` shows of any mesh.

The mesh lies beside this file: two panels of quads, sewn along shoulders, sleeves and sides, 2500
vertices in metres (`tests/shirt.py` made it).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from taichi_cloth.files import meshes
from taichi_cloth.scene import hanging, scenefile
from taichi_cloth.scene.model import Scene
from taichi_cloth.settings.parameters import Parameter

FILE = Path(__file__).with_name("shirt.obj")
THICKNESS = 0.01  # so that its front does not pass through its back [m]


def scene(
    *,
    stretch: Annotated[
        float, Parameter("stiffness of a width of cloth", unit="N/m", above=0)
    ] = hanging.STRETCH,
    density: Annotated[
        float, Parameter("mass of an area", unit="kg/m2", above=0)
    ] = hanging.DENSITY,
    bending: Annotated[
        float, Parameter("rigidity against bending", unit="N m", minimum=0)
    ] = hanging.BENDING,
    thickness: Annotated[
        float,
        Parameter("which keeps it off itself; 0: it passes through itself", unit="m", minimum=0),
    ] = THICKNESS,
) -> Scene:
    """A shirt out of a mesh file, held at its collar; 3-D, in metres and seconds."""
    surface = meshes.read(FILE)
    table = hanging.table(FILE, surface)
    table["name"] = "shirt"
    table["meshes"][0] |= {"stretch": stretch, "density": density, "bending": bending, "parts": 1}
    if thickness:
        table["meshes"][0]["thickness"] = thickness
    return scenefile.parse_table(table, "shirt")
