"""Compensated sums in f32: as good as f64 to 1e-7, however short the steps; plain f32 beside it."""

import json
import subprocess
import sys

import numpy as np
import pytest
from conftest import command

from taichi_cloth import runtime
from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.kernels import methods
from taichi_cloth.scene.library import build
from taichi_cloth.simulation.simulation import Simulation

FRAMES, COARSE, FINE = 48, 8, 8 * 32
EXPLICIT = [name for name in methods.METHODS if not methods.load(name).claims.settings]
WAYS = [(t, e) for t in ("lanes", "graph") for e in ("serial", "parallel")]
CASES = [
    *(("oscillator", method, "graph", "serial") for method in EXPLICIT),
    ("chain", "symplectic_euler", "graph", "serial"),
    *(("cloth", "symplectic_euler", *way) for way in WAYS),
    ("cloth", "rk4", "lanes", "parallel"),  # stages with low parts of their own, read by neighbours
]
SCENES = {
    "oscillator": lambda: build("oscillator"),
    "chain": lambda: build("chain"),
    "cloth": lambda: build("cloth", columns=8, rows=6).with_world(mouse="none"),
}


def final(cases):
    """Positions after FRAMES frames of COARSE and of FINE steps, by case."""
    found = {}
    for case in cases:
        scene, method, topology, execution = case
        sim = Simulation(SCENES[scene](), method, topology=topology, execution=execution, lanes=2)
        for substeps in (COARSE, FINE):
            sim.substeps = substeps
            sim.reset()
            sim.advance(FRAMES)
            found[" ".join([*case, str(substeps)])] = sim.positions().tolist()
    return found


def in_another_process(precision, cases):
    """The same there: one process has one precision."""
    done = subprocess.run(
        [sys.executable, __file__, precision, json.dumps(cases)],
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout.splitlines()[-1])


def undone():
    """Whether a frame that fails leaves no trace in a state that f32 alone could not hold."""
    sim = Simulation(SCENES["cloth"](), topology="lanes", execution="serial", lanes=2)
    sim.advance(3)
    before = sim.positions(), sim.velocities()
    sim.speed_limit = 1e-9
    sim.set_step()
    with pytest.raises(SimulationFailure):
        sim.advance()
    after = sim.positions(), sim.velocities()
    assert (before[0] != before[0].astype(np.float32)).mean() > 0.5
    return all((a == b).all() for a, b in zip(before, after, strict=True))


def main(precision, cases):
    runtime.start("cpu", precision, threads=2)
    found = final(json.loads(cases))
    if precision == "compensated":
        found["undone"] = bool(undone())
    print(json.dumps(found))


def error(one, other):
    """Largest distance of a particle, relative to how far positions reach."""
    one, other = np.array(one), np.array(other)
    return np.abs(one - other).max() / np.abs(other).max()


def test_errors_stay_below_1e_7_under_32_times_more_steps(device):
    exact, compensated = final(CASES), in_another_process("compensated", CASES)
    assert compensated["undone"]
    plain = in_another_process("f32", [CASES[-2]])
    for case in CASES:
        coarse, fine = (" ".join([*case, str(steps)]) for steps in (COARSE, FINE))
        errors = [error(compensated[key], exact[key]) for key in (coarse, fine)]
        assert max(errors) < 5e-8, (case, errors)
    errors = [error(plain[key], exact[key]) for key in plain]
    assert len(errors) == 2 and errors[1] > 1e-6 and errors[1] > 5 * errors[0], errors


FALLING = """
[world]
size = [10.0, 10.0]
gravity = [0.0, 9.81]
dt = 0.016
[[particles]]
position = [1.45, 1.45]
"""


def fall(folder, precision, arch, substeps, frames=1, method="symplectic_euler"):
    """How far a body falls, relative to how far it does."""
    (folder / "falling.toml").write_text(FALLING)
    flags = ("--headless", "--quiet", "--execution", "parallel" if arch != "cpu" else "serial")
    how = ("--precision", precision, "--arch", arch, "--substeps", substeps, "--frames", frames)
    how += ("--method", method)
    save = ("--save", folder / "falling.npz", "--every", frames)
    command("run", folder / "falling.toml", *flags, *how, *save)
    with np.load(folder / "falling.npz") as file:
        fallen = file["position"][-1, 0, 1] - 1.45
    h, n = 0.016 / substeps, frames * substeps
    claims = methods.load(method).claims
    backward = claims.implicit or claims.symplectic  # velocities at the ends of first-order steps
    steps = n * n if claims.order > 1 else n * (n + 1) if backward else n * (n - 1)
    return fallen / (9.81 * h * h * steps / 2)


@pytest.mark.parametrize(
    ("arch", "substeps"),
    [("cpu", 256), ("cpu", 1000), ("cpu", 40000), ("vulkan", 1000), ("opengl", 1000)],
)
def test_gravity_does_not_vanish_in_short_steps(arch, substeps, tmp_path, display):
    """Drivers of Vulkan and OpenGL, too, must leave the sums as they are."""
    assert fall(tmp_path, "compensated", arch, substeps) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("method", methods.METHODS)
def test_gravity_does_not_vanish_under_any_method(method, tmp_path):
    assert fall(tmp_path, "compensated", "cpu", 4000, method=method) == pytest.approx(1.0, abs=2e-6)


def test_gravity_does_vanish_in_plain_f32(tmp_path):
    assert abs(fall(tmp_path, "f32", "cpu", 40000) - 1.0) > 0.5


def test_fast_math_is_refused():
    with pytest.raises(InputError, match="--fast-math: --precision compensated excludes it"):
        runtime.start("cpu", "compensated", fast_math=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
