"""Spawning, growth, fracture, the pointer, the two paths, the watchdog."""

import copy
import gc
import pickle
import signal
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from inside import fields_of, room_for_clicks, state_of
from selection import as_thorough, mostly_thorough

from taichi_cloth import runtime
from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.kernels.forces.blow import REACH, STRENGTH
from taichi_cloth.kernels.state import State
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import (
    ParticleDefaults,
    Particles,
    Scene,
    SpringDefaults,
    Springs,
    World,
)
from taichi_cloth.simulation import interrupts
from taichi_cloth.simulation.acts import Listener
from taichi_cloth.simulation.interrupts import HeldBack
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.ui.showing import picture

pytestmark = pytest.mark.usefixtures("device", "few_lanes")

SIDES = ("left", "right", "top", "bottom")  # one kind of world, so that simulations are shared


def pull(speed):
    """Two columns of a small grid drawn apart at `speed`: springs whose force may exceed 2.

    The springs between rows, which hold and are at rest, make it a grid. Spring 0 ties particles 0
    and 1, spring 2 the two of the other row.
    """
    world = World(size=(1000.0, 1000.0), gravity=(0.0, 0.0), dt=1.0, walls=SIDES)
    x = [[490.0, 500.0], [500.0, 500.0], [490.0, 510.0], [500.0, 510.0]]
    springs = Springs.build(
        [[0, 1], [0, 2], [2, 3], [1, 3]],
        x,
        stiffness=1.0,
        rest_length=10.0,
        break_force=[2.0, np.inf, 2.0, np.inf],
    )
    v = [[0.0, 0.0], [speed, 0.0]] * 2
    return Scene("pull", world, Particles.build(x, v, mass=[1e6, 1.0] * 2), springs)


def test_another_scene_runs_as_in_a_simulation_of_its_own(some_way):
    """One with fewer features, particles and springs needs no new fields, and no new kernels."""
    cloth = build("cloth", columns=6, rows=5).with_world(mouse="none")
    drop = replace(cloth, particles=Particles.build([[200.0, 20.0]], [[3.0, 0.0]]))
    drop = replace(drop, triangles=cloth.triangles[:0])
    scenes = [build("cloth", columns=5, rows=4).with_world(mouse="none")]
    if some_way["topology"] == "graph":  # there is no grid in a drop
        scenes.append(replace(drop, springs=Springs.none()))
    sim = Simulation(cloth.with_world(mouse="blow"), **some_way)
    sim.advance(3)
    state = state_of(sim)
    for scene in scenes:
        sim.load_scene(scene, 0.5, 3)
        own = Simulation(scene, dt=0.5, substeps=3, **some_way)
        for one in (sim, own):
            one.advance(20)
        np.testing.assert_array_equal(sim.positions(), own.positions())
        np.testing.assert_array_equal(sim.velocities(), own.velocities())
        assert (sim.time, sim.work(), sim.speed_limit) == (own.time, own.work(), own.speed_limit)
        assert sim.began == own.began
        assert state_of(sim) is state
        with pytest.raises(InputError, match="the mouse does not blow here"):
            sim.blow([0.0, 0.0], [1.0, 0.0])
    sim.begin_from(own.start(), 0.25, 2)
    assert sim.began == {"method": "symplectic_euler", "dt": 0.25, "substeps": 2}
    sim.load_scene(build("box"))  # of another dimension
    assert state_of(sim) is not state


@pytest.mark.parametrize("speed", [3.0, -3.0])
def test_a_spring_over_its_limit_acts_once_more_and_is_gone(pool, way, speed):
    sim = pool(pull(speed), **way)
    sim.advance()  # stretched, or squeezed, by 3: force 3 > 2 from here on
    np.testing.assert_array_equal(sim.springs_alive(), [False, True, False, True])
    v = sim.velocities()[1, 0]
    sim.advance()  # it still acts
    assert sim.velocities()[1, 0] == pytest.approx(v - speed, abs=1e-4)
    v = sim.velocities()[1, 0]
    sim.advance(5)  # gone
    assert sim.velocities()[1, 0] == v


# Rest length 10, stiffness 1: (break force, break_in, distance, whether it holds there).
LIMITS = [
    (2.0, "both", 8.0, True),  # at its limit, not over it
    (2.0, "both", 7.999, False),
    (2.0, "tension", 0.001, True),
    (2.0, "tension", 12.001, False),
    (9.99, "both", 0.02, True),
    (9.99, "both", 0.005, False),
    (10.0, "both", 0.005, True),  # no length is short enough
    (np.inf, "both", 0.005, True),
]


@pytest.mark.parametrize(("force", "break_in", "distance", "holds"), LIMITS)
def test_squeezed_springs_break_where_they_may(pool, some_way, force, break_in, distance, holds):
    scene = pull(0.0)
    springs = scene.springs
    springs.break_force[[0, 2]], springs.break_in[[0, 2]] = force, break_in
    scene.particles.position[[0, 2], 0] = 500.0 - distance
    sim = pool(scene, **some_way)
    np.testing.assert_array_equal(sim.springs_alive(), [holds, True, holds, True])
    sim.advance()
    np.testing.assert_array_equal(sim.springs_alive()[0], holds)


def test_spawning_beside_a_breaking_spring_leaves_it_its_last_pull(pool, some_way):
    sim = pool(pull(3.0).with_world(mouse="spawn"), **some_way)
    sim.advance()
    v = sim.velocities()[1, 0]
    sim.spawn((10.0, 10.0))
    sim.advance()
    assert sim.velocities()[1, 0] == pytest.approx(v - 3.0, abs=1e-4)


def test_an_undone_frame_gives_a_breaking_spring_its_last_pull_back(pool, way):
    """A frame fails right after a spring went over its limit; repeated, it must fail the same."""
    scene = pull(3.0)
    scene.springs.stiffness[[0, 2]] = 1e5  # the last pull throws its particle out of the world
    sim = pool(scene, **way)
    sim.advance()
    before = sim.velocities()
    said = []
    for _ in range(2):
        with pytest.raises(SimulationFailure, match="frame 2: .*runs away") as failure:
            sim.advance()
        said.append(str(failure.value))
        assert sim.frame == 1
        np.testing.assert_array_equal(sim.velocities(), before)
    assert said[0] == said[1]


def test_a_spring_at_its_limit_holds(pool, way):
    sim = pool(pull(1.9), **way)
    sim.advance(200)
    assert sim.springs_alive().all()


def test_a_spring_that_starts_over_its_limit_pulls_once(pool, way):
    scene = pull(0.0)
    scene.springs.rest_length[[0, 2]] = 5.0
    sim = pool(scene, **way)
    assert not sim.springs_alive()[0]
    sim.advance(10)
    assert sim.velocities()[1, 0] == pytest.approx(-5.0, abs=1e-3)


@pytest.mark.parametrize(("columns", "rows"), [(16, 12), as_thorough((41, 33))])
def test_the_four_ways_give_the_same_trajectory(pool, columns, rows):
    """One source, two ways to store it and two to run it: equal to the last bit on the CPU."""
    ends = []
    scene = build("cloth", columns=columns, rows=rows)
    for topology in ("lanes", "graph"):
        for execution in ("serial", "parallel"):
            sim = pool(scene, topology=topology, execution=execution)
            for frame in range(60):
                sim.blow((200.0 + 3 * frame, 150.0), (30.0, 10.0))
                sim.advance()
            ends.append((sim.positions(), sim.velocities(), sim.springs_alive()))
    assert not ends[0][2].all()
    for end in ends[1:]:
        for a, b in zip(end, ends[0], strict=True):
            np.testing.assert_array_equal(a, b)


def test_frames_advanced_one_by_one_or_in_one_call_are_the_same(pool, way):
    ends = []
    for batches in ([30], [1] * 30):
        sim = pool(build("cloth"), substeps=3, **way)
        for frames in batches:
            sim.advance(frames)
        ends.append(sim.positions())
        assert (sim.frame, sim.time) == (30, 30.0)
    np.testing.assert_array_equal(*ends)


def slack_grid(x):
    """Springs that hardly pull, and make a grid of the particles at x, in rows of two."""
    between = [[0, 1], [2, 3], [0, 2], [1, 3]]
    return Springs.build(between, np.array(x), stiffness=1e-15)


def test_blow_pushes_by_distance_and_displacement(pool, topology):
    world = World(size=(200.0, 100.0), gravity=(0.0, 0.0), mouse="blow", walls=SIDES)
    x = [[10.0, 50.0], [40.0, 50.0], [100.0, 50.0], [20.0, 50.0]]
    particles = Particles.build(x, fixed=[False, False, False, True], mass=2.0)
    scene = Scene("blow", world, particles, slack_grid(x))
    sim = pool(scene, topology=topology, execution="parallel")
    sim.blow((20.0, 50.0), (3.0, -4.0))
    sim.advance()
    distance = np.array([10.0, 20.0, 80.0])
    force = STRENGTH * np.maximum(REACH - distance, 0)[:, None] * [3.0, -4.0]
    np.testing.assert_allclose(sim.velocities()[:3], force / 2.0, atol=1e-12)
    sim.advance()  # the push lasted one frame
    np.testing.assert_allclose(sim.velocities()[:3], force / 2.0, atol=1e-12)
    assert (sim.velocities()[3] == 0).all()


@pytest.mark.parametrize("topology", ["graph", as_thorough("lanes")])
def test_blow_in_space_reaches_along_the_ray(pool, topology):
    world = World(size=(200.0,) * 3, gravity=(0.0,) * 3, mouse="blow", walls=SIDES)
    x = [[50.0, 50.0, -40.0], [50.0, 60.0, 40.0], [50.0, 100.0, 0.0], [30.0, 50.0, 0.0]]
    scene = Scene("blow", world, Particles.build(x), slack_grid(x))
    sim = pool(scene, topology=topology, execution="parallel")
    sim.blow_ray((50.0, 50.0, -1000.0), (0.0, 0.0, 2.0), (1.0, 0.0, 0.0))
    sim.advance()
    np.testing.assert_allclose(sim.velocities()[:, 0], [0.1, 0.08, 0.0, 0.06], atol=1e-12)


@pytest.mark.parametrize("topology", ["graph", as_thorough("lanes")])
def test_a_blow_of_some_reach_moves_what_has_a_mass_as_the_original_moves_one(pool, topology):
    """A tenth of the pointer's velocity in a frame right under it, none where its reach ends."""
    world = World(size=(4.0,) * 3, gravity=(0.0,) * 3, mouse="blow", up="y", walls=(), dt=1 / 60)
    x = [[2.0, 2.0, -1.0], [2.0, 2.25, 1.0], [2.0, 3.0, 0.0], [1.5, 2.0, 0.0]]
    scene = Scene("blow", world, Particles.build(x, mass=0.003), slack_grid(x))
    sim = pool(scene, topology=topology, execution="parallel")
    sim.blow_ray((2.0, 2.0, 9.0), (0.0, 0.0, -2.0), (0.3, 0.0, 0.0), reach=0.5)
    sim.advance()
    gained = np.array([0.1, 0.05, 0.0, 0.0]) * 0.3 * 60
    np.testing.assert_allclose(sim.velocities()[:, 0], gained, atol=1e-12)
    with pytest.raises(InputError, match="reach must be positive"):
        sim.blow_ray((2.0, 2.0, 9.0), (0.0, 0.0, -2.0), (0.3, 0.0, 0.0), reach=0.0)


def test_a_scene_without_blowing_refuses_the_pointer(pool):
    with pytest.raises(InputError, match="does not blow"):
        pool(build("oscillator")).blow((0, 0), (1, 1))


@pytest.mark.parametrize(
    ("execution", "first_room"),
    mostly_thorough([("serial", 20), ("serial", 4), ("parallel", 4)], default=[("serial", 4)]),
)
def test_spawning_past_the_capacity_loses_nothing(execution, first_room):
    """A sim that had to grow its fields moves on as one that had room from the start."""

    def spawn_all(sim, count):
        rng = np.random.default_rng(0)
        last = None
        for k in range(count):
            x = rng.uniform([40, 40, -200], [560, 360, 200])
            last = sim.spawn(x, rng.uniform(-2, 2, 3), fixed=k % 7 == 0, tied_to=last)
            if k % 3 == 0:
                sim.advance()
        sim.advance(20)
        return sim

    scene = build("box")
    ends = []
    for room in (first_room, 64):
        with room_for_clicks(room):
            ends.append(spawn_all(Simulation(scene, execution=execution), 24))
    grown, roomy = ends
    assert grown.particle_count == 24 and grown.spring_count == 23
    np.testing.assert_array_equal(grown.springs_alive(), roomy.springs_alive())
    # the grid's cells differ with the capacity, and with them the order of a collision's sums
    np.testing.assert_allclose(grown.positions(), roomy.positions(), rtol=0, atol=1e-6)
    np.testing.assert_array_equal(grown.springs(), [[k, k + 1] for k in range(23)])


def test_spawned_springs_break_at_the_scene_default(pool):
    world = World(size=(400.0, 400.0), gravity=(0.0, 0.0), mouse="spawn", walls=SIDES)
    scene = Scene(
        "spawn",
        world,
        Particles.none(2),
        particle_defaults=ParticleDefaults(mass=10.0),
        spring_defaults=SpringDefaults(stiffness=0.01, rest_length=20.0, break_force=2.0),
    )
    sim = pool(scene)
    sim.advance(3)  # nothing there yet: nothing to go wrong
    a = sim.spawn((10.0, 50.0))
    b = sim.spawn((100.0, 50.0), tied_to=a)  # force 0.7
    c = sim.spawn((390.0, 50.0), tied_to=b)  # force 2.7: over the limit at once
    assert (a, b, c) == (0, 1, 2)
    np.testing.assert_array_equal(sim.springs_alive(), [True, False])
    sim.advance()
    np.testing.assert_allclose(sim.velocities()[:, 0], [0.07, -0.07 + 0.27, -0.27], atol=1e-12)
    sim.advance()
    assert sim.velocities()[2, 0] == pytest.approx(-0.27, abs=1e-12)
    sim.reset()
    assert sim.particle_count == 0 and sim.frame == 0

    for break_in, holds in (("both", False), ("tension", True)):
        stiff = SpringDefaults(1.0, rest_length=20.0, break_force=2.0, break_in=break_in)
        sim = pool(replace(scene, spring_defaults=stiff))
        sim.spawn((105.0, 50.0), tied_to=sim.spawn((100.0, 50.0)))
        assert sim.springs_alive().tolist() == [holds]
        sim.spawn((110.0, 50.0))  # the springs are stored anew
        assert sim.springs_alive().tolist() == [holds]


def test_features_that_a_scene_lacks_have_no_fields():
    def fields(scene, topology="graph"):
        return fields_of(Simulation(scene, execution="serial", topology=topology))

    bare = Scene("bare", World((9.0, 9.0), (0.0, 1.0)), Particles.build([[1.0, 1.0]]))
    on_graph, on_grid = (
        {"csr_k", "csr_slot", "status"},
        {"link_k", "ring_forces", "link_status", "breaking"},
    )
    optional = {
        "viscous",
        "push",
        "low",
        "radius",
        "csr_c",
        "jump",
        "sorted",
        "traction",
        "wind",
        "begun_x",
        "obstacle_pose",
        "face",
        "touching",
        "stencil_k",
        *on_graph,
        *on_grid,
    }
    cloth = {"viscous", "push", "low", "radius"}
    assert not optional & fields(bare)
    assert optional & fields(build("cloth")) == cloth | on_graph
    assert optional & fields(build("cloth"), "lanes") == cloth | on_grid
    box = {"viscous", "low", "radius", "jump", "sorted"}
    assert optional & fields(build("box")) == box | on_graph


def test_watchdog_names_particle_frame_and_cause_and_keeps_the_last_good_frame(pool, way):
    scene = build("cloth").with_world(mouse="none")
    scene.particles.velocity[100] = (3.0, 1.0)  # something to amplify
    sim = pool(scene, dt=3.0, **way)
    with pytest.raises(SimulationFailure) as failure:
        sim.advance(500)
    error = failure.value
    assert sim.frame == error.frame - 1 > 1
    assert "stable limit of symplectic_euler" in str(error) and "--substeps" in str(error)
    good, alive = sim.positions(), sim.springs_alive()
    assert np.isfinite(good).all()

    frames = sim.frame
    sim.reset()
    sim.advance(frames)
    np.testing.assert_array_equal(sim.positions(), good)
    np.testing.assert_array_equal(sim.springs_alive(), alive)
    with pytest.raises(SimulationFailure) as second:
        sim.advance()
    assert (second.value.particle, second.value.frame) == (error.particle, error.frame)


def test_an_interrupt_comes_between_two_frames(monkeypatch):
    """It ended `advance` with frames on the device that nobody had counted."""
    scene = build("oscillator")
    straight, sim = (Simulation(scene, topology="graph", execution="serial") for _ in range(2))
    advance, handler = sim._launcher.advance, signal.getsignal(signal.SIGINT)

    def interrupted(*arguments):
        passed = advance(*arguments)
        signal.raise_signal(signal.SIGINT)
        return passed

    straight.advance(3)
    monkeypatch.setattr(sim._launcher, "advance", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sim.advance(3)
    assert sim.frame == 3 and np.array_equal(sim.positions(), straight.positions())
    assert signal.getsignal(signal.SIGINT) is handler
    monkeypatch.undo()
    sim.advance(2)
    straight.advance(2)
    assert sim.frame == 5 and np.array_equal(sim.positions(), straight.positions())


@pytest.mark.parametrize("second", ["SIGINT", "SIGTERM"])
def test_who_interrupts_twice_is_not_held_back(second):
    """Also where a supervisor sends another signal, as the first one did nothing."""
    number, done = getattr(signal, second), []
    was = signal.signal(number, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), HeldBack():
            signal.raise_signal(signal.SIGINT)
            done.append("went on")
            signal.raise_signal(number)
            done.append("and on")
        assert done == ["went on"]
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(number, was)


def test_handlers_are_put_back_also_where_one_of_them_raises_meanwhile(monkeypatch):
    """It may as soon as it is there again: a handler that was left behind heard nothing more."""
    numbers = signal.SIGINT, signal.SIGTERM
    was = [signal.signal(number, signal.default_int_handler) for number in numbers]
    left = ["once"]

    class Raising:
        getsignal = staticmethod(signal.getsignal)

        @staticmethod
        def signal(number, handler):
            if handler is signal.default_int_handler and left:
                left.pop()
                raise KeyboardInterrupt
            return signal.signal(number, handler)

    try:
        monkeypatch.setattr(interrupts, "_signal", Raising)
        with pytest.raises(KeyboardInterrupt), HeldBack():
            pass
        assert not left
        assert [signal.getsignal(n) for n in numbers] == [signal.default_int_handler] * 2
    finally:
        for number, handler in zip(numbers, was, strict=True):
            signal.signal(number, handler)


def test_a_handler_gets_the_frame_and_one_that_was_set_meanwhile_stays():
    frames, was = [], signal.getsignal(signal.SIGINT)
    try:
        signal.signal(signal.SIGINT, lambda number, frame: frames.append(frame.f_code.co_name))
        with HeldBack():
            signal.raise_signal(signal.SIGINT)
            assert not frames
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        assert len(frames) == 1 and signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, was)


def test_an_interrupt_ends_what_takes_long_between_frames():
    """As the error meter of a run without a window, which waits for another process."""
    heard = []

    class Waiting(Listener):
        def after_frame(self):
            signal.raise_signal(signal.SIGINT)
            heard.append("after")

        def between_frames(self):
            heard.append("between")

    sim = Simulation(build("oscillator"), topology="graph", execution="serial")
    sim.listeners = (Waiting(),)
    with pytest.raises(KeyboardInterrupt):
        sim.advance(3)
    assert heard == ["after"] and sim.frame == 1
    sim.listeners = ()


def test_a_failure_goes_from_process_to_process():
    """As an exception of a worker does: one that could not be made again broke the whole pool."""
    failure = SimulationFailure(3, 7, "runs away", "steps too long", "more --substeps")
    for explained in (False, True):
        if explained:
            failure.explain("springs too stiff", "softer springs")
        there = pickle.loads(pickle.dumps(failure))
        assert type(there) is SimulationFailure
        assert str(there) == str(failure)
        assert vars(there) == vars(failure)


def test_watchdog_sees_a_nan_at_once(pool):
    """A force that overflows: inf - inf in the next step. Nothing of it reaches the user."""
    world = World(size=(100.0, 100.0), gravity=(0.0, 0.0), dt=1.0, walls=SIDES)
    x = [[10.0, 10.0], [90.0, 90.0], [50.0, 20.0]]
    springs = Springs.build([[0, 1]], x, stiffness=1e308, rest_length=0.0)
    sim = pool(Scene("huge", world, Particles.build(x), springs))
    with pytest.raises(SimulationFailure, match="frame 1: particle 0 .*not a finite number"):
        sim.advance(5)
    assert sim.frame == 0
    np.testing.assert_array_equal(sim.positions(), x)


def test_who_fails_in_the_first_step_is_named_and_not_whom_a_later_one_loses(pool):
    """Two swings far beyond the limit: that of particle 2 grows faster, so it is lost first."""
    world = World(size=(400.0, 200.0), gravity=(0.0, 0.0), walls=SIDES)
    x = [[50.0, 50.0], [61.0, 50.0], [50.0, 90.0], [61.0, 90.0]]
    springs = Springs.build([[0, 1], [2, 3]], x, stiffness=[40.0, 4e4], rest_length=10.0)
    particles = Particles.build(x, fixed=[False, True, False, True])
    sim = pool(Scene("swings", world, particles, springs), dt=40.0, substeps=40)
    with pytest.raises(SimulationFailure) as failure:
        sim.advance()
    assert failure.value.particle == 2


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"method": "symplectic"}, "did you mean 'symplectic_euler'"),
        ({"dt": 0.0}, "--dt"),
        ({"dt": float("nan")}, "--dt"),
        # Not a frame less than that: where a compiler has it taken for 0, it is.
        ({"dt": 1e-306, "substeps": 1000}, "step of 1e-306 / 1000 is less than 2.23e-308, the le"),
        ({"substeps": 0}, "--substeps"),
        ({"execution": "paralel"}, "did you mean 'parallel'"),
        ({"topology": "graf"}, "did you mean 'graph'"),
        ({"topology": "lanes"}, "--topology lanes: .* scene 'oscillator' form no regular grid"),
    ],
)
def test_wrong_settings_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        Simulation(build("oscillator"), **arguments)


def test_the_arrays_of_a_scene_that_runs_are_read_only():
    """What was written there was in energies, and not in the run, until a reset."""
    x = np.array([[300.0, 100.0], [300.0, 150.0]])
    particles = Particles(**{**vars(Particles.build(x)), "position": x})
    scene = Scene("pair", build("chain").world, particles, Springs.build([[0, 1]], x))
    scene.particles.mass[:] = 2.0  # not yet
    sim = Simulation(scene, topology="graph")
    for array in (scene.particles.position, scene.springs.stiffness, scene.triangles):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0
    assert x.flags.writeable and sim.energy().kinetic == 0
    heavier = replace(particles, mass=2 * particles.mass)
    sim.load_scene(replace(scene, particles=heavier))
    with pytest.raises(ValueError, match="read-only"):
        heavier.mass[:] = 0.0
    assert sim.positions().flags.writeable


@pytest.mark.parametrize("make", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_simulation_is_not_copied(pool, make):
    """A shallow copy shared the state on the device, and counted frames by itself."""
    with pytest.raises(TypeError, match="of 'chain' is on the device, .* `checkpoint"):
        make(pool(build("chain"), topology="graph"))


def test_a_simulation_that_is_gone_gives_its_fields_back(monkeypatch):
    """Taichi has room for 512 trees of fields, two of which a simulation takes."""
    gc.collect()  # of what tests before have left
    freed, free = [], State.free
    monkeypatch.setattr(State, "free", lambda state: freed.append(free(state)))
    for gone in range(2):
        sim = Simulation(build("chain"), topology="graph", execution="serial")
        assert len(freed) == gone
        del sim
        gc.collect()
        assert len(freed) == gone + 1


def test_a_simulation_of_an_earlier_start_is_refused(device, monkeypatch):
    """Its memory is another's by then: to read it, or write to it, ended the process."""
    scene = build("oscillator")
    sim = Simulation(scene, soon=True)
    sim.advance()
    calls = (
        *(sim.advance, sim.reset, sim.positions, sim.forces, sim.energy, sim.checkpoint),
        *(lambda: sim.set(mass=2.0), lambda: sim.set_method("verlet"), lambda: sim.set_step(0.5)),
        *(lambda: sim.load_scene(scene), lambda: picture(sim)),
    )
    monkeypatch.setattr(runtime, "_device", replace(device))  # as another start leaves it
    for call in calls:
        with pytest.raises(InputError, match="'oscillator' is gone with the start of Taichi"):
            call()
    assert repr(sim) == "<Simulation: 'oscillator', gone with the start of Taichi>"
    monkeypatch.undo()
    sim.advance()


def test_a_simulation_is_refused_once_the_program_has_called_ti_init(device, monkeypatch):
    """It ended the process, and a new one computed in the precision of that call."""
    sim = Simulation(build("oscillator"), soon=True)
    reset = runtime._start._replace(program=lambda: None)  # as Taichi's own leaves it
    monkeypatch.setattr(runtime, "_start", reset)
    with pytest.raises(InputError, match="'oscillator' is gone with the start of Taichi"):
        sim.positions()
    with pytest.raises(InputError, match="started anew by ti.init, .* call `start` again"):
        Simulation(build("oscillator"))


def in_another_thread(call):
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(call).result()


def test_another_thread_runs_what_is_there_and_is_refused_what_is_to_be_made():
    """Taichi asserted that it is in its own thread, and left a run without its state, or it ended
    the process where it compiled.
    """
    scene = build("chain")
    sim, straight = (Simulation(scene, topology="graph", execution="serial") for _ in range(2))
    sim.advance(2)
    straight.advance(5)
    for call in (
        lambda: Simulation(scene),
        lambda: sim.set(damping=0.1),
        lambda: sim.set_method("verlet"),
        lambda: sim.load_scene(build("box")),
        lambda: picture(sim),
    ):
        with pytest.raises(InputError, match="compiles in the thread that started it alone"):
            in_another_thread(call)
    in_another_thread(lambda: sim.advance(3))
    assert (sim.frame, sim.method, sim.scene) == (5, "symplectic_euler", scene)
    np.testing.assert_array_equal(in_another_thread(sim.positions), straight.positions())


def test_a_scene_that_is_refused_leaves_the_one_before():
    chain = build("chain")
    springs = replace(chain.springs, stiffness=chain.springs.stiffness * 1e30)
    sim, straight = (Simulation(chain, dt="auto", topology="graph") for _ in range(2))
    sim.advance(2)
    with pytest.raises(InputError, match="--dt auto"):
        sim.load_scene(replace(chain, springs=springs))
    sim.advance()
    straight.advance(3)
    assert (sim.frame, sim.substeps) == (3, straight.substeps) and sim.scene is chain
    np.testing.assert_array_equal(sim.positions(), straight.positions())
