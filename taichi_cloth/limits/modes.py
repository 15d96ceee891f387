"""One mode, x'' = -omega^2 x - d v: by how much it grows in a step, and the largest stable step.

Around a state, particles obey M x'' = -K x - C v: K is the Hessian of the springs' energy, C holds
drag and dashpots. A method is stable while no disturbance of that system grows. What a method makes
of one mode is its own to say, beside its claims:

- a Runge-Kutta method by its `stability_function(z)`: a mode grows by |R(dt mu)| a step, where mu
  are the eigenvalues of the system itself, mu^2 + d mu + omega^2 = 0 (Hairer, Wanner, Solving
  Ordinary Differential Equations II, IV.2);
- a method that treats position and velocity differently by `amplification(h, omega2, d)`, its
  step as a matrix. Its modes are those of K and C together, which in general have none in
  common. But the matrix is linear in omega^2 and d, so every mode of the whole has a real
  omega^2 = u*Ku / u*Mu and d = u*Cu / u*Mu, and the limit is the least over all u. For symplectic
  Euler that is h^2 omega^2 + 2 h d < 4, for velocity Verlet, which takes drag at a predicted
  velocity, h^2 omega^2 + 4 h d < 4.

Which modes there are, `bounds` says roughly and in every geometry, `eigenmodes` for a state.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from taichi_cloth.kernels.methods.contract import Method

# A mode that grows by less than this a step does not: round-off of the computed growth.
ROUND_OFF = 1e-11


def growth(method: Method, h: float, omega2: float, damping: float) -> float:
    """By how much the mode x'' = -omega2 x - damping v grows in a step h, at most.

    inf where h times the rates is more than a number can be.
    """
    if method.stability_function:
        root = np.sqrt(complex(damping * damping / 4 - omega2))
        # The smaller root by the product of both: the difference would lose it to round-off.
        fast = -damping / 2 - root
        slow = omega2 / fast if fast else 0.0
        return max(float(abs(method.stability_function(h * mu))) for mu in (fast, slow))
    assert method.amplification  # one of the two, by the contract
    matrix = method.amplification(h, omega2, damping)
    return float(np.abs(np.linalg.eigvals(matrix)).max()) if np.isfinite(matrix).all() else math.inf


def largest_step(method: Method, omega2: float, damping: float = 0.0) -> float:
    """The largest h up to which the mode does not grow; inf where none is too large, 0 where all.

    Found by bisection on `growth`; what is unconditionally stable by its claims is not asked.
    """
    if math.isinf(method.claims.stability_limit) or (omega2 <= 0 and damping <= 0):
        return math.inf
    if not (math.isfinite(omega2) and math.isfinite(damping)):
        return 0.0
    if damping <= 0:
        return float(method.claims.stability_limit) / math.sqrt(omega2)
    # In units of time in which the faster of the two rates is 1.
    rate = max(math.sqrt(omega2), damping)
    omega2, damping = omega2 / rate / rate, damping / rate  # rate^2 may not be a number
    return _largest_multiple(lambda h: growth(method, h, omega2, damping)) / rate


def _largest_multiple(grows: Callable[[float], float]) -> float:
    """The largest h up to which grows(h) <= 1, where rates are about 1."""
    low = 4.0
    while grows(low) <= 1 + ROUND_OFF:
        low *= 2
        if low > 2.0**20:
            return math.inf
    while grows(low) > 1 + ROUND_OFF:
        low /= 2
        if low < 2.0**-20:
            return 0.0
    high = 2 * low
    while high - low > 1e-9 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if grows(middle) <= 1 + ROUND_OFF else (low, middle)
    return low
