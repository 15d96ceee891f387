"""Where particles and springs are stored: on a graph, or in the cells of regular grids (NumPy).

`kernels/lanes.py` draws how a grid lies in its cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taichi_cloth.scene.cloth import LINKS
from taichi_cloth.scene.model import Springs
from taichi_cloth.simulation import adjacency

# Offsets (columns, rows) from a particle to those that come later and are tied to it.
FORWARD = tuple((-column, -row) for kind in LINKS.values() for column, row in kind)
WORTH_SORTING = 4096  # particles; fewer are in the processor's fastest caches anyway
LOOSE_WIDTH = 16  # cells in a row of particles that are on no grid
# Rest lengths of links of one kind may differ by the rounding of the positions they come from.
SAME = 1e-11


@dataclass(frozen=True)
class Layout:
    """Places of n particles and s springs.

    lanes: particles in a cell; links: offsets of the kinds of link, empty on a graph.
    n_packs: packs in use, empty ones included; slot: (n,) int32, each particle's cell * lanes +
    lane. grid: (g, 4) int32, first cell, rows, width and whether it has links; grid_of: (n_cells,)
    int32. kind: (s,) int, a spring's kind of link, -1 for one on the graph; owner: (s,) int, site
    of a link's earlier particle. rest_length, damping, break_length2: (kinds, g), of links.
    row: cells in the widest row with its halos. rows_share_stiffness: whether all rows of each grid, but the last
    ones, have the same links with the same stiffness.
    """

    lanes: int
    links: tuple[tuple[int, int], ...]
    n_packs: int
    slot: np.ndarray
    grid: np.ndarray
    grid_of: np.ndarray
    kind: np.ndarray
    owner: np.ndarray
    rest_length: np.ndarray
    damping: np.ndarray
    break_length2: np.ndarray
    row: int
    rows_share_stiffness: bool


def break_length2(springs: Springs) -> np.ndarray:
    """Square of the length at which a spring's force reaches its break force, (s,)."""
    with np.errstate(all="ignore"):  # an infinite length never breaks
        return (springs.rest_length + springs.break_force / springs.stiffness) ** 2


def on_graph(springs: Springs, position: np.ndarray | None, particle_count: int) -> Layout:
    """Particles one by one, all springs on the graph.

    In the order of their numbers, or, where springs reach far between those and `position` is
    given, along a curve through space, so that neighbours are near in memory.
    """
    site = np.arange(particle_count, dtype=np.int32)
    if position is not None and particle_count >= WORTH_SORTING:
        curve = np.empty_like(site)
        curve[adjacency.z_order(position)] = site
        if _reach(springs, curve) < 0.5 * _reach(springs, site):
            site = curve
    none = np.zeros((0, 0))
    return Layout(
        lanes=1,
        links=(),
        n_packs=particle_count,
        slot=site,
        grid=np.array([[0, 1, particle_count, 0]], np.int32),
        grid_of=np.zeros(1, np.int32),
        kind=np.full(len(springs), -1),
        owner=np.zeros(len(springs), np.int64),
        rest_length=none,
        damping=none,
        break_length2=none,
        row=1,
        rows_share_stiffness=False,
    )


def _reach(springs: Springs, site) -> float:
    """Mean distance in memory between the ends of springs."""
    a, b = site[springs.between].astype(np.int64).T
    return float(np.abs(a - b).mean()) if len(a) else 0.0


def any_period(halo: int) -> int:
    """For `on_grids`: strips may be as wide as they like."""
    return 1


def spring_period(halo: int) -> int:
    """Columns after which colours of links repeat (`spring_colours`): for `on_grids`.

    halo: the most columns that a link reaches.
    """
    return 2 * max(halo, 1)


def spring_colours(springs: Springs, grids: Layout | None, particle_count: int) -> np.ndarray:
    """Colours (s,) of all springs; those of one colour share no particle (`kernels/colours.py`).

    Links of a kind take turns: by as many rows as they reach down, or columns where they stay in
    their row. So the colours of kind k are 2k and 2k + 1; the springs on the graph have those that
    follow. grids: the layout on grids, if there is one, of any number of lanes.
    """
    colour = np.zeros(len(springs), np.int64)
    linked = np.zeros(len(springs), bool)
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
    """The same for colours of particles (`particle_colours`)."""
    return halo + 1


def particle_colours(springs: Springs, grids: Layout | None, particle_count: int) -> np.ndarray:
    """Colours (n,) of all particles, no two of them tied where they are equal; -1 without springs.

    On grids rows and columns take turns, by one more than links reach. Particles that have springs
    on the graph have colours that follow. grids: as in `spring_colours`.
    """
    linked = np.zeros(len(springs), bool) if grids is None else grids.kind >= 0
    colour = np.full(particle_count, -1, np.int64)
    shared = np.zeros(particle_count, bool)
    shared[springs.between[~linked]] = True
    turns = 0
    if grids is not None:
        g, row, column = _places(grids, grids.slot)
        columns, down = np.abs(np.array(grids.links)).max(axis=0)
        turns = (columns + 1) * (down + 1)
        place = row % (down + 1) * (columns + 1) + column % (columns + 1)
        colour = np.where(g >= 0, place, -1)
    between = springs.between[shared[springs.between].all(axis=1)]
    own = adjacency.vertex_colours(between, particle_count)
    colour[shared] = turns + own[shared]
    return colour


def _places(grids: Layout, site):
    """Grid (-1: none), row and column of sites."""
    cell, lane = np.divmod(site, grids.lanes)
    g = grids.grid_of[cell]
    first, _, width, _ = grids.grid[g].T
    halo = max(abs(c) for c, _ in grids.links) if grids.lanes > 1 else 0
    row, place = np.divmod(cell - first, width + 2 * halo)
    return g, row, lane * width + place


def on_grids(springs: Springs, particle_count: int, lanes: int, period=any_period) -> Layout | None:
    """Regular grids in cells of `lanes`, what else there is besides; None without a grid.

    A spring that differs from the others of its kind in its grid, in more than its stiffness,
    stays on the graph. Strips are a multiple of `period` wide, a function of the most columns that
    a link reaches.
    """
    grids = adjacency.find_grids(springs.between, particle_count)
    if not grids:
        return None
    grid = np.full(particle_count, -1)
    column, row = np.zeros((2, particle_count), np.int64)
    for g, of in enumerate(grids):
        block = slice(of.first, of.first + of.rows * of.columns)
        grid[block] = g
        row[block], column[block] = np.divmod(np.arange(of.rows * of.columns), of.columns)

    kind = _kinds(springs, grid, column, row)
    rest_length, damping, limit, kind = _shared_numbers(springs, kind, grid, len(grids))
    used = np.unique(kind[kind >= 0])
    if not len(used):
        return None  # all of them differ
    renumbered = np.full(len(FORWARD) + 1, -1)
    renumbered[used] = np.arange(len(used))
    kind = renumbered[kind]
    links = tuple(FORWARD[k] for k in used)

    halo = max(abs(c) for c, _ in links) if lanes > 1 else 0
    depth = max(r for _, r in links)
    # Before the first cell: what the links of a row above the first one reach back to.
    table, next_cell = [], halo + 2
    cell, lane = np.zeros((2, particle_count), np.int64)
    for g, of in enumerate(grids):
        width = max(-(-of.columns // lanes), halo, 1)
        if lanes > 1:
            width = -(-width // period(halo)) * period(halo)
        pitch = width + 2 * halo
        first = next_cell + depth * pitch + halo
        table.append([first, of.rows, width, 1])
        mine = grid == g
        lane[mine], place = np.divmod(column[mine], width)
        cell[mine] = first + row[mine] * pitch + place
        next_cell = first + (of.rows + depth) * pitch
    loose = np.flatnonzero(grid < 0)
    if len(loose):
        pitch = LOOSE_WIDTH + 2 * halo
        first = next_cell + halo
        place, lane[loose] = np.divmod(np.arange(len(loose)), lanes)
        at_row, at = np.divmod(place, LOOSE_WIDTH)
        table.append([first, at_row.max() + 1, LOOSE_WIDTH, 0])
        cell[loose] = first + at_row * pitch + at
        next_cell = first + (at_row.max() + 1) * pitch
    n_packs = next_cell + halo + 2

    grid_of = np.full(n_packs, -1, np.int32)
    for g, (first, rows, width, linked) in enumerate(table):
        if linked:
            cells = first + np.arange(rows)[:, None] * (width + 2 * halo) + np.arange(width)
            grid_of[cells] = g
    site = (cell * lanes + lane).astype(np.int32)
    return Layout(
        lanes=lanes,
        links=links,
        n_packs=n_packs,
        slot=site,
        grid=np.array(table, np.int32),
        grid_of=grid_of,
        kind=kind,
        owner=site[springs.between.min(axis=1)].astype(np.int64),
        rest_length=rest_length[used],
        damping=damping[used],
        break_length2=limit[used],
        row=max(width for _, _, width, _ in table) + 2 * halo,
        rows_share_stiffness=_alike(springs, kind, grids, depth),
    )


def _kinds(springs: Springs, grid, column, row) -> np.ndarray:
    """Each spring's kind, an index into FORWARD, or -1 where it is no link of a grid.

    A link without stiffness cannot be told from an absent one, and stays on the graph.
    """
    a, b = springs.between.min(axis=1), springs.between.max(axis=1)
    offset = np.stack([column[b] - column[a], row[b] - row[a]], axis=1)
    inside = (grid[a] == grid[b]) & (grid[a] >= 0) & (springs.stiffness > 0)
    kind = np.full(len(springs), -1)
    for k, forward in enumerate(FORWARD):
        kind[inside & (offset == forward).all(axis=1)] = k
    return kind


def _alike(springs: Springs, kind, grids, depth: int) -> bool:
    """Whether the links of all rows, but the last `depth` of each grid, are those of the first."""
    first = springs.between.min(axis=1)
    for of in grids:
        inside = (first >= of.first) & (first < of.first + of.rows * of.columns)
        for k in np.unique(kind[inside & (kind >= 0)]):
            links = inside & (kind == k)
            stiffness = np.zeros(of.rows * of.columns)
            stiffness[first[links] - of.first] = springs.stiffness[links]
            rows = stiffness.reshape(of.rows, of.columns)[: max(of.rows - depth, 0)]
            if (rows != rows[:1]).any():
                return False
    return True


def _shared_numbers(springs: Springs, kind, grid, grid_count: int):
    """(rest length, damping, break length squared), each (kinds, grids), and the kinds again.

    A spring with other numbers than most of its kind and grid (their median) gets kind -1.
    """
    shape = len(FORWARD), grid_count
    limit2 = break_length2(springs)
    linked = np.flatnonzero(kind >= 0)
    group = kind[linked] * grid_count + grid[springs.between[linked, 0]]
    groups, begin, count = np.unique(np.sort(group), return_index=True, return_counts=True)
    tables, same = [], np.ones(len(linked), bool)
    for of in (springs.rest_length, springs.damping, limit2):
        table = np.zeros(shape)
        ranked = linked[np.lexsort((of[linked], group))]
        table.flat[groups] = of[ranked[begin + count // 2]]
        mine = table.flat[group]
        with np.errstate(invalid="ignore"):
            same &= (of[linked] == mine) | (np.abs(of[linked] - mine) <= SAME * mine)
        tables.append(table)
    kind = kind.copy()
    kind[linked[~same]] = -1
    return (*tables, kind)
