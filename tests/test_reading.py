"""Whatever is given to a reader is read, or refused in one line: documents that are nearly right.

Documents are sound ones with a few mistakes in them: values of every odd kind, lines that are
missing, twice, or elsewhere, bytes that are no text.
"""

import json
import math
import os
import time

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from selection import as_thorough

import bench
from bench.options import BenchOptions
from taichi_cloth.cli import main as command_line
from taichi_cloth.cli import scene_command
from taichi_cloth.errors import InputError, nearest
from taichi_cloth.files import trajectory
from taichi_cloth.scene import assignments, library, scenefile
from taichi_cloth.scene.checks import validate
from taichi_cloth.scene.reassignment import reassigned
from taichi_cloth.settings.arguments import CommandParser, value_of
from taichi_cloth.settings.options import parameters_of
from taichi_cloth.ui import interaction

SECONDS = 5.0  # of the processor, far more than any document takes: each ends

# Values as TOML, most of which JSON and arguments take, too.
ODD_VALUES = [
    *("0", "-0.0", "1", "-1", "2.5", "1e-320", "5e-324", "1e308", "1e400", "-1e400", "1_0", "nan"),
    *("inf", "-inf", "NaN", "Infinity", "true", "false", "null", "''", '""', '"blow"', "blow"),
    *(
        "9" * 400,
        "9" * 5000,
        "-" + "9" * 5000,
        "0x" + "f" * 6000,
        "0b" + "1" * 20000,
        "1e" + "9" * 99,
    ),
    *("[]", "[[]]", "{}", "[1,2]", "[1,2,3]", "[0,0]", "[1e300,1e300]", "[-1,5e-324]", "[nan,inf]"),
    *(
        "[" * 3000 + "]" * 3000,
        "[" * 200,
        '{"a":' * 3000 + "1" + "}" * 3000,
        "{a=1}",
        "{a={b=[{}]}}",
    ),
    *("{ structural = 1 }", "{ shear = -1 }", "[[0,0],[9,9]]", "[['a']]", "[true,false]", "2**3"),
    *(
        "1979-05-27",
        "07:32:00",
        "1979-05-27T07:32:00Z",
        '"\\u0000"',
        '"\\u001b[2J"',
        '"\\n"',
        "'''",
    ),
    *(
        "\u0663",
        "\u0661\u0660",
        "1\u00a0",
        "\ud800",
        "\ufeff1",
        "#",
        "=",
        "1 2",
        "1,2",
        "0x10",
        "1e5",
    ),
    *(
        "x" * 3000,
        '"' + "x" * 3000 + '"',
        "300x200",
        "1%",
        "8ms",
        "--",
        "-",
        "=1",
        "a=b",
        "../..",
        "\x00",
    ),
]
odd_values = st.sampled_from(ODD_VALUES) | st.text(max_size=8) | st.floats().map(repr)

SCENE = """\
name = "fuzz"
[world]
size = [100.0, 100.0]
gravity = [0.0, 1.0]
dt = 1.0
walls = ["top", "left"]
collisions = true
mouse = "spawn"
[particle]
mass = 1.0
radius = 2.0
viscous = 0.1
restitution = 0.5
[spring]
stiffness = 1.0
rest_length = 5.0
break_force = 3.0
damping = 0.1
[[particles]]
position = [10.0, 10.0]
velocity = [0.0, 1.0]
fixed = true
color = [1, 2, 3]
[[particles]]
position = [20.0, 10.0]
mass = 3.0
[[springs]]
between = [0, 1]
break_force = false
[[cloths]]
origin = [30.0, 30.0]
columns = 3
rows = 2
spacing = 5.0
pinned = [[0, 0]]
links = ["structural", "shear"]
across = [1.0, 0.0]
down = [0.0, 1.0]
stiffness = { structural = 0.5, shear = 0.1 }
damping = 0.2
"""
LOG = """\
{"header": {"scene": "fuzz", "window": [100, 100], "dt": 1.0, "arguments": ["--rows", "3"]}}
{"frame": 0, "event": "move", "pos": [50.0, 50.0]}
{"frame": 1, "event": "press", "button": "left", "pos": [50.0, 50.0]}
{"frame": 2, "event": "press", "key": "space"}
{"frame": 2, "event": "release", "key": "space"}
{"frame": 3, "event": "wheel", "delta": 1.0}
"""


def is_value_of(line):
    """Where the value of a line begins: after its first '=' or ':'."""
    return min((line.index(mark) + 1 for mark in "=:" if mark in line), default=0)


@st.composite
def damaged(draw, text):
    """The bytes of a text with one to four mistakes in it."""
    lines = text.splitlines()
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(lines) - 1)) if lines else 0
        mistake = draw(
            st.sampled_from(
                ["value", "value", "value", "inside", "drop", "twice", "move", "key", "text"]
            )
        )
        line = lines[at] if lines else ""
        if mistake == "value" and lines:
            lines[at] = line[: is_value_of(line)] + " " + draw(odd_values)
        elif mistake == "inside" and lines:  # one of the numbers or words of a line
            parts = line.replace("[", "\0[\0").replace("]", "\0]\0").replace(",", "\0,\0")
            parts = parts.replace(": ", ": \0").replace("}", "\0}").split("\0")
            parts[draw(st.integers(0, len(parts) - 1))] = draw(odd_values)
            lines[at] = "".join(parts)
        elif mistake == "drop" and lines:
            del lines[at]
        elif mistake == "twice":
            lines.insert(at, line)
        elif mistake == "move" and lines:
            lines.insert(draw(st.integers(0, len(lines) - 1)), lines.pop(at))
        elif mistake == "key" and lines:
            cut = draw(st.integers(0, len(line)))
            lines[at] = line[:cut] + draw(st.text(max_size=2)) + line[cut + 1 :]
        elif mistake == "text":
            lines.insert(at, draw(st.text(max_size=20)))
    made = draw(st.sampled_from(["\n", "\n", "\r\n", "\r"])).join(lines)
    content = made.encode("utf-8", "surrogatepass")
    junk = draw(
        st.sampled_from([b"", b"", b"", b"\xff", b"\x00", b"\xef\xbb\xbf", b"\xed\xa0\x80"])
    )
    at = draw(st.integers(0, len(content)))
    return content[:at] + junk + content[at:] if draw(st.booleans()) else junk + content


def refused_in_a_line(read, *names):
    """What `read` returns, or None where it refuses in one line that has one of these names."""
    begin = time.process_time()
    try:
        result = read()
    except InputError as error:
        message, result = str(error), None
        assert message.isprintable() and len(message) <= 1000, message
        assert any(name in message for name in names), message
    assert time.process_time() - begin < SECONDS
    return result


def each(examples, strategy):
    """Runs a check on so many examples."""

    def run(check):
        quiet = settings(
            max_examples=examples,
            deadline=None,
            database=None,
            suppress_health_check=list(HealthCheck),
        )
        quiet(given(strategy)(check))()

    return run


EXAMPLES = [50, as_thorough(2000)]


@pytest.mark.parametrize("examples", EXAMPLES)
def test_scene_files(examples, tmp_path):
    path = tmp_path / "fuzz.toml"

    @each(examples, damaged(SCENE))
    def check(document):
        path.write_bytes(document)
        scene = refused_in_a_line(lambda: scenefile.load(path), "fuzz.toml")
        if scene is None:
            return
        assert validate(scene) is scene
        for columns in (scene.particles, scene.springs):
            for name, column in vars(columns).items():
                words = column.dtype.kind == "U"
                assert name == "break_force" or words or np.isfinite(column).all()
        again = scenefile.parse(scenefile.dump(scene))
        assert again.world == scene.world and again.name == scene.name
        assert (again.particles.position == scene.particles.position).all()


@pytest.mark.parametrize("examples", EXAMPLES)
def test_interaction_logs(examples, tmp_path):
    path = tmp_path / "fuzz.jsonl"

    @each(examples, damaged(LOG))
    def check(document):
        path.write_bytes(document)
        log = refused_in_a_line(lambda: interaction.load(path), "fuzz.jsonl line ")
        for frame, events in (log.by_frame if log else {}).items():
            assert frame >= 0
            for event in events:
                numbers = [*(event.pos or ()), event.delta]
                assert all(map(math.isfinite, numbers)), event
                json.dumps({"frame": frame, **event.fields()})


COMMANDS = {name: settings_ for name, (_, settings_) in command_line.SCENE_COMMANDS.items()}
FLAGS = {
    name: [*parameters_of(of), *(k for s in library.names() for k in library.parameters(s)), "set"]
    for name, of in {**COMMANDS, "bench": BenchOptions}.items()
}


@st.composite
def command_lines(draw):
    """A command and its words: flags that are nearly right, with values that are nearly right."""
    command = draw(st.sampled_from(sorted(FLAGS)))
    words = draw(
        st.lists(st.sampled_from([*library.names(), "a.toml", "speed", "", "x" * 300]), max_size=1)
    )
    for _ in range(draw(st.integers(1, 4))):
        name = "--" + draw(st.sampled_from(FLAGS[command])).replace("_", "-")
        if draw(st.integers(0, 9)) == 0:
            name = draw(
                st.sampled_from([name[:-1], name + "=", "-" + name, "--", "-h", name.upper()])
            )
        value = draw(odd_values | st.sampled_from(["world.dt=" + v for v in ODD_VALUES]))
        words += draw(st.sampled_from([[name], [name, value], [f"{name}={value}"]]))
    return command, words


@pytest.mark.parametrize("examples", EXAMPLES)
def test_arguments(examples, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def read(command, words):
        if command != "bench":
            return scene_command.read(command, COMMANDS[command], words, "")
        parser = CommandParser("bench")
        declared = parameters_of(BenchOptions)
        parser.declare("flags", declared)
        said = parser.read(words)
        for part in said.others:
            if part not in bench.PARTS:
                raise InputError(f"bench: unknown part '{part}'; {nearest(part, bench.PARTS)}")
        return {name: value_of(name, declared[name], text) for name, text in said.texts.items()}

    @each(examples, command_lines())
    def check(case):
        command, words = case
        result = refused_in_a_line(
            lambda: read(command, words), "--", "-h", "unexpected", "scene", "bench"
        )
        capsys.readouterr()  # help
        if not isinstance(result, tuple):
            return
        source, options = result
        for name, value in {**source.parameters, **vars(options)}.items():
            if isinstance(value, (int, float)) and name != "break_force":
                assert math.isfinite(value)
        if not source.is_file:
            assert read(command, [*source.words(), *options.words()]) == (source, options)


@pytest.mark.parametrize("examples", EXAMPLES)
def test_assignments(examples):
    keys = ["world.size", "world.gravity", "world.size[0]", "particle.mass", "spring.break_force"]
    keys += ["cloths[0].rows", "particles[1].position", "name", "world", "spring.stiffness.x", "x"]
    scene = library.build("cloth", columns=3, rows=2)

    @each(examples, st.tuples(st.sampled_from(keys), odd_values, st.booleans()))
    def check(case):
        key, value, of_file = case

        def read():
            assignment = assignments.read(f"{key}={value}")
            if of_file:
                return scenefile.parse(SCENE, "fuzz.toml", assignments=[assignment])
            return reassigned(scene, [assignment])

        made = refused_in_a_line(read, "--set", "fuzz.toml", "scene 'cloth'")
        assert made is None or validate(made) is made


@pytest.mark.parametrize("examples", [50, as_thorough(500)])
def test_saved_trajectories(examples, tmp_path):
    path = tmp_path / "fuzz.npz"
    whole = tmp_path / "whole.npz"
    arrays = dict.fromkeys(("frame", "time", "position", "velocity", "spring", "spring_alive"))
    np.savez(whole, **{name: np.zeros((2, 2)) for name in arrays}, meta=np.array('{"a": 1}'))
    content = whole.read_bytes()
    places = st.lists(st.tuples(st.integers(0, len(content) - 1), st.integers(0, 255)), max_size=4)

    @each(examples, st.tuples(places, st.integers(0, len(content))))
    def check(case):
        changes, end = case
        damaged = bytearray(content)
        for at, byte in changes:
            damaged[at] = byte
        path.write_bytes(damaged[: end if end % 3 else None])
        refused_in_a_line(lambda: trajectory.load(path), "fuzz.npz")


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("dt", "0x" + "f" * 6000, "line 5: [world]: dt must be a number that fits"),
        ("dt", "9" * 6000, "line 5: has a whole number with too many digits"),
        ("size", "[5e-324, 5e-324]", "line 3: [world]: size must be"),
        ("size", "[1e300, 1e300]", "line 3: [world]: size must be"),
        ("size", "a" + ".a" * 20000 + "=1", "line 3"),
    ],
)
def test_numbers_that_no_scene_can_have(name, value, says):
    lines = [
        f"{name} = {value}" if line.startswith(f"{name} ") else line for line in SCENE.split("\n")
    ]
    with pytest.raises(InputError) as refused:
        scenefile.parse("\n".join(lines))
    assert says in str(refused.value)


@pytest.mark.parametrize(
    "text", ["\u0663", "1_0", " 3", "3 ", "3\n", "\u00b2", "0x10", "3.0", "", "9" * 5000]
)
def test_whole_numbers_are_written_in_the_digits_0_to_9(text, capsys):
    for words in (["bench", "--rounds", text], ["run", "--frames", text]):
        assert command_line.main(words) == 2
        said = capsys.readouterr().err
        assert words[1] in said and said.count("\n") == 1 and len(said) < 200


def test_a_file_without_an_end_is_refused(monkeypatch):
    monkeypatch.setattr("taichi_cloth.files.content.LARGEST", 2**20)
    for read, what in ((scenefile.load, "scene file"), (interaction.load, "interaction log")):
        with pytest.raises(
            InputError, match=f"/dev/zero: has more than 1 MiB, too much for a {what}"
        ):
            read("/dev/zero")


def test_a_name_that_is_no_text_is_shown(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    name = os.fsdecode(b"\xff.toml")
    (tmp_path / name).write_text("[world]\nsize = [10, 10]\ndt = 0")
    assert command_line.main(["run", name]) == 2
    assert "\\udcff.toml line 3: [world]: dt must be positive" in capsys.readouterr().err
    (tmp_path / name).write_text("[world]\nsize = [10, 10]")
    assert scenefile.load(name).name == "\ufffd"
