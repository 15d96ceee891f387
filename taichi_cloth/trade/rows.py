"""A row for each setting: its errors, its cost, and what it takes to run it again."""

from __future__ import annotations

import csv
import io
import json
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from taichi_cloth.trade.errors import Breaks, Invariants, Samples, distance
from taichi_cloth.trade.runner import Outcome, Result
from taichi_cloth.trade.settings import Setting


@dataclass(frozen=True)
class Row:
    """One setting. Numbers that it does not have are None.

    error_final_rms, error_final_max, error_trajectory, error_trajectory_max: distances from the
    reference in world units (`measures.Distance`); with `_relative`: in parts of `scale`, the
    horizon's. error_discretisation: that of the converged step; error_solver: the distance from it.
    energy_drift, momentum_drift: in parts of the reference's scales (`measures.Invariants`).
    order: by which the error falls with the step, from the row with the next longer step.
    wall_seconds: of the whole horizon, the median; wall_lower, wall_upper: its quartiles.
    floor: the least trajectory error that the reference can tell from none, in world units;
    below_floor: that it cannot tell this one. pareto: no other is both as cheap
    and as good. command: runs it again.
    """

    method: str
    dt: float
    substeps: int
    iterations: int | None
    precision: str
    fast_math: bool
    arch: str
    error_final_rms: float | None = None
    error_final_max: float | None = None
    error_trajectory: float | None = None
    energy_drift: float | None = None
    max_strain: float | None = None
    wall_seconds: float | None = None
    force_evaluations: int | None = None
    sweeps: int | None = None
    status: str = "ok"
    pareto: bool = False
    tolerance: float | None = None
    step: float = 0.0
    error_final_rms_relative: float | None = None
    error_final_max_relative: float | None = None
    error_trajectory_relative: float | None = None
    error_trajectory_max: float | None = None
    error_discretisation: float | None = None
    error_solver: float | None = None
    below_floor: bool = False
    floor: float | None = None
    scale: float | None = None
    order: float | None = None
    momentum_drift: float | None = None
    unconverged: int | None = None
    breaks: int | None = None
    breaks_agreeing: int | None = None
    first_break: int | None = None
    first_break_later: int | None = None
    wall_lower: float | None = None
    wall_upper: float | None = None
    repeats: int | None = None
    frames: int | None = None
    topology: str = ""
    execution: str = ""
    threads: int | None = None
    device: str = ""
    scene_hash: str = ""
    versions: str = ""
    command: str = ""

    @property
    def ok(self) -> bool:
        return self.status == "ok"

    @property
    def setting(self) -> Setting:
        """What it was measured in."""
        names = (f.name for f in fields(Setting))
        return Setting(**{name: getattr(self, name) for name in names})


NAMES = tuple(f.name for f in fields(Row))


def rows_of(result: Result, common: Mapping[str, Any], command: Sequence[str]) -> list[Row]:
    """The rows of a sweep.

    common: what all rows share (scene_hash, versions). command: the words of a run of the scene,
    to which each row's settings are added.
    """
    scene, found = result.scene, result.reference
    free = ~scene.particles.fixed
    true = Invariants.of(scene, found.samples) if found else None
    breaks = scene.features().fracture
    exact: dict[Setting, Samples] = {}
    made = []
    for outcome in result.outcomes:
        setting = outcome.setting
        row = {name: getattr(setting, name) for name in _SETTING} | dict(common)
        row |= {name: getattr(outcome, name) for name in _WORK}
        row |= {name: value for name, value in outcome.about.items() if name in NAMES}
        row["step"], row["command"] = setting.step, " ".join([*command, *setting.words()])
        row["frames"] = result.horizon.frames if result.horizon else None
        if outcome.ok and found:
            samples = outcome.samples()
            row |= _errors(samples, result, free, true)
            row |= _solver_errors(samples, outcome, result, free, exact)
            if breaks:
                of = Breaks.of(samples, found.samples)
                row |= {
                    "breaks": of.count,
                    "breaks_agreeing": of.agreeing,
                    "first_break": of.first,
                    "first_break_later": of.later,
                }
        if outcome.seconds:
            row |= _times(outcome)
        made.append(Row(**row))
    made = [_with(row, order=order) for row, order in zip(made, _orders(made), strict=True)]
    floor = found.floor(result.horizon) if found else 0.0
    front = pareto([_cost(row, floor) for row in made])
    return [_with(row, pareto=on) for row, on in zip(made, front, strict=True)]


_SETTING = tuple(f.name for f in fields(Setting))
_WORK = ("status", "force_evaluations", "sweeps", "unconverged")


def _with(row: Row, **changes) -> Row:
    return Row(**(vars(row) | changes))


def _errors(samples: Samples, result: Result, free, true: Invariants) -> dict[str, Any]:
    apart = distance(samples, result.reference.samples, free)
    mine, scale = Invariants.of(result.scene, samples), result.horizon.scale
    return {
        "error_final_rms": apart.final_rms,
        "error_final_max": apart.final_max,
        "error_trajectory": apart.trajectory,
        "error_trajectory_max": apart.trajectory_max,
        "error_final_rms_relative": apart.final_rms / scale,
        "error_final_max_relative": apart.final_max / scale,
        "error_trajectory_relative": apart.trajectory / scale,
        "energy_drift": mine.energy_drift(true),
        "momentum_drift": mine.momentum_drift(true),
        "max_strain": mine.strain,
        "floor": result.reference.floor(result.horizon),
        "scale": scale,
        "below_floor": apart.trajectory < result.reference.floor(result.horizon),
    }


def _solver_errors(samples, outcome: Outcome, result: Result, free, exact) -> dict[str, Any]:
    """The error of the converged step, and what the solver adds; of a method without one, all of
    its error is of the first kind.
    """
    from taichi_cloth.trade.settings import converged

    twin = converged(outcome.setting)
    if twin is None:
        apart = distance(samples, result.reference.samples, free)
        return {"error_discretisation": apart.trajectory}
    if twin not in result.converged:
        return {}
    if twin not in exact:
        exact[twin] = result.converged[twin].samples()
    return {
        "error_discretisation": distance(exact[twin], result.reference.samples, free).trajectory,
        "error_solver": distance(samples, exact[twin], free).trajectory,
    }


def _times(outcome: Outcome) -> dict[str, Any]:
    seconds = outcome.seconds
    low = middle = high = seconds[0]
    if len(seconds) > 1:
        low, middle, high = statistics.quantiles(seconds, n=4, method="inclusive")
    return {
        "wall_seconds": middle,
        "wall_lower": low,
        "wall_upper": high,
        "repeats": len(seconds),
    }


def _orders(rows: Sequence[Row]) -> list[float | None]:
    """By which power of the step the error fell from the next longer step of the same series."""
    orders = []
    for row in rows:
        same = [r for r in rows if r.setting.series == row.setting.series and r.step > row.step]
        longer = min(same, key=lambda r: r.step, default=None)
        usable = [r for r in (row, longer) if r and r.error_trajectory and not r.below_floor]
        if len(usable) < 2:
            orders.append(None)
            continue
        ratio = longer.error_trajectory / row.error_trajectory
        orders.append(math.log(ratio) / math.log(longer.step / row.step))
    return orders


def _cost(row: Row, floor: float) -> tuple[float, float] | None:
    """(seconds, error), errors that cannot be told from none taken for alike."""
    if not row.ok or row.wall_seconds is None or row.error_trajectory is None:
        return None
    return row.wall_seconds, max(row.error_trajectory, floor)


def pareto(costs: Sequence[tuple[float, float] | None]) -> list[bool]:
    """Which of (seconds, error) are on the front: none is as good in both and better in one."""
    order = sorted((cost, i) for i, cost in enumerate(costs) if cost is not None)
    front, least = [False] * len(costs), math.inf
    for k, ((seconds, error), i) in enumerate(order):
        if error < least:
            front[i], least = True, error
        elif k and front[order[k - 1][1]] and order[k - 1][0] == (seconds, error):
            front[i] = True  # a twin of one on the front
    return front


# ------------------------------------------------------------------------------------------
# Files


def as_csv(rows: Iterable[Row]) -> str:
    """A table with a header, numbers in full."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(NAMES)
    for row in rows:
        table.writerow([_plain(getattr(row, name)) for name in NAMES])
    return text.getvalue()


def _plain(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def as_json(rows: Iterable[Row], environment: Mapping[str, Any]) -> str:
    """The same rows after what they were measured with."""
    whole = {"environment": environment, "rows": [asdict(row) for row in rows]}
    return json.dumps(whole, indent=1, allow_nan=False, default=str) + "\n"
