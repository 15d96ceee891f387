"""Every scene under every method on a GPU, beside the same on the CPU, in f64.

Both run the same frames from the same start, with the substeps that `--dt auto` chooses there. A
pair of them has a process of its own: compiling takes most of it, and ends together with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from threading import Timer
from typing import Any

import numpy as np

from bench.contest import Bench, distance
from bench.report import Measurement
from taichi_cloth import runtime
from taichi_cloth.errors import InputError
from taichi_cloth.kernels.methods import METHODS
from taichi_cloth.measuring.worker import Worker, WorkerFailed
from taichi_cloth.scene import library
from taichi_cloth.simulation.simulation import Simulation

FRAMES = 2
# Of a scene's extent. What tolerances leave of implicit steps differs by up to as much; without
# them a pair is apart by the last bits.
BOUND = 1e-6
# Where something lies on a cloth from the start: pairs of cloth act all at once on GPUs, and one
# after the other on CPUs (`kernels/resting_pairs.py`), which leaves other things at rest.
BOUND_OF_PAIRS, LIE_ON_CLOTH = 1e-2, ("pull",)
LONGEST = 300.0  # seconds for a pair, which take half a minute: a GPU may wait for ever
SHORTER = 16  # steps of methods that no step makes stable, than those of the default method
# Scenes that are empty until something is spawned get some particles, which hit each other.
GIVEN: dict[str, dict[str, Any]] = {"box": {"particles": 60}, "sandbox": {"particles": 60}}
QUICK_SCENES, QUICK_METHODS = ("box", "cloth"), ("symplectic_euler", "implicit_euler", "xpbd")


def measure(bench: Bench, part: str, arch: str, note: str) -> Iterator[Measurement]:
    """A row for each scene: how far the backend is from the CPU under its worst method."""
    scenes = QUICK_SCENES if bench.quick else tuple(library.names())
    methods = QUICK_METHODS if bench.quick else tuple(METHODS)
    wanted = [(scene, method) for scene in scenes for method in methods]
    if arch == "metal":
        bench.leave_out(part, f"{arch}: beside the CPU", "all scenes", "Metal has no f64")
        return
    running: set[Worker] = set()
    # A process on CUDA has one thread; a software driver's has more, on the same cores.
    pool = ThreadPoolExecutor(bench.threads if arch == "cuda" else max(1, bench.threads // 2))
    try:
        asked = {pair: pool.submit(_compare, bench, running, *pair, arch) for pair in wanted}
        for number, scene in enumerate(scenes):
            apart: dict[tuple[str, str], float] = {}
            for k, method in enumerate(methods):
                done = number * len(methods) + k
                bench.tell(f"{arch} beside the CPU: {scene}, {method}", done, len(wanted))
                try:
                    apart[scene, method] = asked[scene, method].result()
                except WorkerFailed as failure:
                    name = f"{arch}: beside the CPU, {method}"
                    bench.leave_out(part, name, scene, str(failure))
            yield from rows(part, arch, apart, note)
    finally:  # also where it is interrupted: what has yet to begin does not, and the rest ends
        pool.shutdown(wait=False, cancel_futures=True)
        for worker in list(running):
            worker.kill()
        pool.shutdown()


def rows(
    part: str, arch: str, apart: dict[tuple[str, str], float], note: str
) -> Iterator[Measurement]:
    """The rows of what was measured: of each scene the method under which it is farthest."""
    for scene in dict.fromkeys(scene for scene, _ in apart):
        of_scene = {method: far for (named, method), far in apart.items() if named == scene}
        worst = max(of_scene, key=of_scene.__getitem__)
        yield Measurement(
            part=part,
            contestant=f"{arch}: beside the CPU, farthest of {len(of_scene)} methods ({worst})",
            size=scene,
            rate=of_scene[worst],
            unit="of its extent",
            target=f"<= {BOUND_OF_PAIRS if scene in LIE_ON_CLOTH else BOUND:g}",
            note=note,
        )


def _compare(bench: Bench, running: set[Worker], scene: str, method: str, arch: str) -> float:
    """The distance of a pair, by a process of its own; raises WorkerFailed.

    running: has that process while it runs, LONGEST at most.
    """
    worker = Worker(bench.folder, {"OMP_NUM_THREADS": "1"})
    running.add(worker)
    limit = Timer(LONGEST, worker.kill)
    limit.start()
    try:
        given = {"scene": scene, "method": method, "arch": arch}
        about = worker.ask(make=f"{__name__}:Pair", **{"as": "pair", "with": given})["result"]
        return float(about["apart"])
    except WorkerFailed as failure:
        if limit.finished.is_set():
            raise WorkerFailed(f"no answer in {LONGEST:g} s") from failure
        raise
    finally:
        limit.cancel()
        running.discard(worker)
        worker.close()


class Pair:
    """A scene under a method on the CPU and on a backend, as `about` says how far apart: in parts
    of its extent.
    """

    def __init__(self, scene: str, method: str, arch: str):
        on_cpu, there = (positions(scene, method, where) for where in ("cpu", arch))
        self.about = {"apart": relative(on_cpu, there)}


def relative(one: np.ndarray, other: np.ndarray) -> float:
    """The largest distance of a particle in `one` from the same in `other`, both (n, dim), in
    parts of the extent of `one`.
    """
    return distance(one, other) / float(np.ptp(one, axis=0).max())


def positions(scene: str, method: str, arch: str) -> np.ndarray:
    """Places of a scene's particles after FRAMES frames, (n, dim)."""
    runtime.start(arch, "f64")
    made = library.build(scene, **GIVEN.get(scene, {}))
    way: dict[str, Any] = {"topology": "graph", "soon": True}
    way["execution"] = "serial" if arch == "cpu" else "parallel"
    try:
        sim = Simulation(made, method, dt="auto", **way)
    except InputError:  # of `explicit_euler`, which no step makes stable: so short it lasts
        substeps = Simulation(made, dt="auto", **way).substeps
        sim = Simulation(made, method, substeps=SHORTER * substeps, **way)
    sim.advance(FRAMES)
    return sim.positions()
