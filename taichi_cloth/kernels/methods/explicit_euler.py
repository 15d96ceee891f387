"""Explicit (forward) Euler: x += dt*v with the old v, v += dt*a(x, v).

Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, I.7. First order; an undamped
oscillation grows at every dt, which is why it is here: as the baseline that others beat.
"""

import taichi as ti

from taichi_cloth.kernels.contact import compute_contacts, kept_above_floor, velocity_jump
from taichi_cloth.kernels.forces import compute_acceleration
from taichi_cloth.kernels.methods.claims import Claims
from taichi_cloth.kernels.watch import store

CLAIMS = Claims(order=1, symplectic=False, implicit=False, stability_limit=0.0)


@ti.func
def step(features: ti.template(), state: ti.template()):
    dt = state.dt[None]
    compute_acceleration(features, state)
    compute_contacts(features, state)
    for i in range(state.n[None]):
        v = state.v[i] + dt * state.a[i] + velocity_jump(features, state, i)
        x = kept_above_floor(features, state, i, state.x[i] + dt * state.v[i], v)
        store(state, i, x, v)
