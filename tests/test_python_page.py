"""docs/python.md is true: its pieces of code are one program, which does what the page says."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import taichi_cloth as tc
from taichi_cloth.errors import InputError
from taichi_cloth.scene import scenefile

PAGE = (Path(__file__).parent.parent / "docs" / "python.md").read_text()


def test_the_page_is_one_program(tmp_path):
    """In a process of its own, as `start` is to be the first; it asserts what it claims itself."""
    pieces = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
    assert len(pieces) == 8 and PAGE.count("```") == 2 * len(pieces)
    program = "import matplotlib\n\nmatplotlib.use('agg')\n" + "\n".join(pieces)
    unseen = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=unseen,
        **{"cwd": tmp_path, "capture_output": True, "text": True, "timeout": 300},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    told = re.search(
        r"<Scene: 'banner', 221 particles.*>\n(\d+) steps a frame\n.* at (\d\.\d+) m\n"
        r"<Saved: 'banner', 30 frames of 221 particles>\n.* moved by (\d\.\d+) m\n",
        done.stdout,
    )
    assert told, done.stdout
    assert "60 (720, 960, 3)" in done.stdout  # its window ran without a display
    steps, lowest, way = map(float, told.groups())
    assert steps > 5 and 0.8 < lowest < 1.4 and 0.1 < way < 1.0  # it was blown, and hangs
    assert (tmp_path / "energy.png").stat().st_size > 5000
    saved = tc.load_trajectory(tmp_path / "banner.npz")
    assert saved.frame.tolist() == list(range(2, 61, 2))
    apart = np.linalg.norm(saved.position - [1.5, 1.3, -0.35], axis=2)
    assert apart.min() > 0.25 + 0.005 - 1e-6  # the ball keeps it out, and was met
    assert apart.min() < 0.25 + 0.005 + 1e-3


@pytest.mark.parametrize("dim", [2, 3])
def test_rows_of_a_grid_go_down_where_y_points_up(dim):
    """As in files; without it to larger y, and `down` goes before it."""
    origin = (1.0, 2.0, 0.5)[:dim]
    where = [tc.grid(origin, 3, 4, 0.1, up=up)[0].position for up in ("y", "")]
    for x, sign in zip(where, (-1, 1), strict=True):
        np.testing.assert_allclose(x[:, 1], 2.0 + sign * 0.1 * np.repeat(np.arange(4), 3))
    size = [4.0, 4.0, 4.0][:dim]
    cloth = f"[[cloths]]\norigin = {list(origin)}\ncolumns = 3\nrows = 4\nspacing = 0.1\n"
    file = scenefile.parse(f'[world]\nsize = {size}\nup = "y"\n{cloth}')
    assert (file.particles.position == where[0]).all()
    other = tc.grid(origin, 3, 4, 0.1, up="y", down=(0.0, 1.0, 0.0)[:dim])[0].position
    assert (other == where[1]).all()
    with pytest.raises(InputError, match="grid: up must be 'y', or '' where y points down, is 'z'"):
        tc.grid(origin, 3, 4, 0.1, up="z")


def test_the_package_lists_its_public_names_alone():
    assert dir(tc) == sorted(tc.__all__)
    assert not {"os", "Any", "annotations"} & set(dir(tc)) and "Simulation" in dir(tc)
