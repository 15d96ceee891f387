"""Faces that are not looked at would have met nothing: the bits are those of looking at all."""

import functools

import numpy as np
import pytest
from cloths import ROD, loose_sheet
from face_twins import SCENES, all_looked_at, ends_of, left_out
from selection import mostly_thorough

from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("device", "few_lanes")


@pytest.fixture(scope="module")
def ends():
    """`ends_of`, of each scene once."""
    return functools.cache(ends_of)


@pytest.mark.parametrize(
    "name", mostly_thorough(SCENES, default=["flag in a storm", "rod, fast", "rope"])
)
def test_bits_are_those_of_looking_at_all_faces(ends, name):
    found, without = ends(name)
    with all_looked_at():
        expected, none = ends_of(name)
    assert found == expected
    assert none == 0 and (without > 0) == ("moves" not in name)


@pytest.mark.thorough
@pytest.mark.parametrize("way", ["graph parallel", "lanes serial"])
def test_they_are_in_all_ways_to_run(ends, way):
    topology, execution = way.split()
    assert ends_of("rod", topology=topology, execution=execution)[0] == ends("rod")[0]


@pytest.mark.thorough
def test_they_are_in_compensated_precision(cli):
    names = ["flag in a storm", "rod, fast"]
    found, expected = cli.call("face_twins:twins_in", precision="compensated", names=names)
    for (bits, without), (twin, none) in zip(found, expected, strict=True):
        assert bits == twin and without > none == 0


def handled(sim):
    """A cloth over a rod, with all that changes a state from outside; its states on the way."""
    states = []

    def go(frames):
        for _ in range(frames):
            sim.advance()
            states.append((sim.positions(), sim.velocities()))

    go(6)
    falling = sim.checkpoint()
    go(8)
    lying = sim.checkpoint()
    sim.restore(falling)  # back above the rod, with the clearances of lying on it
    go(4)
    sim.restore(lying)
    go(2)
    sim.spawn([5.0, 1.1, 0.0], velocity=[0.0, -5.0, 0.0], tied_to=40)
    go(6)
    x = sim.positions()
    sim.set(positions=x + [0.0, 0.2, 0.0])
    go(4)
    sim.set(velocities=np.tile([0.0, -30.0, 0.0], (len(x), 1)))
    go(3)
    sim.remove([3])
    sim.cut(np.arange(5))
    sim.add_spring(10, 60)
    go(6)
    sim.reset()
    go(12)
    return np.array([np.concatenate(state).ravel()[:480] for state in states])


@pytest.mark.thorough
def test_what_changes_a_state_from_outside_leaves_no_clearance_behind():
    def scene():
        return loose_sheet(Obstacle.build("capsule", **ROD), mouse="blow")

    how = {"topology": "graph", "execution": "serial", "substeps": 8}
    sim = Simulation(scene(), **how)
    found = handled(sim)
    assert left_out(sim) > 0
    with all_looked_at():
        expected = handled(Simulation(scene(), **how))
    np.testing.assert_array_equal(found, expected)
