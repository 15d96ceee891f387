"""Velocity Verlet: v += dt/2*a, x += dt*v, then v += dt/2*a with the new a.

Swope, Andersen, Berens, Wilson, "A computer simulation method for the calculation of equilibrium
constants", J. Chem. Phys. 76, 1982; Hairer, Lubich, Wanner, Geometric Numerical Integration, I.1.4.
Second order, symplectic without drag, one force evaluation a step: a is kept from step to step.
Forces that depend on velocity take it as it would be with the old a, which keeps the order.
Stable while dt*omega < 2, with drag while
dt^2 omega^2 + 4 dt d < 4: the price of the predicted velocity.
"""

import numpy as np
import taichi as ti

from taichi_cloth.kernels.compensated import moved, sped_up
from taichi_cloth.kernels.contact import compute_contacts, kept_above_floor, velocity_jump
from taichi_cloth.kernels.forces import compute_acceleration, kick_after, kicks_at_once
from taichi_cloth.kernels.methods.contract import Claims
from taichi_cloth.kernels.packs import read, write
from taichi_cloth.kernels.watchdog import store

CLAIMS = Claims(
    order=2,
    symplectic=True,
    implicit=False,
    stability_limit=2.0,
    choose=(
        "Smooth motion: second order at about the price of the default, and energy kept far "
        "better. Not where drag is strong: its limit falls sooner."
    ),
)


def amplification(h, omega2, d):
    """One step of x'' = -omega2 x - d x', as a matrix on (x, v, a)."""
    x = np.array([1, h, h * h / 2])
    a = -omega2 * x - d * np.array([0, 1, h])
    v = np.array([0, 1, h / 2]) + h / 2 * a
    return np.array([x, v, a])


# The velocity in the middle of a step is v - dt/2*a with the old a. Compensated sums need it
# exactly; where accelerations have a pass of their own, that would lose the old ones.
LOW_VECTORS, VECTORS = ("half_v",), ("old_a",)


@ti.func
def begin(plan: ti.template(), state: ti.template(), t):
    compute_acceleration(plan, state, t)


@ti.func
def drift(plan: ti.template(), state: ti.template(), c):
    """To the new positions, and the velocities that the old accelerations would lead to."""
    dt, a = state.dt[None], read(plan, state.a, c)
    x, v = read(plan, state.x, c), read(plan, state.v, c)
    jump = velocity_jump(plan, state, c, x, v)
    half_v = sped_up(plan, state, c, sped_up(plan, state, c, v, jump), 0.5 * dt * a)
    new_x = moved(plan, state, c, x, dt * half_v)
    new_x = kept_above_floor(plan, state, c, x, v, new_x, half_v)
    if ti.static(plan.compensated):
        write(plan, state.half_v, c, half_v)
    elif ti.static(not kicks_at_once(plan)):
        write(plan, state.old_a, c, a)
    write(plan, state.x, c, new_x)
    write(plan, state.v, c, half_v + 0.5 * dt * a)


@ti.func
def kick(plan: ti.template(), state: ti.template(), c, a):
    """To the new velocities."""
    dt = state.dt[None]
    half_v = read(plan, state.v, c)
    if ti.static(plan.compensated):
        half_v = read(plan, state.half_v, c)
    elif ti.static(kicks_at_once(plan)):
        half_v = half_v - 0.5 * dt * read(plan, state.a, c)
    else:
        half_v = half_v - 0.5 * dt * read(plan, state.old_a, c)
    write(plan, state.a, c, a)
    store(plan, state, c, read(plan, state.x, c), sped_up(plan, state, c, half_v, 0.5 * dt * a))


@ti.func
def step(plan: ti.template(), state: ti.template(), t):
    compute_contacts(plan, state)
    kick_after(plan, state, t, drift, kick)
