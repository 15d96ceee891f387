"""Budgets: what is chosen for a frame's time and for an error, from what was measured alone."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from taichi_cloth.budgets import methods, seconds
from taichi_cloth.budgets.choice import RUNGS, Limits
from taichi_cloth.budgets.frames import Frame, FrameTimes
from taichi_cloth.budgets.goal import read
from taichi_cloth.budgets.keeper import FOLDS, LOOK, OFTEN, Keeper
from taichi_cloth.budgets.methods import Rival, Rivals
from taichi_cloth.budgets.seconds import Second, SecondErrors
from taichi_cloth.budgets.solver import PATIENCE, SolverErrors
from taichi_cloth.error_meter.others import Trial, results
from taichi_cloth.error_meter.verdict import Verdict
from taichi_cloth.scene import library


def held(times, cost, count, limits, now=1):
    """The substeps of `count` frames whose simulation takes cost(substeps, frame) seconds."""
    taken = []
    for frame in range(count):
        if frame % OFTEN == 0:
            now = times.choose(int(now), limits).substeps
        taken.append(now)
        times.note(Frame(now, *cost(now, frame)))
    return np.array(taken)


def noisy(a, b, draw, seed, noise=0.2):
    """A frame's cost with noise of a fifth, and one frame in forty that the machine holds up."""
    rng = np.random.default_rng(seed)

    def cost(substeps, frame):
        late = 0.03 if rng.random() < 1 / 40 else 0.0
        factor = np.clip(rng.normal(1.0, noise / 2, 2), 1 - noise, 1 + noise)
        return (a + b * substeps) * factor[0] + late, draw * factor[1]

    return cost


@pytest.mark.parametrize(
    ("a", "b", "draw"), [(2e-4, 3e-4, 5e-3), (1e-3, 2e-3, 2e-3), (1e-5, 2e-5, 6e-3)]
)
def test_a_time_budget_takes_about_the_most_that_fits(a, b, draw):
    """Within two rungs of what fits, in time in 95 % of the frames, and without fluttering."""
    for seed in range(2):
        cost = noisy(a, b, draw, seed)
        taken = held(FrameTimes(1 / 60), cost, 3600, Limits())
        fits = (0.85 / 60 - draw * 1.1 - a) / (b * 1.1)
        best = max(n for n in RUNGS if n <= fits)
        near = RUNGS[max(RUNGS.index(best) - 2, 0)], RUNGS[RUNGS.index(best) + 2]
        assert near[0] <= taken[-1] <= near[1]
        again = [sum(cost(n, 0)) <= 1 / 60 for n in taken[600:]]
        assert np.mean(again) > 0.95
        assert (np.diff(taken[900:]) != 0).sum() <= 3


def test_a_time_budget_follows_the_scene():
    """A scene that takes four times as long gets fewer substeps within a second, and more again."""
    times = FrameTimes(1 / 60)
    quick, slow = noisy(1e-4, 4e-4, 4e-3, 1), noisy(4e-4, 16e-4, 4e-3, 2)
    first = held(times, quick, 900, Limits())
    second = held(times, slow, 600, Limits(), first[-1])
    third = held(times, quick, 5400, Limits(), second[-1])
    assert first[-1] >= 16 and second[60:].max() <= 8 and second[-1] >= 4
    assert third[-1] >= 16
    late = [sum(slow(n, 0)) > 1 / 60 for n in second]
    assert np.mean(late) < 0.1


def test_what_was_too_much_is_not_tried_again_for_twice_as_long_each_time():
    times = FrameTimes(0.01)
    for _ in range(60):
        times.note(Frame(8, 0.02, 0.0))
    for frames in (600, 1200, 2400):
        times._fewer(8, [4], 1)
        assert times._too_many[8] == (60 + frames, frames)


def test_a_time_budget_never_leaves_its_limits_and_says_what_is_in_the_way():
    """Neither below the stable steps, however slow, nor above what the precision follows."""
    times = FrameTimes(1 / 60)
    taken = held(times, noisy(1e-3, 8e-3, 4e-3, 3), 600, Limits(least=3, most=8))
    assert taken.min() == taken[-1] == 3
    choice = times.choose(3, Limits(least=3, most=8))
    assert not choice.met and "fewer are not stable" in choice.why
    times = FrameTimes(1 / 60)
    taken = held(times, noisy(1e-5, 1e-5, 4e-3, 4), 1200, Limits(most=48, why_most="f32"))
    assert taken.max() == taken[-1] == 48
    assert times.choose(48, Limits(most=48, why_most="f32")).why.endswith("no more: f32")
    times = FrameTimes(1 / 60)
    held(times, noisy(1e-4, 1e-4, 0.02, 5), 300, Limits())
    assert "drawing takes" in times.choose(1, Limits()).why
    for drawing, says, of_it in ((0.2, "250", "200"), (0.0496, "100", "50")):
        times = FrameTimes(1 / 60)  # as a software driver draws a large window
        held(times, lambda n, _, drawing=drawing: (0.05, drawing), 300, Limits())
        slow = times.choose(1, Limits())
        assert slow.short == f"{says} of 16.7 ms, 100 % late"
        assert slow.why.endswith(f"drawing takes {of_it}")


def test_a_time_budget_says_what_the_next_would_take():
    times = FrameTimes(1 / 60)
    held(times, lambda n, _: (1e-3 * n, 1e-3), 600, Limits())
    assert times.choose(12, Limits()).why == (
        "12 substeps: 13 ms of 16.7 ms; next finer, 14, would take 15"
    )


def second_of(n, c, p, rng, noise=1.5):
    """A second whose error is about c n^-p, by up to a factor of noise."""
    error = c * n ** -float(p) * noise ** rng.uniform(-1, 1)
    tries = [(k, error * (n / k) ** float(p)) for k in (n // 4, n // 2, n, 2 * n, 4 * n) if k]
    return Second(n, error, tries=tries)


@pytest.mark.parametrize(("c", "p"), [(0.02, 1), (0.3, 1), (0.5, 2), (1e-4, 1)])
def test_an_error_budget_takes_about_the_fewest_that_meet_it(c, p):
    """In 95 % of the seconds within the goal, and not finer than that takes with its margins."""
    rng, goal, now = np.random.default_rng(1), 0.01, 2
    errors, taken, kept = SecondErrors(goal, p), [], []
    for _ in range(120):
        now = errors.choose(now, Limits(least=2)).substeps
        second = second_of(now, c, p, rng)
        errors.note(second, torn=False)
        taken.append(now)
        kept.append(second.error <= goal)
    assert np.mean(kept) >= 0.95
    fewest = max(2.0, (c * 1.5 / goal) ** (1 / p))
    assert taken[-1] <= 1.3 * max(2.0, (c * 1.5 / (seconds.MARGIN * goal)) ** (1 / p)) + 1
    assert taken[-1] >= fewest * 0.99
    assert (np.diff(taken[30:]) != 0).sum() <= 9  # one in ten seconds, which are remembered
    assert min(taken) >= 2


def test_an_error_budget_gets_coarser_only_by_what_was_measured_since():
    errors = SecondErrors(0.01, 1)
    for _ in range(seconds.PATIENCE):
        errors.note(Second(16, 1e-4), torn=True)
        early = errors.choose(16, Limits()).substeps
        assert early == (16 if len(errors.sure) < seconds.PATIENCE else 8)
    assert errors.choose(8, Limits()).substeps == 8  # asked once more, as when springs break
    errors = SecondErrors(0.01, 1)  # as far as it was tried at once
    for _ in range(seconds.PATIENCE):
        errors.note(Second(16, 1e-4, tries=[(16, 1e-4), (8, 1e-3), (4, 2e-3), (2, 8e-3)]), False)
    assert errors.choose(16, Limits()).substeps == 4


def test_a_calmed_scene_is_held_by_what_its_last_seconds_took():
    """After ten seconds, but where somebody acted, who may do so again; rest takes the fewest."""
    for acted, chosen in ((False, 4), (True, 40)):
        errors = SecondErrors(0.01, 1)
        errors.note(Second(40, 0.005, acted=acted), torn=False)
        for _ in range(seconds.RECENT):
            errors.note(Second(40, 5e-4, tries=[(40, 5e-4), (4, 0.005), (2, 0.01)]), torn=False)
        assert errors.choose(40, Limits()).substeps == chosen
    errors = SecondErrors(0.01, 1)
    errors.note(Second(40, 0.005), torn=False)
    for _ in range(seconds.RECENT):
        errors.rest(40)
    assert errors.choose(40, Limits(least=2)).substeps == 20
    for _ in range(seconds.PATIENCE):
        errors.rest(3)
    assert errors.choose(3, Limits(least=2)).substeps == 2


def test_finer_steps_decide_also_where_the_next_ones_are_no_help():
    """An error that is saturated hides the order: what tries with far finer steps say is taken."""
    errors, tries = SecondErrors(0.01, 4), [(24, 0.05), (48, 0.051), (96, 0.03), (192, 1e-3)]
    errors.note(Second(24, 0.05, tries=tries), torn=False)
    choice = errors.choose(24, Limits())
    assert 128 < choice.substeps < 192 and choice.met
    assert errors.would_be(errors.sure[0], 192) == pytest.approx(1e-3)
    assert errors.would_be(errors.sure[0], 96) == pytest.approx(0.03)
    # Where small disturbances grow, others may be worse: of fourth order by 1000 so 5.6 times as
    # many, and of first order as many as are spared at most.
    for order, times in ((4, 5.6), (1, seconds.MOST_SPARED)):
        errors = SecondErrors(0.01, order)
        errors.note(Second(24, 0.05, tries=tries, growth=5e4), torn=False)
        assert errors.spare() == [pytest.approx(times, rel=0.01)]
        assert errors.needed == pytest.approx(times * errors.needs(errors.sure[0]), rel=0.01)
    assert "as small disturbances grow" in errors.choose(24, Limits()).why


def test_where_disturbances_grow_a_run_gets_no_coarser_than_its_start_before_more_was_seen():
    errors, limits = SecondErrors(0.01, 4), Limits(least=3)
    for _ in range(seconds.RECENT - 1):
        errors.note(Second(24, 1e-5, growth=1e4), torn=False)
        assert errors.wanted(limits) == 3 * seconds.FIRST and errors.restless
    errors.note(Second(24, 1e-5, growth=1e4), torn=False)
    assert errors.wanted(limits) == errors.needed < 24
    calm = SecondErrors(0.01, 4)
    calm.note(Second(24, 1e-5, growth=10.0), torn=False)
    assert not calm.restless and calm.wanted(limits) == calm.needed < 24


def test_what_swings_far_undamped_is_taken_for_what_folds_soon():
    """At first: a chain that is let go swings calmly, and then whips."""
    scene = library.build("chain", particles=8)
    keeper = object.__new__(Keeper)
    keeper._sim, keeper._verdicts = SimpleNamespace(scene=scene), 0
    extent = float(np.linalg.norm(np.ptp(scene.particles.position, axis=0)))
    far = Verdict(0, 60, error=1e-3, scale=0.5 * extent, growth=0.0, judged=60)
    assert keeper._growth(far) == FOLDS
    assert keeper._growth(replace(far, scale=0.1 * extent)) == 1.0
    assert keeper._growth(replace(far, growth=0.3)) == pytest.approx(np.exp(18.0))
    keeper._verdicts = seconds.RECENT
    assert keeper._growth(far) == 1.0
    keeper._verdicts, damped = 0, np.full(8, 0.1)
    particles = replace(scene.particles, viscous=damped)
    keeper._sim = SimpleNamespace(scene=replace(scene, particles=particles))
    assert keeper._growth(far) == 1.0


def test_a_small_growth_is_worth_no_more_substeps():
    errors = SecondErrors(0.01, 1)
    errors.note(Second(8, 0.005, growth=seconds.CALM), torn=False)
    assert errors.spare() == [1.0]


def test_where_an_error_is_all_roundings_steps_get_coarser():
    errors = SecondErrors(0.01, 2)
    for _ in range(seconds.PATIENCE):
        errors.note(Second(32, 1e-5, rounding=1.1e-5), torn=False)
    assert errors.needed < 1 and errors.choose(32, Limits()).substeps == 16
    errors.note(Second(32, 0.05, solver=0.05), torn=False)
    assert errors.needs(errors.sure[-1]) == 32


def test_an_error_budget_is_finer_while_springs_tear_that_no_second_showed():
    errors = SecondErrors(0.01, 1)
    for _ in range(6):
        errors.note(Second(4, 0.005), torn=False)
    calm = errors.choose(4, Limits()).substeps
    errors.tear()
    assert calm == 4 and errors.choose(calm, Limits()).substeps == 8  # 2 * 4 * 0.5 % / 0.5 %
    assert "tear" in errors.choose(calm, Limits()).why
    errors.note(Second(8, 0.002), torn=True)
    errors.tear()  # which a second has shown by now
    assert "tear" not in errors.choose(8, Limits()).why


@pytest.mark.parametrize("first", [200, 2])
def test_sweeps_leave_a_fair_part_of_the_error(first):
    """What they leave falls with their number, with noise: it ends between the two parts."""
    rng, now, solver, taken = np.random.default_rng(3), first, SolverErrors("iterations", "f32"), []
    for _ in range(200):
        before, now = now, solver.choose(now)
        if now != before:
            solver.changed(before, now)
        solver.note(6.0 / now * 1.2 ** rng.uniform(-1, 1))
        taken.append(now)
    assert 12 <= taken[-1] <= 60 and (np.diff(taken[60:]) != 0).sum() <= 3


def test_a_tolerance_is_tightened_at_once_and_loosened_by_half_decades():
    tight, loose = SolverErrors("tolerance", "f32"), SolverErrors("tolerance", "f64")
    tight.note(0.9)
    assert tight.choose(1e-3) == 1e-4 and tight.work(1e-3, 1e-4) == pytest.approx(4 / 3)
    tight.changed(1e-3, 1e-4)
    tight.note(0.89)  # which was no help
    assert tight.choose(1e-4) == 1e-4
    for _ in range(PATIENCE):
        assert loose.choose(1e-6) == 1e-6
        loose.note(1e-3)
    assert loose.choose(1e-6) == 3.2e-6
    for precision in ("f32", "compensated"):
        tight = SolverErrors("tolerance", precision)
        tight.note(5.0)
        assert tight.choose(1e-6) == 1e-6  # f32 follows no smaller one


def test_a_setting_of_a_solver_that_was_chosen_and_not_taken_is_no_try():
    """Where there is no time for it; and what was no help is tried again after a looser one."""
    solver = SolverErrors("iterations", "f32")
    for _ in range(2):
        solver.note(0.9)
        assert solver.choose(10) == 36
    solver.changed(10, 36)
    solver.note(0.89)
    assert solver.choose(36) == 36
    solver.changed(36, 24)
    solver.note(0.9)
    assert solver.choose(24) == 87


def test_a_solver_is_judged_by_seconds_that_it_solved(pool, monkeypatch):
    """Not by those of before another setting; after a reset by those from the start on."""
    sim = pool(library.build("cloth", columns=4, rows=3))
    monkeypatch.setattr(sim, "solver", {"iterations": 10})
    sim.advance(LOOK)
    keeper = Keeper(sim, read("1%"))
    keeper._solvers = [SolverErrors("iterations", "f32")]
    known = {"error": 0.02, "scale": 1.0, "size": 1.0, "solver": 0.016, "own_substeps": 1}
    verdict = Verdict(0, LOOK, method=sim.method, **known)
    assert keeper.choose([verdict]).solver == {"iterations": 10}
    assert keeper._errors.sure[0].error == pytest.approx(0.004)
    sim.reset()
    verdicts = [verdict, *[replace(verdict, solver=None)] * PATIENCE]  # no time to see what it left
    assert keeper.choose(verdicts).solver == {"iterations": 10}
    assert keeper.choose([*verdicts, verdict]).solver == {"iterations": 40}


def test_where_a_solver_goes_farther_for_fewer_substeps_these_are_said(pool, monkeypatch):
    sim = pool(library.build("cloth", columns=4, rows=3), substeps=8)
    monkeypatch.setattr(sim, "solver", {"iterations": 10})
    keeper = Keeper(sim, read("60fps"))
    keeper._solvers = [SolverErrors("iterations", "f32")]
    keeper._solvers[0].note(0.9)
    choice = keeper.choose(())
    assert choice.solver == {"iterations": 36} and choice.why.startswith(f"{choice.substeps} subst")
    assert choice.substeps < 8


def test_what_a_solver_leaves_asks_for_no_finer_steps():
    errors = SecondErrors(0.01, 1)
    errors.note(Second(8, 0.02, solver=0.016), torn=False)
    assert errors.needs(errors.sure[0]) == pytest.approx(8 * 0.004 / 0.0025)
    errors.solve_otherwise()
    assert errors.sure[0].error == pytest.approx(0.004)


def test_an_error_budget_says_what_is_in_the_way():
    """Rounding, limits, chance, and that there is no error at all."""
    errors = SecondErrors(0.01, 1)
    errors.note(Second(4, 0.02, rounding=0.015), torn=False)
    assert not errors.choose(4, Limits()).met
    assert "rounding alone makes 1.5 %" in errors.choose(4, Limits()).why
    errors = SecondErrors(0.01, 1)
    errors.note(Second(4, 0.2), torn=False)
    choice = errors.choose(4, Limits(most=8, why_most="frames would take more than 100 ms"))
    assert choice.substeps == 8 and not choice.met and choice.why.endswith("more than 100 ms")
    assert choice.short == "error 10 %"  # after "hold 1%: "
    choice = errors.choose(4, Limits(most=80, why_most="f32"))
    assert choice.substeps == 16 and choice.why.endswith("may ask for 4 times as many at most")
    errors = SecondErrors(0.01, 1)
    errors.note(Second(4, 0.2, tries=[(4, 0.2), (8, 0.18), (64, 0.15)]), torn=False)
    choice = errors.choose(4, Limits())
    assert choice.substeps == 4 and not choice.met
    assert choice.why.endswith("finer steps are no help: 64 still make 15 %")
    errors = SecondErrors(0.01, 1)
    for _ in range(3):
        errors.note(Second(4, 0.2, trouble="two references differ"), torn=False)
    choice = errors.choose(4, Limits())
    assert choice.substeps == 4 and "no error to keep to: two references differ" in choice.why


def test_measured_rounding_bounds_what_a_time_budget_takes():
    """With more substeps than its rounding allows a run would be less accurate, not more."""
    errors = SecondErrors(1.0, 1)
    assert errors.best() is None
    errors.note(Second(10, 0.011, rounding=0.001), torn=False)
    n = np.arange(1.0, 2000.0)
    total = 0.01 * 10 / n + 0.001 * n / 10
    assert errors.best() == pytest.approx(n[total.argmin()], rel=0.02)
    errors = SecondErrors(1.0, 4)  # of fewer steps than were measured it counts on the claim
    errors.note(Second(48, 1.001e-5, rounding=1e-5), torn=False)
    total = 1e-8 * (48 / n) ** 4 + 1e-5 * n / 48
    assert errors.best() == pytest.approx(n[total.argmin()], abs=1)


def test_the_best_substeps_are_enough_for_as_many_seconds_as_the_order_says():
    """Of order 2 for two in three: too few steps are wrong by twice as many powers as too many.

    With these shares of rounding each second is at its best with the substeps that it had.
    """
    errors = SecondErrors(0.01, 2)
    for substeps in (10, 40, 70, 100):
        errors.note(Second(substeps, error=1.5e-5, rounding=1e-5), torn=False)
    assert errors.best() == pytest.approx(70.0)


def tried(trials, errors, rounding=0.0):
    """(method, substeps) of each try; errors: by method, of so many substeps."""
    found = results(trials, lambda name, n: errors[name](n), rounding)
    return [(name, n) for name, n, _ in found]


def test_fewer_substeps_are_tried_as_long_as_their_error_is_within():
    trial, error = Trial("verlet", 20, 3, within=0.01), {"verlet": lambda n: 0.1 / n**2}
    assert [n for _, n in tried([trial], error)] == [20, 10, 5, 3]
    error = {"verlet": lambda n: 0.1 / n}
    assert [n for _, n in tried([trial], error)] == [20, 10, 5]
    by_rounding = replace(trial, within=None)
    for rounding, fewer in ((1e-3, [20, 10, 5]), (1e-5, [20])):
        error = {"verlet": lambda n: 0.1 / n**2}
        assert [n for _, n in tried([by_rounding], error, rounding)] == fewer


def test_finer_steps_of_all_methods_are_tried_until_the_cheapest_is_within():
    """At equal cost, then at twice that, and so on; a method that is too coarse there waits."""
    error = {"own": lambda n: 0.1, "rk4": lambda n: 0.1 if n < 24 else 0.001}
    trials = [Trial("own", 24, 3, 1536, 0.005), Trial("rk4", 6, 8, 384, 0.005)]
    expected = [("own", 24), ("own", 48), ("rk4", 12), ("own", 96), ("rk4", 24), ("own", 192)]
    assert tried(trials, error) == expected
    far = [Trial("own", 24, 3, 100, 0.005)]
    assert tried(far, error) == [("own", 24), ("own", 48), ("own", 96)]


# Errors in `n` substeps: of the present method (first order), and of others.
EULER, RK4 = Rival("symplectic_euler", 1.0, 2), Rival("rk4", 4.0, 1)
VERLET = Rival("verlet", 1.0, 2)


def judged(rivals, own, n, others, errors, count, rng=None, noise=1.5, rounding=0.0):
    """`count` seconds with n substeps, of which each method has errors c n^-p up to noise."""
    for _ in range(count):
        factor = noise ** rng.uniform(-1, 1) if rng else 1.0
        error = factor * errors["symplectic_euler"](n) + rounding
        tries = {}
        for name, k, found in results(
            rivals.trials(n, Limits(least=2), others),
            lambda name, k, f=factor: f * errors[name](k),
            rounding,
        ):
            tries.setdefault(name, []).append((k, found))
        second = Second(n, error, rounding, tries["symplectic_euler"])
        own.note(second, torn=False)
        rivals.note(second, tries, torn=False)


def test_an_error_is_held_by_the_method_that_is_clearly_cheapest():
    """Once enough seconds say so, from the substeps with which they met it; and by half as many
    steps as the present one, or it stays.
    """
    errors = {"symplectic_euler": lambda n: 0.1 / n, "verlet": lambda n: 0.4 / n**2}
    errors["rk4"] = lambda n: 0.2 / n**4
    rivals, own = Rivals("symplectic_euler", 0.01), SecondErrors(0.01, 1)
    others = [VERLET, RK4]
    for seconds_so_far in range(methods.ENOUGH):
        assert rivals.better(own, 16, Limits(least=2), others) is None
        assert ("to compare" in rivals.said(others)) == (seconds_so_far > 0)
        judged(rivals, own, 16, others, errors, 1)
    found = rivals.better(own, 16, Limits(least=2), others)
    assert found.method == "verlet" and 8 <= found.substeps <= 10  # 3 steps of rk4 cost 12
    assert found.why == "symplectic_euler would take 20"
    assert found.errors.choose(found.substeps, Limits(least=2)).substeps == found.substeps
    # By less than a rung it is left as it is.
    errors["verlet"] = lambda n: 0.1 / n**1.05
    rivals, own = Rivals("symplectic_euler", 0.01), SecondErrors(0.01, 1)
    judged(rivals, own, 16, others, errors, 20, np.random.default_rng(1))
    assert rivals.better(own, 16, Limits(least=2), [VERLET]) is None
    assert rivals.said([VERLET]).startswith("no other method is clearly better: verlet would take ")


def test_a_method_that_misses_the_error_is_left_after_one_second():
    """Where its own finer steps are no help; of a chain that folds, saturated errors."""
    errors = {"symplectic_euler": lambda n: 0.05, "verlet": lambda n: 0.04}
    errors["rk4"] = lambda n: 0.04 if n < 12 else 4e-4
    rivals, own = Rivals("symplectic_euler", 0.01), SecondErrors(0.01, 1)
    judged(rivals, own, 24, [VERLET, RK4], errors, 1)
    found = rivals.better(own, 24, Limits(least=2), [VERLET, RK4])
    assert found.method == "rk4" and found.substeps in (10, 12)
    assert found.why == "symplectic_euler would take more than 96"
    # Those that are not within go on once more than the cheapest.
    assert rivals.said([VERLET]).endswith("verlet would take more than 96")


def test_a_higher_order_is_worth_more_where_worse_seconds_are_to_come():
    """A disturbance's growth asks of a lower order for more substeps than are taken at once."""
    chosen = []
    for growth in (1.0, 5e4):
        rivals, own = Rivals("symplectic_euler", 0.01), SecondErrors(0.01, 1)
        second = Second(24, 0.05, tries=[(24, 0.05), (48, 0.04)], growth=growth)
        own.note(second, torn=False)
        others = {"verlet": [(24, 0.002), (12, 0.02)], "rk4": [(6, 0.003), (4, 0.02)]}
        rivals.note(second, others, torn=False)
        chosen.append(rivals.better(own, 24, Limits(least=2), [VERLET, RK4]).method)
    assert chosen == ["verlet", "rk4"]


def test_a_frames_time_is_held_by_the_method_with_the_smallest_error_at_equal_cost():
    errors = {"symplectic_euler": lambda n: 0.1 / n, "verlet": lambda n: 0.06 / n}
    errors["rk4"] = lambda n: 0.1 / n**3
    rivals, own, others = Rivals("symplectic_euler", None), SecondErrors(1.0, 1), [VERLET, RK4]
    own_order, verlet = rivals.trials(3, Limits(), others)  # not one of rk4 in that time
    assert (verlet.method, verlet.at(0)) == ("verlet", 3) and own_order.at(0) == 6
    judged(rivals, own, 32, others, errors, methods.ENOUGH)
    found = rivals.better(own, 32, Limits(least=2), others)
    assert (found.method, found.substeps) == ("rk4", 8)
    assert found.why == "in the same time symplectic_euler errs 16 times as much"
    only = rivals.better(own, 32, Limits(least=2), [VERLET])
    assert only is None and "verlet errs 0.6 times as much" in rivals.said(others)
    # Where rounding is most of what the present one errs, another one errs less by fewer steps.
    rivals, own = Rivals("symplectic_euler", None), SecondErrors(1.0, 1)
    errors["verlet"] = lambda n: 0.1 / n**4
    judged(rivals, own, 256, others, errors, methods.ENOUGH, rounding=4e-4)
    found = rivals.better(own, 256, Limits(least=2), [VERLET])
    assert (found.method, found.substeps) == ("verlet", 16)
    assert found.errors.sure[0].error == pytest.approx(0.1 / 16**4 + 4e-4 * 16 / 256)


def test_methods_do_not_go_to_and_fro():
    """Where luck decides which is better, each change takes twice as many seconds to say so."""
    rng, lucky = np.random.default_rng(2), 0
    for changes in range(4):
        rivals = Rivals("symplectic_euler", None, changes)
        for _ in range(200):
            second = Second(8, 0.01 * 4 ** rng.uniform(-1, 1))
            rivals.note(second, {"verlet": [(8, 0.01 * 4 ** rng.uniform(-1, 1))]}, torn=False)
            lucky += rivals.better(SecondErrors(1.0, 1), 8, Limits(), [VERLET]) is not None
        clear = Rivals("symplectic_euler", None, changes)
        for _ in range(min(methods.ENOUGH * 2**changes, methods.LATELY)):
            assert clear.better(SecondErrors(1.0, 1), 8, Limits(), [VERLET]) is None
            clear.note(Second(8, 0.01), {"verlet": [(8, 0.001)]}, torn=False)
        assert clear.better(SecondErrors(1.0, 1), 8, Limits(), [VERLET]).method == "verlet"
    assert lucky <= 8
    refused = [clear.refuse("verlet"), clear.better(SecondErrors(1.0, 1), 8, Limits(), [VERLET])]
    assert refused == [None, None]


def test_limits_offer_rungs_between_them():
    assert Limits(least=9, most=20).rungs() == [9, 10, 12, 14, 16, 20]
    assert Limits(least=30, most=3).rungs() == [30]
    assert Limits(least=2).at_least(2.5) == 3


def test_where_all_frames_are_late_their_share_is_a_number_one_can_read():
    times = FrameTimes(1 / 60)
    for _ in range(240):
        times.note(Frame(4, 0.03, 0.001))
    choice = times.choose(4, Limits(4, 4, "there are no more"))
    assert "100 % late" in choice.why and choice.short.endswith(", 100 % late")
