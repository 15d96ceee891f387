"""The account of contacts: the energy that they give, the first touch, the deepest penetration."""

from dataclasses import replace

import numpy as np
import pytest
from selection import mostly_thorough, thorough

from taichi_cloth.kernels import methods
from taichi_cloth.scene.cloth import grid, grid_stencils, grid_triangles
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import ParticleDefaults, Particles, Scene, SpringDefaults, World
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.scene.penetration import deepest, overlapping, touches
from taichi_cloth.scene.solids import solids
from taichi_cloth.simulation import diagnostics
from taichi_cloth.simulation.simulation import Simulation

G = 9.81
EXACT = ("verlet", "rk4", "implicit_midpoint", "tr_bdf2")  # for constant accelerations


def on_plane(*bodies, velocity=None, friction=0.0, restitution=0.0, moves=(0.0, 0.0)):
    """Bodies of radius 0.1 and mass 2 at (x, height) above a plane."""
    world = World(size=(100.0, 50.0), gravity=(0.0, -G), dt=0.01, up="y")
    x = np.array([[at, 1.1 + height] for at, height in bodies])
    plane = Obstacle.build(
        "plane", point=[0.0, 1.0], normal=[0.0, 1.0],
        friction=friction, restitution=restitution, velocity=moves,
    )  # fmt: skip
    particles = Particles.build(x, velocity, mass=2.0, radius=0.1)
    return Scene("plane", world, particles, obstacles=(plane,))


@pytest.mark.parametrize("method", mostly_thorough(methods.METHODS, default=["symplectic_euler"]))
def test_what_lies_gets_no_energy_and_a_belt_gives_what_it_should(device, method):
    """A belt that takes a body along gives it m v^2 / 2; what lies, or slides to a stop, nothing,
    also under methods whose positions fall farther in a step than a body does."""
    rests = on_plane([10.0, 0.0], [30.0, 0.0], velocity=[[0.0, 0.0], [1.0, 0.0]], friction=0.5)
    sim = Simulation(rests, method, execution="serial", accounts_contacts=True)
    sim.account_contacts()
    sim.advance(100)
    account = sim.contact_account()
    assert 0 <= account.gained < 1e-12 and account.first_touch == pytest.approx(0.01)
    assert sim.velocities()[1, 0] == 0.0 and sim.penetration() < 1e-12
    sim.load_scene(on_plane([10.0, 0.0], friction=0.5, moves=[1.5, 0.0]))
    assert sim.contact_account() is None  # a load ends it
    sim.account_contacts()
    sim.advance(100)
    assert sim.contact_account().gained == pytest.approx(0.5 * 2.0 * 1.5**2, rel=1e-9)
    falls = on_plane([10.0, 0.5 * G * 0.3**2 + 1e-9], restitution=0.5)
    sim.load_scene(falls)
    sim.account_contacts()
    sim.advance(28)
    assert sim.contact_account().first_touch is None
    sim.advance(6)
    assert sim.contact_account().first_touch == pytest.approx(0.3, abs=0.0101)
    lost = 0.5 * 2.0 * (1 - 0.25) * (G * 0.3) ** 2
    assert sim.contact_account().gained < 1e-3 * lost
    assert sim.contact_account().balance == pytest.approx(-lost, rel=0.05)


def test_a_bounce_has_back_no_more_than_the_free_part_took(device):
    """Against steps by hand: what contact changes of kinetic and potential energy from the free end
    on, and half of what symplectic Euler's positions are behind by, as far as contact has it back.
    """
    scene = on_plane([10.0, 0.1], velocity=[[0.0, -3.0]], restitution=0.5)
    sim = Simulation(scene, "symplectic_euler", execution="serial", accounts_contacts=True)
    sim.account_contacts()
    h, m, expected = 0.01, 2.0, 0.0
    for _ in range(20):
        x, v = sim.positions()[0, 1], sim.velocities()[0, 1]
        free_v = v - h * G
        free_x = x + h * free_v
        sim.advance()
        x, v = sim.positions()[0, 1], sim.velocities()[0, 1]
        had_back = min(max(-h * G * (v - free_v), -((h * G) ** 2)), 0.0)
        expected += m * (0.5 * (v * v - free_v**2) + G * (x - free_x) + 0.5 * had_back)
    assert expected < -1.0
    assert sim.contact_account().balance == pytest.approx(expected, rel=1e-9)


@thorough
def test_a_wall_takes_what_restitution_leaves(device):
    """A body between walls, without gravity: half its mass times the squares of its speeds, also
    where a step ends on the wall, or far past it."""
    world = World(size=(100.0, 50.0), gravity=(0.0, 0.0), dt=0.1, walls=("left", "right"))
    body = Particles.build([[90.0, 20.0]], mass=2.0, radius=1.0)
    scene = Scene("walls", world, body)
    sim = Simulation(scene, execution="serial", accounts_contacts=True)
    for speed in (33.3, 30.0, 150.0):
        for e in (1.0, 0.5):
            v = np.array([[speed, 0.0]])
            sim.load_scene(
                replace(scene, particles=replace(body, velocity=v, restitution=np.full(1, e)))
            )
            sim.account_contacts()
            sim.advance(6)
            account, v = sim.contact_account(), sim.velocities()[0, 0]
            assert v == pytest.approx(-speed * e)
            assert account.balance == pytest.approx(0.5 * 2.0 * (v * v - speed**2), abs=1e-9)
            assert account.gained == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("method", mostly_thorough(EXACT, default=["verlet"]))
def test_what_falls_on_a_floor_until_it_lies_loses_its_energy_to_that(device, method):
    """Methods that follow a fall exactly: the body lost to contact all that it lost."""
    m, g = 2.0, 9.81
    world = World((100.0, 50.0), (0.0, g), dt=0.01, walls=("bottom", "left"))
    body = Particles.build([[20.0, 48.3]], [[0.5, 0.0]], mass=m, radius=1.0, restitution=0.5)
    sim = Simulation(
        Scene("falls", world, body), method, execution="serial", accounts_contacts=True
    )
    sim.account_contacts()

    def energy():
        return 0.5 * m * float((sim.velocities() ** 2).sum()) - m * g * sim.positions()[0, 1]

    before = energy()
    sim.advance(200)
    assert abs(sim.velocities()[0, 1]) < 0.11 and abs(sim.positions()[0, 1] - 49.0) < 1e-3
    assert before - energy() > 0.9 * m * g * 0.7
    assert sim.contact_account().balance == pytest.approx(energy() - before, rel=1e-9)


@thorough
def test_walls_hold_a_cloth_in_lanes_as_on_the_graph(device):
    """The same account of a cloth that falls on the floor and into a corner, whose springs give."""
    spring = SpringDefaults(stiffness=40.0)
    particles, springs = grid(
        [6.0, 45.0], 5, 4, 1.0, spring_defaults=spring,
        particle_defaults=ParticleDefaults(mass=0.1, radius=0.2, restitution=0.3),
    )  # fmt: skip
    particles = replace(particles, velocity=np.tile([-20.0, 5.0], (20, 1)))
    world = World((100.0, 50.0), (0.0, 9.81), dt=0.005, walls=("left", "bottom"))
    scene, accounts = Scene("falls", world, particles, springs), []
    for how in ({"topology": "graph"}, {"topology": "lanes", "lanes": 2}):
        sim = Simulation(scene, "verlet", execution="serial", accounts_contacts=True, **how)
        sim.account_contacts()
        sim.advance(200)
        accounts.append(sim.contact_account())
    a, b = accounts
    assert a.balance < -5.0
    assert b.balance == pytest.approx(a.balance, rel=1e-6)
    assert b.gained == pytest.approx(a.gained, abs=1e-6 * abs(a.balance))


def sheet():
    """A cloth of springs that bends, over a plane that comes up fast and pushes it, askew."""
    spring = SpringDefaults(stiffness=400.0)
    particles, springs = grid(
        [20.0, 10.0], 4, 3, 0.3, spring_defaults=spring,
        particle_defaults=ParticleDefaults(mass=0.1, radius=0.02),
        across=[1.0, 0.2], down=[0.2, -1.0], links=("structural", "shear"),
    )  # fmt: skip
    stencils = grid_stencils(4, 3, 0.3, 0.05)
    low = float(particles.position[:, 1].min()) - 0.03
    plane = Obstacle.build(
        "plane", point=[0.0, low], normal=[0.0, 1.0], friction=0.3, velocity=[0.5, 3.0]
    )
    world = World(size=(100.0, 50.0), gravity=(0.0, -G), dt=0.004, up="y")
    return Scene("sheet", world, particles, springs, obstacles=(plane,), stencils=stencils)


@thorough
@pytest.mark.parametrize("topology", ["graph serial", "graph parallel", "lanes serial"])
def test_the_energy_is_that_of_steps_beside_steps_without_contact(device, topology):
    """A twin on the host: each step also without the plane, and energies by the terms' own."""
    scene = sheet()
    stored, execution = topology.split()
    how = {"topology": stored, "execution": execution, "lanes": 2}
    sim = Simulation(scene, "verlet", accounts_contacts=True, **how)
    free = Simulation(replace(scene, obstacles=()), "verlet", **how)
    sim.account_contacts()
    gained, given = 0.0, 0
    everything = np.ones(len(scene.springs), bool)
    for _ in range(40):
        x, v = sim.positions(), sim.velocities()
        moved = replace(scene.particles, position=x, velocity=v)
        free.load_scene(replace(scene, obstacles=(), particles=moved))
        free.advance()
        sim.advance()
        before, after = (
            diagnostics.energy(scene, of.positions(), of.velocities(), everything).total
            for of in (free, sim)
        )
        gained += max(after - before, 0.0)
        given += after - before > 1e-6
    account = sim.contact_account()
    assert given > 10 and gained > 1.0
    assert account.gained == pytest.approx(gained, rel=1e-6)


def test_the_deepest_penetration_is_that_of_all_pairs_walls_and_obstacles():
    """Against every pair and wall compared; fixed particles have nothing to answer for."""
    rng = np.random.default_rng(4)
    for dim in (2, 3):
        for walls, collisions in (((), True), (("left", "top"), False), (("bottom",), True)):
            world = World(
                size=(10.0,) * dim, gravity=(0.0,) * dim, walls=walls, collisions=collisions
            )
            low = world.low
            x = low + rng.uniform(0.0, 10.0, (30, dim))
            radius, fixed = rng.uniform(0.1, 0.6, 30), rng.uniform(size=30) < 0.3
            ball = Obstacle.build("sphere", centre=low + 5.0, radius=1.0, velocity=[0.5] * dim)
            particles = Particles.build(x, radius=radius, fixed=fixed)
            scene = Scene("many", world, particles, obstacles=(ball,))
            found = [0.0, *(radius + 1.0 - np.linalg.norm(x - low - 5.0 - 1.0, axis=1))[~fixed]]
            for wall in walls:
                axis, side = world.side(wall)
                bound = world.high[axis] if side > 0 else low[axis]
                found += list((radius - np.abs(bound - x[:, axis]))[~fixed])
            for i in range(30 * collisions):
                for j in range(i):
                    if not (fixed[i] and fixed[j]):
                        found.append(radius[i] + radius[j] - np.linalg.norm(x[i] - x[j]))
            assert deepest(scene, solids(scene), x, 2.0) == pytest.approx(max(found))


def test_pairs_that_overlap_at_the_start_are_all_but_fixed_ones():
    """Against every pair compared; what touches to the bit does not overlap."""
    rng = np.random.default_rng(6)
    x, radius = rng.uniform(0.0, 10.0, (40, 2)), rng.uniform(0.1, 0.8, 40)
    x[:3], radius[:3] = [[20.0, 5.0], [21.0, 5.0], [22.0, 5.0]], 0.5
    fixed = (rng.uniform(size=40) < 0.4) & (np.arange(40) > 2)
    world = World(size=(30.0, 10.0), gravity=(0.0, 0.0))
    scene = Scene("many", world, Particles.build(x, radius=radius, fixed=fixed))
    expected = {
        (i, j)
        for j in range(40)
        for i in range(j)
        if not (fixed[i] and fixed[j]) and np.linalg.norm(x[i] - x[j]) < radius[i] + radius[j]
    }
    held = {(i, j) for j in range(40) for i in range(j) if fixed[i] and fixed[j]}
    assert len(expected) > 10 and any(np.linalg.norm(x[i] - x[j]) < 0.5 for i, j in held)
    assert {tuple(sorted(pair)) for pair in overlapping(scene).tolist()} == expected


def test_an_empty_scene_and_one_without_contact_have_none(device):
    scene = on_plane([10.0, 5.0])
    sim = Simulation(replace(scene, obstacles=()), accounts_contacts=True)
    sim.account_contacts()
    sim.advance(3)
    assert sim.contact_account() is None and not sim.can_touch() and sim.penetration() == 0.0


def test_of_cloths_with_a_thickness_it_is_that_of_their_spheres():
    """Pairs that start nearer than their spheres are wide have reaches of their own."""
    world = World(size=(10.0,) * 3, gravity=(0.0,) * 3, up="y")
    particles, springs = grid(
        [3.0, 3.0, 0.0], 4, 4, 0.2, down=[0.0, 0.0, 1.0], links=("structural", "shear"),
        material=Material(density=0.2, thickness=0.05, stretch=10.0, shear=2.0),
    )  # fmt: skip
    scene = Scene("thick", world, particles, springs, triangles=grid_triangles(4, 4))
    assert touches(scene, []) and deepest(scene, [], particles.position, 0.0) == 0.0
    x = particles.position.copy()
    x[:, 0] = 3.0 + np.abs(x[:, 0] - 3.3) * 0.4  # folded, and pressed together
    spheres, found = scene.spheres, [0.0]
    for i in range(16):
        own = dict(
            zip(
                spheres.other[spheres.start[i] : spheres.start[i + 1]].tolist(),
                spheres.reach[spheres.start[i] : spheres.start[i + 1]].tolist(),
                strict=True,
            )
        )
        for j in range(i):
            reach = own.get(j, spheres.radius[i] + spheres.radius[j])
            found.append(reach - float(np.linalg.norm(x[i] - x[j])))
    assert max(found) > 0.01 and len(spheres.other)
    assert deepest(scene, [], x, 0.0) == pytest.approx(max(found))
