"""The architecture, read from the source: who may import whom, and what start-up may load."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import taichi_cloth

ROOT = Path(taichi_cloth.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))


def imports(path):
    """(module, whether at the file's top level) for everything a file imports."""
    tree = ast.parse(path.read_text())
    top = {id(node) for node in tree.body}
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module] + [f"{node.module}.{alias.name}" for alias in node.names]
        for name in names:
            yield name, id(node) in top


def layer(path):
    """0 for kernels, 2 for ui, 1 for what lies between."""
    part = path.relative_to(ROOT).parts[0]
    return {"kernels": 0, "ui": 2}.get(part, 1)


def of_layer(name):
    if name.startswith("taichi_cloth.kernels"):
        return 0
    if name.startswith("taichi_cloth.ui"):
        return 2
    return 1 if name.startswith("taichi_cloth") else -1


def test_imports_point_downwards():
    """ui -> core -> kernels -> taichi; only commands reach up, inside the function in need."""
    upwards = [
        (str(path.relative_to(ROOT)), name)
        for path in FILES
        for name, at_top in imports(path)
        if of_layer(name) > layer(path) and not (path.parent.name == "cli" and not at_top)
    ]
    assert not upwards


def test_only_the_runtime_starts_taichi():
    callers = [
        path.name
        for path in FILES
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr == "init"
        and getattr(node.func.value, "id", "") in ("ti", "taichi")
    ]
    assert callers == ["runtime.py"]


def test_kernel_files_keep_their_annotations():
    """Taichi reads them as values; `from __future__ import annotations` would make them text."""
    deferred = [
        p for p in (ROOT / "kernels").rglob("*.py") if "import annotations" in p.read_text()
    ]
    assert not deferred


def test_each_file_says_what_it_is_for():
    silent = [str(path) for path in FILES if not ast.get_docstring(ast.parse(path.read_text()))]
    assert not silent


@pytest.mark.parametrize(
    "arguments", [["-c", "import taichi_cloth"], ["-m", "taichi_cloth", "--help"]]
)
def test_start_up_leaves_taichi_alone(arguments):
    done = subprocess.run(
        [sys.executable, "-X", "importtime", *arguments], capture_output=True, text=True, check=True
    )
    loaded = {line.split("|")[-1].strip() for line in done.stderr.splitlines()}
    assert "taichi_cloth" in loaded and "taichi" not in loaded
