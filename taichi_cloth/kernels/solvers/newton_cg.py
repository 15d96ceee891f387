"""Implicit stages: Newton's method, each direction by preconditioned conjugate gradients.

A stage of every implicit method is backward Euler over a time tau from (start_x, start_v): it looks
for what the velocity gains, with

    residual = a(start_x + tau*v, v) - gain/tau = 0, where v = start_v + gain,

an acceleration for each particle. The iterate's v and x are kept in state.v and state.x, so that
forces are those of `forces.py`. A direction p solves A p = tau*M*residual with

    A = M + tau*(drag + dashpots) + tau^2*K,

K the springs' stiffness with what is negative clamped to 0 (`laws.spring_stiffness_product`), so
that A is positive definite; it is never stored, only multiplied (`springs.accumulate`). Where
springs are compressed the clamped K is not their stiffness, and directions only halve the residual;
so near the solution, from NEAR on, it is taken as it is. Should A then turn out to be indefinite,
what conjugate gradients have so far is the direction, and the next one is clamped again. The
preconditioner is its diagonal, with every spring along every axis. A step that leaves more than
half of its directional derivative, of either sign, is made longer or shorter by the secant rule.

Baraff, Witkin, "Large steps in cloth simulation", 1998; Choi, Ko, "Stable but responsive cloth",
2002; Nocedal, Wright, Numerical Optimization, 3.5 and 7.1 (line search Newton-CG); Shewchuk, "An
introduction to the conjugate gradient method without the agonizing pain", 1994, B3.

A stage has converged when its largest residual is at most state.tolerance times the largest
acceleration that it began with (gravity at least), or is as small as rounding leaves it. Otherwise
it ends after MOST_DIRECTIONS, after MOST_STALLS that brought nothing, or where numbers are no
longer finite, and state.work counts its step as unconverged.
"""

import functools

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.compensated import moved, sped_up
from taichi_cloth.kernels.contact import compute_contacts, kept_above_floor, velocity_jump
from taichi_cloth.kernels.forces import acceleration
from taichi_cloth.kernels.loops import add_up, barrier, each, each_cell_moving, find_largest
from taichi_cloth.kernels.packs import (
    component,
    dot,
    read,
    scaled,
    set_site_value,
    site_number,
    site_value,
    where_positive,
    write,
)
from taichi_cloth.kernels.solvers.phases import DONE, set_alone
from taichi_cloth.kernels.springs import accumulate, force_between
from taichi_cloth.kernels.state import FORCES, SWEEPS, UNCONVERGED
from taichi_cloth.kernels.watchdog import is_finite, store

# old_x, old_v: the state at the step's start; gain: the iterate's; change: a Newton direction,
# built up by conjugate gradients from residual, direction and its product with A.
VECTORS = (
    *("old_x", "old_v", "start_x", "start_v", "gain"),
    *("change", "residual", "direction", "product"),
)
LOW_VECTORS = ("old_x_low", "start_x_low")
HALOED = ("direction",)
NEEDS = ("near",)
SCALARS = (
    "tau",  # time of a stage
    "scale",  # acceleration that the residual is compared with
    "rounding",  # residual that rounding alone leaves
    "residual_max",
    "residual_rms",
    "best",  # least residual_max so far
    "slope",  # directional derivative at the start of a Newton step
    "length",  # part of `change` that has been gone
    "go",  # part of it still to go
    "short",  # longest length known to be too short, and the derivative there; likewise too long
    "short_slope",
    "long",  # 0: none known
    "long_slope",
    "energy",  # residual times preconditioned residual, of conjugate gradients
    "goal",  # energy at which these end
    "least",  # what a compressed spring's stiffness across is not below: CLAMPED or EXACT
)
COUNTS = ("indefinite", "directions", "trials", "stalls", "sweeps", "outcome", "step_outcome")
SUMS = 3
BEGIN, EVALUATE, DIRECT, ITERATE, SHIFT, FINISH = range(6)  # phases
LANES = 4  # in cells: with 8 it is a tenth faster, and takes twice as long to compile
LAUNCHES = ((BEGIN,), (EVALUATE, SHIFT), (DIRECT, ITERATE), (FINISH,))
# What came of a stage. ROUNDED: as small as rounding lets it be.
CONVERGED, ROUNDED, EXHAUSTED, STALLED, SINGULAR, NOT_FINITE = range(6)
OUTCOMES = (
    "converged",
    "converged to rounding",
    "the most directions were not enough",
    "directions brought no more progress",
    "singular",
    "not finite",
)

MOST_DIRECTIONS = 60
MOST_TRIALS = 12  # lengths of one direction
MOST_STALLS = 6  # directions without progress
ROUNDING = 0.5  # of a spring's force; several add up in a residual, with either sign
MOST_ROUNDINGS = 16.0  # times that, where directions bring no more progress
CLAMPED, EXACT = 0.0, -1e30
NEAR = 0.1  # part of the first residual
FORCING = 0.1  # conjugate gradients leave this part of the residual to the next direction
ONLY_EVALUATE = -1  # stage: the acceleration of the iterate is wanted, as its residual


def phases(fraction, start, move, first=0, last=0):
    """The phases of a method's step, whose stages take `fraction` of dt and are numbered from
    `first` (ONLY_EVALUATE or 0) to `last`.

    start(plan, state, c) sets the start of the first stage in cell c; move(plan, state, c) takes
    the solution of stage state.stage: it starts the next one from there (`start_from`) or, after
    the last, ends with `arrive`.
    """

    @ti.func
    def begin(plan: ti.template(), state: ti.template(), t):
        set_tau(plan, state, t, fraction * state.dt[None])
        compute_contacts(plan, state)
        each_cell_moving(plan, state, t, start)
        begin_stage(plan, state, t, first)

    @ti.func
    def finish(plan: ti.template(), state: ti.template(), t):
        each_cell_moving(plan, state, t, move)
        each(plan, state, t, 1, ti.static(_ending(last)))

    return begin, evaluate, direct, iterate, shift, finish


@ti.func
def set_tau(plan: ti.template(), state: ti.template(), t, tau):
    """Before anything of a step's stages: their time."""
    set_alone(plan, state.tau, t, tau)
    set_alone(plan, state.step_outcome, t, CONVERGED)
    barrier(plan, state)


@ti.func
def keep_start(plan: ti.template(), state: ti.template(), c):
    """In cell c, keep the state at the step's start."""
    write(plan, state.old_x, c, read(plan, state.x, c))
    write(plan, state.old_v, c, read(plan, state.v, c))
    if ti.static(plan.compensated):
        write(plan, state.old_x_low, c, read(plan, state.x_low, c))


@ti.func
def start_from(plan: ti.template(), state: ti.template(), c, change, v):
    """In cell c, start a stage `change` away from the step's start with the velocities v, which
    are the first iterate's, too.
    """
    x = moved_from_old(plan, state, c, change)
    write(plan, state.start_x, c, x)
    write(plan, state.start_v, c, v)
    if ti.static(plan.compensated):
        write(plan, state.start_x_low, c, read(plan, state.x_low, c))
    iterate_from(plan, state, c, 0.0 * v)


@ti.func
def moved_from_old(plan: ti.template(), state: ti.template(), c, change):
    """Cell c's positions at the step's start, changed."""
    if ti.static(plan.compensated):
        write(plan, state.x_low, c, read(plan, state.old_x_low, c))
    return moved(plan, state, c, read(plan, state.old_x, c), change)


@ti.func
def iterate_from(plan: ti.template(), state: ti.template(), c, gain):
    """Make `gain` what the velocities of cell c gain in the iterate."""
    write(plan, state.gain, c, gain)
    v = read(plan, state.start_v, c) + gain
    write(plan, state.v, c, v)
    if ti.static(plan.compensated):
        write(plan, state.x_low, c, read(plan, state.start_x_low, c))
    write(
        plan, state.x, c, moved(plan, state, c, read(plan, state.start_x, c), state.tau[None] * v)
    )


@ti.func
def new_velocity(plan: ti.template(), state: ti.template(), c, gain):
    """Cell c's velocities at the step's end: those of its start, contacts, and what they gain."""
    x, v = read(plan, state.old_x, c), read(plan, state.old_v, c)
    new_v = sped_up(plan, state, c, v, velocity_jump(plan, state, c, x, v))
    return sped_up(plan, state, c, new_v, gain)


@ti.func
def arrive(plan: ti.template(), state: ti.template(), c, change, new_v):
    """End of a step for cell c: `change` away from where it started, with the velocities new_v."""
    x, v = read(plan, state.old_x, c), read(plan, state.old_v, c)
    new_x = moved_from_old(plan, state, c, change)
    store(plan, state, c, kept_above_floor(plan, state, c, x, v, new_x, new_v), new_v)


@ti.func
def start(plan: ti.template(), state: ti.template(), c):
    """In cell c, start a stage from the step's start, with contacts."""
    keep_start(plan, state, c)
    x, v = read(plan, state.x, c), read(plan, state.v, c)
    start_from(plan, state, c, 0.0 * v, v + velocity_jump(plan, state, c, x, v))


@ti.func
def begin_stage(plan: ti.template(), state: ti.template(), t, stage):
    """End of `begin`: the first stage."""
    set_alone(plan, state.stage, t, stage)
    each(plan, state, t, 1, _begin_stage)


@ti.func
def _begin_stage(plan: ti.template(), state: ti.template(), i):
    state.directions[None], state.trials[None], state.stalls[None] = 0, 0, 0
    state.outcome[None], state.indefinite[None] = CONVERGED, 0
    state.phase[None] = EVALUATE


@functools.cache
def _ending(last):
    """To the next stage or, after stage `last`, the end of the step, which is counted if a solution
    did not converge.
    """

    @ti.func
    def body(plan: ti.template(), state: ti.template(), i):
        if state.stage[None] < last:
            state.stage[None] += 1
            _begin_stage(plan, state, i)
        else:
            if state.step_outcome[None] > ROUNDED:
                state.work[UNCONVERGED] += 1
            state.phase[None] = DONE

    return body


@ti.func
def evaluate(plan: ti.template(), state: ti.template(), t):
    accumulate(plan, state, t, force_between, _store_residual, _residual_more)
    find_largest(plan, state, t, _rounding_of, 0)
    each(plan, state, t, 1, _keep_rounding)
    find_largest(plan, state, t, _size, 0)
    add_up(plan, state, t, _square, 1)
    add_up(plan, state, t, _slope, 2)
    each(plan, state, t, 1, _judge)


@ti.func
def _store_residual(plan: ti.template(), state: ti.template(), c, f):
    a = acceleration(plan, state, c, f)
    residual = a - (1.0 / state.tau[None]) * read(plan, state.gain, c)
    w = read(plan, state.w, c)
    write(plan, state.residual, c, where_positive(w, residual, 0.0 * residual))


@ti.func
def _residual_more(plan: ti.template(), state: ti.template(), site, f):
    w = site_number(plan, state.w, site)
    residual = site_value(plan, state.residual, site) + w * f
    set_site_value(plan, state.residual, site, residual)


@ti.func
def _rounding_of(plan: ti.template(), state: ti.template(), c):
    """What rounding of positions, over all springs, and of the gain leaves of a residual."""
    w, x = read(plan, state.w, c), _largest_component(plan, state.x, c)
    gain = (1.0 / state.tau[None]) * _largest_component(plan, state.gain, c)
    return ti.select(w > 0.0, w * read(plan, state.near_k, c) * x + gain, 0.0 * w)


@ti.func
def _judge(plan: ti.template(), state: ti.template(), i):
    """After an evaluation: whether the stage is done, and what comes next if it is not."""
    state.work[FORCES] += 1
    most, squares, slope = state.sums[0, 0], state.sums[1, 0], state.sums[2, 0]
    state.residual_max[None] = most
    state.residual_rms[None] = ti.sqrt(squares / ti.max(state.n[None] * plan.dim, 1))
    first = state.directions[None] == 0
    if first:
        state.scale[None], state.best[None] = most, most
        for axis in ti.static(range(plan.dim)):
            state.scale[None] = ti.max(state.scale[None], ti.abs(state.gravity[axis]))
    wanted = _wanted(state)
    finite = is_finite(squares) and (first or is_finite(slope))
    start = state.slope[None]
    missed = not finite or slope < -0.5 * start or slope > 0.5 * start
    next_phase = DIRECT
    if state.stage[None] == ONLY_EVALUATE:
        next_phase = FINISH
    elif finite and most <= wanted:
        state.outcome[None], next_phase = CONVERGED, FINISH
    elif finite and state.directions[None] > 1 and most <= state.rounding[None]:
        state.outcome[None], next_phase = ROUNDED, FINISH
    elif first and not finite:
        state.outcome[None], next_phase = NOT_FINITE, FINISH
    elif not first and missed and state.trials[None] < MOST_TRIALS:
        state.trials[None] += 1
        length = _next_length(state, slope, finite)
        state.go[None] = length - state.length[None]
        state.length[None] = length
        next_phase = SHIFT
    elif not finite:
        state.outcome[None], next_phase = NOT_FINITE, FINISH
    else:
        state.stalls[None] = ti.select(most > 0.7 * state.best[None], state.stalls[None] + 1, 0)
        if state.outcome[None] == SINGULAR:
            next_phase = FINISH
        elif not first and state.stalls[None] > MOST_STALLS:
            rounded = most <= MOST_ROUNDINGS * state.rounding[None]
            state.outcome[None], next_phase = ti.select(rounded, ROUNDED, STALLED), FINISH
        elif state.directions[None] >= MOST_DIRECTIONS:
            state.outcome[None], next_phase = EXHAUSTED, FINISH
    state.best[None] = ti.min(state.best[None], most)
    near = state.indefinite[None] == 0 and most < NEAR * state.scale[None]
    state.indefinite[None] = 0
    state.least[None] = ti.select(near, EXACT, CLAMPED)
    if next_phase == FINISH:
        state.step_outcome[None] = ti.max(state.step_outcome[None], state.outcome[None])
    state.phase[None] = next_phase


@ti.func
def _next_length(state: ti.template(), slope, finite):
    """By the secant rule, between the longest length that is too short and the shortest that is
    too long; four times as long where none is known to be too long.
    """
    length = state.length[None]
    if finite and slope > 0.0:
        state.short[None], state.short_slope[None] = length, slope
    else:
        state.long[None] = length
        state.long_slope[None] = ti.select(finite, slope, -10.0 * state.slope[None])
    short, short_slope = state.short[None], state.short_slope[None]
    longer = 4.0 * ti.max(short, 1.0)
    if state.long[None] > 0.0:
        width = state.long[None] - short
        part = short_slope / (short_slope - state.long_slope[None])
        longer = short + ti.min(ti.max(part, 0.1), 0.9) * width
    return longer


@ti.func
def direct(plan: ti.template(), state: ti.template(), t):
    """Begin conjugate gradients: no change yet, the first direction is downhill."""
    add_up(plan, state, t, _first_energy, 0)
    each_cell_moving(plan, state, t, _downhill)
    each(plan, state, t, 1, _begin_iterating)


@ti.func
def _first_energy(plan: ti.template(), state: ti.template(), c):
    residual = _momentum(plan, state, c, read(plan, state.residual, c))
    write(plan, state.residual, c, residual)
    write(plan, state.change, c, 0.0 * residual)
    return dot(residual, _preconditioned(plan, state, c, residual))


@ti.func
def _momentum(plan: ti.template(), state: ti.template(), c, residual):
    """tau*M times an acceleration."""
    return scaled(state.tau[None] * _mass(plan, state, c), residual)


@ti.func
def _downhill(plan: ti.template(), state: ti.template(), c):
    residual = read(plan, state.residual, c)
    write(plan, state.direction, c, _preconditioned(plan, state, c, residual))


@ti.func
def _preconditioned(plan: ti.template(), state: ti.template(), c, residual):
    tau = state.tau[None]
    w = read(plan, state.w, c)
    diagonal = _mass(plan, state, c) + tau * tau * read(plan, state.near_k, c)
    if ti.static(plan.drag):
        diagonal = diagonal + tau * read(plan, state.viscous, c)
    if ti.static(plan.dashpots):
        diagonal = diagonal + tau * read(plan, state.near_c, c)
    return scaled(ti.select(w > 0.0, 1.0 / diagonal, 0.0 * w), residual)


@ti.func
def iterate(plan: ti.template(), state: ti.template(), t):
    """One step of conjugate gradients."""
    accumulate(plan, state, t, _product_between, _store_product, _product_more)
    add_up(plan, state, t, _curvature, 0)
    add_up(plan, state, t, _approach, 1)
    each_cell_moving(plan, state, t, _turn)
    each(plan, state, t, 1, _count_iteration)


@ti.func
def _product_between(
    plan: ti.template(), state: ti.template(), value: ti.template(), i, j, k, rest, c
):
    d = value(plan, state.x, j) - value(plan, state.x, i)
    length = laws.length(d)
    along = laws.unit(d, length)
    moved = value(plan, state.direction, j) - value(plan, state.direction, i)
    product = laws.spring_stiffness_product(moved, along, length, k, rest, state.least[None])
    if ti.static(plan.dashpots):
        damping = (1.0 / state.tau[None]) * c
        product += scaled(laws.dashpot_tension(moved, along, damping), along)
    return product


@ti.func
def _store_product(plan: ti.template(), state: ti.template(), c, pulled):
    tau = state.tau[None]
    direction = read(plan, state.direction, c)
    diagonal = _mass(plan, state, c)
    if ti.static(plan.drag):
        diagonal = diagonal + tau * read(plan, state.viscous, c)
    product = scaled(diagonal, direction) - (tau * tau) * pulled
    w = read(plan, state.w, c)
    write(plan, state.product, c, where_positive(w, product, 0.0 * product))


@ti.func
def _product_more(plan: ti.template(), state: ti.template(), site, pulled):
    if site_number(plan, state.w, site) > 0.0:
        tau = state.tau[None]
        product = site_value(plan, state.product, site) - (tau * tau) * pulled
        set_site_value(plan, state.product, site, product)


@ti.func
def _approach(plan: ti.template(), state: ti.template(), c):
    step = _step_length(state)
    change, direction = read(plan, state.change, c), read(plan, state.direction, c)
    residual, product = read(plan, state.residual, c), read(plan, state.product, c)
    write(plan, state.change, c, change + step * direction)
    residual = residual - step * product
    write(plan, state.residual, c, residual)
    return dot(residual, _preconditioned(plan, state, c, residual))


@ti.func
def _turn(plan: ti.template(), state: ti.template(), c):
    part = state.sums[1, 0] / state.energy[None]
    residual = _preconditioned(plan, state, c, read(plan, state.residual, c))
    write(plan, state.direction, c, residual + part * read(plan, state.direction, c))


@ti.func
def shift(plan: ti.template(), state: ti.template(), t):
    """Go the length that is still to go along `change`."""
    each_cell_moving(plan, state, t, _shift_cell)
    each(plan, state, t, 1, _to_evaluate)


@ti.func
def _shift_cell(plan: ti.template(), state: ti.template(), c):
    change = read(plan, state.change, c)
    iterate_from(plan, state, c, read(plan, state.gain, c) + state.go[None] * change)


@ti.func
def _mass(plan: ti.template(), state: ti.template(), c):
    """Masses of cell c's particles; 0 where they are fixed."""
    w = read(plan, state.w, c)
    return ti.select(w > 0.0, 1.0 / w, 0.0 * w)


@ti.func
def _largest_component(plan: ti.template(), of: ti.template(), c):
    """Of each vector in cell c, without its sign."""
    a = read(plan, of, c)
    most = 0.0 * component(a, 0)
    for axis in ti.static(range(plan.dim)):
        part = component(a, axis)
        most = ti.max(most, ti.max(part, -1.0 * part))
    return most


@ti.func
def _size(plan: ti.template(), state: ti.template(), c):
    return _largest_component(plan, state.residual, c)


@ti.func
def _square(plan: ti.template(), state: ti.template(), c):
    residual = read(plan, state.residual, c)
    return dot(residual, residual)


@ti.func
def _slope(plan: ti.template(), state: ti.template(), c):
    """Directional derivative along `change` of what a stage minimizes, negated."""
    change, residual = read(plan, state.change, c), read(plan, state.residual, c)
    return dot(change, _momentum(plan, state, c, residual))


@ti.func
def _keep_rounding(plan: ti.template(), state: ti.template(), i):
    state.rounding[None] = ROUNDING * ti.static(_epsilon(state)) * state.sums[0, 0]


def _epsilon(state):
    return 2.0**-52 if state.real == ti.f64 else 2.0**-23


def _least(state):
    """A million of the smallest numbers: products of some such still mean something."""
    return 1e6 * (2.0**-1022 if state.real == ti.f64 else 2.0**-126)


@ti.func
def _wanted(state: ti.template()):
    """The residual at which a stage has converged."""
    return state.tolerance[None] * state.scale[None]


@ti.func
def _begin_iterating(plan: ti.template(), state: ti.template(), i):
    energy = state.sums[0, 0]
    part = ti.min(ti.max(0.3 * _wanted(state) / state.residual_max[None], FORCING), 0.5)
    state.energy[None], state.goal[None] = energy, part * part * energy
    state.slope[None] = 0.0
    state.sweeps[None] = 0
    state.phase[None] = ITERATE
    if energy < ti.static(_least(state)):  # what is left is too small to be squared
        state.outcome[None] = ROUNDED
        state.step_outcome[None] = ti.max(state.step_outcome[None], ROUNDED)
        state.phase[None] = FINISH


@ti.func
def _curvature(plan: ti.template(), state: ti.template(), c):
    return dot(read(plan, state.direction, c), read(plan, state.product, c))


@ti.func
def _step_length(state: ti.template()):
    """Of conjugate gradients; 0 where A is singular along the direction, or not finite."""
    curvature = state.sums[0, 0]
    return ti.select(curvature > 0.0, state.energy[None] / curvature, 0.0)


@ti.func
def _count_iteration(plan: ti.template(), state: ti.template(), i):
    energy, step = state.sums[1, 0], _step_length(state)
    state.slope[None] += step * state.energy[None]
    state.energy[None] = energy
    state.sweeps[None] += 1
    state.work[SWEEPS] += 1
    most = 2 * plan.dim * state.n[None] + 20
    ends = not (energy > state.goal[None]) or state.sweeps[None] >= most
    if not (step > 0.0):
        # Exact, A may be indefinite: the change so far is downhill. Clamped it is not, unless
        # numbers are no longer finite.
        ends, state.indefinite[None] = True, 1
        if state.least[None] == CLAMPED:
            state.outcome[None] = SINGULAR
    if ends:
        state.directions[None] += 1
        state.trials[None] = 0
        state.length[None], state.go[None] = 1.0, 1.0
        state.short[None], state.short_slope[None], state.long[None] = 0.0, state.slope[None], 0.0
        state.phase[None] = SHIFT


@ti.func
def _to_evaluate(plan: ti.template(), state: ti.template(), i):
    state.phase[None] = EVALUATE
