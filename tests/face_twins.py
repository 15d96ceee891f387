"""Runs whose faces are looked at where they may have met something, and twins that look at all."""

import hashlib
from contextlib import contextmanager

import inside
import numpy as np
from cloths import ROD, loose_sheet

from taichi_cloth import runtime
from taichi_cloth.kernels import face_clearance
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import (
    Particles,
    Scene,
    Springs,
    World,
)
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.simulation.simulation import Simulation

BOX = {"centre": [5.0, 0.9, 0.0], "half": [0.05] * 3, "turn": [45.0, 0.0, 35.26], "friction": 0.6}
PLATE = {"centre": [4.916, 0.75, 0.041], "half": [0.01, 0.16, 0.002]}
TETRAHEDRON = {
    "vertices": [[0.0, 0.1, 0.0], [0.1, -0.05, 0.0], [-0.05, -0.05, 0.08], [-0.05, -0.05, -0.08]],
    "faces": [[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]],
    "centre": [5.0, 0.85, 0.0],
    "cell": 0.02,
}


def rope():
    """A rope in a plane that falls onto a disc smaller than its links."""
    x = np.column_stack([np.linspace(4.55, 5.55, 11), np.full(11, 1.0)])
    ties = Springs.build([[k, k + 1] for k in range(10)], x, stiffness=50.0, damping=0.05)
    world = World(size=(10.0, 10.0), gravity=(0.0, -9.81), dt=0.01, up="y")
    disc = Obstacle.build("sphere", centre=[5.0, 0.9], radius=0.02, friction=0.3)
    return Scene(
        "rope", world, Particles.build(x, mass=0.01, radius=0.005), ties, obstacles=(disc,)
    )


SCENES = {  # (scene, frames, steps a frame)
    "flag in a storm": lambda: (build("flag", columns=13, wind=30.0), 60, 40),
    "curtain that tears": lambda: (build("curtain", columns=17, strength=40.0), 60, 40),
    "rod": lambda: (loose_sheet(Obstacle.build("capsule", **ROD)), 40, 8),
    "rod, fast": lambda: (loose_sheet(Obstacle.build("capsule", **ROD), speed=20.0), 20, 8),
    "rod that tears": lambda: (
        loose_sheet(Obstacle.build("capsule", **ROD), speed=8.0, break_force=1.0),
        30,
        8,
    ),
    "corner": lambda: (loose_sheet(Obstacle.build("box", **BOX)), 40, 8),
    "plate, fast": lambda: (loose_sheet(Obstacle.build("box", **PLATE), speed=12.0), 6, 7),
    "mesh": lambda: (loose_sheet(Obstacle.build("mesh", **TETRAHEDRON)), 40, 8),
    "rod and a ball that moves": lambda: (
        loose_sheet(
            Obstacle.build("capsule", **ROD),
            Obstacle.build("sphere", centre=[5.1, 0.8, 0.1], radius=0.02, velocity=[0, 2.0, 0]),
        ),
        30,
        8,
    ),
    "rope": lambda: (rope(), 80, 4),
}


@contextmanager
def all_looked_at():
    """Simulations that are made meanwhile look at all faces in every search."""
    kept = face_clearance.kept
    face_clearance.kept = lambda spec: False
    try:
        yield
    finally:
        face_clearance.kept = kept


def ends_of(name, **how):
    """What a scene comes to: a digest of all its frames and of how many of its steps ended with
    faces in obstacles, and the most faces that were left out at the end of a frame.
    """
    scene, frames, substeps = SCENES[name]()
    how = {"topology": "graph", "execution": "serial"} | how
    sim = Simulation(scene, substeps=substeps, **how)
    digest, most = hashlib.sha256(), 0
    for _ in range(frames):
        sim.advance()
        digest.update(sim.positions().tobytes() + sim.velocities().tobytes())
        most = max(most, left_out(sim))
    digest.update(str(sim.unsettled_faces()).encode())
    return digest.hexdigest(), most


def left_out(sim):
    """How many faces have a clearance, where these are kept."""
    state = inside.state_of(sim)
    noted = state.face_seen.to_numpy().any()
    return int((state.face_clear.to_numpy() > 0.0).sum()) if noted else 0


def twins_in(precision, names):
    """`ends_of` scenes in a precision, and of their twins. For a process of its own."""
    runtime.start("cpu", precision, threads=2)
    with runtime.compiled_soon():
        found = [ends_of(name) for name in names]
        with all_looked_at():
            return [found, [ends_of(name) for name in names]]
