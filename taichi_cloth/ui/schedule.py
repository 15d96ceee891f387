"""When a window is drawn: sixty times a second, and seldom while nothing moves in it."""

from __future__ import annotations

import time

FRAME_RATE = 60.0  # frames a second that count as real time
# A window in which nothing moves: seconds after the last event until it sleeps, between its
# pictures then (what was before it may have gone), and between looks at what the user does.
AWAKE, ASLEEP, POLLED = 1.0, 1.0, 1 / 30


class Schedule:
    """When the next turn of a window is due, and whether it is to be drawn in this one.

    waited, waited_in_all: seconds, before the present turn, and before all until now.
    """

    def __init__(self) -> None:
        self.waited = self.waited_in_all = 0.0
        self._next = 0.0
        self._awake_until = self._drawn_at = 0.0
        self._drawn_size = (0, 0)

    def wake(self) -> None:
        """The user did something: draw each turn for a while."""
        self._awake_until = time.perf_counter() + AWAKE

    def draws(self, moved: bool, size: tuple[int, int]) -> bool:
        """True if the window, of this size, is to be drawn: where nothing `moved`, now and then."""
        now = time.perf_counter()
        if moved or size != self._drawn_size:
            self._awake_until = now + AWAKE
        elif self._awake_until < now <= self._drawn_at + ASLEEP:
            return False
        self._drawn_at, self._drawn_size = now, size
        return True

    def wait(self, stopped: bool) -> None:
        """Sleep until the next turn is due; what is a frame late or more moves the schedule.

        stopped: whether the scene stands still.
        """
        asleep = stopped and time.perf_counter() > self._awake_until
        period = POLLED if asleep else 1 / FRAME_RATE
        now = time.perf_counter()
        self.waited = max(self._next - now, 0.0)
        if self.waited > 0.0:
            time.sleep(self.waited)
            self.waited_in_all += self.waited
        elif now - self._next > period:
            self._next = now
        self._next += period
