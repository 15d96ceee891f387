"""Verification, in f64 on the CPU: exact discrete solutions, orders, conservation laws, statics.

What is asked of a method is read from its claims; its exact discrete map stands in `discrete.py`.
"""

import math

import numpy as np
import pytest
from discrete import DISCRETE
from selection import mostly_thorough, thorough

from bench.equal_error.problems import warp
from taichi_cloth.errors import RunFailure, SimulationFailure
from taichi_cloth.kernels import methods
from taichi_cloth.scene import library
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.storage import requirements
from taichi_cloth.trade import ode

pytestmark = pytest.mark.usefixtures("to_run_fast")

every_method = pytest.mark.parametrize("method", methods.METHODS)
SERIAL, GRIDS = ("graph", "serial"), ("lanes", "parallel")
QUICK = "symplectic_euler", "xpbd", "vbd"  # on grids by default, too: each a pattern of its own


def oscillator(k=3.0, m=2.0, x0=0.25):
    """One mass on a spring of rest length 1 to a fixed particle, along x; x0 its extension."""
    world = World(size=(4.0, 1.0), gravity=(0.0, 0.0), dt=0.1)
    x = [[0.0, 0.5], [1.0 + x0, 0.5]]
    particles = Particles.build(x, mass=m, fixed=[True, False])
    springs = Springs.build([[0, 1]], x, stiffness=k, rest_length=1.0)
    return Scene("oscillator", world, particles, springs)


def precisely(method):
    """Settings with which a method that solves for its step leaves nothing but rounding."""
    settings = methods.load(method).claims.settings
    return {name: {"tolerance": 1e-15, "iterations": 30}[name] for name in settings}


PATHS = [(method, path) for method in methods.METHODS for path in ("serial", "parallel")]


@pytest.mark.parametrize(
    ("method", "execution"),
    mostly_thorough(PATHS, default=[p for p in PATHS if p[1] == "serial" or p[0] == QUICK[0]]),
)
def test_oscillator_follows_the_exact_discrete_map(pool, method, execution):
    sim = pool(oscillator(), method, 0.1, execution=execution, **precisely(method))
    sim.advance(100)
    x, v = np.linalg.matrix_power(DISCRETE[method](0.1, 1.5), 100) @ [0.25, 0.0]
    assert sim.positions()[1, 0] - 1.0 == pytest.approx(x, rel=0, abs=1e-12)
    assert sim.velocities()[1, 0] == pytest.approx(v, rel=0, abs=1e-12)


@every_method
def test_order_on_a_linear_chain_is_the_claimed_one(pool, method):
    """Error against the closed form of a normal mode, of position and velocity together."""
    scene = library.build("chain", particles=8, mode=2)
    omega = 2 * math.sqrt(0.1) * math.sin(math.pi * 2 / 18)
    order = methods.load(method).claims.order
    sim = pool(scene, method, dt=5.0 / omega, **precisely(method))
    x, v = (of[0] for of in library.solution("chain")(scene, np.array([5.0 / omega])))

    def error(steps):
        sim.reset()
        sim.set_step(substeps=steps)
        sim.advance(1)
        return np.hypot(
            np.linalg.norm(sim.positions() - x), np.linalg.norm(sim.velocities() - v) / omega
        )

    steps = 2048 >> 3 * order // 2  # fine enough for the leading term, coarse enough for round-off
    measured = math.log2(error(steps) / error(2 * steps))
    assert measured == pytest.approx(order, abs=0.05)


@pytest.fixture(scope="module")
def cloth():
    """An 8 x 8 cloth without contacts, and where it is after 16 frames of 0.5, by DOP853."""
    scene = library.build("cloth", columns=8, rows=8).with_world(mouse="none", walls=())
    return scene, ode.solve(scene, np.linspace(0, 8, 17))


@every_method
def test_order_on_a_nonlinear_cloth_is_the_claimed_one(pool, method, cloth):
    scene, exact = cloth
    order = methods.load(method).claims.order
    sim = pool(scene, method, 8.0, **precisely(method))

    def error(steps):
        sim.reset()
        sim.set_step(substeps=steps)
        sim.advance(1)
        return np.abs(sim.positions() - exact.x[-1]).max()

    steps = 16 * (64 >> order)
    measured = math.log2(error(steps) / error(2 * steps))
    assert measured == pytest.approx(order, abs=0.1)


def test_rk4_reaches_round_off(pool, cloth):
    scene, exact = cloth
    sim = pool(scene, "rk4", 8.0, 4096)
    sim.advance(1)
    error = np.linalg.norm(sim.positions() - exact.x[-1])
    assert error < 1e-13 * np.linalg.norm(exact.x[-1])


WAYS = [(method, *way) for method in methods.METHODS for way in (SERIAL, GRIDS)]


@pytest.mark.parametrize(
    ("method", "topology", "execution"),
    mostly_thorough(WAYS, default=[w for w in WAYS if w[1] == "graph" or w[0] in QUICK]),
)
def test_momentum_of_a_free_cloth_is_kept(pool, method, topology, execution):
    whole = library.build("cloth", columns=8, rows=8, shear=0.2, damping=0.05)
    rng = np.random.default_rng(3)
    velocity = rng.normal(0, 0.5, (64, 2)) + [0.5, -0.25]
    particles = Particles.build(whole.particles.position, velocity, mass=rng.uniform(0.5, 2, 64))
    world = World(size=whole.world.size, gravity=(0.0, 0.0))
    scene = Scene("free", world, particles, whole.springs)
    how = precisely(method)
    if method == "xpbd":  # in every sweep impulses are equal and opposite
        how = {"iterations": 2}
    sim = pool(scene, method, 0.1, topology=topology, execution=execution, **how)
    before, scale = sim.momentum(), (particles.mass[:, None] * np.abs(velocity)).sum()
    sim.advance(100)
    assert np.abs(sim.momentum() - before).max() < 1e-13 * scale


@pytest.mark.parametrize("steps", mostly_thorough([50_000, 1_000_000], default=[50_000]))
def test_symplectic_euler_keeps_its_modified_energy(pool, steps):
    """The quadratic form that the discrete map of an oscillator conserves exactly."""
    h, k, m = 0.1, 3.0, 2.0
    sim = pool(oscillator(k, m), dt=h * 1000, substeps=1000)

    def modified():
        x, v = sim.positions()[1, 0] - 1.0, sim.velocities()[1, 0]
        return 0.5 * m * v * v + 0.5 * k * x * x - 0.5 * h * k * x * v

    start = modified()
    sim.advance(steps // 1000)
    assert sim.steps == steps
    assert modified() == pytest.approx(start, rel=1e-11)


def test_energy_falls_under_implicit_euler(pool):
    scene = library.build("cloth", columns=8, rows=8).with_world(mouse="none", walls=())
    sim = pool(scene, "implicit_euler", 2.0, tolerance=1e-10)
    energies = [sim.energy().total]
    for _ in range(100):
        sim.advance()
        energies.append(sim.energy().total)
    assert (np.diff(energies) < 0).all()
    assert sim.work().unconverged == 0


@thorough
@pytest.mark.parametrize("dim", [2, 3])
def test_blocks_of_stiff_cloth_change_the_sweeps_and_not_the_solution(device, dim, monkeypatch):
    """Against the graph, told that nothing is stiff: the diagonal alone preconditions there."""
    monkeypatch.setattr(requirements, "STIFF_ON_GRAPH", math.inf)
    scene, dt = warp(20, times=100, damped=False), None
    if dim == 2:
        scene = library.build("cloth", columns=21, rows=18, shear=1.0)
        scene, dt = scene.with_world(mouse="none", walls=()), 100.0
    works, at = [], []
    for topology, execution in (SERIAL, GRIDS, ("lanes", "serial")):
        lanes = {"lanes": 2} if topology == "lanes" else {}
        how = {"topology": topology, "execution": execution, **lanes}
        sim = Simulation(scene, "implicit_euler", dt, **how)
        sim.advance(4)
        works.append(sim.work())
        at.append(sim.positions())
    assert not any(work.unconverged for work in works)
    assert works[1].sweeps < works[0].sweeps / 3
    size = np.ptp(at[0], axis=0).max()
    assert at[1] == pytest.approx(at[0], rel=0, abs=1e-5 * size)
    assert works[1] == works[2] and (at[1] == at[2]).all()  # with any number of threads
    sim.reset()  # nothing of what blocks were is left
    sim.advance(4)
    assert (sim.positions() == at[2]).all()


@thorough
@pytest.mark.parametrize(("name", "frames"), [("trampoline", 60), ("shirt", 14)])
@pytest.mark.parametrize("method", ["implicit_euler", "tr_bdf2"])
def test_every_implicit_step_converges_where_cloth_buckles(method, name, frames, device):
    """There the residual has many minima: a step is cut where Newton's method finds none."""
    sim = Simulation(library.build(name), method, execution="serial", soon=True)
    sim.advance(frames)
    work = sim.work()
    assert work.unconverged == 0 and work.force_evaluations < 250 * work.steps


def swung(pool, stiffness, gravity=1.0):
    """A simulation of a chain that starts level, held at one end, after 20 frames."""
    x = np.column_stack([50 + 10 / 3 * np.arange(4), np.full(4, 50.0)])
    particles = Particles.build(x, fixed=np.arange(4) == 0)
    springs = Springs.build([[0, 1], [1, 2], [2, 3]], x, stiffness=stiffness)
    world = World((100.0, 100.0), (0.0, gravity), dt=1 / 60)
    sim = pool(Scene("chain", world, particles, springs), "implicit_euler")
    sim.advance(20)
    return sim


def test_stiff_springs_do_not_hide_gravity_from_implicit_steps(pool):
    """A chain swings alike however stiff it is, or its steps count as unconverged."""
    fall = swung(pool, 1e6).positions()[-1, 1] - 50
    assert fall > 0.05
    for stiffness in (1e11, 1e14):
        assert swung(pool, stiffness).positions()[-1, 1] - 50 == pytest.approx(fall, rel=1e-4)
    for stiffness in (1e23, 1e30):  # residuals are small there, as nothing moves at all
        sim = swung(pool, stiffness)
        with pytest.raises(RunFailure, match="rounding of .* hides gravity.*; remedy: use softer"):
            sim.check_converged()
    sim = swung(pool, 1e12, gravity=0.0)  # nothing to hide: it stays where it is
    assert sim.work().unconverged == 0 and (sim.velocities() == 0).all()


def test_a_hanging_chain_rests_where_statics_says(pool):
    """Each spring carries the weight of what hangs below it: it is longer by that over k."""
    n, k, m, g, rest = 10, 50.0, 0.3, 9.81, 0.5
    x = np.column_stack([np.full(n + 1, 2.0), rest * np.arange(n + 1)])
    particles = Particles.build(x, mass=m, fixed=np.arange(n + 1) == 0)
    springs = Springs.build(
        np.column_stack([np.arange(n), np.arange(1, n + 1)]), x, stiffness=k, rest_length=rest
    )
    world = World(size=(4.0, 20.0), gravity=(0.0, g), dt=10.0)
    sim = pool(Scene("hanging", world, particles, springs), "implicit_euler", tolerance=1e-14)
    sim.advance(400)
    below = m * g * np.arange(n, 0, -1)
    hangs = np.concatenate([[0.0], np.cumsum(rest + below / k)])
    np.testing.assert_allclose(sim.positions()[:, 1], hangs, rtol=0, atol=1e-9)
    np.testing.assert_allclose(sim.positions()[:, 0], 2.0, rtol=0, atol=1e-9)


def test_stability_limit_is_where_it_is_claimed(pool):
    omega = np.sqrt(1.5)
    stable = pool(oscillator(x0=0.01), dt=0.995 * 2 / omega)
    for _ in range(40):  # the exact amplitude is 0.01 / sqrt(1 - 0.995^2)
        stable.advance(501)
        assert np.abs(stable.positions()[1, 0] - 1.0) < 0.101
    with pytest.raises(SimulationFailure, match="stable limit of symplectic_euler"):
        pool(oscillator(), dt=1.01 * 2 / omega).advance(20_000)
