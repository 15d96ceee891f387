"""Results as rows: shown as tables, kept as CSV, and turned into the documents' tables."""

from __future__ import annotations

import csv
import datetime
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

from taichi_cloth.benchmarks import PARTS
from taichi_cloth.errors import InputError
from taichi_cloth.files.pending import PendingFile


@dataclass
class Row:
    """One result: a timed setting, the ratio of two (`target` says what it should be), or a gap.

    size: columns x rows, or a count. seconds, lower, upper: median and quartiles of a step's
    time. rate: in `unit`. error: largest distance of a particle from what `against` names.
    rounds: how many were counted. note: what was left out and why, or what to know about it.
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
        """Whether it compares others, instead of being timed itself."""
        return self.seconds is None and self.rate is not None

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without one."""
        if not self.target:
            return None
        sign, _, limit = self.target.partition(" ")
        return self.rate >= float(limit) if sign == ">=" else self.rate <= float(limit)


NAMES = tuple(f.name for f in fields(Row))
NUMBERS = ("seconds", "lower", "upper", "rate", "error")
COUNTS = ("threads", "rounds")


# ------------------------------------------------------------------------------------------
# Files


def write(path: Path, machine: Mapping[str, str], rows: Iterable[Row]) -> None:
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
    PendingFile(path).fill(lambda file: file.write(text.getvalue().encode()))


def read(path: Path) -> tuple[dict[str, str], list[Row]]:
    """The machine's description and the rows of a file; raises InputError."""
    try:
        lines = path.read_text("utf-8").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    machine = dict(line[2:].split(": ", 1) for line in lines if line.startswith("# "))
    table = csv.DictReader(line for line in lines if not line.startswith("# "))
    if tuple(table.fieldnames or ()) != NAMES:
        raise InputError(f"{path}: is no file of results of this version; remove it")
    rows = []
    for record in table:
        for name in (*NUMBERS, *COUNTS):
            kind = float if name in NUMBERS else int
            record[name] = kind(record[name]) if record[name] else None
        rows.append(Row(**record))
    return machine, rows


def replace_part(path: Path, machine: Mapping[str, str], part: str, rows: Sequence[Row]) -> None:
    """Put a part's rows into a file, in place of those it had; the other parts' stay."""
    kept = [row for row in read(path)[1] if row.part != part] if path.exists() else []
    write(path, machine, sorted([*kept, *rows], key=lambda row: PARTS.index(row.part)))


# ------------------------------------------------------------------------------------------
# Tables

MACHINE = "machine"  # the marker of the machine's description
MARKED = re.compile(r"(<!-- bench:(\w+)(?: ([\w.-]+))? -->\n).*?(<!-- end -->)", re.S)


def tables(rows: Sequence[Row]) -> list[tuple[list[str], list[list[str]]]]:
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
            "time a step": [_time(row.seconds) for row in timed],
            "quartiles": [f"{_time(row.lower)} .. {_time(row.upper)}" for row in timed],
            **_rates(timed),
            "error": ["" if row.error is None else f"{row.error:.1e}" for row in timed],
        }
        columns = {name: texts for name, texts in columns.items() if any(texts)}
        shown.append((list(columns), [list(line) for line in zip(*columns.values(), strict=True)]))
    if ratios:
        lines = [
            [row.contestant, row.size, f"{_plain(row.rate)} {row.unit}".strip(), _wanted(row)]
            for row in ratios
        ]
        shown.append((["compared", "size", "measured", "target"], lines))
    return shown


def notes(rows: Sequence[Row]) -> list[str]:
    """What errors are measured against, what to know, what was left out, when and with what."""
    said = {f"error: distance from {row.against}": [] for row in rows if row.against}
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


def _rates(rows: Sequence[Row]) -> dict[str, list[str]]:
    """Columns of the rates: one for each unit."""
    units = dict.fromkeys(row.unit for row in rows if row.unit)
    return {
        f"M {unit}" if unit == "particle-steps/s" else unit: [
            "" if row.unit != unit else _plain(row.rate / (1e6 if unit[:2] == "pa" else 1))
            for row in rows
        ]
        for unit in units
    }


def _plain(number: float) -> str:
    """Three digits, without an exponent where that is readable."""
    if number >= 100:
        return f"{number:.0f}"
    return f"{number:.3g}"


def _time(seconds: float) -> str:
    for unit, scale in (("s", 1.0), ("ms", 1e3), ("µs", 1e6)):
        if seconds * scale >= 1:
            return f"{_plain(seconds * scale)} {unit}"
    return f"{_plain(seconds * 1e9)} ns"


def _wanted(row: Row) -> str:
    if not row.target:
        return ""
    sign = row.target.replace(">=", "at least").replace("<=", "at most")
    return sign if row.met else f"{sign}: missed"


def show(title: str, rows: Sequence[Row], console) -> None:
    """Print a part's tables and notes."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    for headers, lines in tables(rows):
        table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
        title = None
        for header in headers:
            left = header in ("contestant", "compared", "path", "target")
            table.add_column(header, justify="left" if left else "right")
        for line in lines:
            table.add_row(*map(escape, line))
        console.print(table)
    for note in notes(rows):
        console.print(escape(note), highlight=False)


def markdown(rows: Sequence[Row]) -> str:
    """The same for a document."""
    text = []
    for headers, lines in tables(rows):
        text.append("\n".join("| " + " | ".join(line) + " |" for line in _ruled(headers, lines)))
    said = notes(rows)
    if said:
        text.append("\n".join(f"- {note}" for note in said))
    return "\n\n".join(text)


def _ruled(headers: list[str], lines: list[list[str]]) -> list[list[str]]:
    return [headers, ["---"] * len(headers), *lines]


def used(text: str) -> list[tuple[str, str | None]]:
    """(part, name of the file of results or None for the own) of the markers in a document."""
    return [(match[2], match[3]) for match in MARKED.finditer(text)]


def fill(text: str, folder: Path, own: str) -> str:
    """`text` with what stands between its markers made anew from the results in `folder`.

    A marker is ``<!-- bench:PART -->`` or, for another machine than `own`,
    ``<!-- bench:PART NAME -->``, and ends at ``<!-- end -->``; the part `machine` is its
    description.
    """

    def filled(match: re.Match) -> str:
        opening, part, name, closing = match.groups()
        machine, rows = read(folder / f"{name or own}.csv")
        if part == MACHINE:
            body = "\n".join(f"- {key}: {value}" for key, value in machine.items())
        else:
            rows = [row for row in rows if row.part == part]
            body = markdown(rows) or f"Not measured yet: `taichi-cloth bench {part}` fills this."
        return f"{opening}{body}\n{closing}"

    return MARKED.sub(filled, text)
