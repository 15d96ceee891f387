"""Counts intersecting triangles in saved frames, 30 a second, of scenes with self-collision.

    python -m bench.experiments.intersection_sweep --scenes drape,twist --sizes 3 --out table.md

Each scene is run at its own resolution and at smaller ones, from starts that differ by a jitter of
a tenth of the thickness. A row of the table for each scene and size, once all its starts are done;
a line on stderr for each run.
"""

import argparse
import sys
import time
from dataclasses import replace

import numpy as np

from bench.experiments.intersections import intersecting_pairs
from taichi_cloth import runtime
from taichi_cloth.scene import library
from taichi_cloth.simulation.simulation import Simulation

# What sets the resolution, its values from the coarsest to the scene's own, and how long to run [s]
SCENES = {
    "drape": ("side", (25, 33, 49), 4.0),
    "stack": ("side", (17, 23, 31), 4.0),
    "pull": ("columns", (19, 27, 35), 4.0),
    "twist": ("columns", (41, 61, 81), 10.0),
}
HEAD = (
    "| scene | particles along | starts | frames each | frames with any | most pairs "
    "| not certified | unsettled steps |\n|---|---|---|---|---|---|---|---|\n"
)


def jittered(scene, start):
    """The scene with its free particles moved by up to a tenth of their thickness."""
    p = scene.particles
    moved = np.random.default_rng(start).uniform(-0.1, 0.1, p.position.shape)
    free = ~np.asarray(p.fixed, bool)
    return replace(
        scene,
        particles=replace(p, position=p.position + free[:, None] * p.thickness[:, None] * moved),
    )


def run(name, size, start, frames, sim=None):
    """A run's simulation, how many frames had intersections, the most pairs of a frame, and of
    pairs that were not certified, in every tenth of them."""
    scene = jittered(library.build(name, **{SCENES[name][0]: size}), start)
    if sim is None:
        sim = Simulation(
            scene, dt="auto", topology="graph", execution="serial", method="symplectic_euler"
        )
    else:
        sim.load_scene(scene)
    bad = worst = uncertified = 0
    for _ in range(frames):
        sim.advance(2)
        count = len(intersecting_pairs(sim.positions(), scene.triangles))
        bad, worst = bad + (count > 0), max(worst, count)
        if sim.frame % 20 == 0:
            uncertified = max(uncertified, sim.uncertified())
    return sim, bad, worst, uncertified


def row(name, size, starts, seconds=None, say=lambda line: None):
    """The numbers of a scene at a size, summed over its starts."""
    frames, sim, all_bad, most, least = round(30 * (seconds or SCENES[name][2])), None, 0, 0, 0
    unsettled = 0
    for start in range(starts):
        begun = time.process_time()
        sim, bad, worst, uncertified = run(name, size, start, frames, sim)
        all_bad, most, least = all_bad + bad, max(most, worst), max(least, uncertified)
        unsettled += sim.unsettled()
        say(
            f"{name} {size} start {start}: {bad} frames, at most {worst} pairs, "
            f"uncertified {uncertified}, unsettled {sim.unsettled()} of {sim.steps} steps, "
            f"{time.process_time() - begun:.0f} s"
        )
    return name, size, starts, frames, all_bad, most, least, unsettled


def write(path, text):
    """Add to the file at `path`, or to the standard output."""
    if path:
        with open(path, "a") as file:
            file.write(text)
    else:
        print(text, end="", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--sizes", type=int, default=3, help="how many, the smallest first")
    parser.add_argument("--starts", type=int, default=10)
    parser.add_argument("--seconds", type=float, help="of each run, instead of the scene's own")
    parser.add_argument("--precision", default="f32")
    parser.add_argument("--out", help="a file to which the table goes, line by line")
    asked = parser.parse_args()
    runtime.start("cpu", asked.precision, threads=1)
    write(asked.out, HEAD)
    for k in range(asked.sizes):
        for name in asked.scenes.split(","):
            numbers = row(
                name,
                SCENES[name][1][k],
                asked.starts,
                asked.seconds,
                lambda line: print(line, file=sys.stderr, flush=True),
            )
            write(asked.out, "| " + " | ".join(map(str, numbers)) + " |\n")


if __name__ == "__main__":
    main()
