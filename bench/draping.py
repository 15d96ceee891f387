"""Cloth with a thickness: frames while it falls, drapes, and touches and crumples on itself.

Sheets of `cloths.draping`, 8 steps a frame, timed from frames on at which they fall, lie on a
sphere, hang from it in folds, and stand in a heap of their own.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from bench import ours
from bench.contest import Bench
from bench.report import Measurement

PART = "draping"
SCENE = "bench.cloths:draping"
SIDES = {128: 60, 256: 12}  # particles along, and frames a second that are asked for
SUBSTEPS = 8
FRAMES = 2  # in a round
# What is seen, whether the sheet stands upright, and the frame from which on it is timed at 128
STAGES = (
    ("falling", False, 8),
    ("over a sphere", False, 30),
    ("in folds", False, 60),
    ("crumpling", True, 40),
    ("in a heap", True, 90),
)


def measure(bench: Bench) -> Iterator[Measurement]:
    """One contest for each size and stage."""
    for side in [64] if bench.quick else SIDES:
        for stage, upright, frame in STAGES:
            yield from _measure_stage(bench, side, stage, upright, frame * side // 128)


def _measure_stage(
    bench: Bench, side: int, stage: str, upright: bool, frame: int
) -> Iterator[Measurement]:
    shared: dict[str, Any] = {
        "precision": "f32",
        "size": f"{side}²",
        "particles": side * side,
        "units": FRAMES,
        "after": frame,
        "substeps": SUBSTEPS,
        "method": "symplectic_euler",
        "topology": "graph",
        "execution": "parallel",
    }
    scene = (SCENE, {"side": side, "upright": upright})
    sheet = ours.enter(bench, PART, stage, scene, **shared)
    finished = bench.race(PART, [sheet])
    yield from bench.rows(PART, finished, {}, "")
    if sheet and sheet.seconds:
        yield Measurement(
            part=PART,
            contestant=f"{stage}, frames",
            size=f"{side}²",
            rate=1 / (SUBSTEPS * sheet.step_seconds),
            unit="frames/s",
            target=f">= {SIDES[side]}" if side in SIDES else "",
        )
        sheet.drop()
