"""Backward Euler by Gauss-Seidel sweeps, which the methods xpbd and vbd share.

A step of backward Euler solves v = goal_v + mobility*(impulses of springs over dt, at x + dt*v).
Stencils (`stencils.py`) are as springs. goal_v is the velocity after the step without them;
mobility is the inverse mass, made smaller by drag, which resists the impulses. Such a method sweeps
over the springs, one by one or particle by particle, by colour (`colours.py`), as often as
state.iterations says, and changes state.v; state.x stays where the step began until its end. Saad,
Iterative Methods for Sparse Linear Systems, 2003,
chapters 4 (Gauss-Seidel) and 12 (multicolouring).

The unknown is the velocity: if it were computed from positions, as in the papers, it would lose
gravity to rounding in f32. Forces on triangles depend on where particles go, and on each other's
velocities: they are computed anew before every sweep, at the state that the sweeps have so far, and
goal_v follows. Between sweeps they count as -damping*(change of velocity), with a bound on their
damping that stays the same through a step; where the sweeps converge, that is to backward Euler's
solution whatever the bound. How a triangle turns into the wind is not in that bound: where in a
step the air passes many triangles, sweeps do not converge (`docs/stability.md`).

In the precision `compensated` state.v is, until the step ends, only
what the sweeps add to goal_v, which is far less.
"""

import functools

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.accelerations import (
    acceleration,
    binds,
    damping_of,
    resists,
    stiffness_of,
)
from taichi_cloth.kernels.clock import time_of_forces
from taichi_cloth.kernels.compensated import add_to_position, add_to_velocity, difference
from taichi_cloth.kernels.contact import compute_contacts, store_held_by_walls, velocity_jump
from taichi_cloth.kernels.forces import has_tractions
from taichi_cloth.kernels.grids import renew_number
from taichi_cloth.kernels.loops import each, each_pack_moving, each_row
from taichi_cloth.kernels.packs import read, write, zeros
from taichi_cloth.kernels.phases import DONE, go_to
from taichi_cloth.kernels.state import SWEEPS
from taichi_cloth.kernels.surfaces import compute_traction_damping, compute_tractions
from taichi_cloth.kernels.watchdog import commit

# The parts of a `methods.contract.Method` that these methods share.
KEEPS = {
    "vectors": ("old_v", "goal_v"),  # velocity at the step's start, and after it without springs
    "haloed": ("goal_v",),
    # Forces on triangles and velocity at the step's start, or in the precision `compensated` the
    # change to goal_v; and by how much goal_v has followed these forces since.
    "traction_vectors": ("first_traction", "first_v", "followed"),
    "counts": ("colour", "sweep"),
}
SWEEP, FINISH, RENEW = 1, 2, 3  # phases, after the first one


@ti.func
def _nothing(spec: ti.template(), state: ti.template(), t):
    """Prepare nothing."""
    pass


def phases(colours, visit, prepare=_nothing):
    """The phases of a method's step: a beginning, the sweeps, and an end.

    colours(spec, state): how many colours there are.
    visit(spec, state, t, colour): visits all springs or particles of a colour; with
        spec.one_launch_per_step its loops are top-level ones. state.sweep is the number of the
        sweep, from 0.
    prepare(spec, state, t): what is to be done before the first sweep of a step.
    """

    @ti.func
    def begin(spec: ti.template(), state: ti.template(), t):
        compute_contacts(spec, state, t)
        compute_tractions(spec, state, t, time_of_forces, False)
        compute_traction_damping(spec, state, t)
        if ti.static(has_tractions(spec) and spec.halo > 0):
            each_row(spec, state, t, _renew_halos_of_damping)
        each_pack_moving(spec, state, t, predict)
        prepare(spec, state, t)
        each(spec, state, t, 1, ti.static(_beginning(colours)))

    @ti.func
    def sweep(spec: ti.template(), state: ti.template(), t):
        if ti.static(spec.one_launch_per_step):  # one colour, a launch each
            visit(spec, state, t, state.colour[None])
            each(spec, state, t, 1, ti.static(_turning(colours)))
        else:
            for k in range(state.iterations[None]):
                # Every thread writes the same number, and none is still in the sweep before.
                state.sweep[None] = k
                _follow_tractions(spec, state, t, prepare)
                for colour in range(colours(spec, state)):
                    visit(spec, state, t, colour)
            go_to(spec, state, t, FINISH)

    @ti.func
    def renew(spec: ti.template(), state: ti.template(), t):
        if ti.static(has_tractions(spec) and spec.one_launch_per_step):
            _follow_tractions(spec, state, t, prepare)
            each(spec, state, t, 1, ti.static(_renewed(colours)))

    return begin, sweep, finish, renew


def _first_phase(spec):
    """The phase that a sweep begins with."""
    return RENEW if has_tractions(spec) and spec.one_launch_per_step else SWEEP


@functools.cache
def _beginning(colours):
    """The body of a loop, run once, that goes to the first colour of the first sweep."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), i):
        state.colour[None], state.sweep[None] = 0, 0
        state.phase[None] = ti.select(colours(spec, state) > 0, SWEEP, FINISH)
        if ti.static(has_tractions(spec)):
            state.phase[None] = 0 + ti.static(_first_phase(spec))

    return body


@functools.cache
def _turning(colours):
    """The body of a loop, run once, that goes to the next colour, or sweep, or to the end."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), i):
        state.colour[None] += 1
        if state.colour[None] >= colours(spec, state):
            _end_sweep(spec, state)

    return body


@ti.func
def _end_sweep(spec: ti.template(), state: ti.template()):
    """Go to the next sweep, or to the end."""
    state.colour[None] = 0
    state.sweep[None] += 1
    state.phase[None] = 0 + ti.static(_first_phase(spec))
    if state.sweep[None] == state.iterations[None]:
        state.phase[None] = FINISH


@functools.cache
def _renewed(colours):
    """The body of a loop, run once, that goes to a sweep's first colour, if there is any."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), i):
        state.phase[None] = SWEEP
        if colours(spec, state) == 0:
            _end_sweep(spec, state)

    return body


def _resists(spec):
    """True if any force on particles or triangles has damping."""
    return resists(spec) or has_tractions(spec)


@ti.func
def predict(spec: ti.template(), state: ti.template(), i):
    """Compute goal_v of pack i, from which the sweeps begin; drag acts on the new velocity."""
    x, v = read(spec, state.x, i), read(spec, state.v, i)
    write(spec, state.old_v, i, v)
    v = add_to_velocity(spec, state, i, v, velocity_jump(spec, state, i, x, v))
    write(spec, state.v, i, v)
    a = acceleration(spec, state, i, zeros(spec, state))
    if ti.static(binds(spec)):  # its force where the particle goes, not where it is
        back = state.dt[None] * read(spec, state.w, i) * stiffness_of(spec, state, read, i)
        a = a - back * v
    if ti.static(_resists(spec) or binds(spec)):
        a = _softened(spec, state, read, i) * a
    if ti.static(has_tractions(spec)):
        write(spec, state.first_traction, i, read(spec, state.traction, i))
        write(spec, state.followed, i, zeros(spec, state))
        write(spec, state.first_v, i, state.dt[None] * a if ti.static(spec.compensated) else v)
    v = add_to_velocity(spec, state, i, v, state.dt[None] * a)
    write(spec, state.goal_v, i, v)
    if ti.static(spec.compensated):
        v = zeros(spec, state)
    write(spec, state.v, i, v)


@ti.func
def _renew_halos_of_damping(spec: ti.template(), state: ti.template(), begin, width):
    """Fill the halos of the numbers state.traction_damping of a row, which links there ask for."""
    for h in range(spec.halo):
        for lane in range(spec.lanes - 1):
            renew_number(spec, state.traction_damping, begin, width, h, lane)


@ti.func
def _follow_tractions(spec: ti.template(), state: ti.template(), t, prepare: ti.template()):
    """Let goal_v follow the forces on triangles to the state that the sweeps have so far."""
    if ti.static(has_tractions(spec)):
        compute_tractions(spec, state, t, time_of_forces, True)
        each_pack_moving(spec, state, t, _follow)
        prepare(spec, state, t)  # what is read of neighbours in their halos


@ti.func
def _follow(spec: ti.template(), state: ti.template(), i):
    """Change goal_v and the velocities of pack i by what its triangles' forces have changed."""
    v, first_v = read(spec, state.v, i), read(spec, state.first_v, i)
    gained = v + first_v if ti.static(spec.compensated) else v - first_v
    force = read(spec, state.traction, i) - read(spec, state.first_traction, i)
    force += read(spec, state.traction_damping, i) * gained
    follows = state.dt[None] * mobility(spec, state, read, i) * force
    change = follows - read(spec, state.followed, i)
    write(spec, state.followed, i, follows)
    write(spec, state.v, i, v + change)
    if ti.static(not spec.compensated):
        write(spec, state.goal_v, i, read(spec, state.goal_v, i) + change)


@ti.func
def relative_velocity(spec: ti.template(), state: ti.template(), value: ti.template(), i, j):
    """The velocity of j relative to i, as the sweeps have it so far."""
    dv = value(spec, state.v, j) - value(spec, state.v, i)
    if ti.static(spec.compensated):
        dv += value(spec, state.goal_v, j) - value(spec, state.goal_v, i)
    return dv


@ti.func
def apart_at_end(spec: ti.template(), state: ti.template(), value: ti.template(), i, j):
    """The vectors from i to j at the step's end, as the sweeps have it so far, for stencils."""
    moved = state.dt[None] * relative_velocity(spec, state, value, i, j)
    return difference(spec, state, value, i, j) + moved


@ti.func
def short_of_goal(spec: ti.template(), state: ti.template(), value: ti.template(), i):
    """The difference goal_v - v at i, as the sweeps have it so far."""
    missing = -1.0 * value(spec, state.v, i)
    if ti.static(not spec.compensated):
        missing += value(spec, state.goal_v, i)
    elif ti.static(has_tractions(spec)):
        missing += value(spec, state.followed, i)
    return missing


@ti.func
def mobility(spec: ti.template(), state: ti.template(), number: ti.template(), i):
    """The mobility at i: inverse masses, made smaller by the damping and stiffness of forces."""
    w = number(spec, state.w, i)
    if ti.static(_resists(spec) or binds(spec)):
        w *= _softened(spec, state, number, i)
    return w


@ti.func
def _softened(spec: ti.template(), state: ti.template(), number: ti.template(), i):
    """The part of a change of velocity that terms on particles leave by damping and stiffness."""
    dt, w = state.dt[None], number(spec, state.w, i)
    resistance = 0.0 * w
    if ti.static(resists(spec)):
        resistance = damping_of(spec, state, number, i)
    if ti.static(has_tractions(spec)):
        resistance += number(spec, state.traction_damping, i)
    if ti.static(binds(spec)):
        resistance += dt * stiffness_of(spec, state, number, i)
    return laws.drag_factor(w, resistance, dt)


@ti.func
def finish(spec: ti.template(), state: ti.template(), t):
    """Move all particles by their new velocities, and end the step."""
    each_pack_moving(spec, state, t, _move)
    each(spec, state, t, 1, _end_step)


@ti.func
def _move(spec: ti.template(), state: ti.template(), i):
    """Take pack i to the end of the step, with the velocities that the sweeps have found."""
    x, v = read(spec, state.x, i), read(spec, state.v, i)
    old_v = read(spec, state.old_v, i)
    if ti.static(spec.compensated):
        v = add_to_velocity(spec, state, i, read(spec, state.goal_v, i), v)
    new_x = add_to_position(spec, state, i, x, state.dt[None] * v)
    store_held_by_walls(spec, state, i, x, old_v, new_x, v, commit)


@ti.func
def _end_step(spec: ti.template(), state: ti.template(), i):
    state.work[SWEEPS] += state.iterations[None]
    state.phase[None] = DONE
