"""Compares what the error meter says of sessions with what `compare --events` says of the same.

    python -m bench.experiments.error_sessions --sessions 5 --out table.md

A session is a second of a scene in which somebody blows (with a mouse that moves), pulls a particle
along, cuts springs and pins: a log, of seeded chance. The meter watches its replay; `compare` runs
the log again, in processes of its own, as it is and with 64 times the steps, and says how far apart
these are. Its way from the log to the steps is another one than the meter's, which knows no log.
A row of the table for each scene and setting; a line on stderr for each session.
"""

import argparse
import json
import math
import sys
import tempfile
from pathlib import Path

import numpy as np

from bench.experiments.error_windows import FACTOR, HEAD, SCENES
from taichi_cloth import runtime
from taichi_cloth.cli import replays
from taichi_cloth.error_meter.meter import ErrorMeter
from taichi_cloth.scene import library
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import CompareOptions
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.ui import app, interaction
from taichi_cloth.ui.view import View

SETTINGS = (("symplectic_euler", 1), ("implicit_midpoint", 2))
FRAMES, FINER = 60, 64


class Kept(ErrorMeter):
    """An error meter that judges nothing: it keeps its windows."""

    def __init__(self, sim):
        self.windows = []
        super().__init__(sim)

    def _judge(self, window, trials):
        self.windows.append(window)


def events_of(scene, rng):
    """The acts of a session, as lines of a log."""
    x, free = scene.particles.position, np.flatnonzero(~scene.particles.fixed)
    size = np.asarray(scene.world.size)[:2]
    if scene.world.mouse == "blow":
        start, way = rng.uniform(0.2, 0.8, 2) * size, rng.normal(0.0, 0.05, 2) * size
        for frame in range(4, 16):
            place = np.clip(start + way * (frame - 4), 1, size - 1)
            yield frame, "move", {"pos": [round(float(p), 3) for p in place]}
    held = int(rng.choice(free))
    stiffness = float(np.max(scene.springs.stiffness))
    place, way = x[held], rng.normal(0.0, 0.01, x.shape[1]) * np.linalg.norm(size)
    grip = {"stiffness": [stiffness], "damping": [0.1 * stiffness]}
    yield 18, "grab", {"particle": held, "pos": place.tolist(), **grip}
    for frame in range(19, 36):
        yield frame, "drag", {"pos": (place + way * (frame - 18)).tolist()}
    yield 36, "let_go", {}
    if len(scene.springs) > 100:
        cut = rng.choice(len(scene.springs), 3, replace=False)
        yield 40, "cut", {"springs": sorted(int(s) for s in cut)}
    yield 45, "pin", {"particle": [int(rng.choice(free))]}


def _unseen(world):
    """A view that nobody sees."""
    return View("none", world, (320, 240), draws=False)


def write_log(path, sim, source, rng):
    header = app.log_header(sim, _unseen(sim.scene.world), 0)
    lines = [{"header": {**header, "arguments": source.flags()}}]
    lines += [{"frame": f, "event": kind, **more} for f, kind, more in events_of(sim.scene, rng)]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))


def compared(source, method, substeps, count, seed, judge, folder):
    """(error by compare, that of the meter, whether it is sure) of each session."""
    scene = source.build().with_world(tools=True)
    sim = Simulation(scene, method, topology="graph", execution="serial")
    sim.set_step(substeps=substeps)
    for number in range(count):
        log = folder / f"session-{number}.jsonl"
        sim.reset()
        write_log(log, sim, source, np.random.default_rng([seed, number]))
        kept = Kept(sim)
        app.run(sim, _unseen(scene.world), replay=interaction.load(str(log)), frames=FRAMES,
                quiet=True)  # fmt: skip
        kept.close()
        (window,) = kept.windows
        verdict, _ = judge._ask(window, math.inf)
        given = {"events": str(log), "substeps": FINER * substeps, "frames": FRAMES}
        found, _ = replays.run(source, CompareOptions.from_given(given), "5%")
        yield found.error, verdict.relative, not verdict.trouble
        print(
            f"{source.name}: {method}, {sum(map(len, window.acts.values()))} acts: compare "
            f"{found.error}, {verdict.describe(False)}", file=sys.stderr, flush=True,
        )  # fmt: skip


def table(count, out, names):
    judge = ErrorMeter(Simulation(library.build("chain")))
    total = good = 0
    with tempfile.TemporaryDirectory() as folder:
        for seed, (name, given) in enumerate(SCENES):
            if name not in names:
                continue
            for method, substeps in SETTINGS:
                found = list(
                    compared(SceneSource(name, given), method, substeps, count, seed, judge,
                             Path(folder))
                )  # fmt: skip
                factors = [max(a / b, b / a) if a and b else np.inf for a, b, _ in found]
                within = sum(factor <= FACTOR for factor in factors)
                total, good = total + len(found), good + within
                flags = " ".join(f"{flag} {value}" for flag, value in given.items())
                unsure = sum(not sure for *_, sure in found)
                out.write(
                    f"| {name} {flags} | {method}, {substeps} | {len(found)} | {within} "
                    f"| {max(factors):.3f} | {unsure} |\n"
                )
                out.flush()
    out.write(f"\n{good} of {total} sessions within {FACTOR} times.\n")
    judge.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=5)
    parser.add_argument("--scenes", default="cloth,chain")
    parser.add_argument("--out", default="-")
    options = parser.parse_args()
    runtime.start("cpu", "f32", threads=1)
    with sys.stdout if options.out == "-" else open(options.out, "w") as to:
        to.write(HEAD.replace("windows", "sessions") + "|---" * 6 + "|\n")
        to.flush()
        table(options.sessions, to, options.scenes.split(","))
