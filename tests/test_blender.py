"""Exports in Blender, by its module `bpy` in an environment of its own: what is shown, and when."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from selection import thorough
from test_exports import SPRINGS, TRIANGLES, Moving
from test_pythons import interpreter

from taichi_cloth.files.exports import Export

PYTHON, BPY = "3.13", "bpy==5.2.3"  # the one is for the other alone
FRAMES = range(1, 7)
SECONDS = 1500


class Hanging(Moving):
    """Four particles that move, a triangle that tears in frame 4, and a particle of none."""

    def __init__(self, up):
        super().__init__()
        self.more = 1
        self.scene = SimpleNamespace(
            file_points=None,
            world=SimpleNamespace(dim=3, up=up),
            particles=SimpleNamespace(position=self.positions()),
            springs=SimpleNamespace(between=SPRINGS),
            triangles=TRIANGLES,
        )


@thorough
def test_blender_shows_each_frame_at_its_number_and_upright(tmp_path):
    """Point caches on the mesh beside them, USD, PLY and OBJ, of scenes whose y is up or down.

    A vertex whose last face is torn keeps its number, and so does a particle that never had one.
    """
    python = interpreter(PYTHON)
    if python is None:
        pytest.skip(f"needs Python {PYTHON}")
    subprocess.run([python, "-m", "venv", tmp_path / "venv"], check=True)
    inside = tmp_path / "venv" / ("Scripts" if sys.platform == "win32" else "bin")
    subprocess.run([inside / "pip", "install", "-q", BPY], check=True, timeout=SECONDS)
    for up in ("y", ""):
        folder, sim = tmp_path / f"up-{up}", Hanging(up)
        folder.mkdir()
        exports = [
            Export(folder / "cloth.pc2", sim.dt, scene=sim.scene),
            Export(folder / "second.pc2", sim.dt, 2, scene=sim.scene),
            *(Export(folder / f"cloth.{kind}", sim.dt) for kind in ("usda", "ply", "obj")),
        ]
        expected = {}
        for sim.frame in FRAMES:
            for export in exports:
                export.record(sim)
            x, y, z = sim.positions().T * (1 if up else np.array([[1], [-1], [-1]]))
            expected[sim.frame] = np.column_stack([x, -z, y])  # Blender's z is up
        for export in exports:
            export.save()
        reader = Path(__file__).with_name("blender_reading.py")
        done = subprocess.run(
            [inside / "python", reader, folder], capture_output=True, text=True, timeout=SECONDS
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert_shown(np.load(folder / "shown.npz"), expected)


def assert_shown(shown, expected):
    assert str(shown["version"]).startswith("5.2.3")
    for n, x in expected.items():
        for name in ("cache", "stage", "ply", "obj"):
            np.testing.assert_allclose(shown[f"{name} {n}"], x, atol=1e-5, err_msg=f"{name} {n}")
        if n % 2 == 0:
            np.testing.assert_allclose(shown[f"second {n}"], x, atol=1e-5)
    middle = (expected[2] + expected[4]) / 2
    np.testing.assert_allclose(shown["second 3"], middle, atol=1e-5)
