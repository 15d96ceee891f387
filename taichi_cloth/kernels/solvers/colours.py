"""Loops over the springs or particles of one colour, all of which may change at once.

Springs of one colour share no particle, particles of one colour share no spring. On grids colours
are known by place:

- Links of a kind have two colours, which take turns by as many rows as the kind reaches down, or by
  as many columns as it reaches where it stays in its row.
- Particles have (columns + 1)*(rows + 1) colours, where links reach that many columns and rows; but
  on packs of several lanes rows + 1, because a thread goes through a row by itself.

In a row of packs all lanes of a pack have the same colour, because strips are as wide as
`spring_period` and `particle_period` of `simulation.storage.layouts` say. After these colours come
those of the graph, which the host assigns (`spring_colours` and `particle_colours` there).

A sweep goes through all colours in this order, so it has the same bits for every number of threads.
"""

import functools

import taichi as ti

from taichi_cloth.kernels.grids import (
    link_index,
    link_offset,
    pitch_of,
    renew_left_halo,
    renew_number,
    renew_right_halo,
    return_left_halo,
    return_right_halo,
)
from taichi_cloth.kernels.links import link_stiffness
from taichi_cloth.kernels.loops import PIECE, barrier, each_row, share
from taichi_cloth.kernels.packs import (
    read,
    set_slot_value,
    slot_number,
    write,
)
from taichi_cloth.kernels.spring_numbers import own_numbers
from taichi_cloth.kernels.stencils import line_step


@ti.func
def colours_of_springs(spec: ti.template(), state: ti.template()):
    """The number of colours of springs."""
    if ti.static(spec.springs):
        return 2 * spec.kinds + state.n_colours[None]
    else:
        return 2 * spec.kinds


@ti.func
def each_spring(
    spec: ti.template(),
    state: ti.template(),
    t,
    colour,
    on_links: ti.template(),
    on_spring: ti.template(),
):
    """Visit the springs of a colour, each of which may change the velocities of its ends.

    on_links(spec, state, s, g, i, far, stiffness): visits the links of kind s in grid g from pack i
        to the later pack `far`; the pack `stiffness` has links with the stiffness that is theirs.
    on_spring(spec, state, s): visits spring s on the graph.
    """
    if ti.static(spec.kinds > 0):
        s = ti.min(colour // 2, spec.kinds - 1)
        # A colour of the graph has no links: it gets a parity that no row has.
        parity = ti.select(colour < 2 * spec.kinds, colour % 2, 2)
        _visit_grids(spec, state, t, s, parity, _visit_pack, _visit_rows, on_links)
    if ti.static(spec.springs):
        first, end = 0, 0
        there = colour >= 2 * spec.kinds
        if ti.static(spec.line_kinds > 0 or spec.stencils):  # whose colours come after these
            there = there and colour < colours_of_springs(spec, state)
        if there:
            first = state.colour_start[colour - 2 * spec.kinds]
            end = state.colour_start[colour - 2 * spec.kinds + 1]
        _each_from(spec, state, t, first, end, on_spring)
    barrier(spec, state, t)


@ti.func
def _visit_grids(
    spec: ti.template(),
    state: ti.template(),
    t,
    kind,
    turn,
    of_pack: ti.template(),
    of_rows: ti.template(),
    visit: ti.template(),
):
    """Visit what has a turn on all grids: links, or stencils along lines, of a kind, or particles.

    of_pack(spec, state, i, kind, turn, visit): visits what begins at pack i, where packs have one
        lane; of_rows(spec, state, t, kind, turn, visit): what begins in thread t's share of rows.
    """
    if ti.static(spec.lanes == 1 and spec.one_launch_per_step):
        for c in range(state.n_packs[None]):
            of_pack(spec, state, c, kind, turn, visit)
    elif ti.static(spec.lanes == 1):
        count = state.n_packs[None]
        for c in range(share(spec, count, t), share(spec, count, t + 1)):
            of_pack(spec, state, c, kind, turn, visit)
    elif ti.static(spec.one_launch_per_step):
        for i in range(spec.threads * PIECE):
            if i % PIECE == 0:
                of_rows(spec, state, i // PIECE, kind, turn, visit)
    else:
        of_rows(spec, state, t, kind, turn, visit)


@ti.func
def _each_from(spec: ti.template(), state: ti.template(), t, first, end, visit: ti.template()):
    """Run visit(spec, state, i) for every i from `first` to below `end`, without a barrier."""
    if ti.static(spec.one_launch_per_step):
        for i in range(first, end):
            visit(spec, state, i)
    else:
        count = end - first
        for i in range(share(spec, count, t), share(spec, count, t + 1)):
            visit(spec, state, first + i)


@ti.func
def _visit_pack(spec: ti.template(), state: ti.template(), i, s, parity, visit: ti.template()):
    """Visit the link of kind s that begins at pack i, if there is one and it has the colour.

    An absent one must be left alone: another link of the colour may end where it would end.
    """
    g = state.grid_of[i]
    if g >= 0:
        columns, down, pitch = state.link[s, 0], state.link[s, 1], pitch_of(spec, state, g)
        at = i - state.grid[g, 0]
        turn, period = at // pitch, down
        if down == 0:
            turn, period = at % pitch, columns
        if (turn & period) == parity * period and link_stiffness(spec, state, s, i) > 0.0:
            visit(spec, state, s, g, i, i + link_offset(state, s, pitch), i)


@ti.func
def _visit_rows(spec: ti.template(), state: ti.template(), t, s, parity, visit: ti.template()):
    """Visit the links of kind s and of one colour that begin in thread t's share of rows.

    parity: 0 or 1, which of the kind's two colours; 2: none. Velocities that links change in the
    halos of a row are copied there before, from the row's other end, and back to it afterwards, so
    no other halos of the velocity need to be renewed.
    """
    columns, down = state.link[s, 0], state.link[s, 1]
    for g in range(state.n_grids[None]):
        first, rows, width = state.grid[g, 0], state.grid[g, 1], state.grid[g, 2]
        pitch = pitch_of(spec, state, g)
        linked = ti.select(state.grid[g, 3] == 1, rows - down, 0)
        end = ti.min(share(spec, rows, t + 1), linked)
        count, beyond = width, columns  # links in a row; how far they reach beyond it
        if down == 0:
            count, beyond = width // 2, ti.select(parity == 0, 0, columns)
        if parity == 2:
            count, beyond = 0, 0
        for r in range(share(spec, rows, t), end):
            if (r & down) == parity * down:
                row, far_row = first + r * pitch, first + (r + down) * pitch
                stiffness = row
                if ti.static(spec.rows_share_stiffness):
                    if r < rows - spec.depth:
                        stiffness = first
                renew_right_halo(spec, state.v, far_row, width, beyond)
                renew_left_halo(spec, state.v, far_row, width, -beyond)
                for i in range(count):
                    p = i
                    if down == 0:
                        p = 2 * i - (i & (columns - 1)) + parity * columns
                    visit(spec, state, s, g, row + p, far_row + p + columns, stiffness + p)
                return_right_halo(spec, state.v, far_row, width, beyond)
                return_left_halo(spec, state.v, far_row, width, -beyond)


# --- stencils --------------------------------------------------------------------------------


def colours_of_lines(spec):
    """The number of colours of stencils along lines: those of a kind take turns by three."""
    return 3 * spec.line_kinds


@ti.func
def colours_of_stencils(spec: ti.template(), state: ti.template()):
    """The number of colours of stencils."""
    if ti.static(spec.stencils):
        return ti.static(colours_of_lines(spec)) + state.n_stencil_colours[None]
    else:
        return ti.static(colours_of_lines(spec))


@ti.func
def each_stencil(
    spec: ti.template(),
    state: ti.template(),
    t,
    colour,
    on_lines: ti.template(),
    on_stencil: ti.template(),
):
    """Visit the stencils of a colour, if it is one, each of which may change its particles' motion.

    on_lines(spec, state, h, i, step): visits those of kind h that begin at pack i.
    on_stencil(spec, state, m): visits the listed stencil m.
    """
    if ti.static(spec.line_kinds > 0):
        h = ti.min(ti.max(colour, 0) // 3, spec.line_kinds - 1)
        # Another colour gets a turn that no row has.
        inside = colour >= 0 and colour < 3 * spec.line_kinds
        turn = ti.select(inside, colour - 3 * h, 3)
        _visit_grids(spec, state, t, h, turn, _visit_line, _visit_rows_of_lines, on_lines)
    if ti.static(spec.stencils):
        first, end = 0, 0
        lines = ti.static(colours_of_lines(spec))
        if colour >= lines:
            first = state.stencil_colour[colour - lines]
            end = state.stencil_colour[colour - lines + 1]
        _each_from(spec, state, t, first, end, on_stencil)
    barrier(spec, state, t)


@ti.func
def _visit_line(spec: ti.template(), state: ti.template(), i, h, turn, visit: ti.template()):
    """Visit the stencil of kind h that begins at pack i, if there is one and it has the turn."""
    g = state.grid_of[i]
    if g >= 0:
        pitch, at = pitch_of(spec, state, g), i - state.grid[g, 0]
        place = ti.select(state.line[h, 1] > 0, at // pitch, at % pitch)
        k = slot_number(spec, state.line_k, link_index(state, h, i))
        if place % 3 == turn and k > 0.0:
            visit(spec, state, h, i, line_step(state, h, pitch))


@ti.func
def _visit_rows_of_lines(
    spec: ti.template(), state: ti.template(), t, h, turn, visit: ti.template()
):
    """Visit the stencils of kind h and one turn that begin in thread t's share of rows.

    Halos are copied as in `_visit_rows`: of a turn, the last stencil in a row of a strip reaches as
    many packs beyond it as the turn's number.
    """
    down = state.line[h, 1]
    for g in range(state.n_grids[None]):
        first, rows, width = state.grid[g, 0], state.grid[g, 1], state.grid[g, 2]
        pitch = pitch_of(spec, state, g)
        linked = ti.select(state.grid[g, 3] == 1 and turn < 3, rows - 2 * down, 0)
        begin, every, beyond = ti.select(down == 0, turn, 0), ti.select(down == 0, 3, 1), 0
        if down == 0:
            beyond = turn
        for r in range(share(spec, rows, t), ti.min(share(spec, rows, t + 1), linked)):
            if down == 0 or r % 3 == turn:
                row = first + r * pitch
                renew_right_halo(spec, state.v, row, width, beyond)
                for i in range(width // every):
                    at = row + begin + i * every
                    visit(spec, state, h, at, line_step(state, h, pitch))
                return_right_halo(spec, state.v, row, width, beyond)


# --- particles -------------------------------------------------------------------------------


def turns(spec):
    """The number of colours of particles on grids.

    With several lanes only rows have different ones, because a thread goes through the packs of a
    row one after the other.
    """
    if spec.kinds == 0:
        return 0
    return (spec.depth + 1) * (spec.reach + 1 if spec.lanes == 1 else 1)


@ti.func
def colours_of_particles(spec: ti.template(), state: ti.template()):
    """The number of colours of particles."""
    if ti.static(spec.springs):
        return ti.static(turns(spec)) + state.n_colours[None]
    else:
        return ti.static(turns(spec))


@ti.func
def each_particle(
    spec: ti.template(),
    state: ti.template(),
    t,
    colour,
    on_pack: ti.template(),
    on_particle: ti.template(),
):
    """Set the velocities of the particles of a colour.

    on_pack(spec, state, g, i): gives the new velocities of pack i of grid g.
    on_particle(spec, state, p): gives that of the particle of row p of the compressed rows, which
        is one with springs on the graph.
    """
    if ti.static(spec.kinds > 0):
        _visit_grids(spec, state, t, 0, colour, _set_pack, _set_rows, on_pack)
    if ti.static(spec.springs):
        first, end = 0, 0
        if colour >= ti.static(turns(spec)):
            first = state.colour_start[colour - ti.static(turns(spec))]
            end = state.colour_start[colour - ti.static(turns(spec)) + 1]
        _each_from(spec, state, t, first, end, ti.static(_setting(on_particle)))
    barrier(spec, state, t)


@ti.func
def _set_pack(spec: ti.template(), state: ti.template(), i, _, colour, on_pack: ti.template()):
    """Set the velocity of the one particle in pack i, if it is on a grid and has the colour."""
    g = state.grid_of[i]
    if g >= 0:
        at, pitch = i - state.grid[g, 0], pitch_of(spec, state, g)
        place = at % pitch % (spec.reach + 1)
        if colour == at // pitch % (spec.depth + 1) * (spec.reach + 1) + place:
            _set_own(spec, state, g, i, on_pack)


@ti.func
def _set_own(spec: ti.template(), state: ti.template(), g, i, on_pack: ti.template()):
    """Set the velocities of pack i, except those of particles that have springs on the graph.

    These have a turn of their own.
    """
    v = on_pack(spec, state, g, i)
    if ti.static(spec.springs):
        old_v = read(spec, state.v, i)
        v = old_v + read(spec, state.own, i) * (v - old_v)
    write(spec, state.v, i, v)


@ti.func
def _set_rows(spec: ti.template(), state: ti.template(), t, _, colour, on_pack: ti.template()):
    """Set the velocities in those rows of thread t's share that have the colour.

    In a row, packs take turns by one more than links reach, and the halos are renewed after each.
    """
    for g in range(state.n_grids[None]):
        first, width, pitch = state.grid[g, 0], state.grid[g, 2], pitch_of(spec, state, g)
        rows = ti.select(state.grid[g, 3] == 1, state.grid[g, 1], 0)
        for r in range(share(spec, rows, t), share(spec, rows, t + 1)):
            if r % (spec.depth + 1) == colour:
                row = first + r * pitch
                for place in range(spec.reach + 1):
                    for i in range(width // (spec.reach + 1)):
                        _set_own(spec, state, g, row + i * (spec.reach + 1) + place, on_pack)
                    renew_left_halo(spec, state.v, row, width, spec.halo)
                    renew_right_halo(spec, state.v, row, width, spec.halo)


@functools.cache
def _setting(on_particle):
    """The body of a loop over coloured particles that sets the velocity of each."""

    @ti.func
    def visit(spec: ti.template(), state: ti.template(), i):
        p = state.coloured[i]
        _set_particle(spec, state, state.csr_slot[p], on_particle(spec, state, p))

    return visit


@ti.func
def _set_particle(spec: ti.template(), state: ti.template(), slot, v):
    """Set the velocity of the particle at a slot, and of its copies in the halos of its row."""
    set_slot_value(spec, state.v, slot, v)
    if ti.static(spec.halo > 0):
        i, lane = slot // spec.lanes, slot % spec.lanes
        g = state.grid_of[i]
        if g >= 0:
            width = state.grid[g, 2]
            place = (i - state.grid[g, 0]) % pitch_of(spec, state, g)
            if place < spec.halo and lane > 0:
                set_slot_value(spec, state.v, slot + width * spec.lanes - 1, v)
            if place >= width - spec.halo and lane < spec.lanes - 1:
                set_slot_value(spec, state.v, slot - width * spec.lanes + 1, v)


@ti.func
def renew_both_halos(spec: ti.template(), state: ti.template(), t):
    """Fill all halos of all rows with what the visits of `each_particle` read there.

    These are positions, velocities and the stiffness of links, which may have broken. It comes
    before the sweeps of a step. Where packs are single particles there is nothing to do.
    """
    if ti.static(spec.halo > 0):
        each_row(spec, state, t, _renew_both_halos)


def _read_beside(spec, state):
    """The fields of vectors that visits read of neighbours."""
    low = (state.x_low, state.goal_v) if spec.compensated else ()
    return (state.x, state.v, *low)


@ti.func
def _renew_both_halos(spec: ti.template(), state: ti.template(), begin, width):
    """Fill both halos of the row of packs at `begin`, as wide as any link reaches."""
    for field in ti.static(_read_beside(spec, state)):
        renew_left_halo(spec, field, begin, width, spec.halo)
        renew_right_halo(spec, field, begin, width, spec.halo)
    for s in range(spec.kinds):
        row = link_index(state, s, begin)
        for h in range(spec.halo):
            for lane in range(spec.lanes - 1):
                for field in ti.static(own_numbers(spec, state)):
                    renew_number(spec, field, row, width, h, lane)
    if ti.static(spec.line_kinds > 0):
        for s in range(spec.line_kinds):
            row = link_index(state, s, begin)
            for h in range(spec.halo):
                for lane in range(spec.lanes - 1):
                    renew_number(spec, state.line_k, row, width, h, lane)
