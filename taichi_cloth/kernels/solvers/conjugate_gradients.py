"""Conjugate gradients for a Newton direction: A p = tau*M*residual, where A is symmetric.

Shewchuk, "An introduction to the conjugate gradient method without the agonizing pain", 1994, B3.
The matrix and its preconditioner are those of `newton_matrix.py`.
"""

import taichi as ti

from taichi_cloth.kernels.loops import add_up, each, each_pack_moving
from taichi_cloth.kernels.packs import read, write
from taichi_cloth.kernels.solvers.newton_matrix import (
    begin_iterating,
    curvature,
    downhill,
    first_energy,
    go_along,
    multiply,
    preconditioned,
    take_change,
)
from taichi_cloth.kernels.solvers.stages import CLAMPED, SINGULAR
from taichi_cloth.kernels.state import SWEEPS


@ti.func
def direct(spec: ti.template(), state: ti.template(), t):
    """Begin conjugate gradients: no change yet, the first direction is downhill."""
    add_up(spec, state, t, first_energy, 0)
    each_pack_moving(spec, state, t, downhill)
    each(spec, state, t, 1, begin_iterating)


@ti.func
def iterate(spec: ti.template(), state: ti.template(), t):
    """Make one step of conjugate gradients."""
    multiply(spec, state, t)
    add_up(spec, state, t, curvature, 0)
    add_up(spec, state, t, _approach, 1)
    each_pack_moving(spec, state, t, _turn)
    each(spec, state, t, 1, _count_iteration)


@ti.func
def _approach(spec: ti.template(), state: ti.template(), i):
    """Go a step of conjugate gradients in pack i, and return the energy of its new residual."""
    return go_along(spec, state, i, _step_length(state))


@ti.func
def _turn(spec: ti.template(), state: ti.template(), i):
    """Set the next direction of conjugate gradients in pack i."""
    part = state.sums[1, 0] / state.energy[None]
    residual = preconditioned(spec, state, i, read(spec, state.residual, i))
    write(spec, state.direction, i, residual + part * read(spec, state.direction, i))


@ti.func
def _step_length(state: ti.template()):
    """The length of a step of conjugate gradients.

    It is 0 where A is not positive along the direction, or numbers are no longer finite.
    """
    along_itself = state.sums[0, 0]
    return ti.select(along_itself > 0.0, state.energy[None] / along_itself, 0.0)


@ti.func
def _count_iteration(spec: ti.template(), state: ti.template(), i):
    """Count a step of conjugate gradients, and decide whether they end with it."""
    energy, step = state.sums[1, 0], _step_length(state)
    state.slope[None] += step * state.energy[None]
    state.energy[None] = energy
    state.sweeps[None] += 1
    state.work[SWEEPS] += 1
    most = 2 * spec.dim * state.n[None] + 20
    ends = not (energy > state.goal[None]) or state.sweeps[None] >= most
    if not (step > 0.0):
        # With the exact K, A may be indefinite; the change so far is downhill. With a clamped K it
        # is positive definite, unless numbers are no longer finite.
        ends, state.indefinite[None] = True, 1
        if state.least[None] == CLAMPED:
            state.outcome[None] = SINGULAR
    if ends:
        take_change(state)
