"""``taichi-cloth list``: the scenes, the methods, and the backends usable here."""

from __future__ import annotations

import ast
from pathlib import Path

from taichi_cloth import console, runtime
from taichi_cloth.kernels import methods
from taichi_cloth.scene import library
from taichi_cloth.settings.options import flag


def main() -> int:
    """Print the tables; return the exit status."""
    to = console.output()
    scenes = []
    for name in library.names():
        parameters = (
            flag(k) if p.default is None else f"{flag(k)} {p.default}"
            for k, p in library.parameters(name).items()
        )
        scenes.append((name, library.description(name), "\n".join(parameters)))
    console.print_table(to, None, ("scene", "what it shows", "parameters"), scenes)

    files = ((name, Path(methods.__path__[0], f"{name}.py")) for name in methods.METHODS)
    listed = [(name, _first_line(path)) for name, path in files]
    console.print_table(to, None, ("method", "what it is"), listed)

    backends = [
        (name, "yes" if lack is None else f"no: needs {lack}")
        for name, lack in runtime.usable_backends().items()
    ]
    console.print_table(to, None, ("backend", "usable here"), backends)
    return 0


def _first_line(path: Path) -> str:
    """The first line of a source file's docstring, read without running the file."""
    docstring = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
    return docstring.partition("\n")[0]
