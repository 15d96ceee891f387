"""The smallest step that a precision can follow: below it, sums no longer change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Stall:
    """The step below which a sum no longer changes: `what`, "x" or "v", of a particle.

    value: the largest coordinate or speed it has; rate: what it changes by per time.
    """

    dt: float
    what: str
    particle: int
    value: float
    rate: float

    def describe(self) -> str:
        if self.particle < 0:
            return "nothing: nothing moves"
        names = {"x": ("x", "speed"), "v": ("v", "acceleration")}[self.what]
        return (
            f"{names[0]} of particle {self.particle}: {self.value:.4g}, {names[1]} {self.rate:.3g}"
        )


# Slower than the fastest by this factor is at rest: round-off of a balance of forces.
AT_REST = 1e-3


def stall(
    position: np.ndarray,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    fixed: np.ndarray,
    dt: float,
    *,
    bits: int = 24,
    sums: str = "xv",
) -> Stall:
    """The step below which numbers of `bits` binary digits lose the motion a scene starts with.

    A sum x + h v stays x where h v is less than half the distance of x to the next number. Looked
    at is each free particle's speed after one frame, |v| + |a| dt, at its largest coordinate, and
    the acceleration that has to change this speed. The answer is the largest step at which one
    particle's x or v stalls.

    position, velocity, acceleration: (n, dim), at the start.
    fixed: (n,) bool.
    dt: time of a frame.
    bits: 24 of f32, 53 of f64.
    sums: which are looked at: those of positions, "x", of velocities, "v", or both.
    """
    a = np.linalg.norm(acceleration, axis=1)
    speed = np.linalg.norm(velocity, axis=1) + a * dt
    place = np.abs(position).max(axis=1, initial=0.0)
    best = Stall(0.0, "x", -1, 0.0, 0.0)
    for what, value, rate in (("x", place, speed), ("v", speed, a)):
        if what not in sums:
            continue
        rate = np.where(fixed, 0.0, rate)
        moving = rate > AT_REST * rate.max(initial=0.0)
        if not moving.any():
            continue
        with np.errstate(all="ignore"):
            half_ulp = 2.0 ** (np.floor(np.log2(value)) - bits)
            step = np.where(moving, half_ulp / rate, 0.0)
        worst = int(step.argmax())
        if step[worst] > best.dt:
            best = Stall(float(step[worst]), what, worst, float(value[worst]), float(rate[worst]))
    return best
