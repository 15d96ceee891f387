"""The benchmark: its yardsticks do the same as ours, its results keep, its documents are true."""

import importlib
import inspect
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from goldens import golden
from lacking import needs_compiler, needs_peers
from selection import thorough

from bench import (
    PARTS,
    cloths,
    compiled,
    contest,
    module_of,
    newton,
    objects,
    objects_inlined,
    report,
    summary,
)
from bench import meshes as meshes_part
from bench import structural as structural_part
from bench import warp as warp_part
from taichi_cloth import runtime
from taichi_cloth.cli.main import main
from taichi_cloth.errors import InputError
from taichi_cloth.measuring import machine
from taichi_cloth.scene import library

ROOT = Path(__file__).parent.parent
SPEED = ROOT / "docs" / "speed.md"
RESULTS = ROOT / "bench" / "results"


@pytest.fixture
def bench():
    bench = contest.Bench(rounds=2, quick=True)
    yield bench
    bench.close()


# ------------------------------------------------------------------------------------------
# The yardsticks


@pytest.mark.parametrize("program", [objects, objects_inlined])
def test_programs_of_objects_rest_like_the_original(program):
    cloth = program.Cloth()
    for expected in golden("cloth_rest.npz")["position"]:
        for _ in range(10):
            cloth.step()
        np.testing.assert_allclose(cloth.positions(), expected, rtol=0, atol=1e-9)


def test_program_of_objects_is_blown_and_torn_like_the_original():
    """Pulling amplifies round-off, to 60 at last: each sum is in the original's order."""
    cloth, expected, before = objects.Cloth(), golden("cloth_storm.npz"), None
    springs = list(cloth.springs)
    for frame, event in enumerate(golden("cloth_storm.jsonl"), 1):
        pointer = objects.Vector(*event["pos"])
        cloth.blow(pointer, pointer - (before or pointer))
        before = pointer
        cloth.step()
        if frame % 10 == 0:
            positions = expected["position"][frame // 10 - 1]
            most = 1e-6 if frame <= 100 else 1e-4
            np.testing.assert_allclose(cloth.positions(), positions, rtol=0, atol=most)
    cloth.step()  # what was over its limit pulls once more and is gone
    alive = np.isin([id(spring) for spring in springs], [id(spring) for spring in cloth.springs])
    np.testing.assert_array_equal(alive, expected["spring_alive_final"])


# A user may lack a compiler, and `bench` then leaves the C++ out; .ci/run installs one.
@needs_compiler
def test_compiled_yardsticks_agree_with_ours(bench, pool):
    """Both C++ programs, on a cloth whose sides differ, to f32's round-off."""
    scene = structural_part.structural(24, 17)
    substeps = structural_part.STRUCTURAL_SUBSTEPS
    sim = pool(scene, dt=float(substeps), substeps=substeps)
    sim.advance(4)
    resolution = np.spacing(np.float32(scene.particles.position.max()))
    for kind in ("csr", "grid"):
        shared = {"size": "24 x 17", "particles": 24 * 17, "units": 4}
        entered = structural_part._enter(bench, kind, kind, {"side": 24, "rows": 17}, **shared)
        assert bench.mark_after("structural", [entered], 4), bench.left_out
        assert contest.distance(entered.marks[4], sim.positions()) < 20 * resolution


@thorough
@needs_compiler
def test_the_compiled_mesh_agrees_with_ours_in_every_order(bench, pool):
    """To f32's round-off, by the sheet's own numbers, however its vertices lie in memory."""
    substeps, side = structural_part.STRUCTURAL_SUBSTEPS, 9
    for order in meshes_part.ORDERS:
        scene = cloths.sheet(side, "rows" if order == "rows" else "shuffled")
        sim = pool(scene, dt=substeps * scene.world.dt, substeps=substeps)
        sim.advance(4)
        entered = compiled.enter_compiled(
            bench,
            order,
            "bench.meshes:CompiledMesh",
            {"side": side, "order": order},
            part="meshes",
            steps=substeps,
            **{"size": "81", "particles": side**2, "units": 4},
        )
        assert bench.mark_after("meshes", [entered], 4), bench.left_out
        assert contest.distance(entered.marks[4], sim.positions()) < 20 * np.spacing(np.float32(2))


@needs_peers
@thorough
def test_cloth_of_warp_is_ours(tmp_path):
    """The same particles in the same order, the same springs with the same numbers."""
    theirs, scene = warp_part.their_cloth(9, tmp_path), library.build("warp", side=9)
    np.testing.assert_allclose(scene.particles.position, theirs.positions, atol=1e-6)
    np.testing.assert_array_equal(scene.particles.fixed, theirs.inv_masses == 0)
    ends = theirs.spring_indices.reshape(-1, 2)
    lengths = {tuple(sorted(e)): l for e, l in zip(ends.tolist(), theirs.spring_lengths)}  # noqa: B905, E741
    springs = scene.springs
    assert len(lengths) == len(springs) == len(ends)
    for pair, length in zip(springs.between.tolist(), springs.rest_length, strict=True):
        assert length == pytest.approx(lengths[tuple(sorted(pair))], abs=1e-6)
    assert set(theirs.spring_stiffness) == set(springs.stiffness)
    assert set(theirs.spring_damping) == set(springs.damping)
    # A recorded frame has the bits of a launched one.
    launched, recorded = (
        warp_part.Theirs("warp", "WpIntegrator", ["cpu"], 9, str(tmp_path), recorded=recorded)
        for recorded in (False, True)
    )
    for side in (launched, recorded):
        side.advance(3)
    np.testing.assert_array_equal(launched.positions(), recorded.positions())
    assert np.abs(recorded.positions() - theirs.positions).max() > 1e-3


# ------------------------------------------------------------------------------------------
# Contests


def enter_objects(bench, name="objects", kind="bench.seed:Program"):
    return bench.enter(
        "seed",
        name,
        kind,
        {"module": "bench.objects_inlined"},
        library="objects",
        precision="f64",
        threads=1,
        size="16 x 12",
        particles=192,
        steps=1,
        units=10,
        packages=("python",),
    )


def test_contestants_take_turns_and_are_timed(bench):
    one, other = enter_objects(bench), enter_objects(bench)
    finished = bench.race("seed", [one, None, other], marks=[20])
    assert finished == [one, other] and [len(c.seconds) for c in finished] == [2, 2]
    np.testing.assert_array_equal(one.marks[20], other.marks[20])
    (row, _) = bench.rows("seed", finished, {20: one.marks[20] + [3.0, 4.0]}, "a shifted copy")
    assert row.error == pytest.approx(5.0) and row.against == "a shifted copy"
    assert row.lower <= row.seconds <= row.upper and row.rounds == 2
    assert row.rate == pytest.approx(192 / row.seconds) and row.versions.startswith("python 3")
    (ratio,) = contest.compare("seed", "", "both", one, other, ">= 0.001")
    assert ratio.is_ratio and ratio.met
    assert contest.separation("seed", one, other, 20, "px", "<= 0")[0].met


def test_contestants_that_fail_are_left_out(bench):
    assert enter_objects(bench, "absent", "bench.seed:Absent") is None
    dying, lasting = enter_objects(bench, "dying"), enter_objects(bench, "lasting")
    dying.key = "nobody"
    assert bench.race("seed", [dying, lasting]) == [lasting]
    said = [(row.contestant, row.note) for row in bench.left_out]
    assert [name for name, _ in said] == ["absent", "dying"]
    assert all(re.match(r"left out: \w+Error: ", note) for _, note in said)
    lasting.worker._process.kill()
    assert bench.race("seed", [lasting]) == []
    assert "its process ended" in bench.left_out[-1].note
    assert bench.race("seed", [enter_objects(bench)])  # a new process takes its place


def test_each_part_is_described_and_measures(capsys):
    assert main(["bench", "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    for part in PARTS:
        module = importlib.import_module(module_of(part))
        assert inspect.isgeneratorfunction(module.measure) and part == module.PART
        assert summary(part) in shown


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["sead"], "unknown part 'sead'; did you mean 'seed'?"),
        (["--rounds", "1"], "--rounds must be at least 2, is 1"),
        (["--round", "3"], "did you mean '--rounds'?"),
        (["seed", "--arch", "cuda"], "only the part gpu takes it"),
        (["gpu", "--arch", "cpu"], "--arch: unknown value 'cpu'"),
        (["--tables", "no.md"], "there is no such file"),
        (["--tables", "latin.md"], "--tables latin.md: is not a text file in UTF-8 (byte 20)"),
        (["--tables", "other.md"], "--tables other.md: has no '<!-- bench:... -->' to fill"),
        (["seed", "--output", "/dev/null/x"], "--output /dev/null/x: cannot be made"),
    ],
)
def test_bad_arguments_are_refused_in_one_line(arguments, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "latin.md").write_bytes(b"<!-- bench:seed -->\n\xfc\n<!-- end -->\n")
    (tmp_path / "other.md").write_text("<!-- explain:machine -->\n<!-- end -->\n")
    assert main(["bench", *arguments]) == 2
    out, err = capsys.readouterr()
    assert says in err and err.count("\n") == 1 and not out


def test_without_a_checkout_it_says_where_it_runs(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("taichi_cloth.cli.bench.__file__", str(tmp_path / "a" / "b" / "bench.py"))
    monkeypatch.setattr("sys.path", [])
    assert main(["bench", "seed"]) == 2
    assert "run it in a checkout of taichi-cloth" in capsys.readouterr().err


# ------------------------------------------------------------------------------------------
# What is absent


def test_missing_peers_are_named_with_what_to_install(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(machine, "installed", lambda package: False)
    monkeypatch.setattr(
        runtime, "usable_backends", lambda: dict.fromkeys(runtime.BACKENDS, "a GPU")
    )
    assert main(["bench", "newton", "gpu", "--output", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    for name in newton.SOLVERS:
        assert f"newton, {name}, all sizes: pip install " in out
    assert "gpu, cuda: not usable here; it needs a GPU" in out
    (file,) = tmp_path.iterdir()
    kept = report.read(file)[1]
    assert [row.contestant for row in kept] == [*newton.SOLVERS, "cuda", "vulkan"]
    assert all(row.note.startswith("left out: ") for row in kept)


def test_warp_and_the_compiler_may_be_missing(monkeypatch, bench):
    monkeypatch.setattr(machine, "installed", lambda package: False)
    monkeypatch.setattr(bench, "enter", lambda *_, **__: None)
    for part in (warp_part, structural_part):
        assert [row for row in part.measure(bench) if row.seconds] == []
    said = {row.contestant: row.note for row in bench.left_out}
    assert all("pip install" in said[name] for name in warp_part.PEERS)
    assert all("C++ compiler" in said[f"C++, {kind}"] for kind in ("csr", "grid"))


# ------------------------------------------------------------------------------------------
# Results


def results():
    timed = report.Measurement(
        "seed",
        "ours, lanes",
        size="16 x 12",
        precision="f64",
        threads=1,
        seconds=2.5e-6,
        lower=2.25e-6,
        upper=3e-6,
        rate=7.68e7,
        unit="particle-steps/s",
        error=0.015,
        against="a reference",
        rounds=7,
        versions="taichi 1.7.4",
    )
    ratio = report.Measurement("seed", "ours to theirs", rate=3.5, unit="times", target=">= 4")
    gap = report.Measurement("seed", 'a "peer", too', note="left out: not here")
    return [timed, ratio, gap]


def test_results_survive_their_file(tmp_path):
    path, rows = tmp_path / "machine.csv", results()
    report.write(path, {"processor": "Fast: 3 GHz"}, rows)
    assert report.read(path) == ({"processor": "Fast: 3 GHz"}, rows)
    other = [replace(rows[0], part="warp")]
    report.replace_part(path, {"processor": "Faster"}, "warp", other)
    report.replace_part(path, {"processor": "Faster"}, "seed", rows[:1])
    assert report.read(path) == ({"processor": "Faster"}, [*other, rows[0]])
    path.write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="no file of results"):
        report.read(path)


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda whole: b"\xfc" + whole, "is not a text file in UTF-8 (byte 0); remove it"),
        (lambda whole: whole[:-40], "line 5: is cut short, or is no row; mend it, or remove"),
        (lambda whole: whole.replace(b",7,", b",7x,"), "line 3: is cut short, or is no row"),
        (lambda whole: whole.replace(b"seed,ours to", b"sead,ours to"), "has a part 'sead'"),
        (lambda whole: b"", "is no file of results of this version; remove it"),
    ],
    ids=["no UTF-8", "cut", "no number", "no part", "empty"],
)
def test_results_that_cannot_be_joined_are_refused_before_measuring(
    damage, says, tmp_path, monkeypatch, capsys
):
    path = tmp_path / f"{machine.file_name()}.csv"
    report.write(path, {"processor": "Fast: 3 GHz"}, results())
    path.write_bytes(damage(path.read_bytes()))
    before = path.read_bytes()
    monkeypatch.setattr("bench.command._measure", None)
    assert main(["bench", "seed", "--output", str(tmp_path)]) == 2
    out, err = capsys.readouterr()
    assert says in err and str(path) in err and err.count("\n") == 1 and not out
    assert path.read_bytes() == before


def test_tables_show_speed_error_and_missed_targets(tmp_path):
    text = report.markdown(results())
    assert "| ours, lanes | 16 x 12 | f64 | 1 | 2.5 µs | 2.25 µs .. 3 µs | 76.8 | 1.5e-02 |" in text
    assert "| ours to theirs |  | 3.5 times | at least 4: missed |" in text
    assert 'a "peer", too: left out: not here' in text and "with taichi 1.7.4" in text
    report.write(tmp_path / "mine.csv", {"cores": "2"}, results())
    document = "a\n<!-- bench:{} -->\nold\n<!-- end -->\nb\n"
    filled = report.fill(
        document.format("seed") + document.format("machine mine"), tmp_path, "mine"
    )
    assert text in filled and "- cores: 2" in filled and "old" not in filled
    assert report.fill(filled, tmp_path, "mine") == filled
    with pytest.raises(InputError, match="there is no such file"):
        report.fill(document.format("seed other"), tmp_path, "mine")


def test_documented_figures_are_those_of_the_committed_results():
    text = SPEED.read_text()
    assert {part for part, _ in report.used(text)} == {"machine", *PARTS}
    assert report.fill(text, RESULTS, "none: each marker names its file") == text


def test_a_machine_has_a_safe_file_name():
    assert re.fullmatch(r"[a-z0-9][a-z0-9-]*-\d+-cores", machine.file_name())


@thorough
def test_a_quick_run_prints_and_keeps_its_results(cli, tmp_path):
    out, err = cli("bench", "seed", "--quick", "--rounds", 2, "--output", tmp_path)
    assert not err
    path = tmp_path / f"{machine.file_name()}.csv"
    description, rows = report.read(path)
    assert description["cores"] in out and str(path) in out.replace("\n", "")
    timed = [row for row in rows if row.seconds]
    assert len(timed) == 7 and all(row.error < 1 and row.rounds == 2 for row in timed)
    ratios = {row.contestant: row for row in rows if row.is_ratio}
    assert ratios["ours, fastest in f64, to objects"].rate > 0
    apart = [row for row in ratios.values() if "farthest" in row.contestant]
    assert len(apart) == 2 and all(row.met for row in apart)


def test_what_an_interrupted_part_has_measured_is_kept(tmp_path, monkeypatch, capsys):
    """Where the file has nothing of it; a run that was finished stays. A file for each part."""

    def measure(bench):
        bench.leave_out("gpu", "one", "8 x 8", "not here")
        yield report.Measurement("gpu", "two", "8 x 8", rate=speed, unit="GB/s")
        if stops:
            raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, "measures", SimpleNamespace(measure=measure))
    monkeypatch.setattr("bench.command.module_of", lambda part: "measures")
    asked = ["bench", "gpu", "--output", str(tmp_path)]
    stops = True
    for speed in (0.5, 1.0):
        assert main(asked) == 130
        (path,) = tmp_path.iterdir()
        kept = [(row.contestant, row.rate, row.note) for row in report.read(path)[1]]
        assert kept == [
            ("two", speed, ""),
            ("one", None, "left out: not here"),
            ("all that was to follow", None, "left out: interrupted"),
        ]
    speed, stops = 2.0, False
    assert main(asked) == 0
    whole = path.read_text()
    assert "interrupted" not in whole
    speed, stops = 3.0, True
    capsys.readouterr()
    assert main(asked) == 130 and path.read_text() == whole
    shown = capsys.readouterr().out
    assert "two" in shown and "not written" in " ".join(shown.split())
