"""The oldest and the newest Python that we say we run on, with the newest of all that is needed.

The oldest one also with the lowest versions that are promised. NumPy, SciPy and their types are of
other versions on each, and so are `typing` and `inspect`.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from selection import thorough

ROOT = Path(__file__).parent.parent
# Host code of every floor: scenes and files, all commands' words, how the code is laid out.
FILES = ("test_scenes", "test_reading", "test_structure", "test_tables")
SECONDS = 1500


def named():
    """The oldest and the newest version, as pyproject.toml has them: "3.10", "3.13"."""
    text = (ROOT / "pyproject.toml").read_text()
    oldest, beyond = re.search(r'requires-python = ">=3\.(\d+),<3\.(\d+)"', text).groups()
    return f"3.{oldest}", f"3.{int(beyond) - 1}"


def interpreter(version):
    """A Python of a version, on the path or among those of pyenv; None: this machine has none."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found = [shutil.which(f"python{version}"), *pyenv.glob(f"{version}.*/bin/python3")]
    asks = "import sys, venv; print('%d.%d' % sys.version_info[:2])"
    for path in filter(None, found):
        done = subprocess.run([path, "-c", asks], capture_output=True, text=True)
        if done.returncode == 0 and done.stdout.strip() == version:
            return str(path)
    return None


@thorough
@pytest.mark.parametrize("version", named())
def test_the_oldest_and_the_newest_python_serve(version, tmp_path):
    python = interpreter(version)
    if python is None:
        pytest.skip(f"needs Python {version}")
    copy = tmp_path / "copy"
    subprocess.run(["git", "clone", "-q", ROOT, copy], check=True)
    away = ("PYTHONPATH", "DISPLAY", "WAYLAND_DISPLAY", "PYTEST_ADDOPTS")
    env = {name: value for name, value in os.environ.items() if name not in away}
    env |= {"XDG_CACHE_HOME": str(tmp_path), "TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path / "ti")}

    def do(*words):
        words = [str(word) for word in words]
        done = subprocess.run(
            words, cwd=copy, env=env, capture_output=True, text=True, timeout=SECONDS
        )
        assert done.returncode == 0, f"{' '.join(words)}\n{done.stdout}{done.stderr}"

    do(python, "-m", "venv", ".venv")
    inside = copy / ".venv" / ("Scripts" if sys.platform == "win32" else "bin")
    do(inside / "pip", "install", "-q", "-e", ".[test]")
    do(inside / "mypy")
    if version == named()[0]:
        lowest = subprocess.run([python, copy / "tests" / "lowest.py"], stdout=subprocess.PIPE)
        (tmp_path / "lowest.txt").write_bytes(lowest.stdout)
        do(inside / "pip", "install", "-q", "-c", tmp_path / "lowest.txt", "-e", ".[test]")
    do(inside / "pytest", "-q", *(f"tests/{name}.py" for name in FILES))
    do(inside / "taichi-cloth", "run", "cloth", "--headless", "--frames", 30)
