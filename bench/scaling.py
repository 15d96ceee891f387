"""The cost of a particle's step from 10 x 10 to 2048 x 2048, on 1 thread and on all.

The structural cloth in f32 as `taichi-cloth run` would run it: the faster path is taken.
"""

from __future__ import annotations

from collections.abc import Iterator

from bench import ours
from bench.cloths import STRUCTURAL_FRAME, STRUCTURAL_SCENE, STRUCTURAL_SUBSTEPS
from bench.contest import Bench, compare
from bench.report import Measurement
from taichi_cloth.errors import counted

PART = "scaling"
SIDES = (10, 32, 100, 316, 1024, 2048)
QUICK_SIDES = (10, 32, 100, 316)
WORK = 4_000_000  # particle-steps in a round, at least
FRAMES = 6  # of 16 steps: when the error is measured; LARGE_FRAMES from LARGE on
LARGE, LARGE_FRAMES = 2048, 1


def measure(bench: Bench) -> Iterator[Measurement]:
    """One contest a size: one thread against all."""
    for side in QUICK_SIDES if bench.quick else SIDES:
        yield from _measure_size(bench, side)


def _measure_size(bench: Bench, side: int) -> Iterator[Measurement]:
    size, scene = f"{side} x {side}", (STRUCTURAL_SCENE, {"columns": side, "rows": side})
    frames = FRAMES if side < LARGE else LARGE_FRAMES
    reference = ours.reference(bench, PART, scene, side * side, frames=[frames], **STRUCTURAL_FRAME)
    contestants = [
        ours.enter(
            bench,
            PART,
            counted(threads, "thread"),
            scene,
            precision="f32",
            threads=threads,
            size=size,
            particles=side * side,
            units=max(1, WORK // (side * side * STRUCTURAL_SUBSTEPS)),
            **STRUCTURAL_FRAME,
        )
        for threads in dict.fromkeys((1, bench.threads))
    ]
    finished = bench.race(PART, bench.mark_after(PART, contestants, frames))
    against = f"{ours.AGAINST}, after {frames * STRUCTURAL_SUBSTEPS} steps"
    yield from bench.rows(PART, finished, reference, against)
    if len(finished) == 2:
        one, all_ = finished
        yield from compare(PART, size, f"{all_.name} to 1", all_, one)
    for contestant in finished:
        contestant.drop()
