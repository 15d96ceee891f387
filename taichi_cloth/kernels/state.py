"""Fields that hold the state of a simulation on the device.

Allocated once with a capacity and refilled in place: every new container makes every kernel
compile again. Fields of features that a scene lacks are not allocated at all.
"""

from dataclasses import astuple, dataclass

import taichi as ti

from taichi_cloth.kernels.loops import COUNTER_SIZE

ALIVE, BREAKING, GONE = 0, 1, 2  # BREAKING: over its limit, pulls for one more step

CELLS_PER_PARTICLE = 8  # of the collision grid: more cells mean fewer comparisons, more clearing

CACHE_LINE = 32  # numbers: two lines of 64 bytes, which processors fetch in pairs


@dataclass(frozen=True)
class Capacity:
    """How much fits: particles, springs on the graph, cells, grids; cells in a row with halos."""

    particles: int
    springs: int
    cells: int
    grids: int
    row: int

    def holds(self, other: "Capacity") -> bool:
        """Whether what needs `other` fits in here."""
        return all(a >= b for a, b in zip(astuple(self), astuple(other), strict=True))


@ti.data_oriented
class State:
    """All device data of one simulation.

    Cells (`lanes.py`), each value a vector of `dim` or a number for each of the cell's particles:
        x, v: position and velocity; a: acceleration of the current step;
        w: inverse mass (0 = fixed); radius, restitution (walls or collisions);
        viscous (drag); push (blow): force of the pointer, held through a frame;
        good_x, good_v: the state at the start of the frame under way, the last good one;
        particle: index of the particle there; site: where particle i is.
    Springs on the graph, in both directions, as compressed rows: the p-th particle that has any
        is near[p], its half-springs are near_row[p] .. near_row[p+1], each with its far end, and
        k, rest and c (dashpots), which are 0-D where all springs have the same. What is gone has
        its own particle as its far end.
    Springs on the graph once each (fracture): ends, break_length2 (square of the length at which
        the force reaches the break force), status (ALIVE, BREAKING, GONE), break_step, half (its
        two half-springs).
    Grids: grid: first cell, rows, width in cells, whether it has links; grid_of: a cell's grid, -1
        in the empty rows. For each kind of link s: link_k[s] (0 = absent or gone), link_status[s]
        and link_step[s] (fracture) of cells; link_rest, link_c, link_limit2 by kind and grid;
        given[s]: what links give: rows of zeros, a ring of rows for each thread, then the last
        rows of each thread's share of each grid; breaking: how many of a cell's links are about
        to go.
    Numbers a run may change are 0-D fields: n, n_cells, n_grids, dt, gravity, low, high, ...
    """

    def __init__(self, plan, real, capacity):
        """Allocate. real: ti.f32 or ti.f64."""
        dim, lanes, kinds = plan.dim, plan.lanes, range(len(plan.links))
        n, s, m = max(capacity.particles, 1), max(capacity.springs, 1), max(capacity.cells, 1)
        self.real, self.capacity = real, capacity
        # Two trees, one per width of number: where both share a tree, Vulkan and OpenGL read f64
        # at addresses that are no multiple of 8, which are not the ones that were written.
        reals, integers = ti.FieldsBuilder(), ti.FieldsBuilder()

        def placed(tree, field, shape):
            (tree.dense(ti.i, shape) if shape else tree).place(field)
            return field

        def scalars(shape=None):
            return placed(reals, ti.field(real), shape)

        def vectors(shape=None):
            return placed(reals, ti.Vector.field(dim, real), shape)

        def counts(shape=None):
            return placed(integers, ti.field(ti.i32), shape)

        def count_vectors(size, shape=None):
            return placed(integers, ti.Vector.field(size, ti.i32), shape)

        def cell_vectors(shape=m):
            if lanes == 1:
                return vectors(shape)
            return placed(reals, ti.Matrix.field(dim, lanes, real), shape)

        def cell_numbers(shape=m):
            if lanes == 1:
                return scalars(shape)
            return placed(reals, ti.Vector.field(lanes, real), shape)

        def cell_counts():
            return counts(m) if lanes == 1 else count_vectors(lanes, m)

        # Cells first, so that they lie at multiples of their size, as vectors are best read.
        self.x, self.v, self.a = cell_vectors(), cell_vectors(), cell_vectors()
        self.good_x, self.good_v = cell_vectors(), cell_vectors()
        self.w = cell_numbers()
        self.particle, self.site = cell_counts(), counts(n)
        self.haloed = (self.x, self.v) if plan.dashpots else (self.x,)
        if plan.drag:
            self.viscous = cell_numbers()
        if plan.blow:
            self.push = cell_vectors()
        if plan.walls or plan.collisions:
            self.radius, self.restitution = cell_numbers(), cell_numbers()
        if plan.links:
            self.row = capacity.row
            self.link_k = [cell_numbers() for _ in kinds]
            tails = max(capacity.grids, 1) * (plan.threads + 1) * plan.depth
            given = (plan.threads * plan.ring + tails) * capacity.row if lanes > 1 else 1
            self.given = [cell_vectors(given) for _ in kinds]
            self.grid_of = counts(m)

        # What threads write at every step is kept off the cache lines of what they only read.
        counts(CACHE_LINE)
        self.arrivals = counts(COUNTER_SIZE)
        self.step, self.passed = counts(), counts()
        self.fault, self.watching = counts(), counts()
        counts(CACHE_LINE)
        self.n, self.n_cells, self.n_grids = counts(), counts(), counts()
        self.dt, self.gravity = scalars(), vectors()
        self.speed_limit = scalars()
        self.grid = count_vectors(4, max(capacity.grids, 1))
        if plan.blow:
            self.pushing = counts()
            self.pointer = vectors(3)
            self.pointer_reach, self.pointer_strength = scalars(), scalars()
        if plan.walls:
            self.low, self.high = vectors(), vectors()
        if plan.links:
            of_kinds = len(plan.links), max(capacity.grids, 1)
            self.link_rest, self.link_c, self.link_limit2 = (
                placed(reals.dense(ti.ij, of_kinds), ti.field(real), None) for _ in range(3)
            )
            if plan.fracture:
                self.link_status = [cell_counts() for _ in kinds]
                self.link_step = [cell_counts() for _ in kinds]
                self.breaking = counts(m)
        if plan.springs:
            self.n_near = counts()
            self.near, self.near_row = counts(n), counts(n + 1)
            self.far = counts(2 * s)
            each = None if plan.uniform_springs else 2 * s
            self.k, self.rest = scalars(each), scalars(each)
            if plan.dashpots:
                self.c = scalars(each)
            if plan.fracture:
                self.n_springs = counts()
                self.ends, self.half = count_vectors(2, s), count_vectors(2, s)
                self.break_length2 = scalars(None if plan.uniform_springs else s)
                self.status, self.break_step = counts(s), counts(s)
        if plan.collisions:
            self.cell_capacity = CELLS_PER_PARTICLE * n + 64
            self.block = 1024  # cells whose counts one loop iteration sums
            self.grid_size = count_vectors(dim)
            self.cell_size = scalars()
            self.cell_start = counts(self.cell_capacity + 1)
            self.cell_fill = counts(self.cell_capacity)
            self.block_start = counts(self.cell_capacity // self.block + 2)
            self.cell_of = counts(n)
            self.sorted_index = counts(n)
            self.sorted_x, self.sorted_radius = vectors(n), scalars(n)
            self.jump = cell_vectors()
        self._trees = [reals.finalize(), integers.finalize()]

    def free(self):
        """Give the device memory back; no field of this container may be used afterwards."""
        for tree in self._trees:
            tree.destroy()
