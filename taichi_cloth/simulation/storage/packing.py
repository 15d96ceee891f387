"""Rows of half-springs in packs, whose other ends follow each other in memory (NumPy)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from taichi_cloth.simulation.storage.adjacency import HalfSprings, half_springs

LANES = 8  # rows in a pack: 16 take three times as long to compile, and are no faster
# Parts of the columns. With more copies than these, the other order may need fewer; with more than
# these, rows stay as they are: even if all columns need copies packs are faster in a processor's
# caches, but copies take memory.
FEW_COPIES, MOST_COPIES = 0.25, 0.5


@dataclass(frozen=True)
class PackedRows:
    """Packed rows, as `kernels/graph.py` describes them: p packs, c columns, e copies.

    start: (p + 1,), the first column of each pack. run: (c,), the slot at which its other ends
    begin. place: (2s,), where each half-spring lies: its column times LANES, plus its lane.
    copied: (e * LANES,), the slots of what is copied; copy n comes as pack p + n.
    by_place: whether rows are in the order of the other ends (`adjacency.half_springs`).
    """

    start: np.ndarray
    run: np.ndarray
    place: np.ndarray
    copied: np.ndarray
    by_place: bool = False

    @property
    def packs(self) -> int:
        """Their number, without copies."""
        return len(self.start) - 1

    @property
    def copies(self) -> int:
        """The number of columns that have other ends that do not follow each other."""
        return len(self.copied) // LANES


def worth_packing(between: np.ndarray, slot_count: int) -> PackedRows | None:
    """The packed rows of the springs `between` (s, 2); None where too few columns are runs.

    slot_count: a multiple of LANES. Rows are in the order of the springs' numbers where that will
    do. In a mesh it seldom does: its edges are numbered otherwise than its vertices.
    """
    rows = packed(half_springs(between, slot_count))
    if rows.copies > FEW_COPIES * len(rows.run):
        other = packed(half_springs(between, slot_count, by_place=True))
        if other.copies < rows.copies:
            rows = replace(other, by_place=True)
    return rows if rows.copies <= MOST_COPIES * len(rows.run) else None


def packed(half: HalfSprings) -> PackedRows:
    """The rows of half-springs in packs; their number is a multiple of LANES.

    Particles inside a net reach the same ways, in the same order; those at its borders lack some of
    these. So a pack takes the columns of the longest of its rows, and each row those that reach as
    far as it does; where this leaves any over, each half-spring is in the column of its number in
    its row.
    """
    length = np.diff(half.row).astype(np.int64).reshape(-1, LANES)
    first = half.row[:-1].astype(np.int64).reshape(-1, LANES)
    count, longest = length.max(axis=1, initial=0), length.argmax(axis=1)
    start = np.zeros(len(length) + 1, np.int64)
    np.cumsum(count, out=start[1:])
    reach = np.append(half.far.astype(np.int64) - half.near, 0)
    place, taken = np.zeros(len(half.far), np.int64), np.zeros_like(length)
    for k in range(int(count.max(initial=0))):
        mine = np.flatnonzero(count > k)
        along = reach[first[mine, longest[mine]] + k]
        at = np.minimum(first[mine] + taken[mine], len(half.far))
        fits = (taken[mine] < length[mine]) & (reach[at] == along[:, None])
        place[at[fits]] = ((start[mine] + k)[:, None] * LANES + np.arange(LANES))[fits]
        taken[mine] += fits
    pack, number = half.near // LANES, np.arange(len(half.far)) - half.row[half.near]
    short = np.asarray((taken < length).any(axis=1))
    left = short[pack]
    place[left] = ((start[pack] + number) * LANES + half.near % LANES)[left]

    # Where each column's run would begin, by each of its half-springs.
    column = place // LANES
    begin = half.far.astype(np.int64) - half.near % LANES
    least, most = np.full((2, start[-1]), [[len(half.row)], [-1]])
    np.minimum.at(least, column, begin)
    np.maximum.at(most, column, begin)
    run = least
    apart = (least != most) | (least < 0) | (most > (len(length) - 1) * LANES)
    slots = np.repeat(np.arange(len(length)), count)[:, None] * LANES + np.arange(LANES)
    slots.ravel()[place] = half.far
    run[apart] = (len(length) + np.arange(np.count_nonzero(apart))) * LANES
    return PackedRows(start, run, place, slots[apart].ravel())
