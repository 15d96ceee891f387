"""A session run again: as its log has it, and with other settings, each by `run` in a process.

The frames stay the log's, and with them the times of its events: what is finer are the steps
within each frame. (Of a mouse, what blows does so through a frame: shorter ones would be a weaker
push.)
"""

from __future__ import annotations

import contextlib
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth import console
from taichi_cloth.cli import run_options
from taichi_cloth.comparison.compare import Comparison, compare
from taichi_cloth.console import percent
from taichi_cloth.errors import InputError, RunFailure, counted, nearest
from taichi_cloth.files import trajectory
from taichi_cloth.files.events import Recorder
from taichi_cloth.files.pending import make_folder
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import (
    MOST_SUBSTEPS,
    PRECISIONS,
    PROGRAM,
    CompareOptions,
    RunOptions,
    flag,
)

if TYPE_CHECKING:
    from taichi_cloth.ui.interaction import Log

BEYOND = 60  # frames past the last event
KEPT = ("a.npz", "b.npz", "c.npz", "b.jsonl")  # what `--keep` may write
FINER = ("substeps", "dt", "method", "precision")


@dataclass
class About:
    """Notes on the runs beside their comparison, and JSON values by their names."""

    notes: list[str] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Planned:
    """A run: its log, and the flags of `run` that it has besides."""

    log: Path
    words: list[str]


def run(source: SceneSource, options: CompareOptions, within: str) -> tuple[Comparison, About]:
    """Run a session as its log has it and with other settings, and compare the two.

    Raises InputError for settings that make no other run, and RunFailure where a run fails before
    its first frame.
    """
    from taichi_cloth.ui import interaction

    assert options.events is not None
    path, log = Path(options.events), interaction.load(options.events)
    scene = _scene(source, path, log)
    _check(options)
    frames = options.frames or log.last_frame + 1 + BEYOND
    about = About()
    with _folder(options.keep) as folder:
        plans = _planned(options, log, scene, folder, about)
        names = ("a", "b", "c")[: len(plans)]
        files = [folder / f"{name}.npz" for name in names]
        with console.progress(("text", "bar", "elapsed")) as tell:
            failed = {}
            for k, (name, plan, file) in enumerate(zip(names, plans, files, strict=True)):
                words = [*source.words(), "--events", str(plan.log), "--frames", str(frames)]
                words += ["--beside", "none"] * ("beside" in log.header)
                tell(f"run {name.upper()}", k, len(plans))
                failed[name] = _run(name.upper(), [*words, *plan.words], file)
        for name, why in failed.items():
            if why:
                about.notes.append(f"{name.upper()} failed, and is compared up to there: {why}")
        about.values["failed"] = failed
        found = compare(files[0], files[1], within=within)
        finer = compare(files[1], files[2], within=within) if options.order else None
    found = replace(found, a=f"{path} as recorded", b=f"{path}, {_changes(options)}")
    if not _changes_step(log):
        _estimate(found, finer, about)
    elif options.given & {"substeps", "dt"}:
        about.notes.append("A's own error is not estimated: the session itself changes its steps")
    return found, about


def _scene(source: SceneSource, path: Path, log: Log) -> Scene:
    """The scene that the log is replayed on, from its start."""
    if log.header.get("start_frame"):
        raise InputError(f"{path}: its session went on from a checkpoint; compare needs its start")
    scene = source.build()
    if log.header.get("scene", scene.name) != scene.name:
        raise InputError(
            f"{path}: is of scene '{log.header['scene']}', not of '{scene.name}'; name that"
        )
    if log.header.get("arguments"):
        given = RunOptions(events=str(path))
        scene = run_options.scene_as_recorded(source, given, log.header["arguments"]).build()
    run_options.check_same_rules(RunOptions(events=str(path)), log, scene)
    return scene


def _check(options: CompareOptions) -> None:
    """Refuse what makes no other run."""
    from taichi_cloth.kernels.methods import METHODS

    if not options.given & set(FINER):
        flags = ", ".join(map(flag, FINER))
        raise InputError(f"--events: say what the other run has: {flags}")
    if {"dt", "substeps"} <= options.given:
        raise InputError("--dt and --substeps exclude each other: both say how long a step is")
    if options.method is not None and options.method not in METHODS:
        hint = nearest(options.method, METHODS)
        raise InputError(f"--method: unknown method '{options.method}'; {hint}")
    if options.order and not options.given & {"dt", "substeps"}:
        raise InputError("--order: needs finer steps; give --substeps or --dt")


def _planned(
    options: CompareOptions, log: Log, scene: Scene, folder: Path, about: About
) -> list[Planned]:
    """The runs A, B and, to measure an order, C. What is left out of the log is noted."""
    path = Path(options.events or "")
    recorded = log.header.get("dt", scene.world.dt)
    frame = scene.world.dt if recorded == "auto" else float(recorded)
    words: list[str] = []
    substeps = options.substeps
    if options.dt is not None:
        if "dt" in _set_to(log):
            raise InputError(f"--dt: the session {path} sets its frame time itself; use --substeps")
        steps = frame / options.dt
        if steps > MOST_SUBSTEPS:
            raise InputError(
                f"--dt {options.dt:g}: makes {steps:.3g} steps in each frame of {frame:g}; at most "
                f"{MOST_SUBSTEPS} can be"
            )
        substeps = max(1, math.ceil(steps - 1e-9))
        steps_of = counted(substeps, "step")
        about.notes.append(f"--dt {options.dt:g}: {steps_of} in each frame of {frame:g}")
    if substeps is not None:
        words += ["--substeps", str(substeps)]
    if options.method is not None:
        words += ["--method", options.method]
    precision = _precision(path, log)
    of_a, of_b = (["--precision", p] for p in (precision, options.precision or precision))
    fixed = {"substeps"} if substeps is not None else set()
    fixed |= options.given & {"method"}
    other = _without_sets(path, log, fixed, folder, about)
    plans = [Planned(path, of_a), Planned(other, [*words, *of_b])]
    if options.order and substeps is not None:
        ratio = substeps / int(log.header.get("substeps", 1))
        finest = round(substeps * ratio)
        if recorded == "auto" or ratio <= 1 or finest > MOST_SUBSTEPS:
            raise InputError(
                "--order: needs a log of fixed steps, and finer ones in B; give more --substeps"
            )
        at = words.index("--substeps") + 1
        plans.append(Planned(other, [*words[:at], str(finest), *words[at + 1 :], *of_b]))
    return plans


def _precision(path: Path, log: Log) -> str:
    """The precision that a session was recorded in; logs of earlier versions do not say it."""
    said: str = log.header.get("precision", RunOptions.precision)
    if said not in PRECISIONS:
        raise InputError(f"{path} line 1: unknown precision '{said}'; {nearest(said, PRECISIONS)}")
    return said


def _without_sets(path: Path, log: Log, fixed: set[str], folder: Path, about: About) -> Path:
    """The log without the session's own changes of what the other run keeps fixed."""
    from taichi_cloth.ui.interaction import SET, LogEvent

    def dropped(event: LogEvent) -> bool:
        return event.kind == SET.name and event.fields().get("name") in fixed

    frames = [f for f, events in log.by_frame.items() if any(map(dropped, events))]
    if not frames:
        return path
    about.notes.append(
        f"B leaves out the session's own changes of {', '.join(sorted(fixed))} (first in frame "
        f"{min(frames)})"
    )
    made = folder / "b.jsonl"
    recorder = Recorder(made, log.header)
    for frame, events in log.by_frame.items():
        for event in events:
            if not dropped(event):
                recorder.write(frame, event)
    recorder.close()
    return made


@contextlib.contextmanager
def _folder(keep: str | None) -> Iterator[Path]:
    """The folder of the recordings: one that stays, or one that does not."""
    if keep is None:
        with tempfile.TemporaryDirectory(prefix="taichi-cloth-") as made:
            yield Path(made)
        return
    folder = Path(keep)
    for name in KEPT:
        if os.path.lexists(folder / name):
            raise InputError(
                f"--keep {keep}: '{name}' is there already, and would be written over; name "
                "another folder"
            )
    there = os.path.exists(folder)
    make_folder("--keep", folder)
    try:
        yield folder
    finally:
        if not there:
            with contextlib.suppress(OSError):  # it has something in it, which stays
                folder.rmdir()


def _run(name: str, words: Sequence[str], file: Path) -> str | None:
    """Run a scene headless into a recording; None, or how it failed with frames to show for it.

    name: what the run is called.

    Raises InputError where it is refused, RunFailure where it has no frame but the start.
    """
    command = [sys.executable, "-m", "taichi_cloth", "run", *words, "--headless", "--quiet"]
    done = subprocess.run(
        [*command, "--save", str(file)], capture_output=True, text=True, check=False
    )
    if done.returncode == 0:
        return None
    said = [line for line in done.stderr.splitlines() if line.startswith(f"{PROGRAM}: error: ")]
    why = said[-1].removeprefix(f"{PROGRAM}: error: ") if said else f"exit {done.returncode}"
    if done.returncode == InputError.exit_status:
        raise InputError(why)
    with contextlib.suppress(InputError):
        if done.returncode == RunFailure.exit_status and (trajectory.load(file).frame > 0).any():
            return why
    raise RunFailure(f"run {name} failed at once, and nothing can be compared: {why}")


def _changes(options: CompareOptions) -> str:
    """The settings that B has and A has not, in words."""
    given = {name: getattr(options, name) for name in FINER if name in options.given}
    return ", ".join(f"{name} {value}" for name, value in given.items())


def _changes_step(log: Log) -> bool:
    """True if a session takes other steps, or another method, than those it began with."""
    began = {"substeps": 1, "dt": None, "method": None, **log.header}
    found = _set_to(log)
    return any(set(found.get(name, ())) - {began[name]} for name in ("substeps", "dt", "method"))


def _set_to(log: Log) -> dict[str, list[Any]]:
    """The values that a session gives to each setting."""
    from taichi_cloth.ui.interaction import SET

    found: dict[str, list[Any]] = {}
    for event in (event for events in log.by_frame.values() for event in events):
        if event.kind == SET.name:
            fields = event.fields()
            found.setdefault(fields["name"], []).append(fields["value"])
    return found


def _estimate(found: Comparison, finer: Comparison | None, about: About) -> None:
    """Note what the distance says of A's own error, where the two differ in nothing but steps.

    Up to where they part or differ in an event: beyond it no order holds. By Richardson (1911), if
    errors go by h^p, the distance of A and B is A's error times 1 - (h_B / h_A)^p.
    """
    steps = [_step(settings) for settings in (found.settings_a, found.settings_b)]
    alike = all(
        found.settings_a.get(name) == found.settings_b.get(name)
        for name in ("method", "precision", "dt")
    )
    if steps[0] is None or steps[1] is None or not alike or steps[0] <= steps[1]:
        return
    ends = [event.time for event in (found.first_break, found.first_touch) if event]
    until = min([*ends, found.parted if found.parted is not None else math.inf, math.inf])
    window = found.time < until
    apart = _rms(found.rms[window])
    if not apart > 0.0:
        return
    from taichi_cloth.kernels import methods

    ratio = steps[0] / steps[1]
    order, how = float(methods.load(found.settings_a["method"]).claims.order), "claimed"
    if finer is not None:
        near = _rms(finer.rms[finer.time < until])
        if near > 0.0 and apart > near:
            order, how = math.log(apart / near) / math.log(ratio), "measured"
            about.values["order"] = order
        else:
            about.notes.append("no order can be measured: a finer step brings them no nearer")
    own = apart / (1.0 - ratio**-order)
    when = "over all frames" if not math.isfinite(until) else f"before time {until:g}"
    about.values |= {"own_error": own, "own_error_relative": own / found.scale}
    about.notes.append(
        f"A's own error, steps being {ratio:g} times as long, is about "
        f"{percent(own / found.scale)} ({own:.3g}) {when}, by an order of {order:.3g} ({how})"
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else 0.0


def _step(settings: dict[str, Any]) -> float | None:
    """The time of a step; None where it is not known, or changes."""
    dt, substeps = settings.get("dt"), settings.get("substeps")
    return dt / substeps if isinstance(dt, float) and isinstance(substeps, int) else None
