"""Backward Euler by sweeps: what xpbd and vbd share.

A step of backward Euler is v = goal_v + mobility*(impulses of springs at x + dt*v, over dt), where
goal_v is the velocity after the step without springs, and mobility the inverse mass, of which drag
is a part. Such a method goes through springs or particles by colour (`colours.py`), as often as
state.iterations says, and changes state.v; state.x stays where the step began until its end.

The unknown is the velocity: set from positions, as in the papers, velocities would lose gravity to
rounding in f32. In the precision `compensated` state.v is what the sweeps add to goal_v, which is
far less, until the step ends.
"""

import functools

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.compensated import moved, sped_up
from taichi_cloth.kernels.contact import compute_contacts, kept_above_floor, velocity_jump
from taichi_cloth.kernels.forces import acceleration
from taichi_cloth.kernels.loops import each, each_cell_moving
from taichi_cloth.kernels.packs import read, scaled, write, zeros
from taichi_cloth.kernels.solvers.phases import DONE, go_to
from taichi_cloth.kernels.state import SWEEPS
from taichi_cloth.kernels.watchdog import store

VECTORS = ("old_v", "goal_v")  # velocity at the step's start, and after it without springs
HALOED = ("goal_v",)
LANES = 4  # in cells: with 8 it is no faster, and takes twice as long to compile
COUNTS = ("colour", "sweep")
SWEEP, FINISH = 1, 2  # phases, after the first one


@ti.func
def _nothing(plan: ti.template(), state: ti.template(), t):
    pass


def phases(colours, visit, prepare=_nothing):
    """The phases of a method's step.

    prepare(plan, state, t): what else comes first.
    colours(plan, state): how many colours there are; visit(plan, state, t, colour): go through one,
    by loops of the top level where they are spread. state.sweep says in which sweep, from 0.
    """

    @ti.func
    def begin(plan: ti.template(), state: ti.template(), t):
        compute_contacts(plan, state)
        each_cell_moving(plan, state, t, predict)
        prepare(plan, state, t)
        each(plan, state, t, 1, ti.static(_beginning(colours)))

    @ti.func
    def sweep(plan: ti.template(), state: ti.template(), t):
        if ti.static(plan.spread):  # one colour, a launch each
            visit(plan, state, t, state.colour[None])
            each(plan, state, t, 1, ti.static(_turning(colours)))
        else:
            for k in range(state.iterations[None]):
                # By every thread alike, none of which is still in the sweep before.
                state.sweep[None] = k
                for colour in range(colours(plan, state)):
                    visit(plan, state, t, colour)
            go_to(plan, state, t, FINISH)

    return begin, sweep, finish


@functools.cache
def _beginning(colours):
    @ti.func
    def body(plan: ti.template(), state: ti.template(), i):
        state.colour[None], state.sweep[None] = 0, 0
        state.phase[None] = ti.select(colours(plan, state) > 0, SWEEP, FINISH)

    return body


@functools.cache
def _turning(colours):
    @ti.func
    def body(plan: ti.template(), state: ti.template(), i):
        state.colour[None] += 1
        if state.colour[None] == colours(plan, state):
            state.colour[None] = 0
            state.sweep[None] += 1
            if state.sweep[None] == state.iterations[None]:
                state.phase[None] = FINISH

    return body


@ti.func
def predict(plan: ti.template(), state: ti.template(), c):
    """goal_v, from which the sweeps begin; drag acts on the new velocity."""
    x, v = read(plan, state.x, c), read(plan, state.v, c)
    write(plan, state.old_v, c, v)
    v = sped_up(plan, state, c, v, velocity_jump(plan, state, c, x, v))
    write(plan, state.v, c, v)
    a = acceleration(plan, state, c, zeros(plan, state))
    if ti.static(plan.drag):
        viscous, w = read(plan, state.viscous, c), read(plan, state.w, c)
        a = scaled(laws.drag_factor(w, viscous, state.dt[None]), a)
    v = sped_up(plan, state, c, v, state.dt[None] * a)
    write(plan, state.goal_v, c, v)
    if ti.static(plan.compensated):
        v = zeros(plan, state)
    write(plan, state.v, c, v)


@ti.func
def relative_velocity(plan: ti.template(), state: ti.template(), value: ti.template(), i, j):
    """Velocity of j relative to i, in the sweeps; value: `read` of cells, `site_value` of sites."""
    dv = value(plan, state.v, j) - value(plan, state.v, i)
    if ti.static(plan.compensated):
        dv += value(plan, state.goal_v, j) - value(plan, state.goal_v, i)
    return dv


@ti.func
def short_of_goal(plan: ti.template(), state: ti.template(), value: ti.template(), i):
    """goal_v - v, in the sweeps."""
    missing = -1.0 * value(plan, state.v, i)
    if ti.static(not plan.compensated):
        missing += value(plan, state.goal_v, i)
    return missing


@ti.func
def mobility(plan: ti.template(), state: ti.template(), number: ti.template(), i):
    """Inverse masses, of which drag is a part. number: `read`, or of a site `site_number`."""
    w = number(plan, state.w, i)
    if ti.static(plan.drag):
        w *= laws.drag_factor(w, number(plan, state.viscous, i), state.dt[None])
    return w


@ti.func
def finish(plan: ti.template(), state: ti.template(), t):
    each_cell_moving(plan, state, t, _move)
    each(plan, state, t, 1, _end_step)


@ti.func
def _move(plan: ti.template(), state: ti.template(), c):
    x, v = read(plan, state.x, c), read(plan, state.v, c)
    old_v = read(plan, state.old_v, c)
    if ti.static(plan.compensated):
        v = sped_up(plan, state, c, read(plan, state.goal_v, c), v)
    new_x = moved(plan, state, c, x, state.dt[None] * v)
    store(plan, state, c, kept_above_floor(plan, state, c, x, old_v, new_x, v), v)


@ti.func
def _end_step(plan: ti.template(), state: ti.template(), i):
    state.work[SWEEPS] += state.iterations[None]
    state.phase[None] = DONE
