"""The cost of the error meter and its ghost: a run draws with neither, with the meter, and
with both, in turns.

    python -m bench.experiments.error_cost --side 128 --view gui

Prints the medians of what a frame takes to simulate and to draw [ms], and of the whole frame
against the one without in the same turn.
"""

import argparse
import sys
import time

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.cli.run_meter import MeasuredErrors
from taichi_cloth.scene import library
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.ui.depiction import Depiction
from taichi_cloth.ui.framing import camera_of
from taichi_cloth.ui.view import View

FRAMES = 66  # of a block: so many that a window begins and ends in it
WAYS = ("neither", "meter", "meter and ghost")


def block(sim, errors, depiction, view, way):
    """(simulate, draw) of each frame of a block [s]."""
    meter, found = errors._meter, []
    sim.listeners = () if way == "neither" else (meter,)
    errors._ghost = int(way == "meter and ghost")
    for _ in range(FRAMES):
        begin = time.perf_counter()
        sim.advance()
        middle = time.perf_counter()
        view.draw(depiction.picture())
        found.append((middle - begin, time.perf_counter() - middle))
        time.sleep(max(0.0, 1 / 60 - (time.perf_counter() - begin)))
    while meter.busy:
        time.sleep(0.1)
    return found


def main(options):
    runtime.start("cpu", "f32")
    side = options.side
    scene = library.build("cloth", columns=side, rows=side, spacing=400 / side)
    if options.dim == 3:
        scene = library.build("warp", side=side)
    sim = Simulation(scene)
    view = View(options.view, scene.world, (1280, 800))
    view.camera = camera_of(scene)
    errors = MeasuredErrors(sim, waits=False, told=False)
    errors.switch()
    depiction = Depiction(sim, errors=errors)
    print(f"{len(scene.particles)} particles; compiling the reference", file=sys.stderr)
    for _ in range(3):
        if errors._meter.ghost is None:
            block(sim, errors, depiction, view, "meter and ghost")
    assert errors._meter.ghost is not None, errors._meter.verdicts
    taken = {way: [] for way in WAYS}
    end = time.perf_counter() + options.seconds
    while time.perf_counter() < end:
        for way in WAYS:
            taken[way].append(np.mean(block(sim, errors, depiction, view, way), axis=0))
    whole = {way: np.sum(taken[way], axis=1) for way in WAYS}
    for way in WAYS:
        simulate, draw = 1e3 * np.median(taken[way], axis=0)
        more = np.median(whole[way] / whole["neither"]) - 1
        print(f"{way}: simulate {simulate:.2f} ms, draw {draw:.2f} ms, frame {100 * more:+.1f} %")
    print(f"{len(taken['neither'])} turns")
    errors.close()
    view.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--side", type=int, default=128)
    parser.add_argument("--dim", type=int, default=2, choices=(2, 3))
    parser.add_argument("--view", default="gui")
    parser.add_argument("--seconds", type=float, default=30.0)
    main(parser.parse_args())
