"""A scene on a GPU, and the same on a CPU that is run as one."""

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
