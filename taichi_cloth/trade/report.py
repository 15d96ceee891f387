"""A study on the terminal: a table with the Pareto front marked, and what to know about it."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from taichi_cloth import console
from taichi_cloth.console import duration
from taichi_cloth.errors import counted
from taichi_cloth.trade.reference import Horizon, Reference
from taichi_cloth.trade.rows import Row
from taichi_cloth.trade.runner import Result

if TYPE_CHECKING:
    from rich.console import Console

FRONT, FAILED, FLOOR = "●", "✗", "≤"
MOST_FAILURES = 8  # that are told one by one
# Columns that a narrow terminal goes without, the first ones first; trade.csv has them all.
SPARED = (
    *("sweeps", "forces", "quartiles", "worst at end", "strain", "energy drift"),
    *("order", "by solver"),
)


def show(result: Result, rows: Sequence[Row], to: Console) -> None:
    """Print the table and the notes below it."""
    columns = _columns(result, rows)
    spared = []
    for name in SPARED:
        if sum(_width(name, texts) for name, texts in columns.items()) <= to.width:
            break
        spared.append(name)
        del columns[name]
    frames = result.horizon.frames if result.horizon else 0
    title = f"{result.scene.name}: error beside cost over {counted(frames, 'frame')}"
    left = ("", "method", "numbers", "solver")
    table = console.table(title, columns, left, padding=(0, 1, 0, 0))
    for row, texts in zip(rows, zip(*columns.values(), strict=True), strict=True):
        table.add_row(*texts, style="red" if not row.ok else "bold" if row.pareto else None)
    to.print(table)
    for note in notes(result, rows):
        line = note if note.startswith(" ") else f"- {note}"
        to.print(line, highlight=False, markup=False, soft_wrap=True)
    if spared:
        left_out = ", ".join(reversed(spared))
        to.print(f"- left out, for the terminal is narrow: {left_out}", highlight=False)


def _width(name: str, texts: Sequence[str]) -> int:
    """Width of a column, with the space that parts it from the next."""
    return max(map(len, [name, *texts])) + 2


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
        "by solver": column(lambda row: _number(row.error_solver, _scale(result))),
        "worst at end": column(lambda row: _percent(row.error_final_max_relative)),
        "order": column(lambda row: "" if row.order is None else f"{row.order:.2f}"),
        "energy drift": column(lambda row: _percent(row.energy_drift)),
        "strain": column(lambda row: _percent(row.max_strain)),
        "breaks (as in ref.)": column(
            lambda row: f"{row.breaks} ({row.breaks_agreeing})" if row.breaks is not None else ""
        ),
        "time a frame": column(lambda row: a_frame(row, row.wall_seconds)),
        "quartiles": column(
            lambda row: f"{a_frame(row, row.wall_lower)} .. {a_frame(row, row.wall_upper)}"
        ),
        "forces": column(lambda row: str(row.force_evaluations or "")),
        "sweeps": column(lambda row: str(row.sweeps or "")),
    }
    if not any(row.breaks for row in rows):
        del columns["breaks (as in ref.)"]
    for name in ("solver", "by solver"):
        if not any(columns[name]):
            del columns[name]
    return columns


def notes(result: Result, rows: Sequence[Row]) -> list[str]:
    """What errors are, what they are measured against, and what of it to trust."""
    said = [f"{FRONT} on the Pareto front: nothing else is as good and as cheap"]
    failed = [row for row in rows if not row.ok]
    if failed:
        said.append(f"{FAILED} {len(failed)} of {len(rows)} settings failed:")
        said += [f"  {row.setting.describe()}: {row.status}" for row in failed[:MOST_FAILURES]]
    if len(failed) > MOST_FAILURES:
        said.append(f"  and {len(failed) - MOST_FAILURES} more, in trade.csv")
    if result.horizon:
        said.append(
            "error: root mean square distance from the reference, over the free particles and the "
            f"ends of all frames, in parts of {result.horizon.what}: {result.horizon.scale:.4g}"
        )
        said.append(result.horizon.describe())
    if result.reference is None:
        said.append("no reference: errors are not known")
        return said
    if result.horizon:
        said += result.reference.describe(result.horizon)
    said += _orders(result.reference, rows)
    unknown = [row for row in rows if row.ok and row.error_discretisation is None]
    if unknown:
        said.append(
            f"in {len(unknown)} settings the solver's share is not known: to converge it would "
            "take too long"
        )
    unconverged = [row for row in rows if row.unconverged]
    if unconverged:
        said.append(f"in {len(unconverged)} settings the solver missed its tolerance in some steps")
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
    exact = "" if setting.fast_math or setting.precision != "f32" else " exact"
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
    if row.error_trajectory_relative is None:
        return "not known"
    if row.below_floor and reference and horizon:
        return FLOOR + _percent(reference.floor(horizon) / horizon.scale)
    return _percent(row.error_trajectory_relative)


def _percent(part: float | None) -> str:
    """A part as a percentage of three digits; tiny ones with an exponent."""
    if part is None:
        return ""
    if part == 0:
        return "0 %"
    if part >= 1:
        return f"{100 * part:.0f} %" if part < 1e4 else f"{100 * part:.0e} %"
    return f"{100 * part:.3g} %" if part >= 1e-5 else f"{100 * part:.1e} %"


def _number(error: float | None, scale: float) -> str:
    return "" if error is None else _percent(error / scale)
