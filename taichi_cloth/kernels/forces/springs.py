"""Springs between two particles, with a tension by Hooke's law: T = k (length - rest)."""

from dataclasses import replace

import numpy as np
import taichi as ti

from taichi_cloth.errors import counted
from taichi_cloth.kernels import laws
from taichi_cloth.kernels.forces.contract import TENSION, Absent, Term, Variant
from taichi_cloth.kernels.spring_numbers import REST, K


@ti.func
def law(length, along, dv, numbers: ti.template()):
    """The tension of springs."""
    return laws.spring_tension(length, numbers[K], numbers[REST])


@ti.func
def stiffness(numbers: ti.template()):
    """The derivative of the tension by length [force / length]."""
    return numbers[K]


@ti.func
def across(length, numbers: ti.template(), least):
    """The stiffness across the spring's axis, at least `least` times the one along it."""
    return laws.spring_stiffness_across(length, numbers[K], numbers[REST], least)


def present(scene):
    """True if the scene has springs, clicks can make some, or stencils are summed as they are."""
    bends = bool((scene.stencils.bending > 0).any())
    return scene.world.takes_clicks or len(scene.springs) > 0 or bends


def energies(x, springs):
    """The potential energy k (length - rest)^2 / 2 of each spring, (s,)."""
    a, b = springs.between.T
    d = x.take(b, axis=0) - x.take(a, axis=0)
    stretch = np.sqrt(np.einsum("ij,ij->i", d, d)) - springs.rest_length
    return 0.5 * (springs.stiffness * stretch**2)


def energy(x, v, world, particles, springs):
    """The potential energy of all springs."""
    return float(energies(x, springs).sum())


def twin(length, rate, springs):
    """The law in NumPy."""
    return springs.stiffness * (length - springs.rest_length)


def variant(scene):
    """The scene without its springs; None where it has none, or clicks make some."""
    springs = scene.springs
    if len(springs) == 0 or scene.world.takes_clicks:
        return None
    without = replace(
        scene,
        springs=springs.select(np.zeros(len(springs), bool)),
        stencils=scene.stencils.select(np.zeros(len(scene.stencils), bool)),
    )
    return Variant("springs", True, counted(len(springs), "spring"), without)


TERM = Term(
    adds=TENSION,
    keys=Absent("the numbers of springs are keys that every scene has"),
    present=present,
    fields=Absent("a spring's numbers are stored by topology (spring_numbers.py)"),
    law=law,
    acts=Absent("it always acts"),
    after_step=Absent("it changes nothing"),
    stiffness=stiffness,
    damping=Absent("it does not depend on velocity"),
    across=across,
    energy=energy,
    twin=twin,
    bound=lambda world, particles, springs: (springs.stiffness, np.zeros(len(springs))),
    variant=variant,
)
