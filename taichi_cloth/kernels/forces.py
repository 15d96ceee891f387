"""Force accumulation: everything that acts on a particle, as one acceleration."""

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.springs_graph import spring_forces


@ti.func
def compute_acceleration(features: ti.template(), state: ti.template()):
    """a = g + w*f for every particle, from the positions and velocities as they stand.

    Positions and velocities are only read, so the loop has no race. The order of the sums is that
    of the reference trajectories: a pulled cloth amplifies round-off 1e8 times in 600 frames.
    """
    for i in range(state.n[None]):
        x, v, w = state.x[i], state.v[i], state.w[i]
        field = state.gravity[None]
        if ti.static(features.drag):
            field += w * laws.drag_force(v, state.viscous[i])
        f = 0.0 * x
        if ti.static(features.springs):
            f += spring_forces(features, state, i, x, v)
        if ti.static(features.blow):
            if state.pushing[None] == 1:
                f += state.push[i]
        state.a[i] = ti.select(w > 0.0, field + w * f, 0.0 * x)
