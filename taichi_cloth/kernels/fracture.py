"""Springs that break: over its break force a spring acts for one more step, then it is gone.

The magnitude of the force k*(l - rest) exceeds the break force where the spring is longer than
rest + break_force/k, or shorter than rest - break_force/k; a dashpot's force does not count.
Lengths are compared squared, so that no root is taken, and once for each spring, so that its ends
agree. With a spring those stencils go (`stencils.py`) that need it.
"""

import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels.graph import number
from taichi_cloth.kernels.grids import link_index, link_offset, pitch_of
from taichi_cloth.kernels.links import link_stiffness
from taichi_cloth.kernels.loops import each, each_pack, each_row
from taichi_cloth.kernels.packs import (
    component,
    dot,
    largest,
    read,
    set_slot_number,
    slot_number,
    slot_value,
)
from taichi_cloth.kernels.spring_numbers import stored_fields
from taichi_cloth.kernels.state import ALIVE, BREAKING, GONE
from taichi_cloth.kernels.stencils import line_step


@ti.func
def break_springs(spec: ti.template(), state: ti.template(), t):
    """Remove the springs that were breaking, and mark those that are over their limit now.

    It comes at the end of a step.
    """
    if ti.static(spec.kinds > 0):
        if ti.static(spec.lanes == 1):
            each_pack(spec, state, t, _break_links_of_pack)
        else:
            each_row(spec, state, t, _break_links_of_row)
    if ti.static(spec.springs):
        each(spec, state, t, state.n_springs[None], _break_spring)
    if ti.static(spec.stencils):
        each(spec, state, t, state.n_stencils[None], _break_stencil)


@ti.func
def is_beyond(length2, shortest2, longest2):
    """True if a spring of this length is over its limit: squares of lengths, as in `State`."""
    return length2 > longest2 or length2 < shortest2


# --- on a graph ------------------------------------------------------------------------------


@ti.func
def _break_spring(spec: ti.template(), state: ti.template(), s):
    """Remove spring s on the graph if it was breaking, else mark it if it is over its limit."""
    if state.status[s] == BREAKING:
        _remove_spring(spec, state, s)
    else:
        _mark_spring(spec, state, s)


@ti.func
def _remove_spring(spec: ti.template(), state: ti.template(), s):
    """Let spring s on the graph be gone."""
    state.status[s] = GONE
    for end in ti.static(range(2)):
        # A spring from a particle to itself pulls nowhere.
        if ti.static(spec.packed_rows):
            for _, field in ti.static(stored_fields(spec, state, "csr")):
                field[state.half[s, end]] = 0.0
        else:
            state.csr_other[state.half[s, end]] = state.ends[s, end]


@ti.func
def _mark_spring(spec: ti.template(), state: ti.template(), s):
    """Mark spring s on the graph as breaking if it is longer or shorter than it holds at."""
    if state.status[s] == ALIVE:
        near, far = state.ends[s, 0], state.ends[s, 1]
        d = slot_value(spec, state.x, far) - slot_value(spec, state.x, near)
        if is_beyond(d.dot(d), number(spec, state.shortest2, s), number(spec, state.longest2, s)):
            state.status[s] = BREAKING
            state.break_step[s] = state.step[None]


@ti.func
def _break_stencil(spec: ti.template(), state: ti.template(), m):
    """Remove the listed stencil m if a spring that it needs is gone."""
    for e in range(state.side_start[m], state.side_start[m + 1]):
        if _is_gone(spec, state, state.side[e]):
            state.stencil_k[m] = 0.0


@ti.func
def _is_gone(spec: ti.template(), state: ti.template(), side):
    """True if a spring is gone: number `side` on the graph, or, if negative, link -1 - side."""
    status = ALIVE
    if side >= 0:
        status = state.status[side]
    elif ti.static(spec.kinds > 0):
        status = slot_number(spec, state.link_status, -1 - side)
    return status == GONE


# --- on grids --------------------------------------------------------------------------------


@ti.func
def _break_links_of_pack(spec: ti.template(), state: ti.template(), i):
    """Run `_break_links_of_row` for pack i alone."""
    _break_links_of_row(spec, state, i, 1)


@ti.func
def _break_links_of_row(spec: ti.template(), state: ti.template(), begin, width):
    """Remove or mark the links that begin in a row of packs, as `_break_spring` does for a spring.

    What the row's links share is read before its packs, because no compiler does so: this loop is
    short, and would spend much of its time on it.
    """
    g = state.grid_of[begin]
    if g >= 0:
        pitch = pitch_of(spec, state, g)
        to_far = ti.Vector([link_offset(state, s, pitch) for s in range(spec.kinds)])
        shortest2 = ti.Vector([state.link_shortest2[s, g] for s in range(spec.kinds)])
        longest2 = ti.Vector([state.link_longest2[s, g] for s in range(spec.kinds)])
        for i in range(begin, begin + width):
            x = read(spec, state.x, i)
            # Most packs pay no more than this one test, which reads no stiffness: also where there
            # is no link it asks for the lengths.
            excesses = [
                _excess(read(spec, state.x, i + to_far[s]) - x, shortest2[s], longest2[s])
                for s in range(spec.kinds)
            ]
            most = 0.0 * component(x, 0)
            for s in ti.static(range(spec.kinds)):
                most = ti.max(most, excesses[s])
            if largest(spec, most) > 0.0 or state.breaking[i] > 0:
                # A link that is there has a stiffness: the lesser is positive where both are.
                there = 0.0 * component(x, 0)
                for s in ti.static(range(spec.kinds)):
                    there = ti.max(there, ti.min(excesses[s], link_stiffness(spec, state, s, i)))
                if largest(spec, there) > 0.0 or state.breaking[i] > 0:
                    _break_links(spec, state, g, i)


@ti.func
def _excess(d, shortest2, longest2):
    """Positive where links that reach to d are over their limit, as `is_beyond` says of one."""
    d2 = dot(d, d)
    return ti.max(d2 - longest2, shortest2 - d2)


@ti.func
def _break_links(spec: ti.template(), state: ti.template(), g, i):
    """Remove the links that begin at pack i and were breaking; mark those over their limit now."""
    for lane in range(spec.lanes):
        for s in range(spec.kinds):
            link = link_index(state, s, i) * spec.lanes + lane
            if slot_number(spec, state.link_status, link) == BREAKING:
                state.breaking[i] -= 1
                _remove_link(spec, state, s, g, i, lane)
            else:
                _mark_link(spec, state, s, g, i, lane)


@ti.func
def _remove_link(spec: ti.template(), state: ti.template(), s, g, i, lane):
    """Let the link of kind s in one lane of pack i be gone, and what needs it."""
    link = link_index(state, s, i) * spec.lanes + lane
    set_slot_number(spec, state.link_status, link, GONE)
    set_slot_number(spec, state.link_k, link, 0.0)
    if ti.static(spec.line_kinds > 0):
        _break_lines(spec, state, s, g, i, lane)


@ti.func
def _break_lines(spec: ti.template(), state: ti.template(), s, g, i, lane):
    """Remove the stencils along lines that have the link of kind s from one lane of pack i."""
    slot, pitch = i * spec.lanes + lane, pitch_of(spec, state, g)
    for h in range(spec.line_kinds):
        if state.line[h, 0] == state.link[s, 0] and state.line[h, 1] == state.link[s, 1]:
            before = slot - line_step(state, h, pitch) * spec.lanes
            there = True
            if ti.static(spec.lanes > 1):
                width = state.grid[g, 2]
                if state.line[h, 0] == 1 and (i - state.grid[g, 0]) % pitch == 0:
                    # The column before a strip's first one is the last one of the strip before.
                    before = slot + (width - 1) * spec.lanes - 1
                    there = lane > 0
            at = link_index(state, h, 0) * spec.lanes
            set_slot_number(spec, state.line_k, at + slot, 0.0)
            if there:
                set_slot_number(spec, state.line_k, at + before, 0.0)


@ti.func
def _mark_link(spec: ti.template(), state: ti.template(), s, g, i, lane):
    """Mark the link of kind s in one lane of pack i as `_mark_spring` does a spring."""
    slot, link = i * spec.lanes + lane, link_index(state, s, i) * spec.lanes + lane
    alive = slot_number(spec, state.link_status, link) == ALIVE
    if alive and slot_number(spec, state.link_k, link) > 0.0:
        far = slot + link_offset(state, s, pitch_of(spec, state, g)) * spec.lanes
        d = slot_value(spec, state.x, far) - slot_value(spec, state.x, slot)
        if is_beyond(d.dot(d), state.link_shortest2[s, g], state.link_longest2[s, g]):
            set_slot_number(spec, state.link_status, link, BREAKING)
            set_slot_number(spec, state.link_step, link, state.step[None])
            state.breaking[i] += 1


@ti.func
def _mark_links(spec: ti.template(), state: ti.template(), i):
    """Mark the links that begin at pack i and are over their limit."""
    g = state.grid_of[i]
    if g >= 0:
        for lane in range(spec.lanes):
            for s in range(spec.kinds):
                _mark_link(spec, state, s, g, i, lane)


@kernel
def mark_new_springs(spec: ti.template(), state: ti.template(), step: ti.i32):
    """Mark the springs that are over their limit after step number `step`, outside of any: they
    break in the next one.
    """
    state.step[None] = step
    if ti.static(spec.kinds > 0):
        each_pack(spec, state, 0, _mark_links)
    if ti.static(spec.springs):
        each(spec, state, 0, state.n_springs[None], _mark_spring)


@kernel
def cut_springs(
    spec: ti.template(),
    state: ti.template(),
    springs: ti.types.ndarray(),
    links: ti.types.ndarray(),
    n_springs: ti.i32,
    n_links: ti.i32,
    step: ti.i32,
):
    """Let springs be gone at once, as if they had broken in step number `step`.

    springs: (n_springs,) or longer, their numbers on the graph; links: (n_links, 2) or longer, kind
    and slot of the earlier end. Those that are gone already stay as they are.
    """
    for _ in range(1):  # one after the other: several may be in one pack
        if ti.static(spec.springs):
            for m in range(n_springs):
                if state.status[springs[m]] != GONE:
                    state.break_step[springs[m]] = step
                    _remove_spring(spec, state, springs[m])
        if ti.static(spec.kinds > 0):
            for m in range(n_links):
                s, i, lane = links[m, 0], links[m, 1] // spec.lanes, links[m, 1] % spec.lanes
                link = link_index(state, s, i) * spec.lanes + lane
                status = slot_number(spec, state.link_status, link)
                if status != GONE:
                    if status == BREAKING:
                        state.breaking[i] -= 1
                    set_slot_number(spec, state.link_step, link, step)
                    _remove_link(spec, state, s, state.grid_of[i], i, lane)
    if ti.static(spec.stencils):
        each(spec, state, 0, state.n_stencils[None], _break_stencil)
