"""What stands beside the world in a window: the panel of settings and the timeline's row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from null_view import NullView

from taichi_cloth import load_trajectory
from taichi_cloth.cli.run_budget import HeldBudget
from taichi_cloth.cli.run_meter import MeasuredErrors
from taichi_cloth.kernels import methods
from taichi_cloth.render import style
from taichi_cloth.render.picture import Rect
from taichi_cloth.scene import library
from taichi_cloth.simulation.checkpoint import Checkpoint
from taichi_cloth.simulation.running_costs import RunningCosts
from taichi_cloth.ui import app, text
from taichi_cloth.ui.chrome import settings_rows
from taichi_cloth.ui.chrome.chrome import Chrome
from taichi_cloth.ui.chrome.layout import Parts, arrange
from taichi_cloth.ui.chrome.settings_panel import SettingsPanel
from taichi_cloth.ui.chrome.timeline_row import TimelineRow
from taichi_cloth.ui.chrome.why import Finding, Why
from taichi_cloth.ui.controls import Controls
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.scenes import Scenes
from taichi_cloth.ui.timeline import Timeline

RECT, HEIGHT = Rect(500, 20, 300, 560), 12


class Hands:
    """A panel with the pointer and the keys on it."""

    def __init__(self, sim, scenes=None, budget=None):
        self.noted = []
        self.controls = Controls(sim, None, (800, 600), note=self.noted.append)
        scenes = scenes or Scenes()
        told = lambda: self.controls.notice  # noqa: E731
        self.panel = SettingsPanel(sim, self.controls, RunningCosts(), scenes, told, budget)
        self.look()

    def look(self):
        self.panel._read_at = self.panel._costs._looked = -np.inf  # as if a second had passed
        return self.panel.panel(RECT, HEIGHT).words.splitlines()

    def place(self, name, across=0.5):
        placed = next(n for n in self.panel._rows if n.row.name == name)
        return RECT.x + across * RECT.width, RECT.y + placed.top + placed.tall - 3

    def press(self, pos):
        self.panel.take(Event("press", pos=pos, button="left"), RECT, HEIGHT)

    def release(self):
        self.panel.take(Event("release", pos=(0, 0), button="left"), RECT, HEIGHT)
        self.panel.flush()

    def keys(self, *keys):
        for key in keys:
            self.panel.take(Event("press", key=key), RECT, HEIGHT)
        self.panel.flush()


@pytest.fixture
def sim(pool):
    made = pool(library.build("cloth", columns=4, rows=3))
    made.reset()
    return made


def test_settings_are_set_by_mouse_and_keys_and_noted(sim):
    hands = Hands(sim)
    assert "stiffness 0.5 lim 65 %" in hands.look() and not hands.panel.focused
    hands.press(hands.place("stiffness", 0.75))
    dragged = sim.storage.scene.springs.stiffness
    assert (dragged == 0.5).all()  # only before the next frame
    hands.release()
    dragged = float(sim.storage.scene.springs.stiffness[0])
    assert 0.5 < dragged < 50 and hands.panel.focused
    hands.keys("1", "2", "backspace", ".", "5", "return")
    assert (
        sim.storage.scene.springs.stiffness == 1.5
    ).all() and "stiffness 1.5 lim 113 %" in hands.look()
    hands.keys("delete")
    assert (sim.storage.scene.springs.stiffness == 0.5).all()
    hands.keys("right")
    assert sim.storage.scene.springs.stiffness[0] > 0.5
    hands.panel._clicked = "", -np.inf
    for _ in range(2):  # a double click
        hands.press(hands.place("stiffness", 0.1)[:1] + (hands.place("stiffness")[1] - 14,))
        hands.release()
    assert (sim.storage.scene.springs.stiffness == 0.5).all()
    assert [event.values["name"] for event in hands.noted] == ["stiffness"] * 5
    # Keys that mean nothing to a row are the window's: to pause, to see strain; e is in 3e2.
    for name, used in (("space", False), ("r", False), ("e", False), ("3", True), ("e", True)):
        assert hands.panel.take(Event("press", key=name), RECT, HEIGHT) is used
    hands.keys("2", "return")
    assert (sim.storage.scene.springs.stiffness == 300.0).all()
    hands.keys("delete", "escape")
    assert not hands.panel.focused


def test_up_and_down_choose_rows_as_soon_as_the_settings_are_open(sim):
    """Also in the turn that opened them, and after a click elsewhere; closed, both zoom."""
    size = 900, 600
    place = arrange(size, Parts(bar=True, strip=1, columns=("settings",))).columns["settings"]
    first = Event("press", pos=(place.x + 20, place.y + 5), button="left")
    beside = Event("press", pos=(300.0, 300.0), button="left")

    def foot(*keys):
        window, panels = Pressed(sim.scene.world, (keys, [])), []
        window.size, window.look = size, None
        window.draw = lambda picture: panels.extend(picture.overlay)
        app.run(sim, window, quiet=True, device="test")
        said = [panel.words for panel in panels if "cost now" in panel.words]
        assert said or window.look
        return said[-1].splitlines()[-2:] if said else window.look.zoom

    none, clicked, last = foot("o"), foot("o", first), foot("o", "up")
    assert foot("o", "down") == foot("o", "down", beside, "down") == clicked
    assert foot("o", "up", "down") == clicked and none != last != clicked != none
    assert foot("o", "down", "escape") == foot("o", "down", beside) == none
    assert foot("up") > 1 > foot("down")


def test_escape_closes_a_list_with_the_row_that_opened_it(sim):
    hands = Hands(sim)

    def rows():  # limits are measured anew once a second
        return [line.partition(" lim ")[0] for line in hands.look()]

    closed = rows()
    for keys in (["escape"], ["down", "down", "escape"]):  # on the method, on a word of its list
        hands.panel._clicked = "", -np.inf
        hands.press(hands.place("method"))
        assert len(hands.look()) > len(closed) + 3
        hands.keys(*keys)
        assert rows() == closed and not hands.panel.focused


def test_a_budget_is_chosen_from_a_list_and_ends_where_substeps_are_set_by_hand(sim):
    errors = MeasuredErrors(sim, waits=False, told=False)
    budget = HeldBudget(sim, errors, windowed=True, told=False)
    hands = Hands(sim, budget=budget)
    assert hands.look()[1] == "hold \u2039 off \u203a" and budget.status() is None
    hands.press(hands.place("hold"))
    assert hands.look()[2:5] == ["off now", "60fps", "30fps"]
    hands.press(hands.place("hold:60fps"))
    assert budget.chosen == "60fps" and hands.look()[1] == "hold \u2039 60fps \u203a"
    sim.set(stiffness=8.0)  # which is unstable with one
    budget.before_frame(hands.controls.set)
    assert sim.substeps == 4 and [e.fields()["name"] for e in hands.noted] == ["substeps"]
    assert "nothing measured yet" in "".join(hands.look()[-4:])
    for _ in range(60):
        budget.after_frame(1e-3 * sim.substeps, 2e-3)
    budget.before_frame(hands.controls.set)
    assert budget.status().text.startswith("hold 60fps: ")
    hands.press(hands.place("method"))
    hands.press(hands.place("method:verlet"))
    hands.release()
    assert sim.method == "verlet" and budget.chosen == "60fps"
    assert hands.controls.notice == "hold 60fps leaves the method as it was set"
    budget.before_frame(hands.controls.set)
    assert budget.why.endswith("verlet stays, as it was set by hand")
    sim.set_method("symplectic_euler")
    hands.press(hands.place("substeps"))
    hands.keys("7", "return")
    assert sim.substeps == 7 and budget.chosen == "off"
    assert hands.controls.notice == "nothing is held any more, as substeps was set"
    sim.set_step(substeps=1)
    for word, ends in (("60fps", False), ("1%", True)):
        budget.choose(word)
        assert budget.unmeasured() is ends
    assert budget.chosen == "off"
    errors.close()


def test_scenes_and_methods_are_chosen_from_lists_that_say_what_each_is_and_costs(sim):
    opened = []
    about = {name: f"about {name}" for name in ("box", "cloth", "net")}
    hands = Hands(sim, Scenes(about, opened.append))
    assert hands.look()[0] == "scene \u2039 cloth \u203a"
    hands.press(hands.place("scene"))
    assert hands.look()[:4] == ["scene \u2039 cloth \u203a", "box", "cloth now", "net"]
    before = hands.panel.panel(RECT, HEIGHT).tile.pixels
    hands.press(hands.place("scene:net"))
    after = hands.panel.panel(RECT, HEIGHT)
    assert "net open" in after.words and "about net" in after.words
    x, y = hands.place("scene:net", 0.95)
    spot = int(y) - RECT.y, int(x) - RECT.x
    assert tuple(before[spot]) == style.PAPER and tuple(after.tile.pixels[spot]) == style.CHOSEN
    assert hands.panel.take_scene() is None
    hands.press((x, y))
    assert hands.panel.take_scene() == "net" and hands.panel.take_scene() is None
    hands.keys("up", "return")  # the one that there is: nothing is opened
    assert hands.panel.take_scene() is None
    hands.keys("up", "return")
    assert hands.panel.take_scene() == "box"
    hands.keys("left")
    assert "net open" not in hands.look() and not hands.noted and not opened

    hands.press(hands.place("method"))
    rows = [line.split() for line in hands.look()]
    assert ["symplectic_euler", "min", "1", "?"] in rows and ["verlet", "min", "1", "?"] in rows
    assert not hands.noted
    hands.keys(*["down"] * 8)
    costs, advice = hands.look()[-2:]
    assert costs == "not measured; stable from 1 substep on; compiles, and waits"
    assert advice == methods.load("verlet").claims.choose
    fixed = Hands(sim, Scenes(fixed="why not"))
    fixed.press(fixed.place("scene"))
    assert "why not" in fixed.look() and fixed.look()[1] == "run cost now"


def label_end(placed, height):
    return settings_rows._indent(placed.row, height) + text.length(placed.label, height)


@pytest.mark.parametrize("size", [(800, 600), (1280, 800), (1920, 1080), (2560, 1440)])
def test_nothing_written_in_the_panel_is_cut_or_meets_something_else(sim, size):
    """By what is drawn: the columns between what stands beside each other are empty paper."""
    rect = arrange(size, Parts(bar=True, strip=1, columns=("settings",)))
    height, rect = rect.text, rect.columns["settings"]
    hands = Hands(sim, Scenes({"trampoline": "a net"}))
    for name in ("scene", "method"):
        hands.panel._unfold(name)
        pixels = hands.panel.panel(rect, height).tile.pixels
        first, end = settings_rows.cost_column(rect.width, height)
        room = hands.panel._room(rect)
        assert (pixels[:room, end + 2 : -3] == style.PAPER).all()
        assert (pixels[:room, first - 3 : first - 1] == style.PAPER).all()
        for placed in hands.panel._rows:
            assert text.length(placed.row.cost, height) <= end - first
            words = "" if placed.under else placed.words
            assert label_end(placed, height) < settings_rows.value_start(words, rect.width, height)


def test_a_name_under_its_label_has_the_room_of_both_columns(sim):
    size = (640, 480)
    rect = arrange(size, Parts(bar=True, strip=1, columns=("settings",)))
    height, rect = rect.text, rect.columns["settings"]
    hands = Hands(sim)
    hands.panel.panel(rect, height)
    (placed,) = (one for one in hands.panel._rows if one.row.name == "method")
    assert placed.under and placed.words == settings_rows.marked(sim.method)
    _, end = settings_rows.cost_column(rect.width, height)
    pixels, _ = settings_rows.draw(placed, rect.width, height, False, "")
    assert (pixels[:, end + 2 :] == style.PAPER).all()


def test_a_step_of_any_length_leaves_its_cost_room_in_the_panel(sim):
    hands, said = Hands(sim), set()
    for dt in (9.0, 90.0, 1e9):
        hands.press(hands.place("dt"))
        hands.release()
        hands.keys(*f"{dt:g}".replace("+", ""), "return")
        hands.look()
        first, end = settings_rows.cost_column(RECT.width, HEIGHT)
        (row,) = (one.row for one in hands.panel._rows if one.row.name == "dt")
        assert text.length(row.cost, HEIGHT) <= end - first
        said.add(row.cost)
    assert len(said) == 3 and "lim >999x" in said


def test_what_to_do_about_a_failure_is_said_where_not_all_fits():
    """The title stands in the banner, too, and the proof is the first that one can do without."""
    words = [" ".join([name] * 14) for name in ("title", "cause", "proof", "remedy")]
    finding = Finding(words[0], words[1], words[2], True, words[3], {"substeps": 7})
    for tall, absent in ((600, set()), (280, {"proof"}), (215, {"proof", "title"})):
        why = Why()
        why.finding = finding
        said = why.panel(Rect(0, 0, 200, tall), HEIGHT).words
        assert {
            name for name in ("title", "cause", "proof", "remedy") if name not in said
        } == absent
        assert "u: go on" in said and "begin anew" in said


def test_a_long_name_of_a_scene_is_shortened_in_the_panel(sim, monkeypatch):
    name = "the_curtain_of_the_large_window_in_the_dining_room"
    hands = Hands(sim, Scenes({name: "a scene of somebody's", "box": "another"}))
    monkeypatch.setattr(sim, "scene", replace(sim.scene, name=name))
    hands.panel._unfold("scene")
    first, option = hands.look()[:2]
    assert "the_curtain" in first and "the_curtain" in option
    assert first.endswith(f"{text.ELLIPSIS} \u203a") and option.endswith(f"{text.ELLIPSIS} now")
    height, (_, end) = HEIGHT, settings_rows._left(RECT.width, HEIGHT)
    assert all(label_end(placed, height) <= end for placed in hands.panel._rows)


def test_what_is_refused_is_said_and_leaves_all_as_it_was(sim):
    hands = Hands(sim)
    hands.press(hands.place("substeps", 0.1)[:1] + (hands.place("substeps")[1] - 14,))
    hands.release()
    hands.keys("0", "return")
    assert sim.substeps == 1 and "substeps" in hands.look()[-1]
    for name in ("substeps", "stiffness"):  # a whole number, and one
        for typed in ("9e999", "1-2"):
            hands.press((hands.place(name)[0], hands.place(name)[1] - 14))
            for key in (*typed, "return"):
                hands.panel.take(Event("press", key=key), RECT, HEIGHT)
            assert f"{name}: {typed} is no number" in hands.look()[-1]
    assert not hands.panel.given


def test_a_panel_that_is_too_long_is_scrolled_and_draws_inside(sim):
    hands = Hands(sim)
    small = Rect(0, 0, 180, 200)
    first = hands.panel.panel(small, HEIGHT)
    assert first is hands.panel.panel(small, HEIGHT) and first.tile.pixels.shape == (200, 180, 3)
    hands.panel.take(Event("wheel", pos=(5, 5), delta=-100), small, HEIGHT)
    last = hands.panel.panel(small, HEIGHT)
    assert "method" in first.words and "method" not in last.words and "fracture" in last.words


@pytest.mark.parametrize(("size", "text_size"), [((320, 240), 1.0), ((640, 400), 2.0)])
def test_a_low_panel_has_settings_beside_its_foot(sim, size, text_size):
    """Where meters are open, too: of what the foot says it has whole lines."""
    opened = Parts(bar=True, strip=1, columns=("settings", "meters"), text=text_size)
    layout = arrange(size, opened)
    rect, hands = layout.columns["settings"], Hands(sim)
    words = hands.panel.panel(rect, layout.text).words
    assert "scene" in words.splitlines()[0]
    room = hands.panel._room(rect)
    assert room >= rect.height / 2 - 1.5 * layout.text
    foot = hands.panel.panel(rect, layout.text).tile.pixels[room:]
    assert (foot[-2:] == style.SURROUND).all() and not (foot == style.SURROUND).all()


def test_a_panel_that_fits_again_is_scrolled_back(sim):
    """A list was scrolled and closed, or the window is higher: there is no bar to scroll it by."""
    hands = Hands(sim)
    hands.panel._unfold("method")
    tall = Rect(0, 0, 250, hands.panel._whole() + hands.panel._foot - 20)
    for low, end in (tall, lambda: hands.keys("escape")), (Rect(0, 0, 250, 200), lambda: None):
        hands.panel.focused = True
        hands.panel.take(Event("wheel", pos=(5, 5), delta=-100), low, HEIGHT)
        assert "scene \u2039" not in hands.panel.panel(low, HEIGHT).words
        end()
        again = hands.panel.panel(tall, HEIGHT)
        assert "scene \u2039" in again.words and "fracture" in again.words


def test_a_drag_on_the_timeline_goes_through_its_frames(sim):
    gone = []
    timeline = Timeline(sim, Controls(sim, None, (800, 600)), None)
    for frame in range(1, 62):
        sim.advance()
        timeline.note(frame)
    row = TimelineRow(timeline, gone.append, lambda: 4)
    chrome = Chrome(windowed=True, status=True, parts=[row])
    assert chrome.toggle("timeline") and chrome.is_open("timeline")
    layout = chrome.layout((900, 600))
    y = layout.row.y + 5
    for event in (
        Event("press", pos=(899, y), button="left"),
        Event("move", pos=(0, 0)),  # outside, but it is the row's until the release
        Event("release", pos=(0, 0), button="left"),
    ):
        assert chrome.take(event, layout, ()) is None
    assert (gone[0], gone[-1]) == (61, 1)
    move = Event("move", pos=(450, 300))
    assert chrome.take(move, layout, ()) is move  # the world's again
    assert "now of 1.0 s   1/4 speed" in row.panel(layout.row, layout.text).words
    assert not chrome.toggle("nothing") and chrome.toggle("timeline")
    assert not chrome.is_open("timeline")


class Pressed(NullView):
    """A window in which keys are pressed, those of each turn at once; it closes after the last.

    turns: of each the names of keys, or events.
    """

    visible = True

    def __init__(self, world, turns):
        super().__init__(world)
        self.turns, self.said = turns, []

    def poll(self):
        keys, *self.turns = self.turns
        self.closed = not self.turns
        return [key if isinstance(key, Event) else Event("press", key=key) for key in keys]

    def draw(self, picture):
        self.said.append("\n".join(panel.words for panel in picture.overlay))


def test_what_a_key_closed_gets_nothing_of_the_same_turn(sim):
    """A slow frame leaves many keys for one turn; the panels are those after each of them."""
    turns = (["l", "m", "o"], ["l", "p", "o", "p"], ["m", "l"], [])
    app.run(sim, Pressed(sim.scene.world, turns), quiet=True, device="test")


def test_what_a_window_has_no_room_for_is_said_where_its_key_is_pressed(sim):
    for key, name in {"m": "meters", "o": "settings", "k": "why", "l": "timeline"}.items():
        window = Pressed(sim.scene.world, ([key], [key], []))
        window.size, window.text_size = (320, 240 if key != "l" else 170), 1.5
        app.run(sim, window, quiet=True, device="test")
        told = [f"{name}: no room here" in said for said in window.said]
        assert told == [False, True, False]
        window = Pressed(sim.scene.world, ([key], []))
        app.run(sim, window, quiet=True, device="test")
        assert not any("no room" in said for said in window.said)


def test_what_was_told_leaves_the_settings_foot_after_a_while(sim, monkeypatch):
    """Later than the row of the status, which is read sooner; what is told anew is there anew."""
    now = [0.0]
    monkeypatch.setattr(sim, "_watch", None)  # whose launches would take no time
    monkeypatch.setattr(app.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(app.time, "sleep", lambda _: None)

    class Seen(Pressed):
        def draw(self, picture):
            now[0] += 1.0
            panels = [panel.words for panel in picture.overlay]
            foot = next((words for words in panels if "cost now" in words), "").splitlines()[-1:]
            self.said.append(["cut springs" in "".join(some) for some in (foot, panels)])

    window = Seen(sim.scene.world, (["c"], *[[]] * 4, ["o"], *[[]] * 9, ["c"], ["c"], []))
    window.size = (900, 600)
    app.run(sim, window, quiet=True, device="test")
    in_foot, anywhere = (
        "".join("-x"[told] for told in seen) for seen in zip(*window.said, strict=True)
    )
    assert (in_foot, anywhere) == ("-------xxxxx------x", "--xxxx-xxxxx------x")


def test_the_same_words_are_told_again(sim, monkeypatch):
    """As where a second click is refused for what the first one was, a while later."""
    now = [0.0]
    monkeypatch.setattr(app.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(app.time, "sleep", lambda _: None)
    monkeypatch.setattr(sim, "_watch", None)

    class Seen(Pressed):
        def draw(self, picture):
            now[0] += 1.0
            super().draw(picture)

    beside = [Event(kind, pos=(9.0, 300.0), button="left") for kind in ("press", "release")]
    turns = ["n"], *[[]] * 4, beside, *[[]] * 6, beside, beside, *[[]] * 6
    window = Seen(sim.scene.world, turns)
    window.size = (1600, 600)
    app.run(sim, window, quiet=True, device="test")
    told = "".join("-x"["outside the world" in said] for said in window.said)
    assert told.strip("-") == "xxxx---xxxxx" and told.endswith("-")


def test_escape_closes_what_was_opened_last_and_quits_where_nothing_is_open(sim):
    """The key list lies over a row of the settings that takes keys, and goes before it."""
    window = Pressed(sim.scene.world, ())
    window.size = (900, 600)
    opened = Parts(bar=True, strip=1, row="timeline", columns=("settings", "meters"))
    place = arrange(window.size, opened).columns["settings"]
    row = Event("press", pos=(place.x + 20, place.y + 5), button="left")
    escape = ["escape"]
    window.turns = ["m"], ["l"], ["o"], [row, "tab"], *[escape] * 6, *[["p"]] * 9, []
    result = app.run(sim, window, quiet=True, device="test")
    words = {"m": "h\u00b7omega", "l": "of 0.", "o": "cost now", "t": "this list"}
    seen = ["".join(key for key in words if words[key] in said) for said in window.said]
    # From its start on; the list, the row, then the panels; the sixth escape quits.
    assert seen == ["", "m", "ml", "mlo", "mlot", "mlo", "mlo", "ml", "m", ""]
    assert result.quit and len(window.turns) == 10


def test_the_key_list_lies_over_panels_and_legends_where_there_is_no_room_beside_them(sim):
    """In letters as large as without them, up to its end or the line that says there is more."""
    lists = []
    for size in (640, 480), (320, 240):
        for opened in ["o", "m", "e"], []:
            window = Pressed(sim.scene.world, (opened, ["tab"], []))
            window.size = size
            window.draw = lambda picture: lists.append(picture.overlay[-1])
            app.run(sim, window, quiet=True, device="test")
    found = [lists[2::3][n] for n in range(4)]
    assert ["this list" in one.words for one in found] == [True, True, False, False]
    assert "larger window" in found[2].words
    for beside, alone in (found[:2], found[2:]):
        assert beside.words == alone.words
        np.testing.assert_array_equal(beside.tile.pixels, alone.tile.pixels)


def test_keys_write_a_checkpoint_and_export_the_last_seconds(sim, tmp_path):
    """Pressed after 3 frames and after 5: what is read back is the run as it was then."""

    seen = []
    window = Pressed(sim.scene.world, ([], [], [], ["w"], [], ["x"], []))
    window.size = (400, 300)  # in which the notice of what was saved before leaves no room
    app.run(
        sim, window, pictures=str(tmp_path), quiet=True, device="test",
        on_frame=lambda s: seen.append(s.positions()),
    )  # fmt: skip
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "cloth-1.checkpoint.npz", "cloth-1.seconds.npz",
    ]  # fmt: skip
    sim.restore(Checkpoint.load(tmp_path / "cloth-1.checkpoint.npz"))
    assert sim.frame == 3 and sim.positions().tobytes() == seen[3].tobytes()
    saved = load_trajectory(tmp_path / "cloth-1.seconds.npz")
    assert saved.frame.tolist() == [1, 2, 3, 4, 5]
    assert np.array_equal(saved.position, np.array(seen[1:6]))
    exporting = [n for n, words in enumerate(window.said) if "exporting the last 10" in words]
    assert len(exporting) == 1 and "saved" in window.said[exporting[0] + 1]
