"""The built-in scenes in space end inside physical bounds (CPU, f64, coarse); what cameras see."""

import numpy as np
import pytest

from bench.experiments.intersections import intersecting_pairs
from taichi_cloth.scene import library
from taichi_cloth.scene.library import pull, trampoline, twist
from taichi_cloth.scene.model import Particles, Scene, World
from taichi_cloth.scene.solids import held, solids
from taichi_cloth.ui.framing import camera_of


def strain(sim):
    """How much longer than at rest each spring is that holds, as a part of that."""
    springs, x = sim.scene.springs, sim.positions()
    a, b = springs.between[sim.springs_alive()].T
    rest = springs.rest_length[sim.springs_alive()]
    return np.linalg.norm(x[a] - x[b], axis=1) / rest - 1


def energy(sim):
    now = sim.energy()
    return now.kinetic + sum(now.potential.values())


def turns(a, b):
    """How often two lines (n, 3) that lead to larger x, and straight on there, go round each other.

    Gauss's integral, side by side (Klenin, Langowski, "Computation of writhe in modeling of
    supercoiled DNA", 2000). It changes by a whole number where one passes through the other.
    """
    far = np.array([1e3, 0.0, 0.0])
    p, q = (np.vstack([line[0] - far, line, line[-1] + far]) for line in (a, b))
    r = q - p[:, None]
    r13, r14, r23, r24 = r[:-1, :-1], r[:-1, 1:], r[1:, :-1], r[1:, 1:]
    sides = [np.cross(u, v) for u, v in ((r13, r14), (r14, r24), (r24, r23), (r23, r13))]
    sides = [n / np.maximum(np.linalg.norm(n, axis=2, keepdims=True), 1e-300) for n in sides]
    cosines = [np.clip((sides[k] * sides[k - 3]).sum(axis=2), -1, 1) for k in range(4)]
    side = np.sign((np.cross(q[1:] - q[:-1], (p[1:] - p[:-1])[:, None]) * r13).sum(axis=2))
    return float((side * np.arcsin(cosines).sum(axis=0)).sum() / (4 * np.pi))


def after(pool, name, seconds, **parameters):
    """A simulation of a scene so many seconds after its start; its largest depth is checked."""
    scene = library.build(name, **parameters)
    assert scene.world.up == "y" and len(scene.triangles)
    sim = pool(scene, dt="auto")
    start = energy(sim)
    for _ in range(seconds):
        sim.advance(60)
        assert sim.depths().max(initial=-1) < 1e-6  # nothing is inside an obstacle or the floor
    x = sim.positions()
    assert np.isfinite(x).all()
    which, local = held(scene, solids(scene))
    still = scene.particles.fixed & (which < 0)
    assert (x[still] == scene.particles.position[still]).all()
    for index, solid in enumerate(solids(scene)):
        (centre, turn), mine = solid.pose(sim.time), which == index
        np.testing.assert_allclose(x[mine], centre + local[mine] @ turn.T, atol=1e-9)
    return sim, x, start


def test_the_net_bounces_evenly_and_keeps_its_energy(pool):
    sim, x, start = after(pool, "net", 2, side=13)
    height = x[:, 1].reshape(13, 13)
    np.testing.assert_allclose(height, height[::-1], atol=1e-9)
    np.testing.assert_allclose(height, height.T, atol=1e-9)
    fallen = start - sim.energy().potential["gravity"]
    assert abs(energy(sim) - start) < 0.02 * max(fallen, 1)
    assert strain(sim).max() < 0.25


@pytest.mark.thorough
def test_warps_cloth_hangs_from_two_corners(pool):
    sim, x, start = after(pool, "warp", 8, side=12)
    assert x[:, 1].max() == 0.0 and (x[1:11, 1] < 0).all()
    assert -1.3 * np.hypot(1.1, 1.1) < x[:, 1].min() < -0.7
    assert strain(sim).min() > -0.2 and strain(sim).max() < 0.25
    assert energy(sim) < start and sim.energy().kinetic < 3


@pytest.mark.thorough
def test_the_flag_flies_downwind(pool):
    sim, x, _ = after(pool, "flag", 4, columns=13)
    edge = x.reshape(9, 13, 3)[:, -1]
    assert edge[:, 0].mean() > 0.3 + 0.5 * 1.8
    assert x[:, 1].max() < 2.8 and x[:, 1].min() > 0.3
    assert strain(sim).max() < 0.15
    # Without wind it hangs beside its pole.
    calm, x, _ = after(pool, "flag", 4, columns=13, wind=0.0)
    assert x.reshape(9, 13, 3)[:, -1, 0].mean() < 0.3 + 0.35 * 1.8


@pytest.mark.thorough
def test_the_curtain_hangs_in_a_breeze_and_tears_in_a_storm(pool):
    calm, x, _ = after(pool, "curtain", 3, columns=25, wind=1.0)
    assert calm.springs_alive().all() and x[:, 1].max() < 2.4 + 1e-9 and x[:, 1].min() > 0.1
    assert strain(calm).max() < 0.2
    storm, _, _ = after(pool, "curtain", 4, columns=25)
    torn = 1 - storm.springs_alive().mean()
    assert 0 < torn < 0.3
    assert storm.triangles_alive().mean() > 0.6


@pytest.mark.thorough
def test_the_drape_lies_on_the_sphere_and_the_floor(pool):
    sim, x, start = after(pool, "drape", 4, side=17)
    away = np.linalg.norm(x - [1.0, 0.3, 0.0], axis=1)
    assert away.min() >= 0.3 and (away < 0.32).sum() >= 5  # it rests on the sphere's top
    assert x[:, 1].min() >= 0.0 and (x[:, 1] < 0.02).sum() >= 4
    assert np.hypot(x[:, 0] - 1, x[:, 2]).max() < 0.8 * np.sqrt(2)
    assert energy(sim) < start and sim.energy().kinetic < 0.02 * start
    assert strain(sim).max() < 0.3


@pytest.mark.thorough
def test_the_trampoline_holds_the_light_spheres_and_the_heavy_one_tears_it(pool):
    sim, x, start = after(pool, "trampoline", 6, side=21)
    *light, heavy = x[-3:]
    assert heavy[1] == pytest.approx(trampoline.RADIUS, abs=1e-3)  # on the floor
    off = np.abs(np.array(light)[:, [0, 2]] - [2.5, 0.0]).max(axis=1)
    assert (off < trampoline.WIDTH / 2).all()
    assert all(0.8 < sphere[1] - trampoline.RADIUS < trampoline.HEIGHT for sphere in light)
    broken = ~sim.springs_alive()
    assert 4 <= broken.sum() < 0.05 * len(broken)
    ends = sim.scene.springs.between[broken].ravel()  # all of them where the heavy one came down
    assert np.linalg.norm((sim.scene.particles.position[ends] - heavy)[:, [0, 2]], axis=1).max() < 1
    assert energy(sim) < start and sim.energy().kinetic < 0.01 * start


@pytest.mark.thorough
def test_the_stack_lies_in_order(pool):
    sim, x, start = after(pool, "stack", 3, side=9)
    sheets = x.reshape(5, 81, 3)
    assert x[:, 1].min() >= 0.0
    middle = sheets[:, 40, 1]
    apart = sim.scene.spheres.radius[0] * 2
    assert (np.diff(middle) > 0.6 * apart).all()  # each middle above the one below
    assert (np.diff(middle) < apart).all() and middle[0] < 0.01  # and on it
    assert np.hypot(x[:, 0] - 0.5, x[:, 2]).max() < 0.5
    assert strain(sim).max() < 0.3
    assert energy(sim) < start and sim.energy().kinetic < 0.02 * start


@pytest.mark.thorough
def test_the_twisted_strip_keeps_its_turns(pool):
    sim, x, _ = after(pool, "twist", 9, columns=41)
    rows = x.reshape(-1, 41, 3)
    assert turns(rows[0], rows[-1]) == pytest.approx(4.0, abs=0.05)
    apart = np.linalg.norm(rows[:, -1] - rows[:, 0], axis=1)
    np.testing.assert_allclose(apart, 0.9 * twist.LENGTH, rtol=1e-9)
    # Without a coil its edges would be helices; where coils are few, its corners are as long.
    helix = np.hypot(0.9 * twist.LENGTH, np.pi * 4 * twist.WIDTH) / twist.LENGTH - 1
    stretched = strain(sim)
    assert stretched.max() < 1.1 * helix and np.quantile(stretched, 0.99) < 0.6 * helix
    thick = np.linalg.norm(rows[:, 20] - rows[:, 20].mean(axis=0), axis=1).max()
    assert thick < twist.WIDTH / 2 + 0.02
    assert sim.energy().kinetic < 1e-3


@pytest.mark.thorough
def test_the_plates_stay_on_the_table(pool):
    sim, x, _ = after(pool, "pull", 2)  # a coarser cloth drags them along
    first, free = sim.scene.particles.position, sim.scene.particles.radius > pull.THICKNESS
    balls, began = x[free], first[free]
    assert (np.linalg.norm((balls - began)[:, [0, 2]], axis=1) < 0.3).all()
    assert balls[:, 0].max() < pull.TABLE[1]
    low = balls[:, 1] - sim.scene.particles.radius[free] - pull.TOP
    assert (low > -1e-6).all() and np.median(low) < 0.01
    assert x[~free, 0].min() > pull.TABLE[1] - 0.05  # the cloth is off the table
    assert strain(sim).max() < 0.3


@pytest.mark.thorough
def test_the_shirt_hangs_and_its_front_stays_before_its_back(pool):
    sim, x, start = after(pool, "shirt", 2)
    first = sim.scene.particles.position
    assert strain(sim).max() < 0.3 and energy(sim) < start
    assert x[:, 1].max() < first[:, 1].max() + 1e-3  # nothing is above its collar
    assert first[:, 1].min() - 0.1 < x[:, 1].min() < first[:, 1].min() + 0.1
    assert not len(intersecting_pairs(x, sim.scene.triangles))


def sheet(*middle):
    """A level sheet of 1 by 1 without a floor, held along one side."""
    a = np.linspace(-0.5, 0.5, 6)
    x = np.stack(np.meshgrid(a, [0.0], a, indexing="ij"), -1).reshape(-1, 3) + middle
    world = World((10.0, 10.0, 10.0), gravity=(0.0, -9.81, 0.0), up="y")
    return Scene("sheet", world, Particles.build(x, fixed=x[:, 0] == x[:, 0].min(), radius=0.01))


def sees(camera, points):
    """Which of the points (n, 3) are inside its picture."""
    pixels, _, depths = camera.project(points)
    return (depths > 0) & (pixels > 0).all(axis=1) & (pixels < 2 * camera.middle).all(axis=1)


def test_a_camera_sees_where_a_held_sheet_comes_to_hang():
    scene = sheet(0.0, 5.0, 0.0)
    camera, particles = camera_of(scene), scene.particles
    assert sees(camera, particles.position).all()
    assert sees(camera, particles.position[particles.fixed] - [0.0, 1.0, 0.0]).all()


def test_a_camera_sees_the_origin_where_it_is_near_and_only_there():
    """What is far from it is seen as large as anywhere else."""
    near, far, farther = (camera_of(sheet(x, 0.0, 0.0)) for x in (0.9, 8.0, 20.0))
    origin = np.zeros((1, 3))
    assert sees(near, origin).all() and not sees(far, origin).any()
    assert far.distance < 1.5 * farther.distance
