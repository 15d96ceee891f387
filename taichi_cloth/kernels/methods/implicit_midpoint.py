"""Implicit midpoint: v += dt*a and x += dt*u, where a and u are those in the middle of the step.

Hairer, Lubich, Wanner, Geometric Numerical Integration, I.1.2 and VI.4. Second order, symplectic
without drag; stable at every dt for linear springs, and keeps their energy exactly. What it cannot
resolve it neither damps nor follows: it swings slower. The middle is an implicit Euler stage of
half the step (`newton.py`).
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
)


def stability_function(z):
    """What a step makes of y' = mu y, where z = dt mu."""
    return (1 + z / 2) / (1 - z / 2)


LANES, LAUNCHES, NEEDS = newton.LANES, newton.LAUNCHES, newton.NEEDS
VECTORS, LOW_VECTORS, HALOED = newton.VECTORS, newton.LOW_VECTORS, newton.HALOED
SCALARS, COUNTS, SUMS = newton.SCALARS, newton.COUNTS, newton.SUMS


@ti.func
def begin_step(plan: ti.template(), state: ti.template(), t):
    newton.set_tau(plan, state, t, 0.5 * state.dt[None])
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
    middle = read(plan, state.v, c)
    new_v = sped_up(plan, state, c, v, velocity_jump(plan, state, c, x, v))
    new_v = sped_up(plan, state, c, new_v, 2.0 * read(plan, state.gain, c))
    new_x = newton.moved_from_old(plan, state, c, state.dt[None] * middle)
    store(plan, state, c, kept_above_floor(plan, state, c, x, v, new_x, new_v), new_v)


PHASES = newton.phases(begin_step, finish)
