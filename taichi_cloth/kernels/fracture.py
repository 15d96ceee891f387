"""Springs that break: over its break force a spring pulls for one more step, then it is gone.

The limit is compared as a squared length (force k*(l - rest) > limit means l > rest + limit/k), so
no root is taken and both ends of a spring share one decision.
"""

import taichi as ti

from taichi_cloth.kernels.loops import each, each_cell
from taichi_cloth.kernels.packs import (
    component,
    dot,
    largest,
    link_offset,
    of_kind,
    pitch_of,
    read,
    set_site_number,
    site_number,
    site_value,
)
from taichi_cloth.kernels.springs import link_stiffness, number
from taichi_cloth.kernels.state import ALIVE, BREAKING, GONE


@ti.func
def break_springs(plan: ti.template(), state: ti.template(), t):
    """End of a step: remove the springs that were breaking; mark those now over their limit."""
    if ti.static(plan.kinds > 0):
        each_cell(plan, state, t, _break_links)
    if ti.static(plan.springs):
        each(plan, state, t, state.n_springs[None], _break_spring)


# --- on a graph ------------------------------------------------------------------------------


@ti.func
def _break_spring(plan: ti.template(), state: ti.template(), s):
    if state.status[s] == BREAKING:
        state.status[s] = GONE
        for end in ti.static(range(2)):
            # A spring from a particle to itself pulls nowhere.
            state.far[state.half[s, end]] = state.ends[s, end]
    else:
        _mark_spring(plan, state, s)


@ti.func
def _mark_spring(plan: ti.template(), state: ti.template(), s):
    if state.status[s] == ALIVE:
        near, far = state.ends[s, 0], state.ends[s, 1]
        d = site_value(plan, state.x, far) - site_value(plan, state.x, near)
        if d.dot(d) > number(plan, state.break_length2, s):
            state.status[s] = BREAKING
            state.break_step[s] = state.step[None]


# --- on grids --------------------------------------------------------------------------------


@ti.func
def _break_links(plan: ti.template(), state: ti.template(), c):
    """One test for a whole cell: in most none breaks, and that is all they pay."""
    g = state.grid_of[c]
    if g >= 0:
        x = read(plan, state.x, c)
        none = -1.0 + 0.0 * component(x, 0)
        most = none
        for s in range(plan.kinds):
            far = c + link_offset(state, s, pitch_of(plan, state, g))
            d = read(plan, state.x, far) - x
            excess = dot(d, d) - state.link_limit2[s, g]
            k = link_stiffness(plan, state, s, c)
            most = ti.max(most, ti.select(k > 0.0, excess, none))
        if largest(plan, most) > 0.0 or state.breaking[c] > 0:
            for lane in range(plan.lanes):
                for s in range(plan.kinds):
                    link = of_kind(state, s, c) * plan.lanes + lane
                    if site_number(plan, state.link_status, link) == BREAKING:
                        set_site_number(plan, state.link_status, link, GONE)
                        set_site_number(plan, state.link_k, link, 0.0)
                        state.breaking[c] -= 1
                    else:
                        _mark_link(plan, state, s, g, c, lane)


@ti.func
def _mark_link(plan: ti.template(), state: ti.template(), s, g, c, lane):
    site, link = c * plan.lanes + lane, of_kind(state, s, c) * plan.lanes + lane
    alive = site_number(plan, state.link_status, link) == ALIVE
    if alive and site_number(plan, state.link_k, link) > 0.0:
        far = site + link_offset(state, s, pitch_of(plan, state, g)) * plan.lanes
        d = site_value(plan, state.x, far) - site_value(plan, state.x, site)
        if d.dot(d) > state.link_limit2[s, g]:
            set_site_number(plan, state.link_status, link, BREAKING)
            set_site_number(plan, state.link_step, link, state.step[None])
            state.breaking[c] += 1


@ti.func
def _mark_links(plan: ti.template(), state: ti.template(), c):
    g = state.grid_of[c]
    if g >= 0:
        for lane in range(plan.lanes):
            for s in range(plan.kinds):
                _mark_link(plan, state, s, g, c, lane)


@ti.kernel
def mark_new_springs(plan: ti.template(), state: ti.template()):
    """Outside of steps: springs that are over their limit from the start pull once and are gone."""
    if ti.static(plan.kinds > 0):
        each_cell(plan, state, 0, _mark_links)
    if ti.static(plan.springs):
        each(plan, state, 0, state.n_springs[None], _mark_spring)
