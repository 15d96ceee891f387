"""The files that a run writes: begun before Taichi starts, finished however the run ends."""

from __future__ import annotations

import contextlib
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy

from taichi_cloth.cli import run_beside, run_notes
from taichi_cloth.errors import InputError, RunFailure, SimulationFailure
from taichi_cloth.files.events import Recorder
from taichi_cloth.files.exports import Export
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.files.recordings import Recordings
from taichi_cloth.files.trajectory import Trajectory
from taichi_cloth.scene.fingerprint import scene_hash
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.rules import MODEL
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import RunOptions
from taichi_cloth.version import __version__

if TYPE_CHECKING:
    from taichi_cloth.runtime import Device
    from taichi_cloth.simulation.simulation import Simulation


@dataclass(frozen=True)
class RunFiles:
    """The files of a run, beside pictures.

    recorder: of its log. ending: the file of the checkpoint that it ends with. beside: what is
    noted of a second run. report: that was asked for.
    """

    recorder: Recorder | None
    recordings: Recordings
    ending: PendingFile | None
    beside: Recordings
    report: PendingFile | None = None


@contextlib.contextmanager
def begun(scene: Scene, options: RunOptions) -> Iterator[RunFiles]:
    """The files that the options ask for; those that are not finished at the end are discarded.

    InputError where one cannot be written.
    """
    from taichi_cloth.ui import film

    if options.image:
        film.Image(options.image).discard()
    if options.video:
        film.Film(options.video).discard()
    with contextlib.ExitStack() as unfinished:
        recordings, beside = _recordings(scene, options, unfinished), Recordings(None, None)
        if run_beside.asked(options):
            beside = _recordings(scene, run_beside.files_of(options), unfinished)
        recorder = Recorder(options.record) if options.record else None
        if recorder:
            unfinished.callback(recorder.discard)
        ending = PendingFile(options.checkpoint) if options.checkpoint else None
        if ending:
            unfinished.callback(ending.discard)
        report = PendingFile(options.report) if options.report else None
        if report:
            unfinished.callback(report.discard)
        yield RunFiles(recorder, recordings, ending, beside, report)


def _recordings(scene: Scene, options: RunOptions, unfinished: contextlib.ExitStack) -> Recordings:
    """Recordings for `--save` and `--export`; `unfinished` discards them."""
    trajectory = Trajectory(options.save, options.every) if options.save else None
    if trajectory:
        unfinished.callback(trajectory.discard)
    export = _export(scene, options)
    if export:
        unfinished.callback(export.discard)
    return Recordings(trajectory, export)


def _export(scene: Scene, options: RunOptions) -> Export | None:
    """The recording for `--export`."""
    if options.export is None:
        return None
    dt = options.dt if isinstance(options.dt, float) else scene.world.dt
    return Export(options.export, dt, options.every, scene)


@contextlib.contextmanager
def kept(
    source: SceneSource,
    sim: Simulation,
    device: Device,
    written: RunFiles,
    beside: Simulation | None = None,
) -> Iterator[None]:
    """Finish log, trajectory, export and checkpoint however the run ends, and those of a second
    run beside it.

    A failed one has its last frame.
    """
    from taichi_cloth.ui import rescue

    recorder, recordings, ending = written.recorder, written.recordings, written.ending
    failure: KeyboardInterrupt | RunFailure | InputError | None = None
    began, first = sim.scene, sim.frame  # a user may change the scene
    second = beside.scene if beside else None

    def finish() -> None:
        refused: list[InputError] = []
        for write in writing():  # each is tried, also where a disk is full
            try:
                write()
            except InputError as error:
                refused.append(error)
        for other in refused[1:]:
            run_notes.say(str(other))
        if refused:
            raise refused[0]

    def writing() -> Iterator[Callable[[], object]]:
        if isinstance(failure, SimulationFailure):
            yield partial(recordings.record, sim, last=True)
            if beside:
                yield partial(written.beside.record, beside, last=True)
        if recordings.trajectory:
            yield partial(recordings.trajectory.save, _meta(source, began, sim, device))
        if recordings.export:
            yield recordings.export.save
        if written.beside.trajectory and beside and second:
            yield partial(written.beside.trajectory.save, _meta(source, second, beside, device))
        if written.beside.export:
            yield written.beside.export.save
        if ending and not ending.file.closed:
            from taichi_cloth.simulation import saved

            about = {"arguments": source.flags()}
            yield partial(saved.into, ending, vars(sim.checkpoint()), about)
        if recorder:
            yield recorder.close

    try:
        with rescue.saving(finish):
            yield
    except (KeyboardInterrupt, RunFailure) as error:
        failure = error
    except InputError as error:
        if sim.frame == first:  # refused before anything was run
            raise
        failure = error  # a disk is full: it may not be the one of the other files
    try:
        finish()
    except InputError as error:
        if failure is None or isinstance(failure, KeyboardInterrupt):
            raise
        run_notes.say(str(error))  # what ended the run is what to end with
    if failure:
        raise failure


def header(
    source: SceneSource, header: dict[str, Any], beside: run_beside.Beside | None
) -> dict[str, Any]:
    """A log's header with the flags that gave its scene parameters and assignments, and what a
    second run beside it has.
    """
    more: dict[str, Any] = {"beside": beside.text()} if beside else {}
    return {**header, **more, "arguments": source.flags()} if source.flags() else {**header, **more}


def _meta(source: SceneSource, began: Scene, sim: Simulation, device: Device) -> dict[str, Any]:
    """Facts of a run for its trajectory; began: the scene as it was at the start."""
    import taichi

    return {
        "scene": began.name,
        "arguments": source.flags(),
        "scene_source": source.as_json(),
        "scene_hash": scene_hash(began),
        "model": MODEL,
        "method": sim.method,
        **sim.solver,  # the last ones, too
        "dt": sim.dt,
        "substeps": sim.substeps,  # the last ones, where they follow the springs
        "dt_auto": sim.follows,
        "precision": device.precision,
        "arch": device.arch,
        "device": device.describe(),
        "execution": sim.execution,
        "topology": sim.topology,
        "lanes": sim.lanes,
        "versions": {
            "taichi_cloth": __version__,
            "taichi": ".".join(map(str, taichi.__version__)),
            "numpy": numpy.__version__,
            "python": platform.python_version(),
        },
    }
