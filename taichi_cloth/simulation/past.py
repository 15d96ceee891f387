"""The past of a run: its begin, the acts since, and a few states on the way.

It is what a post-mortem makes the run again from. Acts cost what it takes to pickle their
arguments; checkpoints are those that others make anyway, such as a window's timeline, and where
nobody does, as many as fit into a hundredth of the time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from taichi_cloth.errors import SimulationFailure
from taichi_cloth.simulation.acts import noted

SPAN = 120  # frames before the present one that the ring reaches back, at least
APART = 15  # frames between its checkpoints, at least
MOST_BYTES = 64 << 20  # of checkpoints; of larger states there are two
MOST_OF_ACTS = 16 << 20
SOON = 10.0  # seconds, within which a run is quickly made again from its start
SHARE = 0.01  # of the time, that checkpoints made for the ring alone may take
# Acts that make another run of it, from the start of its scene or from a checkpoint.
BEGIN = frozenset(("reset", "load_scene", "restore"))


@dataclass(frozen=True)
class Settings:
    """The settings of a run: the method, the time of a frame, its steps, the solver's numbers.

    follows: whether it chooses the steps itself (`dt="auto"`); then substeps are those of the time.
    """

    method: str
    dt: float
    substeps: int
    solver: Mapping[str, float] = field(default_factory=dict)
    follows: bool = False

    @classmethod
    def of(cls, sim: Any) -> Settings:
        """Those that a simulation has now."""
        return cls(sim.method, sim.dt, sim.substeps, dict(sim.solver), sim.follows)


@dataclass(frozen=True)
class Place:
    """Somewhere a run can be made again from.

    frame: how many frames it had done there. acts: how many acts had been told by then. checkpoint:
    the `Checkpoint` of it; None: it is the start of the scene. settings: of then.
    """

    frame: int
    acts: int
    checkpoint: Any
    settings: Settings


class Past:
    """Takes note of a `Simulation` for its post-mortem. Nothing of the run is changed.

    keeps: whether it sees to checkpoints itself, where nobody else makes any. clock: that tells
    what they cost.

    failure: with which the last frame ended; None: it did not fail. acts: what was done, as bytes
    (`acts.noted`), each with the number of frames done by then. whole: whether they are all there
    since the origin.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.keeps, self._clock = False, clock
        self.failure: SimulationFailure | None = None
        self.acts: list[tuple[int, bytes]] = []
        self.origin: Place | None = None
        self.ring: list[Place] = []
        self._bytes, self._dropped = 0, 0
        self._next, self._compiled = math.inf, False

    @property
    def whole(self) -> bool:
        """True if the run can be made again from its origin."""
        return self.origin is not None

    # --- as the run goes on ----------------------------------------------------------------

    def begin(self, sim: Any, checkpoint: Any = None) -> None:
        """The run begins at the start of its scene, or at a checkpoint."""
        self.acts, self._bytes, self._dropped = [], 0, 0
        self.failure, self._next = None, self._clock() + SOON
        self.origin = Place(sim.frame, 0, checkpoint, Settings.of(sim))
        self.ring = [self.origin] if checkpoint is not None else []

    def forget(self) -> None:
        """The run begins somewhere that cannot be gone back to."""
        self.acts, self.ring, self.origin, self.failure = [], [], None, None
        self._bytes = self._dropped = 0

    def act(self, frame: int, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        """Something is about to be done to the run."""
        if self.origin is None and not self.ring or name in BEGIN:
            return
        told = noted(name, args, given)
        if told is None or self._bytes + len(told) > MOST_OF_ACTS:
            self._lose()
            return
        self._bytes += len(told)
        self.acts.append((frame, told))

    def acted(self, sim: Any, name: str, args: tuple[Any, ...], given: Mapping[str, Any]) -> None:
        """It was done."""
        if name in BEGIN:
            self.begin(sim, [*args, *given.values()][0] if name == "restore" else None)

    def _lose(self) -> None:
        """Forget what came before: places begin anew with the next checkpoint."""
        self.acts, self._bytes, self._dropped = [], 0, 0
        self.origin, self.ring = None, []

    def after_frames(self, sim: Any) -> None:
        """Frames were made: make a checkpoint if one is due."""
        self.failure = None
        if not self.keeps or not self._wants(sim.frame):
            return
        now = self._clock()
        if now < self._next:
            return
        first = not self._compiled
        sim.checkpoint()  # which offers itself
        self._compiled = True
        self._next = self._clock() + (0.0 if first else self._clock() - now) / SHARE

    def _wants(self, frame: int) -> bool:
        last = self.ring[-1] if self.ring else self.origin
        return last is None or frame - last.frame >= APART

    def offer(self, sim: Any, checkpoint: Any) -> None:
        """Somebody made a checkpoint of the present frame."""
        if not self._wants(sim.frame):
            return
        acts = len(self.acts) + self._dropped
        self.ring.append(Place(sim.frame, acts, checkpoint, Settings.of(sim)))
        while len(self.ring) > 2 and (
            sim.frame - self.ring[1].frame >= SPAN or _bytes(self.ring) > MOST_BYTES
        ):
            self.ring.pop(0)
        if self.origin is None:
            self._drop_acts()

    def _drop_acts(self) -> None:
        """Let go of what came before the first place."""
        before = self.ring[0].acts - self._dropped
        self._bytes -= sum(len(told) for _, told in self.acts[:before])
        self.acts, self._dropped = self.acts[before:], self.ring[0].acts

    # --- back ------------------------------------------------------------------------------

    def acts_since(self, place: Place) -> dict[int, list[bytes]]:
        """Acts since a place, by the number of frames done before them."""
        found: dict[int, list[bytes]] = {}
        for frame, told in self.acts[place.acts - self._dropped :]:
            found.setdefault(frame, []).append(told)
        return found

    def places(self) -> list[Place]:
        """Places from which the run can be made again, the earliest first."""
        ring = [place for place in self.ring if place is not self.origin]
        return [self.origin, *ring] if self.origin is not None else ring

    @contextmanager
    def resting(self, sim: Any) -> Iterator[None]:
        """Go where one likes meanwhile; then the run is as it was, to the bit, and so is this."""
        listeners, sim.past, sim.listeners = sim.listeners, None, ()
        here = sim.checkpoint()
        try:
            yield
        finally:
            sim.restore(here)
            sim.past, sim.listeners = self, listeners


def _bytes(ring: list[Place]) -> int:
    """The memory of the checkpoints of some places; what they share counts once."""
    held = {id(a): a.nbytes for p in ring if p.checkpoint for a in p.checkpoint.arrays()}
    return sum(held.values())


def go_to(sim: Any, place: Place, settings: Settings | None = None) -> None:
    """Put a simulation at a place of its past, with the settings of then or others."""
    if place.checkpoint is None or not place.checkpoint.is_of(sim):  # whose method it needs
        sim.set_method(place.settings.method)
    if place.checkpoint is not None:
        sim.restore(place.checkpoint)
    else:
        sim.reset()
    set_to(sim, settings or place.settings)


def set_to(sim: Any, wanted: Settings) -> None:
    """Have a simulation go on with other settings; the step of one that chooses it stays so."""
    sim.set_method(wanted.method)
    solver = {name: value for name, value in wanted.solver.items() if name in sim.solver}
    if solver:
        sim.set_solver(**solver)
    if not sim.follows:
        sim.set_step(wanted.dt, wanted.substeps)
