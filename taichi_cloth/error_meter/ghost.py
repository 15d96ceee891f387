"""The reference of a window beside what was shown in it: the ghost of what is on screen."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taichi_cloth.error_meter.window import Window

# Of the numbers in the displacements of a window: of more, those of its end alone are kept.
MOST_OF = 0.99  # of the particles: a torn one that flies off does not count
MOST_NUMBERS = 6_000_000


@dataclass(frozen=True)
class Ghost:
    """By how much the reference of a window is away from what was shown.

    first, frames, stride: as of its `Window`. shown: what was shown, (n, dim) each, at its start
    and at each `stride`th frame. away: from there to the reference, (samples, n, dim) float32, at
    the same moments, or at the last alone. torn: (k, 2), between which particles springs broke in
    the reference. largest: how far nearly all particles are away at most, at the end. extent: of
    all that was shown then.
    """

    first: int
    frames: int
    stride: int
    shown: list[np.ndarray]
    away: np.ndarray
    torn: np.ndarray
    largest: float
    extent: float

    @classmethod
    def read(cls, path: Path, window: Window) -> Ghost:
        """That of a window out of the file that `write` made."""
        with np.load(path) as parts:
            away, torn = parts["away"], parts["torn"]
            shown = window.shown[: int(parts["samples"])]
        far = np.sqrt(np.einsum("ij,ij->i", away[-1], away[-1]))
        extent = float(np.linalg.norm(np.ptp(shown[-1], axis=0)))
        settings = window.first, window.frames, window.stride
        return cls(*settings, shown, away, torn, float(np.quantile(far, MOST_OF)), extent)

    @property
    def end(self) -> int:
        """The last frame of the run at which the reference is known."""
        return self.first + (len(self.shown) - 1) * self.stride

    @property
    def start(self) -> int:
        """The first one."""
        return self.first if len(self.away) > 1 else self.end

    def at(self, frame: int) -> np.ndarray | None:
        """By how much the reference was away, (n, dim); beyond the window's end as at that.

        Between two samples it is their mean by time. None before it began.
        """
        if frame < self.start:
            return None
        before, beyond = divmod(min(frame, self.end) - self.first, self.stride)
        away: np.ndarray = self.away[min(before, len(self.away) - 1)]
        if beyond:
            part = np.float32(beyond / self.stride)
            away = (1 - part) * away + part * self.away[before + 1]
        return away


def write(path: Path, reference: np.ndarray, shown: np.ndarray, torn: np.ndarray) -> None:
    """Write what a ghost is read from.

    reference, shown: positions, (samples, n, dim): those that were judged. torn: as of `Ghost`.
    """
    samples = len(reference)
    if reference.size > MOST_NUMBERS:
        reference, shown = reference[-1:], shown[-1:]
    np.savez(path, away=(reference - shown).astype(np.float32), torn=torn, samples=samples)
