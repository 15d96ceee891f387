"""PC2 point caches, which Blender, 3ds Max and others play on a mesh with the same vertices.

32 bytes of header: "POINTCACHE2" and a zero, version 1, points, the first frame, frames from a
sample to the next, samples; then x, y, z in single precision of every point of every sample, all
little-endian. (Format of Autodesk's Point Cache 2, as in Blender's `MOD_meshcache_pc2.cc`.)
"""

from __future__ import annotations

import struct
from pathlib import Path

from taichi_cloth.files.exports.frame import Clock, Frame
from taichi_cloth.files.pending import PendingFile

HEADER = struct.Struct("<12siiffi")


class PointCache:
    """Writes a `.pc2` file, frame by frame."""

    def __init__(self, path: Path, clock: Clock):
        self._file, self._clock = PendingFile(path), clock
        self.restart()

    def restart(self) -> None:
        self._samples, self._points, self._first = 0, 0, self._clock.every
        self._file.cut(0)
        self._file.write(self._header())

    def _header(self) -> bytes:
        return HEADER.pack(
            b"POINTCACHE2",
            1,
            self._points,
            float(self._first),
            float(self._clock.every),
            self._samples,
        )

    def add(self, frame: Frame) -> None:
        if self._samples == 0:
            self._points, self._first = len(frame.position), frame.number
        if frame.number != self._first + self._samples * self._clock.every:
            return  # the last of a run that failed, where no sample is: it would be played later
        self._file.write(frame.position.astype("<f4").tobytes())
        self._samples += 1

    def rewind(self, frame: int) -> None:
        kept = (frame - self._first) // self._clock.every + 1
        self._samples = min(self._samples, kept)
        self._file.cut(self._size)

    @property
    def _size(self) -> int:
        """Of header and samples, in bytes."""
        return HEADER.size + 12 * self._points * self._samples

    def finish(self) -> None:
        if self._file.file.closed:
            return
        self._file.cut(self._size)  # an interrupt may have left a part of a sample
        self._file.file.seek(0)
        self._file.write(self._header())
        self._file.commit()

    def discard(self) -> None:
        self._file.discard()
