"""How fast, and beside it how wrong: the figures of docs/speed.md.

    python bench/speed.py [seed | large | spheres ...]

seed: the seed cloth in f64 against a program of Python objects, both against the golden data.
large: a 1024 x 1024 cloth in f32 against C++ compiled on the spot, and against itself in f64.
spheres: 20 000 and 100 000 colliding spheres.

Each part runs in a process of its own, because a process has one precision.
"""

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from taichi_cloth import runtime, topology
from taichi_cloth.scene import Springs
from taichi_cloth.scenes import build
from taichi_cloth.simulation import Simulation

HERE = Path(__file__).parent
GOLDEN = HERE.parent / "tests" / "golden"
ROUNDS, STEPS = 7, 32  # rounds of a measurement; steps in a round of the large cloth
WARM_UP = 2 * STEPS  # steps before the first counted round of the large cloth


def quartiles(values):
    """(median, lower quartile, upper quartile)."""
    low, middle, high = statistics.quantiles(values, n=4)
    return middle, low, high


def show(title, columns, rows):
    table = Table(title=title, title_justify="left")
    for name in columns:
        table.add_column(name, justify="left" if name == columns[0] else "right")
    for row in rows:
        table.add_row(*map(str, row))
    Console(width=110).print(table)


def seconds(function):
    begin = time.perf_counter()
    function()
    return time.perf_counter() - begin


def error(sim, x):
    """Largest distance of a particle from where it should be."""
    return float(np.linalg.norm(sim.positions() - x, axis=1).max())


def seed():
    sys.path.insert(0, str(HERE))
    from objects import Cloth

    runtime.start("cpu", "f64", threads=1)
    golden = np.load(GOLDEN / "cloth_rest.npz")["position"][-1]
    scene = build("cloth")

    program = Cloth()
    for _ in range(300):
        program.step()
    wrong = np.linalg.norm([[p.x, p.y] for p in program.particles] - golden, axis=1).max()
    sims = {
        f"{path}, {words} a launch": (Simulation(scene, execution=path), batch)
        for path, batch, words in (
            ("serial", 1000, "1000 steps"),
            ("serial", 1, "1 step"),
            ("parallel", 1, "1 step"),
        )
    }
    errors = {}
    for name, (sim, _) in sims.items():
        sim.advance(300)
        errors[name] = error(sim, golden)
    times = {"Python objects": []} | {name: [] for name in sims}
    for _ in range(ROUNDS):  # in turn, so that a drift of the machine meets them all
        times["Python objects"].append(seconds(program.step))
        for name, (sim, batch) in sims.items():
            calls = 2 if batch > 1 else 200
            run = lambda sim=sim, batch=batch, calls=calls: [  # noqa: E731
                sim.advance(batch) for _ in range(calls)
            ]
            times[name].append(seconds(run) / (calls * batch))
    errors["Python objects"] = wrong
    base = statistics.median(times["Python objects"])
    rows = []
    for name, t in times.items():
        middle, low, high = (1e6 * s for s in quartiles(t))
        rows.append(
            (
                name,
                f"{middle:.2f}",
                f"{low:.2f} .. {high:.2f}",
                f"{base * 1e6 / middle:.0f}",
                f"{errors[name]:.1e}",
            )
        )
    show(
        "seed cloth, 192 particles, f64, one thread",
        ("program", "us/step", "quartiles", "times faster", "error at 300 steps"),
        rows,
    )


def large_scene(size):
    """The structural cloth alone, and with walls, fracture and the mouse, a little disturbed."""
    full = build("cloth", columns=size, rows=size)
    rng = np.random.default_rng(0)
    full.particles.velocity[:] = rng.normal(0, 0.3, full.particles.velocity.shape)
    full.particles.velocity[full.particles.fixed] = 0.0
    s = full.springs
    bare = full.with_world(mouse="none", walls=())
    return full, type(full)(
        name="structural",
        world=bare.world,
        particles=bare.particles,
        springs=Springs.build(
            s.between, bare.particles.position, stiffness=s.stiffness, rest_length=s.rest_length
        ),
    )


def large(size=1024):
    full, structural = large_scene(size)
    runtime.start("cpu", "f64")
    exact = Simulation(structural, dt=16.0, substeps=16, execution="parallel")
    exact.advance((WARM_UP + ROUNDS * STEPS) // 16)
    x64 = exact.positions()
    del exact

    device = runtime.start("cpu", "f32")
    n = size * size

    def rate(sim, frames):
        return n * frames * sim.substeps / seconds(lambda: sim.advance(frames)) / 1e6

    plain = Simulation(structural, dt=16.0, substeps=16, execution="parallel")
    each = Simulation(structural, execution="parallel")
    whole = Simulation(full, execution="parallel")
    for sim in (plain, each, whole):
        sim.advance(WARM_UP // sim.substeps)
    rates = {
        "16 steps a frame": [],
        "1 step a frame": [],
        "1 step a frame, walls, fracture, mouse": [],
    }
    with tempfile.TemporaryDirectory() as folder:
        hand = compiled(Path(folder), structural)
        cpp = [] if hand else None
        for _ in range(ROUNDS):
            rates["16 steps a frame"].append(rate(plain, STEPS // 16))
            rates["1 step a frame"].append(rate(each, STEPS))
            rates["1 step a frame, walls, fracture, mouse"].append(rate(whole, STEPS))
            if hand:
                cpp.append(n * STEPS / hand(1)[0] / 1e6)
        rows = []
        ends = {"16 steps a frame": plain, "1 step a frame": each}
        for name, values in rates.items():
            middle, low, high = quartiles(values)
            wrong = f"{error(ends[name], x64):.1e}" if name in ends else "other physics"
            ratio = f"{middle / statistics.median(cpp):.2f}" if cpp else "no compiler"
            rows.append((name, f"{middle:.0f}", f"{low:.0f} .. {high:.0f}", ratio, wrong))
        if cpp:
            middle, low, high = quartiles(cpp)
            x = hand.final(WARM_UP + ROUNDS * STEPS)
            wrong = np.linalg.norm(x - x64, axis=1).max()
            rows.append(
                (
                    "C++, OpenMP, per-particle gather",
                    f"{middle:.0f}",
                    f"{low:.0f} .. {high:.0f}",
                    "1",
                    f"{wrong:.1e}",
                )
            )
    show(
        f"cloth of {size} x {size}, f32, {device.threads} threads, against f64 at the same step",
        ("what", "M particle-steps/s", "quartiles", "of C++", "error at the end"),
        rows,
    )


def compiled(folder, scene):
    """The C++ program for a scene, as a function rounds -> seconds of each; None without g++."""
    if shutil.which("g++") is None:
        print("left out: C++ (no g++ on this machine)")
        return None
    program, data, out = folder / "graph_cloth", folder / "in", folder / "out"
    source = HERE / "graph_cloth.cpp"
    flags = ["-O3", "-march=native", "-ffast-math", "-fopenmp"]
    subprocess.run(["g++", *flags, str(source), "-o", str(program)], check=True)
    p, s = scene.particles, scene.springs
    half = topology.half_springs(s.between, len(p))
    with data.open("wb") as file:
        for array in (
            np.int32([len(p), len(half.far)]),
            np.float32([scene.world.dt, scene.world.gravity[1], p.viscous[0]]),
            half.row,
            half.far,
            s.stiffness[half.spring].astype(np.float32),
            s.rest_length[half.spring].astype(np.float32),
            np.where(p.fixed, 0, 1 / p.mass).astype(np.float32),
            p.position.astype(np.float32),
            p.velocity.astype(np.float32),
        ):
            array.tofile(file)

    def run(rounds, steps=STEPS):
        done = subprocess.run(
            [program, data, out, str(rounds + 1), str(steps)],
            check=True,
            capture_output=True,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": str(os.cpu_count())},
        )
        return [float(line) for line in done.stdout.split()][1:]  # the first one warms up

    def final(steps):
        run(0, steps)
        return np.fromfile(out, np.float32).reshape(-1, 2)

    run.final = final
    return run


def spheres():
    device = runtime.start("cpu", "f32")
    rows = []
    for count, radius in ((1_000, 8.0), (20_000, 3.0), (100_000, 1.8)):
        scene = build("box", particles=count, radius=radius)
        for path in ("serial", "parallel"):
            sim = Simulation(scene, execution=path)
            sim.advance(20)
            t = [seconds(lambda sim=sim: sim.advance(2)) / 2 for _ in range(ROUNDS)]
            middle, low, high = (1e3 * s for s in quartiles(t))
            rows.append(
                (
                    f"{count} spheres, {path}",
                    f"{middle:.2f}",
                    f"{low:.2f} .. {high:.2f}",
                    f"{1e3 / middle:.0f}",
                )
            )
    show(
        f"colliding spheres in the box, f32, {device.threads} threads",
        ("what", "ms a step", "quartiles", "steps/s"),
        rows,
    )


PARTS = {"seed": seed, "large": large, "spheres": spheres}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "parts",
        nargs="*",
        default=list(PARTS),
        metavar="PART",
        help=f"out of {', '.join(PARTS)} (default: all)",
    )
    parts = parser.parse_args().parts
    unknown = set(parts) - set(PARTS)
    if unknown:
        parser.error(f"unknown part {', '.join(sorted(unknown))}; known: {', '.join(PARTS)}")
    if len(parts) == 1:
        PARTS[parts[0]]()
    else:
        for part in parts:
            subprocess.run([sys.executable, __file__, part], check=True)


if __name__ == "__main__":
    main()
