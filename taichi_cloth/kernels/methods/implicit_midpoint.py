"""Implicit midpoint: v += dt*a and x += dt*u, where a and u are those in the middle of the step.

Hairer, Lubich, Wanner, Geometric Numerical Integration, I.1.2 and VI.4. Second order, symplectic
without drag; stable at every dt for linear springs, whose energy it keeps exactly. What swings too
fast for dt is not damped; it swings more slowly than it should. The middle of the step is found as
an implicit Euler stage of half the step (`solvers/newton_cg.py`).
"""

import math

import taichi as ti

from taichi_cloth.kernels.methods.contract import Claims, Method
from taichi_cloth.kernels.packs import read
from taichi_cloth.kernels.solvers import newton_cg, stages


def stability_function(z):
    """The factor by which a step multiplies the y of y' = mu y, where z = dt mu."""
    return (1 + z / 2) / (1 - z / 2)


@ti.func
def move(spec: ti.template(), state: ti.template(), i):
    """Take pack i from the middle, which the one stage has found, to the end of the step."""
    new_v = stages.new_velocity(spec, state, i, 2.0 * read(spec, state.gain, i))
    dt = stages.time_of_part(state)
    stages.arrive(spec, state, i, dt * read(spec, state.v, i), new_v)


METHOD = Method(
    claims=Claims(
        order=2,
        symplectic=True,
        implicit=True,
        stability_limit=math.inf,
        forces=0,
        settings=("tolerance",),
        choose=(
            "Stiff scenes whose energy must last: no amplitude is lost. What is too fast to follow "
            "rings on, at a lower pitch."
        ),
    ),
    position_weight=0.5,
    force_times=((0, 0.5),),
    phases=newton_cg.phases(0.5, stages.start, move),
    stability_function=stability_function,
    **newton_cg.keeps(),
)
