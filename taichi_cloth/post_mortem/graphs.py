"""The graphs of a post-mortem: h omega, energy and strain over time, up to the failure."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.kernels import methods
from taichi_cloth.post_mortem.causes import DAMPINGS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from taichi_cloth.post_mortem.examine import PostMortem

FEW = 9  # numbers beside an axis
LARGEST = 1e30  # what a graph shows of numbers that overflow


def draw(found: PostMortem) -> str:
    """The graphs as an SVG element."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 7.5), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    samples = found.trace.samples
    time = np.array([sample.time for sample in samples])
    marker = "." if len(time) < 40 else ""
    _reach(axes[0], found, time, marker)
    for name, color in (("total", "0.2"), ("moving", "tab:blue"), ("drift", "tab:red")):
        label = {"moving": "of motion and springs", "drift": "from nothing"}.get(name, name)
        _line(axes[1], time, [getattr(s, name) for s in samples], marker, color, label)
    _scaled(axes[1], [abs(s.moving) for s in samples])
    axes[1].set_ylabel("energy")
    axes[1].legend(loc="best", fontsize=8)
    strained = [100 * abs(s.strain) for s in samples]
    _line(axes[2], time, strained, marker, "tab:green", "largest strain")
    _scaled(axes[2], strained)
    axes[2].set_ylabel("largest strain, %")
    axes[2].set_xlabel("time (the scene's)")
    for each in axes:
        _mark(each, found)
        each.grid(True, color="0.88", linewidth=0.6)
        each.set_axisbelow(True)
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    svg = buffer.getvalue()
    return svg[svg.index("<svg") :]


def _reach(axes: Axes, found: PostMortem, time: np.ndarray, marker: str) -> None:
    samples, settings = found.trace.samples, found.trace.settings
    limit = methods.load(settings.method).claims.stability_limit
    reach = [sample.reach for sample in samples]
    _line(axes, time, reach, marker, "tab:purple", "h omega of the fastest mode")
    if 0 < limit < np.inf:
        axes.axhline(limit, color="tab:red", ls="--", lw=1, label=f"{settings.method}: {limit:.4g}")
    _scaled(axes, reach)
    axes.set_ylabel("h omega")
    if found.cause.kind in DAMPINGS:
        damped = [sample.damped for sample in samples]
        _line(axes, time, damped, marker, "tab:brown", "h d, its damping")
        _scaled(axes, [*reach, *damped])
        axes.set_ylabel("h omega, h d")
    axes.legend(loc="best", fontsize=8)


def _line(
    axes: Axes, time: np.ndarray, values: list[float], marker: str, color: str, label: str
) -> None:
    shown = np.array(values, np.float64)
    shown[~(np.abs(shown) < LARGEST)] = np.nan
    axes.plot(time, shown, marker=marker, color=color, lw=1.4, label=label)


def _scaled(axes: Axes, values: list[float]) -> None:
    """Go by powers where values differ by many."""
    seen = np.array([v for v in values if 0 < v < LARGEST])
    if len(seen) and seen.max() > 100 * np.median(seen):
        least = float(np.quantile(seen, 0.1)) or 1.0
        axes.set_yscale("symlog", linthresh=least)
        axes.autoscale_view()
        # Numbers beside 0 would lie on each other.
        ticks = [at for at in axes.get_yticks() if at == 0 or abs(at) > 10 * least]
        axes.set_yticks(ticks[:: 1 + len(ticks) // FEW])


def _mark(axes: Axes, found: PostMortem) -> None:
    """Lines where the frame that failed begins, where the cause is seen first, and acts."""
    samples = found.trace.samples
    failed = next((s.time for s in samples if s.part > 0), None)
    if failed is not None:
        axes.axvspan(failed, max(samples[-1].time, failed), color="tab:red", alpha=0.12)
        axes.axvline(failed, color="tab:red", lw=1)
    if found.cause.sample >= 0:
        axes.axvline(samples[found.cause.sample].time, color="tab:orange", lw=1.2, ls=":")
