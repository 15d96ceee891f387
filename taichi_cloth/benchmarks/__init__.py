"""``taichi-cloth bench``: how fast, beside how wrong, here and beside other programs.

Each part is a module named in `PARTS`: its docstring's first line says what it measures, and
``measure(bench)`` yields rows of results. Contestants run in processes of their own and take turns
(`contest`); rows are shown, kept and turned into the documents' tables by `report`.
"""

from __future__ import annotations

import ast
from pathlib import Path

# In the order in which they run.
PARTS = (
    "warp",
    "structural",
    "meshes",
    "lanes",
    "seed",
    "newton",
    "scaling",
    "contacts",
    "draping",
    "windows",
    "gpu",
)


def summary(part: str) -> str:
    """What a part measures, in one line, read without running its module."""
    docstring = ast.get_docstring(ast.parse(Path(__path__[0], f"{part}.py").read_text("utf-8")))
    return (docstring or "").partition("\n")[0]
