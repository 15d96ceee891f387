"""Fields that hold the state of a simulation on the device.

Allocated once with a capacity and refilled in place: every new container makes every kernel
compile again. Fields of features that a scene lacks are not allocated at all.
"""

import taichi as ti

ALIVE, BREAKING, GONE = 0, 1, 2  # BREAKING: over its limit, pulls for one more step

CELLS_PER_PARTICLE = 8  # of the collision grid: more cells mean fewer comparisons, more clearing


@ti.data_oriented
class State:
    """All device data of one simulation.

    Particles (capacity rows, the first n in use):
        x, v: position and velocity, vectors of `dim`; a: acceleration of the current step;
        w: inverse mass (0 = fixed); radius, restitution (walls or collisions);
        viscous (drag); push (blow): force of the pointer, held through a frame;
        good_x, good_v: the state at the start of the frame under way, the last good one.
    Springs in both directions, as compressed rows: particle i's half-springs are
        row[i] .. row[i+1], each with its far end, and k, rest and c (dashpots), which are 0-D
        where all springs have the same. What is gone has its own particle as its far end.
    Springs once each (fracture): ends, break_length2 (square of the length at which the force
        reaches the break force), status (ALIVE, BREAKING, GONE), break_step, half (its two
        half-springs).
    Numbers a run may change are 0-D fields: n, n_springs, dt, gravity, low, high, ...
    """

    def __init__(self, features, real, particle_capacity, spring_capacity):
        """Allocate. real: ti.f32 or ti.f64; capacities: how many particles and springs fit."""
        dim, n, s = features.dim, max(particle_capacity, 1), max(spring_capacity, 1)
        self.real = real
        self.particle_capacity, self.spring_capacity = n, s
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

        self.n = counts()
        self.dt = scalars()
        self.gravity = vectors()
        self.x, self.v, self.a = vectors(n), vectors(n), vectors(n)
        self.w = scalars(n)
        self.good_x, self.good_v = vectors(n), vectors(n)
        self.speed_limit = scalars()
        self.fault, self.watching = counts(), counts()

        if features.drag:
            self.viscous = scalars(n)
        if features.blow:
            self.push = vectors(n)
            self.pushing = counts()
        if features.walls:
            self.low, self.high = vectors(), vectors()
        if features.walls or features.collisions:
            self.radius, self.restitution = scalars(n), scalars(n)
        if features.springs:
            self.row = counts(n + 1)
            self.far = counts(2 * s)
            each = None if features.uniform_springs else 2 * s
            self.k, self.rest = scalars(each), scalars(each)
            if features.dashpots:
                self.c = scalars(each)
        if features.fracture:
            self.n_springs = counts()
            self.ends, self.half = count_vectors(2, s), count_vectors(2, s)
            self.break_length2 = scalars(None if features.uniform_springs else s)
            self.status, self.break_step = counts(s), counts(s)
        if features.collisions:
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
            self.jump = vectors(n)
        self._trees = [reals.finalize(), integers.finalize()]

    def free(self):
        """Give the device memory back; no field of this container may be used afterwards."""
        for tree in self._trees:
            tree.destroy()
