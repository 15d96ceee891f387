"""What lies on sharp obstacles comes to rest, stands still to the bit, and goes on when stirred."""

import numpy as np
import pytest
from cloths import loose_sheet

from taichi_cloth import runtime
from taichi_cloth.errors import InputError
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.scene.scenefile import parse
from taichi_cloth.simulation.simulation import Simulation

BOX = {"centre": [4.95, 0.9, 0.0], "half": [0.15, 0.05, 0.12], "friction": 0.5}
HOW = {"topology": "graph", "execution": "serial", "substeps": 8}
MOST = 260  # frames after which the sheet is at rest; 197 were seen


def sheet(**world):
    """A small sheet that falls onto a corner of a box."""
    world = {"ground": 0.0, "mouse": "blow"} | world
    return loose_sheet(Obstacle.build("box", **BOX), viscous=1e-2, **world)


def brought_to_rest(sim):
    """Advance until all is at rest; how many frames that took."""
    for frame in range(MOST):
        sim.advance()
        if sim.at_rest():
            return frame + 1
    raise AssertionError(f"it is not at rest after {MOST} frames")


@pytest.fixture(scope="module")
def resting(device):
    """A simulation of the sheet, the frames that it took to come to rest, and a checkpoint."""
    sim = Simulation(sheet(), **HOW)
    frames = brought_to_rest(sim)
    return sim, frames, sim.checkpoint()


@pytest.mark.usefixtures("device")
def test_what_is_at_rest_stands_still_to_the_bit_and_moves_without():
    sim, restless = Simulation(sheet(), **HOW), Simulation(sheet(rest=False), **HOW)
    frames = brought_to_rest(sim)
    restless.advance(frames - 1)
    before = restless.positions()
    sim.advance(1)
    x = sim.positions()
    assert np.abs(x - before).max() < 1e-3  # the way that a rest allows is 0.5 mm
    sim.advance(60)
    restless.advance(60)
    np.testing.assert_array_equal(sim.positions(), x)
    assert sim.at_rest() and not sim.velocities().any()
    assert not restless.at_rest() and (restless.positions() != before).any()


def blown(sim):
    sim.blow_ray([5.2, 1.0, 5.0], [0.0, 0.0, -1.0], [0.02, 0.0, 0.0])


STIRS = {
    "a velocity": lambda sim: sim.set(velocities=sim.velocities() + [0.0, 0.1, 0.0]),
    "a place": lambda sim: sim.set(positions=sim.positions() + [0.0, 0.01, 0.0]),
    "gravity": lambda sim: sim.set(gravity=[0.5, -9.81, 0.0]),
    "friction": lambda sim: sim.set(friction=0.2),
    "a cut": lambda sim: sim.cut(np.arange(40)),
    "a blow": blown,
}


@pytest.mark.parametrize("stir", STIRS)
def test_what_stirs_it_ends_a_rest(resting, stir):
    sim, _, at_rest = resting
    sim.restore(at_rest)
    x = sim.positions()
    STIRS[stir](sim)
    sim.advance(2)
    assert not sim.at_rest() and np.abs(sim.positions() - x).max() > 1e-6


@pytest.mark.parametrize("before", [0, 3, 40])
def test_what_goes_on_from_a_checkpoint_rests_as_if_it_had_gone_on(resting, before):
    sim, frames, at_rest = resting
    sim.reset()
    sim.advance(frames - before)
    other = Simulation(sheet(), **HOW)
    other.restore(sim.checkpoint())
    other.advance(before)
    assert other.at_rest()
    other.advance(5)
    sim.restore(at_rest)
    np.testing.assert_array_equal(other.positions(), sim.positions())


@pytest.mark.thorough
@pytest.mark.usefixtures("device", "few_lanes")
@pytest.mark.parametrize("way", ["graph parallel", "lanes serial"])
def test_rest_has_the_same_bits_in_all_ways_to_run(resting, way):
    topology, execution = way.split()
    sim = Simulation(sheet(), **(HOW | {"topology": topology, "execution": execution}))
    assert brought_to_rest(sim) == resting[1]
    resting[0].restore(resting[2])
    np.testing.assert_array_equal(sim.positions(), resting[0].positions())


def test_rest_is_a_word_of_the_file():
    text = "[world]\nsize = [1, 1]\nrest = {}\n[[particles]]\nposition = [0.5, 0.5]\n"
    assert parse(text.format("true"), "here").world.rest
    assert not parse(text.format("false"), "here").world.rest
    with pytest.raises(InputError, match="rest"):
        parse(text.format("0"), "here")


CORNER = """
[world]
size = [20.0, 20.0, 20.0]
up = "y"
gravity = [0.0, -9.81, 0.0]
dt = 0.0166667
ground = 0.0
friction = 0.4
[particle]
radius = 0.005
restitution = 0.0
viscous = 0.000453515
[[cloths]]
origin = [9.7, 1.1, -0.5]
columns = 21
rows = 21
spacing = 0.05
across = [1.0, 0.0, 0.0]
down = [0.0, 0.0, 1.0]
links = ["structural", "shear"]
density = 0.2
stretch = 80.0
shear = 10.0
damping_time = 4e-4
bending = 2e-5
thickness = 0.01
[[obstacles]]
shape = "box"
centre = [10.0, 0.7, 0.0]
half = [0.4, 0.3, 0.4]
friction = 0.5
turn = {turn}
"""
PLACED = {"along": [0.0, 0.0, 0.0], "tilted": [8.0, 20.0, 5.0]}


def ways_of_the_last_seconds(precision, turn, method, substeps):
    """The most that a sheet over a corner moves in the last 5 of 20 s. For its own process."""
    runtime.start("cpu", precision, threads=1)
    sim = Simulation(parse(CORNER.format(turn=turn), "corner"), method=method, substeps=substeps)
    sim.advance(15 * 60)
    x, most = sim.positions().astype(float), 0.0
    for _ in range(5 * 60):
        sim.advance()
        most = max(most, float(np.abs(sim.positions() - x).max()))
    return most


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("precision", "placed", "method", "substeps"),
    [
        ("f32", "along", "symplectic_euler", 16),
        ("f32", "tilted", "implicit_euler", 4),
    ],
)
def test_a_sheet_over_a_corner_comes_to_rest_within_15_s(cli, precision, placed, method, substeps):
    """It ticked by 0.8 mm once a second."""
    given = {"turn": PLACED[placed], "method": method, "substeps": substeps}
    most = cli.call("test_rest:ways_of_the_last_seconds", precision=precision, **given)
    assert most <= 1e-5
