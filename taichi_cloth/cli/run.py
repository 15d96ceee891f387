"""``taichi-cloth run``: a scene in a window or headless."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy

from taichi_cloth import runtime, signals
from taichi_cloth.cli import (
    run_aside,
    run_beside,
    run_budget,
    run_files,
    run_kernels,
    run_meter,
    run_notes,
    run_options,
    run_report,
)
from taichi_cloth.cli.run_scenes import Run, Wanted, Window
from taichi_cloth.errors import InputError, RunFailure
from taichi_cloth.files.recordings import Recordings
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import (
    HEADLESS_FRAMES,
    PROGRAM,
    RunOptions,
    shown_parts,
)

if TYPE_CHECKING:
    from taichi_cloth.runtime import Device
    from taichi_cloth.simulation import saved
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui.interaction import Log
    from taichi_cloth.ui.view import View

MOST_WITH_TOOLS = 20_000  # particles of a scene in a window that has all mouse tools ready


def main(source: SceneSource, options: RunOptions) -> int:
    """Run a scene; return the exit status.

    Everything that can be refused is refused before Taichi starts, and leaves no file.
    """
    options = run_budget.checked(run_options.consistent(options))
    run_options.check_inputs_stay(source, options)
    if options.dt == "auto" and "substeps" in options.given:
        raise InputError("--substeps: --dt auto chooses them; give one of the two")
    scene = source.build()
    options = run_options.of_scene(options, scene.world)

    from taichi_cloth.ui import interaction

    log = interaction.load(options.events) if options.events else None
    if log and options.hold:
        log = run_budget.without_its_steps(log)
    if log:
        options = run_options.as_recorded(options, log.header)
        if log.header.get("scene") == scene.name and log.header.get("arguments"):
            source = run_options.scene_as_recorded(source, options, log.header["arguments"])
            scene = source.build()
    resumed = run_options.resumed(options)
    run_options.check_same_start(options, log, resumed)
    run_options.check_same_rules(options, log, scene)
    if resumed:
        options, source = run_options.as_saved(source, scene.name, options, resumed, log)
        scene = source.build()
    if options.pictures is not None and not os.path.isdir(options.pictures):
        raise InputError(f"--pictures {options.pictures}: there is no such folder; make it first")
    with run_files.begun(scene, options) as files:
        return _simulate(Wanted(source, scene, options, files), log, resumed)


def _simulate(first: Wanted, log: Log | None, resumed: saved.Saved | None) -> int:
    """Run a checked scene on the device, and those that the user opens in its window; return the
    exit status.
    """
    from taichi_cloth.ui.opening import opens_window

    # Numbers that overflow are the watchdog's to report, in one line.
    numpy.seterr(all="ignore")
    options, scene = first.options, first.scene
    device = runtime.start(
        options.arch, options.precision, options.threads, fast_math=options.fast_math
    )
    signals.check()
    told = run_notes.compiling(scene, options)
    sim = _resumed(scene, options, resumed, told) if resumed else _begun(scene, options, log, told)
    signals.check()
    run_notes.note_inside(sim, options)
    run_notes.note_rounded(sim, options)
    make = partial(_simulation, sim.scene, told=told)
    beside = run_beside.begun(sim, options, make, paced=opens_window(options.view))
    failure: RunFailure | None = None
    with contextlib.closing(_view(scene, options)) as view, Window(first, view, _ready) as window:
        now: Run | None = Run(first, sim, log, beside)
        if log:
            window.scenes.fixed = "a log is replayed here, and that is of this scene"
        while now is not None:
            frames, missed = _run_in(window, now, device)
            # Told last, where the window goes on.
            failure = failure or _ended(now) or missed
            now = window.go_on(frames)
    if failure is not None:
        raise failure
    return 0


def _ready(wanted: Wanted) -> Run:
    """The run of a scene from its start, on the device that was started."""
    told = run_notes.compiling(wanted.scene, wanted.options)
    # What an earlier process compiled is for the fields of the first scene of a window.
    sim = _begun(wanted.scene, replace(wanted.options, lanes="8"), None, told)
    run_notes.note_inside(sim, wanted.options)
    run_notes.note_rounded(sim, wanted.options)
    make = partial(_simulation, sim.scene, told=told)
    return Run(wanted, sim, None, run_beside.begun(sim, wanted.options, make, paced=True))


def _run_in(window: Window, run: Run, device: Device) -> tuple[int, RunFailure | None]:
    """Run a scene in a view until it ends, and finish its files; return how many frames it made,
    and what to say of a budget that was to be held strictly, and was not.
    """
    from taichi_cloth.ui import app

    signals.check()
    view, sim, log, beside = window.view, run.sim, run.log, run.beside
    source, options, files = run.of.source, run.of.options, run.of.files
    seed = _seed(options, log)
    if log:
        log.header["seed"] = seed
        present = run_files.header(source, app.log_header(sim, view, seed), beside)
        run_notes.note_differences(log.header, present)
    if files.recorder:
        header = app.log_header(sim, view, seed, replay=log)
        files.recorder.write_header(run_files.header(source, header, beside))
    if not options.quiet:
        run_notes.announce(sim, device, view)
        if options.verbose:
            run_notes.tell_assumed(run.of.scene)
        if beside:
            print(f"beside it: {beside.names()[1]}", flush=True)
        run_notes.note_passing(source, run.of.scene)
        run_notes.note_files(run.of.scene)
        run_notes.note_parted(run.of.scene)
        run_notes.note_wide(run.of.scene)
        run_notes.note_reset(files.recordings, view)
    begin, words, way = time.perf_counter(), run_report.words_of(source, options), sim.way
    with (
        # Outermost: all else that the run leaves is on the disk before anything is tried.
        run_report.written(sim, options, words, files.report),
        run_files.kept(source, sim, device, files, beside.sim if beside else None),
        run_meter.measured(sim, options, waits=not view.visible) as errors,
        run_budget.held(sim, options, errors, view) as budget,
        run_aside.compiled_beside(sim, options),
    ):
        summary = app.run(
            sim,
            view,
            replay=log,
            recorder=files.recorder,
            trajectory=_noted(run),
            seed=seed,
            about={"arguments": source.flags()},
            device=device.describe(),
            scenes=window.scenes,
            errors=errors,
            beside=beside,
            examiner=run_report.Examining(sim, words, options.survivors),
            budget=budget,
            **_of_frames(options, view),
        )
        missed = budget.missed() if options.strict else None
    if not options.quiet:
        seconds = time.perf_counter() - begin
        along = beside.twin.later[1] if beside else 0.0
        waited = errors.waited + along
        print(run_notes.last_line(sim, way, summary, seconds, waited), flush=True)
        run_notes.note_refused(summary.refused)
        for note in files.recordings.export.notes() if files.recordings.export else ():
            run_notes.say(f"note: {note}")
        if log and options.frames is None and not view.visible:
            run_notes.note_unreplayed(log, summary.frames)
        for line in beside.findings(summary.frames) if beside else ():
            print(line, flush=True)
    return summary.frames, missed


def _noted(run: Run) -> Recordings | None:
    """The recorders of a run's frames, and of one beside it."""
    files = run.of.files
    if not files.recordings:
        return None
    if run.beside is None:
        return files.recordings
    return run_beside.BothRecordings(files.recordings, files.beside, run.beside.sim)


def _ended(run: Run) -> RunFailure | None:
    """Say what there is to say of a run that ended; the failure that it ended with, if any."""
    try:
        run_notes.check_converged(run.sim, run.of.options)
        if run.beside:
            run_notes.check_converged(run.beside.sim, run.of.options)
            run.beside.check()
    except RunFailure as failure:
        return failure
    if not run.of.options.quiet:
        run_notes.note_held_up(run.sim)
        run_notes.note_empty(run.of.files.recordings, run.of.options.every)
        run_notes.note_left_out(run.of.files.recordings)
        run_notes.note_unsettled(run.sim)
    return None


def _resumed(
    scene: Scene, options: RunOptions, resumed: saved.Saved, told: Callable[[], None] | None
) -> Simulation:
    """The simulation at a checkpoint; in other settings, if they are asked for, from there on.

    These are given to it as a panel would: what another method keeps from step to step is computed
    anew from positions and velocities.
    """
    from taichi_cloth.simulation.checkpoint import Checkpoint
    from taichi_cloth.simulation.past import Settings, set_to

    there = Checkpoint(**resumed.parts)
    if options.dt != "auto":
        there = replace(there, auto=None)  # the substeps are the user's from here on
    scene = scene.with_world(tools=there.kept.taken.scene.world.tools)
    sim = _simulation(scene, replace(options, **run_options.settings_of(vars(there))), told)
    try:
        sim.restore(there)
    except InputError as error:
        said = str(error).removeprefix("restore: ")
        raise InputError(f"--resume {options.resume}: {said}") from None
    before = Settings.of(sim)
    wanted = run_options.wanted_of(options, before)
    if wanted != before:
        set_to(sim, wanted)
        if sim.past is not None:  # the run begins here: nothing was done to it yet
            sim.past.begin(sim, sim.checkpoint())
    return sim


def _begun(
    scene: Scene, options: RunOptions, log: Log | None, told: Callable[[], None] | None
) -> Simulation:
    """The simulation at its start, with what mouse tools need compiled, so that no click waits.

    It is so in a window, but for scenes so large that their frames would feel what is idle, and
    where a log was recorded with it; else the first use of a tool compiles.
    """
    from taichi_cloth.ui.opening import opens_window

    ready = opens_window(options.view) and len(scene.particles) <= MOST_WITH_TOOLS
    if log is not None:
        ready = bool(log.header.get("tools", False))
    sim = _simulation(scene.with_world(tools=True) if ready else scene, options, told)
    if options.hold:
        run_budget.begin_stable(sim)
    return sim


def _simulation(scene: Scene, options: RunOptions, told: Callable[[], None] | None) -> Simulation:
    """A simulation at the start of a scene. told: called before it compiles."""
    from taichi_cloth.simulation.simulation import Simulation

    return Simulation(
        scene,
        method=options.method,
        dt=None if options.hold and options.dt == "auto" else options.dt,
        substeps=options.substeps,
        execution=options.execution,
        topology=options.topology,
        lanes=run_kernels.lanes_of(scene, options),
        tolerance=options.tolerance,
        iterations=options.iterations,
        compiling=told,
        soon=run_kernels.soon(scene, options),
    )


def _view(scene: Scene, options: RunOptions) -> View:
    """The window, or what stands for one."""
    from taichi_cloth.ui.framing import camera_of
    from taichi_cloth.ui.opening import open_view

    return open_view(
        options.view,
        scene.world,
        size=options.size,
        title=f"{PROGRAM}: {scene.name}",
        pictures=bool(options.image or options.video),
        camera=camera_of(scene),
        status=options.status,
        text_size=options.text_size,
        pair=run_beside.asked(options) is not None,
    )


def _seed(options: RunOptions, log: Log | None) -> int:
    """The seed that is asked for, else the log's, else 0."""
    if options.seed is not None:
        return options.seed
    seed: int = log.header.get("seed", 0) if log else 0
    return seed


def _of_frames(options: RunOptions, view: View) -> dict[str, Any]:
    """The options on the run's frames, as `app.run` takes them.

    Without a number of frames a run in a window ends when the user quits (None).
    """
    frames = options.frames
    if frames is None and not view.visible:
        frames = HEADLESS_FRAMES
    return {
        "frames": frames,
        "film": options.video,
        "image": options.image,
        "pictures": options.pictures,
        "paused": options.paused,
        "quiet": options.quiet,
        "status": options.status,
        "meters": options.meters,
        "show": shown_parts(options.show) if options.show else None,
    }
