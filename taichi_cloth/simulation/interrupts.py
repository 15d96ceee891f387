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

    A second one of the same kind waits no more: who sends it will not. In threads but the main one
    there is nothing to do: handlers run in that.
    """

    def __enter__(self) -> None:
        self._handlers: dict[int, Callable[[int, FrameType | None], Any]] = {}
        self._held: list[int] = []  # whose handlers are to be put back
        self._came: list[int] = []
        if threading.current_thread() is not threading.main_thread():
            return
        try:
            for number in _NUMBERS:
                handler = _signal.getsignal(number)
                if callable(handler):
                    self._handlers[number] = handler
                    self._held.append(number)
                    _signal.signal(number, self._note)
        except BaseException:  # of a signal that is not held back yet
            self._put_back()
            raise

    def __exit__(self, *error: object) -> None:
        self._put_back()
        while self._came:
            number = self._came.pop()
            self._handlers[number](number, None)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if number in self._came:
            self._handlers[number](number, frame)
        else:
            self._came.append(number)

    def _put_back(self) -> None:
        """Have all handlers as they were, also where one of them raises meanwhile."""
        try:
            while self._held:
                number = self._held.pop()
                _signal.signal(number, self._handlers[number])
        finally:
            if self._held:
                self._put_back()
