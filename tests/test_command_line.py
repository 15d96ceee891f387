"""The command line: what it prints, writes and returns, and what it imports to do so."""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from commands import PROGRAM, after_start, command
from goldens import GOLDEN
from selection import as_thorough

from taichi_cloth import runtime
from taichi_cloth.cli import doctor, run_notes, scene_command
from taichi_cloth.cli.main import main
from taichi_cloth.comparison.compare import compare
from taichi_cloth.errors import InputError, RunFailure
from taichi_cloth.files import trajectory as trajectories
from taichi_cloth.files.exports import Export
from taichi_cloth.files.pending import PendingFile, write_whole
from taichi_cloth.files.recordings import Recordings
from taichi_cloth.kernels import methods
from taichi_cloth.scene import checks, library
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import ExplainOptions, RunOptions, parameters_of
from taichi_cloth.settings.sweeps import StabilityOptions, TradeOptions, TuneOptions
from taichi_cloth.simulation import autotune
from taichi_cloth.simulation.checkpoint import Checkpoint
from taichi_cloth.simulation.prediction import Cost

HEAVY = ("taichi", "matplotlib", "imageio", "scipy", "rich", "PIL")


@pytest.mark.parametrize(
    "code",
    [
        "import taichi_cloth",
        "from taichi_cloth import Scene, World, validate, grid, load_scene, scenes",
        "from taichi_cloth import Trajectory, load_events, InputError, SimulationFailure",
        "import taichi_cloth.cli.main, taichi_cloth.files.events, taichi_cloth.files.trajectory",
        "from taichi_cloth.cli.main import main; main(['--help'])",
        "from taichi_cloth.cli.main import main; main(['run', 'box', '--help'])",
        "from taichi_cloth.cli.main import main; assert main(['run', '--frames', '0']) == 2",
        "from taichi_cloth.cli.main import main; main(['trade', '--help'])",
    ],
)
def test_nothing_heavy_is_imported_before_a_run(code):
    heavy = f"[name for name in {HEAVY} if name in sys.modules]"
    subprocess.run(
        [sys.executable, "-c", f"import sys; {code}; assert not {heavy}, {heavy}"],
        check=True,
        capture_output=True,
    )


def test_every_public_name_is_there():
    import taichi_cloth

    for name in taichi_cloth.__all__:
        assert getattr(taichi_cloth, name) is not None
    with pytest.raises(AttributeError):
        taichi_cloth.no_such_name  # noqa: B018


@pytest.mark.parametrize("name", library.names())
def test_help_shows_every_flag_of_a_scene(name, capsys):
    assert main(["run", name, "--help"]) == 0
    shown = capsys.readouterr().out
    for parameters in (parameters_of(RunOptions), library.parameters(name)):
        for flag in parameters:
            assert "--" + flag.replace("_", "-") in shown


def test_a_flag_that_scene_and_command_share_takes_one_value_for_both():
    """As --seed does; no scene's parameter hides a flag of a command, as a --size in particles."""
    shared = set()
    for options in (RunOptions, StabilityOptions, TradeOptions, TuneOptions, ExplainOptions):
        of_command = parameters_of(options)
        for name in library.names():
            for flag in of_command.keys() & library.parameters(name).keys():
                assert of_command[flag].type is library.parameters(name)[flag].type, (name, flag)
                shared.add(flag)
    assert "seed" in shared


def test_help_and_version(capsys):
    assert main(["--help"]) == 0 and "taichi-cloth run --help" in capsys.readouterr().out
    assert main(["--version"]) == 0 and capsys.readouterr().out.startswith("taichi-cloth ")


@pytest.mark.parametrize(
    ("words", "source", "given"),
    [
        ("oscillator --amplitude -5", SceneSource("oscillator", {"amplitude": -5.0}), {}),
        ("--amplitude=-1e1 oscillator", SceneSource("oscillator", {"amplitude": -10.0}), {}),
        ("--frames 3 box --quiet", SceneSource("box"), {"frames": 3, "quiet": True}),
        ("box --seed 4", SceneSource("box", {"seed": 4}), {"seed": 4}),
        ("--no-fast-math --save -x", SceneSource(), {"fast_math": False, "save": "-x"}),
        ("--frames 3 --frames 5", SceneSource(), {"frames": 5}),
        ("a.toml --dt auto --size 80x60", SceneSource("a.toml"), {"dt": "auto", "size": (80, 60)}),
    ],
)
def test_words_say_a_scene_and_what_is_given(words, source, given):
    asked = scene_command.read("run", RunOptions, words.split(), "")
    assert asked == (source, RunOptions.from_given(given))


ASSIGNMENTS = [
    # (scene, --set, what of the scene has which value)
    ("cloth", "world.gravity=[0,0.1]", lambda scene: scene.world.gravity == (0, 0.1)),
    ("cloth", "world.walls=[top, left]", lambda scene: scene.world.walls == ("top", "left")),
    ("cloth", "world.mouse=none", lambda scene: scene.world.mouse == "none"),
    ("cloth", 'world.mouse = "none"', lambda scene: scene.world.mouse == "none"),
    ("cloth", "name=my cloth", lambda scene: scene.name == "my cloth"),
    ("cloth", "particle.viscous=0.5", lambda scene: (scene.particles.viscous == 0.5).all()),
    ("box", "particle.mass=2", lambda scene: scene.particle_defaults.mass == 2),
    ("cloth --shear 0.1", "spring.stiffness=0.3", lambda s: (s.springs.stiffness == 0.3).all()),
    ("cloth", "spring.break_force=false", lambda s: np.isinf(s.springs.break_force).all()),
    ("cloth", "spring.rest_length=20", lambda scene: (scene.springs.rest_length == 20).all()),
    ("a.toml", "cloths[0].columns=4", lambda scene: len(scene.particles) == 1 + 4 * 2),
    ("a.toml", "particles[0].fixed=true", lambda scene: scene.particles.fixed[0]),
    ("a.toml", "particle.mass=3", lambda scene: (scene.particles.mass == [7, *[3] * 6]).all()),
    ("a.toml", "world.size[0]=50", lambda scene: scene.world.size == (50, 100)),
    ("a.toml", "spring.damping=0.5", lambda scene: (scene.springs.damping == 0.5).all()),
    ("a.toml", "cloths[0].stiffness={structural=4}", lambda s: (s.springs.stiffness == 4).all()),
]
WRONG_ASSIGNMENTS = [
    ("cloth", "world.gravty=[0,1]", "--set world.gravty: unknown key 'gravty'; did you mean 'grav"),
    (
        "cloth",
        "gravity=[0,1]",
        "--set gravity: unknown key 'gravity'; did you mean 'world.gr",
    ),
    ("cloth", "wrold.dt=1", "--set wrold.dt: unknown key 'wrold'; did you mean 'world'?"),
    ("cloth", "world.dt=0", "--set world.dt: dt must be positive, is 0"),
    ("cloth", "world.dt=soon", "--set world.dt: dt must be a number, is the text 'soon'"),
    ("cloth", "world.gravity=[0,1,2]", "--set world.gravity: gravity must have 2 numbers"),
    ("cloth", "particle.mass=-1", "--set particle.mass: mass must be positive, is -1"),
    ("cloth", "spring.stiffness=nan", "--set spring.stiffness: stiffness must be finite, is nan"),
    ("cloth", "world.size=[50,50]", "scene 'cloth': particle 0: position (100, 20) is outside"),
    ("cloth", "cloths[0].rows=3", "--set cloths[0].rows: a built-in scene has no entries by"),
    ("cloth", "world.dt=[1", "--set world.dt: '[1' is no value of TOML"),
    ("cloth", "world.dt=1\nmouse='none'", "--set world.dt: '1"),
    ("cloth", "world.dt=" + "[" * 5000, "--set world.dt: "),
    ("cloth", "world.dt=" + "9" * 5000, "--set world.dt: has a whole number with too many"),
    ("cloth", "world.dt=0x" + "f" * 5000, "--set world.dt: dt must be a number that fits"),
    ("cloth", "world", "--set must be KEY=VALUE, such as world.gravity=[0,0.1]; is 'world'"),
    ("cloth", "=3", "--set must be KEY=VALUE"),
    ("cloth", "world.d\u0661=3", "--set must be KEY=VALUE"),
    ("a.toml", "cloths[1].rows=3", "--set cloths[1].rows: 'cloths' has 1 entry, numbered from 0"),
    ("a.toml", "cloths.rows=3", "--set cloths.rows: name one entry of the list, such as cloths[0]"),
    ("a.toml", "world.dt.x=3", "--set world.dt.x: 'world.dt' is no table"),
    ("a.toml", "springs[0].between=[0,1]", "'springs' has 0 entries"),
    ("a.toml", "cloths[0].rows=3000", "[[cloths]] 0 particle "),
]
SCENE_FILE = """
[world]
size = [100, 100]
dt = 1
[[particles]]
position = [1, 1]
mass = 7
[[cloths]]
origin = [10, 10]
columns = 3
rows = 2
spacing = 5
"""


@pytest.fixture
def scene_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text(SCENE_FILE)


@pytest.mark.parametrize(("scene", "text", "has"), ASSIGNMENTS)
def test_a_key_of_scene_files_can_be_set_in_any_scene(scene, text, has, scene_file):
    words = [*scene.split(), "--set", text]
    source, _ = scene_command.read("run", RunOptions, words, "")
    assert not has(replace(source, assignments=()).build()) and has(source.build())
    assert source.words() == words and source.solution() is None


@pytest.mark.parametrize(("scene", "text", "says"), WRONG_ASSIGNMENTS)
def test_what_cannot_be_set_is_refused(scene, text, says, scene_file, capsys):
    for words in (["run"], ["trade"], ["tune", "--error", "1"], ["stability"], ["explain"]):
        assert main([*words, scene, "--set", text]) == 2
        said = capsys.readouterr().err
        assert says in said and said.count("\n") == 1 and len(said) < 300


def test_what_is_set_last_holds_and_others_stay():
    words = [
        "cloth",
        "--set",
        "world.dt=2",
        "--set",
        "world.dt=0.5",
        "--set",
        "world.gravity=[1,2]",
    ]
    source, _ = scene_command.read("run", RunOptions, words, "")
    scene, plain = source.build(), library.build("cloth")
    assert scene.world.dt == 0.5 and scene.world.gravity == (1, 2)
    assert replace(scene.world, dt=1.0, gravity=(0.0, 0.05)) == plain.world
    for ours, before in ((scene.particles, plain.particles), (scene.springs, plain.springs)):
        for name, column in vars(ours).items():
            assert (column == vars(before)[name]).all()


@pytest.mark.parametrize("word", ["--frame", "--head", "--", "-5", "-hx"])
def test_flags_are_written_out(word):
    with pytest.raises(InputError, match=f"unknown flag '{word}'"):
        scene_command.read("run", RunOptions, [word, "3"], "")


@pytest.mark.parametrize(
    ("words", "right", "wrong"),
    [
        (["explain", "cloth", "--turnss", "3"], "", "--turns"),  # of twist
        (["run", "--turnss", "3"], "", "--turns"),
        (["run", "--turnss", "3", "twist"], "did you mean '--turns'?", ""),
        (["run", "a.toml", "--spinn", "3"], "", "--spin"),  # of drape
        (["run", "drape", "--spinn", "3"], "did you mean '--spin'?", ""),
        (["run", "--colums=3"], "did you mean '--columns'?", ""),
        (["explain", "--sets", "3"], "did you mean '--set'?", ""),
        (["explain", "--resume"], "", "--set"),  # dashes alone make no likeness
    ],
)
def test_a_hint_names_no_flag_of_another_scene(words, right, wrong):
    command, *rest = words
    settings = {"explain": ExplainOptions, "run": RunOptions}[command]
    with pytest.raises(InputError) as refused:
        scene_command.read(command, settings, rest, "")
    hint = str(refused.value).partition("; ")[2]
    assert hint == right if right else f"'{wrong}'" not in hint


def test_the_hint_of_a_long_flag_is_not_cut_off():
    with pytest.raises(InputError, match=r"unknown flag '-9+\.\.\.'; '.* --help' shows all flags$"):
        scene_command.read("run", RunOptions, ["-" + "9" * 5000], "")


def test_a_scene_source_and_options_are_written_as_they_are_read():
    words = ["chain", "--particles", "5", "--methods", "rk4", "--dt", "0.5", "--within", "110s"]
    source, options = scene_command.read("trade", TradeOptions, words, "")
    assert [*source.words(), *options.words()] == words


def test_a_scene_is_checked_once_on_its_way_to_the_device(monkeypatch):
    checked = []
    monkeypatch.setattr(checks, "_check_world", lambda world, _: checked.append(world))
    scene = SceneSource("oscillator").build()
    assert checks.validate(scene) is scene and len(checked) == 1
    ours = library.build("oscillator")  # whose arrays may be written to before it is run
    assert checks.validate(ours) is ours and len(checked) == 3


def test_a_replay_follows_the_recordings_scene(cli, tmp_path):
    own = ["--columns", 3, "--rows", 2, "--break-force", "inf", "--set", "world.gravity=[0,0.5]"]
    how = [*ON_GRAPH, "--frames", 3]
    cli("run", "cloth", *own, *how, "--record", "a.jsonl", "--save", "a.npz", cwd=tmp_path)
    header = json.loads((tmp_path / "a.jsonl").read_text().splitlines()[0])["header"]
    _, said = cli("run", "cloth", *how, "--events", "a.jsonl", "--save", "b.npz", cwd=tmp_path)
    assert said == ""
    a, b = (trajectories.load(tmp_path / name) for name in ("a.npz", "b.npz"))
    assert header["arguments"] == a.meta["arguments"] == b.meta["arguments"] == [*map(str, own)]
    assert a.position.shape == (3, 6, 2) and (a.position == b.position).all()
    again = ["--rows", 3, "--events", "a.jsonl", "--save", "c.npz"]
    _, said = cli("run", "cloth", *how, *again, cwd=tmp_path)
    assert "--rows 3" in said and "(recorded: --columns 3 --rows 2" in said
    assert trajectories.load(tmp_path / "c.npz").position.shape == (3, 9, 2)
    header["arguments"] = ["--save", "x.npz"]
    (tmp_path / "a.jsonl").write_text(json.dumps({"header": header}))
    _, said = cli("run", "cloth", *how, "--events", "a.jsonl", cwd=tmp_path, check=2)
    assert "a.jsonl line 1: arguments: --save is none of a scene" in said


def test_list_names_every_scene_method_and_backend(capsys):
    assert main(["list"]) == 0
    shown, error = capsys.readouterr()
    for word in (*library.names(), *methods.METHODS, "--columns 16", *runtime.BACKENDS):
        assert word in shown
    assert error == ""


def test_doctor_reports_and_succeeds():
    shown, _ = command("doctor", env={"DISPLAY": ""})
    for word in ("Python", "taichi", "numpy", "backend cpu", "display", "view gui", "video writer"):
        assert word in shown


def test_doctor_shows_what_was_measured(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(doctor, "findings", lambda: ())
    assert doctor.main() == 0 and "nothing measured yet" in capsys.readouterr().out
    autotune.remember("cpu f64/verlet/2-D, 4 walls", "lanes parallel", Cost(1e-4, 2e-6))
    autotune.remember("cpu f64/verlet/2-D, 4 walls", "graph serial", Cost(3e-5, 4e-6))
    doctor.main()
    (row,) = [line for line in capsys.readouterr().out.splitlines() if "cpu f64" in line]
    assert "verlet; 2-D, 4 walls" in row
    assert row.split()[-8:] == ["-", "100", "+", "2", "30", "+", "4", "-"]


ON_GRAPH = ("--headless", "--topology", "graph", "--execution", "serial")


def test_a_run_prints_two_lines_and_saves_what_it_did(cli, tmp_path):
    arguments = [*ON_GRAPH, "--frames", 25, "--every", 10, "--precision", "f64"]
    out, err = cli("run", "cloth", *arguments, "--save", "out.npz", cwd=tmp_path)
    assert err == ""
    first, last = out.splitlines()
    for word in ("cloth", "symplectic_euler", "dt 1", "1 substep", "cpu f64", "headless"):
        assert word in first
    assert last.startswith("25 frames in ") and "ms a frame" in last
    with np.load(tmp_path / "out.npz") as file:
        arrays = dict(file)
    assert arrays["frame"].tolist() == [10, 20] and arrays["time"].tolist() == [10.0, 20.0]
    assert arrays["position"].shape == arrays["velocity"].shape == (2, 192, 2)
    assert arrays["position"].dtype == np.float64
    assert arrays["spring"].shape == (356, 2) and arrays["spring_alive"].shape == (2, 356)
    meta = json.loads(str(arrays["meta"]))
    assert meta["scene"] == "cloth" and meta["precision"] == "f64" and meta["arch"] == "cpu"
    assert {"method", "dt", "substeps", "device", "versions"} <= meta.keys()
    assert [p.name for p in tmp_path.iterdir()] == ["out.npz"]
    assert trajectories.load(tmp_path / "out.npz").meta == meta


def test_a_failure_asks_for_the_steps_that_the_warning_before_it_asked_for(cli):
    """What flies apart when it fails would ask for far more."""
    _, told = cli("run", "flag", "--columns", 11, "--dt", 0.016667, "--headless", check=3)
    warned, failed = re.findall(r"use --substeps (\d+)", told)
    assert warned == failed


def test_quiet_prints_nothing(cli):
    assert cli("run", "oscillator", "--headless", "--frames", 1, "--quiet") == ("", "")


def test_scene_parameters_and_files_run(cli, tmp_path):
    out, _ = cli("run", "cloth", "--columns", 3, "--rows=2", *ON_GRAPH, "--frames", 1)
    assert out.startswith("cloth: 6 particles, 7 springs")
    (tmp_path / "drop.toml").write_text(
        "[world]\nsize = [10, 10]\n[[particles]]\nposition = [1, 1]"
    )
    out, _ = cli("run", "drop.toml", "--headless", "--frames", 1, cwd=tmp_path)
    assert out.startswith("drop: 1 particle, 0 springs")


@pytest.mark.parametrize(
    ("flags", "path"),
    [
        (("--threads", 1), "serial"),
        (("--threads", 2), "serial"),  # at most two, where that pays
        (("--threads", 2, "--execution", "parallel"), "parallel"),
        (("--execution", "parallel"), "parallel"),
    ],
)
def test_threads_choose_the_execution_path(cli, flags, path):
    out, _ = cli("run", "oscillator", "--headless", "--frames", 1, *flags)
    assert f", {path} graph;" in out


def test_a_recorded_log_replays_to_the_same_bits(cli, tmp_path):
    common = [*ON_GRAPH, "--frames", 120, "--quiet"]
    first = ["--events", GOLDEN / "cloth_blow.jsonl", "--record", "b.jsonl", "--save", "a.npz"]
    cli("run", *common, *first, cwd=tmp_path)
    cli("run", *common, "--events", "b.jsonl", "--save", "b.npz", cwd=tmp_path)
    a, b = np.load(tmp_path / "a.npz"), np.load(tmp_path / "b.npz")
    for name in a.files:
        np.testing.assert_array_equal(a[name], b[name])
    assert not a["spring_alive"][-1].all(), "the log should tear springs"


def test_a_replay_says_what_of_its_log_was_refused(cli, tmp_path):
    """Which is left out; all else is done, and that is no error."""
    log, saved = tmp_path / "log.jsonl", tmp_path / "run.npz"
    cut = {"frame": 1, "event": "cut", "springs": [0]}
    wrong = {"frame": 2, "event": "set", "name": "gravty.y", "value": 0.5}
    more = [{"frame": 3, "event": "cut", "springs": [10**6]}, {"frame": 3, "event": "let_go"}]
    about = "'set' in frame 2: set: 'cloth' has no setting 'gravty.y'; did you mean 'gravity.y'?"
    for events, says in (
        ([cut], ""),
        ([cut, wrong], f"taichi-cloth: note: 1 event of the log was refused: {about}\n"),
        (
            [cut, wrong, *more],
            f"taichi-cloth: note: 2 events of the log were refused: the first, {about}\n",
        ),
    ):
        log.write_text("".join(json.dumps(event) + "\n" for event in events))
        words = ("run", *ON_GRAPH, "--frames", 5, "--events", log, "--save", saved)
        _, said = cli(*words)
        assert "".join(line for line in said.splitlines(True) if "compiling" not in line) == says
        assert np.flatnonzero(~np.load(saved)["spring_alive"][-1]).tolist() == [0]
        assert "refused" not in cli(*words, "--quiet")[1]


def test_a_replay_that_ends_before_its_log_says_so(cli, tmp_path):
    """Without a window, where it was not told how many frames to make."""
    log = tmp_path / "log.jsonl"
    words = ("run", "oscillator", *ON_GRAPH, "--events", log)
    for frame, given, says in (
        (600, (), "note: the log goes on beyond these 600 frames; --frames 601 makes all"),
        (599, (), ""),
        (600, ("--frames", 2), ""),
    ):
        log.write_text(json.dumps({"frame": frame, "event": "press", "key": "g"}) + "\n")
        _, said = cli(*words, *given)
        assert says in said and ("goes on" in said) == bool(says)


@pytest.mark.parametrize(("frames", "says"), [(3, "the first that --every 5 keeps"), (5, "")])
def test_a_run_that_keeps_no_frame_says_so(cli, tmp_path, frames, says):
    """A folder of an export is not even made."""
    words = ("run", "oscillator", *ON_GRAPH, "--frames", frames, "--every", 5, "--export")
    _, said = cli(*words, tmp_path / "frames")
    assert says in said and ("nothing is saved" in said) == bool(says)


def test_what_a_window_saves_and_what_not_is_said_of_each_flag(tmp_path, capsys):
    """That r makes files begin anew, and that none of their frames came before the end."""
    trajectory = trajectories.Trajectory(tmp_path / "a.npz")
    export = Export(tmp_path / "b.npz", 1.0)
    for recordings, says in (
        (Recordings(trajectory, None), "--save begins"),
        (Recordings(trajectory, export), "--save and --export begin"),
    ):
        run_notes.note_reset(recordings, SimpleNamespace(visible=True))
        run_notes.note_empty(recordings, 1)
        said = capsys.readouterr()
        assert said.out == f"r goes back to the start, and {says} anew there\n"
        assert said.err.endswith("this run's frames: it ended before the first\n")
    export._noted.append((1, 0))
    run_notes.note_empty(recordings, 1)
    assert not capsys.readouterr().err
    assert (tmp_path / "frames").exists() == (not says)


def test_a_run_says_once_that_it_compiles(capsys):
    """Whichever of two beside each other does first."""
    tell = run_notes.compiling(library.build("cloth"), RunOptions())
    tell()
    tell()
    assert capsys.readouterr().err.count("compiling kernels") == 1
    assert run_notes.compiling(library.build("cloth"), RunOptions(quiet=True)) is None


def test_a_replay_follows_the_recorded_solver(cli, tmp_path):
    """Where its method takes the setting; logs of before, which do not say it, have the default."""
    own = ("cloth", "--columns", 6, "--rows", 4, "--headless", "--frames", 8, "--topology", "graph")
    log, saved = tmp_path / "log.jsonl", [tmp_path / f"{name}.npz" for name in "abcd"]
    for given in (("vbd", "--iterations", 2), ("implicit_euler", "--tolerance", 0.03)):
        cli("run", *own, "--method", *given, "--record", log, "--save", saved[0])
        header = json.loads(log.read_text().splitlines()[0])["header"]
        assert header[given[1][2:]] == given[2]
        _, said = cli("run", *own, "--events", log, "--save", saved[1])
        assert said == "" and compare(*saved[:2]).identical
        _, said = cli("run", *own, "--events", log, "--method", "verlet")
        assert "method verlet (recorded: " in said
        del header[given[1][2:]]
        log.write_text(json.dumps({"header": header}))
        cli("run", *own, "--events", log, "--save", saved[2])
        cli("run", *own, "--method", given[0], "--save", saved[3])
        assert compare(*saved[2:]).identical and not compare(saved[0], saved[2]).identical
    for wrong in ('"tolerance": 0', '"iterations": 2.5', '"iterations": 1000001'):
        log.write_text(f'{{"header": {{{wrong}}}}}')
        assert "line 1: " in cli("run", *own, "--events", log, check=2)[1]


def test_a_replay_takes_the_recorded_settings_and_says_where_it_does_not(cli, tmp_path):
    (tmp_path / "log.jsonl").write_text('{"header": {"dt": 0.5, "substeps": 3}}\n')
    arguments = [*ON_GRAPH, "--frames", 1, "--events", "log.jsonl"]
    out, err = cli("run", "cloth", *arguments, cwd=tmp_path)
    assert "dt 0.5, 3 substeps" in out and not err
    out, err = cli("run", "cloth", *arguments, "--dt", 1, cwd=tmp_path)
    assert "dt 1.0 (recorded: 0.5)" in err and "dt 1, 3 substeps" in out


def test_picture_and_film_of_one_run_show_the_same(cli, tmp_path):
    from PIL import Image, ImageSequence

    arguments = [*ON_GRAPH, "--frames", 3, "--image", "a.png", "--video", "a.gif"]
    cli("run", "cloth", *arguments, cwd=tmp_path)
    picture = np.asarray(Image.open(tmp_path / "a.png").convert("RGB"), int)
    *_, last = ImageSequence.Iterator(Image.open(tmp_path / "a.gif"))
    film = np.asarray(last.convert("RGB"), int)
    assert picture.std() > 15
    for color, at_least in (((0, 255, 0), 5000), ((128, 128, 128), 100), ((255, 255, 255), 3000)):
        assert (picture == color).all(axis=2).sum() > at_least, color  # particles, pins, springs
    assert np.abs(picture - film).mean() < 4  # a film has fewer colours


def test_clicked_particles_are_nan_before_they_exist(cli, tmp_path):
    (tmp_path / "log.jsonl").write_text(
        '{"frame": 0, "event": "press", "pos": [100, 100], "button": "left"}\n'
        '{"frame": 2, "event": "press", "key": "space"}\n'
        '{"frame": 2, "event": "press", "pos": [300, 100], "button": "left"}\n'
    )
    arguments = [*ON_GRAPH, "--frames", 4, "--events", "log.jsonl", "--save", "a.npz"]
    cli("run", "sandbox", *arguments, cwd=tmp_path)
    saved = trajectories.load(tmp_path / "a.npz")
    assert saved.position.shape == (4, 2, 2) and saved.spring.tolist() in ([[0, 1]], [[1, 0]])
    assert np.isnan(saved.position[:2, 1]).all() and np.isfinite(saved.position[2:]).all()
    assert np.isnan(saved.velocity[:2, 1]).all()
    assert saved.spring_alive[:, 0].tolist() == [False, False, True, True]


def test_a_failed_simulation_is_status_3_and_keeps_the_last_good_frame(tmp_path):
    arguments = [*ON_GRAPH, "--dt", 30, "--save", "a.npz", "--every", 10]
    _, err = command("run", "cloth", *arguments, cwd=tmp_path, check=3)
    warning, error = err.splitlines()
    assert warning.startswith("taichi-cloth: warning: a step of 30 is above ")
    assert error.startswith("taichi-cloth: error: frame ")
    saved = trajectories.load(tmp_path / "a.npz")
    assert len(saved.frame) == 1 and np.isfinite(saved.position).all()
    assert f"the last good frame, {saved.frame[0]}, is kept" in err


TOO_STIFF = """
[world]
size = [100.0, 100.0]
gravity = [0.0, 0.1]
[spring]
stiffness = 1e30
[[particles]]
position = [50.0, 20.0]
fixed = true
[[particles]]
position = [60.0, 30.0]
[[particles]]
position = [60.0, 40.0]
[[springs]]
between = [0, 1]
[[springs]]
between = [1, 2]
"""


def test_a_run_most_of_whose_steps_did_not_converge_has_failed(cli, tmp_path):
    (tmp_path / "stiff.toml").write_text(TOO_STIFF)
    arguments = ["stiff.toml", *ON_GRAPH, "--method", "implicit_euler", "--frames", 5]
    _, err = cli("run", *arguments, "--save", "a.npz", "--quiet", cwd=tmp_path, check=3)
    assert err.startswith("taichi-cloth: error: 5 of 5 steps of implicit_euler did not converge")
    assert err.count("\n") == 1 and "remedy: use softer springs" in err
    assert "--unconverged accept" in err
    assert trajectories.load(tmp_path / "a.npz").frame.tolist() == [1, 2, 3, 4, 5]  # all of it
    accepted, err = cli("run", *arguments, "--unconverged", "accept", cwd=tmp_path)
    assert "5 frames in" in accepted and err.startswith("taichi-cloth: note: 5 of 5 steps")


def test_a_scene_whose_name_does_not_print_is_announced_in_one_line(cli, tmp_path):
    """Nor does what is in a scene file, from wherever, steer the terminal."""
    (tmp_path / "a.toml").write_text('name = "x\\ny\\u001b[31m"\n[world]\nsize = [9.0, 9.0]\n')
    out, _ = cli("run", "a.toml", "--headless", "--frames", 1, cwd=tmp_path)
    assert out.startswith("x\\ny\\x1b[31m: 0 particles") and out.count("\n") == 2


def test_a_run_few_of_whose_steps_did_not_converge_is_noted(pool, monkeypatch, capsys):
    sim = pool(library.build("oscillator"), "implicit_euler")
    sim.advance(4)
    sim.check_converged()
    assert sim.work().unconverged == 0 and not sim.work().mostly_unconverged
    for unconverged, fails in ((1, False), (2, False), (3, True), (4, True)):
        work = replace(sim.work(), unconverged=unconverged)
        monkeypatch.setattr(sim, "work", lambda work=work: work)
        for options in (RunOptions(), RunOptions(unconverged="accept")):
            if fails and options.unconverged == "fail":
                with pytest.raises(RunFailure, match=f"{unconverged} of 4 steps"):
                    run_notes.check_converged(sim, options)
            else:
                run_notes.check_converged(sim, options)
                assert f"note: {unconverged} of 4 steps" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("faces", "pairs", "near", "thick", "says"),
    [
        (0, 0, 0, True, []),
        (3, 0, 0, False, ["3 of 9 steps ended with faces or edges of a cloth inside an obstacle"]),
        (0, 2, 0, False, ["2 of 9 steps ended with pairs that overlap by more than a hundredth"]),
        (0, 2, 0, True, ["2 of 9 steps ended with pairs that overlap by more than a tenth"]),
        (0, 0, 1, True, ["1 pair of particles ended so near that triangles of cloth might"]),
        (1, 9, 7, True, ["1 of 9 steps", "9 of 9 steps", "7 pairs of particles ended"]),
    ],
)
def test_what_was_given_up_is_noted(faces, pairs, near, thick, says, capsys):
    scene = SimpleNamespace(features=lambda: SimpleNamespace(thick=thick))
    counts = {"unsettled_faces": faces, "unsettled": pairs, "uncertified": near, "unguarded": 0}
    of = {name: lambda count=count: count for name, count in counts.items()}
    run_notes.note_unsettled(SimpleNamespace(scene=scene, steps=9, **of))
    lines = " ".join(capsys.readouterr().err.split()).split("taichi-cloth: note: ")[1:]
    assert len(lines) == len(says)
    assert all(line.startswith(words) for line, words in zip(lines, says, strict=True)), lines


def let_work(process, seconds):
    """Wait until a process has had the processor for so long, however busy the machine is."""

    def worked():
        numbers = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(numbers[11]) + int(numbers[12])) / os.sysconf("SC_CLK_TCK")

    if not Path("/proc/self/stat").exists():
        time.sleep(seconds)
        return
    begin = worked()
    while process.poll() is None and worked() < begin + seconds:
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("number", "status"),
    [(signal.SIGINT, 130), as_thorough((signal.SIGTERM, 143)), as_thorough((signal.SIGHUP, 129))],
)
def test_an_interrupted_run_keeps_its_files(tmp_path, number, status):
    process = subprocess.Popen(
        [*PROGRAM, "run", "oscillator", *ON_GRAPH, "--frames", str(10**9), "--every", "10"]
        + ["--save", str(tmp_path / "a.npz"), "--record", str(tmp_path / "a.jsonl")]
        + ["--report", str(tmp_path / "a.html")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path / "ti")},
        # What runs the tests in the background, or beyond a terminal's end, has signals ignored.
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    )
    try:
        assert process.stdout.readline().startswith("oscillator")
        let_work(process, 2.5)  # the first frames are compiled and run
        process.send_signal(number)
        told, error = process.communicate(timeout=60)
    finally:
        process.kill()  # one that did not hear would run on, and take a core from all tests to come
    assert process.returncode == status and after_start(error) == "taichi-cloth: interrupted\n"
    assert trajectories.load(tmp_path / "a.npz").frame[0] == 10
    assert json.loads((tmp_path / "a.jsonl").read_text())["header"]["scene"] == "oscillator"
    assert f"report: {tmp_path / 'a.html'}\n" in told
    assert "oscillator" in (tmp_path / "a.html").read_text()
    assert sorted(p.name for p in tmp_path.glob("a.*")) == ["a.html", "a.jsonl", "a.npz"]


@pytest.mark.skipif(os.name == "nt", reason="sends itself POSIX signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    "meets",
    [
        "exec('signal.raise_signal(number)')",  # as in the standard library's named tuples
        "try: signal.raise_signal(number)\n"
        "    except BaseException as e: raise ImportError('initialization failed') from e",
    ],
)
def test_an_interrupt_of_what_is_being_imported_is_one(tmp_path, number, meets):
    """Python ended by SIGINT after the first; of the second, NumPy's, there was a traceback."""
    (tmp_path / "interrupted.py").write_text(
        "import signal, sys\n"
        "from taichi_cloth.cli import listing, main\n"
        f"def interrupted(number={int(number)}):\n"
        f"    {meets}\n"
        "listing.main = interrupted\n"
        "sys.exit(main.main(['list']))\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "interrupted"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, sys.path)])},
        capture_output=True,
        text=True,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    )
    assert (done.returncode, done.stderr) == (128 + number, "taichi-cloth: interrupted\n")


@pytest.mark.thorough
@pytest.mark.parametrize("full", ["save", "record", "image", "video"])
def test_a_full_disk_ends_in_one_line_and_spoils_no_other_file(tmp_path, full):
    names = {"save": "a.npz", "record": "a.jsonl", "image": "a.png", "video": "a.gif"}
    if full in ("image", "video"):  # whose names must say what they are
        (tmp_path / names[full]).symlink_to("/dev/full")
    paths = {name: "/dev/full" if name == full else tmp_path / file for name, file in names.items()}
    if full in ("image", "video"):
        paths[full] = tmp_path / names[full]
    words = [word for name, path in paths.items() for word in (f"--{name}", path)]
    _, error = command("run", "oscillator", *ON_GRAPH, "--frames", 5, "--headless", *words, check=2)
    assert error.count("\n") == 1 and "No space left" in error
    left = {path.name for path in tmp_path.iterdir() if not path.is_symlink()}
    assert left == set(names.values()) - {names[full]}


needs_full_device = pytest.mark.skipif(
    not os.path.exists("/dev/full"), reason="there is no /dev/full here"
)


def full_disk(tmp_path, request):
    """A folder on a disk that is full; where none can be made, a device that always is."""
    small = tmp_path / "small"
    small.mkdir()
    if os.name == "nt" or os.geteuid() != 0:
        return Path("/dev/full")
    mount = ["mount", "-t", "tmpfs", "-o", "size=4k", "tmpfs", str(small)]
    if subprocess.run(mount, capture_output=True).returncode:
        return Path("/dev/full")
    request.addfinalizer(lambda: subprocess.run(["umount", str(small)], check=True))
    (small / "filler").write_bytes(bytes(4096))
    return small


@pytest.mark.parametrize(
    "full", ["export", *map(as_thorough, ["save", "checkpoint", "record", "image", "video"])]
)
def test_where_one_disk_fills_the_other_files_are_whole(tmp_path, full, request):
    """Whenever it does, as a frame is written or at the end; and end at one frame."""
    small = full_disk(tmp_path, request)
    names = {"save": "a.npz", "export": "out", "checkpoint": "a.checkpoint.npz"}
    names |= {"record": "a.jsonl", "image": "a.png", "video": "a.gif"}
    folder = tmp_path / "files"
    folder.mkdir()
    paths = {name: folder / file for name, file in names.items()}
    paths[full] = small / names[full]
    if not small.is_dir():  # whose name has to say what it is
        kind = {"export": ".npz", "image": ".png", "video": ".gif"}.get(full, "")
        paths[full] = tmp_path / f"full{kind}"
        paths[full].symlink_to(small)
    words = [word for name, path in paths.items() for word in (f"--{name}", path)]
    _, error = command("run", "cloth", *ON_GRAPH, "--frames", 5, "--headless", *words, check=2)
    assert error.count("\n") == 1 and "No space left" in error
    assert {path.name for path in folder.iterdir()} == set(names.values()) - {names[full]}
    last = [max(trajectories.load(paths["save"]).frame)] if full != "save" else []
    last += [Checkpoint.load(paths["checkpoint"]).frame] if full != "checkpoint" else []
    last += [len(list(paths["export"].iterdir()))] if full != "export" else []
    assert len(set(last)) == 1 and last[0] >= 1


@needs_full_device
def test_where_two_disks_are_full_both_are_told(tmp_path):
    written = tmp_path / "a.checkpoint.npz"
    words = ["--save", "/dev/full", "--record", "/dev/full", "--checkpoint", written]
    _, error = command("run", "oscillator", *ON_GRAPH, "--frames", 5, "--headless", *words, check=2)
    assert error.count("No space left") == error.count("\n") == 2
    assert Checkpoint.load(written).frame == 5


def test_a_file_whose_folder_is_removed_is_not_said_to_be_in_it(tmp_path):
    folder = tmp_path / "gone"
    folder.mkdir()
    file = PendingFile(folder / "a.npz")
    file.write(b"all of it")
    shutil.rmtree(folder)
    with pytest.raises(InputError) as error:
        file.commit()
    assert str(error.value) == f"{folder / 'a.npz'}: cannot be written: No such file or directory"


@pytest.mark.parametrize("words", [["run", "oscillator", "--headless", "--frames", "1"], ["list"]])
def test_a_reader_that_leaves_is_no_error(words):
    process = subprocess.Popen(
        [*PROGRAM, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    process.stdout.close()
    assert after_start(process.stderr.read()) == "" and process.wait() == 141


@pytest.mark.skipif(os.name == "nt", reason="closes streams by a POSIX shell")
@pytest.mark.parametrize("streams", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_streams_that_are_closed_from_the_start_are_no_error(tmp_path, streams):
    """Nor does a file that the run writes get what it prints: it would have their number."""
    words = ["run", "oscillator", *ON_GRAPH, "--frames", "3", "--save", "a.npz"]
    for arguments in (["--version"], ["run", "--help"], words):
        line = f"{shlex.join([*PROGRAM, *arguments])} {streams}"
        done = subprocess.run(["sh", "-c", line], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0 and "Traceback" not in done.stderr
    assert len(trajectories.load(tmp_path / "a.npz").frame) == 3
    line = f"{shlex.join([*PROGRAM, 'run', '--frames', '0'])} {streams}"
    assert subprocess.run(["sh", "-c", line], capture_output=True).returncode == 2


@pytest.mark.skipif(os.name == "nt", reason="homes of a POSIX system")
@pytest.mark.parametrize("home", [None, f"{os.devnull}/home"])
def test_a_home_that_is_none_is_no_error(tmp_path, home):
    """Taichi makes a folder there: it ended the process where it could not, or knew of no home."""
    away = ("HOME", "XDG_CACHE_HOME", "TI_OFFLINE_CACHE_FILE_PATH")
    env = {name: value for name, value in os.environ.items() if name not in away}
    env |= {"TMPDIR": str(tmp_path), **({"HOME": home} if home else {})}
    words = ["run", "oscillator", *ON_GRAPH, "--frames", "2", "--headless"]
    done = subprocess.run([*PROGRAM, *words], env=env, capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.splitlines()[1].startswith("2 frames")
    assert after_start(done.stderr) == "" and list(tmp_path.iterdir()) == []
    assert not home or "there is no cache to keep them" in done.stderr


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits as Linux has them")
@pytest.mark.parametrize(
    ("most", "words", "says"),
    [
        (10**9, ["oscillator"], "Taichi cannot start: Virtual memory allocation"),
        (2 * 10**9, ["net", "--side", "2048"], "there is not enough memory (Unable to allocate"),
    ],
)
def test_memory_that_the_system_refuses_ends_in_one_line(most, words, says):
    import resource

    done = subprocess.run(
        [*PROGRAM, "run", *words, "--headless", "--frames", "1"],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (most, most)),
    )
    assert (done.returncode, done.stdout.strip()) == (3, "")
    assert says in done.stderr and done.stderr.strip().count("\n") == 0


@pytest.mark.skipif(os.name == "nt", reason="removes a folder that is in use")
def test_a_current_folder_that_was_removed_is_named(tmp_path):
    line = f"mkdir gone; cd gone; rmdir ../gone; {shlex.join([*PROGRAM, 'run', '--headless'])}"
    done = subprocess.run(["sh", "-c", line], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 3 and "error: the current folder, which was removed" in done.stderr


@needs_full_device
def test_an_error_that_cannot_be_told_has_its_status():
    """Python tries once more at exit what it has not written, and ended with 120 then."""
    buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    with open("/dev/full", "w") as full:
        done = subprocess.run([*PROGRAM, "--version"], stdout=full, stderr=full, env=buffered)
        assert done.returncode == 3
        note = "from taichi_cloth.cli import listing, main, run_notes\nimport sys\n"
        note += "listing.main = lambda: run_notes.say('it takes a while') or 0\n"
        note += "sys.exit(main.main(['list']))"
        done = subprocess.run([sys.executable, "-c", note], stderr=full, env=buffered)
        assert done.returncode == 0


def test_an_unusable_backend_is_refused_with_those_that_are(tmp_path):
    arch = "metal" if sys.platform != "darwin" else "cuda"
    out, error = command("run", "--arch", arch, "--headless", "--save", tmp_path / "x", check=2)
    assert out == "" and list(tmp_path.iterdir()) == []
    assert f"--arch {arch}" in error and "usable: cpu" in error and error.count("\n") == 1


class FakeSimulation:
    """As much of a simulation as a trajectory reads."""

    class scene:
        class world:
            dim = 2

        class particles:
            position, fixed = np.zeros((1, 2)), np.zeros(1, bool)

    def __init__(self):
        self.frame, self.n, self.pairs = 0, 1, []

    time = property(lambda self: 0.5 * self.frame)
    particle_count = property(lambda self: self.n)

    def positions(self):
        return np.full((self.n, 2), float(self.frame))

    def velocities(self):
        return -self.positions()

    def springs(self):
        return np.array(self.pairs, np.int64).reshape(-1, 2)

    def springs_alive(self):
        return np.ones(len(self.pairs), bool)


def test_a_reset_starts_the_trajectory_again(tmp_path):
    sim, trajectory = FakeSimulation(), trajectories.Trajectory(tmp_path / "a.npz", every=2)
    for frame in (1, 2, 3, 4, 4, 1, 2):
        sim.frame = frame
        trajectory.record(sim)
    trajectory.save({"scene": "x"})
    trajectory.save({"scene": "y"})
    saved = trajectories.load(tmp_path / "a.npz")
    assert saved.frame.tolist() == [2] and saved.meta == {"scene": "x"}


def test_a_trajectory_without_frames_is_a_file_all_the_same(tmp_path):
    trajectory = trajectories.Trajectory(tmp_path / "a.npz")
    trajectory.record(FakeSimulation())
    trajectory.save()
    assert trajectories.load(tmp_path / "a.npz").position.shape == (0, 1, 2)


@pytest.mark.skipif(not os.path.exists("/dev/fd"), reason="there is no /dev/fd here")
def test_a_pipe_is_written_through_by_its_number(tmp_path):
    """As a shell's `>(gzip > a.gz)` names it: the link's own target is no path."""
    out, into = os.pipe()
    with open(out, "rb") as reader:
        write_whole(f"/dev/fd/{into}", b"all of it")
        os.close(into)
        assert reader.read() == b"all of it"


def test_a_link_and_a_device_are_written_through(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "target")
    trajectories.Trajectory(tmp_path / "link").save()
    assert (tmp_path / "link").is_symlink() and trajectories.load(tmp_path / "target")
    if os.path.exists(os.devnull) and os.name == "posix":
        trajectories.Trajectory(os.devnull).save()
        assert not os.path.isfile(os.devnull)


@pytest.mark.skipif(os.name == "nt", reason="links and permissions of a POSIX system")
def test_a_file_that_is_replaced_keeps_its_permissions(tmp_path):
    write_whole(tmp_path / "own", b"before")
    (tmp_path / "own").chmod(0o600)
    write_whole(tmp_path / "own", b"after")
    assert (tmp_path / "own").read_bytes() == b"after"
    assert (tmp_path / "own").stat().st_mode & 0o777 == 0o600


def test_what_cannot_get_its_name_at_the_end_is_kept(tmp_path):
    """As where the file is one of a container's mounts: it was lost with the run that made it."""
    pending = PendingFile(tmp_path / "a")
    pending.write(b"all of it")
    (tmp_path / "a").mkdir()
    with pytest.raises(InputError, match="a: cannot be written: .*; all of it is in ") as refused:
        pending.commit()
    pending.discard()
    kept = Path(str(refused.value).rpartition(" in ")[2])
    assert kept.parent == tmp_path and kept.read_bytes() == b"all of it"


@pytest.mark.skipif(os.name == "nt", reason="links of a POSIX system")
def test_what_cannot_be_written_is_said_of_the_file_that_a_link_names(tmp_path):
    (tmp_path / "link").symlink_to("lacking/a")
    with pytest.raises(InputError, match=rf"link: .* no folder '{tmp_path / 'lacking'}'"):
        PendingFile(tmp_path / "link")


def test_a_name_that_is_none_is_refused():
    with pytest.raises(InputError, match="a.x00: cannot be written: .*embedded null"):
        PendingFile("a\0")
    if Path("/proc/self").exists():
        with pytest.raises(InputError, match="^/proc/a: cannot be written: No such file"):
            PendingFile("/proc/a")


def test_a_name_that_the_system_refuses_is_refused(cli):
    """As in a folder that the user may not look into, it was status 3, of no word of writing."""
    out, err = cli("run", "oscillator", "--headless", "--save", "a" * 300, check=2)
    assert out == "" and "aaa: cannot be written: " in err
