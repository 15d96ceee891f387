"""The tables of `docs/accuracy.md`, from results that `accuracy` keeps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from taichi_cloth import console
from taichi_cloth.console import duration, markdown_table
from taichi_cloth.errors import InputError, counted
from taichi_cloth.kernels import methods
from taichi_cloth.settings.options import default_fast_math, flag

MARKED = "accuracy"  # what marks the document's places
TARGETS = (0.05, 0.01, 1e-3, 1e-4, 1e-6)  # errors, in parts of the largest displacement
SHOWN = ("1", "5")  # Hz


def filled(text: str, results: Mapping[str, Any]) -> str:
    """The document with its marked places filled. Raises InputError for results that lack."""

    return console.filled(text, MARKED, lambda name, part: _content(name, part, results))


def _content(name: str, part: str | None, results: Mapping[str, Any]) -> str:
    whole = {
        "machine": _machine,
        "methods": _methods,
        "events": _events,
        "friction": _friction,
        "contacts": _contacts,
        "sweeps": _sweeps,
        "precisions": _precisions,
        "matrix": _matrix,
        "refused": _refused,
        "scenes": _scenes,
    }
    try:
        if name in whole:
            return whole[name](results)
        if name == "source":
            return _source(results[part or ""])
        if name == "cheapest":
            return _cheapest(results[part or ""]["data"])
    except KeyError as missing:
        raise InputError(f"'{name}' needs results of the part {missing}: measure it") from None
    raise InputError(f"the document asks for the unknown table '{name}'")


def in_order(names: Sequence[str]) -> list[str]:
    """Methods as they are shown: explicit ones, those that solve, those that sweep, by order."""
    claims = {name: methods.load(name).claims for name in names}
    return sorted(
        names,
        key=lambda n: (claims[n].implicit, "iterations" in claims[n].settings, claims[n].order, n),
    )


def _source(part: Mapping[str, Any]) -> str:
    """The command, and what errors were measured against."""
    lines = part["data"].get("reference", [])
    said = [f"Measured by `{part['command']}`", *(line[0].upper() + line[1:] for line in lines)]
    return f"<sub>{'. '.join(said)}.</sub>"


def _machine(results: Mapping[str, Any]) -> str:
    """Where, when and with what all was measured."""
    places: dict[tuple[str, str], list[str]] = {}
    for part in results.values():
        places.setdefault((part["machine"], part["versions"]), []).append(part["date"])
    return "\n".join(
        f"Measured on {machine}, {' to '.join(sorted({min(dates), max(dates)}))}, "
        f"with {versions}, by the command below each table."
        for (machine, versions), dates in places.items()
    )


# ------------------------------------------------------------------------------------------
# One table of all methods


def _methods(results: Mapping[str, Any]) -> str:
    orders, damping, costs = (results[p]["data"] for p in ("orders", "damping", "costs"))
    small, large = costs["small"]["methods"], costs["large"]["methods"]
    header = ["method", "order: chain, cloth", "limit dt·ω"]
    header += [f"{f} Hz: lost, pitch" for f in SHOWN]
    header += ["cost, 16 × 12", "cost, 64 × 64", "when to choose it"]
    lines = []
    for name in in_order(list(orders)):
        claims = methods.load(name).claims
        swings = [damping[name][f] for f in SHOWN]
        lines.append(
            [
                f"`{name}`",
                f"{orders[name]['chain']:.2f}, {orders[name]['cloth']:.2f}",
                _limit(claims.stability_limit),
                *(f"{_lost(s['kept'])}, {_pitch(s['pitch'])}" for s in swings),
                *(_times(of[name]["ratio"][1]) for of in (small, large)),
                claims.choose,
            ]
        )
    return markdown_table(header, lines)


def _limit(limit: float) -> str:
    return "none" if math.isinf(limit) else "never stable" if limit == 0 else f"{limit:.3g}"


def _lost(kept: float) -> str:
    """The part of the amplitude that is lost, in words where it grows."""
    if kept > 1 + 1e-9:
        return f"grows {_times(kept)} ×"
    lost = 100 * (1 - kept)
    if lost < 1e-6:
        return "0 %"
    return "> 99.9 %" if lost > 99.9 else f"{lost:.2g} %"


def _pitch(pitch: float) -> str:
    return "0 %" if abs(pitch) < 1e-8 else f"{100 * pitch:+.2g} %".replace("e-0", "e-")


def _times(ratio: float) -> str:
    return f"{ratio:.0f}" if ratio >= 100 else f"{ratio:.3g}"


# ------------------------------------------------------------------------------------------
# The rest


def _events(results: Mapping[str, Any]) -> str:
    data = results["events"]["data"]
    said = {
        "nothing": "nothing happens",
        "floor": "they hit the floor",
        "pairs": "they collide",
        "breaks": "springs break",
    }
    lines = [[f"`{n}`", *(f"{data[n][event]:.2f}" for event in said)] for n in in_order(list(data))]
    return markdown_table(["method", *said.values()], lines)


def _friction(results: Mapping[str, Any]) -> str:
    """Orders before, at and past a contact with friction, and how far what sticks has crept."""
    data = results["friction"]["data"]
    said = {
        "before": "in the air",
        "at": "as they land",
        "past": "as they slide",
        "stuck": "where they come to rest",
        "cloth_before": "a cloth in the air",
        "cloth": "as it slides",
    }
    lines = []
    for name in in_order(list(data)):
        orders = [data[name][kind] for kind in said]
        cells = ["exact" if order is None else f"{order:.2f}" for order in orders]
        lines.append([f"`{name}`", *cells, f"{data[name]['creep']:.0e}".replace("0e+00", "0")])
    return markdown_table(["method", *said.values(), "creep at rest"], lines)


def _contacts(results: Mapping[str, Any]) -> str:
    """Errors by substeps, as far as the reference tells them apart, and the last ones' time."""
    data = results["contacts"]["data"]
    rows, floor = usable(data["rows"]), data["floor"]
    told = [r for r in rows if r["error_trajectory_relative"] >= floor]
    counts = sorted({r["substeps"] for r in told})
    lines = []
    for name in in_order(sorted({r["method"] for r in rows})):
        of = {r["substeps"]: r for r in rows if r["method"] == name}
        cells = [_error(of[c], floor) if c in of else "fails" for c in counts]
        last = duration(_of_frame(of[counts[-1]])) if counts[-1] in of else ""
        lines.append([f"`{name}`", *cells, last])
    return markdown_table(["substeps", *map(str, counts), "a frame"], lines)


def usable(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Rows that have an error and a time."""
    return [r for r in rows if r["error_trajectory_relative"] is not None and r["wall_seconds"]]


def _cheapest(data: Mapping[str, Any]) -> str:
    """The cheapest setting for an error, and what the default costs to be as good."""
    from bench.accuracy.experiments import DEFAULT

    rows, floor = usable(data["rows"]), data["floor"]
    header = ["error at most", "cheapest", "a frame", f"`{DEFAULT}`", "a frame", "costs"]
    lines = []
    for target in TARGETS:
        good = [r for r in rows if max(r["error_trajectory_relative"], floor) <= target]
        if not good:
            continue
        best = min(good, key=_of_frame)
        ours = [r for r in rows if r["method"] == DEFAULT]
        enough = [r for r in ours if r in good]
        line = [f"{100 * target:g} %", _setting(best), duration(_of_frame(best))]
        if enough:
            mine = min(enough, key=_of_frame)
            substeps, cost, about = mine["substeps"], _of_frame(mine), ""
        else:  # its error falls with the first power of the step, and its cost rises alike
            mine = min(ours, key=lambda r: r["error_trajectory_relative"])
            order = methods.load(DEFAULT).claims.order
            more = (mine["error_trajectory_relative"] / target) ** (1 / order)
            substeps, cost, about = mine["substeps"] * more, _of_frame(mine) * more, "≈ "
        said = f"{about}{substeps:.0f} substep{'s' * (substeps > 1)}"
        line += [said, about + duration(cost), f"{about}{_times(cost / _of_frame(best))} ×"]
        lines.append(line)
    return markdown_table(header, lines)


def _of_frame(row: Mapping[str, Any]) -> float:
    seconds: float = row["wall_seconds"] / row["frames"]
    return seconds


def _setting(row: Mapping[str, Any]) -> str:
    sweeps = f", {row['iterations']} iterations" if row["iterations"] else ""
    return f"`{row['method']}`, {counted(row['substeps'], 'substep')}{sweeps}"


def _sweeps(results: Mapping[str, Any]) -> str:
    """The distance from the converged step, in parts of that step's own error."""
    rows = usable(results["sweeps"]["data"]["rows"])
    counts = sorted({r["iterations"] for r in rows if r["iterations"]})
    lines = []
    for name in in_order(sorted({r["method"] for r in rows if r["iterations"]})):
        for substeps in sorted({r["substeps"] for r in rows}):
            of = [r for r in rows if (r["method"], r["substeps"]) == (name, substeps)]
            by_count = {r["iterations"]: r for r in of}
            cells = [
                f"{by_count[c]['error_solver'] / by_count[c]['error_discretisation']:.2g}"
                if c in by_count
                else "fails"
                for c in counts
            ]
            lines.append([f"`{name}`, {counted(substeps, 'substep')}", *cells])
    return markdown_table(["sweeps", *map(str, counts)], lines)


def _precisions(results: Mapping[str, Any]) -> str:
    """Errors by substeps, and what a frame costs where steps are shortest."""
    data = results["precisions"]["data"]
    rows, floor = usable(data["rows"]), data["floor"]
    counts = sorted({r["substeps"] for r in rows})
    lines = []
    for name in in_order(sorted({r["method"] for r in rows})):
        series = dict.fromkeys((r["precision"], r["fast_math"]) for r in rows)
        base = None
        for kind in series:
            of = {r["substeps"]: r for r in rows if (r["method"], *series_of(r)) == (name, *kind)}
            cells = [_error(of[c], floor) if c in of else "fails" for c in counts]
            cost = _of_frame(of[counts[-1]]) if counts[-1] in of else math.nan
            base = base or cost
            lines.append([f"`{name}`", called(*kind), *cells, _times(cost / base)])
    return markdown_table(["method", "numbers", *map(str, counts), "cost"], lines)


def series_of(row: Mapping[str, Any]) -> tuple[str, bool]:
    return row["precision"], row["fast_math"]


def called(precision: str, fast_math: bool) -> str:
    """A precision in words."""
    lacks = default_fast_math(precision) and not fast_math
    return f"{precision} without fast_math" if lacks else precision


def _error(row: Mapping[str, Any], floor: float) -> str:
    error = row["error_trajectory_relative"]
    return f"≤ {floor:.0e}" if error < floor else f"{error:.1e}"


# ------------------------------------------------------------------------------------------
# Every method on every kind of scene


def _matrix(results: Mapping[str, Any]) -> str:
    """A row for each scene and method; cells of what is refused have the number of its reason."""
    data = results["matrix"]["data"]
    reasons, ways = _reasons(data), _ways(data)
    lines = []
    for scene, of in data.items():
        for name in in_order(list(of["cells"])):
            cells = [of["cells"][name].get(way) for way in ways]
            lines.append([f"`{scene}`", f"`{name}`", *(_cell(cell, reasons) for cell in cells)])
    return markdown_table(["scene", "method", *ways], lines)


def _ways(data: Mapping[str, Any]) -> list[str]:
    """The columns: topology and precision."""
    cells = (cells for of in data.values() for cells in of["cells"].values())
    return list(dict.fromkeys(way for of in cells for way in of))


def _reasons(data: Mapping[str, Any]) -> list[str]:
    """Why cells have no error, each reason once."""
    cells = (c for of in data.values() for row in of["cells"].values() for c in row.values())
    return list(dict.fromkeys(_reason(cell) for cell in cells if "error" not in cell))


def _reason(cell: Mapping[str, Any]) -> str:
    """Why a cell has no error."""
    said: str = cell.get("refused") or cell["not measured"]
    return said


def _cell(cell: Mapping[str, Any] | None, reasons: Sequence[str]) -> str:
    if cell is None:
        return ""
    if "error" in cell:
        return f"{cell['error']:.1e}"
    word = "refused" if "refused" in cell else "not measured"
    return f"{word} ({reasons.index(_reason(cell)) + 1})"


def _refused(results: Mapping[str, Any]) -> str:
    said = _reasons(results["matrix"]["data"])
    return "\n".join(f"{k}. {reason}" for k, reason in enumerate(said, 1)) or "Nothing is refused."


def _scenes(results: Mapping[str, Any]) -> str:
    """The way the scenes of the matrix were run."""
    lines = []
    for name, of in results["matrix"]["data"].items():
        words = [name, *(f"{flag(k)} {v:g}" for k, v in of["parameters"].items())]
        numbers = (of["particles"], of["frames"], of["substeps"])
        lines.append([f"`{' '.join(words)}`", of["features"], *map(str, numbers)])
    return markdown_table(["scene", "features", "particles", "frames", "steps a frame"], lines)
