"""GGUI's shaders without branches: the same pictures, and no memory that grows with frames."""

import os
import struct
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import taichi as ti
from lacking import needs_vulkan
from selection import thorough

from taichi_cloth.ui import shaders

BOOL, FIRST, SECOND = (2 << 16 | 20, 7), (4 << 16 | 250, 3, 11, 12), (4 << 16 | 250, 4, 13, 14)


def module(*instructions, bound=20):
    words = [shaders.MAGIC, 0x10300, 0, bound, 0]
    return struct.pack(f"<{5 + sum(map(len, instructions))}I", *words, *sum(instructions, ()))


def test_conditions_become_constants():
    false, true = (3 << 16 | 42, 7, 20), (3 << 16 | 41, 7, 21)
    given = module(BOOL, FIRST, SECOND)
    assert shaders.fixed(given, (None, True)) == module(
        BOOL, false, true, FIRST, (SECOND[0], 21, *SECOND[2:]), bound=22
    )
    assert shaders.fixed(given, (False, None)) == module(
        BOOL, false, true, (FIRST[0], 20, *FIRST[2:]), SECOND, bound=22
    )
    for wrong in (given[4:], given[:-4], module(BOOL, FIRST), module(BOOL, (0,)), b""):
        with pytest.raises(ValueError):
            shaders.fixed(wrong, (False, False))


def test_what_corners_share_is_not_interpolated():
    variable, other = (4 << 16 | 59, 5, 9, 1), (4 << 16 | 59, 5, 8, 3)
    at, of_other = (4 << 16 | 71, 9, 30, 1), (4 << 16 | 71, 8, 30, 1)
    given = module(of_other, at, variable, other)
    flat = (3 << 16 | 71, 9, 14)
    assert shaders.shared(given, 1) == module(of_other, at, flat, variable, other)
    for wrong in (given[4:], module(of_other, other)):
        with pytest.raises(ValueError):
            shaders.shared(wrong, 1)


def run(program, tmp_path):
    """What a program prints, in a process of its own: GGUI opens one window in each."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        env={**os.environ, "XDG_CACHE_HOME": str(tmp_path)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


PICTURES = """
    import hashlib
    from taichi_cloth import runtime
    from taichi_cloth.scene import library
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui import app, composer, shaders
    from taichi_cloth.ui.framing import camera_of
    from taichi_cloth.ui.opening import open_view
    {own}
    runtime.start()
    scene = library.build("SCENE")
    sim = Simulation(scene)
    view = open_view("none", scene.world, pictures=True, size=(400, 300), camera=camera_of(scene))
    assert view.name == "ggui"
    for composer.SMOOTH_LINES, composer.MESH_VERTICES in ((10**6, 10**6), (0, 0)):
        app.run(sim, view, frames=1)
        print(hashlib.sha256(app.pixels_of(sim, view).tobytes()).hexdigest())
"""


@thorough
@needs_vulkan
@pytest.mark.parametrize("scene", ["cloth", "warp"])
def test_pictures_are_those_of_taichis_own_shaders(tmp_path, scene):
    """Of lines and balls, in a plane and in space, as meshes and as what GGUI has for them."""
    program = PICTURES.replace("SCENE", scene)
    ours = run(program.format(own=""), tmp_path)
    theirs = run(program.format(own="shaders._package = lambda source: None"), tmp_path)
    assert ours == theirs and len(set(ours)) == 2
    (folder,) = (tmp_path / "taichi-cloth").glob("shaders-*")
    assert {path.name for path in (folder / "shaders").iterdir()} > {
        *shaders.BRANCHES,
        *shaders.SHARED,
    }


def test_copies_that_are_damaged_are_not_used(tmp_path, monkeypatch, capsys):
    """A cut or missing one ended each later run that drew: Taichi draws by its own instead."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    source = Path(ti.__file__).parent / "shaders"
    folder = shaders._package(source)
    copy = folder / "shaders" / "Mesh_vk_vert.spv"
    whole = copy.read_bytes()
    assert shaders._package(source) == folder and capsys.readouterr().err == ""
    for damage in (lambda: copy.write_bytes(whole[:-4]), copy.unlink):
        damage()
        assert shaders._package(source) is None
        assert capsys.readouterr().err.count("\n") == 1
    copy.write_bytes(whole)
    assert shaders._package(source) == folder


@needs_vulkan
@pytest.mark.thorough
def test_memory_does_not_grow_with_the_frames_of_a_picture_in_space(tmp_path):
    """Without `fixed` it grows by 500 KB a frame on Mesa 22.3's software Vulkan."""
    program = """
        from pathlib import Path
        from taichi_cloth import runtime
        from taichi_cloth.scene import library
        from taichi_cloth.simulation.simulation import Simulation
        from taichi_cloth.ui import app
        from taichi_cloth.ui.framing import camera_of
        from taichi_cloth.ui.opening import open_view
        runtime.start()
        scene = library.build("box")
        sim = Simulation(scene)
        view = open_view("none", scene.world, pictures=True, size=(160, 120),
            camera=camera_of(scene))
        for _ in range(3):
            for _ in range(400):
                app.pixels_of(sim, view)
            print(int(Path("/proc/self/statm").read_text().split()[1]) * 4096)
    """
    _, before, after = map(int, run(program, tmp_path))
    assert (after - before) / 400 < 5000
