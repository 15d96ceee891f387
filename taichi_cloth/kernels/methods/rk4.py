"""The classical Runge-Kutta method: four slopes a step, weighted 1, 2, 2, 1.

Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.1, table 1.2. Fourth order;
not symplectic: it damps an undamped oscillator by (dt*omega)^6 / 144 a step; stable while
dt*omega < 2*sqrt(2). Contacts are changes of velocity at the step's start, and keep first order.
"""

import taichi as ti

from taichi_cloth.kernels.accelerations import accelerate_then, set_stage
from taichi_cloth.kernels.compensated import add_to_position, add_to_velocity
from taichi_cloth.kernels.contact import compute_contacts, store_held_by_walls, velocity_jump
from taichi_cloth.kernels.methods.contract import Claims, Method
from taichi_cloth.kernels.packs import read, write
from taichi_cloth.kernels.watchdog import commit


def stability_function(z):
    """The factor by which a step multiplies the y of y' = mu y, where z = dt mu."""
    return 1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4)))


@ti.func
def move(spec: ti.template(), state: ti.template(), i, a):
    """Run one of four stages for pack i, whose accelerations are a.

    It adds the slopes here to the sums and goes to where the next slopes are taken, and from the
    last stage to the end of the step.
    """
    dt, stage = state.dt[None], state.stage[None]
    x, v = read(spec, state.x, i), read(spec, state.v, i)
    sum_v, sum_a = v, a
    if stage == 0:
        write(spec, state.start_x, i, x)
        write(spec, state.start_v, i, v)
    else:
        weight = ti.select(stage < 3, 2.0, 1.0)
        sum_v = read(spec, state.sum_v, i) + weight * v
        sum_a = read(spec, state.sum_a, i) + weight * a
    if ti.static(spec.compensated):  # each stage starts from the low parts of the step's start
        if stage == 0:
            write(spec, state.start_x_low, i, read(spec, state.x_low, i))
            write(spec, state.start_v_low, i, read(spec, state.v_low, i))
        else:
            write(spec, state.x_low, i, read(spec, state.start_x_low, i))
            write(spec, state.v_low, i, read(spec, state.start_v_low, i))
    start_x, start_v = read(spec, state.start_x, i), read(spec, state.start_v, i)
    if stage < 3:
        write(spec, state.sum_v, i, sum_v)
        write(spec, state.sum_a, i, sum_a)
        ahead = ti.select(stage < 2, 0.5, 1.0) * dt
        write(spec, state.x, i, add_to_position(spec, state, i, start_x, ahead * v))
        write(spec, state.v, i, add_to_velocity(spec, state, i, start_v, ahead * a))
    else:
        jump = velocity_jump(spec, state, i, start_x, start_v)
        new_v = add_to_velocity(spec, state, i, start_v, (dt / 6.0) * sum_a)
        new_v = add_to_velocity(spec, state, i, new_v, jump)
        new_x = add_to_position(spec, state, i, start_x, (dt / 6.0) * sum_v)
        new_x = add_to_position(spec, state, i, new_x, dt * jump)
        store_held_by_walls(spec, state, i, start_x, start_v, new_x, new_v, commit)


@ti.func
def step(spec: ti.template(), state: ti.template(), t):
    """Advance the state by one step."""
    compute_contacts(spec, state, t)
    if ti.static(spec.one_launch_per_step):
        for stage in ti.static(range(4)):
            set_stage(spec, state, stage)
            accelerate_then(spec, state, t, move)
    else:
        for stage in range(4):  # at run time: unrolled, it takes long to compile
            set_stage(spec, state, stage)
            accelerate_then(spec, state, t, move)


METHOD = Method(
    claims=Claims(
        order=4,
        symplectic=False,
        implicit=False,
        stability_limit=8.0**0.5,
        forces=4,
        choose=(
            "Errors of 1e-4 and below where nothing hits or tears. Not for long runs near its "
            "limit: it loses energy there."
        ),
    ),
    position_weight=0.5,
    force_times=((0, 0.0), (1, 0.5), (2, 0.5), (3, 1.0)),
    step=step,
    stability_function=stability_function,
    # The state at the step's start; sums of the slopes of position and velocity.
    vectors=("start_x", "start_v", "sum_v", "sum_a"),
    low_vectors=("start_x_low", "start_v_low"),
)
