"""Contacts that end a step, alike for every method: obstacles, ground, what lies on each other.

A step leads to its free end (x, v), as if there were no contact. Then each part takes positions to
where they may be, and velocities to what contact and friction leave of them; a position gets
state.position_weight times dt of what a velocity is changed by, which is the weight that the
method's step gives a constant acceleration in its position (`methods.contract.Method`). So what
lies on something stays there, under every method: it neither sinks nor hovers nor trembles.

A part is a pair of functions in a file of its own: needed(spec), whether a scene has it, and
acts(spec), a list of ti.funcs(spec, state, t) that come one after the other. They change state.x
and state.v (with the low parts of the precision `compensated`) and renew halos, as
`loops.each_pack_moving` does. Where the step began is in state.begun_x and begun_v, with
begun_x_low, if spec.keeps_begun says so.
"""

import taichi as ti

from taichi_cloth.kernels import contact_account, faces, grips, obstruction, resting_pairs
from taichi_cloth.kernels.copies import keep
from taichi_cloth.kernels.loops import each_pack

# (needed, acts), in the order in which they act
PARTS = (
    (grips.needed, grips.acts),
    (faces.needed, faces.acts),
    (obstruction.needed, obstruction.acts),
    (resting_pairs.needed, resting_pairs.acts),
)


def settles(spec):
    """Whether a specialization has any contact that ends a step."""
    return any(needed(spec) for needed, _ in PARTS)


def ends_step(spec):
    """Whether anything is done here: a contact ends the step, or an account of them is kept."""
    return settles(spec) or spec.accounts_contacts


def acts_of(spec, state):
    """What is run one after the other at the end of a step, as ti.funcs."""
    before, after = _acts_of_parts(spec)
    acts = after if in_launches(spec) else before + after
    if spec.keeps_begun:
        acts = [*acts, _keep_begun]
    begins = [state.begin] if settles(spec) and state.begin else []
    return (*acts, *begins)


def _acts_of_parts(spec):
    """The acts of contacts and of their account: up to the iterations of resting pairs, and on.

    Where there are no resting pairs, all are in the first list.
    """
    before, after = [], []
    if spec.accounts_contacts:
        before.append(contact_account.open_step)
    for needed, acts in PARTS:
        if needed(spec):
            (after if needed is resting_pairs.needed else before).extend(acts(spec))
    if spec.accounts_contacts:
        (after or before).append(contact_account.close_step)
    return before, after


def in_launches(spec):
    """Whether what ends a step takes several launches, of which `begin_settling` is the first."""
    return bool(spec.resting and spec.one_launch_per_step)


@ti.func
def begin_settling(spec: ti.template(), state: ti.template()):
    """Do what comes before the iterations of resting pairs, where those are launches."""
    for act in ti.static(_acts_of_parts(spec)[0]):
        act(spec, state, 0)
    resting_pairs.begin(spec, state, 0)


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
    for act in ti.static(acts_of(spec, state)):
        act(spec, state, t)
