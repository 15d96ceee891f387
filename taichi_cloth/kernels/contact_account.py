"""The account of contacts: the energy that they give, and the step of the first one.

Studies ask for it; a run that does not has none of this compiled. A contact's work in a step is
what it changes of kinetic and potential energy: what ends the step (`settling.py`) from the free
end on, what walls hold as it is reached, and the impulses of walls and pairs (`contact.py`) at the
step's start. A step counts where the sum over all particles is positive: what contacts take
elsewhere in that step is set against it, and what moving obstacles do is in it.

Methods whose positions are ahead of a constant acceleration's, or behind (state.position_weight),
lose energy in the free part of a step and have it back from a contact that holds against that
acceleration. This is no gain, and is left out: m (weight - 1/2) times what the contact takes of the
square of the change of velocity in the free part.

The elastic energy between two positions is the work of the springs' and stencils' forces along the
way, by Simpson's rule: exact for what is linear, and no rounding of a large sum.
"""

import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.compensated import difference
from taichi_cloth.kernels.contact import has_impulses, velocity_jump
from taichi_cloth.kernels.copies import keep
from taichi_cloth.kernels.forces import load
from taichi_cloth.kernels.forces.contract import ACCELERATION, has
from taichi_cloth.kernels.loops import add_up, each, each_pack, each_pack_moving
from taichi_cloth.kernels.packs import (
    dot,
    largest,
    read,
    set_slot_number,
    slot_number,
    slot_value,
    where_positive,
    write,
    zeros,
)
from taichi_cloth.kernels.springs import accumulate, pull

NEVER = 2147483647
TINY = 1e-30  # no inverse mass
PARTS = 3  # of the way along which forces are looked at: its ends and its middle


def is_elastic(spec):
    """True if a specialization has springs or stencils."""
    return bool(spec.springs or spec.kinds or spec.stencils or spec.line_kinds)


@ti.func
def open_step(spec: ti.template(), state: ti.template(), t):
    """Keep the free end of a step, before contacts end it."""
    if state.accounting[None] == 1:
        if t == 0:
            state.touched[None] = 0
        each_pack(spec, state, t, _keep_free)


@ti.func
def _keep_free(spec: ti.template(), state: ti.template(), i):
    keep(spec, state, i, "free")
    if ti.static(len(spec.walls) > 0):  # as if they had held nothing
        for free, held in ti.static(((state.free_x, state.held_x), (state.free_v, state.held_v))):
            change = read(spec, held, i)
            write(spec, free, i, read(spec, free, i) - change)
            write(spec, held, i, 0.0 * change)


@ti.func
def close_step(spec: ti.template(), state: ti.template(), t):
    """Book what contacts did in a step that they have ended."""
    if state.accounting[None] == 1:
        each_pack(spec, state, t, _work_on_particles)
        if state.touched[None] == 1:
            if ti.static(is_elastic(spec)):
                for part in range(PARTS):
                    state.account_part[None] = part  # every thread writes the same
                    each_pack_moving(spec, state, t, _go_along)
                    accumulate(
                        spec, state, t, _pull_between, difference, _add_work, _add_work_of_slot
                    )
                each_pack_moving(spec, state, t, _put_back)
            add_up(spec, state, t, _work_of, ti.static(state.sums.shape[0] - 1))
            each(spec, state, t, 1, _book)
        each_pack(spec, state, t, _keep_start)


@ti.func
def _jump(spec: ti.template(), state: ti.template(), i):
    """The changes by walls and pairs of pack i's velocities at the step's start."""
    if ti.static(has_impulses(spec)):
        x, v = read(spec, state.opened_x, i), read(spec, state.opened_v, i)
        return velocity_jump(spec, state, i, x, v)
    else:
        return zeros(spec, state)


@ti.func
def _work_on_particles(spec: ti.template(), state: ti.template(), i):
    """Compute the contacts' work on pack i but for elastic energy; note whether it was touched."""
    x, v, w = read(spec, state.x, i), read(spec, state.v, i), read(spec, state.w, i)
    free_v, start_v = read(spec, state.free_v, i), read(spec, state.opened_v, i)
    dx, dv, jump = x - read(spec, state.free_x, i), v - free_v, _jump(spec, state, i)
    free = where_positive(w, 0.0 * dx + 1.0, zeros(spec, state))
    dx, dv, jump = dx * free, dv * free, jump * free
    work = 0.5 * dot(dv, v + free_v) + dot(jump, start_v + 0.5 * jump)
    for term in ti.static(_uniform_fields(spec)):
        work = work - dot(term.law(spec, state, i), dx)
    fell = (free_v - start_v) * free - jump
    held = ti.min(ti.max(dot(fell, dv), -1.0 * dot(fell, fell)), 0.0 * w)
    work = work + (ti.static(state.position_weight) - 0.5) * held
    write(spec, state.contact_work, i, ti.select(w > 0.0, work / ti.max(w, TINY), 0.0 * w))
    write(spec, state.ended_x, i, x)
    if largest(spec, dot(dx, dx) + dot(dv, dv) + dot(jump, jump)) > 0.0:
        state.touched[None] = 1
        if state.first_touch[None] > state.step[None]:
            state.first_touch[None] = state.step[None]


def _uniform_fields(spec):
    """The terms that give every particle the same acceleration everywhere, and have an energy."""
    terms = [load(name) for name in spec.terms]
    return [term for term in terms if term.adds == ACCELERATION and has(term.energy)]


@ti.func
def _pull_between(
    spec: ti.template(), state: ti.template(), value: ti.template(), i, j, numbers: ti.template()
):
    """The force on i of the spring to j, without its dashpot: for `springs.accumulate`."""
    d = difference(spec, state, value, i, j)
    _, along, tension = pull(spec, d, 0.0 * d, numbers)
    return tension * along


@ti.func
def _go_along(spec: ti.template(), state: ti.template(), i):
    """Put pack i at a part of the way from the free end."""
    begin, part = read(spec, state.free_x, i), 0.5 * state.account_part[None]
    write(spec, state.x, i, begin + part * (read(spec, state.ended_x, i) - begin))


@ti.func
def _put_back(spec: ti.template(), state: ti.template(), i):
    write(spec, state.x, i, read(spec, state.ended_x, i))


@ti.func
def _weight(state: ti.template()):
    """The weight of a part of the way by Simpson's rule, negated: forces take what they do."""
    return ti.select(state.account_part[None] == 1, -4.0 / 6.0, -1.0 / 6.0)


@ti.func
def _add_work(spec: ti.template(), state: ti.template(), i, f):
    """Add the elastic energy of pack i, by the forces f on it."""
    dx = read(spec, state.ended_x, i) - read(spec, state.free_x, i)
    work = _weight(state) * dot(f, dx)
    none = 0.0 * work
    work = ti.select(read(spec, state.w, i) > 0.0, work, none)
    write(spec, state.contact_work, i, read(spec, state.contact_work, i) + work)


@ti.func
def _add_work_of_slot(spec: ti.template(), state: ti.template(), slot, f):
    """Add that of a particle's springs and stencils that no grid holds."""
    dx = slot_value(spec, state.ended_x, slot) - slot_value(spec, state.free_x, slot)
    if slot_number(spec, state.w, slot) > 0.0:
        work = slot_number(spec, state.contact_work, slot) + _weight(state) * f.dot(dx)
        set_slot_number(spec, state.contact_work, slot, work)


@ti.func
def _work_of(spec: ti.template(), state: ti.template(), i):
    return read(spec, state.contact_work, i)


@ti.func
def _book(spec: ti.template(), state: ti.template(), i):
    """Add a step's work to that of the run, and if it is positive, to what was given."""
    work = ti.cast(state.sums[ti.static(state.sums.shape[0] - 1), 0], state.wide)
    # += would be atomic.
    given = ti.max(work, ti.cast(0.0, state.wide))
    state.contact_energy[None] = state.contact_energy[None] + given
    state.contact_balance[None] = state.contact_balance[None] + work


@ti.func
def _keep_start(spec: ti.template(), state: ti.template(), i):
    """Keep where the next step begins."""
    keep(spec, state, i, "opened")


@kernel
def begin_account(spec: ti.template(), state: ti.template()):
    """Begin an account with the next step."""
    state.accounting[None], state.first_touch[None] = 1, NEVER
    state.contact_energy[None] = ti.cast(0.0, state.wide)
    state.contact_balance[None] = ti.cast(0.0, state.wide)
    each_pack(spec, state, 0, _keep_start)
