"""Budgets of runs: what is chosen for a simulation, refused, counted and said; and that a budgeted
run's log replays to the same bits.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from selection import as_thorough

from taichi_cloth.budgets import keeper, methods, seconds
from taichi_cloth.budgets.goal import read
from taichi_cloth.budgets.keeper import LOOK, Keeper, StableSteps
from taichi_cloth.budgets.seconds import Second
from taichi_cloth.cli import run_budget
from taichi_cloth.cli.main import main
from taichi_cloth.cli.run_budget import HeldBudget
from taichi_cloth.error_meter.verdict import Verdict
from taichi_cloth.errors import InputError
from taichi_cloth.files.trajectory import load
from taichi_cloth.limits.precision import most_substeps, unresolved
from taichi_cloth.scene import library
from taichi_cloth.simulation.diagnostics import acceleration_at_start
from taichi_cloth.simulation.simulation import Simulation


def seconds_of(method, others, count=methods.ENOUGH):
    """Verdicts on a chain's first seconds with 8 substeps."""
    known = {"error": 0.01, "scale": 1.0, "size": 1.0, "own_substeps": 8}
    return [Verdict(60 * k, 60, method=method, others=others, **known) for k in range(count)]


def test_a_method_that_was_chosen_is_gone_on_with_from_what_was_measured_of_it(device):
    sim = Simulation(library.build("chain"), substeps=8)
    tries = {"symplectic_euler": [[8, 0.01], [16, 0.005]]}
    tries["verlet"] = [[8, 1e-5], [4, 1e-4], [2, 4e-3], [1, 0.05]]
    said = seconds_of("symplectic_euler", tries)
    keeper = Keeper(sim, read("1%"))
    assert {trial.method for trial in keeper.trials()} == {"symplectic_euler", "verlet", "rk4"}
    choice = keeper.choose(said)
    assert (choice.method, choice.substeps) == ("verlet", 2)
    assert choice.why.endswith("; symplectic_euler would take 16")
    # Nobody could take it: the run goes on without, and nothing asks for it again.
    assert keeper.choose(said).method == "" and keeper.choose(said).substeps == 16
    keeper = Keeper(sim, read("1%"))
    keeper.choose(said)
    sim.set_method("verlet")
    sim.set_step(substeps=2)
    choice = keeper.choose(said)
    assert (choice.method, choice.substeps) == ("", 2)
    assert "in 5 seconds measured" in choice.why and "would take 16" in choice.why
    assert keeper._rivals.changes == 1
    sim.set_method("symplectic_euler")  # as where the run goes back to a frame that had it
    choice = keeper.choose(said)  # whose seconds are known still
    assert choice.substeps == 16 and "in 5 seconds measured" in choice.why
    assert "would take" not in choice.why


def test_other_methods_cost_what_they_would_where_they_run(device):
    """By what their steps compute, and by the lanes that they would leave."""
    costs = {}
    for name, topology in (("cloth", "graph"), ("cloth", "lanes"), ("flag", "lanes")):
        sim = Simulation(library.build(name), topology=topology, execution="serial", substeps=64)
        costs[name, topology] = {r.name: r.cost for r in Keeper(sim, read("1%"))._others()}
    for cost in (costs["cloth", "graph"], costs["cloth", "lanes"]):
        assert cost["verlet"] == pytest.approx(1.0)
        assert 3.0 < cost["rk4"] <= 4.0  # breaks are looked for once a step
        assert "explicit_euler" not in cost
    # The flag's lanes would compile long: other methods would be on the graph.
    assert costs["flag", "lanes"]["verlet"] > 1.05


@pytest.mark.parametrize(
    ("method", "kept", "said"),
    [
        ("symplectic_euler", "--method gave it", "symplectic_euler stays, as --method gave it"),
        ("implicit_euler", "", "only explicit methods are"),
    ],
)
def test_a_method_that_is_kept_is_said(device, method, kept, said):
    sim = Simulation(library.build("chain"), method, substeps=8)
    keeper = Keeper(sim, read("1%"), kept=kept)
    choice = keeper.choose(seconds_of(method, {"verlet": [[8, 1e-5], [4, 1e-4]]}))
    assert choice.method == "" and said in choice.why
    assert not keeper.chooses_method and [trial.method for trial in keeper.trials()] == [method]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("fast", "--hold must be frames a second such as 60fps"),
        ("0fps", "--hold must be frames a second"),
        ("1e9fps", "1 ms to 10 s"),
        ("80%", "at most 50%"),
        ("-1%", "must be a number above 0"),
        ("1", "or an error such as 1%"),
    ],
)
def test_bad_goals_are_refused_in_one_line(given, said):
    with pytest.raises(InputError, match=".*") as refused:
        read(given)
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_goals_are_read():
    assert read("60 FPS").seconds == pytest.approx(1 / 60)
    assert read("12ms").seconds == pytest.approx(0.012)
    assert read("0.5%").error == pytest.approx(0.005)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--hold", "60fps", "--headless"], "a headless run has no frames to be in time for"),
        (["--hold", "1%", "--dt", "auto", "--headless"], "--hold and --dt auto both choose"),
        (["--strict", "--headless"], "--strict is of a budget: give --hold 1%"),
    ],
)
def test_budgets_that_cannot_be_kept_are_refused_in_one_line(words, said, capsys):
    assert main(["run", "chain", *words]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


def test_the_fewest_substeps_are_those_of_dt_auto_and_the_most_are_resolved(device):
    sim = Simulation(library.build("cloth"))
    stable = StableSteps(sim)
    assert stable.least() == Simulation(library.build("cloth"), dt="auto").substeps
    assert not stable.changed()
    sim.set(stiffness=4.0)
    assert stable.changed() and stable.least() == 4
    scene, a = sim.scene, acceleration_at_start(sim.scene)
    most = most_substeps(scene, a, sim.dt, "f32")
    assert unresolved(scene, a, sim.dt, most, "f32") is None
    assert unresolved(scene, a, sim.dt, most + 1, "f32") is not None
    sim.unpin(np.flatnonzero(sim.fixed())[:1])  # what is free may swing faster
    assert stable.changed()


def test_time_alone_is_no_reason_for_more_steps(pool, device, monkeypatch):
    """An empty box has time for any number, and so has one in which nothing moves."""
    monkeypatch.setattr(keeper, "current_device", lambda: replace(device, precision="f32"))
    sim = pool(library.build("box"))
    budget = Keeper(sim, read("60fps"))

    def chosen():
        for _ in range(600):
            budget.frame(1e-4, 1e-3)
            choice = budget.choose(())
            sim.substeps = choice.substeps
        return choice

    alone, stable = chosen(), StableSteps(sim)
    assert stable.resolved() is None
    assert alone.substeps == 1 and "there is no particle yet" in alone.why
    sim.spawn([300.0, 200.0, 0.0])
    assert stable.resolved() < 1e4
    resting = chosen()
    assert resting.substeps == 64 and "no second has been measured yet" in resting.why


class Errors:
    """An error meter that measures nothing, and says whether it is on."""

    on, verdicts, rested = False, (), None

    def rest(self, times):
        self.rested = times

    def try_methods(self, trials):
        self.trials = trials

    def switch(self):
        self.on = not self.on

    refused = ""


def test_a_time_budget_measures_errors_once_there_is_time_for_more(device, monkeypatch):
    """Where frames are late anyway, another process would only take processor time from them."""
    in_f32 = replace(device, precision="f32")  # in f64 it measures none
    monkeypatch.setattr(run_budget, "current_device", lambda: in_f32)
    sim, errors = Simulation(library.build("cloth"), substeps=2), Errors()
    budget = HeldBudget(sim, errors, windowed=True, told=False)
    budget.choose("60fps")
    for frames, rest in ((90, 0.02), (240, 1e-3)):
        assert not errors.on
        for _ in range(frames):
            budget.before_frame(lambda name, value: sim.set_step(substeps=value))
            sim.advance(1)
            budget.after_frame(1e-4 * sim.substeps, rest)
    assert errors.on and sim.substeps > 2 and errors.rested is None
    for few, rested in ((1, None), (0, run_budget.RESTS)):  # after so many, it may rest
        errors.verdicts = (Verdict(0, 60, method="another"),) * (run_budget.MEASURED - few)
        budget.before_frame(lambda name, value: None)
        assert errors.rested == rested
    budget.choose("0.5%")  # which is what seconds are measured for
    assert errors.rested == 0.0


def test_to_hold_frames_a_second_is_a_help_where_there_are_more_substeps_than_the_fewest(pool):
    """Not where it has chosen already, and not with dt auto, which holds nothing."""
    scene = library.build("cloth", columns=8, rows=6)
    errors = Errors()
    for given, helps in (
        ({"substeps": 9}, True),
        ({"substeps": 1}, False),
        ({"dt": "auto"}, False),
    ):
        sim = pool(scene, **given)
        budget = HeldBudget(sim, errors, windowed=True, told=False)
        assert budget.shortens == helps
    sim.reset()
    sim = pool(scene, substeps=StableSteps(pool(scene)).least())
    budget = HeldBudget(sim, errors, windowed=True, told=False)
    assert not budget.shortens
    sim.set_step(substeps=9)
    assert budget.shortens
    budget.choose("1%")
    assert budget.shortens
    budget.choose("60fps")
    assert not budget.shortens


def test_what_a_budget_came_to_is_counted_from_its_choice_on(pool):
    """Frames that were held to something else are no part of it."""
    sim = pool(library.build("cloth", columns=4, rows=3))
    budget = HeldBudget(sim, Errors(), windowed=True, told=False)
    for word, took, frames in (("30fps", 1.0, 3), ("60fps", 1e-3, 2)):
        budget.choose(word)
        for _ in range(frames):
            budget.after_frame(took, 0.0)
    assert budget.summary().startswith("hold 60fps: held in 100 % of 2 frames")


def test_an_error_that_was_held_is_counted_by_the_frames_that_were_measured(pool):
    """Not those of a second in which nothing moved, or whose error is not sure."""
    sim, errors = pool(library.build("cloth", columns=4, rows=3)), Errors()
    budget = HeldBudget(sim, errors, windowed=False, told=False)
    budget.choose("1%")
    budget.after_frame(1e-3, 0.0)
    assert "hold 1%: no frame was measured, by " in budget.summary()
    good = Verdict(0, 60, error=0.5, scale=100.0, size=1.0, by_frame=[0.5] * 60, judged=60)
    half = replace(good, error=9.0, by_frame=[0.5, 12.0] * 30)
    unsure, still = replace(half, trouble="two references differ"), replace(half, size=1e9)
    errors.verdicts = (good, half, unsure, still)
    said = "held in 75 % of 120 frames that were measured, and over 1 of 2 windows as a whole"
    assert said in budget.summary()


def test_a_budget_that_was_not_held_is_a_failure_where_it_is_to_be_strict(pool):
    """But for the search of the first seconds, where others follow, and one second in fifty."""
    sim, errors = pool(library.build("cloth", columns=4, rows=3)), Errors()
    budget = HeldBudget(sim, errors, windowed=True, told=False)
    assert budget.missed() is None  # nothing is held
    budget.choose("1%")
    budget.after_frame(1e-3, 0.0)
    assert "no frame was measured" in str(budget.missed())
    good = Verdict(0, 60, error=0.5, scale=100.0, size=1.0, by_frame=[0.5] * 60, judged=60)
    bad, rest = replace(good, error=5.0), replace(good, size=1e9)
    for seen, held_at_all in (
        ((good,), True),
        ((rest,), True),
        ((bad,), False),
        ((bad, bad, bad, good), True),
        ((bad, bad, bad, bad, good), False),
        ((good,) * 40 + (bad,) + (good,) * 11, False),
        ((good,) * 40 + (bad,) + (good,) * 12, True),
    ):
        errors.verdicts = seen
        assert (budget.missed() is None) == held_at_all
    errors.verdicts = (bad, bad, bad, good)
    assert "and over 1 of 4 windows as a whole (1 of 1 after the search of" in budget.summary()
    errors.verdicts = (bad,)
    assert str(budget.missed()).startswith("--hold 1% was not held: held in ")
    assert budget.missed().exit_status == 1
    budget.choose("60fps")
    for took, frames, held_at_all in ((1e-3, 95, True), (1.0, 5, True), (1.0, 1, False)):
        for _ in range(frames):
            budget.after_frame(took, 0.0)
        assert (budget.missed() is None) == held_at_all


def test_chance_is_named_where_runs_that_differ_by_a_nudge_part(pool):
    """Not where they do not: there the references alone say that there is no error to keep to."""
    sim = pool(library.build("cloth", columns=4, rows=3))
    for parted, named in ((5.0, True), (0.5, False)):
        keeper = Keeper(sim, read("1%"))
        verdict = Verdict(
            0, 60, error=9.0, scale=100.0, size=1.0, method=sim.method, own_substeps=1,
            parted=parted, trouble="two references differ by 0.1 of the motion",
        )  # fmt: skip
        why = keeper.choose([verdict] * seconds.UNSURE).why
        assert "no error to keep to: two references differ" in why
        assert ("chance decides: runs that differ by a millionth part by 5 %" in why) == named


SWINGS = {  # undamped; what is pinned of a cloth of so many columns and rows, or a chain
    "chain": (16, 1, "[[0, 0]]"),
    "cloth": (9, 9, "[[0, 0], [8, 0]]"),
    "corner": (7, 10, "[[0, 0]]"),
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", SWINGS)
def test_an_error_is_held_of_what_swings_undamped_and_folds(name, tmp_path, cli):
    """Small disturbances grow a ten-thousandfold in each second there, and errors with them."""
    columns, rows, pinned = SWINGS[name]
    scene = tmp_path / "swing.toml"
    scene.write_text(
        f"""[world]
size = [6.0, 6.0, 6.0]
up = "y"
gravity = [0.0, -9.81, 0.0]
dt = 0.016666666666666666
[particle]
mass = 0.02
radius = 0.005
[spring]
stiffness = 400.0
[[cloths]]
origin = [2.5, 4.0, 0.0]
columns = {columns}
rows = {rows}
spacing = 0.1
pinned = {pinned}
links = ["structural", "shear"]
across = [1.0, 0.0, 0.0]
down = [0.0, 0.0, 1.0]
"""
    )
    words = ["run", scene, "--precision", "f64", "--headless", "--frames", "540", "--error-meter"]
    said, _ = cli(*words, "--hold", "1%", "--strict")
    errors = [float(part.split()[0]) for part in said.split("over the last second: ")[1:]]
    assert len(errors) == 9 and max(errors[3:]) <= 1.0
    assert "chance" not in said


@pytest.mark.parametrize(
    ("scene", "goal", "name"),
    [
        (["chain", "--frames", "320"], "0.02%", "method"),
        as_thorough((["cloth", "--method", "xpbd", "--frames", "300"], "1%", "iterations")),
    ],
)
def test_a_run_whose_method_or_solver_was_chosen_replays_to_the_same_bits(
    scene, goal, name, tmp_path, cli
):
    """By its log alone, and by the budget that makes the same choices again."""
    log, *saved = (tmp_path / name for name in ("log.jsonl", "a.npz", "b.npz", "c.npz"))
    words, held = ["run", *scene, "--headless", "--quiet"], ["--hold", goal]
    for more, file in zip(
        (["--record", log, *held], ["--events", log], ["--events", log, *held]), saved, strict=True
    ):
        cli(*words, *more, "--save", file)
    chosen = [json.loads(line) for line in log.read_text().splitlines()[1:]]
    assert name in {event["name"] for event in chosen}
    first, *others = (load(path).position for path in saved)
    assert all((first == other).all() for other in others)


def test_other_springs_are_others_also_where_the_old_ones_were_in_memory():
    scene = SimpleNamespace(springs=object(), stencils=None, world=SimpleNamespace(more={}))
    stable = StableSteps(SimpleNamespace(method="", dt=1.0, storage=SimpleNamespace(scene=scene)))
    stable._of = stable._now()
    scene.springs = None
    scene.springs = object()
    assert stable.changed()


def test_what_was_seen_of_another_run_is_forgotten(pool, monkeypatch):
    """After a reset none of its springs is broken; with other frames each second is another one."""
    sim, broken = pool(library.build("cloth", columns=4, rows=3)), [0, 2, 0, 0]
    monkeypatch.setattr(sim.storage, "count_broken", lambda: broken.pop(0))
    keeper = Keeper(sim, read("1%"))
    keeper.choose(())
    sim.advance(LOOK)
    keeper.choose(())
    assert keeper._broken == [(0, 0), (LOOK, 2)]
    sim.reset()
    keeper.choose(())
    assert keeper._broken == [(0, 0)]
    keeper._errors.note(Second(8, 0.01), torn=False)
    sim.set_step(dt=sim.dt / 2)
    keeper.choose(())
    assert not keeper._errors.sure
    sim.set_step(dt=2 * sim.dt)


@pytest.mark.thorough
def test_a_budgeted_run_replays_to_the_same_bits(tmp_path, cli):
    """An error is held by a meter that the run waits for; its log has what was chosen, and a second
    run that follows the first in its substeps.
    """
    log, one, other = (tmp_path / name for name in ("log.jsonl", "one.npz", "other.npz"))
    words = ["run", "chain", "--headless", "--quiet", "--frames", "400"]
    held = ["--hold", "0.1%", "--beside", "method=rk4"]
    cli(*words, *held, "--record", log, "--save", one)
    chosen = [json.loads(line) for line in log.read_text().splitlines()[1:]]
    assert len({event["value"] for event in chosen if event["event"] == "set"}) > 1
    cli(*words, "--events", log, "--save", other)
    for name in "{}.npz", "{}-beside.npz":
        first, again = (load(tmp_path / name.format(path.stem)) for path in (one, other))
        assert (first.position == again.position).all()
        assert first.meta["substeps"] == again.meta["substeps"] != 1
