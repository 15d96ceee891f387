"""The specialization of a run: the scene's features, the storage, the way of loops."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Specialization:
    """The switches of one compilation; specializations that are equal share their kernels.

    dim, uniform_springs, uniform_particles, fracture, walls, floor, collisions: features of the
        scene, as in `scene.features.Features`.
    obstacles: the shapes of its obstacles, ground and resting walls included (`obstacles/`).
    moving: whether any of them moves. faces: whether any is so thin that the faces of triangles are
        tested against it (`faces.py`).
    terms: the names of its forces (`forces/`), in the order in which they are added up.
    springs: whether there are springs on the graph: all of them, or those that no grid holds.
    held: whether fixed particles may go with obstacles that move (`grips.py`).
    resting: whether pairs that collide rest on each other (`resting_pairs.py`). thick: whether some
        are of cloths with a thickness, whose triangles must not intersect.
    lanes: how many particles a pack has (`packs.py`); 1 on GPUs, and on a graph whose rows are not
        packed.
    links: (columns, rows) from the earlier end to the later one, for each kind of link; empty on a
        graph.
    lines: (columns, rows) from each particle to the next, for each kind of line along which grids
        have stencils (`stencils.py`).
    stencils: whether there are other stencils, which are listed on the graph.
    keeps_pulls: whether sweeps over particles keep the pulls of those (`stencils.with_listed`).
    rows_share_stiffness: whether all rows of each grid, but the last ones, have the same links with
        the same stiffness, none of which breaks.
    compensated: whether positions and velocities have low parts (`compensated.py`).
    together: whether several springs of a particle on the graph are computed at once (`graph.py`).
    packed_rows: whether packs are particles of a graph that follow each other in memory, and their
        half-springs lie in columns (`graph.py`).
    blocks_on_graph: whether solvers move blocks of a graph's particles (`solvers/two_levels.py`).
    accounts_contacts: whether an account of what contacts do can be kept (`contact_account.py`).
    threads, blocks, one_launch_per_step: how loops are run (`loops.py`).
    """

    dim: int
    springs: bool
    uniform_springs: bool
    uniform_particles: bool
    fracture: bool
    walls: tuple[tuple[int, int], ...]
    floor: bool
    collisions: bool
    terms: tuple[str, ...]
    obstacles: tuple[str, ...] = ()
    resting: bool = False
    thick: bool = False
    moving: bool = False
    held: bool = False
    faces: bool = False
    lanes: int = 1
    links: tuple[tuple[int, int], ...] = ()
    lines: tuple[tuple[int, int], ...] = ()
    stencils: bool = False
    keeps_pulls: bool = False
    rows_share_stiffness: bool = False
    compensated: bool = False
    together: bool = False
    packed_rows: bool = False
    blocks_on_graph: bool = False
    accounts_contacts: bool = False
    threads: int = 1
    blocks: int = 0
    one_launch_per_step: bool = False

    def can_run(self, other: "Specialization") -> bool:
        """True if kernels of this specialization can run what needs the specialization `other`.

        They can if they lack nothing, and if what they have besides has no effect.
        """
        mine, theirs = vars(self), vars(other)
        wider = ("springs", "fracture")
        closer = (  # what a specialization relies on
            "uniform_springs",
            "uniform_particles",
            "rows_share_stiffness",
        )
        others = {*wider, *closer, "terms", "blocks_on_graph"}  # which only takes less time
        same = all(mine[name] == theirs[name] for name in mine.keys() - others)
        return (
            same
            and set(mine["terms"]) >= set(theirs["terms"])
            and all(mine[name] or not theirs[name] for name in wider)
            and all(theirs[name] or not mine[name] for name in closer)
        )

    @property
    def passes_over_rows(self) -> bool:
        """True if packs are strips of grids, whose links are computed row by row (`links.py`)."""
        return self.lanes > 1 and not self.packed_rows

    @property
    def only_links(self) -> bool:
        """True if all that acts between particles that follow each other are links of strips."""
        others = self.springs or self.stencils or self.lines
        return self.passes_over_rows and bool(self.links) and not others

    @property
    def keeps_begun(self) -> bool:
        """True if contacts that end a step look at where it began (`settling.py`)."""
        return bool(self.obstacles or self.thick)

    @property
    def has_bodies(self) -> bool:
        """True if particles have a radius and a restitution."""
        return bool(self.walls or self.collisions or self.obstacles)

    @property
    def kinds(self) -> int:
        """The number of kinds of link."""
        return len(self.links)

    @property
    def line_kinds(self) -> int:
        """The number of kinds of line."""
        return len(self.lines)

    @property
    def _reaches(self) -> tuple[tuple[int, int], ...]:
        """(columns, rows) from the earliest to the last particle of every kind of link and line."""
        return (*self.links, *((2 * c, 2 * r) for c, r in self.lines))

    @property
    def reach(self) -> int:
        """The most columns that a link or line reaches, to either side."""
        return max((abs(c) for c, _ in self._reaches), default=0)

    @property
    def halo(self) -> int:
        """The halo packs on each side of a row; 0 where a pack is one particle."""
        return self.reach if self.lanes > 1 else 0

    @property
    def left_reach(self) -> int:
        """The most columns that links reach to the left; 0 where there are no halos."""
        return max((-c for c, _ in self._reaches), default=0) if self.halo else 0

    @property
    def right_reach(self) -> int:
        """The most columns that links reach to the right; 0 where there are no halos."""
        return max((c for c, _ in self._reaches), default=0) if self.halo else 0

    @property
    def depth(self) -> int:
        """The most rows that a link or line reaches down."""
        return max((r for _, r in self._reaches), default=0)

    @property
    def ring_depth(self) -> int:
        """The rows of a thread's ring (`links.pass_over_rows`), a power of two.

        It is larger than depth + 1, so that the row after these has room, too.
        """
        return 1 << (self.depth + 1).bit_length()

    @property
    def forward(self) -> tuple[int, ...]:
        """The kinds of link in the order in which their later ends are numbered."""
        return tuple(sorted(range(len(self.links)), key=lambda s: self.links[s][::-1]))
