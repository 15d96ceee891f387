"""Interrupts that wait until a frame is whole: the state on the device, and what the host counts.

Python runs a signal's handler between any two of its instructions, and while a kernel runs none of
them: Ctrl-C nearly always comes between a launch and the line that counts its frames.
"""

from __future__ import annotations

# Those of `signal` make enums of what they return, which takes 15 us a frame.
import _signal  # type: ignore[import-not-found]
import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any

# What a handler raises for: Ctrl-C, an end that is asked for, a time that is over.
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK", "SIGALRM")
_NUMBERS = tuple(int(getattr(signal, name)) for name in _NAMES if hasattr(signal, name))


class HeldBack:
    """While the context lasts, what Python's handlers do for a signal waits for its end.

    A second signal waits no more, be it another one: who sends it will not. In threads but the main
    one there is nothing to do: handlers run in that.
    """

    def __enter__(self) -> None:
        # One object, by which it is known again.
        self._own: Callable[[int, FrameType | None], None] | None = self._note
        self._handlers: dict[int, Callable[[int, FrameType | None], Any]] = {}
        self._held: list[int] = []  # whose handlers are to be put back
        self._came: tuple[int, FrameType | None] | None = None
        if threading.current_thread() is not threading.main_thread():
            return
        try:
            for number in _NUMBERS:
                handler = _signal.getsignal(number)
                if callable(handler):
                    self._handlers[number] = handler
                    self._held.append(number)
                    _signal.signal(number, self._own)
        except BaseException:  # of a signal that is not held back yet
            self._put_back()
            raise

    def __exit__(self, *error: object) -> None:
        self._put_back()
        # Not kept, nor is this by its own method: a frame holds all that it works with, as long.
        (came, self._came), self._own = (self._came, None), None
        if came is not None:
            self._handlers[came[0]](*came)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self._came is None:
            self._came = number, frame
        else:
            came, self._came = self._came, None
            self._handlers[came[0]](*came)  # the first one first
            self._handlers[number](number, frame)

    def _put_back(self) -> None:
        """Have all handlers as they were, also where one of them raises meanwhile, which it may as
        soon as it is back. What was set in the context by somebody else stays.
        """
        try:
            while self._held:
                number = self._held[-1]
                if _signal.getsignal(number) is self._own:
                    _signal.signal(number, self._handlers[number])
                self._held.pop()
        finally:
            if self._held:
                self._put_back()
