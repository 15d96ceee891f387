"""A sweep in the time that one has: when it has to end, and what still fits until then."""

from __future__ import annotations

import contextlib
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from types import FrameType

from taichi_cloth.errors import InputError, clipped, counted
from taichi_cloth.settings.parameters import positive

SHORT = 120.0  # seconds: where there are fewer, less is asked for from the start
QUICK = 60.0  # seconds that --quick stands for
LEAST, MOST = 5.0, 7 * 24 * 3600.0  # seconds that may be asked for
UNITS = {"min": 60.0, "h": 3600.0, "s": 1.0}
ENDING = 0.06  # of the time, and seconds, that a sweep keeps for its files, table and plots
ENDING_SECONDS = 2.0
MOST_TOLD = 12  # lines of what was left out


class TimeIsUp(KeyboardInterrupt):
    """A sweep's time is over: what is on its way is interrupted, as by Ctrl-C."""


class Clock:
    """The time of a sweep, which begins now; a sweep with no limit of its time has one, too.

    seconds: together; inf: as long as it takes. now: tells the time, in seconds.
    """

    def __init__(self, seconds: float = math.inf, now: Callable[[], float] = time.monotonic):
        self.seconds, self._now = seconds, now
        self._began = now()
        self._end = seconds - max(ENDING_SECONDS, ENDING * seconds) if self.limited else seconds

    @property
    def limited(self) -> bool:
        """True if it ends."""
        return math.isfinite(self.seconds)

    @property
    def short(self) -> bool:
        """True if less is to be asked for from the start."""
        return self.seconds < SHORT

    def left(self) -> float:
        """Seconds until nothing more is to be measured; below zero past that."""
        return self._end - (self._now() - self._began)

    def part(self, share: float) -> Clock:
        """The same, whose measuring ends after a share of its time."""
        part = Clock(self.seconds, self._now)
        part._began, part._end = self._began, min(self._end, share * self.seconds)
        return part

    def describe(self) -> str:
        """Its length: '60 s'."""
        return f"{self.seconds:g} s"


@contextlib.contextmanager
def ending(clock: Clock) -> Iterator[None]:
    """As long as the context lasts, raise TimeIsUp in this thread at the clock's end, whatever it
    waits for.

    Only the main thread can be interrupted, and only where the system has a timer: elsewhere a
    sweep has to look at its clock.
    """
    main = threading.current_thread() is threading.main_thread()
    if not (clock.limited and main and hasattr(signal, "setitimer")):
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise TimeIsUp

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, max(clock.left(), 1e-3))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def said_of_left_out(clock: Clock, lines: Sequence[str]) -> list[str]:
    """The parts that did not fit in the time; none where it is as long as it takes."""
    if not clock.limited:
        return []
    if not lines:
        return [f"nothing was left out: all of it fits in {clock.describe()}"]
    said = [f"left out, as it does not fit in {clock.describe()} (--within gives more time):"]
    said += [f"  {line}" for line in lines[:MOST_TOLD]]
    more = len(lines) - MOST_TOLD
    return said + [f"  and {counted(more, 'line')} more"] * (more > 0)


def clock(within: str | None, quick: bool = False) -> Clock:
    """The clock that a command's settings ask for; raises InputError for words that are no time."""
    if within is None:
        return Clock(QUICK) if quick else Clock()
    if quick:
        raise InputError(f"--quick means --within {QUICK:g}s: give one of them")
    return Clock(seconds_of(within))


def seconds_of(within: str) -> float:
    """The seconds that '60s', '5min' or '2h' stand for."""
    text = within.strip()
    unit = next((unit for unit in UNITS if text.endswith(unit)), None)
    says = "a time with its unit, s, min or h, such as 60s"
    if unit is None:
        raise InputError(f"--within must be {says}; is '{clipped(within)}'")
    seconds = positive("--within", text.removesuffix(unit), says, within) * UNITS[unit]
    if not LEAST <= seconds <= MOST:
        raise InputError(f"--within must be {LEAST:g}s to 7 days, is '{clipped(within)}'")
    return seconds


def rounded_up(seconds: float) -> str:
    """A time that is enough, as --within takes it: '40s', '3min'."""
    if seconds <= 90:
        return f"{10 * math.ceil(seconds / 10)}s"
    return f"{math.ceil(seconds / 60)}min"
