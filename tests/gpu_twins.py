"""A scene on a GPU, and the same on a CPU that is run as one."""

from dataclasses import replace

import numpy as np
import small

from taichi_cloth import runtime
from taichi_cloth.simulation.simulation import Simulation


def end_on(arch, name, method, frames):
    """`end` on a backend in f64. For a process of its own."""
    runtime.start(arch, "f64")
    return end(name, method, frames)


def end(name, method, frames):
    """Positions of a small scene after some frames, (n, dim) numbers."""
    way = {"topology": "graph", "execution": "parallel", "lanes": 1}
    sim = Simulation(small.build(name), method, dt="auto", **way)
    sim.advance(frames)
    return sim.positions().tolist()


def bare_normals_on(arch):
    """The largest normal of particles at no triangle, after forces were read. For its own process.

    Arrays as large as that of the normals are on the device before.
    """
    runtime.start(arch, "f32")
    scene = small.build("flag")
    sim = Simulation(replace(scene, triangles=scene.triangles[: len(scene.triangles) // 2]))
    bare = np.setdiff1d(np.arange(sim.particle_count), sim.scene.triangles)
    found = 0.0
    for _ in range(3):
        sim.advance()
        sim.velocities(), sim.positions()
        found = max(found, float(np.abs(sim.normals()[bare]).max()))
    return found
