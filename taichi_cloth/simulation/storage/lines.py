"""Stencils along the lines of regular grids, and colours of those that are not (NumPy)."""

from __future__ import annotations

import numpy as np

from taichi_cloth.scene.stencils import IN_ROW, Stencils

LINES = ((1, 0), (0, 1))  # (columns, rows) from a particle to the next: in rows, in columns


def find(
    stencils: Stencils,
    between: np.ndarray,
    kind: np.ndarray,
    grid: np.ndarray,
    column: np.ndarray,
    row: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Which kind of line out of `LINES` each stencil lies along, (m,), -1: none; and its earliest
    particle, (m,).

    It has the weights (1, -2, 1) times a number, and what springs it needs are links of its grid.

    between, kind: (s, 2), (s,), the springs, and whether each is a link (not negative).
    grid, column, row: (n,), where each particle is; grid -1: on none.
    """
    line, earliest = np.full(len(stencils), -1), np.zeros(len(stencils), np.int64)
    for mine, at in stencils.by_size():
        if at.shape[1] != IN_ROW:
            continue
        middle, one, other = stencils.particle[at].T
        of_middle, of_one, of_other = stencils.weight[at].T
        first, last = np.minimum(one, other), np.maximum(one, other)
        even = (of_one == of_other) & (of_middle == -2 * of_one) & (of_one > 0)
        even &= (grid[middle] >= 0) & (grid[first] == grid[middle]) & (grid[middle] == grid[last])
        for k, (across, down) in enumerate(LINES):
            straight = even.copy()
            for a, b in ((first, middle), (middle, last)):
                straight &= (column[b] - column[a] == across) & (row[b] - row[a] == down)
            line[mine[straight]] = k
        earliest[mine] = first
    of, spring = stencils.sides(between)
    line[of[kind[spring] < 0]] = -1
    # Of several at one place only the first is the grid's.
    placed = np.flatnonzero(line >= 0)
    _, first = np.unique(line[placed] + len(LINES) * earliest[placed], return_index=True)
    again = np.ones(len(placed), bool)
    again[first] = False
    line[placed[again]] = -1
    return line, earliest


def pairs(stencils: Stencils) -> np.ndarray:
    """All pairs of particles that are in one stencil, (q, 2), in order; the smaller is first."""
    count = int(stencils.particle.max(initial=0)) + 1
    keys: np.ndarray = np.zeros(0, np.int64)
    for _, at in stencils.by_size():
        members = np.sort(stencils.particle[at], axis=1)
        # The up to three stencils of a triangle, one after the other, have the same pairs.
        new = np.append(True, (members[1:] != members[:-1]).any(axis=1))[: len(members)]
        one, other = np.triu_indices(at.shape[1], 1)
        keys = np.append(keys, (members[new][:, one] * count + members[new][:, other]).ravel())
    keys = np.sort(keys)
    keys = keys[np.append(True, keys[1:] != keys[:-1])[: len(keys)]]
    return np.stack(np.divmod(keys, count), axis=1)


def colours(stencils: Stencils, particle_count: int) -> np.ndarray:
    """A colour for each stencil, (m,), so that no two with a common particle share one.

    Each gets the first colour that is free at all of its particles.
    """
    colour = np.empty(len(stencils), np.int64)
    used = [0] * particle_count
    particle, start = stencils.particle.tolist(), stencils.start.tolist()
    for m in range(len(stencils)):
        members = particle[start[m] : start[m + 1]]
        taken = 0
        for i in members:
            taken |= used[i]
        free = ~taken & (taken + 1)
        colour[m] = free.bit_length() - 1
        for i in members:
            used[i] |= free
    return colour
