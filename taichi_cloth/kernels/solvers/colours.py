"""Springs or particles by colour, so that all of one colour may change at once: springs that share
no particle, particles that share no spring.

On grids colours are known by place. Links of a kind have two, taking turns by as many rows as the
kind reaches down, or by columns where it stays in its row; particles as many as links reach columns
times rows, and one more each. A row of lanes takes turns in every lane alike, because strips are as
wide as `layout.spring_period` and `particle_period` say. What is on the graph has the colours that
the host gave it (`layout.spring_colours`, `particle_colours`), after those.

A sweep goes through all colours in this order, so it has the same bits for every number of threads.
"""

import functools

import taichi as ti

from taichi_cloth.kernels.loops import PIECE, barrier, each_row, share
from taichi_cloth.kernels.packs import (
    link_offset,
    of_kind,
    pitch_of,
    read,
    renew_left_halo,
    renew_right_halo,
    return_left_halo,
    return_right_halo,
    scaled,
    set_site_number,
    set_site_value,
    site_number,
    write,
)
from taichi_cloth.kernels.springs import link_stiffness


@ti.func
def colours_of_springs(plan: ti.template(), state: ti.template()):
    """How many colours there are."""
    if ti.static(plan.springs):
        return 2 * plan.kinds + state.n_colours[None]
    else:
        return 2 * plan.kinds


@ti.func
def each_spring(
    plan: ti.template(),
    state: ti.template(),
    t,
    colour,
    on_links: ti.template(),
    on_spring: ti.template(),
):
    """Visit the springs of a colour, of which each may change the velocities of its ends.

    on_links(plan, state, s, g, c, far, stiffness): those of kind s in grid g from cell c to far;
    the cell `stiffness` has the stiffness that is theirs. on_spring(plan, state, s): spring s on
    the graph. Where loops are spread, these are loops of the launch's top level.
    """
    if ti.static(plan.kinds > 0):
        s = ti.min(colour // 2, plan.kinds - 1)
        # Of a colour that is not one of links there are none: a parity that no row has.
        parity = ti.select(colour < 2 * plan.kinds, colour % 2, 2)
        if ti.static(plan.lanes == 1 and plan.spread):
            for c in range(state.n_cells[None]):
                _visit_cell(plan, state, c, s, parity, on_links)
        elif ti.static(plan.lanes == 1):
            count = state.n_cells[None]
            for c in range(share(plan, count, t), share(plan, count, t + 1)):
                _visit_cell(plan, state, c, s, parity, on_links)
        elif ti.static(plan.spread):
            for i in range(plan.threads * PIECE):
                if i % PIECE == 0:
                    _visit_rows(plan, state, i // PIECE, s, parity, on_links)
        else:
            _visit_rows(plan, state, t, s, parity, on_links)
    if ti.static(plan.springs):
        first, end = 0, 0
        if colour >= 2 * plan.kinds:
            first = state.colour_start[colour - 2 * plan.kinds]
            end = state.colour_start[colour - 2 * plan.kinds + 1]
        _each_from(plan, state, t, first, end, on_spring)
    barrier(plan, state)


@ti.func
def _each_from(plan: ti.template(), state: ti.template(), t, first, end, visit: ti.template()):
    if ti.static(plan.spread):
        for i in range(first, end):
            visit(plan, state, i)
    else:
        count = end - first
        for i in range(share(plan, count, t), share(plan, count, t + 1)):
            visit(plan, state, first + i)


@ti.func
def _visit_cell(plan: ti.template(), state: ti.template(), c, s, parity, visit: ti.template()):
    """The link of kind s that begins at cell c, where there is one and it has the colour.

    One that is absent must be left alone: what lies at its far end is another link's.
    """
    g = state.grid_of[c]
    if g >= 0:
        columns, down, pitch = state.link[s, 0], state.link[s, 1], pitch_of(plan, state, g)
        at = c - state.grid[g, 0]
        turn, period = at // pitch, down
        if down == 0:
            turn, period = at % pitch, columns
        if (turn & period) == parity * period and link_stiffness(plan, state, s, c) > 0.0:
            visit(plan, state, s, g, c, c + link_offset(state, s, pitch), c)


@ti.func
def _visit_rows(plan: ti.template(), state: ti.template(), t, s, parity, visit: ti.template()):
    """The links of kind s and of one colour that begin in thread t's share of rows.

    What is beyond a row's end is looked up and put back where the particles are, in the row's other
    end, so halos of the velocity need not be renewed.
    """
    columns, down = state.link[s, 0], state.link[s, 1]
    for g in range(state.n_grids[None]):
        first, rows, width = state.grid[g, 0], state.grid[g, 1], state.grid[g, 2]
        pitch = pitch_of(plan, state, g)
        linked = ti.select(state.grid[g, 3] == 1, rows - down, 0)
        end = ti.min(share(plan, rows, t + 1), linked)
        count, beyond = width, columns  # links in a row; how far they reach beyond it
        if down == 0:
            count, beyond = width // 2, ti.select(parity == 0, 0, columns)
        if parity == 2:
            count, beyond = 0, 0
        for r in range(share(plan, rows, t), end):
            if (r & down) == parity * down:
                row, far_row = first + r * pitch, first + (r + down) * pitch
                stiffness = row
                if ti.static(plan.alike):
                    if r < rows - plan.depth:
                        stiffness = first
                renew_right_halo(plan, state.v, far_row, width, beyond)
                renew_left_halo(plan, state.v, far_row, width, -beyond)
                for i in range(count):
                    p = i
                    if down == 0:
                        p = 2 * i - (i & (columns - 1)) + parity * columns
                    visit(plan, state, s, g, row + p, far_row + p + columns, stiffness + p)
                return_right_halo(plan, state.v, far_row, width, beyond)
                return_left_halo(plan, state.v, far_row, width, -beyond)


# --- particles -------------------------------------------------------------------------------


def turns(plan):
    """Colours of the particles on grids. In lanes a thread goes through those of a row by itself,
    so only rows take turns.
    """
    if plan.kinds == 0:
        return 0
    return (plan.depth + 1) * (plan.reach + 1 if plan.lanes == 1 else 1)


@ti.func
def colours_of_particles(plan: ti.template(), state: ti.template()):
    """How many colours there are."""
    if ti.static(plan.springs):
        return ti.static(turns(plan)) + state.n_colours[None]
    else:
        return ti.static(turns(plan))


@ti.func
def each_particle(
    plan: ti.template(),
    state: ti.template(),
    t,
    colour,
    of_cell: ti.template(),
    of_particle: ti.template(),
):
    """Set the velocities of the particles of a colour.

    To of_cell(plan, state, g, c) those of a cell of grid g; to of_particle(plan, state, p) that of
    the p-th particle that has springs on the graph.
    """
    if ti.static(plan.kinds > 0):
        if ti.static(plan.lanes == 1 and plan.spread):
            for c in range(state.n_cells[None]):
                _set_cell(plan, state, c, colour, of_cell)
        elif ti.static(plan.lanes == 1):
            count = state.n_cells[None]
            for c in range(share(plan, count, t), share(plan, count, t + 1)):
                _set_cell(plan, state, c, colour, of_cell)
        elif ti.static(plan.spread):
            for i in range(plan.threads * PIECE):
                if i % PIECE == 0:
                    _set_rows(plan, state, i // PIECE, colour, of_cell)
        else:
            _set_rows(plan, state, t, colour, of_cell)
    if ti.static(plan.springs):
        first, end = 0, 0
        if colour >= ti.static(turns(plan)):
            first = state.colour_start[colour - ti.static(turns(plan))]
            end = state.colour_start[colour - ti.static(turns(plan)) + 1]
        _each_from(plan, state, t, first, end, ti.static(_setting(of_particle)))
    barrier(plan, state)


@ti.func
def _set_cell(plan: ti.template(), state: ti.template(), c, colour, of_cell: ti.template()):
    g = state.grid_of[c]
    if g >= 0:
        at, pitch = c - state.grid[g, 0], pitch_of(plan, state, g)
        place = at % pitch % (plan.reach + 1)
        if colour == at // pitch % (plan.depth + 1) * (plan.reach + 1) + place:
            _set_own(plan, state, g, c, of_cell)


@ti.func
def _set_own(plan: ti.template(), state: ti.template(), g, c, of_cell: ti.template()):
    """Particles with springs on the graph are left alone: they have their own turn."""
    v = of_cell(plan, state, g, c)
    if ti.static(plan.springs):
        old_v = read(plan, state.v, c)
        v = old_v + scaled(read(plan, state.own, c), v - old_v)
    write(plan, state.v, c, v)


@ti.func
def _set_rows(plan: ti.template(), state: ti.template(), t, colour, of_cell: ti.template()):
    for g in range(state.n_grids[None]):
        first, width, pitch = state.grid[g, 0], state.grid[g, 2], pitch_of(plan, state, g)
        rows = ti.select(state.grid[g, 3] == 1, state.grid[g, 1], 0)
        for r in range(share(plan, rows, t), share(plan, rows, t + 1)):
            if r % (plan.depth + 1) == colour:
                row = first + r * pitch
                for place in range(plan.reach + 1):
                    for i in range(width // (plan.reach + 1)):
                        _set_own(plan, state, g, row + i * (plan.reach + 1) + place, of_cell)
                    renew_left_halo(plan, state.v, row, width, plan.halo)
                    renew_right_halo(plan, state.v, row, width, plan.halo)


@functools.cache
def _setting(of_particle):
    @ti.func
    def visit(plan: ti.template(), state: ti.template(), i):
        p = state.coloured[i]
        _set_particle(plan, state, state.near[p], of_particle(plan, state, p))

    return visit


@ti.func
def _set_particle(plan: ti.template(), state: ti.template(), site, v):
    """Velocity of one particle, and of its images in the halos of its row."""
    set_site_value(plan, state.v, site, v)
    if ti.static(plan.halo > 0):
        c, lane = site // plan.lanes, site % plan.lanes
        g = state.grid_of[c]
        if g >= 0:
            width = state.grid[g, 2]
            place = (c - state.grid[g, 0]) % pitch_of(plan, state, g)
            if place < plan.halo and lane > 0:
                set_site_value(plan, state.v, site + width * plan.lanes - 1, v)
            if place >= width - plan.halo and lane < plan.lanes - 1:
                set_site_value(plan, state.v, site - width * plan.lanes + 1, v)


@ti.func
def renew_both_halos(plan: ti.template(), state: ti.template(), t):
    """Before the sweeps of a step: what `each_particle` reads beside a row, on both sides.

    Positions, velocities, and the stiffness of links that begin there, which may have broken.
    Nothing where cells are single particles.
    """
    if ti.static(plan.halo > 0):
        each_row(plan, state, t, _renew_both_halos)


def _read_beside(plan, state):
    low = (state.x_low, state.goal_v) if plan.compensated else ()
    return (state.x, state.v, *low)


@ti.func
def _renew_both_halos(plan: ti.template(), state: ti.template(), begin, width):
    for of in ti.static(_read_beside(plan, state)):
        renew_left_halo(plan, of, begin, width, plan.halo)
        renew_right_halo(plan, of, begin, width, plan.halo)
    for s in range(plan.kinds):
        row = of_kind(state, s, begin)
        for h in range(plan.halo):
            for lane in range(plan.lanes - 1):
                to_right, to_left = row + width + h, row - 1 - h
                k = site_number(plan, state.link_k, (row + h) * plan.lanes + lane + 1)
                set_site_number(plan, state.link_k, to_right * plan.lanes + lane, k)
                k = site_number(plan, state.link_k, (row + width - 1 - h) * plan.lanes + lane)
                set_site_number(plan, state.link_k, to_left * plan.lanes + lane + 1, k)
