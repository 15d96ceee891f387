"""Which settings are worth running for an error: by seconds that all of them share.

An error of a second is judged where the setting's own run stood, so each setting takes references
of its own. A survey takes seconds of one fine run instead, and has one reference of each for all
settings. So it is cheap, and says about how many substeps each explicit method takes. Those run,
and are judged; a method that solves equations is left to run where it may be as cheap.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from taichi_cloth.error_meter.others import Trial
from taichi_cloth.errors import counted
from taichi_cloth.kernels import methods
from taichi_cloth.trade.settings import Setting

MOST = 8  # seconds of a horizon that are looked at
FINEST = 64  # times the fewest substeps of each method: the most that are tried
NEAR = 2.0  # times the error that is wanted: in its own run a setting may still be within
DOUBLINGS = 3  # of the substeps that should do, which are run at once
ROUNDS = 2  # of that: the second one is of far finer steps, where none of the first holds
DEARER = 2.0  # times the forces of the cheapest: methods that are run, too
# Times the forces that seconds ask for: where these differ by more, seconds to come may be harder
# than all that were seen, and a higher order is worth more than these can say.
UNEVEN = 4.0
SOLVE = 4  # evaluations of forces that a step takes at least which solves equations


def looked_at(seconds: int) -> list[int]:
    """Which seconds of a horizon are surveyed: all of a few, else the first and some others."""
    if seconds <= MOST:
        return list(range(seconds))
    return [round(k * (seconds - 1) / (MOST - 1)) for k in range(MOST)]


def trials(chosen: Sequence[Setting], found: Sequence[Mapping[str, Any]]) -> list[Trial]:
    """By what the next second is made again: explicit methods, whose steps cost alike by forces.

    found: the seconds before. A method begins with what these asked for, and is left out once it
    is clearly dearer than another one. Empty where no method chosen is explicit.
    """
    least: dict[str, int] = {}
    for setting in chosen:
        if _is_surveyed(setting.method):
            least[setting.method] = min(setting.substeps, least.get(setting.method, 1 << 30))
    finest = {name: FINEST * fewest for name, fewest in least.items()}
    survey = Survey.of_seconds(found)
    for name in survey.needs:
        fewest = least.pop(name)
        if name in survey.worth:
            least[name] = max(fewest, min(survey.worth[name][0], finest[name]))
    cost = min((_forces(name, fewest) for name, fewest in least.items()), default=0)
    order = sorted(least, key=lambda name: _forces(name, least[name]))
    return [Trial(name, cost / _forces(name, 1), least[name], finest[name]) for name in order]


def _is_surveyed(method: str) -> bool:
    claims = methods.load(method).claims
    return not claims.implicit and not claims.settings and claims.stability_limit > 0


@dataclass(frozen=True)
class Survey:
    """A survey of seconds: by method the substeps that should do, and whether they were seen to.

    seconds: of how many there are errors; of: how many were looked at. uneven: how many times as
    many evaluations of forces one of them asks for as another.
    """

    needs: Mapping[str, tuple[int, bool]]
    seconds: int
    of: int
    uneven: float = 1.0

    @classmethod
    def of_seconds(cls, found: Sequence[Mapping[str, Any]]) -> Survey:
        """Sum seconds up, as `Judge.survey` returns each.

        A method takes the most that one of them asks for; where none of the tries in a second is
        within, twice the finest.
        """
        needs: dict[str, tuple[int, bool]] = {}
        known = [second["tries"] for second in found if second["tries"]]
        asked = []
        for tries in known:
            here = {}
            for name, of in tries.items():
                within = [n for n, error in of if error <= NEAR]
                here[name] = min(within, default=2 * max(n for n, _ in of)), bool(within)
            met = [_forces(name, n) for name, (n, seen) in here.items() if seen]
            asked.append(min(met, default=max(_forces(name, n) for name, (n, _) in here.items())))
            for name, need in here.items():
                needs[name] = max(needs.get(name, need), need)
        resting = sum(second["resting"] for second in found)
        uneven = max(asked, default=1) / min(asked, default=1)
        return cls(needs, len(known) + resting, len(found), uneven)

    @property
    def forces(self) -> float | None:
        """The evaluations of forces that a frame takes at least; None: no method was enough."""
        met = (_forces(name, n) for name, (n, met) in self.needs.items() if met)
        return min(met, default=None)

    @property
    def worth(self) -> dict[str, tuple[int, bool]]:
        """The needs of methods that may be the cheapest: of all where none was enough."""
        least, found = self.forces, {}
        for name, (n, met) in self.needs.items():
            forces = _forces(name, n)
            if least is None or (forces <= DEARER * least if met else forces < least):
                found[name] = n, met
        if self.uneven >= UNEVEN:
            best = max(self.needs, key=lambda name: methods.load(name).claims.order)
            found[best] = self.needs[best]
        return found

    def narrowed(self, chosen: Sequence[Setting], short: bool, again: int = 0) -> list[Setting]:
        """The settings to run, of those chosen, with the substeps that should do.

        again: how many rounds there were, whose settings do not hold. short: whether time is
        limited: then no method that solves equations runs beside one that should do, and nothing in
        compensated precision beside f64.
        """
        if not self.needs:
            return list(chosen)
        least, worth = self.forces, self.worth
        kept: list[Setting] = []
        exact = {setting.precision for setting in chosen} >= {"f64", "compensated"}
        for setting in chosen:
            name = setting.method
            if short and exact and setting.precision == "compensated":
                continue
            if name in worth:
                n = worth[name][0]
                finer = range(again * DOUBLINGS, (again + 1) * DOUBLINGS)
                kept += [replace(setting, substeps=n << k) for k in finer]
            elif again:
                continue
            elif least is None or not _is_surveyed(name) and not short:
                sweeps = setting.iterations or SOLVE
                if least is None or sweeps * setting.substeps <= least:
                    kept.append(setting)
        return list(dict.fromkeys(kept))

    def describe(self) -> str:
        """'verlet from 48 substeps on, rk4 from 12, by 5 of 5 seconds'."""
        words = [
            f"{name} {'from' if met else 'beyond'} {n if met else n // 2}"
            for name, (n, met) in sorted(
                self.needs.items(), key=lambda need: _forces(need[0], need[1][0])
            )
        ]
        of = counted(self.of, "second")
        return f"{', '.join(words)} substeps, by {self.seconds} of {of}"


def _forces(method: str, substeps: int) -> int:
    return methods.load(method).claims.forces * substeps
