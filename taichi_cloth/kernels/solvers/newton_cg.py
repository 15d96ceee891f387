"""Implicit stages: Newton's method, each direction by a preconditioned Krylov method.

A stage of every implicit method here is backward Euler over a time tau from (start_x, start_v). It
looks for the gain of the velocity for which

    residual = a(start_x + tau*v, v) - gain/tau = 0, where v = start_v + gain.

The residual is an acceleration for each particle. The iterate's v and x are kept in state.v and
state.x, so that forces are computed as for all methods (`accelerations.py`). A *direction* p, by
which the gain is changed, solves A p = tau*M*residual with the masses M and

    A = M + tau*(drag + dashpots) + tau^2*K + the exact derivative of the forces on triangles.

K is the springs' stiffness matrix with its negative eigenvalues clamped to 0
(`laws.spring_stiffness_across`), so that A is positive definite, and conjugate gradients solve it
(`conjugate_gradients.py`); in air it is not symmetric, and BiCGSTAB does (`bicgstab.py`). A is
never stored, only multiplied with vectors (`newton_matrix.py`). Where springs are compressed the
clamped K is not their stiffness, and directions only halve the residual; so near the solution, from
NEAR on, K is taken as it is. If A then turns out to be indefinite, the direction is what the
iterations have found so far, and for the next one K is clamped again. A step along p that leaves
more than half of the directional derivative, of either sign, is made longer or shorter by the
secant rule.

Baraff, Witkin, "Large steps in cloth simulation", 1998; Choi, Ko, "Stable but responsive cloth",
2002; Nocedal, Wright, Numerical Optimization, 3.5 and 7.1 (line search Newton-CG).

A stage has converged when its largest residual is at most state.tolerance times the largest
residual that it began with (gravity at least), or is as small as rounding leaves it; what is left
must be small beside gravity, too (`stages.SOLVED`), unless rough solutions are wanted
(`stages.ROUGH`). Otherwise it ends after MOST_DIRECTIONS, after MOST_STALLS directions that brought
little (fewer where rounding may be why), or where numbers are no longer finite, and state.work
counts its step as unconverged.

The vectors of springs are those at the stage's start, and by how much their ends have moved against
each other since (`stages.apart`): in f32 rounding of positions, times a stiff spring's stiffness,
is more than gravity, and no direction can take it from the residual.

Wind that would move a cloth by more than its spacing in a step leaves no minimum to go to, and a
cloth that buckles has many: Newton's method may then wander for ever. So a step in which a stage
does not converge is cut in two, and its halves again, up to MOST_HALVINGS times: the method's own
steps, each solved to its tolerance, with one end for contacts and tears. In air, and where a step
was cut before, that is seen after MOST_BEFORE_CUT directions. In still air symplectic methods cut
none: they keep energy by equal steps (Hairer, Lubich, Wanner, Geometric Numerical Integration,
2006, VIII.1).
"""

import functools

import taichi as ti

from taichi_cloth.kernels.accelerations import (
    acceleration,
)
from taichi_cloth.kernels.clock import time_of_forces
from taichi_cloth.kernels.contact import compute_contacts
from taichi_cloth.kernels.forces import has_tractions
from taichi_cloth.kernels.links import Pass, nothing
from taichi_cloth.kernels.loops import each, each_pack_moving, leave
from taichi_cloth.kernels.packs import (
    dot,
    epsilon,
    plus,
    read,
    set_slot_value,
    slot_number,
    slot_value,
    where_positive,
    write,
)
from taichi_cloth.kernels.phases import DONE, set_alone
from taichi_cloth.kernels.solvers import bicgstab, conjugate_gradients, two_levels
from taichi_cloth.kernels.solvers.newton_matrix import keep_springs
from taichi_cloth.kernels.solvers.stages import (
    BEGIN,
    CLAMPED,
    COARSEN,
    CONVERGED,
    CUT,
    DIRECT,
    EVALUATE,
    EXACT,
    EXHAUSTED,
    FINISH,
    HIDDEN,
    ITERATE,
    JUST_NOW,
    NOT_FINITE,
    NOT_YET,
    ONLY_EVALUATE,
    ROUNDED,
    SINGULAR,
    STALLED,
    apart,
    iterate_from,
    largest_component,
    momentum_of,
    outcome_of_rounding,
    residual_at_rest,
    return_to_start,
    rounding_accepted,
    set_tau,
    time_of_part,
    wanted_residual,
)
from taichi_cloth.kernels.solvers.two_levels import has_two_levels, stiff_from
from taichi_cloth.kernels.springs import accumulate_and_join, force_along
from taichi_cloth.kernels.state import FORCES, UNCONVERGED
from taichi_cloth.kernels.surfaces import compute_tractions
from taichi_cloth.kernels.watchdog import is_finite

SCALARS = (
    "tau",  # time of a stage
    "scale",  # acceleration that the residual is compared with
    "rounding",  # residual that rounding alone leaves
    "load",  # largest acceleration by gravity or by the iterate's gain
    "residual_max",  # largest component of the residual, without its sign
    "residual_rms",  # root of the mean square of its components
    "best",  # least residual_max so far
    "slope",  # directional derivative at the start of a Newton step
    "length",  # part of `change` that the iterate has gone
    "go",  # part of it still to go
    "short",  # longest length known to be too short
    "short_slope",  # directional derivative there
    "long",  # shortest length known to be too long; 0: none known
    "long_slope",  # directional derivative there
    "energy",  # residual times preconditioned residual, of conjugate gradients
    "goal",  # energy at which these end
    "ahead",  # the part of their direction that `change` has yet to go
    "part",  # the part of it that the next direction takes over
    "least",  # stiffness across a spring is at least this times the one along: CLAMPED or EXACT
    *bicgstab.SCALARS,
)
MOST_DIRECTIONS = 60
MOST_BEFORE_CUT = 16  # directions after which a step that may be cut in two is, if soon
MOST_HALVINGS = 6
MOST_TRIALS = 12  # lengths of one direction
# Directions one after the other that bring little progress; where rounding may be why, fewer.
MOST_STALLS, MOST_STALLS_ROUNDED = 20, 2
MOST_STALLS_BEFORE_CUT = 6
# Rounding of a spring's force, in epsilons: several add up in a residual, with either sign.
ROUNDING = 0.5
MOST_ROUNDINGS = 16.0  # where progress has ended, a residual is ROUNDED up to this times `rounding`
NEAR = 0.1  # part of the first residual below which K is taken as it is
# What an evaluation joins over all packs (`_numbers`), and how.
LENGTHS, GAINED, MOST, SQUARES, SLOPE, STIFFNESS = range(6)
OPS = (ti.max, ti.max, ti.max, plus, plus, ti.max)


def keeps(*vectors):
    """The parts of a `methods.contract.Method` that methods with these stages share.

    vectors: names of further vectors that the method keeps itself.
    The shared ones are old_x, old_v: the state at the step's start; start_x, start_v: that at a
    stage's start; gain, moved: by how much the iterate's v and x are more; change: the Newton
    direction, which conjugate gradients build up from residual, direction (theirs) and product
    (that of A with it).
    """
    state = ("old_x", "old_v", "start_x", "start_v", "gain", "moved")
    return {
        "vectors": (*state, "change", "residual", "direction", "product", *vectors),
        "low_vectors": ("old_x_low", "start_x_low"),
        "haloed": ("direction", "start_x", "moved"),
        "numbers": ("over_diagonal",),
        "needs": ("summed_springs", "kept_stiffness"),
        "scalars": SCALARS,
        "raised": ("longest",),  # the length of the longest spring
        "traction_vectors": bicgstab.VECTORS,
        "counts": (
            *("indefinite", "directions", "trials", "stalls", "sweeps"),
            *("outcome", "step_outcome"),
            "coarsened",  # when a step has made the coarse level: NOT_YET, JUST_NOW or BEFORE
            # How often the step was cut in two, parts that are done, whether one of them failed.
            *("halvings", "parts_done", "failed"),
            *bicgstab.COUNTS,
        ),
        "sums": max(len(OPS), conjugate_gradients.SUMS, bicgstab.SUMS),
        "launches": ((BEGIN, FINISH, CUT), (EVALUATE, DIRECT, ITERATE), (COARSEN,)),
        "lanes": (8, 8),  # with 4 a step takes 1.5 times as long
    }


def phases(fraction, start, move, first=0, last=0):
    """The phases of a method's step.

    fraction: the time of each stage, as a part of dt.
    start(spec, state, i): sets the start of the first stage in pack i.
    move(spec, state, i): takes the solution of stage state.stage in pack i and starts the next
        stage from there by `start_from`, or after the last one ends the step by `arrive`.
    first, last: the numbers of the first stage, 0 or ONLY_EVALUATE, and of the last one.
    """

    @ti.func
    def begin(spec: ti.template(), state: ti.template(), t):
        set_tau(spec, state, t, fraction * time_of_part(state))
        compute_contacts(spec, state, t)
        each_pack_moving(spec, state, t, start)
        begin_stage(spec, state, t, first)

    @ti.func
    def finish(spec: ti.template(), state: ti.template(), t):
        each_pack_moving(spec, state, t, move)
        each(spec, state, t, 1, ti.static(_ending(last)))

    return begin, evaluate, direct, iterate, finish, cut, coarsen


@ti.func
def begin_stage(spec: ti.template(), state: ti.template(), t, stage):
    """Go to the first stage of a step, which has the number `stage`."""
    set_alone(spec, state.stage, t, stage)
    each(spec, state, t, 1, _begin_stage)


@ti.func
def _begin_stage(spec: ti.template(), state: ti.template(), i):
    """Clear what is counted in a stage, and go to its first evaluation."""
    state.directions[None], state.trials[None], state.stalls[None] = 0, 0, 0
    state.outcome[None], state.indefinite[None] = CONVERGED, 0
    state.ahead[None], state.go[None], state.longest[None] = 0.0, 0.0, 0.0
    state.phase[None] = EVALUATE


@functools.cache
def _ending(last):
    """The body of a loop, run once, that goes to the next stage or, after `last`, ends the step.

    A step in which a stage did not converge is counted.
    """

    @ti.func
    def body(spec: ti.template(), state: ti.template(), i):
        if state.stage[None] < last:
            state.stage[None] += 1
            _begin_stage(spec, state, i)
        else:
            _end_part(state)

    return body


@ti.func
def _end_part(state: ti.template()):
    """Go on to the next part of a step that was cut, or end the step."""
    if state.step_outcome[None] > ROUNDED:
        state.failed[None] = 1
    state.parts_done[None] += 1
    state.phase[None] = BEGIN
    if state.parts_done[None] == 1 << state.halvings[None]:
        state.work[UNCONVERGED] += state.failed[None]
        state.halvings[None], state.parts_done[None], state.failed[None] = 0, 0, 0
        state.phase[None] = DONE


@ti.func
def cut(spec: ti.template(), state: ti.template(), t):
    """Cut the present part of a step in two, and go back to its start."""
    each_pack_moving(spec, state, t, return_to_start)
    each(spec, state, t, 1, _halve)


@ti.func
def _halve(spec: ti.template(), state: ti.template(), i):
    state.halvings[None] += 1
    state.parts_done[None] *= 2
    state.phase[None] = BEGIN


@ti.func
def direct(spec: ti.template(), state: ti.template(), t):
    """Begin to look for a direction."""
    if ti.static(has_tractions(spec)):
        bicgstab.direct(spec, state, t)
    else:
        conjugate_gradients.direct(spec, state, t)


@ti.func
def iterate(spec: ti.template(), state: ti.template(), t):
    """Make one step towards a direction."""
    if ti.static(has_tractions(spec)):
        bicgstab.iterate(spec, state, t)
    else:
        conjugate_gradients.iterate(spec, state, t)


@ti.func
def coarsen(spec: ti.template(), state: ti.template(), t):
    """Make what this step's directions need of the coarse level."""
    if ti.static(has_two_levels(spec)):
        keep_springs(spec, state, t)
        two_levels.coarsen(spec, state, t)
    each(spec, state, t, 1, _go_to_direct)


@ti.func
def _go_to_direct(spec: ti.template(), state: ti.template(), i):
    state.coarsened[None] = JUST_NOW
    state.phase[None] = DIRECT


@ti.func
def evaluate(spec: ti.template(), state: ti.template(), t):
    """Move the iterate by what is still to go, compute its residual, and decide what comes next."""
    if ti.static(has_tractions(spec)):  # which come before the links of the first row
        each_pack_moving(spec, state, t, _shift)
        compute_tractions(spec, state, t, time_of_forces, False)
        accumulate_and_join(spec, state, t, ti.static(_evaluating(leave)), _residual_more)
    else:
        accumulate_and_join(spec, state, t, ti.static(_evaluating(_shift)), _residual_more)
    each(spec, state, t, 1, _judge)


@functools.cache
def _evaluating(move):
    """The pass that moves the iterate by `move`, and computes its residual."""
    return Pass(
        _force_between,
        apart,
        _store_residual,
        move,
        numbers=_numbers,
        ops=OPS,
        moved=_shifted,
        consumed=nothing,
    )


@ti.func
def _force_between(
    spec: ti.template(), state: ti.template(), value: ti.template(), i, j, numbers: ti.template()
):
    """The force on i of the spring to j at the iterate: a contribution for `accumulate`."""
    return force_along(spec, state, value, i, j, apart(spec, state, value, i, j), numbers)


def _shifted(state):
    """The changes by a shift of the iterate of what neighbours read."""
    return (*state.haloed_motion, state.moved)


@ti.func
def _shift(spec: ti.template(), state: ti.template(), i):
    """Move the iterate of pack i along `change` by the length that is still to go."""
    if state.directions[None] > 0:
        change = read(spec, state.change, i)
        if state.ahead[None] != 0.0:  # the solver's last step
            change = change + state.ahead[None] * read(spec, state.direction, i)
            write(spec, state.change, i, change)
        iterate_from(spec, state, i, read(spec, state.gain, i) + state.go[None] * change)


@ti.func
def _store_residual(spec: ti.template(), state: ti.template(), i, f):
    """Store the residual of pack i under the spring forces f; 0 where particles are fixed."""
    a = acceleration(spec, state, i, f)
    residual = a - (1.0 / state.tau[None]) * read(spec, state.gain, i)
    w = read(spec, state.w, i)
    write(spec, state.residual, i, where_positive(w, residual, 0.0 * residual))


@ti.func
def _residual_more(spec: ti.template(), state: ti.template(), slot, f):
    """Add the forces f of those springs that no grid holds to the residual of one particle."""
    w = slot_number(spec, state.w, slot)
    residual = slot_value(spec, state.residual, slot) + w * f
    set_slot_value(spec, state.residual, slot, residual)


@ti.func
def _numbers(spec: ti.template(), state: ti.template(), i):
    """The terms of pack i that an evaluation joins over all packs, for `_judge`.

    - LENGTHS: the residual that rounding of lengths, over all springs, can make up; w is 0 if fixed
    - GAINED: the acceleration that gives the pack its gain
    - MOST: the largest component, without its sign, of each residual
    - SQUARES: the square of each residual
    - SLOPE: the directional derivative along `change` of what a stage minimizes, negated
    - STIFFNESS: a bound of (tau*omega)^2
    """
    tau, residual = state.tau[None], read(spec, state.residual, i)
    w, k = read(spec, state.w, i), read(spec, state.summed_k, i)
    lengths = state.longest[None] + largest_component(spec, read(spec, state.moved, i))
    gained = (1.0 / tau) * largest_component(spec, read(spec, state.gain, i))
    slope = dot(read(spec, state.change, i), momentum_of(spec, state, i, residual))
    return [
        w * k * lengths,
        gained,
        largest_component(spec, residual),
        dot(residual, residual),
        slope,
        (tau * tau) * w * k,
    ]


@ti.func
def _judge(spec: ti.template(), state: ti.template(), i):
    """Decide after an evaluation whether the stage is done, and what comes next if it is not."""
    state.work[FORCES] += 1
    gained, most = state.sums[GAINED, 0], state.sums[MOST, 0]
    squares, slope = state.sums[SQUARES, 0], state.sums[SLOPE, 0]
    rounding = ti.static(epsilon(state)) * (state.sums[LENGTHS, 0] + gained)
    state.rounding[None] = ROUNDING * rounding
    state.load[None] = ti.max(state.least_scale[None], gained)
    state.ahead[None] = 0.0
    state.residual_max[None] = most
    state.residual_rms[None] = ti.sqrt(squares / ti.max(state.n[None] * spec.dim, 1))
    first = state.directions[None] == 0
    if first:
        state.scale[None], state.best[None] = ti.max(most, state.least_scale[None]), most
    wanted = wanted_residual(state)
    finite = is_finite(squares) and (first or is_finite(slope))
    start = state.slope[None]
    missed = not finite or slope < -0.5 * start or slope > 0.5 * start
    next_phase = DIRECT
    if state.stage[None] == ONLY_EVALUATE:
        next_phase = FINISH
    elif finite and most <= ti.select(first, residual_at_rest(state), wanted):
        state.outcome[None], next_phase = CONVERGED, FINISH
    elif finite and state.directions[None] > 1 and most <= rounding_accepted(state):
        state.outcome[None], next_phase = outcome_of_rounding(state), FINISH
    elif first and not finite:
        state.outcome[None], next_phase = NOT_FINITE, FINISH
    elif not first and missed and state.trials[None] < MOST_TRIALS:
        state.trials[None] += 1
        length = _next_length(state, slope, finite)
        state.go[None] = length - state.length[None]
        state.length[None] = length
        next_phase = EVALUATE
    elif not finite:
        state.outcome[None], next_phase = NOT_FINITE, FINISH
    else:
        state.stalls[None] = ti.select(most > 0.7 * state.best[None], state.stalls[None] + 1, 0)
        if state.outcome[None] == SINGULAR:
            next_phase = FINISH
        elif not first and state.stalls[None] > _most_stalls(spec, state):
            rounded = most <= MOST_ROUNDINGS * state.rounding[None]
            state.outcome[None] = ti.select(rounded, outcome_of_rounding(state), STALLED)
            next_phase = FINISH
        elif state.directions[None] >= _most_directions(spec, state):
            state.outcome[None], next_phase = EXHAUSTED, FINISH
    state.best[None] = ti.min(state.best[None], most)
    near = state.indefinite[None] == 0 and most < NEAR * state.scale[None]
    state.indefinite[None] = 0
    state.least[None] = ti.select(near, EXACT, CLAMPED)
    if ti.static(has_two_levels(spec)):
        stiff = state.sums[STIFFNESS, 0] > ti.static(stiff_from(spec))
        if next_phase == DIRECT and state.coarsened[None] == NOT_YET and stiff:
            next_phase = COARSEN
    if next_phase == FINISH and state.outcome[None] > HIDDEN and _may_be_cut(spec, state):
        next_phase = CUT
    if next_phase == FINISH:
        state.step_outcome[None] = ti.max(state.step_outcome[None], state.outcome[None])
    state.phase[None] = next_phase


@ti.func
def _may_be_cut(spec: ti.template(), state: ti.template()):
    """True if a step may be cut in two where a stage does not converge."""
    if ti.static(has_tractions(spec) or not state.symplectic):
        return state.halvings[None] < MOST_HALVINGS
    else:
        return False


@ti.func
def _is_cut_soon(spec: ti.template(), state: ti.template()):
    """True if it is where a stage does not converge soon."""
    if ti.static(has_tractions(spec)):
        return _may_be_cut(spec, state)
    else:
        return _may_be_cut(spec, state) and state.halvings[None] > 0


@ti.func
def _most_stalls(spec: ti.template(), state: ti.template()):
    """After how many directions that bring little progress a stage ends."""
    rounded = state.best[None] <= state.rounding[None]
    most = ti.select(_is_cut_soon(spec, state), MOST_STALLS_BEFORE_CUT, MOST_STALLS)
    return ti.select(rounded, MOST_STALLS_ROUNDED, most)


@ti.func
def _most_directions(spec: ti.template(), state: ti.template()):
    """After how many directions a stage ends."""
    return ti.select(_is_cut_soon(spec, state), MOST_BEFORE_CUT, MOST_DIRECTIONS)


@ti.func
def _next_length(state: ti.template(), slope, finite):
    """The next length to try along `change`, after one that was too short or too long.

    It is found by the secant rule between the longest that is too short and the shortest that is
    too long; while none is known to be too long, it is four times the one that is too short.
    slope: directional derivative at the last length; finite: whether all numbers were, there.
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
