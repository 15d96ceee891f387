"""Spring forces on any graph, gathered particle by particle.

Each particle sums over its own half-springs in a fixed order: no atomics, so the same bits on
every run and for every number of threads.
"""

import taichi as ti

from taichi_cloth.kernels import laws


@ti.func
def number(features: ti.template(), of: ti.template(), s):
    """A (half-)spring's k, rest, c or limit: its own, or the one that all of them share."""
    if ti.static(features.uniform_springs):
        return of[None]
    else:  # without it, Taichi would read both
        return of[s]


@ti.func
def spring_forces(features: ti.template(), state: ti.template(), i, x, v):
    """Sum of the spring (and dashpot) forces on particle i at position x and velocity v."""
    f = 0.0 * x
    for h in range(state.row[i], state.row[i + 1]):
        j = state.far[h]
        d = state.x[j] - x
        k, rest = number(features, state.k, h), number(features, state.rest, h)
        f += laws.spring_force(d, k, rest)
        if ti.static(features.dashpots):
            f += laws.dashpot_force(d, state.v[j] - v, number(features, state.c, h))
    return f
