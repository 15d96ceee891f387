"""Windows of the seed scenes: frames a second, by view and size.

A window waits for its next frame, so that there are sixty a second; the wait is left out here. Each
window is opened in a process of its own, as GGUI opens one only.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from contextlib import closing
from statistics import median

from taichi_cloth import runtime
from taichi_cloth.benchmarks.contest import Bench
from taichi_cloth.benchmarks.report import Measurement
from taichi_cloth.errors import InputError, RunFailure

PART = "windows"
SCENES = ("cloth", "box", "sandbox")
VIEWS = ("ggui", "gui")
SIZES = ((1280, 800), (1920, 1080))  # pixels
WANTED = ">= 60"  # frames a second
WARM, FRAMES = 60, 120  # frames before the first round, and in each


def measure(bench: Bench) -> Iterator[Measurement]:
    """One row for each size, view and scene."""
    wanted = [
        (size, view, scene)
        for size in (SIZES[:1] if bench.quick else SIZES)
        for view in VIEWS
        for scene in SCENES
    ]
    spawn = multiprocessing.get_context("spawn")
    for done, (size, view, scene) in enumerate(wanted):
        name, pixels = f"{scene}, {view}", f"{size[0]} x {size[1]}"
        bench.tell(f"{name}, {pixels}", done, len(wanted))
        with spawn.Pool(1) as process:
            rates = process.apply(frames_a_second, (scene, view, size, bench.rounds))
        if isinstance(rates, str):
            bench.leave_out(PART, name, pixels, rates)
            continue
        yield Measurement(
            part=PART,
            contestant=name,
            size=pixels,
            threads=bench.threads,
            precision="f32",
            rate=median(rates),
            unit="frames/s",
            target=WANTED,
            rounds=len(rates),
        )


def frames_a_second(scene: str, view: str, size: tuple[int, int], rounds: int) -> list[float] | str:
    """How many frames a window could show a second, in each of some rounds; or why it cannot open.

    Call it in a process of its own. size: in pixels.
    """
    runtime.start("cpu", "f32")
    from taichi_cloth.scene import library
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui import app
    from taichi_cloth.ui.framing import camera_of
    from taichi_cloth.ui.opening import open_view

    given = library.build(scene)
    sim = Simulation(given)
    try:
        opened = open_view(view, given.world, camera=camera_of(given), size=size)
    except (InputError, RunFailure) as error:
        return str(error)
    with closing(opened):
        app.run(sim, opened, frames=WARM)
        runs = [app.run(sim, opened, frames=FRAMES) for _ in range(rounds)]
    return [run.frames / (run.seconds - run.waited) for run in runs]
