"""Methods that go through springs or particles in sweeps: xpbd, vbd."""

import numpy as np
import pytest
from cloths import LINKS, assert_same, cloth, edits, mixed, motion, particles_and_springs
from hypothesis import given, settings
from hypothesis import strategies as st
from selection import mostly_thorough, thorough

from taichi_cloth.kernels import methods
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.storage import adjacency, layouts

SWEEPING = [m for m in methods.METHODS if "iterations" in methods.load(m).claims.settings]
sweeping = pytest.mark.parametrize("method", SWEEPING)


# --- colours ---------------------------------------------------------------------------------


@settings(max_examples=100, deadline=None)
@given(st.data(), particles_and_springs(), st.sampled_from([1, 2, 4, 8]))
def test_springs_of_one_colour_share_no_particle(data, made, lanes):
    count, springs, _ = made
    springs = data.draw(edits(springs, count))
    grids = layouts.on_grids(springs, count, lanes, layouts.spring_period)
    colour = layouts.spring_colours(springs, grids, count)
    for one in np.unique(colour):
        ends = springs.between[colour == one]
        assert len(np.unique(ends)) == ends.size
    # What the lanes are does not matter, so all topologies go through the springs in one order.
    single = layouts.on_grids(springs, count, 1)
    np.testing.assert_array_equal(colour, layouts.spring_colours(springs, single, count))
    if grids is not None:
        halo = max(abs(column) for column, _ in grids.links)
        assert lanes == 1 or (grids.grid[:, 2][grids.grid[:, 3] == 1] % (2 * halo) == 0).all()


@settings(max_examples=100, deadline=None)
@given(st.data(), particles_and_springs(), st.sampled_from([1, 2, 4, 8]))
def test_no_spring_ties_particles_of_one_colour(data, made, lanes):
    count, springs, _ = made
    springs = data.draw(edits(springs, count))
    grids = layouts.on_grids(springs, count, lanes, layouts.particle_period)
    colour = layouts.particle_colours(springs, grids, count)
    ends = colour[springs.between]
    assert (ends[:, 0] != ends[:, 1]).all() and (ends >= 0).all()
    single = layouts.on_grids(springs, count, 1)
    np.testing.assert_array_equal(colour, layouts.particle_colours(springs, single, count))
    if grids is not None:
        halo = max(abs(column) for column, _ in grids.links)
        assert lanes == 1 or (grids.grid[:, 2][grids.grid[:, 3] == 1] % (halo + 1) == 0).all()


@settings(max_examples=50, deadline=None)
@given(st.integers(2, 30), st.integers(0, 200), st.integers(0, 99))
def test_any_springs_are_coloured_with_few_colours(count, springs, seed):
    ends = np.random.default_rng(seed).integers(0, count, (springs, 2))
    between = ends[ends[:, 0] != ends[:, 1]]
    colour = adjacency.edge_colours(between, count)
    at = np.concatenate([between, between[:, ::-1]])[:, 0]
    assert len(np.unique(np.column_stack([at, np.tile(colour, 2)]), axis=0)) == len(at)
    most = np.bincount(at, minlength=count).max()
    assert colour.max(initial=-1) < max(2 * most - 1, 1)


# --- one spring ------------------------------------------------------------------------------


def two_bodies(damping=0.0, drag=0.0):
    """Two masses of 2 and 3 on a stretched spring along x, k = 5, which fly apart."""
    world = World(size=(100.0, 100.0), gravity=(0.5, 0.0), dt=0.3)
    x, v = [[50.0, 50.0], [61.0, 50.0]], [[-1.0, 0.0], [0.7, 0.0]]
    particles = Particles.build(x, v, mass=np.array([2.0, 3.0]), viscous=drag)
    springs = Springs.build([[0, 1]], x, stiffness=5.0, rest_length=10.0, damping=damping)
    return Scene("two bodies", world, particles, springs)


def backward_euler(x, v, h, damping, drag):
    """One step of those, along x: the linear equations, solved."""
    mass, pull = np.diag([2.0, 3.0]), np.array([[-1.0, 1.0], [1.0, -1.0]])
    left = mass - h * (h * 5.0 + damping) * pull + h * drag * np.eye(2)
    force = 5.0 * (pull @ x - 10.0 * np.array([1.0, -1.0])) + mass @ [0.5, 0.5]
    new_v = np.linalg.solve(left, mass @ v + h * force)
    return x + h * new_v, new_v


@pytest.mark.parametrize(("damping", "drag"), [(0.0, 0.0), (2.0, 0.4)])
def test_one_sweep_of_xpbd_over_one_spring_is_backward_euler(damping, drag, pool):
    sim = pool(two_bodies(damping, drag), "xpbd", iterations=1)
    x, v = sim.positions()[:, 0], sim.velocities()[:, 0]
    for _ in range(30):
        sim.advance()
        x, v = backward_euler(x, v, 0.3, damping, drag)
        np.testing.assert_allclose(sim.positions()[:, 0], x, rtol=1e-12)
        np.testing.assert_allclose(sim.velocities()[:, 0], v, rtol=0, atol=1e-12)


@sweeping
def test_a_spring_of_no_length_has_no_direction_and_pulls_nowhere(method, pool):
    world = World(size=(100.0, 100.0), gravity=(0.0, 1.0), dt=0.5)
    x = [[50.0, 20.0]] * 3
    springs = Springs.build([[0, 1], [1, 2], [0, 2]], x, stiffness=[5.0, 5.0, 0.0], rest_length=2.0)
    sim = pool(Scene("point", world, Particles.build(x), springs), method)
    sim.advance(4)
    np.testing.assert_allclose(sim.positions(), [[50.0, 22.5]] * 3, rtol=0, atol=1e-12)
    np.testing.assert_allclose(sim.velocities(), [[0.0, 2.0]] * 3, rtol=0, atol=1e-12)


# --- many springs ----------------------------------------------------------------------------


@sweeping
def test_many_sweeps_end_at_the_solution_of_backward_euler(method, pool):
    scene = cloth(7, 6, LINKS[:2], damping=0.05, drag=0.1, speed=1.0)
    exact = pool(scene, "implicit_euler", 2.0, tolerance=1e-13)
    exact.advance()
    assert exact.work().unconverged == 0
    goal, moved = exact.positions(), np.abs(exact.positions() - scene.particles.position).max()
    errors = []
    for sweeps in (1, 4, 16, 64, 256):
        sim = pool(scene, method, 2.0, iterations=sweeps)
        sim.advance()
        assert sim.work().sweeps == sweeps
        errors.append(np.abs(sim.positions() - goal).max() / moved)
    assert errors[0] > 0.1
    assert all(b < max(0.3 * a, 1e-11) for a, b in zip(errors[:-1], errors[1:], strict=True)), (
        errors
    )
    assert errors[-1] < 1e-8


@sweeping
def test_the_number_of_sweeps_does_not_change_the_material(method, pool):
    """A cloth that hangs is stretched as statics say, after 1 sweep a step or many.

    Links of a row carry all rows below: together m*g*(4 + 3 + 2 + 1)/k. What is missing after few
    sweeps vanishes with the step; at this one it is below half a hundredth.
    """
    scene = build("cloth", columns=4, rows=5).with_world(mouse="none", walls=())
    scene.particles.viscous[:] = 1.0
    scene.particles.fixed[:4] = True
    stretch = scene.particles.mass[0] * scene.world.gravity[1] * 10 / scene.springs.stiffness[0]
    slack = scene.particles.position[:4, 1] + 4 * scene.springs.rest_length[0]
    for sweeps in (1, 4, 16):
        sim = pool(scene, method, 0.1, iterations=sweeps)
        sim.advance(20_000)
        assert np.abs(sim.velocities()).max() < 1e-9
        hanging = sim.positions()[16:, 1] - slack
        np.testing.assert_allclose(hanging, stretch, rtol=5e-3 if sweeps == 1 else 1e-6)


MIXED = {
    "in space": (mixed(), {"execution": "serial", "lanes": 2}),
    "colliding": (mixed(2, collisions=True), {"execution": "parallel", "lanes": 2}),
    "one lane": (mixed(collisions=True), {"execution": "parallel", "lanes": 1}),
}
# `test_topologies.py` has them on a whole grid, to the last bit, by default.


@pytest.mark.parametrize(
    ("method", "name"),
    mostly_thorough([(method, name) for method in SWEEPING for name in MIXED], []),
)
def test_cloths_tied_to_each_other_move_the_same_on_both_topologies(method, name, pool):
    scene, how = MIXED[name]
    on_grids = motion(Simulation(scene, method, topology="lanes", **how))
    assert_same(on_grids, motion(pool(scene, method)), 1e-9)
    assert on_grids[2].any() and not on_grids[2].all()


@thorough  # by default `test_topologies.py` has one thread and two, equal to the bit
@sweeping
def test_sweeps_have_the_same_bits_for_every_thread_count(method, cli):
    made = {"precision": "f32", "method": method, "collisions": True, "iterations": 1}
    one, two = (cli.call("cloths:bits", **made, threads=count) for count in (1, 2))
    assert one == two and one[1] > 0
