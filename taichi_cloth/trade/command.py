"""A study of a scene as a command asks for it: prepared, measured, and written to files."""

from __future__ import annotations

import contextlib
import datetime
import shlex
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from taichi_cloth import console
from taichi_cloth.errors import InputError
from taichi_cloth.files.pending import write_all
from taichi_cloth.scene.fingerprint import scene_hash
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import ARCHS, PROGRAM
from taichi_cloth.settings.sweeps import ComparisonOptions
from taichi_cloth.sweeps.identity import PACKAGES
from taichi_cloth.sweeps.journal import Journal
from taichi_cloth.sweeps.tasks import Elsewhere, said_of_lost
from taichi_cloth.sweeps.within import Clock
from taichi_cloth.trade import plot, reference, rows, runner, settings
from taichi_cloth.trade.conditions import RunConditions, conditions, without_mouse
from taichi_cloth.trade.outcomes import Result

FILES = ("trade.csv", "trade.json", "trade.png", "trade.svg")


def prepare(
    source: SceneSource, options: ComparisonOptions
) -> tuple[Scene, list[settings.Setting], RunConditions]:
    """The scene, the settings to compare and how they are run; raises InputError."""
    from taichi_cloth import runtime

    scene = without_mouse(source.build())
    reference.check_frames(scene, options.frames or 1)
    reference.coarsest(scene, options.dt or scene.world.dt)  # whether there can be one
    chosen = settings.choose(scene, options)
    how = conditions(scene, options, len(chosen))
    archs = {setting.arch for setting in chosen} - {"cpu"}
    if archs:
        usable = runtime.usable_backends()
        for arch in sorted(archs, key=ARCHS.index):
            if usable[arch] is not None:
                there = ", ".join(name for name, lack in usable.items() if lack is None)
                raise InputError(
                    f"--archs {arch}: not usable here (it needs {usable[arch]}); usable: {there}"
                )
    return scene, chosen, how


def planned(
    scene: Scene,
    options: ComparisonOptions,
    chosen: list[settings.Setting],
    how: RunConditions,
    journal: Journal,
) -> tuple[list[settings.Setting], RunConditions]:
    """The result of `prepare`, or, where a sweep goes on in another time than it began in, the
    settings that were chosen then: else some that are finished would not be among them.
    """
    if journal.within == how.clock.seconds:
        return chosen, how
    begun = settings.choose(scene, options, Clock(journal.within))
    return begun, replace(conditions(scene, options, len(begun)), clock=how.clock)


@contextlib.contextmanager
def measured(
    source: SceneSource,
    options: ComparisonOptions,
    scene: Scene,
    chosen: list[settings.Setting],
    how: RunConditions,
    journal: Journal | None = None,
    elsewhere: Elsewhere | None = None,
    closed: bool = True,
    quiet: bool = False,
) -> Iterator[Result]:
    """The findings of a study, with its samples as long as the context lasts.

    How far it is shows on standard error, unless `quiet`. journal: has what is finished already.
    elsewhere: where it is measured, if not here. closed: whether the scene is the one whose closed
    form is known, if there is one.
    """
    frames = options.frames or reference.default_frames(scene)
    study = runner.Study(
        [scene],
        chosen,
        frames,
        how,
        lambda times: reference.closed_form(source, scene, times) if closed else None,
        journal,
        elsewhere,
    )
    try:
        with progress(shown=not quiet) as study.tell:
            (result,) = study.run()
        if study.lost and not quiet:
            print(said_of_lost(study.lost), file=sys.stderr, flush=True)
        yield result
    finally:
        study.close()


def progress(shown: bool = True) -> contextlib.AbstractContextManager[console.Tell]:
    """A bar with the time left on a terminal, a line every tenth elsewhere."""
    parts = "bar", "count", "elapsed", "left:", "left", "text"
    return console.progress(parts, shown=shown, lines=True)


def write(
    folder: Path,
    source: SceneSource,
    options: ComparisonOptions,
    result: Result,
    measured: list[rows.Row],
) -> list[str]:
    """Write the files, each whole; return their names.

    There is no plot without an error: one that lies there is of other rows, and goes.
    """
    texts = {
        "trade.csv": rows.as_csv(measured).encode(),
        "trade.json": rows.as_json(measured, environment(source, options, result)).encode(),
    }
    drawn = plot.draw(result, measured, ("png", "svg"))
    texts |= {f"trade.{kind}": content for kind, content in drawn.items()}
    write_all({folder / name: content for name, content in texts.items()})
    for name in FILES:
        if name not in texts:
            (folder / name).unlink(missing_ok=True)
    return list(texts)


def common(scene: Scene) -> dict[str, str]:
    """The shared part of all rows."""
    from taichi_cloth.measuring import machine

    return {"scene_hash": scene_hash(scene), "versions": machine.versions(PACKAGES)}


def environment(source: SceneSource, options: ComparisonOptions, result: Result) -> dict[str, Any]:
    """All that it takes to measure the same again."""
    from taichi_cloth.measuring import machine

    horizon, found = result.horizon, result.reference
    devices = {outcome.about["device"]: None for outcome in result.outcomes if outcome.about}
    return {
        "command": shlex.join([PROGRAM, "trade", *source.words(), *options.words()]),
        "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "versions": machine.versions(PACKAGES),
        "machine": machine.describe(),
        "devices": list(devices),
        "scene": result.scene.name,
        "scene_hash": scene_hash(result.scene),
        "particles": len(result.scene.particles),
        "springs": len(result.scene.springs),
        "frames": horizon.frames if horizon else None,
        "frames_asked": horizon.asked if horizon else None,
        "scale": horizon.scale if horizon else None,
        "scale_is": horizon.what if horizon else None,
        "disturbance_grown": horizon.grown if horizon else None,
        "reference": found.what if found else None,
        "reference_against": found.against if found else None,
        "reference_apart": found.apart.trajectory if found else None,
        "reference_floor": found.floor(horizon) if found and horizon else None,
        "event": found.event if found else None,
        "interrupted": result.interrupted is not None,
        "within": result.clock.seconds if result.clock.limited else None,
        "left_out": result.left_out,
    }


def run_words(source: SceneSource, how: RunConditions) -> list[str]:
    """The words of a run of the scene, to which a setting's are added."""
    return [PROGRAM, "run", *source.words(), *how.words()]
