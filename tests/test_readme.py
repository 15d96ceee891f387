"""The README is true: its commands run, its snippets work, its packages install."""

import importlib.metadata
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest
from inside import not_starting
from selection import thorough

from taichi_cloth.cli.main import main
from taichi_cloth.errors import InputError

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
FLAGS = (ROOT / "docs" / "command-line.md").read_text()  # goes on where README ends
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.M | re.S)
BLOCKS = BLOCK.findall(README + FLAGS)
PACKAGES = list((ROOT / "taichi_cloth").rglob("__init__.py"))
SET_UP = "python3 -m venv"  # the two commands that make an environment; see below, and .ci/run
TOUR = (ROOT / "docs" / "tour.md").read_text()  # `test_tour.py` runs its commands
SCENES = ("sheet.toml",)  # as what the scene files are to be saved


def blocks(language):
    return [text for kind, text in BLOCKS if kind == language]


def save_scenes(folder):
    """The README's scene files, by the names that it gives them."""
    for name, text in zip(SCENES, blocks("toml"), strict=True):
        assert f"`{name}`" in README
        (folder / name).write_text(text)


def command_lines():
    """The commands of both, in their order, but the two that make an environment."""
    lines = [line for text in blocks("sh") for line in text.splitlines() if SET_UP not in line]
    assert len(lines) >= 8 and all(line.startswith("taichi-cloth ") for line in lines)
    return lines


def environment(*folders):
    """No display, and the programs of this interpreter's environment (or of `folders`) first."""
    dropped = ("DISPLAY", "WAYLAND_DISPLAY", "PYTHONPATH")
    env = {k: v for k, v in os.environ.items() if k not in dropped}
    first = [str(f) for f in folders] or [str(Path(sys.executable).parent)]
    return {**env, "PATH": os.pathsep.join([*first, env["PATH"]])}


def shell(line, cwd, env, timeout=540):
    done = subprocess.run(
        ["bash", "-c", line], cwd=cwd, env=env, capture_output=True, text=True, timeout=timeout
    )
    assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr


def test_every_block_is_of_a_kind_that_is_tested():
    assert {kind for kind, _ in BLOCKS} == {"sh", "toml", "python"}
    assert (README + FLAGS).count("```") == 2 * len(BLOCKS)


def test_a_newcomer_reads_it_in_five_minutes():
    assert len(README.split()) <= 1200


@thorough
def test_commands_run_one_after_the_other(tmp_path):
    """In their order, in one folder, without a display; the scene files are the README's own.

    But those that are the tour's, too: two of them sweep for a minute each.
    """
    save_scenes(tmp_path)
    lines = command_lines()
    rest = [line for line in lines if " run " in line or f"\n{line}\n" not in TOUR]
    assert len(rest) >= 15 and len(lines) - len(rest) <= 6
    for line in rest:
        shell(line, tmp_path, environment())
    made = {path.name for path in tmp_path.iterdir()}
    files = {"cloth.npz", "there.npz", "session.jsonl", "cloth.png", "cloth.mp4", "sheet.npz"}
    assert made == {*SCENES, *files, "frames"}


# A checkpoint to resume is made by the command before, in the thorough tests.
AT_ONCE = [line for line in command_lines() if " run " in line and "--resume" not in line]


@pytest.mark.parametrize("line", AT_ONCE)
def test_every_run_is_accepted(line, tmp_path, monkeypatch, capsys):
    """Up to the moment at which Taichi would start; the slow ones run in the thorough tests."""
    monkeypatch.chdir(tmp_path)
    save_scenes(tmp_path)
    (tmp_path / "session.jsonl").write_text("")

    def start(*_, **__):
        raise InputError("it would start now")

    not_starting(monkeypatch, start)
    assert main(shlex.split(line)[1:]) == 2
    assert capsys.readouterr().err == "taichi-cloth: error: it would start now\n"


def test_python_example_runs_and_is_short(cli, tmp_path):
    (example,) = blocks("python")
    assert len(example.splitlines()) <= 20
    out = cli.call("commands:printed_by", program=example)
    assert re.search(r"\(384, 2\) 7\d\d -?\d+\.\d+", out)


# An unpacked source archive has no git and nothing tracked to copy; .ci/run has both.
@thorough
@pytest.mark.skipif(shutil.which("git") is None, reason="needs git to copy what is tracked")
def test_the_first_command_sets_everything_up(tmp_path):
    """In a copy of what git tracks: the environment is made, and the cloth runs headless."""
    copy = tmp_path / "copy"
    shell(f"git clone -q {ROOT} {copy}", tmp_path, environment())
    for path in shell("git ls-files -m -o --exclude-standard", ROOT, environment()).splitlines():
        (copy / path).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / path).exists():
            shutil.copy(ROOT / path, copy / path, follow_symlinks=False)
    first = next(text for text in blocks("sh") if SET_UP in text).strip()
    out = shell(first, copy, environment(Path(sys.base_prefix) / "bin"))
    assert "no display" in out and "600 frames in" in out


def build(folder):
    """The paths of a source archive and of the wheel that is built from it, in `folder`."""
    # Where setuptools is new enough, nothing is downloaded.
    try:
        version = importlib.metadata.version("setuptools")
    except importlib.metadata.PackageNotFoundError:
        version = "0"
    alone = ["--no-isolation"] if int(version.split(".")[0]) >= 77 else []
    command = [sys.executable, "-m", "build", "-q", *alone, "--outdir", str(folder), str(ROOT)]
    shell(shlex.join(command), folder.parent, environment())
    wheel, archive = sorted(folder.iterdir())
    assert archive.name.endswith(".tar.gz") and wheel.name.endswith(".whl")
    return archive, wheel


@thorough
def test_the_wheel_of_the_source_archive_has_all_and_works(tmp_path):
    """In an environment that has what it depends on, run from elsewhere."""
    _, wheel = build(tmp_path / "dist")
    inside = shell(f"{sys.executable} -m zipfile -l {wheel}", tmp_path, environment())
    for package in PACKAGES:
        assert package.relative_to(ROOT).as_posix() in inside
    assert not re.search(r"^(kernels|ui|tests)/", inside, re.M)

    venv.create(tmp_path / "env", with_pip=False)
    bin_ = tmp_path / "env" / "bin"
    (there,) = (tmp_path / "env" / "lib").glob("python*/site-packages")
    (there / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    install = f"-m pip --python {bin_}/python install -q --no-deps --no-index --ignore-installed"
    shell(f"{sys.executable} {install} {wheel}", tmp_path, environment())
    env = environment(bin_)
    place = shell("python -c 'import taichi_cloth; print(taichi_cloth.__file__)'", tmp_path, env)
    assert Path(place.splitlines()[-1]).is_relative_to(there)
    said = shell("taichi-cloth run box --particles 9 --frames 5 --execution serial", tmp_path, env)
    assert "5 frames in" in said


@thorough
def test_wheel_and_sdist_install_with_what_they_depend_on(tmp_path):
    """Each into a clean environment, with pip."""
    files = build(tmp_path / "dist")
    venv.create(tmp_path / "env", with_pip=True)
    bin_ = tmp_path / "env" / "bin"
    for number, file in enumerate(files):
        again = "--force-reinstall --no-deps" if number else ""
        shell(f"{bin_}/pip install -q {again} {file}", tmp_path, environment(bin_))
        said = shell(
            "taichi-cloth run box --particles 9 --frames 5 --execution serial",
            tmp_path,
            environment(bin_),
        )
        assert "5 frames in" in said


def test_documented_scene_file_and_log_are_accepted(tmp_path):
    from taichi_cloth.scene import scenefile
    from taichi_cloth.ui import interaction

    text = (ROOT / "docs" / "scenes.md").read_text()
    shutil.copy(ROOT / "taichi_cloth" / "scene" / "library" / "shirt.obj", tmp_path)
    block = re.search(r"^```toml\n(.*?)^```", text, re.M | re.S)[1]
    scene = scenefile.parse(block, folder=tmp_path)
    assert len(scene.obstacles) == 1 and scene.springs.between.max() < len(scene.particles)
    log = tmp_path / "log.jsonl"
    log.write_text(re.search(r"^```json\n(.*?)^```", text, re.M | re.S)[1])
    assert sorted(interaction.load(log).by_frame) == [12, 13, 20, 30, 31, 32, 40, 50]
