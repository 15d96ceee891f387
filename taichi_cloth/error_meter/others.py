"""A window by other methods than its own: at which steps these are tried."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Trial:
    """What a window is to be made again with, besides its own method.

    method: which. most: substeps of a frame, tried first: those that take as long as the window's
    own. least: the fewest with which it is stable. within: with an error of at most that, in parts
    of the window's motion, half as many are tried next, and so on; None: of what rounding made of
    the window, as below that fewer steps are more accurate.
    """

    method: str
    most: int
    least: int
    within: float | None = None

    def results(
        self, error: Callable[[int], float], rounding: float
    ) -> Iterator[tuple[int, float]]:
        """(substeps, error) of each try; error: of so many substeps, and rounding: what that made
        of the window, in parts of the motion.
        """
        within = rounding if self.within is None else self.within
        substeps = self.most
        while True:
            found = error(substeps)
            yield substeps, found
            fewer = max(substeps // 2, self.least)
            if not found <= within or fewer >= substeps:
                return
            substeps = fewer
