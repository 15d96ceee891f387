"""The cost of frames on a GPU.

    python -m bench.experiments.gpu_cost [ARCH] [SCENE:METHOD:TOPOLOGY:STEPS:SIDE]

Milliseconds of a frame, one by one and many in a call (medians of TURNS), f32, beside the speed of
copies of one number a thread and, as `bench gpu` makes it, of several. SCENE: `warp`, or
`structural` (`bench/cloths.py`), of which a step must move 36 bytes a particle: their speed is
given, too, in parts of the faster copy. `taichi-cloth bench gpu` measures more, and the error
beside it.
"""

import statistics
import sys
import time

from taichi_cloth import runtime

ASKED = (
    "warp:symplectic_euler:lanes:16:128",
    "warp:symplectic_euler:graph:16:128",
    "warp:implicit_euler:lanes:1:64",
    "warp:implicit_euler:lanes:1:512",
    "structural:symplectic_euler:lanes:16:256",
    "structural:symplectic_euler:lanes:16:512",
    "structural:symplectic_euler:lanes:16:1024",
    "structural:symplectic_euler:lanes:16:2048",
    "structural:symplectic_euler:graph:16:2048",
)
TURNS, PARTICLE_STEPS, MOST_FRAMES = 5, 3e7, 500  # particle-steps and frames in a turn, at most
COPIED, COPIES, BYTES = 2**26, 20, 36  # numbers


def copy_speed(ti, numbers):
    """Bytes a second, read and written, by so many numbers a thread."""
    a, b, stride = ti.field(ti.f32, COPIED), ti.field(ti.f32, COPIED), COPIED // numbers

    @ti.kernel
    def copy():
        for i in range(stride):
            for k in ti.static(range(numbers)):
                b[i + k * stride] = a[i + k * stride]

    times = []
    for _ in range(TURNS + 1):
        ti.sync()
        begin = time.perf_counter()
        for _ in range(COPIES):
            copy()
        ti.sync()
        times.append((time.perf_counter() - begin) / COPIES)
    return 8 * COPIED / statistics.median(times[1:])


def measure(ti, scene, method, topology, substeps, side):
    """Seconds of a frame, by itself and of many in a call; of particles; and the blocks."""
    from bench import cloths
    from taichi_cloth.scene import library
    from taichi_cloth.simulation.simulation import Simulation

    if scene == "structural":
        made, dt = cloths.structural(columns=side, rows=side), cloths.STRUCTURAL_FRAME["dt"]
    else:
        made, dt = library.build(scene, side=side), None
    way = {"topology": topology, "execution": "parallel", "dt": dt, "substeps": substeps}
    sim = Simulation(made, method, **way)
    frames = min(max(2, int(PARTICLE_STEPS / (side * side * substeps))), MOST_FRAMES)
    ways = {"one by one": lambda: [sim.advance() for _ in range(frames)]}
    ways["many"] = lambda: sim.advance(frames)
    found = {name: [] for name in ways}
    for _ in range(TURNS + 1):
        for name, run in ways.items():
            ti.sync()
            begin = time.perf_counter()
            run()
            ti.sync()
            found[name].append((time.perf_counter() - begin) / frames)
    times = [statistics.median(each[1:]) for each in found.values()]
    return *times, side * side, sim.storage.specialization.blocks


def main(words):
    """Print a table, a line for each that was asked for."""
    arch = words.pop(0) if words and ":" not in words[0] else "cuda"
    runtime.start(arch, "f32")
    import taichi as ti

    from bench.contestants import STRIDES

    speeds = {numbers: copy_speed(ti, numbers) for numbers in (1, STRIDES)}
    for numbers, speed in speeds.items():
        print(f"a copy, numbers of a thread: {numbers}: {speed / 1e9:.0f} GB/s")
    copied = max(speeds.values())
    print("| scene | method, substeps | topology | side | blocks | ms, one by one | many | GB/s |")
    print("|---" * 8 + "|")
    for word in words or ASKED:
        scene, method, topology, substeps, side = word.split(":")
        one, many, particles, blocks = measure(
            ti, scene, method, topology, int(substeps), int(side)
        )
        speed = BYTES * particles * int(substeps) / many
        shown = f"{speed / 1e9:.0f} ({100 * speed / copied:.0f} %)" * (scene == "structural")
        times = f"{1e3 * one:.3f} | {1e3 * many:.3f} | {shown}"
        print(f"| {scene} | {method}, {substeps} | {topology} | {side} | {blocks} | {times} |")
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
