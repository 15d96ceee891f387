"""Reading the words of ``taichi-cloth compare``, and doing what they ask for."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from taichi_cloth.cli import scene_command
from taichi_cloth.errors import InputError
from taichi_cloth.files.pending import is_device
from taichi_cloth.scene import library
from taichi_cloth.settings.arguments import CommandParser, value_of
from taichi_cloth.settings.options import PROGRAM, WITHIN, CompareOptions, flag, parameters_of
from taichi_cloth.settings.parameters import error_limit

if TYPE_CHECKING:
    from taichi_cloth.cli.replays import About
    from taichi_cloth.comparison.compare import Comparison
    from taichi_cloth.files.pending import PendingFile

ABOUT = (
    "How far apart two runs of a scene are over time, and what differs first: two recordings "
    "(run --save), or a session that was logged (run --record) and the same with other settings."
)
OF_REPLAYS = ("substeps", "dt", "method", "precision", "frames", "order", "keep")


def main(arguments: Sequence[str]) -> int:
    """Compare what the words name, or print help; return the exit status."""
    if any(word.partition("=")[0] == "--events" for word in arguments):
        return _replayed(arguments)
    parser = CommandParser("compare", "A.npz B.npz | [SCENE] --events FILE.jsonl [flags]", ABOUT)
    declared = parameters_of(CompareOptions)
    parser.declare("flags", declared)
    words = parser.read(arguments)
    if words.wants_help:
        print(parser.format_help().rstrip())
        return 0
    values = {name: value_of(name, declared[name], text) for name, text in words.texts.items()}
    options = _checked(CompareOptions.from_given(values))
    for name in OF_REPLAYS:
        if name in options.given:
            raise InputError(f"{flag(name)}: only with --events, which runs a session again")
    if len(words.others) != 2:
        named = ", ".join(words.others) or "none"
        raise InputError(
            f"compare: name two recordings (got {named}); '{PROGRAM} run --save FILE.npz' makes "
            "one, and --events FILE.jsonl runs a session again"
        )
    from taichi_cloth.comparison.compare import compare

    with _picture(options) as picture:
        found = compare(*words.others, within=options.within or WITHIN)
        return _report(found, options, picture)


def _replayed(arguments: Sequence[str]) -> int:
    """Run a session twice, and compare; return the exit status."""
    read = scene_command.read("compare", CompareOptions, arguments, f"{ABOUT}\n", _scene_of)
    if read is None:
        return 0
    source, options = read
    options = _checked(options)
    _refuse_pipe(options.events or "")

    from taichi_cloth.cli import replays

    with _picture(options) as picture:
        found, about = replays.run(source, options, options.within or WITHIN)
        return _report(found, options, picture, about)


def _checked(options: CompareOptions) -> CompareOptions:
    """The options; InputError for a limit that is none."""
    if options.within is not None:
        error_limit("--within", options.within)
    return options


def _refuse_pipe(path: str) -> None:
    """Raise InputError for a log that could be read once only: each run reads it."""
    if is_device(Path(path)):
        raise InputError(f"{path}: is no file but a pipe or a device; write the log to a file")


def _scene_of(texts: Mapping[str, str | bool]) -> str:
    """The scene of a log, where the command line names none."""
    from taichi_cloth.ui import interaction

    path = str(texts["events"])
    _refuse_pipe(path)
    name = interaction.load(path).header.get("scene")
    if name is None:
        raise InputError(f"{path}: does not say its scene; name it: compare SCENE --events {path}")
    if name not in library.names():
        raise InputError(
            f"{path}: is of '{name}', which is no built-in scene; name its file: "
            f"compare FILE.toml --events {path}"
        )
    return str(name)


@contextlib.contextmanager
def _picture(options: CompareOptions) -> Iterator[PendingFile | None]:
    """The file of the picture that is asked for; discarded where it is not written."""
    if options.picture is None:
        yield None
        return
    from taichi_cloth.comparison import picture

    file = picture.begun(options.picture)
    try:
        yield file
    finally:
        file.discard()


def _report(
    found: Comparison,
    options: CompareOptions,
    file: PendingFile | None,
    about: About | None = None,
) -> int:
    """Print a comparison and write its picture; return the exit status."""
    from taichi_cloth import console
    from taichi_cloth.comparison import picture, report

    same = found.parted is None if options.within is not None else found.identical
    if about is not None:  # one that failed is not like one that went on
        same &= (about.values["failed"]["a"] is None) == (about.values["failed"]["b"] is None)
    if file is not None:
        picture.write(found, file)
    if options.json:
        more = {"notes": about.notes, **about.values} if about else {}
        values = {"same": same, **report.as_json(found), **more}
        print(json.dumps(values, indent=1))
    else:
        to = console.output()
        report.show(found, to)
        for note in about.notes if about else []:
            console.say(to, f"- {note}", hang=2)
        if file is not None:
            console.say(to, f"written: {options.picture}")
    return 0 if same else 1
