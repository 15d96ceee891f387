"""The two original programs are reproduced: same trajectories, same springs broken."""

import numpy as np
import pytest
from conftest import golden

from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import ParticleDefaults, Particles, Scene, World
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("device")


def cloth_at_rest():
    scene = build("cloth")
    return scene.with_world(mouse="none")


def box_scene():
    case = golden("box_bounce.json")
    world, rows = case["world"], case["particles"]
    return Scene(
        name="box_bounce",
        world=World(
            size=tuple(map(float, world["size"])),
            gravity=tuple(world["gravity"]),
            dt=world["dt"],
            walls=("left", "right", "top", "bottom", "front", "back"),
            collisions=True,
        ),
        particles=Particles.build(
            [p["pos"] for p in rows],
            [p["vel"] for p in rows],
            defaults=ParticleDefaults(mass=10.0, viscous=0.01, restitution=0.95),
            radius=[p["radius"] for p in rows],
            fixed=[p["fixed"] for p in rows],
        ),
    )


def test_cloth_at_rest(way):
    sim = Simulation(cloth_at_rest(), **way)
    for expected in golden("cloth_rest.npz")["position"]:
        sim.advance(10)
        np.testing.assert_allclose(sim.positions(), expected, rtol=0, atol=1e-9)


def test_cloth_blown_and_torn(way):
    """Pulling amplifies round-off 1e8 times here, so this holds only if the sums' order does."""
    sim = Simulation(build("cloth"), **way)
    expected = golden("cloth_blow.npz")
    pointer = None
    for event in golden("cloth_blow.jsonl"):
        before, pointer = pointer, np.array(event["pos"])
        sim.blow(pointer, pointer - before if before is not None else np.zeros(2))
        sim.advance()
        if sim.frame % 10 == 0:
            k = sim.frame // 10 - 1
            np.testing.assert_allclose(sim.positions(), expected["position"][k], atol=1e-6)
            assert sim.springs_alive().sum() == expected["springs_alive"][k]
    assert sim.frame == 600
    np.testing.assert_array_equal(sim.springs_alive(), expected["spring_alive_final"])


def test_box_of_bouncing_particles(execution):
    sim = Simulation(box_scene(), execution=execution)
    for expected in golden("box_bounce.npz")["position"][:20]:
        sim.advance(10)
        np.testing.assert_allclose(sim.positions(), expected, rtol=0, atol=1e-6)
