"""One device for the whole test process: the CPU in f64, where results are compared to round-off.

Other precisions, backends and thread counts run through the command line, each in its own process.
"""

import contextlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

os.environ["TI_SKIP_VERSION_CHECK"] = "ON"

import numpy as np
import pytest

GOLDEN = Path(__file__).parent / "golden"


@pytest.fixture(scope="session")
def device():
    from taichi_cloth import runtime

    return runtime.start("cpu", "f64", threads=2)


@pytest.fixture
def few_lanes(monkeypatch):
    """Cells of 2 lanes, which compile in a third of the time: for what holds for any number."""
    from taichi_cloth.simulation import simulation

    monkeypatch.setattr(simulation, "LANES", 2)


@pytest.fixture(params=["serial", "parallel"])
def execution(request):
    return request.param


@pytest.fixture(params=["lanes", "graph"])
def topology(request):
    return request.param


@pytest.fixture(
    scope="module", params=["lanes serial", "lanes parallel", "graph serial", "graph parallel"]
)
def way(request):
    """How a scene with a regular grid can be run: what holds for one way holds for all four."""
    topology, execution = request.param.split()
    return {"topology": topology, "execution": execution}


def golden(name):
    """The arrays of a golden .npz file, the contents of a .json, or the events of a .jsonl."""
    path = GOLDEN / name
    if path.suffix == ".npz":
        with np.load(path) as file:
            return dict(file)
    if path.suffix == ".jsonl":
        return [json.loads(line) for line in path.read_text().splitlines()]
    return json.loads(path.read_text())


def command(*arguments, check=0, env=None, cwd=None, timeout=300):
    """Run `taichi-cloth` with arguments in a process of its own; return (stdout, stderr)."""
    done = subprocess.run(
        [sys.executable, "-m", "taichi_cloth", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=timeout,
        cwd=cwd,
        env={**os.environ, **(env or {})},
    )
    assert done.returncode == check, f"exit {done.returncode}: {done.stdout}{done.stderr}"
    return done.stdout, done.stderr


@contextlib.contextmanager
def virtual_screen():
    """An X server of our own, as long as the context lasts; its name. CI must have Xvfb.

    A plain one, which starts anew whenever its last client leaves.
    """
    if not (shutil.which("Xvfb") or os.environ.get("CI")):
        pytest.skip("needs Xvfb")
    read, write = os.pipe()
    screen = ["-screen", "0", "1400x900x24", "-nolisten", "tcp"]
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), *screen], pass_fds=[write], stderr=subprocess.DEVNULL
    )
    os.close(write)
    with os.fdopen(read) as said:
        number = said.readline().strip()
    try:
        yield f":{number}"
    finally:
        server.terminate()
        server.wait()


@pytest.fixture(scope="session")
def display():
    """A virtual display for this test process, unless it has one."""
    from taichi_cloth import runtime

    if runtime.display_available():
        yield os.environ.get("DISPLAY")
        return
    with virtual_screen() as name:
        os.environ["DISPLAY"] = name
        yield name
        del os.environ["DISPLAY"]
