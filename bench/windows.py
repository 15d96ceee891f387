"""Windows: what a frame takes to draw and to show, beside an earlier build's, by view and size.

Each window runs in a process of its own (`window_worker.py`), those of both builds in turns. Panels
are the settings and the meters. The earlier build draws a scene in space without smooth edges where
a frame takes it long. It is asked for the same picture as ours, which always has them, and once
more for the one that it would draw.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from bench.contest import Bench
from bench.report import Measurement
from taichi_cloth import runtime
from taichi_cloth.measuring.timing import quartiles

PART = "windows"
WORKER = Path(__file__).with_name("window_worker.py")
SCENES = ("cloth", "box", "sandbox", "drape", "flag", "stack", "shirt", "net")
FLAGS = {"net": ("--side", "512")}
# Frames of a window, a sixth or so of which is counted; of one whose frames are long.
FRAMES, FEW = 180, 72
LONG = ("net",)
IN_SPACE = ("drape", "flag", "stack", "shirt", "net")
VIEWS = ("gui", "ggui")
SIZES = ((1280, 800), (1920, 1080))  # pixels
WANTED, MORE = 0.4, 2e-3  # of the earlier build's time, or so many seconds above showing
# The earlier build: with pictures like ours, and as it comes.
BEFORE, COARSE = "before", "before, as it comes"
LONGEST = 300  # seconds that a window may take


def measure(bench: Bench) -> Iterator[Measurement]:
    """Rows of times, by size, view, scene and panels; with an earlier build rows of ratios, too."""
    sizes, views = (SIZES[:1], VIEWS[:1]) if bench.quick else (SIZES, VIEWS)
    wanted = [(size, view, scene) for view in views for size in sizes for scene in SCENES]
    missing = None if runtime.display_available() else "there is no display"
    pythons = {"now": sys.executable}
    if bench.against:
        pythons |= {BEFORE: bench.against, COARSE: bench.against}
    for done, (size, view, scene) in enumerate(wanted):
        pixels = f"{size[0]} x {size[1]}"
        bench.tell(f"{scene}, {view}, {pixels}", done, len(wanted))
        lack = missing
        names = [name for name in pythons if name != COARSE or view == "gui" and scene in IN_SPACE]
        found: dict[str, list[dict[str, dict[str, float]]]] = {name: [] for name in names}
        for _ in range(max(bench.rounds // 3, 1)):
            for name in names:
                smooth = ("--smooth",) if name == BEFORE else ()
                answer = lack or ask(pythons[name], scene, view, size, smooth)
                if isinstance(answer, str):
                    lack = answer
                else:
                    found[name].append(answer)
        if lack:
            bench.leave_out(PART, f"{scene}, {view}", pixels, lack)
            continue
        yield from rows(bench, scene, view, pixels, found)


def rows(
    bench: Bench,
    scene: str,
    view: str,
    pixels: str,
    found: dict[str, list[dict[str, dict[str, float]]]],
) -> Iterator[Measurement]:
    """The rows of one window; found: by build what its runs said (`window_worker.py`)."""
    for panels in ("closed", "open"):
        name, usual = f"{scene}, {view}, panels {panels}", {}
        for build, runs in found.items():
            times = [run[panels]["draw"] / 1e3 for run in runs]
            usual[build] = median(times)
            show = median(run[panels]["show"] for run in runs)
            quarters = quartiles(times)
            yield Measurement(
                part=PART,
                contestant=name if build == "now" else f"{name}, {build}",
                size=pixels,
                threads=bench.threads,
                precision="f32",
                seconds=usual[build],
                lower=quarters.lower,
                upper=quarters.upper,
                rounds=len(times),
                note=f"of it {show:.2f} ms to show",
            )
        for before in (build for build in usual if build != "now"):
            floor = median(run[panels]["show"] for run in found["now"]) / 1e3
            most = max(WANTED, (floor + MORE) / usual[before])
            yield Measurement(
                part=PART,
                contestant=f"{name}: of the time {before}",
                size=pixels,
                rate=usual["now"] / usual[before],
                target=f"<= {most:.3g}" if before == BEFORE else "",
                rounds=len(found["now"]),
            )


def ask(
    python: str, scene: str, view: str, size: tuple[int, int], more: tuple[str, ...]
) -> dict[str, dict[str, float]] | str:
    """The times of a build's window, as `window_worker.py` says them; or why it did not open."""
    frames = FEW if scene in LONG else FRAMES
    words = [scene, view, f"{size[0]}x{size[1]}", str(frames), *more, *FLAGS.get(scene, ())]
    command = [python, str(WORKER), *words]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=LONGEST, env=_environment(python)
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    lines = done.stdout.strip().splitlines()
    if done.returncode or not lines:
        return (done.stderr.strip().splitlines() or ["its process ended"])[-1]
    answer: dict[str, dict[str, float]] = json.loads(lines[-1])
    return answer


def _environment(python: str) -> dict[str, str]:
    """The environment of a build's process: its own packages, and not those of this one."""
    found = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return found if python != sys.executable else dict(os.environ)
