"""The seed cloth of 192 particles against programs of Python objects.

`objects` is written as such a program is: vectors, particles, springs and walls that act on each
other. `objects, inlined` is the same with the vectors' arithmetic written out by hand.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from bench import ours
from bench.contest import Bench, Contestant, compare, separation
from bench.report import Measurement

PART = "seed"
SIZE = "16 x 12"
PARTICLES = 192
STEPS = 300  # when the error is measured
SCENE = ("taichi_cloth.scene.library:build", {"name": "cloth"})
BATCH = 1000  # frames in one call, where they share one


def measure(bench: Bench) -> Iterator[Measurement]:
    """Advance all by 300 steps and compare; then let them take turns."""
    programs = [
        bench.enter(
            PART,
            name,
            f"{__name__}:Program",
            {"module": f"bench.{module}"},
            library=module,
            precision="f64",
            threads=1,
            size=SIZE,
            particles=PARTICLES,
            steps=1,
            units=100,
            packages=("python",),
        )
        for name, module in (("objects", "objects"), ("objects, inlined", "objects_inlined"))
    ]
    single = _enter(bench, "ours, 1 step a call", "auto", "f64", units=BATCH, batch=1)
    many = {
        (layout, precision): _enter(
            bench, f"ours, {layout}, {BATCH} steps a call", layout, precision, units=20 * BATCH
        )
        for precision in ("f64", "f32")
        for layout in ours.TOPOLOGIES
    }
    contestants = [*programs, single, *many.values()]
    reference = ours.reference(bench, PART, SCENE, PARTICLES, 1, [STEPS])
    finished = bench.race(PART, bench.mark_after(PART, contestants, STEPS))
    against = f"{ours.AGAINST}, after {STEPS} steps"
    yield from bench.rows(PART, finished, reference, against)

    in_f64 = [c for (_, precision), c in many.items() if c in finished and precision == "f64"]
    fastest = min(in_f64, key=lambda c: c.step_seconds, default=None)
    for program, target in zip(programs, (">= 250", ""), strict=True):
        if program:
            name = f"ours, fastest in f64, to {program.name}"
            yield from compare(PART, SIZE, name, fastest, program, target)
            yield from separation(PART, fastest, program, STEPS, "px", "<= 1e-9")


def _enter(
    bench: Bench, name: str, layout: str, precision: str, **settings: Any
) -> Contestant | None:
    return ours.enter(
        bench,
        PART,
        name,
        SCENE,
        precision=precision,
        size=SIZE,
        particles=PARTICLES,
        topology=layout,
        **settings,
    )


class Program:
    """A module's `Cloth` of Python objects, in the contestants' process; a unit is a step."""

    def __init__(self, module: str):
        self.cloth = importlib.import_module(module).Cloth()

    def advance(self, units: int) -> None:
        for _ in range(units):
            self.cloth.step()

    def positions(self) -> np.ndarray:
        return np.array(self.cloth.positions())
