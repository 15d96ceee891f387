"""The distance of two runs that go along with each other, and their first difference."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.comparison.compare import Event
from taichi_cloth.comparison.touches import Contacts
from taichi_cloth.trade import errors
from taichi_cloth.trade.errors import Distance, Samples

if TYPE_CHECKING:
    from taichi_cloth.scene.penetration import Moment
    from taichi_cloth.simulation.simulation import Simulation

DEAR = 3e-3  # seconds that looking for touches may take in a window's quickest frame
LOOKED = 10  # frames after which that is asked
PATIENCE = 600  # frames in which one waits for a touch in the other run, too
KEPT = 1200  # frames that are known: those of the graph, also where one goes back by as many


@dataclass(frozen=True)
class Apart:
    """The distance of two runs at the end of a frame.

    frame, time: which. rms, max: root of the mean square, and largest, distance of a free particle
    [length]; farthest: the particle of the latter. count: how many are measured. scale: what parts
    are of, the largest displacement of a particle in the second run so far [length]. mark: what
    tells whether a frame that is made again is the same. squares, counts, most: over all frames up
    to it, the sums of rms² x count and of count, and the largest max.
    """

    frame: int
    time: float
    rms: float
    max: float
    farthest: int
    count: int
    scale: float
    mark: tuple[float, ...]
    squares: float = 0.0
    counts: int = 0
    most: float = 0.0

    def after(self, before: Apart | None) -> Apart:
        """The same with what is over all frames, which that of the frame before has so far."""
        squares, counts = self.rms**2 * self.count, self.count
        if before is None:
            return replace(self, squares=squares, counts=counts, most=self.max)
        return replace(
            self,
            scale=max(self.scale, before.scale),
            squares=before.squares + squares,
            counts=before.counts + counts,
            most=max(before.most, self.max),
        )


class Watch:
    """Measures two runs after each frame, by the definitions of `compare`: B is the second.

    Frames that are made again, since one goes back in time, are known already; where they are
    others, what came after is forgotten. Of the latest `KEPT` frames each is known, of those before
    what they come to. touches_unknown: why nobody looks for touches; "": one
    does. paced: whether that may take but little of each frame.
    """

    def __init__(self, first: Simulation, second: Simulation, paced: bool = False) -> None:
        self._runs, self.paced = (first, second), paced
        self.restart()

    def restart(self) -> None:
        """Begin anew, where the runs are: at the start of the scene, or of the run."""
        scenes, second = [sim.scene for sim in self._runs], self._runs[1]
        self._start = second.positions() if second.frame else scenes[1].particles.position.copy()
        self._fixed = scenes[0].particles.fixed & scenes[1].particles.fixed
        self._rows: dict[int, Apart] = {}
        self._last = 0  # the latest frame of these
        self._box = _box(self._start)
        self._break: Event | None = None
        self._touch: Event | None = None
        self._broke_at = self._touched_at = self._touch_code = 0  # the frames of these; what
        things: list[str] = []
        self._contacts = [Contacts(scene, things) for scene in scenes]
        self._first_frame: list[dict[int, int]] = [{}, {}]  # of each touch, in each run
        self._before: tuple[int, list[Moment]] | None = None
        self._looked, self._least, self.touches_unknown = 0, np.inf, ""
        self._held: list[tuple[np.ndarray, np.ndarray] | None] = [None, None]
        self._look_for_touches(self.frame, [sim.positions() for sim in self._runs])

    # --- what there is to say --------------------------------------------------------------

    @property
    def frame(self) -> int:
        """That of the runs now; one that stands still is behind."""
        return self._runs[0].frame

    @property
    def now(self) -> Apart | None:
        """Their distance now; None: at their start, or one of them stands still."""
        return self._rows.get(self.frame)

    @property
    def _latest(self) -> Apart | None:
        """That of the latest frame that both have made."""
        return self._rows.get(min(sim.frame for sim in self._runs))

    def last(self, frames: int) -> list[Apart]:
        """The frames up to now, the oldest first, at most so many, and `KEPT`."""
        wanted = range(max(self.frame - frames, 0) + 1, self.frame + 1)
        return [self._rows[frame] for frame in wanted if frame in self._rows]

    @property
    def scale(self) -> float:
        """The scale of parts [length]: the largest displacement in the second run, or its box."""
        last = self._latest
        return last.scale if last and last.scale > 0 else self._diagonal()

    @property
    def scale_is(self) -> str:
        """Its words."""
        last = self._latest
        moved = last is not None and last.scale > 0
        return "the largest displacement" if moved else "the world's diagonal, as nothing moves"

    def distance(self) -> Distance:
        """The distance over all frames up to now, as `trade` has it."""
        row = self._latest
        if row is None:
            return Distance(0.0, 0.0, 0.0, 0.0)
        return Distance(row.rms, row.max, (row.squares / max(row.counts, 1)) ** 0.5, row.most)

    @property
    def first_break(self) -> Event | None:
        """The first break that the two do not share, as far as is known now."""
        return self._break if self._broke_at <= self.frame else None

    @property
    def first_touch(self) -> Event | None:
        """The same of touches."""
        return self._touch if self._touched_at <= self.frame else None

    @property
    def first(self) -> Event | None:
        """The first of both."""
        found = [event for event in (self.first_break, self.first_touch) if event]
        return min(found, key=lambda event: event.time, default=None)

    def _grow_box(self, y: np.ndarray) -> None:
        """Have room for points (n, dim) in the box, which parts are of where nothing moves."""
        if len(y):
            (low, high), (now_low, now_high) = self._box, _box(y)
            self._box = np.fmin(low, now_low), np.fmax(high, now_high)

    def _diagonal(self) -> float:
        low, high = self._box
        return float(np.nan_to_num(np.linalg.norm(high - low))) or 1.0

    # --- after each frame ------------------------------------------------------------------

    def note(self) -> None:
        """Measure the frame that both have made."""
        places = [sim.positions() for sim in self._runs]
        alive = [self._holding(run) for run in (0, 1)]
        row = self._measured(places, alive)
        known = self._rows.get(row.frame)
        if known is not None and known.mark == row.mark:
            if not self._touches_over(row.frame):
                self._remember_moments(places)
            return
        before = self._rows.get(row.frame - 1)
        if row.frame <= self._last:
            self._forget(row.frame)
        elif self._rows and before is None:  # it went elsewhere, to before a reset
            self.restart()
        row = row.after(before)
        if row.scale == 0:
            self._grow_box(places[1])
        self._rows[row.frame], self._last = row, row.frame
        self._rows.pop(row.frame - KEPT, None)
        self._look_for_breaks(row, alive)
        self._look_for_touches(row.frame, places)

    def _holding(self, run: int) -> np.ndarray:
        """Which springs of a run hold, (s,) bool: read anew where that changed."""
        segments, known = self._runs[run].drawn_springs(), self._held[run]
        if known is None or known[0] is not segments:
            known = self._held[run] = segments, self._runs[run].springs_alive()
        return known[1]

    def _measured(self, places: list[np.ndarray], alive: list[np.ndarray]) -> Apart:
        """The distances of both as they are now; alive: which springs of each hold."""
        (x, y), first = places, self._runs[0]
        if len(y) > len(self._start):  # those that came: they begin where they are seen first
            self._start = np.concatenate([self._start, y[len(self._start) :]])
        free = np.ones(len(y), bool)
        free[: len(self._fixed)] = ~self._fixed
        a, b = (_samples(points[None]) for points in (x, y))
        square = errors.squares(a, b, free)[0]
        rms, largest = errors.at_once(square)
        _, moved = errors.at_once(errors.squares(_samples(self._start[None, : len(y)]), b, free))
        there = ~np.isnan(square)
        return Apart(
            frame=first.frame, time=first.time, rms=rms, max=largest,
            farthest=int(np.flatnonzero(free)[np.nanargmax(square)]) if there.any() else 0,
            count=int(np.count_nonzero(there)), scale=moved,
            mark=(float(x.sum()), float(y.sum()), *(float(held.sum()) for held in alive)),
        )  # fmt: skip

    def _forget(self, frame: int) -> None:
        """Forget what is known of a frame and of those after it."""
        for later in [known for known in self._rows if known >= frame]:
            del self._rows[later]
        if self._break and self._broke_at >= frame:
            self._break = None
        if self._touch and self._touched_at >= frame:
            self._touch = None
        self._first_frame = [
            {code: at for code, at in seen.items() if at < frame} for seen in self._first_frame
        ]

    def _look_for_breaks(self, row: Apart, alive: list[np.ndarray]) -> None:
        a, b = alive
        found = self._break
        if found is not None and found.spring is not None:
            broken = not a[found.spring], not b[found.spring]
            self._break = _completed(found, broken, row.time)
            return
        differ = np.flatnonzero(a != b)
        if len(differ):
            spring = int(differ[0])
            ends = tuple(map(int, self._runs[0].springs()[spring]))
            of_a, of_b = (None if held[spring] else row.time for held in alive)
            self._break = Event("break", ends, spring, "", of_a, of_b, len(differ) - 1)
            self._broke_at = row.frame

    def _touches_over(self, frame: int) -> bool:
        """True if nobody looks for touches any more."""
        found = self._touch is not None and (
            None not in (self._touch.a, self._touch.b) or frame > self._touched_at + PATIENCE
        )
        none = not any(contacts.possible for contacts in self._contacts)
        return found or none or bool(self.touches_unknown)

    def _look_for_touches(self, frame: int, places: list[np.ndarray]) -> None:
        if self._touches_over(frame):
            return
        begin = time.perf_counter()
        before = self._before
        moments = self._remember_moments(places)
        earlier = before[1] if before and before[0] == frame - 1 else [None, None]
        codes = [
            contacts.codes(now, then)
            for contacts, now, then in zip(self._contacts, moments, earlier, strict=True)
        ]
        for seen, now in zip(self._first_frame, codes, strict=True):
            for code in now.tolist():
                seen.setdefault(code, frame)
        self._compare_touches(frame)
        self._looked += 1
        self._least = min(self._least, time.perf_counter() - begin)
        if self.paced and self._looked == LOOKED and self._least > DEAR:
            cost = f"{1e3 * self._least:.0f} ms a frame"
            self.touches_unknown = f"looking for touches would take {cost}"

    def _remember_moments(self, places: list[np.ndarray]) -> list[Moment]:
        moments = [
            contacts.moment(x, sim.velocities(), sim.time)
            for contacts, x, sim in zip(self._contacts, places, self._runs, strict=True)
        ]
        self._before = self.frame, moments
        return moments

    def _compare_touches(self, frame: int) -> None:
        a, b = self._first_frame
        found, when = self._touch, self._runs[0].time
        if found is not None:
            code = self._touch_code
            self._touch = _completed(found, (code in a, code in b), when)
            return
        apart = sorted(a.keys() ^ b.keys())
        if not apart:
            return
        self._touch_code = code = apart[0]
        particle, thing = self._contacts[0].words(code)
        whom = thing.removeprefix("particle ")
        others = (int(whom),) if whom != thing else ()
        of_a, of_b = (when if code in seen else None for seen in (a, b))
        who = (particle, *others)
        self._touch = Event("touch", who, None, thing, of_a, of_b, len(apart) - 1)
        self._touched_at = frame


def _samples(x: np.ndarray) -> Samples:
    """Positions (k, n, dim) as samples whose motion and springs nobody asks for."""
    return Samples(x, x, np.zeros((len(x), 0), bool))


def _box(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The corners of the box around points (n, dim); of none, where none can be."""
    if not len(x):
        return np.full(x.shape[1], np.nan), np.full(x.shape[1], np.nan)
    return x.min(axis=0), x.max(axis=0)


def _completed(event: Event, there: tuple[bool, bool], time: float) -> Event:
    """An event with the time of a run that has it only now."""
    a = time if event.a is None and there[0] else event.a
    b = time if event.b is None and there[1] else event.b
    return replace(event, a=a, b=b)
