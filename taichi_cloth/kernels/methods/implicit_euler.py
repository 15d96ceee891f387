"""Implicit (backward) Euler: v += dt*a(x, v) and x += dt*v, with the new x and v on both sides.

Hairer, Wanner, Solving Ordinary Differential Equations II, IV.3; Baraff, Witkin, "Large steps in
cloth simulation", 1998, but solved until it has converged (`newton.py`). First order, stable at
every dt; it damps an oscillation by 1/sqrt(1 + (dt*omega)^2) a step, which is its error.
"""

import math

import taichi as ti

from taichi_cloth.kernels import newton
from taichi_cloth.kernels.contact import compute_contacts, kept_above_floor, velocity_jump
from taichi_cloth.kernels.lanes import read
from taichi_cloth.kernels.loops import each_cell_moving
from taichi_cloth.kernels.methods.claims import Claims
from taichi_cloth.kernels.sums import sped_up
from taichi_cloth.kernels.watch import store

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


def stability_function(z):
    """What a step makes of y' = mu y, where z = dt mu."""
    return 1 / (1 - z)


LANES, LAUNCHES, NEEDS = newton.LANES, newton.LAUNCHES, newton.NEEDS
VECTORS, LOW_VECTORS, HALOED = newton.VECTORS, newton.LOW_VECTORS, newton.HALOED
SCALARS, COUNTS, SUMS = newton.SCALARS, newton.COUNTS, newton.SUMS


@ti.func
def begin_step(plan: ti.template(), state: ti.template(), t):
    newton.set_tau(plan, state, t, state.dt[None])
    compute_contacts(plan, state)
    each_cell_moving(plan, state, t, newton.start)
    newton.begin_stage(plan, state, t, 0)


@ti.func
def finish(plan: ti.template(), state: ti.template(), t):
    each_cell_moving(plan, state, t, move)
    newton.end_stage(plan, state, t, 0)


@ti.func
def move(plan: ti.template(), state: ti.template(), c):
    x, v = read(plan, state.old_x, c), read(plan, state.old_v, c)
    new_v = sped_up(plan, state, c, v, velocity_jump(plan, state, c, x, v))
    new_v = sped_up(plan, state, c, new_v, read(plan, state.gain, c))
    new_x = newton.moved_from_old(plan, state, c, state.dt[None] * new_v)
    store(plan, state, c, kept_above_floor(plan, state, c, x, v, new_x, new_v), new_v)


PHASES = newton.phases(begin_step, finish)
