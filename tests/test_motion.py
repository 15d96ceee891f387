"""Motion against closed forms, exact discrete solutions, conservation laws and claims."""

import numpy as np
import pytest

from taichi_cloth.kernels import methods
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("device", "few_lanes")


@pytest.mark.parametrize("method", methods.METHODS)
def test_a_push_is_felt_at_once_and_no_longer_than_it_lasts(method):
    """Whatever a method keeps from step to step, a run goes on like one begun from its state."""
    scene = build("cloth", columns=6, rows=5)
    how = {"topology": "graph", "execution": "serial"}
    run = Simulation(scene, method, 0.5, **how)
    run.advance(5)
    for pushed in (True, False):
        new = Simulation(scene, method, 0.5, **how)
        new.load_as("graph", "serial", run.positions(), run.velocities())
        for sim in (run, new):
            if pushed:
                sim.blow(sim.positions()[8], (30.0, 10.0))
            sim.advance()
        np.testing.assert_array_equal(run.positions(), new.positions())
        np.testing.assert_array_equal(run.velocities(), new.velocities())


def test_a_free_body_falls_as_the_discrete_sum_says():
    world = World(size=(100.0, 1e6), gravity=(0.0, 9.8), dt=0.01)
    sim = Simulation(Scene("fall", world, Particles.build([[50.0, 0.0]])), execution="serial")
    sim.advance(1000)
    assert sim.positions()[0, 1] == pytest.approx(9.8 * 0.01**2 * 1000 * 1001 / 2, rel=1e-12)


def test_drag_decays_as_a_power():
    world = World(size=(1e4, 100.0), gravity=(0.0, 0.0), dt=0.5)
    particles = Particles.build([[0.0, 50.0]], [[10.0, 0.0]], mass=4.0, viscous=0.8)
    sim = Simulation(Scene("drag", world, particles), execution="serial")
    sim.advance(50)
    assert sim.velocities()[0, 0] == pytest.approx(10 * (1 - 0.5 * 0.8 / 4) ** 50, rel=1e-12)


def test_axial_dashpot_damps_the_stretch_and_not_the_turning(execution):
    """A free dumbbell: its spin keeps angular momentum, its vibration dies, momentum stays."""
    world = World(size=(100.0,) * 3, gravity=(0.0,) * 3, dt=0.01)
    x = np.array([[50.0, 50.0, 0.0], [53.0, 50.0, 0.0]])
    v = np.array([[1.0, -1.0, 0.5], [1.0, 1.0, 0.5]])
    springs = Springs.build([[0, 1]], x, stiffness=20.0, rest_length=2.0, damping=2.0)
    sim = Simulation(Scene("dumbbell", world, Particles.build(x, v), springs), execution=execution)
    spin = np.cross(x - x.mean(0), v - v.mean(0)).sum(0)
    sim.advance(4000)
    x1, v1 = sim.positions(), sim.velocities()
    np.testing.assert_allclose(np.cross(x1 - x1.mean(0), v1 - v1.mean(0)).sum(0), spin, atol=1e-9)
    np.testing.assert_allclose(sim.momentum(), [2.0, 0.0, 1.0], atol=1e-11)
    lengths = []
    for _ in range(50):
        lengths.append(np.linalg.norm(np.diff(sim.positions(), axis=0)))
        sim.advance()
    assert np.ptp(lengths) < 1e-6 < np.linalg.norm(spin)  # the two turn on a circle


def test_momentum_of_a_free_cloth_is_kept(topology):
    scene = build("cloth", columns=7, rows=6)
    rng = np.random.default_rng(3)
    particles = Particles.build(scene.particles.position, rng.normal(0, 0.5, (42, 2)))
    world = World(size=scene.world.size, gravity=(0.0, 0.0))
    scene = Scene("free", world, particles, scene.springs)
    sim = Simulation(scene, topology=topology, execution="parallel")
    before = sim.momentum()
    sim.advance(400)
    np.testing.assert_allclose(sim.momentum(), before, rtol=0, atol=1e-12)


def test_two_and_three_dimensions_are_one_physics(topology):
    """The 2-D cloth laid into a plane of 3-D space moves the same, bit for bit."""
    flat = build("cloth", columns=6, rows=5).with_world(mouse="none")
    p = flat.particles
    world = World(size=(*flat.world.size, 100.0), gravity=(0.0, 0.05, 0.0), walls=flat.world.walls)
    deep = Particles.build(
        np.column_stack([p.position, np.zeros(len(p))]),
        mass=p.mass,
        radius=p.radius,
        viscous=p.viscous,
        restitution=p.restitution,
        fixed=p.fixed,
    )
    sims = [
        Simulation(scene, topology=topology, execution="parallel")
        for scene in (flat, Scene("deep", world, deep, flat.springs))
    ]
    for sim in sims:
        sim.advance(200)
    np.testing.assert_array_equal(sims[0].positions(), sims[1].positions()[:, :2])
    assert (sims[1].positions()[:, 2] == 0).all()
