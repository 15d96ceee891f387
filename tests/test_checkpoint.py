"""A run that goes on from a checkpoint has the bits of the one that was never interrupted."""

import copy
import inspect
import json
import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
from cloths import SIDES, cloth, mixed
from commands import command
from inside import state_of
from selection import as_thorough, mostly_thorough

import taichi_cloth as tc
from taichi_cloth.errors import InputError
from taichi_cloth.kernels import methods, persistence
from taichi_cloth.kernels.state import State
from taichi_cloth.scene import scenefile
from taichi_cloth.scene.library import build
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("device", "few_lanes")

LINKS = ("structural", "shear")
DEFAULT = [("symplectic_euler", "graph"), ("verlet", "graph")]
# Lanes, which take long to compile, with a method of one stage, of several, with multipliers, and
# with a solver; the graph with all.
LANES = ("symplectic_euler", "rk4", "xpbd", "implicit_euler")
TABLE = [(m, "lanes") for m in LANES] + [(method, "graph") for method in methods.METHODS]


def torn():
    """A cloth that flies apart, with all that springs and particles can have."""
    return mixed(2, mouse="blow")


def state(sim):
    energy = sim.energy()
    return sim.positions(), sim.velocities(), sim.springs_alive(), sim.time, sim.steps, energy


def assert_same(one, other):
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


def advance(sim, frames):
    """Frames one by one, with a gust in each fourth."""
    for _ in range(frames):
        if sim.frame % 4 == 3 and sim.scene.world.mouse == "blow" and sim.scene.world.dim == 2:
            sim.blow((150.0, 120.0), (3.0, -2.0))
        sim.advance()


@pytest.mark.parametrize(
    ("method", "topology"),
    [row if row in DEFAULT else as_thorough(row) for row in TABLE],
)
def test_a_run_goes_on_from_a_checkpoint_to_the_same_bits(pool, tmp_path, method, topology):
    """In place after springs broke; after other scenes were loaded; and by a file in new fields."""
    sim = pool(torn(), method, topology=topology, substeps=2)
    advance(sim, 5)
    sim.blow((100.0, 100.0), (2.0, 1.0))
    there = sim.checkpoint()
    broken = int((~sim.springs_alive()).sum())
    advance(sim, 9)
    end = state(sim)
    assert 0 <= broken < (~end[2]).sum() < len(end[2])

    sim.restore(there)
    assert (~sim.springs_alive()).sum() == broken and sim.frame == 5
    advance(sim, 9)
    assert_same(state(sim), end)

    sim.set(stiffness=0.7, gravity=(0.0, -0.1))
    sim.set_step(0.5, 3)
    sim.cut([3, 4])
    sim.advance(2)
    sim.restore(there)
    advance(sim, 9)
    assert_same(state(sim), end)

    there.save(tmp_path / "there.npz")
    other = pool(torn(), method, topology=topology, substeps=1, another=True)
    other.advance(3)
    other.restore(tc.Checkpoint.load(tmp_path / "there.npz"))
    assert (other.frame, other.substeps) == (5, 2)
    advance(other, 9)
    assert_same(state(other), end)


# One of each kind of feature that keeps something from step to step.
KEEPING = ["sandbox", "cloth", "slinky", "flag", "shirt", "stack"]


@pytest.mark.parametrize("name", mostly_thorough(KEEPING, ["sandbox"]))
def test_every_scene_goes_on_to_the_same_bits_in_new_fields(name, tmp_path):
    """Fields that were never written hold nothing that a step needs; steps change none that a load
    fills.
    """
    scene, settings = build(name), {"topology": "graph", "execution": "serial"}
    sim = Simulation(scene, **settings)
    sim.advance(4)
    if scene.world.mouse == "spawn":
        place = np.add(scene.world.low, scene.world.high) / 2
        sim.spawn(place, tied_to=sim.spawn(place + 9.0))
    sim.advance()
    loaded = loaded_fields(sim)
    there = sim.checkpoint()
    sim.advance(3)
    for name, before in loaded.items():
        np.testing.assert_array_equal(loaded_fields(sim)[name], before, err_msg=name)
    end = state(sim)
    there.save(tmp_path / "there.npz")
    other = Simulation(scene, **settings)
    other.restore(tc.Checkpoint.load(tmp_path / "there.npz"))
    other.advance(3)
    assert_same(state(other), end)


def loaded_fields(sim):
    """What a load fills and no step changes, by name."""
    fracture = persistence.CHANGED_BY_FRACTURE if sim.storage.specialization.fracture else set()
    names = persistence.LOADED - fracture
    fields = {name: getattr(state_of(sim), name, None) for name in names}
    return {name: field.to_numpy() for name, field in fields.items() if field is not None}


def test_what_is_not_kept_is_named_as_in_the_state():
    """A name that no state has any more would one day hide a field that takes it."""
    text = "".join(inspect.getsource(part) for part in State.__mro__[:-1])
    placed = {*re.findall(r"self\.(\w+)", text), *re.findall(r'"(\w+)"', text), "link_k", "sums"}
    assert placed >= persistence.LOADED | persistence.WITHIN_STEP


@pytest.mark.parametrize("topology", ["graph", as_thorough("lanes")])
def test_what_was_spawned_tied_and_held_comes_and_goes(topology):
    scene = cloth(6, 5, LINKS, mouse="blow", break_force=2.0)
    sim = Simulation(scene, topology=topology, execution="serial")
    sim.advance(2)
    before = sim.checkpoint()
    sim.spawn((150.0, 60.0), (1.0, 0.0), tied_to=3)
    sim.hold(np.full((sim.particle_count, 2), 0.01))
    sim.advance(3)
    after = sim.checkpoint()
    sim.advance(4)
    end = state(sim)
    sim.restore(before)
    assert sim.particle_count == len(scene.particles)
    sim.advance(2)
    straight = state(sim)
    sim.restore(after)
    assert sim.particle_count == len(scene.particles) + 1
    sim.advance(4)
    assert_same(state(sim), end)
    sim.restore(before)
    sim.advance(2)
    assert_same(state(sim), straight)
    sim.reset()
    assert sim.particle_count == len(scene.particles) and sim.frame == 0


def test_one_goes_back_over_a_throw_and_on_in_another_run(tmp_path):
    """The first ball lets particles collide for good, which is no other scene."""
    scene = cloth(4, 3, LINKS)
    sim = Simulation(scene, topology="graph", execution="serial")
    sim.advance(2)
    before = sim.checkpoint()
    sim.advance(3)
    straight = state(sim)
    sim.prepare_balls()
    sim.spawn((150.0, 20.0), (0.0, 4.0), radius=20.0, mass=50.0)
    sim.advance(2)
    thrown = sim.checkpoint()
    sim.advance(2)
    end = state(sim)
    sim.restore(before)
    assert not sim.scene.world.collisions
    sim.advance(3)
    assert_same(state(sim), straight)
    thrown.save(tmp_path / "thrown.npz")
    sim.reset()  # a run that has thrown nothing
    for checkpoint in (thrown, tc.Checkpoint.load(tmp_path / "thrown.npz")):
        sim.restore(checkpoint)
        sim.advance(2)
        assert_same(state(sim), end)
        sim.reset()
        assert sim.scene.world.collisions and sim.scene.world.tools


@pytest.mark.parametrize("topology", ["graph", as_thorough("lanes")])
def test_what_the_mouse_holds_is_held_again(topology, tmp_path):
    scene = cloth(6, 5, LINKS, break_force=50.0).with_world(tools=True)
    sim = Simulation(scene, topology=topology, execution="serial")
    sim.advance(2)
    free = sim.checkpoint()
    sim.grab([8, 9], (120.0, 120.0))
    sim.drag((130.0, 110.0))
    sim.advance(2)
    there = sim.checkpoint()
    sim.drag((150.0, 90.0))
    sim.advance(3)
    end = state(sim)
    sim.let_go()
    there.save(tmp_path / "there.npz")
    for checkpoint in (there, tc.Checkpoint.load(tmp_path / "there.npz"), there):
        sim.restore(checkpoint)
        np.testing.assert_array_equal(sim.held().place, (130.0, 110.0))
        sim.drag((150.0, 90.0))
        sim.advance(3)
        assert_same(state(sim), end)
    sim.restore(free)
    assert sim.held() is None
    sim.grab([8, 9], (120.0, 120.0))
    sim.drag((130.0, 110.0))
    sim.advance(2)
    sim.drag((150.0, 90.0))
    sim.advance(3)
    assert_same(state(sim), end)


def test_substeps_that_follow_the_springs_are_chosen_as_they_were(tmp_path):
    scene = cloth(8, 6, LINKS, break_force=1.0, damping=0.3)
    sim = Simulation(scene, dt="auto", topology="graph", execution="serial")
    sim.advance(3)
    there = sim.checkpoint()
    sim.advance(12)
    end = (*state(sim), sim.substeps)
    there.save(tmp_path / "there.npz")
    for checkpoint in (there, tc.Checkpoint.load(tmp_path / "there.npz")):
        sim.restore(checkpoint)
        sim.advance(12)
        assert_same((*state(sim), sim.substeps), end)


def test_checkpoints_share_what_is_equal(pool):
    sim = pool(cloth(20, 20, LINKS, walls=SIDES[:4], break_force=1e9))
    sim.advance()
    one = sim.checkpoint()
    assert repr(one) == "<Checkpoint: 'cloth' after 1 frame of symplectic_euler in f64>"
    much = f"400 particles, {sim.spring_count} springs"
    run = f"symplectic_euler in f64, {sim.way}; dt {sim.dt:g} in 1 substep"
    assert repr(sim) == f"<Simulation: 'cloth' after 1 frame, {much}; {run}>"
    surface = "" if not len(sim.scene.triangles) else f", {len(sim.scene.triangles)} triangles"
    assert repr(sim.scene) == f"<Scene: 'cloth', {much}{surface}>"
    assert repr((sim.scene.particles, sim.scene.springs)) == f"(<400 particles>, <{much[15:]}>)"
    assert repr(sim.scene.stencils) == "<0 stencils>"
    sim.advance()
    two = sim.checkpoint()
    shared = {id(a) for a in one.arrays()} & {id(a) for a in two.arrays()}
    changed = sum(a.nbytes for a in two.arrays() if id(a) not in shared)
    assert changed < 1.2 * 2 * 8 * 2 * 400  # positions and velocities


def test_what_is_no_checkpoint_of_this_run_is_refused_in_a_line(pool, tmp_path):
    sim = pool(torn())
    there = sim.checkpoint()
    with pytest.raises(InputError, match="takes a Checkpoint, not"):
        sim.restore(3)
    with pytest.raises(InputError, match="has method symplectic_euler, the run has verlet"):
        pool(torn(), "verlet").restore(there)
    with pytest.raises(InputError, match="has scene cloth, the run has box"):
        other = pool(torn(), another=True)
        other.scene = replace(other.scene, name="box")
        other.restore(there)
    with pytest.raises(InputError, match="of another 'cloth': with other parameters"):
        pool(mixed(2, mouse="blow", speed=1.0), another=True).restore(there)
    sim.spawn((30.0, 30.0))
    grown = sim.checkpoint()
    sim.restore(there)
    kept, before = grown.kept, state(sim)
    lanes, lacking = replace(kept.spec, lanes=64), {"x": kept.fields["x"]}
    for other in (
        replace(kept, spec=lanes, loaded=None),
        replace(kept, fields=lacking, loaded=None),
    ):
        with pytest.raises(InputError, match="stored otherwise .*lanes 64, here 1|it lacks '"):
            sim.restore(replace(grown, kept=other))
        assert_same(state(sim), before)
    path = tmp_path / "there.npz"
    for content in (b"", b"none", b"PK\x03\x04"):
        path.write_bytes(content)
        with pytest.raises(InputError, match="there.npz: is no checkpoint"):
            tc.Checkpoint.load(path)
    there.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    meta = json.loads(str(arrays["meta"])) | {"version": 9}
    np.savez(path, **(arrays | {"meta": np.array(json.dumps(meta))}))
    with pytest.raises(InputError, match="of version 9, and this program reads 1"):
        tc.Checkpoint.load(path)
    with pytest.raises(InputError, match="there is no folder"):
        there.save(tmp_path / "none" / "there.npz")


PRECISIONS = [(p, t) for p in ("f32", "compensated") for t in ("lanes", "graph")]


@pytest.mark.parametrize(
    ("precision", "topology"),
    [row if row == ("compensated", "graph") else as_thorough(row) for row in PRECISIONS],
)
def test_the_command_line_goes_on_bit_for_bit(cli, tmp_path, precision, topology):
    """In processes of their own, at every precision, with drag, walls, and springs that break."""
    scene = tmp_path / "scene.toml"
    scenefile.save(torn(), scene)
    run = ("run", scene, "--headless", "--topology", topology, "--precision", precision)
    whole, part, end = (tmp_path / f"{name}.npz" for name in ("whole", "part", "end"))
    cli(*run, "--frames", 14, "--substeps", 2, "--save", whole)
    cli(*run, "--frames", 9, "--substeps", 2, "--checkpoint", part)
    cli("run", scene, "--headless", "--resume", part, "--frames", 5, "--save", end)
    whole, end = tc.load_trajectory(whole), tc.load_trajectory(end)
    particles, name = whole.position.shape[1], scenefile.load(scene).name
    assert repr(whole) == f"<Saved: {name!r}, 14 frames of {particles} particles>"
    np.testing.assert_array_equal(end.frame, whole.frame[9:])
    np.testing.assert_array_equal(end.time, whole.time[9:])
    np.testing.assert_array_equal(end.position, whole.position[9:])
    np.testing.assert_array_equal(end.velocity, whole.velocity[9:])
    np.testing.assert_array_equal(end.spring_alive, whole.spring_alive[9:])
    assert 0 < end.spring_alive[-1].sum() < end.spring_alive.shape[1]


def test_a_run_goes_on_in_other_settings(cli, tmp_path):
    """As by a panel, from the checkpoint's state on: verlet's, of which vectors are kept, and a
    method that solves; its log says so, and its replay has the same bits.
    """
    words = ("run", "cloth", "--columns", 8, "--rows", 6, "--headless")
    there, log = tmp_path / "there.npz", tmp_path / "log.jsonl"
    cli(*words, "--method", "verlet", "--frames", 12, "--checkpoint", there)
    resumed = (*words, "--frames", 4, "--resume", there)
    saved = {name: tmp_path / f"{name}.npz" for name in ("as", "same", "other", "panel", "again")}
    cli(*resumed, "--save", saved["as"])
    cli(*resumed, "--save", saved["same"], "--method", "verlet", "--dt", 1, "--substeps", 1)
    given = ("--method", "xpbd", "--iterations", 7, "--dt", 0.5, "--substeps", 2)
    cli(*resumed, *given, "--save", saved["other"], "--record", log)
    sets = {"method": "xpbd", "iterations": 7, "dt": 0.5, "substeps": 2}
    lines = [{"frame": 0, "event": "set", "name": n, "value": v} for n, v in sets.items()]
    (tmp_path / "panel.jsonl").write_text("\n".join(map(json.dumps, lines)))
    cli(*resumed, "--events", tmp_path / "panel.jsonl", "--save", saved["panel"])
    cli(*resumed, "--events", log, "--save", saved["again"])
    for a, b in (("as", "same"), ("other", "panel"), ("other", "again")):
        assert tc.compare(saved[a], saved[b]).identical, (a, b)
    other = tc.load_trajectory(saved["other"])
    assert other.frame.tolist() == [13, 14, 15, 16] and other.meta["iterations"] == 7
    assert np.allclose(np.diff(other.time), 0.5) and not tc.compare(saved["as"], other).identical
    # The substeps that --dt auto chose are the user's from there on.
    cli(*words, "--dt", "auto", "--frames", 2, "--checkpoint", there)
    assert (
        ", 2 substeps;" in cli(*resumed)[0] and ", 5 substeps;" in cli(*resumed, "--substeps", 5)[0]
    )


def test_a_checkpoint_of_something_else_is_refused_before_taichi_starts(cli, tmp_path):
    path = tmp_path / "there.npz"
    cloth = ("run", "cloth", "--columns", 8, "--rows", 6, "--headless", "--frames", 2)
    cli(*cloth, "--checkpoint", path)
    for words, says in (
        (["box"], "is of scene 'cloth', not of 'box'"),
        (["cloth", "--precision", "f64"], "was made with --precision f32; leave the flag out"),
        (["cloth", "--dt", "auto"], "and --dt auto chooses from the start of a run"),
        (["cloth", "--tolerance", "0.01"], "--tolerance: symplectic_euler does not take it"),
    ):
        said = command("run", *words, "--headless", "--resume", path, check=2)[1]
        assert says in said and said.count("\n") == 1
    said = command("run", "cloth", "--columns", 9, "--headless", "--resume", path, check=2)[1]
    assert said.splitlines()[-1] == (
        f"taichi-cloth: error: --resume {path}: the checkpoint is of another 'cloth': with other "
        "parameters; give this run those that it was made with"
    )
    log = tmp_path / "log.jsonl"
    on = ("run", "cloth", "--headless", "--frames", 1)
    assert cli(*on, "--resume", path, "--record", log)[0].startswith("cloth: 48 particles")
    cli(*on, "--resume", path, "--events", log)
    for words, says in (
        ([*on, "--events", log], "the session went on from a checkpoint at frame 2, and this run"),
        (["compare", "--events", log, "--substeps", 2], "its session went on from a checkpoint"),
    ):
        assert says in command(*words, check=2)[1]


def test_a_checkpoint_is_pickled_and_copied():
    """Its load holds what no other process has: it could be neither."""
    scene = build("chain")
    sim, other = (Simulation(scene, dt="auto", topology="graph") for _ in range(2))
    sim.advance(2)
    there = sim.checkpoint()
    assert copy.copy(there) is there and copy.deepcopy(there) is there
    assert there == there and there != sim.checkpoint()  # NumPy raised here
    sent = pickle.loads(pickle.dumps(there))
    sim.advance(3)
    end = state(sim)
    for run in (sim, other):
        run.restore(sent)
        run.advance(3)
        assert_same(state(run), end)
