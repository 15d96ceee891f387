"""The laws on values, against potentials, textbook formulas and conservation."""

import numpy as np
import pytest
import taichi as ti
from hypothesis import given, settings
from hypothesis import strategies as st

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels import laws

pytestmark = pytest.mark.usefixtures("device")

numbers = st.floats(-50, 50).map(lambda a: round(a, 6))
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
positive = st.floats(0.01, 100)


@kernel
def evaluate(law: ti.template(), a: ti.types.ndarray(), out: ti.types.ndarray()):
    """out = law(vectors and numbers of `a`): 0 spring, 1 dashpot, 2 pair, 3 stiffness, by `law`."""
    for _ in range(1):
        d = ti.Vector([a[0], a[1], a[2]])
        u = ti.Vector([a[3], a[4], a[5]])
        v = ti.Vector([a[6], a[7], a[8]])
        f = 0.0 * d
        if ti.static(law == 0):
            length = laws.length(d)
            f = laws.spring_tension(length, a[9], a[10]) * laws.unit(d, length)
        if ti.static(law == 1):
            along = laws.unit(d, laws.length(d))
            f = laws.dashpot_tension(u, along, a[9]) * along
        if ti.static(law == 2):
            f = laws.pair_bounce(d, u, v, a[9], a[10], a[11], a[12])
        if ti.static(law == 3):
            length = laws.length(d)
            along = laws.unit(d, length)
            across = laws.spring_stiffness_across(length, a[9], a[10], a[11])
            f = laws.stiffness_product(u, laws.stiffness_axis(along, a[9], across), across)
        for axis in ti.static(range(3)):
            out[axis] = f[axis]


def value(law, d, u=(0, 0, 0), v=(0, 0, 0), numbers=()):
    a = np.zeros(13)
    a[:9] = [*d, *u, *v]
    a[9 : 9 + len(numbers)] = numbers
    out = np.empty(3)
    evaluate(law, a, out)
    return out


@settings(max_examples=60, deadline=None)
@given(d=vectors, k=positive, rest=positive)
def test_spring_force_is_minus_the_gradient_of_its_energy(d, k, rest):
    length = np.linalg.norm(d)
    if length < 1e-2:
        return
    force = value(0, d, numbers=(k, rest))
    h = 1e-6 * max(length, 1.0)
    # the energy as a function of the near end: moving it by +h moves d by -h
    energy = lambda d: 0.5 * k * (np.linalg.norm(d) - rest) ** 2  # noqa: E731
    gradient = [(energy(d - h * e) - energy(d + h * e)) / (2 * h) for e in np.eye(3)]
    scale = k * (abs(length - rest) + length + rest)
    np.testing.assert_allclose(
        force, -np.array(gradient), atol=1e-7 * scale * max(1, rest / length)
    )


@settings(max_examples=60, deadline=None)
@given(d=vectors, k=positive, rest=positive)
def test_spring_stiffness_is_the_derivative_of_its_force(d, k, rest):
    length = np.linalg.norm(d)
    if length < 0.1:
        return
    matrix = np.array([value(3, d, u=e, numbers=(k, rest, -1e30)) for e in np.eye(3)])
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-12 * k * (1 + rest / length))
    h = 1e-5 * length
    force = lambda d: value(0, d, numbers=(k, rest))  # noqa: E731
    difference = np.array([(force(d + h * e) - force(d - h * e)) / (2 * h) for e in np.eye(3)])
    np.testing.assert_allclose(matrix, difference, rtol=0, atol=1e-7 * k * (1 + rest / length))


@settings(max_examples=60, deadline=None)
@given(d=vectors, k=positive, rest=positive)
def test_clamped_stiffness_is_the_nearest_without_negative_eigenvalues(d, k, rest):
    if 0 < np.linalg.norm(d) < 0.1:
        return
    exact, clamped = (
        np.array([value(3, d, u=e, numbers=(k, rest, least)) for e in np.eye(3)])
        for least in (-1e30, 0.0)
    )
    values, vectors_ = np.linalg.eigh((exact + exact.T) / 2)
    nearest = vectors_ @ np.diag(np.maximum(values, 0.0)) @ vectors_.T
    scale = k * (1 + rest / max(np.linalg.norm(d), 0.1))
    np.testing.assert_allclose(clamped, nearest, rtol=0, atol=1e-12 * scale)


def test_spring_with_coincident_ends_pulls_nowhere():
    assert (value(0, (0, 0, 0), numbers=(3.0, 2.0)) == 0).all()
    assert (value(1, (0, 0, 0), u=(1, 2, 3), numbers=(3.0,)) == 0).all()


@kernel
def roots(a: ti.types.ndarray(), out: ti.types.ndarray()):
    for i in range(a.shape[0]):
        out[i] = laws.root(a[i])


def test_root_without_a_branch_is_the_root(monkeypatch):
    """As CUDA computes it in f32 with fast_math: to the last bit or the one before."""
    monkeypatch.setattr(laws, "branches_at_roots", lambda: True)
    a = np.concatenate([[0.0], np.geomspace(1e-30, 1e30, 601)]).astype(np.float32)
    out = np.empty_like(a)
    roots(a, out)
    assert out[0] == 0.0
    np.testing.assert_allclose(out, np.sqrt(a), rtol=2.0**-22)


@settings(max_examples=60, deadline=None)
@given(d=vectors, u=vectors, c=positive)
def test_dashpot_resists_lengthening_only(d, u, c):
    if np.linalg.norm(d) < 1e-2:
        return
    n = d / np.linalg.norm(d)
    np.testing.assert_allclose(value(1, d, u, numbers=(c,)), c * (u @ n) * n, atol=1e-9 * c * 100)


@settings(max_examples=100, deadline=None)
@given(d=vectors, u=vectors, v=vectors, m1=positive, m2=positive, e=st.floats(0, 1))
def test_pair_bounce_keeps_momentum_and_reverses_the_approach(d, u, v, m1, m2, e):
    reach = 60.0
    jump1 = value(2, d, u, v, (1 / m1, 1 / m2, reach, e))
    jump2 = value(2, -d, v, u, (1 / m2, 1 / m1, reach, e))
    distance = np.linalg.norm(d)
    np.testing.assert_allclose(m1 * jump1, -m2 * jump2, atol=1e-9 * (m1 + m2))
    if not 0 < distance <= reach or d @ (u - v) < 0:
        assert (jump1 == 0).all()
    else:
        n = d / distance
        after = (u + jump1 - v - jump2) @ n
        assert after == pytest.approx(-e * ((u - v) @ n), abs=1e-9)
