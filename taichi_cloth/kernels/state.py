"""The fields that hold the state of a simulation on the device.

They are allocated once with a capacity and refilled in place, because for every new `State` every
kernel is compiled again. Fields of features that a scene lacks are not allocated at all.
"""

import taichi as ti

from taichi_cloth.front_end import mending
from taichi_cloth.kernels import clock
from taichi_cloth.kernels.contact_fields import ContactFields
from taichi_cloth.kernels.fields import Surface, placed
from taichi_cloth.kernels.forces import device_fields, has_tractions
from taichi_cloth.kernels.forces.contract import (
    COUNT,
    NUMBER,
    PARTICLE_NUMBER,
    PARTICLE_VECTOR,
    VECTOR,
)
from taichi_cloth.kernels.links import JOIN_ROOM
from taichi_cloth.kernels.loops import COUNTER_SIZE, is_short
from taichi_cloth.kernels.spring_numbers import NUMBERS
from taichi_cloth.kernels.springs import reads_velocity

ALIVE, BREAKING, GONE = 0, 1, 2  # of a spring; BREAKING: over its limit, pulls for one more step

# Counts of a solver's work: evaluations of all forces, sweeps (passes over all springs, by
# Gauss-Seidel or for a product with the stiffness matrix), steps that did not converge.
WORK = FORCES, SWEEPS, UNCONVERGED = range(3)

CACHE_LINE = 32  # whole numbers in two lines of 64 bytes, which processors fetch in pairs

MOST_BLOCKS = 64  # of particles, that a preconditioner moves as one (`solvers/two_levels.py`)
STIFF_ON_GRAPH = 500.0  # (tau*omega)^2, as `two_levels.STIFF`, from which blocks of a graph pay


def block_packs(spec):
    """The number of packs of blocks that there are at most."""
    return max(MOST_BLOCKS // spec.lanes, 1)


@ti.data_oriented
class State(ContactFields):
    """All device data of one simulation.

    Packs (`packs.py`): a vector (dim,) or a number for each of a pack's particles.
        x, v: position and velocity; a: acceleration of the current step; w: inverse mass (0: fixed
        or no particle); saved_x, saved_v: the last checkpoint (`watchdog.py`).
        begun_x, begun_v, begun_x_low: where the step began (`settling.py`).
        radius, restitution (walls, collisions, obstacles), and the fields that the scene's forces
        declare for particles (`forces/`): these numbers are 0-D where all particles share them.
        x_low, v_low, saved_x_low, saved_v_low (compensated): what sums lost to rounding.
        jump (collisions): change of velocity by collisions with other particles.
        particle: index of the particle in each place; slot, by that index: its slot.
        haloed: a tuple of those fields of vectors that neighbours read; haloed_motion: those of
        them that say where particles are and how they move, and not what a solver keeps.
    Springs on the graph, from both ends, in compressed rows (`graph.py`): csr_slot, csr_start,
        csr_other and csr_<letter> (`spring_numbers.py`). A spring that is gone has its own
        particle as its other end. Where rows are packed: csr_start, of columns, by pack; csr_run,
        first_copy and n_copies instead of csr_slot.
    Springs on the graph, once each (fracture): ends: their slots; shortest2, longest2: squares of
        the lengths at which the force reaches the break force (`fracture.py`); status: ALIVE,
        BREAKING or GONE; break_step: when it began to break; half: its two half-springs.
    Stencils on the graph (`stencils.py`): those of number m have the particles in the slots
        stencil_slot[e], with stencil_weight[e], e from stencil_start[m] to stencil_start[m + 1],
        and the numbers stencil_k and stencil_pull; a particle of row p has the parts row_stencil
        and row_weight, from row_stencils[p] to row_stencils[p + 1]; side, side_start (fracture):
        the springs that a stencil needs, negative for links (`fracture.py`).
    Grids (`grids.py`): grid: (grids, 4): first pack, rows, width in packs, whether it has links;
        grid_of: a pack's grid, -1 where nothing is linked; breaking (fracture): how many of the
        links that begin at a pack are BREAKING.
    Links (`links.py`): link: (kinds, 2): columns and rows to the later end, after which come those
        to the last particle along lines; forward: the kinds in
        the order in which the later ends are numbered.
        By kind and grid: link_shortest2 and link_longest2, as those of springs, and link_<letter>
        for the numbers that links of a kind and grid share.
        By kind and pack (`grids.link_index`): link_<letter> for the other numbers, link_status and
        link_step (fracture), as status and break_step are for springs.
        line, line_k: columns and rows along each kind of line, and, by kind and pack, what
        multiplies the curvature vectors of the stencils that begin there (`stencils.py`).
        ring_forces: what links and lines give their earlier ends: rows of zeros, a ring of rows
        for each thread, then the last rows of each thread's share of each grid. row, ring_size:
        packs in a row of it, and in all of it for one kind of link or line.
    Numbers that a run may change are 0-D fields: n, n_packs, n_grids, dt, ..., and those of the
        scene's forces; low, high: the world's ends; inner_low, inner_high: those of the inner box,
        in which no particle is past a wall (`contact.py`); step: the number of the step under way;
        stage: which of its stages; fault, watching: see `watchdog.py`.
    Time (`clock.py`, where something asks for it): first_time, first_time_low, first_step, dt_low;
        wide: the widest type of numbers that the device has.
    position_weight, begin, force_times, symplectic: the method's (`methods.contract.Method`).
    Triangles, where forces act on them: surface: a `Surface`; traction, traction_damping: what they
        give each particle of force, or of whatever else was summed last, and of damping.
    Solvers (`solvers/`): phase: the one that comes next; tolerance, iterations: settings; work:
        the counts `WORK` since the host last asked; summed_k, summed_c: sums of the stiffness and
        damping of a particle's springs (needs "summed_springs").
        What is kept of each link and half-spring (needs "kept_stiffness"): link_axis and
        link_across, csr_ likewise: the axis of its stiffness matrix, and its stiffness across that
        (`spring_numbers.OfStiffness`). joined: what a pass over links joins of a row.
        Where they work on two levels (`solvers/two_levels.py`): over_pivots, below: what A does to
        each particle alone, factored; block_of: a pack's coarse pack; coarse: two matrices; pivots:
        what a pack of unknowns does to itself, inverted; coarse_residual, coarse_downhill,
        coarse_product, coarse_solved: vectors of blocks, and one that stays 0. In grids: blocks:
        (grids, 3): first coarse pack, rows and columns of them; holds_fixed: whether any of a pack
        is fixed. On a graph: graph_blocks: how many there are; those of block b have the
        particles in the slots members[m], m from members_start[b] to members_start[b + 1].
        one (compensated): 1, which compilers do not know (`compensated.py`).
    Colours of springs on the graph (needs "spring_colours"; `solvers/colours.py`): those of colour
        k are colour_start[k] .. colour_start[k+1], each with its ends and spring_<letter>.
        impulse, link_impulse, line_impulse, stencil_impulse: a vector for each spring, link, line
        and stencil; the stencils of colour k are stencil_colour[k] .. stencil_colour[k + 1].
    Colours of particles with springs on the graph (needs "particle_colours"): those of colour k are
        in the slots csr_slot[coloured[n]], n from colour_start[k] to colour_start[k+1]; own: 0 for
        these particles, 1 for all others.
    What contacts need: see `ContactFields`.
    is_short: whether loops over what the host reads are one thread's (`loops.is_short`).

    What the host loads is listed by name: number_names, count_names, vector_names and
    particle_names.
    """

    @mending.fields_without_stacks
    def __init__(self, spec, real, capacity, method):
        """Allocate the fields that a specialization and a method need.

        spec: a `Specialization`; real: ti.f32 or ti.f64; capacity: a `Capacity`; method: a
        `methods.contract.Method`. Raises TypeError where two declare a field of the same name.
        """
        super().__init__(real, capacity)
        self.lanes = spec.lanes
        self.is_short = is_short(capacity.particles)
        self.functions = {}  # what is compiled by itself (`parts.py`)
        self.wide = ti.f32 if ti.cfg.arch == ti.metal else ti.f64
        self.position_weight, self.begin = method.position_weight, method.begin
        self.force_times, self.symplectic = method.force_times, method.claims.symplectic
        self._place_packs(spec, method)
        if spec.packed_rows:
            self._place_columns(spec)
        if spec.links:
            self._place_links_of_packs(spec, method)
        if spec.blocks_on_graph:
            self._place_blocks_on_graph(spec)
        # What threads write at every step is kept off the cache lines of what they only read.
        self._counts(CACHE_LINE)
        self._place_progress()
        self._counts(CACHE_LINE)
        self._place_numbers(spec, method)
        if spec.links:
            self._place_links_of_kinds(spec)
        if spec.springs:
            self._place_graph(spec, method)
        if spec.stencils:
            self._place_stencils(spec, method)
        if spec.collisions:
            self._place_collision_grid(spec)
        if has_tractions(spec):
            room = capacity.triangles, capacity.particles
            keeps = "kept_stiffness" in method.needs
            self.surface = Surface(real, *room, self._reals, self._integers, keeps)
        if spec.obstacles:
            self._place_obstacles(spec)
        if spec.accounts_contacts:
            self._place_account(spec)
        if spec.faces:
            self._place_faces(spec)
        self.trees = self._finalize(spec.lanes)
        if spec.accounts_contacts:
            self.trees.append(self.wide_tree)
        if method.sums + spec.accounts_contacts:
            self.add_sums(method.sums + spec.accounts_contacts)
        self._list_what_is_loaded(spec)

    def _place_packs(self, spec, method):
        """Place the fields of packs: first, so that each pack lies at a multiple of its size.

        Vectors are best read there.
        """
        vectors = list(method.vectors)
        names = ["x", "v", "a", "saved_x", "saved_v"]
        haloed = ["x", "v"] if reads_velocity(spec) else ["x"]
        if spec.compensated:
            names += ["x_low", "v_low", "saved_x_low", "saved_v_low"]
            haloed.append("x_low")
            vectors += method.low_vectors
        read_by_neighbours = {*haloed, *method.haloed}
        for name in (*names, *vectors):
            setattr(self, name, self._pack_vectors(spec, copied=name in read_by_neighbours))
        for name in method.numbers:
            setattr(self, name, self._pack_numbers(spec))
        self.w = self._pack_numbers(spec)
        self.particle = self._pack_counts(spec)
        self.slot = self._counts(max(self.capacity.particles, 1))
        self.haloed = self.haloed_motion = tuple(getattr(self, name) for name in haloed)
        self.haloed += tuple(getattr(self, name) for name in method.haloed)
        if spec.keeps_begun:
            self.begun_x, self.begun_v = self._pack_vectors(spec), self._pack_vectors(spec)
            if spec.compensated:
                self.begun_x_low = self._pack_vectors(spec)
        if "summed_springs" in method.needs:
            self.summed_k, self.summed_c = self._pack_numbers(spec), self._pack_numbers(spec)
        if "particle_colours" in method.needs and spec.springs:
            self.own = self._pack_numbers(spec)
        for field in device_fields(spec):
            if field.shape == PARTICLE_NUMBER:
                setattr(self, field.name, self._particle_numbers(spec))
                self.particle_names += [field.name] if field.value else []
            elif field.shape == PARTICLE_VECTOR:
                setattr(self, field.name, self._pack_vectors(spec))
                self.vector_names += [field.name] if field.value else []
        if spec.has_bodies:
            self.radius, self.restitution = (
                self._particle_numbers(spec),
                self._particle_numbers(spec),
            )
            self.particle_names += ["radius", "restitution"]
        if spec.held:
            self.held_by, self.held_at = self._pack_numbers(spec), self._pack_vectors(spec)
            self.particle_names.append("held_by")
            self.vector_names.append("held_at")
        if spec.thick:
            self.pair_radius = self._pack_numbers(spec)
            self.pair_restitution = self._pack_numbers(spec)
            self.particle_names += ["pair_radius", "pair_restitution"]
        if spec.collisions and not spec.resting:
            self.jump = self._pack_vectors(spec)
        if has_tractions(spec):
            self.traction, self.traction_damping = (
                self._pack_vectors(spec),
                self._pack_numbers(spec),
            )
            for name in method.traction_vectors:
                setattr(self, name, self._pack_vectors(spec))

    def _place_columns(self, spec):
        """Place packed rows, whose columns are read as packs are."""
        columns = max(self.capacity.columns, 1)
        self._place_spring_numbers(spec, "csr", columns * spec.lanes)
        copies = max(self.capacity.copies, 1)
        self.csr_other, self.csr_run = self._counts(copies * spec.lanes), self._counts(columns)
        self.csr_start = self._counts(self.packs + 1)
        self.first_copy, self.n_copies = self._counts(), self._counts()

    def _place_links_of_packs(self, spec, method):
        kinds, row = spec.kinds, self.capacity.row
        self.row = row
        self.link = self._counts(kinds + spec.line_kinds, 2)
        self.forward = self._counts(kinds)
        for number in NUMBERS:
            if number.stored(spec) and number.own(spec):
                numbers = self._pack_numbers(spec, kinds * self.packs)
                setattr(self, f"link_{number.letter}", numbers)
        if "kept_stiffness" in method.needs:
            self.link_axis = self._pack_vectors(spec, kinds * self.packs)
            self.link_across = self._pack_numbers(spec, kinds * self.packs)
            self.joined = self._pack_numbers(spec, (spec.threads + 2) * JOIN_ROOM)
            if spec.only_links:
                self._place_two_levels(spec)
                self.blocks = self._counts(max(self.capacity.grids, 1), 3)
                self.holds_fixed = self._counts(self.packs)
        if "spring_colours" in method.needs:
            self.link_impulse = self._pack_vectors(spec, kinds * self.packs)
        carried = max(self.capacity.grids, 1) * (spec.threads + 1) * spec.depth
        self.ring_size = 1
        if spec.lanes > 1:
            self.ring_size = (spec.threads * spec.ring_depth + carried) * row
        self.ring_forces = self._pack_vectors(spec, (kinds + spec.line_kinds) * self.ring_size)
        if spec.lines:
            self.line = self._counts(spec.line_kinds, 2)
            self.line_k = self._pack_numbers(spec, spec.line_kinds * self.packs)
            if "spring_colours" in method.needs:
                self.line_impulse = self._pack_vectors(spec, spec.line_kinds * self.packs)
        self.grid_of = self._counts(self.packs)
        if spec.fracture:
            self.link_status = self._pack_counts(spec, kinds * self.packs)
            self.link_step = self._pack_counts(spec, kinds * self.packs)
            self.breaking = self._counts(self.packs)

    def _place_two_levels(self, spec):
        """Place what a preconditioner keeps of particles, and of blocks of them."""
        self.over_pivots, self.below = self._pack_vectors(spec), self._pack_vectors(spec)
        blocks = block_packs(spec)
        self.coarse_residual, self.coarse_downhill, self.coarse_product, self.coarse_solved = (
            self._pack_vectors(spec, blocks + 1) for _ in range(4)
        )
        rows = blocks * spec.dim
        self.coarse = self._pack_numbers(spec, 2 * rows * rows * spec.lanes)
        self.pivots = self._pack_numbers(spec, spec.lanes)
        self.block_of, self.n_blocks = self._counts(self.packs), self._counts()

    def _place_blocks_on_graph(self, spec):
        """Place the blocks of a graph's particles."""
        self._place_two_levels(spec)
        self.graph_blocks, self.members_start = self._counts(), self._counts(MOST_BLOCKS + 1)
        self.members = self._counts(max(self.capacity.particles, 1))

    def _place_progress(self):
        self.arrivals = self._counts(COUNTER_SIZE)
        self.step, self.stage, self.passed = self._counts(), self._counts(), self._counts()
        self.phase, self.work = self._counts(), self._counts(len(WORK))
        self.fault, self.watching = self._counts(), self._counts()

    def _place_numbers(self, spec, method):
        """Place the numbers of the scene and the run."""
        dim = spec.dim
        self.n, self.n_packs, self.n_grids = self._counts(), self._counts(), self._counts()
        self.n_pieces, self.n_groups = self._counts(), self._counts()
        self.grid = self._counts(max(self.capacity.grids, 1), 4)
        self.dt, self.speed_limit = self._scalars(), self._scalars()
        self.tolerance, self.least_scale = self._scalars(), self._scalars()
        self.iterations = self._counts()
        self.number_names += ["dt", "speed_limit", "tolerance", "least_scale"]
        self.count_names += ["n", "iterations"]
        for field in device_fields(spec):
            if field.shape in (NUMBER, VECTOR):
                setattr(self, field.name, self._scalars(*([dim] if field.shape == VECTOR else [])))
                self.number_names += [field.name] if field.value else []
            elif field.shape == COUNT:
                setattr(self, field.name, self._counts())
                self.count_names += [field.name] if field.value else []
        if clock.timed(spec):
            for name in clock.NUMBERS:
                setattr(self, name, self._scalars())
            for name in clock.COUNTS:
                setattr(self, name, self._counts())
            self.number_names += clock.NUMBERS
            self.count_names += clock.COUNTS
        for name in method.scalars:
            setattr(self, name, self._scalars())
        for name in method.raised:
            setattr(self, name, self._raised())
        for name in method.counts:
            setattr(self, name, self._counts())
        if spec.compensated:
            self.one = self._scalars()
            self.number_names.append("one")
        if spec.walls:
            self.low, self.high = self._scalars(dim), self._scalars(dim)
            self.inner_low, self.inner_high = self._scalars(dim), self._scalars(dim)
            self.number_names += ["low", "high", "inner_low", "inner_high"]

    def _place_links_of_kinds(self, spec):
        of_kinds = spec.kinds, max(self.capacity.grids, 1)
        for number in NUMBERS:
            if number.stored(spec) and not number.own(spec):
                setattr(self, f"link_{number.letter}", self._scalars(*of_kinds))
        self.link_shortest2, self.link_longest2 = self._scalars(*of_kinds), self._scalars(*of_kinds)

    def _place_graph(self, spec, method):
        n, s = max(self.capacity.particles, 1), max(self.capacity.springs, 1)
        coloured = "spring_colours" in method.needs
        if not spec.packed_rows:
            self.n_csr_rows = self._counts()
            self.csr_slot, self.csr_start = self._counts(n), self._counts(n + 1)
            self.csr_other = self._counts(2 * s)
            self._place_spring_numbers(spec, "csr", 2 * s)
        if spec.fracture or coloured:
            self.ends = self._counts(s, 2)
        if "kept_stiffness" in method.needs:
            self.csr_axis = self._scalars(2 * s, spec.dim)
            self.csr_across = self._scalars(2 * s)
        if coloured or "particle_colours" in method.needs:
            self.n_colours = self._counts()
            self.colour_start = self._counts(max(n, s) + 1)
        if coloured:
            self._place_spring_numbers(spec, "spring", s)
            self.impulse = self._scalars(s, spec.dim)
        if "particle_colours" in method.needs:
            self.coloured = self._counts(n)
        if spec.fracture:
            self.n_springs = self._counts()
            self.half = self._counts(s, 2)
            lengths = [] if spec.uniform_springs else [s]
            self.shortest2, self.longest2 = self._scalars(*lengths), self._scalars(*lengths)
            self.status, self.break_step = self._counts(s), self._counts(s)

    def _place_stencils(self, spec, method):
        n, capacity = max(self.capacity.particles, 1), self.capacity
        m, k = max(capacity.stencils, 1), max(capacity.stencil_particles, 1)
        self.n_stencils, self.stencil_start = self._counts(), self._counts(m + 1)
        self.stencil_slot, self.stencil_weight = self._counts(k), self._scalars(k)
        self.stencil_k, self.stencil_pull = self._scalars(m), self._scalars(m, spec.dim)
        self.row_stencils = self._counts(n + 1)
        self.row_stencil, self.row_weight = self._counts(k), self._scalars(k)
        if spec.fracture:
            self.side_start = self._counts(m + 1)
            self.side = self._counts(max(capacity.stencil_sides, 1))
        if "spring_colours" in method.needs:
            self.n_stencil_colours, self.stencil_colour = self._counts(), self._counts(m + 1)
            self.stencil_impulse = self._scalars(m, spec.dim)

    def _place_spring_numbers(self, spec, place, count):
        for number in NUMBERS:
            if number.stored(spec):
                own = () if spec.uniform_springs else (count,)
                setattr(self, f"{place}_{number.letter}", self._scalars(*own))

    def __setattr__(self, name, value):
        """Take up a field by the name that a method, a force or a function above gave it.

        Raises TypeError where there is already a field of this name.
        """
        if isinstance(value, ti.Field) and hasattr(self, name):
            raise TypeError(f"two things store a field called {name!r}; rename one of them")
        super().__setattr__(name, value)

    def _list_what_is_loaded(self, spec):
        self.particle_names.insert(0, "w")
        low = ["x_low", "v_low"] if spec.compensated else []
        self.vector_names[:0] = ["x", "v", *low]

    # --- more, for methods and tests -------------------------------------------------------------

    def add_sums(self, count):
        """Allocate state.sums for `count` sums by `loops.add_up`: sums[k, 0], then its parts."""
        room = self.packs + 3  # few packs make as many pieces, and a group of these
        self.sums = placed(tree := ti.FieldsBuilder(), ti.field(self.real), count, room)
        self.trees.append(tree.finalize())

    def free(self):
        """Give the device memory back; no field of this state may be used afterwards."""
        for tree in self.trees:
            tree.destroy()
