"""Surfaces: triangles torn with their springs, their normals, a material in any resolution."""

from dataclasses import replace

import numpy as np
import pytest
from selection import mostly_thorough

from taichi_cloth.errors import InputError
from taichi_cloth.kernels.state import GONE
from taichi_cloth.scene import scenefile
from taichi_cloth.scene.cloth import grid, grid_triangles
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.triangles import areas, at_corners, corner_shares
from taichi_cloth.simulation.diagnostics import spring_forces
from taichi_cloth.simulation.simulation import Simulation

TORN = """
[world]
size = [20.0, 20.0, 20.0]
gravity = [0.0, 1.0, 0.0]
dt = 0.02
[particle]
mass = 0.1
[[cloths]]
origin = [2.0, 5.0, 0.0]
columns = 7
rows = 5
spacing = 1.0
links = ["structural", "shear"]
stiffness = 30.0
break_force = 0.7
down = [0.0, 0.3, 1.0]
pinned = [[0, 0], [6, 0]]
"""


def normals_of(x, triangles):
    """Unit normals by areas, (n, 3), in NumPy."""
    areas = np.cross(
        x[triangles[:, 1]] - x[triangles[:, 0]], x[triangles[:, 2]] - x[triangles[:, 0]]
    )
    total = np.zeros_like(x)
    for corner in triangles.T:
        np.add.at(total, corner, areas)
    length = np.linalg.norm(total, axis=1)
    return total / np.where(length > 0, length, 1.0)[:, None]


def sides_of(triangle):
    return {frozenset((triangle[k], triangle[(k + 1) % 3])) for k in range(3)}


@pytest.mark.parametrize("topology", mostly_thorough(["lanes", "graph"], default=["graph"]))
def test_triangles_are_torn_with_their_springs_and_normals_are_those_of_the_rest(topology, device):
    scene = scenefile.parse(TORN)
    sim = Simulation(scene, substeps=4, topology=topology, execution="serial", lanes=2)
    assert sim.topology == topology and not hasattr(sim.storage.state, "surface")
    torn = 0
    for _ in range(6):
        sim.advance(10)
        broken = {frozenset(pair) for pair in sim.springs()[~sim.springs_alive()].tolist()}
        whole = [not sides_of(t) & broken for t in scene.triangles.tolist()]
        np.testing.assert_array_equal(sim.triangles_alive(), whole)
        torn += sum(whole) < len(whole)
        gone = {
            frozenset(pair) for pair in sim.springs()[sim.storage.marks()[:, 0] == GONE].tolist()
        }
        acting = scene.triangles[[not sides_of(t) & gone for t in scene.triangles.tolist()]]
        expected = normals_of(sim.positions(), acting)
        np.testing.assert_allclose(sim.normals(), expected, rtol=0, atol=1e-14)
    assert 0 < torn < 6 and 0 < (~sim.springs_alive()).sum() < len(scene.springs) / 2
    left = sim.remove([8, 9])  # what is on the device follows
    mine = sim.triangles()[sim.triangles_alive()]
    assert len(left) == 33 and len(mine) < len(scene.triangles) - 8, "of two particles"
    np.testing.assert_allclose(sim.normals(), normals_of(sim.positions(), mine), rtol=0, atol=1e-14)


MATERIAL = Material(density=0.15, stretch=80.0, shear=20.0, damping_time=0.01, strength=40.0)


def strip(cells, material=MATERIAL, links=("structural", "shear")):
    """A strip 0.4 wide and 1 long, of `cells` and 2.5 times as many cells, hanging down in y."""
    size = cells + 1, 5 * cells // 2 + 1
    particles, springs = grid((0.0, 0.0, 0.0), *size, 0.4 / cells, links=links, material=material)
    return particles, springs, grid_triangles(*size)


def test_refining_a_grid_does_not_change_its_material():
    """A strip that is stretched evenly is in equilibrium and pulls with E times width and strain.

    So do its dashpots; it tears at the strength; its mass is that of its area, spread so that each
    row but the ends has the same.
    """
    y, g = MATERIAL.stretch, MATERIAL.shear
    modulus, strain = y * (y + 2 * g) / (y + g), 1e-6
    for cells in (2, 4, 8):
        particles, springs, triangles = strip(cells)
        x = particles.position
        assert particles.mass.sum() == pytest.approx(0.15 * 0.4, rel=1e-14)
        rows = particles.mass.reshape(-1, cells + 1).sum(axis=1)
        weights = np.ones(len(rows))
        weights[[0, -1]] = 0.5
        np.testing.assert_allclose(rows, weights * rows[1], rtol=1e-13)
        moved = strain * x * (-g / (y + g), 1.0, 0.0)
        still = np.zeros_like(x)
        end = x[:, 1] == x[:, 1].max()
        for force, of in (
            (spring_forces(x + moved, still, springs), strain),
            (spring_forces(x, moved / strain, springs), MATERIAL.damping_time),
        ):
            inside = ~end & (x[:, 1] > 0)
            assert np.abs(force[inside]).max() < 1e-4 * modulus * of * 0.4 / cells
            assert -force[end, 1].sum() == pytest.approx(modulus * 0.4 * of, rel=1e-4)
        along = np.abs(x[springs.between[:, 0]] - x[springs.between[:, 1]]).sum(axis=1)
        longest = springs.lengths_held()[1] / springs.rest_length - 1
        np.testing.assert_allclose(longest[along < 0.5 / cells], 0.5, rtol=1e-12)
    area = areas(x, triangles)[:, None]
    np.testing.assert_allclose(  # as masses are shared, so is what triangles give their corners
        at_corners(0.15 * area * corner_shares(x, triangles), triangles, len(x)), particles.mass
    )


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"stretch": None}, "shear needs stretch"),
        ({"shear": None}, "shear links need shear"),
        ({"density": 0.0}, "density must be positive"),
        ({"damping_time": -1.0}, "damping_time must not be negative"),
    ],
)
def test_a_material_that_makes_no_sense_is_refused(change, says):
    with pytest.raises(InputError, match=says):
        strip(2, replace(MATERIAL, **change))


def test_the_walls_of_a_world_whose_y_points_up(pool):
    """Bottom is at y = 0, front near to who looks; what falls rests there, by no special rule."""
    text = """
    [world]
    size = [4.0, 4.0, 4.0]
    up = "y"
    gravity = [0.0, -9.81, 0.0]
    dt = 0.01
    walls = ["bottom", "front"]
    contact = "original"
    [particle]
    radius = 0.1
    restitution = 0.0
    [[particles]]
    position = [2.0, 0.5, 1.0]
    velocity = [0.0, 0.0, 4.0]
    [[cloths]]
    origin = [0.0, 4.0, 0.0]
    columns = 2
    rows = 2
    spacing = 1.0
    """
    scene = scenefile.parse(text)
    assert scene.particles.position[-1].tolist() == [1.0, 3.0, 0.0]  # rows go down
    assert scenefile.parse(scenefile.dump(scene)).world == scene.world
    sim = pool(scene)
    sim.advance(200)
    x = sim.positions()[0]
    assert x[1] == pytest.approx(0.1, abs=1e-12) and 1.9 <= x[2] < 1.9 + 4 * 0.01
    with pytest.raises(InputError, match=r"line 4: \[world\]: up must be 'y'"):
        scenefile.parse(text.replace('"y"', '"z"'))
