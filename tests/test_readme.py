"""The README is true: its commands run, its snippets work, its packages install."""

import os
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", README, re.M | re.S)
PACKAGES = list((ROOT / "taichi_cloth").rglob("__init__.py"))
SET_UP = "python3 -m venv"  # the two commands that make an environment; see below, and .ci/run


def blocks(language):
    return [text for kind, text in BLOCKS if kind == language]


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
    assert README.count("```") == 2 * len(BLOCKS)
    assert all((ROOT / path).exists() for path in re.findall(r"\]\((?!http)([^)]+)\)", README))


def test_commands_run_one_after_the_other(tmp_path):
    """In their order, in one folder, without a display; the scene file is the README's own."""
    (tmp_path / "curtain.toml").write_text(blocks("toml")[0])
    lines = [line for text in blocks("sh") for line in text.splitlines() if SET_UP not in line]
    assert len(lines) >= 8
    for line in lines:
        assert line.startswith("taichi-cloth ")
        shell(line, tmp_path, environment())
    made = {path.name for path in tmp_path.iterdir()}
    files = {"curtain.toml", "cloth.npz", "session.jsonl", "cloth.png", "cloth.mp4"}
    assert made == files | {"trade-cloth", "stability-cloth"}


def test_python_example_runs_and_is_short(tmp_path):
    (example,) = blocks("python")
    assert len(example.splitlines()) <= 15
    out = shell(f"{sys.executable} -c '{example}'", tmp_path, environment())
    assert re.search(r"\(384, 2\) 7\d\d -?\d+\.\d+", out)


# An unpacked source archive has no git and nothing tracked to copy; .ci/run has both.
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


def test_wheel_and_sdist_install_and_work(tmp_path):
    """Built in isolation, installed into a clean environment, run from elsewhere."""
    out = tmp_path / "dist"
    shell(f"{sys.executable} -m build -q --outdir {out} {ROOT}", tmp_path, environment())
    files = sorted(path.name for path in out.iterdir())
    assert [name.endswith((".whl", ".tar.gz")) for name in files] == [True, True]
    packages = {".".join(path.relative_to(ROOT).parts[:-1]) for path in PACKAGES}
    inside = shell(f"{sys.executable} -m zipfile -l {out}/*.whl", tmp_path, environment())
    for package in packages:
        assert f"{package.replace('.', '/')}/__init__.py" in inside
    assert not re.search(r"^(kernels|ui|tests)/", inside, re.M)

    venv.create(tmp_path / "env", with_pip=True)
    bin_ = tmp_path / "env" / "bin"
    for number, file in enumerate(("*.whl", "*.tar.gz")):
        again = "--force-reinstall --no-deps" if number else ""
        shell(f"{bin_}/pip install -q {again} {out}/{file}", tmp_path, environment(bin_))
        said = shell("taichi-cloth run box --particles 9 --frames 5", tmp_path, environment(bin_))
        assert "5 frames in" in said


def test_documented_scene_file_and_log_are_accepted(tmp_path, device):
    from taichi_cloth.files import events
    from taichi_cloth.scene import scenefile
    from taichi_cloth.simulation.simulation import Simulation

    text = (ROOT / "docs" / "scenes.md").read_text()
    scene = scenefile.parse(re.search(r"^```toml\n(.*?)^```", text, re.M | re.S)[1])
    Simulation(scene, execution="serial").advance(3)
    log = tmp_path / "log.jsonl"
    log.write_text(re.search(r"^```json\n(.*?)^```", text, re.M | re.S)[1])
    assert sorted(events.load(log).by_frame) == [12, 13, 20]
