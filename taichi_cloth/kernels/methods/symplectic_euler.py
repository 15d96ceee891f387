"""Symplectic (semi-implicit) Euler: v += dt*a(x, v), then x += dt*v with the new v.

Hairer, Lubich, Wanner, Geometric Numerical Integration, I.1.2. First order; symplectic without
drag, so the energy error stays bounded; stable while dt*omega < 2.
"""

import taichi as ti

from taichi_cloth.kernels.contact import compute_contacts, kept_above_floor, velocity_jump
from taichi_cloth.kernels.forces import compute_acceleration
from taichi_cloth.kernels.methods.claims import Claims
from taichi_cloth.kernels.watch import store

CLAIMS = Claims(order=1, symplectic=True, implicit=False, stability_limit=2.0)


@ti.func
def step(features: ti.template(), state: ti.template()):
    dt = state.dt[None]
    compute_acceleration(features, state)
    compute_contacts(features, state)
    for i in range(state.n[None]):
        v = state.v[i] + dt * state.a[i] + velocity_jump(features, state, i)
        x = kept_above_floor(features, state, i, state.x[i] + dt * v, v)
        store(state, i, x, v)
