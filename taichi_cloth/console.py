"""What a terminal and a document are shown: tables, progress, durations, marked places filled.

Rich is imported only where something is shown, so that start-up is quick.
"""

from __future__ import annotations

import contextlib
import re
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

# How progress is told: what is going on, how much is done, how much there is in all.
Tell = Callable[[str, int, int], None]


def tell_nobody(text: str, done: int, total: int) -> None:
    """Progress that is not shown."""


# ------------------------------------------------------------------------------------------
# The terminal


def output(width: int) -> Console:
    """The console of standard output. A pipe or a file has no width: there it is `width` columns
    wide, so that whole lines have a place where they fit.
    """
    from rich.console import Console

    return Console() if sys.stdout.isatty() else Console(width=width)


def table(
    title: str | None,
    headers: Iterable[str],
    left: Collection[str] | None = None,
    *,
    fold: bool = False,
    show_header: bool = True,
    padding: tuple[int, int, int, int] = (0, 1, 0, 1),
) -> Table:
    """An empty table in the style of all tables.

    left: headers of the columns that are aligned to the left, None for all of them.
    fold: whether texts too long for their column go on in the next line, instead of being cut.
    show_header: False leaves the line of headers out.
    padding: spaces around a cell, from the top clockwise.
    """
    from rich import box
    from rich.table import Table

    made = Table(
        title=title,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=padding,
        pad_edge=False,
        show_header=show_header,
    )
    for header in headers:
        made.add_column(
            header,
            justify="left" if left is None or header in left else "right",
            overflow="fold" if fold else "ellipsis",
        )
    return made


def print_table(
    to: Console,
    title: str | None,
    headers: Sequence[str],
    lines: Iterable[Sequence[str]],
    left: Collection[str] | None = None,
    *,
    fold: bool = False,
) -> None:
    """Print a table whose cells are plain text; the arguments are those of `table`."""
    from rich.markup import escape

    made = table(title, headers, left, fold=fold)
    for line in lines:
        made.add_row(*map(escape, line))
    to.print(made)


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
