"""A run of a simulation in a view: windows, pictures and plain runs alike."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.console import progress
from taichi_cloth.errors import InputError, RunFailure
from taichi_cloth.scene.rules import NOTED
from taichi_cloth.ui import film as films
from taichi_cloth.ui import rescue
from taichi_cloth.ui.interaction import Log
from taichi_cloth.ui.log_window import event_window
from taichi_cloth.ui.loop import Loop
from taichi_cloth.ui.request import Request
from taichi_cloth.ui.summary import Summary
from taichi_cloth.ui.view import View

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation


def log_header(
    sim: Simulation, view: View, seed: int = 0, replay: Log | None = None
) -> dict[str, Any]:
    """The first line of an interaction log: what a replay must know beside the events.

    replay: the log that is being replayed while this one is recorded; its window is kept.
    """
    return {
        **NOTED,
        "scene": sim.scene.name,
        "window": list(event_window(sim.scene.world, view, replay)),
        "seed": seed,
        **({"dt": "auto"} if sim.follows else {"dt": sim.dt, "substeps": sim.substeps}),
        "method": sim.method,
        **sim.solver,
        "topology": sim.topology,
        **({"lanes": sim.lanes} if sim.wide else {}),
        "precision": runtime.current_device().precision,
        **({"tools": True} if sim.scene.world.tools else {}),
        **({"start_frame": sim.frame} if sim.frame else {}),  # of a checkpoint that it went on from
    }


def run(sim: Simulation, view: View, **asked: Any) -> Summary:
    """Run `sim` in `view` until `frames` are done, the user quits, or (without both) for ever.

    Each turn polls the user's events, records and applies them, advances one frame, and draws
    it. A window shows at most 60 frames a second, and catches up no more than one that was late.

    asked: what a `Request` has, which explains it.

    A SimulationFailure pauses a window with a banner until R. Without a window, or where the user
    quits at the banner, it is raised once film and image are saved with the last good frame; so is
    the ConnectionCut of a window whose connection to the display is cut.
    """
    request = Request(**asked)
    with ExitStack() as stack:
        picture_file = films.Image(request.image) if request.image else None
        if picture_file:
            stack.callback(picture_file.discard)
        film_file = films.Film(request.film) if request.film else None
        if film_file:
            stack.callback(film_file.discard)
        loop = Loop(sim, view, request, film_file)
        shown = not (request.quiet or view.visible)
        bar = stack.enter_context(_progress(request.frames, shown))
        stack.enter_context(rescue.saving(lambda: loop.finish(picture_file)))
        failure: RunFailure | None = None
        try:
            loop.begin()
            while not loop.ended and loop.state.frames < (request.frames or math.inf):
                loop.turn()
                bar(loop.state.frames)
        except RunFailure as error:
            failure = error
        except (KeyboardInterrupt, InputError):  # an end that is asked for, or another file's disk
            # What was filmed so far is worth keeping; the caller decides how to end.
            loop.finish(picture_file)
            raise
        loop.finish(picture_file)
        failure = failure or loop.state.failure
        if failure:
            raise failure
        return loop.summary()


def pixels_of(
    sim: Simulation, view: View, *, status: bool = False, show: frozenset[str] | None = None
) -> np.ndarray:
    """The present frame of `sim` as `view` draws it, (height, width, 3) uint8.

    status, show: as for `run`.
    """
    return Loop(sim, view, Request(status=status, show=show)).pixels()


@contextmanager
def _progress(frames: int | None, shown: bool) -> Iterator[Callable[[int], None]]:
    """A bar on a terminal's standard error; its value is called with the number of frames done."""
    later = 0.0

    def told(done: int) -> None:
        # Terminals are slow next to a frame of a small scene.
        nonlocal later
        if time.perf_counter() >= later:
            later = time.perf_counter() + 0.1
            tell("", done, frames or 0)

    with progress(("frames", "bar", "count", "left"), shown=shown and bool(frames)) as tell:
        yield told
