"""Arithmetic on the vectors of a pack, `kernels/vectors.py`, beside NumPy's on the same numbers."""

from dataclasses import replace

import inside
import numpy as np
import pytest
import small
import taichi as ti

from taichi_cloth import runtime
from taichi_cloth.kernels import packs, stepping
from taichi_cloth.simulation.simulation import Simulation

X = np.array([[1.0, -2.0], [3.0, 0.5], [-5.0, 4.0]])
V = np.array([[2.0, 8.0], [-1.0, 0.25], [4.0, -2.0]])
W = np.array([0.5, 0.0])  # a number for each lane


@pytest.fixture
def computed(few_lanes):
    """What a body makes of x, v and w, with one number `s` for all, 3: the vectors it returns."""
    sim = Simulation(small.build("warp"), "tr_bdf2", topology="lanes")

    def compute(expression):
        state, spec = inside.state_of(sim), sim.storage.specialization

        @ti.func
        def body(spec: ti.template(), state: ti.template(), t):
            x, v = packs.read(spec, state.x, 0), packs.read(spec, state.v, 0)
            s = 3.0 + ti.cast(t, state.real)
            packs.write(spec, state.a, 0, expression(x, v, packs.read(spec, state.w, 0), s))

        for numbers, field in ((X, state.x), (V, state.v), (W[None], state.w)):
            for k, lane in np.ndindex(numbers.shape):
                field[0, k * spec.lanes + lane] = numbers[k, lane]
        with runtime.whole_vectors():
            kernel = stepping.kernels_of(spec.lanes, state.real).once
            kernel(body, replace(spec, threads=1), state, state.lane_memory)
        return np.array([state.a[0, at] for at in range(3 * spec.lanes)]).reshape(3, -1)

    return compute


def test_arithmetic_is_that_of_each_component(computed):
    @ti.func
    def expression(x, v, w, s):
        return 2.0 * x - v / 4.0 + s * (x * v) + (1.0 - x) - (s - v) + (0.25 + x) * w + (x - s) * s

    expected = 2 * X - V / 4 + 3 * (X * V) + (1 - X) - (3 - V) + (0.25 + X) * W + (X - 3) * 3
    np.testing.assert_allclose(computed(expression), expected, rtol=1e-6)


def test_a_variable_is_a_copy(computed):
    """Also of an argument, and what is assigned under a condition or in a loop stays there."""

    @ti.func
    def grown(a, b):
        for _ in range(2):
            a += b
        return a

    @ti.func
    def expression(x, v, w, s):
        y = x
        if s > 2.0:
            y = v
        y += x
        z = grown(x, v)
        return 10.0 * y + 100.0 * z + x

    expected = 10 * (V + X) + 100 * (X + 2 * V) + X
    np.testing.assert_allclose(computed(expression), expected, rtol=1e-6)


def test_components_numbers_and_conditions(computed):
    @ti.func
    def expression(x, v, w, s):
        a = packs.with_component(x, 1, packs.component(v, 0) * s)
        a += packs.dot(x, v)
        lane = ti.cast(s, ti.i32) - 2  # 1, known only at run time
        packs.set_vector_of_lane(a, lane, packs.vector_of_lane(v, lane) * 2.0)
        return packs.where_positive(w, a, a - 100.0)

    expected = X.copy()
    expected[1] = 3 * V[0]
    expected += (X * V).sum(axis=0)
    expected[:, 1] = 2 * V[:, 1]
    np.testing.assert_allclose(computed(expression), np.where(W > 0, expected, expected - 100))
