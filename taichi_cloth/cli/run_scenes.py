"""The scenes that follow each other in a window: what of the command line the next one takes.

How and where to compute, and what the window looks like, stays; the physics of a scene is its own.
A scene's log, trajectory, film and so on are files of their own, beside those of the first scene.
"""

from __future__ import annotations

import gc
import glob
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taichi_cloth.cli import run_files, run_options
from taichi_cloth.cli.run_files import RunFiles
from taichi_cloth.files.pending import is_device
from taichi_cloth.scene import library
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import WRITES, RunOptions, flag

if TYPE_CHECKING:
    from taichi_cloth.cli.run_beside import Beside
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui.interaction import Log
    from taichi_cloth.ui.view import View

# Of one scene alone: its steps, what solves them, the layout of its springs, what it begins with.
OF_ONE_SCENE = (
    *("method", "dt", "substeps", "tolerance", "iterations", "topology"),
    "lanes",
    "resume",
    "beside",
)


@dataclass(frozen=True)
class Wanted:
    """A checked scene that is to be run: where it comes from, its options, the files it writes."""

    source: SceneSource
    scene: Scene
    options: RunOptions
    files: RunFiles


@dataclass(frozen=True)
class Run:
    """A scene that is ready to run, in a simulation. log: what is replayed.

    beside: a second run under the same mouse.
    """

    of: Wanted
    sim: Simulation
    log: Log | None
    beside: Beside | None = None


class Window:
    """A view, and the scenes that follow each other in it.

    first: the one that it begins with. view: of it; with one that is no window there are no others.
    ready: makes the simulation of another one, or raises InputError or RunFailure.

    scenes: what the window offers.
    """

    def __init__(self, first: Wanted, view: View, ready: Callable[[Wanted], Run]) -> None:
        from taichi_cloth.ui.scenes import Scenes

        self.view, self._ready = view, ready
        self._source, self._options, self._name = first.source, first.options, first.scene.name
        self._unfinished = ExitStack()  # discards the files of scenes that were opened
        self._now = first
        self._next: Run | None = None
        self._made = [(first.scene.name, written(first.options))]
        about = choices(first.source, self._name) if view.visible else {}
        self.scenes = Scenes(about, self._open, edited=self._edited, file=file_of(first.source))

    def __enter__(self) -> Window:
        return self

    def __exit__(self, kind: object, error: object, traceback: object) -> None:
        """Discard what was not finished; where there were several scenes, say what is where."""
        self._unfinished.close()
        several = len(self._made) > 1 and not self._options.quiet
        for name, files in self._made if several else ():
            if files:
                print(f"{name}: {', '.join(files)}")

    def _open(self, name: str) -> None:
        """Make a scene ready; InputError or RunFailure where it cannot be."""
        source = source_of(name, self._source, self._name)
        scene, options = source.build(), options_of(name, self._options)
        names = self._make(source, scene, run_options.of_scene(options, scene.world))
        left = left_behind(self._source, self._options)
        if left:
            names.append(f"{', '.join(left)} {'were' if left[1:] else 'was'} for {self._name}")
        self.scenes.said = "; ".join([f"opened {name}", *names])

    def _edited(self) -> Callable[[], None] | None:
        """The opener of the present scene as its file says by now; None: it says the same."""
        if not self.scenes.file:
            return None
        scene = self._now.source.build()
        return None if scene == self._now.scene else partial(self._reread, scene)

    def _reread(self, scene: Scene) -> None:
        """Make the present scene ready as its file says by now, with the flags that it had."""
        now = self._now
        options = files_of(self._options, scene.name, onto=now.options)
        # Whether it is paused by now is for `Scenes` to say, and not for a flag of the start.
        options = replace(options, resume=None, paused=False, given=options.given - {"resume"})
        if scene.world.substeps != now.scene.world.substeps:
            options = run_options.of_scene(options, scene.world)
        names = self._make(now.source, scene, options)
        if now.options.resume is not None:
            names.append(f"--resume was of {Path(self.scenes.file).name} before")
        self.scenes.said = "; ".join([f"read {Path(self.scenes.file).name} anew", *names])

    def _make(self, source: SceneSource, scene: Scene, options: RunOptions) -> list[str]:
        """Make a scene ready; the files that it writes, each after its flag."""
        with ExitStack() as unfinished:
            files = unfinished.enter_context(run_files.begun(scene, options))
            self._next = self._ready(Wanted(source, scene, options, files))
            self._unfinished.push(unfinished.pop_all())
        words = (line.split(" ", 1) for line in written(options))
        return [f"{word} {Path(path).name}" for word, path in words]

    def go_on(self, frames: int) -> Run | None:
        """The scene that was opened, seen in the window; None: the window closes.

        frames: that the last one made.
        """
        run, self._next = self._next, None
        if run is None:
            return None
        if self._options.frames is not None:  # --frames counts those of all scenes
            self._options = replace(self._options, frames=self._options.frames - frames)
            run = replace(
                run,
                of=replace(run.of, options=replace(run.of.options, frames=self._options.frames)),
            )
        if not self._options.quiet:
            print(self.scenes.said, flush=True)
        self._made.append((run.of.scene.name, written(run.of.options)))
        gc.collect()  # what the last scene held on the device is given back
        self._turn_to(run)
        self._now, self.scenes.file = run.of, file_of(run.of.source)
        return run

    def _turn_to(self, run: Run) -> None:
        """Show a run; that of a scene that was read anew as the user looked at it, and had it."""
        from taichi_cloth.ui.framing import camera_of

        view, scenes, last, scene = self.view, self.scenes, self._now, run.of.scene
        again = run.of.source == last.source
        if not again:
            scenes.paused, scenes.tool = False, ""
        stays = again and scene.world.size == last.scene.world.size
        before, begun, look = view.camera, camera_of(last.scene), view.look
        moved = before and begun and before.pose != begun.pose
        scenes.pose = before.pose if stays and before and moved else None
        view.turn_to(scene.world, camera_of(scene))
        if stays:
            view.look = look


def file_of(source: SceneSource) -> str:
    """The file that a scene is read from; "": none."""
    return source.name if source.is_file else ""


def choices(first: SceneSource, name: str) -> dict[str, str]:
    """Scenes that a window may go on with, in the order of a list: a line on each, by name.

    first: of the scene that it began with, called `name`; it is among them if it is a file.
    """
    found = {name: f"the scene of {first.name}"} if first.is_file else {}
    return found | {one: library.description(one) for one in library.names() if one not in found}


def source_of(chosen: str, first: SceneSource, name: str) -> SceneSource:
    """The scene of a choice, as it is without parameters or assignments."""
    return SceneSource(first.name if first.is_file and chosen == name else chosen)


def options_of(chosen: str, options: RunOptions) -> RunOptions:
    """The options of the next scene. Its files are named after it: FILE-SCENE.jsonl, of which the
    first is taken that no file has.
    """
    other: dict[str, Any] = {f.name: f.default for f in fields(options) if f.name in OF_ONE_SCENE}
    there = replace(options, given=options.given - set(OF_ONE_SCENE), **other)
    return files_of(options, chosen, onto=there)


def files_of(first: RunOptions, scene: str, onto: RunOptions) -> RunOptions:
    """Options `onto` with the files of the next scene, each beside that of the first one."""
    given: dict[str, Any] = {name: getattr(first, name) for name in WRITES}
    paths: dict[str, Any] = {name: path and beside(path, scene) for name, path in given.items()}
    return replace(onto, **paths)


def beside(path: str, scene: str) -> str:
    """A path like this one for a file of another scene; devices, such as /dev/null, take all."""
    given = Path(path)
    if is_device(given):
        return path
    number, name = 1, f"{given.stem}-{scene}"
    while any(given.parent.glob(f"{glob.escape(name)}[._]*")) or (given.parent / name).exists():
        number += 1
        name = f"{given.stem}-{scene}-{number}"
    return str(given.with_name(name + given.suffix))


def left_behind(source: SceneSource, options: RunOptions) -> list[str]:
    """The flags that were for the first scene alone, which the next one does not take."""
    words = [flag(name) for name in OF_ONE_SCENE if name in options.given]
    return [*words, *(word for word in source.flags() if word.startswith("--"))]


def written(options: RunOptions) -> list[str]:
    """The files of a scene, each after the flag that asks for it."""
    paths = {name: getattr(options, name) for name in WRITES}
    return [f"{flag(name)} {path}" for name, path in paths.items() if path is not None]
