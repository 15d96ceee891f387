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


def run(sim, body):
    """Run a body once, on one thread, as steps are run."""
    state, spec = inside.state_of(sim), sim.storage.specialization
    kernel = stepping.kernels_of(spec.lanes, state.real).once
    with runtime.whole_vectors():
        kernel(body, replace(spec, threads=1), state, state.lane_memory)


def pack(sim, field):
    """The numbers of pack 0, (dim, lanes)."""
    lanes = sim.storage.specialization.lanes
    return np.array([field[0, at] for at in range(3 * lanes)]).reshape(3, -1)


def set_pack(sim, field, numbers):
    """Store the numbers of pack 0, (dim, lanes)."""
    for k, lane in np.ndindex(numbers.shape):
        field[0, k * numbers.shape[1] + lane] = numbers[k, lane]


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

    state = inside.state_of(sim)
    x = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    set_pack(sim, state.x, x)
    run(sim, stored)
    assert (pack(sim, state.x) == x).all()
    expected = 4.0 * x
    expected[:, 1] = 2.0 * x[:, 1] + [1.0, 2.0, 3.0]
    assert (pack(sim, state.v) == expected).all()
    assert state.sums[0, 0] == expected[2, 1]


# Bodies that read pack 0 of x, store 9 there, and read it again; they store the sum of both in v.
# By itself Taichi takes a vector in memory and a number in it for different memory.


@ti.func
def number_under_a_condition(spec: ti.template(), state: ti.template(), t):
    total = packs.read(spec, state.x, 0)
    if t == 0:
        packs.set_slot_value(spec, state.x, t, ti.Vector([9.0, 9.0, 9.0]))
    packs.write(spec, state.v, 0, total + packs.read(spec, state.x, t))


@ti.func
def numbers_in_a_loop(spec: ti.template(), state: ti.template(), t):
    total = packs.read(spec, state.x, t)
    for lane in range(spec.lanes):
        packs.set_slot_value(spec, state.x, lane, ti.Vector([9.0, 9.0, 9.0]))
    packs.write(spec, state.v, 0, total + packs.read(spec, state.x, 0))


@ti.func
def number_at_each_turn(spec: ti.template(), state: ti.template(), t):
    total = packs.zeros(spec, state)
    for _ in range(2):
        total += packs.read(spec, state.x, 0)
        packs.set_slot_value(spec, state.x, 0, ti.Vector([9.0, 9.0, 9.0]))
    packs.write(spec, state.v, 0, total)


@ti.func
def whole_between_numbers(spec: ti.template(), state: ti.template(), t):
    total = packs.slot_value(spec, state.x, 0)
    for i in range(1):
        packs.write(spec, state.x, i, packs.zeros(spec, state) + 9.0)
    packs.set_slot_value(spec, state.v, 0, total + packs.slot_value(spec, state.x, 0))


@ti.func
def whole_at_another_name(spec: ti.template(), state: ti.template(), t):
    total = packs.read(spec, state.x, t)
    packs.write(spec, state.x, 0, packs.zeros(spec, state) + 9.0)
    packs.write(spec, state.v, 0, total + packs.read(spec, state.x, t))


@ti.func
def number_in_a_pack(spec: ti.template(), state: ti.template(), t):
    first = packs.number_in_pack(spec, state.x, 0, 0)
    packs.write(spec, state.x, 0, packs.zeros(spec, state) + 9.0)
    total = first + packs.number_in_pack(spec, state.x, 0, 0)
    packs.set_number_in_pack(spec, state.v, t, 0, total)


@pytest.mark.parametrize(
    "body",
    [
        number_under_a_condition,
        numbers_in_a_loop,
        number_at_each_turn,
        whole_between_numbers,
        whole_at_another_name,
        number_in_a_pack,
    ],
    ids=lambda body: body.__name__,
)
def test_what_is_stored_in_one_way_is_read_in_another(sim, body):
    state = inside.state_of(sim)
    set_pack(sim, state.x, np.ones((3, sim.storage.specialization.lanes)))
    run(sim, body)
    assert pack(sim, state.v)[0, 0] == 10.0


def test_a_kernel_that_reads_it_both_ways_is_refused(sim):
    """What `inside.refuse_both_ways` does in all tests is seen to work."""

    @ti.func
    def both(spec: ti.template(), state: ti.template(), t):
        state.x[0, 0] = 1.0

    state, spec = inside.state_of(sim), sim.storage.specialization
    run = stepping.kernels_of(spec.lanes, state.real).once
    with pytest.raises(Exception, match="reads a field of it"):
        run(both, spec, state, state.lane_memory)
