"""What a user gets wrong: one line that says what, where and what to do; status 2; no file left.

Cases run `cli.main` in this process: they are refused before Taichi starts.
"""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from taichi_cloth.advice import trade as trade_command
from taichi_cloth.advice import tune
from taichi_cloth.cli import run_files
from taichi_cloth.cli.main import main
from taichi_cloth.errors import InputError, RunFailure
from taichi_cloth.files.events import Recorder
from taichi_cloth.files.recordings import Recordings
from taichi_cloth.limits.precision import refuse_unholdable, unresolved
from taichi_cloth.scene import assignments, library, scenefile
from taichi_cloth.scene.checks import validate
from taichi_cloth.scene.cloth import grid
from taichi_cloth.scene.model import Particles, Scene, SpringDefaults, Springs, World
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.simulation.diagnostics import acceleration_at_start
from taichi_cloth.stability import command as stability_command

COMMAND_LINES = [
    # (arguments, what the line must say)
    ("clth", "did you mean 'taichi-cloth run cloth'?"),
    ("cloth", "did you mean 'taichi-cloth run cloth'?"),
    ("lst", "did you mean 'list'?"),
    ("zzzzzz", "known: run, list, doctor"),
    ("list x", "unexpected 'x'"),
    ("run clth", "did you mean 'cloth'?"),
    ("run cloth box", "unexpected 'box'"),
    ("run --framse 3", "did you mean '--frames'?"),
    ("run --frames", "--frames needs a value"),
    ("run --frames= --quiet", "--frames needs a value"),
    ("run --frames --quiet", "--frames needs a value"),
    ("run --frames 0", "--frames must be at least 1, is 0"),
    ("run --frames -5", "--frames must be at least 1, is -5"),
    ("run --frames 2.5", "--frames must be a whole number"),
    ("run --every 0", "--every must be at least 1, is 0"),
    ("run --substeps 0", "--substeps must be at least 1, is 0"),
    ("run --threads 0", "--threads must be at least 1, is 0"),
    ("run --dt 0", "--dt must be positive"),
    ("run --dt -1e-3", "--dt must be positive"),
    ("run --dt nan", "--dt must be a finite number"),
    ("run --dt -inf", "--dt must be a finite number"),
    ("run --dt soon", "--dt must be a number"),
    ("run --seed -1", "--seed must be at least 0"),
    ("run --method symplectic_eular", "did you mean 'symplectic_euler'?"),
    ("run --arch vulcan", "did you mean 'vulkan'?"),
    ("run --precision f16", "--precision: unknown value 'f16'"),
    ("run --execution serail", "did you mean 'serial'?"),
    ("run --topology lanse", "did you mean 'lanes'?"),
    ("run --view guii", "did you mean 'gui'?"),
    ("run --size 800", "such as 800x600"),
    ("run --size 800x0", "16 to 8192"),
    ("run --headless=yes", "--headless takes no value"),
    ("run --headless --view gui", "exclude each other"),
    ("run --arch vulkan --threads 2", "only --arch cpu"),
    ("run box --columns 3", "scene 'box' does not take it"),
    ("run flag --set stencils=[]", "--set stencils: a built-in scene has no entries by number"),
    ("run flag --set triangles=[]", "--set triangles: a built-in scene has no entries by number"),
    ("run cloth --columns 0", "--columns must be at least 1"),
    ("run cloth --spacing nan", "--spacing must be a finite number"),
    ("run chain --mode 17", "mode must be at most"),
    ("run box --particles 20000", "do not fit into the world"),
    ("run missing.toml", "there is no such file"),
    ("trade oscillator --output fine.toml", "fine.toml: cannot be made: it is a file"),
    ("run here/", "there is no such file"),
    ("run .", "is a folder"),
    ("run binary.toml", "is not a text file in UTF-8"),
    ("run broken.toml", "broken.toml line 2: is not TOML"),
    ("run other.fbx", "; a mesh is read from a file that ends in .obj, .ply, .stl, .glb"),
    ("run fine.toml --columns 3", "change the value in fine.toml"),
    ("run --events missing.jsonl", "there is no such file"),
    ("run --events broken.toml", "broken.toml line 1: is not JSON"),
    ("run --events old.jsonl", "old.jsonl line 1: --method: unknown method 'rk5'"),
    ("compare fine.toml .", "fine.toml: is no saved trajectory: it is no .npz archive"),
    ("compare . fine.toml", ".: is a folder; name the saved trajectory in it"),
    ("run --resume fine.toml", "fine.toml: is no checkpoint: it is no .npz archive"),
    ("run --save missing/x.npz", "there is no folder 'missing'"),
    ("run --save .", "is a folder"),
    ("run --record missing/x.jsonl", "there is no folder 'missing'"),
    ("run --image missing/x.png", "there is no folder 'missing'"),
    ("run --video missing/x.mp4", "there is no folder 'missing'"),
    ("run --image x.jpg", "must end in .png"),
    ("run --pictures missing", "--pictures missing: there is no such folder; make it first"),
    ("run --video x.avi", "must end in .mp4 or .gif"),
    ("run --save x.npz --record ./x.npz", "would write the same file"),
    ("run --save x.npz --report x.npz", "--save and --report would write the same file"),
    ("run --save x.npz --export x-beside.npz --beside substeps=2", "--save of --beside would"),
    ("run fine.toml --record fine.toml", "--record fine.toml: would overwrite the scene"),
    ("run --events fine.toml --save ./fine.toml", "would overwrite --events"),
    ("run --resume fine.toml --save fine.toml", "would overwrite --resume"),
    (
        "run --resume x-beside.npz --save x.npz --beside substeps=2",
        "--save of --beside x-beside.npz: would overwrite --resume",
    ),
    ("run --save x.npz --record y.jsonl --image missing/x.png", "there is no folder"),
]


@pytest.mark.parametrize(("arguments", "says"), COMMAND_LINES)
def test_command_lines(arguments, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "other.fbx").write_bytes(b"Kaydara FBX Binary  \0\x1a\0")
    (tmp_path / "broken.toml").write_text("[world]\nsize =")
    (tmp_path / "fine.toml").write_text("[world]\nsize = [10, 10]")
    (tmp_path / "old.jsonl").write_text('{"header": {"method": "rk5"}}')
    before = sorted(tmp_path.iterdir())
    assert main(arguments.split()) == 2
    out, error = capsys.readouterr()
    assert out == "" and error.startswith("taichi-cloth: error: ")
    assert error.count("\n") == 1 and says in error
    assert sorted(tmp_path.iterdir()) == before


def test_a_resumed_run_that_is_refused_leaves_no_file(tmp_path):
    recorder, none = Recorder(tmp_path / "a.jsonl"), Recordings(None, None)
    files = run_files.RunFiles(recorder, none, None, none)
    resumed = SimpleNamespace(frame=30, scene=None)
    with pytest.raises(InputError), run_files.kept(None, resumed, None, files):
        raise InputError("a budget that it cannot have")
    recorder.discard()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("../../evil/x", "evil-x"),
        ("a\nb\0c", "a-b-c"),
        ("tücher 2.0", "tücher-2.0"),
        ("布" * 300, "布" * 33),
        ("../..", "scene"),
    ],
    ids=["another folder", "no line", "letters", "long", "nothing left"],
)
def test_a_scene_s_name_leads_to_no_other_folder(name, part, tmp_path, monkeypatch, capsys):
    """Whatever a scene file is called by, results are in the folder where the command is given."""
    monkeypatch.chdir(tmp_path)
    scene = replace(library.build("oscillator"), name=name)
    (tmp_path / "scene.toml").write_text(scenefile.dump(scene))
    seen = []

    def refused(folder, names):
        seen.append(str(folder))
        raise InputError("enough")

    for module in (stability_command, trade_command, tune):
        monkeypatch.setattr(module, "folder_of_results", refused)
    for command in ("stability", "trade", "tune --error 1%"):
        assert main([*command.split(), "scene.toml"]) == 2
    assert seen == [f"stability-{part}", f"trade-{part}", f"tune-{part}"]


def test_a_run_that_fails_where_a_disk_is_full_says_both(capsys):
    full, none = Recorder("/dev/full", {"of": "something"}), Recordings(None, None)
    files = run_files.RunFiles(full, none, None, none)
    with (
        pytest.raises(RunFailure),
        run_files.kept(None, SimpleNamespace(frame=30, scene=None), None, files),
    ):
        raise RunFailure("particle 3 runs away")
    assert "/dev/full: cannot be written" in capsys.readouterr().err


SCENE = """\
[world]
size = [100.0, 100.0]
gravity = [0.0, 1.0]
dt = 1.0
walls = ["top"]
mouse = "blow"
[particle]
mass = 1.0
radius = 2.0
restitution = 0.5
[spring]
stiffness = 1.0
[[particles]]
position = [10.0, 10.0]
[[particles]]
position = [20.0, 10.0]
velocity = [0.0, 0.0]
[[springs]]
between = [0, 1]
[[cloths]]
origin = [30.0, 30.0]
columns = 3
rows = 2
spacing = 5.0
pinned = [[0, 0]]
links = ["structural"]
"""
EDITS = [
    # (line replaced, new line, what the message says after the line number)
    (2, "size = [100.0]", "[world]: size must be 2 or 3 lengths"),
    (2, "size = [100.0, -1.0]", "[world]: size must be positive, is -1"),
    (2, "size = 5", "[world]: size must be a list of numbers"),
    (2, "siez = [100.0, 100.0]", "[world]: unknown key 'siez'; did you mean 'size'?"),
    (3, "gravity = [0.0, 0.0, 1.0]", "[world]: gravity must have 2 numbers"),
    (3, "gravity = [0.0, nan]", "[world]: gravity must be finite"),
    (4, "dt = 0.0", "[world]: dt must be positive, is 0"),
    (4, "dt = -inf", "[world]: dt must be a finite number"),
    (4, "dt = true", "[world]: dt must be a number, is true"),
    (5, 'walls = ["tpo"]', "[world]: unknown wall 'tpo'; did you mean 'top'?"),
    (5, 'walls = ["front"]', "[world]: a 2-D world has no front wall"),
    (5, "walls = 3", "[world]: walls must be true, false or a list of names"),
    (6, 'mouse = "blwo"', "[world]: unknown mouse mode 'blwo'; did you mean 'blow'?"),
    (7, "[particel]", "unknown key 'particel'; did you mean 'particle'?"),
    (8, "mass = 0", "[particle]: mass must be positive, is 0"),
    (8, "mass = nan", "[particle]: mass must be a finite number, is nan"),
    (8, 'mass = "heavy"', "[particle]: mass must be a number, is the text 'heavy'"),
    (9, "radius = -1", "[particle]: radius must not be negative, is -1"),
    (9, "viscous = -0.5", "[particle]: viscous must not be negative"),
    (10, "restitution = 1.5", "[particle]: restitution must be between 0 and 1, is 1.5"),
    (12, "stiffness = -1", "[spring]: stiffness must not be negative"),
    (12, "break_force = 0", "[spring]: break_force must be positive"),
    (12, "break_force = inf", "[spring]: break_force must be finite"),
    (12, "damping = -1", "[spring]: damping must not be negative"),
    (12, 'break_in = "tensoin"', "[spring]: break_in must be 'both' or 'tension', is 'tensoin'"),
    (12, "color = [256, 0, 0]", "[spring]: color must be three whole numbers from 0 to 255"),
    (12, "break_in = true", "[spring]: break_in must be a text in quotes, is true"),
    (12, "rest_length = -1", "[spring]: rest_length must not be negative"),
    (14, "position = [10.0, 900.0]", "[[particles]] 0: position (10, 900) is outside the world"),
    (14, "position = [10.0]", "[[particles]] 0: position must have 2 numbers"),
    (16, "position = [inf, 0]", "[[particles]] 1: position must be finite"),
    (17, "mass = -2", "[[particles]] 1: mass must be positive, is -2"),
    (17, "fixed = 1", "[[particles]] 1: fixed must be true or false"),
    (17, "color = [0, 0, 256]", "[[particles]] 1: color must be three whole numbers"),
    (17, "restitution = -0.1", "[[particles]] 1: restitution must be between 0 and 1"),
    (19, "between = [0, 8]", "[[springs]] 0: there is no particle 8; the scene's are 0 to 7"),
    (19, "between = [-1, 0]", "[[springs]] 0: there is no particle -1"),
    (19, "between = [1, 1]", "[[springs]] 0: it ties particle 1 to itself"),
    (19, "between = [2, 3]", "[[cloths]] 0: it ties particles 2 and 3, as spring 0 already does"),
    (19, "between = [0, 1, 2]", "[[springs]] 0: between must be a list of two whole numbers"),
    (21, "origin = [95.0, 30.0]", "[[cloths]] 0 particle 2: position (105, 30) is outside"),
    (22, "columns = 0", "[[cloths]] 0: columns and rows must be at least 1"),
    (22, "columns = 100000000", "[[cloths]] 0: 100000000 columns x 2 rows"),
    (24, "spacing = 0", "[[cloths]] 0: spacing must be positive"),
    (24, "spacing = nan", "[[cloths]] 0: spacing must be finite, is nan"),
    (25, "pinned = [[3, 0]]", "[[cloths]] 0: pinned [3, 0] is outside the grid"),
    (25, "pinned = [[0, -1]]", "[[cloths]] 0: pinned [0, -1] is outside the grid"),
    (25, "pinned = [0, 0]", "[[cloths]] 0: pinned must be a list of [column, row] pairs"),
    (26, 'links = ["bned"]', "[[cloths]] 0: links: unknown kind 'bned'; did you mean 'bend'?"),
    (26, "stiffness = { shear = 1 }", "[[cloths]] 0: stiffness: this cloth has no shear links"),
    (26, "stiffness = { strucural = 1 }", "[[cloths]] 0: unknown kind 'strucural'; did you mean"),
    (26, "damping = { structural = -1 }", "[[cloths]] 0: damping of structural links must be"),
    (26, "bending = inf", "[[cloths]] 0: bending must be finite, is inf"),
    (26, "bending = -1", "[[cloths]] 0: bending must be at least 0, is -1"),
    (26, "across = [0.0, 2.0]", "[[cloths]] 0: across and down must not be parallel"),
    (26, "down = [0.0, 0.0]", "[[cloths]] 0: down must be a finite direction"),
]


def test_the_scene_without_edits_is_accepted():
    assert len(scenefile.parse(SCENE).particles) == 8


@pytest.mark.parametrize(("number", "edit", "says"), EDITS)
def test_scene_files(number, edit, says):
    lines = SCENE.splitlines()
    lines[number - 1] = edit
    with pytest.raises(InputError) as refused:
        scenefile.parse("\n".join(lines))
    message = str(refused.value)
    assert message.startswith("scene.toml line ") and says in message and "\n" not in message
    # The line itself, except where two entries do not fit each other.
    if "already does" not in says:
        shown = int(message.split()[2].rstrip(":"))
        assert shown == number or (number in (2, 21, 22) and shown in (1, 20)), message


def test_a_value_that_came_from_the_defaults_is_blamed_on_them():
    text = SCENE.replace("radius = 2.0", "radius = -2.0")
    with pytest.raises(InputError, match=r"line 9: \[particle\]: radius"):
        scenefile.parse(text)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("world.wind.velocity=[1,0,0]", "world.wind.velocity: wind does nothing without air"),
        ("world.air.drag=1", "world.air.drag: air: 'density' is missing"),
        ("spring.stiffness=-1", "spring.stiffness: stiffness must not be negative"),
    ],
)
def test_an_assignment_that_makes_a_table_is_blamed_for_it(given, says):
    text = "[world]\nsize = [1.0, 1.0, 1.0]\ngravity = [0.0, 1.0, 0.0]\n[spring]\nstiffness = 2.0\n"
    with pytest.raises(InputError, match=re.escape(f"--set {says}")):
        scenefile.parse(text, assignments=[assignments.read(given)])


def test_duplicate_springs_are_found_in_both_directions():
    for pair in ("[0, 1]", "[1, 0]"):
        with pytest.raises(InputError, match=r"line 28: \[\[springs\]\] 1: it ties particles"):
            scenefile.parse(SCENE + f"[[springs]]\nbetween = {pair}")


def two_particles(**changes) -> Scene:
    position = np.array([[1.0, 1.0], [2.0, 1.0]])
    particles = Particles.build(position)
    springs = Springs.build([(0, 1)], position)
    for name, value in changes.items():
        target = particles if name in vars(particles) else springs
        vars(target)[name] = value  # a frozen dataclass still has a plain dictionary
    return Scene("two", World((10.0, 10.0), (0.0, 0.0)), particles, springs)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"mass": np.array([1.0, 0.0])}, "particle 1: mass must be positive, is 0"),
        ({"mass": np.array([1.0, np.nan])}, "particle 1: mass must be a finite number, is nan"),
        ({"mass": np.array([1.0])}, "particles: mass must have shape (2,), has (1,)"),
        ({"radius": np.array([-1.0, 0.0])}, "particle 0: radius must not be negative, is -1"),
        ({"viscous": np.array([1.0, np.inf])}, "particle 1: viscous must be a finite number"),
        ({"restitution": np.array([1.0, 1.1])}, "particle 1: restitution must be between 0 and 1"),
        ({"velocity": np.array([[0, 0], [0, np.nan]])}, "particle 1: velocity must be finite"),
        ({"position": np.array([[1.0, 1.0], [11.0, 1.0]])}, "particle 1: position (11, 1) is out"),
        ({"position": np.zeros((2, 3))}, "particles: position has 3 numbers a particle in a 2-D"),
        ({"between": np.array([[0, 2]])}, "spring 0: there is no particle 2"),
        ({"between": np.array([[1, 1]])}, "spring 0: it ties particle 1 to itself"),
        ({"stiffness": np.array([-1.0])}, "spring 0: stiffness must not be negative, is -1"),
        ({"rest_length": np.array([np.inf])}, "spring 0: rest_length must be a finite number"),
        ({"break_force": np.array([0.0])}, "spring 0: break_force must be positive, is 0"),
        ({"break_force": np.array([np.nan])}, "spring 0: break_force must be positive, is nan"),
        ({"damping": np.array([-1.0])}, "spring 0: damping must not be negative, is -1"),
        (
            {"break_in": np.array(["push"])},
            "spring 0: break_in must be 'both' or 'tension', is 'p",
        ),
        ({"break_in": np.array([1.0])}, "springs: break_in must be an array of words, is float64"),
    ],
)
def test_scenes_built_by_hand(changes, says):
    with pytest.raises(InputError) as refused:
        validate(two_particles(**changes))
    assert str(refused.value).startswith(says)


AIR = {"density": 1.2}
BREEZE = {"velocity": (1.0, 0.0, 0.0)}


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"size": (1.0,)}, "size must be 2 or 3 lengths, is (1)"),
        ({"size": (1e101, 1.0)}, "size must be from 1e-100 to 1e+100, is 1e+101; use other units"),
        ({"size": (1.0, 1e-101)}, "size must be from 1e-100 to 1e+100, is 1e-101; use other units"),
        ({"gravity": 1.0}, "gravity must be a list of numbers, is 1.0"),
        ({"gravity": (0.0, 1.0, 0.0)}, "gravity must have 2 numbers in a 2-D world, is (0.0, 1.0"),
        ({"gravity": ((0.0,), (1.0,))}, "gravity must have 2 numbers in a 2-D world, is ((0.0,)"),
        ({"gravity": (0.0, np.nan)}, "gravity must be a finite number, is nan"),
        ({"dt": 0.0}, "dt must be positive, is 0"),
        ({"walls": "left"}, "walls must be a list of names, is"),
        ({"walls": (1,)}, "walls: a name is expected, not 1"),
        ({"walls": ("lfet",)}, "unknown wall 'lfet'; did you mean 'left'?"),
        ({"walls": ("front",)}, "a 2-D world has no front wall; known: "),
        ({"collisions": 1}, "collisions must be True or False, is 1"),
        ({"up": 3}, "up: a name is expected, not 3"),
        ({"up": "z"}, "up must be 'y', or absent where y points down, is 'z'"),
        ({"mouse": None}, "mouse: a name is expected, not None"),
        ({"mouse": "blwo"}, "unknown mouse mode 'blwo'; did you mean 'blow'?"),
        ({"ground": np.inf}, "ground must be a finite number, is inf"),
        ({"contact": "restign"}, "unknown contact 'restign'; did you mean 'resting'?"),
        ({"friction": -0.1}, "friction must not be negative, is -0.1"),
        ({"friction": 0.1}, "friction acts on a ground and on resting walls; set contact = 're"),
        ({"more": [1]}, "more must be a mapping of keys to values, is (1,)"),
        ({"more": {"wnid": BREEZE}}, "unknown key 'wnid'; did you mean 'wind'?"),
        ({"more": {"air": AIR}}, "air: a 2-D world has none; give size three lengths"),
        ({"dim": 3, "more": {"wind": BREEZE}}, "wind does nothing without air; give both"),
        ({"dim": 3, "more": {"air": 1.2}}, "air must be a table with density, drag, lift, is 1.2"),
        ({"dim": 3, "more": {"air": {}}}, "air: 'density' is missing"),
        (
            {"dim": 3, "more": {"air": {**AIR, "darg": 1.0}}},
            "air: unknown key 'darg'; did you mean 'drag'?",
        ),
        (
            {"dim": 3, "more": {"air": {"density": -1.0}}},
            "air.density must be at least 0, is -1",
        ),
        (
            {"dim": 3, "more": {"air": AIR, "wind": {"velocity": (1.0, 0.0)}}},
            "wind.velocity must have 3 numbers in a 3-D world, is (1.0, 0.0)",
        ),
        (
            {"dim": 3, "more": {"air": AIR, "wind": {**BREEZE, "seed": 1.5}}},
            "wind.seed must be a whole number, is 1.5",
        ),
    ],
)
def test_worlds_built_by_hand(given, says):
    dim, changes = given.get("dim", 2), {k: v for k, v in given.items() if k != "dim"}
    world = {"size": (10.0,) * dim, "gravity": (0.0,) * dim} | changes
    with pytest.raises(InputError) as refused:
        validate(Scene("by hand", World(**world), Particles.none(dim)))
    assert str(refused.value).startswith(f"world: {says}")


def test_worlds_at_their_limits_are_accepted():
    air = {"air": AIR, "wind": {**BREEZE, "seed": 2.0}}
    for given in (
        {"size": (1e100, 1e-100)},
        {"friction": 0.5, "ground": 1.0},
        {"friction": 0.5, "contact": "resting"},
        {"friction": 0.0, "walls": ("left",)},
        {"size": (1.0, 1.0, 1.0), "gravity": (0.0,) * 3, "walls": ("front",), "more": air},
        {"size": (1.0, 1.0, 1.0), "gravity": (0.0,) * 3, "more": {"air": AIR}},
    ):
        world = World(**{"size": (1.0, 1.0), "gravity": (0.0, 0.0), **given})
        validate(Scene("by hand", world, Particles.none(world.dim)))
    edge = Particles.build([[0.0, 0.0], [10.0, 10.0]], color=[[0, 255, 0], [255, 0, 255]])
    assert validate(replace(two_particles(), particles=edge, spring_color=(0, 255, 7)))


def row_of(*particle, weight=(-2.0, 1.0, 1.0), start=(0, 3)):
    arrays = np.array(start), np.array(particle), np.array(weight), np.ones(len(start) - 1)
    return {"stencils": Stencils(*arrays)}


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"triangles": np.zeros((2, 2), int)}, "triangles: must have shape (m, 3), has (2, 2)"),
        (
            {"triangles": [[0, 1, 2], [0, 3, 1]]},
            "triangle 1: there is no particle 3; the scene has particles 0 to 2",
        ),
        (
            {"triangles": [[0, 1, 2], [-1, 3, 1]]},
            "triangle 1: there is no particle -1; the scene has particles 0 to 2",
        ),
        *(
            (
                {"triangles": [[0, 1, 2], corners]},
                f"triangle 1: two of its corners {tuple(corners)} are one particle; give three",
            )
            for corners in ([0, 0, 1], [1, 0, 0], [0, 1, 0])
        ),
        (
            {"between": [[0, 1], [2, 3]]},
            "spring 1: there is no particle 3; the scene has particles",
        ),
        (
            {"between": [[0, 1], [3, 2]]},
            "spring 1: there is no particle 3; the scene has particles",
        ),
        ({"between": [[-1, 1], [0, 2]]}, "spring 0: there is no particle -1; the scene has par"),
        ({"between": [[0, 1], [2, 2]]}, "spring 1: it ties particle 2 to itself; give two"),
        (
            {"between": [[0, 2], [0, 1], [1, 0]]},
            "spring 2: it ties particles 0 and 1, as spring 1 already does",
        ),
        ({"color": [[0, 0, 0], [0, 0, 256], [1, 1, 1]]}, "particle 1: color must be whole numbers"),
        ({"color": [[0, 0, 0], [1, 1, 1], [0, -1, 0]]}, "particle 2: color must be whole numbers"),
        (row_of(1, 0, 3), "stencil 0: the scene has particles 0 to 2, not all of (1, 0, 3)"),
        (row_of(1, -1, 2), "stencil 0: the scene has particles 0 to 2, not all of (1, -1, 2)"),
        (row_of(1, 0, 1), "stencil 0: a particle is twice in (1, 0, 1)"),
        (
            row_of(1, 0, 2, weight=(-2.0, np.inf, 1.0)),
            "stencil 0: weights must be finite numbers, are (-2, inf, 1)",
        ),
        (
            row_of(1, 0, 2, weight=(-2.0, 1.0, 1.1)),
            "stencil 0: weights must add up to 0, are (-2, 1, 1.1)",
        ),
        (
            row_of(*(1, 0, 2), *(0, 1), weight=(-2.0, 1.0, 1.0, -1.0, 1.0), start=(0, 3, 5)),
            "stencil 1: between must have at least 3 particles",
        ),
    ],
)
def test_what_ties_particles_built_by_hand(given, says):
    x = np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 2.0]])
    scene = Scene("three", World((10.0, 10.0), (0.0, 0.0)), Particles.build(x))
    springs = Springs.build([(0, 1), (0, 2), (1, 2)], x)
    if "between" in given:
        between = np.array(given["between"])
        springs = replace(springs.select(np.arange(len(between))), between=between)
        scene = replace(scene, springs=springs)
    elif "color" in given:
        scene = replace(scene, particles=replace(scene.particles, color=np.array(given["color"])))
    else:
        scene = replace(scene, **given)
    with pytest.raises(InputError) as refused:
        validate(scene)
    assert str(refused.value).startswith(says)


def test_a_sound_scene_is_returned_as_it_is():
    scene = two_particles()
    assert validate(scene) is scene


def test_scene_parameters_are_checked_in_python_too():
    for name, values, says in (
        ("clth", {}, "did you mean 'cloth'?"),
        ("cloth", {"colums": 3}, "did you mean 'columns'?"),
        ("cloth", {"columns": 2.5}, "whole number"),
        ("cloth", {"spacing": float("nan")}, "finite"),
    ):
        with pytest.raises(InputError) as refused:
            library.build(name, **values)
        assert says in str(refused.value)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_scene_that_overflows_is_refused_in_one_line():
    """Without NumPy's lines of where it did."""
    with pytest.raises(InputError, match="size must be a finite number, is inf"):
        SceneSource("cloth", {"spacing": 1e308}).build()


def test_a_cloth_refuses_infinite_spacing():
    with pytest.raises(InputError, match="spacing"):
        grid((0, 0), 2, 2, np.inf, spring_defaults=SpringDefaults())


def two(apart, size, *, v=0.0, mass=1.0, k=0.1):
    """Two particles on a spring of the length `apart`, at the far end of a world."""
    x = np.array([[size - apart, size], [size, size]])
    springs = Springs.build([[0, 1]], x, stiffness=k)
    particles = Particles.build(x, [[v, 0.0], [v, 0.0]], mass=mass, radius=0.0, viscous=0.0)
    return Scene("two", World(size=(size, size), gravity=(0.0, 0.0)), particles, springs)


@pytest.mark.parametrize(
    ("scene", "precision", "says"),
    [
        (two(1e-20, 1e-19), "f32", r"spring 0: length 1e-20 .*use --precision f64 or other units"),
        (two(1e-20, 1e-19), "compensated", "spring 0: length 1e-20 .*--precision f64"),
        (two(1e-160, 1e-159), "f64", "spring 0: length 1e-160 .*; use other units"),
        (two(1e20, 1e21), "f32", "spring 0: length 1e.20 is too large"),
        (two(1.0, 9.0, mass=1e39), "f32", "particle 0: mass 1e.39 is too large"),
        (two(1.0, 9.0, k=1e-39), "f32", "spring 0: stiffness 1e-39 is too small"),
    ],
)
def test_what_a_precision_cannot_hold_is_refused(scene, precision, says):
    with pytest.raises(InputError, match=says):
        refuse_unholdable(scene, precision)
    if precision != "f64":
        refuse_unholdable(scene, "f64")


def test_lengths_of_nothing_are_held_by_every_precision():
    """Points that collide, and a spring whose ends are in one place, at rest and at the start."""
    points = Particles.build([[1.0, 1.0], [1.0, 1.0]], radius=0.0)
    spring = Springs.build([(0, 1)], points.position, stiffness=1.0, rest_length=0.0)
    world = World((2.0, 2.0), (0.0, 0.0), collisions=True)
    for precision in ("f32", "compensated", "f64"):
        refuse_unholdable(Scene("points", world, points, spring), precision)


@pytest.mark.parametrize(
    ("scene", "substeps", "precision", "says"),
    [
        (two(1.0, 1e7, v=0.3), 1, "f32", "stands still in f32.*--precision compensated or f64"),
        (two(1.0, 1e7, v=0.3), 1, "compensated", None),
        (two(1.0, 1e5, v=0.002), 1, "f32", "stands still in f32"),
        (two(1.0, 1e5, v=0.5), 1, "f32", None),
        (two(1.0, 1e5, v=0.5), 64, "f32", "or fewer --substeps"),
        (two(1.0, 1e17, v=3.0), 1, "f64", "stands still in f64: .*; use longer steps"),
        (two(1.0, 9.0, mass=[1e-20, 1e20], k=1e-21), 1, "f32", "particle 1 of mass 1e.20 .*f64"),
        (two(1.0, 9.0, mass=[1e-20, 1e20], k=1e-21), 1, "f64", None),
        (two(1.0, 9.0), 1, "f32", None),
    ],
)
def test_what_a_precision_cannot_resolve_is_said(scene, substeps, precision, says):
    found = unresolved(scene, acceleration_at_start(scene), 1.0, substeps, precision)
    assert (found is None) if says is None else re.search(says, found)


@pytest.mark.parametrize("name", library.names())
def test_scenes_of_the_library_are_resolved(name):
    scene = library.build(name)
    refuse_unholdable(scene, "f32")
    assert unresolved(scene, acceleration_at_start(scene), scene.world.dt, 16, "f32") is None
