"""Which way to run is fastest: measured once, kept by machine, kind and size of scene."""

import json

import numpy as np
import pytest
from cloths import assert_same, cloth, motion
from inside import candidates_of, lose_patience, measure_by
from selection import mostly_thorough, thorough

from taichi_cloth.scene.library import build
from taichi_cloth.simulation import autotune
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("few_lanes")


@pytest.fixture
def measured(device, monkeypatch, tmp_path):
    """An empty cache of measurements, and the list of what is measured, in order."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    happened = []

    def counted(way):
        happened.append(f"{way.topology} {way.path}")
        return measure(way)

    measure = measure_by(monkeypatch, counted)
    return happened


WAYS = [f"{t} {path}" for t in ("lanes", "graph") for path in ("serial", "parallel")]


@thorough
def test_what_is_fastest_is_measured_once(measured):
    sim = Simulation(build("cloth"), substeps=64)
    (of,) = autotune.measurements()
    assert sorted(measured) == sorted(of.seconds) == sorted(WAYS)
    assert all(0 < seconds < 1 for seconds in of.seconds.values())
    chosen = of.seconds[f"{sim.topology} {sim.execution}"]
    assert chosen <= 1.1 * min(of.seconds.values())
    np.testing.assert_array_equal(sim.positions(), sim.scene.particles.position)
    assert sim.frame == 0

    measured.clear()
    again = Simulation(build("cloth"), substeps=64)
    assert (again.topology, again.execution) == (sim.topology, sim.execution)
    assert measured == []


@thorough
def test_threads_are_not_tried_where_one_is_done_before_they_wake(measured, monkeypatch):
    monkeypatch.setattr(autotune, "WAKING", 1.0)
    assert Simulation(build("cloth", columns=4, rows=3)).execution == "serial"
    assert sorted(measured) == ["graph serial", "lanes serial"]


@pytest.mark.parametrize("path", mostly_thorough(["serial", "parallel"], default=["parallel"]))
def test_a_run_is_the_same_after_measuring(path, pool, measured, monkeypatch):
    """Both paths were run in the memory that one of them then goes on with."""

    def measure(way):
        run(way)
        return 1.0 if way.path == path else 2.0

    run = measure_by(monkeypatch, measure)
    scene = cloth(9, 7)
    sim = Simulation(scene, topology="lanes")
    assert sim.execution == path
    assert_same(motion(sim), motion(pool(scene)))


def test_the_smallest_of_the_table_is_chosen_and_words_are_honoured(measured, monkeypatch):
    measure_by(monkeypatch, lambda way: 1.0)
    scene = build("cloth", columns=4, rows=3)
    sim = Simulation(scene)
    table = json.loads(autotune.cache_file().read_text())
    (key,) = table
    measure_by(monkeypatch, None)  # not called any more

    def chosen(topology, path):
        choice = autotune.choose(topology, path, candidates_of(sim))
        return f"{choice.topology} {choice.execution}"

    for fastest in WAYS:
        table[key] = {way: 1.0 + (way != fastest) for way in WAYS}
        autotune.cache_file().write_text(json.dumps(table))
        topology, path = fastest.split()
        assert fastest == chosen("auto", "auto") == chosen(topology, "auto") == chosen("auto", path)
        for way in WAYS:
            assert chosen(*way.split()) == way


def test_of_ways_that_are_about_as_fast_the_simpler_is_chosen():
    seconds = {"graph parallel": 1.0, "graph serial": 1.05, "lanes parallel": 1.2}
    assert autotune.fastest(seconds) == "graph serial"
    assert autotune.fastest(seconds | {"lanes parallel": 1.09}) == "lanes parallel"


@pytest.mark.parametrize("topology", mostly_thorough(["lanes", "graph"], default=["graph"]))
def test_a_run_whose_threads_only_wait_goes_on_with_one(topology, pool, monkeypatch):
    scene = cloth(9, 7)
    sim = Simulation(scene, topology=topology, execution="parallel")
    lose_patience(monkeypatch, sim)
    sim.advance()
    assert sim.execution == "parallel"  # the first frame compiles
    sim.advance(15)
    sim.advance(14)
    assert sim.execution == "serial"
    now = sim.positions(), sim.velocities(), sim.springs_alive()
    assert_same(now, motion(pool(scene)))


@thorough
def test_measurements_hold_for_one_machine_kind_and_size_of_scene(measured, monkeypatch):
    measure_by(monkeypatch, lambda way: measured.append(1) or 1.0)

    def count(scene, topology="graph"):
        measured.clear()
        Simulation(scene, topology=topology)
        return len(measured)

    small = build("cloth", columns=4, rows=3)
    assert count(small) == 2  # only what could be chosen
    assert count(small, "auto") == 2 and count(small, "auto") == 0
    assert count(build("cloth", columns=9, rows=9)) == 2  # another size
    assert count(small.with_world(walls=())) == 2  # other features
    assert count(build("oscillator"), "auto") == 2  # no grid
    with monkeypatch.context() as patch:
        patch.setattr("platform.node", lambda: "elsewhere")
        assert count(small) == 2
    autotune.cache_file().write_text("not JSON")
    assert count(small) == 2
    assert len(autotune.measurements()) == 1
