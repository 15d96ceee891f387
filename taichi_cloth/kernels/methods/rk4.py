"""The classical Runge-Kutta method: four slopes a step, weighted 1, 2, 2, 1.

Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.1, table 1.2. Fourth order;
not symplectic: it damps an undamped oscillator by (dt*omega)^6 / 144 a step; stable while
dt*omega < 2*sqrt(2). Contacts are changes of velocity at the step's start, and keep first order.
"""

import taichi as ti

from taichi_cloth.kernels.compensated import moved, sped_up
from taichi_cloth.kernels.contact import compute_contacts, kept_above_floor, velocity_jump
from taichi_cloth.kernels.forces import accelerate_then
from taichi_cloth.kernels.methods.contract import Claims
from taichi_cloth.kernels.packs import read, write
from taichi_cloth.kernels.watchdog import store

CLAIMS = Claims(
    order=4,
    symplectic=False,
    implicit=False,
    stability_limit=8.0**0.5,
    forces=4,
    choose=(
        "Errors of 1e-4 and below where nothing hits or tears. Not for long runs near its "
        "limit: it loses energy there."
    ),
)


def stability_function(z):
    """What a step makes of y' = mu y, where z = dt mu."""
    return 1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4)))


# The state at the step's start; sums of the slopes of position and velocity.
VECTORS = ("start_x", "start_v", "sum_v", "sum_a")
LOW_VECTORS = ("start_x_low", "start_v_low")


@ti.func
def move(plan: ti.template(), state: ti.template(), c, a):
    """One of four stages: add the slopes here to the sums, go to where the next ones are."""
    dt, stage = state.dt[None], state.stage[None]
    x, v = read(plan, state.x, c), read(plan, state.v, c)
    sum_v, sum_a = v, a
    if stage == 0:
        write(plan, state.start_x, c, x)
        write(plan, state.start_v, c, v)
    else:
        weight = ti.select(stage < 3, 2.0, 1.0)
        sum_v = read(plan, state.sum_v, c) + weight * v
        sum_a = read(plan, state.sum_a, c) + weight * a
    if ti.static(plan.compensated):  # each stage starts from the low parts of the step's start
        if stage == 0:
            write(plan, state.start_x_low, c, read(plan, state.x_low, c))
            write(plan, state.start_v_low, c, read(plan, state.v_low, c))
        else:
            write(plan, state.x_low, c, read(plan, state.start_x_low, c))
            write(plan, state.v_low, c, read(plan, state.start_v_low, c))
    start_x, start_v = read(plan, state.start_x, c), read(plan, state.start_v, c)
    if stage < 3:
        write(plan, state.sum_v, c, sum_v)
        write(plan, state.sum_a, c, sum_a)
        ahead = ti.select(stage < 2, 0.5, 1.0) * dt
        write(plan, state.x, c, moved(plan, state, c, start_x, ahead * v))
        write(plan, state.v, c, sped_up(plan, state, c, start_v, ahead * a))
    else:
        jump = velocity_jump(plan, state, c, start_x, start_v)
        new_v = sped_up(plan, state, c, start_v, (dt / 6.0) * sum_a)
        new_v = sped_up(plan, state, c, new_v, jump)
        new_x = moved(plan, state, c, start_x, (dt / 6.0) * sum_v)
        new_x = moved(plan, state, c, new_x, dt * jump)
        new_x = kept_above_floor(plan, state, c, start_x, start_v, new_x, new_v)
        store(plan, state, c, new_x, new_v)


@ti.func
def step(plan: ti.template(), state: ti.template(), t):
    compute_contacts(plan, state)
    if ti.static(plan.spread):
        for stage in ti.static(range(4)):
            for _ in range(1):
                state.stage[None] = stage
            accelerate_then(plan, state, t, move)
    else:
        for stage in range(4):  # at run time: unrolled, it takes long to compile
            state.stage[None] = stage  # by every thread alike, none of which is in the last one
            accelerate_then(plan, state, t, move)
