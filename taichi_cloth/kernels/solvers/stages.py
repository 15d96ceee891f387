"""Implicit stages: where they start, the iterate, and the step's end; what their solvers share.

A stage of every implicit method here is backward Euler over a time tau from (start_x, start_v); its
iterate has gained `gain` of velocity and is kept in state.x and state.v, so that forces are
computed as for all methods (`newton_cg.py`).
"""

import taichi as ti

from taichi_cloth.kernels.accelerations import (
    binds,
    damping_of,
    resists,
    stiffness_of,
)
from taichi_cloth.kernels.compensated import (
    add_to_position,
    add_to_velocity,
    difference,
)
from taichi_cloth.kernels.contact import store_held_by_walls, velocity_jump
from taichi_cloth.kernels.copies import keep, return_to
from taichi_cloth.kernels.loops import barrier
from taichi_cloth.kernels.packs import (
    component,
    read,
    write,
)
from taichi_cloth.kernels.phases import set_alone
from taichi_cloth.kernels.springs import reads_velocity
from taichi_cloth.kernels.watchdog import commit

BEGIN, EVALUATE, DIRECT, ITERATE, FINISH, CUT, COARSEN = range(7)  # phases
# What came of a stage. ROUNDED: its residual is as small as rounding lets it be; HIDDEN: so it is,
# but what rounding leaves hides what moves the particles. From HIDDEN on a stage is not solved.
CONVERGED, ROUNDED, HIDDEN, EXHAUSTED, STALLED, SINGULAR, NOT_FINITE = range(7)
OUTCOMES = (
    "converged",
    "converged to rounding",
    "rounding of the springs' forces hides gravity",
    "the most directions were not enough",
    "directions brought no more progress",
    "singular",
    "not finite",
)
# Forces of stiff springs cancel, so a small part of the first residual may be more than all that is
# left of them. Where there is gravity, a stage that has converged leaves at most SOLVED times its
# load, the larger of gravity and of what the particles gain; one that rounding ends, HIDING times.
# Rounding acts along springs, and moves only what is far softer than it: measured, swings and
# cloths lose a percent of their motion at 4 times the load, and most of it at 40 times.
SOLVED, HIDING = 0.1, 5.0
# A tolerance above this one asks for rough solutions: these leave more of the load, at 1 ten times
# as much as there is, and as they take few sweeps, preparing for them has to take less, too.
ROUGH = 0.1
# Where rounding alone may leave so many times the load, a residual that is small says nothing:
# springs are then so stiff that the least change of a length gives more than any load.
MOST_HIDING = 40.0
CLAMPED, EXACT = 0.0, -1e30  # state.least: how K is taken across springs
# Whether a step has made the coarse level (`two_levels.py`); springs are kept from JUST_NOW.
NOT_YET, JUST_NOW, BEFORE = range(3)
ONLY_EVALUATE = -1  # number of a stage that only computes the acceleration, as its residual


@ti.func
def set_tau(spec: ti.template(), state: ti.template(), t, tau):
    """Set the time of a step's stages; it comes before all else of the step."""
    set_alone(spec, state.tau, t, tau)
    set_alone(spec, state.step_outcome, t, CONVERGED)
    set_alone(spec, state.coarsened, t, NOT_YET)
    if ti.static(spec.only_links or spec.blocks_on_graph):
        set_alone(spec, state.n_blocks, t, 0)
    barrier(spec, state, t)


@ti.func
def time_of_part(state: ti.template()):
    """The time of the present part of a step: dt, halved as often as it was cut in two."""
    return state.dt[None] / ti.cast(1 << state.halvings[None], state.real)


@ti.func
def return_to_start(spec: ti.template(), state: ti.template(), i):
    """Put pack i back to where the present part of the step began."""
    return_to(spec, state, i, "old")


@ti.func
def keep_start(spec: ti.template(), state: ti.template(), i):
    """Keep the state of pack i at the step's start, in old_x and old_v."""
    keep(spec, state, i, "old")


@ti.func
def start_from(spec: ti.template(), state: ti.template(), i, change, v):
    """Start a stage for pack i.

    change: how far its positions are from those at the step's start; v: its velocities, which are
    the first iterate's, too.
    """
    begin_at(spec, state, i, moved_from_old(spec, state, i, change))
    write(spec, state.start_v, i, v)
    if ti.static(spec.compensated):
        write(spec, state.start_x_low, i, read(spec, state.x_low, i))
    iterate_from(spec, state, i, 0.0 * v)


@ti.func
def begin_at(spec: ti.template(), state: ti.template(), i, x):
    """Set where a stage starts for pack i, and its iterate, which has not moved yet."""
    write(spec, state.start_x, i, x)
    write(spec, state.moved, i, 0.0 * x)


@ti.func
def apart(spec: ti.template(), state: ti.template(), value: ti.template(), i, j):
    """The vectors from i to j at the iterate: those at the stage's start, and by how much more.

    Their rounding is that of their own length and of the way in the stage, and not that of the
    positions, which stiff springs would answer with forces that hide gravity.
    """
    if ti.static(spec.compensated):
        return difference(spec, state, value, i, j)
    else:
        d = value(spec, state.start_x, j) - value(spec, state.start_x, i)
        return d + (value(spec, state.moved, j) - value(spec, state.moved, i))


@ti.func
def moved_from_old(spec: ti.template(), state: ti.template(), i, change):
    """The positions of pack i at the step's start, plus `change`."""
    if ti.static(spec.compensated):
        write(spec, state.x_low, i, read(spec, state.old_x_low, i))
    return add_to_position(spec, state, i, read(spec, state.old_x, i), change)


@ti.func
def iterate_from(spec: ti.template(), state: ti.template(), i, gain):
    """Set the iterate of pack i to the one whose velocities gain `gain` in the stage."""
    write(spec, state.gain, i, gain)
    v = read(spec, state.start_v, i) + gain
    write(spec, state.v, i, v)
    if ti.static(spec.compensated):
        write(spec, state.x_low, i, read(spec, state.start_x_low, i))
    moved = state.tau[None] * v
    write(spec, state.moved, i, moved)
    start_x = read(spec, state.start_x, i)
    write(spec, state.x, i, add_to_position(spec, state, i, start_x, moved))


@ti.func
def new_velocity(spec: ti.template(), state: ti.template(), i, gain):
    """The velocities of pack i at the step's end: those at its start, contacts' changes, `gain`."""
    x, v = read(spec, state.old_x, i), read(spec, state.old_v, i)
    new_v = add_to_velocity(spec, state, i, v, velocity_jump(spec, state, i, x, v))
    return add_to_velocity(spec, state, i, new_v, gain)


@ti.func
def arrive(spec: ti.template(), state: ti.template(), i, change, new_v):
    """End the step for pack i.

    change: how far its positions are from those at the step's start; new_v: its velocities.
    """
    x, v = read(spec, state.old_x, i), read(spec, state.old_v, i)
    new_x = moved_from_old(spec, state, i, change)
    store_held_by_walls(spec, state, i, x, v, new_x, new_v, commit)


@ti.func
def start(spec: ti.template(), state: ti.template(), i):
    """Start a stage for pack i from the step's start, with the changes that contacts make."""
    keep_start(spec, state, i)
    x, v = read(spec, state.x, i), read(spec, state.v, i)
    start_from(spec, state, i, 0.0 * v, v + velocity_jump(spec, state, i, x, v))


@ti.func
def mass_of(spec: ti.template(), state: ti.template(), i):
    """The masses of pack i's particles; 0 where they are fixed."""
    w = read(spec, state.w, i)
    return ti.select(w > 0.0, 1.0 / w, 0.0 * w)


@ti.func
def own_diagonal(spec: ti.template(), state: ti.template(), i):
    """The diagonal of A for pack i without its springs: masses, holds and drag."""
    tau, diagonal = state.tau[None], mass_of(spec, state, i)
    if ti.static(binds(spec)):
        diagonal = diagonal + tau * tau * stiffness_of(spec, state, read, i)
    if ti.static(resists(spec)):
        diagonal = diagonal + tau * damping_of(spec, state, read, i)
    return diagonal


@ti.func
def whole_diagonal(spec: ti.template(), state: ti.template(), i):
    """The same with every spring of pack i's particles counted along every axis."""
    tau = state.tau[None]
    diagonal = own_diagonal(spec, state, i) + tau * tau * read(spec, state.summed_k, i)
    if ti.static(reads_velocity(spec)):
        diagonal = diagonal + tau * read(spec, state.summed_c, i)
    return diagonal


@ti.func
def largest_component(spec: ti.template(), a):
    """The largest component, without its sign, of each of the vectors a of a pack."""
    most = 0.0 * component(a, 0)
    for axis in ti.static(range(spec.dim)):
        part = component(a, axis)
        most = ti.max(most, ti.max(part, -1.0 * part))
    return most


@ti.func
def momentum_of(spec: ti.template(), state: ti.template(), i, residual):
    """The product of tau*M with the accelerations `residual` of pack i."""
    return state.tau[None] * mass_of(spec, state, i) * residual


@ti.func
def reachable_residual(state: ti.template()):
    """The residual that ends a stage: the wanted one, or what rounding leaves."""
    return ti.max(wanted_residual(state), rounding_accepted(state))


@ti.func
def wanted_residual(state: ti.template()):
    """The residual at which a stage has converged."""
    return _residual_within(state, state.tolerance[None], _part_of_load(state))


@ti.func
def residual_at_rest(state: ti.template()):
    """The residual that needs no direction at all, however rough a solution may be: where nothing
    but the load acts, the first one is the whole load.
    """
    return _residual_within(state, ti.min(state.tolerance[None], ROUGH), SOLVED)


@ti.func
def _residual_within(state: ti.template(), tolerance, part_of_load):
    wanted = tolerance * state.scale[None]
    if state.least_scale[None] > 0.0:
        wanted = ti.min(wanted, part_of_load * state.load[None])
    return wanted


@ti.func
def _part_of_load(state: ti.template()):
    """The residual that a stage may leave, in parts of its load."""
    return SOLVED * roughness(state) * roughness(state)


def may_be_rough(of):
    """True if solutions may be rough: not where steps begin with the acceleration at their start.

    What the step before has left is a part of that, and would grow from step to step.
    of: a method, or a state for it.
    """
    return of.force_times[0][0] != ONLY_EVALUATE


@ti.func
def roughness(state: ti.template()):
    """The factor by which solutions are rougher than by ROUGH; 1: they are not rough."""
    if ti.static(may_be_rough(state)):
        return ti.max(state.tolerance[None] / ti.cast(ROUGH, state.real), 1.0)
    else:
        return ti.cast(1.0, state.real)


@ti.func
def rounding_accepted(state: ti.template()):
    """The residual at which a stage is ROUNDED at once, without a look for further progress."""
    accepted = state.rounding[None]
    if state.least_scale[None] > 0.0:
        accepted = ti.min(accepted, _part_of_load(state) * state.load[None])
    return accepted


@ti.func
def outcome_of_rounding(state: ti.template()):
    """The outcome of a stage whose residual rounding does not let become smaller."""
    load = state.load[None]
    hidden = state.residual_max[None] > HIDING * load or state.rounding[None] > MOST_HIDING * load
    return ti.select(state.least_scale[None] > 0.0 and hidden, HIDDEN, ROUNDED)
