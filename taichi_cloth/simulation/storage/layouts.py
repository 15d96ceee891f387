"""Layouts of particles and springs: on a graph, or on regular grids in packs (NumPy).

A pack holds several particles side by side, its width in number, each in a slot of its own.
`kernels/packs.py` draws how a grid lies in its packs. On a graph, packs hold one particle each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from taichi_cloth.kernels.packs import PACKS
from taichi_cloth.kernels.spring_numbers import NUMBERS
from taichi_cloth.scene.cloth import LINKS
from taichi_cloth.scene.model import Springs
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.simulation.storage import adjacency, lines, packing

# Offsets (columns, rows) from a particle to those that come later and are tied to it.
FORWARD = tuple((-column, -row) for kind in LINKS.values() for column, row in kind)
WORTH_SORTING = 4096  # particles; fewer are in the processor's fastest caches anyway
# Particles of nets whose rows may be packed: steps of fewer are some microseconds, and packed rows
# take a second or two longer to compile.
WORTH_PACKING = 1024
LOOSE_WIDTH = 16  # packs in a row of particles that are on no grid
WORTH_LANES = 10  # one of so many springs must be a link, or lanes only add what they cost
# Rest lengths of links of one kind may differ by the rounding of the positions they come from.
SAME = 1e-11


@dataclass(frozen=True)
class Layout:
    """The layout of n particles and s springs.

    lanes: the width of packs, in particles.
    links: offsets (columns, rows) of the kinds of link, empty on a graph.
    n_packs: packs in use, empty ones included.
    slot: (n,) int32, each particle's slot: its pack times the width, plus its place in the pack.
    grid: (g, 4) int32, each grid's first pack, rows, packs in a row, and whether it has links.
    grid_of: (n_packs,) int32, each pack's grid; -1: none with links.
    kind: (s,) int, each spring's kind of link, -1 for one on the graph.
    owner: (s,) int, the slot of a link's earlier particle.
    lines: (columns, rows) along the kinds of line that have stencils; line: (m,) int, each
        stencil's kind of line, -1 for one on the graph; line_owner: (m,) int, the slot of its
        earliest particle.
    shared: by column of `Springs`, (kinds, g), what the links of a kind share in a grid.
    held: (kinds, g, 2), likewise (`squares_held`).
    row: packs in the widest row, halos included; beside: packs in a row of particles that are on no
        grid, likewise; 0 on a graph.
    rows_share_stiffness: whether all rows of each grid, but the last ones, have the same links
        with the same stiffness.
    rows: the half-springs of all springs, where rows of a graph are packed.
    """

    lanes: int
    links: tuple[tuple[int, int], ...]
    n_packs: int
    slot: np.ndarray
    grid: np.ndarray
    grid_of: np.ndarray
    kind: np.ndarray
    owner: np.ndarray
    lines: tuple[tuple[int, int], ...]
    line: np.ndarray
    line_owner: np.ndarray
    shared: dict[str, np.ndarray]
    held: np.ndarray
    row: int
    beside: int
    rows_share_stiffness: bool
    rows: packing.PackedRows | None = None

    @property
    def reaches(self) -> tuple[tuple[int, int], ...]:
        """(columns, rows) from the earliest to the last particle of each kind of link and line."""
        return (*self.links, *((2 * c, 2 * r) for c, r in self.lines))


def squares_held(springs: Springs) -> np.ndarray:
    """Squares of the shortest and the longest length at which springs hold, (s, 2) [length^2]."""
    with np.errstate(all="ignore"):  # of an infinite length, too
        squares: np.ndarray = np.stack(springs.lengths_held(), axis=1) ** 2
        return squares


def on_graph(
    springs: Springs,
    particle_count: int,
    sort: bool,
    stencils: Stencils | None = None,
    packs: bool = False,
) -> Layout:
    """The layout in which particles stand one by one, and all springs are on the graph.

    Particles are in the order of their numbers, or, where `sort` allows it and springs reach far
    between those, in one in which neighbours are near in memory.

    packs: whether rows may be packed, which those of large nets then are if that pays.
    """
    slot = np.arange(particle_count, dtype=np.int32)
    if sort and particle_count >= WORTH_SORTING and len(springs):
        near = np.empty_like(slot)
        near[adjacency.banded_order(springs.between, particle_count)] = slot
        if _reach(springs, near) < 0.5 * _reach(springs, slot):
            slot = near
    rows = _packed_rows(springs, slot) if packs else None
    lanes, n_packs, grid = 1, particle_count, [0, 1, particle_count, 0]
    if rows is not None:
        lanes, n_packs = packing.LANES, rows.packs
        grid = [0, n_packs // LOOSE_WIDTH, LOOSE_WIDTH, 0]
    return Layout(
        lanes=lanes,
        links=(),
        n_packs=n_packs,
        slot=slot,
        grid=np.array([grid], np.int32),
        grid_of=np.zeros(1, np.int32),
        kind=np.full(len(springs), -1),
        owner=np.zeros(len(springs), np.int64),
        lines=(),
        line=np.full(0 if stencils is None else len(stencils), -1),
        line_owner=np.zeros(0 if stencils is None else len(stencils), np.int64),
        shared={},
        held=np.zeros((0, 0, 2)),
        row=1,
        beside=0,
        rows_share_stiffness=False,
        rows=rows,
    )


def _packed_rows(springs: Springs, slot: np.ndarray) -> packing.PackedRows | None:
    """The packed rows of all springs between particles in the slots `slot`; None where the net is
    small, or larger than kernels count, or other ends follow each other too seldom.
    """
    if len(slot) < WORTH_PACKING or not len(slot) <= len(springs) <= PACKS:
        return None
    slots = -(-len(slot) // (packing.LANES * LOOSE_WIDTH)) * packing.LANES * LOOSE_WIDTH
    return packing.worth_packing(slot[springs.between], slots)


def _reach(springs: Springs, slot: np.ndarray) -> float:
    """Mean distance in memory between the ends of springs."""
    a, b = slot[springs.between].astype(np.int64).T
    return float(np.abs(a - b).mean()) if len(a) else 0.0


def any_period(halo: int) -> int:
    """The period for `on_grids` with which strips may be as wide as they like: 1 column."""
    return 1


def spring_period(halo: int) -> int:
    """Columns after which colours of links repeat (`spring_colours`), for `on_grids`.

    halo: the most columns that a link reaches.
    """
    return 2 * max(halo, 1)


def spring_colours(springs: Springs, grids: Layout | None, particle_count: int) -> np.ndarray:
    """Colours (s,) of all springs; those of one colour share no particle (`solvers/colours.py`).

    Links of a kind take turns: by as many rows as they reach down, or columns where they stay in
    their row. So the colours of kind k are 2k and 2k + 1; the springs on the graph have those that
    follow.

    grids: the layout on grids, if there is one, with packs of any width.
    """
    colour = np.zeros(len(springs), np.int64)
    linked: np.ndarray = np.zeros(len(springs), bool)
    kinds = 0
    if grids is not None:
        linked, kinds = grids.kind >= 0, len(grids.links)
        kind = grids.kind[linked]
        _, row, column = _places(grids, grids.owner[linked])
        columns, down = np.array(grids.links)[kind].T
        across = column // np.maximum(np.abs(columns), 1)
        turn = np.where(down > 0, row // np.maximum(down, 1), across)
        colour[linked] = 2 * kind + turn % 2
    colour[~linked] = 2 * kinds + adjacency.edge_colours(springs.between[~linked], particle_count)
    return colour


def particle_period(halo: int) -> int:
    """Columns after which colours of particles repeat (`particle_colours`), for `on_grids`.

    halo: the most columns that a link reaches.
    """
    return halo + 1


def particle_colours(
    springs: Springs,
    grids: Layout | None,
    particle_count: int,
    stencils: Stencils | None = None,
) -> np.ndarray:
    """Colours (n,) of all particles; no two of one colour are tied, or in one stencil.

    Without springs and stencils: -1. On grids rows and columns take turns, by one more than links
    and lines reach. Particles that have something on the graph have colours that follow.

    grids: the layout on grids, if there is one, with packs of any width.
    """
    linked = np.zeros(len(springs), bool) if grids is None else grids.kind >= 0
    colour: np.ndarray = np.full(particle_count, -1, np.int64)
    shared = np.zeros(particle_count, bool)
    shared[springs.between[~linked]] = True
    tied = springs.between
    if stencils is not None and len(stencils):
        along = np.full(len(stencils), -1) if grids is None else grids.line
        shared[stencils.select(along < 0).particle] = True
        tied = np.concatenate([tied, lines.pairs(stencils)])
    turns = 0
    if grids is not None:
        g, row, column = _places(grids, grids.slot)
        columns, down = np.abs(np.array(grids.reaches)).max(axis=0)
        turns = (columns + 1) * (down + 1)
        place = row % (down + 1) * (columns + 1) + column % (columns + 1)
        colour = np.where(g >= 0, place, -1)
    between = tied[shared[tied].all(axis=1)]
    own = adjacency.vertex_colours(between, particle_count)
    colour[shared] = turns + own[shared]
    return colour


def stencil_colours(stencils: Stencils, grids: Layout | None, particle_count: int) -> np.ndarray:
    """Colours (m,) of all stencils; those of one colour share no particle (`solvers/colours.py`).

    Along lines they take turns by three: the colours of kind k are 3k to 3k + 2. All others have
    those that follow.
    """
    colour, kinds = np.zeros(len(stencils), np.int64), 0
    along = np.full(len(stencils), -1)
    if grids is not None:
        along, kinds = grids.line, len(grids.lines)
        mine = np.flatnonzero(along >= 0)
        _, row, column = _places(grids, grids.line_owner[mine])
        if len(mine):
            down = np.array(grids.lines)[along[mine], 1]
            colour[mine] = 3 * along[mine] + np.where(down > 0, row, column) % 3
    listed = along < 0
    colour[listed] = 3 * kinds + lines.colours(stencils.select(listed), particle_count)
    return colour


def _places(grids: Layout, slot: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Grid (-1: none), row and column of slots."""
    cell, lane = np.divmod(slot, grids.lanes)
    g = grids.grid_of[cell]
    first, _, width, _ = grids.grid[g].T
    halo = max(abs(c) for c, _ in grids.reaches) if grids.lanes > 1 else 0
    row, place = np.divmod(cell - first, width + 2 * halo)
    return g, row, lane * width + place


def on_grids(
    springs: Springs,
    particle_count: int,
    lanes: int,
    period: Callable[[int], int] = any_period,
    terms: Collection[str] = (),
    stencils: Stencils | None = None,
) -> Layout | None:
    """The layout of regular grids in packs, and of what else there is; None without a grid.

    A spring that differs from the others of its kind in its grid, in more than its stiffness,
    stays on the graph.

    lanes: the width of packs.
    period: strips are a multiple of this many columns wide, a function of the most columns that a
        link reaches.
    terms: names of the scene's forces; a number that one of them changes is each link's own.
    stencils: those that are to be placed, too.
    """
    grids = adjacency.find_grids(springs.between, particle_count)
    if not grids:
        return None
    grid, column, row = _on_which_grid(grids, particle_count)
    kind = _kinds(springs.between, grid, column, row)
    # A link without stiffness cannot be told from an absent one, and stays on the graph.
    kind[~(springs.stiffness > 0)] = -1
    shared, held, kind = _shared_numbers(springs, kind, grid, len(grids), terms)
    used = _kinds_among(kind)
    if WORTH_LANES * np.count_nonzero(kind >= 0) < len(springs):
        return None  # all of them differ, or most: it is a mesh that looks like a grid in places
    renumbered = np.full(len(FORWARD) + 1, -1)
    renumbered[used] = np.arange(len(used))
    kind = renumbered[kind]
    links = tuple(FORWARD[k] for k in used)

    stencils = Stencils.none() if stencils is None else stencils
    line, earliest = lines.find(stencils, springs.between, kind, grid, column, row)
    along = tuple(of for k, of in enumerate(lines.LINES) if (line == k).any())
    line = np.array([*(along.index(of) if of in along else -1 for of in lines.LINES), -1])[line]
    reaches = (*links, *((2 * c, 2 * r) for c, r in along))

    halo = max(abs(c) for c, _ in reaches) if lanes > 1 else 0
    depth = max(r for _, r in reaches)
    multiple = period(halo) if lanes > 1 else 1
    if along and multiple > 1:
        multiple = math.lcm(multiple, 3)  # `stencil_colours`
    table, slot, n_packs = _packed(grids, grid, column, row, lanes, halo, depth, multiple)
    return Layout(
        lanes=lanes,
        links=links,
        n_packs=n_packs,
        slot=slot,
        grid=table,
        grid_of=_grid_of_packs(table, halo, n_packs),
        kind=kind,
        owner=slot[springs.between.min(axis=1)].astype(np.int64),
        lines=along,
        line=line,
        line_owner=slot[earliest].astype(np.int64),
        shared={column: numbers[used] for column, numbers in shared.items()},
        held=held[used],
        row=int(table[:, 2].max()) + 2 * halo,
        beside=LOOSE_WIDTH + 2 * halo,
        rows_share_stiffness=_alike(springs, kind, grids, depth),
    )


def springs_of_kind(name: str, between: np.ndarray, particle_count: int) -> np.ndarray:
    """Which of the springs `between` (s, 2) are links of one kind of regular grids, (s,) bool.

    name: of the kind, out of `LINKS`.
    """
    grids = adjacency.find_grids(between, particle_count)
    names = np.array([kind for kind in LINKS for _ in LINKS[kind]] + [""])
    kind = _kinds(between, *_on_which_grid(grids, particle_count))
    mine: np.ndarray = names[kind] == name
    return mine


def _on_which_grid(
    grids: Sequence[adjacency.Grid], particle_count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each particle's grid (-1: none), and its column and row in it, all (n,)."""
    grid = np.full(particle_count, -1)
    column, row = np.zeros((2, particle_count), np.int64)
    for g, block in enumerate(grids):
        inside = slice(block.first, block.first + block.rows * block.columns)
        grid[inside] = g
        row[inside], column[inside] = np.divmod(
            np.arange(block.rows * block.columns), block.columns
        )
    return grid, column, row


def _packed(
    grids: Sequence[adjacency.Grid],
    grid: np.ndarray,
    column: np.ndarray,
    row: np.ndarray,
    lanes: int,
    halo: int,
    depth: int,
    multiple: int,
) -> tuple[np.ndarray, np.ndarray, int]:
    """`Layout.grid`, the slots of particles (n,) int32, and how many packs that takes.

    grid, column, row: (n,), where each particle is; grid -1: on none.
    lanes: the width of packs; halo: packs beside a row at either end; depth: rows that links
        reach down; multiple: columns of which strips are a multiple wide.
    """
    # Before the first pack: what the links of a row above the first one reach back to.
    table, next_pack = [], halo + 2
    pack, place = np.zeros((2, len(grid)), np.int64)
    for g, block in enumerate(grids):
        width = max(-(-block.columns // lanes), halo, 1)
        width = -(-width // multiple) * multiple
        pitch = width + 2 * halo
        first = next_pack + depth * pitch + halo
        table.append([first, block.rows, width, 1])
        mine = grid == g
        place[mine], along = np.divmod(column[mine], width)
        pack[mine] = first + row[mine] * pitch + along
        next_pack = first + (block.rows + depth) * pitch
    loose = np.flatnonzero(grid < 0)
    if len(loose):
        pitch = LOOSE_WIDTH + 2 * halo
        first = next_pack + halo
        along, place[loose] = np.divmod(np.arange(len(loose)), lanes)
        at_row, at = np.divmod(along, LOOSE_WIDTH)
        table.append([first, at_row.max() + 1, LOOSE_WIDTH, 0])
        pack[loose] = first + at_row * pitch + at
        next_pack = first + (at_row.max() + 1) * pitch
    slot = (pack * lanes + place).astype(np.int32)
    return np.array(table, np.int32), slot, int(next_pack + halo + 2)


def _grid_of_packs(table: np.ndarray, halo: int, n_packs: int) -> np.ndarray:
    """`Layout.grid_of`, from `Layout.grid`."""
    grid_of = np.full(n_packs, -1, np.int32)
    for g, (first, rows, width, linked) in enumerate(table):
        if linked:
            packs = first + np.arange(rows)[:, None] * (width + 2 * halo) + np.arange(width)
            grid_of[packs] = g
    return grid_of


def _kinds(
    between: np.ndarray, grid: np.ndarray, column: np.ndarray, row: np.ndarray
) -> np.ndarray:
    """The kind of each of the springs `between` (s, 2), an index into FORWARD, or -1 where it is no
    link of a grid.

    grid, column, row: (n,), where each particle is; grid -1: on none.
    """
    a, b = between.min(axis=1), between.max(axis=1)
    offset = np.stack([column[b] - column[a], row[b] - row[a]], axis=1)
    inside = (grid[a] == grid[b]) & (grid[a] >= 0)
    kind = np.full(len(between), -1)
    for k, forward in enumerate(FORWARD):
        kind[inside & (offset == forward).all(axis=1)] = k
    return kind


def _kinds_among(kind: np.ndarray) -> np.ndarray:
    """The kinds that some links are of, in order; negative: of none.

    `numpy.unique` would sort them, and import masked arrays at its first use.
    """
    return np.flatnonzero(np.bincount(kind[kind >= 0], minlength=1))


def _alike(springs: Springs, kind: np.ndarray, grids: Sequence[adjacency.Grid], depth: int) -> bool:
    """True if the links of all rows, but the last `depth` of each grid, are those of the first."""
    first = springs.between.min(axis=1)
    for block in grids:
        inside = (first >= block.first) & (first < block.first + block.rows * block.columns)
        for k in _kinds_among(kind[inside]):
            links = inside & (kind == k)
            stiffness = np.zeros(block.rows * block.columns)
            stiffness[first[links] - block.first] = springs.stiffness[links]
            rows = stiffness.reshape(block.rows, block.columns)[: max(block.rows - depth, 0)]
            if (rows != rows[:1]).any():
                return False
    return True


def _shared_numbers(
    springs: Springs,
    kind: np.ndarray,
    grid: np.ndarray,
    grid_count: int,
    terms: Collection[str],
) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """Numbers shared by links of a kind and grid: by column of `Springs`, (kinds, grids)
    each, but those that each link has of its own, and `Layout.held`; and the kinds.

    A spring with other numbers than most of its kind and grid (their median) gets kind -1.
    """
    shape = len(FORWARD), grid_count
    linked = np.flatnonzero(kind >= 0)
    group = kind[linked] * grid_count + grid[springs.between[linked, 0]]
    groups, begin, count = np.unique(np.sort(group), return_index=True, return_counts=True)
    same = np.ones(len(linked), bool)

    def shared(values: np.ndarray, size: np.ndarray | None = None) -> np.ndarray:
        """The values that most have; what has another one is no longer `same`.

        size: (s,), what they are a difference of, whose rounding they have; absent: of nothing.
        """
        table = np.zeros(shape)
        ranked = linked[np.lexsort((values[linked], group))]
        table.flat[groups] = values[ranked[begin + count // 2]]
        mine = table.flat[group]
        with np.errstate(invalid="ignore"):
            most = SAME * (mine if size is None else size[linked])
            same[:] &= (values[linked] == mine) | (np.abs(values[linked] - mine) <= most)
        return table

    columns = [n.column for n in NUMBERS if not (n.per_link or n.changes(terms))]
    numbers = {column: shared(getattr(springs, column)) for column in columns}
    shared(springs.break_in == "tension")
    shortest2, longest2 = squares_held(springs).T
    held = np.stack([shared(shortest2, longest2), shared(longest2)], axis=2)
    kind = kind.copy()
    kind[linked[~same]] = -1
    return numbers, held, kind
