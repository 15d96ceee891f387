"""The last seconds of a few numbers: a ring of rows, each with the second it was noted at."""

from __future__ import annotations

import numpy as np

SECONDS = 10.0  # that meters keep
ROWS = 1200  # twice as many as a window's frames in that time


class History:
    """Rows of numbers, the oldest of which make room for new ones.

    seconds: for how long rows are wanted; rows: the most that there may be in that time, beyond
    which it reaches back less far. columns: numbers in a row.
    """

    def __init__(self, seconds: float, rows: int, columns: int) -> None:
        self.seconds = seconds
        self._row = np.zeros((rows, 1 + columns))
        self._count = 0

    def note(self, now: float, *numbers: float) -> None:
        """Note a row at the second `now`, which is not before the last one's."""
        self._row[self._count % len(self._row)] = (now, *numbers)
        self._count += 1

    def clear(self) -> None:
        """Forget all rows."""
        self._count = 0

    def __len__(self) -> int:
        return min(self._count, len(self._row))

    def last(self, now: float) -> tuple[np.ndarray, np.ndarray]:
        """Ages in seconds (k,), the oldest first, and numbers (k, columns), of the last seconds.

        One row more than that is there, where there was one: a curve goes on to the edge.
        """
        size = len(self._row)
        row = self._row[: self._count]
        if self._count > size:
            row = np.roll(self._row, -(self._count % size), axis=0)
        begin = int(np.searchsorted(row[:, 0], now - self.seconds))
        row = row[max(begin - 1, 0) :]
        return now - row[:, 0], row[:, 1:]

    def rate(self, now: float) -> float:
        """Rows a second noted lately; 0 before the second one."""
        age, _ = self.last(now)
        age = age[age <= min(2.0, self.seconds)]
        return (len(age) - 1) / (age[0] - age[-1]) if len(age) > 1 and age[0] > age[-1] else 0.0
