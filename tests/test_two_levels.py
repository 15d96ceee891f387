"""The coarse level of Newton directions against NumPy's inverse of P^T A P, from the springs."""

from dataclasses import replace

import inside
import numpy as np
import pytest

from taichi_cloth.kernels import stepping
from taichi_cloth.kernels.solvers import newton_cg, stages, two_levels
from taichi_cloth.runtime import sums_in_order, whole_vectors
from taichi_cloth.scene import library
from taichi_cloth.simulation.simulation import Simulation

SIDE = 21  # no multiple of the blocks along a side: they are of 2 or 3 rows, and 2 or 3 columns


@pytest.fixture
def scene():
    """Warp's cloth, jittered: springs long and short, many of which push; one block is fixed."""
    made = library.build("warp", side=SIDE)
    row, column = np.divmod(np.arange(SIDE**2), SIDE)
    fixed = made.particles.fixed | ((row < 3) & (column < 3))
    moved = np.random.default_rng(3).uniform(-0.02, 0.02, made.particles.position.shape)
    x = abs(made.particles.position + moved * ~fixed[:, None])  # inside its world
    return replace(made, particles=replace(made.particles, position=x, fixed=fixed))


def matrix(scene, x, tau):
    """A, with no negative stiffness, (3 n, 3 n); rows of fixed particles have a mass alone."""
    springs, free = scene.springs, ~scene.particles.fixed
    a = np.diag(np.repeat(scene.particles.mass, 3))
    for (i, j), k, c, rest in zip(
        springs.between, springs.stiffness, springs.damping, springs.rest_length, strict=True
    ):
        length = np.linalg.norm(x[j] - x[i])
        u, across = (x[j] - x[i]) / length, max(k * (1 - rest / length), 0.0)
        own = tau**2 * (across * np.eye(3) + (k + c / tau - across) * np.outer(u, u))
        for end, sign in ((i, 1.0), (j, -1.0)):
            if free[end]:
                a[3 * end : 3 * end + 3, 3 * i : 3 * i + 3] += sign * free[i] * own
                a[3 * end : 3 * end + 3, 3 * j : 3 * j + 3] -= sign * free[j] * own
    return a


@pytest.mark.parametrize("along", [2, 8])  # with 2 links of a pack lead to two lanes of another
def test_the_coarse_level_is_the_inverse_of_the_sum_over_blocks(
    few_lanes, scene, along, monkeypatch
):
    monkeypatch.setattr(two_levels, "ALONG", along)
    sim = Simulation(scene, "implicit_euler", topology="lanes", execution="serial", substeps=4)
    sim.advance()
    state, spec = inside.state_of(sim), sim.storage.specialization
    state.least[None] = stages.EXACT  # which the coarse level leaves out
    with whole_vectors(), sums_in_order():
        run = stepping.kernels_of(spec.lanes, state.real).once
        run(newton_cg.coarsen, replace(spec, threads=1), state, state.lane_memory)

    x, tau = sim.positions(), state.tau[None]
    a = matrix(scene, x, tau)
    lengths = np.linalg.norm(np.diff(x[scene.springs.between], axis=1)[:, 0], axis=1)
    short = lengths < scene.springs.rest_length
    assert 0.2 < short.mean() < 0.8
    p = np.zeros((len(a), two_levels.unknowns(spec)))
    for slot, particle in enumerate(state.particle.to_numpy().ravel()):
        pack, lane = divmod(slot, spec.lanes)
        if particle < len(x) and not scene.particles.fixed[particle]:
            for axis in range(3):
                unknown = (state.block_of[pack] * 3 + axis) * spec.lanes + lane
                p[3 * particle + axis, unknown] = 1.0
    coarse = p.T @ a @ p
    coarse[np.diag_indices_from(coarse)] *= 1 + two_levels.LIFTED * np.finfo(np.float32).eps
    moves = np.diag(coarse) > 0
    if along == 8:
        assert moves.sum() == len(moves) - 3 and p.sum(0).max() == 9
    expected = np.zeros_like(coarse)
    expected[np.ix_(moves, moves)] = np.linalg.inv(coarse[np.ix_(moves, moves)])
    found = state.coarse.to_numpy().reshape(2, *coarse.shape)[0]
    n = 3 * spec.lanes * state.n_blocks[None]
    assert n == 3 * along**2 and not expected[n:].any() and not expected[:, n:].any()
    np.testing.assert_allclose(found[:n, :n], expected[:n, :n], atol=2e-5 * abs(expected).max())
