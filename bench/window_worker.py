"""A window of a scene, measured frame by frame: what drawing and showing take.

Run as a program, by the Python of any build of this package, that of an earlier one as well:

    python window_worker.py SCENE VIEW WIDTHxHEIGHT FRAMES [--smooth] [FLAG ...]

--smooth: an earlier build whose ti.GUI goes over to pictures without smooth edges, where a frame
takes it more than 12 ms, keeps them.

It prints a line of JSON: milliseconds, the medians of frames with the panels closed, then open.
`draw`: to make the picture, draw and show it. `show`: of these, to show it. `simulate`.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import runpy
import sys
import time
from collections.abc import Callable
from statistics import median
from typing import Any

WARM = 20  # frames that are not counted, at first and after the panels open
taken: dict[str, list[float]] = {"picture": [], "draw": [], "show": [], "simulate": []}


def timed(of: Any, name: str, part: str) -> None:
    """Have what a method takes added to a part, in milliseconds."""
    call: Callable[..., Any] = getattr(of, name)

    def timing(*given: Any, **named: Any) -> Any:
        begin = time.perf_counter()
        try:
            return call(*given, **named)
        finally:
            taken[part].append(1e3 * (time.perf_counter() - begin))

    setattr(of, name, timing)


def main(scene: str, view: str, size: str, frames: str, *flags: str) -> None:
    """Run a scene in a window; print what its frames took."""
    import taichi as ti

    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui.inputs import Event
    from taichi_cloth.ui.presentation import Presentation

    try:
        shown: Any = importlib.import_module("taichi_cloth.ui.view").View
    except ImportError:  # a build whose windows drew by themselves
        shown = importlib.import_module(f"taichi_cloth.ui.views.{view}")
        shown = shown.GuiView if view == "gui" else shown.GguiView

    if "--smooth" in flags:
        flags = tuple(flag for flag in flags if flag != "--smooth")
        drawing: Any = sys.modules[shown.__module__]
        if hasattr(drawing, "ENOUGH"):
            drawing.ENOUGH = float("inf")
    count, polls, poll = int(frames), 0, shown.poll

    def polled(self: Any) -> Any:
        nonlocal polls
        events, polls = poll(self), polls + 1
        if polls == count // 2:
            events = [*events, Event("press", key="o"), Event("press", key="m")]
        return events

    shown.poll = polled
    timed(Presentation, "picture", "picture")
    timed(shown, "draw", "draw")
    timed(ti.GUI if view == "gui" else ti.ui.Window, "show", "show")
    timed(Simulation, "advance", "simulate")
    words = ["--view", view, "--size", size, "--frames", frames, "--quiet", *flags]
    sys.argv = ["taichi-cloth", "run", scene, *words]
    with contextlib.suppress(SystemExit):
        runpy.run_module("taichi_cloth", run_name="__main__")
    said = {}
    for panels, part in (("closed", slice(WARM, count // 2 - 2)), ("open", slice(-count // 3, -1))):
        picture, draw, show, simulate = (median(times[part]) for times in taken.values())
        said[panels] = {"draw": picture + draw, "show": show, "simulate": simulate}
    print(json.dumps(said))


if __name__ == "__main__":
    main(*sys.argv[1:])
