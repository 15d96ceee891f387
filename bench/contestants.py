"""Contestants on Taichi, in their processes: ours, and kernels of the benchmark's own."""

import functools
import importlib
from typing import Any

import numpy as np
import taichi as ti

from bench.cloths import STRUCTURAL_SUBSTEPS, SceneCall, structural
from taichi_cloth import runtime
from taichi_cloth.kernels.collision_grid import sort_into_cells
from taichi_cloth.kernels.contact import compute_pair_bounces
from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation.launch import kernels_of
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.storage import adjacency


@functools.cache
def started(arch: str, precision: str, threads: int | None) -> runtime.Device:
    """Start Taichi once in a process."""
    return runtime.start(arch, precision, threads)


def scene_of(words: str, arguments: dict[str, Any]) -> Scene:
    """The scene that the function "module:name" makes of its arguments."""
    module, _, name = words.partition(":")
    scene: Scene = getattr(importlib.import_module(module), name)(**arguments)
    return scene


class Ours:
    """A unit of work is a frame.

    scene: "module:function" and its arguments. batch: frames in one call, None for all of a
    round's. after: frames before the first round. The other arguments are `Simulation`'s and
    `runtime.start`'s.
    """

    def __init__(
        self,
        scene: SceneCall,
        precision: str,
        threads: int | None = None,
        arch: str = "cpu",
        batch: int | None = None,
        after: int = 0,
        **settings: Any,
    ):
        device = started(arch, precision, threads)
        self.sim = Simulation(scene_of(*scene), **settings)
        self.sim.advance(after)
        self.batch = batch
        serial = self.sim.execution == "serial"
        self.about = {
            "threads": 1 if serial else device.threads,
            "execution": self.sim.execution,
            "topology": self.sim.topology,
        }

    def advance(self, units: int) -> None:
        for done in range(0, units, self.batch or units):
            self.sim.advance(min(self.batch or units, units - done))
        ti.sync()

    def positions(self) -> np.ndarray:
        return self.sim.positions()


STRIDES = 16  # numbers that one thread of a copy moves at once
MOST_BLOCKS = 2**15  # that a copy is spread over: drivers limit how many there are


@ti.data_oriented
class PlainGather:
    """The structural cloth as one writes it first: compressed rows, an array of vectors.

    One particle at a time sums over its springs; a unit of work is 16 steps, f32.
    """

    def __init__(self, side: int, threads: int):
        started("cpu", "f32", threads)
        scene = structural(side, side)
        p, s = scene.particles, scene.springs
        half = adjacency.half_springs(s.between, len(p))
        self.dt, self.viscous = scene.world.dt, float(p.viscous[0])
        self.gravity = ti.Vector(list(scene.world.gravity))
        self.x, self.v = (ti.Vector.field(2, ti.f32, len(p)) for _ in range(2))
        self.w = ti.field(ti.f32, len(p))
        self.row, self.far = ti.field(ti.i32, len(p) + 1), ti.field(ti.i32, len(half.far))
        self.k, self.rest = (ti.field(ti.f32, len(half.far)) for _ in range(2))
        for field, values in (
            (self.x, p.position),
            (self.v, p.velocity),
            (self.w, np.where(p.fixed, 0, 1 / p.mass)),
            (self.k, s.stiffness[half.spring]),
            (self.rest, s.rest_length[half.spring]),
        ):
            field.from_numpy(values.astype(np.float32))
        self.row.from_numpy(half.row)
        self.far.from_numpy(half.far)
        self.about = {"execution": "parallel", "topology": "graph"}

    @ti.kernel
    def step(self):  # type: ignore[no-untyped-def]  # a kernel that returns nothing says nothing
        for i in self.x:
            x, v, w = self.x[i], self.v[i], self.w[i]
            f = -self.viscous * v
            for h in range(self.row[i], self.row[i + 1]):
                d = self.x[self.far[h]] - x
                length = d.norm()
                if length > 0.0:
                    f += self.k[h] * (length - self.rest[h]) * d / length
            if w > 0.0:
                self.v[i] = v + self.dt * (self.gravity + w * f)
        for i in self.x:
            self.x[i] += self.dt * self.v[i]

    def advance(self, units: int) -> None:
        for _ in range(units * STRUCTURAL_SUBSTEPS):
            self.step()
        ti.sync()

    def positions(self) -> np.ndarray:
        x: np.ndarray = self.x.to_numpy()
        return x


class Collisions(Ours):
    """Ours on all threads, of which also the search for collisions can be run alone."""

    def build(self, units: int) -> None:
        self._repeat(sort_into_cells, units)

    def build_and_query(self, units: int) -> None:
        self._repeat(compute_pair_bounces, units)

    def _repeat(self, part: Any, units: int) -> None:
        """Run a part of a step, a ti.func(spec, state, t), so many times in a launch."""
        spec, state = self.sim.storage.specialization, self.sim.storage.state
        kernels_of(state).frames(part, spec, state, state.lane_memory, 0, 1, units)
        ti.sync()


class Copy:
    """A copy of `count` floats (a multiple of STRIDES) on a backend: two numbers moved for each."""

    def __init__(self, arch: str, count: int):
        started(arch, "f32", None)
        self.a, self.b = ti.field(ti.f32, count), ti.field(ti.f32, count)

    def advance(self, units: int) -> None:
        for _ in range(units):
            copy(self.a, self.b)
        ti.sync()


@ti.kernel  # type: ignore[untyped-decorator]
def copy(a: ti.template(), b: ti.template()):  # type: ignore[no-untyped-def, valid-type]
    stride = ti.static(a.shape[0] // STRIDES)
    threads = ti.static(min(stride, MOST_BLOCKS * ti.cfg.default_gpu_block_dim))
    for i in range(threads):
        for turn in range(stride // threads):
            for k in ti.static(range(STRIDES)):
                at = i + turn * threads + k * stride
                b[at] = a[at]
