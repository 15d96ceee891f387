"""Intersecting pairs of triangles: an exact count in double precision, of any positions.

It shares nothing with what it checks. Two triangles without a common corner intersect where an edge
of one pierces the other. Where they share one corner, that is asked of the edges opposite to it;
where they share an edge, they overlap only if they lie folded onto each other.
"""

import numpy as np
from scipy.spatial import cKDTree


def intersecting_pairs(x, triangles):
    """The pairs of triangles that intersect, (k, 2): their numbers, the lower one first.

    x: positions (n, 3); triangles: (m, 3), the particles at their corners.
    """
    x, triangles = np.asarray(x, np.float64), np.asarray(triangles)
    i, j = _near(x[triangles])
    shared = (triangles[i][:, :, None] == triangles[j][:, None, :]).sum(axis=(1, 2))
    found = np.zeros(len(i), bool)
    for count, test in ((0, _apart), (1, _at_a_corner), (2, _at_an_edge), (3, _same)):
        those = np.flatnonzero(shared == count)
        for part in np.array_split(those, max(1, len(those) // 100_000)):
            found[part] = test(x, triangles[i[part]], triangles[j[part]])
    return np.stack([i[found], j[found]], axis=1)


def _near(corners):
    """Numbers i < j of triangles whose boxes overlap, for corners (m, 3, 3)."""
    middle = 0.5 * (corners.min(axis=1) + corners.max(axis=1))
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max()
    pairs = cKDTree(middle).query_pairs(2 * radius * (1 + 1e-9), output_type="ndarray")
    i, j = np.sort(pairs, axis=1).T
    low, high = corners.min(axis=1), corners.max(axis=1)
    overlap = ((low[i] <= high[j]) & (low[j] <= high[i])).all(axis=1)
    return i[overlap], j[overlap]


def _volume(a, b, c, d):
    """Six times the signed volume of tetrahedra, rows of points."""
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)


def _pierces(p, q, a, b, c):
    """True if segments p q meet the triangles a b c, their rims included; not within one plane."""
    above, below = _volume(a, b, c, p), _volume(a, b, c, q)
    crosses = (above * below <= 0) & ((above != 0) | (below != 0))
    sides = np.stack([_volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)])
    return crosses & ((sides >= 0).all(axis=0) | (sides <= 0).all(axis=0))


def _apart(x, one, other):
    found = np.zeros(len(one), bool)
    for first, second in ((one, other), (other, one)):
        a, b, c = x[second].transpose(1, 0, 2)
        for k in range(3):
            found |= _pierces(x[first[:, k]], x[first[:, k - 1]], a, b, c)
    return found | _overlap_in_a_plane(x, one, other)


def _overlap_in_a_plane(x, one, other):
    """True if triangles that lie in one plane, exactly, have a point in common."""
    a, b, c = x[one].transpose(1, 0, 2)
    flat = np.ones(len(one), bool)
    for k in range(3):
        flat &= _volume(a, b, c, x[other[:, k]]) == 0
    found = np.zeros(len(one), bool)
    for at in np.flatnonzero(flat):
        normal = np.cross(b[at] - a[at], c[at] - a[at])
        axes = np.delete(np.arange(3), np.abs(normal).argmax())
        found[at] = not _separated(x[one[at]][:, axes], x[other[at]][:, axes])
    return found


def _separated(one, other):
    """True if a side of one of two triangles in a plane, (3, 2) each, keeps them apart."""
    for first, second in ((one, other), (other, one)):
        for k in range(3):
            along = first[k] - first[k - 1]
            across = np.array([-along[1], along[0]])
            mine, theirs = first @ across, second @ across
            if mine.max() < theirs.min() or theirs.max() < mine.min():
                return True
    return False


def _turned(triangles, shared):
    """The corners of triangles, so turned that the shared one comes first; shared: (k, 3) bool."""
    first = shared.argmax(axis=1)
    return triangles[np.arange(len(triangles))[:, None], (first[:, None] + np.arange(3)) % 3]


def _at_a_corner(x, one, other):
    same = one[:, :, None] == other[:, None, :]
    one, other = _turned(one, same.any(axis=2)), _turned(other, same.any(axis=1))
    found = np.zeros(len(one), bool)
    for first, second in ((one, other), (other, one)):
        found |= _pierces(x[first[:, 1]], x[first[:, 2]], *x[second].transpose(1, 0, 2))
    return found


def _at_an_edge(x, one, other):
    same = one[:, :, None] == other[:, None, :]
    one, other = _turned(one, ~same.any(axis=2)), _turned(other, ~same.any(axis=1))
    a, b = x[one[:, 1]], x[one[:, 2]]
    along = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
    up, down = (x[t[:, 0]] - a for t in (one, other))
    up = up - np.einsum("ij,ij->i", up, along)[:, None] * along
    down = down - np.einsum("ij,ij->i", down, along)[:, None] * along
    cosine = np.einsum("ij,ij->i", up, down)
    lengths = np.linalg.norm(up, axis=1) * np.linalg.norm(down, axis=1)
    return cosine >= (1 - 1e-15) * lengths


def _same(x, one, other):
    return np.ones(len(one), bool)
