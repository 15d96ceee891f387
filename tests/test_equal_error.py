"""The bench of equal error: its search, its contestants against closed forms, its rows."""

import os
import pickle
import signal
from dataclasses import replace

import numpy as np
import pytest
from lacking import needs_peers
from selection import thorough

from bench import contest, equal_error, newton_model, report
from bench.equal_error import contestants, picture, problems, runs_file
from bench.equal_error.scipy_runs import ScipyTrial, jacobian_pattern
from bench.equal_error.search import Choice, Tried, cheapest, climb, search_all
from bench.equal_error.truth import Truth
from taichi_cloth.cli.main import main
from taichi_cloth.console import percent
from taichi_cloth.errors import InputError
from taichi_cloth.measuring import machine
from taichi_cloth.scene.cloth import grid
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.sweeps.within import Clock
from taichi_cloth.trade import ode
from taichi_cloth.trade.errors import Samples

AT_ONE = "a little cloth: 1 %"
LADDER = tuple(Choice(substeps=1 << k) for k in range(12))


def model_run(order, cost=1.0, stable_from=1, floor=0.0):
    """A run that errs by (10 / substeps)^order at most, at a cost in proportion to its substeps."""

    def run(choice):
        if choice.substeps < stable_from:
            return Tried(choice, failed="flew apart")
        error = max((10 / choice.substeps) ** order / 10, floor)
        return Tried(choice, error, cost * choice.substeps)

    return run


# ------------------------------------------------------------------------------------------
# The search


def test_a_climb_ends_where_the_finest_level_is_met():
    tried = climb(model_run(2, stable_from=4), LADDER, limit=1e9, finest=1e-4)
    assert [t.choice.substeps for t in tried] == [1, 2, 4, 8, 16, 32, 64, 128, 256, 512]
    assert [bool(t.failed) for t in tried] == [True, True] + [False] * 8
    assert tried[-1].meets(1e-4) and not tried[-2].meets(1e-4)


def test_a_climb_ends_where_it_costs_too_much_or_gains_nothing():
    dear = climb(model_run(1), LADDER, limit=20, finest=1e-9)
    assert dear[-1].choice.substeps == 32
    flat = climb(model_run(2, floor=1e-3), LADDER, limit=1e9, finest=1e-9)
    assert flat[-1].choice.substeps == 128 << 3  # the first at the floor, and three no better


def test_the_search_finds_the_cheapest_between_the_rungs():
    """Of a second-order solver and a dear one of the fourth: steps to 9 % of the fewest there are.

    Errors (10 / n)^p / 10: the fewest that meet 1e-4 are 10 * 1000^(1/p).
    """

    def run(choice):
        order = 4 if choice.iterations == 2 else 2
        done = model_run(order, cost=order)(Choice(substeps=choice.substeps))
        return replace(done, choice=choice)

    ladders = [[replace(rung, iterations=count) for rung in LADDER] for count in (1, 2)]
    tried = search_all(run, ladders, limit=1e9)
    for level in equal_error.LEVELS:
        best = cheapest(tried, level)
        fewest = {p: max(1, 10 * (0.1 / level) ** (1 / p)) for p in (2, 4)}
        ideal = min(p * n for p, n in fewest.items())
        assert best.error <= level and ideal <= best.seconds < 1.2 * ideal
    assert cheapest(tried, 1e-9) is None
    again = search_all(run, ladders, limit=1e9, before=tried)
    assert max(t.seconds for t in again) <= 4 * cheapest(tried, 1e-4).seconds


def test_tolerances_have_a_middle_too():
    coarse, fine = Choice(tolerance=1e-2), Choice(tolerance=1e-4)
    assert coarse.between(fine).tolerance == pytest.approx(1e-3)
    assert Choice(substeps=4).between(Choice(substeps=5)) is None
    assert fine.describe() == "tolerance 0.0001"
    assert Choice(substeps=1, iterations=5).describe() == "1 substep, 5 iterations"


# ------------------------------------------------------------------------------------------
# The contestants


def net(damping=0.3, dim=3):
    """Five particles of different masses, one of them held, tied by eight springs, all moving."""
    rng = np.random.default_rng(3)
    position = 1.0 + rng.uniform(0, 1, (5, dim))
    between = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [0, 2], [1, 3], [2, 4], [0, 4]])
    return Scene(
        name="net",
        world=World(size=(3.0,) * dim, gravity=(0.0, -2.0, 0.5)[:dim], dt=0.05),
        particles=Particles.build(
            position,
            rng.normal(0, 0.2, position.shape),
            fixed=[False, True, False, False, False],
            mass=[1.0, 2.0, 0.5, 1.5, 3.0],
            viscous=0.0,
            radius=0.0,
        ),
        springs=Springs.build(
            between,
            position,
            stiffness=rng.uniform(5, 20, 8),
            rest_length=rng.uniform(0.5, 1.0, 8),
            damping=damping,
        ),
    )


def start_of(scene):
    fixed = scene.particles.fixed[:, None]
    return scene.particles.position, np.where(fixed, 0.0, scene.particles.velocity)


@needs_peers
@thorough
@pytest.mark.parametrize("dim", [2, 3])
def test_newtons_model_has_our_forces(dim):
    """Its semi-implicit solver beside the same steps of our forces' twins, to f32's round-off."""
    scene = net(dim=dim)
    stepper = newton_model.Stepper(newton_model.model_of(scene), "SolverSemiImplicit")
    (x, v), forces = start_of(scene), ode.Forces(scene)
    for _ in range(20):
        v = v + 0.01 * forces.acceleration(x, v)
        x = x + 0.01 * v
    stepper.advance(0.01, 20)
    np.testing.assert_allclose(stepper.positions(), newton_model.in_space(x), atol=3e-6)
    np.testing.assert_allclose(stepper.velocities(), newton_model.in_space(v), atol=3e-5)


@needs_peers
@thorough
def test_newtons_vbd_on_our_model_converges_to_implicit_euler():
    """v1 = v0 + h a(x1): what is left of it after many iterations is f32's round-off."""
    scene, h = net(damping=0.0), 0.05
    stepper = newton_model.Stepper(newton_model.model_of(scene), "SolverVBD", iterations=200)
    (_, v0), forces = start_of(scene), ode.Forces(scene)
    stepper.advance(h, 1)
    x1, v1 = stepper.positions().astype(float), stepper.velocities().astype(float)
    np.testing.assert_allclose(v1, v0 + h * forces.acceleration(x1, v1), atol=1e-4)


def sheet():
    """Four by three particles in a warped sheet, of which no two springs are alike, one held."""
    rng = np.random.default_rng(5)
    particles, springs = grid((0.5, 1.0, 0.5), 4, 3, 0.3, links=("structural",))
    n, s = len(particles), len(springs)
    position = particles.position + rng.uniform(-0.05, 0.05, (n, 3))
    springs = replace(
        springs,
        stiffness=rng.uniform(5, 20, s),
        rest_length=rng.uniform(0.2, 0.3, s),
        damping=np.zeros(s),
    )
    particles = replace(
        particles,
        position=position,
        velocity=rng.normal(0, 0.2, (n, 3)),
        mass=rng.uniform(0.5, 2, n),
        fixed=np.arange(n) == 1,
        viscous=np.zeros(n),
    )
    world = World(size=(3.0, 3.0, 3.0), gravity=(0.0, -2.0, 0.5), dt=0.05)
    return Scene(name="sheet", world=world, particles=particles, springs=springs)


@needs_peers
@thorough
def test_newtons_triangles_are_our_springs():
    """Style3D, which has no springs: after many iterations x1 = x0 + h (v0 + h a(x1)), of our
    forces. Of the velocity it then takes two thousandths away.
    """
    scene, h = sheet(), 0.05
    model = newton_model.model_of(scene, "SolverStyle3D")
    stepper = newton_model.Stepper(model, "SolverStyle3D", iterations=100)
    (x0, v0), forces = start_of(scene), ode.Forces(scene)
    stepper.advance(h, 1)
    x1, v1 = stepper.positions().astype(float), stepper.velocities().astype(float)
    moved = (x1 - x0) / h
    np.testing.assert_allclose(moved, v0 + h * forces.acceleration(x1, moved), atol=1e-4)
    np.testing.assert_allclose(v1, 0.998 * moved, atol=1e-5)


@needs_peers
@thorough
@pytest.mark.parametrize(("solver", "iterates"), newton_model.SOLVERS.values())
def test_newtons_contacts_are_where_ours_are(solver, iterates):
    """A sheet that falls on the sphere, over it and on the floor: free at first, never inside.

    Recorded steps have the bits of launched ones, also in requests of an odd number.
    """
    scene, steps = problems.drape(5), 16 if iterates else 96
    h, settings = 1 / 60 / steps, {"iterations": 10} if iterates else {}
    model = newton_model.model_of(scene, solver, 1e4)
    stepper = newton_model.Stepper(model, solver, **settings)
    recorded = newton_model.Stepper(model, solver, recorded=True, **settings)
    stepper.advance(h, 2 * steps)
    fallen = scene.particles.position[:, 1] - stepper.positions()[:, 1]
    np.testing.assert_allclose(fallen, 9.81 / 2 * (2 / 60) ** 2, rtol=0.1)
    stepper.advance(h, 24 * steps)
    recorded.prepare(h, 25)
    for request in (25, 1, 26 * steps - 26):
        recorded.advance(h, request)
    np.testing.assert_array_equal(recorded.positions(), stepper.positions())
    np.testing.assert_array_equal(recorded.velocities(), stepper.velocities())
    x = stepper.positions().astype(float)
    from_sphere = np.linalg.norm(x - [1.0, problems.RADIUS, 0.0], axis=1) - problems.RADIUS
    assert problems.NEAR / 2 < x[:, 1].min() < 2 * problems.NEAR
    assert problems.NEAR / 2 < from_sphere.min() < 2 * problems.NEAR


def test_what_newton_has_not_is_refused():
    full = problems.build("cloth")
    with pytest.raises(InputError, match="scene 'cloth': Newton's models here have no drag"):
        newton_model.model_of(full)
    for problem in problems.all_problems(quick=False):
        assert not newton_model.lacking(problem.scene)
        said = newton_model.lacking(problem.scene, "SolverStyle3D")
        assert ("Style3D has" in said) == problem.key.startswith("warp")
    smooth = problems.drape(5)
    rough = replace(smooth, world=replace(smooth.world, friction=0.4))
    assert newton_model.lacking(rough) == "Newton's models here have no friction"
    hanging = replace(smooth, springs=smooth.springs.select(np.arange(len(smooth.springs)) > 0))
    assert "no springs but those along" in newton_model.lacking(hanging, "SolverStyle3D")


def test_who_takes_part_where():
    """Contacts: nobody whose equation has none, and each stiffness of those that are springs."""
    *_, drape = problems.all_problems(quick=True)
    fit = [k for k in contestants.kinds(True, True) if not contestants.unfit(k, drape)]
    assert {kind.group for kind in fit} == {"ours", *newton_model.SOLVERS}
    assert sum(kind.group == "Newton, VBD" for kind in fit) == len(contestants.CONTACTS)
    assert all(k.arguments["topology"] == "lanes" for k in fit if k.group == "ours")
    seed, warp, *_ = problems.all_problems(quick=True)
    fit = {k.name for k in contestants.kinds(True) if not contestants.unfit(k, seed)}
    left = {k.name for k in contestants.kinds(True) if contestants.unfit(k, warp)}
    assert {"SciPy, Radau", "Newton, Style3D"} <= fit and left == {"Newton, Style3D"}


@pytest.mark.parametrize("solver", contestants.SCIPY.values())
def test_scipys_solvers_meet_a_closed_form(solver, tmp_path):
    """A mass on a spring with a dashpot: x = A exp(-d t) cos(w t), to their tolerance."""
    k, c, m, a = 4.0, 0.4, 1.0, 0.25
    position = np.array([[2.0, 1.0], [1.0 - a, 1.0]])
    scene = Scene(
        name="mass",
        world=World(size=(3.0, 3.0), gravity=(0.0, 0.0), dt=0.1),
        particles=Particles.build(position, fixed=[True, False], mass=m, viscous=0.0, radius=0.0),
        springs=Springs.build([[0, 1]], position, stiffness=k, rest_length=1.0, damping=c),
    )
    d = c / (2 * m)
    w = np.sqrt(k / m - d**2)
    t = 0.1 * np.arange(21)
    expected = 1.0 - a * np.exp(-d * t) * (np.cos(w * t) + d / w * np.sin(w * t))
    (tmp_path / "scene").write_bytes(pickle.dumps(scene))
    trial = ScipyTrial(str(tmp_path / "scene"), solver, 0.5, 1.0, patience=60.0)
    asked = {"dt": 0.1, "solver": {"tolerance": 1e-7}, "frames": 20}
    assert not trial.sample(**asked, file=str(tmp_path / "run.npz"))["failed"]
    run = Samples.read(tmp_path / "run.npz")
    np.testing.assert_allclose(run.x[:, 1, 0], expected, atol=1e-5)
    assert trial.time(**asked, budget=0.0)[0] > 0
    hasty = ScipyTrial(str(tmp_path / "scene"), solver, 0.5, 1.0, patience=0.0)
    says = hasty.sample(**asked, file=str(tmp_path / "run.npz"))["failed"]
    assert says == "failed: took more than 0 s"


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_the_pattern_has_every_entry_of_the_jacobian(damping):
    scene = net(damping)
    forces, y = ode.Forces(scene), np.concatenate([part.ravel() for part in start_of(scene)])
    steps = 1e-6 * np.eye(len(y))
    columns = [(forces.slope(0, y + e) - forces.slope(0, y - e)) / 2e-6 for e in steps]
    there = np.abs(np.array(columns).T) > 1e-7
    allowed = jacobian_pattern(scene).toarray() != 0
    assert not (there & ~allowed).any()
    if damping:  # the held particle's rows are the only ones with less
        free = np.tile(np.repeat(~scene.particles.fixed, 3), 2)
        assert (there == allowed)[free][:, free].mean() > 0.9


# ------------------------------------------------------------------------------------------
# The part


def little(monkeypatch, kinds):
    """The part on a cloth of 4 x 4 alone, with these contestants, DOP853 as the reference."""
    scene = problems.warp(4, damped=False)
    problem = problems.Problem("little", "a little cloth", scene, 4)
    smooth = ode.solve(scene, np.arange(5) * scene.world.dt)
    samples = Samples(smooth.x, smooth.v, np.ones((5, 0), bool))
    free = ~scene.particles.fixed
    truth = Truth(samples, free, "DOP853", scale=0.02, floor=1e-9, speed=0.6)
    monkeypatch.setattr(equal_error, "all_problems", lambda quick: [problem])
    monkeypatch.setattr(equal_error, "truth_of", lambda *_: truth)
    monkeypatch.setattr(equal_error, "kinds", lambda *_: kinds)


def test_the_part_tells_who_is_cheapest_at_each_level(monkeypatch, tmp_path):
    dop853, _, bdf = [k for k in contestants.kinds(True) if k.package == "scipy"]
    blunt = replace(bdf, group="blunt", name="blunt", ladders=((Choice(tolerance=0.5),),))
    absent = replace(bdf, group="absent", name="absent", package="no-such-package")
    little(monkeypatch, [replace(dop853, group="ours", name="ours, a"), bdf, blunt, absent])
    again = {"name": "SciPy, BDF, again", "way": "again"}  # another way in the same process
    other_way = lambda kind, _: replace(kind, **again) if kind is bdf else None  # noqa: E731
    monkeypatch.setattr(contestants.Kind, "other_way", other_way)
    bench = contest.Bench(rounds=2, quick=True, results=tmp_path)
    try:
        rows = list(equal_error.measure(bench))
    finally:
        bench.close()
    timed = [row for row in rows if row.seconds is not None]
    for level in equal_error.LEVELS:
        at = f"a little cloth: {100 * level:g} %"
        here = {row.contestant.partition(":")[0]: row for row in timed if row.size == at}
        assert {"ours", "SciPy, BDF", "SciPy, BDF, again"} <= set(here)
        assert here["SciPy, BDF, again"].contestant.startswith("SciPy, BDF, again: tolerance ")
        assert all(row.error <= level and row.rounds == 2 for row in here.values())
        (ratio,) = [row for row in rows if row.is_ratio and row.size == at]
        peers = [row.seconds for name, row in here.items() if name != "ours"]
        assert ratio.rate == pytest.approx(min(peers) / here["ours"].seconds)
        assert ratio.target == (">= 10" if level == 0.01 else ">= 1")
    said = {row.contestant: row.note for row in bench.left_out}
    assert "pip install" in said["absent"]
    assert "up to one that took 1 s, has an error of at most " in said["blunt"]
    (kept,) = tmp_path.glob(f"*{runs_file.SUFFIX}")
    runs = runs_file.read(kept)
    assert {run.group for run in runs} == {"ours", "SciPy, BDF", "blunt"}
    (row,) = [row for row in timed if (row.contestant[:4], row.size) == ("ours", AT_ONE)]
    ours = [run.tried for run in runs if run.group == "ours"]
    (best,) = [one for one in ours if row.contestant == f"ours: a, {one.choice.describe()}"]
    least = cheapest(ours, 0.01).seconds  # to the digits of the file, where two may take as long
    assert best.meets(0.01) and best.seconds == pytest.approx(least, rel=1e-3)
    assert row.error == pytest.approx(best.error, rel=1e-3)
    headers, lines = report.by_level(rows)
    assert headers == ["scene", "solver", "10 %", "1 %", "0.1 %", "0.01 %"]
    table = {line[1]: dict(zip(headers, line, strict=True)) for line in lines}
    assert {"ours", "SciPy, BDF", "best peer's time to ours"} <= set(table)
    assert table["ours"]["1 %"].endswith(f": a, {best.choice.describe()}")
    assert f"error {percent(best.error, 2)}" in table["ours"]["1 %"]
    assert "at least 10" in table["best peer's time to ours"]["1 %"]
    assert report.markdown(rows).startswith("| scene | solver | 10 % | 1 % |")
    (drawn,) = tmp_path.glob("*.png")
    assert drawn.read_bytes()[:4] == picture.draw(runs)[:4] == b"\x89PNG"


@thorough
def test_ours_is_raced_on_all_cores_too(monkeypatch):
    """At each level its rows, and the ratio of the quicker, with its target; of one thread, too,
    where that is not the quicker.
    """
    ours = next(contestants.kinds(True))
    bdf = next(k for k in contestants.kinds(True) if k.name == "SciPy, BDF")
    assert ours.threads == bdf.threads == 1 and bdf.other_way(2) is ours.other_way(1) is None
    little(monkeypatch, [ours, bdf])
    bench = contest.Bench(rounds=2, quick=True)
    bench.threads = 2
    try:
        rows = [row for row in equal_error.measure(bench) if row.size == AT_ONE]
    finally:
        bench.close()
    timed = {row.contestant.partition(":")[0]: row for row in rows if row.seconds is not None}
    assert list(timed) == ["ours", "ours, 2 threads", "SciPy, BDF"]
    one, two = timed["ours"], timed["ours, 2 threads"]
    assert (one.threads, one.execution) == (1, "serial")
    assert (two.threads, two.execution) == (2, "parallel") and two.error == one.error
    settings = {row.contestant.partition(": ")[2] for row in (one, two)}
    assert len(settings) == 1 and "threads" not in settings.pop()
    ratios = {row.contestant.partition(":")[0]: row for row in rows if row.is_ratio}
    quicker = min(one.seconds, two.seconds)
    main = ratios.pop("best peer's time to ours")
    assert main.rate == pytest.approx(timed["SciPy, BDF"].seconds / quicker)
    assert main.target == ">= 10"
    assert list(ratios) == ["best peer's time to ours, one thread"] * (quicker == two.seconds)
    for row in ratios.values():
        assert row.rate == pytest.approx(timed["SciPy, BDF"].seconds / one.seconds)
        assert row.target == ""


def count_runs(monkeypatch, at=None, act=None):
    """A list that gets (solver, setting) of each run; before run number `at`, `act(entrant)`."""
    made, run = [], contestants.Entrant._run

    def counted(entrant, choice):
        made.append((entrant.kind.name, choice.describe()))
        if len(made) == at:
            act(entrant)
        return run(entrant, choice)

    monkeypatch.setattr(contestants.Entrant, "_run", counted)
    return made


def searched(folder, **piece):
    """The part, measured in a piece: its rows, what it says it left out, and its runs."""
    bench = contest.Bench(rounds=2, quick=True, results=folder, piece=contest.Piece(**piece))
    try:
        rows = list(equal_error.measure(bench))
    finally:
        bench.close()
    kept = list(folder.glob(f"*{runs_file.SUFFIX}"))
    runs = [(r.contestant, r.setting, r.error) for p in kept for r in runs_file.read(p)]
    return rows, bench, runs


def interrupt(entrant):
    raise KeyboardInterrupt


def kill_worker(entrant):
    os.kill(entrant._worker._process.pid, signal.SIGKILL)


def test_a_search_that_was_killed_goes_on_and_measures_nothing_twice(monkeypatch, tmp_path, capsys):
    dop853, radau, _ = [k for k in contestants.kinds(True) if k.package == "scipy"]
    little(monkeypatch, [replace(dop853, group="ours", name="ours, a"), radau])
    with monkeypatch.context() as patch:
        whole = count_runs(patch)
        _, _, runs = searched(tmp_path / "whole")
    assert [(name, setting) for name, setting, _ in runs] == whole
    folder = tmp_path / "killed"
    with monkeypatch.context() as patch:
        first = count_runs(patch, 9, interrupt)
        with pytest.raises(KeyboardInterrupt):
            searched(folder)
    assert "--resume goes on with 8 finished results in" in capsys.readouterr().err
    with monkeypatch.context() as patch:
        patch.setattr(equal_error.identity, "of_place", lambda: {"machine": "another one"})
        with pytest.raises(InputError, match="its machine is '.*', here it is 'another one'"):
            searched(folder, resume=True)
    with monkeypatch.context() as patch:
        patch.setattr(machine, "versions", lambda packages: "newton 99")
        with pytest.raises(InputError, match="its versions are '.*', here they are 'newton 99'"):
            searched(folder, resume=True)
    with monkeypatch.context() as patch:
        second = count_runs(patch, 5, kill_worker)
        rows, _, resumed = searched(folder, resume=True)
    # What was interrupted is asked for again. The cheapest may differ, and so what is refined.
    assert first[:8] == whole[:8] and second[0] == first[8]
    asked = first[:8] + second
    assert len(set(asked)) == len(asked)
    errors = {(name, setting): error for name, setting, error in runs}
    same = [(errors[name, s], e) for name, s, e in resumed if (name, s) in errors]
    assert len(same) > 15 and all(one == other for one, other in same)
    assert [row for row in rows if row.size == AT_ONE and row.is_ratio]
    assert not list(folder.glob(f"*{equal_error.JOURNAL}"))


def test_a_table_is_filled_scene_by_scene_in_the_time_there_is(monkeypatch, tmp_path):
    dop853, _, _ = [k for k in contestants.kinds(True) if k.package == "scipy"]
    little(monkeypatch, [replace(dop853, group="ours", name="ours, a")])
    (problem,) = equal_error.all_problems(True)
    other = replace(problem, key="other", name="another cloth")
    monkeypatch.setattr(equal_error, "all_problems", lambda quick: [other, problem])
    path = tmp_path / "results.csv"

    def piece(**asked):
        rows, bench, _ = searched(tmp_path, **asked)
        report.replace_part(path, {}, "accuracy", [*rows, *bench.left_out], bench.scenes)
        shown = [row for row in report.read(path)[1] if row.seconds is not None]
        (search,) = tmp_path.glob(f"*{runs_file.SUFFIX}")
        scenes = {row.size.rpartition(": ")[0] for row in shown}
        assert {run.scene for run in runs_file.read(search)} == scenes
        return shown, {row.size: row.note for row in bench.left_out}

    first, _ = piece(scenes=["little"])
    assert {row.size.partition(": ")[0] for row in first} == {"a little cloth"}
    with monkeypatch.context() as patch:
        made = count_runs(patch)
        rows, said = piece(clock=Clock(-1.0))
    assert not made and rows == first
    assert "not finished in -1 s; --resume goes on" in said["another cloth"]
    both, said = piece(scenes=["other"])
    assert "another cloth" not in said and both[-len(first) :] == first
    assert both[0].size == "another cloth: 10 %"
    with pytest.raises(InputError, match="--scenes: unknown scene 'litle'; did you mean 'little'"):
        piece(scenes=["litle"])


def test_pieces_are_asked_for_of_the_part_that_has_them(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["bench", "warp", "--within", "60s"]) == 2
    assert "--within: only the part accuracy takes it, alone" in capsys.readouterr().err
    assert main(["bench", "accuracy", "--scenes", "sed"]) == 2
    out, err = capsys.readouterr()
    assert "--scenes: unknown scene 'sed'; did you mean 'seed'" in err and not out
    assert main(["bench", "accuracy", "--scenes", ",", "--within", "5s"]) == 2
    out, err = capsys.readouterr()
    assert "--scenes: names nothing; known: seed, warp, " in err and not out


@needs_peers
@thorough
def test_ours_and_newtons_solve_the_same_cloth(monkeypatch):
    """Each of them comes below 1 % of the reference: the scene is the same in every program."""
    with_springs = set(newton_model.SOLVERS) - {"Newton, Style3D"}
    wanted = ("ours, verlet, f32", *with_springs)
    kinds = [kind for kind in contestants.kinds(True) if kind.name in wanted]
    # With the fewest iterations, as those that take ten times as many are minutes.
    little(monkeypatch, [replace(kind, ladders=kind.ladders[:1]) for kind in kinds])
    bench = contest.Bench(rounds=2, quick=True)
    try:
        rows = list(equal_error.measure(bench))
    finally:
        bench.close()
    timed = [row for row in rows if row.seconds and row.size == AT_ONE]
    met = {row.contestant.partition(":")[0]: row for row in timed}
    cores = bench.threads
    ways = [f"{name}, {way}" for name in with_springs for way in ("recorded", "launched")]
    assert set(met) == {"ours", *[f"ours, {cores} threads"] * (cores > 1), *ways}
    assert all("spring_stiffness is k" in met[way].note for way in ways)
    (ratio,) = [row for row in rows if row.size == AT_ONE and row.target]
    fastest = min(met[way].seconds for way in ways)
    ours = min(row.seconds for name, row in met.items() if name.startswith("ours"))
    assert ratio.rate == pytest.approx(fastest / ours)
