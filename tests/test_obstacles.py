"""Contacts that end a step: obstacles, the ground and resting walls, against closed forms."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cloths import ROD, loose_sheet
from inside import state_of
from selection import as_thorough, mostly_thorough

from taichi_cloth.cli import run_notes
from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods, obstruction
from taichi_cloth.kernels.faces import LEAST_ROOM, UNSETTLED
from taichi_cloth.kernels.obstacles import SHAPES, load
from taichi_cloth.scene import scenefile
from taichi_cloth.scene.checks import validate
from taichi_cloth.scene.cloth import grid, grid_triangles
from taichi_cloth.scene.model import (
    ParticleDefaults,
    Particles,
    Scene,
    SpringDefaults,
    Springs,
    World,
)
from taichi_cloth.scene.obstacles import CONTACTS, Obstacle
from taichi_cloth.scene.solids import (
    depths,
    goes_through,
    inside_at_start,
    met_by_faces,
    solids,
    surface,
)
from taichi_cloth.settings.options import RunOptions
from taichi_cloth.simulation.checkpoint import Checkpoint
from taichi_cloth.simulation.readings import Readings
from taichi_cloth.simulation.simulation import Simulation

G, RADIUS = 9.81, 0.1
TETRAHEDRON = np.array([[0, 0, 0], [0.9, 0, 0], [0, 0.9, 0], [0, 0, 0.9]])
ITS_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def on_slope(degrees, friction, **world):
    """A disc at rest on a slope that falls to the right, and the direction down the slope."""
    slope = np.radians(degrees)
    normal, down = (
        np.array([np.sin(slope), np.cos(slope)]),
        np.array([np.cos(slope), -np.sin(slope)]),
    )
    here = World(size=(100.0, 100.0), gravity=(0.0, -G), dt=0.01, **world)
    start = np.array([20.0, 70.0]) + RADIUS * normal
    plane = Obstacle.build("plane", point=[20.0, 70.0], normal=normal, friction=friction)
    return Scene("slope", here, Particles.build(start, radius=RADIUS), obstacles=(plane,)), down


@pytest.mark.parametrize("method", mostly_thorough(methods.METHODS, default=["verlet"]))
def test_friction_on_a_slope_is_coulombs(device, method):
    sliding, down = on_slope(30.0, 0.2)
    sim = Simulation(sliding, method, execution="serial")
    start = sim.positions()[0]
    sim.advance(100)
    rate = G * (np.sin(np.radians(30.0)) - 0.2 * np.cos(np.radians(30.0)))
    velocity, way = sim.velocities()[0], sim.positions()[0] - start
    np.testing.assert_allclose(velocity, rate * down, rtol=1e-12, atol=1e-13)
    weight = methods.load(method).position_weight
    expected = (0.5 + (weight - 0.5) * 0.01) * rate  # what the method itself makes of it
    np.testing.assert_allclose(way, expected * down, rtol=1e-11, atol=1e-12)
    for degrees, sticks in ((20.05, False), (19.95, True)):
        scene, down = on_slope(degrees, np.tan(np.radians(20.0)))
        sim.load_scene(scene)
        start = sim.positions()
        sim.advance(1000)
        assert np.array_equal(sim.positions(), start) == sticks
        assert np.array_equal(sim.velocities(), 0.0 * start) == sticks


def test_a_bounce_rises_as_its_closed_form_says(device):
    """Second order: what is left of a step after a bounce is part of the flight."""
    world = World(size=(100.0, 100.0), gravity=(0.0, -10.0), dt=0.01)
    floor = Obstacle.build("plane", point=[20.0, 70.0], normal=[0.0, 1.0], restitution=0.8)
    ball = Particles.build([[20.0, 70.0 + RADIUS + 1.0123]], radius=RADIUS)
    sim = Simulation(Scene("bounce", world, ball, obstacles=(floor,)), "verlet", execution="serial")
    sim.advance(72)
    touched = np.sqrt(2 * 1.0123 / 10.0)
    flight, speed = 0.72 - touched, 0.8 * 10.0 * touched
    assert sim.positions()[0, 1] - 70.0 - RADIUS == pytest.approx(
        speed * flight - 5.0 * flight**2, abs=2e-6
    )
    energies = []
    for _ in range(600):
        sim.advance()
        height = sim.positions()[0, 1] - 70.0 - RADIUS
        energies.append(10.0 * height + 0.5 * (sim.velocities() ** 2).sum())
    assert np.diff(energies).max() < 1e-12 and abs(energies[-1]) < 1e-12


@pytest.mark.parametrize("method", mostly_thorough(methods.METHODS, default=["verlet"]))
def test_both_walls_of_a_corner_met_in_a_step_are_as_one_after_the_other(device, method):
    """What the friction of the first takes from the way into the second is no acceleration."""
    world = World(
        size=(10.0, 10.0),
        gravity=(0.0, 0.0),
        dt=0.01,
        walls=("right", "bottom"),
        friction=0.4,
        contact="resting",
    )
    sim = None
    for part in (1.0, 0.6):
        at_once, in_turn = (
            Particles.build([[5.0, y]], [[1.0, 1.0]], radius=0.5, restitution=part)
            for y in (5.0, 4.8)
        )
        ends = []
        for ball in (at_once, in_turn):
            scene = Scene("corner", world, ball)
            if sim is None:
                sim = Simulation(scene, method, execution="serial", topology="graph")
            sim.load_scene(scene)
            sim.advance(600)
            ends.append(sim.velocities()[0])
        friction = 0.4 * (1.0 + part)  # of what each wall turns round
        came = max(1.0 - friction, 0.0)
        slowed = part - min(0.4 * (1.0 + part) * came, part)
        np.testing.assert_allclose(ends[1], [-slowed, -part * came], atol=1e-9)
        np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


@pytest.mark.parametrize("method", mostly_thorough(methods.METHODS, default=["verlet"]))
def test_what_impulses_give_is_no_acceleration_of_a_bounce_in_the_same_step(device, method):
    """Walls and pairs act at its start: what meets an obstacle later came with that."""
    world = World(size=(10.0, 10.0), gravity=(0.0, 0.0), dt=0.01, walls=("left",), collisions=True)
    sim = None
    for height in (1.101, 1.11):
        for normal, x, v in (
            ([0.0, 1.0], [[5.0, height], [5.05, height + 0.19]], [[0.0, -1.0], [0.0, -3.0]]),
            ([0.3, 1.0], [[0.0999, height - 0.02], [5.0, 5.0]], [[-2.0, -1.0], [0.0, 0.0]]),
        ):
            floor = Obstacle.build("plane", point=[0.0, 1.0], normal=normal, restitution=1.0)
            balls = Particles.build(x, v, radius=0.1)
            scene = Scene("at once", world, balls, obstacles=(floor,))
            if sim is None:
                sim = Simulation(scene, method, execution="serial", topology="graph")
            sim.load_scene(scene)
            sim.advance(4)
            assert (sim.velocities() ** 2).sum() == pytest.approx(np.square(v).sum(), rel=1e-12)


@pytest.mark.parametrize("method", mostly_thorough(methods.METHODS, default=["verlet"]))
def test_a_wall_that_ends_a_step_is_no_acceleration_of_a_bounce_in_it(device, method):
    """What crosses more than its diameter past a wall is put onto it, and may be in a floor there:
    it leaves as if it had met one after the other, or, led away by the wall, as that one has it."""
    world = World(size=(10.0, 10.0), gravity=(0.0, 0.0), dt=0.01, walls=("left",))
    floor = Obstacle.build("plane", point=[0.0, 1.0], normal=[0.3, 1.0], restitution=1.0)
    speeds = np.stack(np.meshgrid(np.arange(30.0, 70.0, 5.0), np.arange(3.0, 60.0, 3.0)), -1)
    v = -1.0 * np.concatenate([speeds.reshape(-1, 2), [[55.13, 14.81]]])
    x = np.array([0.2045, 1.0 - 0.3 * 0.2045 + 0.1 * np.hypot(0.3, 1.0)])
    heights = np.linspace(0.002, 0.4, 7)
    starts = np.concatenate([x + [0.0, height] for height in heights for _ in v]).reshape(-1, 2)
    v = np.tile(v, (len(heights), 1))
    balls = Particles.build(starts, v, radius=0.1)
    scene = Scene("at once", world, balls, obstacles=(floor,))
    sim = Simulation(scene, method, execution="serial", topology="graph")
    for _ in range(3):
        sim.advance()
        np.testing.assert_allclose((sim.velocities() ** 2).sum(1), (v**2).sum(1), rtol=1e-12)


@pytest.mark.usefixtures("device", "few_lanes")
def test_in_lanes_each_particle_bounces_with_what_walls_gave_itself():
    """All of a small cloth meet a wall and a floor in one step, at speeds of their own; then so
    fast that the wall holds them at the step's end."""
    world = World(size=(10.0, 10.0), gravity=(0.0, 0.0), dt=0.01, walls=("left",))
    ties = SpringDefaults(stiffness=1.0)
    balls, *rest = grid([0.099, 1.0773], 4, 3, 1e-4, spring_defaults=ties)
    slow = np.stack([-1.0 - 0.05 * np.arange(12.0), np.full(12, -1.0)], axis=1)
    fast = np.stack([-50.0 - np.arange(12.0), np.full(12, -15.0)], axis=1)
    floor = Obstacle.build("plane", point=[0.0, 1.0], normal=[0.3, 1.0], restitution=1.0)
    sims = {}
    for move, v in (([0.0, 0.0], slow), ([0.1, 0.0], fast)):
        cloth = replace(balls, position=balls.position + move, velocity=v, radius=np.full(12, 0.1))
        scene = Scene("at once", world, cloth, *rest, obstacles=(floor,))
        for topology in ("graph", "lanes"):
            if topology not in sims:
                sims[topology] = Simulation(
                    scene, "verlet", execution="serial", topology=topology, lanes=2
                )
            sim = sims[topology]
            sim.load_scene(scene)
            sim.advance()
            np.testing.assert_allclose((sim.velocities() ** 2).sum(1), (v**2).sum(1), rtol=1e-3)


def lone_triangles(rng):
    """Triangles of no springs, fast and slow, some of which meet a rod and the wall in one step."""
    x = rng.uniform(-0.05, 0.05, (1100, 1, 3)) + rng.uniform(-0.15, 0.15, (1100, 3, 3))
    x = np.maximum(x + [0.2, 1.24, 0.0], [0.011, 0.0, -1.0])
    v = rng.uniform(-30, 30, (1100, 1, 3)) + rng.uniform(-3, 3, x.shape)
    return x, v, np.arange(3).reshape(1, 3)


def small_sheets(rng):
    """Sheets of 4 x 4 particles and no springs that fall flat onto a rod, each as it lies."""
    x = np.stack(np.meshgrid(np.arange(4), [0.0], np.arange(4), indexing="ij"), -1).reshape(-1, 3)
    moves = np.stack([rng.uniform(0.0, 0.3, 60), rng.uniform(1.04, 1.06, 60), np.zeros(60)], -1)
    x = moves[:, None] + 0.1 * x
    v = rng.uniform(-3, 3, (60, 1, 3)) * [1, 0, 1] - [0.0, 3.0, 0.0] + np.zeros_like(x)
    return x, v, grid_triangles(4, 4)


@pytest.mark.parametrize("method", mostly_thorough(methods.METHODS, default=["verlet"]))
def test_faces_bounce_off_an_edge_with_the_energy_that_they_came_with(device, method):
    """Also those that several places of it meet, that share corners, and that a wall turns."""
    world = World(size=(10.0, 10.0, 10.0), gravity=(0.0, 0.0, 0.0), dt=0.01, walls=("left",))
    rod = Obstacle.build(
        "capsule", ends=[[0.2, 1.0, -2.0], [0.2, 1.0, 2.0]], radius=0.02, restitution=1.0
    )
    sim = None
    for thrown in (lone_triangles, small_sheets):
        x, v, corners = thrown(np.random.default_rng(3))
        triangles = corners + x.shape[1] * np.arange(len(x))[:, None, None]
        scene = Scene(
            *("thrown", world, Particles.build(x.reshape(-1, 3), v.reshape(-1, 3), radius=0.01)),
            triangles=triangles.reshape(-1, 3),
            obstacles=(rod,),
        )
        if sim is None:
            sim = Simulation(scene, method, execution="serial", topology="graph")
        sim.load_scene(scene)
        sim.advance(3)
        after = sim.velocities().reshape(x.shape)
        hit = (np.abs(after) != np.abs(v)).any((1, 2))
        part = (after**2).sum((1, 2)) / (v**2).sum((1, 2))
        assert hit.sum() > 20 and part.max() < 1.005
        assert np.quantile(part[hit], 0.1) > 0.98


@pytest.mark.parametrize("method", mostly_thorough(methods.METHODS, default=["verlet"]))
def test_what_an_edge_gives_is_no_acceleration_of_a_bounce_in_the_same_step(device, method):
    """A rod meets a small disc by its side, and turns with its far end onto the floor."""
    disc = Obstacle.build("sphere", centre=[9.7, 9.95], radius=0.05, restitution=1.0)
    floor = Obstacle.build("plane", point=[0.0, 10.0], normal=[0.0, 1.0], restitution=1.0)
    world = World(size=(40.0, 40.0), gravity=(0.0, 0.0), dt=1e-3)
    share = np.array([0.8, 0.2])
    one = -1.0 + 2.0 * share / (share**2).sum()  # what the disc makes of -1
    sim = None
    for gap in (2e-4, 8e-4):
        x = np.array([[9.5, 10.02 + gap], [10.5, 10.02 + gap]])
        rod = Particles.build(x, [[0.0, -1.0]] * 2, radius=0.02)
        tie = Springs.build([[0, 1]], x, stiffness=1.0)
        scene = Scene("rod", world, rod, tie, obstacles=(disc, floor))
        if sim is None:
            sim = Simulation(scene, method, execution="serial", topology="graph")
        sim.load_scene(scene)
        sim.advance()
        np.testing.assert_allclose(sim.velocities()[:, 1], np.abs(one), rtol=1e-6)


@pytest.mark.parametrize(
    ("method", "fall"), [("verlet", 1.25), ("symplectic_euler", 1.25 * 33 / 32)]
)
def test_a_step_that_ends_on_the_surface_is_a_bounce(device, method, fall):
    """All numbers are whole in binary: the 32nd step ends on the floor, to the bit."""
    world = World(size=(64.0, 64.0), gravity=(0.0, -10.0), dt=1 / 64, up="y")
    floor = Obstacle.build("plane", point=[0.0, 8.0], normal=[0.0, 1.0], restitution=0.5)
    ball = Particles.build([[20.0, 8.5 + fall]], radius=0.5)
    sim = Simulation(Scene("arrival", world, ball, obstacles=(floor,)), method, execution="serial")
    sim.advance(31)
    arriving = sim.velocities()[0, 1] - 10 / 64
    sim.advance()
    assert sim.positions()[0, 1] == 8.5 and sim.velocities()[0, 1] == -0.5 * arriving
    heights = []
    for _ in range(16):
        sim.advance()
        heights.append(sim.positions()[0, 1] - 8.5)
    assert max(heights) == pytest.approx(0.25 * 1.25, rel=0.1) and min(heights) > 0.0


@pytest.mark.parametrize(("method", "part"), [("symplectic_euler", 1.0), ("verlet", 0.0)])
def test_a_ball_that_bounces_loses_energy_by_the_law_of_first_order(device, method, part):
    """g h t / (2 H) of it in a time t, for a step h and a height H; `verlet` has none of that."""
    h, height = 1 / 240, 1.0
    world = World((10.0, 10.0, 10.0), (0.0, -G, 0.0), dt=h, up="y", ground=0.0, contact="resting")
    ball = Particles.build([[5.0, 0.1 + height, 0.0]], radius=0.1, restitution=1.0)
    sim = Simulation(Scene("ball", world, ball, Springs.none()), method, execution="serial")
    sim.advance(int(10 * np.sqrt(8 * height / G) / h))
    speed = sim.velocities()[0]
    left = (G * (sim.positions()[0, 1] - 0.1) + 0.5 * speed @ speed) / (G * height)
    assert 1.0 - left == pytest.approx(part * G * h * sim.time / (2 * height), rel=0.02, abs=2e-3)


def one_of_each(**more):
    """An obstacle of each shape, with what lies on top of it, in 3-D."""
    shapes = {
        "plane": {"point": [0.0, 1.0, 0.0], "normal": [0.0, 1.0, 0.0]},
        "sphere": {"centre": [2.0, 2.0, 0.0], "radius": 0.4},
        "capsule": {"ends": [[3.7, 2.0, 0.2], [4.3, 2.0, -0.2]], "radius": 0.4},
        "box": {"centre": [6.0, 2.0, 0.0], "half": [0.5, 0.4, 0.3], "turn": [0.0, 33.0, 0.0]},
        "mesh": {
            "vertices": TETRAHEDRON * [1, -1, 1],
            "faces": ITS_FACES[:, ::-1],
            "centre": [8.0, 2.4, 0.0],
            "cell": 0.05,
        },
    }
    tops = [[0.5, 1.0], [2.0, 2.4], [4.0, 2.4], [6.0, 2.4], [8.25, 2.4]]
    z = [0.0, 0.0, 0.0, 0.0, 0.25]
    assert set(shapes) == set(SHAPES)
    obstacles = tuple(Obstacle.build(name, **given, **more) for name, given in shapes.items())
    lying = np.array([[x, y + RADIUS, at] for (x, y), at in zip(tops, z, strict=True)])
    world = World(size=(10.0, 10.0, 10.0), gravity=(0.0, -G, 0.0), dt=1 / 60, up="y")
    return world, obstacles, lying


@pytest.mark.parametrize("method", mostly_thorough(methods.METHODS, default=["symplectic_euler"]))
def test_what_lies_on_a_shape_stays_to_the_bit(device, method):
    """Also where it was dropped from; it neither sinks nor hovers, and has no velocity."""
    world, obstacles, lying = one_of_each(friction=0.3)
    particles = Particles.build(lying + [0.0, 0.05, 0.0], radius=RADIUS)
    scene = Scene("rest", world, particles, obstacles=obstacles)
    sim = Simulation(scene, method, substeps=4, execution="serial")
    sim.advance(40)
    settled = sim.positions()
    np.testing.assert_allclose(settled, lying, atol=1e-12)
    assert np.abs(sim.depths()).max() < 1e-14
    sim.advance(100)
    assert np.array_equal(sim.positions(), settled) and not sim.velocities().any()


@pytest.mark.parametrize("method", mostly_thorough(methods.METHODS, default=["symplectic_euler"]))
def test_what_sticks_to_an_obstacle_that_moves_goes_with_it_as_a_part_of_it(device, method):
    """On a turning sphere and a turntable that rises; one comes to rest on it, and then stays."""
    obstacles = (
        Obstacle.build("sphere", centre=[3.0, 5.0, 0.0], radius=1.0, spin=[0, 90, 0], friction=0.8),
        Obstacle.build(
            "box",
            centre=[6.0, 2.0, 0.0],
            half=[1.5, 0.1, 1.5],
            velocity=[0.3, 0.5, -0.2],
            spin=[0, 60, 0],
            friction=0.6,
        ),
    )
    lean = 1.1 * np.array([np.sin(0.4), np.cos(0.4)])
    x = [[3.0 + lean[0], 5.0 + lean[1], 0.0], [6.7, 2.2, 0.3], [6.2, 2.2, 0.0]]
    v = [[0, 0, -lean[0] * np.pi / 2], [0.3 + 0.1 * np.pi, 0.5, -0.2 - 0.7 * np.pi / 3], [0, 0, 0]]
    world = World(size=(10.0, 10.0, 10.0), gravity=(0.0, -G, 0.0), dt=0.01, up="y")
    particles = Particles.build(x, v, radius=RADIUS)
    sim = Simulation(
        Scene("carried", world, particles, obstacles=obstacles), method, execution="serial"
    )
    placed = solids(sim.scene)

    def in_frames():
        frames = [placed[0].pose(sim.time), placed[1].pose(sim.time), placed[1].pose(sim.time)]
        return np.array(
            [(at - c) @ turn for at, (c, turn) in zip(sim.positions(), frames, strict=True)]
        )

    first = in_frames()
    sim.advance(100)
    after = in_frames()
    np.testing.assert_allclose(after[:-1], first[:-1], rtol=0, atol=1e-12)
    sim.advance(300)
    np.testing.assert_allclose(in_frames(), after, rtol=0, atol=1e-12)
    assert sim.depths().max() < 1e-12


def test_shapes_have_distances_normals_and_closed_surfaces():
    world, obstacles, _ = one_of_each(velocity=[0.1, 0.2, 0.3], spin=[10.0, 20.0, 30.0])
    rng = np.random.default_rng(1)
    for solid in solids(Scene("shapes", world, Particles.none(3), obstacles=obstacles)):
        centre, turn = solid.pose(0.7)
        x = centre + rng.uniform(-0.7, 0.7, (500, 3))
        d, n = solid.distances(x, 0.7)
        slope = [
            (solid.distances(x + h, 0.7)[0] - solid.distances(x - h, 0.7)[0]) / 2e-6
            for h in 1e-6 * np.eye(3)
        ]
        error = np.abs(np.transpose(slope) - n).max(axis=1)
        assert np.median(error) < (1e-8 if solid.shape != "mesh" else 0.05), solid.shape
        vertices, faces = surface(solid, 10.0)
        on, _ = solid.distances(centre + vertices @ turn.T, 0.7)
        assert np.abs(on).max() < (1e-12 if solid.shape != "mesh" else 0.03), solid.shape
        if solid.shape != "plane":
            a, b, c = (vertices[faces[:, k]] for k in range(3))
            assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0  # all round, seen from outside
        assert np.allclose(d[on.argmin() : on.argmin() + 1], d[on.argmin()])


@pytest.mark.parametrize("shape", ["sphere", "capsule", "box"])
def test_nothing_of_an_obstacle_is_outside_the_ball_around_it(shape):
    """Which is no larger than it need be: who is outside of it is not asked about the rest."""
    keys = {
        "sphere": {"centre": [1.0, 2.0, 3.0], "radius": 0.25},
        "capsule": {"ends": [[0.0, 0.0, 0.0], [1.0, 2.0, 2.0]], "radius": 0.25},
        "box": {"centre": [1.0, 2.0, 3.0], "half": [0.5, 1.0, 2.0], "turn": [0.0, 0.0, 0.0]},
    }
    placed = load(shape).place(keys[shape], 3, 0.1)
    vertices, _ = load(shape).surface(placed, 1.0)
    farthest = np.linalg.norm(vertices, axis=1).max()
    assert 0.9 * placed.bound < farthest <= placed.bound * (1 + 1e-12)


def test_a_file_with_obstacles_reads_back_as_it_was():
    world, obstacles, lying = one_of_each(friction=0.25, velocity=[0.1, 0.0, -0.0])
    world = World(**{**vars(world), "ground": -0.0, "friction": 0.5, "contact": "resting"})
    scene = Scene("file", world, Particles.build(lying), obstacles=obstacles)
    again = scenefile.parse(scenefile.dump(scene))
    assert again.obstacles == scene.obstacles and again.world == world
    assert scenefile.dump(again) == scenefile.dump(scene)


@pytest.mark.parametrize(
    ("newer", "contact"),
    [
        ("", "original"),
        ("up = 'y'", "resting"),
        ("ground = 0.5", "resting"),
        ("friction = 0.5", "resting"),
        ("air = { density = 1.2 }", "resting"),
        ("up = 'y'\ncontact = 'original'", "original"),
        ("contact = 'resting'", "resting"),
        ("[[obstacles]]\nshape = 'sphere'\ncentre = [0, 0, 0]\nradius = 0.1", "resting"),
    ],
)
def test_files_with_anything_new_have_resting_contacts(newer, contact):
    text = f"[world]\nsize = [1, 1, 1]\nwalls = true\n{newer}\n"
    scene = scenefile.parse(text)
    assert scene.world.contact == contact
    for other in CONTACTS:  # also where a scene says what its kind has not
        kept = scene.with_world(contact=other)
        if other == "resting" or not kept.world.friction:
            assert scenefile.parse(scenefile.dump(kept)).world == kept.world


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (
            "shape = 'spere'",
            "line 4: [[obstacles]] 0: unknown shape 'spere'; did you mean 'sphere'?",
        ),
        ("shape = 'sphere'\nradius = 1", "'centre' is missing"),
        ("shape = 'sphere'\ncentre = [0, 0]\nradius = 1", "centre must be 3 numbers"),
        (
            "shape = 'sphere'\ncentre = [0, 0, 0]\nradius = 0",
            "line 6: [[obstacles]] 0: radius must be",
        ),
        ("shape = 'sphere'\ncentre = [0, 0, nan]\nradius = 1", "centre must be finite"),
        ("shape = 'sphere'\ncentre = [0, 0, 0]\nradius = 1\nfriktion = 1", "mean 'friction'?"),
        ("shape = 'box'\ncentre = [0, 0, 0]\nhalf = [1, 0, 1]", "half must be positive"),
        ("shape = 'plane'\npoint = [0, 0, 0]\nnormal = [0, 0, 0]", "normal must not be zero"),
        ("shape = 'capsule'\nradius = 1\nends = [[0, 0, 0], [0, 0, 0]]", "two different points"),
        ("shape = 'mesh'\nvertices = [[0, 0, 0]]\nfaces = [[0, 0, 1]]", "there is no vertex 1"),
        ("shape = 'mesh'\nfile = 'no.obj'", "line 5: [[obstacles]] 0: no.obj: there is no such"),
        (
            "shape = 'mesh'\nfile = 'no.obj'\nfaces = [[0, 1, 2]]",
            "line 6: [[obstacles]] 0: faces and",
        ),
        (
            "shape = 'sphere'\ncentre = [0, 0, 0]\nradius = 1\nstarts = 2\nstops = 1",
            "line 8: [[obstacles]] 0: stops must not be before starts, 2, is 1",
        ),
    ],
)
def test_a_wrong_obstacle_is_refused_by_its_line(given, says):
    text = f"[world]\nsize = [1, 1, 1]\n[[obstacles]]\n{given}\n"
    with pytest.raises(InputError) as refused:
        scenefile.parse(text)
    assert says in str(refused.value) and "\n" not in str(refused.value)


def test_friction_without_a_surface_is_refused():
    world = World(size=(1.0, 1.0), gravity=(0.0, 1.0), friction=0.5, walls=("bottom",))
    with pytest.raises(InputError, match="set contact = 'resting'"):
        validate(Scene("none", world, Particles.none(2)))


def draped(**sphere):
    """A cloth above a sphere and the ground."""
    cloth, ties = grid(
        [4.6, 1.05, -0.4],
        9,
        9,
        0.1,
        links=["structural", "shear"],
        across=[1, 0, 0],
        down=[0, 0, 1],
        particle_defaults=ParticleDefaults(mass=0.001, radius=0.02, viscous=1e-4),
        spring_defaults=SpringDefaults(stiffness=20.0, damping=0.002),
    )
    ball = Obstacle.build("sphere", centre=[5.0, 0.7, 0.0], radius=0.3, friction=0.5, **sphere)
    world = World(
        size=(10.0, 10.0, 10.0), gravity=(0.0, -G, 0.0), dt=1 / 60, up="y", ground=0.4, friction=0.3
    )
    return Scene("draped", world, cloth, ties, obstacles=(ball,))


@pytest.mark.thorough
def test_a_cloth_on_a_turning_sphere_is_outside_and_turns_alike_in_all_ways(device):
    ends = []
    for topology, execution in (("graph", "serial"), ("lanes", "serial"), ("lanes", "parallel")):
        how = {"topology": topology, "execution": execution, "lanes": 2}
        sim = Simulation(draped(spin=[0.0, 90.0, 0.0]), "symplectic_euler", substeps=8, **how)
        for _ in range(120):
            sim.advance()
            assert sim.depths().max() < 1e-12
        ends.append((sim.positions(), sim.velocities()))
    for end in ends[1:]:
        np.testing.assert_array_equal(end, ends[0])
    arm, v = ends[0][0] - [5.0, 0.0, 0.0], ends[0][1]
    spin = (arm[:, 2] * v[:, 0] - arm[:, 0] * v[:, 2]).sum() / (arm[:, ::2] ** 2).sum()
    assert spin == pytest.approx(np.pi / 2, rel=0.15)


def hail(**world):
    """Particles that fly among obstacles of each shape, one very thin."""
    _, obstacles, _ = one_of_each(friction=0.3)
    plate = Obstacle.build("box", centre=[5.0, 5.0, 0.0], half=[5.0, 0.001, 1.0], restitution=0.5)
    rng = np.random.default_rng(5)
    x = rng.uniform([0.0, 2.6, -1.0], [10.0, 8.0, 1.0], (200, 3))
    v = rng.normal(0, 1, x.shape) * rng.choice([0.5, 5.0, 60.0], (200, 1))
    world = {"gravity": (0.0, -G, 0.0), "dt": 1 / 60, "up": "y"} | world
    particles = Particles.build(x, v, radius=0.05)
    here = World(size=(10.0, 10.0, 10.0), **world)
    return Scene("hail", here, particles, obstacles=(*obstacles, plate))


@pytest.mark.parametrize(
    ("method", "world"),
    [
        ("symplectic_euler", {"contact": "resting", "collisions": True}),
        as_thorough(("explicit_euler", {})),
    ],
)
def test_who_is_in_a_ball_free_of_obstacles_would_have_met_nothing(
    device, monkeypatch, method, world
):
    """The bits are those of asking all obstacles of all particles in each step."""

    def states():
        sim = Simulation(hail(**world), method, substeps=4, topology="graph", execution="serial")
        states, touched, early = [], 0, sim.checkpoint()
        for frame in range(60):
            if frame == 30:
                sim.restore(early)
            if frame == 40:  # who was far from all is put where others lay
                there = np.clip(np.roll(sim.positions(), 7, axis=0), [0, 0, -5], [10, 10, 5])
                sim.set(positions=there)
            sim.advance()
            states.append((sim.positions(), sim.velocities()))
            touched += (np.abs(sim.depths()) < 1e-9).sum()
        balls = state_of(sim).free_ball.to_numpy()[:, 3] > 0
        assert touched > 100
        return np.array(states), balls.sum()

    found, balls = states()
    monkeypatch.setattr(obstruction, "keeps_balls", lambda spec: False)
    expected, none = states()
    np.testing.assert_array_equal(found, expected)
    assert balls > 20 and none == 0


def test_what_is_drawn_is_in_its_place_and_resting_walls_are_not():
    """Obstacles in their order, then the ground; at the time that is asked for, or now."""
    sphere = Obstacle.build("sphere", centre=[5.0, 2.0], radius=0.5, velocity=[1.0, -0.5])
    box = Obstacle.build("box", centre=[2.0, 2.0], half=[0.5, 0.25], spin=90.0)
    walls = {"walls": ("left",), "contact": "resting", "ground": 1.0}
    world = World((10.0, 10.0), gravity=(0.0, -1.0), up="y", **walls)
    scene = Scene("drawn", world, Particles.none(2), obstacles=(sphere, box))
    assert [solid.name for solid in solids(scene)][-1] == "left wall"
    sim = SimpleNamespace(storage=SimpleNamespace(scene=scene, solids=solids(scene)), time=3.0)
    for time, at in ((None, 3.0), (1.0, 1.0)):
        drawn = Readings.obstacles(sim, time)
        assert [one.name for one in drawn] == ["obstacle 0", "obstacle 1", "ground"]
        ball, turned, ground = (one.points() for one in drawn)
        away = np.linalg.norm(ball - [5.0 + at, 2.0 - 0.5 * at], axis=1)
        assert away.max() == pytest.approx(0.5)
        assert np.abs(turned - [2.0, 2.0]).max(axis=0) == pytest.approx([0.25, 0.5])
        assert ground[:, 1].max() == 1.0 and np.ptp(ground[:, 0]) > 10.0


@pytest.mark.thorough
def test_nothing_passes_through_in_one_step(device):
    """A plate thinner than a particle's step, and a sphere that flies through a sheet of them."""
    world = World(size=(10.0, 10.0, 10.0), gravity=(0.0, 0.0, 0.0), dt=0.02)
    x = np.stack(np.meshgrid(np.linspace(4.8, 5.2, 9), [1.0], np.linspace(-0.2, 0.2, 9)), -1)
    particles = Particles.build(x.reshape(-1, 3), np.tile([0, -100.0, 0], (81, 1)), radius=0.01)
    plate = Obstacle.build("box", centre=[5.0, 0.5, 0.0], half=[1.0, 0.001, 1.0])
    ball = Obstacle.build("sphere", centre=[5.0, -0.2, 0.0], radius=0.1, velocity=[0, 100.0, 0])
    sim = Simulation(Scene("thin", world, particles, obstacles=(plate,)), execution="serial")
    sim.advance(2)
    np.testing.assert_allclose(sim.positions()[:, 1], 0.511, rtol=1e-12)
    sim = Simulation(
        Scene("fast", world, Particles.build(x.reshape(-1, 3), radius=0.01), obstacles=(ball,)),
        execution="serial",
    )
    sim.advance()
    hit = np.hypot(*(x.reshape(-1, 3)[:, ::2] - [5.0, 0.0]).T) < 0.11
    assert (sim.velocities()[hit, 1] > 0).all() and not sim.velocities()[~hit].any()
    assert sim.depths().max() < 1e-12


SHARES = np.array([(i, j, 16 - i - j) for i in range(17) for j in range(17 - i)]) / 16


def deepest_face(sim, some=slice(None)):
    """How deep the faces of a scene's triangles are in its obstacles, sampled [length].

    some: of which triangles; absent: all.
    """
    points = np.einsum("sk,mkd->msd", SHARES, sim.positions()[sim.scene.triangles[some]])
    radii = np.full(points.size // 3, sim.radii().max())
    sharp = [solid for solid in solids(sim.scene) if solid.shape != "plane"]
    return depths(sharp, points.reshape(-1, 3), radii, sim.time).max()


SHARP = {
    "rod": Obstacle.build("capsule", **ROD),
    "corner": Obstacle.build(
        "box", centre=[5.0, 0.8, 0.0], half=[0.05] * 3, turn=[45.0, 0.0, 35.26], friction=0.6
    ),
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", SHARP)
def test_a_cloth_lies_on_what_would_pass_between_its_particles(device, name):
    """Its faces too are outside: of a rod to a thousandth, of a corner to a 50th of a cell."""
    sim = Simulation(
        loose_sheet(SHARP[name]),
        "symplectic_euler",
        substeps=8,
        topology="graph",
        execution="serial",
    )
    for _ in range(12):
        sim.advance(8)
        assert deepest_face(sim) < (2e-5 if name == "rod" else 1e-3)
        assert sim.depths().max() < 1e-12
    assert sim.positions()[:, 1].max() > (0.955 if name == "rod" else 0.88)
    assert sim.unsettled_faces() == 0


@pytest.mark.parametrize("topology", mostly_thorough(["graph", "lanes"], default=["graph"]))
def test_threads_of_a_torn_cloth_lie_on_what_would_pass_between_their_particles(device, topology):
    """No triangle of it is whole, and of each only the side across the rod holds."""
    scene = loose_sheet(SHARP["rod"], break_force=1e3)
    near, far = scene.springs.between.T
    crosses = scene.particles.position[near, 0] != scene.particles.position[far, 0]
    how = {"topology": topology, "execution": "serial", "lanes": 2}
    sim = Simulation(scene, "symplectic_euler", substeps=8, **how)
    sim.cut(crosses)
    assert not sim.triangles_alive().any()
    along = np.linspace(0.0, 1.0, 21)[:, None, None]
    near, far = near[~crosses], far[~crosses]
    for _ in range(4):
        sim.advance(8)
        x = sim.positions()
        points = (x[near] + along * (x[far] - x[near])).reshape(-1, 3)
        assert depths(sim.storage.solids, points, np.full(len(points), 0.002), 0.0).max() < 2e-5
    tops = sim.positions().reshape(9, 9, 3)[..., 1].max(axis=0)
    assert tops.min() > 0.955  # each thread hangs over it
    assert sim.unsettled_faces() == 0


IN_BOUNDS = """
from test_obstacles import SHARP, Simulation, loose_sheet

from taichi_cloth import runtime

runtime.start("cpu")
scene = loose_sheet(SHARP["rod"], break_force=1e3)
sim = Simulation(scene, substeps=8, topology="graph", execution="serial")
sim.advance()
sim.cut([0, 1])
sim.advance()
"""


def test_a_cloth_that_begins_through_a_box_is_not_thrown(device, capsys):
    """Faces whose corners are pushed to several sides stay through it, by which no energy comes."""
    sim = None
    # Of a plate thinner than half a side no face can be a quarter of a side inside; of the last
    # one, which is between particles, none of these is. No face is as near to two sides of the box.
    off = [5.011, 0.997, 0.023]
    for half, centre in ((0.12, off), (0.0005, [5.0, 1.0, 0.02]), (0.0005, [5.01, 1.0, 0.02])):
        box = Obstacle.build("box", centre=centre, half=[half, 0.16, 0.14])
        scene = loose_sheet(box, gravity=(0.0, 0.0, 0.0))
        if sim is None:
            sim = Simulation(scene, topology="graph", execution="serial")
        sim.load_scene(scene, substeps=8)
        run_notes.note_inside(sim, RunOptions())
        assert "faces or edges of a cloth begin through an obstacle" in capsys.readouterr().err
        ends, rest = scene.springs.between, scene.springs.rest_length
        energies = []
        for _ in range(20):
            sim.advance()
            x, v = sim.positions(), sim.velocities()
            lengths = np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1)
            energies.append(10.0 * ((lengths - rest) ** 2).sum() + 0.5e-3 * (v**2).sum())
            assert sim.depths().max() < 1e-12
        assert max(energies) == energies[0] and sim.unsettled_faces() == 0
    # A blade that comes so fast that sweeps are given up; the count stays until a reset.
    thin, up = [0.0005, 0.16, 0.14], [0.0, 5.0, 0.0]
    blade = Obstacle.build("box", centre=[5.0, 0.7, 0.02], half=thin, velocity=up)
    sim.load_scene(loose_sheet(blade, gravity=(0.0, 0.0, 0.0)))
    for count in (0, 0, 1):
        sim.advance()
        inside = deepest_face(sim) > (0.0005 + 0.002) / 2
        assert sim.unsettled_faces() == count == inside
    run_notes.note_unsettled(sim)
    assert "note: 1 of 3 steps ended with faces or edges of a cloth" in capsys.readouterr().err
    sim.set(stiffness=3.0)  # which loads
    assert sim.unsettled_faces() == 1 and sim.unsettled() == 0
    sim.reset()
    assert sim.unsettled_faces() == 0
    run_notes.note_unsettled(sim)
    assert capsys.readouterr().err == ""
    # What is pushed to one side, or lies on a rod, is tested as ever; what is fixed may be inside.
    rod = Obstacle.build("capsule", **(ROD | {"ends": [[4.0, 1.0, 0.0], [6.0, 1.0, 0.0]]}))
    for obstacle in (rod, Obstacle.build("box", centre=[5.0, 0.9, 0.0], half=[0.3, 0.12, 0.3])):
        near = loose_sheet(obstacle)
        assert len(inside_at_start(near, solids(near)).particles)
        assert not through_from_start(near).any()
    held = replace(scene, particles=replace(scene.particles, fixed=np.ones(81, bool)))
    assert not through_from_start(held).any()
    through, elements = through_from_start(scene), scene.elements
    fixed = np.arange(81) == elements[through][0, 0]  # of one particle that is fixed: its faces
    held = replace(scene, particles=replace(scene.particles, fixed=fixed))
    np.testing.assert_array_equal(through_from_start(held), through & ~fixed[elements].any(axis=1))


@pytest.mark.parametrize("shape", ["rod", as_thorough("plate")])
def test_every_step_that_ends_with_a_face_deep_in_an_obstacle_is_counted(device, shape):
    """Where sweeps were given up, and where a step's path met the obstacle in another place."""
    ends = [[4.968, 0.695, -0.148], [4.946, 0.805, 0.009]]
    plate = {"centre": [4.916, 0.75, 0.041], "half": [0.01, 0.16, 0.002]}
    known = {"rod": ("capsule", {"ends": ends, "radius": 0.003}), "plate": ("box", plate)}
    (kind, values), sim, counted = known[shape], None, []
    for speed, steps in ((9.86, 5), (11.37, 7), (4.0, 4)):
        obstacle = Obstacle.build(kind, **values, velocity=[0.0, speed, 0.0])
        scene = loose_sheet(obstacle, gravity=(0.0, 0.0, 0.0), dt=1 / 60 / steps)
        sim = sim or Simulation(scene, topology="graph", execution="serial")
        sim.load_scene(scene)
        for _ in range(8 * steps):
            before = sim.unsettled_faces()
            sim.advance()
            x = sim.positions()[scene.triangles]
            longest = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max()
            room = max(0.002 + 0.003 * (shape == "rod"), LEAST_ROOM * longest)
            counted.append(sim.unsettled_faces() - before)
            assert counted[-1] or deepest_face(sim) < UNSETTLED * room
    assert 0 < sum(counted) < len(counted) / 3


def test_no_face_ends_deep_in_what_its_path_met_elsewhere(device):
    """Faces around a box, along whose steps they met another side of it: one was 6 mm inside."""
    box = Obstacle.build("box", centre=[5.011, 0.997, 0.023], half=[0.12, 0.16, 0.14])
    scene = loose_sheet(box, gravity=(0.0, 0.0, 0.0), dt=1 / 480)
    through = through_from_start(scene)[: len(scene.triangles)]
    sim = Simulation(scene, topology="graph", execution="serial")
    for _ in range(64):
        sim.advance()
        assert deepest_face(sim, ~through) < 1e-3
    assert sim.unsettled_faces() == 0


def test_a_face_whose_fixed_corner_an_obstacle_leaves_is_not_tested_in_that_step(device):
    """Though it ends deep inside, and with its corner outside: the next step takes it out."""
    ends = Particles.build(
        [[5.0, 1.0, 0.0], [5.05, 1.0, 0.0], [5.0, 1.0, 0.05]],
        fixed=[True, False, False],
        radius=0.002,
        mass=0.001,
    )
    moves = {"centre": [5.0, 1.005, 0.0], "velocity": [1.2, 0.0, 0.0]}
    world = World((10.0, 10.0, 10.0), (0.0, 0.0, 0.0), dt=1 / 60, up="y")
    scene = Scene(
        "held",
        world,
        ends,
        Springs.none(),
        triangles=np.array([[0, 1, 2]]),
        obstacles=(Obstacle.build("sphere", radius=0.015, **moves),),
    )
    sim = Simulation(scene, substeps=1, topology="graph", execution="serial")
    sim.advance()
    np.testing.assert_array_equal(sim.positions(), ends.position)
    assert sim.unsettled_faces() == 0 and deepest_face(sim) > UNSETTLED * 0.017
    sim.advance()
    assert deepest_face(sim) < 1e-3


def through_from_start(scene):
    """Which of a scene's elements begin through an obstacle, (m,) bool."""
    every = np.ones(len(scene.elements), bool)
    return goes_through(scene, solids(scene), scene.particles.position, 0.0, every)


def test_faces_that_are_put_through_an_obstacle_stay_through_it(device, tmp_path):
    """It is asked where it is by then; what is pinned, gone back to or removed later is no matter,
    and those that are put outside of it meet it again."""
    half, still = [0.0005, 0.16, 0.14], {"gravity": (0.0, 0.0, 0.0)}
    there = loose_sheet(Obstacle.build("box", centre=[5.0, 1.0, 0.02], half=half), **still)
    expected, put = through_from_start(there), there.particles.position
    assert expected.sum() == 13
    moves = {"centre": [4.0, 1.0, 0.02], "velocity": [2.0, 0.0, 0.0], "stops": 0.5}
    scene = loose_sheet(Obstacle.build("box", half=half, **moves), **still)
    away = replace(scene.particles, position=put + [0.0, 2.0, 0.0])
    scene = replace(scene, particles=away)
    sim = Simulation(scene, substeps=8, topology="graph", execution="serial")
    sim.advance(31)
    assert sim.through_at_start() == 0
    sim.set(positions=put, velocities=np.zeros(3))
    corner = there.elements[expected][0, 0]
    sim.pin([corner])
    sim.set(stiffness=20.5)
    assert sim.through_at_start() == 13
    kept = sim.checkpoint()
    kept.save(tmp_path / "there.npz")
    ends, rest = scene.springs.between, scene.springs.rest_length
    energies, ways = [], []
    for _ in range(20):
        sim.advance()
        x, v = sim.positions(), sim.velocities()
        lengths = np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1)
        energies.append(10.25 * ((lengths - rest) ** 2).sum() + 0.5e-3 * (v**2).sum())
        ways.append(x)
    assert max(energies) == energies[0] and sim.unsettled_faces() == 0
    sim.set(stiffness=20.0)  # it is loaded anew, and then again
    for back in (kept, Checkpoint.load(tmp_path / "there.npz")):
        sim.restore(back)
        sim.advance(20)
        np.testing.assert_array_equal(sim.positions(), ways[-1])
    sim.remove([corner])
    gone = (there.elements == corner).any(axis=1)
    assert sim.through_at_start() == (expected & ~gone).sum() < 13
    sim.set(positions=np.delete(put, corner, axis=0) + [0.0, 0.3, 0.0], velocities=np.zeros(3))
    assert sim.through_at_start() == 0


def test_a_cloth_that_is_let_go_through_a_box_is_not_thrown(device):
    """A corner that is fixed may be inside: its faces are asked once it is free."""
    box = Obstacle.build("box", centre=[5.0, 1.0, 0.02], half=[0.0005, 0.16, 0.14])
    scene = loose_sheet(box, gravity=(0.0, 0.0, 0.0))
    every = np.ones(81, bool)
    held = replace(scene, particles=replace(scene.particles, fixed=every))
    sim = Simulation(held, substeps=8, topology="graph", execution="serial")
    sim.advance(2)
    assert sim.through_at_start() == 0
    sim.unpin(every)
    assert sim.through_at_start() == through_from_start(scene).sum() == 13
    # Pinned and let go elsewhere, those that go through it stay so.
    corner = scene.elements[through_from_start(scene)][0, 0]
    sim.pin([corner])
    sim.unpin([corner])
    assert sim.through_at_start() == 13
    sim.advance(10)
    assert np.abs(sim.velocities()).max() < 0.5 and sim.unsettled_faces() == 0  # it was 2.7 m/s


def test_the_search_for_faces_of_what_may_tear_reads_no_field_outside_of_it():
    """Taichi looks only where it debugs, which is known when a process starts it."""
    paths = os.pathsep.join(map(str, (Path(__file__).parent, Path(__file__).parents[1])))
    environment = os.environ | {"TI_DEBUG": "1", "PYTHONPATH": paths}
    ran = [sys.executable, "-c", IN_BOUNDS]
    done = subprocess.run(ran, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.thorough
@pytest.mark.parametrize("speed", [5.0, 20.0, 100.0])
def test_a_small_fast_sphere_takes_the_cloth_along(device, speed):
    ball = Obstacle.build(
        "sphere", centre=[5.013, 0.9, 0.011], radius=0.015, velocity=[0.0, speed, 0.0]
    )
    sim = Simulation(
        loose_sheet(ball, gravity=(0.0, 0.0, 0.0), dt=0.01),
        "symplectic_euler",
        substeps=4 if speed < 100 else 8,  # with 4, of 0.25 m each, it is through at 2 m
        topology="graph",
        execution="serial",
    )
    frames = 2 + int(0.3 / (0.01 * speed))
    for _ in range(frames):
        sim.advance()
        assert deepest_face(sim) < 2e-3  # of 17 mm, in cells that are torn wide
    x, ahead = sim.positions(), 0.9 + speed * sim.time + 0.015
    assert x[:, 1].max() > ahead > 1.05  # the face that was hit is before it


@pytest.mark.thorough
def test_faces_have_the_same_bits_in_all_ways(device):
    ends = []
    for topology, execution in (("graph", "serial"), ("lanes", "parallel")):
        how = {"topology": topology, "execution": execution, "lanes": 2}
        sim = Simulation(loose_sheet(SHARP["rod"]), "symplectic_euler", substeps=8, **how)
        sim.advance(30)
        ends.append((sim.positions(), sim.velocities()))
    np.testing.assert_array_equal(ends[1], ends[0])
    assert deepest_face(sim) > -1e-3  # it lies on the rod


@pytest.mark.thorough
def test_a_small_fast_disc_takes_a_rope_along_in_the_plane(device):
    """The rope's particles are farther apart than the disc is wide; edges meet it to rounding."""
    x = np.column_stack([np.linspace(4.55, 5.55, 11), np.full(11, 1.0)])
    ties = Springs.build([[k, k + 1] for k in range(10)], x, stiffness=50.0, damping=0.05)
    disc = Obstacle.build("sphere", centre=[5.0, 0.9], radius=0.02, velocity=[0.0, 10.0])
    world = World(size=(10.0, 10.0), gravity=(0.0, 0.0), dt=0.01)
    particles = Particles.build(x, mass=0.01, radius=0.005)
    scene = Scene("rope", world, particles, ties, obstacles=(disc,))
    sim = Simulation(scene, execution="serial", topology="graph")
    along = np.linspace(0.0, 1.0, 41)[:, None, None]
    for _ in range(8):
        sim.advance()
        here, middle = sim.positions(), [5.0, 0.9 + 10.0 * sim.time]
        edges = (1.0 - along) * here[:-1] + along * here[1:]
        assert np.linalg.norm(edges - middle, axis=2).min() > 0.025 * (1 - 2e-3)
    assert here[:, 1].max() > middle[1]


@pytest.mark.parametrize(("radius", "tested"), [(0.39, True), (0.41, False)])
def test_sides_are_tested_where_they_would_be_far_inside(radius, tested):
    """As long as they are at rest: a rope may begin in a heap."""
    x = [[5.0, 6.0], [5.05, 6.0], [5.0, 6.05]]
    ties = Springs.build([[0, 1], [1, 2]], x, stiffness=50.0, rest_length=[0.2, 0.15])
    disc = Obstacle.build("sphere", centre=[5.0, 5.0], radius=radius)
    world = World(size=(10.0, 10.0), gravity=(0.0, 0.0))
    scene = Scene("heap", world, Particles.build(x), ties, obstacles=(disc,))
    assert met_by_faces(scene, solids(scene)) == ["obstacle 0"] * tested


def test_who_begins_inside_is_named_and_who_has_no_room_is_refused(device, capsys):
    ball = Obstacle.build("sphere", centre=[5.0, 5.0], radius=1.0)
    world = World(size=(10.0, 10.0), gravity=(0.0, 0.0))
    particles = Particles.build(
        [[3.0, 5.0], [5.5, 5.0], [4.2, 5.0], [5.0, 5.0]],
        radius=0.1,
        fixed=[False, False, False, True],
    )
    scene = Scene("inside", world, particles, obstacles=(ball,))
    found = inside_at_start(scene, solids(scene))
    assert found.particles.tolist() == [1, 2] and len(found.stuck) == 0
    sim = Simulation(scene, execution="serial")
    run_notes.note_inside(sim, RunOptions())
    said = capsys.readouterr().err
    assert "2 particles begin inside" in said and "particle 1, in obstacle 0" in said
    walls = [
        Obstacle.build("plane", point=[5.0, 5.0], normal=[1.0, 0.0]),
        Obstacle.build("plane", point=[5.1, 5.0], normal=[-1.0, 0.0]),
    ]
    sim = Simulation(Scene("stuck", world, particles, obstacles=tuple(walls)), execution="serial")
    with pytest.raises(InputError, match="particle 0 begins inside obstacle 0, and .* no room"):
        run_notes.note_inside(sim, RunOptions())


def test_particles_wider_than_the_world_are_named_for_it(capsys):
    """A file in metres that says no radius has the original's, of 5."""
    sides = ("left", "right", "bottom")
    world = World(size=(4.0, 3.0), gravity=(0.0, 0.0), walls=sides, contact="resting")

    def made(radius):
        return Scene("wide", world, Particles.build([[1.0, 2.0], [2.0, 2.0]], radius=radius))

    run_notes.note_wide(made([1.5, 1.4]))
    assert not capsys.readouterr().err
    run_notes.note_wide(made([1.4, 5.0]))
    assert "note: particle 1 has a radius of 5, in a world of 3; " in capsys.readouterr().err
    scene = made([5.0, 0.1])
    begun = SimpleNamespace(
        scene=scene, inside_at_start=lambda: inside_at_start(scene, solids(scene))
    )
    with pytest.raises(InputError, match="particle 0 begins inside left wall: particle 0 has a r"):
        run_notes.note_inside(begun, RunOptions())
