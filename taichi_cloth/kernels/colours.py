"""Springs by colour: those of one colour share no particle, so all of them may move theirs at once.

Links of grids are coloured by where they are: of each kind two colours, taking turns by as many
rows as the kind reaches down, or by columns where it stays in its row. A row of lanes takes turns
in every lane alike, because strips are as wide as `layout.spring_period` says. Springs on the graph
have the colours that the host gave them (`layout.spring_colours`), after those of the links.

A sweep goes through all colours in this order, so it has the same bits for every number of threads.
"""

import taichi as ti

from taichi_cloth.kernels.lanes import (
    link_offset,
    pitch_of,
    renew_left_halo,
    renew_right_halo,
    return_left_halo,
    return_right_halo,
)
from taichi_cloth.kernels.loops import PIECE, barrier, share
from taichi_cloth.kernels.springs import link_stiffness


@ti.func
def colour_count(plan: ti.template(), state: ti.template()):
    """How many colours there are."""
    if ti.static(plan.springs):
        return 2 * plan.kinds + state.n_colours[None]
    else:
        return 2 * plan.kinds


@ti.func
def each_of_colour(
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
        if ti.static(plan.spread):
            for i in range(first, end):
                on_spring(plan, state, i)
        else:
            count = end - first
            for i in range(share(plan, count, t), share(plan, count, t + 1)):
                on_spring(plan, state, first + i)
    barrier(plan, state)


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
