"""Which way to run is taken: predicted from the size, corrected by what runs here have cost."""

import json
from types import SimpleNamespace

import pytest
from cloths import assert_same, cloth, motion
from inside import candidates_of, counting_kernels, lose_patience, predict_by
from selection import mostly_thorough

from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods
from taichi_cloth.runtime import Device
from taichi_cloth.scene.library import build
from taichi_cloth.scene.solids import solids
from taichi_cloth.simulation import autotune, compiled, sixteen
from taichi_cloth.simulation.autotune import Choice, Watch
from taichi_cloth.simulation.launch import Launcher
from taichi_cloth.simulation.prediction import Cost, predict, slow_to_compile
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("few_lanes")

WAYS = [f"{t} {path}" for t in ("lanes", "graph") for path in ("serial", "parallel")]
DEVICE = Device("cpu", "f32", 2, True)
SERIAL_HERE = Cost(30e-6, 2e-6)


@pytest.fixture
def empty_cache(monkeypatch, tmp_path):
    """An empty cache folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "taichi-cloth"


def ways_of(scene, method="symplectic_euler", substeps=1, key="k"):
    """The candidates of a scene with a regular grid, without a simulation."""
    declared = methods.load(method)
    return SimpleNamespace(
        scene_name=scene.name,
        key=key,
        paths=("serial", "parallel"),
        substeps=substeps,
        slow_to_compile=slow_to_compile(scene, solids(scene)),
        topologies=lambda: ["lanes", "graph"],
        predict=lambda t, p: predict(scene, declared, DEVICE, t, p),
    )


def chosen(candidates, topology="auto", execution="auto"):
    choice = autotune.choose(topology, execution, candidates)
    return f"{choice.topology} {choice.execution}"


@pytest.mark.parametrize("name", ["flag", "trampoline"])
def test_lanes_that_are_not_worth_compiling_are_asked_for(name, empty_cache):
    """Where faces meet obstacles, or pairs rest; faces of a finer flag are too small to meet it."""
    ways = ways_of(build(name), "rk4", substeps=64)
    assert chosen(ways).startswith("graph")
    assert chosen(ways, "lanes").startswith("lanes")


def test_what_only_particles_touch_is_met_in_lanes(empty_cache):
    ways = ways_of(build("flag", columns=257), "rk4", substeps=64)
    assert chosen(ways) == "lanes parallel"


def test_a_run_starts_in_one_way_and_remembers_what_it_costs(device, empty_cache, monkeypatch):
    ways = counting_kernels(monkeypatch)
    monkeypatch.setattr(Watch, "ENOUGH", 3)
    # So many substeps that they take most of a launch.
    sim = Simulation(build("cloth", columns=4, rows=3), substeps=5000)
    assert ways == []  # nothing is run before the first frame
    with monkeypatch.context() as patch:  # of runs in sixteen lanes nothing is remembered
        patch.setattr(sixteen, "LANES", sim.lanes)
        for _ in range(6):
            sim.advance()
        assert sim.way == f"{sim.execution} {sim.topology} of {sim.lanes}"
    assert sim.way == f"{sim.execution} {sim.topology}"
    assert sim.lanes == (2 if sim.topology == "lanes" else 1)
    assert autotune.measurements() == []
    monkeypatch.setattr(Watch, "ENOUGH", 6)
    for _ in range(6):
        sim.advance()
    assert len(set(ways)) == 1
    (of,) = autotune.measurements()
    assert list(of.costs) == [f"{sim.topology} {sim.execution}"]
    assert of.what == candidates_of(sim).key


@pytest.mark.parametrize("method", methods.METHODS)
def test_the_default_cloth_starts_in_what_compiles_soonest(method, empty_cache):
    assert chosen(ways_of(build("cloth"), method)) == "graph serial"


@pytest.mark.parametrize("method", methods.METHODS)
def test_a_large_cloth_is_run_in_lanes_by_all_threads(method, empty_cache):
    assert chosen(ways_of(build("cloth", columns=256, rows=256), method)) == "lanes parallel"


def test_many_substeps_share_a_launch_and_want_the_faster_step(empty_cache):
    scene = build("cloth")
    assert chosen(ways_of(scene)) == "graph serial"
    assert chosen(ways_of(scene, substeps=64)) == "lanes serial"
    # A solver that takes several launches a step in lanes pays them at each step.
    assert chosen(ways_of(scene, "implicit_euler", substeps=64)).startswith("graph")


@pytest.mark.parametrize("substeps", [4, 16])
def test_a_solver_on_16384_particles_takes_all_threads(substeps, empty_cache):
    """Measured: 1.4 times as fast as one, though threads are woken for each of its launches.

    With fewer particles one thread in lanes is faster, measured: 0.24 ms a step at 64 x 64, where
    the graph takes 0.72 on one.
    """
    scene = build("cloth", columns=128, rows=128)
    assert chosen(ways_of(scene, "implicit_euler", substeps)) == "lanes parallel"
    smaller = build("cloth", columns=64, rows=48)
    assert chosen(ways_of(smaller, "implicit_euler", substeps)) == "lanes serial"


def test_what_a_run_with_substeps_cost_does_not_mislead_one_without(empty_cache):
    """The measured launch would be spread over the substeps, and threads look free."""
    for way, cost in {
        "lanes serial": Cost(40e-6, 0.7e-6),
        "lanes parallel": Cost(100e-6, 0.5e-6),
    }.items():
        watch = Watch(Choice(*way.split(), False, {}), substeps=400)
        watch.lost(1.0, 400, 1.0)  # compiles
        told = [watch.enough(cost.of(400) * (1 + 0.1 * k), 400) for k in range(Watch.ENOUGH)]
        assert told == [False] * (Watch.ENOUGH - 1) + [True]
        measured = watch.cost(cost.launch)
        assert measured.step == pytest.approx(cost.step)
        autotune.remember("k", way, measured)
    of = {m.what: m.costs for m in autotune.measurements()}["k"]
    assert of["lanes parallel"].launch == pytest.approx(100e-6)
    assert chosen(ways_of(build("cloth"), substeps=1), "lanes") == "lanes serial"
    assert chosen(ways_of(build("cloth"), substeps=1000), "lanes") == "lanes parallel"


@pytest.mark.parametrize("launch", [39e-6, 45e-6])  # by two launches without steps
def test_nothing_is_said_of_steps_that_hide_in_a_launch(launch):
    """As nearly free, they would keep a scene from lanes that gain at 64 substeps."""
    watch = Watch(Choice("graph", "serial", False, {}), substeps=1)
    watch.lost(1.0, 1, 1.0)  # compiles
    for _ in range(Watch.ENOUGH):
        watch.enough(42e-6, 1)
    assert watch.cost(launch) is None


def test_one_slow_machine_does_not_change_how_ways_compare(empty_cache):
    scene = build("cloth", columns=128, rows=128)
    for factor in (0.1, 10.0):
        found = predict(scene, methods.load("rk4"), DEVICE, "lanes", "parallel")
        autotune.remember(
            f"{factor}", "lanes parallel", Cost(factor * found.launch, factor * found.step)
        )
        candidates = ways_of(scene, "rk4", key=f"{factor}")
        assert chosen(candidates) == "lanes parallel"
        costs = autotune.expected(candidates, ["lanes", "graph"])
        alone = predict(scene, methods.load("rk4"), DEVICE, "graph", "serial").of(1)
        assert costs["graph serial"].of(1) == pytest.approx(factor * alone)


def test_words_are_honoured(empty_cache):
    candidates = ways_of(build("cloth"))
    for way in WAYS:
        assert chosen(candidates, *way.split()) == way
    with pytest.raises(InputError, match="--execution both"):
        autotune.choose("auto", "both", candidates)


@pytest.mark.parametrize(
    "content",
    [
        "not JSON",
        "[1]",
        '{"KEY": 3}',
        '{"KEY": {"lanes serial": 1e-6, "lanes parallel": 1e-9}}',  # of an earlier version
        '{"KEY": {"lanes serial": [1e-6], "lanes parallel": ["a", 2], "graph serial": [0, 0]}}',
    ],
)
def test_a_cache_of_another_format_is_passed_over(content, empty_cache):
    autotune.remember("k", "graph serial", SERIAL_HERE)
    (key,) = json.loads(autotune.cache_file().read_text())
    autotune.cache_file().write_text(content.replace("KEY", key))
    assert autotune.measurements() == []
    assert chosen(ways_of(build("cloth"))) == "graph serial"
    autotune.remember("k", "graph serial", SERIAL_HERE)
    assert [m.costs for m in autotune.measurements()] == [{"graph serial": SERIAL_HERE}]


def test_measurements_hold_for_one_machine_and_keep_the_least(empty_cache, monkeypatch):
    autotune.remember("k", "graph serial", SERIAL_HERE)
    autotune.remember("k", "graph serial", Cost(90e-6, 9e-6))  # on a busy machine
    assert autotune.measurements()[0].costs == {"graph serial": SERIAL_HERE}
    monkeypatch.setattr("platform.node", lambda: "elsewhere")
    assert autotune.measurements() == []


def test_of_ways_that_are_about_as_fast_the_one_that_starts_soonest_is_chosen():
    seconds = {"graph parallel": 1.0, "graph serial": 1.05, "lanes parallel": 0.95}
    assert autotune.fastest(seconds) == "graph serial"
    assert autotune.fastest(seconds | {"lanes serial": 0.8}) == "lanes serial"
    assert autotune.fastest(seconds | {"graph serial": 1.5}) == "graph parallel"


# --- threads that only wait ------------------------------------------------------------------


def parallel_watch(forced):
    costs = {"serial": Cost(0.0, 1.6e-3), "parallel": Cost(0.0, 1e-3)}
    watch = Watch(Choice("lanes", "parallel", forced, costs), substeps=1)
    watch.lost(2.0, 1, 0.5)  # compiles
    return watch


def launches(watch, seconds, count, had):
    """How many launches of a step there were when one thread was found to do better, or None."""
    return next((k for k in range(count) if watch.lost(seconds, 1, had)), None)


def test_threads_lose_where_they_are_slower_than_one_would_be():
    watch = parallel_watch(False)
    assert launches(watch, 1.3e-3, 1000, 0.8) is None  # a little disturbed
    lost_a_step = 5.5e-3 - 1.6 * 1.3e-3
    # As much as it took to compile, and what is looked at together.
    assert 0 <= launches(watch, 5.5e-3, 2000, 0.6) - 2.0 / lost_a_step <= 2 * 0.3 / 5.5e-3
    assert watch.alone == pytest.approx(1.6 * 1.3e-3)
    assert watch.together == pytest.approx(5.5e-3)


def test_threads_that_have_more_to_do_do_not_lose():
    """Such as contacts after a free fall, where all cores are theirs as they were before."""
    watch = parallel_watch(False)
    assert launches(watch, 1e-3, 1000, 1.0) is None
    assert launches(watch, 9e-3, 1000, 0.97) is None
    assert launches(watch, 18e-3, 1000, 0.7) is None  # alone it would be 14.4 ms: 1.25 times
    assert launches(watch, 20e-3, 3000, 0.7) is not None
    assert watch.alone == pytest.approx(1.6 * 9e-3)


def test_threads_that_were_asked_for_are_said_to_wait_at_once():
    watch = parallel_watch(True)
    assert launches(watch, 1e-3, 400, 1.0) is None
    assert launches(watch, 4e-3, 200, 0.6) is not None


@pytest.mark.parametrize("topology", mostly_thorough(["lanes", "graph"], default=["graph"]))
def test_a_run_whose_threads_only_wait_goes_on_with_one(topology, pool, monkeypatch):
    scene = cloth(9, 7)
    costs = {"serial": Cost(1.0, 1.0), "parallel": Cost(0.5, 0.5)}
    predict_by(monkeypatch, lambda _, path: costs[path])
    monkeypatch.setattr(autotune, "remember", lambda *_: None)
    sim = Simulation(scene, topology=topology)
    assert sim.execution == "parallel"
    lose_patience(monkeypatch, sim)
    sim.advance()
    assert sim.execution == "parallel"  # the first frame compiles
    sim.advance(15)
    assert sim.changes_over  # which a window says before it waits
    sim.advance(14)
    assert sim.execution == "serial" and sim.held_up is None and not sim.changes_over
    now = sim.positions(), sim.velocities(), sim.springs_alive()
    assert_same(now, motion(pool(scene)))


def test_threads_that_were_asked_for_are_kept_and_said_to_wait(pool, monkeypatch):
    sim = pool(cloth(9, 7), execution="parallel")
    with monkeypatch.context() as patch:
        patch.setattr(sim, "held_up", None)
        patch.setattr(sim, "_watch", sim._watch)
        lose_patience(patch, sim)
        sim.advance()
        assert sim.held_up is None
        sim.advance()
        alone, together = sim.held_up
        assert together > 0 and alone > 0 and sim.execution == "parallel"


# --- a word before the silence ---------------------------------------------------------------


def test_compiling_is_told_once_where_no_run_has_compiled(pool, empty_cache, monkeypatch):
    monkeypatch.setattr(compiled, "kernel_cache", lambda: empty_cache)
    sim = pool(cloth(9, 7))
    spec, state = sim.storage.specialization, sim.storage.state
    told = []

    def start(also=0):
        launcher = Launcher(methods.load(sim.method), sim._launcher.device, lambda: told.append(1))
        monkeypatch.setattr("taichi_cloth.simulation.launch.COMPILED", 1e9)
        launcher.expect(spec, state.capacity)
        launcher.expect(spec, state.capacity)
        if also:
            launcher.advance(spec, state, sim.steps, also, 1)
        return len(told)

    assert start() == 1
    assert start(also=1) == 2  # the one before has not come to its first frame
    assert start() == 2
    compiled_folder = autotune.cache_file().parent
    (compiled_folder / "compiled.json").write_text("{}")
    assert start() == 3
