"""``taichi-cloth run``: a scene in a window or headless, and the files that it reads and writes."""

from __future__ import annotations

import contextlib
import os
import platform
import shlex
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy

from taichi_cloth import runtime
from taichi_cloth.cli import scene_command
from taichi_cloth.errors import InputError, RunFailure, SimulationFailure, counted
from taichi_cloth.files.events import Recorder
from taichi_cloth.files.exports import Export
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.files.recordings import Recordings
from taichi_cloth.files.trajectory import Trajectory
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import (
    HEADLESS_FRAMES,
    PROGRAM,
    RunOptions,
    check_run,
    flag,
    shown_parts,
)
from taichi_cloth.version import __version__

if TYPE_CHECKING:
    from taichi_cloth.runtime import Device
    from taichi_cloth.simulation import saved
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui.interaction import Log
    from taichi_cloth.ui.loop import Summary
    from taichi_cloth.ui.views.contract import View

MOST_WITH_TOOLS = 20_000  # particles of a scene in a window that has all mouse tools ready
MOST_NOTES = 4  # sentences on spheres wider than the thickness, before a run


@dataclass(frozen=True)
class _Files:
    """What a run reads and writes.

    recorder: of its log. resumed: the checkpoint that it goes on from; ending: the file of the one
    that it ends with.
    """

    recorder: Recorder | None
    recordings: Recordings
    resumed: saved.Saved | None
    ending: PendingFile | None


def main(source: SceneSource, options: RunOptions) -> int:
    """Run a scene; return the exit status.

    Everything that can be refused is refused before Taichi starts, and leaves no file.
    """
    options = _consistent(options)
    if options.dt == "auto" and "substeps" in options.given:
        raise InputError("--substeps: --dt auto chooses them; give one of the two")
    scene = source.build()
    if not options.given & {"dt", "substeps"}:
        options = replace(options, dt=source.frame())

    from taichi_cloth.ui import film, interaction

    log = interaction.load(options.events) if options.events else None
    if log:
        options = _as_recorded(options, log.header)
        if log.header.get("scene") == scene.name and log.header.get("arguments"):
            source = _scene_as_recorded(source, options, log.header["arguments"])
            scene = source.build()
    resumed = _resumed(options)
    if resumed:
        options, source = _as_saved(source, scene.name, options, resumed)
        scene = source.build()
    if options.image:
        film.Image(options.image).discard()
    if options.video:
        film.Film(options.video).discard()
    if options.pictures is not None and not os.path.isdir(options.pictures):
        raise InputError(f"--pictures {options.pictures}: there is no such folder; make it first")
    with contextlib.ExitStack() as unfinished:
        trajectory = Trajectory(options.save, options.every) if options.save else None
        if trajectory:
            unfinished.callback(trajectory.discard)
        export = _export(scene, options)
        if export:
            unfinished.callback(export.discard)
        recorder = Recorder(options.record) if options.record else None
        if recorder:
            unfinished.callback(recorder.discard)
        ending = PendingFile(options.checkpoint) if options.checkpoint else None
        if ending:
            unfinished.callback(ending.discard)
        files = _Files(recorder, Recordings(trajectory, export), resumed, ending)
        return _simulate(source, scene, options, log, files)


def _export(scene: Scene, options: RunOptions) -> Export | None:
    """What `--export` asks for."""
    if options.export is None:
        return None
    dt = options.dt if isinstance(options.dt, float) else scene.world.dt
    return Export(options.export, dt, options.every)


def _as_recorded(options: RunOptions, header: Mapping[str, Any]) -> RunOptions:
    """The options with the recording's dt, substeps and so on where none are given."""
    recorded = {
        name: header[name]
        for name in ("dt", "substeps", "method", "topology")
        if name in header and name not in options.given
    }
    if recorded.get("dt") == "auto" and "substeps" in options.given:
        del recorded["dt"]  # substeps of the user's own: of the scene's frames, too
    if options.dt == "auto":
        recorded.pop("substeps", None)
    return _consistent(replace(options, **recorded))


def _scene_as_recorded(
    source: SceneSource, options: RunOptions, arguments: Sequence[str]
) -> SceneSource:
    """The scene with the recording's parameters and assignments where none are given."""
    try:
        return scene_command.recorded(source, arguments)
    except InputError as error:
        raise InputError(f"{options.events} line 1: {error}") from None


def _resumed(options: RunOptions) -> saved.Saved | None:
    """The checkpoint that `--resume` names."""
    if options.resume is None:
        return None
    from taichi_cloth.simulation import saved

    return saved.read(Path(options.resume))


def _as_saved(
    source: SceneSource, name: str, options: RunOptions, resumed: saved.Saved
) -> tuple[RunOptions, SceneSource]:
    """The options and the scene, called `name`, as a checkpoint's where none are given.

    Raises InputError where what is given is not what it was made with.
    """
    parts, about = resumed.parts, resumed.about
    settings, where = parts["settings"], f"--resume {options.resume}"
    if parts["name"] != name:
        raise InputError(f"{where}: is of scene '{parts['name']}', not of '{name}'")
    of_run = {
        "method": parts["method"],
        "precision": parts["precision"],
        "topology": parts["kept"].topology,
        "dt": settings["dt"] if parts["auto"] is None else "auto",
        "substeps": settings["substeps"] if parts["auto"] is None else 1,
        **settings["solver"],
    }
    for name, value in of_run.items():
        if name in options.given and getattr(options, name) != value:
            raise InputError(f"{where}: was made with {flag(name)} {value}; leave the flag out")
    try:
        source = scene_command.recorded(source, about.get("arguments", []))
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return _consistent(replace(options, **of_run)), source


def _consistent(options: RunOptions) -> RunOptions:
    """The options with what follows from them filled in; refuses those that exclude each other."""
    options = check_run(options)
    if options.headless:
        if options.view not in ("auto", "none"):
            raise InputError(f"--headless and --view {options.view} exclude each other; give one")
        options = replace(options, view="none")
    written: dict[str, str] = {}
    for name in ("record", "save", "export", "image", "video", "checkpoint"):
        path = getattr(options, name)
        if path is None:
            continue
        twin = written.setdefault(os.path.realpath(path), name)
        if twin != name and os.path.isfile(path) | (not os.path.exists(path)):
            raise InputError(f"--{twin} and --{name} would write the same file, {path}")
    return options


def _simulate(
    source: SceneSource,
    scene: Scene,
    options: RunOptions,
    log: Log | None,
    files: _Files,
) -> int:
    """Run a checked scene on the device; return the exit status."""
    from taichi_cloth.simulation.checkpoint import Checkpoint
    from taichi_cloth.ui import app
    from taichi_cloth.ui.framing import camera_of
    from taichi_cloth.ui.opening import open_view

    # Numbers that overflow are the watchdog's to report, in one line.
    numpy.seterr(all="ignore")
    device = runtime.start(
        options.arch, options.precision, options.threads, fast_math=options.fast_math
    )
    recorder, recordings = files.recorder, files.recordings
    if files.resumed:
        there = Checkpoint(**files.resumed.parts)
        scene = scene.with_world(tools=there.kept.taken.scene.world.tools)
        sim = _simulation(scene, options)
        sim.restore(there)
    else:
        sim = _simulation(_with_tools(scene, options, log), options)
    view = open_view(
        options.view,
        scene.world,
        size=options.size,
        title=f"{PROGRAM}: {scene.name}",
        pictures=bool(options.image or options.video),
        camera=camera_of(scene),
        status=options.status,
        text_size=options.text_size,
    )
    with contextlib.closing(view):
        seed = _seed(options, log)
        if log:
            log.header["seed"] = seed
            _note_differences(log.header, _header(source, app.log_header(sim, view, seed)))
        if recorder:
            recorder.write_header(_header(source, app.log_header(sim, view, seed, replay=log)))
        _note_inside(sim, options)
        if not options.quiet:
            _announce(sim, device, view)
            _note_passing(source, scene)
            if recordings and view.visible:
                words = "--save" if recordings.trajectory else "--export"
                print(f"r goes back to the start, and {words} begins anew there", flush=True)
        begin = time.perf_counter()
        with _kept(source, sim, device, files):
            summary = app.run(
                sim,
                view,
                replay=log,
                recorder=recorder,
                trajectory=recordings if recordings else None,
                seed=seed,
                about={"arguments": source.flags()},
                device=device.describe(),
                **_of_frames(options, view),
            )
        if not options.quiet:
            print(_last_line(sim, summary, time.perf_counter() - begin))
        _check_converged(sim, options)
        if not options.quiet:
            _note_held_up(sim)
            _note_left_out(recordings)
            _note_unsettled(sim)
    return 0


def _with_tools(scene: Scene, options: RunOptions, log: Log | None) -> Scene:
    """The scene with what mouse tools need compiled from the start, so that no click waits for it.

    It is so in a window, but for scenes so large that their frames would feel what is idle, and
    where a log was recorded with it; else the first use of a tool compiles.
    """
    from taichi_cloth.ui.opening import opens_window

    if log is not None:
        return scene.with_world(tools=bool(log.header.get("tools", False)))
    ready = opens_window(options.view) and len(scene.particles) <= MOST_WITH_TOOLS
    return scene.with_world(tools=True) if ready else scene


def _simulation(scene: Scene, options: RunOptions) -> Simulation:
    from taichi_cloth.simulation.simulation import Simulation

    return Simulation(
        scene,
        method=options.method,
        dt=options.dt,
        substeps=options.substeps,
        execution=options.execution,
        topology=options.topology,
        tolerance=options.tolerance,
        iterations=options.iterations,
        compiling=None if options.quiet else partial(_note_compiling, scene),
    )


def _say(text: str) -> None:
    """Say something on standard error, in a line."""
    print(f"{PROGRAM}: {text}", file=sys.stderr, flush=True)


def _note_compiling(scene: Scene) -> None:
    """Say on standard error why nothing happens for a while."""
    touches = scene.obstacles or scene.features().resting
    takes = "up to some minutes" if touches else "some seconds"
    _say(f"compiling kernels for this run: {takes}, once; later runs find them")


@contextlib.contextmanager
def _kept(
    source: SceneSource,
    sim: Simulation,
    device: Device,
    written: _Files,
) -> Iterator[None]:
    """Finish log, trajectory, export and checkpoint however the run ends.

    A failed one has its last frame.
    """
    from taichi_cloth.ui import rescue

    recorder, recordings, ending = written.recorder, written.recordings, written.ending
    failure: KeyboardInterrupt | RunFailure | InputError | None = None

    def finish() -> None:
        with contextlib.ExitStack() as files:  # each is tried, also where a disk is full
            if recorder:
                files.callback(recorder.close)
            if ending and not ending.file.closed:
                from taichi_cloth.simulation import saved

                now, about = sim.checkpoint(), {"arguments": source.flags()}
                files.callback(saved.into, ending, vars(now), about)
            if recordings.export:
                files.callback(recordings.export.save)
            if recordings.trajectory:
                files.callback(recordings.trajectory.save, _meta(source, sim, device))
            if isinstance(failure, SimulationFailure):
                recordings.record(sim, last=True)

    try:
        with rescue.saving(finish):
            yield
    except (KeyboardInterrupt, RunFailure) as error:
        failure = error
    except InputError as error:
        if sim.frame == 0:  # refused before anything was run
            raise
        failure = error  # a disk is full: it may not be the one of the other files
    finish()
    if failure:
        raise failure


def _seed(options: RunOptions, log: Log | None) -> int:
    """The seed that is asked for, else the log's, else 0."""
    if options.seed is not None:
        return options.seed
    seed: int = log.header.get("seed", 0) if log else 0
    return seed


def _of_frames(options: RunOptions, view: View) -> dict[str, Any]:
    """What the options say of the run's frames, as `app.run` takes it.

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


def _announce(sim: Simulation, device: Device, view: View) -> None:
    """Say what runs, and on standard error if its steps are too long to be stable, or if there is
    something that the precision cannot resolve.
    """
    from taichi_cloth.limits.auto_step import above_limit
    from taichi_cloth.limits.precision import unresolved
    from taichi_cloth.simulation.diagnostics import acceleration_at_start

    print(_first_line(sim, device, view), flush=True)
    warnings = [
        above_limit(sim.method, sim.scene, sim.dt, sim.substeps),
        unresolved(
            sim.scene, acceleration_at_start(sim.scene), sim.dt, sim.substeps, device.precision
        ),
    ]
    for warning in filter(None, warnings):
        _say(f"warning: {warning}")
    if sim.scene.features().thick:
        for sentence in sim.scene.spheres.widened[:MOST_NOTES]:
            _say(f"note: {sentence}")


def _note_passing(source: SceneSource, scene: Scene) -> None:
    """Say on standard error that a mesh file passes through itself, where nobody asked for that."""
    asked = any(entry.keys[-1] == "thickness" for entry in source.assignments)
    if source.is_mesh and not asked and not scene.features().thick:
        _say(
            "note: the mesh passes through itself: it is so large or so uneven that its steps "
            "would take far longer; --set meshes[0].thickness=0.01 keeps it from that"
        )


def _first_line(sim: Simulation, device: Device, view: View) -> str:
    """Scene, method, dt, substeps, device, execution path and view."""
    steps = f"{sim.substeps} substep{'s' * (sim.substeps > 1)}"
    width, height = view.size
    window = f"window {view.name} {width}x{height}" if view.visible else "headless"
    return (
        f"{sim.scene.name}: {sim.particle_count} particles, {sim.spring_count} springs; "
        f"{sim.method}, dt {sim.dt:g}, {steps}; "
        f"{device.describe()}, {sim.execution} {sim.topology}; {window}"
    )


def _last_line(sim: Simulation, summary: Summary, seconds: float) -> str:
    """Frames, time a frame, steps a second, and the execution path."""
    frames = summary.frames
    if not frames:
        return f"0 frames in {seconds:.2f} s"
    done = f"{frames} frame{'s' * (frames > 1)} in {seconds:.2f} s"
    if frames == 1:
        return done
    a_frame = summary.simulate / (frames - 1)
    return (
        f"{done}: {1e3 * a_frame:.3g} ms a frame to simulate after the first, "
        f"{sim.substeps / a_frame:.4g} steps/s, {sim.execution} {sim.topology}"
    )


def _check_converged(sim: Simulation, options: RunOptions) -> None:
    """Say on standard error how many steps' solutions missed their tolerance.

    Raises RunFailure where most of them did, unless the user accepts that.
    """
    if options.unconverged == "fail":
        try:
            sim.check_converged()
        except RunFailure as failure:
            raise RunFailure(f"{failure}, or accept it: --unconverged accept") from None
    if sim.work().unconverged and not options.quiet:
        _say(f"note: {sim.describe_convergence()}")


def _note_held_up(sim: Simulation) -> None:
    """Say on standard error that several threads were asked for, and only waited."""
    if sim.held_up:
        alone, together = (1e3 * seconds for seconds in sim.held_up)
        _say(
            f"note: another program wants the cores: a frame took {together:.3g} ms on all "
            f"threads, where one would take about {alone:.3g} ms; --execution parallel keeps "
            "them, without it the run gives way"
        )


def _note_left_out(recordings: Recordings) -> None:
    """Say on standard error that an export lacks particles, which came after its first frame."""
    left_out = recordings.export.left_out if recordings.export else 0
    if left_out:
        _say(
            "note: the export has the particles of its first frame; left out: "
            f"{counted(left_out, 'particle')} that came later"
        )


def _note_inside(sim: Simulation, options: RunOptions) -> None:
    """Say on standard error which particles begin inside an obstacle, from which they are pushed.

    Raises InputError where one has no place outside.
    """
    inside = sim.inside_at_start()
    if len(inside.stuck):
        first = int(inside.stuck[0])
        name = inside.solid[int(numpy.searchsorted(inside.particles, first))]
        raise InputError(
            f"particle {first} begins inside {name}, and what is around leaves it no room; "
            "move it, or make it fixed"
        )
    if len(inside.particles) and not options.quiet:
        count = len(inside.particles)
        _say(
            f"note: {counted(count, 'particle')} begin{'s' * (count == 1)} inside an obstacle and "
            f"{'is' if count == 1 else 'are'} pushed out in the first step; the first is particle "
            f"{inside.particles[0]}, in {inside.solid[0]}"
        )


def _note_unsettled(sim: Simulation) -> None:
    """Say on standard error in how many steps faces were left in obstacles and resting pairs
    overlapping, and whether triangles might intersect at the end.
    """
    thick = sim.scene.features().thick
    part, near = "a tenth" if thick else "a hundredth", sim.uncertified()
    if sim.unsettled_faces():
        _say(
            f"note: {sim.unsettled_faces()} of {sim.steps} steps ended with faces or edges of a "
            "cloth inside an obstacle; use more --substeps"
        )
    if sim.unsettled():
        _say(
            f"note: {sim.unsettled()} of {sim.steps} steps ended with pairs that overlap by more "
            f"than {part} of their reach; use more --substeps"
        )
    if near:
        _say(
            f"note: {counted(near, 'pair')} of particles ended so near that triangles of cloth "
            "might intersect: they are stretched, or the steps are too long"
        )


def _note_differences(recorded: Mapping[str, Any], present: Mapping[str, Any]) -> None:
    """Say on standard error where a replay's settings are not those of the recording."""
    notes = [
        f"{key} {present[key]} (recorded: {recorded[key]})"
        for key in ("scene", "dt", "substeps", "method", "topology")
        if key in recorded and key in present and recorded[key] != present[key]
    ]
    words = [shlex.join(header.get("arguments", ())) for header in (present, recorded)]
    if words[0] != words[1] and present.get("scene") == recorded.get("scene"):
        notes.append(f"{words[0] or 'no parameters'} (recorded: {words[1] or 'none'})")
    if notes:
        _say(f"note: replaying with {', '.join(notes)}")


def _header(source: SceneSource, header: dict[str, Any]) -> dict[str, Any]:
    """A log's header with the flags that gave its scene parameters and assignments."""
    return {**header, "arguments": source.flags()} if source.flags() else header


def _meta(source: SceneSource, sim: Simulation, device: Device) -> dict[str, Any]:
    """What a saved trajectory says about its run."""
    import taichi

    return {
        "scene": sim.scene.name,
        "arguments": source.flags(),
        "method": sim.method,
        "dt": sim.dt,
        "substeps": sim.substeps,  # the last ones, where they follow the springs
        "dt_auto": sim.follows,
        "precision": device.precision,
        "arch": device.arch,
        "device": device.describe(),
        "execution": sim.execution,
        "topology": sim.topology,
        "versions": {
            "taichi_cloth": __version__,
            "taichi": ".".join(map(str, taichi.__version__)),
            "numpy": numpy.__version__,
            "python": platform.python_version(),
        },
    }
