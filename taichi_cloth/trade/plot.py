"""The work-precision plot: error against time, and against the step."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from taichi_cloth.errors import printable
from taichi_cloth.trade.outcomes import Result
from taichi_cloth.trade.rows import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.typing import ColorType

MARKERS = "osD^vP*X"
LEAST = 1e-17  # what a logarithmic axis shows of an error that is zero
LINES = {"f64": "-", "f32": "--", "compensated": ":"}


class SeriesStyle(NamedTuple):
    """The look of a series."""

    color: ColorType
    linestyle: str
    marker: str


Styles = dict[tuple[Any, ...], SeriesStyle]  # by `Setting.series`


def draw(result: Result, rows: Sequence[Row], kinds: Sequence[str]) -> dict[str, bytes]:
    """The plot as files of these kinds ("png", "svg"); none where there is no error to show."""
    errors = [e for row in rows if row.ok and (e := row.told()[1]) is not None]
    if not (errors and result.reference and result.horizon):
        return {}
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter

    judged = any(row.judged is not None for row in rows)
    floor = LEAST if judged else result.reference.floor(result.horizon) / result.horizon.scale
    floor = max(floor, LEAST)
    figure = Figure(figsize=(13, 6.5), layout="constrained")
    of_time, of_step = figure.subplots(1, 2, sharey=True)
    styles = _styles(rows)
    for series in dict.fromkeys(row.setting.series for row in rows):
        alike = sorted((r for r in rows if r.setting.series == series), key=lambda r: -r.step)
        _draw_series(of_time, of_step, alike, styles[series], floor)
    shown = [max(error, floor) for error in errors]
    # Failures are drawn along the upper edge.
    room = 2 if all(row.ok for row in rows) else 10
    top, bottom = room * max(shown), min(shown) / 4
    of_time.set(xscale="log", yscale="log", ylim=(bottom, top))
    steps = [row.step for row in rows]
    of_step.set(xscale="log", xlim=(0.8 * min(steps), 1.25 * max(steps)))
    _draw_failures(of_time, of_step, rows, styles)
    _draw_front(of_time, rows, floor)
    for axes in (of_time, of_step):
        if floor > bottom:
            axes.axhspan(bottom, floor, color="0.9", zorder=0)
        axes.grid(True, which="major", color="0.85", linewidth=0.6)
        axes.set_axisbelow(True)
    if floor > bottom:
        says = "below what the reference can tell"
        of_step.text(
            0.98, floor, says, fontsize=8, color="0.35", ha="right", va="top",
            transform=of_step.get_yaxis_transform(),
        )  # fmt: skip
    _label_axes(of_time, of_step, rows)
    what = f"trajectory error (RMS, in % of {result.horizon.what.split(',')[0]})"
    of_time.set_ylabel("error of the worst second (RMS, in % of its motion)" if judged else what)
    of_time.yaxis.set_major_formatter(FuncFormatter(lambda part, _: f"{100 * part:.3g} %"))
    figure.suptitle(_title(result), fontsize=11, parse_math=False)  # a name's $ is a $
    _legend(figure, styles, rows)
    return {kind: file_of(figure, kind) for kind in kinds}


def _title(result: Result) -> str:
    assert result.reference and result.horizon
    name = printable(result.scene.name)
    title = (
        f"{name}: error beside cost, {len(result.scene.particles)} particles, "
        f"{result.frames or result.horizon.frames} frames; reference: {result.reference.what}"
    )
    if result.reference.event:
        title += f"\nnot smooth: {result.reference.event}"
    return title


def file_of(figure: Figure, kind: str) -> bytes:
    """A figure as a file of a kind ("png", "svg"), the same each time."""
    buffer = io.BytesIO()
    # A date would make every file another one.
    figure.savefig(buffer, format=kind, dpi=130, metadata={"Date": None} if kind == "svg" else {})
    return buffer.getvalue()


def _styles(rows: Sequence[Row]) -> Styles:
    """A colour for each method, a line for each precision, a marker for each solver setting."""
    from matplotlib import color_sequences

    palette = color_sequences["tab10"]
    methods = list(dict.fromkeys(row.setting.method for row in rows))
    solvers = list(dict.fromkeys(_solver(row) for row in rows))
    return {
        row.setting.series: SeriesStyle(
            color=palette[methods.index(row.setting.method) % len(palette)],
            linestyle=LINES.get(row.setting.precision, "-."),
            marker=MARKERS[solvers.index(_solver(row)) % len(MARKERS)],
        )
        for row in rows
    }


def _solver(row: Row) -> tuple[int | None, float | None]:
    return row.setting.iterations, row.setting.tolerance


def _draw_series(
    of_time: Axes, of_step: Axes, rows: Sequence[Row], style: SeriesStyle, floor: float
) -> None:
    ok = [(r, e) for r in rows if r.ok and (e := r.error_trajectory_relative) is not None]
    for axes, numbers in (
        (of_time, [row.a_frame(row.wall_seconds) for row, _ in ok]),
        (of_step, [row.step for row, _ in ok]),
    ):
        here = [
            (
                number,
                max(error, floor),
                "none" if row.untold else style.color,
            )
            for number, (row, error) in zip(numbers, ok, strict=True)
            if number
        ]
        if not here:
            continue
        x, y, face = zip(*here, strict=True)
        axes.plot(x, y, color=style.color, linestyle=style.linestyle, linewidth=1.2, alpha=0.8)
        axes.scatter(
            x, y, s=22, marker=style.marker, facecolors=face, edgecolors=[style.color], zorder=3
        )


def _draw_failures(of_time: Axes, of_step: Axes, rows: Sequence[Row], styles: Styles) -> None:
    """Crosses along the upper edge: at their step, and at the time that they would have taken."""
    at_step: dict[float, int] = {}
    times = []
    for row in rows:
        if row.ok:
            continue
        series = row.setting.series
        cross: dict[str, Any] = {"marker": "x", "s": 40, "color": styles[series].color, "zorder": 4}
        # One below the other where they would hide each other.
        rank = at_step[row.step] = at_step.get(row.step, -1) + 1
        height = 0.985 - 0.025 * (rank % 16)
        of_step.scatter([row.step], [height], transform=of_step.get_xaxis_transform(), **cross)
        alike = [
            (abs(r.setting.substeps - row.setting.substeps), k, seconds / r.setting.substeps)
            for k, r in enumerate(rows)
            if r.setting.series == series and (seconds := r.a_frame(r.wall_seconds))
        ]
        if alike:
            a_frame = min(alike)[2] * row.setting.substeps
            of_time.scatter([a_frame], [height], transform=of_time.get_xaxis_transform(), **cross)
            times.append(a_frame)
    if times:
        low, high = of_time.get_xlim()
        of_time.set_xlim(min(low, 0.8 * min(times)), max(high, 1.2 * max(times)))


def _label_axes(of_time: Axes, of_step: Axes, rows: Sequence[Row]) -> None:
    """Axes, and ticks that can be read: times with their unit, the steps there are."""
    from matplotlib.ticker import EngFormatter, FixedLocator, LogLocator, NullFormatter

    low, high = of_time.get_xlim()
    subs = (1.0,) if high > 100 * low else (1.0, 2.0, 5.0)
    of_time.xaxis.set_major_locator(LogLocator(subs=subs, numticks=12))
    of_time.xaxis.set_major_formatter(EngFormatter(unit="s"))
    of_time.xaxis.set_minor_formatter(NullFormatter())
    steps = sorted({row.step for row in rows})
    # The longest step is always shown; labels of neighbours would overlap where there are many.
    steps = steps[:: -max(1, -(-len(steps) // 7))]
    of_step.xaxis.set_major_locator(FixedLocator(steps))
    of_step.xaxis.set_major_formatter(lambda step, _: f"{step:.3g}")
    of_step.xaxis.set_minor_locator(FixedLocator([]))
    of_time.set_xlabel("time a frame")
    of_step.set_xlabel(f"step (the scene's time; a frame is {rows[0].setting.dt:g})")
    for axes in (of_time, of_step):
        axes.tick_params(labelsize=9)


def _draw_front(axes: Axes, rows: Sequence[Row], floor: float) -> None:
    front = [
        (seconds, max(error, floor))
        for row in rows
        if row.pareto
        and (seconds := row.a_frame(row.wall_seconds)) is not None
        and (error := row.told()[1]) is not None
    ]
    front.sort(key=lambda point: point[0])
    x, y = [point[0] for point in front], [point[1] for point in front]
    axes.step(x, y, where="post", color="black", linewidth=2.2, alpha=0.45, zorder=1)
    axes.scatter(x, y, s=110, facecolors="none", edgecolors="black", linewidths=1.0, zorder=4)


def _legend(figure: Figure, styles: Styles, rows: Sequence[Row]) -> None:
    from matplotlib.lines import Line2D

    handles: list[Line2D] = []

    def add(label: str, **look: Any) -> None:
        shown = {"color": "0.3", "linestyle": "none"} | look
        handles.append(Line2D([], [], **shown, label=label))

    colours = {row.setting.method: styles[row.setting.series].color for row in rows}
    for method, colour in colours.items():
        add(method, color=colour, linestyle="-", linewidth=2.5)
    for precision in dict.fromkeys(row.setting.precision for row in rows):
        add(precision, linestyle=LINES.get(precision, "-."))
    solvers = {
        row.setting.describe_solver() or "no solver setting": styles[row.setting.series].marker
        for row in rows
    }
    if len(solvers) > 1:
        for says, marker in solvers.items():
            add(says, marker=marker)
    add("on the Pareto front", color="black", marker="o", markersize=9, markerfacecolor="none")
    if any(row.untold for row in rows):
        add("below the reference's floor", marker="o", markerfacecolor="none")
    if any(not row.ok for row in rows):
        add("failed", marker="x", markeredgewidth=1.8)
    figure.legend(handles=handles, loc="outside right upper", fontsize=9, frameon=False)
