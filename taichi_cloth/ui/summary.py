"""What a run did, for whoever started it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Summary:
    """What a run did.

    frames: advanced in this run. seconds: it took, from the first to the last. simulate: the part
    of these spent simulating, without the first frame, which compiles. draw: the part spent
    drawing. waited: the part spent waiting until the next frame was due. quit: whether the user
    ended it.
    """

    frames: int
    seconds: float
    simulate: float
    draw: float
    waited: float
    quit: bool
