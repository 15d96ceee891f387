"""All that a run notes frame by frame, as one."""

from __future__ import annotations

import contextlib

from taichi_cloth.files.exports import Export
from taichi_cloth.files.trajectory import Recordable, Trajectory


class Recordings:
    """A trajectory and an export, as far as a run has them."""

    def __init__(self, trajectory: Trajectory | None, export: Export | None):
        self.trajectory, self.export = trajectory, export

    def __bool__(self) -> bool:
        return not (self.trajectory is None and self.export is None)

    def by_flag(self) -> dict[str, Trajectory | Export]:
        """Recordings by the flag that asks for them."""
        parts = {"--save": self.trajectory, "--export": self.export}
        return {flag: part for flag, part in parts.items() if part is not None}

    @property
    def frames(self) -> int:
        """The number of frames that are noted."""
        return max((part.frames for part in self.by_flag().values()), default=0)

    def record(self, sim: Recordable, *, last: bool = False) -> None:
        """Take note of a simulation's present frame; last: whatever its number is.

        Where the disk of one is full, the other has the frame all the same.
        """
        with contextlib.ExitStack() as parts:
            for part in self.by_flag().values():
                parts.callback(part.record, sim, last=last)

    def rewind(self, frame: int) -> None:
        """Forget the frames after `frame`, from which a simulation goes on another way."""
        for part in self.by_flag().values():
            part.rewind(frame)
