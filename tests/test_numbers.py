"""Scenes at the ends of the numbers: refused, failed by name, or finite and right.

Each scene has units of its own, of length, time and mass, from 1e-60 to 1e60, and some numbers that
are extreme even in these. What comes out is compared with `running_error.Twin`.
"""

import os
import subprocess
import sys
from dataclasses import replace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from pool import Pool
from running_error import Doubt, Twin, calculate_in
from scipy.integrate import solve_ivp
from selection import as_thorough

from taichi_cloth import runtime
from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.limits.auto_step import above_limit
from taichi_cloth.limits.precision import STIFFEST, too_stiff, unresolved
from taichi_cloth.scene import library
from taichi_cloth.scene.model import WALLS, Particles, Scene, Springs, World
from taichi_cloth.simulation.diagnostics import acceleration_at_start
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.trade import ode

FRAMES = 3
# Part of the largest movement that a run may be off without a warning, where rounding adds up.
MOST_OFF = 0.5


def of_size(low, high):
    """Numbers whose logarithms are even between those of `low` and `high`."""
    return st.floats(np.log10(low), np.log10(high)).map(lambda a: 10.0**a)


ENDS = of_size(1e-300, 1e300)
UNITS = st.one_of(st.just(1.0), of_size(1e-4, 1e4), of_size(1e-12, 1e12), of_size(1e-60, 1e60))


@st.composite
def scenes(draw, dim, walls, collisions):
    """(scene, dt, substeps): 1 to 4 particles, 0 to 4 springs."""
    length, time, mass = draw(UNITS), draw(UNITS), draw(UNITS)
    count = draw(st.integers(1, 4))
    rarely = draw(st.integers(0, 2)) == 0  # whether a number may be one of the ends

    def number(low, high, unit, zero=False):
        kinds = [of_size(low, high).map(lambda a: a * unit)] * 6 + [ENDS] * rarely
        return draw(st.one_of(*kinds, *[st.just(0.0)] * (2 * zero)))

    def signed(*about):
        return draw(st.sampled_from([-1.0, 1.0])) * number(*about, zero=True)

    size = [number(1, 100, length) for _ in range(dim)]
    low = [0.0, 0.0, -size[-1] / 2][:dim]
    place = st.one_of(st.floats(0, 1), st.floats(0.4, 0.6))
    x = [[a + b * draw(place) for a, b in zip(low, size, strict=True)] for _ in range(count)]
    speed = length / time
    particles = Particles.build(
        x,
        [[signed(0.01, 30, speed) for _ in range(dim)] for _ in range(count)],
        mass=[number(0.1, 10, mass) for _ in range(count)],
        radius=[number(0.01, 5, length, zero=True) for _ in range(count)],
        viscous=[number(0.01, 1, mass / time, zero=True) for _ in range(count)],
        restitution=[draw(st.floats(0, 1)) for _ in range(count)],
        fixed=[draw(st.integers(0, 3)) == 0 for _ in range(count)],
    )
    pairs = [(a, b) for a in range(count) for b in range(a)]
    chosen = draw(st.lists(st.sampled_from(pairs), max_size=4, unique=True)) if pairs else []
    springs = Springs.none()
    if chosen:
        each = range(len(chosen))
        springs = Springs.build(
            chosen,
            np.array(x),
            stiffness=[number(0.01, 30, mass / time**2, zero=True) for _ in each],
            rest_length=[number(0.1, 50, length, zero=True) for _ in each],
            damping=[number(0.01, 1, mass / time, zero=True) for _ in each],
            break_force=[draw(st.one_of(st.just(np.inf), of_size(1, 1e3))) for _ in each],
        )
    gravity = tuple(signed(0.01, 10, length / time**2) for _ in range(dim))
    world = World(tuple(size), gravity, walls=tuple(walls), collisions=collisions, mouse="blow")
    return (
        Scene("ends", world, particles, springs),
        number(0.01, 0.3, time),
        draw(st.integers(1, 3)),
    )


def run(pool, made, counts):
    """Run a scene in every way that the module's text promises; count what came of it."""
    scene, dt, substeps = made
    try:
        sim = pool(scene, dt=dt, substeps=substeps)
    except InputError as refusal:
        assert "\n" not in str(refusal)
        counts["refused"] += 1
        return
    precision = runtime.current_device().precision
    walls = [WALLS[name] for name in scene.world.walls]
    twin = Twin(scene, sim.dt, sim.substeps, sim.speed_limit, walls)
    compared = twin.sure
    for frame in range(1, FRAMES + 1):
        if compared:
            try:
                twin.frame()
            except Doubt:
                compared = False
        try:
            sim.advance()
        except SimulationFailure as failure:
            counts["failed"] += 1
            assert failure.frame == frame and failure.particle < len(scene.particles)
            assert not compared or failure.particle in twin.suspects, failure
            assert_finite(sim)
            return
        assert not (compared and twin.culprits), f"not noticed: {twin.culprits}"
        assert_finite(sim)
        compared = compared and not twin.suspects
    assert_inside(sim)
    if not compared:
        counts["finite"] += 1
        return
    counts["compared"] += 1
    assert_right(sim, twin, precision)


def assert_finite(sim):
    assert np.isfinite(sim.positions()).all() and np.isfinite(sim.velocities()).all()


def assert_inside(sim):
    """No particle is farther past a wall than its radius, but for rounding."""
    world, particles = sim.scene.world, sim.scene.particles
    x, slack = sim.positions(), 8 * np.finfo(sim.storage.real).eps
    for axis, side in (WALLS[name] for name in world.walls):
        bound = world.high[axis] if side > 0 else world.low[axis]
        beyond = side * (x[:, axis] - bound)
        most = particles.radius + slack * (abs(world.low[axis]) + abs(world.high[axis]))
        assert (beyond <= most * (1 + slack))[~particles.fixed].all()


def assert_right(sim, twin, precision):
    """Within the bound of rounding, which is small beside what moves, or there is a warning."""
    start = sim.scene.particles.position
    for now, exact in ((sim.positions(), twin.x), (sim.velocities(), twin.v)):
        for row, numbers in zip(now, exact, strict=True):
            for value, number in zip(row, numbers, strict=True):
                apart = abs(type(number.value)(float(value)) - number.value)
                assert apart <= number.error, (value, number.value, number.error)
    exact = np.array([[float(n.value) for n in row] for row in twin.x])
    with np.errstate(all="ignore"):
        a = acceleration_at_start(sim.scene)
        free = ~sim.scene.particles.fixed
        moved = np.abs(exact - start)[free].max(initial=0.0)
        off = np.abs(exact - sim.positions())[free].max(initial=0.0)
        off -= np.finfo(sim.storage.real).eps * np.abs(start)[free].max(initial=0.0)
        if off > MOST_OFF * moved:
            warned = unresolved(sim.scene, a, sim.dt, sim.substeps, precision) or above_limit(
                sim.method, sim.scene, sim.dt, sim.substeps
            )
            assert warned, f"off by {off:.3g} of {moved:.3g} without a warning"


BOXED = ("left", "right", "top", "bottom")
KINDS = {  # dimension, walls, collisions
    "springs": (2, (), False),
    "contacts": (2, BOXED, True),
    "springs in 3-D": (3, (), False),
    "contacts in 3-D": (3, (*BOXED, "front", "back"), True),
}


@pytest.mark.parametrize("mass", [1.0, 1e20])
@pytest.mark.parametrize("fixed", [False, True])
def test_a_collision_does_not_depend_on_the_unit_of_mass(pool, mass, fixed):
    """Equal balls exchange their velocities; one that is fixed sends the other back."""
    x = [[40.0, 50.0], [49.0, 50.0]]
    particles = Particles.build(
        x, [[1.0, 0.0], [0.0, 0.0]], mass=mass, radius=5.0, fixed=[False, fixed]
    )
    world = World((100.0, 100.0), (0.0, 0.0), collisions=True)
    sim = pool(Scene("balls", world, particles, Springs.none()), dt=0.1)
    sim.advance()
    after = [[-1.0, 0.0], [0.0, 0.0]] if fixed else [[0.0, 0.0], [1.0, 0.0]]
    assert sim.velocities() == pytest.approx(np.array(after), abs=3e-6)


def test_the_stable_step_of_rates_whose_squares_vanish():
    for drag in (1e-170, 1e-300):
        particles = Particles.build([[1.0, 1.0]], viscous=drag)
        scene = Scene("slow", World((2.0, 2.0), (0.0, 0.0)), particles, Springs.none())
        assert above_limit("symplectic_euler", scene, 1.0, 1) is None
        assert above_limit("symplectic_euler", scene, 1e301, 1)


def test_drag_counts_at_the_start():
    """a = -c v / m, in which steps are measured that rounding must not swallow."""
    particles = Particles.build([[10.0, 10.0]], [[3.0, -2.0]], mass=2.0, viscous=0.5)
    scene = Scene("slowed", World((40.0, 30.0), (0.0, 0.0)), particles)
    np.testing.assert_allclose(acceleration_at_start(scene), [[-0.75, 0.5]])


def test_all_forces_count_at_the_start():
    """Springs, dashpots, drag, gravity, bending and wind: those of the differential equation."""
    scene = library.build("flag", columns=7, wind=6.0)
    rng = np.random.default_rng(2)
    p, springs, stencils = scene.particles, scene.springs, scene.stencils
    moved = replace(
        p,
        position=p.position + rng.uniform(-0.01, 0.01, p.position.shape),
        velocity=rng.uniform(-1.0, 1.0, p.position.shape),
        viscous=rng.uniform(0.1, 0.2, len(p)),
    )
    full = replace(
        scene,
        particles=moved,
        springs=replace(springs, damping=np.full(len(springs), 0.01)),
        stencils=replace(stencils, bending=1e3 * stencils.bending),
    )
    exact = ode.Forces(full).acceleration(moved.position, moved.velocity, 0.0)
    free = ~p.fixed
    found = acceleration_at_start(full)
    np.testing.assert_allclose(found[free], exact[free], rtol=1e-9, atol=1e-9)
    for without in (
        {"stencils": stencils},
        {"springs": springs},
        {"triangles": full.triangles[:0]},
    ):
        less = acceleration_at_start(replace(full, **without))
        assert abs(less - found)[free].max() > 0.1, without.keys()


def test_what_no_precision_can_watch_is_named_so(pool):
    """Squares of speeds and sums of coordinates are watched as numbers of f32."""

    def scene(size, speed):
        particles = Particles.build([[size / 2, size / 2]], [[speed, 0.0]])
        world = World((size, size), (0.0, 0.0), mouse="blow")
        return Scene("vast", world, particles, Springs.none())

    with pytest.raises(
        InputError, match="particle 0: its position is 1e.40 away, beyond the 3.4e.38"
    ):
        pool(scene(1e40, 0.0), dt=1.0)
    sim = pool(scene(1e30, 1e20), dt=1.0)
    with pytest.raises(SimulationFailure, match="has speed 1e.20, and only speeds up to 1.8e.19"):
        sim.advance()


def fuzz(pool, kind, examples):
    """Run so many scenes of a kind; what came of them."""
    calculate_in(np.float64 if runtime.current_device().precision == "f64" else np.float32)
    counts = dict.fromkeys(("refused", "failed", "finite", "compared"), 0)

    @settings(
        max_examples=examples,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(scenes(*KINDS[kind]))
    def check(made):
        run(pool, made, counts)

    check()
    return counts


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(
    ("kind", "examples"),
    [("springs", 30), *(as_thorough((kind, 130)) for kind in KINDS)],
)
def test_scenes_at_the_ends_of_the_numbers(pool, kind, examples):
    counts = fuzz(pool, kind, examples)
    assert counts["compared"] > examples // 20, counts


@pytest.mark.thorough
def test_scenes_at_the_ends_of_f32():
    """The same in f32, in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__], capture_output=True, text=True, env={**os.environ}
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


if __name__ == "__main__":
    runtime.start("cpu", "f32", threads=1)
    shared = Pool()
    for some in KINDS:
        print(some, fuzz(shared, some, 50), flush=True)


def pendulum(stiffness):
    """A mass of 1 on a spring of 1, let go at 45 degrees."""
    angle = np.pi / 4
    x = np.array([[5.0, 5.0, 0.0], [5.0 + np.sin(angle), 5.0 - np.cos(angle), 0.0]])
    world = World((20.0, 20.0, 20.0), (0.0, -9.81, 0.0), dt=1 / 60, up="y")
    ends = Particles.build(x, mass=1.0, radius=0.0, fixed=[True, False])
    return Scene("pendulum", world, ends, Springs.build([[0, 1]], x, stiffness=stiffness))


def test_springs_too_stiff_for_a_precision_are_told_of_and_f64_only_where_it_helps():
    for precision, most in STIFFEST.items():
        for method in ("implicit_midpoint", "tr_bdf2"):
            assert too_stiff(pendulum(0.9 * 9.81 * most), method, precision) is None
            words = too_stiff(pendulum(1.1 * 9.81 * most), method, precision)
            assert words.startswith("spring 0 is so stiff") and f"{method} in {precision}" in words
            assert ("--precision f64" in words) == (precision == "f32")
            assert too_stiff(pendulum(100 * 9.81 * most), "verlet", precision) is None
    hopeless = too_stiff(pendulum(1.1 * 9.81 * STIFFEST["f64"]), "tr_bdf2", "f32")
    assert "f64" not in hopeless and "softer springs" in hopeless
    free = pendulum(1e15).with_world(gravity=(0.0, 0.0, 0.0))
    assert too_stiff(free, "tr_bdf2", "f64") is None


@pytest.mark.thorough
def test_a_pendulum_swings_right_up_to_the_stiffness_that_is_told_of(device):
    """By the pendulum's own equation, two seconds on; well above it, it does not."""
    start, times = [np.pi / 4, 0.0], (0.0, 2.0)
    motion = solve_ivp(
        lambda t, y: [y[1], -9.81 * np.sin(y[0])], times, start, rtol=1e-11, atol=1e-12
    )
    ends = motion.y[0, -1]
    sim, off = None, {}
    for times in (0.1, 10.0, 100.0):
        scene = pendulum(9.81 * times * STIFFEST["f64"])
        sim = sim or Simulation(scene, "implicit_midpoint", substeps=4, topology="graph")
        sim.load_scene(scene)
        sim.advance(120)
        x, y, _ = sim.positions()[1] - sim.positions()[0]
        off[times] = abs(np.arctan2(x, -y) - ends)
    assert off[0.1] < 5e-3 and max(off[10.0], off[100.0]) > 0.02
