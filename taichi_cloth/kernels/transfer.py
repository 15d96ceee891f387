"""Between NumPy arrays and the containers: one kernel a direction, so that little is compiled."""

import taichi as ti


@ti.kernel
def load_numbers(
    features: ti.template(),
    state: ti.template(),
    counts: ti.types.ndarray(),
    numbers: ti.types.ndarray(),
):
    """Fill the 0-D fields.

    counts: n, n_springs, then the grid's size per axis; numbers: dt, speed limit, cell size,
    then per axis gravity, low, high.
    """
    dim = ti.static(features.dim)
    for _ in range(1):
        state.n[None] = counts[0]
        state.dt[None] = numbers[0]
        state.speed_limit[None] = numbers[1]
        if ti.static(features.fracture):
            state.n_springs[None] = counts[1]
        if ti.static(features.collisions):
            state.cell_size[None] = numbers[2]
        for axis in ti.static(range(dim)):
            state.gravity[None][axis] = numbers[3 + axis]
            if ti.static(len(features.walls) > 0):
                state.low[None][axis] = numbers[3 + dim + axis]
                state.high[None][axis] = numbers[3 + 2 * dim + axis]
            if ti.static(features.collisions):
                state.grid_size[None][axis] = counts[2 + axis]


@ti.kernel
def load_particles(features: ti.template(), state: ti.template(), rows: ti.types.ndarray()):
    """Fill the particles from `rows` (n, 2*dim + 4): x, v, w, radius, restitution, viscous."""
    dim = ti.static(features.dim)
    for i in range(rows.shape[0]):
        for axis in ti.static(range(dim)):
            state.x[i][axis] = rows[i, axis]
            state.v[i][axis] = rows[i, dim + axis]
        state.w[i] = rows[i, 2 * dim]
        if ti.static(len(features.walls) > 0 or features.collisions):
            state.radius[i] = rows[i, 2 * dim + 1]
            state.restitution[i] = rows[i, 2 * dim + 2]
        if ti.static(features.drag):
            state.viscous[i] = rows[i, 2 * dim + 3]


@ti.kernel
def load_half_springs(
    features: ti.template(),
    state: ti.template(),
    row: ti.types.ndarray(),
    far: ti.types.ndarray(),
):
    """Fill the compressed rows: row (n + 1,), far (2s,)."""
    for i in range(row.shape[0]):
        state.row[i] = row[i]
    for h in range(far.shape[0]):
        state.far[h] = far[h]


@ti.kernel
def load_spring_numbers(features: ti.template(), state: ti.template(), rows: ti.types.ndarray()):
    """Fill k, rest and c from rows (2s, 3), or from (1, 3) where all springs have the same."""
    for h in range(rows.shape[0]):
        if ti.static(features.uniform_springs):
            state.k[None] = rows[h, 0]
            state.rest[None] = rows[h, 1]
            if ti.static(features.dashpots):
                state.c[None] = rows[h, 2]
        else:
            state.k[h] = rows[h, 0]
            state.rest[h] = rows[h, 1]
            if ti.static(features.dashpots):
                state.c[h] = rows[h, 2]


@ti.kernel
def load_springs(
    features: ti.template(),
    state: ti.template(),
    indices: ti.types.ndarray(),
    break_length2: ti.types.ndarray(),
):
    """Fill the springs: indices (s, 6): two ends, two half-springs, status, break_step.

    break_length2: (s,), or (1,) where all springs have the same.
    """
    for s in range(indices.shape[0]):
        for end in ti.static(range(2)):
            state.ends[s][end] = indices[s, end]
            state.half[s][end] = indices[s, 2 + end]
        state.status[s] = indices[s, 4]
        state.break_step[s] = indices[s, 5]
    for s in range(break_length2.shape[0]):
        if ti.static(features.uniform_springs):
            state.break_length2[None] = break_length2[s]
        else:
            state.break_length2[s] = break_length2[s]


@ti.kernel
def read_motion(state: ti.template(), x: ti.types.ndarray(), v: ti.types.ndarray()):
    """Copy positions and velocities out, both (n, dim)."""
    for i in range(x.shape[0]):
        for axis in ti.static(range(state.x.n)):
            x[i, axis] = state.x[i][axis]
            v[i, axis] = state.v[i][axis]


@ti.kernel
def read_fracture(state: ti.template(), out: ti.types.ndarray()):
    """Copy status and break_step out, (s, 2)."""
    for s in range(out.shape[0]):
        out[s, 0] = state.status[s]
        out[s, 1] = state.break_step[s]
