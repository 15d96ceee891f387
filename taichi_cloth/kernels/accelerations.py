"""Accelerations: all terms that act on a particle (`forces/`), added up, over its mass."""

import functools

import taichi as ti

from taichi_cloth.kernels.clock import time_of_forces
from taichi_cloth.kernels.compensated import difference
from taichi_cloth.kernels.forces import has_tractions, load
from taichi_cloth.kernels.forces.contract import ACCELERATION, FORCE, has
from taichi_cloth.kernels.loops import each_pack_moving
from taichi_cloth.kernels.packs import (
    read,
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
from taichi_cloth.kernels.surfaces import compute_tractions


@ti.func
def compute_acceleration(spec: ti.template(), state: ti.template(), t):
    """Compute state.a for every particle, from the positions and velocities as they stand.

    It is what `acceleration` gives with the forces of all springs (Newton's second law). Positions
    and velocities are only read, so no loop has a race.
    """
    compute_tractions(spec, state, t, time_of_forces, False)
    accumulate(spec, state, t, force_between, difference, _store_acceleration, _accelerate_more)


@ti.func
def accelerate_then(spec: ti.template(), state: ti.template(), t, move: ti.template()):
    """Run move(spec, state, i, a) for every pack i with its acceleration a in the present state.

    move: may change what neighbours read; each pack's acceleration is that before any has moved.
    On grids with several lanes and no other springs a pack can move as soon as it has its
    acceleration, which saves storing and reading it: measured, that pays. All else takes two loops.
    """
    if ti.static(spec.passes_over_rows and not spec.springs):
        compute_tractions(spec, state, t, time_of_forces, False)
        accumulate(
            spec, state, t, force_between, difference, ti.static(_moving(move)), _accelerate_more
        )
    else:
        compute_acceleration(spec, state, t)
        each_pack_moving(spec, state, t, ti.static(_moving_with_stored(move)))


@ti.func
def set_stage(spec: ti.template(), state: ti.template(), stage):
    """Say which of its stages a step is in, before the forces of that stage are asked for.

    All threads write the same number, and none is still in the stage before.
    """
    if ti.static(spec.one_launch_per_step):
        for _ in range(1):
            state.stage[None] = stage
    else:
        state.stage[None] = stage


def kicks_at_once(spec):
    """True if `kick_after` runs `kick` for a pack as soon as it has its forces.

    state.a is then what the method stored there, until `kick` changes it.
    """
    if has_tractions(spec):  # which come before the links of the first row
        return False
    if spec.passes_over_rows:
        return not spec.springs and not spec.one_launch_per_step
    # Neighbours read positions, which a kick leaves, and for dashpots velocities.
    return not reads_velocity(spec) and not (spec.springs and spec.kinds > 0)


@ti.func
def kick_after(
    spec: ti.template(), state: ti.template(), t, move: ti.template(), kick: ti.template()
):
    """Run move(spec, state, i) for every pack i, then kick(spec, state, i, a) for every pack i.

    a: the pack's acceleration where `move` has left it; kick: changes velocities alone. On grids
    with several lanes both are done in one pass over memory.
    """
    if ti.static(not kicks_at_once(spec)):
        each_pack_moving(spec, state, t, move)
        accelerate_then(spec, state, t, kick)
    elif ti.static(spec.passes_over_rows):
        move_and_accumulate(
            spec, state, t, move, force_between, difference, ti.static(_moving(kick))
        )
    else:
        each_pack_moving(spec, state, t, move)
        accumulate(
            spec, state, t, force_between, difference, ti.static(_moving(kick)), _accelerate_more
        )


@ti.func
def kick_then(
    spec: ti.template(), state: ti.template(), t, kick: ti.template(), move: ti.template()
):
    """Run kick(spec, state, i, a) with the acceleration of every pack i, then move(spec, state, i).

    Only where `kicks_at_once`, on a graph: no acceleration is then stored and read.
    """
    accumulate(
        spec, state, t, force_between, difference, ti.static(_moving(kick)), _accelerate_more
    )
    each_pack_moving(spec, state, t, move)


@functools.cache
def _moving(move):
    """A `consume` that runs move(spec, state, i, a) with the acceleration by the forces it gets."""

    @ti.func
    def consume(spec: ti.template(), state: ti.template(), i, f):
        move(spec, state, i, acceleration(spec, state, i, f))

    return consume


@functools.cache
def _moving_with_stored(move):
    """The body of a loop that runs move(spec, state, i, a) with the acceleration in state.a."""

    @ti.func
    def body(spec: ti.template(), state: ti.template(), i):
        move(spec, state, i, read(spec, state.a, i))

    return body


@ti.func
def _store_acceleration(spec: ti.template(), state: ti.template(), i, f):
    write(spec, state.a, i, acceleration(spec, state, i, f))


def terms_on_particles(spec, adds, resists=None):
    """Those terms on particles that add ACCELERATION or FORCE.

    adds: which of both; resists: True: only those with damping; False: only those without; None:
    all.
    """
    found = [load(name) for name in spec.terms]
    return [
        term
        for term in found
        if term.adds == adds and (resists is None or has(term.damping) == resists)
    ]


@ti.func
def plus_force(spec: ti.template(), state: ti.template(), i, term: ti.template(), total, times):
    """A sum with so many times the force of a term on pack i, where that acts."""
    found = total
    if ti.static(not has(term.acts)):
        found += times * term.law(spec, state, i)
    elif term.acts(state):
        found += times * term.law(spec, state, i)
    return found


@ti.func
def acceleration(spec: ti.template(), state: ti.template(), i, f):
    """The acceleration of pack i by the spring forces f and all that acts on single particles.

    The order of the sums is that of the reference trajectories: a pulled cloth amplifies round-off
    1e8 times in 600 frames. Forces that resist motion are added up among the accelerations.
    """
    w, v = read(spec, state.w, i), read(spec, state.v, i)
    none = 0.0 * v
    a, total = none, f
    for term in ti.static(terms_on_particles(spec, ACCELERATION)):
        a += term.law(spec, state, i)
    for term in ti.static(terms_on_particles(spec, FORCE, True)):
        a = plus_force(spec, state, i, term, a, w)
    for term in ti.static(terms_on_particles(spec, FORCE, False)):
        total = plus_force(spec, state, i, term, total, 1.0)
    if ti.static(has_tractions(spec)):
        total += read(spec, state.traction, i)
    return where_positive(w, a + w * total, none)


def _derivatives(spec, part):
    """The functions that give one part, "stiffness" or "damping", of the terms on particles."""
    found = [load(name) for name in spec.terms]
    on_particles = [term for term in found if term.adds in (ACCELERATION, FORCE)]
    return [getattr(term, part) for term in on_particles if has(getattr(term, part))]


def resists(spec):
    """True if any term on particles has damping."""
    return bool(_derivatives(spec, "damping"))


def binds(spec):
    """True if any term on particles has stiffness."""
    return bool(_derivatives(spec, "stiffness"))


@ti.func
def damping_of(spec: ti.template(), state: ti.template(), number: ti.template(), i):
    """The damping by all terms on particles, a number for each particle [force / velocity].

    i: a pack where `number` is `packs.read`, a slot where it is `packs.slot_number`.
    """
    return sum_of(
        [part(spec, state, number, i) for part in ti.static(_derivatives(spec, "damping"))]
    )


@ti.func
def stiffness_of(spec: ti.template(), state: ti.template(), number: ti.template(), i):
    """The stiffness by all terms on particles, a number for each particle [force / length].

    i: a pack where `number` is `packs.read`, a slot where it is `packs.slot_number`.
    """
    return sum_of(
        [part(spec, state, number, i) for part in ti.static(_derivatives(spec, "stiffness"))]
    )


@ti.func
def _accelerate_more(spec: ti.template(), state: ti.template(), slot, f):
    """Add the forces f of those springs that no grid holds to the acceleration of one particle."""
    w = slot_number(spec, state.w, slot)
    set_slot_value(spec, state.a, slot, slot_value(spec, state.a, slot) + w * f)
