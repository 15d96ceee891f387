"""Colliding spheres at constant density: a step, the grid's build, and its query.

The radius falls with the cube root of the count, so that a sphere always has as many neighbours.
Build: sorting all spheres into cells. Query: finding and resolving the collisions with them. C++,
compiled here, does the same (`cpp/spheres.cpp`): with cells of a diameter, as one would take
them first, and with those as wide across rows as measures best. One count is timed on one thread,
too, where no thread waits for another; and twenty spheres, with all frames of a round in a launch.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench import ours
from bench.compiled import Compiled, compiled, enter_compiled
from bench.contest import Bench, Contestant, compare, separation
from bench.report import Measurement
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.scene.library import build

PART = "contacts"
COUNTS = (1_000, 3_000, 10_000, 30_000, 100_000, 200_000)
QUICK_COUNTS = (1_000, 10_000)
DENSE = (100_000, 1.8)  # a count and the radius of its spheres, which set the density
FEW = 20  # spheres of the scene as it is
SUBSTEPS = 2  # of a frame
WORK = 100_000  # spheres times frames in a round, at least
FITTED = 10_000  # from this count on, starting threads for the loops no longer shows
WHOLE, SORT, QUERY = "whole step", "build", "query"
CPP = {"C++, cells of a diameter": 1.0, "C++, cells of 3 diameters": 3.0}
ALIKE = 2  # frames after which positions are compared: later a collision's rounding has grown
SCENE = "taichi_cloth.scene.library:build"


def measure(bench: Bench) -> Iterator[Measurement]:
    """One contest a count: whole steps, building alone, building and querying."""
    rows = []
    for count in QUICK_COUNTS if bench.quick else COUNTS:
        rows += _measure_count(bench, count)
    yield from rows
    if not bench.quick:
        yield from _measure_one_thread(bench)
    yield from _measure_few(bench)
    for name in (WHOLE, SORT, QUERY):
        exponent = fitted_exponent([row for row in rows if row.contestant == name])
        if exponent is not None:
            yield Measurement(
                part=PART,
                contestant=f"{name}: exponent of the time's growth from {FITTED} spheres on",
                rate=exponent,
                target="<= 1.2",
            )
    for row in rows:
        if row.contestant == WHOLE and row.size == f"{DENSE[0]}" and row.seconds:
            yield Measurement(
                part=PART,
                contestant=f"frames of {SUBSTEPS} steps",
                size=row.size,
                rate=1 / (SUBSTEPS * row.seconds),
                unit="frames/s",
                target=">= 10",
            )


def _measure_count(bench: Bench, count: int) -> list[Measurement]:
    radius = DENSE[1] * (DENSE[0] / count) ** (1 / 3)
    scene = (SCENE, {"name": "box", "particles": count, "radius": radius})
    settings: dict[str, Any] = {"substeps": SUBSTEPS, "topology": "graph", "execution": "parallel"}
    reference = ours.reference(bench, PART, scene, count, frames=[1], **settings)
    frames, cpp = _entered(bench, count, radius, bench.threads, "")
    if not frames or not bench.mark_after(PART, [frames, *cpp], 1):
        return []
    bench.mark_after(PART, [frames, *cpp], ALIKE - 1)
    units = SUBSTEPS * frames.units
    build, query = (
        replace(frames, name=name, method=method, steps=1, units=units, seconds=[], marks={})
        for name, method in ((SORT, "build"), (QUERY, "build_and_query"))
    )
    finished = bench.race(PART, [frames, *cpp, build, query])
    if query in finished and build in finished:  # what querying takes is the difference
        pairs = zip(query.seconds, build.seconds, strict=True)
        query.seconds = [both - sorting for both, sorting in pairs]
    against = f"{ours.AGAINST}, after the first frame"
    rows = bench.rows(PART, finished, reference, against)
    for other in cpp:
        rows += compare(
            PART, f"{count}", f"{WHOLE} to {other.name}" if other else "", frames, other, ">= 0.7"
        )
        rows += separation(PART, frames, other, ALIKE, "px")
    frames.drop()
    return rows


def _entered(
    bench: Bench, count: int, radius: float, threads: int, how: str
) -> tuple[Contestant | None, list[Contestant | None]]:
    """Whole steps of ours, and those of C++; how: what their names say of the threads."""
    shared: dict[str, Any] = {
        "size": f"{count}",
        "particles": count,
        "units": max(1, WORK // count),
        "threads": threads,
    }
    frames = ours.enter(
        bench,
        PART,
        WHOLE + how,
        (SCENE, {"name": "box", "particles": count, "radius": radius}),
        precision="f32",
        kind="bench.contestants:Collisions",
        substeps=SUBSTEPS,
        topology="graph",
        execution="parallel",
        **shared,
    )
    cpp = [
        enter_compiled(
            bench,
            name + how,
            f"{__name__}:CompiledSpheres",
            {"count": count, "radius": radius, "width": width, "steps": SUBSTEPS},
            steps=SUBSTEPS,
            part=PART,
            **shared,
        )
        for name, width in CPP.items()
    ]
    return frames, cpp


def _measure_one_thread(bench: Bench) -> Iterator[Measurement]:
    """Whole steps of `DENSE` on one thread, which waits for no other."""
    frames, cpp = _entered(bench, *DENSE, 1, ", one thread")
    yield from bench.rows(PART, bench.race(PART, [frames, *cpp]), {}, "")
    for other in cpp:
        name = f"{WHOLE} to {other.name}" if other else ""
        yield from compare(PART, f"{DENSE[0]}", name, frames, other, ">= 0.7")


def _measure_few(bench: Bench) -> Iterator[Measurement]:
    """A step of `FEW` spheres, where a call advances all frames of a round."""
    few = ours.enter(
        bench,
        PART,
        f"{WHOLE}, frames in one call",
        (SCENE, {"name": "box", "particles": FEW}),
        precision="f32",
        size=f"{FEW}",
        particles=FEW,
        units=WORK // FEW,
        substeps=SUBSTEPS,
        topology="graph",
        execution="serial",
    )
    yield from bench.rows(PART, bench.race(PART, [few]), {}, "")
    if few and few.seconds:
        yield Measurement(
            part=PART,
            contestant="a step, frames in one call",
            size=f"{FEW}",
            rate=1e6 * few.step_seconds,
            unit="µs",
            target="<= 8",
        )


class CompiledSpheres(Compiled):
    """Spheres of the scene `box` at random, sorted into cells `width` diameters wide."""

    def __init__(self, folder: str, count: int, radius: float, width: float, steps: int):
        self.advances = compiled(folder).sphere_steps
        scene = build("box", particles=count, radius=radius)
        p, world = scene.particles, scene.world
        self.x, self.v = (np.ascontiguousarray(a, np.float32) for a in (p.position, p.velocity))
        corners = (np.ascontiguousarray(a, np.float32) for a in (world.low, world.high))
        numbers = (
            world.dt / steps,
            world.gravity[1],
            float(p.viscous[0]),
            float(1 / p.mass[0]),
            radius,
            float(p.restitution[0]),
            2 * radius * width,
        )
        self.steps = steps
        self.arguments: tuple[Any, ...] = (count, *numbers, *corners, self.x, self.v)


def fitted_exponent(rows: Sequence[Measurement]) -> float | None:
    """p in time ~ count**p, fitted to the logarithms; None for less than two counts."""
    timed = [(int(row.size), row.seconds) for row in rows if row.seconds is not None]
    points = [(count, seconds) for count, seconds in timed if count >= FITTED]
    if len(points) < 2:
        return None
    counts, seconds = np.log(np.array(points)).T
    return float(np.polyfit(counts, seconds, 1)[0])


def plot(rows: Sequence[Measurement], path: Path) -> None:
    """Time a step by the number of spheres, both logarithmic. Raises InputError."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 4), layout="constrained")
    for name in (WHOLE, SORT, QUERY):
        mine = [row for row in rows if row.contestant == name]
        points = [(int(row.size), 1e3 * row.seconds) for row in mine if row.seconds is not None]
        exponent = fitted_exponent(mine)
        label = name if exponent is None else f"{name} (~ n^{exponent:.2f})"
        axes.loglog(*np.array(points).reshape(-1, 2).T, "o-", label=label)
    axes.set(xlabel="spheres", ylabel="ms a step", title="Collisions at constant density, f32")
    axes.grid(which="both", alpha=0.3)
    axes.legend()
    PendingFile(path).fill(
        lambda file: figure.savefig(file, format="png", dpi=120, metadata={"Software": None})
    )
    pyplot.close(figure)
