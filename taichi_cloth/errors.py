"""Errors that end a run early: the user's input is refused, or the run fails.

Both carry one line that says what was wrong, where, and what to do; the command
line prints that line and nothing else (no traceback for a user's mistake). The wording
that lines of all rooms share stands here too: this is the file that every room may import.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any


class InputError(ValueError):
    """The user's input is refused (exit status 2). The message is one line.

    Whatever of the input it shows, it is a line that a terminal can show: what does not print
    (a newline in a key, an escape sequence, half of a surrogate pair) is written as its escape, and
    what is longer than a screen is cut.
    """

    exit_status = 2

    def __init__(self, message: str = "") -> None:
        super().__init__(clipped(printable(message), 1000))


class RunFailure(RuntimeError):
    """A request that cannot be computed (exit status 3). The message is one line."""

    exit_status = 3


class BudgetMissed(RunFailure):
    """A run was made, and did not hold what it was to (exit status 1). The message is one line."""

    exit_status = 1


class SimulationFailure(RunFailure):
    """The simulation left its bounds: who, when, why, and what to change.

    particle: index of the first particle at fault.
    frame: 1-based number of the frame that failed; the last good frame is ``frame - 1``.
    cause, remedy: one clause each, by the last good frame alone until a post-mortem tells more.
    """

    def __init__(self, particle: int, frame: int, what: str, cause: str, remedy: str):
        self.particle, self.frame = particle, frame
        self.what, self.cause, self.remedy = what, cause, remedy
        super().__init__(self._line("likely cause"))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle it by its parts, of which it is made."""
        parts = (self.particle, self.frame, self.what, self.cause, self.remedy)
        return type(self), parts, vars(self) | {"args": self.args}

    def explain(self, cause: str, remedy: str) -> None:
        """Have it say what a post-mortem found."""
        self.cause, self.remedy = cause, remedy
        self.args = (self._line("cause"),)

    def _line(self, called: str) -> str:
        return (
            f"frame {self.frame}: particle {self.particle} {self.what}; {called}: {self.cause}; "
            f"remedy: {self.remedy} (the last good frame, {self.frame - 1}, is kept)"
        )


def nearest(word: object, known: Iterable[str]) -> str:
    """'did you mean X?' for the known word most like `word`, else a list of the known ones.

    word: as it was given; a key of a mapping from Python may be no text.
    """
    known = sorted(set(known))
    close = difflib.get_close_matches(str(word)[:100], known, n=1, cutoff=0.5)
    if close:
        return f"did you mean '{close[0]}'?"
    return f"known: {', '.join(known)}"


def clipped(text: str, most: int = 40) -> str:
    """`text` for a message of one line: cut where it is longer than `most`."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def printable(text: str) -> str:
    """`text` with what does not print written as its escape."""
    shown = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return "".join(shown)


def one_line(error: BaseException) -> str:
    """An exception as one process tells another: its kind and its words, in one line."""
    return clipped(" ".join(f"{type(error).__name__}: {error}".split()), 300)


def milliseconds(seconds: float, digits: int = 3) -> str:
    """A time in milliseconds, of so many digits, or as many as it has before its point: "4.2",
    "1861".
    """
    ms = 1e3 * seconds
    return f"{ms:.0f}" if abs(ms) >= 10**digits - 0.5 else f"{ms:.{digits}g}"


def counted(count: int, thing: str) -> str:
    """'1 spring', '2 springs'."""
    return f"{count} {thing}{'s' * (count != 1)}"
