"""Compares what the error meter says of windows with what `trade` says of the same, on scenes that
neither was made on.

    python tests/error_windows.py --starts 7 --out table.md

Each scene runs in f32, in a plane blown about; at some moments a copy of its state is a scene for
`trade`, and runs a second in each setting, or as many frames as `trade` compares, while the meter
notes a window. A row of the table for each scene and setting; a line on stderr for each window.
"""

import argparse
import sys
from dataclasses import replace

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.error_meter.meter import ErrorMeter
from taichi_cloth.error_meter.window import Window
from taichi_cloth.scene import library
from taichi_cloth.settings.options import TradeOptions
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.trade import rows
from taichi_cloth.trade.conditions import conditions, without_mouse
from taichi_cloth.trade.outcomes import StudyFailure
from taichi_cloth.trade.runner import Study
from taichi_cloth.trade.settings import Setting

SCENES = (
    ("cloth", {"columns": 11, "rows": 9, "pins": 2, "stiffness": 0.3}),
    ("chain", {"particles": 23, "stiffness": 0.2}),
    ("slinky", {"particles": 61}),
    ("box", {"particles": 12, "radius": 24.0}),
    ("cloth", {"columns": 23, "rows": 17, "pins": 5, "gravity": 0.04}),
    ("chain", {"particles": 9, "mode": 4}),
    ("slinky", {"particles": 140}),
    ("box", {"particles": 40, "radius": 15.0}),
)
SETTINGS = (("symplectic_euler", 1), ("implicit_midpoint", 2))
FRAMES, BETWEEN = 60, 45  # of a window; from one start to the next
FACTOR = 1.5  # by which both may differ
HEAD = "| scene | setting | windows | within 1.5 times | largest factor | not sure |\n"


def starts_of(scene, count, seed):
    """The scene at some moments of runs in which it is blown about, none of its springs broken and
    all of it in its world."""
    rng = np.random.default_rng(seed)
    sim = Simulation(scene.with_world(tools=True), topology="graph", execution="serial")
    found = []
    for frame in range(4 * count * BETWEEN):
        if frame % 20 < 4 and scene.world.dim == 2:
            place = sim.positions()[rng.integers(sim.particle_count)]
            sim.blow(place, rng.normal(0.0, 4.0, 2))
        sim.advance()
        x = sim.positions()
        whole = sim.springs_alive().all()
        if not (whole and (x >= scene.world.low).all() and (x <= scene.world.high).all()):
            sim.reset()
        elif (frame + 1) % BETWEEN == 0 and len(found) < count:
            moved = replace(scene.particles, position=x, velocity=sim.velocities())
            found.append(replace(scene, particles=moved))
    return found


def windows_of(starts, setting, frames):
    """Each start run in a setting for its number of frames, as a window of the error meter."""
    sim = Simulation(starts[0], setting.method, topology="graph", execution="serial")
    for scene, count in zip(starts, frames, strict=True):
        sim.load_scene(scene, setting.dt, setting.substeps)
        window = Window.opened(sim)
        for _ in range(count):
            sim.advance()
            window.note_frame(sim)
        yield window


def compared(name, given, count, seed, meter):
    """(setting, relative error by trade, that of the meter, whether it is sure) of each window."""
    scene = without_mouse(library.build(name, **given))
    starts = starts_of(library.build(name, **given), count, seed)
    starts = [without_mouse(start) for start in starts]
    chosen = [
        Setting(method, scene.world.dt, substeps, precision="f32", fast_math=True)
        for method, substeps in SETTINGS
    ]
    how = replace(conditions(scene, TradeOptions(quick=True)), budget=0.001, solver_errors=False)
    study = Study(starts, chosen, FRAMES, how)
    try:
        made = [rows.rows_of(r, {"scene_hash": "", "versions": ""}, []) for r in study.run()]
    finally:
        study.close()
    for k, setting in enumerate(chosen):
        of = [row[k] for row in made]
        windows = windows_of(starts, setting, [row.frames for row in of])
        for row, window in zip(of, windows, strict=True):
            verdict, _ = meter._ask(window)
            yield setting, row.error_trajectory_relative, verdict.relative, not verdict.trouble
            print(
                f"{name}: {setting.method}, {row.frames} frames: "
                f"trade {row.error_trajectory_relative}, {verdict.describe(False)}",
                file=sys.stderr,
                flush=True,
            )


def table(starts, out, names):
    meter = ErrorMeter(Simulation(library.build("chain")))
    total = good = 0
    for seed, (name, given) in enumerate(SCENES):
        if name not in names:
            continue
        try:
            found = list(compared(name, given, starts, seed, meter))
        except StudyFailure as failure:
            print(f"{name}: {failure}", file=sys.stderr, flush=True)
            continue
        for setting in dict.fromkeys(row[0] for row in found):
            mine = [row for row in found if row[0] == setting]
            factors = [max(a / b, b / a) if a and b else np.inf for _, a, b, _ in mine]
            within = sum(factor <= FACTOR for factor in factors)
            total, good = total + len(mine), good + within
            flags = " ".join(f"{flag} {value}" for flag, value in given.items())
            steps = f"{setting.method}, {setting.substeps}"
            unsure = sum(not sure for *_, sure in mine)
            out.write(
                f"| {name} {flags} | {steps} | {len(mine)} | {within} | {max(factors):.3f} "
                f"| {unsure} |\n"
            )
            out.flush()
    out.write(f"\n{good} of {total} windows within {FACTOR} times.\n")
    meter.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=7)
    parser.add_argument("--scenes", default="cloth,chain,slinky,box")
    parser.add_argument("--out", default="-")
    options = parser.parse_args()
    runtime.start("cpu", "f32", threads=1)
    with sys.stdout if options.out == "-" else open(options.out, "w") as to:
        to.write(HEAD + "|---" * 6 + "|\n")
        to.flush()
        table(options.starts, to, options.scenes.split(","))
