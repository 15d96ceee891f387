"""Fields that hold the state of a simulation on the device.

Allocated once with a capacity and refilled in place: every new container makes every kernel
compile again. Fields of features that a scene lacks are not allocated at all.
"""

from dataclasses import astuple, dataclass

import taichi as ti

from taichi_cloth.kernels.loops import COUNTER_SIZE

ALIVE, BREAKING, GONE = 0, 1, 2  # BREAKING: over its limit, pulls for one more step

WORK = FORCES, SWEEPS, UNCONVERGED = range(3)

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
        w: inverse mass (0 = fixed); radius, restitution (walls or collisions), viscous (drag),
        0-D where all particles share them; push (blow): force of the pointer, held for a frame;
        good_x, good_v: the state at the start of the frame under way, the last good one;
        x_low, v_low, good_x_low, good_v_low (compensated): what sums lost to rounding;
        particle: index of the particle there; site: where particle i is.
    Springs on the graph, in both directions, as compressed rows: the p-th particle that has any
        is near[p], its half-springs are near_row[p] .. near_row[p+1], each with its far end, and
        k, rest and c (dashpots), which are 0-D where all springs have the same. What is gone has
        its own particle as its far end.
    Springs on the graph once each (fracture): ends, break_length2 (square of the length at which
        the force reaches the break force), status (ALIVE, BREAKING, GONE), break_step, half (its
        two half-springs).
    Grids: grid: first cell, rows, width in cells, whether it has links; grid_of: a cell's grid, -1
        in the empty rows; breaking: how many of a cell's links are about to go.
    Kinds of link: link: columns and rows to the other end; forward: the kinds in the order in
        which the other ends are numbered; link_rest, link_c, link_limit2 by kind and grid. One
        kind after the other (`lanes.of_kind`): link_k (0 = absent or gone), link_status and
        link_step (fracture) of cells; given: what links give: rows of zeros, a ring of rows for
        each thread, then the last rows of each thread's share of each grid.
    Numbers a run may change are fields too: n, n_cells, n_grids, dt, gravity, low, high, ...; step:
        the number of the step under way, stage: which of its stages, in methods that have several.
    Solvers (`phases.py`): phase: the one that comes next; tolerance, iterations: settings; work:
        counts since the host last asked, FORCES, SWEEPS, UNCONVERGED; near_k, near_c: sums of the
        stiffness and damping of a particle's springs (needs "near").
        one (compensated): 1, which compilers do not know (`sums.py`).
    Colours of springs on the graph (needs "spring_colours"; `colours.py`): those of colour k are
        colour_start[k] .. colour_start[k+1], each with its ends, spring_k, spring_rest, spring_c.
        impulse, link_impulse: a vector for each spring, for each link.
    Colours of particles with springs on the graph (needs "particle_colours"): those of colour k are
        near[coloured[i]] from i = colour_start[k] to colour_start[k+1]; own: 0 for those, 1 for
        others.
    """

    def __init__(self, plan, real, capacity, method=None):
        """Allocate. real: ti.f32 or ti.f64; method: the module of a method, whose VECTORS,
        LOW_VECTORS, HALOED, SUMS, SCALARS, COUNTS and NEEDS get room.
        """
        vectors, haloed = getattr(method, "VECTORS", ()), getattr(method, "HALOED", ())
        needs = getattr(method, "NEEDS", ())
        dim, lanes, kinds = plan.dim, plan.lanes, plan.kinds
        n, s, m = max(capacity.particles, 1), max(capacity.springs, 1), max(capacity.cells, 1)
        self.real, self.capacity, self.cells = real, capacity, m
        # Two trees, one per width of number: where both share a tree, Vulkan and OpenGL read f64
        # at addresses that are no multiple of 8, which are not the ones that were written.
        reals, integers = ti.FieldsBuilder(), ti.FieldsBuilder()

        def scalars(*shape):
            return _placed(reals, ti.field(real), *shape)

        def counts(*shape):
            return _placed(integers, ti.field(ti.i32), *shape)

        def cell_vectors(m=m):
            return self._cell_vectors(plan, reals, m)

        def cell_numbers(m=m):
            return scalars(m) if lanes == 1 else scalars(m, lanes)

        def cell_counts(m=m):
            return counts(m) if lanes == 1 else counts(m, lanes)

        # Cells first, so that they lie at multiples of their size, as vectors are best read.
        self.x, self.v, self.a = cell_vectors(), cell_vectors(), cell_vectors()
        self.good_x, self.good_v = cell_vectors(), cell_vectors()
        if plan.compensated:
            self.x_low, self.v_low = cell_vectors(), cell_vectors()
            self.good_x_low, self.good_v_low = cell_vectors(), cell_vectors()
            vectors = (*vectors, *getattr(method, "LOW_VECTORS", ()))
        for name in vectors:
            setattr(self, name, cell_vectors())
        self.w = cell_numbers()
        self.particle, self.site = cell_counts(), counts(n)
        self.haloed = (self.x, self.v) if plan.dashpots else (self.x,)
        self.haloed += tuple(getattr(self, name) for name in haloed)
        if "near" in needs:
            self.near_k, self.near_c = cell_numbers(), cell_numbers()
        if plan.compensated:
            self.haloed = (*self.haloed, self.x_low)
        coloured = "spring_colours" in needs
        if "particle_colours" in needs and plan.springs:
            self.own = cell_numbers()
            self.n_colours, self.colour_start, self.coloured = counts(), counts(n + 1), counts(n)
        if coloured and plan.links:
            self.link_impulse = cell_vectors(kinds * m)
        if coloured and plan.springs:
            self.impulse = scalars(s, dim)
        particle_numbers = scalars if plan.uniform_particles else cell_numbers
        if plan.drag:
            self.viscous = particle_numbers()
        if plan.blow:
            self.push = cell_vectors()
        if plan.walls or plan.collisions:
            self.radius, self.restitution = particle_numbers(), particle_numbers()
        if plan.links:
            self.row = capacity.row
            self.link, self.forward = counts(kinds, 2), counts(kinds)
            self.link_k = cell_numbers(kinds * m)
            tails = max(capacity.grids, 1) * (plan.threads + 1) * plan.depth
            given = (plan.threads * plan.ring + tails) * capacity.row if lanes > 1 else 1
            self.given_size = given
            self.given = cell_vectors(kinds * given)
            self.grid_of = counts(m)

        # What threads write at every step is kept off the cache lines of what they only read.
        counts(CACHE_LINE)
        self.arrivals = counts(COUNTER_SIZE)
        self.step, self.stage, self.passed = counts(), counts(), counts()
        self.phase, self.work = counts(), counts(len(WORK))
        self.fault, self.watching = counts(), counts()
        counts(CACHE_LINE)
        self.n, self.n_cells, self.n_grids = counts(), counts(), counts()
        self.dt, self.gravity = scalars(), scalars(dim)
        self.speed_limit = scalars()
        self.tolerance, self.iterations = scalars(), counts()
        for name in getattr(method, "SCALARS", ()):
            setattr(self, name, scalars())
        for name in getattr(method, "COUNTS", ()):
            setattr(self, name, counts())
        if plan.compensated:
            self.one = scalars()
        self.grid = counts(max(capacity.grids, 1), 4)
        if plan.blow:
            self.pushing = counts()
            self.pointer = scalars(3, dim)
            self.pointer_reach, self.pointer_strength = scalars(), scalars()
        if plan.walls:
            self.low, self.high = scalars(dim), scalars(dim)
        if plan.links:
            of_kinds = plan.kinds, max(capacity.grids, 1)
            self.link_rest, self.link_c, self.link_limit2 = (scalars(*of_kinds) for _ in range(3))
            if plan.fracture:
                self.link_status, self.link_step = cell_counts(kinds * m), cell_counts(kinds * m)
                self.breaking = counts(m)
        if plan.springs:
            self.n_near = counts()
            self.near, self.near_row = counts(n), counts(n + 1)
            self.far = counts(2 * s)
            each = () if plan.uniform_springs else (2 * s,)
            self.k, self.rest = scalars(*each), scalars(*each)
            if plan.dashpots:
                self.c = scalars(*each)
            if plan.fracture or coloured:
                self.ends = counts(s, 2)
            if coloured:
                self.n_colours, self.colour_start = counts(), counts(s + 1)
                own = () if plan.uniform_springs else (s,)
                self.spring_k, self.spring_rest = scalars(*own), scalars(*own)
                if plan.dashpots:
                    self.spring_c = scalars(*own)
            if plan.fracture:
                self.n_springs = counts()
                self.half = counts(s, 2)
                self.break_length2 = scalars(*([] if plan.uniform_springs else [s]))
                self.status, self.break_step = counts(s), counts(s)
        if plan.collisions:
            self.cell_capacity = CELLS_PER_PARTICLE * n + 64
            self.block = 1024  # cells whose counts one loop iteration sums
            self.grid_size = counts(dim)
            self.cell_size = scalars()
            self.cell_start = counts(self.cell_capacity + 1)
            self.cell_fill = counts(self.cell_capacity)
            self.block_start = counts(self.cell_capacity // self.block + 2)
            self.cell_of = counts(n)
            self.sorted_index = counts(n)
            self.sorted_x, self.sorted_radius = scalars(n, dim), scalars(n)
            self.jump = cell_vectors()
        self._trees = [reals.finalize(), integers.finalize()]
        if sums := getattr(method, "SUMS", 0):
            self.add_sums(sums)

    def add_vectors(self, plan, name, haloed=False):
        """A further field of cells for a method: one vector a particle, state.<name>.

        haloed: whether what a particle has there is read by those it is tied to.
        """
        of = self._cell_vectors(plan, tree := ti.FieldsBuilder(), self.cells)
        self._trees.append(tree.finalize())
        setattr(self, name, of)
        if haloed:
            self.haloed = (*self.haloed, of)

    def add_sums(self, count):
        """Room for `count` sums by `loops.add_up`: sums[k, 0], and their parts after it."""
        self.sums = _placed(tree := ti.FieldsBuilder(), ti.field(self.real), count, self.cells + 1)
        self._trees.append(tree.finalize())

    def _cell_vectors(self, plan, tree, cells):
        if plan.lanes == 1:
            return _placed(tree, ti.Vector.field(plan.dim, self.real), cells)
        return _placed(tree, ti.field(self.real), cells, plan.dim * plan.lanes)

    def free(self):
        """Give the device memory back; no field of this container may be used afterwards."""
        for tree in self._trees:
            tree.destroy()


def _placed(tree, field, *shape):
    """The field, placed in a tree: one axis inside the other."""
    for axis, size in zip((ti.i, ti.j), shape, strict=False):
        tree = tree.dense(axis, size)
    tree.place(field)
    return field
