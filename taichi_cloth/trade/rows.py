"""A row for each setting: its errors, its cost, and what it takes to run it again."""

from __future__ import annotations

import csv
import io
import json
import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from taichi_cloth.measuring.timing import quartiles
from taichi_cloth.scene.model import Scene
from taichi_cloth.trade.errors import Breaks, Contacts, Invariants, Samples, distance
from taichi_cloth.trade.outcomes import Outcome, Result
from taichi_cloth.trade.reference import Horizon, Reference
from taichi_cloth.trade.seconds import SECOND, Second
from taichi_cloth.trade.settings import Setting, converged


@dataclass(frozen=True)
class Row:
    """One setting. Numbers that it does not have are None.

    error_final_rms, error_final_max, error_trajectory, error_trajectory_max: distances from the
    reference in world units (`errors.Distance`); with `_relative`: in parts of `scale`, the
    horizon's. error_discretisation: that of the converged step; error_solver: the distance from it.
    energy_drift, momentum_drift: in parts of the reference's scales (`errors.Invariants`).
    order: by which the error falls with the step, from the row with the next longer step.
    wall_seconds: of the whole horizon, the median; wall_lower, wall_upper: its quartiles.
    floor: the least trajectory error that the reference can tell from none, in world units;
    below_floor: that it cannot tell this one. pareto: no other is both as cheap
    and as good. command: runs it again.
    penetration_max, contact_energy, first_touch_later: of contacts (`errors.Contacts`), in the
    scene's units. timed_on: the name of the machine on which it was timed.
    judged: its seconds, as the error meter has them; None where nobody judges them, as where the
    horizon is one second, and the trajectory error is that second's.
    """

    setting: Setting
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
    penetration_max: float | None = None
    contact_energy: float | None = None
    first_touch_later: float | None = None
    timed_on: str = ""
    judged: Sequence[Second] | None = None

    @property
    def known(self) -> list[Second]:
        """The seconds whose error is known."""
        return [second for second in self.judged or () if second.error is not None]

    @property
    def untold(self) -> bool:
        """True if its error is the least that the reference can tell from none."""
        return self.below_floor and self.judged is None

    @property
    def seconds(self) -> int:
        """The number of judged seconds."""
        return len(self.judged or ())

    @property
    def seconds_known(self) -> int:
        """Of how many of them the error is known."""
        return len(self.known)

    @property
    def error_second(self) -> float | None:
        """The error of the worst second, in parts of its motion."""
        longer = self.judged is None and (self.frames or 0) > SECOND
        return None if longer else self.told()[1]

    @property
    def error_second_middle(self) -> float | None:
        """That of the second in the middle."""
        if self.judged is None:
            return self.error_second
        return float(np.median([s.relative for s in self.known])) if self.known else None

    @property
    def ok(self) -> bool:
        return self.status == "ok"

    @property
    def step(self) -> float:
        """Time of a step."""
        return self.setting.step

    def a_frame(self, seconds: float | None) -> float | None:
        """Seconds of a frame, of those of the whole horizon."""
        return seconds / self.frames if seconds is not None and self.frames else None

    def told(self) -> tuple[float | None, float | None]:
        """The error of the worst second, in world units and in parts of its motion; where seconds
        were not judged the trajectory error, or the least that the reference can tell from none.
        """
        if self.judged is not None:
            lengths = [second.error or 0.0 for second in self.known]
            parts = [second.relative or 0.0 for second in self.known]
            return max(lengths, default=None), max(parts, default=None)
        if self.untold and self.floor is not None and self.scale:
            return self.floor, self.floor / self.scale
        return self.error_trajectory, self.error_trajectory_relative

    def record(self) -> dict[str, Any]:
        """Its values by `COLUMNS`, as files have them: what overflowed is None."""
        of_setting = vars(self.setting) | {"step": self.step}
        values = {
            name: of_setting[name] if name in of_setting else getattr(self, name)
            for name in COLUMNS
        }
        return dict(finite(values))


# Of the files, in this order. New ones are added at the end: other programs read these.
COLUMNS = (
    *("method", "dt", "substeps", "iterations", "precision", "fast_math", "arch"),
    *("error_final_rms", "error_final_max", "error_trajectory", "energy_drift", "max_strain"),
    *("wall_seconds", "force_evaluations", "sweeps", "status", "pareto", "tolerance", "step"),
    *("error_final_rms_relative", "error_final_max_relative", "error_trajectory_relative"),
    *("error_trajectory_max", "error_discretisation", "error_solver", "below_floor", "floor"),
    *("scale", "order", "momentum_drift", "unconverged", "breaks", "breaks_agreeing"),
    *("first_break", "first_break_later", "wall_lower", "wall_upper", "repeats", "frames"),
    *("topology", "execution", "threads", "device", "scene_hash", "versions", "command"),
    *("penetration_max", "contact_energy", "first_touch_later", "timed_on"),
    *("error_second", "error_second_middle", "seconds", "seconds_known"),
)
ABOUT = ("device", "threads", "topology", "execution")  # what the process of a setting tells


def rows_of(
    result: Result,
    common: Mapping[str, Any],
    command: Sequence[str],
    seconds: Mapping[Setting, Sequence[Second]] | None = None,
) -> list[Row]:
    """The rows of a study.

    common: what all rows share (scene_hash, versions). command: the words of a run of the scene,
    to which each row's settings are added. seconds: as judged, by setting.
    """
    judge = None
    if result.reference and result.horizon:
        judge = _Judge(result.scene, result.reference, result.horizon, result.converged)
    made = []
    for outcome in result.outcomes:
        about = {name: outcome.about[name] for name in ABOUT if name in outcome.about}
        judged: dict[str, Any] = {}
        if outcome.ok:
            judged = judge.errors_of(outcome) if judge else contacts_of(outcome.samples())
        row = Row(
            outcome.setting,
            status=outcome.status,
            force_evaluations=outcome.force_evaluations,
            sweeps=outcome.sweeps,
            unconverged=outcome.unconverged,
            frames=result.frames or (result.horizon.frames if result.horizon else None),
            judged=None if seconds is None else seconds.get(outcome.setting, ()),
            command=shlex.join([*command, *outcome.setting.words()]),
            **common,
            **about,
            **judged,
        )
        if outcome.seconds:
            times = quartiles(outcome.seconds)
            row = replace(
                row,
                wall_seconds=times.median,
                wall_lower=times.lower,
                wall_upper=times.upper,
                repeats=len(outcome.seconds),
                timed_on=outcome.timed_on,
            )
        made.append(row)
    made = [replace(row, order=order) for row, order in zip(made, _orders(made), strict=True)]
    front = pareto([_cost(row) for row in made])
    return [replace(row, pareto=on) for row, on in zip(made, front, strict=True)]


@dataclass
class _Judge:
    """A study's reference, and what it says of the study's outcomes.

    converged: outcomes with a converged solver, by setting.
    """

    scene: Scene
    reference: Reference
    horizon: Horizon
    converged: Mapping[Setting, Outcome]
    _exact: dict[Setting, Samples] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._free: np.ndarray = ~self.scene.particles.fixed
        self._true = Invariants.of(self.scene, self.reference.samples)
        self._fracture = self.scene.features().fracture
        self.floor = self.reference.floor(self.horizon)

    def errors_of(self, outcome: Outcome) -> dict[str, Any]:
        """The fields of a row that come from an outcome's samples."""
        whole, true = outcome.samples(), self.reference.samples
        samples = whole.first(self.horizon.frames)
        apart, scale = distance(samples, true, self._free), self.horizon.scale
        mine = Invariants.of(self.scene, samples)
        found: dict[str, Any] = {
            "error_final_rms": apart.final_rms,
            "error_final_max": apart.final_max,
            "error_trajectory": apart.trajectory,
            "error_trajectory_max": apart.trajectory_max,
            "error_final_rms_relative": apart.final_rms / scale,
            "error_final_max_relative": apart.final_max / scale,
            "error_trajectory_relative": apart.trajectory / scale,
            "energy_drift": mine.energy_drift(self._true),
            "momentum_drift": mine.momentum_drift(self._true),
            "max_strain": mine.strain,
            "floor": self.floor,
            "scale": scale,
            "below_floor": apart.trajectory < self.floor,
        }
        found |= self._errors_by_source(outcome.setting, samples, apart.trajectory)
        if self._fracture:
            breaks = Breaks.of(samples, true)
            found |= {
                "breaks": breaks.count,
                "breaks_agreeing": breaks.agreeing,
                "first_break": breaks.first,
                "first_break_later": breaks.later,
            }
        return found | contacts_of(whole, true)

    def _errors_by_source(
        self, setting: Setting, samples: Samples, error: float
    ) -> dict[str, float]:
        """The error of the converged step, and what the solver adds. A method without a solver has
        the first kind alone; of one whose converged run is missing, neither is known.
        """
        twin = converged(setting)
        if twin is None:
            return {"error_discretisation": error}
        if twin not in self.converged:
            return {}
        if twin not in self._exact:
            self._exact[twin] = self.converged[twin].samples().first(self.horizon.frames)
        exact = self._exact[twin]
        return {
            "error_discretisation": distance(exact, self.reference.samples, self._free).trajectory,
            "error_solver": distance(samples, exact, self._free).trajectory,
        }


def contacts_of(samples: Samples, reference: Samples | None = None) -> dict[str, Any]:
    """The fields of a row that say what contacts did in the whole run."""
    contacts = Contacts.of(samples, samples if reference is None else reference)
    return {
        "penetration_max": contacts.penetration,
        "contact_energy": contacts.energy,
        "first_touch_later": None if reference is None else contacts.later,
    }


def _orders(rows: Sequence[Row]) -> list[float | None]:
    """The power of the step by which the error fell from the next longer step of the same series,
    for each row; None where that cannot be told.
    """
    orders: list[float | None] = []
    for row in rows:
        same = [r for r in rows if r.setting.series == row.setting.series and r.step > row.step]
        longer = min(same, key=lambda r: r.step, default=None)
        here, there = _told_error(row), _told_error(longer)
        if longer is None or not here or not there:
            orders.append(None)
        else:
            orders.append(math.log(there / here) / math.log(longer.step / row.step))
    return orders


def _told_error(row: Row | None) -> float | None:
    """A trajectory error that the reference can tell from none."""
    return None if row is None or row.below_floor else row.error_trajectory


def _cost(row: Row) -> tuple[float, float] | None:
    """(seconds, error), errors that cannot be told from none taken for alike."""
    error = row.told()[1]
    if not row.ok or row.wall_seconds is None or error is None:
        return None
    return row.wall_seconds, error


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
    table.writerow(COLUMNS)
    for row in rows:
        table.writerow(map(_plain, row.record().values()))
    return text.getvalue()


def _plain(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def finite(value: Any) -> Any:
    """JSON's values with None for numbers that JSON lacks: those that overflowed."""
    if isinstance(value, Mapping):
        return {name: finite(of) for name, of in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(of) for of in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def as_json(rows: Iterable[Row], environment: Mapping[str, Any]) -> str:
    """The rows after what they were measured with."""
    whole = {"environment": finite(environment), "rows": [row.record() for row in rows]}
    return json.dumps(whole, indent=1, allow_nan=False, default=str) + "\n"
