"""Explicit (forward) Euler: x += dt*v with the old v, v += dt*a(x, v).

Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, I.7. First order; an undamped
oscillation grows at every dt, which is why it is here: as the baseline that others beat.
"""

import taichi as ti

from taichi_cloth.kernels.compensated import moved, sped_up
from taichi_cloth.kernels.contact import compute_contacts, kept_above_floor, velocity_jump
from taichi_cloth.kernels.forces import accelerate_then
from taichi_cloth.kernels.methods.contract import Claims
from taichi_cloth.kernels.packs import read
from taichi_cloth.kernels.watchdog import store

CLAIMS = Claims(
    order=1,
    symplectic=False,
    implicit=False,
    stability_limit=0.0,
    choose="Never: every swing grows. It is the baseline that the others are held against.",
)


def stability_function(z):
    """What a step makes of y' = mu y, where z = dt mu."""
    return 1 + z


@ti.func
def move(plan: ti.template(), state: ti.template(), c, a):
    dt, x, v = state.dt[None], read(plan, state.x, c), read(plan, state.v, c)
    jump = velocity_jump(plan, state, c, x, v)
    new_v = sped_up(plan, state, c, sped_up(plan, state, c, v, dt * a), jump)
    new_x = moved(plan, state, c, x, dt * v)
    new_x = kept_above_floor(plan, state, c, x, v, new_x, new_v)
    store(plan, state, c, new_x, new_v)


@ti.func
def step(plan: ti.template(), state: ti.template(), t):
    compute_contacts(plan, state)
    accelerate_then(plan, state, t, move)
