"""Both levels that precondition Newton directions, against NumPy: from springs and stencils."""

from dataclasses import replace

import inside
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from selection import mostly_thorough

from taichi_cloth.kernels import stepping
from taichi_cloth.kernels.solvers import (
    coarse_level,
    fine_level,
    grid_blocks,
    newton_cg,
    stages,
    two_levels,
)
from taichi_cloth.kernels.state import block_packs
from taichi_cloth.runtime import sums_in_order, whole_vectors
from taichi_cloth.scene import library
from taichi_cloth.scene.cloth import grid_stencils
from taichi_cloth.scene.model import Particles
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.storage import adjacency, requirements

SIDE = 21  # no multiple of 8 blocks along a side: they are of 2 or 3 rows, and 2 or 3 columns


@pytest.fixture
def scene():
    """Warp's cloth, jittered: springs long and short, many of which push; one block is fixed."""
    made = library.build("warp", side=SIDE)
    row, column = np.divmod(np.arange(SIDE**2), SIDE)
    fixed = made.particles.fixed | ((row < 3) & (column < 3))
    moved = np.random.default_rng(3).uniform(-0.02, 0.02, made.particles.position.shape)
    x = abs(made.particles.position + moved * ~fixed[:, None])  # inside its world
    return replace(made, particles=replace(made.particles, position=x, fixed=fixed))


@pytest.fixture
def bending(scene):
    """The same with stencils, as stiff as springs are, of which no free one is gone."""
    return replace(scene, stencils=grid_stencils(SIDE, SIDE, 0.1, 50.0))


def matrix(scene, x, tau, as_factored=False):
    """A, with no negative stiffness, (3 n, 3 n); rows of fixed particles have a mass alone.

    as_factored: with too much along springs that push, as blocks of particles have it.
    """
    springs, free = scene.springs, ~scene.particles.fixed
    a = np.diag(np.repeat(scene.particles.mass, 3))
    for (i, j), k, c, rest in zip(
        springs.between, springs.stiffness, springs.damping, springs.rest_length, strict=True
    ):
        length = np.linalg.norm(x[j] - x[i])
        u, across = (x[j] - x[i]) / length, k * (1 - rest / length)
        less = across if as_factored else max(across, 0.0)
        own = tau**2 * (max(across, 0.0) * np.eye(3) + (k + c / tau - less) * np.outer(u, u))
        for end, sign in ((i, 1.0), (j, -1.0)):
            if free[end]:
                a[3 * end : 3 * end + 3, 3 * i : 3 * i + 3] += sign * free[i] * own
                a[3 * end : 3 * end + 3, 3 * j : 3 * j + 3] -= sign * free[j] * own
    stencils, weight = scene.stencils, np.zeros((len(scene.stencils), len(x)))
    np.add.at(weight, (stencils.owner, stencils.particle), stencils.weight)
    bent = weight.T @ (stencils.stiffness(scene.particles.fixed)[:, None] * weight)
    return a + tau**2 * np.kron(np.outer(free, free) * bent, np.eye(3))


# With 2 links of a pack lead to two lanes of another.
@pytest.mark.parametrize("along", mostly_thorough([2, 8], default=[2]))
def test_the_coarse_level_is_the_inverse_of_the_sum_over_blocks(
    few_lanes, scene, along, monkeypatch
):
    monkeypatch.setattr(grid_blocks, "ACROSS", along)
    monkeypatch.setattr(grid_blocks, "BLOCKS_PER_ROOT", along**2 / SIDE)
    sim = Simulation(scene, "implicit_euler", topology="lanes", execution="serial", substeps=4)
    sim.advance()
    state, spec = inside.state_of(sim), sim.storage.specialization
    state.least[None] = stages.EXACT  # which the coarse level leaves out
    with whole_vectors(), sums_in_order():
        run = stepping.kernels_of(spec.lanes, state.real).once
        run(newton_cg.coarsen, replace(spec, threads=1), state, state.lane_memory)

    p = np.zeros((3 * len(scene.particles), coarse_level.unknowns(spec)))
    for slot, particle in enumerate(state.particle.to_numpy().ravel()):
        pack, lane = divmod(slot, spec.lanes)
        if particle < len(scene.particles) and not scene.particles.fixed[particle]:
            for axis in range(3):
                unknown = (state.block_of[pack] * 3 + axis) * spec.lanes + lane
                p[3 * particle + axis, unknown] = 1.0
    moves = check_inverse(sim, scene, p)
    if along == 8:
        assert moves == p.shape[1] - 3 and p.sum(0).max() == 9
    assert 3 * spec.lanes * state.n_blocks[None] == 3 * along**2


def check_inverse(sim, scene, p, within=2e-5):
    """Hold the coarse level to the inverse of P^T A P; how many of its unknowns move anything.

    within: part of its largest number that rounding may make of it.
    """
    state, spec = inside.state_of(sim), sim.storage.specialization
    x, tau = sim.positions(), state.tau[None]
    lengths = np.linalg.norm(np.diff(x[scene.springs.between], axis=1)[:, 0], axis=1)
    assert 0.2 < (lengths < scene.springs.rest_length).mean() < 0.8
    coarse = p.T @ matrix(scene, x, tau) @ p
    coarse[np.diag_indices_from(coarse)] *= 1 + coarse_level.LIFTED * np.finfo(np.float32).eps
    moves = np.diag(coarse) > 0
    expected = np.zeros_like(coarse)
    expected[np.ix_(moves, moves)] = np.linalg.inv(coarse[np.ix_(moves, moves)])
    found = state.coarse.to_numpy().reshape(2, *coarse.shape)[0]
    n = 3 * spec.lanes * state.n_blocks[None]
    assert not expected[n:].any() and not expected[:, n:].any()
    np.testing.assert_allclose(found[:n, :n], expected[:n, :n], atol=within * abs(expected).max())
    return moves.sum()


@pytest.mark.thorough
def test_blocks_are_as_many_as_the_root_of_particles_asks_for(few_lanes, monkeypatch):
    """In whole rows of 8, from one of them to 8."""
    monkeypatch.setattr(two_levels, "STIFF", 1.0)
    largest = library.build("warp", side=120)
    sim = Simulation(largest, "implicit_euler", topology="lanes", execution="serial", substeps=1)
    for side, rows in ((120, 8), (60, 8), (36, 5), (10, 1)):
        sim.load_scene(library.build("warp", side=side), substeps=1)
        sim.advance()
        state, lanes = inside.state_of(sim), sim.storage.specialization.lanes
        assert state.n_blocks[None] * lanes == 8 * rows
        used = np.unique(state.block_of.to_numpy()[sim.storage.layout.slot // lanes])
        np.testing.assert_array_equal(used, np.arange(8 * rows // lanes))


def test_particles_beside_a_cloth_take_no_sweeps(few_lanes, scene, monkeypatch):
    """Those on no grid are in no block, and have nothing but masses in A."""
    monkeypatch.setattr(two_levels, "STIFF", 1.0)
    top = np.arange(SIDE**2) >= SIDE**2 - SIDE  # fixed: a row of the last blocks
    cloth = replace(scene, particles=replace(scene.particles, fixed=top))
    x = np.random.default_rng(4).uniform(0.2, 1.8, (20, 3))
    beside = Particles.build(x, defaults=scene.particle_defaults)
    both = replace(cloth, particles=cloth.particles.joined(beside))
    sim = Simulation(both, "implicit_euler", topology="lanes", execution="serial", substeps=4)
    sim.advance(2)
    sweeps, end = sim.work().sweeps, sim.positions()
    state, spec = inside.state_of(sim), sim.storage.specialization
    packs = sim.storage.layout.slot[len(cloth.particles) :] // spec.lanes
    assert (state.block_of.to_numpy()[packs] == block_packs(spec)).all()
    sim.load_scene(cloth, substeps=4)
    sim.advance(2)
    assert sim.work().unconverged == 0 and state.n_blocks[None] > 0
    assert sweeps < 1.1 * sim.work().sweeps
    np.testing.assert_allclose(sim.positions(), end[: len(cloth.particles)], atol=1e-4)


def test_on_a_graph_blocks_are_the_hosts(few_lanes, bending, monkeypatch):
    """And what A does to each particle alone is factored there: its own block of A."""
    monkeypatch.setattr(requirements, "STIFF_ON_GRAPH", 0.0)
    sim = Simulation(bending, "implicit_euler", topology="graph", execution="serial", substeps=4)
    sim.advance()
    state, spec = inside.state_of(sim), replace(sim.storage.specialization, threads=1)
    state.least[None] = stages.EXACT
    none = replace(spec, blocks_on_graph=False)  # what was begun with or without them goes on so
    assert spec.blocks_on_graph and none.can_run(spec) and spec.can_run(none)
    run = stepping.kernels_of(spec.lanes, state.real).once
    with sums_in_order():
        run(newton_cg.coarsen, spec, state, state.lane_memory)
        run(fine_level.factor_particles, spec, state, state.lane_memory)
    block = adjacency.blocks(bending.springs.between, SIDE**2, 4)
    p = np.zeros((3 * SIDE**2, coarse_level.unknowns(spec)))
    for particle in np.flatnonzero(~bending.particles.fixed):
        for axis in range(3):
            p[3 * particle + axis, 3 * block[particle] + axis] = 1.0
    assert check_inverse(sim, bending, p, within=1e-4) == 3 * 16 == 3 * state.n_blocks[None]

    a = matrix(bending, sim.positions(), state.tau[None], as_factored=True)
    over, below = state.over_pivots.to_numpy(), state.below.to_numpy()
    for slot, particle in enumerate(state.particle.to_numpy()[: SIDE**2]):
        if not bending.particles.fixed[particle]:
            low = np.eye(3)
            low[1, 0], low[2, 1], low[2, 0] = below[slot]
            alone = slice(3 * particle, 3 * particle + 3)
            found, expected = low @ np.diag(1 / over[slot]) @ low.T, a[alone, alone]
            np.testing.assert_allclose(found, expected, atol=1e-4 * abs(expected).max())
        else:
            assert not over[slot].any()


def test_on_a_graph_it_takes_fewer_sweeps_to_the_same_step(few_lanes, bending, monkeypatch):
    """On one thread as on several, to the bit."""
    springs = replace(bending.springs, stiffness=100 * bending.springs.stiffness)
    scene, runs = replace(bending, springs=springs), {}
    for way, stiff in (("serial", 0.0), ("parallel", 0.0), ("alone", 1e30)):
        monkeypatch.setattr(requirements, "STIFF_ON_GRAPH", stiff)
        execution = way if stiff == 0 else "serial"
        sim = Simulation(scene, "implicit_euler", topology="graph", execution=execution)
        sim.advance()
        runs[way] = sim.positions(), sim.work()
    (x, work), (alone, work_alone) = runs["serial"], runs["alone"]
    np.testing.assert_array_equal(x, runs["parallel"][0])
    moved = abs(x - bending.particles.position).max()
    np.testing.assert_allclose(x, alone, atol=1e-2 * moved)
    assert work.sweeps < 0.7 * work_alone.sweeps
    assert work.unconverged == work_alone.unconverged == 0


@given(st.integers(1, 60), st.integers(0, 4), st.integers(0, 150), st.integers(0, 2**32 - 1))
def test_blocks_are_of_like_size(count, halvings, springs, seed):
    between = np.random.default_rng(seed).integers(0, count, (springs, 2))
    block = adjacency.blocks(between, count, halvings)
    sizes = np.bincount(block)  # of fewer particles each is a block, and no number is left out
    assert len(sizes) == min(count, 2**halvings) and sizes.max() - sizes.min() <= 1


def test_blocks_of_a_chain_are_its_pieces():
    chain = np.random.default_rng(1).permutation(64)
    block = adjacency.blocks(np.stack([chain[:-1], chain[1:]], axis=1), 64, 3)[chain]
    assert (np.abs(np.diff(block)) > 0).sum() == 7
