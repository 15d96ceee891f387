"""Bending of cloth with a rigidity B, E = B/2 |curvature vector|^2 for each stencil.

The curvature vectors, of rows of particles and of triangles in meshes, are those of
`scene/stencils.py`, which has their sources. The force is linear in positions, as in Bergou,
Wardetzky, Harmon, Zorin, Grinspun, "A quadratic bending model for inextensible surfaces", 2006.
"""

from dataclasses import replace

import numpy as np
import taichi as ti

from taichi_cloth.errors import counted
from taichi_cloth.kernels.forces.contract import CURVATURE, Absent, Term, Variant


@ti.func
def law(curvature, k):
    """The force on a particle of weight 1."""
    return -1.0 * k * curvature


@ti.func
def stiffness(k):
    """By how much it falls with the curvature vector."""
    return k


def present(scene):
    """True if any stencil of the scene has a rigidity."""
    return bool((scene.stencils.bending > 0).any())


def energy(x, v, world, particles, stencils):
    """The bending energy of all stencils."""
    squares = (stencils.curvature(x) ** 2).sum(axis=1)
    return float(0.5 * (stencils.stiffness(particles.fixed) * squares).sum())


def variant(scene):
    """The scene without it; None where it has none: `explain` knows where grids are."""
    if not present(scene):
        return None
    about = f"of {counted(len(scene.stencils), 'stencil')}"
    none = scene.stencils.select(np.zeros(len(scene.stencils), bool))
    return Variant("bending", True, about, replace(scene, stencils=none))


TERM = Term(
    adds=CURVATURE,
    keys=Absent("[[cloths]] and [[meshes]] bending is the rigidity of a cloth"),
    present=present,
    fields=Absent("stencils are stored by topology (stencils.py)"),
    law=law,
    acts=Absent("it always acts"),
    after_step=Absent("it changes nothing"),
    stiffness=stiffness,
    damping=Absent("it does not depend on velocity"),
    across=Absent("it is as stiff in every direction"),
    energy=energy,
    twin=lambda curvature, k: -k[:, None] * curvature,
    bound=lambda world, particles, stencils: (
        stencils.stiffness(particles.fixed),
        np.zeros(len(stencils)),
    ),
    variant=variant,
)
