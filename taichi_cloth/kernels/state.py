"""Fields that hold the state of a simulation on the device.

Allocated once with a capacity and refilled in place: every new container makes every kernel
compile again. Fields of features that a scene lacks are not allocated at all.
"""

import taichi as ti

ALIVE, BREAKING, GONE = 0, 1, 2  # BREAKING: over its limit, pulls for one more step


@ti.data_oriented
class State:
    """All device data of one simulation.

    Particles (capacity rows, the first n in use):
        x, v: position and velocity, vectors of `dim`; a: acceleration of the current step;
        w: inverse mass (0 = fixed); radius, restitution (walls or collisions);
        viscous (drag); push (blow): force of the pointer, held through a frame;
        good_x, good_v: the state at the start of the frame under way, the last good one.
    Springs in both directions, as compressed rows: particle i's half-springs are
        row[i] .. row[i+1], each with its far end, k, rest and c (dashpots).
    Springs once each (fracture): ends, break_length2 (square of the length at which the force
        reaches the break force), status (ALIVE, BREAKING, GONE), break_frame, half (its two
        half-springs).
    Numbers a run may change are 0-D fields: n, n_springs, dt, gravity, low, high, ...
    """

    def __init__(self, features, real, particle_capacity, spring_capacity):
        """Allocate. real: ti.f32 or ti.f64; capacities: how many particles and springs fit."""
        dim, n, s = features.dim, max(particle_capacity, 1), max(spring_capacity, 1)
        self.real = real
        self.particle_capacity, self.spring_capacity = n, s

        def vectors(*shape):
            return ti.Vector.field(dim, real, shape)

        self.n = ti.field(ti.i32, ())
        self.dt = ti.field(real, ())
        self.gravity = vectors()
        self.x, self.v, self.a = vectors(n), vectors(n), vectors(n)
        self.w = ti.field(real, n)
        self.good_x, self.good_v = vectors(n), vectors(n)
        self.speed_limit = ti.field(real, ())
        self.fault = ti.field(ti.i32, ())

        if features.drag:
            self.viscous = ti.field(real, n)
        if features.blow:
            self.push = vectors(n)
        if features.walls:
            self.low, self.high = vectors(), vectors()
        if features.walls or features.collisions:
            self.radius, self.restitution = ti.field(real, n), ti.field(real, n)
        if features.springs:
            self.row = ti.field(ti.i32, n + 1)
            self.far = ti.field(ti.i32, 2 * s)
            self.k, self.rest = ti.field(real, 2 * s), ti.field(real, 2 * s)
            if features.dashpots:
                self.c = ti.field(real, 2 * s)
        if features.fracture:
            self.n_springs = ti.field(ti.i32, ())
            self.ends, self.half = ti.Vector.field(2, ti.i32, s), ti.Vector.field(2, ti.i32, s)
            self.break_length2 = ti.field(real, s)
            self.status, self.break_frame = ti.field(ti.i32, s), ti.field(ti.i32, s)
        if features.collisions:
            self.cell_capacity = 4 * n + 64
            self.block = 1024  # cells whose counts one loop iteration sums
            self.grid_size = ti.Vector.field(dim, ti.i32, ())
            self.cell_size = ti.field(real, ())
            self.cell_start = ti.field(ti.i32, self.cell_capacity + 1)
            self.cell_fill = ti.field(ti.i32, self.cell_capacity)
            self.block_start = ti.field(ti.i32, self.cell_capacity // self.block + 2)
            self.cell_of = ti.field(ti.i32, n)
            self.sorted_index = ti.field(ti.i32, n)
            self.sorted_x, self.sorted_radius = vectors(n), ti.field(real, n)
            self.jump = vectors(n)
