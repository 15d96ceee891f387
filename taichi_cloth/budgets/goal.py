"""The goal of a budget: a frame's time, or an error of each second."""

from __future__ import annotations

from dataclasses import dataclass

from taichi_cloth.errors import InputError, clipped
from taichi_cloth.settings.parameters import error_limit, positive

SAYS = "frames a second such as 60fps, a frame's time such as 12ms, or an error such as 1%"
LEAST_SECONDS, MOST_SECONDS = 1e-3, 10.0  # of a frame
MOST_ERROR = 0.5  # of the motion: half of it wrong is no goal


@dataclass(frozen=True)
class Goal:
    """One of the two: seconds of a frame, or the error of a second in parts of its motion.

    words: as it was given.
    """

    words: str
    seconds: float | None = None
    error: float | None = None


def read(given: str, name: str = "--hold") -> Goal:
    """The goal that somebody wrote; InputError, by the `name` of the flag, where it is none."""
    words = given.strip().lower().replace(" ", "")
    for unit in ("fps", "ms"):
        if words.endswith(unit):
            number = positive(name, words.removesuffix(unit), SAYS, given)
            seconds = 1 / number if unit == "fps" else number / 1e3
            return Goal(words, seconds=_checked(name, seconds, given))
    if not words.endswith("%"):
        raise InputError(f"{name} must be {SAYS}; is '{clipped(given)}'")
    error, _ = error_limit(name, words)
    if error > MOST_ERROR:
        raise InputError(
            f"{name}: an error is at most {100 * MOST_ERROR:g}%; is '{clipped(given)}'"
        )
    return Goal(words, error=error)


def _checked(name: str, seconds: float, given: str) -> float:
    if not LEAST_SECONDS <= seconds <= MOST_SECONDS:
        raise InputError(
            f"{name}: a frame takes {1e3 * LEAST_SECONDS:g} ms to {MOST_SECONDS:g} s, which is "
            f"{1 / MOST_SECONDS:g} to {1 / LEAST_SECONDS:g} frames a second; is '{clipped(given)}'"
        )
    return seconds
