"""A study on the terminal: a table with the Pareto front marked, and what to know about it."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from taichi_cloth import console
from taichi_cloth.console import duration, percent
from taichi_cloth.errors import counted
from taichi_cloth.sweeps.within import said_of_left_out
from taichi_cloth.trade.outcomes import Result
from taichi_cloth.trade.reference import Horizon, Reference
from taichi_cloth.trade.rows import Row
from taichi_cloth.trade.seconds import SECOND

if TYPE_CHECKING:
    from rich.console import Console

FRONT, FAILED, FLOOR = "●", "✗", "≤"
MOST_FAILURES = 8  # that are told one by one
GOOD = 0.01  # parts of the largest displacement: an error that nobody sees
# Columns that a narrow terminal goes without, the first ones first; trade.csv has them all.
SPARED = (
    *("sweeps", "forces", "quartiles", "worst at end", "strain", "energy drift"),
    *(
        "middle second",
        "order",
        "energy by contacts",
        "by solver",
        "breaks (as in ref.)",
        "first touch",
    ),
    "penetration",
)
OF_CONTACTS = ("penetration", "energy by contacts", "first touch")
LEFT = ("", "method", "numbers", "solver")  # columns of text
OF_FRONT = ("method", "numbers", "substeps", "solver", "error", "time a frame")


def show(result: Result, rows: Sequence[Row], to: Console) -> None:
    """Print the table and the notes below it."""
    columns = _columns(result, rows)
    frames = result.frames or (result.horizon.frames if result.horizon else 0)
    title = f"{result.scene.name}: error beside cost over {counted(frames, 'frame')}"
    styles = ["red" if not row.ok else "bold" if row.pareto else None for row in rows]
    lines = list(zip(*columns.values(), strict=True))
    left_out = console.print_table(
        to, title, list(columns), lines, LEFT, spared=SPARED, styles=styles
    )
    for note in notes(result, rows):
        console.say(to, note if note.startswith(" ") else f"- {note}", hang=2)
    if left_out:
        names = ", ".join(reversed(left_out))
        console.say(to, f"- left out, for the terminal is narrow: {names}", hang=2)


def show_front(result: Result, rows: Sequence[Row], to: Console) -> None:
    """Print the cheapest setting at each error, and one sentence that says which to take."""
    front = sorted((row for row in rows if row.pareto), key=_by_cost)
    if not front:
        horizon = ", over the whole horizon" if (result.frames or 0) > SECOND else ""
        why = f"no setting has both an error{horizon} and a time"
        console.say(to, f"Take none of these: {why}{_more_time(result)}.")
        return
    columns = {name: of for name, of in _columns(result, front).items() if name in OF_FRONT}
    lines = list(zip(*columns.values(), strict=True))
    to.print()
    title = f"{FRONT} the front: the cheapest setting at each error"
    console.print_table(to, title, list(columns), lines, LEFT)
    taken, why = advised(front)
    error = _error(taken, result.reference, result.horizon)
    a_frame = duration(taken.a_frame(taken.wall_seconds))
    setting = taken.setting.describe()
    console.say(to, f"Take {setting} ({error}, {a_frame} a frame), {why}; this runs it:")
    console.say_command(to, taken.command)


def _more_time(result: Result) -> str:
    """Advice where there was too little time."""
    return "; give more time, or fewer --frames" if result.clock.limited else ""


def advised(front: Sequence[Row]) -> tuple[Row, str]:
    """The row of a front that most would take, and why: good to the eye, and no more than that.

    Methods that are stable at no step are left aside where others will do: a longer run than that
    of the study shows it.
    """
    from taichi_cloth.kernels import methods

    good = [row for row in front if (row.told()[1] or 0.0) <= GOOD]
    lasting = [row for row in good if methods.load(row.setting.method).claims.stability_limit > 0]
    if lasting or good:
        taken = min(lasting or good, key=_by_cost)
        return taken, f"the cheapest with an error of at most {percent(GOOD)}"
    best = min(front, key=lambda row: row.told()[1] or 0.0)
    return best, "the most accurate there is"


def _by_cost(row: Row) -> float:
    return row.wall_seconds or 0.0


def _columns(result: Result, rows: Sequence[Row]) -> dict[str, list[str]]:
    """The table's columns by their headers; those that say nothing are left out."""

    def column(text: Callable[[Row], str]) -> list[str]:
        return [text(row) if row.ok else "" for row in rows]

    def a_frame(row: Row, seconds: float | None) -> str:
        return duration(row.a_frame(seconds))

    columns = {
        "": [FRONT if row.pareto else "" if row.ok else FAILED for row in rows],
        "method": [row.setting.method for row in rows],
        "numbers": [_numbers(row) for row in rows],
        "substeps": [str(row.setting.substeps) for row in rows],
        "solver": [_solver(row) for row in rows],
        "error": [_error(row, result.reference, result.horizon) for row in rows],
        "middle second": column(lambda row: percent(row.error_second_middle) if row.known else ""),
        "by solver": column(lambda row: _number(row.error_solver, _scale(result))),
        "worst at end": column(lambda row: percent(row.error_final_max_relative)),
        "order": column(lambda row: "" if row.order is None else f"{row.order:.2f}"),
        "energy drift": column(lambda row: percent(row.energy_drift)),
        "strain": column(lambda row: percent(row.max_strain)),
        "breaks (as in ref.)": column(
            lambda row: f"{row.breaks} ({row.breaks_agreeing})" if row.breaks is not None else ""
        ),
        "penetration": column(lambda row: _plain(row.penetration_max)),
        "energy by contacts": column(lambda row: _plain(row.contact_energy)),
        "first touch": column(lambda row: _signed(row.first_touch_later)),
        "time a frame": column(lambda row: a_frame(row, row.wall_seconds)),
        "quartiles": column(
            lambda row: f"{a_frame(row, row.wall_lower)} .. {a_frame(row, row.wall_upper)}"
        ),
        "forces": column(lambda row: str(row.force_evaluations or "")),
        "sweeps": column(lambda row: str(row.sweeps or "")),
    }
    if not any(row.breaks for row in rows):
        del columns["breaks (as in ref.)"]
    for name in ("solver", "middle second", "by solver", *OF_CONTACTS):
        if not any(columns[name]):
            del columns[name]
    return columns


def notes(result: Result, rows: Sequence[Row]) -> list[str]:
    """Notes on errors: their reference, and how far to trust it."""
    said = [f"{FRONT} on the Pareto front: nothing else is as good and as cheap"]
    said += said_of_left_out(result.clock, result.left_out)
    failed = [row for row in rows if not row.ok]
    if failed:
        said.append(f"{FAILED} {len(failed)} of {len(rows)} settings failed:")
        said += [f"  {row.setting.describe()}: {row.status}" for row in failed[:MOST_FAILURES]]
    if len(failed) > MOST_FAILURES:
        said.append(f"  and {len(failed) - MOST_FAILURES} more, in trade.csv")
    judged = [row for row in rows if row.judged]
    if judged:
        said += _seconds(judged)
    if result.horizon:
        error = "errors of whole runs, in trade.csv" if judged else "error"
        said.append(
            f"{error}: root mean square distance from the reference, over the free particles and "
            f"the ends of all frames, in parts of {result.horizon.what}: {result.horizon.scale:.4g}"
        )
        said.append(result.horizon.describe())
    if result.reference is None:
        said.append("no reference: errors are not known")
        return said
    if result.horizon:
        said += result.reference.describe(result.horizon)
    said += _orders(result.reference, rows)
    if any(row.penetration_max is not None for row in rows):
        said.append(
            "penetration: the deepest at the end of a frame; energy by contacts: what they gave, "
            "summed over the steps in which they gave any; first touch: by how much it is later "
            "than the reference's; all in the scene's units"
        )
    unknown = [row for row in rows if row.ok and row.error_discretisation is None]
    if unknown:
        said.append(
            f"in {len(unknown)} settings the solver's share is not known: to converge it would "
            "take too long, or fails"
        )
    unconverged = [row for row in rows if row.unconverged]
    if unconverged:
        said.append(f"in {len(unconverged)} settings the solver missed its tolerance in some steps")
    return said


def _seconds(judged: Sequence[Row]) -> list[str]:
    """Notes on the errors of seconds, and on those that nobody can know."""
    said = [
        f"error: that of the worst of {counted(judged[0].seconds, 'second')}, each by itself from "
        "where the run stood, in parts of its motion: what run --error-meter says"
    ]
    unknown = sum(row.seconds - row.seconds_known for row in judged)
    if unknown:
        every = counted(sum(row.seconds for row in judged), "second")
        said.append(f"of {unknown} of {every} the error cannot be known: references differ there")
    return said


def _orders(reference: Reference, rows: Sequence[Row]) -> list[str]:
    """Measured orders beside the claimed ones, of f64 runs."""
    from taichi_cloth.kernels import methods

    found = []
    for method in dict.fromkeys(row.setting.method for row in rows):
        exact = [r for r in rows if (r.setting.method, r.setting.precision) == (method, "f64")]
        orders = [(row.step, row.order) for row in exact if row.order]
        if orders:
            claimed, (finest, _) = methods.load(method).claims.order, min(orders)
            measured = statistics.median(order for step, order in orders if step <= 2 * finest)
            found.append(f"{method} {measured:.2f} ({claimed})")
    if not found:
        return []
    what = "orders that survive" if reference.event else "orders"
    return [f"{what} at the finest steps (claimed): {', '.join(found)}"]


def _scale(result: Result) -> float:
    return result.horizon.scale if result.horizon else 1.0


def _numbers(row: Row) -> str:
    """'f32', with the backend where it is not the CPU."""
    setting = row.setting
    exact = " exact" if setting.lacks_fast_math else ""
    arch = "" if setting.arch == "cpu" else f"{setting.arch} "
    return f"{arch}{setting.precision}{exact}"


def _solver(row: Row) -> str:
    """The solver's settings in short: '8 sweeps', 'to 1e-06'."""
    iterations, tolerance = row.setting.iterations, row.setting.tolerance
    sweeps = counted(iterations, "sweep") if iterations else ""
    return ", ".join(filter(None, [sweeps, f"to {tolerance:g}" if tolerance else ""]))


def _error(row: Row, reference: Reference | None, horizon: Horizon | None) -> str:
    if not row.ok:
        return row.status.partition(":")[0]
    if row.judged is not None:
        return "not known" if row.error_second is None else percent(row.error_second)
    if row.error_trajectory_relative is None:
        return "not known"
    if row.untold and reference and horizon:
        return FLOOR + percent(reference.floor(horizon) / horizon.scale)
    return percent(row.error_trajectory_relative)


def _plain(number: float | None) -> str:
    return "" if number is None else f"{number:.3g}"


def _signed(number: float | None) -> str:
    """By how much, with a sign."""
    return "" if number is None else "0" if number == 0 else f"{number:+.3g}"


def _number(error: float | None, scale: float) -> str:
    return "" if error is None else percent(error / scale)
