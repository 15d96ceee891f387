"""A sweep on the terminal: a table with the Pareto front marked, and what to know about it."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from taichi_cloth.trade.rows import Row
from taichi_cloth.trade.sweep import Result

FRONT, FAILED, FLOOR = "●", "✗", "≤"
MOST_FAILURES = 8  # that are told one by one


def show(result: Result, rows: Sequence[Row], console) -> None:
    """Print the table and the notes below it."""
    from rich import box
    from rich.table import Table

    frames = result.horizon.frames if result.horizon else 0
    table = Table(
        title=f"{result.scene.name}: error beside cost over {frames} frame{'s' * (frames != 1)}",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    tears = any(row.breaks for row in rows)
    solves = any(row.error_solver is not None for row in rows)
    headers = ["", "method", "numbers", "substeps", "solver", "error", "worst at the end"]
    headers += ["of which solver"] * solves + ["order", "energy drift", "strain"]
    headers += ["breaks (as in ref.)"] * tears + ["time a frame", "forces", "sweeps"]
    for header in headers:
        left = header in ("", "method", "numbers", "solver")
        table.add_column(header, justify="left" if left else "right", no_wrap=header == "method")
    for row in rows:
        if not row.ok:
            line = [FAILED, *_setting(row), row.status.partition(":")[0]]
            table.add_row(*line, *[""] * (len(headers) - len(line)), style="red")
            continue
        line = [FRONT if row.pareto else "", *_setting(row), _error(row, result)]
        line.append(_percent(row.error_final_max_relative))
        if solves:
            line.append(_number(row.error_solver, _scale(result)))
        line += ["" if row.order is None else f"{row.order:.2f}", _percent(row.energy_drift)]
        line.append(_percent(row.max_strain))
        if tears:
            line.append("" if row.breaks is None else f"{row.breaks} ({row.breaks_agreeing})")
        a_frame = None if row.wall_seconds is None else row.wall_seconds / row.frames
        line += [seconds(a_frame), str(row.force_evaluations), str(row.sweeps or "")]
        table.add_row(*line, style="bold" if row.pareto else None)
    console.print(table)
    for note in notes(result, rows):
        console.print(
            note if note.startswith(" ") else f"- {note}",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )


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
    said += result.reference.describe(result.horizon)
    said += _orders(result, rows)
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


def _orders(result: Result, rows: Sequence[Row]) -> list[str]:
    """Measured orders beside the claimed ones, of f64 runs."""
    from taichi_cloth.kernels import methods

    found = []
    for method in dict.fromkeys(row.method for row in rows):
        of = [r for r in rows if r.method == method and r.precision == "f64" and r.order]
        if of:
            claimed = methods.load(method).CLAIMS.order
            finest = min(row.step for row in of)
            measured = statistics.median(row.order for row in of if row.step <= 2 * finest)
            found.append(f"{method} {measured:.2f} ({claimed})")
    if not found:
        return []
    what = "orders that survive" if result.reference.event else "orders"
    return [f"{what} at the finest steps (claimed): {', '.join(found)}"]


def _scale(result: Result) -> float:
    return result.horizon.scale if result.horizon else 1.0


def _setting(row: Row) -> list[str]:
    exact = "" if row.fast_math or row.precision != "f32" else " exact"
    arch = "" if row.arch == "cpu" else f"{row.arch} "
    solver = row.setting.describe_solver()
    return [row.method, f"{arch}{row.precision}{exact}", str(row.substeps), solver]


def _error(row: Row, result: Result) -> str:
    if row.error_trajectory_relative is None:
        return "not known"
    if row.below_floor:
        return FLOOR + _percent(result.reference.floor(result.horizon) / result.horizon.scale)
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


def seconds(number: float | None) -> str:
    """A time with its unit, three digits."""
    if number is None:
        return ""
    for unit, scale in (("s", 1.0), ("ms", 1e3), ("µs", 1e6)):
        if number * scale >= 1:
            return f"{number * scale:.3g} {unit}"
    return f"{number * 1e9:.3g} ns"
