"""The number of particles that a cell should hold, by precision.

The structural cloth on the grid topology, in parallel. Lanes of 1 take no vectors at all.
"""

from __future__ import annotations

from collections.abc import Iterator

from bench import ours
from bench.cloths import STRUCTURAL_FRAME, STRUCTURAL_SCENE, STRUCTURAL_SUBSTEPS
from bench.contest import Bench
from bench.report import Measurement
from taichi_cloth.errors import counted

PART = "lanes"
SIDE, QUICK_SIDE = 512, 128
LANES = (1, 2, 4, 8, 16)
FRAMES = 6  # of 16 steps: when the error is measured


def measure(bench: Bench) -> Iterator[Measurement]:
    """All widths in both precisions, against each other."""
    side = QUICK_SIDE if bench.quick else SIDE
    scene, particles = (STRUCTURAL_SCENE, {"columns": side, "rows": side}), side * side
    reference = ours.reference(bench, PART, scene, particles, frames=[FRAMES], **STRUCTURAL_FRAME)
    contestants = [
        ours.enter(
            bench,
            PART,
            counted(lanes, "lane"),
            scene,
            precision=precision,
            size=f"{side} x {side}",
            particles=particles,
            units=2,
            topology="lanes",
            execution="parallel",
            lanes=lanes,
            **STRUCTURAL_FRAME,
        )
        for precision in ("f32", "f64")
        for lanes in LANES
    ]
    finished = bench.race(PART, contestants, marks=[FRAMES])
    against = f"{ours.AGAINST}, after {FRAMES * STRUCTURAL_SUBSTEPS} steps"
    yield from bench.rows(PART, finished, reference, against)
