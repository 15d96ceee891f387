"""The two original programs are reproduced: same trajectories, same springs broken."""

import numpy as np
import pytest
from goldens import golden
from selection import mostly_thorough

from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import ParticleDefaults, Particles, Scene, World
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("device")

WAYS = ["lanes serial", "lanes parallel", "graph serial", "graph parallel"]


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


@pytest.fixture(scope="module", params=WAYS)
def cloth(request, device):
    """A simulation of the cloth; of lanes 8, as users have them, and 2."""
    topology, execution = request.param.split()
    lanes = None if execution == "parallel" else 2
    return Simulation(build("cloth"), topology=topology, execution=execution, lanes=lanes)


def test_cloth_at_rest(cloth):
    sim = cloth
    sim.load_scene(cloth_at_rest())
    for expected in golden("cloth_rest.npz")["position"]:
        sim.advance(10)
        np.testing.assert_allclose(sim.positions(), expected, rtol=0, atol=1e-9)


def test_cloth_blown_and_torn(cloth):
    """Pulling amplifies round-off 1e8 times here, so this holds only if the sums' order does."""
    sim = cloth
    sim.load_scene(build("cloth"))
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


@pytest.mark.parametrize("execution", mostly_thorough(["serial", "parallel"], default=["serial"]))
def test_box_of_bouncing_particles(execution):
    sim = Simulation(box_scene(), execution=execution)
    for expected in golden("box_bounce.npz")["position"][:20]:
        sim.advance(10)
        np.testing.assert_allclose(sim.positions(), expected, rtol=0, atol=1e-6)
