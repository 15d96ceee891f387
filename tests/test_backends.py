"""The same run on every backend, thread count and precision, through the command line."""

import os

import numpy as np
import pytest
from conftest import GOLDEN, command, golden

from taichi_cloth import runtime
from taichi_cloth.errors import InputError


def save(folder, name, *arguments, **options):
    path = folder / f"{name}.npz"
    command("run", *arguments, "--headless", "--quiet", "--save", path, **options)
    with np.load(path) as file:
        return dict(file)


BLOWN = ("cloth", "--precision", "f64", "--events", GOLDEN / "cloth_blow.jsonl")


ON = [(arch, topology) for arch in ("cpu", "vulkan", "opengl") for topology in ("lanes", "graph")]


@pytest.mark.parametrize(("arch", "topology"), ON)
def test_blown_cloth_on_every_backend(arch, topology, tmp_path, display):
    where = ("--arch", arch, "--topology", topology)
    saved = save(tmp_path, arch, *BLOWN, *where, "--frames", 600, "--every", 10)
    expected = golden("cloth_blow.npz")
    np.testing.assert_array_equal(saved["frame"], np.arange(10, 601, 10))
    np.testing.assert_array_equal(saved["time"], saved["frame"])
    np.testing.assert_allclose(saved["position"], expected["position"], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(saved["spring_alive"].sum(1), expected["springs_alive"])
    np.testing.assert_array_equal(saved["spring_alive"][-1], expected["spring_alive_final"])


@pytest.mark.parametrize(("arch", "topology"), ON)
def test_resting_cloth_in_f32_on_every_backend(arch, topology, tmp_path, display):
    where = ("--arch", arch, "--topology", topology)
    saved = save(tmp_path, arch, "cloth", *where, "--frames", 300, "--every", 10)
    expected = golden("cloth_rest.npz")["position"]
    np.testing.assert_allclose(saved["position"], expected, rtol=0, atol=0.02)


@pytest.mark.parametrize(
    "scene",
    [["cloth", "--columns", 60, "--rows", 50, "--topology", "graph"], ["box", "--particles", 400]],
)
def test_same_bits_for_every_thread_count_and_on_every_run(scene, tmp_path):
    """`test_topologies.py` does the same in lanes."""
    runs = [("--threads", 1), ("--threads", 2), ("--threads", 2), ("--threads", 3)]
    saved = [
        save(
            tmp_path,
            f"run{k}",
            *scene,
            *run,
            "--execution",
            "parallel",
            "--frames",
            60,
            "--every",
            20,
        )
        for k, run in enumerate(runs)
    ]
    for other in saved[1:]:
        np.testing.assert_array_equal(other["position"], saved[0]["position"])
        np.testing.assert_array_equal(other["velocity"], saved[0]["velocity"])


def test_metal_has_no_f64():
    with pytest.raises(InputError, match="Metal has no f64"):
        runtime.start("metal", "f64")


def test_a_missing_backend_is_refused_with_those_that_are_there(tmp_path):
    missing = next(name for name, lack in runtime.usable_backends().items() if lack)
    out, error = command("run", "cloth", "--arch", missing, "--save", tmp_path / "x.npz", check=2)
    assert out == "" and len(error.splitlines()) == 1
    assert f"--arch {missing}" in error and "usable: cpu" in error
    assert os.listdir(tmp_path) == []


BARE = """
[world]
size = [100.0, 100.0]
[[particles]]
position = [20.0, 50.0]
[[particles]]
position = [60.0, 50.0]
"""
WITH = {  # without drag: its two instructions are fewer than the names in a file vary by
    "walls": ("size", "walls = true\nsize"),
    "collisions": ("size", "collisions = true\nsize"),
    "mouse": ("size", "mouse = 'blow'\nsize"),
    "springs": ("[world]", "springs = [{ between = [0, 1] }]\n[world]"),
    "fracture": ("[world]", "springs = [{ between = [0, 1], break_force = 9.0 }]\n[world]"),
}


def test_features_that_a_scene_lacks_are_not_compiled(tmp_path):
    """The size of what the compiler wrote, from an empty cache: each feature adds to it."""

    def compiled(name, text):
        (tmp_path / f"{name}.toml").write_text(text)
        env = {"TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path / name)}
        command(
            *("run", tmp_path / f"{name}.toml", "--headless", "--frames", 2, "--threads", 1),
            env=env,
        )
        return sum(file.stat().st_size for file in (tmp_path / name).rglob("*.tic"))

    bare = compiled("bare", BARE)
    sizes = {name: compiled(name, BARE.replace(*edit, 1)) for name, edit in WITH.items()}
    assert bare > 0
    assert all(size > bare + 500 for size in sizes.values()), (bare, sizes)
    assert sizes["fracture"] > sizes["springs"]


@pytest.mark.parametrize("cache, limit", [("cold", 10.0), ("warm", 3.0)])
def test_first_frame_comes_soon(cache, limit, tmp_path_factory):
    """From an empty cache of compiled kernels and measured speeds, and again with them filled."""
    import time

    folder = tmp_path_factory.getbasetemp() / "caches"
    env = {"TI_OFFLINE_CACHE_FILE_PATH": str(folder / "ti"), "XDG_CACHE_HOME": str(folder)}
    begin = time.perf_counter()
    command("run", "cloth", "--headless", "--frames", 1, env=env)
    assert time.perf_counter() - begin < limit
