"""All frames in one NumPy archive."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.files.exports.frame import Clock, Frame
from taichi_cloth.files.pending import PendingFile


class Archive:
    """Writes an `.npz` file for k frames of n points.

    frame (k,), time (k,), position (k, n, 3) float64, triangles (m, 3), triangle_whole (k, m) bool,
    springs (s, 2), spring_held (k, s) bool, rate: frames in a unit of time, every: the step from a
    frame kept to the next.
    """

    def __init__(self, path: Path, clock: Clock):
        self._file, self._clock = PendingFile(path), clock
        self._frames: list[Frame] = []

    def add(self, frame: Frame) -> None:
        if self._frames:  # the last frame's tables are written: no other keeps its own
            last = self._frames[-1]
            self._frames[-1] = replace(last, triangles=frame.triangles, springs=frame.springs)
        self._frames.append(frame)

    def restart(self) -> None:
        self._frames = []

    def rewind(self, frame: int) -> None:
        self._frames = [one for one in self._frames if one.number <= frame]
        last = self._frames[-1]  # its tables are those of the next one, which may have had more
        faces, springs = last.triangles[: len(last.whole)], last.springs[: len(last.held)]
        self._frames[-1] = replace(last, triangles=faces, springs=springs)

    def finish(self) -> None:
        if self._file.file.closed:
            return
        frames = self._frames
        points = len(frames[0].position) if frames else 0
        faces = frames[-1].triangles if frames else np.zeros((0, 3), np.int64)
        springs = frames[-1].springs if frames else np.zeros((0, 2), np.int64)

        def rows(columns: list[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
            """One row a frame; what came later is False in earlier ones."""
            table = np.zeros((len(frames), *shape), columns[0].dtype if columns else bool)
            for row, column in zip(table, columns, strict=True):
                row[: len(column)] = column
            return table

        arrays: dict[str, Any] = {
            "frame": np.array([f.number for f in frames], np.int64),
            "time": np.array([f.time for f in frames], np.float64),
            "position": rows([f.position for f in frames], (points, 3)).astype(np.float64),
            "triangles": faces,
            "triangle_whole": rows([f.whole for f in frames], (len(faces),)),
            "springs": springs,
            "spring_held": rows([f.held for f in frames], (len(springs),)),
            "rate": np.array(self._clock.rate),
            "every": np.array(self._clock.every),
        }
        self._file.fill(lambda file: np.savez(file, **arrays))

    def discard(self) -> None:
        self._file.discard()
