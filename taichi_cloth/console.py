"""Text for terminals and documents: tables, progress, durations, marked places filled.

Rich is imported only where something is shown, so that start-up is quick.
"""

from __future__ import annotations

import contextlib
import re
import shutil
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from taichi_cloth.errors import InputError
from taichi_cloth.files import content

if TYPE_CHECKING:
    from rich.console import Console

# How progress is told: what is going on, how much is done, how much there is in all.
Tell = Callable[[str, int, int], None]
NARROWEST = 40  # columns of a terminal, below which lines are wider than it
SHORT_TEXT = 20  # columns below which a text is not wrapped while another column can be left out
# What of a text stays whole in any line: a word, or of a path and the like each part.
PIECE = re.compile(r"[^\s/,;|-]+[/,;|-]*|[/,;|-]+")
CONTINUED = " \\"  # a shell's sign that a command goes on in the next line


def tell_nobody(text: str, done: int, total: int) -> None:
    """Progress that is not shown."""


# ------------------------------------------------------------------------------------------
# The terminal


def output() -> Console:
    """The console of standard output, as wide as its terminal; pipes and files get 80 columns.

    The variable COLUMNS overrides both. Where its reader is gone, printing raises BrokenPipeError.
    """
    from rich.console import Console

    class Output(Console):
        def on_broken_pipe(self) -> None:
            raise  # Rich would end the program with status 1, as if something had gone wrong

    return Output(width=max(shutil.get_terminal_size().columns, NARROWEST))


def say(to: Console, text: str, *, hang: int = 0) -> None:
    """Print plain text in whole words; its lines but the first are indented by `hang`."""
    to.print(
        "\n".join(wrapped(text, to.width, hang=hang)), highlight=False, markup=False, soft_wrap=True
    )


def say_command(to: Console, command: str) -> None:
    """Print a command so that a shell takes what is printed, also where it needs several lines."""
    lines = wrapped(command.replace(" --", "\n--"), to.width - len(CONTINUED), whole=True)
    joined = [lines[0]]
    for line in lines[1:]:
        if len(joined[-1]) + 1 + len(line) + len(CONTINUED) <= to.width:
            joined[-1] += f" {line}"
        else:
            joined.append(f"  {line}")
    to.print(f"{CONTINUED}\n".join(joined), highlight=False, markup=False, soft_wrap=True)


def wrapped(text: str, width: int, *, hang: int = 0, whole: bool = False) -> list[str]:
    """The lines of a text, at most `width` long, in whole words.

    A word that is longer is cut at the end of a `PIECE`, else anywhere; with `whole`, it stays.
    hang: spaces before all lines but the first of each line of the text.
    """
    lines = []
    for paragraph in text.split("\n"):
        line = paragraph[: len(paragraph) - len(paragraph.lstrip())]
        indent, empty = " " * (len(line) + hang), True
        for word in paragraph.split():
            if not empty and len(line) + 1 + len(word) > width:
                lines.append(line)
                line, empty = indent, True
            line, empty = line + word if empty else f"{line} {word}", False
            while len(line) > width and not whole:
                ends = [match.end() for match in PIECE.finditer(line, len(indent))]
                cut = max((end for end in ends if end <= width), default=0)
                cut = cut or max(width, len(indent) + 1)
                lines.append(line[:cut])
                line = indent + line[cut:]
        lines.append(line)
    return lines


def print_table(
    to: Console,
    title: str | None,
    headers: Sequence[str],
    lines: Iterable[Sequence[str]],
    left: Collection[str] | None = None,
    *,
    spared: Sequence[str] = (),
    styles: Sequence[str | None] | None = None,
    show_header: bool = True,
) -> list[str]:
    """Print a table of plain texts, no wider than the console; numbers and words stay whole.

    left: headers of the columns of text, which are aligned to the left and may take several lines;
    None for all of them. Other columns are numbers. spared: headers of columns that are left out
    where there is no room, the first ones first. styles: of the lines, in rich's words.
    Where even that is too wide, each line becomes a paragraph. Returns the headers left out.
    """
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    cells = [list(line) for line in lines]
    columns = [
        _Column(header, [line[k] for line in cells], left is None or header in left, show_header)
        for k, header in enumerate(headers)
    ]
    left_out: list[str] = []
    for name in spared:
        if _width([column.narrow for column in columns]) <= to.width:
            break
        if name in headers:
            columns = [column for column in columns if column.header != name]
            left_out.append(name)
    widths = _fitting(columns, to.width)
    if _width(widths) > to.width:
        _print_paragraphs(to, title, columns, show_header)
        return left_out
    made = Table(
        title=escape(title) if title else None,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
        show_header=show_header,
    )
    for column, width in zip(columns, widths, strict=True):
        header = "\n".join(wrapped(column.header, width))
        made.add_column(header, justify="left" if column.text else "right", width=width)
    for k in range(len(cells)):
        texts = ["\n".join(wrapped(c.cells[k], w)) for c, w in zip(columns, widths, strict=True)]
        made.add_row(*map(escape, texts), style=styles[k] if styles else None)
    to.print(made)
    return left_out


def _print_paragraphs(
    to: Console, title: str | None, columns: Sequence[_Column], show_header: bool
) -> None:
    """Print the lines of a table as paragraphs: a name, then each cell after its header."""
    say(to, f"\n{title}" if title else "")
    named = next((k for k, column in enumerate(columns) if column.header), 0)
    for cells in zip(*(column.cells for column in columns), strict=True):
        name = " ".join(filter(None, cells[: named + 1]))
        others = [
            f"{column.header} {cell}" if show_header else cell
            for column, cell in zip(columns[named + 1 :], cells[named + 1 :], strict=True)
            if cell
        ]
        say(to, "\n" + "; ".join(" ".join(text.split()) for text in (name, *others)), hang=2)
    to.print()


@dataclass(frozen=True)
class _Column:
    """A column of a table: its header, its cells, whether these are text, which may be wrapped."""

    header: str
    cells: Sequence[str]
    text: bool
    show_header: bool

    @property
    def wide(self) -> int:
        """The width at which nothing is wrapped."""
        lines = [line for cell in self.cells for line in cell.split("\n")]
        return max(map(len, [self.header * self.show_header, *lines]))

    @property
    def least(self) -> int:
        """The width at which words, and numbers with their units, are still whole."""
        words = self.header.split() if self.show_header else []
        for cell in self.cells:
            words += PIECE.findall(cell) if self.text else cell.split("\n")
        return max(map(len, words), default=1)

    @property
    def narrow(self) -> int:
        """The width down to which it reads well."""
        return max(self.least, min(self.wide, SHORT_TEXT)) if self.text else self.least


def _width(widths: Sequence[int]) -> int:
    """The width of a table whose columns have these."""
    return sum(widths) + 2 * len(widths)


def _fitting(columns: Sequence[_Column], width: int) -> list[int]:
    """Widths of columns that make a table no wider than `width`; the widest give way first."""
    widths = [column.wide for column in columns]
    for least in [column.narrow for column in columns], [column.least for column in columns]:
        while _width(widths) > width:
            spare = [(w, k) for k, w in enumerate(widths) if w > least[k]]
            if not spare:
                break
            widths[max(spare)[1]] -= 1
    return widths


@contextlib.contextmanager
def progress(
    parts: Sequence[str], *, on: Console | None = None, shown: bool = True, lines: bool = False
) -> Iterator[Tell]:
    """A bar on a terminal, as long as the context lasts; its value is called with what is done.

    parts: what is shown beside each other: "spinner", "text", "bar", "count", "elapsed", "left"
    (the time that it still takes), or a word.
    on: the terminal's console, standard error by default.
    shown: False shows nothing at all.
    lines: whether, where there is no terminal, each tenth is told in a line on standard error.
    """
    if not shown:
        yield tell_nobody
    elif on.is_terminal if on else sys.stderr.isatty():
        yield from _bar(parts, on)
    else:
        yield _tenths() if lines else tell_nobody


def _bar(parts: Sequence[str], on: Console | None) -> Iterator[Tell]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    known: dict[str, Callable[[], ProgressColumn]] = {
        "spinner": SpinnerColumn,
        "text": lambda: TextColumn("{task.description}"),
        "bar": BarColumn,
        "count": MofNCompleteColumn,
        "elapsed": TimeElapsedColumn,
        "left": TimeRemainingColumn,
    }
    columns = [known[part]() if part in known else TextColumn(part) for part in parts]
    to = on or Console(stderr=True)
    # Rarely drawn: what is measured needs the processor.
    with Progress(*columns, console=to, transient=True, refresh_per_second=2) as bar:
        task = bar.add_task("", total=None)
        yield lambda text, done, total: bar.update(
            task, description=text, completed=done, total=total
        )


def _tenths() -> Tell:
    """Progress as a line on standard error for each tenth."""
    told = -1

    def tell(text: str, done: int, total: int) -> None:
        nonlocal told
        if 10 * done // total > told:
            told = 10 * done // total
            print(f"{done} of {total}: {text}", file=sys.stderr, flush=True)

    return tell


# ------------------------------------------------------------------------------------------
# Numbers in words


def duration(seconds: float | None, sign: bool = False) -> str:
    """A time [s] with the unit that suits it, three digits; nothing for None. sign: also a plus."""
    if seconds is None:
        return ""
    plus = "+" if sign and seconds >= 0 else ""
    for unit, scale in (("s", 1.0), ("ms", 1e3), ("µs", 1e6)):
        if abs(seconds) * scale >= 1:
            return f"{plus}{three_digits(seconds * scale)} {unit}"
    return f"{plus}{three_digits(seconds * 1e9)} ns"


def three_digits(number: float) -> str:
    """A number without an exponent where that is readable."""
    return f"{number:.0f}" if abs(number) >= 100 else f"{number:.3g}"


def percent(part: float | None, digits: int = 3) -> str:
    """A part as a percentage of so many digits; tiny ones with an exponent."""
    if part is None:
        return ""
    if part == 0:
        return "0 %"
    if part >= 1 or 100 * part >= 10**digits - 0.5:
        return f"{100 * part:.0f} %" if part < 1e4 else f"{100 * part:.0e} %"
    if part < 1e-5:
        return f"{100 * part:.{max(digits - 2, 0)}e} %"
    return f"{100 * part:.{digits}g} %"


# ------------------------------------------------------------------------------------------
# Documents


def markdown_table(headers: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A table for a document, without a newline at its end."""
    ruled = [headers, ["---"] * len(headers), *lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in ruled)


def places(text: str, name: str) -> list[tuple[str, str | None]]:
    """(key, word after it or None) of the places of a document that are marked for `name`.

    Such a place begins with ``<!-- name:key -->`` or ``<!-- name:key word -->`` on a line of its
    own, and ends at ``<!-- end -->``.
    """
    return [(match[2], match[3]) for match in _marked(name).finditer(text)]


def document(path: Path, name: str) -> str:
    """The text of the document that `--tables` names, which has `places` for `name`.

    Raises InputError where it is none.
    """
    text = content.text(path, "document", called=f"--tables {path}").replace("\r\n", "\n")
    if not places(text, name):
        raise InputError(f"--tables {path}: has no '<!-- {name}:... -->' to fill")
    return text


def filled(text: str, name: str, body: Callable[[str, str | None], str]) -> str:
    """A document with what stands in its `places` made anew.

    body: makes the text of a place, without a newline at its end, of its key and word.
    """

    def anew(match: re.Match[str]) -> str:
        opening, key, word, closing = match.groups()
        return f"{opening}{body(key, word)}\n{closing}"

    return _marked(name).sub(anew, text)


def _marked(name: str) -> re.Pattern[str]:
    return re.compile(rf"(<!-- {name}:(\w+)(?: ([\w.-]+))? -->\n).*?(<!-- end -->)", re.S)
