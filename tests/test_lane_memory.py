"""The memory of packs of several lanes as one array of vectors: `kernels/lane_memory.py`."""

from dataclasses import replace

import inside
import numpy as np
import pytest
import small
import taichi as ti

from taichi_cloth import runtime
from taichi_cloth.kernels import packs, stepping
from taichi_cloth.simulation.simulation import Simulation


@pytest.fixture
def sim(few_lanes):
    return Simulation(small.build("warp"), "tr_bdf2", topology="lanes")


def test_it_is_the_memory_of_the_fields(sim):
    """Each field of packs lies in it, whole and where it says, apart from all others."""
    state = inside.state_of(sim)
    memory, taken = state.lane_memory, np.zeros(len(state.lane_memory), int)
    fields = [f for f in vars(state).values() if hasattr(f, "first_vector")]
    assert state.x in fields and state.w in fields
    for number, field in enumerate(fields, start=1):
        field.fill(number)
        count = int(np.prod(field.shape)) // sim.storage.specialization.lanes
        taken[field.first_vector : field.first_vector + count] += 1
        assert (memory[field.first_vector : field.first_vector + count] == number).all()
    assert (taken == 1).all()
    memory[state.v.first_vector] = 7.0
    assert state.v[0, 0] == 7.0 and state.v[0, state.lanes] != 7.0


def test_what_a_kernel_stores_it_reads(sim):
    """Whole packs and single numbers, in the order of the program, whatever Taichi moves about."""

    @ti.func
    def stored(spec: ti.template(), state: ti.template(), t):
        first = packs.read(spec, state.x, 0)
        packs.write(spec, state.x, 0, first + first)
        twice = packs.read(spec, state.x, 0)
        packs.set_slot_value(spec, state.x, 1, ti.Vector([1.0, 2.0, 3.0]))
        one = packs.read(spec, state.x, 0)
        packs.write(spec, state.v, 0, one + twice)
        state.sums[0, 0] = packs.slot_value(spec, state.v, 1)[2]
        packs.write(spec, state.x, 0, first)

    state, spec = inside.state_of(sim), sim.storage.specialization
    x = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    for k, lane in np.ndindex(x.shape):
        state.x[0, k * spec.lanes + lane] = x[k, lane]
    run = stepping.kernels_of(spec.lanes, state.real).once
    with runtime.whole_vectors():
        run(stored, replace(spec, threads=1), state, state.lane_memory)

    def pack(field):
        return np.array([field[0, at] for at in range(3 * spec.lanes)]).reshape(3, -1)

    assert (pack(state.x) == x).all()
    expected = 4.0 * x
    expected[:, 1] = 2.0 * x[:, 1] + [1.0, 2.0, 3.0]
    assert (pack(state.v) == expected).all()
    assert state.sums[0, 0] == expected[2, 1]


def test_a_kernel_that_reads_it_both_ways_is_refused(sim):
    """What `inside.refuse_both_ways` does in all tests is seen to work."""

    @ti.func
    def both(spec: ti.template(), state: ti.template(), t):
        state.x[0, 0] = 1.0

    state, spec = inside.state_of(sim), sim.storage.specialization
    run = stepping.kernels_of(spec.lanes, state.real).once
    with pytest.raises(Exception, match="reads a field of it"):
        run(both, spec, state, state.lane_memory)
