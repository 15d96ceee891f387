"""Measurements as rows: shown as tables, kept as CSV, and turned into the documents' tables."""

from __future__ import annotations

import csv
import datetime
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench import PARTS
from taichi_cloth import console
from taichi_cloth.console import duration, percent, three_digits
from taichi_cloth.errors import InputError, clipped
from taichi_cloth.files import content
from taichi_cloth.files.pending import write_whole

if TYPE_CHECKING:
    from rich.console import Console


@dataclass
class Measurement:
    """One result: a timed setting, the ratio of two (`target` says what it should be), or a gap.

    size: columns x rows, a count, or a scene. seconds, lower, upper: median and quartiles of a
    step's time, or of what `EACH` says. rate: in `unit`. error: largest distance of a particle from
    what `against` names, or as that says. rounds: how many were counted. note: what was left
    out and why, or what to know about it.
    """

    part: str
    contestant: str
    size: str = ""
    precision: str = ""
    threads: int | None = None
    execution: str = ""
    topology: str = ""
    seconds: float | None = None
    lower: float | None = None
    upper: float | None = None
    rate: float | None = None
    unit: str = ""
    target: str = ""
    error: float | None = None
    against: str = ""
    rounds: int | None = None
    note: str = ""
    date: str = field(default_factory=lambda: datetime.date.today().isoformat())
    versions: str = ""

    @property
    def is_ratio(self) -> bool:
        """True if it compares others, instead of being timed itself."""
        return self.seconds is None and self.rate is not None

    @property
    def is_measured(self) -> bool:
        """True if it is a result, and not a gap."""
        return self.seconds is not None or self.is_ratio

    @property
    def met(self) -> bool | None:
        """True if the target is met; None without one."""
        if not self.target or self.rate is None:
            return None
        sign, _, limit = self.target.partition(" ")
        return self.rate >= float(limit) if sign == ">=" else self.rate <= float(limit)


NAMES = tuple(f.name for f in fields(Measurement))
NUMBERS = ("seconds", "lower", "upper", "rate", "error")
COUNTS = ("threads", "rounds")


# ------------------------------------------------------------------------------------------
# Files


def write(path: Path, machine: Mapping[str, str], rows: Iterable[Measurement]) -> None:
    """Write rows, after the machine's description as comment lines. Raises InputError."""
    text = io.StringIO()
    for name, value in machine.items():
        text.write(f"# {name}: {value}\n")
    table = csv.writer(text, lineterminator="\n")
    table.writerow(NAMES)
    for row in rows:
        values = ((name, getattr(row, name)) for name in NAMES)
        table.writerow(
            "" if value is None else f"{value:.4g}" if name in NUMBERS else value
            for name, value in values
        )
    write_whole(path, text.getvalue().encode())


def read(path: Path) -> tuple[dict[str, str], list[Measurement]]:
    """The machine's description and the rows of a file; raises InputError."""
    kinds = dict.fromkeys(NUMBERS, float) | dict.fromkeys(COUNTS, int)
    comments, records = read_table(path, NAMES, kinds, "file of results")
    machine = dict(line[2:].split(": ", 1) for line in comments if ": " in line[2:])
    rows = [Measurement(**record) for record in records]
    unknown = next((row.part for row in rows if row.part not in PARTS), None)
    if unknown is not None:
        raise InputError(f"{path}: has a part '{clipped(unknown)}', which there is not; remove it")
    return machine, rows


def read_table(
    path: Path, names: Sequence[str], kinds: Mapping[str, Callable[[str], Any]], what: str
) -> tuple[list[str], list[dict[str, Any]]]:
    """The comment lines of a file, and its rows, whose columns have these names.

    kinds: of columns that are no texts; empty ones are None. what: it should be. Raises InputError
    where it cannot be read, or a row is not whole.
    """
    lines = content.text(path, what, remedy="remove it").splitlines()
    comments = [line for line in lines if line.startswith("# ")]
    header, *rest = [line for line in lines if not line.startswith("# ")] or [""]
    if header.split(",") != list(names):
        raise InputError(f"{path}: is no {what} of this version; remove it")
    table, records = csv.reader(rest), []
    try:
        for texts in filter(None, table):
            record: dict[str, Any] = dict(zip(names, texts, strict=True))
            for name, kind in kinds.items():
                record[name] = kind(record[name]) if record[name] else None
            records.append(record)
    except (csv.Error, ValueError):
        number = len(comments) + 1 + table.line_num
        raise InputError(
            f"{path} line {number}: is cut short, or is no row; mend it, or remove the file"
        ) from None
    return comments, records


def replace_part(
    path: Path,
    machine: Mapping[str, str],
    part: str,
    rows: Sequence[Measurement],
    scenes: Mapping[str, bool] | None = None,
) -> None:
    """Put a part's rows into a file, in place of those it had; the other parts' stay.

    scenes: of a part of `BY_LEVEL`, all in their order, and whether rows are theirs; those of the
    others stay, too.
    """
    names = list(scenes or {})
    staying = [name for name, measured in (scenes or {}).items() if not measured]
    before = read(path)[1] if path.exists() else []
    new = {(row.contestant, row.size) for row in rows}
    kept = [
        row
        for row in before
        if row.part != part or (_scene_of(row) in staying and (row.contestant, row.size) not in new)
    ]

    def place(row: Measurement) -> tuple[int, int]:
        scene = _scene_of(row) if row.part == part else ""
        return PARTS.index(row.part), names.index(scene) if scene in names else len(names)

    write(path, machine, sorted([*kept, *rows], key=place))


def _scene_of(row: Measurement) -> str:
    """Of a row of `BY_LEVEL`."""
    return row.size.partition(": ")[0]


# ------------------------------------------------------------------------------------------
# Tables

MACHINE = "machine"  # the marker of the machine's description
MARKED = "bench"  # what marks a document's places
# What a part's times are of, where that is no step.
EACH = {"accuracy": "frame", "windows": "frame"}
# Parts whose sizes are "SCENE: LEVEL" and contestants "WHO: SETTING": in documents a row for each
# who on each scene, and a column for each level.
BY_LEVEL = ("accuracy",)
UNMET = "not met"


def tables(rows: Sequence[Measurement]) -> list[tuple[list[str], list[list[str]]]]:
    """(headers, lines) of the tables that show rows: timed settings, then ratios."""
    timed = [row for row in rows if row.seconds is not None]
    ratios = [row for row in rows if row.is_ratio]
    shown = []
    if timed:
        columns = {
            "contestant": [row.contestant for row in timed],
            "size": [row.size for row in timed],
            "numbers": [row.precision for row in timed],
            "threads": [str(row.threads or "") for row in timed],
            "path": [", ".join(filter(None, (row.topology, row.execution))) for row in timed],
            f"time a {EACH.get(timed[0].part, 'step')}": [duration(row.seconds) for row in timed],
            "quartiles": [f"{duration(row.lower)} .. {duration(row.upper)}" for row in timed],
            **_rates(timed),
            "error": ["" if row.error is None else f"{row.error:.1e}" for row in timed],
        }
        columns = {name: texts for name, texts in columns.items() if any(texts)}
        shown.append((list(columns), [list(line) for line in zip(*columns.values(), strict=True)]))
    if ratios:
        lines = [
            [row.contestant, row.size, f"{three_digits(rate)} {row.unit}".strip(), _wanted(row)]
            for row in ratios
            if (rate := row.rate) is not None
        ]
        shown.append((["compared", "size", "measured", "target"], lines))
    return shown


def by_level(rows: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
    """(headers, lines) of rows of `BY_LEVEL`: what each needs for a level, beside its error."""
    cells: dict[tuple[str, str], dict[str, str]] = {}
    levels: dict[str, None] = {}
    for row in rows:
        scene, _, level = row.size.rpartition(": ")
        who, _, setting = row.contestant.partition(": ")
        levels[level] = None
        if row.is_ratio and row.rate is not None:
            says = f"{three_digits(row.rate)} {row.unit} ({setting}), {_wanted(row)}".rstrip(", ")
        else:
            says = f"{duration(row.seconds)}, error {percent(row.error, 2)}: {setting}"
        cells.setdefault((scene, who), {})[level] = says
    scenes = list(dict.fromkeys(scene for scene, _ in cells))
    compared = {row.contestant.partition(": ")[0] for row in rows if row.is_ratio}
    lines = [
        [scene, who, *(says.get(level, "" if who in compared else UNMET) for level in levels)]
        for (scene, who), says in sorted(cells.items(), key=lambda item: scenes.index(item[0][0]))
    ]
    return ["scene", "solver", *levels], lines


def notes(rows: Sequence[Measurement]) -> list[str]:
    """Notes: the reference of errors, what to know, what was left out, when and with what."""
    said: dict[str, list[str]] = {}
    for row in rows:
        if row.against:
            said.setdefault(f"error: distance from {row.against}", [])
    for row in rows:
        if row.note:
            where = ", ".join(filter(None, (row.contestant, row.size)))
            said.setdefault(row.note, []).append(where)
    for row in rows:
        if row.versions:
            said.setdefault(f"measured {row.date}", []).append(row.versions)
    return [_note(note, where) for note, where in said.items()]


def _note(note: str, where: list[str]) -> str:
    if note.startswith("measured "):
        packages = dict.fromkeys(name for versions in where for name in versions.split(", "))
        return f"{note} with {', '.join(packages)}"
    return f"{'; '.join(where)}: {note}" if where else note


def _rates(rows: Sequence[Measurement]) -> dict[str, list[str]]:
    """Columns of the rates: one for each unit."""
    units = dict.fromkeys(row.unit for row in rows if row.unit)
    return {
        f"M {unit}" if unit == "particle-steps/s" else unit: [
            "" if row.unit != unit or row.rate is None else three_digits(row.rate / _scale(unit))
            for row in rows
        ]
        for unit in units
    }


def _scale(unit: str) -> float:
    return 1e6 if unit == "particle-steps/s" else 1.0


def _wanted(row: Measurement) -> str:
    if not row.target:
        return ""
    sign = row.target.replace(">=", "at least").replace("<=", "at most")
    return sign if row.met else f"{sign}: missed"


# Columns that a narrow terminal goes without, the first ones first; the file has them all.
SPARED = ("quartiles", "path", "threads", "numbers")


def show(title: str, rows: Sequence[Measurement], to: Console) -> None:
    """Print a part's tables and notes."""
    left, left_out = ("contestant", "compared", "size", "path", "target"), []
    for number, (headers, lines) in enumerate(tables(rows)):
        shown = None if number else title
        left_out += console.print_table(to, shown, headers, lines, left, spared=SPARED)
    for note in notes(rows):
        console.say(to, note)
    if left_out:
        console.say(to, f"left out, for the terminal is narrow: {', '.join(left_out)}")


def markdown(rows: Sequence[Measurement]) -> str:
    """The tables and notes for a document."""
    shown = tables(rows)
    measured = [row for row in rows if row.is_measured]
    if measured and measured[0].part in BY_LEVEL:
        shown = [by_level(measured)]
    text = [console.markdown_table(headers, lines) for headers, lines in shown]
    said = notes(rows)
    if said:
        text.append("\n".join(f"- {note}" for note in said))
    return "\n\n".join(text)


def used(text: str) -> list[tuple[str, str | None]]:
    """(part, name of the file of results or None for the own) of the markers in a document."""
    return console.places(text, MARKED)


def fill(text: str, folder: Path, own: str) -> str:
    """A document with what stands between its markers made anew from the results in `folder`.

    A marker is ``<!-- bench:PART -->`` or, for another machine than `own`,
    ``<!-- bench:PART NAME -->``, and ends at ``<!-- end -->``; the part `machine` is its
    description.
    """

    def body(part: str, name: str | None) -> str:
        machine, rows = read(folder / f"{name or own}.csv")
        if part == MACHINE:
            return "\n".join(f"- {key}: {value}" for key, value in machine.items())
        text = markdown([row for row in rows if row.part == part])
        return text or f"Not measured yet: `taichi-cloth bench {part}` fills this."

    return console.filled(text, MARKED, body)
