"""Launches with what an earlier one had (`simulation/prepared.py`) against Taichi's own."""

import gc
import weakref
from types import SimpleNamespace

import inside
import numpy as np
import pytest
import small
import taichi as ti

from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels import readback
from taichi_cloth.simulation import prepared
from taichi_cloth.simulation.prepared import PreparedLaunches
from taichi_cloth.simulation.simulation import Simulation


@kernel
def mix(state: ti.template(), start: ti.i32, numbers: ti.types.ndarray(), factor: ti.f64) -> ti.f64:
    """Add numbers and `factor` times the state's count of particles, from `start` on."""
    total = ti.cast(0.0, ti.f64)
    for _ in range(1):
        for k in range(start, numbers.shape[0]):
            total += numbers[k] + factor * state.n[None]
            numbers[k] = 0
    return total


@pytest.fixture(scope="module")
def sim():
    return Simulation(small.build("net"), "verlet")


def test_what_is_given_anew_is_used_anew(sim):
    """Numbers, and arrays of other lengths and places; what a kernel writes and returns."""
    launches, state = PreparedLaunches(), inside.state_of(sim)
    count = state.n[None]
    for length, start, factor in ((3, 0, 1.0), (5, 2, 0.5), (2, 1, -2.5)):
        numbers = np.arange(length, dtype=np.float64)
        expected = numbers[start:].sum() + (length - start) * factor * count
        given = state, start, numbers, factor
        found = launches.find(mix, given)
        if found is None:
            assert length == 3
            result = mix(*given)
            launches.note(mix, given)
        else:
            result = found(given)
        assert result == expected
        np.testing.assert_array_equal(numbers, [*range(start), *[0] * (length - start)])
    numbers[:] = 1.0  # the same array, with other contents, and another number
    again = state, 0, numbers, 3.0
    assert launches.find(mix, again)(again) == 2 * (1.0 + 3.0 * count)
    other = state, 0, np.full(7, 2.0), 1.0
    assert launches.find(mix, other)(other) == 7 * (2.0 + count)
    assert launches.find(mix, again)(again) == 2 * 3.0 * count


def test_other_kinds_of_arguments_are_found_apart(sim):
    launches, state = PreparedLaunches(), inside.state_of(sim)
    given = state, 0, np.zeros(4), 1.0
    mix(*given)
    launches.note(mix, given)
    assert launches.find(mix, given) is not None
    other = inside.state_of(Simulation(small.build("net"), "verlet"))
    for unlike in (
        (state, 0, np.zeros(4, np.float32), 1.0),  # compiled anew
        (state, 0, np.zeros((4, 1)), 1.0),
        (state, 0, np.zeros(8)[::2], 1.0),  # which Taichi refuses
        (other, 0, np.zeros(4), 1.0),
    ):
        assert launches.find(mix, unlike) is None
    assert launches.find(readback.take_work, (state, np.zeros(4, np.int32))) is None


def test_kernels_without_a_state_or_with_vectors_are_launched_as_usual(sim):
    @kernel
    def moved(state: ti.template(), by: ti.math.vec3):
        state.time[None] = by[0]

    launches, state = PreparedLaunches(), inside.state_of(sim)
    half = np.zeros(2, np.int32), np.zeros((2, 1))
    for launched, given in (
        (moved, (state, ti.math.vec3(1.0, 2.0, 3.0))),
        (readback.read_numbers, (state.w, *half)),
    ):
        launches.note(launched, given)
        assert launches.find(launched, given) is None


def test_fields_that_are_dropped_are_not_kept():
    sim = Simulation(small.build("net"), "verlet")
    launches, state = PreparedLaunches(), inside.state_of(sim)
    given = state, 0, np.zeros(4), 1.0
    mix(*given)
    launches.note(mix, given)
    seen = weakref.ref(state)
    del sim, state, given
    gc.collect()
    assert seen() is None


def test_what_another_start_of_taichi_prepared_is_not_launched(sim, monkeypatch):
    launches, given = PreparedLaunches(), (inside.state_of(sim), 0, np.zeros(4), 1.0)
    mix(*given)
    launches.note(mix, given)
    assert launches.find(mix, given) is not None
    monkeypatch.setattr(prepared, "_runtime", lambda: SimpleNamespace())
    assert launches.find(mix, given) is None


@pytest.mark.parametrize("method", ["tr_bdf2", "verlet"])
def test_a_run_has_the_bits_of_one_without(topology, few_lanes, monkeypatch, method):
    """Methods in phases and in whole frames, with a pin, a finer step and a reset between frames;
    of the latter also on another path, which for phases takes half a minute to compile.
    """

    def run():
        sim = Simulation(small.build("net"), method, substeps=1, topology=topology)
        for k in range(11):
            sim.advance(1 + k % 2)
            if k == 1:
                sim.pin([3])
            if k == 3:
                sim.set_step(substeps=2)
            if k in (5, 7) and method == "verlet":
                sim.storage.set_path("parallel" if k == 5 else "serial")
        found = sim.positions(), sim.velocities()
        sim.reset()
        sim.advance(2)
        return *found, sim.positions()

    found, again = [], []
    find, launch = PreparedLaunches.find, prepared.PreparedLaunch.launch

    def noting(self, kernel, arguments):
        found.append(find(self, kernel, arguments))
        return found[-1]

    def repeating(self, *numbers):
        again.append(numbers)
        return launch(self, *numbers)

    monkeypatch.setattr(PreparedLaunches, "find", lambda *_: None)
    usual = run()
    monkeypatch.setattr(PreparedLaunches, "find", noting)
    monkeypatch.setattr(prepared.PreparedLaunch, "launch", repeating)
    np.testing.assert_array_equal(np.concatenate(run()), np.concatenate(usual))
    assert sum(one is not None for one in found) + len(again) > (len(found) + len(again)) / 2
    assert (len(again) > 4) == (method == "verlet" or topology == "graph")
