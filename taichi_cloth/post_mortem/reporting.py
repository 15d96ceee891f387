"""`Simulation.report`: a post-mortem for Python."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.files.pending import PendingFile
from taichi_cloth.post_mortem import page
from taichi_cloth.post_mortem.examine import SECONDS, PostMortem, examine
from taichi_cloth.settings import accepted

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation


def report(
    sim: Simulation,
    path: str | Path,
    draw: Callable[[], np.ndarray] | None = None,
    seconds: float = SECONDS,
) -> PostMortem:
    """Write what led to where a simulation is; see `Simulation.report`."""
    seconds = accepted.number("report: seconds", seconds, above=0)
    file = PendingFile(accepted.path("report: path", path))
    try:
        found = examine(sim, draw=draw, seconds=seconds)
        page.write(found, file)
    except BaseException:
        file.discard()
        raise
    return found
