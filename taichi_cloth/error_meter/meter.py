"""The error meter as the run sees it: it notes windows, and hands them to a process of its own."""

from __future__ import annotations

import math
import tempfile
import threading
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth import signals
from taichi_cloth.console import percent
from taichi_cloth.error_meter.ghost import Ghost
from taichi_cloth.error_meter.others import Trial
from taichi_cloth.error_meter.verdict import DIGITS, Verdict
from taichi_cloth.error_meter.window import (
    ENDS,
    FEW,
    FRAMES,
    GHOST,
    LEAST,
    LEAVES,
    STAGE,
    STRIDE,
    WAITING,
    WINDOW,
    Window,
)
from taichi_cloth.measuring.worker import Worker, WorkerFailed
from taichi_cloth.simulation.acts import Listener
from taichi_cloth.trade import reference

if TYPE_CHECKING:
    from taichi_cloth.scene.model import Scene
    from taichi_cloth.simulation.simulation import Simulation

JUDGE = "taichi_cloth.error_meter.judge:started"
NICE = 19  # of the process: the run goes first
PATIENCE = 10.0  # seconds that a window's references may take where the run goes on
SLOW = 3.0  # seconds: what takes longer says for how long it does
LONGEST_REST = 10.0  # seconds
TRAIL = 1200  # frames, of which a window goes back by half
MOST_LOST = 3  # processes that may end before no other one is started


class ErrorMeter(Listener):
    """Measures how wrong the last second of a simulation was, again and again.

    Each window begins anew from what the run shows, so it measures what a second adds, and not
    where chaos leads. Nothing of the run is changed. While the process is busy no window is noted.

    sim: which it listens to until `close`. waits: whether the run waits for each window's verdict;
    else it goes on. tell: called with each verdict, in another thread unless it waits.
    trials: says at the end of a window by which other steps and methods it is made again; None: by
    none. rests: for how many times as long as it judged a window it leaves the processor to the
    run, which has shorter frames then.
    verdicts: all of them; recent: those of the run as it is now: after a reset of none before, and
    where it went back and went another way, of none after that. ghost: of the last verdict that
    knows an error, while the run is the one it is of.
    """

    def __init__(
        self,
        sim: Simulation,
        *,
        waits: bool = False,
        tell: Callable[[Verdict], None] | None = None,
        patience: float | None = None,
    ) -> None:
        self._sim, self._waits, self._tell = sim, waits, tell
        self.trials: Callable[[], Sequence[Trial]] | None = None
        self.rests, self._rested = 0.0, 0.0  # and until when it rests
        self._patience = patience or (WAITING if waits else PATIENCE)
        self._folder = tempfile.TemporaryDirectory(prefix="taichi-cloth-error-")
        self._worker: Worker | None = None
        self._known: Scene | None = None  # what the process has
        self._task: threading.Thread | None = None
        self._window: Window | None = None
        self._closed, self._lost, self._asked = False, 0, 0
        self._cut, self._left = 0, 0  # windows that were too short; frames of the last at the end
        self.verdicts: list[Verdict] = []
        self.skipped = 0  # frames that were made while the process was busy
        self.waited = 0.0  # seconds that the run waited for verdicts
        self.recent: list[Verdict] = []
        self._judged: Window | None = None  # the last one, while the run is the one it is of
        self.ghost: Ghost | None = None
        self._haunts = False  # whether that one's ghost has who is who in the run by now
        self._trail: dict[int, int] = {}  # what was shown at each frame, by which it is known again
        self._lock = threading.Lock()  # of what is known of the run, which two threads change
        self.refused = _refusal(sim)
        if not self.refused:
            sim.listeners += (self,)
            self._open()

    @property
    def busy(self) -> bool:
        """True if a window is being judged."""
        return self._task is not None and self._task.is_alive()

    @property
    def resting(self) -> bool:
        """True if it leaves the processor to the run for a while."""
        return time.perf_counter() < self._rested

    @property
    def last(self) -> Verdict | None:
        """The latest verdict before what is shown; None: the run was elsewhere then, or none is."""
        shown = self.shown  # read once: the other thread may put a verdict in place of these
        return shown[-1] if shown else None

    @property
    def shown(self) -> list[Verdict]:
        """The recent verdicts up to the frame that is shown, where the run may have gone back."""
        return [verdict for verdict in self.recent if verdict.end <= self._sim.frame]

    @property
    def age(self) -> int:
        """The frames since the window of the last verdict ended."""
        last = self.last
        return 0 if last is None else self._sim.frame - last.end

    def progress(self) -> str:
        """Its state, in words."""
        window = self._window
        if not self.busy:
            if window:
                return f"frame {window.frames} of {FRAMES}"
            if self.resting:
                return "rests, for the frames' time"
            fixed = self._sim.fixed().all()
            return "nothing can move" if fixed else "begins with the next frame"
        with suppress(OSError):
            stage = Path(self._folder.name) / STAGE
            since = time.time() - stage.stat().st_mtime
            return stage.read_text() + (f": {since:.0f} s" if since >= SLOW else "")
        return "starting its process"

    # --- what the simulation tells ---------------------------------------------------------

    def before_act(self, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        """End the window before what is another run's."""
        if self._window is not None and name in ENDS:
            self._end(shown=name not in LEAVES)
        with self._lock:
            if name in LEAVES:
                self._forget()
            elif name == "remove":
                self.ghost, self._haunts = None, False

    def after_act(self, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        """Note what was done."""
        if name == "restore":
            if self._is_beyond():
                with self._lock:
                    self._forget()
            self._follow()
        elif self._window is not None:
            self._window.note_act(name, args, given)
        elif name in ENDS - LEAVES and not (self.busy or self.resting):
            self._open()  # so that the next frame counts, too

    def after_frame(self) -> None:
        """Note a frame; a whole window is handed on, and another one begins, once it is told."""
        self._follow()
        if self._window is not None:
            self._window.note_frame(self._sim)
        elif self.busy or self.resting:
            self.skipped += 1
        if not self._waits:
            self._turn()

    def between_frames(self) -> None:
        """Wait for the verdict of a whole window, where the run is to."""
        if self._waits:
            self._turn()

    def _turn(self) -> None:
        if self._window is not None and self._window.frames >= FRAMES:
            self._end()
        if self._window is None and not (self.busy or self.resting):
            self._open()

    def _forget(self) -> None:
        """Know nothing of the run, which is another one than was shown."""
        self.recent, self._judged, self.ghost, self._trail = [], None, None, {}

    def _is_beyond(self) -> bool:
        """True if the run is beyond all that it showed, as one is that was left by a reset, or
        where it went another way.
        """
        frame = self._sim.frame
        return frame - frame % self._stride > max(self._trail, default=frame)

    @property
    def _stride(self) -> int:
        return 1 if self._sim.particle_count <= FEW else STRIDE

    def _follow(self) -> None:
        """Note what is shown; where that was otherwise at this frame before, the run went back and
        goes another way: forget what is of the other one from here on.
        """
        frame, stride = self._sim.frame, self._stride
        if frame % stride:
            return
        shown = zlib.crc32(self._sim.drawn_positions().tobytes())
        if self._trail.get(frame, shown) != shown:
            self._trail = {at: seen for at, seen in self._trail.items() if at < frame}
            same = frame - stride  # beyond that it may have gone another way
            with self._lock:
                self.recent = [verdict for verdict in self.recent if verdict.end <= same]
                if self.ghost is not None and self.ghost.end > same:
                    self.ghost = None
                if self._judged is not None and self._judged.end > same:
                    self._judged = None
        self._trail[frame] = shown
        self._trail.pop(frame - TRAIL, None)

    def _open(self) -> None:
        """Begin a window, if there is anything that can move."""
        if not self.refused and not self._closed and not self._sim.fixed().all():
            self._window = Window.opened(self._sim)

    def _end(self, shown: bool = True) -> None:
        """Hand the window on, unless it is too short to say anything.

        shown: whether the run goes on from what it showed.
        """
        window, self._window = self._window, None
        if window is None or window.frames < LEAST:
            self._cut += window is not None and window.frames > 0
            return
        with self._lock:
            self._judged, self._haunts = window if shown else None, True
        self._asked += 1
        asked = window, self.trials() if self.trials else ()  # of the run as it is now
        if self._waits:
            begin = time.perf_counter()
            with signals.raising():  # which may take a minute
                self._judge(*asked)
            self.waited += time.perf_counter() - begin
        else:
            self._task = threading.Thread(target=self._judge, args=asked, daemon=True)
            self._task.start()

    # --- in a thread, unless the run waits -------------------------------------------------

    def _judge(self, window: Window, trials: Sequence[Trial]) -> None:
        """Ask the process: for the error, and then for what it comes from."""
        verdict, begin = None, time.perf_counter()
        try:
            verdict, ghost = self._ask(window, _finest(trials))
            if verdict.known:
                self._show(window, verdict)
                with self._lock:
                    if self._judged is window and self._haunts:
                        self.ghost = ghost
                verdict = self._ask_parts(trials)
        except (WorkerFailed, OSError) as failure:
            if not self._closed:
                self._lose_worker(str(failure))
            elif verdict is None:
                return
            verdict = verdict or Verdict(window.first, window.frames, trouble=str(failure))
        self._show(window, verdict)
        now = time.perf_counter()
        self._rested = now + min(self.rests * (now - begin), LONGEST_REST)
        self.verdicts.append(verdict)
        if self._tell and not self._closed:
            self._tell(verdict)

    def _lose_worker(self, why: str) -> None:
        """The process ended: there will be another one, unless it was the last of many."""
        self._give_up_worker()
        self._lost += 1
        if self._lost >= MOST_LOST:
            self.refused = f"its process failed {self._lost} times: {why}"

    def _show(self, window: Window, verdict: Verdict) -> None:
        """Have a verdict as the last one, in place of what was known of the same window before."""
        with self._lock:
            if self._judged is not window:
                return
            # Of a run that went back and came the same way again, windows may lie over each other.
            others = [v for v in self.recent if v.first != verdict.first and _apart(v, verdict)]
            self.recent = sorted([*others, verdict], key=lambda one: one.end)

    def _ask(self, window: Window, within: float) -> tuple[Verdict, Ghost | None]:
        """The error of a window, and its ghost. within: errors that are to be told by it, too."""
        folder = Path(self._folder.name)
        if self._worker is None:
            self._known = None
            self._worker = Worker(folder, {"OMP_NUM_THREADS": "1"}, niceness=NICE)
            if self._closed:  # by whom saw no process to end yet
                raise WorkerFailed("closed")
            threads = None if self._waits else 1
            self._worker.ask(make=JUDGE, **{"as": "judge", "with": {"threads": threads}})
        window.write(folder / WINDOW, self._known)
        self._known = window.start.snapshot.scene
        given = {"folder": str(folder), "patience": self._patience, "within": within}
        answer = self._worker.ask(of="judge", do="measure", **{"with": given})
        verdict = Verdict(**answer["result"])
        return verdict, Ghost.read(folder / GHOST, window) if verdict.known else None

    def _ask_parts(self, trials: Sequence[Trial]) -> Verdict:
        """The verdict on the window that was measured last, with what its error comes from."""
        assert self._worker is not None
        given = {"patience": self._patience, "trials": [asdict(trial) for trial in trials]}
        answer = self._worker.ask(of="judge", do="part", **{"with": given})
        return Verdict(**answer["result"])

    def _give_up_worker(self) -> None:
        if self._worker is not None:
            self._worker.close()
        self._worker = None

    # --- the end ---------------------------------------------------------------------------

    def close(self) -> None:
        """End the process, and listen no more. May be called twice."""
        self._closed = True
        others = (listener for listener in self._sim.listeners if listener is not self)
        self._sim.listeners = tuple(others)
        if self._window is not None:
            self._left, self._window = self._window.frames, None
        worker = self._worker
        if worker is not None:
            worker.kill()
        if self._task is not None:
            self._task.join()
        self._give_up_worker()
        with suppress(OSError):
            self._folder.cleanup()

    def summary(self) -> str:
        """The outcome of all verdicts, in a line."""
        if self.refused:
            return f"error: not measured: {self.refused}"
        known = [v.relative for v in self.verdicts if v.known and not v.resting]
        if not known:
            if any(verdict.known for verdict in self.verdicts):
                return "error: nothing moved"
            if self.verdicts:
                return f"error: no second was measured: {self.verdicts[-1].trouble}"
            if self._asked:
                return "error: not measured: it ended before the first second was made again"
            if self._left >= (LEAST if self._cut else 1):
                return (
                    f"error: not measured: it ended {self._left} frames into a second of {FRAMES}"
                )
            return f"error: not measured: no {LEAST} frames in a row in which anything can move"
        count = f"{len(known)} of {len(self.verdicts)} windows" if len(known) > 1 else "1 window"
        median, most = float(np.median(known)), max(known)
        sure = sum(v.known and not (v.resting or v.trouble) for v in self.verdicts)
        unsure = "" if sure == len(known) else f", {len(known) - sure} of them not sure"
        skipped = f"; {self.skipped} frames passed unmeasured" if self.skipped else ""
        return (
            f"error a second: {percent(median, DIGITS)} in the middle, "
            f"{percent(most, DIGITS)} at most, over "
            f"{count}{unsure}{skipped}"
        )


def _finest(trials: Sequence[Trial]) -> float:
    """The smallest error that trials are to be within, in parts of the motion."""
    return min((trial.within for trial in trials if trial.within is not None), default=math.inf)


def _apart(one: Verdict, other: Verdict) -> bool:
    """True if no frame is in the windows of both."""
    return one.end <= other.first or other.end <= one.first


def _refusal(sim: Simulation) -> str:
    """Why a scene cannot be measured; "": it can."""
    most = reference.SAMPLES // (FRAMES // STRIDE + 1) // sim.scene.world.dim
    if sim.particle_count > max(most, FEW):
        return f"the scene has {sim.particle_count} particles, and at most {most} can be followed"
    return ""
