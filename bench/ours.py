"""Our own contestants, as the parts enter them: a simulation on a topology, in a precision."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.cloths import SceneCall
from bench.contest import FINER, Bench, Contestant
from taichi_cloth.measuring.worker import WorkerFailed
from taichi_cloth.trade.settings import SERIAL_BEST

KIND = "bench.contestants:Ours"
PACKAGES = ("taichi-cloth", "taichi")
TOPOLOGIES = ("lanes", "graph")
AGAINST = "an f64 run at a sixteenth of the step"  # what `reference` is, in words


def enter(
    bench: Bench,
    part: str,
    name: str,
    scene: SceneCall,
    *,
    precision: str,
    size: str,
    particles: int,
    units: int,
    substeps: int = 1,
    threads: int | None = None,
    arch: str = "cpu",
    kind: str = KIND,
    **settings: Any,
) -> Contestant | None:
    """Enter a simulation of ours, `units` frames a round."""
    threads = threads or bench.threads
    arguments: dict[str, Any] = {
        "scene": scene,
        "precision": precision,
        "arch": arch,
        "substeps": substeps,
    }
    if arch == "cpu":
        arguments["threads"] = threads
    return bench.enter(
        part,
        name,
        kind,
        arguments | settings,
        library=f"ours {arch}",
        precision=precision,
        threads=threads,
        size=size,
        particles=particles,
        steps=substeps,
        units=units,
        packages=PACKAGES,
    )


def reference(
    bench: Bench,
    part: str,
    scene: SceneCall,
    particles: int,
    substeps: int,
    frames: list[int],
    **settings: Any,
) -> dict[int, np.ndarray]:
    """Positions after each of `frames` (ascending) in f64 with steps FINER times shorter."""
    # The same way on every machine, whatever runs there have cost.
    settings = {
        "topology": "lanes",
        "execution": "parallel" if particles > SERIAL_BEST else "serial",
    } | settings
    contestant = enter(
        bench,
        part,
        "the reference",
        scene,
        precision="f64",
        size="",
        particles=particles,
        units=1,
        substeps=substeps * FINER,
        **settings,
    )
    if contestant is None:
        return {}
    try:
        for frame in frames:
            while contestant.done < frame:
                bench.tell("the reference, f64 at a sixteenth of the step", contestant.done, frame)
                contestant.advance(1)
            contestant.mark()
    except WorkerFailed as failure:
        bench.leave_out(part, "the reference", "", str(failure))
    contestant.drop()
    return contestant.marks
