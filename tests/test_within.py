"""Sweeps that fit a time: what is left out, told with a clock that is made up, and said."""

import contextlib
import csv
import json
import signal
import threading
from dataclasses import replace

import numpy as np
import pytest
from selection import thorough

from taichi_cloth import runtime
from taichi_cloth.cli.main import main
from taichi_cloth.errors import InputError
from taichi_cloth.limits import eigenmodes
from taichi_cloth.scene import library
from taichi_cloth.scene.fingerprint import scene_hash
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.sweeps import TradeOptions, TuneOptions
from taichi_cloth.stability import command as stability
from taichi_cloth.stability import experiment
from taichi_cloth.sweeps.identity import of_scene
from taichi_cloth.sweeps.journal import Journal, kept
from taichi_cloth.sweeps.within import Clock, TimeIsUp, clock, ending, said_of_left_out
from taichi_cloth.trade import command, runner
from taichi_cloth.trade.outcomes import Outcome, Result
from taichi_cloth.trade.pace import FEWEST_FRAMES, PAST, Pace, Share, left_out
from taichi_cloth.trade.process import Stopped
from taichi_cloth.trade.settings import Setting


class Hand:
    """A clock's hand that is moved by hand."""

    def __init__(self):
        self.at = 100.0

    def __call__(self):
        return self.at


def test_a_clock_keeps_time_for_the_files_and_a_part_ends_before_the_whole():
    hand = Hand()
    minute = Clock(60.0, hand)
    assert 50 < minute.left() < 60 and minute.limited and minute.short
    half = minute.part(0.5)
    hand.at += 30.0
    assert half.left() == 0.0 and minute.left() > 20
    hand.at += 30.0
    assert minute.left() < 0
    assert not Clock().limited and Clock().left() == float("inf")


def test_what_waits_is_interrupted_when_the_time_is_over():
    before = signal.getsignal(signal.SIGALRM)
    with pytest.raises(TimeIsUp), ending(Clock(2.01)):  # two seconds of it are for files
        threading.Event().wait(600)
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0
    with ending(Clock()):
        assert signal.getitimer(signal.ITIMER_REAL)[0] == 0


def test_stability_ends_in_time_whatever_it_waits_for(tmp_path, monkeypatch, capsys):
    """Of a cloth whose damped modes take minutes, and a run that does not end by itself."""

    def never(*_):
        raise AssertionError("takes minutes")

    monkeypatch.setattr(runtime, "start", lambda *_: None)  # of this process, once
    monkeypatch.setattr(eigenmodes, "_damped_modes", never)
    monkeypatch.setattr(experiment, "measure_limit", lambda *_: threading.Event().wait(600))
    monkeypatch.chdir(tmp_path)
    assert main(["stability", "warp", "--side", "30", "--within", "5s"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "exact limits of damped modes: the computed ones may be a percent shorter" in said
    assert "verlet: limit, map of stiffness, map of mass" in said


def test_quick_is_a_minute_and_times_have_units():
    assert clock(None, quick=True).seconds == 60 and not clock(None).limited
    assert [clock(text).seconds for text in ("90s", "5min", "0.5h")] == [90, 300, 1800]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--within", "60"], "must be a time with its unit, s, min or h, such as 60s; is '60'"),
        (["--within", "-1s"], "such as 60s; is '-1s'"),
        (["--within", "1s"], "--within must be 5s to 7 days"),
        (["--within", "60s", "--quick"], "--quick means --within 60s: give one of them"),
    ],
)
@pytest.mark.parametrize("name", ["trade", "explain", "stability"])
def test_what_is_no_time_is_refused_in_one_line(name, words, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([name, "oscillator", *words]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1 and not list(tmp_path.iterdir())


def test_references_take_their_share_of_the_time_at_most():
    """At a hundredth of a second a frame six runs of 150 frames take 9 s, of a minute 15 %."""
    pace = Pace(Clock(60.0, Hand()))
    assert pace.frames(240, 0.01) == 150 and pace.frames(85, 0.01) == 85
    assert pace.frames(240, 5.0) == FEWEST_FRAMES
    assert Pace(Clock()).frames(240, 5.0) == 240


def test_methods_that_do_not_compile_in_time_are_left_out():
    hand = Hand()
    pace = Pace(Clock(60.0, hand))
    pace.compiled("rk4", 5.0)
    assert pace.to_compile("verlet") == 5 and pace.to_compile("tr_bdf2") == 15
    assert pace.fits("verlet") and pace.fits("tr_bdf2")
    hand.at += 49.0
    assert pace.fits("verlet") and not pace.fits("tr_bdf2")
    assert not pace.over(referenced=True)
    pace.found = True
    hand.at += 10.0
    assert pace.over(referenced=True) and not pace.over(referenced=False)
    hand.at += 14.0
    assert pace.over(referenced=False)
    assert Pace(Clock()).fits("tr_bdf2") and not Pace(Clock()).over(referenced=True)


def outcome(seconds, substeps, **of):
    return Outcome(Setting("vbd", 1.0, substeps, **of), sampled_in=seconds)


def test_settings_run_from_the_longest_step_as_long_as_their_share_lasts():
    """Each costs its run and as much again for its timing."""
    share = Share(7.0, budget=0.1)
    assert share.fits(Setting("vbd", 1.0, 1000, iterations=1))  # the first one, whatever it takes
    share.took(outcome(0.5, 1, iterations=1))
    assert share.expected(Setting("vbd", 1.0, 2, iterations=1)) == (1.0, 0.0)
    assert share.expected(Setting("vbd", 1.0, 2, iterations=8)) == (8.0, 0.0)
    assert share.fits(Setting("vbd", 1.0, 4, iterations=1))
    share.took(outcome(2.0, 4, iterations=1))
    assert not share.fits(Setting("vbd", 1.0, 8, iterations=1))
    assert share.fits(Setting("vbd", 1.0, 2, iterations=1))


def test_reading_states_takes_no_longer_with_more_substeps():
    """A run of 0.1 s whose states took 1 s to read: of four times the substeps 0.4 s, and 1."""
    share = Share(4.0, budget=0.1)
    share.took(Outcome(Setting("rk4", 1.0, 1), sampled_in=1.1, read_in=1.0))
    run, read = share.expected(Setting("rk4", 1.0, 4))
    assert run == pytest.approx(0.4) and read == 1.0
    assert share.fits(Setting("rk4", 1.0, 4)) and not share.fits(Setting("rk4", 1.0, 32))


def test_until_there_is_a_row_nothing_begins_that_may_keep_it_from_its_timing():
    hand = Hand()
    pace = Pace(Clock(60.0, hand))
    pace.compiled("rk4", 20.0)
    hand.at += 40.0  # 16.4 s are left, more than HOPE of 20
    assert pace.fits("rk4", made=True) and not pace.fits("verlet")
    pace.found = True
    assert pace.fits("verlet")
    pace.found = False
    hand.at += 20.0
    assert not pace.over(referenced=True) and pace.fits("rk4", made=True)
    pace.found = True
    assert pace.over(referenced=True) and not pace.fits("rk4", made=True)


class Machine:
    """Processes of a study whose seconds are made up: all share one clock, as on one core.

    compiling: of a method in a process; step: of a frame with one substep.
    """

    def __init__(self, hand, clock, compiling, step):
        self.hand, self.clock, self.compiling, self.step = hand, clock, compiling, step
        self.lock = threading.Lock()
        self.sampled = []  # (setting, frames, digest of the scene) of all runs

    def process(self, kind, scene, how, folder, stop):
        return Made(self, kind, scene, stop)


class Made:
    """A process of a `Machine`: the oscillator's closed form, off by the fourth power of the step.

    It is one that ends when the study does, as a `TrialProcess`.
    """

    def __init__(self, machine, kind, scene, stop):
        self.machine, self.kind, self.scene, self.stop = machine, kind, scene, stop
        self.made = set()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def kill(self):
        pass

    def about(self, method):
        return {"device": "made up"} if method in self.made else {}

    def drop(self, method):
        return method in self.made

    def ask(self, setting, scene, do, frames=0, file=None, budget=0.0):
        run = frames * setting.substeps * self.machine.step
        took = run if do == "sample" else 3 * run
        if setting.method not in self.made:
            took += self.machine.compiling
        with self.machine.lock:
            rest = self.machine.clock.left() + PAST * self.machine.clock.seconds
            self.machine.hand.at += min(took, max(rest, 0.0) + 1e-3)
        if took > rest:  # it is killed before it is done
            assert self.stop.wait(timeout=30)
        if self.stop.is_set():
            raise Stopped
        self.made.add(setting.method)
        if do == "sample":
            return self.sampled(setting, scene, frames, file) | {"sampled_in": run}
        return [run] if do == "time" else None

    def sampled(self, setting, scene, frames, file):
        self.machine.sampled.append((setting, frames, scene_hash(scene)))
        times = np.arange(frames + 1) * setting.dt
        x, v = SceneSource("oscillator").solution()(scene, times)
        x = x + (times * setting.step**4)[:, None, None]
        none = np.ones((frames + 1, 0), bool)
        np.savez(file, x=x, v=v, alive=none, contacts=np.zeros((frames + 1, 3)))
        return {"failed": "", "force_evaluations": 1, "sweeps": 0, "unconverged": 0, "read_in": 0.0}


@pytest.mark.parametrize("compiling", [1.0, 5.0, 12.0, 19.0, 24.0])
def test_a_minute_has_rows_wherever_a_reference_and_a_timing_fit(compiling, tmp_path, monkeypatch):
    """However long a method compiles, up to two fifths of the time, of which two do at least."""
    source, options = SceneSource("oscillator"), TradeOptions.from_given({"quick": True})
    scene, chosen, how = command.prepare(source, options)
    hand = Hand()
    how = replace(how, clock=Clock(60.0, hand))
    machine = Machine(hand, how.clock, compiling, 1e-4)
    monkeypatch.setattr(runner, "TrialProcess", machine.process)
    with command.measured(source, options, scene, chosen, how, quiet=True) as result:
        found = {outcome.setting for outcome in result.outcomes if outcome.seconds}
        assert result.reference and len(found) >= 4
        assert hand.at - 100.0 <= 66.0
        of = {(setting.method, setting.process) for setting in chosen}
        whole = {(setting.method, setting.process) for setting in found}
        named = "\n".join(result.left_out)
        for method, (arch, precision, _) in of - whole:
            assert f"{method}, {arch} {precision}: all of it" in named


@pytest.mark.parametrize("words", [["trade"], ["tune", "--error", "1%", "--substeps", "4"]])
def test_what_has_nothing_in_time_asks_for_more(words, tmp_path, monkeypatch, capsys):
    """`tune` said that there is no reference, and to use fewer frames, as one that has failed."""

    @contextlib.contextmanager
    def nothing(source, *_, **__):
        yield Result(source.build(), [], {}, None, None)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "measured", nothing)
    assert main([*words, "oscillator", "--quick"]) == 2
    says = (
        "--within 60 s: not one setting was finished by then; try --within 4min, or fewer --frames"
    )
    assert capsys.readouterr().err == f"taichi-cloth: error: {says}\n"


def test_a_run_that_would_end_too_late_is_told_by_its_first_frames(tmp_path, monkeypatch):
    """Of 300 frames at a second each nothing fits in a minute: it says what one takes."""
    source, options = SceneSource("oscillator"), TuneOptions.from_given({"quick": True})
    scene, chosen, how = command.prepare(source, options)
    hand = Hand()
    how = replace(how, clock=Clock(60.0, hand), references=False, whole=True)
    machine = Machine(hand, how.clock, 1.0, 1.0)
    monkeypatch.setattr(runner, "TrialProcess", machine.process)
    with command.measured(source, options, scene, chosen, how, closed=False, quiet=True) as result:
        assert not result.outcomes and result.longest == 300.0
        assert {frames for _, frames, _ in machine.sampled} == {4}
        says = "one takes 300 s for 300 frames; use about --within 51min, or fewer --frames"
        with pytest.raises(InputError, match=says):
            result.check_some(how.clock)


@pytest.mark.parametrize(("begun", "then"), [(20.0, 600.0), (20.0, None), (None, 60.0)])
def test_a_sweep_goes_on_in_another_time_with_what_it_has(begun, then, tmp_path, monkeypatch):
    """Its settings and its frames stay those that it began with: no run is made for nothing."""
    source, hand = SceneSource("oscillator"), Hand()
    machine = Machine(hand, Clock(), 3.0, 2e-2)
    monkeypatch.setattr(runner, "TrialProcess", machine.process)
    seen = []

    def go_on(seconds, **how):
        asked = TradeOptions.from_given({"within": f"{seconds}s"} if seconds else {})
        scene, chosen, conditions = command.prepare(source, asked)
        machine.clock = Clock(seconds or np.inf, hand)
        conditions = replace(conditions, clock=machine.clock)
        known = of_scene("trade", source, asked, scene)
        with kept(tmp_path, known, within=machine.clock.seconds, **how) as journal:
            chosen, conditions = command.planned(scene, asked, chosen, conditions, journal)
            seen.append(chosen)
            given = source, asked, scene, chosen, conditions, journal
            with command.measured(*given, quiet=True) as result:
                if not how["resume"]:
                    raise KeyboardInterrupt
                return result

    with pytest.raises(KeyboardInterrupt):
        go_on(begun, resume=False)
    before = list(machine.sampled)
    result = go_on(then, resume=True)
    assert seen[0] == seen[1] and len(set(machine.sampled)) == len(machine.sampled)
    assert before and result.horizon.asked == max(frames for _, frames, _ in before)
    done = {outcome.setting for outcome in result.outcomes}
    assert {setting for setting, _, _ in before if setting in seen[0]} <= done


def test_what_is_left_out_is_said_by_method_and_nothing_without_a_limit():
    chosen = [Setting(m, 1.0, n) for m in ("verlet", "rk4") for n in (1, 2, 4)]
    outcomes = [Outcome(setting) for setting in chosen[:1]]
    minute = Clock(60.0, Hand())
    lines = left_out(minute, chosen, outcomes)
    assert lines == ["verlet, cpu f64: substeps 2, 4", "rk4, cpu f64: all of it"]
    said = said_of_left_out(minute, lines)
    assert "does not fit in 60 s" in said[0] and [line.strip() for line in said[1:]] == lines
    assert "nothing was left out" in said_of_left_out(minute, [])[0]
    assert left_out(Clock(), chosen, outcomes) == [] == said_of_left_out(Clock(), lines)


def test_stability_without_time_has_what_is_computed_and_says_what_was_not_measured(tmp_path):
    scene = experiment.at_rest(library.build("oscillator"))
    network = experiment.Network.from_scene(scene)
    limits, journal = [experiment.computed("verlet", network)], Journal(tmp_path, {})
    hand = Hand()
    tell = stability.within(Clock(60.0, hand), lambda *_: None)
    tell("verlet", "")
    hand.at += 60.0
    with pytest.raises(stability.TimeOver):
        tell("verlet", "")
    said = experiment.left_out(scene, limits, journal)
    assert said == ["verlet: limit, map of stiffness, map of mass"]
    journal.discard()


@thorough
def test_a_trade_of_half_a_minute_has_a_reference_and_names_the_rest(cli, tmp_path):
    """Rows and what was left out are together what was asked for."""
    cli("trade", "cloth", "--within", "30s", "--output", tmp_path)
    told = json.loads((tmp_path / "trade.json").read_text())["environment"]
    assert told["within"] == 30 and told["reference"]
    with (tmp_path / "trade.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    asked = TradeOptions.from_given({"within": "30s"})
    chosen = command.prepare(SceneSource("cloth"), asked)[1]
    assert 0 < len(rows) <= len(chosen)
    assert len(rows) == len(chosen) or len(told["left_out"]) > 1
    assert told["left_out"][-1].endswith(": compensated, 4 and 16 iterations, more substeps")
    assert all(row["error_trajectory"] for row in rows if row["status"] == "ok")
