"""A mouse tool is one file, a view is one file and its name; what they lack is said by name."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import taichi_cloth
from taichi_cloth.ui import tools

PEG = '''
"""Tie the particle nearest to a click to a fixed one under the pointer."""

import numpy as np

from taichi_cloth.files.events import pair, whole_number
from taichi_cloth.ui.tools.contract import LoggedEvent, Marks, Tool, ToolEvent


def press(hand, pegs, event):
    place = hand.place(event.pos)
    pegs.append(place)
    nearest = np.linalg.norm(hand.sim.positions() - place, axis=1).argmin()
    return [ToolEvent("peg", {"particle": int(nearest), "at": place.tolist()})]


def replay(sim, values):
    sim.spawn(values["at"], fixed=True, tied_to=values["particle"])


def draw(hand, pegs):
    count = len(pegs)
    gold = np.full((count, 3), (255, 203, 107), np.uint8)
    return Marks(np.reshape(pegs, (-1, 2)), np.full(count, 2.0), gold, np.zeros((0, 2), int))


TOOL = Tool(
    name="peg",
    help="tie the nearest particle to where you click",
    key="7",
    actions=lambda scene: ("left click\\ttie the nearest particle to here",),
    remember=lambda seed: [],
    buttons=("left",),
    press=press,
    prepare=None,
    draw=draw,
    events=(LoggedEvent("peg", {"particle": whole_number, "at": pair}, replay),),
)
'''

RUN = """
import numpy as np
from taichi_cloth import load_events, runtime
from taichi_cloth.files.events import Recorder
from taichi_cloth.scene import library
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.ui import app
from taichi_cloth.ui.inputs import Event
from null_view import NullView

scene = library.build("cloth", columns=4, rows=3)


class Hands(NullView):
    visible = True
    pictures = []
    turns = [
        [Event("move", pos=(300.0, 200.0)), Event("press", key="f1"), Event("press", key="7")],
        [  # a click on the key list is for the list
            Event("press", key="f1"),
            Event("press", pos=(310.0, 250.0), button="left"),
            Event("press", key="f1"),
        ],
        [Event("move", pos=(320.0, 200.0)), Event("press", key="7")],
        [Event("move", pos=(330.0, 200.0))],
        [Event("move", pos=(345.0, 210.0)), Event("press", pos=(310.0, 250.0), button="left")],
    ]

    def poll(self):
        return self.turns.pop(0) if self.turns else []

    def draw(self, picture):
        self.pictures.append(picture)


def end(view, **how):
    sim = Simulation(scene, topology="graph", execution="serial")
    app.run(sim, view, frames=12, quiet=True, status=False, device="test", **how)
    return [sim.positions(), sim.velocities(), sim.springs()]


runtime.start("cpu", "f64", threads=1)
hands = Hands(scene.world, (600, 400))
with Recorder("log.jsonl", {"window": [600, 400]}) as recorder:
    live = end(hands, recorder=recorder)
assert len(live[0]) == 13 and live[2][-1, 1] == 12
assert [len(picture.position) for picture in hands.pictures[1:5]] == [12, 14, 13, 13]
keys = [" ".join(part.words for part in one.overlay) for one in hands.pictures[1:4]]
assert "move the mouse" not in keys[1] and "to here" in keys[1]
assert all("7\\ttie the nearest" in lines for lines in keys) and "move the mouse" in keys[2]
log = load_events("log.jsonl")
(tied,) = [e for events in log.by_frame.values() for e in events if e.kind == "peg"]
assert tied.values["at"] == (310.0, 250.0) and tied.values["particle"] == live[2][-1, 0]
again = end(NullView(scene.world), replay=log)
for a, b in zip(live, again, strict=True):
    assert a.tobytes() == b.tobytes()
"""


@pytest.fixture
def package(tmp_path):
    """A copy of the package to add files to; runs programs with it, and returns what they said."""
    root = Path(taichi_cloth.__file__).parent
    shutil.copytree(root, tmp_path / root.name, ignore=shutil.ignore_patterns("__pycache__"))

    def run(code, check=0):
        env = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(tmp_path), os.path.dirname(__file__)]),
        }
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, env=env, capture_output=True, text=True
        )
        assert done.returncode == check, done.stderr
        return done.stderr

    run.folder = tmp_path / root.name
    return run


def test_one_file_adds_a_tool_whose_log_replays_to_the_bit(package):
    (package.folder / "ui" / "tools" / "peg.py").write_text(PEG)
    package(RUN)


@pytest.mark.parametrize(
    ("part", "instead", "says"),
    [
        ('    help="tie the nearest particle to where you click",\n', "", "'help'"),
        ("    events=(", "    evnets=(", "'evnets'"),
        ("    prepare=None,\n", "", "'prepare'"),
        ("    press=press,\n", "", "press is missing"),
        ('buttons=("left",)', "buttons=()", "press is never called"),
        ('name="peg"', 'name="pole"', "name must be the file's"),
        ('key="7"', 'key="r"', "key must be a letter or digit that has no other meaning"),
        ('    key="7",\n', "", "the tool could never be used"),
        ('key="7"', 'mouse="peg"', "scenes know no 'peg'"),
        ("press=press", "press=True", "press must be a function"),
        ('LoggedEvent("peg"', 'LoggedEvent("move"', "'move' is the mouse's"),
        ("TOOL =", "TOOLS =", "declares no TOOL = Tool(...)"),
    ],
)
def test_what_a_tool_lacks_is_said_by_file_and_part(part, instead, says, tmp_path, monkeypatch):
    assert part in PEG
    (tmp_path / "peg.py").write_text(PEG.replace(part, instead))
    monkeypatch.setattr(tools, "__path__", [str(tmp_path)])
    monkeypatch.delitem(sys.modules, f"{tools.__name__}.peg", raising=False)
    with pytest.raises(TypeError) as refused:
        tools.load_all.__wrapped__()
    said = str(refused.value)
    assert said.startswith("taichi_cloth/ui/tools/peg.py: ") and says in said


def test_no_two_tools_claim_the_same_mouse_key_or_event(tmp_path, monkeypatch):
    for name in ("peg", "pole"):
        (tmp_path / f"{name}.py").write_text(PEG.replace('name="peg"', f'name="{name}"'))
        monkeypatch.delitem(sys.modules, f"{tools.__name__}.{name}", raising=False)
    monkeypatch.setattr(tools, "__path__", [str(tmp_path)])
    with pytest.raises(TypeError, match=r"tools/pole.py: peg.py has key '7', too"):
        tools.load_all.__wrapped__()


def test_a_tools_events_are_checked_where_a_log_is_read(package):
    (package.folder / "ui" / "tools" / "peg.py").write_text(PEG)
    package("""
from taichi_cloth import InputError, load_events

for line, says in (
    ('"particle": -1, "at": [1, 2]', "particle must be a whole number from 0, is -1"),
    ('"particle": 1', "'at' is missing; a peg event needs it"),
    ('"particle": 1, "at": [1, 2], "pos": [1, 2]', "unknown key 'pos'; "),
):
    open("log.jsonl", "w").write(f'{{"frame": 0, "event": "peg", {line}}}')
    try:
        raise SystemExit(load_events("log.jsonl"))
    except InputError as error:
        assert str(error).startswith(f"log.jsonl line 1: {says}"), error
""")


def test_a_presenter_is_a_file(package):
    folder = package.folder / "ui" / "presenters"
    none = (folder / "none.py").read_text()
    (folder / "toy.py").write_text(none.replace('"none"', '"toy"'))
    code = """
from taichi_cloth.scene.model import World
from taichi_cloth.ui.opening import open_view, usable_views

assert "toy" in usable_views()
assert open_view("toy", World((60.0, 40.0), (0.0, 0.0))).name == "toy"
"""
    package(code)
