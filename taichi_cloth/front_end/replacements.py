"""Parts of Taichi that are replaced for as long as one of our kernels, or its fields, are made.

Taichi belongs to the whole process: to other programs that import us, too. So each of its parts
that is replaced here is put back before anything else of Taichi is used.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterable
from typing import Any

# A module or class, the name of its part, and what stands in for it meanwhile.
Replacement = tuple[Any, str, Any]


class Replacements(contextlib.ContextDecorator):
    """A context in which parts of Taichi are replaced.

    It may be entered within itself, and by several threads: the first one that comes replaces, and
    the last one that leaves puts back. Another thread that uses Taichi meanwhile finds what stands
    in; it does the same as Taichi's own for all but our kernels. (Taichi itself refuses to read two
    kernels at once.)
    """

    def __init__(self, make: Callable[[], Iterable[Replacement]]) -> None:
        """make: called once, when they are needed for the first time."""
        self._make = make
        self._made: list[Replacement] | None = None
        self._before: list[Replacement] = []
        self._inside = 0
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        with self._lock:
            if self._made is None:
                self._made = list(self._make())
            if self._inside == 0:
                # As they stand there: of a class's static method the name alone gives the function.
                self._before = [(of, name, vars(of)[name]) for of, name, _ in self._made]
                _put(self._made)
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                _put(self._before)


def _put(parts: list[Replacement]) -> None:
    for of, name, part in parts:
        setattr(of, name, part)
