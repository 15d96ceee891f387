"""The built-in scenes in space end inside physical bounds (CPU, f64, coarse)."""

import numpy as np
import pytest

from taichi_cloth.scene import library


def strain(sim):
    """How much longer than at rest each spring is that holds, as a part of that."""
    springs, x = sim.scene.springs, sim.positions()
    a, b = springs.between[sim.springs_alive()].T
    rest = springs.rest_length[sim.springs_alive()]
    return np.linalg.norm(x[a] - x[b], axis=1) / rest - 1


def energy(sim):
    now = sim.energy()
    return now.kinetic + sum(now.potential.values())


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
    fixed = scene.particles.fixed
    assert (x[fixed] == scene.particles.position[fixed]).all()
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
