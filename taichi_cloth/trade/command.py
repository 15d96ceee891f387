"""The command ``taichi-cloth trade SCENE``: error beside cost, as files, a table and a plot."""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from taichi_cloth.errors import InputError
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import ARCHS, PROGRAM, ComparisonOptions, TradeOptions
from taichi_cloth.trade import plot, reference, report, rows, runner, settings

PACKAGES = ("taichi-cloth", "taichi", "numpy", "scipy", "python")
FILES = ("trade.csv", "trade.json", "trade.png", "trade.svg")


def main(source: SceneSource, options: TradeOptions) -> int:
    """Measure, write the files, print the table; the exit status."""
    from rich.console import Console

    # A pipe or a file has no width: give whole lines a place where they fit.
    console = Console() if sys.stdout.isatty() else Console(width=210)
    scene, chosen, how = prepare(source, options)
    folder = Path(options.output or f"trade-{scene.name}")
    prepare_folder(folder, FILES)
    try:
        with measured(source, options, scene, chosen, how) as result:
            if not result.outcomes:
                raise KeyboardInterrupt  # before anything was finished
            made = rows.rows_of(result, common(scene), run_words(source, how))
        written = write(folder, source, options, result, made)
    finally:
        with contextlib.suppress(OSError):
            folder.rmdir()  # where nothing was written
    report.show(result, made, console)
    console.print(f"written: {folder}/", ", ".join(written), highlight=False, markup=False)
    if result.interrupted:
        kept = f"{len(made)} of {len(chosen)} settings were finished, and are kept"
        console.print(f"interrupted: {kept}", highlight=False)
        raise KeyboardInterrupt
    return 0


def prepare(
    source: SceneSource, options: ComparisonOptions
) -> tuple[Scene, list[settings.Setting], runner.Plan]:
    """The scene, the settings to compare and how they are run; raises InputError."""
    from taichi_cloth import runtime

    scene = runner.without_mouse(source.build())
    reference.check_frames(scene, options.frames or 1)
    chosen = settings.choose(scene, options)
    how = runner.plan(scene, options)
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


def prepare_folder(folder: Path, files: tuple[str, ...]) -> None:
    """See before a long run that results can be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--output {folder}: cannot be made: {error.strerror}") from None
    for name in files:
        PendingFile(folder / name).discard()


@contextlib.contextmanager
def measured(
    source: SceneSource,
    options: ComparisonOptions,
    scene: Scene,
    chosen: list[settings.Setting],
    how: runner.Plan,
    closed: bool = True,
    quiet: bool = False,
) -> Iterator[runner.Result]:
    """What the sweep found, with its samples as long as the context lasts.

    How far it is shows on standard error, unless `quiet`. closed: whether the scene is the one
    whose closed form is known, if there is one.
    """
    frames = options.frames or reference.default_frames(scene)
    run = runner.Sweep(
        [scene],
        chosen,
        frames,
        how,
        lambda times: reference.closed_form(source, scene, times) if closed else None,
    )
    try:
        with contextlib.nullcontext(run.tell) if quiet else progress() as run.tell:
            (result,) = run.run()
        yield result
    finally:
        run.close()


@contextlib.contextmanager
def progress() -> Iterator[Callable[[str, int, int], None]]:
    """A bar with the time left on a terminal, a line every tenth elsewhere."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    if not console.is_terminal:
        told = -1

        def tell_line(text: str, done: int, total: int) -> None:
            nonlocal told
            if 10 * done // total > told:
                told = 10 * done // total
                print(f"{done} of {total}: {text}", file=sys.stderr, flush=True)

        yield tell_line
        return
    columns = BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left:")
    with Progress(
        *columns,
        TimeRemainingColumn(),
        TextColumn("{task.description}"),
        console=console,
        transient=True,
        refresh_per_second=2,  # what is measured needs the processor
    ) as bar:
        task = bar.add_task("", total=None)
        yield lambda text, done, total: bar.update(
            task, description=text, completed=done, total=total
        )


def write(
    folder: Path,
    source: SceneSource,
    options: ComparisonOptions,
    result: runner.Result,
    measured: list[rows.Row],
) -> list[str]:
    """Write the files, each whole; return their names. There is no plot without an error."""
    texts = {
        "trade.csv": rows.as_csv(measured).encode(),
        "trade.json": rows.as_json(measured, environment(source, options, result)).encode(),
    }
    drawn = plot.draw(result, measured, ("png", "svg"))
    texts |= {f"trade.{kind}": content for kind, content in drawn.items()}
    for name, content in texts.items():
        PendingFile(folder / name).fill(lambda file, content=content: file.write(content))
    return list(texts)


def common(scene: Scene) -> dict[str, str]:
    """What all rows share."""
    from taichi_cloth.measuring import machine

    return {"scene_hash": scene_hash(scene), "versions": machine.versions(PACKAGES)}


def environment(
    source: SceneSource, options: ComparisonOptions, result: runner.Result
) -> dict[str, Any]:
    """What it takes to measure the same again."""
    from taichi_cloth.measuring import machine

    horizon, found = result.horizon, result.reference
    devices = {o.about["device"]: None for o in result.outcomes if o.about}
    return {
        "command": " ".join([PROGRAM, "trade", *source.words(), *options.words()]),
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
        "reference_floor": found.floor(horizon) if found else None,
        "event": found.event if found else None,
        "interrupted": result.interrupted,
    }


def scene_hash(scene: Scene) -> str:
    """16 digits that two scenes share only if all of their physics is the same."""
    digest = hashlib.sha256()
    world = scene.world
    digest.update(repr((world.size, world.gravity, world.walls, world.collisions)).encode())
    if world.more:
        digest.update(repr(sorted(world.more.items())).encode())
    for part in (scene.particles, scene.springs):
        for of in fields(part):
            if of.name != "color":
                digest.update(np.ascontiguousarray(getattr(part, of.name)).tobytes())
    return digest.hexdigest()[:16]


def run_words(source: SceneSource, how: runner.Plan) -> list[str]:
    """The words of a run of the scene, to which a setting's are added."""
    return [PROGRAM, "run", *source.words(), *how.words()]
