"""Signals that end a program: noted when they come, and obeyed at places of the program's own.

Python runs a signal's handler between any two instructions, so one that raises does so within
libraries, too: in the middle of an import, of a callback of C, or of a file's header. Here the
handler of the first signal only notes it; `check` raises for it where all is in order. The second
one ends the process at once.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import NoReturn

# Ctrl-C, an end that is asked for, a terminal that is closed: where there are such.
NUMBERS = tuple(
    int(getattr(signal, name)) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


class Ended(KeyboardInterrupt):
    """A signal came that ends the program; its number is the first argument.

    Of a plain KeyboardInterrupt that meets an `exec`, as libraries have it, Python keeps that it
    has to end by SIGINT, whatever it is told later.
    """


class Ending:
    """The signals that came since `taken` took them, and what they do.

    came: their numbers, the first one first. said: whether the user was told of it.
    """

    def __init__(self, line: str, clear: Callable[[], None]) -> None:
        """line: what standard error is told before the program ends at once, unless `tell` told it.
        clear: called before that.
        """
        self.came: list[int] = []
        self.said = self.raises = False
        self._busy = False  # tells the user, or ends
        self._line, self._clear = f"{line}\n".encode(), clear
        # A handler may come while a stream of Python's is in use, or while descriptor 2 leads
        # nowhere, as it does while a library is to be silent.
        self._error = os.dup(2)
        self._numbers = [n for n in NUMBERS if signal.getsignal(n) is not signal.SIG_IGN]  # nohup
        self._before = {n: signal.getsignal(n) for n in self._numbers}
        # Of several that wait for Python to handle them it would take the least number first. The
        # system's own handler writes them here as they come.
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._reader, False)
        os.set_blocking(self._writer, False)
        self._woken = signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
        for number in self._numbers:
            signal.signal(number, self._handle)
        self._restart(True)

    def give_back(self) -> None:
        """Have the handlers as they were."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._woken)
        for descriptor in (self._reader, self._writer, self._error):
            os.close(descriptor)

    def ignore(self) -> None:
        """Pass over what still comes: Python, which ends, would put the system's handlers back."""
        for number in self._numbers:
            signal.signal(number, signal.SIG_IGN)

    def tell(self, tell: Callable[[], None]) -> None:
        """Tell the user, once; a second signal that comes meanwhile waits for it."""
        if not self.said:
            self._busy = True
            tell()
            self.said, self._busy = True, False
            if len(self.came) > 1:
                self._end_now()

    def check(self) -> None:
        """Raise Ended where a signal came."""
        if self.came:
            raise Ended(self.came[0])

    @contextlib.contextmanager
    def raising(self) -> Iterator[None]:
        """While it lasts, the first signal raises wherever it comes, also one from before."""
        was, self.raises = self.raises, True
        self._restart(False)
        try:
            self.check()
            yield
        finally:
            self.raises = was
            self._restart(not was)

    def _restart(self, goes_on: bool) -> None:
        """True if what a library waits for goes on after a signal, as if none had come."""
        if hasattr(signal, "siginterrupt"):
            for number in self._numbers:
                signal.siginterrupt(number, not goes_on)

    def _handle(self, number: int, _: FrameType | None) -> None:
        before = len(self.came)
        with contextlib.suppress(BlockingIOError):
            self.came += [n for n in os.read(self._reader, 4096) if n in self._numbers]
        if len(self.came) == before:  # another thread heard it, and is about to write it
            self.came.append(number)
        if self._busy:
            return
        if len(self.came) > 1:
            self._end_now()
        if self.raises:
            raise Ended(number)

    def _end_now(self) -> NoReturn:
        self._busy = True
        with contextlib.suppress(Exception):
            self._clear()
        if not self.said:
            with contextlib.suppress(OSError):
                os.write(self._error, self._line)
        os._exit(128 + self.came[0])


_now: list[Ending] = []  # the one that takes signals, if any does


@contextlib.contextmanager
def taken(line: str, clear: Callable[[], None], *, gives_back: bool) -> Iterator[Ending | None]:
    """While it lasts, the first signal is noted, and the second one ends the process.

    line, clear: as `Ending` takes them. gives_back: whether the handlers are as before afterwards;
    else the process ends by itself, and no signal changes its status any more. None in another
    thread than the main one, in which no signal is handled.
    """
    if threading.current_thread() is not threading.main_thread():
        yield None
        return
    ending = Ending(line, clear)
    _now.append(ending)
    try:
        yield ending
    finally:
        _now.remove(ending)
        if gives_back:
            ending.give_back()
        else:
            ending.ignore()


def check() -> None:
    """Raise Ended where a signal came that ends the program: a place where all is in order."""
    if _now:
        _now[-1].check()


def raising() -> contextlib.AbstractContextManager[None]:
    """While it lasts, the first signal raises Ended at once: for what takes long, and may end
    anywhere. Nothing where no signals are taken, or in another thread than the main one.
    """
    if _now and threading.current_thread() is threading.main_thread():
        return _now[-1].raising()
    return contextlib.nullcontext()
