"""The graph of particles and springs, as arrays (NumPy)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taichi_cloth.scene import Springs


@dataclass(frozen=True)
class HalfSprings:
    """Every spring seen from both of its ends, grouped by particle (compressed rows).

    Particle i's half-springs are row[i] .. row[i + 1], in the order of the springs' numbers.
    row: (n + 1,) int32; near, far: (2s,) int32, the particle i and the one at the other end;
    spring: (2s,) int64, the spring's number; half: (s, 2) int32, a spring's two half-springs, in
    the order of its ends.
    """

    row: np.ndarray
    near: np.ndarray
    far: np.ndarray
    spring: np.ndarray
    half: np.ndarray


def half_springs(between: np.ndarray, particle_count: int) -> HalfSprings:
    """Adjacency of the springs `between` (s, 2) among `particle_count` particles."""
    s = len(between)
    near, far = between.ravel(), between[:, ::-1].ravel()
    order = np.argsort(near, kind="stable")
    half = np.empty(2 * s, np.int32)
    half[order] = np.arange(2 * s, dtype=np.int32)
    row = np.zeros(particle_count + 1, np.int32)
    np.cumsum(np.bincount(near, minlength=particle_count), out=row[1:])
    return HalfSprings(
        row=row,
        near=near[order].astype(np.int32),
        far=far[order].astype(np.int32),
        spring=order // 2,
        half=half.reshape(s, 2),
    )


def largest_angular_frequency(
    springs: Springs, mass: np.ndarray, fixed: np.ndarray
) -> tuple[float, int]:
    """Gershgorin's bound on the fastest vibration: (omega, the particle that sets it).

    omega^2 <= max_i (1/m_i) * (sum of k to all neighbours + sum of k to free neighbours), the
    largest row sum of |M^-1 K|. Returns (0.0, -1) without springs.
    """
    n = len(mass)
    if len(springs) == 0 or fixed.all():
        return 0.0, -1
    a, b = springs.between.T
    k = springs.stiffness
    with np.errstate(over="ignore"):  # an infinite bound is a true answer
        to_a, to_b = k * (1.0 + ~fixed[b]), k * (1.0 + ~fixed[a])
        row_sum = np.bincount(a, to_a, n) + np.bincount(b, to_b, n)
        omega2 = np.where(fixed, 0.0, row_sum / mass)
    worst = int(omega2.argmax())
    return float(np.sqrt(omega2[worst])), worst
