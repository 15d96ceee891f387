"""Implicit (backward) Euler: v += dt*a(x, v) and x += dt*v, with the new x and v on both sides.

Hairer, Wanner, Solving Ordinary Differential Equations II, IV.3; Baraff, Witkin, "Large steps in
cloth simulation", 1998, but solved until it has converged (`newton.py`). First order, stable at
every dt; it damps an oscillation by 1/sqrt(1 + (dt*omega)^2) a step, which is its error.
"""

import math

import taichi as ti

from taichi_cloth.kernels import newton
from taichi_cloth.kernels.lanes import read
from taichi_cloth.kernels.methods.claims import Claims, backward_euler

CLAIMS = Claims(
    order=1,
    symplectic=False,
    implicit=True,
    stability_limit=math.inf,
    forces=0,
    settings=("tolerance",),
    choose=(
        "Stiff scenes at the frame's step that are to come to rest: it damps what is too fast, "
        "and slow motion with it."
    ),
)
stability_function = backward_euler

LANES, LAUNCHES, NEEDS = newton.LANES, newton.LAUNCHES, newton.NEEDS
VECTORS, LOW_VECTORS, HALOED = newton.VECTORS, newton.LOW_VECTORS, newton.HALOED
SCALARS, COUNTS, SUMS = newton.SCALARS, newton.COUNTS, newton.SUMS


@ti.func
def move(plan: ti.template(), state: ti.template(), c):
    new_v = newton.new_velocity(plan, state, c, read(plan, state.gain, c))
    newton.arrive(plan, state, c, state.dt[None] * new_v, new_v)


PHASES = newton.phases(1.0, newton.start, move)
