"""What commands print fits the terminal: no line is wider, no word and no name is cut."""

import math
import re
import shlex
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import bench
from bench import report as bench_report
from taichi_cloth import console, runtime
from taichi_cloth.advice import tune
from taichi_cloth.advice.choice import Target
from taichi_cloth.cli import doctor
from taichi_cloth.cli.main import COMMANDS, main
from taichi_cloth.explain import command as explain
from taichi_cloth.explain.costs import Compiled, Cost, Explanation, Stored
from taichi_cloth.kernels import methods
from taichi_cloth.limits.eigenmodes import Limit
from taichi_cloth.limits.rounding import Stall
from taichi_cloth.scene import library
from taichi_cloth.settings.options import PATHS, TOPOLOGIES
from taichi_cloth.simulation import autotune, prediction
from taichi_cloth.stability import report as stability_report
from taichi_cloth.stability.experiment import StepLimits
from taichi_cloth.sweeps.within import Clock
from taichi_cloth.trade import report as trade_report
from taichi_cloth.trade import rows
from taichi_cloth.trade.seconds import Second
from taichi_cloth.trade.settings import Setting

RESULTS = Path(__file__).parent.parent / "bench" / "results" / "amd-epyc-2-cores.csv"
LONG = "implicit_midpoint"  # no method has a longer name
RUN = "taichi-cloth run cloth --shear 0.25 --topology graph --execution serial"


@pytest.fixture(params=[60, 80, 120])
def width(request, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(request.param))
    return request.param


def assert_fits(shown, width, *texts):
    """No line is wider; the words of all texts, and so the names, are whole."""
    wide = [line for line in shown.splitlines() if len(line) > width]
    assert not wide, "\n".join(wide)
    assert "…" not in shown
    missing = {word for text in texts for word in words(text)} - words(shown)
    assert not missing, shown


def words(text):
    return set(re.split(r"[\s,;:]+", text))


def made_row(method=LONG, precision="compensated", substeps=4096, error=0.0123, seconds=0.5):
    setting = Setting(method, 1 / 60, substeps, precision, False, "cuda", 16, None)
    numbers = {
        name: error
        for name in (
            *("error_final_max_relative", "error_trajectory", "error_trajectory_relative"),
            *("energy_drift", "max_strain", "error_discretisation", "error_solver"),
            *("penetration_max", "contact_energy", "first_touch_later"),
        )
    }
    times = {"wall_seconds": seconds, "wall_lower": seconds, "wall_upper": 1.5 * seconds}
    command = " ".join([RUN, *setting.words()])
    counts = {"breaks": 123, "breaks_agreeing": 45, "sweeps": 99999, "force_evaluations": 123456}
    judged = [Second(first, error, error) for first in (0, 60, 120, 180)]
    given = {"frames": 240, "judged": judged, "order": 1.98, "command": command}
    return rows.Row(setting, **numbers, **times, **counts, **given)


def made_rows():
    """A front of three, one that is beaten, and one that failed."""
    found = [
        made_row(error=2e-5, seconds=3.0),
        made_row("rk4", "f64", 8, 0.004, 1.0),
        made_row("explicit_euler", "f32", 1, 0.3, 0.1),
        made_row("symplectic_euler", "f64", 8, 0.005, 2.0),
    ]
    front = rows.pareto([(row.wall_seconds, row.error_trajectory) for row in found])
    found = [replace(row, pareto=on) for row, on in zip(found, front, strict=True)]
    why = "failed: frame 12, particle 123 runs away at speed 1e+09; a step is above the limit"
    return [*found, rows.Row(found[0].setting, status=why)]


LEFT_OUT = ["implicit_midpoint and tr_bdf2, and of rk4 12 settings in f64 and in compensated sums"]


def show_trade(made, to):
    horizon = SimpleNamespace(frames=240, scale=1.0, what="the scale", describe=lambda: "horizon")
    result = SimpleNamespace(
        scene=SimpleNamespace(name="x"),
        frames=horizon.frames,
        horizon=horizon,
        reference=None,
        clock=Clock(60.0),
        left_out=LEFT_OUT,
    )
    trade_report.show(result, made, to)
    trade_report.show_front(result, made, to)


def test_words_are_cut_nowhere_but_at_the_ends_of_paths():
    text = "cache: /home/somebody/.cache/taichi-cloth/times.json  (32 MiB)"
    assert console.wrapped(text, 80) == [" ".join(text.split())]
    lines = console.wrapped(text, 24, hang=2)
    assert lines == [
        "cache:",
        "  /home/somebody/.cache/",
        "  taichi-cloth/",
        "  times.json (32 MiB)",
    ]
    assert console.wrapped("x" * 30, 12) == ["x" * 12, "x" * 12, "x" * 6]
    assert console.wrapped("  - a b\n\nc", 5, hang=2) == ["  - a", "    b", "", "c"]


def test_a_table_drops_what_it_is_told_to_before_it_cuts_a_number(capsys):
    headers = ("name", "what it is", "first time", "second time")
    lines = [[LONG, "a text of several words, all of them whole", "123 ms", "456.78 ms"]]
    for columns, kept in ((100, headers), (60, headers), (54, headers[:3]), (42, headers[:2])):
        to = console.output()
        to.width = columns
        left = ("name", "what it is")
        spared = ("second time", "first time")
        dropped = console.print_table(to, "t", headers, lines, left, spared=spared)
        shown = capsys.readouterr().out
        assert tuple(h for h in headers if h not in dropped) == kept
        assert_fits(shown, columns, *kept, *lines[0][:2])
        assert ("123 ms" in shown) is ("first time" in kept)


def test_list_and_doctor_fit(width, monkeypatch, capsys):
    lacks = {name: None if name == "cpu" else "a driver and a display" for name in runtime.BACKENDS}
    monkeypatch.setattr(runtime, "usable_backends", lambda: lacks)
    assert main(["list"]) == 0
    texts = (library.description(name) for name in library.names())
    assert_fits(capsys.readouterr().out, width, *texts, *methods.METHODS, *runtime.BACKENDS)
    ways = [(topology, path) for topology in TOPOLOGIES for path in PATHS]
    kind = SimpleNamespace(
        what="cuda compensated, 128 threads/implicit_midpoint/3-D, collisions; 2^18 particles",
        costs={f"{topology} {path}": prediction.Cost(12.3e-3, 4.56e-3) for topology, path in ways},
    )
    monkeypatch.setattr(autotune, "measurements", lambda: [kind] * 9)
    found = [
        doctor.Finding("cache of measured speeds", "/home/somebody/a/long/path/" * 4),
        doctor.Finding("backend opengl", "needs an OpenGL 4.3 driver [and a display]", False),
    ]
    monkeypatch.setattr(doctor, "findings", lambda: iter(found))
    assert main(["doctor"]) == 0
    shown = capsys.readouterr().out
    assert_fits(shown, width, "cache of measured speeds", found[1].text, LONG, "collisions")
    assert_fits(shown, width, *PATHS, *TOPOLOGIES)


def test_help_is_as_wide_as_the_terminal(width, capsys):
    for words in ([], *([command] for command in COMMANDS)):
        assert main([*words, "--help"]) == 0
        shown = capsys.readouterr().out
        assert_fits(shown, width)
        if words == ["run"]:
            assert max(map(len, shown.splitlines())) > width - 12


def test_the_trade_fits_and_ends_with_its_front_and_advice(width, capsys):
    made = made_rows()
    show_trade(made, console.output())
    shown = capsys.readouterr().out
    names = {row.setting.method for row in made}
    assert_fits(shown, width, *names, "compensated", "time a frame", "failed")
    _, end = shown.split("the front: ")
    assert re.findall(rf"^ ?(\w+_euler|rk4|{LONG})\b", end, re.M) == ["explicit_euler", "rk4", LONG]
    assert "symplectic_euler" not in end
    if width == 60:
        assert "substeps 4096; solver 16 sweeps" in " ".join(shown.split())
    advice, _, command = end.partition("Take ")[2].partition("it:\n")
    assert " ".join(advice.split()).startswith("rk4, 8 substeps") and "at most 1 %" in advice
    # A shell puts together what was printed on several lines.
    assert shlex.split(command.replace("\\\n", "")) == made[1].command.split()


def test_a_wide_terminal_is_shown_all_columns(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "300")
    show_trade(made_rows(), console.output())
    shown = capsys.readouterr().out
    assert "the terminal is narrow" not in shown
    for name in trade_report.SPARED:
        assert name in shown


def test_advice_is_good_cheap_and_lasts():
    front = [
        made_row("explicit_euler", "f32", 1, 0.005, 0.1),
        made_row("rk4", "f32", 1, 0.004, 0.2),
        made_row("rk4", "f64", 1, 0.0001, 0.3),
    ]
    taken, why = trade_report.advised(front)
    assert taken is front[1] and "at most 1 %" in why
    assert trade_report.advised(front[:1])[0] is front[0]  # there is nothing else
    rough = [made_row("rk4", "f32", 1, 0.2, 0.1), made_row("rk4", "f32", 2, 0.1, 0.3)]
    assert trade_report.advised(rough) == (rough[1], "the most accurate there is")
    # An error that the reference cannot tell from 3 % is not known to be at most 1 %.
    hidden = replace(front[1], judged=None, frames=60, below_floor=True, floor=0.03, scale=1.0)
    assert trade_report.advised([hidden, front[2]]) == (front[2], why)
    assert trade_report.advised([hidden]) == (hidden, "the most accurate there is")


def test_tune_fits(width, capsys):
    made = made_rows()
    tried = [tune.Attempt(made[0], made[-1], False), tune.Attempt(made[1], made[1], True)]
    tune._show("cloth", Target(error=0.01), tried, LEFT_OUT)
    shown = capsys.readouterr().out
    assert_fits(shown, width, *(attempt.row.setting.method for attempt in tried), "particle", "f64")
    tune._show("cloth", Target(error=0.01), tried[:1] * 12, ())
    shown = capsys.readouterr().out
    assert_fits(shown, width)
    assert RUN not in shown and "and 4 more" in shown


def test_stability_fits(width, capsys):
    limit = Limit(0.123456, 1.0, 0.1, spring=123456, ends=(12345, 12346), share=0.5, particle=7)
    drag = replace(limit, spring=-1)
    limits = [
        StepLimits(LONG, 0.123456, 0.12345, limit, 0.12346, 10, 1000, "measured"),
        StepLimits("symplectic_euler", 0.1, 0.1, drag, None, 10, 1000),
        StepLimits("explicit_euler", 0.0, 0.0, Limit(0.0), 0.0, 1, 1, "grows at 0.001 already"),
        StepLimits("verlet", math.inf, math.inf, Limit(math.inf), math.inf, 1, 1, "no limit"),
    ]
    stall = Stall(1e-5, "x", 12345, 300.0, 0.5)
    stability_report.show(library.build("cloth"), limits, stall, all_methods=True)
    shown = capsys.readouterr().out
    assert_fits(shown, width, *(of.method for of in limits), "computed", "measured", "set by")
    table, _, left_out = shown.partition("Left out, for the terminal is narrow: ")
    assert ("Gershgorin" in left_out) is (width < 120) is not ("Gershgorin" in table)
    as_it_starts = {of.method: of.limit.dt for of in limits}
    for changed, words in ((1.009, ""), (3.0, "limits are: symplectic_euler")):
        as_it_starts["symplectic_euler"] = changed * drag.dt
        stability_report.say_of_wind(np.array([0.0, 0.25, 0.125]), limits, as_it_starts)
        shown = capsys.readouterr().out
        assert "at its strongest: a rate of 0.25." in " ".join(shown.split())
        assert words in " ".join(shown.split()) and ("limits are:" in shown) == bool(words)
        assert_fits(shown, width)
    stability_report.say_of_wind(np.zeros(3), limits, as_it_starts)
    assert capsys.readouterr().out == ""


def test_explain_fits(width, capsys):
    plan = defaultdict(int, lanes=8, threads=16, fracture=True, walls=True, collisions=True)
    fields = [Stored("half_springs_of_each", (262144, 16), "f64", 2**25)]
    fields += [Stored(name, (1,), "f32", 4) for name in ("pointer_strength", "speed_limit")]
    compiled = Compiled(plan, "lanes", "parallel", 1, {"structural": 524288}, 0, fields, 2**26)
    times = {"seconds_with": 1.234e-3, "seconds_without": 1.1e-3, "seconds": -1.34e-4}
    spread = {"lower": -1.5e-4, "upper": 1.2e-4, "compile_seconds": 12.34, "bytes": -123456}
    costs = [
        Cost("uniform particles", True, "all have the same numbers but mass", **times, **spread),
        Cost("third dimension", False, "the same scene in a plane", failed="cannot be compiled"),
    ]
    e = Explanation(
        *("a scene", 262144, 524288, "2-D, uniform springs, fracture", LONG, 1 / 60, 4096),
        *(compiled, 1.2e-3, 1.1e-3, 1.4e-3, 4.3, 7, costs),
    )
    explain.show(e, console.output())
    shown = capsys.readouterr().out
    texts = (text for cost in costs for text in (cost.feature, cost.about))
    assert_fits(shown, width, *texts, "half_springs_of_each", "pointer_strength", "cost a step")
    # Where there was time for none there is no table without a line.
    explain.show(replace(e, costs=[]), console.output())
    shown = capsys.readouterr().out
    assert "a step" not in shown.partition("compiled:")[2] and "half_springs_of_each" in shown


def test_bench_fits(width, capsys):
    results = [row for row in bench_report.read(RESULTS)[1] if row.rate is not None]
    for part in bench.PARTS:
        measured = [row for row in results if row.part == part]
        bench_report.show(f"{part}: {bench.summary(part)}", measured, console.output())
        assert_fits(capsys.readouterr().out, width, *(row.contestant for row in measured))
