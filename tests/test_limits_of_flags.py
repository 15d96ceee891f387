"""The computed limit of velocity Verlet on random flags and sheets, beside their own maps and runs.

They differ in size, pins, wind, gusts, drag, lift, drag of particles, dashpots and bending.
"""

import re

import numpy as np
import pytest

from taichi_cloth.kernels import methods
from taichi_cloth.limits.auto_step import above_limit, above_limit_in_air
from taichi_cloth.limits.eigenmodes import stable_step
from taichi_cloth.limits.matrices import stiffness_and_damping
from taichi_cloth.limits.network import Network
from taichi_cloth.scene import scenefile
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.stability import experiment

VERLET = methods.load("verlet")


def random_flag(seed, most):
    """The text of a scene file: a flag or sheet of at most `most` columns and rows."""
    rng = np.random.default_rng(seed)
    columns, rows = rng.integers(3, most + 1, 2)
    pins = [[0, k] for k in range(rows)] if rng.random() < 0.4 else [[0, 0], [0, int(rows) - 1]]
    if rng.random() < 0.3:
        pins = [[0, 0]]
    down = "[0.0, -1.0, 0.0]" if rng.random() < 0.6 else "[0.0, 0.0, 1.0]"
    world = 'size = [60.0, 60.0, 60.0]\nup = "y"\ngravity = [0.0, -9.81, 0.0]\ndt = 0.016\n'
    if rng.random() < 0.85:
        drag, lift = rng.uniform(0, 2, 2)
        world += f"air = {{ density = {rng.choice([1.2, 12.0])}, drag = {drag}, lift = {lift} }}\n"
        speed, across, gust = rng.uniform(0, 30), rng.uniform(-5, 5), rng.uniform(0, 1)
        wind = f"velocity = [{speed}, 0.0, {across}], gust = {gust}, period = 1.5, seed = 3"
        world += f"wind = {{ {wind} }}\n" if rng.random() < 0.85 else ""
    stretch = 10 ** rng.uniform(0, 4)
    cloth = (
        f"stretch = {stretch}\nshear = {stretch * rng.uniform(0.05, 1)}\n"
        f"density = {10 ** rng.uniform(-1.3, 0)}\n"
    )
    if rng.random() < 0.7:
        cloth += f"bending = {10 ** rng.uniform(-7, -2)}\n"
    kind = rng.random()
    if kind < 0.35:
        cloth += f"damping_time = {10 ** rng.uniform(-5, -2.5)}\n"
    elif kind < 0.55:
        cloth += f"damping = {10 ** rng.uniform(-4, -0.5)}\n"
    viscous = f"viscous = {10 ** rng.uniform(-5, -1)}\n" if rng.random() < 0.4 else ""
    return (
        f"[world]\n{world}[particle]\nmass = {10 ** rng.uniform(-4, -2)}\nradius = 0.005\n"
        f"{viscous}[[cloths]]\norigin = [20.0, 30.0, 2.0]\ncolumns = {columns}\nrows = {rows}\n"
        f"spacing = {10 ** rng.uniform(-2.2, -0.7)}\npinned = {pins}\n"
        f'links = ["structural", "shear"]\nacross = [1.0, 0.0, 0.0]\ndown = {down}\n{cloth}'
    )


@pytest.fixture
def flag(tmp_path):
    """Makes the scene of a random flag."""

    def made(seed, most):
        file = tmp_path / "flag.toml"
        file.write_text(random_flag(seed, most))
        return scenefile.load(file)

    return made


def growth(network, h):
    """The spectral radius of a step of Verlet on positions, velocities and old accelerations.

    In units of time in which the step is 1: else what does not grow is lost in round-off.
    """
    stiffness, damping = (part.toarray() for part in stiffness_and_damping(network))
    one, none = np.eye(len(stiffness)), np.zeros_like(stiffness)
    x = np.hstack([one, one, one / 2])
    a = -h * h * stiffness @ x - h * damping @ np.hstack([none, one, one])
    v = np.hstack([none, one, one / 2]) + a / 2
    return np.abs(np.linalg.eigvals(np.vstack([x, v, a]))).max()


@pytest.mark.parametrize("seed", range(6))
def test_the_limit_is_that_of_the_whole_map_of_a_step(seed, flag):
    """Though K and C have no modes in common: in the wind as it is, and as it is measured.

    What lift gives energy to, where C has a negative eigenvalue, grows at every step by that much.
    """
    scene = flag(seed, 4)
    for network in map(Network.from_scene, (scene, experiment.at_rest(scene))):
        h = stable_step(VERLET, network).dt
        gains = -min(np.linalg.eigvalsh(stiffness_and_damping(network)[1].toarray())[0], 0.0)
        assert growth(network, 0.999 * h) <= 1 + h * gains + 1e-6
        assert growth(network, 1.001 * h) > 1 + h * gains + 1e-5


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(100, 116))
def test_what_runs_measure_is_what_is_computed(seed, flag, device):
    """To a hundredth, of larger ones."""
    scene = experiment.at_rest(flag(seed, 34))
    limit = stable_step(VERLET, Network.from_scene(scene))
    runs, look = experiment.Runs(scene, "verlet"), experiment.Look(steps=3000, times=60)
    assert not runs.is_unstable(0.99 * limit.dt, limit, look)
    assert runs.is_unstable(1.01 * limit.dt, limit, look)


# A light flag of 17 by 11 that begins across a strong wind in gusts.
ACROSS = """[world]
size = [60.0, 60.0, 60.0]
up = "y"
gravity = [0.0, -9.81, 0.0]
dt = 0.016
air = { density = 1.2, drag = 1.5, lift = 0.8 }
wind = { velocity = [2.0, 0.0, 20.0], gust = 0.5, period = 1.5, seed = 3 }
[particle]
mass = 0.001
radius = 0.005
[[cloths]]
origin = [20.0, 30.0, 2.0]
columns = 17
rows = 11
spacing = 0.04
pinned = [[0, 0], [0, 10]]
links = ["structural", "shear"]
across = [1.0, 0.0, 0.0]
down = [0.0, -1.0, 0.0]
stretch = 20.0
shear = 5.0
density = 0.03
"""


@pytest.fixture
def across(tmp_path):
    """The scene of that flag."""
    file = tmp_path / "across.toml"
    file.write_text(ACROSS)
    return scenefile.load(file)


def test_air_alone_is_no_reason_to_warn(across):
    """Its drag fades as cloth goes with the wind; what springs do not bear is warned of."""
    calm = experiment.at_rest(across.with_world(more={}))
    limits = [stable_step(VERLET, Network.from_scene(scene)).dt for scene in (across, calm)]
    assert limits[0] < limits[1] / 3
    for step, warned, noted in (
        (0.99 * limits[0], False, False),
        (1.01 * limits[0], False, True),
        (0.99 * limits[1], False, True),
        (1.01 * limits[1], True, False),
    ):
        assert (above_limit("verlet", across, step, 1) is not None) == warned
        said = above_limit_in_air("verlet", across, step, 1)
        assert (said is not None) == noted
        if noted:
            assert f"is above {limits[0]:.4g}, the limit of verlet by the air's drag" in said
            least = int(re.search(r"--substeps (\d+)", said)[1])
            assert above_limit_in_air("verlet", across, step, least) is None


def test_the_limit_as_triangles_stand_is_beside_that_of_triangles_across(across):
    """Drag as if all stood across the wind bounds it, and verlet counts it twice as much."""
    names = ("verlet", "symplectic_euler")
    bounding = Network.from_scene(experiment.at_rest(across))
    found = experiment.as_it_starts(across, names)
    assert found["verlet"] > 1.2 * stable_step(VERLET, bounding).dt
    for name in names:
        method = methods.load(name)
        assert found[name] == stable_step(method, Network.from_scene(across)).dt


@pytest.mark.thorough
def test_a_run_that_is_only_noted_is_well(across, device):
    """Half as long again as the limit in the strongest wind; as fast as with steps half as long."""
    fastest = []
    for substeps in (31, 62):
        sim = Simulation(across, "verlet", substeps=substeps, execution="serial")
        speeds = []
        for _ in range(40):
            sim.advance(3)
            speeds.append(np.linalg.norm(sim.velocities(), axis=1).max())
        fastest.append(np.max(speeds))
    assert above_limit("verlet", across, 0.016, 31) is None
    assert above_limit_in_air("verlet", across, 0.016, 31) is not None
    assert fastest[0] == pytest.approx(fastest[1], rel=0.25)
