"""The state of a run in a view: what it does or waits for, and a window's word for that."""

from __future__ import annotations

from dataclasses import dataclass, field

from taichi_cloth.errors import SimulationFailure
from taichi_cloth.render import style
from taichi_cloth.ui.summary import Refused
from taichi_cloth.ui.text import Word
from taichi_cloth.ui.timeline import Pace


@dataclass
class RunState:
    """The state of a run.

    paused: whether frames wait for the user. log_end: the last frame for which the log that is
    replayed has an event; -1: there is none. frames: advanced so far, counted over resets.
    step: whether one frame is due although the run is paused. pace: how slow the motion is.
    quit: whether the user ended it. left: whether another scene goes on in the window.
    compiling: whether a window stands still for a compiler. opening: the name of the scene that is
    made ready ("": none). exporting: whether it stands still while the last seconds are written.
    refused: events of the log that the simulation refused. failure: for which a window stands still
    until r. examining: what is being found out of it ("": nothing).
    """

    paused: bool = False
    log_end: int = -1
    frames: int = 0
    step: bool = False
    quit: bool = False
    left: bool = False
    compiling: bool = False
    opening: str = ""
    exporting: bool = False
    refused: Refused = field(default_factory=Refused)
    failure: SimulationFailure | None = None
    examining: str = ""
    pace: Pace = field(default_factory=Pace)

    @property
    def replaying(self) -> bool:
        """True if the log still has events for this frame or a later one."""
        return self.frames <= self.log_end

    @property
    def stopped(self) -> bool:
        """True if no frame comes by itself."""
        return self.paused or self.failure is not None

    def due(self) -> bool:
        """True if this turn advances a frame, of those that slow motion spaces out; ask once."""
        due = self.step or (not self.paused and self.pace.turn())
        self.step = False
        return due and self.failure is None

    def word(self, recording: str | None) -> Word:
        """A window's word for it; recording: its words while a film is being made."""
        if self.opening:
            return Word(f"opening {self.opening}: compiling takes a moment, once", style.WARN)
        if self.exporting:
            return Word("exporting the last 10 seconds, the window waits", style.WARN)
        if self.failure is not None:
            return Word(f"stopped: {self.examining}" if self.examining else "stopped", style.BAD)
        if recording is not None:
            # Seen beside any notice, however long that is.
            return Word(recording + (", paused" if self.paused else ""), style.RECORDING, -1)
        if self.frames == 0 and (self.compiling or not self.paused):
            return Word("starting: compiling takes a moment, once", style.WARN)
        if self.compiling:
            return Word("compiling, the window waits", style.WARN)
        if self.paused:
            return Word("paused", style.WARN)
        state = "replaying" if self.replaying else "playing"
        return Word(", ".join(filter(None, (state, self.pace.words))), style.GOOD)
