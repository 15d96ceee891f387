"""The architecture, read from the source: who may import whom, and what start-up may load."""

import ast
import functools
import re
import subprocess
import sys
from pathlib import Path

import pytest

import taichi_cloth

ROOT = Path(taichi_cloth.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))


TESTS = Path(__file__).parent
# Of what the lowest versions that pyproject.toml allows lack, or do otherwise, what was used once.
TOO_NEW = {
    "gc.get_referrers": "in Python 3.10 an object's dictionary refers to its attributes, not it",
    "typing.get_type_hints": "that of Python 3.10 makes an Optional of what defaults to None",
    "np.trapezoid": "NumPy 2.0; SciPy has it in `integrate`",
    "scipy.sparse.diags_array": "SciPy 1.11; `diags` does",
}


@functools.cache
def imports(path):
    """(module, whether at the file's top level) for everything a file imports."""
    tree = ast.parse(path.read_text())
    top = {id(node) for node in tree.body}
    found = []
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module] + [f"{node.module}.{alias.name}" for alias in node.names]
        found += [(name, id(node) in top) for name in names]
    return found


# Which rooms (folders and files of the package's top level) a room may import, beside the GROUND.
# The order is that of the floors: nothing on the right stands further up.
BASE = {"files", "kernels", "scene", "settings"}
GROUND = {"errors", "signals", "version"}
ROOMS = {
    "errors": set(),
    "signals": set(),
    "version": set(),
    "declarations": set(),
    "imports": set(),
    "front_end": {"imports"},
    "kernels": {"declarations", "front_end"},  # device code: knows no scene, file or window
    "files": set(),
    "measuring": set(),
    "settings": {"kernels"},
    "console": {"files"},
    "vulkan": set(),
    "runtime": {"front_end", "settings", "vulkan"},
    "scene": {"files", "kernels", "settings"},
    "sweeps": {"files", "measuring", "scene", "settings"},
    "limits": {"kernels", "scene"},
    "simulation": {*BASE, "limits", "runtime"},
    "render": {"kernels", "runtime", "settings"},
    "ui": {*BASE, "console", "declarations", "render", "runtime", "simulation", "vulkan"}
    - {"kernels"},
    "explain": {*BASE, "console", "measuring", "runtime", "simulation", "sweeps"},
    "stability": {*BASE, "console", "limits", "runtime", "simulation", "sweeps"},
    "trade": {*BASE, "console", "limits", "measuring", "runtime", "simulation"} | {"sweeps"},
    "comparison": {"console", "files", "scene", "settings", "trade"},
    "beside": {"comparison", "kernels", "scene", "settings", "simulation", "trade"},
    "error_meter": {"console", "measuring", "runtime", "scene", "simulation", "trade"},
    "advice": {*BASE, "console", "error_meter", "measuring", "runtime", "sweeps", "trade"},
    "budgets": {"console", "error_meter", "kernels", "limits", "runtime", "settings", "simulation"},
    "post_mortem": {"files", "kernels", "limits", "runtime", "scene", "settings", "simulation"},
    "cli": {*BASE, "beside", "budgets", "comparison", "console", "error_meter"}
    | {"imports"}
    | {"limits", "measuring", "post_mortem", "render", "runtime", "simulation", "ui", "vulkan"},
    "__main__": {"cli"},
}


def room_of(path):
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def rooms_imported(path):
    """The rooms that a file imports, also inside functions, and whether at its top level."""
    for name, at_top in imports(path):
        parts = name.split(".")
        if parts[0] == "taichi_cloth" and len(parts) > 1 and parts[1] in ROOMS:
            yield parts[1], at_top


def test_rooms_import_only_what_they_may():
    """Every room's boundary; what a room may import and does not is taken from the table."""
    found = {room: set() for room in ROOMS}
    for path in FILES:
        if path.name != "__init__.py" or path.parent != ROOT:
            found[room_of(path)] |= {room for room, _ in rooms_imported(path)}
    for room, allowed in ROOMS.items():
        assert found[room] - {room, *GROUND} == allowed, room
    order = list(ROOMS)
    upwards = [(a, b) for a in ROOMS for b in ROOMS[a] if order.index(b) >= order.index(a)]
    assert not upwards


def test_nobody_inside_imports_the_public_names():
    """The package's `__init__` stands above all rooms: it says where public names are at home."""
    named = [
        f"{path.name}: {name}"
        for path in FILES
        for name, _ in imports(path)
        if re.fullmatch(r"taichi_cloth\.\w+", name) and name.split(".")[1] not in ROOMS
    ]
    assert not named


def module_of(path):
    """The dotted name by which a file is imported; a package's is that of its `__init__`."""
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def circles(needs):
    """The files that are on circles, or between two: neither the first nor the last of a way."""
    while True:
        used = set().union(*needs.values())
        left = {name for name, of in needs.items() if of & needs.keys() and name in used}
        if len(left) == len(needs):
            return sorted(left)
        needs = {name: needs[name] & left for name in left}


def test_no_files_import_each_other_in_a_circle():
    """Those inside functions and under TYPE_CHECKING count too: a reader has to follow them."""
    modules = {module_of(path) for path in FILES}
    needs = {
        module_of(path): {name for name, _ in imports(path)} & modules - {module_of(path)}
        for path in FILES
    }
    assert not circles(needs)
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set()}) == ["b", "c"]


def test_the_ui_is_imported_by_the_command_line_alone_and_late():
    users = {
        (room_of(path), at_top)
        for path in FILES
        for room, at_top in rooms_imported(path)
        if room == "ui" and room_of(path) != "ui" and "TYPE_CHECKING" not in path.read_text()
    }
    assert users <= {("cli", False)}


def test_a_simulation_reaches_what_draws_it_by_the_package_alone():
    """Nothing below the ui names it in a string either; `__init__` does, as its public names."""
    below = [path for path in FILES if room_of(path) not in ("ui", "cli", "__init__")]
    named = [
        path.name for path in below if re.search(r"""["'](taichi_cloth\.)?ui\.""", path.read_text())
    ]
    assert not named


def test_a_wheel_has_every_package():
    listed = re.findall(
        r'^  "(taichi_cloth[.\w]*)",$', (ROOT.parent / "pyproject.toml").read_text(), re.M
    )
    there = [".".join(path.parent.relative_to(ROOT.parent).parts) for path in FILES]
    assert sorted(listed) == sorted(set(there))


def test_what_the_lowest_versions_lack_is_not_used():
    used = []
    for path in [*FILES, *TESTS.glob("*.py"), *TESTS.parent.glob("docs/**/*.py")]:
        names = {name for name, _ in imports(path)}
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                names.add(f"{node.value.id}.{node.attr}")
        used += [f"{path.name}: {name}: {TOO_NEW[name]}" for name in names & set(TOO_NEW)]
    assert not used


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


def test_docstrings_name_the_thing():
    """They begin with it, or with a verb; 3 begin otherwise."""
    first = {"What", "Who", "How", "Whether", "Where"}
    kinds = ast.FunctionDef, ast.ClassDef, ast.Module
    said = [
        ast.get_docstring(node) or "."
        for path in FILES
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, kinds)
    ]
    assert len(said) > 3000 and sum(text.split()[0] in first for text in said) <= 5


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
