"""Surfaces: triangles torn with their springs, their normals, a material in any resolution."""

import numpy as np

from taichi_cloth.kernels.state import GONE
from taichi_cloth.scene import scenefile
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
