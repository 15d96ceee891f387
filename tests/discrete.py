"""One step of each method on x'' = -w^2 x as a matrix on (x, v): its exact discrete map.

A method that comes to the program adds its own here; all else that tests ask of it are its claims.
"""

import math

import numpy as np


def _rational(numerator, denominator):
    """A method that maps z' = A z by numerator(hA) / denominator(hA): coefficients from 1 on."""

    def step(h, w2):
        a = h * np.array([[0, 1], [-w2, 0]])

        def value(coefficients):
            return sum(c * np.linalg.matrix_power(a, n) for n, c in enumerate(coefficients))

        return np.linalg.solve(value(denominator), value(numerator))

    return step


def _tr_bdf2(h, w2):
    a, g = h * np.array([[0, 1], [-w2, 0]]), 2 - math.sqrt(2)
    left, one = np.eye(2) - 0.5 * g * a, np.eye(2)
    first = np.linalg.solve(left, one + 0.5 * g * a)
    return np.linalg.solve(left, (first - (1 - g) ** 2 * one) / (g * (2 - g)))


DISCRETE = {
    "symplectic_euler": lambda h, w2: np.array([[1 - h * h * w2, h], [-h * w2, 1]]),
    "explicit_euler": lambda h, w2: np.array([[1, h], [-h * w2, 1]]),
    "verlet": lambda h, w2: np.array(
        [[1 - h * h * w2 / 2, h], [-h * w2 * (1 - h * h * w2 / 4), 1 - h * h * w2 / 2]]
    ),
    "rk4": _rational([1 / math.factorial(n) for n in range(5)], [1]),
    "implicit_euler": _rational([1], [1, -1]),
    "implicit_midpoint": _rational([1, 0.5], [1, -0.5]),
    "tr_bdf2": _tr_bdf2,
    "vbd": _rational([1], [1, -1]),
    "xpbd": _rational([1], [1, -1]),
}
