"""The second setting of a budget, which solves a step's equations: a tolerance, or sweeps.

The error meter says of each second what its solver left. That is kept a part of the error: where it
is the larger one, the solver goes on for longer, and where it hardly counts, it ends earlier, so
that the time goes to finer steps. What the other part takes is a matter of the substeps alone.
"""

from __future__ import annotations

import math
from collections import deque

MOST, LEAST, AIM = 0.5, 0.1, 0.25  # of the error: that a solver may leave; at least; is aimed at
PATIENCE = 4  # seconds with one setting, each below the least, before a looser one
HELPS = 0.8  # times what was left before: what is above is no help
BARRED = 20  # seconds for which what was too loose is not tried again; each time twice as many
# Tightest and loosest, by precision: f32 follows no smaller residual, nor do compensated sums, with
# which solvers have vectors in f32.
TOLERANCES = {"f64": (1e-10, 1e-2), "f32": (1e-6, 1e-2), "compensated": (1e-6, 1e-2)}
SWEEPS = (2, 200)
BY_TOLERANCE, BY_SWEEPS = 10.0, 4.0  # times: by how much it is tightened at once, at most
DECADE, HALF_MORE = 2, 1.5  # rungs of tolerances in a decade; how many times more sweeps each has


class SolverErrors:
    """Residuals of the last seconds, and the setting that would leave a fair part.

    name: "tolerance" or "iterations". precision: of the run.
    """

    def __init__(self, name: str, precision: str) -> None:
        self.name = name
        self._ends = SWEEPS if name == "iterations" else TOLERANCES[precision]
        self._lately: deque[float] = deque(maxlen=PATIENCE)  # parts, with the present setting
        self._seconds = 0
        self._before: float | None = None  # what was left when it was tightened last
        self._barred: tuple[float, int, int] | None = None  # a setting, until when, for how long
        self._helpless = False

    def note(self, part: float) -> None:
        """A second with the present setting is measured: what its solver left, of the error."""
        self._seconds += 1
        if self._before is not None:
            self._helpless = part > HELPS * self._before
            self._before = None
        self._lately.append(part)

    def changed(self, was: float, now: float) -> None:
        """The setting is another one from now on; what was only chosen is no try."""
        if self._lately and self.work(was, now) > 1:
            lasted = self._barred[2] if self._barred else BARRED // 2
            self._before = max(self._lately)
            self._barred = was, self._seconds + 2 * lasted, 2 * lasted
        else:
            self._before = None
        self._helpless = False
        self._lately.clear()

    def choose(self, now: float) -> float:
        """The setting from now on, where it is `now`."""
        if not self._lately:
            return now
        part = max(self._lately)
        if part > MOST and not self._helpless:
            return self._tightened(now, part)
        if len(self._lately) == PATIENCE and part < LEAST:
            looser = self.looser(now)
            return now if self._is_barred(looser) else looser
        return now

    def looser(self, now: float) -> float:
        """The next setting that ends earlier, or the same."""
        if self.name == "iterations":
            return min(now, max(int(now / HALF_MORE), self._ends[0]))
        return max(now, min(_rung(now, 1), self._ends[1]))

    def work(self, now: float, other: float) -> float:
        """The factor by which a step is longer with another setting, about."""
        if self.name == "iterations":  # beside the sweeps, each step has about the work of one
            return (1 + other) / (1 + now)
        return math.log(other) / math.log(now)

    def _tightened(self, now: float, part: float) -> float:
        if self.name == "iterations":
            more = math.ceil(now * min(part / AIM, BY_SWEEPS))
            return max(now, min(more, self._ends[1]))
        rungs = -math.ceil(DECADE * math.log10(min(part / AIM, BY_TOLERANCE)))
        return min(now, max(_rung(now, rungs), self._ends[0]))

    def _is_barred(self, value: float) -> bool:
        if self._barred is None or self._seconds >= self._barred[1]:
            return False
        known = self._barred[0]
        return value <= known if self.name == "iterations" else value >= known


def _rung(now: float, more: int) -> float:
    """A tolerance so many rungs larger, in few digits."""
    return float(f"{10 ** (round(DECADE * math.log10(now) + more) / DECADE):.1e}")
