"""Saved trajectories: what every particle and spring did, frame by frame, as an ``.npz`` file."""

from __future__ import annotations

import json
import operator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from taichi_cloth.errors import InputError, counted
from taichi_cloth.files import archives
from taichi_cloth.files.meshes.seams import FilePoints
from taichi_cloth.files.pending import PendingFile

_WHAT = "saved trajectory"
_ARRAYS = ("frame", "time", "position", "velocity", "spring", "spring_alive", "meta")
_LATER = ("start", "fixed")  # which files of earlier versions do not have
# Of what NumPy calls a kind each array is; of numbers, where nothing is said.
_KINDS = {"frame": "iu", "spring": "iu", "spring_alive": "b", "fixed": "b"}


@dataclass(frozen=True, repr=False)
class Saved:
    """A trajectory of k frames that was read back, with the arrays of the file.

    frame: (k,) int, numbered from 1; time: (k,) [the scene's time]; position, velocity:
    (k, particles, dim) float64, NaN before a particle exists; spring: (springs, 2) int;
    spring_alive: (k, springs) bool; meta: scene, method, dt and so on.
    start: (particles, dim), where particles were at the scene's start, NaN of those that came
    later; fixed: (particles,) bool, which were fixed there. None: a file of an earlier version.
    """

    frame: np.ndarray
    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    spring: np.ndarray
    spring_alive: np.ndarray
    meta: dict[str, Any]
    start: np.ndarray | None = None
    fixed: np.ndarray | None = None

    def __repr__(self) -> str:
        """Its line at a prompt or in a notebook's cell: not its arrays."""
        frames, particles = self.position.shape[:2]
        of = f"{self.meta['scene']!r}, " if "scene" in self.meta else ""
        return f"<Saved: {of}{counted(frames, 'frame')} of {counted(particles, 'particle')}>"


class _World(Protocol):
    @property
    def dim(self) -> int: ...
    @property
    def up(self) -> str: ...


class _Particles(Protocol):
    @property
    def position(self) -> np.ndarray: ...
    @property
    def fixed(self) -> np.ndarray: ...


class _Springs(Protocol):
    @property
    def between(self) -> np.ndarray: ...


class Exportable(Protocol):
    """The part of a scene that trajectories and exports use."""

    @property
    def world(self) -> _World: ...
    @property
    def particles(self) -> _Particles: ...
    @property
    def springs(self) -> _Springs: ...
    @property
    def triangles(self) -> np.ndarray: ...
    @property
    def file_points(self) -> FilePoints | None: ...


class Recordable(Protocol):
    """The part of a simulation that trajectories and exports use."""

    @property
    def frame(self) -> int: ...
    @property
    def time(self) -> float: ...
    @property
    def particle_count(self) -> int: ...
    @property
    def scene(self) -> Exportable: ...
    def springs(self) -> np.ndarray: ...
    def positions(self) -> np.ndarray: ...
    def velocities(self) -> np.ndarray: ...
    def springs_alive(self) -> np.ndarray: ...
    def triangles(self) -> np.ndarray: ...
    def triangles_alive(self) -> np.ndarray: ...


class _Frame(NamedTuple):
    """A frame that was noted: its number and time, and the particles and springs of it."""

    number: int
    time: float
    position: np.ndarray
    velocity: np.ndarray
    alive: np.ndarray


class Trajectory:
    """Collects every `every`-th frame of a simulation and saves them.

    Raises InputError at once if `path` cannot be written or `every` is not positive. The file
    appears, whole, at `save`.
    """

    def __init__(self, path: str | Path, every: int = 1):
        try:
            self.every = operator.index(every)
        except TypeError:
            raise InputError("every must be a whole number") from None
        if self.every < 1 or isinstance(every, bool):
            raise InputError(f"every must be at least 1, is {every}")
        self._pending = PendingFile(_checked(path))
        self._forget()

    def _forget(self) -> None:
        self._frames: list[_Frame] = []
        self._springs: np.ndarray = np.zeros((0, 2), np.int64)
        self._shape = (0, 2)
        self._began: _Particles | None = None

    @property
    def frames(self) -> int:
        """The number of frames that are noted."""
        return len(self._frames)

    def record(self, sim: Recordable, *, last: bool = False) -> None:
        """Take note of `sim`'s present frame if its number is a multiple of `every`.

        Call it after each frame. `last` takes note of any frame: the last good one of a run that
        failed (number 0, the scene's start, if its first frame did). A frame that was noted
        already is not noted twice; a lower number means that the simulation was reset, and what
        was noted before is forgotten. InputError where particles were removed since: the rows of
        a file are those of the same ones in every frame.
        """
        frame = sim.frame
        if self._frames and frame < self._frames[-1].number:
            self._forget()
        if sim.particle_count < self._shape[0] and self._frames:
            raise InputError(
                f"a trajectory of {self._shape[0]} particles cannot go on with "
                f"{sim.particle_count}: save it, and record to another file"
            )
        self._shape = (sim.particle_count, sim.scene.world.dim)
        self._springs = sim.springs()
        self._began = self._began or sim.scene.particles
        wanted = last or (frame > 0 and frame % self.every == 0)
        if not wanted or (self._frames and frame == self._frames[-1].number):
            return
        # Whole or not at all: an interrupt while it is read must leave no half of it.
        now = sim.time, sim.positions(), sim.velocities(), sim.springs_alive()
        self._frames.append(_Frame(frame, *now))

    def rewind(self, frame: int) -> None:
        """Forget the frames after `frame`, from which the simulation goes on another way."""
        try:
            frame = operator.index(frame)
        except TypeError:
            raise InputError("Trajectory.rewind: frame must be a whole number") from None
        self._frames = [noted for noted in self._frames if noted.number <= frame]
        last = self._frames[-1] if self._frames else None
        # Particles that came since then are no part of it.
        self._shape = (len(last.position) if last else 0, self._shape[1])
        self._springs = self._springs[: len(last.alive) if last else 0]

    def save(self, meta: dict[str, Any] | None = None) -> None:
        """Write the file. May be called twice; only the first call writes.

        Particles and springs that came later have NaN rows, and False, in earlier frames.
        meta: what to note beside them. InputError where that cannot be written as JSON; what was
        recorded can be saved all the same then.
        """
        about = archives.noted("Trajectory.save: meta", meta)
        k, (particles, dim) = len(self._frames), self._shape
        position = np.full((k, particles, dim), np.nan)
        velocity = np.full((k, particles, dim), np.nan)
        alive = np.zeros((k, len(self._springs)), bool)
        start, fixed = np.full((particles, dim), np.nan), np.zeros(particles, bool)
        if self._began is not None:
            there = len(self._began.fixed[:particles])
            start[:there] = self._began.position[:particles]
            fixed[:there] = self._began.fixed[:particles]
        for i, frame in enumerate(self._frames):
            position[i, : len(frame.position)] = frame.position
            velocity[i, : len(frame.velocity)] = frame.velocity
            alive[i, : len(frame.alive)] = frame.alive
        if self._pending.file.closed:
            return
        # Given an open file, np.savez adds no suffix to the name the user chose.
        self._pending.fill(
            lambda file: np.savez(
                file,
                frame=np.array([frame.number for frame in self._frames], np.int64),
                time=np.array([frame.time for frame in self._frames], np.float64),
                position=position,
                velocity=velocity,
                spring=np.asarray(self._springs, np.int64).reshape(-1, 2),
                spring_alive=alive,
                meta=np.array(about),
                start=start,
                fixed=fixed,
            )
        )

    def discard(self) -> None:
        """Forget everything, unless already saved; what was at the path before stays."""
        self._pending.discard()


def _checked(path: str | Path) -> Path:
    if not isinstance(path, (str, Path)):
        raise InputError(f"a trajectory's path is no {type(path).__name__}; give a str or Path")
    return Path(path)


def load(path: str | Path) -> Saved:
    """The trajectory saved at `path`. Raises InputError if there is none that can be read."""
    path = _checked(path)
    arrays = archives.read(path, _WHAT)
    missing = [name for name in _ARRAYS if name not in arrays]
    if "triangle_whole" in arrays:
        raise InputError(f"{path}: is no {_WHAT} but an export, for other programs; use --save")
    if missing:
        raise InputError(f"{path}: is no {_WHAT}: it has no '{missing[0]}'")
    parts: dict[str, Any] = {n: arrays[n] for n in (*_ARRAYS, *_LATER) if n in arrays}
    try:
        parts["meta"] = json.loads(str(arrays["meta"]))
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is no {_WHAT}: its 'meta' is no JSON") from None
    return _as_documented(_whole(Saved(**parts), path))


def _as_documented(saved: Saved) -> Saved:
    """The same numbers in the types of `Saved`, whichever another program wrote them in."""
    types: dict[str, Any] = {"f": np.float64, "i": np.int64, "b": np.bool_}
    read: dict[str, Any] = {}
    for name in (*_ARRAYS, *_LATER):
        array = getattr(saved, name)
        if name != "meta" and array is not None:
            read[name] = np.asarray(array, types[_KINDS.get(name, "f")[0]])
    return replace(saved, **read)


def _whole(saved: Saved, path: Path) -> Saved:
    """Check that the arrays read go together; else InputError."""
    shape = saved.position.shape
    k, n, dim = shape if len(shape) == 3 else (0, 0, 0)
    s = len(saved.spring) if saved.spring.ndim else 0
    wanted = {
        "frame": (k,), "time": (k,), "position": (k, n, dim), "velocity": (k, n, dim),
        "spring": (s, 2), "spring_alive": (k, s), "start": (n, dim), "fixed": (n,),
    }  # fmt: skip
    for name, there in wanted.items():
        array = getattr(saved, name)
        kinds = _KINDS.get(name, "iuf")
        if array is not None and (array.shape != there or array.dtype.kind not in kinds):
            found = f"{array.dtype} {array.shape}"
            raise InputError(f"{path}: is no {_WHAT}: its '{name}' is {found}")
    if s and not 0 <= saved.spring.min() <= saved.spring.max() < n:
        raise InputError(f"{path}: is no {_WHAT}: a spring's end is none of its {n} particles")
    if not isinstance(saved.meta, dict):
        raise InputError(f"{path}: is no {_WHAT}: its 'meta' is no object")
    return saved
