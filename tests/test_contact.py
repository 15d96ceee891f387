"""Collisions through the grid against a loop over all pairs; walls; conservation."""

from dataclasses import replace

import numpy as np
import pytest
from selection import mostly_thorough

from taichi_cloth.errors import SimulationFailure
from taichi_cloth.kernels import methods
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import WALLS, ParticleDefaults, Particles, Scene, World
from taichi_cloth.scene.scatter import VELOCITY_HIGH, VELOCITY_LOW
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.storage.boxes import inner_box

PATHS = ["serial", "parallel"]


def crowd(dim, count, seed, *, radius=None, walls=False, size=100.0, restitution=0.9):
    """Random particles, denser than anything that settles: many overlap and collide at once."""
    rng = np.random.default_rng(seed)
    names = ("left", "right", "top", "bottom", "front", "back")[: 2 * dim] if walls else ()
    world = World(size=(size,) * dim, gravity=(0.0,) * dim, dt=0.01, walls=names, collisions=True)
    fixed = rng.uniform(size=count) < 0.1
    particles = Particles.build(
        world.low + rng.uniform(0, 1, (count, dim)) * size,
        np.where(fixed[:, None], 0.0, rng.normal(0, 5, (count, dim))),
        mass=rng.uniform(0.5, 4, count),
        radius=rng.uniform(0.5, 4, count) if radius is None else radius,
        restitution=restitution,
        fixed=fixed,
    )
    return Scene("crowd", world, particles)


def brute_force_jump(scene):
    """Velocity change of every particle from one step's pair collisions, by definition."""
    p = scene.particles
    d = p.position[None] - p.position[:, None]  # d[i, j]: from i to j
    distance = np.linalg.norm(d, axis=2)
    np.fill_diagonal(distance, np.inf)
    n = d / distance[..., None]
    closing = ((p.velocity[:, None] - p.velocity[None]) * n).sum(2)
    hit = (distance <= p.radius[:, None] + p.radius[None]) & (closing >= 0)
    w = np.where(p.fixed, 1e-9, 1 / p.mass)
    e = p.restitution[:, None] * p.restitution[None]
    impulse = np.where(hit, (1 + e) * closing / (w[:, None] + w[None]), 0.0)
    jump = -(impulse[..., None] * n).sum(1) * w[:, None]
    jump[p.fixed] = 0.0
    return jump, int(hit.sum())


@pytest.mark.parametrize(
    ("dim", "count", "execution"),
    mostly_thorough(
        [(dim, count, path) for dim, count in ((2, 300), (3, 1200)) for path in PATHS],
        default=[(2, 300, "parallel"), (3, 1200, "serial")],
    ),
)
def test_grid_finds_the_same_collisions_as_all_pairs(pool, dim, count, execution):
    scene = crowd(dim, count, seed=dim)
    scene.particles.radius[[7, 11]] = 12.0, 30.0  # in a cell of their own
    expected, hits = brute_force_jump(scene)
    sim = pool(scene, execution=execution)
    sim.advance()
    assert hits > 200
    jump = sim.velocities() - scene.particles.velocity
    np.testing.assert_allclose(jump, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("dim", [2, 3])
def test_collisions_of_random_clouds_in_random_boxes_are_those_of_all_pairs(pool, dim):
    """Few and many, in flat and long boxes, of like and very different radii, far outside too."""
    rng, hits = np.random.default_rng(dim), 0
    for count in (1, 2, 47, 49, 130, 400):
        for large in (0, 0, 0, 3):
            size = 100.0 * 10.0 ** rng.uniform(-1, 1, dim)
            scene = crowd(dim, count, rng.integers(1000))
            p, away = scene.particles, rng.choice([0.0, 1.0, 1e4]) * rng.normal(size=dim)
            world = scene.with_world(size=tuple(size)).world
            p.position[:] = world.low + rng.uniform(size=(count, dim)) * size
            spread = np.prod(size) ** (1 / dim) / count ** (1 / dim)
            p.radius[:] = spread * 10.0 ** rng.uniform(-1.5, rng.choice([-1.4, 0.0]), count)
            p.radius[:large] = 2.5 * p.radius.max()
            moved = Particles.build(
                p.position, p.velocity, mass=p.mass, radius=p.radius,
                restitution=p.restitution, fixed=p.fixed,
            )  # fmt: skip
            scene = Scene("cloud", world, moved)
            sim = pool(scene)
            sim.load_as("graph", "serial", p.position + away * size, p.velocity)
            there = replace(moved, position=sim.positions())
            expected, found = brute_force_jump(scene.with_parts(particles=there))
            sim.advance()
            jump = sim.velocities() - p.velocity
            np.testing.assert_allclose(jump, expected, rtol=0, atol=1e-9)
            hits += found
    assert hits > 300


def test_particles_far_outside_the_world_still_collide(pool):
    """The grid wraps around, so leaving the world neither loses nor doubles a collision."""
    world = World(size=(100.0, 100.0), gravity=(0.0, 0.0), dt=1.0, collisions=True)
    x = [[50.0, 50.0], [58.0, 50.0]]
    v = [[1000.0, 0.0], [999.0, 0.0]]
    sim = pool(Scene("pair", world, Particles.build(x, v, radius=3.0)))
    sim.advance(7)  # the gap of 2 closes at 1 a frame, 7000 units away
    np.testing.assert_allclose(sim.velocities(), [[999.0, 0.0], [1000.0, 0.0]], rtol=0, atol=1e-9)


def test_elastic_crowd_keeps_momentum_and_energy(pool):
    """Equal spheres that only meet in pairs; no fixed ones, no walls."""
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(*[np.arange(6)] * 3, indexing="ij"), -1).reshape(-1, 3)
    world = World(size=(120.0,) * 3, gravity=(0.0,) * 3, dt=0.05, collisions=True)
    particles = Particles.build(
        world.low + 20 + grid * 15.0,
        rng.normal(0, 5, (216, 3)),
        defaults=ParticleDefaults(mass=2.0, radius=3.0, restitution=1.0),
    )
    sim = pool(Scene("gas", world, particles))
    momentum, energy = sim.momentum(), sim.energy().total
    sim.advance(200)
    assert np.abs(sim.velocities() - particles.velocity).max() > 1  # they did collide
    np.testing.assert_allclose(sim.momentum(), momentum, rtol=0, atol=1e-9)
    assert sim.energy().total == pytest.approx(energy, rel=1e-3)  # triple contacts are not exact


@pytest.mark.parametrize("execution", mostly_thorough(PATHS, default=["serial"]))
def test_a_ball_bounces_to_the_height_its_restitution_allows(pool, execution):
    e, drop = 0.8, 50.0
    world = World(size=(100.0, 100.0), gravity=(0.0, 10.0), dt=1e-3, walls=("bottom",))
    particles = Particles.build([[50.0, 95.0 - drop]], radius=5.0, restitution=e)
    sim = pool(Scene("ball", world, particles), execution=execution)
    fall = int(np.sqrt(2 * drop / 10.0) / 1e-3)
    heights = []
    for _ in range(2 * fall // 20):
        sim.advance(20)
        heights.append(95.0 - sim.positions()[0, 1])
    assert max(heights[fall // 20 + 5 :]) == pytest.approx(e**2 * drop, rel=0.01)


def test_a_particle_at_rest_on_the_floor_stays_on_it(pool):
    world = World(size=(100.0, 100.0), gravity=(0.0, 0.5), dt=1.0, walls=("bottom",))
    particles = Particles.build([[50.0, 95.0]], radius=5.0, restitution=0.0)
    sim = pool(Scene("rest", world, particles))
    sim.advance(500)
    assert 95.0 - 1e-9 <= sim.positions()[0, 1] <= 95.0 + 0.5


@pytest.mark.parametrize("radius", [5.0, 12.036362492426134, 1.7, 7.3])
def test_floor_and_bounce_agree_on_a_hit_to_the_last_bit(pool, radius):
    """After a clamp the gap is zero but for rounding, and all that follows hangs on its sign."""
    g, e, high = 0.1, 0.4, 200.0
    world = World(size=(300.0, high), gravity=(0.0, g), walls=("bottom",))
    particles = Particles.build([[150.0, 180.0]], radius=radius, restitution=e)
    sim = pool(Scene("floor", world, particles))
    y, v = 180.0, 0.0
    for _ in range(300):
        sim.advance()
        hit = (y - high) + radius > 0 and v > 0
        v = v + g + (-(1.0 + e) * v if hit else 0.0)
        y = y + v
        if hit and v > 0:
            y = high - radius
        assert sim.positions()[0, 1] == pytest.approx(y, abs=1e-9)


@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_in_the_inner_box_no_particle_is_past_a_wall(real):
    """Also where the gap is rounded: kernels ask for gaps only outside of the box."""
    rng = np.random.default_rng(6)
    for size, radius in 10.0 ** rng.uniform(-3, 5, (500, 2)):
        world = World(size=(size, size, size), gravity=(0.0, 0.0, 0.0), walls=tuple(WALLS))
        balls = Particles.build(np.zeros((1, 3)), radius=radius)
        low, high = (np.asarray(corner, real) for corner in inner_box(world, balls, real))
        world_low, world_high = world.low.astype(real), world.high.astype(real)
        assert ((low - world_low) - real(radius) >= 0).all()
        assert ((world_high - high) - real(radius) >= 0).all()


SIDES = {"left": (-0.5, 0.0), "right": (0.5, 0.0), "top": (0.0, -0.5), "bottom": (0.0, 0.5)}


def thrown_about(gravity):
    """Particles of every restitution and many radii, at rest and thrown at all walls, 100 apart."""
    restitutions, radii = (0.0, 0.01, 0.5, 0.95, 1.0), (0.0, 0.3, 5.0, 5.0)
    speeds = np.array([[0, 0], [7, 3], [-20, 11], [60, -45], [-80, 70], [50, 50]], float)
    e, radius, speed = np.meshgrid(restitutions, radii, np.arange(len(speeds)), indexing="ij")
    v = speeds[speed.ravel()]
    x = np.tile([50.0, 50.0], (len(v), 1)) + np.linspace(-9, 9, len(v))[:, None]
    world = World(size=(100.0, 100.0), gravity=gravity, walls=tuple(SIDES))
    particles = Particles.build(
        x, v, radius=radius.ravel(), restitution=e.ravel(), viscous=0.01 * (speed.ravel() == 0)
    )
    return Scene("thrown", world, particles)


def held(sim, frames):
    """How far the particle that is farthest outside was so, less its radius, in any frame."""
    world, worst = sim.scene.world, -np.inf
    for _ in range(frames):
        sim.advance()
        x = sim.positions()
        outside = np.maximum(world.low - x, x - world.high).max(axis=1)
        worst = max(worst, (outside - sim.radii()).max())
    return worst


@pytest.mark.parametrize("wall", SIDES)
def test_every_wall_holds_what_lies_on_it_and_what_is_thrown_at_it(pool, wall):
    gravity = SIDES[wall]
    sim = pool(thrown_about(gravity))
    assert held(sim, 150) <= 1e-9
    sim.advance(2000)
    assert held(sim, 20) <= 1e-9
    rests = (sim.scene.particles.restitution == 0) & (sim.radii() == 5)
    axis, side = WALLS[wall]
    depth = 50 + side * (sim.positions()[rests, axis] - 50) - 95
    assert depth.min() >= -1e-9 and depth.max() <= 1.0 + 1e-9  # two steps of gravity


def test_what_crosses_more_than_the_world_in_a_step_is_named(pool):
    scene = thrown_about((0.0, 0.0))
    scene.particles.velocity[17] = (0.0, -180.0)
    sim = pool(scene)
    says = "frame 1: particle 17 ended .* beyond the wall 'top': .*--substeps"
    with pytest.raises(SimulationFailure, match=says):
        sim.advance()
    np.testing.assert_array_equal(sim.positions(), scene.particles.position)
    sim.set_step(substeps=2)
    assert held(sim, 10) <= 1e-9


def thin_box(restitution, depth=1e-6):
    rng = np.random.default_rng(4)
    x = np.column_stack([rng.uniform(10, 90, (9, 2)), np.zeros(9)])
    world = World(size=(100.0, 100.0, depth), gravity=(0.0, 0.1, 0.0), walls=tuple(WALLS))
    v = rng.uniform(-9, 9, (9, 3))
    return Scene("thin", world, Particles.build(x, v, radius=5.0, restitution=restitution))


@pytest.mark.thorough
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_a_box_thinner_than_its_particles_holds_them(pool, restitution):
    assert held(pool(thin_box(restitution)), 500) <= 1e-9


@pytest.mark.thorough
@pytest.mark.parametrize("method", methods.METHODS)
def test_walls_hold_with_every_method(pool, method):
    for gravity in SIDES.values():
        sim = pool(thrown_about(gravity), method)
        assert held(sim, 300) <= 1e-9


@pytest.mark.thorough
def test_three_hundred_clicks_at_one_point_stay_inside(device):
    sim = Simulation(build("box"), execution="serial")
    rng, last = np.random.default_rng(0), None
    for _ in range(300):
        v = rng.uniform(VELOCITY_LOW, VELOCITY_HIGH)
        last = sim.spawn([300.0, 200.0, 0.0], v, tied_to=last)
    assert held(sim, 2000) <= 1e-9
