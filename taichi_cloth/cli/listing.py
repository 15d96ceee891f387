"""``taichi-cloth list``: the scenes, the methods, and the backends usable here."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from taichi_cloth import runtime
from taichi_cloth.kernels import methods
from taichi_cloth.scene import library
from taichi_cloth.settings.options import flag


def main() -> int:
    """Print the tables; return the exit status."""
    # A pipe or a file has no width: give whole sentences a line where they fit.
    console = Console() if sys.stdout.isatty() else Console(width=160)

    scenes = _table("scene", "what it shows", "parameters")
    for name in library.names():
        parameters = (f"{flag(k)} {p.default}" for k, p in library.parameters(name).items())
        scenes.add_row(name, library.description(name), "\n".join(parameters))
    console.print(scenes)

    listed = _table("method", "what it is")
    for name in methods.METHODS:
        listed.add_row(name, _first_line(Path(methods.__path__[0], f"{name}.py")))
    console.print(listed)

    backends = _table("backend", "usable here")
    for name, lack in runtime.usable_backends().items():
        backends.add_row(name, "yes" if lack is None else f"no: needs {lack}")
    console.print(backends)
    return 0


def _table(*headers: str) -> Table:
    return Table(*headers, box=box.SIMPLE_HEAD, header_style="bold", pad_edge=False)


def _first_line(path: Path) -> str:
    """The first line of a source file's docstring, read without running the file."""
    docstring = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
    return docstring.partition("\n")[0]
