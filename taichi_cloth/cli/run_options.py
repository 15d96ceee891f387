"""The options of a run with what follows: from each other, a log to replay, a checkpoint."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_cloth.cli import run_beside, run_kernels, scene_command
from taichi_cloth.errors import InputError
from taichi_cloth.files.pending import is_device
from taichi_cloth.scene import rules
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import SOLVER_SETTINGS, WRITES, RunOptions, check_run, flag

if TYPE_CHECKING:
    from taichi_cloth.scene.model import Scene, World
    from taichi_cloth.simulation import saved
    from taichi_cloth.simulation.past import Settings
    from taichi_cloth.ui.interaction import Log


def consistent(options: RunOptions) -> RunOptions:
    """The options with what follows from them filled in; refuses those that exclude each other."""
    options = run_kernels.consistent(check_run(options))
    if options.headless:
        if options.view not in ("auto", "none"):
            raise InputError(f"--headless and --view {options.view} exclude each other; give one")
        options = replace(options, view="none")
    if options.quiet and options.verbose:
        raise InputError("--quiet and --verbose exclude each other; give one")
    _check_written(options)
    return options


def _check_written(options: RunOptions) -> None:
    """Refuse two results in one file."""
    results = [(flag(name), getattr(options, name)) for name in WRITES]
    if run_beside.asked(options):
        other, of = run_beside.files_of(options), "of --beside"
        results += [(f"{flag(name)} {of}", getattr(other, name)) for name in run_beside.KEPT]
    written: dict[str, str] = {}
    for what, path in results:
        if path is None or is_device(Path(path)) or os.path.isdir(path):
            continue
        twin = written.setdefault(os.path.realpath(path), what)
        if twin != what:
            raise InputError(f"{twin} and {what} would write the same file, {path}")


def check_inputs_stay(source: SceneSource, options: RunOptions) -> None:
    """Refuse to write a result over what the run is made of.

    A log may be recorded anew, and a checkpoint made anew, where it was: the run goes on from them.
    A mesh exported to its own name is not written over: it gets numbers.
    """
    made_of = [
        (source.name if source.is_file else None, "the scene", "export"),
        (options.events, "--events", "record"),
        (options.resume, "--resume", "checkpoint"),
    ]
    results = [(name, flag(name), getattr(options, name)) for name in WRITES]
    if run_beside.asked(options):
        other = run_beside.files_of(options)
        results += [("", f"{flag(n)} of --beside", getattr(other, n)) for n in run_beside.KEPT]
    for path, what, but in made_of:
        for name, given, result in results:
            if not (path and result) or name == but:
                continue
            if os.path.realpath(result) == os.path.realpath(path):
                raise InputError(f"{given} {result}: would overwrite {what}; name another file")


def of_scene(options: RunOptions, world: World) -> RunOptions:
    """The options with the scene's steps, where they say nothing of them."""
    given = options.given & {"dt", "substeps"}
    if "substeps" in given or (given and options.dt == "auto"):
        return options
    dt = options.dt if given else None
    if isinstance(world.substeps, int):
        return replace(options, dt=dt, substeps=world.substeps)
    return replace(options, dt=dt if given else "auto", substeps=1)


def as_recorded(options: RunOptions, header: Mapping[str, Any]) -> RunOptions:
    """The options with the recording's dt, substeps and so on where none are given.

    Of the solver's settings those that the method takes, which may be another one.
    """
    from taichi_cloth.kernels import methods

    recorded = {
        name: header[name]
        for name in ("dt", "substeps", "method", "topology", "beside", *SOLVER_SETTINGS)
        if name in header and name not in options.given
    }
    if "lanes" not in options.given:
        recorded["lanes"] = run_kernels.word(header.get("lanes"))
    solver = {name: recorded.pop(name) for name in SOLVER_SETTINGS if name in recorded}
    if recorded.get("dt") == "auto" and "substeps" in options.given:
        del recorded["dt"]  # substeps of the user's own: of the scene's frames, too
    if options.dt == "auto":
        recorded.pop("substeps", None)
    try:
        options = consistent(replace(options, **recorded))
    except InputError as error:
        raise InputError(f"{options.events} line 1: {error}") from None
    taken = methods.load(options.method).claims.settings
    return replace(options, **{name: solver[name] for name in taken if name in solver})


def scene_as_recorded(
    source: SceneSource, options: RunOptions, arguments: Sequence[str]
) -> SceneSource:
    """The scene with the recording's parameters and assignments where none are given."""
    try:
        return scene_command.recorded(source, arguments)
    except InputError as error:
        raise InputError(f"{options.events} line 1: {error}") from None


def resumed(options: RunOptions) -> saved.Saved | None:
    """The checkpoint that `--resume` names."""
    if options.resume is None:
        return None
    from taichi_cloth.simulation import saved

    return saved.read(Path(options.resume))


def check_same_start(options: RunOptions, log: Log | None, resumed: saved.Saved | None) -> None:
    """Refuse to replay a session that went on from a checkpoint from anywhere else."""
    began = log.header.get("start_frame") if log else None
    here = resumed.parts["frame"] if resumed else 0
    if began is not None and began != here:
        raise InputError(
            f"{options.events} line 1: the session went on from a checkpoint at frame {began}, and "
            f"this run begins at frame {here}; name that checkpoint: --resume FILE.npz"
        )


def check_same_rules(options: RunOptions, log: Log | None, scene: Scene) -> None:
    """Refuse to replay a session of this scene whose rules have changed since."""
    if log and log.header and log.header.get("scene", scene.name) == scene.name:
        rules.refuse_changed(scene, log.header, f"{options.events} line 1")


def settings_of(parts: Mapping[str, Any]) -> dict[str, Any]:
    """The options, by name, with which a checkpoint of these parts goes on as it was.

    dt: "auto", if its substeps were chosen.
    """
    settings, chosen = parts["settings"], parts["auto"] is not None
    solver = {name: settings["solver"].get(name) for name in SOLVER_SETTINGS}
    return {
        "method": parts["method"],
        "dt": "auto" if chosen else settings["dt"],
        "substeps": 1 if chosen else settings["substeps"],
        **solver,
    }


def wanted_of(options: RunOptions, before: Settings) -> Settings:
    """The settings with which a resumed run goes on. before: those of its checkpoint."""
    solver = {name: getattr(options, name) for name in SOLVER_SETTINGS}
    dt, substeps = before.dt, before.substeps
    if isinstance(options.dt, float):  # else the run goes on choosing them
        dt, substeps = options.dt, options.substeps
    return replace(
        before,
        method=options.method,
        dt=dt,
        substeps=substeps,
        solver={name: value for name, value in solver.items() if value is not None},
    )


def as_saved(
    source: SceneSource, name: str, options: RunOptions, resumed: saved.Saved, log: Log | None
) -> tuple[RunOptions, SceneSource]:
    """The options and the scene, called `name`, as a checkpoint's where none are given.

    log: of a session that went on from there: what that one had is given, too. Method, step and
    solver may be others; raises InputError where a precision or topology that is given is not what
    it was made with, and for a solver's setting that the method does not take.
    """
    from taichi_cloth.kernels import methods
    from taichi_cloth.simulation.numbers import solver_settings

    parts, about, where = resumed.parts, resumed.about, f"--resume {options.resume}"
    if parts["name"] != name:
        raise InputError(f"{where}: is of scene '{parts['name']}', not of '{name}'")
    kept = parts["kept"]
    fixed = {
        "precision": parts["precision"],
        "topology": kept.topology,
        "lanes": run_kernels.word(kept.spec.lanes if kept.topology == "lanes" else 1),
    }
    for name, value in fixed.items():
        if name in options.given and getattr(options, name) != value:
            raise InputError(f"{where}: was made with {flag(name)} {value}; leave the flag out")
    here = set(options.given)
    if log is not None and "start_frame" in log.header:
        here |= log.header.keys()
    there = settings_of(parts)
    if options.dt == "auto" and "dt" in here and there["dt"] != "auto":
        raise InputError(
            f"{where}: was made with --dt {there['dt']:g}, and --dt auto chooses from the start of "
            "a run; give a number"
        )
    if here & {"dt", "substeps"} and options.dt != "auto":  # then both are the user's
        there |= {"dt": parts["settings"]["dt"], "substeps": parts["settings"]["substeps"]}
    wanted = {name: getattr(options, name) if name in here else there[name] for name in there}
    claims = methods.load(wanted["method"]).claims
    for name in SOLVER_SETTINGS:
        if name not in here and name not in claims.settings:
            wanted[name] = None
    try:
        solver = {name: wanted[name] for name in SOLVER_SETTINGS}
        wanted |= solver_settings(wanted["method"], claims, **solver)
        source = scene_command.recorded(source, about.get("arguments", []))
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return consistent(replace(options, **fixed, **wanted)), source
