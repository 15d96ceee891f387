"""Settings that are changed while a run goes on: read back, restored, logged, another method."""

from dataclasses import replace

import numpy as np
import pytest
from cloths import cloth
from null_view import NullView
from selection import mostly_thorough, thorough

import taichi_cloth as tc
from taichi_cloth.errors import InputError
from taichi_cloth.files.events import Recorder
from taichi_cloth.kernels import methods
from taichi_cloth.limits.eigenmodes import stable_step
from taichi_cloth.scene.library import build
from taichi_cloth.simulation import live
from taichi_cloth.simulation.running_costs import WARM, FrameCost, RunningCosts
from taichi_cloth.simulation.setting_costs import SettingCosts
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.ui import app, interaction

pytestmark = pytest.mark.usefixtures("device", "few_lanes")

HOW = {"topology": "graph", "execution": "serial"}


def another(setting, now):
    """A value that a setting does not have now, inside its slider."""
    if setting.kind == live.WORD:
        return next(word for word in setting.words if word != now)
    if setting.kind == live.FLAG:
        return not now
    value = setting.low + 0.25 * (setting.high - setting.low)
    if setting.log:
        value = setting.low**0.45 * setting.high**0.55
    return max(int(value), 2) if setting.kind == live.COUNT else value


def state(sim):
    return sim.positions(), sim.velocities(), sim.springs_alive()


def assert_same(one, other):
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


# A plane and a box, ties, a closed form, air with bending, and cloth with a thickness.
SETTABLE = ["cloth", "box", "chain", "oscillator", "flag", "drape"]


@pytest.mark.parametrize("name", mostly_thorough(SETTABLE, ["cloth"]))
def test_every_setting_is_read_back_and_restored(name):
    scene = build(name)
    sim = Simulation(scene, **HOW)
    sim.advance(2)
    settings = live.settings_of(sim)
    assert len({setting.name for setting in settings}) == len(settings)
    for setting in settings:
        assert setting.read(sim) == pytest.approx(setting.own), setting.name
        assert setting.label and setting.help and setting.low < setting.high
        if setting.fixed:
            with pytest.raises(InputError, match="auto"):
                setting.set(sim, another(setting, setting.read(sim)))
            continue
        if setting.name == "collisions":  # compiles, and may push a cloth's particles apart
            continue
        value = another(setting, setting.read(sim))
        if setting.name == "method" and sim.follows:
            value = "implicit_euler"
        frame, x = sim.frame, sim.positions()
        setting.set(sim, value)
        assert live.setting(sim, setting.name).read(sim) == pytest.approx(value), setting.name
        assert sim.frame == frame
        np.testing.assert_array_equal(sim.positions(), x)
        live.setting(sim, setting.name).set(sim, setting.own)
        assert live.setting(sim, setting.name).read(sim) == pytest.approx(setting.own)
    sim.advance(2)


@pytest.mark.parametrize("break_force", [5.0, None])
def test_what_was_clicked_into_an_empty_scene_has_settings(break_force):
    """They read what clicks give, restore that, and cost what settings of other scenes do."""
    scene = build("sandbox")
    ties = replace(scene.spring_defaults, break_force=break_force)
    sim = Simulation(replace(scene, spring_defaults=ties), **HOW)
    assert not {"drag", "stiffness", "fracture"} & {one.label for one in live.settings_of(sim)}
    sim.spawn((100.0, 100.0))
    sim.spawn((120.0, 100.0), tied_to=0)
    costs, known = RunningCosts(), live.settings_of(sim)
    names = {"drag", "stiffness", "damping", "break force", "fracture"}
    assert names <= {one.label for one in known}
    for one in [one for one in known if one.label in names]:
        assert one.read(sim) == one.own and one.low < one.high, one.name
        SettingCosts(sim, costs).of(one, one.read(sim))
        value = another(one, one.own)
        one.set(sim, value)
        assert live.setting(sim, one.name).read(sim) == pytest.approx(value), one.name
        live.setting(sim, one.name).set(sim, one.own)
        assert live.setting(sim, one.name).read(sim) == one.own, one.name
    assert live.setting(sim, "fracture").own == (break_force is not None)
    sim.advance(2)


def test_what_is_refused_leaves_the_run_as_it_was():
    sim = Simulation(cloth(6, 5), **HOW)
    for name, value, says in (
        ("substeps", 0, "--substeps"),
        ("substeps", 1.5, "must be a whole number"),
        ("dt", "auto", "must be a number"),
        ("method", "eulr", "unknown 'eulr'"),
        ("method", 3, "method must be one of explicit_euler, .*, is 3"),
        ("method", None, "method must be one of .*, is None"),
        ("stiffness", -1.0, "must not be negative"),
        ("collisions", 1, "must be true or false"),
        ("sitffness", 1.0, "did you mean 'stiffness'"),
        ("substeps", 10**9, "--substeps must be at most 1000000, is 1000000000"),
        ("dt", 0.0, "--dt must be positive"),
    ):
        with pytest.raises(InputError, match=says):
            live.apply(sim, name, value)
    assert (sim.substeps, sim.dt) == (1, cloth(6, 5).world.dt)
    with pytest.raises(InputError, match="does not take it"):
        sim.set_solver(iterations=3)
    auto = Simulation(cloth(6, 5), dt="auto", **HOW)
    with pytest.raises(InputError, match="unstable on these springs at every step"):
        auto.set_method("explicit_euler")
    assert auto.method == "symplectic_euler"
    auto.advance(3)


def test_settings_of_a_solver_end_where_their_flags_do():
    sim = Simulation(cloth(6, 5), "implicit_euler", **HOW)
    for value in (1.5, 5, np.inf):
        with pytest.raises(InputError, match="--tolerance must be"):
            live.apply(sim, "tolerance", value)
        with pytest.raises(InputError, match="--tolerance must be"):
            sim.set_solver(tolerance=value)
    assert sim.solver == {"tolerance": 1e-6}
    live.apply(sim, "tolerance", 1)
    with pytest.raises(InputError, match="--tolerance must be at most 1, is 2"):
        Simulation(cloth(6, 5), "implicit_euler", tolerance=2, **HOW)
    sweeps = Simulation(cloth(6, 5), "xpbd", **HOW)
    with pytest.raises(InputError, match="--iterations must be at most 1000000"):
        live.apply(sweeps, "iterations", 10**8)
    with pytest.raises(InputError, match="--iterations must be at most 1000000"):
        sweeps.set_solver(iterations=10**8)


def test_stiffness_by_kind_is_that_of_its_links_alone():
    sim = Simulation(cloth(6, 5, ("structural", "shear"), own_numbers=True), **HOW)
    by_name = {setting.name: setting for setting in live.settings_of(sim)}
    assert by_name["stiffness"].unit == live.TIMES
    own = sim.scene.springs.stiffness
    by_name["stiffness.shear"].set(sim, 0.9)
    by_name["stiffness"].set(sim, 2.0)  # of what the scene has, so that nothing adds up
    np.testing.assert_array_equal(sim.storage.scene.springs.stiffness, 2.0 * own)
    assert by_name["stiffness"].read(sim) == 2.0


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("scene", "there"), [(cloth(8, 6), "lanes"), (build("flag", columns=16), "graph")]
)
def test_another_method_has_the_lanes_of_the_first_unless_they_compile_long(scene, there):
    """However they came about: a replay asks for the lanes that its run had chosen by itself."""
    sim = Simulation(scene, topology="lanes", execution="serial")
    sim.set_method("verlet")
    assert sim.topology == there
    sim.set_method("symplectic_euler")
    assert sim.topology == "lanes"


@pytest.mark.thorough
def test_frames_that_a_run_went_back_from_do_not_say_where_a_method_is_stored():
    """As a log that ends before them does not have them, and its replay has the same bits."""
    sim = Simulation(build("warp", side=12), topology="lanes", execution="serial", substeps=8)
    there = sim.checkpoint()
    sim.prepare_balls()
    sim.set_method("verlet")
    assert sim.topology == "graph"
    sim.set_method("symplectic_euler")
    sim.restore(there)
    assert sim.topology_of("verlet") == "lanes"
    sim.set_method("verlet")
    assert sim.topology == "lanes"


@pytest.mark.thorough
def test_a_run_in_sixteen_lanes_goes_on_with_a_method_of_eight():
    scene = build("warp", side=20)
    how = {"topology": "lanes", "execution": "serial", "substeps": 8}
    sim = Simulation(scene, lanes=16, **how)
    sim.set_method("implicit_euler")
    assert (sim.topology, sim.lanes) == ("lanes", 8)
    sim.advance(2)
    other = Simulation(scene, "implicit_euler", lanes=8, **how)
    other.advance(2)
    assert_same(state(sim), state(other))
    sim.set_method("symplectic_euler")
    assert (sim.topology, sim.lanes) == ("lanes", 16)


@pytest.mark.parametrize(
    "method", mostly_thorough([m for m in methods.METHODS if m != "symplectic_euler"], ["verlet"])
)
def test_another_method_goes_on_where_the_first_one_was(method):
    """From a state on it does what a run does that begins with it there; checkpoints lead back."""
    scene = cloth(8, 6, mouse="blow", drag=0.02)
    sim = Simulation(scene, **HOW)
    sim.advance(4)
    there = sim.checkpoint()
    x, v = sim.positions(), sim.velocities()
    sim.advance(3)
    first = state(sim)
    sim.restore(there)
    work = sim.work()
    sim.hold(np.full((sim.particle_count, 2), 0.01))
    sim.set_method(method)
    assert (sim.method, sim.frame, sim.time) == (method, 4, there.time)
    assert_same((x, v), state(sim)[:2])
    sim.advance(3)
    other = Simulation(scene, method, **HOW)
    other.set(positions=x, velocities=v)
    other.hold(np.full((sim.particle_count, 2), 0.01))
    other.advance(3)
    assert_same(state(sim), state(other))
    done = sim.work()
    assert done.steps == 7
    assert done.force_evaluations == work.force_evaluations + other.work().force_evaluations
    sim.restore(there)
    assert sim.method == "symplectic_euler"
    sim.advance(3)
    assert_same(state(sim), first)
    sim.set_method(method)  # whose fields are still there
    sim.restore(there)
    sim.set_method(method)
    sim.hold(np.full((sim.particle_count, 2), 0.01))
    sim.advance(3)
    assert_same(state(sim), state(other))


def test_a_log_of_settings_replays_to_the_same_bits(tmp_path):
    scene = cloth(8, 6, ("structural", "shear"), mouse="blow", break_force=3.0)
    path = tmp_path / "log.jsonl"
    lines = [
        (2, "stiffness", 0.3),
        (3, "gravity.y", -0.02),
        (4, "method", "verlet"),
        (4, "substeps", 3),
        (5, "damping", 0.02),
        (6, "break_force", None),
        (6, "dt", 0.5),
        (7, "fracture", True),
    ]
    with Recorder(path) as recorder:
        for frame, name, value in lines:
            recorder.write(frame, interaction.set_event(name, value))
    sim = Simulation(scene, **HOW)
    for frame in range(10):
        for at, name, value in lines:
            if at == frame:
                live.apply(sim, name, value)
        sim.advance()
    again = Simulation(scene, **HOW)
    copy = tmp_path / "copy.jsonl"
    with Recorder(copy) as recorder:
        replay = tc.load_events(path)
        app.run(
            again, NullView(scene.world), frames=10, replay=replay, recorder=recorder, quiet=True
        )
    assert_same(state(again), state(sim))
    assert again.method == "verlet" and copy.read_text() == path.read_text()


def test_what_a_setting_costs_is_measured_or_predicted_or_said_to_be_unknown():
    sim = Simulation(cloth(8, 6), **HOW)
    costs, by_name = RunningCosts(), {s.name: s for s in live.settings_of(sim)}
    assert costs.now(sim).words() == "not measured"
    assert costs.of(sim, by_name["substeps"], 4).words() == "not measured"
    for _ in range(9):
        costs.note(sim, 2e-3)
    assert costs.now(sim).words() == "2 ms a frame, measured"
    assert FrameCost(1.8612, "measured").words() == "1861 ms a frame, measured"
    assert costs.of(sim, by_name["substeps"], 4).words() == "8 ms a frame, predicted"
    assert costs.of(sim, by_name["gravity.x"], 1.0).how == "measured"
    assert costs.of(sim, by_name["method"], "rk4").how == "predicted"
    assert costs.of(sim, by_name["method"], "rk4").seconds > 2e-3
    assert costs.of(sim, by_name["collisions"], True).how == "predicted"
    breaking = costs.of(sim, by_name["fracture"], True)
    assert breaking.how == "predicted" and 2e-3 < breaking.seconds < 2.1e-3  # 86 springs
    sim.set_step(substeps=4)
    for _ in range(9):
        costs.note(sim, 5e-3)
    sim.set_step(substeps=1)
    assert costs.of(sim, by_name["substeps"], 4).words() == "5 ms a frame, measured"


def test_what_frames_took_on_all_threads_says_nothing_of_them_on_one(pool, monkeypatch):
    """Where a run changes over, the first of which compiles, they are measured anew."""
    sim, costs = pool(build("oscillator")), RunningCosts()
    monkeypatch.setattr(sim, "execution", "parallel")
    for _ in range(2 * WARM):
        costs.note(sim, 0.5)
    monkeypatch.setattr(sim, "execution", "serial")
    costs.note(sim, 15.0)
    assert costs.now(sim).words() == "not measured"
    for _ in range(WARM):
        costs.note(sim, 0.1)
    assert costs.now(sim).words() == "100 ms a frame, measured"


def test_frames_that_are_measured_first_count_alike(pool):
    """A mean of all until frames are many; and none of those that warm up counts."""
    sim, costs = pool(build("oscillator")), RunningCosts()
    for seconds in [9.0] * WARM + [1.0, 3.0, 5.0]:
        costs.note(sim, seconds)
    assert costs.now(sim).seconds == pytest.approx(3.0)


def test_what_stands_beside_a_setting_is_measured_or_predicted_or_of_the_stable_step():
    sim, clock = Simulation(cloth(8, 6, drag=0.02), substeps=2, **HOW), iter(range(0, 10**6, 10**4))
    frames = RunningCosts()
    costs = SettingCosts(sim, frames, clock=lambda: next(clock))

    def beside(name):
        one = live.setting(sim, name)
        return costs.of(one, one.read(sim))

    def run(seconds):
        for _ in range(5):
            frames.note(sim, seconds)
        costs.look()

    costs.look()
    assert (beside("method").words, beside("fracture").words) == ("?", "free")
    run(2e-3)
    sim.advance(3)
    costs.look()
    longest = stable_step(methods.load(sim.method), sim.network()).dt
    assert beside("dt").used == pytest.approx(sim.dt / 2 / longest, rel=0.03)
    assert (beside("method").words, beside("substeps").words) == ("2 ms", "min 1")
    assert "1 ms each, measured" in beside("substeps").said
    assert beside("gravity.x").words == "free"
    before = beside("stiffness").used
    assert before < beside("dt").used and beside("viscous").used > 0
    live.apply(sim, "stiffness", 4.0 * float(sim.scene.springs.stiffness[0]))
    costs.look()
    assert beside("stiffness").used == pytest.approx(2 * before, rel=0.03)
    method = live.setting(sim, "method")
    assert costs.option(method, "rk4").words.startswith("~")
    assert costs.option(method, "implicit_euler").said.endswith("predicted; stable at every step")
    assert int(costs.least("explicit_euler").removeprefix("min ")) > 10
    live.apply(sim, "fracture", True)
    run(3e-3)
    assert beside("fracture").words == "1 ms" and "measured" in beside("fracture").said
    live.apply(sim, "fracture", False)
    run(2e-3)
    assert beside("fracture").said == "off it takes no time; on 1 ms of a frame, measured"
    for on in (False, True):
        live.apply(sim, "fracture", on)
        for _ in range(400):
            frames.note(sim, 1e-4)
    costs.look()
    assert beside("fracture").words == "< 0.01 ms"  # a fiftieth of it counts as none


@thorough
def test_features_go_on_and_off_and_say_whether_they_compile():
    scene = build("drape")
    sim = Simulation(scene, dt="auto", **HOW)
    sim.advance()
    by_name = {setting.name: setting for setting in live.settings_of(sim)}
    assert by_name["self_collision"].read(sim) and by_name["self_collision"].compiles(sim, False)
    assert not by_name["gravity.y"].compiles(sim, -3.0)
    by_name["self_collision"].set(sim, False)
    assert not sim.storage.specialization.thick
    sim.advance(2)
    by_name["self_collision"].set(sim, True)
    assert sim.storage.specialization.thick
    by_name["air"].set(sim, True)
    sim.advance(2)
    by_name["air"].set(sim, False)
    by_name["friction"].set(sim, 0.9)
    assert by_name["friction"].read(sim) == 0.9
    sim.advance(2)
