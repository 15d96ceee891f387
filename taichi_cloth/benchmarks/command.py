"""The command ``taichi-cloth bench``: runs parts, keeps their results, fills documents."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from taichi_cloth.benchmarks import PARTS, contacts, report, summary
from taichi_cloth.benchmarks.contest import Bench
from taichi_cloth.errors import InputError
from taichi_cloth.files.pending import PendingFile
from taichi_cloth.measuring import machine
from taichi_cloth.settings.options import BenchOptions

QUICK_ROUNDS = 3


def main(parts: Sequence[str], options: BenchOptions) -> int:
    """Measure parts (all, if none is named and no document is to be filled); the exit status.

    A part that is finished stays in the file of results, whatever becomes of the next.
    """
    from rich.console import Console

    # A pipe or a file has no width: give whole lines a place where they fit.
    console = Console() if sys.stdout.isatty() else Console(width=170)
    folder = Path(options.output)
    path = folder / f"{machine.file_name()}.csv"
    document = _document(options.tables) if options.tables else None
    chosen = [part for part in PARTS if part in parts] or ([] if document else list(PARTS))
    if options.arch and "gpu" not in chosen:
        raise InputError("--arch: only the part gpu takes it")
    if chosen:
        _prepare(folder, path)
        description = machine.describe()
        console.print(
            *(f"{name}: {value}" for name, value in description.items()), sep="\n", highlight=False
        )
        rounds = options.rounds or (QUICK_ROUNDS if options.quick else 7)
        left_out = []
        for part in chosen:
            rows = _measure(part, rounds, options, console)
            report.replace_part(path, description, part, rows)
            timed = [row for row in rows if row.seconds is not None or row.is_ratio]
            gaps = [row for row in rows if row not in timed]
            console.print()
            report.show(f"{part}: {summary(part)}", timed, console)
            left_out += gaps
        if left_out:
            console.print("\nLeft out:")
            for row in left_out:
                where = ", ".join(filter(None, (row.part, row.contestant, row.size)))
                text = f"- {where}: {row.note.removeprefix('left out: ')}"
                console.print(text, highlight=False, markup=False)
        console.print(f"\nwritten: {path}", highlight=False, markup=False)
    if document:
        fill_document(document, folder, console.print)
    return 0


def _document(name: str) -> Path:
    if not os.path.isfile(name):
        raise InputError(f"--tables {name}: there is no such file")
    return Path(name)


def _prepare(folder: Path, path: Path) -> None:
    """See before a long run that results can be written, and joined to those there are."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--output {folder}: cannot be made: {error.strerror}") from None
    PendingFile(path).discard()
    if path.exists():
        report.read(path)


def _measure(part: str, rounds: int, options: BenchOptions, console) -> list[report.Row]:
    """All rows of a part, what it left out at the end."""
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
    module = importlib.import_module(f"taichi_cloth.benchmarks.{part}")
    with Progress(
        *columns,
        console=console,
        transient=True,
        refresh_per_second=2,  # what is measured needs the processor
        disable=not console.is_terminal,
    ) as progress:
        task = progress.add_task(part)

        def tell(text: str, done: int, total: int) -> None:
            progress.update(task, description=f"{part}: {text}", completed=done, total=total)

        bench = Bench(rounds, options.quick, options.arch, tell)
        try:
            return [*module.measure(bench), *bench.left_out]
        finally:
            bench.close()


def fill_document(path: Path, folder: Path, say: Callable[[str], None]) -> None:
    """Make a document's tables, and the plot beside it, anew from the results in `folder`."""
    text = path.read_text("utf-8")
    new = report.fill(text, folder, machine.file_name())
    if new != text:
        PendingFile(path).fill(lambda file: file.write(new.encode()))
    say(f"tables filled: {path}")
    images = path.parent / "images"
    plotted = [name for part, name in report.used(text) if part == "contacts"]
    if plotted and images.is_dir():
        rows = report.read(folder / f"{plotted[0] or machine.file_name()}.csv")[1]
        rows = [row for row in rows if row.part == "contacts"]
        try:
            contacts.plot(rows, images / "contacts.png")
        except ImportError:
            say('left out: the plot; pip install "taichi-cloth[bench]" (or matplotlib)')
        else:
            say(f"plotted: {images / 'contacts.png'}")
