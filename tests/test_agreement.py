"""Scenes on a GPU beside the CPU, as `taichi-cloth bench gpu` compares them."""

import numpy as np
import pytest
from selection import thorough

from bench import agreement
from bench.contest import Bench


@pytest.fixture
def bench():
    made = Bench(quick=True)
    yield made
    made.close()


def test_distances_are_parts_of_the_extent():
    one = np.array([[0.0, 0.0], [4.0, 3.0]])
    assert agreement.relative(one, one) == 0.0
    assert agreement.relative(one, one + [0.6, 0.8]) == 0.25


def test_a_row_is_of_the_method_that_is_farthest():
    apart = {("a", "rk4"): 1e-9, ("a", "vbd"): 1e-5, ("b", "rk4"): 0.0}
    far, near = agreement.rows("gpu", "cuda", apart, "")
    assert (far.size, far.rate, far.met) == ("a", 1e-5, False) and "(vbd)" in far.contestant
    assert (near.size, near.rate, near.met) == ("b", 0.0, True)


def test_what_fails_is_left_out_with_its_reason(bench, monkeypatch):
    monkeypatch.setattr(agreement, "QUICK_SCENES", ("chain", "nowhere"))
    monkeypatch.setattr(agreement, "QUICK_METHODS", ("explicit_euler",))
    (row,) = agreement.measure(bench, "gpu", "cpu", "")
    assert (row.size, row.rate) == ("chain", 0.0)
    (left,) = bench.left_out
    assert left.size == "nowhere" and "unknown" in left.note


def test_a_pair_that_never_answers_is_left_out(bench, monkeypatch):
    monkeypatch.setattr(agreement, "QUICK_SCENES", ("chain",))
    monkeypatch.setattr(agreement, "QUICK_METHODS", ("verlet",))
    monkeypatch.setattr(agreement, "LONGEST", 0.05)
    assert list(agreement.measure(bench, "gpu", "cpu", "")) == []
    (left,) = bench.left_out
    assert left.note == "left out: no answer in 0.05 s"


@thorough
@pytest.mark.parametrize(
    ("arch", "method", "scenes"),
    [("vulkan", "implicit_euler", ("box", "curtain")), ("opengl", "rk4", ("twist",))],
)
def test_a_software_driver_agrees_with_the_cpu(arch, method, scenes, bench, display, monkeypatch):
    """With gusts and four stages, a spinning obstacle, particles that hit each other."""
    monkeypatch.setattr(agreement, "QUICK_SCENES", scenes)
    monkeypatch.setattr(agreement, "QUICK_METHODS", (method,))
    found = list(agreement.measure(bench, "gpu", arch, ""))
    assert tuple(row.size for row in found) == scenes and not bench.left_out
    assert all(row.met for row in found), [(row.size, row.rate) for row in found]
