"""Implicit steps solved roughly, by a tolerance up to 1: what they leave, and what they lose."""

from dataclasses import replace

import inside
import numpy as np
import pytest

from bench.equal_error.problems import warp
from taichi_cloth.kernels.solvers import stages
from taichi_cloth.simulation.simulation import Simulation

SIDE, STIFFER, FRAMES = 21, 400, 10  # dt * omega of a frame: 160
WAY = {"topology": "lanes", "execution": "serial"}


@pytest.fixture
def cloth():
    return warp(SIDE, STIFFER, damped=False)


def test_a_rough_solution_leaves_what_its_tolerance_says(few_lanes, cloth):
    """By the residual of each step, and by where particles are then: farther off for less work."""
    sim = Simulation(cloth, "implicit_midpoint", **WAY)
    state, g = inside.state_of(sim), np.linalg.norm(cloth.world.gravity)
    ends, sweeps = [], []
    for tolerance in (1e-6, 0.3, 1.0):
        sim.reset()
        sim.set_solver(tolerance=tolerance)
        before = sim.work().sweeps
        for _ in range(FRAMES):
            sim.advance()
            assert state.outcome[None] in (stages.CONVERGED, stages.ROUNDED)
            assert state.load[None] >= 0.999 * g
            left = state.residual_max[None]
            assert left <= 1.001 * max(0.1, 10 * tolerance**2) * state.load[None]
            assert left <= 1.001 * tolerance * state.scale[None] or tolerance < 0.1
        ends.append(sim.positions())
        sweeps.append(sim.work().sweeps - before)
    assert left > 0.1 * state.load[None]  # which the default would not leave
    assert sweeps[0] > 1.5 * sweeps[1] > 2 * sweeps[2]
    fallen = np.linalg.norm(ends[0] - cloth.particles.position, axis=1).max()
    apart = [np.linalg.norm(end - ends[0], axis=1).max() / fallen for end in ends[1:]]
    assert 1e-6 < apart[0] < 0.2 * apart[1] and apart[1] < 0.03


def test_no_tolerance_lets_a_load_go_unanswered(few_lanes, cloth):
    """What falls freely has all of gravity for its residual, and falls at a tolerance of 1, too."""
    loose = replace(cloth.particles, fixed=np.zeros_like(cloth.particles.fixed))
    sim = Simulation(replace(cloth, particles=loose), "implicit_midpoint", tolerance=1.0, **WAY)
    sim.advance(3)
    fallen = 3 * sim.dt * np.array(cloth.world.gravity)
    np.testing.assert_allclose(sim.velocities(), np.tile(fallen, (SIDE**2, 1)), atol=1e-3)
