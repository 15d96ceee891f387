"""Kernels that run faster: who takes them, and how a run compiles them for those that come later.

They are those of sixteen lanes, and those of the graph that are not compiled soon. Four lanes stand
for sixteen here, and two for eight, which compile in less time.
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

from taichi_cloth.cli import doctor, run_aside, run_kernels
from taichi_cloth.errors import InputError
from taichi_cloth.measuring import machine
from taichi_cloth.render import style
from taichi_cloth.scene.library import build
from taichi_cloth.settings.options import RunOptions
from taichi_cloth.simulation import aside, sixteen
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.ui import hud
from taichi_cloth.ui.text import Word

# A run as the command line makes it, of a scene that is large enough; at its end it waits until
# what is compiled beside it is there, and says so. Its first argument is `run_kernels.WORTH`.
RUN = """
import sys
from taichi_cloth.cli import main, run_aside, run_kernels
from taichi_cloth.measuring import machine
from taichi_cloth.simulation import simulation, sixteen

def end(compiler):
    compiler._thread.join()
    print("aside:", compiler._sim.aside, flush=True)

simulation.LANES, sixteen.LANES, sixteen.LEAST = 2, 4, 100
run_aside.AFTER, run_kernels.WORTH, run_aside.Compiler.end = 0.0, float(sys.argv[1]), end
machine.vector_unit = lambda: machine.WIDEST
sys.exit(main.main(sys.argv[2:]))
"""
SHORT = ("run", "cloth", "--headless", "--frames", "20")
CLOTH = (*SHORT, "--columns", "40", "--rows", "30")
WHAT = "cpu f32, 2 threads/symplectic_euler/2-D; 2^11 particles, 2^12 springs"


@pytest.fixture
def own_caches(monkeypatch, tmp_path):
    """Empty caches, of kernels and of what runs have learned."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "learned"))
    monkeypatch.setenv("TI_OFFLINE_CACHE_FILE_PATH", str(tmp_path / "kernels"))
    monkeypatch.setattr(machine, "vector_unit", lambda: machine.WIDEST)
    return tmp_path


def run(folder, *words, worth=0.0):
    """What a run says on standard output; it is a process of its own, as Taichi's cache wants."""
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(worth), *words],
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


@pytest.mark.thorough
def test_a_run_compiles_them_and_the_next_one_takes_them(own_caches):
    how = ("--topology", "lanes", "--lanes", "auto", "--execution", "serial")
    first = run(own_caches, *CLOTH, *how, "--save", "first.npz")
    assert "serial lanes;" in first and "aside: 4 lanes are there for later runs" in first
    (tried,) = aside.all_tried()
    assert (tried.done, tried.failed) == (1, 0)

    there = kernels(own_caches)
    second = run(own_caches, *CLOTH, *how, "--save", "second.npz", "--record", "log.jsonl")
    assert "serial lanes of 4;" in second and "aside" not in second
    assert kernels(own_caches) == there  # nothing was compiled anew
    assert aside.all_tried() == [tried]
    np.testing.assert_allclose(
        positions(own_caches / "first.npz"), positions(own_caches / "second.npz"), rtol=1e-5
    )

    # A log has them, wherever it is replayed, and a checkpoint has those that it was made with.
    (own_caches / "learned" / "taichi-cloth" / aside.FILE).unlink()
    header = json.loads((own_caches / "log.jsonl").read_text().splitlines()[0])["header"]
    assert header["lanes"] == 4
    saved = ("--save", "replay.npz", "--checkpoint", "c.npz")
    replay = run(own_caches, *CLOTH, "--events", "log.jsonl", *saved)
    assert "lanes of 4;" in replay
    np.testing.assert_array_equal(
        positions(own_caches / "second.npz"), positions(own_caches / "replay.npz")
    )
    assert "lanes of 4;" in run(own_caches, *CLOTH, "--resume", "c.npz")


def compiler_of(monkeypatch, of=run_aside.COMPILED):
    """What compiles beside a run of a small cloth, at once. of: in its place, for the other one."""
    monkeypatch.setattr(sixteen, "LEAST", 100)
    monkeypatch.setattr(sixteen, "PRECISION", "f64")  # of the tests' own process
    monkeypatch.setattr(run_aside, "AFTER", 0.0)
    monkeypatch.setattr(run_kernels, "WORTH", 0.0)
    monkeypatch.setattr(run_aside, "COMPILED", of)
    sim = Simulation(build("cloth", columns=40, rows=30), topology="lanes", execution="serial")
    return sim, run_aside.compiled_beside(sim, RunOptions(view="none"))


def test_a_failure_is_noted_for_doctor_and_said_to_nobody_else(
    device, few_lanes, own_caches, monkeypatch, capfd
):
    for count in range(1, aside.TRIES + 1):
        sim, beside = compiler_of(monkeypatch, of="taichi_cloth.cli.run_aside:Missing")
        with beside:
            wait_for(
                lambda n=count: sum(one.failed for one in aside.all_tried()) == n,
                None,
                "a failure that is noted",
            )
        assert sim.aside == ""
    assert capfd.readouterr() == ("", "")
    finding = doctor._compiled_beside()
    assert not finding.good and f"failed {aside.TRIES} times" in finding.text
    assert "Missing" in finding.text and "0 kinds" in finding.text
    assert run_aside._compiler(sim, RunOptions(view="none")) is None  # left alone from now on


def test_what_is_not_done_when_the_run_ends_is_left(device, few_lanes, own_caches, monkeypatch):
    sim, beside = compiler_of(monkeypatch)
    with beside:
        wait_for(lambda: sim.aside, None, "what compiles beside the run")
        row, _ = hud.status_rows(sim, "cpu f64", state=Word("playing", style.INK))
        assert "compiling 16 lanes for later runs" in [word.text for word in row.left]
    assert aside.all_tried() == []


def test_who_may_choose(device, few_lanes, own_caches, monkeypatch):
    monkeypatch.setattr(run_kernels, "WORTH", 0.0)
    large = build("cloth", columns=200, rows=100)

    def lanes(scene=large, **given):
        options = RunOptions(view="none", given=frozenset(given), **given)
        return run_kernels.lanes_of(scene, run_kernels.consistent(options))

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
    assert run_kernels.lanes_of(large, recorded) is None
    monkeypatch.setattr(run_kernels, "WORTH", 1e9)
    assert lanes(frames=100) is None and lanes(frames=100_000) == "auto"
    monkeypatch.setattr(machine, "vector_unit", lambda: "avx2")
    assert lanes(frames=100_000) is None


def test_what_is_noted_outlives_what_cannot_be_read(own_caches):
    aside.note(WHAT, "no memory")
    aside.note("other")
    aside.note(WHAT)
    assert aside.all_tried() == [
        aside.Tried("other", 1, 0, ""), aside.Tried(WHAT, 1, 1, "no memory"),
    ]  # fmt: skip
    file = own_caches / "learned" / "taichi-cloth" / aside.FILE
    for broken in ("[", "[1]", json.dumps({WHAT: [1, -1, ""], "x": 3, "y": [True, 0, ""]})):
        file.write_text(broken)
        assert aside.all_tried() == [] and aside.tried(WHAT).done == 0


# --- kernels of the graph that are compiled soon --------------------------------------------------

# Whether a scene has the same positions after frames with kernels of both kinds, to the bit, in f32
# and where compilers may reorder.
BOTH = """
import sys
from taichi_cloth import runtime
from taichi_cloth.scene.library import build
from taichi_cloth.simulation.simulation import Simulation

scene, method, frames = sys.argv[1], sys.argv[2], int(sys.argv[3])
runtime.start("cpu", "f32", 2, fast_math=True)
dt = "auto" if method in ("symplectic_euler", "verlet", "rk4") else None
sims = [Simulation(build(scene), method, dt, topology="graph", soon=soon) for soon in (True, False)]
for sim in sims:
    sim.advance(frames)
print(sims[0].hurries, sims[1].hurries, (sims[0].positions() == sims[1].positions()).all())
"""


def test_a_run_compiles_soon_and_the_next_one_takes_faster_kernels(own_caches):
    how = (*SHORT, "--method", "verlet", "--topology", "graph", "--execution", "serial")
    first = run(own_caches, *how, "--save", "first.npz", worth=1e9)
    assert "aside: faster kernels are there for later runs" in first
    (tried,) = aside.all_tried()
    assert (tried.done, tried.failed) == (1, 0) and tried.what.startswith("graph/cpu f32")
    there = kernels(own_caches)
    second = run(own_caches, *how, "--save", "second.npz", worth=1e9)
    assert "aside" not in second
    assert kernels(own_caches) == there  # nothing was compiled anew
    np.testing.assert_array_equal(
        positions(own_caches / "first.npz"), positions(own_caches / "second.npz")
    )


def test_what_hurries_and_what_does_not(to_run_fast, few_lanes, own_caches):
    cloth = build("cloth")

    def made(**given):
        sim = Simulation(cloth, execution="serial", compiling=lambda: None, **given)
        sim.advance()
        return sim

    first = made(topology="graph", soon=True)
    assert first.hurries and made(topology="graph", soon=True).hurries  # as nothing else is there
    first.set_method("verlet")
    assert first.hurries
    assert not made(topology="lanes", soon=True).hurries
    faster = made(topology="graph")
    assert not faster.hurries and not made(topology="graph", soon=True).hurries
    first = made(topology="graph", soon=True)
    np.testing.assert_array_equal(first.positions(), faster.positions())


def test_short_runs_and_windows_begin_with_what_compiles_soon(monkeypatch):
    def soon(scene, frames, **given):
        options = RunOptions(view="none", frames=frames, **given)
        return run_kernels.soon(build(scene), options)

    assert soon("cloth", 600) and not soon("cloth", 2_000_000)
    assert not soon("cloth", 600, substeps=3_000)
    assert soon("trampoline", 6_000) and not soon("trampoline", 6_000, dt="auto")
    monkeypatch.setattr("taichi_cloth.ui.opening.opens_window", lambda view: view != "none")
    monkeypatch.setattr(run_kernels, "WORTH", 0.0)
    assert run_kernels.soon(build("cloth"), RunOptions(view="gui"))
    assert not run_kernels.soon(build("cloth"), RunOptions(view="gui", frames=600))
    monkeypatch.setattr(run_kernels, "MOST_SOON", 100)
    assert not run_kernels.soon(build("cloth"), RunOptions(view="gui"))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("scene", "method"),
    [
        *(("flag", "implicit_euler"), ("trampoline", "rk4")),
        *(("curtain", "xpbd"), ("drape", "verlet"), ("trampoline", "vbd"), ("box", "tr_bdf2")),
        ("cloth", "verlet"),
    ],
)
def test_both_have_the_same_bits(own_caches, scene, method):
    done = subprocess.run(
        [sys.executable, "-c", BOTH, scene, method, "5"],
        capture_output=True, text=True, timeout=PATIENCE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "True False True"
