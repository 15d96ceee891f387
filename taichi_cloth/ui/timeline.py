"""The last seconds of a run, frame by frame: to go back to, to go on from, and to export."""

from __future__ import annotations

import bisect
import time
from collections import Counter
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.files.exports import Export
from taichi_cloth.files.recordings import Recordings
from taichi_cloth.files.trajectory import Trajectory
from taichi_cloth.ui.interaction import LogEvent
from taichi_cloth.ui.schedule import FRAME_RATE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from taichi_cloth.simulation.checkpoint import Checkpoint
    from taichi_cloth.simulation.simulation import Simulation

SECONDS = 10.0  # of frames that are kept, at `FRAME_RATE`
MOST_BYTES = 256 << 20  # of checkpoints; beyond that only some frames have one


class Remembers(Protocol):
    """A window's memory of what was done, beside the simulation: `Controls`."""

    def memory(self) -> Any:
        """The state that later events depend on, as it is now."""

    def recall(self, memory: Any) -> None:
        """Go back to such a memory."""


@dataclass(frozen=True)
class _Kept:
    """A frame with the checkpoints of its runs, and what the window remembered then."""

    frame: int
    checkpoints: tuple[Checkpoint, ...]
    memory: Any

    def arrays(self) -> list[np.ndarray]:
        """The arrays of its checkpoints, some of which others share."""
        return [array for checkpoint in self.checkpoints for array in checkpoint.arrays()]


class Timeline:
    """Notes frames as they come, and goes back to any of the last ones, to the bit.

    Frames are counted as the interaction log counts them, over resets. A frame that has no
    checkpoint, because there is no room for all of them, is run again from the one before, with the
    events that came between.

    remembers: what is put back beside the simulation. rerun: advances the simulation by one frame,
    from the one of this number on, after doing its events; None: no frame can be run again, so that
    a run that takes more room reaches back less far.
    seconds, most_bytes: what is kept at most.
    spacing: seconds of work after which a frame that can be run again has a checkpoint all the
    same: it costs as much as drawing at 60 frames a second. clock: that tells these seconds.
    beside: another run, which goes along with the first, and goes back with it.

    at: the frame that was gone back to; None: the run is where it has come to.
    """

    def __init__(
        self,
        sim: Simulation,
        remembers: Remembers,
        rerun: Callable[[int, list[LogEvent]], None] | None,
        seconds: float = SECONDS,
        most_bytes: int = MOST_BYTES,
        spacing: float = 0.0,
        clock: Callable[[], float] = time.perf_counter,
        beside: Simulation | None = None,
    ) -> None:
        self._runs = (sim,) if beside is None else (sim, beside)
        self._sim, self._remembers, self._rerun = sim, remembers, rerun
        self._span, self._most = max(1, round(seconds * FRAME_RATE)), most_bytes
        self._spacing, self._clock = spacing if rerun else 0.0, clock
        self.at: int | None = None
        self.forget()

    def forget(self) -> None:
        """Keep nothing: the run is of another simulation, or begins."""
        self._kept: list[_Kept] = []
        self._events: dict[int, list[LogEvent]] = {}
        self._holders: Counter[int] = Counter()
        self._bytes, self._every = 0, 1
        self._last, self._held_at = 0, 0.0
        self._set: set[int] = set()
        self._present: _Kept | None = None
        self._untouched: tuple[Any, ...] = ()
        self.at = None

    # --- as the run goes on ----------------------------------------------------------------

    def note(self, frame: int) -> None:
        """Take note of the present frame, after it was advanced."""
        self._last = frame
        now = self._clock()
        due = frame % self._every == 0 and now - self._held_at >= self._spacing
        if due or not self._kept or frame in self._set:
            self._held_at = now
            self._hold(self._now(frame))
        while self._kept and frame - self._kept[0].frame > self._span and len(self._kept) > 1:
            self._drop(0)
        while self._bytes > self._most and len(self._kept) > 2:
            self._thin()

    def event(self, frame: int, event: LogEvent) -> None:
        """Take note of an event that came before `frame` was advanced."""
        self._events.setdefault(frame, []).append(event)
        if event.kind == "set":  # which may compile: the frame after it is not run again
            self._set.add(frame + 1)

    def _now(self, frame: int) -> _Kept:
        """The present frame, of this number."""
        checkpoints = tuple(sim.checkpoint() for sim in self._runs)
        return _Kept(frame, checkpoints, self._remembers.memory())

    def _restore(self, kept: _Kept) -> None:
        for sim, checkpoint in zip(self._runs, kept.checkpoints, strict=True):
            sim.restore(checkpoint)
        self._remembers.recall(kept.memory)

    def _hold(self, kept: _Kept) -> None:
        self._kept.append(kept)
        for array in kept.arrays():
            if self._holders[id(array)] == 0:
                self._bytes += array.nbytes
            self._holders[id(array)] += 1

    def _drop(self, at: int) -> None:
        dropped = self._kept.pop(at)
        for array in dropped.arrays():
            self._holders[id(array)] -= 1
            if self._holders[id(array)] == 0:
                del self._holders[id(array)]
                self._bytes -= array.nbytes
        if at == 0 and self._kept:
            first = self._kept[0].frame
            self._events = {f: events for f, events in self._events.items() if f >= first}
            self._set = {f for f in self._set if f >= first}

    def _thin(self) -> None:
        """Make room: every second checkpoint goes, or, where none can be done without, the oldest.

        Twice as many frames are then run again, so no more than an eighth of a second's.
        """
        if self._rerun is None or self._every >= FRAME_RATE / 8:
            self._drop(0)
            return
        self._every *= 2
        for at in range(len(self._kept) - 1, 0, -1):
            frame = self._kept[at].frame
            if frame % self._every and frame not in self._set:
                self._drop(at)

    @property
    def bytes(self) -> int:
        """The memory of the checkpoints; what two share counts once."""
        return self._bytes

    # --- back ------------------------------------------------------------------------------

    @property
    def frames(self) -> range:
        """The frames that one can go to, the present one included; empty: none."""
        return range(self._kept[0].frame, self._last + 1) if self._kept else range(0)

    @property
    def frame(self) -> int:
        """The frame that is seen."""
        return self._last if self.at is None else self.at

    def go(self, frame: int) -> int:
        """Go to a frame, or to the nearest one that is held; return which.

        At the last one the run is where it was left, with all that was done there since.
        """
        frames = self.frames
        if not frames:
            return self.frame
        frame = min(max(frame, frames[0]), frames[-1])
        if self.at is None and frame != self._last:
            self._present = self._now(self._last)
        if frame != self.frame:
            self._put_back(frame)
        return frame

    def back(self, count: int = 1) -> int:
        """Go back by so many frames, or on by a negative number of them; return where to."""
        return self.go(self.frame - count)

    def _put_back(self, frame: int) -> None:
        if frame == self._last and self._present is not None:
            kept, self.at, self._present = self._present, None, None
        else:
            place = bisect.bisect_right([kept.frame for kept in self._kept], frame) - 1
            kept, self.at = self._kept[place], frame
        self._restore(kept)
        for between in range(kept.frame, frame):
            assert self._rerun is not None  # else each frame has its checkpoint
            self._rerun(between, self._events.get(between, []))
        self.untouch()

    def untouch(self) -> None:
        """Have what was done to the state until now not count as touching it."""
        self._untouched = self._marks()

    @property
    def touched(self) -> bool:
        """True if the frame that was gone back to is no longer as it was: something was done."""
        return self.at is not None and self._marks() != self._untouched

    def _marks(self) -> tuple[Any, ...]:
        """Marks by which one sees that something was done to the state from outside."""
        storage = self._sim.storage
        return id(storage), storage.loads, storage.altered

    def branch(self) -> int | None:
        """Let the run go on from the frame that was gone back to: what came after is dropped.

        Returns that frame, from which on logs and recordings are to forget what they have, or None
        where the run is where it has come to.
        """
        frame, self.at, self._present = self.at, None, None
        if frame is None:
            return None
        while self._kept and self._kept[-1].frame > frame:
            self._drop(len(self._kept) - 1)
        self._events = {f: events for f, events in self._events.items() if f < frame}
        self._set = {f for f in self._set if f <= frame}
        self._last = frame
        return frame

    # --- export ----------------------------------------------------------------------------

    def export(self, path: str | Path, meta: Mapping[str, Any] | None = None) -> int:
        """Write the frames that are held to a file, and return how many; the run stays as it is.

        path: as for `run --export`; a file ``.npz`` is a trajectory, with `meta`. Of a run that was
        reset, the frames since. InputError where it cannot be written.
        """
        if not self.frames:
            raise InputError(f"{path}: there is no frame to export yet")
        whole = Path(path).suffix.lower() == ".npz"
        trajectory = Trajectory(path) if whole else None
        export = None if whole else Export(Path(path), self._sim.dt, scene=self._sim.scene)
        recordings = Recordings(trajectory, export)
        try:
            with self._visiting():
                for frame in self.frames:
                    self.go(frame)
                    recordings.record(self._sim, last=True)
        except BaseException:
            if trajectory:
                trajectory.discard()
            if export:
                export.discard()
            raise
        if trajectory:
            trajectory.save(dict(meta or {}))
        if export:
            export.save()
        return recordings.frames

    @contextmanager
    def _visiting(self) -> Iterator[None]:
        """Go where one likes meanwhile; then everything is as it was, also what was done there."""
        before = self.at, self._present, self._untouched
        here = self._now(self.frame)
        try:
            yield
        finally:
            self.at, self._present, self._untouched = before
            self._restore(here)


# --- slow motion -----------------------------------------------------------------------------

SPEEDS = (1, 2, 4, 8, 16)  # times as long as a frame is shown


class Pace:
    """The pace of frames: each is shown for `slowness` times as long; no step is changed.

    A picture between two frames may be drawn: `part` says how far on it is.
    """

    def __init__(self) -> None:
        self.slowness = SPEEDS[0]
        self._shown = 0

    @property
    def words(self) -> str:
        """A window's words on it; "" at full speed."""
        return "" if self.slowness == 1 else f"1/{self.slowness} speed"

    def slower(self) -> None:
        """Half as fast, down to the slowest."""
        self._set(min(self.slowness * 2, SPEEDS[-1]))

    def faster(self) -> None:
        """Twice as fast, up to full speed."""
        self._set(max(self.slowness // 2, SPEEDS[0]))

    def full(self) -> None:
        """At full speed again."""
        self._set(SPEEDS[0])

    def _set(self, slowness: int) -> None:
        # The picture stays where it is between two frames.
        self.slowness, self._shown = slowness, self._shown * slowness // self.slowness

    def turn(self) -> bool:
        """True if the next frame is due in this turn of a window, sixty of which are a second."""
        self._shown += 1
        if self._shown < self.slowness:
            return False
        self._shown = 0
        return True

    @property
    def part(self) -> float:
        """The place of this turn's picture between two frames, from 0 to below 1.

        A window in slow motion shows the frame before the last one, and this part of the way on to
        the last one (`between.py`): what comes next is not known.
        """
        return self._shown / self.slowness
