"""The thickness of a closed mesh: how far its far side is, from points all over its surface.

Rays go inwards from these points and end at the next face. A ray is cut into pieces, and each piece
is tested against the faces of the bin that it is in (Amanatides, Woo, "A fast voxel traversal
algorithm for ray tracing", 1987, with pieces of one length). Faces may be turned either way: the
inside of a point is where its ray crosses the mesh an odd number of times.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

BINS = 16, 256  # along the mesh's longest side, at least and at most
FACES_OF_BIN = 6  # about, where the surface goes through one
MOST_ENTRIES = 4_000_000  # of bins, in all: long faces are in many
FACES, RANDOM, EACH = 6_000, 2_048, 8  # faces sampled; points by area; points of a face, at most
TILT = 2e-3  # of a ray, which then goes through no edge
SHARE = 0.1  # of its thickness, within which a grid is to meet it
THINNEST = 0.75  # of a thickness: the widest cell that is sure to have a node well inside
TAPERS, CLASSES = 1.25, 4.0  # see `badly_met`; of thickness, in an octave
SLENDER = 2.0  # thicknesses within which what tapers off gets thicker: a finger does not
OPPOSED = 0.95  # cosine between two faces, from which on they are the two sides of something


@dataclass(frozen=True)
class Samples:
    """Points (n, 3) on a mesh, the unit vectors (n, 3) that point into it there, and its thickness
    there, (n,): infinite where what lies opposite is not the other side of something thin.
    """

    points: np.ndarray
    inwards: np.ndarray
    thickness: np.ndarray

    def among(self, which: np.ndarray) -> "Samples":
        """Those of them that are wanted, (n,) bool."""
        return Samples(*(rows[which] for rows in vars(self).values()))


def sampled(corners: np.ndarray) -> Samples:
    """Measure the thickness of a mesh (m, 3, 3) at points all over it; the same ones each time."""
    rng = np.random.default_rng(57)
    area = np.linalg.norm(_normals(corners), axis=1)
    sound = np.flatnonzero(area > 0)
    mine = sound if len(sound) <= FACES else rng.choice(sound, FACES, replace=False)
    mine = np.repeat(mine, max(1, min(EACH, FACES // len(mine))))
    by_area = rng.choice(len(corners), RANDOM, p=area / area.sum())
    face = np.concatenate([mine, by_area])
    root, along = np.sqrt(rng.random(len(face))), rng.random(len(face))
    shares = np.column_stack([1.0 - root, root * (1.0 - along), root * along])
    points = np.einsum("nk,nkd->nd", shares, corners[face])
    normals = _normals(corners)[face] / area[face, None]
    tilt = TILT * rng.standard_normal(points.shape)
    bins = _Bins(corners)
    inwards = -1.0 * normals
    first, opposite, crossings = bins.crossed(points, inwards + tilt)
    turned = np.flatnonzero(crossings % 2 == 0)
    if len(turned):
        inwards[turned] = normals[turned]
        found = bins.crossed(points[turned], inwards[turned] + tilt[turned])
        first[turned], opposite[turned] = found[:2]
    cosine = np.abs(
        (normals * (_normals(corners) / np.maximum(area, 1e-300)[:, None])[opposite]).sum(axis=1)
    )
    first[cosine < OPPOSED] = np.inf
    return Samples(points, inwards, first)


def badly_met(
    samples: Samples, field: Callable[[np.ndarray], np.ndarray] | None, cell: float, taper: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The error of a field of distances at samples of its mesh, (n,), and which of
    them it does not meet within SHARE of their thickness: lost and rounded, (n,) bool.

    field(points): its distances, (n,); None: of a grid that meets all that is thick enough for its
    cells. cell: their width. What is met badly is rounded, not lost, where the mesh tapers off: at
    most `taper` from there it is TAPERS times as thick, or half as much again, and met; and it gets
    so much thicker within SLENDER thicknesses.
    """
    from scipy.spatial import cKDTree

    thickness = samples.thickness
    error = np.zeros(len(thickness)) if field is None else np.abs(field(samples.points))
    badly = (error > SHARE * thickness) | (THINNEST * thickness < cell)
    solid = ~badly & np.isfinite(thickness)  # a tip is not, though its middle may be deep
    if field is not None:
        depth = np.minimum(thickness / 2.0, 2.0 * cell)
        solid &= field(samples.points + depth[:, None] * samples.inwards) <= -0.25 * depth
    rounded = np.zeros(len(error), bool)
    level = np.floor(np.log2(np.where(badly, thickness, 1.0)) * CLASSES)
    for one in np.unique(level[badly])[::-1]:
        mine = np.flatnonzero(badly & (level == one))
        most = thickness[mine].max()
        near = np.ones(len(mine), bool)
        for kept, reach in ((solid, taper), (solid | rounded, min(taper, SLENDER * most))):
            thicker = kept & (thickness >= TAPERS * most)
            if thicker.any():
                apart, _ = cKDTree(samples.points[thicker]).query(samples.points[mine])
                near &= apart <= reach
            else:
                near[:] = False
        rounded[mine] = near
    return error, badly & ~rounded, rounded


def _normals(corners: np.ndarray) -> np.ndarray:
    """Normals of faces, as long as twice their areas."""
    normals: np.ndarray = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals


class _Bins:
    """Which faces are in, or near, each bin of a grid around a mesh (m, 3, 3)."""

    def __init__(self, corners: np.ndarray):
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        self.corners = corners
        self.middles = corners.mean(axis=1)
        self.radii2 = ((corners - self.middles[:, None]) ** 2).sum(axis=2).max(axis=1)
        self.size = float((high - low).max())
        least, most = BINS
        # By the area that most faces have: they are small where a body is fine, as its hands are.
        width = np.sqrt(0.5 * FACES_OF_BIN * np.median(np.linalg.norm(_normals(corners), axis=1)))
        along = min(max(least, int(self.size / max(width, self.size / most))), most)
        while True:
            self.width = self.size / along
            self.low = low - self.width
            self.counts = np.ceil((high + self.width - self.low) / self.width).astype(np.int64)
            pad = 0.26 * self.width  # half a piece of a ray, and rounding
            first = np.floor((corners.min(axis=1) - pad - self.low) / self.width).astype(np.int64)
            last = np.floor((corners.max(axis=1) + pad - self.low) / self.width).astype(np.int64)
            sizes = last - first + 1
            if along <= least or sizes.prod(axis=1).sum() <= MOST_ENTRIES:
                break
            along = max(least, along // 2)
        face, inner = expanded(sizes.prod(axis=1))
        ny, nz = sizes[face, 1], sizes[face, 2]
        at = first[face] + np.column_stack([inner // (ny * nz), inner // nz % ny, inner % nz])
        number = self._number(at)
        order = np.argsort(number, kind="stable")
        self.face = face[order]
        self.start = np.searchsorted(number[order], np.arange(self.counts.prod() + 1))

    def _number(self, at: np.ndarray) -> np.ndarray:
        number: np.ndarray = (at[:, 0] * self.counts[1] + at[:, 1]) * self.counts[2] + at[:, 2]
        return number

    def _near(self, points: np.ndarray, ways: np.ndarray, face: np.ndarray) -> np.ndarray:
        """Which rays, (n,), come into the ball around their face, (n,) bool: a quick look first."""
        away = self.middles[face] - points
        along, way2 = np.einsum("nd,nd->n", away, ways), np.einsum("nd,nd->n", ways, ways)
        away2 = np.einsum("nd,nd->n", away, away)
        near: np.ndarray = away2 * way2 - along**2 <= self.radii2[face] * way2 + 1e-12 * away2
        return near

    def crossed(
        self, points: np.ndarray, ways: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lengths of rays from points (n, 3) along ways (n, 3), of about unit length, to the next
        face, (n,), infinite: there is none; which one; and how many faces each crosses in all.
        """
        nearest, which = np.full(len(points), np.inf), np.zeros(len(points), np.int64)
        crossings = np.zeros(len(points), np.int64)
        piece, own = 0.5 * self.width, 1e-6 * self.size
        active, k = np.arange(len(points)), 0
        while len(active):
            middle = points[active] + (k + 0.5) * piece * ways[active]
            at = np.floor((middle - self.low) / self.width).astype(np.int64)
            here = ((at >= 0) & (at < self.counts)).all(axis=1)
            active, number = active[here], self._number(at[here])
            row, inner = expanded(self.start[number + 1] - self.start[number])
            ray, face = active[row], self.face[self.start[number][row] + inner]
            near = self._near(points[ray], ways[ray], face)
            ray, face = ray[near], face[near]
            t, hit = _met(points[ray], ways[ray], self.corners[face])
            hit &= (t >= k * piece) & (t < (k + 1) * piece) & (t > own)
            ray, face, t = ray[hit], face[hit], t[hit]
            np.add.at(crossings, ray, 1)
            order = np.argsort(-t, kind="stable")  # the last of equal indices is what remains
            ray, face, t = ray[order], face[order], t[order]
            nearer = t < nearest[ray]
            nearest[ray[nearer]], which[ray[nearer]] = t[nearer], face[nearer]
            k += 1
        return nearest, which, crossings


def expanded(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of these lengths: the row of each entry, and its place in that."""
    row = np.repeat(np.arange(len(counts)), counts)
    return row, np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)


def _met(p: np.ndarray, way: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The way (n, 3) of each ray from p (n, 3) to its triangle's plane, and whether
    it does so within the triangle (Moeller, Trumbore, "Fast, minimum storage ray-triangle
    intersection", 1997).
    """
    ab, ac, ap = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], p - corners[:, 0]
    across = np.cross(way, ac)
    volume = (ab * across).sum(axis=1)
    turned = np.cross(ap, ab)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (ap * across).sum(axis=1) / volume
        v = (way * turned).sum(axis=1) / volume
        t = (ac * turned).sum(axis=1) / volume
    return t, (volume != 0) & (u >= 0) & (v >= 0) & (u + v <= 1)
