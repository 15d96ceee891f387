"""Contacts, as changes of velocity, so that every method shares them: walls and particle pairs.

All changes are computed from the state at the start of the step. Pairs are found with a uniform
grid of cells at least one largest diameter wide, filled by a counting sort (Green, "Particle
Simulation using CUDA", 2010). The grid wraps around at its edges, so it needs no bounds: with at
least three cells per axis the 3^dim cells around a particle are distinct, and what a far particle
in the same cell costs is one comparison. Each cell lists its particles by index, which fixes the
order of accumulation.
"""

import taichi as ti

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.lanes import (
    any_lane,
    component,
    set_site_value,
    site_number,
    site_value,
    where,
    with_component,
)


@ti.func
def cell_coordinates(state: ti.template(), x):
    """Integer coordinates of x's cell, before wrapping."""
    return ti.cast(ti.floor(x / state.cell_size[None]), ti.i32)


@ti.func
def wrapped(c, size):
    """c modulo size, in 0..size-1 also for negative c."""
    m = c % size
    return ti.select(m < 0, m + size, m)


@ti.func
def cell_index(state: ti.template(), c):
    """Index of the cell with coordinates c (wrapped); the first axis runs fastest."""
    size = state.grid_size[None]
    index = wrapped(c[c.n - 1], size[c.n - 1])
    for axis in ti.static(range(c.n - 2, -1, -1)):
        index = index * size[axis] + wrapped(c[axis], size[axis])
    return index


@ti.func
def cell_count(state: ti.template()):
    count = 1
    for axis in ti.static(range(state.grid_size.n)):
        count *= state.grid_size[None][axis]
    return count


@ti.func
def site_of(plan: ti.template(), state: ti.template(), i):
    """Where particle i is stored."""
    if ti.static(len(plan.links) > 0):
        return state.site[i]
    else:
        return i


@ti.func
def sort_into_cells(plan: ti.template(), state: ti.template()):
    """Counting sort of the particles by cell: cell_start, sorted_index, sorted_x, sorted_radius."""
    for c in range(cell_count(state)):
        state.cell_fill[c] = 0
    for i in range(state.n[None]):
        x = site_value(plan, state.x, site_of(plan, state, i))
        c = cell_index(state, cell_coordinates(state, x))
        state.cell_of[i] = c
        ti.atomic_add(state.cell_fill[c], 1)

    # Exclusive prefix sum in blocks: sums per block, then over blocks, then inside each block.
    for b in range((cell_count(state) + state.block - 1) // state.block):
        total = 0
        for c in range(b * state.block, ti.min((b + 1) * state.block, cell_count(state))):
            total += state.cell_fill[c]
        state.block_start[b] = total
    for _ in range(1):
        total = 0
        for b in range((cell_count(state) + state.block - 1) // state.block):
            count = state.block_start[b]
            state.block_start[b] = total
            total += count
        state.cell_start[cell_count(state)] = total
    for b in range((cell_count(state) + state.block - 1) // state.block):
        total = state.block_start[b]
        for c in range(b * state.block, ti.min((b + 1) * state.block, cell_count(state))):
            state.cell_start[c] = total
            total += state.cell_fill[c]
            state.cell_fill[c] = 0

    for i in range(state.n[None]):
        c = state.cell_of[i]
        state.sorted_index[state.cell_start[c] + ti.atomic_add(state.cell_fill[c], 1)] = i

    # Threads may have filled a cell in any order: an insertion sort by index fixes it.
    for c in range(cell_count(state)):
        first = state.cell_start[c]
        for at in range(first + 1, state.cell_start[c + 1]):
            i = state.sorted_index[at]
            to = at
            while to > first and state.sorted_index[to - 1] > i:
                state.sorted_index[to] = state.sorted_index[to - 1]
                to -= 1
            state.sorted_index[to] = i
    for at in range(state.n[None]):
        site = site_of(plan, state, state.sorted_index[at])
        state.sorted_x[at] = site_value(plan, state.x, site)
        state.sorted_radius[at] = site_number(plan, state.radius, site)


@ti.func
def bounce_off_cell(plan: ti.template(), state: ti.template(), c, i, x, v, w, radius, e):
    """Sum of the velocity changes of particle i from colliding with the particles of one cell."""
    change = 0.0 * x
    for at in range(state.cell_start[c], state.cell_start[c + 1]):
        d = state.sorted_x[at] - x
        reach = radius + state.sorted_radius[at]
        if d.dot(d) <= reach * reach:
            j = state.sorted_index[at]
            if j != i:
                site = site_of(plan, state, j)
                change += laws.pair_bounce(
                    d,
                    v,
                    site_value(plan, state.v, site),
                    w,
                    site_number(plan, state.w, site),
                    reach,
                    e * site_number(plan, state.restitution, site),
                )
    return change


@ti.func
def compute_pair_bounces(plan: ti.template(), state: ti.template()):
    """jump: change of each particle's velocity from all its collisions, equal time for all."""
    sort_into_cells(plan, state)
    for at in range(state.n[None]):  # cell by cell: one after the other looks at the same memory
        i = state.sorted_index[at]
        site = site_of(plan, state, i)
        x, v = state.sorted_x[at], site_value(plan, state.v, site)
        w = site_number(plan, state.w, site)
        jump = 0.0 * x
        if w > 0.0:
            centre = cell_coordinates(state, x)
            radius, e = state.sorted_radius[at], site_number(plan, state.restitution, site)
            for offset in ti.grouped(ti.ndrange(*((-1, 2),) * plan.dim)):
                c = cell_index(state, centre + offset)
                jump += bounce_off_cell(plan, state, c, i, x, v, w, radius, e)
        set_site_value(plan, state.jump, site, jump)


@ti.func
def compute_contacts(plan: ti.template(), state: ti.template()):
    """Prepare the step's contacts; nothing for a scene without collisions."""
    if ti.static(plan.collisions):
        compute_pair_bounces(plan, state)


@ti.func
def wall_gap(state: ti.template(), c, axis: ti.template(), side: ti.template()):
    """How far the surfaces of cell c's particles are short of a wall (negative: past it).

    One formula for all that ask: where a particle rests on the floor, rounding decides.
    """
    bound = state.high[None][axis] if ti.static(side > 0) else state.low[None][axis]
    return side * (bound - component(state.x[c], axis)) - state.radius[c]


@ti.func
def touches_wall(plan: ti.template(), state: ti.template(), c):
    """Whether a particle of cell c is past any wall: most are not, and that is all they pay."""
    least = 0.0 * state.radius[c]
    for axis, side in ti.static(plan.walls):
        least = ti.min(least, wall_gap(state, c, axis, side))
    return any_lane(plan, least < 0.0)


@ti.func
def velocity_jump(plan: ti.template(), state: ti.template(), c):
    """Change of the velocities in cell c from walls and pairs, by the state at the step's start."""
    v = state.v[c]
    jump = 0.0 * v
    if ti.static(len(plan.walls) > 0):
        if touches_wall(plan, state, c):
            for axis, side in ti.static(plan.walls):
                gap, vn = wall_gap(state, c, axis, side), side * component(v, axis)
                bounce = side * laws.wall_bounce(gap, vn, state.restitution[c])
                jump = with_component(jump, axis, component(jump, axis) + bounce)
            jump = where(state.w[c] > 0.0, jump, 0.0 * v)
    if ti.static(plan.collisions):
        jump += state.jump[c]
    return jump


@ti.func
def kept_above_floor(plan: ti.template(), state: ti.template(), c, x, v):
    """Positions x after the move; on the floor where that was hit and v still points down.

    Must be called before x and v of the cell are overwritten: the hit is the step's start's.
    """
    y = x
    if ti.static(plan.floor):
        hit = ti.min(-wall_gap(state, c, 1, 1), component(state.v[c], 1))  # where positive
        sinks = ti.min(ti.min(hit, component(v, 1)), state.w[c]) > 0.0
        if any_lane(plan, sinks):
            floor = state.high[None][1] - state.radius[c]
            y = with_component(x, 1, ti.select(sinks, floor, component(x, 1)))
    return y
