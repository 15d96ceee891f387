"""Reports of `stability`: on the terminal, as CSV, and as pictures."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth import console
from taichi_cloth.errors import printable
from taichi_cloth.files.pending import write_all
from taichi_cloth.kernels import methods
from taichi_cloth.limits.auto_step import SAFETY
from taichi_cloth.limits.rounding import Stall
from taichi_cloth.scene.model import Scene
from taichi_cloth.stability.experiment import Map, StepLimits, claimed

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DIFFERENT = 0.01  # parts by which limits in two winds differ enough to be said
FILES = ("stability.csv", "stability-map.csv", "stability.png", "stability.svg")


def write(
    folder: Path,
    scene: Scene,
    limits: Sequence[StepLimits],
    maps: Sequence[Map],
    stall: Stall,
) -> list[Path]:
    """Write the files, each whole or not at all; return their paths."""
    table = [_record(scene, of_method, stall) for of_method in limits]
    points = [
        {
            "method": m.method,
            "map": m.kind,
            "factor": factor,
            "dt": h,
            "stable": "yes" if stable else "no",
            "dt_computed": m.line[m.factor.index(factor)],
        }
        for m in maps
        for factor, h, stable in m.points
    ]
    header = ["method", "map", "factor", "dt", "stable", "dt_computed"]
    contents = {
        FILES[0]: _csv(list(table[0]), table),
        FILES[1]: _csv(header, points),
    }
    figure = _figure(scene, limits, maps)
    for name, kind in ((FILES[2], "png"), (FILES[3], "svg")):
        buffer = io.BytesIO()
        figure.savefig(buffer, format=kind, dpi=130)
        contents[name] = buffer.getvalue()
    write_all({folder / name: content for name, content in contents.items()})
    return [folder / name for name in FILES]


def _record(scene: Scene, found: StepLimits, stall: Stall) -> dict[str, Any]:
    """One row of stability.csv."""
    limit = found.limit
    return {
        "scene": printable(scene.name),
        "method": found.method,
        "dt_gershgorin": found.dt_gershgorin,
        "dt_any_geometry": found.dt_any_geometry,
        "dt_computed": limit.dt,
        "dt_measured": "" if found.dt_measured is None else found.dt_measured,
        "status": found.status,
        "omega": math.sqrt(limit.omega2),
        "damping_rate": limit.damping,
        "spring": limit.spring if limit.spring >= 0 else "",
        "spring_from": limit.ends[0] if limit.spring >= 0 else "",
        "spring_to": limit.ends[1] if limit.spring >= 0 else "",
        "spring_share": limit.share,
        "particle": limit.particle if limit.particle >= 0 else "",
        "dt_f32_stall": stall.dt,
        "f32_stall": stall.describe(),
        "runs": found.runs,
        "steps": found.steps,
    }


def _csv(header: Sequence[str], records: Sequence[Mapping[str, Any]]) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, header, lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return text.getvalue().encode()


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    if math.isinf(value):
        return "every"
    return "none" if value == 0 else f"{value:.4g}"


def show(scene: Scene, limits: Sequence[StepLimits], stall: Stall, all_methods: bool) -> None:
    """Print the table and what is to be known about it.

    all_methods: whether it is about all of them, and not about one that was chosen.
    """
    to = console.output()
    heads = ["method", "Gershgorin", "any geometry", "computed", "measured", "off by", "set by"]
    title = f"largest stable step, {scene.name}"
    lines = [_line(found) for found in limits]
    spared = ("Gershgorin", "any geometry")
    left_out = console.print_table(
        to, title, heads, lines, left=("method", "set by"), spared=spared
    )
    for says in dict.fromkeys(of.limit.describe() for of in limits if of.limit.spring >= 0):
        console.say(to, says[0].upper() + says[1:] + ".")
    for found in limits:
        if found.status != "measured":
            console.say(to, f"{found.method}: {found.status}", hang=2)
    dt = scene.world.dt
    says = f"The scene's frame is {dt:g}; --dt auto stays below {SAFETY} of 'any geometry'."
    console.say(to, says)
    free = [m for m in methods.METHODS if math.isinf(claimed(m))]
    if all_methods and free:
        console.say(to, f"Stable at every step: {', '.join(free)}.")
    where = f" ({stall.describe()})" if stall.particle >= 0 else ""
    says = f"f32 stalls below a step of {stall.dt:.3g}" if stall.dt else "f32 stalls nowhere"
    console.say(to, f"{says}{where}.")
    if left_out:
        console.say(to, f"Left out, for the terminal is narrow: {', '.join(left_out)}.")


def say_of_wind(
    rates: np.ndarray, limits: Sequence[StepLimits], as_it_starts: Mapping[str, float]
) -> None:
    """Say what is counted of the wind, where there is any, and what that does to the table.

    rates: damping of each particle (n,). as_it_starts: by method, the limit with the drag that the
    triangles have at the scene's start, as they stand.
    """
    if not rates.max(initial=0.0) > 0:
        return
    to = console.output()
    console.say(
        to,
        f"Of the wind its damping is counted, at its strongest: a rate of {rates.max():.4g}. "
        "What flutters in it grows at every step: that is physics, and not measured here.",
    )
    others = [
        f"{of.method} {_number(as_it_starts[of.method])}"
        for of in limits
        if 0 < of.limit.dt < math.inf
        and not math.isclose(as_it_starts[of.method], of.limit.dt, rel_tol=DIFFERENT)
    ]
    if others:
        console.say(
            to,
            "That drag is of triangles across the wind, which bounds it however they turn. "
            f"As they stand at the start, limits are: {', '.join(others)}.",
        )


def _line(found: StepLimits) -> list[str]:
    """A method's line of the table."""
    measured, limit = found.dt_measured, found.limit
    difference = ""
    if measured and 0 < limit.dt < math.inf and measured < math.inf:
        difference = f"{100 * (measured / limit.dt - 1):+.2f} %"
    steps = found.dt_gershgorin, found.dt_any_geometry, limit.dt, measured
    says = f"spring {limit.spring}" if limit.spring >= 0 else limit.describe()
    return [found.method, *map(_number, steps), difference, says]


COLOURS = {True: "#2274a5", False: "#e8743b"}  # stable, unstable: apart for the colour-blind too


AXES = {
    "stiffness": "stiffness of all springs / the scene's",
    "mass": "mass of every second particle / the scene's",
}


def _figure(scene: Scene, limits: Sequence[StepLimits], maps: Sequence[Map]) -> Figure:
    """Maps of dt by stiffness and by mass ratio, a column a method, with the computed line."""
    from matplotlib.figure import Figure

    drawn = [of for of in limits if any(m.method == of.method for m in maps)]
    count = f"{len(scene.particles)} particles, {len(scene.springs)} springs"
    title = f"Stable and unstable runs of {printable(scene.name)} ({count})"
    if not drawn:
        figure = Figure(figsize=(7, 3))
        lines = [f"{of.method}: {of.status}" for of in limits]
        figure.text(0.5, 0.5, "No map.\n" + "\n".join(lines), ha="center", va="center")
        figure.suptitle(title, parse_math=False)
        return figure
    kinds = [kind for kind in AXES if any(m.kind == kind for m in maps)]
    figure = Figure(figsize=(1.2 + 3.6 * max(len(drawn), 2), 1.2 + 3.5 * len(kinds)))
    panels = figure.subplots(len(kinds), len(drawn), sharex="row", sharey="row", squeeze=False)
    for i, kind in enumerate(kinds):
        for j, of in enumerate(drawn):
            panel = panels[i][j]
            for m in maps:
                if (m.method, m.kind) == (of.method, kind):
                    _draw_map(panel, m, of)
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.set_xlabel(AXES[kind])
            if i == 0:
                panel.set_title(of.method)
            if j == 0:
                panel.set_ylabel("step dt (the scene's time)")
            panel.grid(True, which="major", alpha=0.25, linewidth=0.6)
    handles: dict[str, Artist] = {}
    for panel in panels.ravel():
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(
        list(handles.values()), list(handles), loc="lower center", ncols=len(handles), frameon=False
    )
    figure.suptitle(title, parse_math=False)
    figure.tight_layout(rect=(0, 0.06, 1, 0.98))
    return figure


def _draw_map(panel: Axes, drawn: Map, found: StepLimits) -> None:
    marks = {True: ("o", "stable run"), False: ("x", "unstable run")}
    for stable, (marker, label) in marks.items():
        points = [(factor, h) for factor, h, was in drawn.points if was == stable]
        if points:
            style: dict[str, Any] = {"color": COLOURS[stable]}
            if stable:
                style = {"facecolors": "none", "edgecolors": COLOURS[stable]}
            factors, steps = zip(*points, strict=True)
            panel.scatter(factors, steps, marker=marker, s=22, label=label, **style)
    panel.plot(drawn.factor, drawn.line, color="black", linewidth=1.5, label="computed limit")
    if found.dt_measured:
        panel.scatter(
            [1.0], [found.dt_measured], marker="D", s=42, color="black", zorder=3,
            label="measured limit of the scene",
        )  # fmt: skip
