"""Readings of a run at one moment, for a post-mortem."""

from __future__ import annotations

import math
from dataclasses import dataclass

from taichi_cloth.limits.eigenmodes import Limit
from taichi_cloth.limits.tracking import Shares


@dataclass(frozen=True)
class Sample:
    """A sample of one moment.

    time: the scene's. frame: how many were done; part: of the frame that failed, how much, else 0.
    total, moving: the whole energy, and that of motion and springs. drift: what of it came from
    nothing; work, by_hand: from forces without a potential, and from what was done. reach: h omega;
    used: the part of the stable step that is used. method, h: the method and the step of then.
    limit: the stable step, and what sets it; shares: what that is made of; stiffness, inverse: of
    the spring that sets it, with the inverse masses at its ends (0.0 and () where none does).
    strain, spring, ends: the largest, and whose. speed, fastest: the largest, and whose. broken:
    springs that are.
    """

    time: float
    frame: int
    part: float
    total: float
    moving: float
    drift: float
    work: float
    by_hand: float
    reach: float
    used: float
    method: str
    h: float
    limit: Limit
    shares: Shares | None
    stiffness: float
    inverse: tuple[float, ...]
    strain: float
    spring: int
    ends: tuple[int, int]
    speed: float
    fastest: int
    broken: int

    @property
    def damped(self) -> float:
        """h d, of the mode that is the first to grow; NaN where none is known."""
        return math.nan if self.shares is None else self.h * self.shares.d
