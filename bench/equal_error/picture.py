"""The search as a picture: error against time a frame, a panel for each scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from bench.equal_error.runs_file import SearchRun
from bench.equal_error.search import LEVELS
from taichi_cloth.trade.plot import MARKERS, file_of
from taichi_cloth.trade.rows import pareto

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ACROSS = 3  # panels in a row
WORST = 2.0  # larger errors are not drawn


def draw(runs: Sequence[SearchRun]) -> bytes:
    """A PNG: of each group all runs, faint, and a line along those that none beats."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(run.scene for run in runs))
    groups = list(dict.fromkeys(run.group for run in runs))
    across = max(1, min(ACROSS, len(scenes)))
    down = max(1, math.ceil(len(scenes) / across))
    figure = Figure(figsize=(4.6 * across, 3.8 * down + 0.6), layout="constrained")
    panels = figure.subplots(down, across, squeeze=False, sharey=True).ravel()
    for axes, scene in zip(panels, scenes, strict=False):
        for number, group in enumerate(groups):
            mine = [run for run in runs if (run.scene, run.group) == (scene, group)]
            _draw_group(axes, mine, f"C{number}", MARKERS[number % len(MARKERS)])
        _finish(axes, scene)
    for axes in panels[len(scenes) :]:
        axes.remove()
    for axes in panels[:: across or 1]:
        axes.set_ylabel("error, in parts of the displacement")
    _legend(figure, groups, ncols=2 * across)
    return file_of(figure, "png")


def _draw_group(axes: Axes, runs: Sequence[SearchRun], colour: str, marker: str) -> None:
    points = sorted(
        (run.seconds_a_frame, run.error)
        for run in runs
        if run.error is not None and run.seconds_a_frame is not None and 0 < run.error <= WORST
    )
    if not points:
        return
    x, y = zip(*points, strict=True)
    axes.scatter(x, y, s=9, color=colour, marker=marker, alpha=0.3, linewidths=0)
    front = [point for point, on in zip(points, pareto(points), strict=True) if on]
    x, y = zip(*front, strict=True)
    axes.plot(x, y, color=colour, marker=marker, markersize=4, linewidth=1.2)


def _finish(axes: Axes, scene: str) -> None:
    from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

    axes.set(xscale="log", yscale="log", title=scene, xlabel="time a frame")
    low, high = axes.get_xlim()
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 100 * low else (1.0, 3.0)))
    axes.xaxis.set_major_formatter(EngFormatter(unit="s"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    for level in LEVELS:
        axes.axhline(level, color="0.7", linewidth=0.7, linestyle=":", zorder=0)


def _legend(figure: Figure, groups: Sequence[str], ncols: int) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=f"C{k}", marker=MARKERS[k % len(MARKERS)], markersize=5, label=group)
        for k, group in enumerate(groups)
    ]
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=ncols, frameon=False)
