"""Force accumulation: all terms that act on a particle (`forces/`), as one acceleration."""

import functools

import taichi as ti

from taichi_cloth.kernels.forces import load
from taichi_cloth.kernels.forces.contract import ACCELERATION, FORCE, TENSION, has
from taichi_cloth.kernels.loops import each_pack_moving
from taichi_cloth.kernels.packs import (
    read,
    scaled,
    set_slot_value,
    slot_number,
    slot_value,
    where_positive,
    write,
)
from taichi_cloth.kernels.springs import (
    accumulate,
    force_between,
    move_and_accumulate,
    reads_velocity,
    sum_of,
)


@ti.func
def compute_acceleration(spec: ti.template(), state: ti.template(), t):
    """a = g + w*f for every particle, from the positions and velocities as they stand.

    Positions and velocities are only read, so no loop has a race.
    """
    accumulate(spec, state, t, force_between, _store_acceleration, _accelerate_more)


@ti.func
def accelerate_then(spec: ti.template(), state: ti.template(), t, move: ti.template()):
    """Run move(spec, state, i, a) for every pack i with its acceleration a at the step's start.

    A special case that is measured to pay: in lanes a pack that has its acceleration can move at
    once, which saves storing and reading it. All else takes two loops.
    """
    if ti.static(spec.lanes > 1 and not spec.springs):
        accumulate(spec, state, t, force_between, ti.static(_moving(move)), _accelerate_more)
    else:
        compute_acceleration(spec, state, t)
        each_pack_moving(spec, state, t, ti.static(_moving_with_stored(move)))


def kicks_at_once(spec):
    """Whether `kick_after` kicks a pack when it has its forces, and leaves state.a to that."""
    if spec.lanes > 1:
        return not spec.springs and not spec.one_launch_per_step
    # Neighbours read positions, which a kick leaves, and for dashpots velocities.
    return not reads_velocity(spec) and not (spec.springs and spec.kinds > 0)


@ti.func
def kick_after(
    spec: ti.template(), state: ti.template(), t, move: ti.template(), kick: ti.template()
):
    """Run move(spec, state, i) for every pack, then kick(spec, state, i, a) with its acceleration
    where it is now, which changes its velocity alone. In lanes that is one pass over memory.
    """
    if ti.static(not kicks_at_once(spec)):
        each_pack_moving(spec, state, t, move)
        accelerate_then(spec, state, t, kick)
    elif ti.static(spec.lanes > 1):
        move_and_accumulate(spec, state, t, move, force_between, ti.static(_moving(kick)))
    else:
        each_pack_moving(spec, state, t, move)
        accumulate(spec, state, t, force_between, ti.static(_moving(kick)), _accelerate_more)


@functools.cache
def _moving(move):
    @ti.func
    def consume(spec: ti.template(), state: ti.template(), i, f):
        move(spec, state, i, acceleration(spec, state, i, f))

    return consume


@functools.cache
def _moving_with_stored(move):
    @ti.func
    def body(spec: ti.template(), state: ti.template(), i):
        move(spec, state, i, read(spec, state.a, i))

    return body


@ti.func
def _store_acceleration(spec: ti.template(), state: ti.template(), i, f):
    write(spec, state.a, i, acceleration(spec, state, i, f))


def _laws(spec, adds, resists=None):
    """The laws of the terms on particles of a kind; resists: whether those with damping, or not."""
    found = [load(name) for name in spec.terms]
    return [
        term.law
        for term in found
        if term.adds == adds and (resists is None or has(term.damping) == resists)
    ]


@ti.func
def acceleration(spec: ti.template(), state: ti.template(), i, f):
    """Acceleration of pack i under the spring forces f and all that acts on single particles.

    The order of the sums is that of the reference trajectories: a pulled cloth amplifies round-off
    1e8 times in 600 frames. Forces that resist motion are added up among the accelerations.
    """
    w, v = read(spec, state.w, i), read(spec, state.v, i)
    none = 0.0 * v
    a, total = none, f
    for law in ti.static(_laws(spec, ACCELERATION)):
        a += law(spec, state, i)
    for law in ti.static(_laws(spec, FORCE, True)):
        a += scaled(w, law(spec, state, i))
    for law in ti.static(_laws(spec, FORCE, False)):
        total += law(spec, state, i)
    return where_positive(w, a + scaled(w, total), none)


def _derivatives(spec, part):
    """The stiffnesses or dampings of the terms on particles that have one."""
    found = [load(name) for name in spec.terms]
    return [getattr(t, part) for t in found if t.adds != TENSION and has(getattr(t, part))]


def resists(spec):
    """Whether a term on particles has damping."""
    return bool(_derivatives(spec, "damping"))


def binds(spec):
    """Whether a term on particles has stiffness."""
    return bool(_derivatives(spec, "stiffness"))


@ti.func
def damping_of(spec: ti.template(), state: ti.template(), number: ti.template(), i):
    """Damping by all terms on particles, a number for each particle. number: `packs.read`, or of
    a slot `slot_number`.
    """
    return sum_of(
        [part(spec, state, number, i) for part in ti.static(_derivatives(spec, "damping"))]
    )


@ti.func
def stiffness_of(spec: ti.template(), state: ti.template(), number: ti.template(), i):
    """Stiffness by all terms on particles, a number for each particle."""
    return sum_of(
        [part(spec, state, number, i) for part in ti.static(_derivatives(spec, "stiffness"))]
    )


@ti.func
def _accelerate_more(spec: ti.template(), state: ti.template(), slot, f):
    """Acceleration by springs that no grid holds."""
    w = slot_number(spec, state.w, slot)
    set_slot_value(spec, state.a, slot, slot_value(spec, state.a, slot) + w * f)
