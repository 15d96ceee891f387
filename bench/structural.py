"""A structural cloth of 1024 x 1024 against C++ compiled here, beside the memory's speed.

C++ is compiled here and now. Its state is the same, in f32; it has no watchdog. `csr` goes over
the particles and, for each, over compressed rows; `grid` knows that the cloth is a grid, keeps an
array for each number and a stiffness for each link, and is vectorised. The plain gather is the
same as `csr`, in Taichi: what one writes first.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from typing import Any

import numpy as np

from bench import ours
from bench.cloths import (
    STRUCTURAL_FRAME,
    STRUCTURAL_SCENE,
    STRUCTURAL_SUBSTEPS,
    structural,
)
from bench.compiled import Compiled, compiled, enter_compiled
from bench.contest import Bench, Contestant, compare, separation
from bench.report import Measurement
from taichi_cloth.simulation.storage import adjacency

PART = "structural"
MARGIN = 16  # numbers before and after an array, so that a neighbour beyond it can be read
FRAMES = 12  # of 16 steps, in a round: fewer are over before idle cores are awake


def measure(bench: Bench) -> Iterator[Measurement]:
    """Time all contestants on one cloth, then the triad."""
    side = 256 if bench.quick else 1024
    size, scene = f"{side} x {side}", (STRUCTURAL_SCENE, {"columns": side, "rows": side})
    shared: dict[str, Any] = {"size": size, "particles": side * side, "units": FRAMES}
    reference = ours.reference(bench, PART, scene, side * side, frames=[FRAMES], **STRUCTURAL_FRAME)
    entered = {
        (layout, precision): ours.enter(
            bench,
            PART,
            f"ours, {layout}",
            scene,
            precision=precision,
            topology=layout,
            execution="parallel",
            **STRUCTURAL_FRAME,
            **shared,
        )
        for precision in ("f32", "f64")
        for layout in ours.TOPOLOGIES
    }
    gather = bench.enter(
        PART,
        "plain gather in Taichi (yardstick)",
        "bench.contestants:PlainGather",
        {"side": side, "threads": bench.threads},
        library="gather",
        precision="f32",
        threads=bench.threads,
        steps=STRUCTURAL_SUBSTEPS,
        packages=("taichi",),
        **shared,
    )
    cpp = {
        kind: _enter(bench, f"C++, {kind}", kind, {"side": side}, **shared)
        for kind in ("csr", "grid")
    }
    racing = [*entered.values(), gather, *cpp.values()]
    finished = bench.race(PART, racing, marks=[FRAMES])
    against = f"{ours.AGAINST}, after {FRAMES * STRUCTURAL_SUBSTEPS} steps"
    yield from bench.rows(PART, finished, reference, against)

    lanes, graph = entered["lanes", "f32"], entered["graph", "f32"]
    for name, fast, slow, target in (
        ("ours, lanes, to C++ grid", lanes, cpp["grid"], ">= 0.75"),
        ("ours, lanes, to the plain gather", lanes, gather, ">= 4"),
        ("ours, graph, to C++ csr", graph, cpp["csr"], ">= 0.9"),
        ("ours, lanes, f64 to f32", entered["lanes", "f64"], lanes, ">= 0.45"),
    ):
        yield from compare(PART, size, name, fast, slow, target)
    for other in (entered["graph", "f64"], cpp["grid"], cpp["csr"], gather):
        yield from separation(PART, lanes, other, FRAMES, "px")
    yield from _triad(bench, side)


def _triad(bench: Bench, side: int) -> Iterator[Measurement]:
    """The speed of the machine's memory: arrays of the cloth's size, and larger than caches."""
    numbers = {"the cloth's size": side * side, "64 MiB": 2**24}
    contestants = [
        _enter(
            bench,
            f"STREAM triad, arrays of {words}",
            "stream",
            {"count": count},
            size=f"3 x {count}",
            particles=count,
            units=max(1, 2**26 // count),
            steps=1,
        )
        for words, count in numbers.items()
    ]
    finished = bench.race(PART, contestants)
    for row, contestant in zip(bench.rows(PART, finished, {}, ""), finished, strict=True):
        if row.seconds:
            row.rate, row.unit = 12e-9 * contestant.particles / row.seconds, "GB/s"
        yield row


def _enter(
    bench: Bench,
    name: str,
    kind: str,
    arguments: dict[str, Any],
    steps: int = STRUCTURAL_SUBSTEPS,
    **shared: Any,
) -> Contestant | None:
    made = f"{__name__}:Compiled{kind.capitalize()}"
    return enter_compiled(bench, name, made, arguments, part=PART, steps=steps, **shared)


# ------------------------------------------------------------------------------------------
# In the contestants' process


class CompiledCsr(Compiled):
    """Compressed rows; positions and velocities as arrays of (x, y)."""

    steps = STRUCTURAL_SUBSTEPS

    def __init__(self, folder: str, side: int, rows: int | None = None):
        self.advances = compiled(folder).csr_steps
        scene = structural(side, rows or side)
        p, s = scene.particles, scene.springs
        half = adjacency.half_springs(s.between, len(p))
        self.x, v = (np.ascontiguousarray(a, np.float32) for a in (p.position, p.velocity))
        k, rest = (a[half.spring].astype(np.float32) for a in (s.stiffness, s.rest_length))
        w = np.where(p.fixed, 0, 1 / p.mass).astype(np.float32)
        numbers = scene.world.dt, scene.world.gravity[1], float(p.viscous[0])
        self.arguments = (len(p), *numbers, half.row, half.far, k, rest, w, self.x, v)


class CompiledGrid(Compiled):
    """A regular grid; an array for each number."""

    steps = STRUCTURAL_SUBSTEPS

    def __init__(self, folder: str, side: int, rows: int | None = None):
        self.advances = compiled(folder).grid_steps
        scene = structural(side, rows or side)
        p, s = scene.particles, scene.springs
        a, b = s.between.T  # to the left neighbour b = a - 1, or the upper one
        k = np.zeros((2, len(p)))
        k[np.where(a - b == 1, 0, 1), b] = s.stiffness
        w = np.where(p.fixed, 0, 1 / p.mass)
        numbers = scene.world.dt, scene.world.gravity[1], float(p.viscous[0])
        arrays = [self._padded(c) for c in (*k, w, *p.position.T, *p.velocity.T)]
        self.x, self.y = arrays[3:5]
        shape = (side, len(p) // side)
        self.arguments: tuple[Any, ...] = (*shape, *numbers, float(s.rest_length[0]), *arrays)

    @staticmethod
    def _padded(values: np.ndarray) -> np.ndarray:
        return np.pad(values.astype(np.float32), MARGIN)[MARGIN:-MARGIN]

    def positions(self) -> np.ndarray:
        return np.stack([self.x, self.y], axis=1)


class CompiledStream:
    """Three arrays of `count` floats."""

    def __init__(self, folder: str, count: int):
        self.triad = compiled(folder).stream_triad
        self.arrays = [np.full(count, value, np.float32) for value in (0, 1, 2)]

    def advance(self, units: int) -> None:
        count = ctypes.c_long(len(self.arrays[0]))
        pointers = (a.ctypes.data_as(ctypes.c_void_p) for a in self.arrays)
        self.triad(ctypes.c_long(units), count, ctypes.c_float(3.0), *pointers)
