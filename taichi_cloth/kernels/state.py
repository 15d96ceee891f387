"""Fields that hold the state of a simulation on the device.

Allocated once with a capacity and refilled in place: every new container makes every kernel
compile again. Fields of features that a scene lacks are not allocated at all.
"""

from dataclasses import astuple, dataclass

import taichi as ti

from taichi_cloth.kernels.loops import COUNTER_SIZE

ALIVE, BREAKING, GONE = 0, 1, 2  # BREAKING: over its limit, pulls for one more step

WORK = FORCES, SWEEPS, UNCONVERGED = range(3)

CELLS_PER_PARTICLE = 8  # of the collision grid: more packs mean fewer comparisons, more clearing

CACHE_LINE = 32  # numbers: two lines of 64 bytes, which processors fetch in pairs


@dataclass(frozen=True)
class Capacity:
    """How much fits: particles, springs on the graph, packs, grids; packs in a row with halos."""

    particles: int
    springs: int
    packs: int
    grids: int
    row: int

    def holds(self, other: "Capacity") -> bool:
        """Whether what needs `other` fits in here."""
        return all(a >= b for a, b in zip(astuple(self), astuple(other), strict=True))


@ti.data_oriented
class State:
    """All device data of one simulation.

    Packs (`packs.py`), each value a vector of `dim` or a number for each of the pack's particles:
        x, v: position and velocity; a: acceleration of the current step;
        w: inverse mass (0 = fixed); radius, restitution (walls or collisions), viscous (drag),
        0-D where all particles share them; push (blow): force of the pointer, held for a frame;
        saved_x, saved_v: the state at the start of the frame under way, the last good one;
        x_low, v_low, saved_x_low, saved_v_low (compensated): what sums lost to rounding;
        particle: index of the particle there; slot: where particle i is.
    Springs on the graph, in both directions, as compressed rows: the p-th particle that has any
        is near[p], its half-springs are near_row[p] .. near_row[p+1], each with its far end, and
        k, rest and c (dashpots), which are 0-D where all springs have the same. What is gone has
        its own particle as its far end.
    Springs on the graph once each (fracture): ends, break_length2 (square of the length at which
        the force reaches the break force), status (ALIVE, BREAKING, GONE), break_step, half (its
        two half-springs).
    Grids: grid: first pack, rows, width in packs, whether it has links; grid_of: a pack's grid, -1
        in the empty rows; breaking: how many of a pack's links are about to go.
    Kinds of link: link: columns and rows to the other end; forward: the kinds in the order in
        which the other ends are numbered; link_rest, link_c, link_limit2 by kind and grid. One
        kind after the other (`link_index`): link_k (0 = absent or gone), link_status and
        link_step (fracture) of packs; given: what links give: rows of zeros, a ring of rows for
        each thread, then the last rows of each thread's share of each grid.
    Numbers a run may change are fields too: n, n_cells, n_grids, dt, gravity, low, high, ...; step:
        the number of the step under way, stage: which of its stages, in methods that have several.
    Solvers (`phases.py`): phase: the one that comes next; tolerance, iterations: settings; work:
        counts since the host last asked, FORCES, SWEEPS, UNCONVERGED; summed_k, summed_c: sums of the
        stiffness and damping of a particle's springs (needs "summed_springs").
        one (compensated): 1, which compilers do not know (`compensated.py`).
    Colours of springs on the graph (needs "spring_colours"; `colours.py`): those of colour k are
        colour_start[k] .. colour_start[k+1], each with its ends, spring_k, spring_rest, spring_c.
        impulse, link_impulse: a vector for each spring, for each link.
    Colours of particles with springs on the graph (needs "particle_colours"): those of colour k are
        near[coloured[i]] from i = colour_start[k] to colour_start[k+1]; own: 0 for those, 1 for
        others.
    """

    def __init__(self, spec, real, capacity, method=None):
        """Allocate. real: ti.f32 or ti.f64; method: the module of a method, whose VECTORS,
        LOW_VECTORS, HALOED, SUMS, SCALARS, COUNTS and NEEDS get room.
        """
        vectors, haloed = getattr(method, "VECTORS", ()), getattr(method, "HALOED", ())
        needs = getattr(method, "NEEDS", ())
        dim, lanes, kinds = spec.dim, spec.lanes, spec.kinds
        n, s, m = max(capacity.particles, 1), max(capacity.springs, 1), max(capacity.packs, 1)
        self.real, self.capacity, self.packs = real, capacity, m
        # Two trees, one per width of number: where both share a tree, Vulkan and OpenGL read f64
        # at addresses that are no multiple of 8, which are not the ones that were written.
        reals, integers = ti.FieldsBuilder(), ti.FieldsBuilder()

        def scalars(*shape):
            return _placed(reals, ti.field(real), *shape)

        def counts(*shape):
            return _placed(integers, ti.field(ti.i32), *shape)

        def pack_vectors(m=m):
            return self._pack_vectors(spec, reals, m)

        def pack_numbers(m=m):
            return scalars(m) if lanes == 1 else scalars(m, lanes)

        def pack_counts(m=m):
            return counts(m) if lanes == 1 else counts(m, lanes)

        # Packs first, so that they lie at multiples of their size, as vectors are best read.
        self.x, self.v, self.a = pack_vectors(), pack_vectors(), pack_vectors()
        self.saved_x, self.saved_v = pack_vectors(), pack_vectors()
        if spec.compensated:
            self.x_low, self.v_low = pack_vectors(), pack_vectors()
            self.saved_x_low, self.saved_v_low = pack_vectors(), pack_vectors()
            vectors = (*vectors, *getattr(method, "LOW_VECTORS", ()))
        for name in vectors:
            setattr(self, name, pack_vectors())
        self.w = pack_numbers()
        self.particle, self.slot = pack_counts(), counts(n)
        self.haloed = (self.x, self.v) if spec.dashpots else (self.x,)
        self.haloed += tuple(getattr(self, name) for name in haloed)
        if "summed_springs" in needs:
            self.summed_k, self.summed_c = pack_numbers(), pack_numbers()
        if spec.compensated:
            self.haloed = (*self.haloed, self.x_low)
        coloured = "spring_colours" in needs
        if "particle_colours" in needs and spec.springs:
            self.own = pack_numbers()
            self.n_colours, self.colour_start, self.coloured = counts(), counts(n + 1), counts(n)
        if coloured and spec.links:
            self.link_impulse = pack_vectors(kinds * m)
        if coloured and spec.springs:
            self.impulse = scalars(s, dim)
        particle_numbers = scalars if spec.uniform_particles else pack_numbers
        if spec.drag:
            self.viscous = particle_numbers()
        if spec.blow:
            self.push = pack_vectors()
        if spec.walls or spec.collisions:
            self.radius, self.restitution = particle_numbers(), particle_numbers()
        if spec.links:
            self.row = capacity.row
            self.link, self.forward = counts(kinds, 2), counts(kinds)
            self.link_k = pack_numbers(kinds * m)
            tails = max(capacity.grids, 1) * (spec.threads + 1) * spec.depth
            ring_forces = (
                (spec.threads * spec.ring_depth + tails) * capacity.row if lanes > 1 else 1
            )
            self.ring_size = ring_forces
            self.ring_forces = pack_vectors(kinds * ring_forces)
            self.grid_of = counts(m)

        # What threads write at every step is kept off the cache lines of what they only read.
        counts(CACHE_LINE)
        self.arrivals = counts(COUNTER_SIZE)
        self.step, self.stage, self.passed = counts(), counts(), counts()
        self.phase, self.work = counts(), counts(len(WORK))
        self.fault, self.watching = counts(), counts()
        counts(CACHE_LINE)
        self.n, self.n_packs, self.n_grids = counts(), counts(), counts()
        self.dt, self.gravity = scalars(), scalars(dim)
        self.speed_limit = scalars()
        self.tolerance, self.iterations = scalars(), counts()
        for name in getattr(method, "SCALARS", ()):
            setattr(self, name, scalars())
        for name in getattr(method, "COUNTS", ()):
            setattr(self, name, counts())
        if spec.compensated:
            self.one = scalars()
        self.grid = counts(max(capacity.grids, 1), 4)
        if spec.blow:
            self.pushing = counts()
            self.pointer = scalars(3, dim)
            self.pointer_reach, self.pointer_strength = scalars(), scalars()
        if spec.walls:
            self.low, self.high = scalars(dim), scalars(dim)
        if spec.links:
            of_kinds = spec.kinds, max(capacity.grids, 1)
            self.link_rest, self.link_c, self.link_limit2 = (scalars(*of_kinds) for _ in range(3))
            if spec.fracture:
                self.link_status, self.link_step = pack_counts(kinds * m), pack_counts(kinds * m)
                self.breaking = counts(m)
        if spec.springs:
            self.n_csr_rows = counts()
            self.csr_slot, self.csr_start = counts(n), counts(n + 1)
            self.csr_other = counts(2 * s)
            each = () if spec.uniform_springs else (2 * s,)
            self.csr_k, self.csr_rest = scalars(*each), scalars(*each)
            if spec.dashpots:
                self.csr_c = scalars(*each)
            if spec.fracture or coloured:
                self.ends = counts(s, 2)
            if coloured:
                self.n_colours, self.colour_start = counts(), counts(s + 1)
                own = () if spec.uniform_springs else (s,)
                self.spring_k, self.spring_rest = scalars(*own), scalars(*own)
                if spec.dashpots:
                    self.spring_c = scalars(*own)
            if spec.fracture:
                self.n_springs = counts()
                self.half = counts(s, 2)
                self.break_length2 = scalars(*([] if spec.uniform_springs else [s]))
                self.status, self.break_step = counts(s), counts(s)
        if spec.collisions:
            self.cell_capacity = CELLS_PER_PARTICLE * n + 64
            self.block = 1024  # packs whose counts one loop iteration sums
            self.grid_size = counts(dim)
            self.cell_size = scalars()
            self.cell_start = counts(self.cell_capacity + 1)
            self.cell_fill = counts(self.cell_capacity)
            self.block_start = counts(self.cell_capacity // self.block + 2)
            self.cell_of = counts(n)
            self.sorted_index = counts(n)
            self.sorted_x, self.sorted_radius = scalars(n, dim), scalars(n)
            self.jump = pack_vectors()
        self._trees = [reals.finalize(), integers.finalize()]
        if sums := getattr(method, "SUMS", 0):
            self.add_sums(sums)

    def add_vectors(self, spec, name, haloed=False):
        """A further field of packs for a method: one vector a particle, state.<name>.

        haloed: whether what a particle has there is read by those it is tied to.
        """
        field = self._pack_vectors(spec, tree := ti.FieldsBuilder(), self.packs)
        self._trees.append(tree.finalize())
        setattr(self, name, field)
        if haloed:
            self.haloed = (*self.haloed, field)

    def add_sums(self, count):
        """Room for `count` sums by `loops.add_up`: sums[k, 0], and their parts after it."""
        self.sums = _placed(tree := ti.FieldsBuilder(), ti.field(self.real), count, self.packs + 1)
        self._trees.append(tree.finalize())

    def _pack_vectors(self, spec, tree, packs):
        if spec.lanes == 1:
            return _placed(tree, ti.Vector.field(spec.dim, self.real), packs)
        return _placed(tree, ti.field(self.real), packs, spec.dim * spec.lanes)

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
