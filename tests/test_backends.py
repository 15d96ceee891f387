"""The same run on every backend, thread count and precision, through the command line."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from commands import command
from goldens import GOLDEN, golden
from selection import as_thorough, mostly_thorough, thorough

from bench.accuracy.matrix import EVERYTHING
from taichi_cloth import runtime
from taichi_cloth.errors import InputError


def save(run, folder, name, *arguments):
    """What a run saves, where run(words...) does the command."""
    path = folder / f"{name}.npz"
    run("run", *arguments, "--headless", "--quiet", "--save", path)
    with np.load(path) as file:
        return dict(file)


ON = [(arch, topology) for arch in ("cpu", "vulkan", "opengl") for topology in ("lanes", "graph")]
# By default a software driver in one topology; of CPUs see test_golden.py.
SOME = [("vulkan", "graph")]


@thorough
@pytest.mark.parametrize(
    ("name", "arch", "topology"),
    [
        *((name, *on) for name in ("cloth_blow", "cloth_storm") for on in ON if on[0] == "cpu"),
        # The other two of software drivers are in the next test.
        *(("cloth_blow", *on) for on in (("vulkan", "graph"), ("opengl", "lanes"))),
    ],
)
def test_blown_cloth_on_every_backend(name, arch, topology, tmp_path, cli_on):
    where = ("--arch", arch, "--topology", topology, "--execution", "parallel")
    blown = ("cloth", "--precision", "f64", "--events", GOLDEN / f"{name}.jsonl")
    saved = save(cli_on[arch], tmp_path, arch, *blown, *where, "--frames", 600, "--every", 10)
    expected = golden(f"{name}.npz")
    np.testing.assert_array_equal(saved["frame"], np.arange(10, 601, 10))
    np.testing.assert_array_equal(saved["time"], saved["frame"])
    np.testing.assert_allclose(saved["position"], expected["position"], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(saved["spring_alive"].sum(1), expected["springs_alive"])
    np.testing.assert_array_equal(saved["spring_alive"][-1], expected["spring_alive_final"])


@pytest.mark.parametrize(("arch", "topology"), mostly_thorough(ON, default=SOME))
def test_resting_cloth_in_f32_on_every_backend(arch, topology, tmp_path, cli_on):
    where = ("--arch", arch, "--topology", topology, "--execution", "parallel")
    saved = save(cli_on[arch], tmp_path, arch, "cloth", *where, "--frames", 300, "--every", 10)
    expected = golden("cloth_rest.npz")["position"]
    np.testing.assert_allclose(saved["position"], expected, rtol=0, atol=0.02)


@thorough
@pytest.mark.parametrize("arch", ["cpu", "vulkan", "opengl"])
def test_particles_at_no_triangle_have_no_normal(arch, cli_on):
    """Arrays that a kernel does not write whole come back from Vulkan with what was there."""
    assert cli_on[arch].call("gpu_twins:bare_normals_on", arch=arch) == 0.0


@thorough
@pytest.mark.parametrize(
    "scene",
    [
        ["cloth", "--columns", 60, "--rows", 50, "--topology", "graph"],
        ["box", "--particles", 400],
        ["everything", "--topology", "graph"],
    ],
    ids=lambda scene: f"{scene[0]} {scene[-1]}",
)
def test_same_bits_for_every_thread_count_and_on_every_run(scene, tmp_path, cli):
    """`test_topologies.py` does the same in lanes, for cloth with nothing but springs."""
    frames = 60
    if scene[0] == "everything":  # air, bending, obstacles, resting pairs
        (tmp_path / "everything.toml").write_text(EVERYTHING)
        scene, frames = [tmp_path / "everything.toml", *scene[1:], "--dt", "auto"], 9
    run = (*scene, "--execution", "parallel", "--frames", frames, "--every", frames // 3)
    run = (*run, "--threads")
    # The long one once for each; more threads than cores wait for each other most of the time.
    counts = (1, 3, 3) if frames == 60 else (1, 2)
    saved = [save(cli, tmp_path, f"run{k}", *run, count) for k, count in enumerate(counts)]
    for other in saved[1:]:
        np.testing.assert_array_equal(other["position"], saved[0]["position"])
        np.testing.assert_array_equal(other["velocity"], saved[0]["velocity"])


def test_what_an_earlier_start_made_is_gone_as_soon_as_taichi_starts_again(device, monkeypatch):
    """Else what is collected meanwhile frees memory of the new one."""
    seen = []

    def initialize(*_):
        seen.append(runtime.still_runs(device))
        return True

    monkeypatch.setattr(runtime, "_device", device)  # which is put back
    monkeypatch.setattr(runtime, "_initialize", initialize)
    runtime.start("cpu", "f32")
    assert seen == [False]


def test_metal_has_no_f64():
    with pytest.raises(InputError, match="Metal has no f64"):
        runtime.start("metal", "f64")


BARE = """
[world]
size = [100.0, 100.0]
[[particles]]
position = [20.0, 50.0]
[[particles]]
position = [60.0, 50.0]
"""
# Without drag and the mouse: their few instructions are less than names in a file, and loops that
# are unrolled or not, vary by. What a push takes besides is compiled once something is pushed.
WITH = {
    "walls": ("size", "walls = true\nsize"),
    "collisions": ("size", "collisions = true\nsize"),
    "springs": ("[world]", "springs = [{ between = [0, 1] }]\n[world]"),
    "fracture": ("[world]", "springs = [{ between = [0, 1], break_force = 9.0 }]\n[world]"),
}


def kernels_in(folder):
    """The compiled kernels in a cache: their files' sizes by name."""
    return {file.name: file.stat().st_size for file in Path(folder).rglob("*.tic")}


@thorough
def test_features_that_a_scene_lacks_are_not_compiled(tmp_path, cli):
    """The size of what the compiler wrote, from an empty cache: each feature adds to it."""

    def compiled(name, text):
        (tmp_path / f"{name}.toml").write_text(text)
        env = {"TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path / name)}
        flags = ("--headless", "--frames", 2, "--threads", 1)
        cli("run", tmp_path / f"{name}.toml", *flags, env=env)
        cli.call("commands:end_taichi")
        return sum(kernels_in(tmp_path / name).values())

    bare = compiled("bare", BARE)
    sizes = {name: compiled(name, BARE.replace(*edit, 1)) for name, edit in WITH.items()}
    assert bare > 0
    assert all(size > bare + 500 for size in sizes.values()), (bare, sizes)
    assert sizes["fracture"] > sizes["springs"]


IN_PARTS = ("drape", "--side", 17, "--substeps", 8, "--topology", "graph", "--execution", "serial")


@pytest.mark.parametrize(("scene", "runs"), [(("oscillator",), 2), as_thorough((IN_PARTS, 3))])
def test_a_later_run_compiles_and_measures_nothing(scene, runs, tmp_path):
    """From empty caches of kernels, of their list and of speeds, and again as they are then.

    Kernels that call functions (`kernels/parts.py`) are looked for by all that they call, in an
    order that may change from process to process: here each calls one at most.
    """
    env = {"TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path / "ti"), "XDG_CACHE_HOME": str(tmp_path)}
    made = []
    for _ in range(runs):
        command("run", *scene, "--headless", "--frames", 30, env=env)
        known = {p.name: p.read_text() for p in (tmp_path / "taichi-cloth").iterdir()}
        made.append((kernels_in(tmp_path / "ti"), known))
    assert made[0][0] and "compiled.json" in made[0][1]
    for (kernels, known), (again, later) in itertools.pairwise(made):
        assert again == kernels and later["compiled.json"] == known["compiled.json"]
        # Speeds are told by the least disturbed of few launches, and may be by a later run first.
        assert "execution.json" not in known or later["execution.json"] == known["execution.json"]


@pytest.mark.parametrize(
    ("devices", "threads"),
    [
        (["llvmpipe (LLVM 15.0.6, 256 bits)"], 8),
        (["NVIDIA H100", "llvmpipe (LLVM 15.0.6, 256 bits)"], None),  # Taichi takes the better one
        ([], None),  # not known: as on macOS, where the loader may list none to us
    ],
)
def test_blocks_are_small_where_vulkan_is_known_to_be_software(devices, threads, monkeypatch):
    monkeypatch.setattr(runtime.vulkan, "devices", lambda: devices)
    assert runtime._block_size("vulkan").get("default_gpu_block_dim") == threads
    assert runtime._block_size("cpu") == {}
