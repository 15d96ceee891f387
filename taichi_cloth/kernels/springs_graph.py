"""Spring forces on any graph, gathered particle by particle.

Each particle sums over its own half-springs in a fixed order: no atomics, so the same bits on
every run and for every number of threads.
"""

import taichi as ti

from taichi_cloth.kernels import laws


@ti.func
def spring_forces(features: ti.template(), state: ti.template(), i, x, v):
    """Sum of the spring (and dashpot) forces on particle i at position x and velocity v."""
    f = 0.0 * x
    for h in range(state.row[i], state.row[i + 1]):
        j = state.far[h]
        d = state.x[j] - x
        f += laws.spring_force(d, state.k[h], state.rest[h])
        if ti.static(features.dashpots):
            f += laws.dashpot_force(d, state.v[j] - v, state.c[h])
    return f
