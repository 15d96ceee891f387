"""``python -m bench``: how fast, beside how wrong, here and beside other programs.

Each part is a module named in `PARTS` (or, by another name, in `MODULES`): its docstring's first
line says what it measures, and ``measure(bench)`` yields rows of results. Contestants run in
processes of their own and take turns (`contest`); rows are shown, kept and turned into the
documents' tables by `report`.
"""

from __future__ import annotations

import ast
import os
from pathlib import Path

# Processes that contestants run in find this folder, too.
_CHECKOUT, _PATHS = str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")
if _CHECKOUT not in _PATHS.split(os.pathsep):
    os.environ["PYTHONPATH"] = os.pathsep.join([*filter(None, [_PATHS]), _CHECKOUT])

# In the order in which they run.
PARTS = (
    "warp",
    "structural",
    "meshes",
    "lanes",
    "seed",
    "newton",
    "accuracy",
    "scaling",
    "contacts",
    "draping",
    "windows",
    "gpu",
)


# Parts whose module has another name: `bench.accuracy` makes the numbers of docs/accuracy.md.
MODULES = {"accuracy": "equal_error"}


def module_of(part: str) -> str:
    """The dotted name of a part's module."""
    return f"{__name__}.{MODULES.get(part, part)}"


def summary(part: str) -> str:
    """The subject of a part, in one line, read without running its module."""
    path = Path(__path__[0], MODULES.get(part, part))
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    docstring = ast.get_docstring(ast.parse(file.read_text("utf-8")))
    return (docstring or "").partition("\n")[0]
