"""Compares what the error meter says of windows with what `trade` says of the same, on scenes that
neither was made on.

    python -m bench.experiments.error_windows --starts 7 --out table.md
    python -m bench.experiments.error_windows --scenes tests/held_out/*.toml

Each scene runs in f32, in a plane blown about; at some moments a copy of its state is a scene for
`trade`, and runs a second in each setting, or as many frames as `trade` compares, while the meter
notes a window, where it takes so few. Where the meter judges the beginning of that alone, both are
compared over that.
A row of the table for each scene and setting; a line on stderr for each window.
"""

import argparse
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.error_meter.meter import ErrorMeter
from taichi_cloth.error_meter.window import LEAST, Window
from taichi_cloth.scene import library
from taichi_cloth.scene.source import SceneSource, names_file
from taichi_cloth.settings.sweeps import TradeOptions
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.trade import errors, reference
from taichi_cloth.trade.conditions import conditions, without_mouse
from taichi_cloth.trade.outcomes import StudyFailure
from taichi_cloth.trade.runner import Study
from taichi_cloth.trade.settings import Setting

SCENES = (  # built-in ones, with other parameters than their own
    ("cloth", {"columns": 11, "rows": 9, "pins": 2, "stiffness": 0.3}),
    ("chain", {"particles": 23, "stiffness": 0.2}),
    ("slinky", {"particles": 61}),
    ("box", {"particles": 12, "radius": 24.0}),
    ("cloth", {"columns": 23, "rows": 17, "pins": 5, "gravity": 0.04}),
    ("chain", {"particles": 9, "mode": 4}),
    ("slinky", {"particles": 140}),
    ("box", {"particles": 40, "radius": 15.0}),
)
CONTACTS = (  # those in which much touches: `trade` takes long for a window of them
    ("drape", {"side": 15}),
    ("trampoline", {"side": 13}),
    ("stack", {"sheets": 2, "side": 9}),
    ("pull", {}),
)
LOOSE = 0.03  # tolerance of a solver that stops early
FRAMES, BETWEEN = 60, 45  # of a window; from one start to the next
FACTOR = 1.5  # by which both may differ
HEAD = "| scene | setting | windows | within 1.5 times | largest factor | not sure |\n"


def settings_of(scene, loose):
    """An explicit method at its largest stable step or so, an implicit one with two steps a frame,
    and one whose solver stops early, if `loose`.
    """
    stable = 1
    if reference.coarsest(scene, scene.world.dt, 0.5) > 1:
        stable = reference.coarsest(scene, scene.world.dt, 1.0)
    method = "implicit_midpoint", scene.world.dt, 2
    chosen = [Setting("symplectic_euler", scene.world.dt, stable), Setting(*method)]
    if loose:
        chosen.append(Setting("implicit_euler", *method[1:], tolerance=LOOSE))
    return [replace(one, precision="f32", fast_math=True) for one in chosen]


def starts_of(scene, count, seed, substeps):
    """The scene at some moments of runs in which it is blown about, none of its springs broken and
    all of it in its world."""
    rng = np.random.default_rng(seed)
    sim = Simulation(
        scene.with_world(tools=True), topology="graph", execution="serial", substeps=substeps
    )
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
        elif (frame + 1) % BETWEEN == 0:
            moved = replace(scene.particles, position=x, velocity=sim.velocities())
            found.append(replace(scene, particles=moved))
            if len(found) == count:
                break
    return found


def windows_of(starts, setting, frames):
    """Each start run in a setting for its number of frames, as a window of the error meter."""
    given = {"tolerance": setting.tolerance} if setting.tolerance else {}
    sim = Simulation(starts[0], setting.method, topology="graph", execution="serial", **given)
    for scene, count in zip(starts, frames, strict=True):
        sim.load_scene(scene, setting.dt, setting.substeps)
        window = Window.opened(sim)
        for _ in range(count):
            sim.advance()
            window.note_frame(sim)
        yield window


def error_over(result, setting, frames):
    """The relative error that `trade` has of a setting over the first frames; None: of none."""
    if result.reference is None or result.horizon.frames < frames:
        return None
    (outcome,) = (one for one in result.outcomes if one.setting == setting)
    if not outcome.ok:
        return None
    true, free = result.reference.samples.first(frames), ~result.scene.particles.fixed
    scale, _ = reference.extent(result.scene, true)
    return errors.distance(outcome.samples().first(frames), true, free).trajectory / scale


def compared(source, count, seed, meter, asked):
    """(setting, relative error by trade, that of the meter, whether it is sure) of each window."""
    given = source.build()
    scene = without_mouse(given)
    chosen = settings_of(scene, source.is_file)
    starts = [without_mouse(s) for s in starts_of(given, count, seed, chosen[0].substeps)]
    how = replace(conditions(scene, TradeOptions()), budget=0.001, patience=5.0)
    how = replace(how, solver_errors=False)
    study = Study(starts, chosen, asked, how)
    try:
        results = study.run()
        yield from _beside(source.name, results, starts, chosen, meter)
    finally:
        study.close()


def _beside(name, results, starts, chosen, meter):
    for setting in chosen:
        frames = [result.horizon.frames for result in results]
        windows = windows_of(starts, setting, frames)
        for result, window in zip(results, windows, strict=True):
            if window.frames < LEAST:
                said = f"trade compares {window.frames} frames, of which the meter says nothing"
                print(f"{name}: {setting.method}: {said}", file=sys.stderr, flush=True)
                continue
            verdict, _ = meter._ask(window, math.inf)
            judged = verdict.judged or window.frames
            true = error_over(result, setting, judged)
            yield setting, true, verdict.relative, not verdict.trouble
            print(
                f"{name}: {setting.method}, {judged} of {window.frames} frames: "
                f"trade {true}, {verdict.describe(False)}",
                file=sys.stderr,
                flush=True,
            )


def scenes_of(words):
    """The scenes that words stand for: names of built-in ones, "contacts", files."""
    for word in words:
        if names_file(word):
            yield SceneSource(word)
        for name, given in SCENES + CONTACTS:
            if word == name or (word == "contacts" and (name, given) in CONTACTS):
                yield SceneSource(name, given)


def table(options, out):
    meter = ErrorMeter(Simulation(library.build("chain")), patience=options.patience)
    total = good = 0
    for seed, source in enumerate(scenes_of(options.scenes)):
        try:
            found = list(compared(source, options.starts, seed, meter, options.frames))
        except StudyFailure as failure:
            print(f"{source.name}: {failure}", file=sys.stderr, flush=True)
            continue
        for setting in dict.fromkeys(row[0] for row in found):
            mine = [row for row in found if row[0] == setting]
            factors = [max(a / b, b / a) if a and b else np.inf for _, a, b, _ in mine]
            within = sum(factor <= FACTOR for factor in factors)
            total, good = total + len(mine), good + within
            words = " ".join([Path(source.name).stem, *source.flags()]).replace("--", "")
            steps = f"{setting.method}, {setting.substeps}"
            steps += f", tolerance {setting.tolerance:g}" if setting.tolerance else ""
            unsure = sum(not sure for *_, sure in mine)
            out.write(
                f"| {words} | {steps} | {len(mine)} | {within} | {max(factors):.3f} | {unsure} |\n"
            )
            out.flush()
    out.write(f"\n{good} of {total} windows within {FACTOR} times.\n")
    meter.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=7)
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--scenes", nargs="+", default=["cloth", "chain", "slinky", "box"])
    parser.add_argument("--patience", type=float, help="of the meter, in seconds")
    parser.add_argument("--out", default="-")
    options = parser.parse_args()
    runtime.start("cpu", "f32", threads=1)
    with sys.stdout if options.out == "-" else open(options.out, "w") as to:
        to.write(HEAD + "|---" * 6 + "|\n")
        to.flush()
        table(options, to)
