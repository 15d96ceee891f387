"""The strain of springs, and how much that is of what they bear."""

from __future__ import annotations

import numpy as np

from taichi_cloth.scene.model import Springs

# The strain that springs which cannot break are compared with: cloth that stretches by more than a
# tenth no longer looks like cloth (Provot, "Deformation constraints in a mass-spring model", 1995).
CLOTHS = 0.1


def allowed(position: np.ndarray, springs: Springs) -> float:
    """The strain that counts as full where springs cannot break.

    It is a cloth's; of what is stretched or squeezed by more from the start, such as a hanging
    spring, the largest there. position: (n, dim) at the start.
    """
    start = strains(lengths(position, springs.between), springs)
    return max(CLOTHS, float(np.abs(start).max(initial=0.0)))


def lengths(x: np.ndarray, between: np.ndarray) -> np.ndarray:
    """The distances of pairs of particles at x (n, dim), of between (s, 2); (s,)."""
    a, b = between.T
    d = x.take(b, axis=0) - x.take(a, axis=0)
    length: np.ndarray = np.sqrt(np.einsum("ij,ij->i", d, d))
    return length


def strains(length: np.ndarray, springs: Springs) -> np.ndarray:
    """(length - rest) / rest of springs, (s,); 0 of those that have no length at rest."""
    rest = springs.rest_length
    with np.errstate(divide="ignore", invalid="ignore"):
        part: np.ndarray = np.where(rest > 0, (length - rest) / rest, 0.0)
    return part


def may_break(length: np.ndarray, springs: Springs) -> np.ndarray:
    """Which springs of these lengths would break of more of the same, (s,) bool: what breaks in
    tension alone bears any push.
    """
    breaks: np.ndarray = np.isfinite(springs.break_force)
    if breaks.any():
        breaks &= (springs.break_in != "tension") | (length >= springs.rest_length)
    return breaks


def borne(length: np.ndarray, springs: Springs, full: float = CLOTHS) -> np.ndarray:
    """The load of springs in parts of their limit, (s,): 1 for a pull at it, -1 for a push.

    Where springs break of it that is their force in break forces, else their strain in `full`.
    """
    breaks = may_break(length, springs)
    if not breaks.any():
        return strains(length, springs) / full
    pull = springs.stiffness * (length - springs.rest_length) / springs.break_force
    return pull if breaks.all() else np.where(breaks, pull, strains(length, springs) / full)
