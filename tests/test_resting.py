"""Pairs that rest on each other: they come apart, keep momentum, lose energy; piles lie still."""

import numpy as np
import pytest
from cloths import TWO_CLOTHS
from selection import as_thorough

from taichi_cloth.kernels import methods
from taichi_cloth.scene import scenefile
from taichi_cloth.scene.cloth import grid
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import ParticleDefaults, Particles, Scene, SpringDefaults, World


def cloud(dim, count, seed, *, size=1000.0, gravity=0.0, fixed=0.0):
    """Random particles that overlap, of several masses, radii and restitutions.

    In a plane there are walls, so that it is compiled as piles are; they are `size` apart.
    """
    rng = np.random.default_rng(seed)
    down = np.eye(dim)[1] * gravity
    world = World(
        size=(size,) * dim,
        gravity=tuple(down),
        dt=0.1,
        collisions=True,
        contact="resting",
        friction=0.3,
        walls=("left", "right", "top", "bottom") if dim == 2 else (),
    )
    held = rng.uniform(size=count) < fixed
    particles = Particles.build(
        (world.low + world.high) / 2 + rng.uniform(-30, 30, (count, dim)),
        np.where(held[:, None], 0.0, rng.normal(0, 5, (count, dim))),
        mass=10.0 ** rng.uniform(-1, 1, count),
        radius=rng.uniform(1, 6, count),
        restitution=rng.uniform(0, 1, count),
        fixed=held,
    )
    return Scene("cloud", world, particles)


def overlap(sim):
    """The deepest overlap of a pair, as a part of its reach."""
    x, radius = sim.positions(), sim.radii()
    distance = np.linalg.norm(x[:, None] - x[None], axis=2)
    reach = radius[:, None] + radius[None]
    np.fill_diagonal(distance, np.inf)
    return float((1.0 - distance / reach).max())


@pytest.mark.parametrize("dim", [2, as_thorough(3)])
def test_free_pairs_keep_momentum_and_their_centre_and_never_gain_energy(pool, dim):
    scene = cloud(dim, 60, seed=dim)
    sim, mass = pool(scene), scene.particles.mass
    momentum, energy = sim.momentum(), sim.energy().kinetic
    scale = float((mass * np.linalg.norm(scene.particles.velocity, axis=1)).sum())
    centre = mass @ sim.positions() / mass.sum()
    first = overlap(sim)
    for step in range(30):
        sim.advance()
        now = sim.energy().kinetic
        assert now <= energy * (1 + 1e-12)
        energy = now
        np.testing.assert_allclose(sim.momentum(), momentum, rtol=0, atol=1e-13 * scale)
        there = centre + momentum / mass.sum() * 0.1 * (step + 1)
        if step == 0:  # friction gives positions what it gives velocities: both keep the centre
            np.testing.assert_allclose(mass @ sim.positions() / mass.sum(), there, 0, 1e-10)
    assert energy < 0.9 * 0.5 * float(mass @ (scene.particles.velocity**2).sum(axis=1))
    assert first > 0.5 and overlap(sim) < 1e-3


@pytest.mark.parametrize("thickness", [0.0, 10.0])
def test_a_pair_bounces_by_its_restitution_and_slides_by_its_friction(pool, thickness):
    """By their laws: normal parts by Newton's, along the surface by Coulomb's, which takes from
    positions what the step had of it. Beside a cloth with a thickness pairs act in sweeps.
    """
    dim = 3 if thickness else 2
    world = World(
        size=(100.0,) * dim, gravity=(0.0,) * dim, dt=0.1, collisions=True, contact="resting",
        friction=0.2, walls=("left", "right", "top", "bottom") if dim == 2 else (),
    )  # fmt: skip
    x, v = np.zeros((3, dim)), np.zeros((3, dim))
    x[:, :2] = [[40.0, 50.0], [50.5, 49.5], [80.0, 80.0]]
    v[:, :2] = [[3.0, 0.0], [-4.0, 5.0], [0.0, 0.0]]
    pair = Particles.build(
        x, v, mass=[2.0, 3.0, 1.0], radius=5.0, restitution=[0.5, 0.8, 1.0],
        thickness=[0.0, 0.0, thickness],
    )  # fmt: skip
    sim = pool(Scene("pair", world, pair))
    sim.advance()
    change, moved = sim.velocities() - v, sim.positions() - (x + 0.1 * v)
    lost = 7.0 * 1.4
    np.testing.assert_allclose((change[1] - change[0])[:2], [lost, -0.2 * lost], atol=1e-12)
    # They overlapped by 0.2, and had slid by what friction takes.
    np.testing.assert_allclose((moved[1] - moved[0])[:2], [0.2, -0.1 * 0.2 * lost], atol=1e-12)
    for each in (change, moved):
        np.testing.assert_allclose(2.0 * each[0] + 3.0 * each[1], 0.0, atol=1e-12)
    assert abs(overlap(sim)) < 1e-3


def test_bodies_in_a_row_share_what_the_first_gives(pool):
    """Restitution acts in a step's first iteration alone, and what is passed on later has none: of
    three that touch the last two go on together, without half of the energy.
    """
    world = World(
        size=(100.0, 100.0), gravity=(0.0, 0.0), dt=0.01, collisions=True,
        contact="resting", walls=("left", "right", "top", "bottom"),
    )  # fmt: skip
    x, v = [[40.0, 50.0], [50.0, 50.0], [60.0, 50.0]], [[4.0, 0.0], [0.0, 0.0], [0.0, 0.0]]
    row = Particles.build(x, v, mass=1.0, radius=5.0, restitution=1.0)
    sim = pool(Scene("row", world, row))
    sim.advance()
    np.testing.assert_allclose(sim.velocities()[:, 0], [0.0, 2.0, 2.0], atol=1e-12)


def test_fixed_particles_stay_and_hold_what_falls_on_them(pool):
    scene = cloud(2, 40, seed=1, size=100.0, gravity=0.5, fixed=0.4)
    sim, fixed = pool(scene), scene.particles.fixed
    sim.advance(300)
    np.testing.assert_array_equal(sim.positions()[fixed], scene.particles.position[fixed])
    x, radius = sim.positions(), sim.radii()
    distance = np.linalg.norm(x[:, None] - x[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    depth = 1.0 - distance / (radius[:, None] + radius[None])
    assert depth[~fixed].max() < 1e-2 and sim.depths()[~fixed].max() < 1e-9


PILES = [("symplectic_euler", 0), *(as_thorough((m, 1)) for m in methods.METHODS)]


@pytest.mark.parametrize(("method", "seed"), PILES)
def test_a_pile_rests_with_overlaps_below_a_percent(pool, method, seed):
    scene = build("sandbox", particles=40, radius=20, seed=seed)
    scene = scene.with_world(contact="resting", mouse="none")
    sim = pool(scene, method)
    energies, worst = [], 0.0
    for _ in range(40):
        sim.advance(20)
        worst = max(worst, overlap(sim), sim.depths().max() / 40)
        energies.append(sim.energy().total)
    assert worst < 1e-2
    drop = energies[0] - energies[-1]
    assert drop > 100 and np.diff(energies).max() < 1e-4 * drop
    assert sim.energy().kinetic < 1e-3 * drop and sim.unsettled() == 0
    before = sim.positions()
    sim.advance(100)
    assert np.abs(sim.positions() - before).max() < 0.4  # a hundredth of a diameter


def draped(method_links=("structural",)):
    """A cloth of spheres that touch each other nearly, above a large fixed one."""
    cloth, springs = grid(
        (150.0, 130.0, -50.0),
        11,
        11,
        10.0,
        links=method_links,
        across=(1.0, 0.0, 0.0),
        down=(0.0, 0.0, 1.0),
        particle_defaults=ParticleDefaults(mass=1.0, radius=4.0, viscous=0.02, restitution=0.0),
        spring_defaults=SpringDefaults(stiffness=2.0, damping=0.1),
    )
    ball = Particles.build([[200.0, 200.0, 0.0]], radius=60.0, fixed=True, restitution=0.0)
    world = World(
        size=(400.0,) * 3, gravity=(0.0, 0.05, 0.0), collisions=True, contact="resting"
    )  # fmt: skip
    return Scene("draped", world, cloth.joined(ball), springs)


@pytest.mark.parametrize(
    ("method", "topology"),
    [
        ("symplectic_euler", "graph"),
        *(as_thorough((m, "graph")) for m in methods.METHODS if m != "symplectic_euler"),
        *(as_thorough((m, "lanes")) for m in ("symplectic_euler", "implicit_midpoint")),
    ],
)
def test_a_cloth_does_not_sink_through_a_fixed_sphere(pool, method, topology):
    # In longer steps explicit Euler is unstable on these dashpots.
    substeps = 32 if method == "explicit_euler" else 4
    sim = pool(draped(), method, substeps=substeps, topology=topology)
    for _ in range(8):
        sim.advance(20)
        distance = np.linalg.norm(sim.positions()[:-1] - [200.0, 200.0, 0.0], axis=1)
        assert distance.min() > 64 * (1 - 1e-3)
    assert (distance < 65).sum() > 20  # they lie on it


@pytest.mark.thorough
def test_resting_pairs_have_the_same_bits_for_every_thread_count(cli):
    made = {"precision": "compensated", "method": "symplectic_euler", "collisions": True}
    found = [cli.call("cloths:bits", **made, threads=count, contact="resting") for count in (1, 2)]
    assert found[0] == found[1]
    scene = scenefile.parse(TWO_CLOTHS.replace("COLLISIONS", "true"))
    assert found[0][1] > 0.2 * len(scene.springs)


def test_unsettled_steps_are_counted_from_the_start_whatever_is_loaded_meanwhile(pool, tmp_path):
    """A particle between two fixed ones that leave it no room is settled in no step."""
    scene = cloud(2, 3, seed=0)
    scene.particles.position[:] = [[500.0, 500.0], [502.0, 500.0], [504.0, 500.0]]
    scene.particles.radius[:] = 4.0
    scene.particles.fixed[:] = True, False, True
    scene.particles.velocity[:] = 0.0
    sim = pool(scene)
    sim.advance(2)
    sim.set(particles=1, radius=3.0)
    sim.advance(3)
    assert sim.unsettled() == sim.steps == 5
    then = sim.checkpoint()
    then.save(tmp_path / "then.npz")
    sim.set_method("verlet")
    assert sim.unsettled() == 5
    sim.set_method("symplectic_euler")
    sim.load_as("graph", sim.execution, sim.positions(), sim.velocities())
    sim.advance()
    assert sim.unsettled() == 6
    for checkpoint in (then, then.load(tmp_path / "then.npz")):
        sim.restore(checkpoint)
        sim.advance(2)
        assert sim.unsettled() == 7
    sim.reset()
    assert sim.unsettled() == 0
