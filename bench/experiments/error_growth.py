"""Compares for how long the error meter trusts a state with what disturbances do to it.

    python -m bench.experiments.error_growth --starts 3 --out table.md

The meter watches one disturbance for a second, and says by its rate in what time a millionth of the
displacement grows to the error. Here several others, of other chance, are followed from the same
start, one by one, until they have grown to that error, or for six seconds: no rate is taken.
A row of the table for each scene; a line on stderr for each window.
"""

import argparse
import math
import sys
from dataclasses import replace

import numpy as np

from bench.experiments.error_windows import scenes_of, settings_of, starts_of, windows_of
from taichi_cloth import runtime
from taichi_cloth.error_meter.meter import ErrorMeter
from taichi_cloth.error_meter.verdict import MILLIONTH
from taichi_cloth.error_meter.window import FRAMES
from taichi_cloth.scene import library
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.trade import reference
from taichi_cloth.trade.conditions import without_mouse

DISTURBANCES = 5
LONGEST = 6 * FRAMES
HEAD = "| scene | windows | said [s] | seen [s] | seen / said |\n"


def seconds_until(scene, substeps, size, error):
    """In what time disturbances of a size grow to an error, each; infinite: not in `LONGEST`."""
    sims = [
        Simulation(scene, reference.fine_method(), topology="graph", execution="serial",
                   substeps=substeps)
        for _ in range(2)
    ]  # fmt: skip
    free = ~scene.particles.fixed
    for seed in range(1, DISTURBANCES + 1):
        for sim, of in zip(sims, (scene, reference.disturbed(scene, size, seed)), strict=True):
            sim.load_scene(of, substeps=substeps)
        for frame in range(LONGEST):
            square = (sims[0].positions() - sims[1].positions())[free] ** 2
            if math.sqrt(square.sum(axis=1).mean()) >= error:
                yield frame / FRAMES
                break
            for sim in sims:
                sim.advance()
        else:
            yield math.inf


def compared(source, count, seed, meter):
    """(seconds said, median of those seen) of each window."""
    given = source.build()
    setting = settings_of(without_mouse(given), loose=False)[0]
    starts = [without_mouse(s) for s in starts_of(given, count, seed, setting.substeps)]
    windows = windows_of(starts, replace(setting, precision="f64"), [FRAMES] * len(starts))
    for scene, window in zip(starts, windows, strict=True):
        verdict, _ = meter._ask(window, math.inf)
        verdict = meter._ask_parts(()) if verdict.known else verdict
        size = MILLIONTH * verdict.scale
        substeps = reference.coarsest(scene, scene.world.dt, 2)
        seen = list(seconds_until(scene, substeps, size, verdict.error))
        print(f"{source.name}: {verdict.describe(False)}; seen {seen}", file=sys.stderr, flush=True)
        yield verdict.ahead, float(np.median(seen))


def table(options, out):
    meter = ErrorMeter(Simulation(library.build("chain")))
    for seed, source in enumerate(scenes_of(options.scenes)):
        found = np.array(list(compared(source, options.starts, seed, meter)))
        said, seen = found.T
        both = np.isfinite(found).all(axis=1)
        parts = ", ".join(f"{b / a:.2f}" for a, b in found[both])
        words = " ".join([source.name, *source.flags()]).replace("--", "")
        numbers = (
            ", ".join(f"{n:.2g}" if np.isfinite(n) else other for n in column)
            for column, other in ((said, "no growth"), (seen, f"over {LONGEST / FRAMES:g}"))
        )
        out.write(f"| {words} | {len(found)} | {' | '.join(numbers)} | {parts} |\n")
        out.flush()
    meter.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=3)
    parser.add_argument("--scenes", nargs="+", default=["chain", "slinky", "box"])
    parser.add_argument("--out", default="-")
    options = parser.parse_args()
    runtime.start("cpu", "f64", threads=1)
    with sys.stdout if options.out == "-" else open(options.out, "w") as to:
        to.write(HEAD + "|---" * 5 + "|\n")
        to.flush()
        table(options, to)
