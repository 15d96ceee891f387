"""Contacts that end a step, alike for every method: obstacles, ground, what lies on each other.

A step leads to its free end (x, v), as if there were no contact. Then each part takes positions to
where they may be, and velocities to what contact and friction leave of them; a position gets
state.position_weight times dt of what a velocity is changed by, which is the weight that the
method's step gives a constant acceleration in its position (`methods.contract.Method`). So what
lies on something stays there, under every method: it neither sinks nor hovers nor trembles.

A part is a pair of functions in a file of its own: needed(spec), whether a scene has it, and the
ti.func settle(spec, state, t), which changes state.x and state.v (with the low parts of the
precision `compensated`) and renews halos, as `loops.each_pack_moving` does. Resting pairs, the last
part, have several such functions in place of one: acts(spec). Where the step began is in
state.begun_x and begun_v, with begun_x_low, if spec.keeps_begun says so.
"""

import functools

import taichi as ti

from taichi_cloth.kernels import (
    contact_account,
    faces,
    grips,
    obstruction,
    rest,
    resting_pairs,
    swept_pairs,
)
from taichi_cloth.kernels.copies import keep
from taichi_cloth.kernels.loops import each_pack

# (needed, settle), in the order in which they act; resting pairs come after them. Faces have
# obstacles settle particles, too, to see what comes of them.
PARTS = (
    (grips.needed, grips.settle),
    (rest.needed, rest.settle),
    (faces.needed, faces.settle),
    (lambda spec: obstruction.needed(spec) and not faces.needed(spec), obstruction.settle),
)


def settles(spec):
    """True if a specialization has any contact that ends a step."""
    return any(needed(spec) for needed, _ in PARTS) or resting_pairs.needed(spec)


def ends_step(spec):
    """True if anything is done here: a contact ends the step, or an account of them is kept."""
    return settles(spec) or spec.accounts_contacts


def acts_of(spec, state):
    """The parts of the end of a step, one after the other, as ti.funcs.

    Where pairs of cloth are swept, all of them are run until no round is to come
    (`goes_on`), and what is no part of a round in the first or in the last one alone.
    """
    acts, pairs, after = [] if in_launches(spec) else _acts_before_pairs(spec), [], []
    if resting_pairs.needed(spec):
        pairs = resting_pairs.acts(spec)
        after += [rest.hold] * rest.needed(spec)
    if spec.accounts_contacts:
        after.append(contact_account.close_step)
    if spec.keeps_begun:
        after.append(_keep_begun)
    if settles(spec) and state.begin:
        after.append(state.begin)
    if has_rounds(spec):
        acts, after = map(once_a_step, acts), map(once_a_step, after)
    return (*acts, *pairs, *after)


def has_rounds(spec):
    """True if what ends a step goes on in rounds."""
    return resting_pairs.needed(spec) and swept_pairs.is_swept(spec)


@ti.func
def goes_on(state: ti.template()):
    """True if a round of what ends a step is to come, as 1 or 0."""
    return ti.cast(state.pair_round[None] > 0, ti.i32)


@functools.cache
def once_a_step(act):
    """An act that rounds do not repeat: before the first one, or once none is to come."""

    @ti.func
    def once(spec: ti.template(), state: ti.template(), t):
        if state.pair_round[None] == 0:
            act(spec, state, t)

    return once


def _acts_before_pairs(spec):
    opened = [contact_account.open_step] * spec.accounts_contacts
    return opened + [settle for needed, settle in PARTS if needed(spec)]


def repeats(spec):
    """True if any of it goes on until it has settled."""
    return faces.needed(spec) or resting_pairs.needed(spec)


def in_launches(spec):
    """True if what ends a step takes several launches: what comes before pairs, these, their end.

    A launch cannot repeat loops that Taichi makes parallel.
    """
    return spec.one_launch_per_step and repeats(spec)


def launches_before_pairs(spec):
    """The parts before resting pairs, a launch each: ti.funcs, and phases of what repeats."""
    return [faces.PHASES if act is faces.settle else act for act in _acts_before_pairs(spec)]


@ti.func
def before_pairs(spec: ti.template(), state: ti.template(), t):
    """Do what comes before resting pairs in one launch, of blocks that stay."""
    for act in ti.static(_acts_before_pairs(spec)):
        act(spec, state, t)


@ti.func
def _keep_begun(spec: ti.template(), state: ti.template(), t):
    each_pack(spec, state, t, _keep_pack)


@ti.func
def _keep_pack(spec: ti.template(), state: ti.template(), i):
    keep(spec, state, i, "begun")


@ti.func
def settle(spec: ti.template(), state: ti.template(), t):
    """Take the free end of a step to what contacts leave of it.

    What the method keeps of forces from step to step is then computed anew.
    """
    if ti.static(has_rounds(spec)):
        going = 1
        while going == 1:
            _settle_round(spec, state, t)
            going = goes_on(state)
    else:
        _settle_round(spec, state, t)


@ti.func
def _settle_round(spec: ti.template(), state: ti.template(), t):
    for act in ti.static(acts_of(spec, state)):
        act(spec, state, t)
