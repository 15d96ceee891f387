"""The distance of two runs over time as a picture, with what differs first."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taichi_cloth.comparison.compare import Comparison
from taichi_cloth.comparison.report import in_short, limit_of, parted_in_short
from taichi_cloth.errors import InputError, printable
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.trade.plot import file_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KINDS = ("png", "svg")
LEAST = 1e-17  # parts: what a logarithmic axis shows of less


def begun(path: str) -> PendingFile:
    """The file that a picture will be written to. InputError where none can be, or of a kind."""
    if Path(path).suffix.lower().removeprefix(".") not in KINDS:
        raise InputError(f"--picture {path}: must end with .png or .svg")
    return PendingFile(path)


def write(found: Comparison, file: PendingFile) -> None:
    """Draw a comparison into a file that was begun."""
    file.write(draw(found, file.path.suffix.lower().removeprefix(".")))
    file.commit()


def draw(found: Comparison, kind: str) -> bytes:
    """The picture as a file of a kind ("png", "svg")."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5.5), layout="constrained")
    axes = figure.subplots()
    scale = found.scale
    seen = found.max[found.max > 0] / scale
    marker = "." if len(found.time) < 60 else ""
    for name, values, style in (("max", found.max, "--"), ("rms", found.rms, "-")):
        shown = np.where(values > 0, values / scale, np.nan)
        axes.plot(found.time, shown, style, marker=marker, color="tab:blue", label=name, lw=1.4)
    limit = found.limit / scale
    axes.axhline(limit, color="0.5", lw=1, ls=":", label=f"limit, {limit_of(found)}")
    low = max(min(seen.min(initial=limit), limit) / 3, LEAST)
    top = 2 * max(seen.max(initial=limit), limit)
    top *= (top / low) ** 0.3  # room for words
    # In this order: a scale alone would first fit what there is, of the same bits a single value.
    axes.set_ylim(low, top)
    axes.set_yscale("log")
    span = (min(0.0, float(found.time[0])), float(found.time[-1]))
    axes.set_xlim(*span)
    axes.set_xlabel("time (the scene's)")
    axes.set_ylabel(f"distance of A and B, in parts of {found.scale_is.split(',')[0]} in B")
    to_length, to_parts = partial(np.multiply, scale), partial(np.multiply, 1 / scale)
    lengths = axes.secondary_yaxis("right", functions=(to_length, to_parts))
    lengths.set_ylabel("distance (the scene's unit)")
    _mark(axes, found)
    if not len(seen):
        axes.text(0.5, 0.5, "the same at all of these times", ha="center", transform=axes.transAxes)
    axes.grid(True, which="major", color="0.88", linewidth=0.6)
    axes.set_axisbelow(True)
    figure.legend(loc="outside lower center", ncols=3, fontsize=9)  # where no curve is
    title = f"A: {_short(found.a)}    B: {_short(found.b)}"
    figure.suptitle(title, fontsize=11, parse_math=False)  # a file's $ is a $
    return file_of(figure, kind)


def _mark(axes: Axes, found: Comparison) -> None:
    """Lines where something happens, with words beside them, one below the other."""
    marks = []
    if found.difference:
        marks.append((found.difference.time, "first difference", "0.35"))
    for event, colour in ((found.first_break, "tab:red"), (found.first_touch, "tab:green")):
        if event:
            marks.append((event.time, in_short(event), colour))
    if found.parted is not None:
        marks.append((found.parted, parted_in_short(found), "0.35"))
    left, right = axes.get_xlim()
    for row, (time, words, colour) in enumerate(sorted(marks)):
        axes.axvline(time, color=colour, lw=1.2, alpha=0.8)
        late = time > left + 0.6 * (right - left)
        axes.annotate(
            words, (time, 0.97 - 0.055 * row), xycoords=("data", "axes fraction"),
            xytext=(-4 if late else 4, 0), textcoords="offset points",
            ha="right" if late else "left", va="top", fontsize=9, color=colour,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1},
        )  # fmt: skip


def _short(text: str) -> str:
    """The end of a long name, which tells it from others."""
    text = printable(text)
    return text if len(text) <= 48 else f"...{text[-45:]}"
