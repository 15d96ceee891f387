"""Symplectic (semi-implicit) Euler: v += dt*a(x, v), then x += dt*v with the new v.

Hairer, Lubich, Wanner, Geometric Numerical Integration, I.1.2. First order; symplectic without
drag, so the energy error stays bounded; stable while dt*omega < 2, with drag while
dt^2 omega^2 + 2 dt d < 4.
"""

import numpy as np
import taichi as ti

from taichi_cloth.kernels.accelerations import accelerate_then, kick_then, kicks_at_once
from taichi_cloth.kernels.compensated import add_to_position, add_to_velocity
from taichi_cloth.kernels.contact import compute_contacts, store_held_by_walls, velocity_jump
from taichi_cloth.kernels.methods.contract import Claims, Method
from taichi_cloth.kernels.packs import read, write
from taichi_cloth.kernels.watchdog import commit


def amplification(h, omega2, d):
    """The matrix by which a step of h multiplies the (x, v) of x'' = -omega2 x - d x'."""
    return np.array([[1 - h * h * omega2, h * (1 - h * d)], [-h * omega2, 1 - h * d]])


@ti.func
def move(spec: ti.template(), state: ti.template(), i, a):
    """Take pack i, whose accelerations are a, to the end of the step."""
    dt, x, v = state.dt[None], read(spec, state.x, i), read(spec, state.v, i)
    jump = velocity_jump(spec, state, i, x, v)
    new_v = add_to_velocity(spec, state, i, add_to_velocity(spec, state, i, v, dt * a), jump)
    new_x = add_to_position(spec, state, i, x, dt * new_v)
    store_held_by_walls(spec, state, i, x, v, new_x, new_v, commit)


def kicks_first(spec):
    """True if velocities change as soon as forces are known, and positions in a loop of their own.

    What meets walls and other particles needs its velocity from before, too.
    """
    return not spec.passes_over_rows and kicks_at_once(spec) and not (spec.walls or spec.collisions)


@ti.func
def kick(spec: ti.template(), state: ti.template(), i, a):
    """The first half of `move`: the new velocities."""
    dt, x, v = state.dt[None], read(spec, state.x, i), read(spec, state.v, i)
    jump = velocity_jump(spec, state, i, x, v)
    new_v = add_to_velocity(spec, state, i, add_to_velocity(spec, state, i, v, dt * a), jump)
    write(spec, state.v, i, new_v)


@ti.func
def drift(spec: ti.template(), state: ti.template(), i):
    """The second half of `move`: the new positions."""
    x, v = read(spec, state.x, i), read(spec, state.v, i)
    commit(spec, state, i, add_to_position(spec, state, i, x, state.dt[None] * v), v)


@ti.func
def step(spec: ti.template(), state: ti.template(), t):
    """Advance the state by one step."""
    if ti.static(kicks_first(spec)):
        kick_then(spec, state, t, kick, drift)
    else:
        compute_contacts(spec, state, t)
        accelerate_then(spec, state, t, move)


METHOD = Method(
    claims=Claims(
        order=1,
        symplectic=True,
        implicit=False,
        stability_limit=2.0,
        choose=(
            "The default: the cheapest step; as good as any where things hit, tear or are pushed, "
            "to errors of some percent."
        ),
    ),
    position_weight=1.0,
    force_times=((0, 0.0),),
    step=step,
    amplification=amplification,
)
