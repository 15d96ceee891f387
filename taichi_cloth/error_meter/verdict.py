"""The verdict on a window: its error, the cause, and how far one may look ahead."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from taichi_cloth.console import percent
from taichi_cloth.error_meter.window import FRAMES

MILLIONTH = 1e-6  # of the scale: the disturbance whose growth is watched
# Of the error, what two references may differ by: what is aimed at, and above what it is not sure.
AIM, THIRD = 1 / 5, 1 / 3
GREW = math.e  # times in a window: below that a disturbance is not seen to grow
REST = 1e-4  # of the world: what moves by less within a window does not move for the eye
DIGITS = 2  # of percentages: a reference is no better known than by a fifth
FOREVER = 60.0  # seconds that nobody waits for


@dataclass(frozen=True)
class Verdict:
    """The error of a window, by the definition of `trade`: lengths in the scene's units.

    first, frames: which frames it is of. error: the root of the mean square distance of a particle
    from the reference, over all particles and the ends of all frames. scale: the largest
    displacement of a particle in the reference, what errors are parts of; size: of the world, its
    diagonal. apart: what the two finest references differ by; substeps: of the finest one.
    solver: how far the window's settings are from themselves with a solver that converged, in f64,
    None where there is no solver.
    rounding: how far what was shown is from the same in f64, None where that was f64.
    method, own_substeps: the window's; 0 where it had several numbers of them. acted: whether
    somebody acted in it, as by a mouse.
    others: by method, its own among them, (substeps, error in parts of the scale) of each try with
    other steps, in f64.
    growth: the rate at which a disturbance of a millionth grew [1 / frame], 0 where it did not,
    None where there was no time to see; parted: by how much it made the runs differ.
    seconds: that it took. trouble: why there is no error, or why it is not sure; "": it is.
    judged: how many of its frames, from the first on, that is said of; further: why not of all;
    by_frame: the root over the particles alone, at the end of each of them, or of each so many.
    """

    first: int
    frames: int
    precision: str = ""
    error: float = math.nan
    scale: float = math.nan
    size: float = 0.0
    apart: float = math.nan
    substeps: int = 0
    solver: float | None = None
    rounding: float | None = None
    growth: float | None = None
    parted: float | None = None
    seconds: float = 0.0
    trouble: str = ""
    method: str = ""
    own_substeps: int = 0
    acted: bool = False
    others: dict[str, Sequence[tuple[int, float]]] = field(default_factory=dict)
    judged: int = 0
    further: str = ""
    by_frame: Sequence[float] = ()

    @property
    def end(self) -> int:
        """The frame that it ends at."""
        return self.first + self.frames

    @property
    def known(self) -> bool:
        """True if there is an error at all."""
        return math.isfinite(self.error) and self.scale > 0

    @property
    def relative(self) -> float:
        """The error in parts of the scale."""
        return self.error / self.scale

    def frames_within(self, part: float) -> int:
        """The share of judged frames that are wrong by at most so much of the scale."""
        within = sum(error <= part * self.scale for error in self.by_frame)
        return round(self.judged * within / max(len(self.by_frame), 1))

    @property
    def resting(self) -> bool:
        """True if nothing moved in it, for the eye: no part of that says anything."""
        return self.known and self.scale < REST * self.size

    @property
    def ahead(self) -> float:
        """Seconds in which a millionth of the scale grows to the error; infinite: it does not."""
        if self.relative <= MILLIONTH:
            return 0.0
        if not self.growth:
            return math.inf
        return math.log(self.relative / MILLIONTH) / self.growth / FRAMES

    @property
    def span(self) -> str:
        """The time that it is of, in words."""
        whole = "the last second" if self.frames == FRAMES else f"{self.frames / FRAMES:.2g} s"
        if self.further:
            return f"the first {self.judged / FRAMES:.2g} s of {whole}"
        return whole

    def describe(self, in_metres: bool) -> str:
        """All of it in a line; in_metres: whether the scene's lengths are metres."""
        if not self.known:
            return f"error over {self.span} not known: {self.trouble}"
        if self.resting:
            length = length_in_words(self.error, in_metres)
            return f"error over {self.span}: {length}; nothing moves"
        parts = self._parts()
        of_which = f", of which {', '.join(parts)}" if parts else ""
        whole = f"error over {self.span}: {self._part(self.error)}"
        length = length_in_words(self.error, in_metres)
        unsure = f"; not sure: {self.trouble}" if self.trouble else ""
        more = "".join(f"; {words}" for words in (self.foresight(), self.further) if words)
        return f"{whole} ({length}){of_which}{more}{unsure}"

    def in_short(self, in_metres: bool) -> tuple[str, tuple[str, ...]]:
        """The same for a meter: its value, and details, the most important first."""
        if self.resting:
            return length_in_words(self.error, in_metres), ("nothing moves",)
        value = f"{self._part(self.error)} ({length_in_words(self.error, in_metres)})"
        ahead = [f"holds {self.ahead:.2g} s"]
        if self.growth is None:
            ahead = []
        elif not self.growth:
            ahead = ["no growth"]
        elif self.ahead > FOREVER:
            ahead = [f"holds over {FOREVER:.0f} s"]
        part = f"of the first {self.judged / FRAMES:.2g} s"
        more, unsure = [part] * bool(self.further), ["not sure"] * bool(self.trouble)
        return value, (*more, *self._parts(), *ahead, *unsure)

    def _parts(self) -> list[str]:
        """The cause of the error, in words."""
        parts = []
        if self.solver is not None:
            parts.append(f"solver {self._part(self.solver)}")
        if self.rounding is not None:
            parts.append(f"{self.precision} {self._part(self.rounding)}")
        return parts

    def foresight(self) -> str:
        """The horizon up to which the future can be trusted, in words; "": nobody looked."""
        if self.growth is None:
            return ""
        if not self.growth:
            return "disturbances did not grow"
        if self.ahead > FOREVER:
            return f"a nudge of a millionth takes over {FOREVER:.0f} s to grow to this"
        return f"a nudge of a millionth grows to this in {self.ahead:.2g} s"

    def _part(self, length: float) -> str:
        return percent(length / self.scale, DIGITS)


def length_in_words(length: float, in_metres: bool) -> str:
    """A length in two digits with its unit, where it has one."""
    if not in_metres:
        return f"{length:.2g}"
    for unit, size in (("m", 1.0), ("cm", 1e-2), ("mm", 1e-3)):
        if length >= size:
            return f"{length / size:.2g} {unit}"
    return f"{float(f'{length / 1e-6:.2g}'):g} um"
