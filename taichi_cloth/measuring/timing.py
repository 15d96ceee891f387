"""Timing: turns of those that are compared, quiet while one is timed, quartiles."""

from __future__ import annotations

import contextlib
import math
import statistics
import threading
import time
from collections.abc import Iterator, Sequence
from typing import NamedTuple, TypeVar

Entrant = TypeVar("Entrant")


class Quartiles(NamedTuple):
    """Lower quartile, median, upper quartile."""

    lower: float
    median: float
    upper: float


def quartiles(values: Sequence[float]) -> Quartiles:
    """The quartiles of at least one value."""
    if len(values) == 1:
        return Quartiles(values[0], values[0], values[0])
    return Quartiles(*statistics.quantiles(values, n=4, method="inclusive"))


def turns(
    running: list[Entrant],
    rounds: int,
    *,
    rotate: bool = False,
    patience: float = math.inf,
    least: int = 0,
) -> Iterator[tuple[int, Entrant]]:
    """(number of the round, whose turn it is), so that a drift of the machine meets all alike.

    Round 0 warms up and is not to be counted; `rounds` more follow.

    running: those that take part. One that is removed from the list has no more turns.
    rotate: whether each round begins with another one.
    patience: seconds after which no round begins, once `least` rounds were counted.
    """
    deadline = time.perf_counter() + patience
    for number in range(rounds + 1):
        if number > least and time.perf_counter() > deadline:
            return
        start = number % len(running) if rotate and running else 0
        for entrant in running[start:] + running[:start]:
            yield number, entrant


class Quiet:
    """Threads of which many may work at a time, or one alone: the one that measures."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._working, self._waiting, self._alone = 0, 0, False

    @contextlib.contextmanager
    def working(self) -> Iterator[None]:
        """Work beside others, once nobody measures or waits to."""
        with self._changed:
            self._changed.wait_for(lambda: not (self._alone or self._waiting))
            self._working += 1
        try:
            yield
        finally:
            with self._changed:
                self._working -= 1
                self._changed.notify_all()

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Measure, once nobody works."""
        with self._changed:
            self._waiting += 1
            self._changed.wait_for(lambda: not (self._alone or self._working))
            self._waiting, self._alone = self._waiting - 1, True
        try:
            yield
        finally:
            with self._changed:
                self._alone = False
                self._changed.notify_all()
