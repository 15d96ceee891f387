"""The seconds of a setting's run: where each began, among its samples, and how wrong it was."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.scene.model import Scene
from taichi_cloth.simulation.snapshot import Grips, Judged, Snapshot
from taichi_cloth.simulation.start import Start

SECOND = 60  # frames


@dataclass(frozen=True)
class Second:
    """The error of a second by itself, from where the run stood at its start.

    first: the frame that it begins at. error: in world units; relative: in parts of the largest
    displacement in it, 0 where nothing moves. None where it cannot be known: `trouble` says why.
    """

    first: int
    error: float | None = None
    relative: float | None = None
    trouble: str = ""


def arrays_of_start(frame: int, start: Start) -> dict[str, np.ndarray]:
    """A start's arrays by name, without its scene; frame: at which it is."""
    taken, judged = start.snapshot, start.snapshot.judged
    arrays = {
        "x": taken.x, "v": taken.v, "marks": taken.marks, "clock": [start.time, start.steps],
        "elements": judged.elements, "known": judged.known, "through": judged.through,
    }  # fmt: skip
    if start.force is not None:
        arrays["force"] = start.force
    if taken.grips is not None:
        arrays |= {"by": taken.grips.by, "at": taken.grips.at}
    return {f"start {frame} {name}": np.asarray(array) for name, array in arrays.items()}


def read_starts(path: Path, scene: Scene) -> tuple[dict[int, Start], dict[str, Any]]:
    """The starts of a run's seconds by frame, and its solver's settings, from its samples' file."""
    of: dict[int, dict[str, np.ndarray]] = {}
    with np.load(path) as file:
        for name in file.files:
            first, *rest = name.split()
            if first == "start":
                of.setdefault(int(rest[0]), {})[rest[1]] = file[name]
        solver: dict[str, Any] = json.loads(str(file["solver"]))
    return {frame: _start_of(arrays, scene) for frame, arrays in of.items()}, solver


def _start_of(arrays: dict[str, np.ndarray], scene: Scene) -> Start:
    judged = Judged(arrays["elements"], arrays["known"], arrays["through"])
    grips = Grips(arrays["by"], arrays["at"]) if "by" in arrays else None
    taken = Snapshot(scene, arrays["x"], arrays["v"], arrays["marks"], judged, grips)
    time, steps = arrays["clock"]
    return Start(taken, float(time), int(steps), arrays.get("force"))
