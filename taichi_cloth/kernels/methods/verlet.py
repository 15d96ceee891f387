"""Velocity Verlet: v += dt/2*a, x += dt*v, then v += dt/2*a with the new a.

Swope, Andersen, Berens, Wilson, "A computer simulation method for the calculation of equilibrium
constants", J. Chem. Phys. 76, 1982; Hairer, Lubich, Wanner, Geometric Numerical Integration, I.1.4.
Second order, symplectic without drag, one force evaluation a step: a is kept from step to step.
Forces that depend on velocity are taken at the velocity that the old a would lead to, which keeps
the order. Stable while dt*omega < 2, with drag while dt^2 omega^2 + 4 dt d < 4: the price of the
predicted velocity.
"""

import numpy as np
import taichi as ti

from taichi_cloth.kernels.accelerations import compute_acceleration, kick_after, kicks_at_once
from taichi_cloth.kernels.compensated import add_to_position, add_to_velocity
from taichi_cloth.kernels.contact import compute_contacts, store_held_by_walls, velocity_jump
from taichi_cloth.kernels.methods.contract import Claims, Method
from taichi_cloth.kernels.packs import read, write
from taichi_cloth.kernels.watchdog import commit


def amplification(h, omega2, d):
    """The matrix by which a step of h multiplies the (x, v, a) of x'' = -omega2 x - d x'."""
    x = np.array([1, h, h * h / 2])
    a = -omega2 * x - d * np.array([0, 1, h])
    v = np.array([0, 1, h / 2]) + h / 2 * a
    return np.array([x, v, a])


@ti.func
def begin(spec: ti.template(), state: ti.template(), t):
    """Compute the accelerations with which the first step begins."""
    compute_acceleration(spec, state, t)


@ti.func
def drift(spec: ti.template(), state: ti.template(), i):
    """Take pack i to its new positions, and the velocities that the old accelerations lead to."""
    dt, a = state.dt[None], read(spec, state.a, i)
    x, v = read(spec, state.x, i), read(spec, state.v, i)
    jump = velocity_jump(spec, state, i, x, v)
    half_v = add_to_velocity(spec, state, i, add_to_velocity(spec, state, i, v, jump), 0.5 * dt * a)
    new_x = add_to_position(spec, state, i, x, dt * half_v)
    store_held_by_walls(spec, state, i, x, v, new_x, half_v, _store_drift)


@ti.func
def _store_drift(spec: ti.template(), state: ti.template(), i, x, half_v):
    """Store pack i's new positions x and velocities half_v, and what `kick` needs of them."""
    dt, a = state.dt[None], read(spec, state.a, i)
    if ti.static(spec.compensated):
        write(spec, state.half_v, i, half_v)
    elif ti.static(not kicks_at_once(spec)):
        write(spec, state.old_a, i, a)
    write(spec, state.x, i, x)
    write(spec, state.v, i, half_v + 0.5 * dt * a)


@ti.func
def kick(spec: ti.template(), state: ti.template(), i, a):
    """Take pack i, whose new accelerations are a, to its velocities at the end of the step."""
    dt = state.dt[None]
    half_v = read(spec, state.v, i)
    if ti.static(spec.compensated):
        half_v = read(spec, state.half_v, i)
    elif ti.static(kicks_at_once(spec)):
        half_v = half_v - 0.5 * dt * read(spec, state.a, i)
    else:
        half_v = half_v - 0.5 * dt * read(spec, state.old_a, i)
    write(spec, state.a, i, a)
    commit(
        spec,
        state,
        i,
        read(spec, state.x, i),
        add_to_velocity(spec, state, i, half_v, 0.5 * dt * a),
    )


@ti.func
def step(spec: ti.template(), state: ti.template(), t):
    """Advance the state by one step."""
    compute_contacts(spec, state, t)
    kick_after(spec, state, t, drift, kick)


METHOD = Method(
    claims=Claims(
        order=2,
        symplectic=True,
        implicit=False,
        stability_limit=2.0,
        choose=(
            "Smooth motion: second order at about the price of the default, and energy kept far "
            "better. Not where drag is strong: its limit falls sooner."
        ),
    ),
    position_weight=0.5,
    force_times=((0, 1.0),),
    step=step,
    begin=begin,
    amplification=amplification,
    # The velocity in the middle of a step is the predicted one less dt/2 times the old a.
    # Compensated sums need it exactly, as half_v. old_a is for where all accelerations are computed
    # before any pack is kicked, which overwrites the old ones.
    vectors=("old_a",),
    low_vectors=("half_v",),
)
