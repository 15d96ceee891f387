"""Advice: settings judged by the seconds of their runs, chosen from, and confirmed."""

import contextlib
import json
import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from selection import thorough
from test_trade import made_up

from taichi_cloth.advice import choice, judges, survey, tune
from taichi_cloth.cli.main import main
from taichi_cloth.error_meter.others import results
from taichi_cloth.error_meter.verdict import Verdict
from taichi_cloth.error_meter.window import Window
from taichi_cloth.errors import InputError
from taichi_cloth.scene import library
from taichi_cloth.sweeps.journal import Journal
from taichi_cloth.sweeps.within import Clock
from taichi_cloth.trade import reference, report, rows, trial
from taichi_cloth.trade.outcomes import Outcome, Result
from taichi_cloth.trade.seconds import Second
from taichi_cloth.trade.settings import Setting

# ------------------------------------------------------------------------------------------
# Seconds


@pytest.mark.parametrize("method", ["verlet", "implicit_midpoint"])
def test_the_seconds_of_a_setting_are_those_that_the_meter_of_its_run_notes(method, pool, tmp_path):
    """To the bit: where each began, with what, and what it showed."""
    scene = library.build("cloth", columns=5, rows=4)
    made = object.__new__(trial.Trial)
    made._sim, made._ran = sim, _ = pool(scene, method), set()
    setting = Setting(method, 0.5, 2, tolerance=1e-3 if method != "verlet" else None)
    solver = {"tolerance": 1e-3} if method != "verlet" else {}
    file = tmp_path / "a.npz"
    made.sample(0.5, 2, solver, 140, str(file))
    windows = judges.windows_of(scene, Outcome(setting, file=file))

    sim.set_step(0.5, 2)
    sim.reset()
    noted = []
    for frame in range(140):
        if frame % 60 == 0:
            noted.append(Window.opened(sim))
        sim.advance()
        noted[-1].note_frame(sim)
    assert [window.frames for window in windows] == [60, 60, 20] == [w.frames for w in noted]
    assert [window.first for window in windows] == [0, 60, 120]
    for mine, true in zip(windows, noted, strict=True):
        for name in ("method", "dt", "solver", "precision", "stride", "substeps", "acts"):
            assert getattr(mine, name) == getattr(true, name), name
        np.testing.assert_array_equal(mine.shown, true.shown)
        begun, there = mine.start, true.start
        assert (begun.time, begun.steps) == (there.time, there.steps)
        assert (begun.force is None) == (there.force is None)
        for name in ("x", "v", "marks"):
            np.testing.assert_array_equal(
                getattr(begun.snapshot, name), getattr(there.snapshot, name)
            )
    assert (
        judges.windows_of(scene, Outcome(setting, file=_of_frames(made, 74, tmp_path)))[-1].first
        == 0
    )


def _of_frames(made, frames, folder):
    """Samples of so many frames: of 74 the last 14 are too few to judge."""
    made.sample(0.5, 2, {}, frames, str(folder / "b.npz"))
    return folder / "b.npz"


class MadeUpJudge:
    """Tells verdicts that are made up, and notes what it was asked.

    errors: by the first frame of a window; None: unknown in ten seconds, and 0.002 in more.
    """

    asked = []
    errors = {}

    def measure(self, window, patience, floor):
        self.asked.append((window.first, patience))
        error = self.errors[window.first]
        if error is None and patience < 60:
            return Verdict(window.first, 60, trouble="references differ")
        error = 0.002 if error is None else error
        return Verdict(window.first, 60, error=2 * error, scale=2.0, size=10.0)

    def close_worker(self):
        pass

    close = close_worker


@pytest.fixture
def judging(monkeypatch, tmp_path):
    """`Judges` whose processes are made up, of runs of five seconds."""
    monkeypatch.setattr(judges, "_Judge", MadeUpJudge)
    monkeypatch.setattr(judges.runtime, "available_cores", lambda: 1)
    windows = [SimpleNamespace(first=60 * k, frames=60) for k in range(5)]
    monkeypatch.setattr(judges, "windows_of", lambda scene, outcome: windows)
    monkeypatch.setattr(MadeUpJudge, "asked", [])
    journal = Journal(tmp_path, {})
    with judges.Judges(journal) as made:
        yield made
    journal.discard()


RUN, SCENE = Outcome(Setting("verlet", 1.0, 4)), library.build("oscillator")


def test_seconds_are_judged_up_to_the_first_that_fails(judging, monkeypatch):
    monkeypatch.setattr(MadeUpJudge, "errors", {0: 0.001, 60: 0.02, 120: 0.5, 180: 0, 240: 0})
    target = choice.Target(error=0.01)
    found = judging.seconds(SCENE, RUN, Clock(), fails=target.refuses)
    assert [second.relative for second in found] == [0.001, 0.02]
    assert MadeUpJudge.asked == [(0, 10.0), (60, 10.0)]
    found = judging.seconds(SCENE, RUN, Clock(), begin=120)
    assert [second.error for second in found] == [1.0, 0.0, 0.0]
    # What is known already is not judged again, as after --resume.
    MadeUpJudge.asked.clear()
    assert judging.seconds(SCENE, RUN, Clock(), begin=120) == found
    assert not MadeUpJudge.asked


def test_a_second_that_is_not_known_soon_is_given_the_time_of_a_headless_run(judging, monkeypatch):
    monkeypatch.setattr(MadeUpJudge, "errors", {60 * k: None if k == 1 else 0.0 for k in range(5)})
    quick = judging.seconds(SCENE, RUN, Clock(), thorough=False)
    assert [second.relative for second in quick] == [0.0, None, 0.0, 0.0, 0.0]
    assert quick[1].trouble == "references differ"
    found = judging.seconds(SCENE, RUN, Clock())
    assert [second.relative for second in found] == [0.0, 0.002, 0.0, 0.0, 0.0]
    assert MadeUpJudge.asked[5:] == [(60, 60.0)]


def test_no_second_is_judged_past_the_end_of_the_time(judging, monkeypatch):
    monkeypatch.setattr(MadeUpJudge, "errors", {0: 0.0})
    with pytest.raises(choice.TimeOver):
        judging.seconds(SCENE, RUN, Clock(60.0, iter([0.0, 60.0]).__next__))
    assert not MadeUpJudge.asked


def test_what_a_verdict_leaves_open_is_no_error():
    sure = Verdict(60, 60, error=0.5, scale=2.0, size=10.0)
    assert judges.second_of(sure) == Second(60, 0.5, 0.25)
    assert judges.second_of(replace(sure, trouble="why")) == Second(60, trouble="why")
    assert judges.second_of(Verdict(0, 60)).error is None
    # Of a first part the error is known; where nothing moves it is no part of anything.
    assert judges.second_of(replace(sure, further="why")) == Second(60, 0.5, 0.25, "why")
    assert judges.second_of(replace(sure, error=1e-5, scale=1e-4)).relative == 0.0


def test_a_row_tells_its_worst_second_and_how_many_are_known():
    row = rows.Row(
        Setting("verlet", 1.0, 4), frames=300, wall_seconds=1.0, error_trajectory=9.0,
        error_trajectory_relative=0.9, below_floor=True, floor=0.1, scale=10.0,
    )  # fmt: skip
    assert row.told() == (0.1, 0.01) and row.error_second is None  # longer than one second
    assert replace(row, frames=60).error_second == 0.01
    seconds = [Second(0, 0.5, 0.1), Second(60, 0.2, 0.3), Second(120), Second(180, 0.1, 0.2)]
    judged = replace(row, judged=seconds)
    assert judged.told() == (0.5, 0.3) and judged.error_second == 0.3 and not judged.untold
    assert (judged.error_second_middle, judged.seconds, judged.seconds_known) == (0.2, 4, 3)
    told = choice.Figures.of(judged).describe()
    assert "error 30 % (0.5) in the worst of 3 seconds (1 more cannot be known)" in told
    nothing = replace(row, judged=[Second(0)])
    assert nothing.told() == (None, None) and not choice.is_measured(nothing)
    record = dict(zip(rows.COLUMNS, judged.record().values(), strict=True))
    assert (record["error_second"], record["seconds_known"]) == (0.3, 3)
    # The advice of a trade goes by it.
    better = replace(judged, wall_seconds=2.0, judged=[Second(0, 0.01, 0.001)])
    assert report.advised([judged, better])[0] is better


@pytest.mark.parametrize(
    ("parameters", "seconds"),
    [({"columns": 5, "rows": 4}, 5), ({"columns": 5, "rows": 4, "stiffness": 1e-4}, 20)],
)
def test_the_horizon_is_the_scene_s_own_length_and_five_seconds_at_least(parameters, seconds):
    assert reference.default_frames(library.build("cloth", **parameters)) == 60 * seconds


def test_the_horizon_of_a_large_scene_is_whole_seconds_that_can_be_kept():
    scene = library.build("cloth", columns=150, rows=150)
    assert reference.default_frames(scene) == reference.most_frames(scene) // 60 * 60 < 300


# ------------------------------------------------------------------------------------------
# Choosing


def met_by(made, target):
    """The rows that meet a target; InputError, with the best there is, where none does."""
    asked = choice.Choice(made, target)
    found = list(asked.candidates())
    if not found:
        raise InputError(asked.refusal())
    return found


def test_tune_chooses_the_cheapest_that_meets_and_the_best_that_fits():
    rng = np.random.default_rng(2)
    for _ in range(200):
        made = made_up(rng, 12)
        ok = [row for row in made if row.ok]
        wanted = 10 ** rng.uniform(-7, 0)
        meeting = [row for row in ok if row.error_trajectory_relative <= wanted]
        for target in (
            choice.Target(error=wanted),
            choice.Target(error=50 * wanted, relative=False),
        ):
            if meeting:
                best = met_by(made, target)[0]
                assert best.wall_seconds == min(row.wall_seconds for row in meeting)
                assert best in meeting
            else:
                with pytest.raises(InputError, match="the best is"):
                    met_by(made, target)
        seconds = 10 ** rng.uniform(-5, -1)
        fitting = [row for row in ok if row.wall_upper / 10 <= seconds]
        target = choice.Target(frame_seconds=seconds)
        if fitting:
            best = met_by(made, target)[0]
            assert best.error_trajectory == min(row.error_trajectory for row in fitting)
        else:
            with pytest.raises(InputError, match="the best is"):
                met_by(made, target)


def test_tune_does_not_promise_what_the_reference_cannot_tell():
    """An error below the floor counts as the floor, however small it came out."""
    made = made_up(np.random.default_rng(0), 1)[0]
    row = replace(
        made,
        status="ok",
        wall_seconds=1.0,
        wall_upper=1.0,
        error_trajectory=1e-6,
        error_trajectory_relative=2e-8,
        below_floor=True,
        floor=0.5,
        scale=50.0,
    )
    assert met_by([row], choice.Target(error=0.011)) == [row]
    assert choice.Figures.of(row).error_relative == 0.01
    with pytest.raises(InputError, match="none of 1 settings meets it"):
        met_by([row], choice.Target(error=0.009))


def test_tune_says_why_no_setting_could_be_measured():
    made = made_up(np.random.default_rng(0), 1)[0]
    row = replace(made, status="failed: frame 12, particle 3 runs away", wall_seconds=None)
    why = f"no setting could be measured; the first: {row.setting.describe()}: {row.status}"
    with pytest.raises(InputError, match=re.escape(why) + "$"):
        met_by([row, row], choice.Target(error=0.01))


def test_tune_keeps_to_a_penetration_alone_and_beside_the_rest():
    """Against a search through all rows."""
    rng = np.random.default_rng(3)
    for _ in range(200):
        made = [
            replace(row, penetration_max=10 ** rng.uniform(-5, -1)) if row.ok else row
            for row in made_up(rng, 12)
        ]
        error, deep, seconds = 10 ** rng.uniform(-6, 0), 10 ** rng.uniform(-5, -1), 10**-2.5
        within = [row for row in made if row.ok and row.penetration_max <= deep]
        for target, fitting, cost in (
            (choice.Target(penetration=deep), within, "wall_seconds"),
            (
                choice.Target(error=error, penetration=deep),
                [row for row in within if row.error_trajectory_relative <= error],
                "wall_seconds",
            ),
            (
                choice.Target(frame_seconds=seconds, penetration=deep),
                [row for row in within if row.wall_upper / 10 <= seconds],
                "error_trajectory",
            ),
        ):
            assert "--penetration" in target.describe()
            if fitting:
                best = met_by(made, target)[0]
                assert getattr(best, cost) == min(getattr(row, cost) for row in fitting)
                assert best in fitting
            else:
                with pytest.raises(InputError, match="the best is"):
                    met_by(made, target)


@pytest.mark.parametrize(
    ("text", "length"),
    [("1mm", 1e-3), ("0.5 cm", 5e-3), ("2m", 2.0), ("0.25", 0.25), ("1e-3m", 1e-3)],
)
def test_a_penetration_may_have_a_unit_where_lengths_are_metres(text, length):
    read = tune.read_target(None, None, text, in_metres=True)
    assert read.penetration == pytest.approx(length) and read.error is read.frame_seconds is None
    if text != "0.25":
        with pytest.raises(InputError, match="has a unit"):
            tune.read_target(None, None, text, in_metres=False)


@pytest.mark.parametrize(
    ("error", "frame_time", "target"),
    [
        ("1%", None, choice.Target(error=0.01, relative=True)),
        ("0.25", None, choice.Target(error=0.25, relative=False)),
        (None, "8ms", choice.Target(frame_seconds=0.008)),
        (None, "16.5 us", choice.Target(frame_seconds=16.5e-6)),
        (None, "1s", choice.Target(frame_seconds=1.0)),
    ],
)
def test_targets_are_read_as_they_are_written(error, frame_time, target):
    read = tune.read_target(error, frame_time)
    assert read.relative == target.relative
    assert read.error == pytest.approx(target.error) if target.error else read.error is None
    assert read.frame_seconds == pytest.approx(target.frame_seconds or 0) or not frame_time


def test_another_start_differs_a_little_and_keeps_what_is_fixed():
    scene = library.build("cloth", columns=5, rows=4)
    v = np.random.default_rng(0).normal(size=(30, 20, 2))
    other = tune.kicked(scene, v, seed=1)
    assert (other.particles.velocity[scene.particles.fixed] == 0).all()
    kick = np.sqrt((other.particles.velocity[~scene.particles.fixed] ** 2).sum(axis=1).mean())
    assert kick == pytest.approx(0.1 * math.sqrt(2), rel=0.4)
    again = tune.kicked(scene, v, seed=2)
    assert (again.particles.velocity != other.particles.velocity).any()


class MadeUpStudies:
    """What `tune` measures, made up: settings by their substeps, whose seconds' errors are given.

    errors: of the scene; again: of later seconds, None for a run that fails. touched: when
    something first touches in it. judged: how many seconds of each setting were judged.
    """

    touched = math.nan

    def __init__(self, monkeypatch, errors, again):
        self.of, self.confirmed, self.frames, self.judged = [errors, again], [], [], {}
        self.late = False
        monkeypatch.setattr(tune.command, "measured", self.measured)
        monkeypatch.setattr(tune.rows, "rows_of", self.rows_of)
        monkeypatch.setattr(tune, "Judges", lambda journal, floor, within: self)
        self.spent, self.windows, self.compiled = 30.0, 10, 0.0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    @contextlib.contextmanager
    def measured(
        self, source, options, scene, chosen, how, journal, elsewhere, closed=True, quiet=False
    ):
        assert not how.references and how.whole
        self.frames.append(options.frames)
        again = len(self.frames) > 1 and options.frames > self.frames[0]
        if again:
            self.confirmed.append([setting.substeps for setting in chosen])
        touches = np.full((2, 3), np.nan)
        touches[1, 2] = self.touched
        samples = SimpleNamespace(v=np.ones((2, 2, 2)), contacts=touches)
        outcomes = []
        for setting in chosen:
            outcome = Outcome(setting, seconds=[setting.substeps * 1e-2])
            failed = self.of[again][setting.substeps] is None
            outcome.status = "failed: frame 3" if failed else "ok"
            outcome.samples = lambda: samples
            outcomes.append(outcome)
        yield Result(scene, outcomes, {}, None, None, None, options.frames, how.clock)

    def rows_of(self, result, common, words, seconds=None):
        return [
            rows.Row(
                outcome.setting, status=outcome.status, frames=result.frames, penetration_max=0.0,
                wall_seconds=outcome.seconds[0], wall_upper=outcome.seconds[0],
                command=f"run {outcome.setting.substeps}",
                judged=seconds and seconds[outcome.setting],
            )  # fmt: skip
            for outcome in result.outcomes
        ]  # fmt: skip

    def seconds(
        self, scene, outcome, clock, *, begin=0, count=None, fails=lambda second: False,
        thorough=True,
    ):  # fmt: skip
        if self.late:
            raise choice.TimeOver
        substeps, found = outcome.setting.substeps, []
        for k, error in enumerate(np.atleast_1d(self.of[begin > 0][substeps])[:count]):
            found.append(Second(begin + 60 * k, 50 * error, error))
            if fails(found[-1]):
                break
        self.judged[substeps] = len(found)
        return found


TUNED = ("--methods", "verlet", "--precisions", "f64", "--substeps", "1,2,3,4,5,6,7,8")


@pytest.mark.parametrize("failing", [0.02, None])
def test_tune_tries_the_next_where_one_is_not_confirmed(monkeypatch, capsys, failing):
    errors = {n: 0.05 if n == 1 else 0.009 / n for n in range(1, 9)}
    again = {n: failing if n < 4 else 0.009 / n for n in range(1, 9)}
    studies = MadeUpStudies(monkeypatch, errors, again)
    assert main(["tune", "oscillator", *TUNED, "--error", "1%"]) == 0
    shown, said = capsys.readouterr()
    assert studies.confirmed == [[2], [3, 4, 5]]  # the cheapest first, then some at once
    assert set(studies.frames) == {300, 600}  # the confirmation is in as many later seconds
    assert shown.startswith("HORIZON: 5 seconds (300 frames)")
    head, told = shown.split("not confirmed, so not taken:")
    assert "verlet, 4 substeps" in head and "confirmed: yes" in head and not said
    assert "2 substeps" in told and "3 substeps" in told and told.endswith("run 4\n")
    assert main(["tune", "oscillator", *TUNED, "--error", "1%", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["setting"]["substeps"] == 4 and found["confirmed"]["held"] is True
    tried = [(one["setting"]["substeps"], one["confirmed"]["held"]) for one in found["tried"]]
    assert tried == [(2, False), (3, False), (4, True)]


def test_tune_judges_no_more_seconds_than_it_takes(monkeypatch, capsys):
    """One that misses by far is not judged with a few more substeps, nor one that is dearer."""
    good = [0.001] * 5
    errors = {1: [0.2, 0.3], 2: good, 3: [0.009, 0.011, 0.5], 4: good, 5: good}
    errors |= dict.fromkeys((6, 7, 8), good)
    studies = MadeUpStudies(monkeypatch, errors, errors)
    assert main(["tune", "oscillator", *TUNED, "--error", "1%"]) == 0
    # By verlet's second order 2 substeps should have a fourth of 20 %, which is more than thrice 1.
    assert studies.judged == {1: 1, 3: 2, 4: 5}
    assert "verlet, 4 substeps" in capsys.readouterr().out


def test_tune_takes_the_most_accurate_by_all_seconds_that_fits_a_time(monkeypatch, capsys):
    errors = {n: [0.01 * n, 0.05] for n in range(1, 9)} | {2: [0.015, 0.016], 3: [0.014, 0.2]}
    studies = MadeUpStudies(monkeypatch, errors, errors)
    assert main(["tune", "oscillator", *TUNED, "--frame-time", "0.19ms"]) == 0
    assert "verlet, 2 substeps" in capsys.readouterr().out
    assert studies.confirmed == [[2]]
    # That of 4 is worse in its first second than 2 in all, so the others of its are of no interest.
    assert studies.judged[3] == 2 and studies.judged[4] == 1


def test_without_time_to_judge_there_is_no_advice_and_the_time_that_it_takes(monkeypatch, capsys):
    errors = {n: 0.001 for n in range(1, 9)}
    studies = MadeUpStudies(monkeypatch, errors, errors)
    studies.late = True
    assert main(["tune", "oscillator", *TUNED, "--error", "1%", "--quick"]) == 2
    shown, said = capsys.readouterr()
    assert "taichi-cloth run" not in shown and said.count("\n") == 1
    # A second took 3 s, so a setting takes 15. Two more of them end at 48 + 30 s, which are to be
    # 0.8 of the time.
    assert "no advice within 60 s: 0 of 8 settings could be judged over 5 seconds" in said
    assert "about --within 2min" in said


def test_an_error_is_told_of_a_quarter_of_a_second_and_more(capsys):
    assert main(["tune", "oscillator", *TUNED, "--error", "1%", "--frames", "8"]) == 2
    assert "--frames 8: an error is told of 15 frames and more" in capsys.readouterr().err


def test_tune_refuses_a_penetration_where_nothing_comes_to_touch(monkeypatch, capsys):
    """Every setting keeps to it then: none is shown to."""
    errors = {n: 0.009 / n for n in range(1, 9)}
    studies = MadeUpStudies(monkeypatch, errors, errors)
    asked = ["tune", "box", "--particles", "2", *TUNED, "--error", "1%", "--penetration", "0.1"]
    assert main(asked) == 2
    shown, said = capsys.readouterr()
    assert "confirmed" not in shown and said.count("\n") == 1 and not studies.confirmed
    assert "nothing touches anything in the 300 frames" in said and "more --frames" in said
    studies.touched = 0.5
    assert main(asked) == 0
    assert "confirmed: yes" in capsys.readouterr().out


def test_tune_ends_with_status_1_and_a_word_where_nothing_is_confirmed(monkeypatch, capsys):
    errors = {n: 0.009 / n for n in range(1, 9)}
    studies = MadeUpStudies(monkeypatch, errors, {n: 0.02 for n in range(1, 9)})
    assert main(["tune", "oscillator", *TUNED, "--error", "1%"]) == 1
    shown, said = capsys.readouterr()
    assert sorted(sum(studies.confirmed, [])) == list(range(1, 9))
    assert "\nrun " not in shown and "no setting that meets it holds in later seconds" in shown
    assert said.count("\n") == 1 and "all 8 that meet it missed it" in said and "--error" in said
    assert main(["tune", "oscillator", *TUNED, "--error", "1%", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["setting"] is found["command"] is found["expected"] is None
    assert found["confirmed"] == {"held": False} and len(found["tried"]) == 8


def test_tune_confirms_times_as_it_confirms_errors(monkeypatch, capsys):
    errors = {n: 0.009 / n for n in range(1, 9)}
    studies = MadeUpStudies(monkeypatch, errors, errors)
    rows_of = studies.rows_of

    def slow(result, *given):
        found = rows_of(result, *given)
        return [replace(row, wall_seconds=99.0) for row in found] if studies.confirmed else found

    monkeypatch.setattr(tune.rows, "rows_of", slow)
    assert main(["tune", "oscillator", *TUNED, "--frame-time", "0.15ms"]) == 1
    assert "ask for a longer --frame-time" in capsys.readouterr().err
    assert studies.confirmed == [[4], [3, 2, 1]]  # the most accurate first


@thorough
def test_the_printed_command_keeps_the_error_by_the_meter(cli, tmp_path):
    """Of a chain: in all seconds, those of the horizon and as many after them."""
    asked = ["tune", "chain", "--particles", 12, "--error", "0.5%", "--precisions", "f64"]
    asked += ["--methods", "symplectic_euler,verlet,rk4", "--substeps", "4,8,16,32", "--json"]
    out, _ = cli(*asked, cwd=tmp_path)
    found = json.loads(out)
    assert 0 < found["expected"]["error_relative"] <= 0.005
    words = [*found["command"].split()[1:], "--headless", "--error-meter", "--frames"]
    told, _ = cli(*words, 2 * found["frames"], cwd=tmp_path)
    errors = [float(text) for text in re.findall(r"over the last second: (\S+) %", told)]
    assert len(errors) >= 8 and max(errors) <= 0.5
    first = max(errors[: found["frames"] // 60])
    assert first == pytest.approx(100 * found["expected"]["error_relative"], rel=0.01)


@thorough
def test_a_row_of_trade_is_what_the_meter_says_of_its_command(cli, tmp_path):
    asked = ["trade", "chain", "--particles", 12, "--methods", "verlet", "--substeps", "8"]
    cli(*asked, "--precisions", "f32,f64", "--frames", 180, "--output", "out", cwd=tmp_path)
    made = json.loads((tmp_path / "out" / "trade.json").read_text())["rows"]
    assert {row["precision"] for row in made} == {"f32", "f64"}
    for row in made:
        words = [*row["command"].split()[1:], "--headless", "--error-meter", "--frames", 180]
        told, _ = cli(*words, cwd=tmp_path)
        errors = [float(text) for text in re.findall(r"over the last second: (\S+) %", told)]
        assert row["seconds"] == row["seconds_known"] == len(errors) == 3
        assert max(errors) == pytest.approx(100 * row["error_second"], rel=0.05)


# ------------------------------------------------------------------------------------------
# Surveys


def surveyed(chosen, seconds, errors):
    """What a survey finds; errors: of (method, substeps, second), in parts of what is wanted."""
    found = []
    for k in seconds:
        wanted = [replace(trial, within=1.0) for trial in survey.trials(chosen, found)]
        tries = {}
        for name, n, error in results(wanted, lambda m, n, k=k: errors(m, n, k), 0.0):
            tries.setdefault(name, []).append((n, error))
        found.append({"tries": tries, "resting": False})
    return survey.Survey.of_seconds(found)


ORDERS = {"symplectic_euler": 1, "verlet": 2, "rk4": 4}


def test_a_survey_leaves_few_settings_and_among_them_the_cheapest_that_meets_all_seconds():
    """Against a search through all settings; by evaluations of forces, of which rk4 takes four."""
    rng = np.random.default_rng(5)
    for _ in range(200):
        least = {"symplectic_euler": 6, "verlet": int(rng.choice([6, 12])), "rk4": 4}
        large = {name: 10 ** rng.uniform(-1, 1.5) for name in least}
        worse = np.exp(rng.uniform(0, 1, 5))

        def errors(name, n, k, large=large, least=least, worse=worse):
            return float(large[name] * worse[k] * (least[name] / n) ** ORDERS[name])

        chosen = [
            Setting(name, 0.1, fewest << k, precision)
            for name, fewest in least.items()
            for k in range(6)
            for precision in ("f32", "f64", "compensated")
        ]
        made = surveyed(chosen, range(5), errors)
        kept = made.narrowed(chosen, short=True)
        cost = {"symplectic_euler": 1, "verlet": 1, "rk4": 4}
        good = [
            cost[name] * n
            for name, fewest in least.items()
            for n in range(fewest, 64 * fewest + 1)
            if max(errors(name, n, k) for k in range(5)) <= 1.0
        ]
        meets = [s for s in kept if max(errors(s.method, s.substeps, k) for k in range(5)) <= 1.0]
        assert {s.precision for s in meets} == {"f32", "f64"} and len(kept) <= 18
        # Numbers are doubled, and costs of rk4 begin between those of others.
        assert min(cost[s.method] * s.substeps for s in meets) <= 4 * min(good)
        assert "by 5 of 5 seconds" in made.describe()


def test_a_later_second_is_tried_from_what_those_before_asked_for():
    chosen = [Setting(name, 0.1, n) for name in ORDERS for n in (4, 8, 16)]
    first = {"tries": {"verlet": [(4, 9.0), (8, 4.0), (16, 0.9)], "rk4": [(4, 3.0)]}}
    first["tries"]["symplectic_euler"] = [(4, 9.0), (8, 9.0), (16, 9.0)]
    trials = survey.trials(chosen, [first | {"resting": False}])
    # 16 evaluations are enough by verlet: symplectic Euler takes more than 16 and rk4 than 16.
    assert [(trial.method, trial.equal, trial.least) for trial in trials] == [("verlet", 16, 16)]
    assert trials[0].finest == 256
    # A second in which nothing moves asks for nothing, one that is not known says nothing.
    others = [{"tries": {}, "resting": True}, {"tries": {}, "resting": False}]
    made = survey.Survey.of_seconds([first | {"resting": False}, *others])
    assert (made.seconds, made.of) == (2, 3) and made.worth == {"verlet": (16, True)}
    assert survey.Survey.of_seconds(others).narrowed(chosen, short=True) == chosen


def test_methods_that_solve_equations_run_where_they_may_be_as_cheap():
    implicit = [Setting("implicit_midpoint", 0.1, n) for n in (1, 2, 4, 8)]
    swept = [Setting("xpbd", 0.1, n, iterations=4) for n in (1, 2, 4, 8)]
    chosen = [Setting("verlet", 0.1, n) for n in (4, 8, 16)] + implicit + swept

    def after(error):
        return surveyed(chosen, range(2), lambda name, n, k: error / n)

    made = after(32.0)
    assert made.needs["verlet"][0] == 16
    kept = made.narrowed(chosen, short=False)
    assert [s.substeps for s in kept if s.method == "verlet"] == [16, 32, 64]
    assert [s for s in kept if s.method != "verlet"] == [*implicit[:3], *swept[:3]]
    assert {s.method for s in made.narrowed(chosen, short=True)} == {"verlet"}
    # Where no explicit one is seen to do, all that was chosen may.
    assert set(implicit + swept) < set(after(1e9).narrowed(chosen, short=True))


def test_seconds_of_a_long_horizon_are_surveyed_here_and_there():
    assert survey.looked_at(5) == [0, 1, 2, 3, 4]
    assert survey.looked_at(20) == [0, 3, 5, 8, 11, 14, 16, 19]


def test_a_setting_is_not_confirmed_where_it_would_miss_as_those_before(monkeypatch, capsys):
    """Later seconds were ten times as wrong: what was wrong by half of the wanted misses, too."""
    errors = {n: 0.005 for n in range(1, 7)} | {7: 0.0009, 8: 0.0009}
    studies = MadeUpStudies(monkeypatch, errors, {n: 10 * e for n, e in errors.items()})
    assert main(["tune", "oscillator", *TUNED, "--error", "1%"]) == 0
    assert studies.confirmed == [[1], [7, 8]] and "verlet, 7 substeps" in capsys.readouterr().out


def test_finer_steps_follow_where_none_of_a_survey_holds(monkeypatch, capsys):
    """A chain that is calm in the seconds that are chosen by, and whips in those that confirm."""
    errors = {8 << k: 0.001 for k in range(6)}
    studies = MadeUpStudies(monkeypatch, errors, {n: 0.02 if n < 64 else 0.005 for n in errors})
    found = [{"tries": {"verlet": [[8, 0.7]]}, "resting": False}]
    studies.survey = lambda *given, **more: found
    asked = ["tune", "oscillator", "--methods", "verlet", "--precisions", "f64", "--error", "1%"]
    assert main(asked) == 0
    assert {8, 64} <= set(sum(studies.confirmed, [])) and "64 substeps" in capsys.readouterr().out


def test_tune_runs_what_a_survey_says(monkeypatch, capsys):
    errors = {n: 0.009 / n for n in (8, 16, 32)}
    studies = MadeUpStudies(monkeypatch, errors, errors)
    studies.survey = lambda *given, **more: [
        {"tries": {"verlet": [[4, 3.0], [8, 0.7]]}, "resting": False}
    ]
    asked = ["tune", "oscillator", "--methods", "verlet", "--error", "1%", "--within", "3min"]
    assert main(asked) == 0
    shown = capsys.readouterr().out
    assert "survey: verlet from 8 substeps, by 1 of 1 second" in shown
    assert "verlet, 8 substeps" in shown and "settings that a survey passed over" in shown
