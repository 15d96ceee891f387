"""The built-in scenes say what they are, and move as their closed forms say (CPU, f64)."""

import inspect

import numpy as np
import pytest

from taichi_cloth.errors import InputError
from taichi_cloth.scene import library


@pytest.mark.parametrize("name", library.names())
def test_every_scene_declares_itself_and_runs(name, pool):
    assert library.description(name).endswith(".")
    for parameter in library.parameters(name).values():
        assert parameter.help and parameter.check("it", parameter.default) == parameter.default
    assert library.build(name).name == name
    signature = inspect.signature(library.function(name))
    assert all(p.kind is p.KEYWORD_ONLY for p in signature.parameters.values())
    scene = library.build(name)
    x = frames(pool, scene, 3)
    assert (
        np.isfinite(x).all() and (x[:, scene.particles.fixed] == x[0, scene.particles.fixed]).all()
    )
    assert len(scene.particles) == 0 or (x[-1] != x[0]).any(), "nothing moves"


def frames(pool, scene, count, substeps=1):
    """Positions at the start and after each frame, (count + 1, n, dim)."""
    sim = pool(scene, substeps=substeps)
    positions = [sim.positions()]
    for _ in range(count):
        sim.advance()
        positions.append(sim.positions())
    return np.array(positions)


def test_the_oscillator_is_a_cosine(pool):
    x = frames(
        pool, library.build("oscillator", amplitude=40.0, stiffness=0.02, mass=2.0), 200, 200
    )
    t = np.arange(201)
    np.testing.assert_allclose(x[:, 1, 0], 250 + 40 * np.cos(0.1 * t), atol=0.05)
    assert (x[:, 1, 1] == 100).all() and (x[:, 0] == (100, 100)).all()


@pytest.mark.parametrize(("n", "mode"), [(1, 1), (7, 2), (16, 1), (16, 16)])
def test_the_chain_swings_in_its_normal_mode(pool, n, mode):
    scene = library.build("chain", particles=n, mode=mode)
    x = frames(pool, scene, 100, 200)
    omega = 2 * np.sqrt(0.1) * np.sin(np.pi * mode / (2 * (n + 1)))
    at_rest = 50 + 500 * np.arange(n + 2) / (n + 1)
    expected = at_rest + np.cos(omega * np.arange(101))[:, None] * (x[0, :, 0] - at_rest)
    # Symplectic Euler with step h is off by A w h / 2 (a shift of half a step in time).
    amplitude = np.abs(x[0, :, 0] - at_rest).max()
    np.testing.assert_allclose(x[:, :, 0], expected, atol=0.6 * amplitude * omega / 200)


@pytest.mark.parametrize("n", [20, 100])
def test_the_slinkys_bottom_waits_for_the_collapse(pool, n):
    scene = library.build("slinky", particles=n)
    y = frames(pool, scene, 3 * n)[:, :, 1]
    arrival = int(n * np.sqrt(1 / 0.25))  # frames: n sqrt(m/k)
    # The ripple ahead of the front spreads like its cube root: a few particles' worth.
    early = arrival - int(5 * n ** (1 / 3))
    assert np.abs(y[:early, -1] - y[0, -1]).max() < 0.01 * (y[0, 1] - y[0, 0])
    assert y[early, 0] - y[0, 0] > 100
    assert y[3 * n, -1] - y[0, -1] > 10
    assert (np.diff(y[:early], axis=1) > 0).all(), "no particle passes another"
    # The centre of mass falls freely all the time; symplectic Euler adds g t dt / 2.
    t, g = np.arange(3 * n + 1), scene.world.gravity[1]
    np.testing.assert_allclose(y.mean(axis=1) - y[0].mean(), g * t * (t + 1) / 2, atol=1e-8)


@pytest.mark.parametrize("name", ["box", "sandbox"])
@pytest.mark.parametrize("count", [1, 2, 25])
def test_scattered_particles_touch_neither_each_other_nor_walls(name, count):
    scene = library.build(name, particles=count, radius=20.0, seed=count)
    position, world = scene.particles.position, scene.world
    distance = np.linalg.norm(position[:, None] - position, axis=2) + 1e9 * np.eye(count)
    assert len(position) == count and distance.min() >= 2 * 20
    assert (position >= world.low + 20).all() and (position <= world.high - 20).all()


def test_the_cloth_takes_shear_and_bend_springs_and_dashpots(pool):
    plain = library.build("cloth").springs
    assert len(plain) == 356 and (plain.damping == 0).all() and (plain.rest_length == 25).all()
    fuller = library.build("cloth", shear=0.1, bend=0.05, damping=0.02)
    springs, (a, b) = fuller.springs, fuller.springs.between.T
    assert {k: int((springs.stiffness == k).sum()) for k in (0.5, 0.1, 0.05)} == {
        0.5: 356,
        0.1: 2 * 15 * 11,
        0.05: 14 * 12 + 16 * 10,
    }
    assert len(springs) == 1014 and (springs.damping == 0.02).all()
    apart = np.linalg.norm(fuller.particles.position[a] - fuller.particles.position[b], axis=1)
    np.testing.assert_allclose(springs.rest_length, apart, rtol=1e-12)
    one_kind = library.build("cloth", columns=3, rows=3, bend=0.05).springs
    assert set(one_kind.stiffness) == {0.5, 0.05} and len(one_kind) == 12 + 6
    # It hangs whole, and less than the plain one, which diagonals do not hold in shape.
    hung = {}
    for name, scene in (("plain", library.build("cloth")), ("fuller", fuller)):
        sim = pool(scene)
        sim.advance(300)
        assert sim.springs_alive().all()
        hung[name] = sim.positions()[:, 1].max()
    assert fuller.particles.position[:, 1].max() < hung["fuller"] < hung["plain"] - 10


@pytest.mark.parametrize("name", ["shear", "bend", "damping"])
def test_the_cloths_springs_are_checked(name):
    for wrong in (-0.1, float("inf"), "much"):
        with pytest.raises(InputError, match=name):
            library.build("cloth", **{name: wrong})
