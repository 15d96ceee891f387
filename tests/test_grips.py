"""Fixed particles that go with an obstacle that moves, under every method, in every way to run."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from selection import mostly_thorough, thorough

from taichi_cloth.errors import InputError
from taichi_cloth.post_mortem.trace import traced
from taichi_cloth.scene import scenefile
from taichi_cloth.scene.checks import validate
from taichi_cloth.scene.cloth import grid, grid_triangles
from taichi_cloth.scene.model import Particles, Scene, World
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.scene.solids import solids
from taichi_cloth.simulation.checkpoint import Checkpoint
from taichi_cloth.simulation.past import Past
from taichi_cloth.simulation.simulation import Simulation

WAYS = ["graph serial", "graph parallel", "lanes serial"]
ALONG = np.array([0.3, -0.2, 0.1])
BAR = {"ends": [[0.9, 2.0, -0.5], [0.9, 2.0, 0.5]], "radius": 0.02, "grip": 0.1}


def pulled(**bar):
    """A cloth of 4 x 3 whose first column is held by a bar that moves; no gravity."""
    pinned = [(0, row) for row in range(3)]
    particles, springs = grid(
        (1.0, 2.0, -0.2),
        4,
        3,
        0.2,
        pinned=pinned,
        links=("structural", "shear"),
        across=(1.0, 0.0, 0.0),
        down=(0.0, 0.0, 1.0),
        stiffness=30.0,
        damping=0.1,
    )
    return Scene(
        "pulled",
        World(size=(4.0, 4.0, 4.0), up="y", gravity=(0.0, 0.0, 0.0), dt=0.01),
        replace(particles, mass=np.full(12, 0.05), radius=np.full(12, 0.01)),
        springs,
        triangles=grid_triangles(4, 3),
        obstacles=(Obstacle.build("capsule", **BAR, **bar),),
    )


@thorough
@pytest.mark.parametrize("method", ["symplectic_euler", "verlet", "xpbd", "vbd", "tr_bdf2"])
def test_a_cloth_that_goes_with_its_bar_is_at_rest_for_it(pool, method):
    scene = pulled(velocity=ALONG)
    moving = np.tile(ALONG, (12, 1))
    scene = replace(scene, particles=replace(scene.particles, velocity=moving))
    sim = pool(scene, method, substeps=2)
    sim.advance(30)
    start = scene.particles.position
    np.testing.assert_allclose(sim.positions(), start + 0.3 * ALONG, atol=1e-11)
    np.testing.assert_allclose(sim.velocities(), moving, atol=1e-10)


@pytest.mark.parametrize("way", mostly_thorough(WAYS, default=["graph serial"]))
def test_what_is_held_turns_with_its_obstacle_for_a_span_of_time(pool, way):
    topology, execution = way.split()
    spans = {"starts": 0.103, "stops": 0.251}
    scene = pulled(velocity=ALONG, spin=[0, 90, 200], **spans)
    sim, (solid,) = (
        pool(scene, "symplectic_euler", topology=topology, execution=execution, substeps=2),
        solids(scene),
    )
    centre, turn = solid.pose(0.0)
    first = scene.particles.position[scene.particles.fixed]
    for _ in range(3):
        sim.advance(10)
        now, turned = solid.pose(sim.time)
        expected = now + (first - centre) @ turn @ turned.T
        np.testing.assert_allclose(sim.positions()[scene.particles.fixed], expected, atol=1e-12)
    assert np.abs(expected - first).max() > 0.05
    assert not sim.velocities()[scene.particles.fixed].any()  # it has stopped
    # A run that is taken up from the middle has the same bits as one that goes on.
    sim.reset()
    sim.advance(15)
    sim.set(viscous=0.0)
    sim.advance(15)
    again = sim.positions()
    sim.reset()
    sim.advance(30)
    np.testing.assert_array_equal(sim.positions(), again)


def test_what_is_fixed_or_put_in_a_run_goes_with_what_it_is_at_by_then(pool, tmp_path):
    """Not with what it began at, from where that began."""
    scene = pulled(velocity=[1.0, 0.0, 0.0])
    pins, way = scene.particles.fixed, np.array([0.1, 0.0, 0.0])
    how = {"topology": "graph", "execution": "serial", "substeps": 2}
    sim = pool(scene, "symplectic_euler", **how)
    sim.advance(50)
    sim.unpin([0])
    sim.set(velocities=[1.0, 0.0, 0.5], particles=[0])
    sim.advance(5)
    put = sim.positions()[pins]
    sim.pin([0])
    kept = sim.checkpoint()
    kept.save(tmp_path / "pinned.npz")
    sim.advance(10)
    after = sim.positions()
    assert np.linalg.norm(put[0] - scene.particles.position[0] - [0.55, 0.0, 0.0]) > 0.01
    np.testing.assert_allclose(after[pins], put + way, atol=1e-12)
    sim.set(stiffness=31.0)
    for back in (kept, Checkpoint.load(tmp_path / "pinned.npz")):
        sim.restore(back)
        sim.advance(10)
        np.testing.assert_array_equal(sim.positions(), after)
    # Out of its grip, they stay where they are put; then one is put into it.
    put = sim.positions() + [0.0, 0.5, 0.0]
    sim.set(positions=put)
    sim.advance(10)
    np.testing.assert_array_equal(sim.positions()[pins], put[pins])
    there = np.array([0.9 + sim.time, 2.05, 0.3])
    sim.set(positions=there, particles=[4])
    sim.remove([1])
    sim.advance(10)
    np.testing.assert_allclose(sim.positions()[3], there + way, atol=1e-12)
    np.testing.assert_array_equal(sim.positions()[[0, 7]], put[[0, 8]])
    # So it is asked of what comes: where the bar began none holds it, and where it is it does.
    for place, by in ((BAR["ends"][0], -1), (BAR["ends"][0] + sim.time * 10.0 * way, 0)):
        new = Particles.build([place], fixed=True)
        grown = sim.storage.judged(sim.storage.snapshot().with_particle(new, None), sim.time)
        assert grown.grips.by.tolist() == [-1, -1, -1, 0, -1, -1, -1, -1, -1, -1, -1, by]


def met(sim):
    """Which obstacle meets or carries a particle in the next frame, as if that had failed."""
    sim.past = Past()
    sim.past.failure = SimpleNamespace(frame=sim.frame + 1)
    found, sim.past = traced(sim, 5.0).met, None
    return found


def test_a_trace_names_who_is_carried_by_now_and_an_empty_scene_takes_who_comes(device):
    """It named one that began in a grip, by a number of then; the spawn was an IndexError."""
    scene = pulled(velocity=[1.0, 0.0, 0.0])
    sim = Simulation(scene, substeps=2, topology="graph", execution="serial")
    sim.advance(2)
    assert met(sim) == ("obstacle 0", 0, 1.0)
    sim.remove([0, 1, 2])
    assert met(sim) == ("obstacle 0", 1, 1.0) and sim.fixed()[1]
    sim.set(positions=sim.positions() + [0.0, 0.5, 0.0])
    assert met(sim) == ("", -1, 0.0)
    sim.remove(np.ones(9, bool))
    there = np.array([0.9 + sim.time, 2.05, 0.3])
    sim.spawn(there, fixed=True)
    sim.advance(10)
    np.testing.assert_allclose(sim.positions(), [there + [0.1, 0.0, 0.0]], atol=1e-12)


def test_grips_are_read_written_and_refused():
    scene = pulled(velocity=ALONG, starts=1.0, stops=2.0)
    again = scenefile.parse(scenefile.dump(scene))
    assert again.obstacles == scene.obstacles and again.features().held
    assert "moving pins" in scene.features().describe()
    still = pulled().features()
    assert not still.held and not still.moving
    for wrong, words in (
        ({"stops": 0.5, "starts": 1.0}, "stops must not be before starts"),
        ({"starts": -1.0}, "starts must be at least 0"),
    ):
        with pytest.raises(InputError, match=words):
            validate(pulled(velocity=ALONG, **wrong))
