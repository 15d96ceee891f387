"""Springs between two particles: Hooke's law along their axis, T = k (length - rest)."""

from dataclasses import replace

import numpy as np
import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.forces.contract import TENSION, Absent, Term, Variant, counted
from taichi_cloth.kernels.spring_numbers import REST, K


@ti.func
def law(length, along, dv, numbers: ti.template()):
    return laws.spring_tension(length, numbers[K], numbers[REST])


@ti.func
def stiffness(numbers: ti.template()):
    return numbers[K]


@ti.func
def across(length, numbers: ti.template(), least):
    return laws.spring_stiffness_across(length, numbers[K], numbers[REST], least)


def present(scene):
    return scene.world.mouse == "spawn" or len(scene.springs) > 0


def energy(x, v, world, particles, springs):
    a, b = springs.between.T
    stretch = np.linalg.norm(x[b] - x[a], axis=1) - springs.rest_length
    return float(0.5 * (springs.stiffness * stretch**2).sum())


def twin(length, rate, springs):
    return springs.stiffness * (length - springs.rest_length)


def variant(scene):
    springs = scene.springs
    if len(springs) == 0 or scene.world.mouse == "spawn":
        return None
    without = replace(scene, springs=springs.select(np.zeros(len(springs), bool)))
    return Variant("springs", True, counted(len(springs), "spring"), without)


TERM = Term(
    adds=TENSION,
    keys=Absent("the numbers of springs are keys that every scene has"),
    present=present,
    fields=Absent("a spring's numbers are stored by topology (spring_numbers.py)"),
    law=law,
    stiffness=stiffness,
    damping=Absent("it does not depend on velocity"),
    across=across,
    energy=energy,
    twin=twin,
    bound=lambda world, particles, springs: (springs.stiffness, np.zeros(len(springs))),
    variant=variant,
)
