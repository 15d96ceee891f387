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
    for axis in ti.static(range(state.x.n)):
        count *= state.grid_size[None][axis]
    return count


@ti.func
def sort_into_cells(state: ti.template()):
    """Counting sort of the particles by cell: cell_start, sorted_index, sorted_x, sorted_radius."""
    for c in range(cell_count(state)):
        state.cell_fill[c] = 0
    for i in range(state.n[None]):
        c = cell_index(state, cell_coordinates(state, state.x[i]))
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
        i = state.sorted_index[at]
        state.sorted_x[at] = state.x[i]
        state.sorted_radius[at] = state.radius[i]


@ti.func
def bounce_off_cell(state: ti.template(), c, i, x, v, w, radius, e):
    """Sum of the velocity changes of particle i from colliding with the particles of one cell."""
    change = 0.0 * x
    for at in range(state.cell_start[c], state.cell_start[c + 1]):
        d = state.sorted_x[at] - x
        reach = radius + state.sorted_radius[at]
        if d.dot(d) <= reach * reach:
            j = state.sorted_index[at]
            if j != i:
                change += laws.pair_bounce(
                    d, v, state.v[j], w, state.w[j], reach, e * state.restitution[j]
                )
    return change


@ti.func
def compute_pair_bounces(state: ti.template()):
    """jump[i]: change of particle i's velocity from all its collisions, equal time for all."""
    sort_into_cells(state)
    for i in range(state.n[None]):
        x, v, w = state.x[i], state.v[i], state.w[i]
        jump = 0.0 * x
        if w > 0.0:
            centre = cell_coordinates(state, x)
            for offset in ti.grouped(ti.ndrange(*((-1, 2),) * state.x.n)):
                c = cell_index(state, centre + offset)
                jump += bounce_off_cell(state, c, i, x, v, w, state.radius[i], state.restitution[i])
        state.jump[i] = jump


@ti.func
def compute_contacts(features: ti.template(), state: ti.template()):
    """Prepare the step's contacts; nothing for a scene without collisions."""
    if ti.static(features.collisions):
        compute_pair_bounces(state)


@ti.func
def wall_gap(state: ti.template(), i, axis: ti.template(), side: ti.template()):
    """How far the surface of particle i is short of a wall (negative: past it).

    One formula for all that ask: where a particle rests on the floor, rounding decides.
    """
    bound = state.high[None][axis] if ti.static(side > 0) else state.low[None][axis]
    return side * (bound - state.x[i][axis]) - state.radius[i]


@ti.func
def touches_wall(features: ti.template(), state: ti.template(), i):
    """Whether particle i is past any wall: for most it is not, and that is all they pay."""
    touches = False
    for axis, side in ti.static(features.walls):
        touches = touches or wall_gap(state, i, axis, side) < 0.0
    return touches


@ti.func
def velocity_jump(features: ti.template(), state: ti.template(), i):
    """Change of particle i's velocity from walls and pairs, from its state at the step's start."""
    v = state.v[i]
    jump = 0.0 * v
    if ti.static(len(features.walls) > 0):
        if touches_wall(features, state, i) and state.w[i] > 0.0:
            for axis, side in ti.static(features.walls):
                gap = wall_gap(state, i, axis, side)
                jump[axis] += side * laws.wall_bounce(gap, side * v[axis], state.restitution[i])
    if ti.static(features.collisions):
        jump += state.jump[i]
    return jump


@ti.func
def kept_above_floor(features: ti.template(), state: ti.template(), i, x, v):
    """Position x after the move; on the floor where that was hit and v still points down.

    Must be called before state.x[i] and state.v[i] are overwritten: the hit is the step's start's.
    """
    y = x
    if ti.static(features.floor):
        hit = wall_gap(state, i, 1, 1) < 0.0 and state.v[i][1] > 0.0 and state.w[i] > 0.0
        if hit and v[1] > 0.0:
            y[1] = state.high[None][1] - state.radius[i]
    return y
