"""Results for other programs: PLY and OBJ sequences, NumPy archives, point caches, USD.

`open_export` chooses the format by a path: a folder becomes a sequence of PLY files, every other
path says it by its suffix. Each file appears whole or not at all.
"""

from __future__ import annotations

import operator
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from taichi_cloth.errors import InputError, nearest
from taichi_cloth.files import meshes
from taichi_cloth.files.exports import npz, pc2, sequence, usd
from taichi_cloth.files.exports.frame import Clock, Frame, Writer
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.files.trajectory import Exportable, Recordable

# What writes the formats, by suffix.
WRITERS: dict[str, Callable[[Path, Clock], Writer]] = {
    ".ply": sequence.Sequence,
    ".obj": sequence.Sequence,
    ".npz": npz.Archive,
    ".pc2": pc2.PointCache,
    ".usda": usd.Stage,
    ".usd": usd.Stage,
    ".usdc": usd.Stage,
}
OWN_COORDINATES = (".npz",)  # formats that have the scene's own; in all others y points up


class Export:
    """Every `every`-th frame of a simulation, in files for other programs.

    dt: time of a frame; scene: what is exported, of which a point cache has the mesh beside it.
    Raises InputError at once, naming the flag `--export`, where the path cannot be written, names
    no format, or that mesh would replace another one.

    Points are the particles or, where a mesh was welded, the vertices of its file. The particles
    are those of the first frame that is noted: what is clicked in later is left out, since the
    formats have the same points in all frames, and is counted in `left_out`.
    """

    def __init__(
        self, path: str | Path, dt: float, every: int = 1, scene: Exportable | None = None
    ):
        self.every = operator.index(every)
        path, clock = Path(path), Clock(dt, self.every)
        self._own = path.suffix.lower() in OWN_COORDINATES
        self._mesh = _mesh_beside(path, clock, scene) if scene is not None else None
        try:
            self._writer = open_export(path, clock)
        except InputError:
            self._discard_mesh()
            raise
        self._points = 0
        self._noted: list[tuple[int, int]] = []  # frames, and how many particles each leaves out

    @property
    def frames(self) -> int:
        """The number noted."""
        return len(self._noted)

    @property
    def left_out(self) -> int:
        """The number of particles left out, of the frame that has the most."""
        return max((more for _, more in self._noted), default=0)

    @property
    def _last(self) -> int:
        return self._noted[-1][0] if self._noted else -1

    def record(self, sim: Recordable, *, last: bool = False) -> None:
        """Take note of a simulation's present frame, if its number is a multiple of `every`.

        last: whatever its number is, as the last good one of a run that failed. A frame that was
        noted already is not noted twice; a lower number means that the simulation was reset, and
        what was noted before is forgotten.
        """
        frame = sim.frame
        if frame < self._last:
            self._restart()
        wanted = last or (frame > 0 and frame % self.every == 0)
        if not wanted or frame == self._last:
            return
        position = sim.positions()
        if not self._noted:
            self._points = len(position)
        self._writer.add(self._frame(sim, position))
        self._noted.append((frame, len(position) - self._points))

    def rewind(self, frame: int) -> None:
        """Forget the frames after `frame`, from which a simulation goes on another way."""
        kept = [noted for noted in self._noted if noted[0] <= frame]
        if not kept:
            self._restart()
        elif len(kept) < len(self._noted):
            self._writer.rewind(frame)
        self._noted = kept

    def _restart(self) -> None:
        self._writer.restart()
        self._noted = []

    def _frame(self, sim: Recordable, position: np.ndarray) -> Frame:
        points = np.full((self._points, 3), 0.0)
        kept = position[: self._points]
        points[: len(kept), : position.shape[1]] = kept  # of a plane's, z is 0
        edges, faces = sim.springs(), sim.triangles()
        # What ends at a particle that is left out would have an end that no file has.
        tied, spanned = ((ends < self._points).all(axis=1) for ends in (edges, faces))
        held, whole = sim.springs_alive()[tied], sim.triangles_alive()[spanned]
        points, faces, edges = _of_files(sim.scene, points, faces[spanned], edges[tied])
        if not self._own:
            points = _hanging(sim.scene, points)
        return Frame(sim.frame, sim.time, points, faces, whole, edges, held)

    def notes(self) -> list[str]:
        """Notes on the files, a sentence each."""
        return self._writer.notes() if isinstance(self._writer, sequence.Sequence) else []

    def save(self) -> None:
        """Write what is not yet written, and give the files their names. Once only."""
        self._writer.finish()
        if self._mesh is not None:
            self._mesh.commit()

    def discard(self) -> None:
        """Leave nothing behind, unless saved; what was at the path before stays."""
        self._writer.discard()
        self._discard_mesh()

    def _discard_mesh(self) -> None:
        if self._mesh is not None:
            self._mesh.discard()


def _of_files(
    scene: Exportable, points: np.ndarray, faces: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Particles (n, 3), their triangles and springs: those of a mesh that was welded as its file
    has them. What was clicked in stands after them.
    """
    of_files = scene.file_points
    if of_files is None:
        return points, faces, edges
    own = np.arange(len(of_files.first), len(points))
    first = np.concatenate([of_files.first, len(of_files.particle) + np.arange(len(own))])
    later = first[faces[len(of_files.corners) :]]
    corners = np.concatenate([of_files.corners, later])
    return points[np.concatenate([of_files.particle, own])], corners, first[edges]


def _hanging(scene: Exportable, points: np.ndarray) -> np.ndarray:
    """Points (n, 3) with y up: of a scene whose y points down, turned half round about x."""
    if scene.world.up:
        return points
    turned: np.ndarray = np.column_stack([points[:, 0], 0.0 - points[:, 1], 0.0 - points[:, 2]])
    return turned


def _mesh_beside(path: Path, clock: Clock, scene: Exportable) -> PendingFile | None:
    """The mesh that a point cache fits, NAME.obj beside it, still to be committed; None for other
    formats, and where the mesh is there already. InputError where another one is.
    """
    if path.suffix.lower() != ".pc2":
        return None
    beside = path.with_suffix(".obj")
    x = np.zeros((len(scene.particles.position), 3))
    x[:, : scene.particles.position.shape[1]] = scene.particles.position
    x, faces, edges = _of_files(scene, x, scene.triangles, scene.springs.between)
    whole, held = np.ones(len(faces), bool), np.ones(len(edges), bool)
    text = sequence.obj(Frame(0, 0.0, _hanging(scene, x), faces, whole, edges, held), clock)
    if os.path.exists(beside):
        if not _is_mesh(beside, text, len(x), faces):
            raise InputError(
                f"--export {path}: the mesh that it fits, '{beside}', would be written over "
                "another one; name the cache otherwise"
            )
        return None
    mesh = PendingFile(beside)
    mesh.write(text)
    return mesh


def _is_mesh(path: Path, text: bytes, count: int, faces: np.ndarray) -> bool:
    """True if a file has as many vertices, and triangles between the same ones."""
    try:
        if path.read_bytes() == text:
            return True
        surface = meshes.read(path)
    except (OSError, InputError):
        return False

    def rows(triangles: np.ndarray) -> np.ndarray:
        return np.asarray(np.unique(np.sort(triangles, axis=1), axis=0))

    # Programs drop a file's vertices without a face, but for those that ours name by lines.
    wanted, kept = rows(faces), len(surface.vertices)
    if kept == count:
        return np.array_equal(rows(surface.triangles), wanted)
    all_of_them = kept + len(surface.left_out) == count
    return all_of_them and np.array_equal(rows(surface.number[surface.triangles]), wanted)


def open_export(path: Path, clock: Clock) -> Writer:
    """The writer of the format that a path names. Raises InputError where there is none."""
    suffix = path.suffix.lower()
    if os.path.isdir(path) or not suffix:
        return sequence.Sequence(path / "frame.ply", clock)
    if suffix not in WRITERS:
        hint = nearest(suffix, WRITERS)
        raise InputError(f"--export {path}: '{suffix}' is no format of results; {hint}")
    return WRITERS[suffix](path, clock)
