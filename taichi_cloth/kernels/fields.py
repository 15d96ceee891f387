"""Parts of a state: fields in their trees, how much fits into them, and triangles."""

from dataclasses import astuple, dataclass

import taichi as ti

from taichi_cloth.kernels.lane_memory import open_lane_memory
from taichi_cloth.kernels.memory import Memory


def memory_of(owner):
    """The `memory.Memory` of the trees of an object's fields; None: the device is no processor."""
    if ti.cfg.arch != ti.cpu:
        return None
    return Memory(field for field in vars(owner).values() if isinstance(field, ti.Field))


def placed(tree, field, *shape):
    """The field, after it was placed in a tree with one axis inside the other."""
    for axis, size in zip((ti.i, ti.j), shape, strict=False):
        tree = tree.dense(axis, size)
    tree.place(field)
    return field


@dataclass(frozen=True)
class Capacity:
    """The room in a `State`.

    particles; springs: those on the graph; columns: of packed rows, and copies:
    those of them that need any (`graph.py`); packs, the empty
    ones included; grids; row: packs in the
    widest row, with its halos; triangles: those of which the scene's forces know; elements: what is
    tested against sharp obstacles (`faces.py`); obstacles; nodes: of their grids; stencils,
    stencil_particles, stencil_sides: those that are listed, all of their particles, and the
    springs they need; closer: pairs that keep less than their radii, from both ends;
    patches: of particles that are compared as one (`scene.spheres`).
    """

    particles: int
    springs: int
    packs: int
    grids: int
    row: int
    columns: int = 0
    copies: int = 0
    triangles: int = 0
    elements: int = 0
    obstacles: int = 0
    nodes: int = 0
    stencils: int = 0
    stencil_particles: int = 0
    stencil_sides: int = 0
    closer: int = 0
    patches: int = 0

    def holds(self, other: "Capacity") -> bool:
        """True if what needs the capacity `other` fits into this one."""
        return all(a >= b for a, b in zip(astuple(self), astuple(other), strict=True))


class Fields:
    """Places fields in two trees, one per width of number.

    Where both share a tree, Vulkan and OpenGL read f64 at addresses that are no multiple of 8,
    which are not the ones that were written.

    real, raised: ti.f32 or ti.f64: type of numbers, and of those that threads raise (`_raised`).
    capacity: a `Capacity`; packs: how many there is room for.
    number_names, count_names, vector_names, particle_names: of the fields that the host loads.
    by_component: the fields of vectors that lie so (`packs.py`), and how many slots each has.
    """

    def __init__(self, real, capacity):
        self.real, self.capacity = real, capacity
        # Shaders of OpenGL have no atomics of f64.
        self.raised = ti.f32 if ti.cfg.arch == ti.opengl else real
        self.packs = max(capacity.packs, 1)
        self.number_names, self.count_names = [], []
        self.particle_names, self.vector_names = [], []
        self.by_component = []
        self._reals, self._integers = ti.FieldsBuilder(), ti.FieldsBuilder()
        self._lanes, self._in_lanes = None, []  # a tree of packs of several lanes, and its fields
        self.batches = {}  # of fields that are filled at once (`transfer.py`)

    def _scalars(self, *shape):
        return placed(self._reals, ti.field(self.real), *shape)

    def _raised(self, *shape):
        """Place numbers that many threads raise at once (`loops.raise_to`)."""
        return placed(self._reals, ti.field(self.raised), *shape)

    def _counts(self, *shape):
        return placed(self._integers, ti.field(ti.i32), *shape)

    def _pack_vectors(self, spec, packs=None, tree=None, copied=False):
        """Place a field of vectors; copied: with room for copies, where rows are packed.

        tree: its own, or that of all.
        """
        packs = packs or self.packs
        if spec.lanes == 1:
            return placed(tree or self._reals, ti.Vector.field(spec.dim, self.real), packs)
        if spec.packed_rows:  # all first components, then all second ones
            room = (packs + self.capacity.copies * copied) * spec.lanes
            field = placed(tree or self._reals, ti.field(self.real), spec.dim * room)
            self.by_component.append((field, room))
            return field
        return self._packs_of_lanes(packs, spec.dim * spec.lanes, tree)

    def _pack_numbers(self, spec, packs=None):
        packs = packs or self.packs
        return self._scalars(packs) if spec.lanes == 1 else self._packs_of_lanes(packs, spec.lanes)

    def _finalize(self, lanes):
        """Allocate the trees; a list of them. lanes: how many particles there are in a pack.

        memory is then theirs, for the host. With several lanes, lane_memory is what is in packs, as
        `lane_memory.py` says.
        """
        trees = [self._reals.finalize(), self._integers.finalize()]
        if self._in_lanes:
            trees.append(self._lanes.finalize())
        self.memory, self.lane_memory = memory_of(self), None
        if self._in_lanes:
            self.lane_memory = open_lane_memory(self.memory, self._in_lanes, lanes, self.real)
        return trees

    def _packs_of_lanes(self, packs, numbers, tree=None):
        """Place a field with so many numbers for each pack of several lanes.

        All of them are in a tree with nothing else: so each pack lies at a multiple of its
        vectors' size, where processors read them best, or at all.
        """
        if tree:
            return placed(tree, ti.field(self.real), packs, numbers)
        self._lanes = self._lanes or ti.FieldsBuilder()
        self._in_lanes.append(placed(self._lanes, ti.field(self.real), packs, numbers))
        return self._in_lanes[-1]

    def _pack_counts(self, spec, packs=None):
        packs = packs or self.packs
        return self._counts(packs) if spec.lanes == 1 else self._counts(packs, spec.lanes)

    def _particle_numbers(self, spec):
        return self._scalars() if spec.uniform_particles else self._pack_numbers(spec)


@ti.data_oriented
class Surface:
    """The triangles of a scene on the device: m of them, by slots of particles (`surfaces.py`).

    corner: (m, 3): slots; side: (m, 3): the spring between the corners k and k + 1: its number on
    the graph, -1 where there is none, or -2 - i for link i (`grids.link_index`, of slots); vector:
    (m, 3), a vector for each, whatever is summed; share: (m, 3), what each corner gets of it.
    kept: (m, KEPT), what a solver keeps of each.
    In compressed rows the triangles at each particle: row_slot, row_start, row_triangle, row_share.
    """

    # Of a triangle: two edges, half as long, times a solver's tau; the area vector; the derivatives
    # of its pressure by velocity and by area; and last the pressure.
    EDGE, OTHER_EDGE, AREA, BY_V, BY_AREA, PRESSURE = range(0, 18, 3)
    KEPT = PRESSURE + 1

    def __init__(self, real, triangles, particles, reals, integers, keeps=False):
        """Place the fields in two trees, `reals` and `integers` (`ti.FieldsBuilder`).

        keeps: whether there is `kept`.
        """
        m, self.capacity = max(triangles, 1), (triangles, particles)
        rows = max(min(particles, 3 * m), 1)
        self.vector, self.share = (placed(reals, ti.field(real), m, 3) for _ in range(2))
        self.row_share = placed(reals, ti.field(real), 3 * m)
        if keeps:
            self.kept = placed(reals, ti.field(real), m, self.KEPT)
        self.corner, self.side = (placed(integers, ti.field(ti.i32), m, 3) for _ in range(2))
        self.n_triangles, self.n_rows = (placed(integers, ti.field(ti.i32)) for _ in range(2))
        self.row_slot = placed(integers, ti.field(ti.i32), rows)
        self.row_start = placed(integers, ti.field(ti.i32), rows + 1)
        self.row_triangle = placed(integers, ti.field(ti.i32), 3 * m)

    @classmethod
    def alone(cls, real, triangles, particles):
        """One with trees of its own, which `free` gives back."""
        reals, integers = ti.FieldsBuilder(), ti.FieldsBuilder()
        surface = cls(real, triangles, particles, reals, integers)
        surface.trees = [reals.finalize(), integers.finalize()]
        surface.memory, surface.batches = memory_of(surface), {}
        return surface

    def free(self):
        """Give the device memory of one that is alone back."""
        for tree in self.trees:
            tree.destroy()
