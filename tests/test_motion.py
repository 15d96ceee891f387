"""Motion against closed forms and conservation laws, beside what each method's claims promise."""

from dataclasses import replace

import numpy as np
import pytest
from inside import move_to
from selection import mostly_thorough

from taichi_cloth.kernels import methods
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import Particles, Scene, Springs, World


@pytest.mark.parametrize("method", methods.METHODS)
def test_a_push_is_felt_at_once_and_no_longer_than_it_lasts(pool, method):
    """Whatever a method keeps from step to step, a run goes on like one begun from its state."""

    def pushed(sim):
        sim.blow(sim.positions()[8], (30.0, 10.0))
        sim.advance()
        return sim.positions(), sim.velocities()

    def left_alone(sim):
        sim.advance()
        return sim.positions(), sim.velocities()

    scene = build("cloth", columns=6, rows=5).with_world(walls=())
    run = pool(scene, method, 0.5)
    run.advance(5)
    states = [(run.positions(), run.velocities()), pushed(run), left_alone(run)]
    assert np.abs(states[1][1] - states[0][1]).max() > 1.0  # the push is felt
    for state, act, expected in zip(states, (pushed, left_alone), states[1:], strict=False):
        new = pool(scene, method, 0.5)
        move_to(new, "graph", "serial", *state)
        np.testing.assert_array_equal(act(new), expected)


def test_a_method_that_gives_two_fields_one_name_is_refused():
    method = methods.load("implicit_euler")
    with pytest.raises(ValueError, match="names two"):
        replace(method, scalars=(*method.scalars, *method.raised))


def test_a_free_body_falls_as_the_discrete_sum_says(pool):
    world = World(size=(100.0, 1e6), gravity=(0.0, 9.8), dt=0.01)
    sim = pool(Scene("fall", world, Particles.build([[50.0, 0.0]])))
    sim.advance(1000)
    assert sim.positions()[0, 1] == pytest.approx(9.8 * 0.01**2 * 1000 * 1001 / 2, rel=1e-12)


@pytest.mark.parametrize("method", methods.METHODS)
def test_the_position_weight_is_what_a_constant_acceleration_gets(pool, method):
    world = World(size=(100.0, 100.0), gravity=(0.0, 8.0), dt=0.5)
    sim = pool(Scene("fall", world, Particles.build([[50.0, 0.0]])), method)
    sim.advance()
    expected = methods.load(method).position_weight * 0.5**2 * 8.0
    assert sim.positions()[0, 1] == pytest.approx(expected, rel=1e-12)


def test_drag_decays_as_a_power(pool):
    world = World(size=(1e4, 100.0), gravity=(0.0, 0.0), dt=0.5)
    particles = Particles.build([[0.0, 50.0]], [[10.0, 0.0]], mass=4.0, viscous=0.8)
    sim = pool(Scene("drag", world, particles))
    sim.advance(50)
    assert sim.velocities()[0, 0] == pytest.approx(10 * (1 - 0.5 * 0.8 / 4) ** 50, rel=1e-12)


@pytest.mark.parametrize("execution", mostly_thorough(["serial", "parallel"], default=["serial"]))
def test_axial_dashpot_damps_the_stretch_and_not_the_turning(pool, execution):
    """A free dumbbell: its spin keeps angular momentum, its vibration dies, momentum stays."""
    world = World(size=(100.0,) * 3, gravity=(0.0,) * 3, dt=0.01)
    x = np.array([[50.0, 50.0, 0.0], [53.0, 50.0, 0.0]])
    v = np.array([[1.0, -1.0, 0.5], [1.0, 1.0, 0.5]])
    springs = Springs.build([[0, 1]], x, stiffness=20.0, rest_length=2.0, damping=2.0)
    sim = pool(Scene("dumbbell", world, Particles.build(x, v), springs), execution=execution)
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


@pytest.mark.parametrize("topology", mostly_thorough(["lanes", "graph"], default=["graph"]))
def test_two_and_three_dimensions_are_one_physics(pool, topology):
    """The 2-D cloth laid into a plane of 3-D space moves the same, bit for bit."""
    flat = build("cloth", columns=6, rows=5)
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
        pool(scene, topology=topology, execution="parallel")
        for scene in (flat, Scene("deep", world, deep, flat.springs))
    ]
    for sim in sims:
        sim.advance(200)
    np.testing.assert_array_equal(sims[0].positions(), sims[1].positions()[:, :2])
    assert (sims[1].positions()[:, 2] == 0).all()
