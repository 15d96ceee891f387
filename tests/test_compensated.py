"""Compensated sums in f32: as good as f64 to 1e-7, however short the steps; plain f32 beside it."""

import numpy as np
import pytest
from selection import as_thorough, mostly_thorough, thorough
from short_steps import COARSE, FINE, ends

from taichi_cloth import runtime
from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods

EXPLICIT = [name for name in methods.METHODS if not methods.load(name).claims.settings]
WAYS = [(t, e) for t in ("lanes", "graph") for e in ("serial", "parallel")]
CASES = [
    *(("oscillator", method, "graph", "serial") for method in EXPLICIT),
    ("chain", "symplectic_euler", "graph", "serial"),
    *(("cloth", "symplectic_euler", *way) for way in WAYS),
    ("cloth", "rk4", "lanes", "parallel"),  # stages with low parts of their own, read by neighbours
]


def error(one, other):
    """Largest distance of a particle, relative to how far positions reach."""
    one, other = np.array(one), np.array(other)
    return np.abs(one - other).max() / np.abs(other).max()


def errors(case, found, exact):
    """That of the coarse and that of the fine steps."""
    names = [" ".join([*case, str(steps)]) for steps in (COARSE, FINE)]
    return [error(found[name], exact[name]) for name in names]


@thorough
def test_errors_stay_below_1e_7_under_32_times_more_steps(pool, cli):
    exact = ends(CASES, pool)
    found = cli.call("short_steps:ends_in", precision="compensated", cases=CASES)
    for case in CASES:
        assert max(errors(case, found, exact)) < 5e-8, case


def test_errors_of_plain_f32_grow_with_the_steps(pool, cli):
    case = ("cloth", "symplectic_euler", "graph", "serial")
    found = cli.call("short_steps:ends_in", precision="f32", cases=[case])
    coarse, fine = errors(case, found, ends([case], pool))
    assert fine > 1e-6 and fine > 5 * coarse


def test_a_frame_that_fails_leaves_no_trace(cli):
    assert cli.call("short_steps:undone")


FALLING = """
[world]
size = [10.0, 10.0]
gravity = [0.0, 9.81]
dt = 0.016
[[particles]]
position = [1.45, 1.45]
"""


def fall(run, folder, precision, substeps, arch="cpu", method="symplectic_euler"):
    """How far a body falls, relative to how far it does. run: does the command."""
    frames = 1
    (folder / "falling.toml").write_text(FALLING)
    flags = ("--headless", "--quiet", "--execution", "parallel" if arch != "cpu" else "serial")
    how = ("--precision", precision, "--arch", arch, "--substeps", substeps, "--frames", frames)
    how += ("--method", method)
    save = ("--save", folder / "falling.npz", "--every", frames)
    run("run", folder / "falling.toml", *flags, *how, *save)
    with np.load(folder / "falling.npz") as file:
        fallen = file["position"][-1, 0, 1] - 1.45
    h, n = 0.016 / substeps, frames * substeps
    claims = methods.load(method).claims
    backward = claims.implicit or claims.symplectic  # velocities at the ends of first-order steps
    steps = n * n if claims.order > 1 else n * (n + 1) if backward else n * (n - 1)
    return fallen / (9.81 * h * h * steps / 2)


@pytest.mark.parametrize(
    ("arch", "substeps"),
    [
        *[("cpu", 256), ("cpu", 1000), ("cpu", 40000)],
        *(as_thorough((driver, 1000)) for driver in ("vulkan", "opengl")),
    ],
)
def test_gravity_does_not_vanish_in_short_steps(arch, substeps, tmp_path, cli_on):
    """Drivers of Vulkan and OpenGL, too, must leave the sums as they are."""
    found = fall(cli_on[arch], tmp_path, "compensated", substeps, arch)
    assert found == pytest.approx(1.0, abs=1e-6)


SOME = ("symplectic_euler", "rk4", "implicit_midpoint", "vbd")


@pytest.mark.parametrize("method", mostly_thorough(methods.METHODS, default=SOME))
def test_gravity_does_not_vanish_under_any_method(method, tmp_path, cli):
    found = fall(cli, tmp_path, "compensated", 4000, method=method)
    assert found == pytest.approx(1.0, abs=2e-6)


def test_gravity_does_vanish_in_plain_f32(tmp_path, cli):
    assert abs(fall(cli, tmp_path, "f32", 40000) - 1.0) > 0.5


AT_A_WALL = """
[world]
size = [10.0, 10.0]
gravity = [{gravity}, 0.0]
dt = 0.016
walls = ["right"]
[particle]
radius = 0.3
restitution = {restitution}
[[particles]]
position = [9.6871, 1.45]
velocity = [{speed}, 0.0]
"""


def at_a_wall(cli, folder, substeps, frames, **numbers):
    """Positions and velocities of a body that comes to a wall on its right."""
    (folder / "wall.toml").write_text(AT_A_WALL.format(**numbers))
    flags = ("--headless", "--quiet", "--execution", "serial", "--precision", "compensated")
    how = ("--frames", frames, "--substeps", substeps, "--save", folder / "wall.npz")
    cli("run", folder / "wall.toml", *flags, *how)
    with np.load(folder / "wall.npz") as file:
        return file["position"][:, 0, 0], file["velocity"][:, 0, 0]


def test_what_a_wall_stops_is_at_the_wall_and_at_rest_to_the_last_bit(tmp_path, cli):
    """No low part is left of the way there, and what a step is too short to show is held."""
    x, v = at_a_wall(cli, tmp_path, 99, 12, gravity=3.0, restitution=0.0, speed=0.0)
    on_its_way = x < 9.7 - 1e-6
    assert on_its_way.any() and (x[on_its_way] != x[on_its_way].astype(np.float32)).any()
    assert set(x[~on_its_way]) == {float(np.float32(10.0) - np.float32(0.3))}
    assert set(v[~on_its_way]) == {0.0} and v[on_its_way].max() > 0.1


def test_what_comes_to_a_wall_bounces_however_short_the_steps(tmp_path, cli):
    """Also where a step takes it less far than rounding leaves of its distance from the wall."""
    x, v = at_a_wall(cli, tmp_path, 30000, 1, gravity=0.0, restitution=1.0, speed=3.0)
    assert v[-1] == -3.0 and x[-1] == pytest.approx(9.7 - (0.048 - 0.0129), abs=1e-5)


def test_fast_math_is_refused():
    with pytest.raises(InputError, match="--fast-math: --precision compensated excludes it"):
        runtime.start("cpu", "compensated", fast_math=True)
