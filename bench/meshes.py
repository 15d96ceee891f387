"""A mesh of 1e6 vertices, numbered at random, against C++ compiled here over compressed rows.

The C++ is what one writes by hand: f32, x, y, z side by side, a stiffness and a rest length for
each half-spring, no watchdog. It gets the vertices in three orders: as they come, which is what a
file of a mesh may be; in that of the sheet's rows; and in ours (`adjacency.banded_order`), whose
speed is what ours is compared to.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from bench import ours
from bench.cloths import SHEET_STEP, STRUCTURAL_SUBSTEPS, sheet
from bench.compiled import Compiled, compiled, enter_compiled
from bench.contest import Bench, compare, separation
from bench.report import Measurement
from taichi_cloth.simulation.storage import adjacency

PART = "meshes"
SCENE = "bench.cloths:sheet"
FRAMES = 4  # of 16 steps, in a round
ORDERS = {"shuffled": "as it comes", "rows": "row by row", "banded": "in our order"}


def measure(bench: Bench) -> Iterator[Measurement]:
    """Time all contestants on one mesh."""
    side = 250 if bench.quick else 1000
    size = f"{side * side} vertices"
    shared: dict[str, Any] = {"size": size, "particles": side * side, "units": FRAMES}
    graph = ours.enter(
        bench,
        PART,
        "ours, graph",
        (SCENE, {"side": side}),
        precision="f32",
        topology="graph",
        execution="parallel",
        dt=STRUCTURAL_SUBSTEPS * SHEET_STEP / side,
        substeps=STRUCTURAL_SUBSTEPS,
        **shared,
    )
    cpp = {
        order: enter_compiled(
            bench,
            f"C++, csr, {words}",
            f"{__name__}:CompiledMesh",
            {"side": side, "order": order},
            part=PART,
            steps=STRUCTURAL_SUBSTEPS,
            **shared,
        )
        for order, words in ORDERS.items()
    }
    finished = bench.race(PART, [graph, *cpp.values()], marks=[FRAMES])
    yield from bench.rows(PART, finished, {}, "")
    for order, words in ORDERS.items():
        target = ">= 1.0" if order == "banded" else ""
        yield from compare(PART, size, f"ours to C++ csr, {words}", graph, cpp[order], target)
    yield from separation(PART, graph, cpp["shuffled"], FRAMES, "m")


class CompiledMesh(Compiled):
    """Compressed rows in space; the order of the vertices is `sheet`'s, or "banded"."""

    steps = STRUCTURAL_SUBSTEPS

    def __init__(self, folder: str, side: int, order: str):
        self.advances = compiled(folder).csr3_steps
        scene = sheet(side, "rows" if order == "rows" else "shuffled")
        p, s, n = scene.particles, scene.springs, side * side
        to = np.arange(n)
        if order == "banded":
            to = adjacency.banded_order(s.between, n)
        number = np.empty(n, np.int64)
        number[to] = np.arange(n)
        self.number = number
        half = adjacency.half_springs(number[s.between], n)
        self.x, v = (np.ascontiguousarray(a[to], np.float32) for a in (p.position, p.velocity))
        k, rest = (a[half.spring].astype(np.float32) for a in (s.stiffness, s.rest_length))
        w = np.where(p.fixed, 0, 1 / p.mass)[to].astype(np.float32)
        numbers = scene.world.dt, scene.world.gravity[1], float(p.viscous[0])
        self.arguments = (n, *numbers, half.row, half.far, k, rest, w, self.x, v)

    def positions(self) -> np.ndarray:
        return self.x[self.number]
