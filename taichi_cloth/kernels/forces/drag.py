"""Viscous drag on single particles, f = -c v, where [particle] viscous is c.

Stokes, "On the effect of the internal friction of fluids on the motion of pendulums", 1851.
"""

from dataclasses import replace

import numpy as np
import taichi as ti

from taichi_cloth.errors import counted
from taichi_cloth.kernels import laws
from taichi_cloth.kernels.forces.contract import (
    FORCE,
    PARTICLE_NUMBER,
    Absent,
    DeviceField,
    Term,
    Variant,
)
from taichi_cloth.kernels.packs import read

LIGHT = 0.01  # of mass / dt: the drag that a variant gets, with which its step stays stable


@ti.func
def law(spec: ti.template(), state: ti.template(), i):
    """The drag on pack i."""
    return laws.drag_force(read(spec, state.v, i), read(spec, state.viscous, i))


@ti.func
def damping(spec: ti.template(), state: ti.template(), number: ti.template(), i):
    """The derivative -df/dv at i, a number for each particle [force / velocity]."""
    return number(spec, state.viscous, i)


def present(scene):
    """True if any particle of the scene, or any that clicks make, has drag."""
    clicked = scene.world.takes_clicks and scene.particle_defaults.viscous > 0
    return bool((scene.particles.viscous > 0).any() or clicked)


def twin(x, v, world, particles):
    """The law in NumPy."""
    return -particles.viscous[:, None] * v


def variant(scene):
    """The scene without its drag, or with a light one on every particle."""
    particles, defaults = scene.particles, scene.particle_defaults
    used = present(scene)
    if used:
        about = f"of {counted(int((particles.viscous > 0).sum()), 'particle')}"
        viscous = np.zeros(len(particles))
        defaults = replace(defaults, viscous=0.0)
    else:
        about = f"{LIGHT:g} of mass / dt for each particle"
        same = scene.features().uniform_particles and len(particles)
        mass = np.full(len(particles), particles.mass[0]) if same else particles.mass
        viscous = LIGHT * mass / scene.world.dt
    particles = replace(particles, viscous=viscous)
    changed = replace(scene, particles=particles, particle_defaults=defaults)
    return Variant("drag", used, about, changed)


TERM = Term(
    adds=FORCE,
    keys=Absent("[particle] viscous is a key that every scene has"),
    present=present,
    fields=(DeviceField("viscous", PARTICLE_NUMBER, lambda world, particles: particles.viscous),),
    law=law,
    acts=Absent("it always acts"),
    after_step=Absent("it changes nothing"),
    stiffness=Absent("it does not depend on position"),
    damping=damping,
    across=Absent("it does not act along springs"),
    energy=Absent("it has no potential: it takes energy"),
    twin=twin,
    bound=lambda world, particles, springs: (np.zeros(len(particles)), particles.viscous),
    variant=variant,
)
