"""Dashpots beside the springs, with a tension of c times the rate at which the spring lengthens.

They act along the spring's axis alone, so that a turning spring is not slowed: Baraff, Witkin,
"Large steps in cloth simulation", 1998, section 4.5.
"""

from dataclasses import replace

import numpy as np
import taichi as ti

from taichi_cloth.errors import counted
from taichi_cloth.kernels import laws
from taichi_cloth.kernels.forces.contract import TENSION, Absent, Term, Variant
from taichi_cloth.kernels.spring_numbers import C

LIGHT = 0.02  # of sqrt(stiffness * mass): the damping that a variant gets


@ti.func
def law(length, along, dv, numbers: ti.template()):
    """The tension of dashpots."""
    return laws.dashpot_tension(dv, along, numbers[C])


@ti.func
def damping(numbers: ti.template()):
    """The derivative of the tension by the rate at which a spring lengthens [force / velocity]."""
    return numbers[C]


def present(scene):
    """True if any spring of the scene, or any that clicks make, is damped."""
    clicked = scene.world.takes_clicks and scene.spring_defaults.damping > 0
    return bool((scene.springs.damping > 0).any() or clicked)


def twin(length, rate, springs):
    """The law in NumPy."""
    return springs.damping * rate


def variant(scene):
    """The scene without its dashpots, or with light ones; None for a scene without springs."""
    springs, defaults = scene.springs, scene.spring_defaults
    if len(springs) == 0:
        return None
    used = present(scene)
    if used:
        about = f"{counted(int((springs.damping > 0).sum()), 'spring')}"
        damping = np.zeros(len(springs))
        defaults = replace(defaults, damping=0.0)
    else:
        about = f"{counted(len(springs), 'spring')}, damped lightly"
        mass = float(scene.particles.mass.min())
        damping = LIGHT * np.sqrt(springs.stiffness * mass)
    springs = replace(springs, damping=damping)
    return Variant(
        "dashpots", used, about, replace(scene, springs=springs, spring_defaults=defaults)
    )


TERM = Term(
    adds=TENSION,
    keys=Absent("[spring] damping is a key that every scene has"),
    present=present,
    fields=Absent("a spring's numbers are stored by topology (spring_numbers.py)"),
    law=law,
    acts=Absent("it always acts"),
    after_step=Absent("it changes nothing"),
    stiffness=Absent("it does not depend on length"),
    damping=damping,
    across=Absent("across the spring nothing is damped"),
    energy=Absent("it has no potential: it takes energy"),
    twin=twin,
    bound=lambda world, particles, springs: (np.zeros(len(springs)), springs.damping),
    variant=variant,
)
