"""Explicit (forward) Euler: x += dt*v with the old v, v += dt*a(x, v).

Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, I.7. First order; an undamped
oscillation grows at every dt, which is why it is here: as the baseline that others beat.
"""

import taichi as ti

from taichi_cloth.kernels.accelerations import accelerate_then
from taichi_cloth.kernels.compensated import add_to_position, add_to_velocity
from taichi_cloth.kernels.contact import compute_contacts, store_held_by_walls, velocity_jump
from taichi_cloth.kernels.methods.contract import Claims, Method
from taichi_cloth.kernels.packs import read
from taichi_cloth.kernels.watchdog import commit


def stability_function(z):
    """The factor by which a step multiplies the y of y' = mu y, where z = dt mu."""
    return 1 + z


@ti.func
def move(spec: ti.template(), state: ti.template(), i, a):
    """Take pack i, whose accelerations are a, to the end of the step."""
    dt, x, v = state.dt[None], read(spec, state.x, i), read(spec, state.v, i)
    jump = velocity_jump(spec, state, i, x, v)
    new_v = add_to_velocity(spec, state, i, add_to_velocity(spec, state, i, v, dt * a), jump)
    new_x = add_to_position(spec, state, i, x, dt * v)
    store_held_by_walls(spec, state, i, x, v, new_x, new_v, commit)


@ti.func
def step(spec: ti.template(), state: ti.template(), t):
    """Advance the state by one step."""
    compute_contacts(spec, state, t)
    accelerate_then(spec, state, t, move)


METHOD = Method(
    claims=Claims(
        order=1,
        symplectic=False,
        implicit=False,
        stability_limit=0.0,
        choose="Never: every swing grows. It is the baseline that the others are held against.",
    ),
    position_weight=0.0,
    force_times=((0, 0.0),),
    step=step,
    stability_function=stability_function,
)
