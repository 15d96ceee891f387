"""The plots of `docs/accuracy.md`, from results that `accuracy` keeps (matplotlib)."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.accuracy.experiments import DEFAULT, RATE, swing
from bench.accuracy.tables import called, in_order, series_of, usable
from taichi_cloth.errors import counted
from taichi_cloth.kernels import methods

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

SIZE = 9.0, 5.2  # inches, at 130 dots each: a page's width
MARKERS = "osD^vP*X"
GREY = 7  # of the ten colours
ALIKE = 0.02  # curves that differ by a smaller part are one
LEAST_ENERGY = 1e-14  # what is less is rounding


def draw_all(results: Mapping[str, Any]) -> dict[str, bytes]:
    """Pictures (PNG) by name, of the parts that there are."""
    drawn: dict[str, Callable[[Mapping[str, Any]], bytes]] = {
        "smooth": _trade,
        "stiff": _trade,
        "long": _long,
        "damping": _damping,
        "sweeps": _sweeps,
        "precisions": _precisions,
    }
    return {f"accuracy-{p}": draw(results[p]["data"]) for p, draw in drawn.items() if p in results}


def _figure(columns: int = 1) -> tuple[Figure, Sequence[Axes]]:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, layout="constrained")
    axes = figure.subplots(1, columns, squeeze=False)[0]
    for each in axes:
        each.grid(True, which="major", color="0.88", linewidth=0.6)
        each.set_axisbelow(True)
    return figure, axes


def _png(figure: Figure, handles: Sequence[Artist] | None = None, columns: int = 1) -> bytes:
    axes = figure.axes[0]
    if handles is None:
        handles = axes.get_legend_handles_labels()[0]
    figure.legend(
        handles=handles,
        loc="outside right upper" if columns == 1 else "outside lower center",
        fontsize=9.5,
        frameon=False,
        ncols=columns,
    )
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130)
    return buffer.getvalue()


def _look(name: str) -> dict[str, Any]:
    """A method's line: the default is black and thick, the others lie upon it in colours."""
    from matplotlib import color_sequences

    if name == DEFAULT:
        return {"color": "black", "linewidth": 3.5, "zorder": 2}
    others = [other for other in in_order(methods.METHODS) if other != DEFAULT]
    colours = [c for k, c in enumerate(color_sequences["tab10"]) if k != GREY]
    return {"color": colours[others.index(name) % len(colours)], "linewidth": 1.5, "zorder": 3}


def _label(names: Iterable[str]) -> str:
    """Methods whose curves are one, one below the other."""
    return "\n= ".join(f"{name} (default)" if name == DEFAULT else name for name in names)


def _seconds_axis(axis: Axis) -> None:
    from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    subs = (1.0,) if high > 300 * low else (1.0, 2.0, 5.0)
    axis.set_major_locator(LogLocator(subs=subs, numticks=12))
    axis.set_major_formatter(EngFormatter(unit="s"))
    axis.set_minor_formatter(NullFormatter())


# ------------------------------------------------------------------------------------------
# Error against work


def _trade(data: Mapping[str, Any]) -> bytes:
    from matplotlib.lines import Line2D

    figure, (axes,) = _figure()
    rows, floor = data["rows"], data["floor"]
    solvers = list(dict.fromkeys(r["iterations"] for r in rows if r["iterations"]))
    handles: list[Artist] = []
    for name in in_order(list(dict.fromkeys(r["method"] for r in rows))):
        look = _look(name)
        all_fail = not usable([r for r in rows if r["method"] == name])
        handles.append(Line2D([], [], **look, label=_label([name]) + ": all fail" * all_fail))
        for count in [None, *solvers]:
            of = [r for r in rows if (r["method"], r["iterations"]) == (name, count)]
            good = sorted(usable(of), key=lambda r: -r["step"])
            marker = MARKERS[[None, *solvers].index(count)]
            x = [r["wall_seconds"] / r["frames"] for r in good]
            y = [max(r["error_trajectory_relative"], floor) for r in good]
            axes.plot(x, y, **look, marker=marker, markersize=5)
            if good and count in (None, solvers[0]):
                steps = good[0]["substeps"]
                axes.annotate(
                    f"{steps}", (x[0], y[0]), (0, 7), textcoords="offset points",
                    ha="center", fontsize=8, color=look["color"],
                )  # fmt: skip
    _failures(axes, rows)
    axes.set(xscale="log", yscale="log")
    # Room for the crosses of what failed.
    axes.set_ylim(top=(2 if len(usable(rows)) == len(rows) else 50) * max(axes.get_ylim()[1], 1.0))
    axes.axhspan(axes.get_ylim()[0], floor, color="0.92", zorder=0)
    axes.set_ylim(bottom=floor / 3)
    axes.set_xlabel("time to simulate a frame")
    axes.set_ylabel("error of the trajectory (largest displacement: 1)")
    axes.set_title(data["title"], fontsize=10.5)
    _seconds_axis(axes.xaxis)
    for count in solvers:
        marker = MARKERS[[None, *solvers].index(count)]
        says = f"{count} sweeps a step"
        handles.append(Line2D([], [], color="0.3", linestyle="", marker=marker, label=says))
    if any(not r["wall_seconds"] for r in rows):
        handles.append(Line2D([], [], color="0.3", linestyle="", marker="x", label="fails"))
    handles.append(Line2D([], [], linestyle="", label="numbers: substeps where\na line begins"))
    handles.append(_band())
    return _png(figure, handles)


def _failures(axes: Axes, rows: Sequence[Mapping[str, Any]]) -> None:
    """Crosses at the upper edge, at the times that runs would have taken (at the default's, where
    all of a method fail), one below the other.
    """
    timed = usable(rows)
    ranks: dict[int, int] = {}
    for row in rows:
        if row["wall_seconds"]:
            continue
        alike = [r for r in timed if r["method"] == row["method"]]
        like = (alike or [r for r in timed if r["method"] == DEFAULT])[0]
        time = like["wall_seconds"] / like["frames"] * row["substeps"] / like["substeps"]
        rank = ranks[row["substeps"]] = ranks.get(row["substeps"], -1) + 1
        axes.plot(
            [time], [0.975 - 0.03 * rank], transform=axes.get_xaxis_transform(), linestyle="",
            marker="x", color=_look(row["method"])["color"], markeredgewidth=2, zorder=5,
        )  # fmt: skip


def _band() -> Patch:
    """The meaning of the grey band, for the legend."""
    from matplotlib.patches import Patch

    return Patch(color="0.92", label="below what the\nreference can tell")


# ------------------------------------------------------------------------------------------
# What a vibration becomes


def _damping(data: Mapping[str, Any]) -> bytes:
    figure, (amplitude, pitch) = _figure(2)
    grid = np.geomspace(0.2, 15.0, 80)
    curves = {
        name: np.array([[f, *vars(swing(methods.load(name), f)).values()] for f in grid])
        for name in data
    }
    for names in _alike(curves):
        name = names[0]
        f, kept, off = curves[name].T
        look = _look(name if DEFAULT not in names else DEFAULT)
        amplitude.plot(f, kept, **look, label=_label(names))
        pitch.plot(f, 100 * off, **look)
        measured = data[name].items()
        points = np.array([[float(f), m["kept"], 100 * m["pitch"]] for f, m in measured])
        for axes, column in ((amplitude, 1), (pitch, 2)):
            axes.plot(points[:, 0], points[:, column], "o", color=look["color"], markersize=5)
    for axes in (amplitude, pitch):
        axes.set(xscale="log", xlim=(0.2, 15))
        axes.set_xticks([0.2, 0.5, 1, 2, 5, 10], ["0.2", "0.5", "1", "2", "5", "10"])
        axes.set_xticks([], minor=True)
        axes.set_xlabel("frequency of the vibration (Hz)")
    amplitude.set_ylim(-0.03, 1.5)
    amplitude.set_ylabel("amplitude left after 1 s, in parts")
    amplitude.set_title(f"damping at {RATE} steps/s", fontsize=10.5)
    pitch.set_ylim(-15, 8)
    pitch.set_ylabel("error of its frequency (%)")
    pitch.set_title(f"pitch at {RATE} steps/s", fontsize=10.5)
    handles = amplitude.get_legend_handles_labels()[0]
    return _png(figure, handles, columns=3)


def _alike(curves: Mapping[str, Any]) -> list[list[str]]:
    """Methods in groups whose curves are one."""
    groups: list[list[str]] = []
    for name in in_order(list(curves)):
        for group in groups:
            one, other = curves[group[0]], curves[name]
            if one.shape == other.shape and np.allclose(one, other, rtol=ALIKE, atol=1e-9):
                group.append(name)
                break
        else:
            groups.append([name])
    return groups


def _long(data: Mapping[str, Any]) -> bytes:
    figure, (energy, phase) = _figure(2)
    curves = {
        name: np.array([of["period"], of["energy"], of["phase"]])
        for name, of in data["methods"].items()
    }
    for names in _alike(curves):
        k, of_energy, of_phase = curves[names[0]]
        of_energy = np.maximum(of_energy, LEAST_ENERGY)
        look = _look(DEFAULT if DEFAULT in names else names[0])
        energy.plot(k, of_energy, **look, label=_label(names))
        phase.plot(k, np.abs(of_phase), **look)
        if any(name in data["ended"] for name in names):
            for axes, y in ((energy, of_energy), (phase, np.abs(of_phase))):
                axes.plot(k[-1], y[-1], "x", color=look["color"], markersize=9, markeredgewidth=2)
    for axes in (energy, phase):
        axes.set(xscale="log", yscale="log")
        axes.set_xticks([1, 10, 100], ["1", "10", "100"])
        axes.set_xlabel("periods of the oscillator")
    energy.set_ylim(LEAST_ENERGY / 3, 100)
    energy.set_ylabel("largest error of the energy so far, in parts of it")
    energy.set_title(f"energy, at dt·ω = {data['step_times_omega']:g}", fontsize=10.5)
    phase.set_ylim(1e-4, 300)
    phase.set_ylabel("behind or ahead of the closed form (degrees)")
    phase.set_title("phase", fontsize=10.5)
    from matplotlib.lines import Line2D

    handles = energy.get_legend_handles_labels()[0]
    if data["ended"]:
        handles.append(
            Line2D(
                [], [], color="0.3", linestyle="", marker="x", markeredgewidth=2,
                label="swings too far for its spring",
            )
        )  # fmt: skip
    return _png(figure, handles, columns=3)


# ------------------------------------------------------------------------------------------
# Sweeps and precisions


def _sweeps(data: Mapping[str, Any]) -> bytes:
    figure, (axes,) = _figure()
    rows, scale = usable(data["rows"]), data["scale"]
    lines = "-", "--", ":"
    for k, substeps in enumerate(sorted({r["substeps"] for r in rows})):
        of_step = [r for r in rows if r["substeps"] == substeps]
        plural = counted(substeps, "substep")
        for name in in_order(list(dict.fromkeys(r["method"] for r in of_step))):
            of = [r for r in of_step if r["method"] == name]
            if of[0]["iterations"] is None:
                own = of[0]["error_discretisation"] / scale
                x = of[0]["wall_seconds"] / of[0]["frames"]
                says = f"converged, {plural}: its own\nerror, at the time of {name}"
                look: dict[str, Any] = {"color": "0.35", "linestyle": lines[k]}
                axes.axhline(own, **look)
                axes.plot([x], [own], marker="*", markersize=13, label=says, **look)
                continue
            of.sort(key=lambda r: r["iterations"])
            x = [r["wall_seconds"] / r["frames"] for r in of]
            y = [r["error_solver"] / scale for r in of]
            look = _look(name) | {"linestyle": lines[k]}
            axes.plot(x, y, **look, marker="o", markersize=5, label=f"{name}, {plural}")
            for row, x_, y_ in list(zip(of, x, y, strict=True))[::2]:
                axes.annotate(
                    str(row["iterations"]), (x_, y_), (5, 4), textcoords="offset points",
                    fontsize=8, color=look["color"],
                )  # fmt: skip
    axes.set(xscale="log", yscale="log")
    axes.set_xlabel("time to simulate a frame (numbers: sweeps a step)")
    axes.set_ylabel("distance from the converged step (largest displacement: 1)")
    axes.set_title(data["title"], fontsize=10.5)
    axes.set_ylim(bottom=1e-10)
    _seconds_axis(axes.xaxis)
    return _png(figure)


def _precisions(data: Mapping[str, Any]) -> bytes:
    figure, (axes,) = _figure()
    rows, floor = usable(data["rows"]), data["floor"]
    series = list(dict.fromkeys(series_of(r) for r in rows))
    lines = "-", "--", "-.", ":"
    for name in in_order(list(dict.fromkeys(r["method"] for r in rows))):
        for kind in series:
            of = [r for r in rows if r["method"] == name and series_of(r) == kind]
            of.sort(key=lambda r: r["substeps"])
            x = [r["substeps"] for r in of]
            y = [max(r["error_trajectory_relative"], floor) for r in of]
            k = series.index(kind)
            look = _look(name) | {"linestyle": lines[k % 4], "marker": MARKERS[k]}
            axes.plot(x, y, **look, markersize=5, label=f"{name}, {called(*kind)}")
    axes.set(xscale="log", yscale="log")
    axes.axhspan(axes.get_ylim()[0], floor, color="0.92", zorder=0)
    axes.set_ylim(bottom=floor / 3)
    counts = sorted({r["substeps"] for r in rows})
    axes.set_xticks(counts, [str(c) for c in counts])
    axes.set_xticks([], minor=True)
    axes.set_title(data["title"], fontsize=10.5)
    axes.set_xlabel("substeps a frame")
    axes.set_ylabel("error of the trajectory (largest displacement: 1)")
    return _png(figure, [*axes.get_legend_handles_labels()[0], _band()])
