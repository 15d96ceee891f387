"""A run of a simulation in a view: windows, pictures and plain runs alike."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth import runtime
from taichi_cloth.console import progress
from taichi_cloth.errors import RunFailure
from taichi_cloth.files.events import Recorder
from taichi_cloth.files.recordings import Recordings
from taichi_cloth.files.trajectory import Trajectory
from taichi_cloth.ui import film as films
from taichi_cloth.ui import rescue
from taichi_cloth.ui.chrome.errors import Errors
from taichi_cloth.ui.interaction import Log
from taichi_cloth.ui.log_window import event_window
from taichi_cloth.ui.loop import Loop
from taichi_cloth.ui.scenes import Scenes
from taichi_cloth.ui.shutter import Shutter
from taichi_cloth.ui.summary import Summary
from taichi_cloth.ui.views.contract import View

if TYPE_CHECKING:
    from taichi_cloth.simulation.simulation import Simulation


def log_header(
    sim: Simulation, view: View, seed: int = 0, replay: Log | None = None
) -> dict[str, Any]:
    """The first line of an interaction log: what a replay must know beside the events.

    replay: the log that is being replayed while this one is recorded; its window is kept.
    """
    return {
        "scene": sim.scene.name,
        "window": list(event_window(sim.scene.world, view, replay)),
        "seed": seed,
        **({"dt": "auto"} if sim.follows else {"dt": sim.dt, "substeps": sim.substeps}),
        "method": sim.method,
        "topology": sim.topology,
        "precision": runtime.current_device().precision,
        **({"tools": True} if sim.scene.world.tools else {}),
    }


def run(
    sim: Simulation,
    view: View,
    *,
    frames: int | None = None,
    replay: Log | None = None,
    recorder: Recorder | None = None,
    trajectory: Trajectory | Recordings | None = None,
    on_frame: Callable[[Simulation], object] | None = None,
    film: str | None = None,
    image: str | None = None,
    pictures: str | None = None,
    about: Mapping[str, Any] | None = None,
    paused: bool = False,
    quiet: bool = False,
    status: bool = True,
    meters: bool = False,
    show: frozenset[str] | None = None,
    seed: int = 0,
    device: str | None = None,
    scenes: Scenes | None = None,
    errors: Errors | None = None,
) -> Summary:
    """Run `sim` in `view` until `frames` are done, the user quits, or (without both) for ever.

    Each turn polls the user's events, records and applies them, advances one frame, and draws
    it. A window shows at most 60 frames a second, and catches up no more than one that was late.

    replay: a log; its events of frame f (0-based, counted over resets) are applied
        before that frame is advanced. Until its last event the user's mouse is ignored.
    recorder: made with `log_header`; every applied event is written.
    trajectory: is shown every frame; recordings: it and an export. Saving them is the caller's.
    on_frame: called before each frame; the run ends where it returns False.
    film, image: paths of a film of the run and of a picture of its last frame; the view must
        draw pictures for them. Refused paths raise InputError before anything is run.
    pictures: the folder of what the keys s, v, w and x save; None: the current one.
    about: what the key w notes in a checkpoint beside the state, as `Checkpoint.save` takes it.
    paused: start paused (a window only). quiet: no progress bar, and no word of pictures.
    status: whether the status is shown from the start (`h` shows more of it, or none).
    meters: whether they are shown from the start (`m` shows and hides them).
    show: what is drawn of cloths from the start, words of `settings.options.SHOWN` (`d` goes on to
        the next choice); None: what suits the scene.
    seed: of the tools' random numbers; a log's header overrides it.
    device: from `Device.describe()`, for the status; absent: of the device that was started.
    errors: what measures the error of what is seen (`a`), shown by the meters; None: nothing.
    scenes: what a window may go on with: the run ends once the user opened one of them. None: none.

    A SimulationFailure pauses a window with a banner until R. Without a window, or where the user
    quits at the banner, it is raised once film and image are saved with the last good frame; so is
    the ConnectionCut of a window whose connection to the display is cut.
    """
    with ExitStack() as stack:
        picture_file = films.Image(image) if image else None
        if picture_file:
            stack.callback(picture_file.discard)
        film_file = films.Film(film) if film else None
        if film_file:
            stack.callback(film_file.discard)
        shutter = Shutter(sim.scene.name, pictures, quiet=quiet)
        loop = Loop(
            sim, view, replay=replay, recorder=recorder, trajectory=trajectory,
            on_frame=on_frame, film=film_file, shutter=shutter, about=about, paused=paused,
            status=status, meters=meters, show=show, seed=seed, device=device, scenes=scenes,
            errors=errors,
        )  # fmt: skip
        bar = stack.enter_context(_progress(frames, not (quiet or view.visible)))
        stack.enter_context(rescue.saving(lambda: loop.finish(picture_file)))
        failure: RunFailure | None = None
        try:
            loop.begin()
            while not (view.closed or loop.quit or loop.left) and loop.frames < (
                frames or math.inf
            ):
                loop.turn()
                bar(loop.frames)
        except RunFailure as error:
            failure = error
        except KeyboardInterrupt:
            # What was filmed so far is worth keeping; the caller decides how to end.
            loop.finish(picture_file)
            raise
        loop.finish(picture_file)
        failure = failure or loop.failure
        if failure:
            raise failure
        return loop.summary()


def pixels_of(
    sim: Simulation, view: View, *, status: bool = False, show: frozenset[str] | None = None
) -> np.ndarray:
    """The present frame of `sim` as `view` draws it, (height, width, 3) uint8.

    status, show: as for `run`.
    """
    loop = Loop(
        sim, view, replay=None, recorder=None, trajectory=None, on_frame=None, film=None,
        shutter=Shutter(""), paused=False, status=status, meters=False, show=show, seed=0,
        device=None,
    )  # fmt: skip
    return loop.pixels()


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
