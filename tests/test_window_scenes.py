"""Another scene in the same window: chosen in the panel, with files of its own that replay."""

import json
import os
import subprocess
import time
from types import SimpleNamespace

import numpy as np
import pytest
from commands import PROGRAM, command
from lacking import VIEWS, needs_x
from null_view import NullView
from screens import virtual_screen, wait_for
from selection import thorough

from taichi_cloth import load_trajectory
from taichi_cloth.cli import run_files, run_scenes
from taichi_cloth.errors import InputError
from taichi_cloth.render.window_map import Look
from taichi_cloth.scene import assignments
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.options import RunOptions
from taichi_cloth.ui.chrome.layout import Parts, arrange
from taichi_cloth.ui.framing import camera_of

OWN = """name = "own"
[world]
size = [600.0, 400.0]
gravity = [0.0, 0.05]
mouse = "blow"
[[cloths]]
origin = [200.0, 100.0]
columns = 6
rows = 5
spacing = 20.0
pinned = [[0, 0], [5, 0]]
"""
SIZE = 900, 600


def test_the_next_scene_keeps_where_to_compute_and_has_files_of_its_own(tmp_path):
    log, folder = tmp_path / "a.b.jsonl", tmp_path / "frames"
    folder.mkdir()
    options = RunOptions.from_given(
        {"precision": "f64", "meters": True, "substeps": 4, "method": "rk4", "topology": "lanes",
         "record": str(log), "export": str(folder), "save": "/dev/null", "report": "a.html"}
    )  # fmt: skip
    there = run_scenes.options_of("box", options)
    assert (there.precision, there.meters) == ("f64", True)
    assert (there.substeps, there.method, there.topology) == (1, "symplectic_euler", "auto")
    assert (there.record, there.export) == (str(tmp_path / "a.b-box.jsonl"), f"{folder}-box")
    assert there.report == "a-box.html"
    assert there.save == "/dev/null" and there.given == options.given - {
        "substeps", "method", "topology",
    }  # fmt: skip
    (tmp_path / "a.b-box.jsonl").touch()
    assert run_scenes.beside(str(log), "box") == str(tmp_path / "a.b-box-2.jsonl")
    first = SceneSource("cloth", {"columns": 8})
    assert run_scenes.left_behind(first, options) == [
        "--method", "--substeps", "--topology", "--columns",
    ]  # fmt: skip
    assert "own" in run_scenes.choices(SceneSource("own.toml"), "own")
    assert run_scenes.source_of("own", SceneSource("own.toml"), "own").name == "own.toml"


IN_SPACE = """name = "own"
[world]
size = [4.0, 3.0, 4.0]
gravity = [0.0, -9.81, 0.0]
up = "y"
[[cloths]]
origin = [1.0, 2.0, 1.0]
columns = 4
rows = 3
spacing = 0.2
"""


@pytest.mark.parametrize("text", [OWN, IN_SPACE], ids=["plane", "space"])
def test_a_scene_whose_file_was_edited_is_read_anew_with_its_flags_and_seen_as_it_was(
    tmp_path, text
):
    file, log = tmp_path / "own.toml", tmp_path / "log.jsonl"
    file.write_text(text)
    source = SceneSource(str(file), assignments=(assignments.read("world.friction=0.5"),))
    given = {"record": str(log), "substeps": 4, "resume": "a.npz", "paused": True}
    options = RunOptions.from_given(given)
    scene = source.build()
    view = NullView(scene.world)
    view.visible, view.camera = True, camera_of(scene)

    def ready(wanted):
        return run_scenes.Run(wanted, SimpleNamespace(scene=wanted.scene), None)

    with run_files.begun(scene, options) as files:
        first = run_scenes.Wanted(source, scene, options, files)
        with run_scenes.Window(first, view, ready) as window:
            file.write_text(f"# a comment changes nothing\n{text}")
            assert window.scenes.edited() is None and window.scenes.file == str(file)
            file.write_text("nothing = 1")
            with pytest.raises(InputError, match="own.toml"):
                window.scenes.edited()
            assert not window.scenes.said and window.go_on(0) is None
            if view.camera:
                view.camera.distance *= 2.0
            view.look = look = Look((300.0, 200.0), 2.0)
            pose = view.camera and view.camera.pose
            window.scenes.paused, window.scenes.tool = True, "grab"
            file.write_text(text.replace("rows", "stiffness = 0.25\nrows"))
            window.scenes.edited()()
            assert window.scenes.said == (
                "read own.toml anew; --record log-own.jsonl; --resume was of own.toml before"
            )
            run = window.go_on(10)
            assert run.of.source == source and run.of.options.substeps == 4
            assert run.of.options.record == str(tmp_path / "log-own.jsonl")
            assert run.of.options.resume is None and "resume" not in run.of.options.given
            assert not run.of.options.paused  # which the window says: it may play by now
            assert set(run.of.scene.springs.stiffness) == {0.25}
            assert run.of.scene.world.friction == 0.5  # what was assigned is still
            assert (window.scenes.pose, view.look) == (pose, look)
            assert (window.scenes.paused, window.scenes.tool) == (True, "grab")
            assert window.scenes.edited() is None
            file.write_text(text.replace('name = "own"', 'name = "other"'))
            window.scenes.edited()()
            assert window.go_on(10).of.options.record == str(tmp_path / "log-other.jsonl")
            window.scenes.open("box")
            window.go_on(10)
            assert window.scenes.file == "" and window.scenes.edited() is None
            assert (window.scenes.paused, window.scenes.tool) == (False, "")
            assert window.scenes.pose is None and view.look is None


class Hands:
    """What the mouse and the keys do in a window of `taichi-cloth run`."""

    def __init__(self, display, caches, folder, *words):
        self.env, self.folder = {**os.environ, **caches, "DISPLAY": display}, folder
        self.process = subprocess.Popen(
            [*PROGRAM, "run", *words, "--size", "x".join(map(str, SIZE))],
            env=self.env, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        self.wait("own, playing")
        column = arrange(SIZE, Parts(bar=True, strip=1, columns=("settings",)))
        rect = column.columns["settings"]
        self.row = rect.x + rect.width // 2, rect.y + column.text // 2
        self.press("o", 100, 300)

    def ask(self, *words):
        return subprocess.run(
            ["xdotool", *map(str, words)], env=self.env, capture_output=True, text=True
        ).stdout.split()

    def wait(self, title):
        search = ("search", "--onlyvisible", "--name", f"^{title}")
        self.id = wait_for(lambda: self.ask(*search), self.process, title, 120)[-1]

    def press(self, key, *place):
        if place:
            self.ask("mousemove", "--window", self.id, *place)
        self.ask("key", key)
        time.sleep(0.3)

    def open(self, number):
        """Open the scene of so many rows under the first."""
        self.ask("mousemove", "--window", self.id, *self.row, "click", 1)
        time.sleep(0.5)
        for _ in range(number):
            self.press("Down")
        self.press("Return")

    def blow(self, *places):
        for place in places:
            self.ask("mousemove", "--window", self.id, *place)
            time.sleep(0.2)

    def quit(self):
        for place in ((100, 300), (), ()):  # leaves the row, then the panel, then the run
            self.press("Escape", *place)
        out, _ = self.process.communicate(timeout=60)
        return out


@thorough
@needs_x
@pytest.mark.parametrize("kind", VIEWS)
def test_a_window_goes_on_with_another_scene_and_both_logs_replay(kind, caches, tmp_path):
    (tmp_path / "own.toml").write_text(OWN)
    files = ("--record", "log.jsonl", "--save", "run.npz", "--substeps", "2")
    with virtual_screen() as display:
        w = Hands(display, caches, tmp_path, "own.toml", "--view", kind, *files)
        w.blow((200, 200), (260, 240), (220, 300))
        w.open(1 + run_scenes.library.names().index("cloth") + 1)
        w.wait("cloth, playing")
        w.blow((200, 200), (260, 240), (320, 300))
        (tmp_path / "own.toml").write_text("nothing = 1")
        w.open(1)
        time.sleep(1.0)
        w.wait("cloth, playing")  # what cannot be opened leaves it as it was
        out = w.quit()
    assert w.process.returncode == 0, out
    assert "opened cloth; --save run-cloth.npz; --record log-cloth.jsonl; --substeps was" in out
    assert out.rstrip().endswith("cloth: --save run-cloth.npz, --record log-cloth.jsonl")
    (tmp_path / "own.toml").write_text(OWN)
    for scene, log, saved, steps in (
        ("own.toml", "log.jsonl", "run.npz", 2),
        ("cloth", "log-cloth.jsonl", "run-cloth.npz", 1),
    ):
        first, *events = (tmp_path / log).read_text().splitlines()
        assert json.loads(first)["header"]["substeps"] == steps
        assert sum('"move"' in event for event in events) >= 2
        seen = load_trajectory(tmp_path / saved)
        frames = ("--frames", seen.frame[-1], "--headless", "--save", "again.npz", "--quiet")
        command("run", scene, "--events", log, *frames, cwd=tmp_path, env=caches)
        again = load_trajectory(tmp_path / "again.npz")
        np.testing.assert_array_equal(again.position, seen.position)
        np.testing.assert_array_equal(again.frame, seen.frame)


@thorough
@needs_x
@pytest.mark.parametrize("kind", VIEWS)
def test_r_reads_the_file_anew_that_an_editor_saved_and_both_logs_replay(kind, caches, tmp_path):
    (tmp_path / "own.toml").write_text(OWN)
    files = ("--record", "log.jsonl", "--save", "run.npz", "--substeps", "2")
    edited = OWN.replace("columns = 6", "columns = 9").replace('"own"', '"wide"')
    with virtual_screen() as display:
        w = Hands(display, caches, tmp_path, "own.toml", "--view", kind, *files)
        w.blow((200, 200), (260, 240), (220, 300))
        (tmp_path / "own.toml").write_text(edited)
        w.press("r")
        w.wait("wide, playing")
        w.blow((200, 200), (260, 240), (320, 300))
        out = w.quit()
    assert w.process.returncode == 0, out
    assert "read own.toml anew; --save run-wide.npz; --record log-wide.jsonl\n" in out
    assert "own: 30 particles" in out and "wide: 45 particles" in out
    for text, log, saved in (
        (OWN, "log.jsonl", "run.npz"),
        (edited, "log-wide.jsonl", "run-wide.npz"),
    ):
        (tmp_path / "own.toml").write_text(text)
        seen = load_trajectory(tmp_path / saved)
        frames = ("--frames", seen.frame[-1], "--headless", "--save", "again.npz", "--quiet")
        command("run", "own.toml", "--events", log, *frames, cwd=tmp_path, env=caches)
        again = load_trajectory(tmp_path / "again.npz")
        np.testing.assert_array_equal(again.position, seen.position)
