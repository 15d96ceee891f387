"""Kernels that copy NumPy arrays into the fields of `State`: few, so little is compiled.

Arrays have the device's precision, or are int32. n: particles; s: springs on the graph; l: links;
"numbers" in a shape: the length of `spring_numbers.NUMBERS`.
"""

import taichi as ti

from taichi_cloth.kernels.grids import link_index, pitch_of
from taichi_cloth.kernels.loops import COUNTER
from taichi_cloth.kernels.packs import set_slot_number, set_slot_value, slot_number
from taichi_cloth.kernels.spring_numbers import (
    NUMBERS,
    K,
    own_columns,
    own_numbers,
    shared_columns,
    stored_fields,
)
from taichi_cloth.kernels.state import BREAKING, GONE
from taichi_cloth.kernels.watchdog import NO_FAULT


@ti.kernel
def load_numbers(state: ti.template(), counts: ti.types.ndarray(), numbers: ti.types.ndarray()):
    """Fill the fields that hold numbers of the scene and the run.

    counts, numbers: 1-D, in the order of state.count_names and of state.number_names.
    """
    _fill(state.count_places, counts)
    _fill(state.number_places, numbers)


@ti.func
def _fill(places: ti.template(), numbers: ti.template()):
    """Fill the fields at `State.count_places` or `State.number_places` from what lies there."""
    for field, at, size in ti.static(places):
        if ti.static(size == 0):
            field[None] = numbers[at]
        else:
            for axis in ti.static(range(size)):
                field[axis] = numbers[at + axis]


@ti.kernel
def load_packs(
    spec: ti.template(),
    state: ti.template(),
    n_packs: ti.i32,
    n_pieces: ti.i32,
    n_groups: ti.i32,
    grid: ti.types.ndarray(),
    grid_of: ti.types.ndarray(),
):
    """Empty all packs and load the grids.

    n_packs: packs in use; n_pieces, n_groups: their `loops.levels_of`; grid: (grids, 4); grid_of:
    (n_packs,), read only where there are links.
    """
    state.n_packs[None] = n_packs
    state.n_pieces[None], state.n_groups[None] = n_pieces, n_groups
    state.arrivals[COUNTER] = 0
    if ti.static(spec.resting):
        state.unsettled[None] = 0
    if ti.static(spec.thick):
        state.outdated[None], state.overfull[None] = 1, 0
    state.n_grids[None] = grid.shape[0]
    ti.loop_config(serialize=state.is_short)
    for g in range(grid.shape[0]):
        for i in ti.static(range(4)):
            state.grid[g, i] = grid[g, i]
    ti.loop_config(serialize=state.is_short)
    for c in range(n_packs):
        if ti.static(spec.links):
            state.grid_of[c] = grid_of[c]
        for slot in range(c * spec.lanes, (c + 1) * spec.lanes):
            set_slot_number(spec, state.w, slot, 0.0)
            set_slot_number(spec, state.particle, slot, NO_FAULT)
            if ti.static(len(spec.walls) > 0):  # a slot without a particle is past no wall
                middle = ti.Vector.zero(state.real, spec.dim)
                for axis in ti.static(range(spec.dim)):
                    middle[axis] = 0.5 * (state.low[axis] + state.high[axis])
                set_slot_value(spec, state.x, slot, middle)
            if ti.static(spec.line_kinds > 0):
                for h in range(spec.line_kinds):
                    line = link_index(state, h, 0) * spec.lanes + slot
                    set_slot_number(spec, state.line_k, line, 0.0)
            if ti.static(spec.links):
                for s in range(spec.kinds):
                    link = link_index(state, s, 0) * spec.lanes + slot
                    for field in ti.static(own_numbers(spec, state)):
                        set_slot_number(spec, field, link, 0.0)
                    if ti.static(spec.fracture):
                        set_slot_number(spec, state.link_status, link, 0)
        if ti.static(spec.kinds > 0 and spec.fracture):
            state.breaking[c] = 0


@ti.kernel
def load_particles(
    spec: ti.template(),
    state: ti.template(),
    slots: ti.types.ndarray(),
    rows: ti.types.ndarray(),
):
    """Load the particles, after `load_packs`; halos are left to `loops.renew_all_halos`.

    slots: (n,), the slot of each; rows: (n, columns): the vectors state.vector_names, dim columns
    each, then the numbers state.particle_names.
    """
    ti.loop_config(serialize=state.is_short)
    for i in range(rows.shape[0]):
        slot = slots[i]
        state.slot[i] = slot
        set_slot_number(spec, state.particle, slot, i)
        if ti.static(spec.obstacles and not spec.moving):
            state.free_ball[slot, ti.static(spec.dim)] = 0.0
        for field, at in ti.static(state.vector_places):
            vector = ti.Vector.zero(state.real, ti.static(spec.dim))
            for axis in ti.static(range(spec.dim)):
                vector[axis] = rows[i, at + axis]
            set_slot_value(spec, field, slot, vector)
        for field, at in ti.static(state.particle_places):
            set_slot_number(spec, field, slot, rows[i, at])


@ti.kernel
def load_summed_springs(
    spec: ti.template(),
    state: ti.template(),
    slots: ti.types.ndarray(),
    rows: ti.types.ndarray(),
):
    """Load the sums of the stiffness and damping of each particle's springs.

    slots: (n,), the slot of each particle; rows: (n, 2), for summed_k and summed_c.
    """
    ti.loop_config(serialize=state.is_short)
    for i in range(rows.shape[0]):
        set_slot_number(spec, state.summed_k, slots[i], rows[i, 0])
        set_slot_number(spec, state.summed_c, slots[i], rows[i, 1])


@ti.kernel
def load_halo_numbers(spec: ti.template(), state: ti.template()):
    """Fill the halos of those fields that hold a number for each particle.

    Methods that read such numbers of neighbours need it; the halos of vectors are renewed by loops.
    """
    ti.loop_config(serialize=state.is_short)
    for g in range(state.n_grids[None]):
        first, width = state.grid[g, 0], state.grid[g, 2]
        for r in range(state.grid[g, 1]):
            row = first + r * pitch_of(spec, state, g)
            for h in range(spec.halo):
                for lane in range(spec.lanes - 1):
                    right, left = row + width + h, row - 1 - h
                    _copy_numbers(spec, state, row + h, lane + 1, right, lane)
                    _copy_numbers(spec, state, row + width - 1 - h, lane, left, lane + 1)


@ti.func
def _copy_numbers(spec: ti.template(), state: ti.template(), i, lane, to, to_lane):
    """Copy all numbers of the particle in a lane of pack i to a lane of the pack `to`."""
    here, there = i * spec.lanes + lane, to * spec.lanes + to_lane
    for field in ti.static(_different_numbers(spec, state)):
        set_slot_number(spec, field, there, slot_number(spec, field, here))


def _different_numbers(spec, state):
    """The fields that hold a number for each particle, except those that all particles share."""
    return [field for field, _ in state.particle_places if field.shape != ()]


@ti.func
def _fill_springs(
    spec: ti.template(), state: ti.template(), place: ti.template(), rows: ti.template()
):
    """Fill the springs' numbers at a place (`spring_numbers.fields_of`) from rows (s, numbers)."""
    ti.loop_config(serialize=state.is_short)
    for s in range(rows.shape[0]):
        for column, field in ti.static(stored_fields(spec, state, place)):
            if ti.static(spec.uniform_springs):
                field[None] = rows[s, column]
            else:
                field[s] = rows[s, column]


@ti.kernel
def load_colours(
    spec: ti.template(),
    state: ti.template(),
    colours: ti.i32,
    start: ti.types.ndarray(),
    ends: ti.types.ndarray(),
    numbers: ti.types.ndarray(),
):
    """Load the springs on the graph sorted by colour.

    start: (colours + 1,), the first spring of each colour; ends: (s, 2), their slots; numbers:
    (s, numbers), or (1, numbers) where all springs have the same.
    """
    state.n_colours[None] = colours
    ti.loop_config(serialize=state.is_short)
    for k in range(colours + 1):
        state.colour_start[k] = start[k]
    ti.loop_config(serialize=state.is_short)
    for s in range(start[colours]):
        for end in ti.static(range(2)):
            state.ends[s, end] = ends[s, end]
    _fill_springs(spec, state, "spring", numbers)


@ti.kernel
def load_particle_colours(
    spec: ti.template(),
    state: ti.template(),
    colours: ti.i32,
    start: ti.types.ndarray(),
    coloured: ti.types.ndarray(),
):
    """Load the particles with springs on the graph sorted by colour, after `load_half_springs`.

    start: (colours + 1,), the first of each colour; coloured: (rows,), their compressed rows.
    """
    state.n_colours[None] = colours
    ti.loop_config(serialize=state.is_short)
    for k in range(colours + 1):
        state.colour_start[k] = start[k]
    ti.loop_config(serialize=state.is_short)
    for slot in range(state.n_packs[None] * spec.lanes):
        set_slot_number(spec, state.own, slot, 1.0)
    ti.loop_config(serialize=state.is_short)
    for i in range(start[colours]):
        state.coloured[i] = coloured[i]
        set_slot_number(spec, state.own, state.csr_slot[coloured[i]], 0.0)


@ti.kernel
def load_half_springs(
    spec: ti.template(),
    state: ti.template(),
    near: ti.types.ndarray(),
    row: ti.types.ndarray(),
    far: ti.types.ndarray(),
    numbers: ti.types.ndarray(),
    near_count: ti.i32,
    far_count: ti.i32,
):
    """Load the compressed rows of half-springs (`graph.py`): csr_slot, csr_start and csr_other.

    near: (near_count,), the slot of each row's particle; row: (near_count + 1,), the first
    half-spring of each row; far: (far_count,), the slot of each half-spring's other end; numbers:
    (far_count, numbers), or (1, numbers) where all springs have the same or there are none.
    """
    state.n_csr_rows[None] = near_count
    ti.loop_config(serialize=state.is_short)
    for i in range(near_count):
        state.csr_slot[i] = near[i]
    ti.loop_config(serialize=state.is_short)
    for i in range(row.shape[0]):
        state.csr_start[i] = row[i]
    ti.loop_config(serialize=state.is_short)
    for h in range(far_count):
        state.csr_other[h] = far[h]
    _fill_springs(spec, state, "csr", numbers)


@ti.kernel
def load_packed_rows(
    spec: ti.template(),
    state: ti.template(),
    start: ti.types.ndarray(),
    run: ti.types.ndarray(),
    copied: ti.types.ndarray(),
    numbers: ti.types.ndarray(),
    copies: ti.i32,
):
    """Load the packed rows of half-springs (`graph.py`).

    start: (packs + 1,), csr_start; run: (columns,), csr_run; copied: (copies * lanes,) or longer,
    csr_other; numbers: (columns * lanes, numbers).
    """
    state.first_copy[None], state.n_copies[None] = start.shape[0] - 1, copies
    ti.loop_config(serialize=state.is_short)
    for i in range(start.shape[0]):
        state.csr_start[i] = start[i]
    ti.loop_config(serialize=state.is_short)
    for c in range(run.shape[0]):
        state.csr_run[c] = run[c]
    ti.loop_config(serialize=state.is_short)
    for h in range(copies * spec.lanes):
        state.csr_other[h] = copied[h]
    _fill_springs(spec, state, "csr", numbers)


@ti.kernel
def load_springs(
    spec: ti.template(),
    state: ti.template(),
    count: ti.i32,
    indices: ti.types.ndarray(),
    held: ti.types.ndarray(),
):
    """Load what fracture needs of `count` springs on the graph.

    indices: (s, 6): slots of the two ends, two half-springs, status, break_step; held: (s, 2),
    squares of the shortest and the longest length at which they hold [length^2], or (1, 2) where
    all springs have the same.
    """
    state.n_springs[None] = count
    ti.loop_config(serialize=state.is_short)
    for s in range(count):
        for end in ti.static(range(2)):
            state.ends[s, end] = indices[s, end]
            state.half[s, end] = indices[s, 2 + end]
        state.status[s] = indices[s, 4]
        state.break_step[s] = indices[s, 5]
    ti.loop_config(serialize=state.is_short)
    for s in range(held.shape[0]):
        for field, at in ti.static(((state.shortest2, 0), (state.longest2, 1))):
            if ti.static(spec.uniform_springs):
                field[None] = held[s, at]
            else:
                field[s] = held[s, at]


@ti.kernel
def load_links(
    spec: ti.template(),
    state: ti.template(),
    shared: ti.types.ndarray(),
    links: ti.types.ndarray(),
    own: ti.types.ndarray(),
):
    """Load the links of grids, after `load_packs`.

    shared: (kinds, grids, numbers + 2): the numbers, of which those are read that links of a kind
    and grid share, and the squares of the shortest and the longest length at which they hold
    [length^2].
    links: (l, 4): kind, slot of the earlier end, status, break_step.
    own: (l, numbers): the numbers, of which those are read that each link has itself.
    """
    for s in ti.static(range(spec.kinds)):
        state.link[s, 0], state.link[s, 1] = spec.links[s][0], spec.links[s][1]
        state.forward[s] = spec.forward[s]
    ti.loop_config(serialize=state.is_short)
    for s, g in ti.ndrange(shared.shape[0], shared.shape[1]):
        for column, field in ti.static(shared_columns(spec, state)):
            field[s, g] = shared[s, g, column]
        state.link_shortest2[s, g] = shared[s, g, ti.static(len(NUMBERS))]
        state.link_longest2[s, g] = shared[s, g, ti.static(len(NUMBERS) + 1)]
    ti.loop_config(serialize=state.is_short)
    for i in range(links.shape[0]):
        slot, status = links[i, 1], links[i, 2]
        link = link_index(state, links[i, 0], 0) * spec.lanes + slot
        for column, field in ti.static(own_columns(spec, state)):
            value = own[i, column]
            if ti.static(column == K):  # what is gone has no stiffness
                value = ti.select(status == GONE, 0.0, value)
            set_slot_number(spec, field, link, value)
        if ti.static(spec.fracture):
            set_slot_number(spec, state.link_status, link, status)
            set_slot_number(spec, state.link_step, link, links[i, 3])
            if status == BREAKING:
                ti.atomic_add(state.breaking[slot // spec.lanes], 1)


@ti.kernel
def load_lines(
    spec: ti.template(),
    state: ti.template(),
    places: ti.types.ndarray(),
    k: ti.types.ndarray(),
):
    """Load the stencils along the lines of grids, after `load_packs`.

    places: (m, 2), each one's kind of line and the slot of its earliest particle; k: (m,).
    """
    for h in ti.static(range(spec.line_kinds)):
        for axis in ti.static(range(2)):
            state.line[h, axis] = spec.lines[h][axis]
            state.link[spec.kinds + h, axis] = 2 * spec.lines[h][axis]
    ti.loop_config(serialize=state.is_short)
    for i in range(k.shape[0]):
        line = link_index(state, places[i, 0], 0) * spec.lanes + places[i, 1]
        set_slot_number(spec, state.line_k, line, k[i])


@ti.kernel
def load_stencils(
    state: ti.template(),
    start: ti.types.ndarray(),
    slots: ti.types.ndarray(),
    weights: ti.types.ndarray(),
    rows: ti.types.ndarray(),
    of: ti.types.ndarray(),
    row_weights: ti.types.ndarray(),
):
    """Load the listed stencils, after `load_half_springs`.

    start: (m + 1,); slots, weights: (q,), their particles. rows: (rows + 1,), where the parts of
    each compressed row begin; of, row_weights: (q,), each part's stencil and weight.
    """
    state.n_stencils[None] = start.shape[0] - 1
    ti.loop_config(serialize=state.is_short)
    for m in range(start.shape[0]):
        state.stencil_start[m] = start[m]
    ti.loop_config(serialize=state.is_short)
    for e in range(slots.shape[0]):
        state.stencil_slot[e], state.stencil_weight[e] = slots[e], weights[e]
        state.row_stencil[e], state.row_weight[e] = of[e], row_weights[e]
    ti.loop_config(serialize=state.is_short)
    for p in range(rows.shape[0]):
        state.row_stencils[p] = rows[p]


@ti.kernel
def load_stencil_numbers(state: ti.template(), k: ti.types.ndarray()):
    """Load what multiplies the curvature vectors of the listed stencils, (m,)."""
    ti.loop_config(serialize=state.is_short)
    for m in range(k.shape[0]):
        state.stencil_k[m] = k[m]


@ti.kernel
def load_stencil_sides(state: ti.template(), start: ti.types.ndarray(), side: ti.types.ndarray()):
    """Load the springs that listed stencils need.

    start: (m + 1,); side: (q,), a spring on the graph, or -1 less the index of a link's number.
    """
    ti.loop_config(serialize=state.is_short)
    for m in range(start.shape[0]):
        state.side_start[m] = start[m]
    ti.loop_config(serialize=state.is_short)
    for e in range(side.shape[0]):
        state.side[e] = side[e]


@ti.kernel
def load_stencil_colours(state: ti.template(), start: ti.types.ndarray()):
    """Load where the colours of listed stencils begin, (colours + 1,)."""
    state.n_stencil_colours[None] = start.shape[0] - 1
    ti.loop_config(serialize=state.is_short)
    for k in range(start.shape[0]):
        state.stencil_colour[k] = start[k]


@ti.kernel
def load_closer_pairs(
    state: ti.template(),
    start: ti.types.ndarray(),
    other: ti.types.ndarray(),
    reach: ti.types.ndarray(),
    rows: ti.i32,
    count: ti.i32,
):
    """Load the pairs that keep less than the sum of their radii: `Spheres.rows_by_place`."""
    ti.loop_config(serialize=state.is_short)
    for i in range(rows + 1):
        state.closer_start[i] = start[i]
    ti.loop_config(serialize=state.is_short)
    for k in range(count):
        state.closer_other[k], state.closer_reach[k] = other[k], reach[k]


@ti.kernel
def load_patches(
    state: ti.template(), start: ti.types.ndarray(), particles: ti.types.ndarray(), patches: ti.i32
):
    """Load the patches of particles that are compared as one: `scene.spheres.Spheres`."""
    state.n_patches[None] = patches
    ti.loop_config(serialize=state.is_short)
    for b in range(patches + 1):
        state.patch_start[b] = start[b]
    ti.loop_config(serialize=state.is_short)
    for at in range(particles.shape[0]):
        state.in_patches[at], state.patch_place[particles[at]] = particles[at], at
    ti.loop_config(serialize=state.is_short)
    for b in range(patches):
        for at in range(start[b], start[b + 1]):
            state.patch_of[at] = b
