"""Between NumPy arrays and the containers: one kernel a direction, so that little is compiled."""

import taichi as ti

from taichi_cloth.kernels.loops import each_cell_moving, leave
from taichi_cloth.kernels.packs import (
    of_kind,
    pitch_of,
    set_site_number,
    set_site_value,
    site_number,
    site_value,
)
from taichi_cloth.kernels.state import ALIVE, BREAKING, GONE
from taichi_cloth.kernels.watchdog import NO_FAULT


@ti.kernel
def load_numbers(
    plan: ti.template(),
    state: ti.template(),
    counts: ti.types.ndarray(),
    numbers: ti.types.ndarray(),
):
    """Fill the 0-D fields.

    counts: n, iterations, then the collision grid's size per axis; numbers: dt, speed limit, cell
    size, tolerance, then per axis gravity, low, high.
    """
    dim = ti.static(plan.dim)
    for _ in range(1):
        state.n[None] = counts[0]
        state.dt[None] = numbers[0]
        state.iterations[None] = counts[1]
        state.speed_limit[None] = numbers[1]
        state.tolerance[None] = numbers[3]
        if ti.static(plan.compensated):
            state.one[None] = 1.0
        if ti.static(plan.collisions):
            state.cell_size[None] = numbers[2]
        for axis in ti.static(range(dim)):
            state.gravity[axis] = numbers[4 + axis]
            if ti.static(len(plan.walls) > 0):
                state.low[axis] = numbers[4 + dim + axis]
                state.high[axis] = numbers[4 + 2 * dim + axis]
            if ti.static(plan.collisions):
                state.grid_size[axis] = counts[2 + axis]


@ti.kernel
def load_cells(
    plan: ti.template(),
    state: ti.template(),
    n_cells: ti.i32,
    grid: ti.types.ndarray(),
    grid_of: ti.types.ndarray(),
):
    """Empty all cells, and fill grid (g, 4) and, where there are links, grid_of (cells,)."""
    for _ in range(1):
        state.n_cells[None] = n_cells
        state.n_grids[None] = grid.shape[0]
        for g in range(grid.shape[0]):
            for i in ti.static(range(4)):
                state.grid[g, i] = grid[g, i]
    for c in range(n_cells):
        if ti.static(plan.links):
            state.grid_of[c] = grid_of[c]
        for site in range(c * plan.lanes, (c + 1) * plan.lanes):
            set_site_number(plan, state.w, site, 0.0)
            set_site_number(plan, state.particle, site, NO_FAULT)
            if ti.static(len(plan.walls) > 0):  # places without a particle are past no wall
                middle = ti.Vector.zero(state.real, plan.dim)
                for axis in ti.static(range(plan.dim)):
                    middle[axis] = 0.5 * (state.low[axis] + state.high[axis])
                set_site_value(plan, state.x, site, middle)
            if ti.static(plan.links):
                for s in range(plan.kinds):
                    link = of_kind(state, s, 0) * plan.lanes + site
                    set_site_number(plan, state.link_k, link, 0.0)
                    if ti.static(plan.fracture):
                        set_site_number(plan, state.link_status, link, 0)
        if ti.static(plan.kinds > 0 and plan.fracture):
            state.breaking[c] = 0


@ti.kernel
def load_particles(
    plan: ti.template(),
    state: ti.template(),
    sites: ti.types.ndarray(),
    rows: ti.types.ndarray(),
):
    """Fill the particles from `rows` (n, 2*dim + 4): x, v, w, radius, restitution, viscous.

    Then, in compensated sums, the low parts of x and v: rows (n, 4*dim + 4).
    """
    dim = ti.static(plan.dim)
    for i in range(rows.shape[0]):
        site = sites[i]
        state.site[i] = site
        set_site_number(plan, state.particle, site, i)
        x, v = ti.Vector.zero(state.real, dim), ti.Vector.zero(state.real, dim)
        for axis in ti.static(range(dim)):
            x[axis] = rows[i, axis]
            v[axis] = rows[i, dim + axis]
        set_site_value(plan, state.x, site, x)
        set_site_value(plan, state.v, site, v)
        set_site_number(plan, state.w, site, rows[i, 2 * dim])
        if ti.static(len(plan.walls) > 0 or plan.collisions):
            set_site_number(plan, state.radius, site, rows[i, 2 * dim + 1])
            set_site_number(plan, state.restitution, site, rows[i, 2 * dim + 2])
        if ti.static(plan.drag):
            set_site_number(plan, state.viscous, site, rows[i, 2 * dim + 3])
        if ti.static(plan.compensated):
            for axis in ti.static(range(dim)):
                x[axis] = rows[i, 2 * dim + 4 + axis]
                v[axis] = rows[i, 3 * dim + 4 + axis]
            set_site_value(plan, state.x_low, site, x)
            set_site_value(plan, state.v_low, site, v)
    if ti.static(plan.halo > 0):
        each_cell_moving(plan, state, 0, leave)


@ti.kernel
def load_near(
    plan: ti.template(),
    state: ti.template(),
    sites: ti.types.ndarray(),
    rows: ti.types.ndarray(),
):
    """Fill near_k and near_c from `rows` (n, 2)."""
    for i in range(rows.shape[0]):
        set_site_number(plan, state.near_k, sites[i], rows[i, 0])
        set_site_number(plan, state.near_c, sites[i], rows[i, 1])


@ti.kernel
def load_halo_numbers(plan: ti.template(), state: ti.template()):
    """Fill the halos of inverse masses and drag, for methods that read those of neighbours."""
    for g in range(state.n_grids[None]):
        first, width = state.grid[g, 0], state.grid[g, 2]
        for r in range(state.grid[g, 1]):
            row = first + r * pitch_of(plan, state, g)
            for h in range(plan.halo):
                for lane in range(plan.lanes - 1):
                    right, left = row + width + h, row - 1 - h
                    _copy_numbers(plan, state, row + h, lane + 1, right, lane)
                    _copy_numbers(plan, state, row + width - 1 - h, lane, left, lane + 1)


@ti.func
def _copy_numbers(plan: ti.template(), state: ti.template(), c, lane, to, to_lane):
    here, there = c * plan.lanes + lane, to * plan.lanes + to_lane
    set_site_number(plan, state.w, there, site_number(plan, state.w, here))
    if ti.static(plan.drag and not plan.uniform_particles):
        set_site_number(plan, state.viscous, there, site_number(plan, state.viscous, here))


@ti.kernel
def load_colours(
    plan: ti.template(),
    state: ti.template(),
    colours: ti.i32,
    start: ti.types.ndarray(),
    ends: ti.types.ndarray(),
    numbers: ti.types.ndarray(),
):
    """Fill the springs on the graph by colour: start (colours + 1,), ends (s, 2); numbers, rows of
    k, rest and c: (s, 3), or (1, 3) where all springs have the same.
    """
    for _ in range(1):
        state.n_colours[None] = colours
    for k in range(colours + 1):
        state.colour_start[k] = start[k]
    for s in range(start[colours]):
        for end in ti.static(range(2)):
            state.ends[s, end] = ends[s, end]
    for s in range(numbers.shape[0]):
        if ti.static(plan.uniform_springs):
            state.spring_k[None], state.spring_rest[None] = numbers[s, 0], numbers[s, 1]
            if ti.static(plan.dashpots):
                state.spring_c[None] = numbers[s, 2]
        else:
            state.spring_k[s], state.spring_rest[s] = numbers[s, 0], numbers[s, 1]
            if ti.static(plan.dashpots):
                state.spring_c[s] = numbers[s, 2]


@ti.kernel
def load_particle_colours(
    plan: ti.template(),
    state: ti.template(),
    colours: ti.i32,
    start: ti.types.ndarray(),
    coloured: ti.types.ndarray(),
):
    """Fill the particles with springs on the graph by colour: start (colours + 1,), coloured (n,).

    After `load_half_springs`.
    """
    for _ in range(1):
        state.n_colours[None] = colours
    for k in range(colours + 1):
        state.colour_start[k] = start[k]
    for site in range(state.n_cells[None] * plan.lanes):
        set_site_number(plan, state.own, site, 1.0)
    for i in range(start[colours]):
        state.coloured[i] = coloured[i]
        set_site_number(plan, state.own, state.near[coloured[i]], 0.0)


@ti.kernel
def load_half_springs(
    state: ti.template(),
    near: ti.types.ndarray(),
    row: ti.types.ndarray(),
    far: ti.types.ndarray(),
    near_count: ti.i32,
    far_count: ti.i32,
):
    """Fill the compressed rows: near (near_count,), row (near_count + 1,), far (far_count,)."""
    for _ in range(1):
        state.n_near[None] = near_count
    for i in range(near_count):
        state.near[i] = near[i]
    for i in range(row.shape[0]):
        state.near_row[i] = row[i]
    for h in range(far_count):
        state.far[h] = far[h]


@ti.kernel
def load_spring_numbers(plan: ti.template(), state: ti.template(), rows: ti.types.ndarray()):
    """Fill k, rest and c from rows (2s, 3), or from (1, 3) where all springs have the same."""
    for h in range(rows.shape[0]):
        if ti.static(plan.uniform_springs):
            state.k[None] = rows[h, 0]
            state.rest[None] = rows[h, 1]
            if ti.static(plan.dashpots):
                state.c[None] = rows[h, 2]
        else:
            state.k[h] = rows[h, 0]
            state.rest[h] = rows[h, 1]
            if ti.static(plan.dashpots):
                state.c[h] = rows[h, 2]


@ti.kernel
def load_springs(
    plan: ti.template(),
    state: ti.template(),
    count: ti.i32,
    indices: ti.types.ndarray(),
    break_length2: ti.types.ndarray(),
):
    """Fill `count` springs: indices (s, 6): two ends, two half-springs, status, break_step.

    break_length2: (s,), or (1,) where all springs have the same.
    """
    for _ in range(1):
        state.n_springs[None] = count
    for s in range(count):
        for end in ti.static(range(2)):
            state.ends[s, end] = indices[s, end]
            state.half[s, end] = indices[s, 2 + end]
        state.status[s] = indices[s, 4]
        state.break_step[s] = indices[s, 5]
    for s in range(break_length2.shape[0]):
        if ti.static(plan.uniform_springs):
            state.break_length2[None] = break_length2[s]
        else:
            state.break_length2[s] = break_length2[s]


@ti.kernel
def load_links(
    plan: ti.template(),
    state: ti.template(),
    numbers: ti.types.ndarray(),
    links: ti.types.ndarray(),
    stiffness: ti.types.ndarray(),
):
    """Fill the grids' links.

    numbers: (kinds, grids, 3): rest, c, limit2. links: (l, 4): kind, site of the earlier end,
    status, break_step; stiffness: (l,).
    """
    for _ in range(1):
        for s in ti.static(range(plan.kinds)):
            state.link[s, 0], state.link[s, 1] = plan.links[s][0], plan.links[s][1]
            state.forward[s] = plan.forward[s]
    for s, g in ti.ndrange(numbers.shape[0], numbers.shape[1]):
        state.link_rest[s, g] = numbers[s, g, 0]
        state.link_c[s, g] = numbers[s, g, 1]
        state.link_limit2[s, g] = numbers[s, g, 2]
    for i in range(links.shape[0]):
        site, status = links[i, 1], links[i, 2]
        link = of_kind(state, links[i, 0], 0) * plan.lanes + site
        k = ti.select(status == GONE, 0.0, stiffness[i])
        set_site_number(plan, state.link_k, link, k)
        if ti.static(plan.fracture):
            set_site_number(plan, state.link_status, link, status)
            set_site_number(plan, state.link_step, link, links[i, 3])
            if status == BREAKING:
                ti.atomic_add(state.breaking[site // plan.lanes], 1)


@ti.kernel
def read_vectors(
    plan: ti.template(), state: ti.template(), of: ti.template(), out: ti.types.ndarray()
):
    """Copy the vectors of a field of cells out, (n, dim), in the order of the particles."""
    for i in range(out.shape[0]):
        vector = site_value(plan, of, state.site[i])
        for axis in ti.static(range(plan.dim)):
            out[i, axis] = vector[axis]


@ti.kernel
def take_work(state: ti.template(), out: ti.types.ndarray()):
    """Copy the counts of the solver's work out, and begin them anew."""
    for i in range(out.shape[0]):
        out[i] = state.work[i]
        state.work[i] = 0


@ti.kernel
def read_fracture(state: ti.template(), out: ti.types.ndarray()):
    """Copy status and break_step of the graph's springs out, (s, 2)."""
    for s in range(out.shape[0]):
        out[s, 0] = state.status[s]
        out[s, 1] = state.break_step[s]


@ti.kernel
def read_link_fracture(
    plan: ti.template(), state: ti.template(), links: ti.types.ndarray(), out: ti.types.ndarray()
):
    """Copy status and break_step of links out, (l, 2); links: (l, 2): kind, site."""
    for i in range(links.shape[0]):
        link = of_kind(state, links[i, 0], 0) * plan.lanes + links[i, 1]
        out[i, 0] = site_number(plan, state.link_status, link)
        out[i, 1] = site_number(plan, state.link_step, link)


@ti.kernel
def count_broken(plan: ti.template(), state: ti.template()) -> ti.i32:
    """How many springs are not alive."""
    count = 0
    if ti.static(plan.fracture and plan.springs):
        for s in range(state.n_springs[None]):
            count += ti.cast(state.status[s] != ALIVE, ti.i32)
    if ti.static(plan.fracture and plan.kinds > 0):
        for c in range(state.n_cells[None]):
            for lane in ti.static(range(plan.lanes)):
                for s in range(plan.kinds):
                    link = of_kind(state, s, c) * plan.lanes + lane
                    status = site_number(plan, state.link_status, link)
                    count += ti.cast(status != ALIVE, ti.i32)
    return count
