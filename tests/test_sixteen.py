"""Sixteen lanes: who takes them, and how a run compiles them for those that come later.

A real run of them compiles for half a minute; four lanes stand for sixteen here, and two for eight.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import PATIENCE
from screens import wait_for

from taichi_cloth.cli import doctor, run_sixteen
from taichi_cloth.errors import InputError
from taichi_cloth.measuring import machine
from taichi_cloth.scene.library import build
from taichi_cloth.settings.options import RunOptions
from taichi_cloth.simulation import sixteen
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.ui import hud, style
from taichi_cloth.ui.text import Word

# A run as the command line makes it, of a scene that is large enough; at its end it waits until
# what is compiled beside it is there, and says so.
RUN = """
import sys
from taichi_cloth.cli import main, run_sixteen
from taichi_cloth.measuring import machine
from taichi_cloth.simulation import simulation, sixteen

def end(compiler):
    compiler._thread.join()
    print("aside:", compiler._sim.aside, flush=True)

simulation.LANES, sixteen.LANES, sixteen.LEAST = 2, 4, 100
run_sixteen.AFTER, run_sixteen.WORTH, run_sixteen.Compiler.end = 0.0, 0.0, end
machine.vector_unit = lambda: machine.WIDEST
sys.exit(main.main(sys.argv[1:]))
"""
CLOTH = ("run", "cloth", "--columns", "40", "--rows", "30", "--headless", "--frames", "20")
WHAT = "cpu f32, 2 threads/symplectic_euler/2-D; 2^11 particles, 2^12 springs"


@pytest.fixture
def own_caches(monkeypatch, tmp_path):
    """Empty caches, of kernels and of what runs have learned."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "learned"))
    monkeypatch.setenv("TI_OFFLINE_CACHE_FILE_PATH", str(tmp_path / "kernels"))
    monkeypatch.setattr(machine, "vector_unit", lambda: machine.WIDEST)
    return tmp_path


def run(folder, *words):
    """What a run says on standard output; it is a process of its own, as Taichi's cache wants."""
    done = subprocess.run(
        [sys.executable, "-c", RUN, *CLOTH, *words],
        capture_output=True, text=True, timeout=PATIENCE, cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def kernels(folder):
    """The kernels in Taichi's cache."""
    return {path.name for path in Path(folder, "kernels").rglob("*.tic")}


def positions(path):
    with np.load(path) as saved:
        return saved["position"]


def test_a_run_compiles_them_and_the_next_one_takes_them(own_caches):
    how = ("--topology", "lanes", "--lanes", "auto", "--execution", "serial")
    first = run(own_caches, *how, "--save", "first.npz")
    assert "serial lanes;" in first and f"aside: {run_sixteen.DONE}" in first
    (tried,) = sixteen.all_tried()
    assert (tried.done, tried.failed) == (1, 0)

    there = kernels(own_caches)
    second = run(own_caches, *how, "--save", "second.npz", "--record", "log.jsonl")
    assert "serial lanes of 4;" in second and "aside" not in second
    assert kernels(own_caches) == there  # nothing was compiled anew
    assert sixteen.all_tried() == [tried]
    np.testing.assert_allclose(
        positions(own_caches / "first.npz"), positions(own_caches / "second.npz"), rtol=1e-5
    )

    # A log has them, wherever it is replayed, and a checkpoint has those that it was made with.
    (own_caches / "learned" / "taichi-cloth" / sixteen.FILE).unlink()
    header = json.loads((own_caches / "log.jsonl").read_text().splitlines()[0])["header"]
    assert header["lanes"] == 4
    saved = ("--save", "replay.npz", "--checkpoint", "c.npz")
    replay = run(own_caches, "--events", "log.jsonl", *saved)
    assert "lanes of 4;" in replay
    np.testing.assert_array_equal(
        positions(own_caches / "second.npz"), positions(own_caches / "replay.npz")
    )
    assert "lanes of 4;" in run(own_caches, "--resume", "c.npz")


def compiler_of(monkeypatch, of=run_sixteen.COMPILED):
    """What compiles beside a run of a small cloth, at once. of: in its place, for the other one."""
    monkeypatch.setattr(sixteen, "LEAST", 100)
    monkeypatch.setattr(sixteen, "PRECISION", "f64")  # of the tests' own process
    monkeypatch.setattr(run_sixteen, "AFTER", 0.0)
    monkeypatch.setattr(run_sixteen, "WORTH", 0.0)
    monkeypatch.setattr(run_sixteen, "COMPILED", of)
    sim = Simulation(build("cloth", columns=40, rows=30), topology="lanes", execution="serial")
    return sim, run_sixteen.compiled_beside(sim, RunOptions(view="none"))


def test_a_failure_is_noted_for_doctor_and_said_to_nobody_else(
    device, few_lanes, own_caches, monkeypatch, capfd
):
    for count in range(1, sixteen.TRIES + 1):
        sim, beside = compiler_of(monkeypatch, of="taichi_cloth.cli.run_sixteen:Missing")
        with beside:
            wait_for(
                lambda n=count: sum(one.failed for one in sixteen.all_tried()) == n,
                None,
                "a failure that is noted",
            )
        assert sim.aside == ""
    assert capfd.readouterr() == ("", "")
    finding = doctor._sixteen_lanes()
    assert not finding.good and f"failed {sixteen.TRIES} times" in finding.text
    assert "Missing" in finding.text and "0 kinds" in finding.text
    assert run_sixteen._compiler(sim, RunOptions(view="none")) is None  # left alone from now on


def test_what_is_not_done_when_the_run_ends_is_left(device, few_lanes, own_caches, monkeypatch):
    sim, beside = compiler_of(monkeypatch)
    with beside:
        wait_for(lambda: sim.aside, None, "what compiles beside the run")
        row, _ = hud.status_rows(sim, "cpu f64", state=Word("playing", style.INK))
        assert run_sixteen.DOING in [word.text for word in row.left]
    assert sixteen.all_tried() == []


def test_who_may_choose(device, few_lanes, own_caches, monkeypatch):
    monkeypatch.setattr(run_sixteen, "WORTH", 0.0)
    large = build("cloth", columns=200, rows=100)

    def lanes(scene=large, **given):
        options = RunOptions(view="none", given=frozenset(given), **given)
        return run_sixteen.lanes_of(scene, run_sixteen.consistent(options))

    assert lanes() == "auto" and lanes(lanes="16") == 16 and lanes(lanes="8") is None
    assert lanes(topology="lanes") is None and lanes(topology="lanes", lanes="auto") == "auto"
    assert lanes(beside="substeps=2") is None and lanes(hold="60fps") is None
    with pytest.raises(InputError, match="--lanes 16 and --topology graph exclude each other"):
        lanes(lanes="16", topology="graph")
    with pytest.raises(InputError, match="--lanes 16: only --arch cpu has lanes, not vulkan"):
        lanes(lanes="16", arch="vulkan")
    with pytest.raises(InputError, match="--lanes 16: method tr_bdf2 takes at most 8"):
        lanes(lanes="16", method="tr_bdf2")
    # A log says so, of another method.
    recorded = RunOptions(view="none", lanes="16", method="tr_bdf2")
    assert run_sixteen.lanes_of(large, recorded) is None
    monkeypatch.setattr(run_sixteen, "WORTH", 1e9)
    assert lanes(frames=100) is None and lanes(frames=100_000) == "auto"
    monkeypatch.setattr(machine, "vector_unit", lambda: "avx2")
    assert lanes(frames=100_000) is None


def test_what_is_noted_outlives_what_cannot_be_read(own_caches):
    sixteen.note(WHAT, "no memory")
    sixteen.note("other")
    sixteen.note(WHAT)
    assert sixteen.all_tried() == [
        sixteen.Tried("other", 1, 0, ""), sixteen.Tried(WHAT, 1, 1, "no memory"),
    ]  # fmt: skip
    file = own_caches / "learned" / "taichi-cloth" / sixteen.FILE
    for broken in ("[", "[1]", json.dumps({WHAT: [1, -1, ""], "x": 3, "y": [True, 0, ""]})):
        file.write_text(broken)
        assert sixteen.all_tried() == [] and sixteen.tried(WHAT).done == 0
