"""Steps compiled in parts (`kernels/parts.py`) against steps that are one kernel."""

import gc
import weakref
from dataclasses import replace

import inside
import numpy as np
import pytest
import small
import taichi as ti
from selection import as_thorough

from taichi_cloth.front_end import mending
from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels import parts
from taichi_cloth.simulation.simulation import Simulation

FRAMES = 8
RUNS = [("symplectic_euler", "parallel"), as_thorough(("implicit_euler", "serial"))]


@pytest.mark.parametrize(("method", "execution"), RUNS)
def test_a_run_in_parts_has_the_bits_of_one_in_a_piece(method, execution, monkeypatch):
    """Sheets thrown onto each other and the ground: pairs and obstacles act."""
    scene = small.build("stack")
    thrown = np.full(scene.particles.position.shape, [0.0, -4.0, 0.0])
    scene = replace(scene, particles=replace(scene.particles, velocity=thrown))

    def run():
        given = {"topology": "graph", "execution": execution, "substeps": 20}
        sim = Simulation(scene, method, **given)
        sim.advance(FRAMES)
        return sim, sim.positions(), sim.velocities()

    sim, *in_parts = run()
    state = inside.state_of(sim)
    assert state.functions and state.colour_size.to_numpy().any()
    monkeypatch.setattr(mending, "functions_work", lambda: False)
    sim, *in_a_piece = run()
    assert not inside.state_of(sim).functions
    np.testing.assert_array_equal(in_parts, in_a_piece)


def act(digit):
    """An act that writes a digit behind those that are there."""

    @ti.func
    def write(spec: ti.template(), state: ti.template(), t):
        state.step[None] = 10 * state.step[None] + digit + t

    return write


ACTS = tuple(act(digit) for digit in (1, 2, 3))


@kernel
def write_all(spec: ti.template(), state: ti.template(), times: ti.i32):
    for _ in range(1):
        state.step[None] = 0
        for _k in range(times):
            ti.static(parts.in_turn(state, ACTS))(spec, state, 2)


def test_acts_take_their_turns_and_keep_no_fields():
    sim = Simulation(small.build("net"), "verlet", topology="graph")
    state = inside.state_of(sim)
    write_all(inside.spec_of(sim), state, 2)
    assert state.step[None] == 345345
    seen = weakref.ref(state)
    del sim, state
    gc.collect()
    assert seen() is None
