"""A file a frame, PLY or OBJ, in a folder: frame_00001.ply and so on.

The files are written to a folder beside it, and come to their place together: a sequence is never
mixed of two runs.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import tempfile
from pathlib import Path
from typing import NoReturn

import numpy as np

from taichi_cloth.errors import InputError, counted
from taichi_cloth.files.exports.frame import Clock, Frame
from taichi_cloth.files.pending import creation_mask, refusal, unfinished


class Sequence:
    """Writes NAME_00001.EXT and so on for a path FOLDER/NAME.EXT; the folder is made.

    An earlier sequence of that name is replaced as a whole. Raises InputError where nothing can be
    written there.
    """

    def __init__(self, path: Path, clock: Clock):
        self._path, self._clock = path, clock
        self._loose: dict[int, int] = {}  # vertices that no face has any more, by frame
        self._text = {".ply": ply, ".obj": obj}[path.suffix.lower()]
        folder = Path(os.path.realpath(path.parent))
        self._target, self._done = folder, False
        if os.path.exists(folder) and not os.path.isdir(folder):
            raise InputError(f"--export {path}: '{path.parent}' is a file, not a folder")
        if os.path.isdir(folder) and not os.access(folder, os.W_OK):
            self._refuse(PermissionError(13, os.strerror(13)))
        # Inside a folder that there is, which may stand in one that cannot be written to.
        beside = folder if os.path.isdir(folder) else folder.parent
        try:
            self._folder = Path(
                tempfile.mkdtemp(prefix=f"{path.stem}.", suffix=".part", dir=beside)
            )
        except FileNotFoundError:
            raise InputError(
                f"--export {path}: cannot be written: there is no folder '{path.parent.parent}'"
            ) from None
        except (OSError, ValueError) as error:
            self._refuse(error)
        unfinished(self._folder)

    def _refuse(self, error: Exception) -> NoReturn:
        raise refusal(f"--export {self._path}", error) from None

    def add(self, frame: Frame) -> None:
        file = self._folder / f"{self._path.stem}_{frame.number:05d}{self._path.suffix}"
        if self._text is obj:
            self._loose[frame.number] = _loose(frame)
        try:
            file.write_bytes(self._text(frame, self._clock))
        except OSError as error:
            self.discard()
            self._refuse(error)
        except BaseException:  # an interrupt: no half of it
            file.unlink(missing_ok=True)
            raise

    def notes(self) -> list[str]:
        """Notes on the files, a sentence each."""
        frames = [loose for loose in self._loose.values() if loose]
        if not frames:
            return []
        return [
            f"in {counted(len(frames), 'frame')} torn cloth has vertices without a face, up to "
            f"{max(frames)}: trimesh and others drop such vertices of OBJ files, and number the "
            "rest anew; Blender keeps them, and PLY and USD do everywhere"
        ]

    def restart(self) -> None:
        self._loose = {}
        for file in self._folder.iterdir():
            file.unlink()

    def rewind(self, frame: int) -> None:
        self._loose = {number: of for number, of in self._loose.items() if number <= frame}
        for file in self._folder.iterdir():
            if int(file.stem.rpartition("_")[2]) > frame:
                file.unlink()

    def finish(self) -> None:
        if self._done:
            return
        try:
            written = sorted(self._folder.iterdir())
            if not self._target.is_dir() and written:
                with contextlib.suppress(OSError):  # not every kind of disk has permissions
                    os.chmod(self._folder, 0o777 & ~creation_mask())
                os.rename(self._folder, self._target)
            elif written:
                new = {file.name for file in written}
                mine = re.compile(
                    rf"{re.escape(self._path.stem)}_\d{{5,}}{re.escape(self._path.suffix)}"
                )
                old = [f for f in self._target.iterdir() if mine.fullmatch(f.name)]
                for file in written:
                    os.replace(file, self._target / file.name)
                for file in old:
                    if file.name not in new:
                        file.unlink()
        except OSError as error:
            self.discard()
            self._refuse(error)
        self.discard()

    def discard(self) -> None:
        self._done = True
        with contextlib.suppress(OSError):
            shutil.rmtree(self._folder)


def _loose(frame: Frame) -> int:
    """The vertices that had a face, and have none since cloth is torn."""
    return len(np.setdiff1d(frame.triangles, frame.faces()))


def _about(frame: Frame, clock: Clock) -> str:
    return f"frame {frame.number}, time {frame.time:.17g}, {clock.rate:.17g} frames a unit of time"


def ply(frame: Frame, clock: Clock) -> bytes:
    """A frame as binary PLY: positions in double precision, the triangles that are whole; without
    triangles the springs that hold.
    """
    faces, edges = frame.faces(), frame.edges()
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {_about(frame, clock)}",
        f"element vertex {len(frame.position)}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        *([f"element edge {len(edges)}"] if len(edges) else []),
        *(["property int vertex1", "property int vertex2"] if len(edges) else []),
        "end_header\n",
    ]
    rows = np.empty(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    return b"".join(
        (
            "\n".join(header).encode(),
            frame.position.astype("<f8").tobytes(),
            rows.tobytes(),
            edges.astype("<i4").tobytes(),
        )
    )


def obj(frame: Frame, clock: Clock) -> bytes:
    """A frame as OBJ: positions with all their digits, the triangles that are whole; without
    triangles the springs that hold, as lines. A vertex of neither is a line from itself to itself:
    Blender drops what nothing names.
    """
    faces, edges = frame.faces() + 1, frame.edges() + 1
    alone = np.setdiff1d(np.arange(len(frame.position)) + 1, np.append(faces, edges))
    parts = [f"# {_about(frame, clock)}\n"]
    for line, rows in (
        ("v %.17g %.17g %.17g\n", frame.position),
        ("f %d %d %d\n", faces),
        ("l %d %d\n", edges),
        ("l %d %d\n", np.column_stack([alone, alone])),
    ):
        parts.append(line * len(rows) % tuple(rows.ravel().tolist()))
    return "".join(parts).encode()
