"""The command ``taichi-cloth bench``: runs parts, keeps their results, fills documents."""

from __future__ import annotations

import importlib
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bench import PARTS, contacts, module_of, report, summary
from bench.contest import Bench, Piece
from bench.equal_error import picture, problems, runs_file
from bench.options import BenchOptions
from taichi_cloth import console
from taichi_cloth.errors import InputError, clipped
from taichi_cloth.files.pending import prepare_folder, write_whole
from taichi_cloth.measuring import machine
from taichi_cloth.settings.options import flag
from taichi_cloth.sweeps.within import clock

if TYPE_CHECKING:
    from rich.console import Console

QUICK_ROUNDS = 3
INTERRUPTED = "left out: interrupted"
PIECEWISE = "accuracy"  # the part that takes hours, and can be measured in pieces


def main(parts: Sequence[str], options: BenchOptions) -> int:
    """Measure parts (all, if none is named and no document is to be filled); the exit status.

    A part that is finished stays in the file of results, whatever becomes of the next. Of one that
    is interrupted the rows it has are shown, and kept where the file has no finished one of that.
    """
    to = console.output()
    folder = Path(options.output)
    path = folder / f"{machine.file_name()}.csv"
    document = Path(options.tables) if options.tables else None
    if document:
        console.document(document, report.MARKED)
    chosen = [part for part in PARTS if part in parts] or ([] if document else list(PARTS))
    if options.arch and "gpu" not in chosen:
        raise InputError("--arch: only the part gpu takes it")
    if options.against is not None:
        _check_against(options.against, chosen)
    piece = _piece(options, chosen)
    if chosen:
        prepare_folder(folder, [path.name])
        if path.exists():
            report.read(path)  # what there is can be joined
        description = machine.describe()
        for name, value in description.items():
            console.say(to, f"{name}: {value}", hang=2)
        rounds = options.rounds or (QUICK_ROUNDS if options.quick else 7)
        left_out = []
        for part in chosen:
            rows: list[report.Measurement] = []
            try:
                scenes = _measure(part, rounds, options, piece, to, rows)
            except KeyboardInterrupt:
                if part != PIECEWISE and any(row.is_measured for row in rows):
                    _keep_unfinished(path, description, part, rows, to)
                raise
            report.replace_part(path, description, part, rows, scenes)
            left_out += _show(part, rows, to)
        _show_left_out(left_out, to)
        console.say(to, f"\nwritten: {path}")
    if document:
        fill_document(document, folder, to.print)
    return 0


def _check_against(python: str, chosen: Sequence[str]) -> None:
    """Raise InputError where an earlier build's Python is none, or no part takes it."""
    if "windows" not in chosen:
        raise InputError("--against: only the part windows takes it")
    try:
        command = [python, "-c", "import taichi_cloth"]
        found = subprocess.run(command, capture_output=True, cwd="/", timeout=60).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        found = False
    if not found:
        said = clipped(python)
        raise InputError(f"--against {said}: is no Python that has taichi-cloth installed")


def _piece(options: BenchOptions, chosen: Sequence[str]) -> Piece:
    """The piece that is measured of the part that has a journal; raises InputError for others."""
    for name in ("scenes", "within", "resume"):
        if name in options.given and list(chosen) != [PIECEWISE]:
            raise InputError(f"{flag(name)}: only the part {PIECEWISE} takes it, alone")
    scenes = [name.strip() for name in (options.scenes or "").split(",") if name.strip()]
    if options.scenes is not None:
        there = problems.all_problems(options.quick)
        if not scenes:
            known = ", ".join(problem.key for problem in there)
            raise InputError(f"--scenes: names nothing; known: {known}")
        problems.chosen(there, scenes)
    return Piece(scenes, clock(options.within), options.resume)


def _show(part: str, rows: list[report.Measurement], to: Console) -> list[report.Measurement]:
    """Print a part's tables; return the rows of what it left out."""
    measured = [row for row in rows if row.is_measured]
    to.print()
    report.show(f"{part}: {summary(part)}", measured, to)
    return [row for row in rows if not row.is_measured]


def _show_left_out(rows: list[report.Measurement], to: Console) -> None:
    if rows:
        to.print("\nLeft out:")
    for row in rows:
        where = ", ".join(filter(None, (row.part, row.contestant, row.size)))
        console.say(to, f"- {where}: {row.note.removeprefix('left out: ')}", hang=2)


def _keep_unfinished(
    path: Path,
    description: dict[str, str],
    part: str,
    rows: list[report.Measurement],
    to: Console,
) -> None:
    """Show what an interrupted part has measured; keep it, but in place of a finished one."""
    rows.append(report.Measurement(part, "all that was to follow", note=INTERRUPTED))
    _show_left_out(_show(part, rows, to), to)
    before = report.read(path)[1] if path.exists() else []
    notes = [row.note for row in before if row.part == part]
    if notes and INTERRUPTED not in notes:
        console.say(to, f"\nnot written: {path} has rows of a run of {part} that was finished")
    else:
        report.replace_part(path, description, part, rows)
        console.say(to, f"\nwritten: {path}")


def _measure(
    part: str,
    rounds: int,
    options: BenchOptions,
    piece: Piece,
    to: Console,
    rows: list[report.Measurement],
) -> dict[str, bool]:
    """Add all rows of a part to `rows`, what it left out at the end, also where it is interrupted;
    return of which scenes they are, if it has pieces.
    """
    module = importlib.import_module(module_of(part))
    with console.progress(("spinner", "text", "bar", "elapsed"), on=to) as show:

        def tell(text: str, done: int, total: int) -> None:
            show(f"{part}: {text}", done, total)

        show(part, 0, 1)
        to_folder = Path(options.output)
        bench = Bench(rounds, options.quick, options.arch, tell, to_folder, piece, options.against)
        try:
            for row in module.measure(bench):
                rows.append(row)
            return bench.scenes
        finally:
            rows += bench.left_out
            bench.close()


def fill_document(path: Path, folder: Path, say: Callable[[str], None]) -> None:
    """Make a document's tables, and the plots beside it, anew from the results in `folder`."""
    text = console.document(path, report.MARKED)
    new = report.fill(text, folder, machine.file_name())
    if new != text:
        write_whole(path, new.encode())
    say(f"tables filled: {path}")
    images = path.parent / "images"
    if images.is_dir():
        for part, name in report.used(text):
            for plot, file in PLOTS.get(part, {}).items():
                if plot(folder, name or machine.file_name(), images / file):
                    say(f"plotted: {images / file}")


def _plot_contacts(folder: Path, name: str, path: Path) -> bool:
    rows = [row for row in report.read(folder / f"{name}.csv")[1] if row.part == "contacts"]
    contacts.plot(rows, path)
    return True


def _plot_accuracy(folder: Path, name: str, path: Path) -> bool:
    """True if the search was made on that machine, and so could be plotted."""
    search = folder / f"{name}{runs_file.SUFFIX}"
    if search.exists():
        write_whole(path, picture.draw(runs_file.read(search)))
    return search.exists()


# What is plotted beside a document that has a part's table: from the folder of results and the
# name of a machine to a file; whether there was anything to plot.
PLOTS = {
    "contacts": {_plot_contacts: "contacts.png"},
    "accuracy": {_plot_accuracy: "equal-error.png"},
}
