"""The ghost of a picture: its particles and what joins them, where somebody else says they are."""

from __future__ import annotations

import numpy as np

from taichi_cloth.render.drawing import Cached
from taichi_cloth.render.picture import Ghost, Picture

NO_TRIANGLES = np.zeros((0, 3), np.int64)


WHOLE = 6000  # particles of which all of a ghost is drawn, which takes as long as they themselves
PINS = 300  # of more, so many


class Ghosts:
    """Makes ghosts of pictures; what has not changed is kept from one to the next.

    Of many particles, some have a pin instead, whose head is where the ghost is: a dense cloth
    would hide a ghost, and drawing one more takes too long.
    """

    def __init__(self) -> None:
        self._parts, self._first = Cached(_parts), Cached(_first)
        self._pinned = Cached(_pinned)

    def of(self, picture: Picture, away: np.ndarray, torn: np.ndarray) -> Ghost:
        """The ghost of a picture whose first n particles are away from where it has them.

        away: (n, dim). torn: (k, 2), between which particles the ghost has no springs.
        """
        count = len(away)
        if count > WHOLE:
            return self._pins(picture, away)
        everything = picture.segments, picture.triangles, picture.as_spheres
        segments, triangles, spheres = self._parts(*everything, count, torn)
        normals = picture.normals
        return Ghost(
            position=picture.position[:count] + away,
            radius=self._first(picture.radius, count),
            segments=segments,
            triangles=triangles,
            as_spheres=spheres,
            normals=None if normals is None else normals[:count],
        )

    def _pins(self, picture: Picture, away: np.ndarray) -> Ghost:
        """A pin from some of the particles to where the ghost is."""
        which, segments, heads = self._pinned(len(away))
        here = picture.position[which]
        position = np.concatenate([here, here + away[which]])
        radius = np.tile(picture.radius[which], 2)
        return Ghost(position, radius, segments, NO_TRIANGLES, heads, None, over=True)


def _pinned(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which of so many particles have a pin, (k,); from where to where these go, (k, 2), in a row
    of their feet and then their heads; which of these are heads, (2 k,).
    """
    which = np.arange(0, count, -(-count // PINS) | 1)  # odd, so as not to follow a grid's lines
    feet = np.arange(len(which))
    segments = np.stack([feet, feet + len(which)], axis=1)
    return which, segments, np.repeat([False, True], len(which))


def _first(values: np.ndarray, count: int) -> np.ndarray:
    return values[:count]


def _parts(
    segments: np.ndarray,
    triangles: np.ndarray,
    as_spheres: np.ndarray | None,
    count: int,
    torn: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Springs, triangles and drawn particles that a ghost of `count` particles has, too.

    torn: (k, 2), the sides that it does not have.
    """
    spheres = np.ones(count, bool) if as_spheres is None else as_spheres[:count]
    segments = segments[(segments < count).all(axis=1)]
    triangles = triangles[(triangles < count).all(axis=1)]
    if len(torn):
        gone = _numbers(torn, count)
        segments = segments[~np.isin(_numbers(segments, count), gone)]
        sides = [triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]
        whole = [~np.isin(_numbers(side, count), gone) for side in sides]
        triangles = triangles[np.logical_and.reduce(whole)]
    return segments, triangles, spheres


def _numbers(pairs: np.ndarray, count: int) -> np.ndarray:
    """One number for each pair of particles (k, 2), whichever comes first in it."""
    low, high = np.sort(pairs, axis=1).astype(np.int64).T
    numbers: np.ndarray = low * count + high
    return numbers
