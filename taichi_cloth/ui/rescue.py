"""Saving what a run made where the window's driver ends the process, as its window is gone.

A connection that breaks while Vulkan draws, or a window that another program destroys then, makes
Taichi abort, in the middle of C++ that no exception of Python can leave. What must be saved is
registered with `saving`; the signal that ends the process saves it first.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
from collections.abc import Callable, Iterator

from taichi_cloth.errors import RunFailure
from taichi_cloth.settings.options import PROGRAM

_FATAL = (signal.SIGABRT, signal.SIGSEGV)
_Handler = ctypes.CFUNCTYPE(None, ctypes.c_int)
_savers: list[Callable[[], object]] = []


@contextlib.contextmanager
def saving(save: Callable[[], object]) -> Iterator[None]:
    """Call `save` if the process is ended meanwhile; what is registered last is called first."""
    _savers.append(save)
    try:
        yield
    finally:
        _savers.remove(save)


class Guard:
    """Handles the signals with which a driver ends the process, until `release`.

    failure: the reason, where it is one to save for; None: the signal takes its course.
    """

    def __init__(self, failure: Callable[[], RunFailure | None]):
        self._failure = failure
        self._handler = _Handler(self._handle)
        self._libc = ctypes.CDLL(None)
        self._libc.signal.restype = ctypes.c_void_p
        self._libc.signal.argtypes = [ctypes.c_int, ctypes.c_void_p]
        address = ctypes.cast(self._handler, ctypes.c_void_p)
        self._before = {number: self._libc.signal(number, address) for number in _FATAL}

    def release(self) -> None:
        """Give the signals back. May be called twice."""
        for number, before in self._before.items():
            self._libc.signal(number, before)
        self._before = {}

    def _handle(self, number: int) -> None:
        self.release()  # what goes wrong from here on ends the process
        failure = self._failure()
        if failure is None:
            return  # the signal comes again
        status = failure.exit_status
        try:
            for save in reversed(_savers):
                save()
        except Exception as error:  # nothing is above us that could handle it
            print(f"{PROGRAM}: error: {error}", file=sys.stderr)
        print(f"{PROGRAM}: {'error' if status else 'note'}: {failure}", file=sys.stderr)
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
