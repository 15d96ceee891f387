"""Largest stable steps: against eigenvalues of real steps, closed forms, and runs; dt auto."""

import csv
import json
import math
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from inside import move_to
from selection import thorough

from taichi_cloth.cli.main import main
from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods
from taichi_cloth.limits import auto_step, modes
from taichi_cloth.limits.auto_step import SubstepController
from taichi_cloth.limits.bounds import (
    AnyGeometry,
    Bounds,
    any_geometry,
    gershgorin,
    gershgorin_here,
    step_within,
)
from taichi_cloth.limits.eigenmodes import Limit, stable_step
from taichi_cloth.limits.holding import EAGER, added_mass, strength
from taichi_cloth.limits.laplacian import Laplacian
from taichi_cloth.limits.matrices import laplacian, stiffness_and_damping
from taichi_cloth.limits.network import Network, Networks
from taichi_cloth.limits.rounding import Stall
from taichi_cloth.limits.rounding import stall as stall_of
from taichi_cloth.limits.tracking import FastestMode
from taichi_cloth.scene.holding import Hold
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import (
    ParticleDefaults,
    Particles,
    Scene,
    SpringDefaults,
    Springs,
    World,
)
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.simulation import diagnosis, diagnostics
from taichi_cloth.simulation.auto_substeps import AutoSubsteps
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.snapshot import Snapshot
from taichi_cloth.stability import experiment, report
from taichi_cloth.sweeps.journal import Journal

LIMITED = [m for m in methods.METHODS if methods.load(m).claims.stability_limit < math.inf]


def tangle(seed=1, damping=0.1, drag=0.2):
    """Particles of all masses at random places, tied at random: no two of its modes are alike.

    Springs are stretched, each differently; drag and dashpots differ, too.
    """
    rng = np.random.default_rng(seed)
    n = 6
    x = rng.uniform(20, 80, (n, 2))
    pairs = [(a, b) for a in range(n) for b in range(a) if a == b + 1 or rng.random() < 0.5]
    s, length = len(pairs), np.array([np.linalg.norm(x[a] - x[b]) for a, b in pairs])
    springs = Springs.build(
        pairs,
        x,
        stiffness=rng.uniform(0.2, 2.0, s),
        rest_length=length * rng.uniform(0.4, 1.0, s),
        damping=damping * rng.random(s),
    )
    particles = Particles.build(
        x, mass=rng.uniform(0.5, 2, n), viscous=drag * rng.random(n), fixed=np.arange(n) == 0
    )
    return Scene("tangle", World((100.0, 100.0), (0.0, 0.1)), particles, springs)


def stretched_cloth(**changes):
    """A small cloth with springs of every kind, drawn out so that they pull across, too."""
    scene = build("cloth", columns=5, rows=4, shear=0.2, bend=0.1, damping=0.02)
    for name, value in changes.items():
        getattr(scene.springs, name)[:] = value
    scene.particles.position[:, 0] *= 1.2
    return scene


def real_growth(sim, scene, force, h, steps=40):
    """The spectral radius of the method's own map of `steps` steps around the scene's start."""
    x0 = scene.particles.position
    free = np.flatnonzero(~scene.particles.fixed)
    epsilon = 1e-6
    columns = []
    for part in range(2):
        for i in free:
            for axis in range(x0.shape[1]):
                ends = []
                for sign in (1, -1):
                    x, v = x0.copy(), np.zeros_like(x0)
                    (x, v)[part][i, axis] += sign * epsilon
                    move_to(sim, "graph", "serial", x, v)
                    sim.hold(force)
                    sim.set_step(h * steps, steps)
                    sim.advance()
                    x, v = sim.positions()[free], sim.velocities()[free]
                    ends.append(np.concatenate([x.ravel(), v.ravel()]))
                columns.append((ends[0] - ends[1]) / (2 * epsilon))
    return np.abs(np.linalg.eigvals(np.array(columns).T)).max() ** (1 / steps)


@pytest.mark.parametrize("method", LIMITED)
def test_the_limit_is_where_the_real_map_of_a_step_begins_to_grow(pool, method):
    """No formula: the method's kernels, disturbed in every direction, with drag and dashpots."""
    scene = experiment.at_rest(tangle())
    limit = stable_step(methods.load(method), Network.from_scene(scene))
    sim = pool(scene, method)
    still = np.zeros_like(scene.particles.position)
    force = -diagnostics.spring_forces(scene.particles.position, still, scene.springs)
    assert real_growth(sim, scene, force, 0.995 * limit.dt) < 1 - 1e-7
    assert real_growth(sim, scene, force, 1.005 * limit.dt) > 1 + 1e-7
    # What it says to a pair of rates, and so to Gershgorin's bounds, is safe.
    bounds = gershgorin(Network.from_scene(scene))
    if method != "explicit_euler":  # whose worst mode is one without damping, if there is one
        assert 0.3 * limit.dt < step_within(methods.load(method), bounds) < limit.dt


@pytest.mark.parametrize("method", LIMITED)
def test_one_mode_agrees_with_the_claims_and_with_the_formulas(method):
    module = methods.load(method)
    claimed = module.claims.stability_limit
    assert modes.largest_step(module, 9.0) == pytest.approx(claimed / 3.0)
    if claimed:
        assert modes.growth(module, (1 - 1e-6) * claimed, 1.0, 0.0) <= 1 + 1e-12
    assert modes.growth(module, 1.001 * claimed + 0.01, 1.0, 0.0) > 1 + 1e-5
    for omega2, d in ((1.0, 0.1), (1.0, 1.0), (0.3, 2.0), (0.0, 1.0)):
        h = modes.largest_step(module, omega2, d)
        if method == "symplectic_euler":
            assert h * h * omega2 + 2 * h * d == pytest.approx(4.0)
        if method == "verlet":  # its drag is that of a predicted velocity
            assert h * h * omega2 + 4 * h * d == pytest.approx(4.0)
        if method == "explicit_euler":
            fast = d / 2 + math.sqrt(max(d * d / 4 - omega2, 0.0))
            exact = d / omega2 if omega2 > d * d / 4 else 2 / fast
            assert h == pytest.approx(exact, rel=1e-6)


def test_limits_of_oscillator_and_chain_are_their_closed_forms():
    oscillator = Network.from_scene(build("oscillator", stiffness=3.0, mass=2.0))
    euler = methods.load("symplectic_euler")
    limit = stable_step(euler, oscillator)
    assert limit.dt == pytest.approx(2 / math.sqrt(1.5), rel=1e-9)
    assert (limit.spring, limit.particle, limit.share) == (0, 1, pytest.approx(1.0))
    for n in (1, 5, 40, 300):
        omega = 2 * math.sqrt(0.7 / 0.3) * math.sin(math.pi * n / (2 * (n + 1)))
        network = Network.from_scene(build("chain", particles=n, stiffness=0.7, mass=0.3))
        found = stable_step(euler, network)
        assert found.dt == pytest.approx(2 / omega, rel=1e-5)
        around = step_within(euler, any_geometry(network))
        assert around == pytest.approx(2 / omega, rel=1e-4)


@pytest.mark.parametrize("seconds", [1e-14, 1e-5, 1e6])
@pytest.mark.parametrize("method", LIMITED)
def test_the_limit_is_as_long_in_every_unit_of_time(method, seconds):
    """Springs between atoms in SI units and ropes in years have that of any others."""
    scene = experiment.at_rest(tangle())
    springs, particles = scene.springs, scene.particles
    other = replace(
        scene,
        springs=replace(
            springs,
            stiffness=springs.stiffness / seconds**2,
            damping=springs.damping / seconds,
            break_force=springs.break_force / seconds**2,
        ),
        particles=replace(particles, viscous=particles.viscous / seconds),
    )
    here, there = (stable_step(methods.load(method), Network.from_scene(s)) for s in (scene, other))
    assert there.dt == pytest.approx(seconds * here.dt, rel=1e-6)
    assert there.spring == here.spring and there.particle == here.particle


def test_bounds_hold_in_every_geometry_and_each_is_closer_than_the_last():
    scene, rng = stretched_cloth(), np.random.default_rng(2)
    euler = methods.load("symplectic_euler")
    start = Network.from_scene(scene)
    rough, close = gershgorin(start), any_geometry(start)
    assert close.omega2 < 0.95 * rough.omega2 and close.damping < rough.damping
    crumpled = scene.particles.position * rng.uniform(0.05, 3.0, scene.particles.position.shape)
    for position in (scene.particles.position, crumpled, rng.normal(0, 50, crumpled.shape)):
        network = Network.from_scene(scene, position)
        for matrix, bound in zip(
            stiffness_and_damping(network), (close.omega2, close.damping), strict=True
        ):
            assert np.linalg.eigvalsh(matrix.toarray())[-1] <= bound * (1 + 1e-9)
        here = gershgorin_here(network)
        own = stable_step(euler, network)
        assert step_within(euler, here) <= own.dt
        assert step_within(euler, close) <= own.dt * (1 + 1e-9)


@pytest.mark.parametrize("name", ["flag", "curtain", "trampoline"])
def test_what_is_kept_from_state_to_state_has_the_bits_of_what_is_made_anew(name):
    """Networks, their Laplacians and bounds, of a cloth that flies and loses springs."""
    scene, random = build(name), np.random.default_rng(3)
    x, holds = scene.particles.position, np.ones(len(scene.springs), bool)
    networks, followed, anew = Networks(), AnyGeometry(), AnyGeometry()
    laplacians, springs = [], None
    for k in range(5):
        x, v = x + 0.01 * random.standard_normal(x.shape), k * random.standard_normal(x.shape)
        if k == 3:
            holds = holds & (random.random(len(holds)) > 0.01)
        kept = networks.of(scene, x, holds, v)
        made = Network.from_scene(scene, x, holds, v)
        assert (kept.springs is springs) == (k not in (0, 3))
        springs = kept.springs
        if k in (0, 3):
            laplacians = [Laplacian(kept, weights) for weights in kept.along_springs]
        for of, weights, air in zip(laplacians, made.along_springs, made.by_triangles, strict=True):
            one, other = of.with_diagonal(air), laplacian(made, weights, air)
            for part in ("data", "indices", "indptr"):
                np.testing.assert_array_equal(getattr(one, part), getattr(other, part))
        assert gershgorin(kept) == gershgorin(made)
        assert gershgorin_here(kept) == gershgorin_here(made)
        assert followed.bounds(kept) == anew.bounds(made)


@pytest.mark.parametrize("method", methods.METHODS)
def test_the_step_within_bounds_is_the_least_of_all_their_modes(method):
    module, random = methods.load(method), np.random.default_rng(4)
    for _ in range(40):
        omega2, damping = 10 ** random.uniform(-3, [9, 6])
        damping *= random.random() > 0.1
        least = damping * random.random() * (random.random() > 0.5)
        pairs = [(0.0, damping)] + [(omega2, d) for d in np.linspace(least, damping, 5)]
        steps = [modes.largest_step(module, *pair) for pair in pairs]
        assert step_within(module, Bounds(omega2, 0, damping, 0, least)) == min(steps)


def test_the_matrices_are_the_derivatives_of_the_force_and_the_force_that_of_the_energy():
    scene = stretched_cloth()
    springs, particles = scene.springs, scene.particles
    springs.rest_length[:] *= 0.5  # none is compressed, where the Hessian is clamped
    x, v = particles.position, np.random.default_rng(0).normal(0, 1, particles.position.shape)
    free = ~particles.fixed

    def forces(direction, h):
        moved = diagnostics.spring_forces(x + h * direction, 0 * v, springs)
        return moved[free].ravel()

    def energy(direction, h):
        pulling = np.ones(len(springs), bool)
        return diagnostics.energy(scene, x + h * direction, 0 * v, pulling).elastic

    direction = np.where(free[:, None], v, 0.0)
    stiffness, damping = stiffness_and_damping(Network.from_scene(scene))  # masses are 1
    slope = (forces(direction, 1e-4) - forces(direction, -1e-4)) / 2e-4
    np.testing.assert_allclose(slope, -stiffness @ direction[free].ravel(), rtol=0, atol=1e-6)
    work = (energy(direction, 1e-4) - energy(direction, -1e-4)) / 2e-4
    assert work == pytest.approx(-(forces(direction, 0) @ direction[free].ravel()), rel=1e-6)
    drag = particles.viscous[free, None] * direction[free]
    dashpots = diagnostics.spring_forces(x, direction, springs) - diagnostics.spring_forces(
        x, 0 * v, springs
    )
    expected = damping @ direction[free].ravel()
    np.testing.assert_allclose((drag - dashpots[free]).ravel(), expected, rtol=0, atol=1e-12)


def test_the_spring_responsible_is_the_one_that_is_stiff():
    scene = stretched_cloth()
    scene.springs.stiffness[17] = 200.0
    euler, network = methods.load("symplectic_euler"), Network.from_scene(scene)
    limit = stable_step(euler, network)
    assert limit.spring == 17 and limit.share > 0.9
    assert limit.ends == tuple(scene.springs.between[17])
    holds = np.arange(len(scene.springs)) != 17
    rest = Network.from_scene(scene, holds=holds)
    without = stable_step(euler, rest)
    assert without.dt > 5 * limit.dt and without.spring != 17
    # A number counts all springs, those that are gone, too.
    holds[:10] = False
    rest = Network.from_scene(scene, holds=holds)
    named = stable_step(euler, rest)
    assert named.spring >= 10 and named.ends == tuple(scene.springs.between[named.spring])


def test_what_is_left_to_improve_is_told_of_omega():
    """Two swings by themselves, of omega^2 = 1 and 4, and the mode a mixture of both: A u - q u is
    as long as the root of u A A u - q^2, and in parts of q that is twice what omega may be off.
    """
    x = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 5.0], [1.0, 5.0]])
    springs = Springs.build([(0, 1), (2, 3)], x, stiffness=[1.0, 4.0])
    particles = Particles.build(x, fixed=[True, False, True, False], mass=1.0)
    scene = Scene("two", World((40.0, 20.0), gravity=(0.0, 0.0)), particles, springs)
    mode = FastestMode(methods.load("symplectic_euler"))
    found = mode.follow(Network.from_scene(scene), 0.5, 0)
    slow, fast = mode.shares.stiffness  # 1 and 4 times the parts that u has of them
    quotient = slow + fast
    assert 0.1 < fast < 3.9
    left = math.sqrt(1.0 * slow + 4.0 * fast - quotient**2)
    assert found.error == pytest.approx(left / quotient / 2, rel=1e-9)


def test_f32_stalls_where_the_lower_limit_says():
    x, v = np.array([[300.0, 5.0], [20.0, 900.0]]), np.array([[0.01, 0.0], [0.0, 3.0]])
    a = np.array([[0.0, 0.002], [0.01, 0.0]])
    stall = stall_of(x, v, a, np.array([False, False]), 1.0)
    assert (stall.what, stall.particle, stall.value) == ("x", 0, 300.0)
    for factor, moves in ((0.99, False), (1.01, True)):
        place, step = np.float32(stall.value), np.float32(factor * stall.dt * stall.rate)
        assert (place + step != place) == moves
    fast = stall_of(0 * x, v * 1e6, a, np.array([False, True]), 1.0)
    assert (fast.what, fast.particle) == ("v", 0)
    place, step = np.float32(fast.value), fast.rate * fast.dt
    assert place + np.float32(0.99 * step) == place != place + np.float32(1.01 * step)


def test_a_speed_that_a_frame_gives_counts_for_where_positions_stall():
    """At rest, and pulled: x stalls where h a dt is half a unit of the last place of x."""
    x, a = np.array([[1000.0, 0.0]]), np.array([[3.0, 0.0]])
    stall = stall_of(x, 0.0 * x, a, np.zeros(1, bool), 0.5, sums="x")
    assert (stall.what, stall.particle) == ("x", 0)
    assert stall.dt == pytest.approx(2.0 ** (9 - 24) / (3.0 * 0.5))


# --- dt auto ---------------------------------------------------------------------------------


def brittle(pool, method):
    """A small cloth whose spring 5 is stiff, and breaks in the fourth frame or so."""
    scene = build("cloth", columns=5, rows=4)
    scene.springs.stiffness[5], scene.springs.break_force[:] = 40.0, np.inf
    scene.springs.break_force[5] = 30.0
    a, b = scene.springs.between[5]
    scene.particles.velocity[b] = 0.5 * (scene.particles.position[b] - scene.particles.position[a])
    return pool(scene, method, "auto")


def fits(sim):
    """Whether the substeps are the fewest that keep to 0.9 of what holds in every geometry."""
    holds = sim.springs_alive()
    network = Network.from_scene(sim.storage.scene, holds=holds)
    method = methods.load(sim.method)
    limit = 0.9 * step_within(method, any_geometry(network))
    few = sim.substeps == 1 or sim.dt / (sim.substeps - 1) > limit * 0.999
    return few and sim.dt / sim.substeps <= limit * 1.001


@pytest.mark.parametrize("method", ["symplectic_euler", "verlet"])
def test_dt_auto_follows_a_break(pool, method):
    sim = brittle(pool, method)
    chosen, times = [sim.substeps], []
    assert fits(sim) and sim.substeps > 4
    for _ in range(10):
        sim.advance()
        chosen.append(sim.substeps)
        times.append(sim.time)
    assert not sim.springs_alive()[5] and sim.springs_alive().sum() == sim.spring_count - 1
    assert fits(sim) and sim.substeps < chosen[0] / 2
    assert times == [float(k) for k in range(1, 11)]
    assert sim.steps == sum(chosen[:-1])
    ends = sim.positions(), sim.velocities()
    sim.reset()  # the same bits again, in one call
    assert sim.substeps == chosen[0] and sim.time == 0
    sim.advance(10)
    np.testing.assert_array_equal(ends, (sim.positions(), sim.velocities()))
    with pytest.raises(InputError, match="--dt auto"):
        sim.set_step(substeps=3)


def test_what_breaks_in_a_frame_s_last_step_makes_the_frame_after_shorter(pool):
    """A light body between two springs, of which one is pulled apart at many speeds: wherever in a
    frame it breaks, two frames later there are as few substeps as the other one needs.
    """
    x = np.array([[50.0, 50.0], [60.0, 50.0], [70.0, 50.0]])
    both = Springs.build([(0, 1), (1, 2)], x, stiffness=100.0, break_force=[np.inf, 20.0])
    world = World((400.0, 200.0), gravity=(0.0, 0.0))

    def row(speed, springs):
        v = [[0.0, 0.0], [0.0, 0.0], [speed, 0.0]]
        particles = Particles.build(x, v, fixed=[True, False, False], mass=[1.0, 1.0, 1e4])
        return pool(Scene("row", world, particles, springs), dt="auto")

    few, last = row(0.1, both.select(np.array([True, False]))).substeps, 0
    for speed in np.linspace(0.05, 0.2, 60):
        sim = row(speed, both)
        assert sim.substeps > few
        while sim.springs_alive()[1]:
            sim.advance(1)
        last += int(sim.storage.marks()[1, 0] == 1)  # it pulls for a step of the next frame
        sim.advance(2)
        assert sim.substeps == few
    assert last > 0


def sail(x, between, stiffness, density, velocity=None, **particles):
    """A triangle in air, with springs between its corners and other particles."""
    x = np.array(x)
    air = {"air": {"density": density, "drag": 1.0, "lift": 0.0}}
    world = World((40.0,) * 3, gravity=(0.0,) * 3, dt=0.1, up="y", more=air)
    springs = Springs.build(between, x, stiffness=stiffness)
    corners = np.array([[0, 1, 2]])
    return Scene(
        "sail", world, Particles.build(x, velocity, **particles), springs, triangles=corners
    )


def test_a_triangle_that_lost_a_side_is_in_no_wind():
    corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    scene = sail(corners, [(0, 1), (1, 2), (0, 2)], 1.0, 2.0, [[0.0, 0.0, 3.0]] * 3)
    assert Network.from_scene(scene, holds=np.ones(3, bool)).by_triangles[1].min() > 0
    for torn in ~np.eye(3, dtype=bool):
        assert not Network.from_scene(scene, holds=torn).by_triangles[1].any()


def test_substeps_in_motion_are_those_of_twice_the_speed():
    """Air damps in proportion to speed, which may double within the frame: what is chosen at v is
    what would be chosen for good at 2 v, and more than at v.
    """
    corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    blown = sail(corners, [(0, 1), (1, 2), (0, 2)], 0.01, 50.0, [[0.0, 0.0, 40.0]] * 3)
    network = Network.from_scene(blown)
    twice = network.moved(network.position, 2.0 * network.velocity)
    euler = methods.load("symplectic_euler")
    in_motion = SubstepController("symplectic_euler", euler, 0.1).choose_in_motion(network)
    here, doubled = (
        SubstepController("symplectic_euler", euler, 0.1).choose(of) for of in (network, twice)
    )
    assert in_motion == doubled > here
    # While it grows faster, what was chosen last is enough until another is: also where air adds to
    # damping alone, beside stiff springs, and to stiffness alone, beside drag.
    ties = [(0, 1), (1, 2), (0, 2)]
    damped = sail(corners, ties, 1e5, 5e3, [[0.0, 0.0, 1.0]] * 3)
    turned = sail(corners, ties, 0.01, 0.03, [[0.0, 0.0, 400.0]] * 3, viscous=150.0)
    for at_first in (network, Network.from_scene(damped), Network.from_scene(turned)):
        kept, controller = 0, SubstepController("symplectic_euler", euler, 0.1)
        chosen = controller.choose_in_motion(at_first)
        for faster in 1.02 ** np.arange(1, 60):
            now = at_first.moved(at_first.position, faster * at_first.velocity)
            before, chosen = chosen, controller.choose_in_motion(now)
            kept += chosen == before
            twice = now.moved(now.position, 2.0 * now.velocity)
            assert 0.1 / chosen <= step_within(euler, any_geometry(twice))
        assert 0 < kept < 59


def test_a_hold_is_like_the_stiffest_spring_and_leaves_the_stable_step_as_it_was():
    scene = tangle(damping=0.0, drag=0.0)
    springs, particles, who = scene.springs, scene.particles, np.array([2, 4])
    network = Network.from_scene(scene)
    stiffness, damping = strength(network, 0.1, who)
    stiffest = [springs.stiffness[(springs.between == n).any(axis=1)].max() for n in who]
    np.testing.assert_array_equal(stiffness, stiffest)
    np.testing.assert_allclose(damping, 2 * np.sqrt(stiffness * particles.mass[who]))  # critical
    alone = network.from_scene(replace(scene, springs=Springs.none()))
    for frame in (0.1, 3.0):  # omega times a frame
        free, _ = strength(alone, frame, who)
        np.testing.assert_allclose(np.sqrt(free / particles.mass[who]) * frame, EAGER)

    method = methods.load("symplectic_euler")
    limit = stable_step(method, network).dt

    def limit_held(added):
        hold = Hold(who, np.zeros((2, 2)), np.zeros(2), stiffness, damping, added)
        mass = particles.mass.copy()
        mass[who] += added
        world = replace(scene.world, tools=True, held=hold)
        held = replace(scene, world=world, particles=replace(particles, mass=mass))
        return stable_step(method, Network.from_scene(held)).dt

    for step in (limit, 0.8 * limit):
        added = added_mass(method, network, step, who, stiffness, damping)
        # (h / 2)^2 K + (h / 2) C <= M is what symplectic Euler needs.
        np.testing.assert_allclose(added, step**2 / 4 * stiffness + step / 2 * damping)
        assert limit_held(added) >= step * (1 - 1e-9) and limit_held(0.0) < limit
    assert not added_mass(method, network, 0.1 * limit, who, stiffness, damping).any()
    implicit = methods.load("implicit_euler")
    assert not added_mass(implicit, network, limit, who, stiffness, damping).any()


def test_what_bounds_cannot_fall_below_is_all_of_them_until_something_breaks():
    """Springs, bending, holds and drag count; with fewer springs it is below their bounds."""
    scene, who, two = tangle(damping=0.3, drag=0.2), np.array([2, 4]), np.zeros((2, 2))
    rows = Stencils.build([[2, 1, 3], [4, 3, 5]], [[-2.0, 1.0, 1.0], [-3.0, 2.0, 1.0]], [0.1, 0.2])
    hold = Hold(who, two, two[0], np.array([0.7, 0.4]), np.array([0.3, 0.1]), np.ones(2))
    world = replace(scene.world, tools=True, held=hold)
    scene = replace(scene, world=world, stencils=rows)
    network, geometry = Network.from_scene(scene), AnyGeometry()
    bounds, least = geometry.bounds(network), geometry.at_least(network)
    assert least.omega2 == pytest.approx(bounds.omega2, rel=1e-9)
    assert least.damping == pytest.approx(bounds.damping, rel=1e-9)
    for broken in range(len(scene.springs)):
        fewer = Network.from_scene(scene, holds=np.arange(len(scene.springs)) != broken)
        less, true = geometry.at_least(fewer), any_geometry(fewer)
        assert less.omega2 <= true.omega2 * (1 + 1e-9) and less.omega2 <= bounds.omega2 * (1 + 1e-9)
        assert less.damping <= true.damping * (1 + 1e-9)


@pytest.mark.parametrize(
    ("stiffness", "density", "damping", "blamed"),
    [
        (0.01, 50.0, 0.0, "the air at the triangles"),
        (4e3, 1e-3, 0.0, "the springs at particle"),
        (4e3, 1e-3, 500.0, "the springs' dashpots"),
    ],
)
def test_a_failure_blames_what_makes_the_step_too_long(stiffness, density, damping, blamed):
    """Air, springs or dashpots, each far stronger than the other two, of a sail in flight."""
    corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    flies = sail(corners, [(0, 1), (1, 2), (0, 2)], stiffness, density, [[0.0, 0.0, 40.0]] * 3)
    flies = replace(flies, springs=replace(flies.springs, damping=np.full(3, damping)))
    still = replace(flies, particles=replace(flies.particles, velocity=np.zeros((3, 3))))
    calm = replace(still, springs=replace(still.springs, stiffness=np.full(3, 1e-3)))
    for start in (flies, replace(calm, springs=replace(calm.springs, damping=np.zeros(3)))):
        cause, remedy = diagnosis.likely_cause(
            start, Network.from_scene(flies), "symplectic_euler", 1.0, 2, "float64", 1e9
        )
        assert blamed in cause and "--substeps" in remedy


@pytest.mark.parametrize(
    ("method", "tolerance", "blamed"),
    [
        ("implicit_midpoint", 1.0, "half solved"),
        ("implicit_midpoint", 0.1, "too large"),
        ("tr_bdf2", 1.0, "too large"),  # whose solutions are never rough
    ],
)
def test_a_failure_blames_a_tolerance_that_is_rough(method, tolerance, blamed):
    """Of methods that no step is too long for."""
    flies = sail([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [(0, 1)], 4.0, 1e-3)
    cause, remedy = diagnosis.likely_cause(
        flies, Network.from_scene(flies), method, 1.0, 1, "float64", 1e9, tolerance
    )
    assert blamed in cause and ("--tolerance 0.1" in remedy) == (blamed == "half solved")


PINNED = sail(
    [
        [0.72, 0.24, 0.11],
        [0.38, 0.36, 0.21],
        [0.24, 0.49, 0.63],
        [0.48, 0.64, 0.82],
        [0.7, 0.45, 0.14],
    ],
    [(2, 0), (3, 1), (3, 2), (4, 0), (4, 1), (4, 3)],
    [5884.0, 57.0, 27.0, 264.0, 626.0, 62.0],
    1e-3,
    mass=[1.64, 0.13, 1.19, 1.67, 8.23],
    fixed=[True, False, True, False, False],
)
HEAVY = sail(
    [[0.96, 0.05, 0.95], [0.26, 0.04, 0.55], [0.72, 0.66, 0.93]],
    [(1, 0), (2, 0), (2, 1)],
    [3054.0, 462.0, 10.0],
    1e-3,
    mass=[2.83, 0.54, 1.64],
    fixed=[False, True, False],
)


@pytest.mark.parametrize(
    ("begun", "change"),
    [
        (PINNED, {"fixed": np.zeros(5, bool)}),
        (HEAVY, {"mass": HEAVY.particles.mass * [1.0, 0.45, 0.631]}),
    ],
    ids=["unpinned", "lighter"],
)
def test_after_a_change_by_hand_nothing_remembered_hides_a_faster_mode(begun, change):
    """In air the last answer stands while rough bounds do, and here they do, though the mode is
    faster with the pins gone or less mass: as many substeps as of a run that begins so.
    """
    edited = replace(begun, particles=replace(begun.particles, **change))
    euler = methods.load("symplectic_euler")
    auto, fresh = (AutoSubsteps("symplectic_euler", euler, 0.1) for _ in range(2))
    now = Snapshot.at_start(begun)
    auto.at_start(now)
    chosen = auto.after_edit(now, replace(now, scene=edited))
    assert chosen == fresh.at_start(Snapshot.at_start(edited))


def clicked(stiffness):
    """An empty scene into which clicks put particles, tied by springs so stiff."""
    world = World((100.0, 100.0), (0.0, 0.1), mouse="spawn")
    defaults = SpringDefaults(stiffness=stiffness, rest_length=10.0, break_force=1e9)
    light = ParticleDefaults(mass=0.5)
    return Scene(
        "spawn", world, Particles.none(2), particle_defaults=light, spring_defaults=defaults
    )


def test_dt_auto_follows_what_is_spawned(pool):
    sim = pool(clicked(5.0), dt="auto")
    assert sim.substeps == 1
    last = sim.spawn((50.0, 20.0), fixed=True)
    for k in range(3):
        last = sim.spawn((50.0, 30.0 + 10.0 * k), tied_to=last)
        sim.advance()
        assert fits(sim)
    assert sim.substeps == math.ceil(math.sqrt(10) * math.sin(math.pi * 5 / 14) / 0.9)
    sim.reset()
    assert sim.substeps == 1


def test_dt_auto_refuses_what_is_too_stiff_and_leaves_all_as_it_was(pool):
    sim = pool(clicked(1e13), dt="auto")
    for x in (20.0, 50.0):
        last = sim.spawn((x, 20.0))
    sim.advance()
    before = sim.particle_count, sim.spring_count, sim.substeps, sim.positions().tolist()
    with pytest.raises(InputError, match="--dt auto: a stable step of symplectic_euler is"):
        sim.spawn((50.0, 80.0), tied_to=last)
    after = sim.particle_count, sim.spring_count, sim.substeps, sim.positions().tolist()
    assert before == after and before[:3] == (2, 0, 1)


def test_dt_auto_is_refused_where_it_cannot_be(device):
    assert main(["run", "cloth", "--dt", "auto", "--substeps", "2"]) == 2
    with pytest.raises(InputError, match="--dt auto chooses them"):
        Simulation(build("chain"), dt="auto", substeps=2)
    with pytest.raises(InputError, match="explicit_euler is unstable on these springs"):
        Simulation(build("chain"), "explicit_euler", dt="auto")
    with pytest.raises(InputError, match="use softer springs or larger masses$"):
        Simulation(build("cloth", stiffness=1e308), "symplectic_euler", dt="auto")


def test_verlet_keeps_its_acceleration_when_the_step_changes(pool):
    """The exact discrete map of an oscillator, with another step in every frame."""
    sim = pool(build("oscillator", stiffness=0.3), "verlet", dt=0.5)
    verlet, state = methods.load("verlet"), np.array([50.0, 0.0, -0.3 * 50.0])
    for k in range(40):
        dt, substeps = 0.3 + 0.05 * (k % 7), 1 + k % 3
        sim.set_step(dt, substeps)
        sim.advance()
        step = verlet.amplification(dt / substeps, 0.3, 0.0)
        state = np.linalg.matrix_power(step, substeps) @ state
    assert sim.positions()[1, 0] - 250.0 == pytest.approx(state[0], abs=1e-10)
    assert sim.velocities()[1, 0] == pytest.approx(state[1], abs=1e-10)


# --- before a run, and the command -----------------------------------------------------------


def test_a_step_above_the_limit_is_warned_of_with_a_remedy_that_helps(pool):
    sim = pool(build("cloth", columns=5, rows=4), dt=3.0)
    said = auto_step.above_limit(sim.method, sim.scene, sim.dt, sim.substeps)
    limit = stable_step(methods.load(sim.method), sim.network())
    assert f"a step of 3 is above {limit.dt:.4g}, the stable limit of symplectic_euler" in said
    assert limit.describe() in said and "--dt auto" in said
    sim.set_step(substeps=int(re.search(r"--substeps (\d+)", said)[1]))
    assert auto_step.above_limit(sim.method, sim.scene, sim.dt, sim.substeps) is None
    sim.set_step(0.999 * limit.dt, 1)
    assert auto_step.above_limit(sim.method, sim.scene, sim.dt, sim.substeps) is None
    sim.set_step(1.001 * limit.dt, 1)
    assert auto_step.above_limit(sim.method, sim.scene, sim.dt, sim.substeps) is not None


def test_run_warns_on_standard_error_and_auto_does_not(cli):
    flags = ["--headless", "--frames", 1, "--execution", "serial"]
    out, err = cli("run", "oscillator", "--dt", 21, *flags)
    (line,) = err.splitlines()
    assert line.startswith("taichi-cloth: warning: a step of 21 is above 20, the stable limit")
    assert "spring 0, between particles 0 and 1" in line and "--substeps 2" in line
    assert cli("run", "oscillator", "--dt", 21, *flags, "--quiet") == ("", "")
    out, err = cli("run", "oscillator", "--stiffness", 20, "--dt", "auto", *flags)
    assert err == "" and "dt 1, 3 substeps" in out


TWO_SPRINGS = """
name = "two"
[world]
size = [100.0, 100.0]
gravity = [0.0, 0.01]
[[particles]]
position = [50.0, 10.0]
fixed = true
[[particles]]
position = [50.0, 20.0]
velocity = [0.0, 6.0]
[[particles]]
position = [50.0, 30.0]
[[springs]]
between = [0, 1]
stiffness = 40.0
break_force = 30.0
[[springs]]
between = [1, 2]
stiffness = 2.0
"""


def test_a_recording_with_dt_auto_replays_to_the_same_bits(cli, tmp_path):
    (tmp_path / "two.toml").write_text(TWO_SPRINGS)
    flags = ["two.toml", "--headless", "--frames", 20, "--execution", "serial"]
    recorded = ["--dt", "auto", "--record", "log.jsonl", "--save", "a.npz"]
    out, _ = cli("run", *flags, *recorded, cwd=tmp_path)
    assert '"dt": "auto"' in (tmp_path / "log.jsonl").read_text()
    replayed = ["--events", "log.jsonl", "--save", "b.npz"]
    assert cli("run", *flags, *replayed, "--quiet", cwd=tmp_path) == ("", "")
    with np.load(tmp_path / "a.npz") as a, np.load(tmp_path / "b.npz") as b:
        for name in a.files:
            np.testing.assert_array_equal(a[name], b[name])
        assert a["time"].tolist() == list(range(1, 21))
        assert a["spring_alive"][-1].tolist() == [False, True]
        last = json.loads(str(a["meta"]))
    first = int(re.search(r"dt 1, (\d+) substeps", out)[1])
    assert last["dt_auto"] and 1 < last["substeps"] < first


@thorough
def test_the_command_finds_the_chain_s_limit_and_writes_its_files(cli, tmp_path):
    out, _ = cli(
        "stability", "chain", "--particles", 5, "--stiffness", 0.7, "--method", "verlet",
        cwd=tmp_path,
    )  # fmt: skip
    folder = tmp_path / "stability-chain"
    assert sorted(p.name for p in folder.iterdir()) == sorted(report.FILES)
    with open(folder / "stability.csv") as file:
        (row,) = csv.DictReader(file)
    exact = 1 / (math.sqrt(0.7) * math.sin(math.pi * 5 / 12))
    assert row["method"] == "verlet" and row["status"] == "measured"
    assert float(row["dt_computed"]) == pytest.approx(exact, rel=1e-6)
    assert float(row["dt_measured"]) == pytest.approx(exact, rel=5e-3)
    assert float(row["dt_gershgorin"]) == pytest.approx(1 / math.sqrt(0.7))
    assert int(row["spring"]) < 6 and f"Spring {row['spring']}, between" in out
    with open(folder / "stability-map.csv") as file:
        points = list(csv.DictReader(file))
    assert {p["map"] for p in points} == {"stiffness", "mass"}
    for p in points:  # whatever is not at the line is on its side of it
        ratio = float(p["dt"]) / float(p["dt_computed"])
        assert 0.98 < ratio < 1.02 or (p["stable"] == "yes") == (ratio < 1)
    assert {p["stable"] for p in points} == {"yes", "no"}
    assert (folder / "stability.png").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (folder / "stability.svg").read_bytes()


def test_a_limit_is_measured_in_every_unit_of_time(tmp_path):
    """Also where 1e-11, which is nothing in seconds, is many times the limit."""
    scene = build("chain", particles=4)
    scene.springs.stiffness[:] /= 1e-14**2
    scene = experiment.at_rest(scene)
    limits = experiment.computed("symplectic_euler", Network.from_scene(scene))
    runs = experiment.Started(scene, "symplectic_euler")
    experiment.measure_limit(runs, limits, lambda *_: None, Journal(tmp_path, {}))
    assert limits.status == "measured"
    assert limits.dt_measured == pytest.approx(limits.limit.dt, rel=5e-3)


def test_files_and_the_table_say_what_was_found(tmp_path, monkeypatch, capsys):
    """Number by number; the first spring and the first particle are ones, too."""
    scene, maps = build("oscillator"), [experiment.Map("verlet", "mass", [0.5, 2.0], [0.3, 0.6])]
    maps[0].points += [(2.0, 0.5, True), (0.5, 0.5, False)]
    spring = Limit(0.5, 9.0, 0.25, spring=0, ends=(0, 1), share=0.75, particle=0)
    limits = [
        experiment.StepLimits("verlet", 0.4, 0.45, spring, 0.51, 7, 700, "measured"),
        experiment.StepLimits("rk4", 0.1, 0.15, Limit(0.2, particle=1), None, 1, 20, "too slow"),
        experiment.StepLimits("bdf9", 0.0, math.inf, Limit(0.0), 0.0, 1, 1, "measured"),
    ]
    stalled = Stall(1e-5, "x", 0, 300.0, 0.5)
    report.write(tmp_path, scene, limits, maps, stalled)
    with open(tmp_path / "stability.csv") as file:
        rows = list(csv.DictReader(file))
    told = {
        "scene": "oscillator", "method": "verlet", "dt_gershgorin": "0.4",
        "dt_any_geometry": "0.45", "dt_computed": "0.5", "dt_measured": "0.51",
        "status": "measured", "omega": "3.0", "damping_rate": "0.25", "spring": "0",
        "spring_from": "0", "spring_to": "1", "spring_share": "0.75", "particle": "0",
        "dt_f32_stall": "1e-05", "f32_stall": "x of particle 0: 300, speed 0.5", "runs": "7",
        "steps": "700",
    }  # fmt: skip
    assert rows[0] == told
    for row, measured, particle in zip(rows[1:], ("", "0.0"), ("1", ""), strict=True):
        assert row["spring"] == row["spring_from"] == row["spring_to"] == ""
        assert (row["dt_measured"], row["particle"]) == (measured, particle)
    with open(tmp_path / "stability-map.csv") as file:
        assert [",".join(row.values()) for row in csv.DictReader(file)] == [
            "verlet,mass,2.0,0.5,yes,0.6",
            "verlet,mass,0.5,0.5,no,0.3",
        ]

    monkeypatch.setenv("COLUMNS", "200")
    report.show(scene, limits, stalled, all_methods=True)
    out = capsys.readouterr().out
    lines = [" ".join(re.findall(r"[^\s\u2500-\u257f]+", line)) for line in out.splitlines()]
    for line in (
        "verlet 0.4 0.45 0.5 0.51 +2.00 % spring 0",
        "rk4 0.1 0.15 0.2 - the drag on particle 1",
        "bdf9 none every none none nothing",
        "Spring 0, between particles 0 and 1.",
        "rk4: too slow",
        "The scene's frame is 1; --dt auto stays below 0.9 of 'any geometry'.",
        "f32 stalls below a step of 1e-05 (x of particle 0: 300, speed 0.5).",
    ):
        assert lines.count(line) == 1, out
    assert any(line.startswith("Stable at every step: implicit_euler") for line in lines)
    assert not any(line.startswith(("verlet:", "Left out")) for line in lines)
    report.show(scene, limits[1:], Stall(0.0, "x", -1, 0.0, 0.0), all_methods=False)
    out = capsys.readouterr().out
    assert "f32 stalls nowhere.\n" in out and "Stable at" not in out and "Spring" not in out


def test_a_title_is_no_formula(tmp_path):
    """A scene may be called anything, and all has been measured by the time it is drawn."""
    scene = replace(build("oscillator"), name="$\\x$ \0")
    limits = [experiment.computed("verlet", Network.from_scene(scene))]
    for maps in ([], [experiment.Map("verlet", "mass", [1.0], [1.0], [(1.0, 1.0, True)])]):
        report.write(tmp_path, scene, limits, maps, experiment.stall(scene))
        assert ElementTree.parse(tmp_path / "stability.svg").getroot().tag.endswith("svg")
        (row,) = csv.DictReader((tmp_path / "stability.csv").open())
        assert row["scene"] == "$\\x$ \\x00"  # Python 3.10 writes no NUL


def test_the_command_refuses_what_it_cannot_do(tmp_path, capsys):
    (tmp_path / "file").touch()
    for arguments, message in (
        (["--method", "verlett"], "did you mean 'verlet'"),
        (["--output", tmp_path / "file"], "cannot be made"),
        (["--steps", "3"], "unknown flag '--steps'"),
        (
            ["--stiffness", "1e308"],
            "the fastest rate is 1e+154, and the most is 1e+150; use softer",
        ),
    ):
        assert main(["stability", "oscillator", *map(str, arguments)]) == 2
        err = capsys.readouterr().err
        assert message in err and len(err.splitlines()) == 1
