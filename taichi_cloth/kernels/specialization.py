"""What is compiled for a run: the scene's features, its topology, and how loops are run."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Specialization:
    """The switches of one compilation; equal ones share their kernels.

    dim, uniform_springs, uniform_particles, fracture, walls, floor, collisions: the scene's, as in
        `scene.Features`; terms: names of its forces (`forces/`), in the order of their sums.
    springs: whether there are springs on the graph: all of them, or those that no grid holds.
    lanes: particles in a pack (`packs.py`); 1 on a graph and on GPUs.
    links: (columns, rows) offsets of the grid's links to later particles; empty on a graph.
    rows_share_stiffness: whether the rows of grids, but the last ones, have the same links, none of which breaks.
    compensated: whether positions and velocities have low parts (`compensated.py`).
    threads, one_launch_per_step: how loops are run (`loops.py`).
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
    lanes: int = 1
    links: tuple[tuple[int, int], ...] = ()
    rows_share_stiffness: bool = False
    compensated: bool = False
    threads: int = 1
    one_launch_per_step: bool = False

    def can_run(self, other: "Specialization") -> bool:
        """Whether kernels of this specialization run what needs `other`.

        They do where they lack nothing, and where what they have besides is without effect.
        """
        mine, theirs = vars(self), vars(other)
        wider = ("springs", "fracture")
        closer = (
            "uniform_springs",
            "uniform_particles",
            "rows_share_stiffness",
        )  # what a specialization relies on
        same = all(mine[name] == theirs[name] for name in mine.keys() - {*wider, *closer, "terms"})
        return (
            same
            and set(mine["terms"]) >= set(theirs["terms"])
            and all(mine[name] or not theirs[name] for name in wider)
            and all(theirs[name] or not mine[name] for name in closer)
        )

    @property
    def kinds(self) -> int:
        """How many kinds of link there are."""
        return len(self.links)

    @property
    def reach(self) -> int:
        """Columns that a link reaches to either side."""
        return max((abs(c) for c, _ in self.links), default=0)

    @property
    def halo(self) -> int:
        """Packs beside each row that repeat its other strips' ends; none where a pack is one."""
        return self.reach if self.lanes > 1 else 0

    @property
    def left_reach(self) -> int:
        """Columns that links reach to the left; `right_reach`: to the right."""
        return max((-c for c, _ in self.links), default=0) if self.halo else 0

    @property
    def right_reach(self) -> int:
        return max((c for c, _ in self.links), default=0) if self.halo else 0

    @property
    def depth(self) -> int:
        """Rows that a link reaches down."""
        return max((r for _, r in self.links), default=0)

    @property
    def ring_depth(self) -> int:
        """Rows of link forces that a sweep remembers: a power of two above the depth and one more,
        for those of the next row.
        """
        return 1 << (self.depth + 1).bit_length()

    @property
    def forward(self) -> tuple[int, ...]:
        """The links in the order in which their far ends are numbered."""
        return tuple(sorted(range(len(self.links)), key=lambda s: self.links[s][::-1]))
