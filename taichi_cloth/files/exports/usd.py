"""USD: a mesh whose points are sampled at every frame; points alone, where a scene has no surface.

`.usda` is text and is written here; `.usd` and `.usdc` are made of it by usd-core (Pixar), which is
an extra. Pixar, "USDA file format specification".
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.files.exports.frame import Clock, Frame
from taichi_cloth.files.pending import PendingFile, refusal

EXTRA = "pip install 'taichi-cloth[usd]'"
WIDTH = 12  # characters of a frame's number, which is known at the end


class Stage:
    """Writes a `.usda`, `.usd` or `.usdc` file; time codes are frames, counted as the run does."""

    def __init__(self, path: Path, clock: Clock):
        self._path, self._clock = path, clock
        if path.suffix.lower() != ".usda":
            _require_library(path)
        self._file = PendingFile(path)
        self.restart()

    def restart(self) -> None:
        self._frames: list[int] = []
        self._extents: list[np.ndarray] = []
        self._faces: list[tuple[int, np.ndarray]] = []  # from a frame on
        self._sizes: list[int] = []  # of the text up to each frame's end
        self._file.cut(0)

    def rewind(self, frame: int) -> None:
        kept = sum(number <= frame for number in self._frames)
        del self._frames[kept:], self._extents[kept:], self._sizes[kept:]
        self._faces = [(number, faces) for number, faces in self._faces if number <= frame]
        self._cut()

    def _cut(self) -> None:
        """Let the text end with the last frame: an interrupt may have left a part of one."""
        self._file.cut(self._sizes[-1])

    def add(self, frame: Frame) -> None:
        points = frame.position.astype(np.float32)
        head = b"" if self._frames else self._head(frame)
        text = head + f"        {frame.number}: [{_tuples(points)}],\n".encode()
        self._file.write(text)
        self._sizes.append((self._sizes[-1] if self._sizes else 0) + len(text))
        self._frames.append(frame.number)
        ends = points if len(points) else np.zeros((1, 3), np.float32)
        self._extents.append(np.stack([ends.min(axis=0), ends.max(axis=0)]))
        faces = frame.faces()
        if not self._faces or not np.array_equal(self._faces[-1][1], faces):
            self._faces.append((frame.number, faces))

    def _head(self, frame: Frame) -> bytes:
        rate = f"{self._clock.rate:.17g}"
        kind = "Mesh" if len(frame.triangles) else "Points"
        lines = [
            "#usda 1.0",
            "(",
            '    defaultPrim = "cloth"',
            f"    endTimeCode = {' ' * WIDTH}",  # by `finish`
            f"    framesPerSecond = {rate}",
            "    metersPerUnit = 1",
            f"    startTimeCode = {frame.number}",
            f"    timeCodesPerSecond = {rate}",
            '    upAxis = "Y"',
            ")",
            "",
            f'def {kind} "cloth"',
            "{",
            "    point3f[] points.timeSamples = {\n",
        ]
        text = "\n".join(lines)
        self._end_at = len(text[: text.index("endTimeCode") + len("endTimeCode = ")].encode())
        return text.encode()

    def finish(self) -> None:
        if self._file.file.closed:
            return
        if not self._frames:
            self._file.write(b"#usda 1.0\n")
        else:
            self._cut()
            self._file.write(self._tail().encode())
            self._file.file.seek(self._end_at)
            self._file.write(f"{self._frames[-1]:<{WIDTH}d}".encode())
        if self._path.suffix.lower() != ".usda":
            self._convert()
        self._file.commit()

    def _tail(self) -> str:
        lines = ["    }", "    float3[] extent.timeSamples = {"]
        for number, extent in zip(self._frames, self._extents, strict=True):
            lines.append(f"        {number}: [{_tuples(extent)}],")
        lines.append("    }")
        if any(len(faces) for _, faces in self._faces):
            lines += ["    uniform bool doubleSided = 1", *_sampled_faces(self._faces)]
            lines.append('    uniform token subdivisionScheme = "none"')
        return "\n".join([*lines, "}", ""])

    def _convert(self) -> None:
        """Turn the text that was written into the binary format."""
        from pxr import Sdf

        self._file.file.flush()
        self._file.file.seek(0)
        folder = tempfile.mkdtemp(prefix="taichi-cloth-")
        text, binary = os.path.join(folder, "text.usda"), os.path.join(folder, "binary.usdc")
        try:
            with open(text, "wb") as file:
                while block := self._file.file.read(2**20):
                    file.write(block)
            Sdf.Layer.FindOrOpen(text).Export(binary)
            self._file.file.seek(0)
            self._file.file.truncate()
            with open(binary, "rb") as file:
                while block := file.read(2**20):
                    self._file.write(block)
        except OSError as error:
            self._file.discard()
            raise refusal(self._path, error) from None
        finally:
            for path in (text, binary):
                with contextlib.suppress(OSError):
                    os.unlink(path)
            os.rmdir(folder)

    def discard(self) -> None:
        self._file.discard()


def _require_library(path: Path) -> None:
    try:
        import pxr  # noqa: F401
    except ImportError:
        raise InputError(
            f"--export {path}: {path.suffix} needs usd-core, which is not there ({EXTRA}); "
            "or choose .usda"
        ) from None


def _tuples(rows: np.ndarray) -> str:
    """Vectors as USD's text has them; nine digits are all that single precision has."""
    pattern = ", ".join(["(%.9g, %.9g, %.9g)"] * len(rows))
    return pattern % tuple(rows.ravel().tolist())


def _sampled_faces(faces: list[tuple[int, np.ndarray]]) -> list[str]:
    """The triangles: once, or where some tear, from each frame on at which they are others."""
    lines = []
    for name, of in (
        ("faceVertexCounts", lambda rows: np.full(len(rows), 3)),
        ("faceVertexIndices", lambda rows: rows.ravel()),
    ):
        texts = [(number, ", ".join(map(str, of(rows).tolist()))) for number, rows in faces]
        if len(texts) == 1:
            lines.append(f"    int[] {name} = [{texts[0][1]}]")
            continue
        lines.append(f"    int[] {name}.timeSamples = {{")
        lines += [f"        {number}: [{text}]," for number, text in texts]
        lines.append("    }")
    return lines
