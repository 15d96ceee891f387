"""Cloths with a thickness: no triangle meets another one, and contacts give no energy."""

from dataclasses import replace

import numpy as np
import pytest
from intersections import intersecting_pairs

from taichi_cloth.kernels import methods
from taichi_cloth.scene.cloth import grid, grid_triangles
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import Scene, World
from taichi_cloth.scene.obstacles import Obstacle

WIDTH = 1.0


def sheets(size, heights, *, thickness=0.01, seed=0, velocity=None, obstacles=(), **world):
    """Square sheets of 1 m above each other, jittered, each a little aside of the one below."""
    rng, spacing = np.random.default_rng(seed), WIDTH / (size - 1)
    material = Material(density=0.2, thickness=thickness, stretch=20, shear=4, damping_time=1e-3)
    parts = []
    for k, height in enumerate(heights):
        particles, springs = grid(
            (1.0 + 0.04 * k, height, -0.5 + 0.03 * k),
            size,
            size,
            spacing,
            links=("structural", "shear"),
            across=(1.0, 0.0, 0.0),
            down=(0.0, 0.0, 1.0),
            material=material,
        )
        x = particles.position + rng.uniform(-2e-3, 2e-3, particles.position.shape) * spacing
        parts.append((replace(particles, position=x), springs))
    particles, springs = parts[0]
    triangles = grid_triangles(size, size)
    for k, (more, tied) in enumerate(parts[1:], 1):
        tied = replace(tied, between=tied.between + k * size**2)
        particles, springs = particles.joined(more), springs.joined(tied)
        triangles = np.concatenate([triangles, grid_triangles(size, size, k * size**2)])
    if velocity is not None:
        particles = replace(particles, velocity=velocity(particles.position))
    world = {"gravity": (0.0, -9.81, 0.0), "ground": 0.0, "friction": 0.3} | world
    world = World(size=(3.0, 3.0, 3.0), up="y", dt=1 / 60, contact="resting", **world)
    return Scene("sheets", world, particles, springs, triangles=triangles, obstacles=obstacles)


def draped(size, **more):
    """A sheet above a sphere."""
    sphere = Obstacle.build("sphere", centre=[1.5, 0.4, 0.0], radius=0.2, friction=0.3)
    return sheets(size, [0.7], obstacles=(sphere,), **more)


def most_intersections(sim, frames, every=3):
    worst = 0
    for _ in range(0, frames, every):
        sim.advance(every)
        worst = max(worst, len(intersecting_pairs(sim.positions(), sim.scene.triangles)))
    return worst


WAYS = [
    ("symplectic_euler", "graph"),
    *(
        pytest.param(m, where, marks=pytest.mark.thorough)
        for m in methods.METHODS
        for where in ("graph", "lanes")
        if (m, where) != ("symplectic_euler", "graph")
    ),
]


@pytest.mark.parametrize(("method", "topology"), WAYS)
def test_sheets_that_fall_on_each_other_never_intersect(pool, method, topology):
    sim = pool(sheets(9, [0.1, 0.35]), method, substeps=8, topology=topology)
    assert most_intersections(sim, 60) == 0 and sim.unsettled() == 0
    assert np.abs(sim.positions()[:, 1]).min() < 0.01  # they lie on the ground
    if (method, topology) == WAYS[0]:
        sim = pool(sheets(9, [0.1, 0.35], thickness=0.0), method, substeps=8)
        assert most_intersections(sim, 60) > 0


def folding(x):
    """Both halves of a sheet thrown at each other: speeds up to 3 m/s."""
    v, away = np.zeros_like(x), x[:, 0] - x[:, 0].mean()
    v[:, 1], v[:, 0] = 6 * np.abs(away), -4 * away
    return v


def test_contacts_keep_momentum_and_give_no_energy(pool):
    """A sheet that folds onto itself without gravity."""
    scene = sheets(10, [1.5], gravity=(0.0, 0.0, 0.0), ground=None, friction=0.2, velocity=folding)
    sim = pool(scene, substeps=16)
    momentum, energy = sim.momentum(), sim.energy().total
    size = float(scene.particles.mass @ np.linalg.norm(scene.particles.velocity, axis=1))
    touched = 0
    for _ in range(40):
        before = sim.energy().total
        sim.advance()
        assert sim.energy().total < before + 1e-3 * energy
        np.testing.assert_allclose(sim.momentum(), momentum, rtol=0, atol=1e-12 * size)
        touched += before - sim.energy().total > 1e-2 * energy
        assert len(intersecting_pairs(sim.positions(), scene.triangles)) == 0
    assert touched > 2
