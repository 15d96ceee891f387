"""Real windows, driven by a real pointer and keyboard: what the user does is what happens.

The windows run in processes of their own under Xvfb, driven by xdotool; both are skipped where
these programs are missing. What a window did is read from its interaction log and its picture.
"""

import ctypes
import itertools
import json
import os
import re
import subprocess
import sys
import textwrap
import time
from dataclasses import replace as changed
from types import SimpleNamespace

import numpy as np
import pytest
from commands import PROGRAM as PROGRAM_LINE
from commands import command
from lacking import VIEWS, needs_vulkan, needs_x
from null_view import NullView
from screens import end_server, virtual_screen, wait_for
from selection import as_thorough

from taichi_cloth import runtime
from taichi_cloth.errors import InputError
from taichi_cloth.files import trajectory as trajectories
from taichi_cloth.render import style
from taichi_cloth.render.camera import Camera
from taichi_cloth.render.drawing import Cached
from taichi_cloth.render.picture import Rect
from taichi_cloth.render.window_map import Look, WindowMap
from taichi_cloth.scene import library
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.scene.palette import COLOR_CYCLE
from taichi_cloth.simulation.diagnostics import Work
from taichi_cloth.ui import app, hud, text, tools, x11
from taichi_cloth.ui.camera_moves import ZOOM_STEP
from taichi_cloth.ui.chrome import messages, strip, toolbar
from taichi_cloth.ui.chrome.chrome import Chrome, Contents
from taichi_cloth.ui.chrome.layout import bar_height, text_height
from taichi_cloth.ui.chrome.strip import Row
from taichi_cloth.ui.chrome.toolbar import Button
from taichi_cloth.ui.controls import Controls
from taichi_cloth.ui.framing import camera_of_world
from taichi_cloth.ui.inputs import Event, fewest_moves
from taichi_cloth.ui.presentation import Presentation
from taichi_cloth.ui.presenters.ggui import GguiPresenter
from taichi_cloth.ui.scenes import Scenes
from taichi_cloth.ui.text import Word


class FakeSimulation:
    """What `app` and `Controls` use of a Simulation, remembering the calls."""

    method, dt, substeps, execution = "symplectic_euler", 1.0, 1, "serial"
    topology, lanes, wide, way = "graph", 1, False, "serial graph"
    held_up, changes_over, follows, aside = None, False, False, ""
    solver = {}

    def __init__(self, scene):
        self.scene, self.frame, self.calls = scene, 0, []
        self.prepared = 0
        self.storage = SimpleNamespace(loads=0, altered=False, scene=scene)
        self.x, self.pairs = list(scene.particles.position), []

    def held(self):
        return None

    def checkpoint(self):
        return SimpleNamespace(frame=self.frame, arrays=lambda: [])

    def let_go(self):
        self.calls.append(("let_go",))

    def prepare_clicks(self):
        self.prepared += 1

    time = property(lambda self: self.frame * self.dt)
    particle_count = property(lambda self: len(self.x))
    spring_count = property(lambda self: len(self.pairs))

    def work(self):
        return Work(steps=self.frame, force_evaluations=self.frame, sweeps=0, unconverged=0)

    def unsettled(self):
        return 0

    def unguarded(self):
        return 0

    def at_rest(self):
        return False

    def advance(self, frames=1):
        self.calls.append(("advance", frames))
        self.frame += frames

    def spawn(self, position, velocity=None, *, fixed=False, color=None, tied_to=None):
        self.calls.append(("spawn", tuple(position), velocity, fixed, color, tied_to))
        self.x.append(position)
        if tied_to is not None:
            self.pairs.append((tied_to, len(self.x) - 1))
        return len(self.x) - 1

    def blow(self, pointer, displacement, reach):
        reach = () if reach is None else (reach,)
        self.calls.append(("blow", tuple(pointer), tuple(displacement), *reach))

    def blow_ray(self, origin, direction, displacement, reach):
        reach = () if reach is None else (reach,)
        self.calls.append(
            ("blow_ray", tuple(origin), tuple(direction), tuple(displacement), *reach)
        )

    def reset(self):
        self.frame, self.x, self.pairs = 0, list(self.scene.particles.position), []

    def drawn_positions(self):
        return np.array(self.x).reshape(-1, self.scene.world.dim)

    positions = drawn_positions

    def radii(self):
        return np.full(len(self.x), 30.0)

    def colors(self):
        return np.full((len(self.x), 3), 200, np.uint8)

    def drawn_springs(self):
        return np.array(self.pairs, np.int64).reshape(-1, 2)

    def drawn_triangles(self):
        return self.scene.triangles

    triangles = drawn_triangles

    def fixed(self):
        return np.zeros(len(self.x), bool)


def world(mouse, dim=2, size=(600.0, 400.0, 500.0)):
    return World(size=size[:dim], gravity=(0.0,) * dim, mouse=mouse)


NO_ONE = {dim: Particles.none(dim) for dim in (2, 3)}


def simulation(mouse, dim=2):
    return FakeSimulation(Scene("fake", world(mouse, dim), Particles.none(dim)))


def press(button=None, pos=None, key=None):
    return Event("press", pos=pos, button=button, key=key)


def calls(sim, kind):
    return [call for call in sim.calls if call[0] == kind]


# Tools


def test_the_first_position_blows_nothing_and_later_ones_their_displacement():
    sim = simulation("blow")
    tools = Controls(sim, None, (600, 400))
    for moves in [[(10, 20)], [(30, 25)], [], [(31, 26), (40, 30)]]:
        for pos in moves:
            tools.apply(Event("move", pos=pos))
        tools.before_frame()
    assert calls(sim, "blow") == [
        ("blow", (30.0, 25.0), (20.0, 5.0)),
        ("blow", (40.0, 30.0), (10.0, 5.0)),
    ]


def test_a_larger_window_scales_the_blow():
    sim = simulation("blow")
    tools = Controls(sim, None, (1200, 1000))  # scale 2, 100 pixels of surround above and below
    for pos in [(100, 300), (120, 300)]:
        tools.apply(Event("move", pos=pos))
        tools.before_frame()
    assert calls(sim, "blow") == [("blow", (60.0, 100.0), (10.0, 0.0))]


def test_in_3d_the_pointers_ray_blows():
    sim = simulation("blow", 3)
    camera = Camera((600, 400, 500), rot_x=0, rot_y=0)
    tools = Controls(sim, camera, (600, 400))
    for pos in [(300, 200), (310, 200)]:
        tools.apply(Event("move", pos=pos))
        tools.before_frame()
    ((_, origin, direction, displacement),) = calls(sim, "blow_ray")
    assert origin == pytest.approx((300, 200, -2000))
    assert displacement == pytest.approx((20, 0, 0))  # 10 pixels at twice the focal length
    assert direction == pytest.approx(np.array([0.01, 0, 1]) / np.hypot(0.01, 1))


def test_in_metres_the_pointer_reaches_an_eighth_of_the_picture():
    """Where a unit is no pixel: y points up, or there are few of them; nearer, less far."""
    for size, up in (((6.0, 4.0), "y"), ((6.0, 4.0), ""), ((600.0, 400.0), "y")):
        sim = FakeSimulation(Scene("fake", changed(world("blow", size=size), up=up), NO_ONE[2]))
        tools = Controls(sim, None, (600, 400))
        for pos in [(300, 200), (330, 200)]:
            tools.apply(Event("move", pos=pos))
            tools.before_frame()
        ((_, _, moved, reach),) = calls(sim, "blow")
        assert moved == pytest.approx((size[0] / 20, 0))
        assert reach == pytest.approx(size[1] / 8)
    space = changed(world("blow", 3, (6.0, 4.0, 5.0)), up="y")
    sim = FakeSimulation(Scene("fake", space, NO_ONE[3]))
    camera = camera_of_world(space)
    tools = Controls(sim, camera, (600, 400))
    for pos in [(300, 200), (330, 200), (360, 200)]:
        tools.apply(Event("move", pos=pos))
        tools.before_frame()
        tools.apply(Event("wheel", pos=pos, delta=1.0))
    first, then = (call[-1] for call in calls(sim, "blow_ray"))
    # What lies at the camera's centre an eighth of the picture's height away is at the reach's end.
    up = camera.rotation()[1]
    pixels, _, _ = camera.project(np.stack([camera.centre, camera.centre + then / ZOOM_STEP * up]))
    assert np.ptp(pixels[:, 1]) == pytest.approx(4.0 / 8)
    assert first == pytest.approx(then * ZOOM_STEP)


def test_clicks_spawn_what_they_say():
    sim = simulation("spawn", 3)
    camera = Camera((600, 400, 500))
    tools = Controls(sim, camera, (600, 400), seed=5)
    tools.apply(press("left", (300, 200)))
    tools.apply(press("right", (320, 210)))
    tools.apply(press("middle", (320, 210)))
    free, fixed = calls(sim, "spawn")
    expected = np.random.default_rng(5).uniform((-10, -10, 0), (10, 0, 10))
    np.testing.assert_array_equal(free[2], expected)
    assert (
        free[1] == pytest.approx((300, 200, 0)) and free[3] is False and free[4] == COLOR_CYCLE[0]
    )
    assert fixed[1] == pytest.approx(camera.unproject((320, 210)))
    assert fixed[2] is None and fixed[3] is True and fixed[4] == (128, 128, 128)


def test_space_ties_each_new_particle_to_the_one_before():
    sim = simulation("spawn")
    tools = Controls(sim, None, (600, 400))
    tools.apply(press("left", (100, 100)))
    assert tools.apply(press(key="space")) is None  # the chain key does not pause here
    for x in (200, 300):
        tools.apply(press("left", (x, 100)))
    tools.apply(Event("release", key="space"))
    tools.apply(press("left", (400, 100)))
    spawned = calls(sim, "spawn")
    assert [call[5] for call in spawned] == [None, 0, 1, None]
    assert [call[4] for call in spawned] == list(COLOR_CYCLE[:4])


def test_ctrl_turns_and_never_spawns():
    sim = simulation("spawn", 3)
    camera = Camera((600, 400, 500))
    tools = Controls(sim, camera, (600, 400))
    tools.apply(Event("move", pos=(300, 200)))
    tools.apply(press(key="ctrl"))
    tools.apply(Event("move", pos=(330, 190)))
    tools.apply(press("left", (330, 190)))
    tools.apply(Event("release", key="ctrl"))
    tools.apply(Event("move", pos=(0, 0)))
    assert (camera.rot_y, camera.rot_x) == pytest.approx((12.0, 14.0))
    assert not calls(sim, "spawn")


@pytest.mark.parametrize("y_up", [False, True])
@pytest.mark.parametrize("begin", ["press", "turn", "orbit", "ctrl"])
def test_the_side_that_faces_us_follows_the_pointer_also_beyond_the_poles(y_up, begin):
    """But in logs of old and by ctrl, as in the original program: to the side it goes as it did."""
    events = {"press": press("left", (300, 200)), "ctrl": press(key="ctrl")}
    event = events.get(begin) or Event("view", drag=begin)
    for rot_x in (0.0, 40.0, -80.0, 100.0, -120.0, 170.0):
        camera = Camera((600, 400, 500), rot_x=rot_x, rot_y=30.0, y_up=y_up)
        _, away = camera.ray(camera.middle)
        place = camera.centre - 100 * away
        tools = Controls(simulation("blow", 3), camera, (600, 400))
        for one in (Event("move", pos=(300, 200)), event, Event("move", pos=(310, 190))):
            tools.apply(one)
        right, down = camera.project([place])[0][0] - camera.middle
        as_it_was = begin in ("orbit", "ctrl") and abs(rot_x) > 90
        assert down < 0 and (right < 0) == as_it_was, rot_x


def test_wheel_and_keys_change_the_distance():
    camera = Camera((600, 400, 500))
    tools = Controls(simulation("spawn", 3), camera, (600, 400))
    tools.apply(Event("wheel", pos=(1, 1), delta=1))
    assert camera.distance == pytest.approx(2000 / 1.1)
    tools.apply(press(key="-"))
    tools.apply(press(key="down"))
    tools.apply(press(key="+"))
    assert camera.distance == pytest.approx(2000)


def test_the_wheel_comes_nearer_to_what_is_under_the_pointer_and_its_log_says_to_what():
    """To the particle in front there, where one is; a log of old has no such place."""
    near = np.array([300.0, 200.0, -150.0])
    scene = Scene("fake", world("blow", 3), Particles.build([near, near + [60.0, 40.0, 300.0]]))
    camera, recorded = camera_of_world(scene.world), Recorded()
    at = tuple(camera.project([near])[0][0] + [3.0, -2.0])
    wheel = [Event("wheel", pos=at, delta=1.0)] * 3
    view = Script(wheel, wheel, [press(key="+")] * 40, [])
    view.camera = camera
    app.run(FakeSimulation(scene), view, recorder=recorded, status=False, device="test")
    (about,) = {event.about for _, event in recorded if event.kind == "wheel"}
    assert camera.distance == camera.nearest_to_point < 0.1 * camera.nearest
    pixel, _, depth = camera_of_world(scene.world).project([about, near])
    np.testing.assert_allclose(pixel[0], at, atol=1e-9)
    assert depth[0] == pytest.approx(depth[1])
    again = camera_of_world(scene.world)
    tools = Controls(FakeSimulation(scene), again, (600, 400))
    for _, event in recorded[:6]:
        tools.apply(event, replayed=True)
    np.testing.assert_allclose(again.project([about])[0][0], at, atol=1e-9)
    for _, event in recorded[6:]:
        tools.apply(event, replayed=True)
    assert again.pose == camera.pose
    old = camera_of_world(scene.world)
    tools = Controls(FakeSimulation(scene), old, (600, 400))
    for event in [Event("wheel", pos=(5.0, 5.0), delta=1.0), press(key="+")] * 40:
        tools.apply(event, replayed=True)
    np.testing.assert_allclose(old.centre, camera_of_world(scene.world).centre)
    assert old.distance == old.nearest


def test_the_wheel_looks_again_at_what_is_under_the_pointer_after_a_key_came_nearer():
    """For a key comes nearer to the middle, and what was under the pointer no longer is."""
    camera = Camera((600, 400, 500))
    tools = Controls(simulation("blow", 3), camera, (600, 400))
    wheel = Event("wheel", pos=(500.0, 80.0), delta=1.0)
    for _ in range(2):
        aimed = tools.aimed(wheel)
        np.testing.assert_allclose(camera.project([aimed.about])[0][0], wheel.pos, atol=1e-9)
        tools.apply(aimed)
        tools.apply(tools.aimed(press(key="+")))


def test_a_click_outside_the_world_is_said_and_ignored():
    sim = simulation("spawn")
    tools = Controls(sim, None, (1200, 1000))
    tools.apply(press("left", (600, 50)))
    assert not calls(sim, "spawn") and "outside" in tools.notice
    tools.apply(press("left", (600, 500)))
    assert calls(sim, "spawn") and tools.notice is None


def test_the_pin_tool_marks_what_is_pinned():
    """Where surfaces are drawn, nothing else would show that a click pinned something."""
    place = [[100.0, 100.0, 0.0], [200.0, 100.0, 0.0], [300.0, 90.0, 10.0]]
    sim = FakeSimulation(Scene("fake", world("none", 3), Particles.build(place)))
    controls = Controls(sim, Camera((600, 400, 500)), (600, 400))
    pinned = np.array([True, False, True])
    sim.fixed = lambda: pinned
    assert controls.marks() is None
    controls.choose("pin")
    marks = controls.marks()
    assert marks.on.tolist() == [0, 2] and (marks.radius > 0).all() and len(marks.segments) == 0
    np.testing.assert_array_equal(marks.position, np.array(place)[pinned])
    pinned[:] = False
    assert controls.marks() is None


@pytest.mark.parametrize("mouse", ["none", "blow", "spawn"])
def test_every_scene_lists_its_keys(mouse):
    for dim in (2, 3):
        sim = simulation(mouse, dim)
        lines = hud.help_lines(sim.scene, has_wheel=True)
        assert all(line.count("\t") == 1 for line in lines)
        keys = " ".join(line.split("\t")[0] for line in lines)
        assert ("space, p" in keys) == (mouse != "spawn")
        assert ("ctrl" in keys) == (dim == 3)


def test_the_key_list_says_which_drags_a_tool_leaves_to_the_camera():
    """Those whose presses in an empty place are not for it, in planes and in space."""
    for dim, button, does in (
        (3, "left", "turn the scene"), (3, "right", "move the scene"),
        (2, "middle", "move the picture"), (2, "right", "move the picture"),
    ):  # fmt: skip
        for tool in tools.load_all().values():
            sim = simulation("none", dim)
            controls = Controls(sim, camera_of_world(sim.scene.world), (600, 400))
            controls.tool = tool
            lines = hud.help_lines(sim.scene, has_wheel=True, tool=tool)
            said = [line.split("\t")[0] for line in lines if does in line]
            free = not controls.takes(press(button, (10, 10)))
            assert any(f"drag {button}" in how or f"or {button}" in how for how in said) == free


# What is drawn


@pytest.mark.parametrize("topology", [as_thorough("lanes"), "graph"])
def test_what_is_drawn_is_the_simulations(topology, pool):
    sim = pool(library.build("cloth"), topology=topology, execution="parallel")
    x, whole = sim.drawn_positions(), sim.drawn_springs()
    assert len(whole) == 356
    for frame in range(40):
        sim.blow((200 + 5 * frame, 150), (90, 30))
        sim.advance()
        assert sim.drawn_positions() is x
        np.testing.assert_array_equal(x, sim.positions())
        drawn = sim.drawn_springs()
        np.testing.assert_array_equal(drawn, sim.springs()[sim.springs_alive()])
        assert sim.drawn_springs() is drawn, "read again only when a spring broke"
    assert len(drawn) < 356
    sim.reset()
    np.testing.assert_array_equal(sim.drawn_springs(), whole)


def test_what_clicks_add_is_drawn(pool):
    sim = pool(library.build("sandbox"))
    assert sim.drawn_positions().shape == (0, 2) and len(sim.drawn_springs()) == 0
    for count in (1, 2, 3):
        sim.spawn((100.0 * count, 100.0), tied_to=count - 2 if count > 1 else None)
        assert sim.drawn_positions().tolist()[-1] == [100.0 * count, 100.0]
        assert sim.drawn_springs().tolist() == [[i, i + 1] for i in range(count - 1)]


def test_kept_values_follow_what_they_are_made_of():
    made, color = [], np.zeros(2)

    def make(*of):
        made.append(of)
        return len(made)

    kept = Cached(make)
    assert [kept(color, 2.0), kept(color, 1.0 + 1.0)] == [1, 1]
    assert kept(color, 3.0) == 2
    assert kept(np.zeros(2), 3.0) == 3  # an equal array is another one


# The loop


class Script:
    """A view that plays prepared turns of events, and ends with the last."""

    name, visible, has_wheel, camera, room, text_size = "script", True, True, None, None, 1.0
    look = None

    def __init__(self, *turns, size=(600, 400)):
        self.turns, self.size, self.pictures = list(turns), size, []

    closed = property(lambda self: not self.turns)

    def poll(self):
        return self.turns.pop(0)

    def draw(self, picture):
        self.pictures.append(picture)

    def entitle(self, title):
        self.title = title

    def grab(self):
        return np.zeros((400, 600, 3), np.uint8)

    def close(self):
        pass


def words(picture):
    """All that is written over a picture."""
    return "\n".join(panel.words for panel in picture.overlay)


class Log:
    def __init__(self, by_frame, **header):
        self.by_frame, self.header = by_frame, header


class Recorded(list):
    def write(self, frame, event):
        self.append((frame, event))


def test_pause_step_and_reset():
    space, dot, r = press(key="space"), press(key="."), press(key="r")
    sim = simulation("blow")
    view = Script([], [space], [], [dot], [], [r], [space], [], [])
    summary = app.run(sim, view, device="test")
    # Turns advance: yes, paused, no, step, no, reset, resumed, yes; the last closes the window.
    assert summary.frames == 4 and sim.frame == 2
    said = [words(picture).splitlines()[1].split()[0] for picture in view.pictures[:4]]
    assert said == ["starting:", "playing", "paused", "paused"] and "fake, " in view.title


@pytest.mark.parametrize("paused", [False, True])
def test_what_the_pointer_needs_is_compiled_while_the_window_says_that_it_starts(paused):
    sim, view, said = simulation("blow"), Script([], [], []), []
    sim.prepare_clicks = lambda: said.append(words(view.pictures[-1]))
    app.run(sim, view, device="test", paused=paused)
    assert "starting: compiling takes a moment, once" in said[0]
    after = ["paused" if paused else "playing" in words(picture) for picture in view.pictures[1:]]
    assert after and all(after)


def test_a_scene_to_click_into_says_in_the_world_what_clicks_do_until_the_first_one():
    click = press("left", (450, 250))
    view = Script([], [press(key="p")], [click], [], [], size=(900, 500))
    app.run(simulation("spawn"), view, device="test")
    told = ["right click" in words(picture) for picture in view.pictures]
    assert told == [True, True, True, False, False]
    blows = Script([], [], size=(900, 500))
    app.run(simulation("blow"), blows, device="test")
    assert not any("right click" in words(picture) for picture in blows.pictures)
    small = Script([], [], size=(120, 60))  # where they have no room
    app.run(simulation("spawn"), small, device="test")


def test_help_hide_and_quit():
    escape = press(key="escape")
    view = Script([press(key="f1")], [press(key="h")], [escape], [escape], [], [])
    summary = app.run(simulation("blow"), view, device="test")
    assert summary.quit and summary.frames == 3
    panels = [[panel for panel in picture.overlay if panel.words] for picture in view.pictures[:2]]
    assert [len(shown) for shown in panels] == [2, 3]
    assert "this list" in words(view.pictures[1]) and "symplectic" not in words(view.pictures[1])
    assert "symplectic" in words(view.pictures[2])
    assert "this list" not in words(view.pictures[3])  # escape has closed it


def test_a_click_on_the_key_list_closes_it_and_is_for_nothing_behind_it(tmp_path):
    sim, help_, click = simulation("spawn"), press(key="f1"), press("left", (450, 250))
    beside, film = press("left", (880, 250)), press(key="v")
    view = Script([help_], [beside], [click], [click], [], size=(900, 500))
    app.run(sim, view, device="test")
    listed = ["this list" in words(picture) for picture in view.pictures]
    assert listed == [False, True, True, False, False]
    assert len(calls(sim, "spawn")) == 1 and "outside" not in words(view.pictures[-1])
    # A film has no list in it, and its clicks are the world's.
    view = Script([help_], [film], [click], [], [], size=(900, 500))
    view.grab = lambda: np.zeros((500, 900, 3), np.uint8)
    app.run(sim, view, pictures=str(tmp_path), quiet=True, device="test")
    assert len(calls(sim, "spawn")) == 2


def test_the_ring_around_the_pointer_is_not_drawn_over_the_key_list():
    over, beside, help_ = (
        Event("move", pos=(450, 250)),
        Event("move", pos=(880, 250)),
        press(key="f1"),
    )
    view = Script([over], [help_], [beside], [], size=(900, 500))
    app.run(simulation("blow"), view, device="test")
    assert [one.pointer is not None for one in view.pictures[1:]] == [True, False, True]


def test_a_picture_shows_no_pointer_and_a_film_does(tmp_path):
    over = Event("move", pos=(450, 250))
    view = Script([over], [press(key="s")], [press(key="v")], [], [], size=(900, 500))
    app.run(simulation("blow"), view, pictures=str(tmp_path), quiet=True, device="test")
    shown = [one.pointer is not None for one in view.pictures[1:]]
    assert shown == [True, False, True, True, True][: len(shown)] and len(shown) > 3
    assert list(tmp_path.glob("*.png"))


def test_a_picture_of_a_replay_shows_no_pointer(tmp_path):
    drawn = []
    view = NullView(world("blow"), (600, 400))
    view.draw = drawn.append
    view.grab = lambda: np.zeros((400, 600, 3), np.uint8)
    log = Log({0: [Event("move", pos=(300.0, 200.0))]}, window=(600, 400))
    image, film = str(tmp_path / "last.png"), str(tmp_path / "film.gif")
    app.run(simulation("blow"), view, frames=2, replay=log, image=image, device="test")
    assert drawn[-1].pointer is None
    log = Log({0: [Event("move", pos=(300.0, 200.0))]}, window=(600, 400))
    app.run(simulation("blow"), view, frames=2, replay=log, film=film, device="test")
    assert drawn[-1].pointer.cross


def test_a_picture_that_a_key_takes_is_as_large_as_the_window_whatever_is_open(tmp_path):
    from PIL import Image

    keys = [press(key=key) for key in "lks"]
    view = Script(keys, [], [], [], size=(900, 600))
    view.grab = lambda: np.zeros((600, 900, 3), np.uint8)
    app.run(simulation("blow"), view, pictures=str(tmp_path), quiet=True, device="test")
    (picture,) = tmp_path.iterdir()
    assert Image.open(picture).size == (900, 600)
    assert "nothing has failed" in words(view.pictures[-1])  # they are still open
    taken = [one for one in view.pictures if not one.overlay]
    assert len(taken) == 1 and taken[0].pointer is None


def test_the_ring_goes_where_the_pointer_leaves_the_world():
    """Onto the bar, or out of the window; a drag that goes on there keeps it."""
    inside, bar = Event("move", pos=(450, 250)), Event("move", pos=(450, 5))
    view = Script([inside], [bar], [inside], [Event("leave")], [inside], [], size=(900, 500))
    app.run(simulation("blow"), view, device="test")
    rings = [bool(one.pointer and one.pointer.ring) for one in view.pictures[1:]]
    assert rings == [True, False, True, False, True]


def test_escape_puts_the_tool_away_before_it_quits():
    escape = press(key="escape")
    view = Script([press(key="i")], [press(key="l")], [escape], [escape], [escape], [], [])
    recorded = Recorded()
    summary = app.run(simulation("blow"), view, recorder=recorded, device="test")
    tools_said = [event.name for _, event in recorded if event.kind == "tool"]
    assert tools_said == ["pin", ""] and summary.quit and summary.frames == 4


@pytest.mark.parametrize("dim", [2, 3])
def test_home_is_the_view_of_the_start(dim):
    view = Script([press(key="+")] * 3, [press(key="home")], [press(key="z")], [], [])
    view.camera = camera = camera_of_world(world("blow", dim))
    seen = []
    view.draw = lambda picture: seen.append(camera.pose if camera else view.look)
    sim = FakeSimulation(Scene("fake", world("blow", dim), NO_ONE[dim]))
    app.run(sim, view, device="test")
    first, nearer, home, back = seen[:4]
    assert first == home and nearer == back != home


def test_strain_has_colours_only_where_there_are_springs():
    place = [[100.0, 100.0], [200.0, 100.0]]
    tied = Scene("tied", world("blow"), Particles.build(place), Springs.build([(0, 1)], place))
    for scene, expected in ((simulation("blow").scene, [False] * 4), (tied, [False, True] * 2)):
        sim = FakeSimulation(scene)
        sim.pairs = [(0, 1)] * len(scene.springs)
        sim.springs_alive = lambda: np.ones(1, bool)
        view = Script([], [press(key="e")], [press(key="e")], [press(key="e")], [])
        app.run(sim, view, device="test")
        assert ["pulled" in words(picture) for picture in view.pictures[1:]] == expected


def test_strain_is_offered_as_soon_as_a_spring_was_clicked_in():
    sim, help_, click = simulation("spawn"), press(key="f1"), press("left", (300, 600))
    view = Script([help_], [help_, press(key="space")], [click], [click], [help_], [])
    view.size = (1400, 900)
    app.run(sim, view, device="test")
    said = [words(picture) for picture in view.pictures]
    assert len(sim.pairs) == 1
    assert ["e strain" in one for one in said] == [False] * 4 + [True] * 2
    assert ["colours of strain" in one for one in said] == [False] * 5 + [True]
    assert "this list" in said[1]


def test_pictures_of_the_world_have_no_key_list_over_it_and_films_neither(tmp_path):
    keys = "f1", "s", None, "v", None, "p", "p", "v", None
    view = Script(*([press(key=key)] if key else [] for key in keys), [], size=(900, 500))
    view.grab = lambda: np.zeros((500, 900, 3), np.uint8)
    app.run(simulation("blow"), view, pictures=str(tmp_path), quiet=True, device="test")
    listed = ["this list" in words(picture) for picture in view.pictures[1:]]
    assert listed == [True, False, True, False, False, True, False, True, True]
    assert len(list(tmp_path.iterdir())) == 2


def test_a_recorded_run_replays_exactly():
    clicks = [
        [Event("move", pos=(100, 100)), press("left", (100, 100))],
        [press(key="p")],
        [press("left", (200, 50))],
        [press(key=".")],
        [press(key="p"), press(key="space")],
        [press("left", (300, 50))],
        [press(key="r")],
        [press("right", (100, 60))],
        [],
        [],
    ]
    live, recorded = simulation("spawn"), Recorded()
    view = Script(*clicks)
    summary = app.run(live, view, recorder=recorded, status=False, seed=3, device="test")
    by_frame = {}
    for frame, event in recorded:
        by_frame.setdefault(frame, []).append(event)
    again = simulation("spawn")
    replay = Log(by_frame, window=[600, 400], seed=3)
    app.run(again, NullView(again.scene.world), frames=summary.frames, replay=replay, device="test")
    assert repr(again.calls) == repr(live.calls)


def advances(sim, view, frames, **asked):
    """How many frames the run asked for at once, each time."""
    app.run(sim, view, frames=frames, quiet=True, device="test", **asked)
    return [call[1] for call in calls(sim, "advance")]


def test_frames_that_nothing_looks_at_are_made_together():
    sim = simulation("spawn")
    log = Log({40: [press("left", (100, 100))]}, window=[600, 400], seed=3)
    made = advances(sim, NullView(sim.scene.world), 300, replay=log)
    assert sum(made) == 300 and max(made) > 1 and set(made[:41]) == {1}
    (spawned,) = (n for n, call in enumerate(sim.calls) if call[0] == "spawn")
    assert sim.calls[:spawned] == [("advance", 1)] * 40


@pytest.mark.parametrize("looks", ("trajectory", "on_frame", "budget", "film"))
def test_each_frame_is_made_by_itself_where_something_looks(looks, tmp_path):
    sim, seen = simulation("spawn"), []
    view = Script(*[[]] * 31) if looks == "film" else NullView(sim.scene.world)
    view.visible = False
    note = lambda *_: seen.append(sim.frame)  # noqa: E731
    asked = {
        "trajectory": SimpleNamespace(record=note),
        "on_frame": note,
        "budget": SimpleNamespace(chosen="1%", before_frame=note, after_frame=lambda *_: None),
        "film": str(tmp_path / "film.gif"),
    }
    assert advances(sim, view, 30, **{looks: asked[looks]}) == [1] * 30
    assert len(seen) == (0 if looks == "film" else 30)


def test_a_resized_window_records_in_the_first_windows_pixels():
    recorded, sim = Recorded(), simulation("spawn")
    view = Script([press("left", (100, 100))], [press("left", (200, 200))], [])
    poll = view.poll

    def resized():
        events = poll()
        if len(view.turns) == 1:
            view.size = (1200, 800)
        return events

    view.poll = resized
    app.run(sim, view, recorder=recorded, status=False, device="test")
    assert [event.pos for _, event in recorded] == [(100, 100), (100.0, 100.0)]
    assert [call[1] for call in calls(sim, "spawn")] == [(100.0, 100.0)] * 2


def test_a_failure_pauses_a_window_and_is_raised_without_one():
    from taichi_cloth.errors import SimulationFailure

    def fail(frames=1):
        raise SimulationFailure(3, 7, "is not finite", "dt too large", "halve dt")

    sim = simulation("blow")
    advance, sim.advance = sim.advance, fail
    view = Script([], [press(key="p")], [press(key="r")], [], [])
    poll = view.poll

    def repaired():
        if len(view.turns) == 3:
            sim.advance = advance
        return poll()

    view.poll = repaired
    summary = app.run(sim, view, device="test")
    said = [words(picture) for picture in view.pictures[1:]]
    assert "particle 3" in said[0] and "r goes back" in said[1] and "stopped" in said[1]
    assert "particle 3" not in said[2] and summary.frames == 2
    sim.advance = fail
    with pytest.raises(SimulationFailure):
        app.run(sim, NullView(sim.scene.world), frames=5, device="test")


def test_the_meter_says_how_late_it_is():
    now = [0.0]
    meter = hud.Meter(clock=lambda: now[0])
    for _ in range(31):
        meter.frame(0.05, 0.04)
        now[0] += 0.1
    assert meter.frames_per_second == pytest.approx(10)
    assert meter.behind == pytest.approx(3 - 30 / 60)
    said = " ".join(word.text for word in hud.rates(meter))
    assert "behind real time (0.17x)" in said and "50.00 ms" in said
    meter.compiles()
    meter.frame(20.0, 0.04)
    assert meter.behind == pytest.approx(3 - 30 / 60) and meter.simulate == 0.0
    now[0] += 0.1
    meter.frame(0.06, 0.04)
    assert meter.behind == pytest.approx(3.1 - 31 / 60) and meter.simulate == 0.06
    for rate, words in ((0.4, "0.4"), (1.0, "1.0"), (9.96, "10"), (59.7, "60")):
        assert hud.rates(paced_at(rate))[0].text == f"{words} frames/s"


def paced_at(rate):
    """A meter that has seen frames come at a rate."""
    now = [0.0]
    meter = hud.Meter(clock=lambda: now[0])
    for _ in range(4):
        meter.frame(0.0, 0.0)
        now[0] += 1 / rate
    return meter


def paced(meter, now, seconds, simulate, draw):
    """Have a meter see frames that take so long to simulate and to draw, one after the other."""
    for _ in range(round(seconds / max(simulate + draw, 1 / 60))):
        meter.frame(simulate, draw)
        now[0] += max(simulate + draw, 1 / 60)


def test_a_window_that_is_late_says_what_would_be_faster():
    """By what takes the time; not at once, not of frames in time or held up by something else."""
    now = [0.0]

    def said(simulate, draw, *, seconds=4.0, shortens=True, before=0.0):
        meter = hud.Meter(clock=lambda: now[0])
        paced(meter, now, 1.0, 0.005, 0.005)
        paced(meter, now, before, 3.0, 0.001)  # which compiles
        paced(meter, now, seconds, simulate, draw)
        word = hud.faster(meter, shortens=lambda: shortens)
        return word.text if word else ""

    assert said(0.004, 0.02) == "faster: smaller window"
    assert said(0.02, 0.004) == "faster: hold 60fps (o)"
    assert said(0.02, 0.004, shortens=False) == ""
    assert said(0.005, 0.006) == said(0.004, 0.02, seconds=1.5) == ""
    assert said(0.005, 0.006, seconds=0.5, before=3.0) == ""
    meter = hud.Meter(clock=lambda: now[0])
    for _ in range(60):  # another program has the processor
        meter.frame(0.004, 0.004)
        now[0] += 0.1
    assert meter.late > hud.LATE
    assert hud.faster(meter, shortens=lambda: True) is None
    paced(meter, now, 4.0, 0.02, 0.01)
    assert hud.faster(meter, shortens=lambda: True) is not None
    meter.interrupt()
    assert meter.late == 0 and hud.faster(meter, shortens=lambda: True) is None


@pytest.mark.parametrize("size", [(800, 600), (1024, 768), (1280, 800), (1920, 1080), (2560, 1440)])
def test_what_would_be_faster_fits_and_pushes_out_nothing_that_matters(size):
    now, sim = [0.0], simulation("blow")
    meter, height = hud.Meter(clock=lambda: now[0]), text_height(size[1])
    paced(meter, now, 4.0, 0.004, 0.03)
    advice = hud.faster(meter, shortens=lambda: True)
    (with_it, _), (without, _) = (
        hud.status_rows(
            sim, "test", state=Word("playing", style.GOOD), tool="blow",
            rates=hud.rates(meter, said),
        )
        for said in (advice, None)
    )  # fmt: skip
    fitted = [
        [*itertools.chain(*text.fitted(row.left, row.right, size[0], height))]
        for row in (with_it, without)
    ]
    more_important = [word for word in fitted[1] if word.rank < advice.rank]
    assert [word for word in fitted[0] if word.rank < advice.rank] == more_important
    assert advice in fitted[0]


def frames_said(pictures):
    """The frame that each picture's status says."""
    return [int(re.search(r"frame (\d+)", words(picture))[1]) for picture in pictures]


def test_the_status_is_that_of_the_frame_drawn(tmp_path):
    view = Script([], [press(key="h")], *[[] for _ in range(6)], size=(1400, 800))
    app.run(simulation("blow"), view, device="test")
    assert frames_said(view.pictures[2:]) == [2, 3, 4, 5, 6, 7]
    assert ["h none" in words(view.pictures[turn]) for turn in (0, 2)] == [False, True]
    runs = []
    for name in ("a", "b"):
        view = Script([], [])
        view.visible, view.poll = False, list
        app.run(
            simulation("blow"), view, frames=5, film=tmp_path / f"{name}.gif",
            image=tmp_path / f"{name}.png", quiet=True, device="test",
        )  # fmt: skip
        runs.append([words(picture) for picture in view.pictures])
        assert frames_said(view.pictures) == [1, 2, 3, 4, 5, 5]  # the last one is the picture
        time.sleep(0.01)  # what a rate would show
    assert runs[0] == runs[1]
    said = " ".join(runs[0])
    assert "/s" not in said and " ms" not in said and "tab" not in said
    view = Script([], [press(key="h")], [])
    app.run(simulation("blow"), view, status=False, device="test")
    assert [bool(picture.overlay) for picture in view.pictures] == [False, False, True]


def test_the_status_says_that_threads_which_were_asked_for_only_wait(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(app.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(app.time, "sleep", lambda _: None)
    sim = simulation("blow")
    advance = sim.advance

    def held_up_once(frames=1):
        advance(frames)
        now[0] += 1.0
        if sim.frame == 2:
            sim.held_up = (1e-3, 5e-3)

    sim.advance = held_up_once
    view = Script(*[[] for _ in range(9)], size=(1400, 800))
    app.run(sim, view, device="test")
    waits = ["threads wait" in words(picture) for picture in view.pictures[1:]]
    assert waits == [False, True, True, True, True, False, False, False]


def test_a_window_says_that_it_waits_where_a_run_changes_over_to_one_thread(monkeypatch):
    """Before it stands still; how long that took is in no rate."""
    now = [0.0]
    monkeypatch.setattr(app.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(app.time, "sleep", lambda _: None)
    sim = simulation("blow")
    advance = sim.advance

    def changing_over(frames=1):
        now[0] += 20.0 if sim.changes_over else 0.1
        advance(frames)
        sim.changes_over = sim.frame == 4

    sim.advance = changing_over
    view = Script(*[[] for _ in range(12)], size=(1400, 800))
    app.run(sim, view, device="test")
    said = [words(picture) for picture in view.pictures]
    waits = ["compiling, the window waits" in picture for picture in said]
    assert waits == [picture == 5 for picture in range(len(said))]
    assert "simulate 20000" not in "".join(said) and "simulate 100.00 ms" in said[-2]


def test_r_goes_on_with_the_scene_as_its_edited_file_says_by_now():
    """Paused or not, and with the tool that was in hand; a file that says none is told of."""
    made, found = [], []
    scenes = Scenes(edited=lambda: found.pop(0)(), file="own.toml")

    def again():
        made.append("again")
        scenes.said = "read own.toml anew"

    def refuse():
        raise InputError("own.toml line 3: is not TOML")

    found += [lambda: None, refuse, lambda: refuse, lambda: again]
    turns = [press(key="g")], [press(key="p")], *([press(key="r")] for _ in range(4))
    noted, view = Recorded(), Script([], *turns, [], [])
    sim = FakeSimulation(Scene("fake", changed(world("blow"), tools=True), NO_ONE[2]))
    asked = {"scenes": scenes, "recorder": noted, "device": "test"}
    app.run(sim, view, **asked)
    assert made == ["again"] and len(view.turns) == 2  # which are for the next run
    said = [words(picture) for picture in view.pictures]
    assert not any("own.toml" in picture for picture in said[:4])
    assert "not read anew: own.toml line 3: is not TOML" in said[5]
    assert "own.toml was not opened: own.toml line 3: is not TOML" in said[-2]
    assert "opening own.toml" in said[-1]
    resets = sum(event.key == "r" for _, event in noted if event.kind == "press")
    assert resets == 3  # what goes on is another run, with a log of its own
    assert (scenes.paused, scenes.tool) == (True, "grab")
    noted.clear()
    view = Script([], [press(key="tab")], [], size=(1200, 900))
    app.run(sim, view, **asked)
    said = [words(picture) for picture in view.pictures]
    assert "paused" in said[-1] and "grab" in said[-1] and "read own.toml anew" in said[0]
    assert "r\tback to the start; reads an edited file" in said[-1]
    assert [(frame, event.kind) for frame, event in noted][:1] == [(0, "tool")]

    scenes.fixed = "a log is replayed here"  # which is of the scene that there was
    app.run(sim, Script([press(key="r")], [press(key="r")], []), **asked)
    assert made == ["again"]


def test_a_reset_says_that_it_shortens_what_is_saved():
    """By `--save` or `--export`, or by a script."""

    class Noted:
        frames = 0

        def record(self, sim):
            self.frames += 1

    view = Script([], [], [press(key="f1")], [press(key="r")], [])
    app.run(simulation("blow"), view, trajectory=Noted(), device="test")
    assert "r\tback to the start; what is saved begins anew" in words(view.pictures[3])
    assert "makes files forget 3 frames" in words(view.pictures[4])
    view = Script([], [press(key="r")], [])
    app.run(simulation("blow"), view, device="test")
    assert "saved" not in words(view.pictures[-1])


def test_events_come_in_order_with_the_last_of_several_moves():
    a, b, c = (Event("move", pos=(n, n)) for n in (1, 2, 3))
    click = press("left", (2, 2))
    assert fewest_moves([a, b, click, a, c]) == [b, click, c]


# Text


def test_what_is_around_the_world_fits():
    for size in ((600, 400), (1400, 900), (200, 150)):
        chrome = Chrome(windowed=True, status=True)
        chrome.next_status()
        layout = chrome.layout(size)
        row = Row((Word("playing", (9, 200, 9)), Word("192 particles", (200, 9, 9), 2)))
        buttons = tuple(Button(key, "a tool", chosen=key == "b") for key in "abcdefg")
        keys = ("r\treset", "escape\tquit")
        contents = Contents((row, row), buttons, keys, "a long message " * 20)
        panels = chrome.overlay(layout, contents)
        assert panels == chrome.overlay(layout, contents)
        said = [panel.words for panel in panels if panel.words]
        assert len(said) == 4 and said[1] == "playing   192 particles\nplaying   192 particles"
        for panel in panels:
            h, w = panel.tile.pixels.shape[:2]
            assert panel.x >= 0 and panel.y >= 0
            assert panel.x + w <= size[0] and panel.y + h <= size[1]


def test_words_of_the_status_are_those_written_on_its_paper_as_a_whole():
    """At any size, also where a word has to be cut off; the next status has the same tiles."""
    left = [Word("playing", (9, 200, 9)), Word("grab: take hold of a gypsy", (200, 9, 9), 2)]
    for width, height, count in ((600, 12, 2), (1280, 15, 1), (320, 30, 2), (60, 16, 1)):
        rect = Rect(7, 5, width, round((1.3 * count + 0.6) * height))
        rows = [Row(tuple(left), (Word("(draw 3.1 ms)", (9, 9, 200), 3),))] * count
        panels = strip.panels(rows, rect, height)
        seen = np.zeros((rect.y + rect.height, rect.x + width, 3), np.uint8)
        for panel in panels:
            pixels = panel.tile.pixels
            seen[panel.y :, panel.x :][: len(pixels), : pixels.shape[1]] = pixels
        whole = np.full((rect.height, width, 3), style.PAPER, np.uint8)
        for n, row in enumerate(rows):
            for word, x in text.placed(row.left, row.right, width, height):
                y = round(0.4 * height) + n * round(1.3 * height)
                text.write(whole, word.text, (x, y), height, word.color)
        np.testing.assert_array_equal(seen[rect.y :, rect.x :], whole)
        other = Row((*left[:1], Word("cut", (200, 9, 9), 2)), rows[0].right)
        again = strip.panels([other], changed(rect, height=round(1.9 * height)), height)
        assert again[1].tile is panels[1].tile


def test_a_key_list_is_drawn_once_in_the_largest_letters_that_fit(monkeypatch):
    """In one block or in two beside each other; else as far as it goes, which it says."""
    lines = hud.help_lines(library.build("curtain"), has_wheel=True)
    half = (len(lines) + 1) // 2
    drawn, rasterise = [], text.rasterise

    def noted(lines, height, **how):
        drawn.append((lines, height))
        return rasterise(lines, height, **how)

    def fits(blocks, height, room):
        wide, tall = zip(*(text.extent(block, height) for block in blocks), strict=True)
        gap = height * (len(blocks) - 1)
        return sum(wide) + gap <= room.width and max(tall) <= room.height

    monkeypatch.setattr(text, "rasterise", noted)
    low = Rect(0, 30, 600, 200)
    for room, height, count in (
        (Rect(0, 40, 800, 640), 15, 1), (Rect(0, 60, 1280, 700), 90, 2), (low, 12, 2),
    ):  # fmt: skip
        panel = messages.keys(lines, height, room)
        (size,) = {size for _, size in drawn}
        blocks = [block for block, _ in drawn]
        assert len(blocks) == count and sum(blocks, ()) == lines and panel.words.endswith(lines[-1])
        assert fits(blocks, size, room)
        for others in [lines], [lines[:half], lines[half:]]:
            assert size == height or not fits(others, size + 1, room)
        drawn.clear()
    room = Rect(0, 25, 320, 190)
    panel = messages.keys(lines, 12, room)
    ((block, size),) = drawn
    assert fits([block], size, room) and len(block) > 10 and "larger window" in block[-1]
    assert panel.words == "\n".join(block)


def test_a_notice_is_told_in_windows_of_any_size():
    """Whole where there is room, else with the name of what was saved, or how an error begins."""
    path = "/home/somebody/a folder/" + "of-many-letters/" * 8 + "cloth-1.seconds.npz"
    saved, refused = f"saved {path}", f"{path}: cannot be written (no space left on device)"
    late = (Word("12 frames/s", style.WARN, 1), Word("1 s behind real time", style.WARN, 5))
    for size in ((320, 240), (640, 480), (1280, 800), (3840, 2160)):
        for notice in (saved, refused, "paused twice"):
            row, _ = hud.status_rows(
                simulation("blow"), "test", state=Word("playing", style.GOOD), notice=notice,
                rates=late,
            )  # fmt: skip
            height = text_height(size[1])
            words = [word for word, _ in text.placed(row.left, row.right, size[0], height)]
            (told,) = [word.text for word in words if word.color == style.KEY_INK]
            room = size[0] - 2 * text.gap(height)
            assert text.length(told, height) <= room
            if text.length(notice, height) > room:
                assert text.ELLIPSIS in told and told[:5] == notice[:5]
                assert notice is refused or told.endswith("seconds.npz")
            else:
                assert told == notice
            if size[0] == 3840:
                assert words[0].text == "playing"
    assert text.shortened("abc", 0.0, 12) == text.ELLIPSIS
    lines = text.wrapped(f"cannot write {path} there", 300, 15)
    assert all(text.length(line, 15) <= 300 for line in lines) and len(lines) > 2


def test_letters_that_the_font_lacks_are_written_by_those_that_it_has():
    def seen(line):
        return text.rasterise([line], 15, paper=(0, 0, 0), inks=((9, 9, 9), (255, 255, 255)))

    for line, written in (
        ("Vorhänge, žaluzie", "Vorhange, zaluzie"), ("Łódź 日本", "?odz ??"), ("x²", "x2"),
    ):  # fmt: skip
        np.testing.assert_array_equal(seen(line), seen(written))
        assert text.length(line, 15) == text.length(written, 15)
    assert (seen("h·omega")[:, :20] != seen("h?omega")[:, :20]).any()  # which it has


@pytest.mark.parametrize("height", [12, 15, 18, 30])
def test_the_hyphens_of_a_flag_are_two(height):
    """The font makes one dash of them."""
    inked = np.flatnonzero(text._ink("--", height).max(axis=(0, 2)) > 0)
    assert len(inked) < np.ptp(inked) + 1
    assert text._ink("--", height).shape[1] <= text.length("--", height) + 4
    assert text.length("a--b", height) > text.length("a-", height) + text.length("-b", height)


def test_planes_are_zoomed_and_moved_and_logs_need_not_know_it():
    """What is under the pointer stays there; a click then puts a particle where it is seen."""
    sim, recorded = simulation("spawn"), Recorded()
    at, there = (450.0, 100.0), (470.0, 130.0)
    wheel = [Event("wheel", pos=at, delta=1.0)] * 5
    drag = [Event("press", pos=at, button="middle"), Event("move", pos=there)]
    drag.append(Event("release", pos=there, button="middle"))
    view = Script(wheel, [press("left", at)], drag, [press("left", there)], [press(key="z")], [])
    looks = []
    draw = view.draw
    view.draw = lambda picture: (looks.append(view.look), draw(picture))
    app.run(sim, view, recorder=recorded, status=False, device="test")
    places = [np.array(call[1]) for call in calls(sim, "spawn")]
    np.testing.assert_allclose(places, [at, at], atol=1e-9)
    assert [event.kind for _, event in recorded] == ["press", "press", "press"]
    assert looks[0] is None and looks[1].zoom == pytest.approx(1.1**5)
    assert looks[3] != looks[2] == looks[-1]
    whole = WindowMap.of(sim.scene.world, (600, 400))
    for y_up in (False, True):
        world = changed(sim.scene.world, up="y" if y_up else "")
        near = WindowMap.of(world, (600, 400), None, Look((300.0, 200.0), 2.0))
        np.testing.assert_allclose(near.to_world([300, 200]), whole.to_world([300, 200]))
        assert near.scale == 2 * whole.scale


def test_a_window_says_that_nothing_is_in_view_and_f_frames_it():
    scene = Scene("fake", world("blow"), Particles.build([[300.0, 200.0], [320.0, 260.0]]))
    sim, f = FakeSimulation(scene), press(key="f")
    anew = press(key="tab")  # after which the status is written anew, as it is now and then
    view, looks = Script([anew], [anew], [f, anew], [anew], [f, anew], []), []
    draw = view.draw
    view.draw = lambda picture: (looks.append(view.look), draw(picture))

    def falls(sim):
        if sim.frame == 1:
            sim.x = [place + [0.0, 9000.0] for place in scene.particles.position]
        if sim.frame == 3:
            sim.x = list(scene.particles.position)

    app.run(sim, view, on_frame=falls, device="test")
    lost = [hud.LOST in words(picture) for picture in view.pictures]
    assert lost == [False, False, True, False, True, False]
    assert looks[2] is None is looks[5]
    assert looks[3].middle == (310.0, 9230.0) and looks[3].zoom == 1.0
    for dim, there in (2, [300.0, 200.0]), (3, [300.0, 200.0, 0.0]):  # in space the camera counts
        room = WindowMap.of(world("blow", dim), (600, 400))
        camera = camera_of_world(world("blow", dim))
        point = np.array([there, [9e9] * dim, [np.nan] * dim])
        pixels, _, _ = camera.project(point) if camera else (point, 0, 0)
        assert room.shows(pixels, np.ones(3)).tolist() == [True, False, False]


def test_a_surface_between_whose_particles_one_looks_is_in_view():
    corners = Particles.build([[300.0, 90.0], [100.0, 390.0], [500.0, 390.0]])
    wheel = [Event("wheel", pos=(300.0, 250.0), delta=60.0)]
    for triangles, lost in ([[0, 1, 2]], False), (np.zeros((0, 3), int), True):
        scene = Scene("fake", world("blow"), corners, triangles=triangles)
        view = Script(wheel, [press(key="tab")], [])
        app.run(FakeSimulation(scene), view, device="test")
        assert view.look.zoom > 200 and (hud.LOST in words(view.pictures[-1])) == lost


def test_a_click_on_a_button_is_its_key_and_the_bar_is_no_world():
    """A click on the button at the right end; then one beside all, which puts no particle."""
    sim = simulation("spawn")
    chrome = Chrome(windowed=True, status=True)
    layout = chrome.layout((900, 500))
    buttons = hud.buttons(sim.scene, None, paused=False)
    placed = {b.key: box for b, box, _ in toolbar.placed(buttons, layout.bar, layout.text)}
    at = placed["tab"].x + 3, placed["tab"].y + 3
    view = Script([], [press("left", at)], [press("left", (2, 2))], [], size=(900, 500))
    recorded = Recorded()
    app.run(sim, view, recorder=recorded, device="test")
    assert "this list" in words(view.pictures[2]) and not calls(sim, "spawn")
    assert [(event.kind, event.key) for _, event in recorded] == [("press", "tab")]


def test_buttons_of_the_bar_never_meet_and_keys_are_offered_as_long_as_one_fits():
    scene = library.build("curtain")
    opens = [Button(key, "a part", right=True) for key in "omlk"]
    buttons = hud.buttons(scene, None, opens, paused=False)
    for width, height in itertools.product((200, 320, 480, 640, 800, 1280, 2560), (12, 30, 60)):
        rect = Rect(0, 0, width, bar_height(height))
        placed = toolbar.placed(buttons, rect, height)
        boxes = [box for _, box, _ in placed]
        assert all(b.x >= a.x + a.width for a, b in itertools.pairwise(boxes))
        assert all(box.x >= 0 and box.x + box.width <= width for box in boxes)
        assert [button.key for button, _, _ in placed][-1] == "tab"
        for button, box, _ in placed:
            at = box.x + box.width - 1, box.y + 1
            assert toolbar.hit(buttons, rect, height, at) is button
    assert len(placed) == len(buttons), "where there is room all are there"


def test_the_bar_keeps_the_key_list_then_tools_then_pause_where_there_is_little_room():
    buttons = [Button(key, "blow") for key in "bc"]
    buttons += [Button(key, "a part", right=True) for key in "pomht"]
    said, height = [], 18
    for width in range(20, 400):
        placed = toolbar.placed(buttons, Rect(0, 0, width, bar_height(height)), height)
        said.append("".join(button.key for button, _, _ in placed))
    kept = list(dict.fromkeys(said))
    assert kept == ["", "t", "bt", "bct", "bcpt", "bcpot", "bcpomt", "bcpomht"]


def test_the_bar_has_labels_as_far_as_there_is_room():
    """The tools', then those at the right, from that of the key list on."""
    buttons = [Button("b", "blow"), *(Button(key, "a part", right=True) for key in "pomh")]
    said, height = set(), 18
    for width in range(100, 600):
        placed = toolbar.placed(buttons, Rect(0, 0, width, bar_height(height)), height)
        said.add("".join(button.key for button, _, shown in placed if shown))
    assert said == {"", "b", "bh", "bph", "bpoh", "bpomh"}


# Real windows

PROGRAM = """
import json, sys
from taichi_cloth import runtime
from taichi_cloth.errors import InputError
from taichi_cloth.scene.model import (
    Particles,
    ParticleDefaults,
    Scene,
    SpringDefaults,
    Springs,
    World,
)
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.ui import app
from taichi_cloth.ui.opening import open_view

kind, mouse, dim, log, image = sys.argv[1:6]
dim = int(dim)
world = World(size=(600.0, 400.0, 500.0)[:dim], gravity=(0.0,) * dim, mouse=mouse)
place = [(300.0, 200.0, 0.0)[:dim], (500.0, 300.0, 0.0)[:dim]]
particles = Particles.build(place, radius=40.0, color=[(250, 20, 20), (20, 250, 20)])
springs = Springs.build([(0, 1)], place)
runtime.start()
scene = Scene("probe", world, particles, springs, ParticleDefaults(radius=30.0))
sim = Simulation(scene, execution="serial")
size = (600, 400)
view = open_view(kind, world, size=size, title="taichi-cloth probe", status=False)


class Recorder:
    def write(self, frame, event):
        with open(log, "a") as file:
            said = {k: v for k, v in vars(event).items() if v}
            file.write(json.dumps({"frame": frame, "size": view.size, **said}) + "\\n")


open(log, "w").close()
app.run(sim, view, recorder=Recorder(), image=image, status=False)
view.close()
"""


@pytest.fixture(scope="module")
def display():
    """A screen for this file's windows only, so that no other window covers them."""
    with virtual_screen() as name:
        yield name


def ask_xdotool(env, *words):
    return subprocess.run(
        ["xdotool", *map(str, words)], env=env, capture_output=True, text=True
    ).stdout


class Window:
    """A running probe window and the hands on it.

    before: what its program does first.
    """

    def __init__(self, display, caches, folder, kind, mouse, dim, before=""):
        self.env = {**os.environ, **caches, "DISPLAY": display}
        self.log, self.image = folder / "log.jsonl", folder / "last.png"
        program = before + textwrap.dedent(PROGRAM)
        self.process = subprocess.Popen(
            [sys.executable, "-c", program, kind, mouse, str(dim), self.log, self.image],
            env=self.env,
        )
        self.wait(self.log.exists, 60)
        self.find()
        time.sleep(0.5)
        # Without a window manager, keys go to the window under the pointer.
        self.point(10, 390)

    def wait(self, done, seconds=60):
        wait_for(done, self.process, "what was done to show", seconds)

    def find(self):
        def found():
            said = self.ask("search", "--onlyvisible", "--name", "probe")
            self.id = said.split()[0] if said else None
            return self.id

        self.wait(found)

    def ask(self, *words):
        return ask_xdotool(self.env, *words)

    def do(self, *words):
        self.ask(*words)
        time.sleep(0.12)

    def point(self, x, y):
        self.do("mousemove", "--window", self.id, x, y)

    def events(self):
        return [json.loads(line) for line in self.log.read_text().splitlines()]

    def pressed(self):
        return [e["key"] for e in self.events() if e["kind"] == "press" and "key" in e]

    def released(self):
        """How many keys were let go."""
        return sum(e["kind"] == "release" and "key" in e for e in self.events())

    def quit(self):
        self.do("key", "Escape")
        assert self.process.wait(20) == 0


# By default one kind: ti.GUI where GGUI cannot be.
KINDS = ["ggui", as_thorough("gui")] if runtime.vulkan_available() else ["gui"]


@pytest.fixture(params=KINDS)
def window(request, display, caches, tmp_path):
    """Opens one probe window of each kind."""
    opened = []

    def open_window(mouse, dim, before=""):
        opened.append(Window(display, caches, tmp_path, request.param, mouse, dim, before))
        return opened[-1]

    yield open_window
    for one in opened:
        if one.process.poll() is None:
            one.process.kill()


def check_that_clicks_are_where_and_when_they_were(w):
    """Also where the pointer and a key move on before the window looks."""
    before = len(w.events())
    places = np.random.default_rng(4).integers((5, 5), (595, 395), (20, 2, 2)).tolist()
    go = ("mousemove", "--window", w.id)
    for n, (at, after) in enumerate(places):
        key = "a" if n % 2 else "shift"
        w.ask(*go, *at, "keydown", key, "click", 1, "keyup", key, *go, *after)
    w.ask(*go, 50, 60, "mousedown", 1, *go, 70, 80, "mouseup", 1, *go, 9, 9)
    w.quit()
    events = [e for e in w.events()[before:] if "button" in e or "key" in e]
    clicks = [e["pos"] for e in events if e["kind"] == "press" and "button" in e]
    assert clicks[:20] == [at for at, _ in places]
    for n in range(20):
        key = "a" if n % 2 else "shift"
        names = [(e["kind"], e.get("key", e.get("button"))) for e in events[4 * n : 4 * n + 4]]
        assert names == [("press", key), ("press", "left"), ("release", "left"), ("release", key)]
    assert [e["pos"] for e in events if e.get("button")][-1] == [70, 80]


@needs_x
def test_keys_buttons_wheel_and_pointer_arrive(window):
    w = window("none", 3)  # in a plane the window keeps some of them to itself
    for x, y in [(100, 50), (200, 150)]:
        w.point(x, y)
    for button in (1, 2, 3, 4, 5):
        w.do("click", button)
    for key in (
        *("F1", "F1", "period", "plus", "minus", "KP_Add", "KP_Subtract"),
        *("Up", "Down", "Tab", "Tab", "h", "h"),  # left goes back, and the log with it
    ):
        before = w.released()
        w.do("key", key)
        w.wait(lambda: w.released() > before)  # noqa: B023
    w.do("keydown", "Control_L")
    w.do("keyup", "Control_L")
    w.do("keydown", "h")
    time.sleep(0.8)  # long enough to repeat
    w.do("keyup", "h")
    events = w.events()
    moves = [tuple(e["pos"]) for e in events if e["kind"] == "move"]
    assert moves[-1] == (200, 150)
    buttons = [(e["kind"], e["button"]) for e in events if "button" in e]
    assert [e["pos"] for e in events if "button" in e] == [[200, 150]] * 6
    assert buttons == [(k, b) for b in ("left", "middle", "right") for k in ("press", "release")]
    assert [e["delta"] for e in events if e["kind"] == "wheel"] == [1, -1]
    pressed = [key for key in w.pressed() if key != "shift"]
    assert pressed == [
        "f1", "f1", ".", "+", "-", "+", "-", "up", "down", "tab", "tab",
        "h", "h", "ctrl", "h",
    ]  # fmt: skip
    check_that_clicks_are_where_and_when_they_were(w)


SLOW = """
import time
from taichi_cloth.ui.loop import Loop
turn = Loop.turn
Loop.turn = lambda loop: (turn(loop), time.sleep(0.7))
"""


@needs_x
@pytest.mark.parametrize("kind", KINDS)
def test_at_a_low_frame_rate_no_click_and_no_key_is_lost(kind, display, caches, tmp_path):
    """Five clicks within a frame are five, each in its place; twice the same key is twice."""
    w = Window(display, caches, tmp_path, kind, "spawn", 2, SLOW)
    w.wait(lambda: any(e["kind"] == "move" for e in w.events()))
    places = [[100 + 60 * n, 300 - 40 * n] for n in range(5)]
    clicks = [("mousemove", "--window", w.id, *place, "click", 1) for place in places]
    w.ask(*[word for click in clicks for word in click], *["key", "i"] * 4)
    w.wait(lambda: w.released() == 4)
    names = [e.get("name", "") for e in w.events() if e["kind"] == "tool"]
    frames = {e["frame"] for e in w.events() if "button" in e or "key" in e}
    pressed = [e["pos"] for e in w.events() if e["kind"] == "press" and "button" in e]
    assert pressed == places and w.pressed() == ["i"] * 4 and len(frames) <= 2
    assert names == ["pin", "", "pin", ""]
    w.quit()


@needs_x
def test_keys_are_let_go_where_another_window_gets_the_keyboard(window, display):
    x = x11.xlib()
    screen = x.XOpenDisplay(display.encode())
    w, other = window("none", 3), x.XDefaultRootWindow(screen)
    w.do("mousemove", 1390, 890, "windowfocus", w.id)  # else the screen gives its keys to us
    for count in (1, 2):
        w.do("keydown", "Control_L", "keydown", "h")
        w.wait(lambda: len(w.pressed()) == 2 * count)  # noqa: B023
        w.do("windowfocus", other)
        w.wait(lambda: w.released() == 2 * count)  # noqa: B023
        w.do("keyup", "Control_L", "keyup", "h")
        w.do("windowfocus", w.id)
    x.XCloseDisplay(screen)
    w.quit()
    assert w.pressed() == ["ctrl", "h"] * 2 and w.released() == 4


@needs_x
def test_every_tool_acts_where_the_pointer_is(window):
    """In space: two particles, tied; what each tool made of the pointer stands in the log."""
    w = window("none", 3)
    camera = Camera((600.0, 400.0, 500.0))
    first, second = camera.project([(300.0, 200.0, 0.0), (500.0, 300.0, 0.0)])[0].round()
    middle = (first + second) / 2

    def said(kind):
        return [e for e in w.events() if e["kind"] == kind]

    def take_up(key, name):
        w.do("key", key)
        w.wait(lambda: [e.get("name", "") for e in said("tool")][-1:] == [name], 20)
        chosen = said("tool")[-1]["frame"]

        def went_on():  # a first tool compiles for some seconds
            w.point(20, 20 + len(w.events()) % 9)
            return w.events()[-1]["frame"] > chosen

        w.wait(went_on, 120)

    def drag(start, *to, button=1):
        w.point(*map(int, start))
        w.do("mousedown", button)
        for place in to:  # each in a frame of its own
            at = [int(number) for number in place]
            w.point(*at)
            w.wait(lambda at=at: said("move")[-1]["pos"] == at)
        w.do("mouseup", button)

    def wait_for(kind, count=1, seconds=20):
        w.wait(lambda: len(said(kind)) >= count, seconds)
        return [e.get("values", {}) for e in said(kind)]

    take_up("i", "pin")
    w.point(*map(int, second))
    w.do("click", 1)
    assert wait_for("pin") == [{"particle": [1]}]
    take_up("c", "cut")
    drag(middle + [-60, 120], middle + [0, 10], middle + [60, -130])
    assert wait_for("cut") == [{"springs": [0]}]
    take_up("g", "grab")
    drag(first, first + [30, 0], first + [60, 10])
    wait_for("let_go")
    (grab,) = wait_for("grab")
    assert grab["particle"] == [0] and grab["pos"] == pytest.approx([300, 200, 0], abs=2)
    assert len(wait_for("drag")) > 1
    take_up("j", "chain")
    for x in (200, 250):
        w.point(x, 120)
        w.do("click", 1)
    assert wait_for("chain") == [{"particles": [2, 3]}] and len(said("link")) == 2
    take_up("t", "throw")
    w.point(320, 150)
    w.do("click", 1)
    (ball,) = wait_for("ball")
    assert ball["velocity"][2] > 0, "away from the eye"
    take_up("t", "")  # away, and what the pointer was from the start again: nothing
    drag((40, 40), (80, 60))
    drag((40, 40), (80, 60), button=3)
    w.do("key", "f")
    w.wait(lambda: len(said("view")) == 3)
    assert [e.get("drag") for e in said("view")] == ["turn", "pan", None]
    w.quit()


@needs_x
@pytest.mark.parametrize("dim", [2, 3])
def test_a_click_puts_a_particle_under_the_pointer(window, dim):
    from PIL import Image

    w = window("spawn", dim)
    w.do("key", "p")  # so that it stays where it was put
    w.point(250, 120)
    w.do("click", "1")
    w.quit()
    assert [e["pos"] for e in w.events() if e.get("button")][0] == [250, 120]
    pixels = np.asarray(Image.open(w.image).convert("RGB")).astype(int)
    assert pixels.shape == (400, 600, 3)
    red, green, blue = pixels[120, 250]
    assert red > 100 and red > 2 * green and red > 2 * blue  # the first colour


@needs_x
def test_a_resized_window_keeps_the_aspect_and_cuts_nothing_off(window):
    from PIL import Image

    w = window("none", 2)
    w.do("windowsize", w.id, 1000, 400)

    def is_wide():
        w.find()  # ti.GUI opens it anew
        w.point(501, 201)
        w.point(500, 200)
        return w.events() and w.events()[-1].get("size") == [1000, 400]

    w.wait(is_wide)
    w.wait(lambda: w.events()[-1].get("pos") == [300, 200])  # the second of the two moves
    w.quit()
    pixels = np.asarray(Image.open(w.image).convert("RGB")).astype(int)
    assert pixels.shape == (400, 1000, 3)
    for (x, y), channel in (((500, 200), 0), ((700, 300), 1)):
        blob = pixels[:, :, channel] - pixels.sum(axis=2) // 3 > 90
        rows, columns = np.nonzero(blob)
        assert columns.mean() == pytest.approx(x, abs=2) and rows.mean() == pytest.approx(y, abs=2)
        assert np.ptp(columns) == pytest.approx(80, abs=5)
        assert np.ptp(rows) == pytest.approx(80, abs=5)


@needs_x
@pytest.mark.parametrize("dim", [2, 3])
def test_the_picture_without_a_window_shows_the_scene(dim, caches, tmp_path):
    """Drawn off-screen in a process without a display; the spheres are where the camera says."""
    from PIL import Image

    code = (
        textwrap.dedent(PROGRAM)
        .replace(
            'view = open_view(kind, world, size=size, title="taichi-cloth probe", status=False)',
            "from taichi_cloth.ui.view import View\nview = View(kind, world, (900, 600))",
        )
        .replace("app.run(sim, view, recorder=Recorder(), ", "app.run(sim, view, frames=1, ")
        .replace("(radius=30.0))", "(radius=30.0), spring_color=(255, 255, 255))")
    )
    image = tmp_path / "picture.png"
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    arguments = ["gui", "none", str(dim), tmp_path / "log", image]
    subprocess.run([sys.executable, "-c", code, *arguments], env={**env, **caches}, check=True)
    pixels = np.asarray(Image.open(image).convert("RGB")).astype(int)
    assert pixels.shape == (600, 900, 3)
    places = np.array([(300.0, 200.0, 0.0), (500.0, 300.0, 0.0)])
    camera = Camera((600, 400, 500))
    expected, radii, _ = camera.project(places, 40.0)
    if dim == 2:
        expected, radii = places[:, :2], np.full(2, 40.0)
    for channel in (0, 1):
        blob = pixels[:, :, channel] > 2.5 * np.delete(pixels, channel, axis=2).max(axis=2)
        rows, columns = np.nonzero(blob)
        middle = np.array([columns.min() + columns.max() + 1, rows.min() + rows.max() + 1]) / 2
        np.testing.assert_allclose(middle, 1.5 * expected[channel], atol=2.5)
        assert np.ptp(columns) + 1 == pytest.approx(2 * 1.5 * radii[channel], abs=4)
    column, row = (1.5 * expected.mean(axis=0)).round().astype(int)
    lightest = pixels[row - 3 : row + 4, column].min(axis=1).max()
    assert lightest > 200, "the spring is white; in the colour of its ends it is at most 123"


def test_views_that_cannot_open_are_refused(monkeypatch):
    from taichi_cloth.errors import InputError
    from taichi_cloth.ui.opening import open_view

    monkeypatch.setattr(runtime, "display_available", lambda: False)
    for kind in ("ggui", "gui"):
        with pytest.raises(InputError, match="no display"):
            open_view(kind, world("none"))
    with pytest.raises(InputError, match="did you mean 'ggui'"):
        open_view("gguy", world("none"))


def test_without_a_display_auto_says_so_and_runs_headless(monkeypatch, capsys):
    from taichi_cloth.ui.opening import open_view

    monkeypatch.setattr(runtime, "display_available", lambda: False)
    assert open_view("auto", world("none")).name == "none"
    reason, instead = capsys.readouterr().err.splitlines()
    assert "running headless" in reason and "works here" in instead


# Films


def test_films_and_pictures_appear_whole_or_not_at_all(tmp_path):
    from PIL import Image

    from taichi_cloth.errors import InputError
    from taichi_cloth.ui import film

    frame = np.zeros((51, 71, 3), np.uint8)
    for name in ("a.mp4", "a.gif"):
        made = film.Film(tmp_path / name)
        kept = 0
        for n in range(12):
            if made.wants():
                frame[:, :, 0] = 20 * n
                made.add(frame)
                kept += 1
        assert not (tmp_path / name).exists()
        made.save()
        assert (tmp_path / name).stat().st_size > 100
        if name == "a.gif":
            with Image.open(tmp_path / name) as gif:
                assert gif.n_frames == kept == 10 and gif.info["duration"] == 20
    dropped = film.Film(tmp_path / "b.gif")
    dropped.add(frame)
    dropped.discard()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.gif", "a.mp4"]
    for make, name in ((film.Film, "x.avi"), (film.Image, "x.jpg"), (film.Image, "no/x.png")):
        with pytest.raises(InputError):
            make(tmp_path / name)


@needs_x
@pytest.mark.thorough
@pytest.mark.parametrize("kind", VIEWS)
def test_a_window_opens_also_while_the_server_starts_anew(kind, display, caches, tmp_path):
    """Every run here is the server's only client, so between two runs it begins from scratch."""
    for _ in range(3):
        out, error = command(
            *("run", "oscillator", "--view", kind, "--frames", 5, "--execution", "serial"),
            env={**caches, "DISPLAY": display},
            cwd=tmp_path,
        )
        assert f"window {kind}" in out and "5 frames in" in out and error == ""
    assert list(tmp_path.iterdir()) == []


@needs_x
@needs_vulkan
@pytest.mark.thorough
def test_ggui_shows_what_vulkan_drew(display, caches, tmp_path):
    """The picture stays on the device, and is as large as a window usually is."""
    from PIL import Image

    out, error = command(
        *("run", "cloth", "--arch", "vulkan", "--view", "ggui", "--frames", 3, "--image", "v.png"),
        env={**caches, "DISPLAY": display},
        cwd=tmp_path,
    )
    assert "window ggui" in out and "rror" not in error
    seen = np.asarray(Image.open(tmp_path / "v.png")).astype(int)
    green = (seen[..., 1] > 200) & (seen[..., 0] < 60)
    assert green.sum() > 192 * 60  # discs of all particles


@needs_x
def test_a_window_destroyed_from_outside_ends_the_run_with_its_files(window, display):
    w = window("none", 2)
    w.ask("windowclose", w.id)
    assert w.process.wait(20) == 0
    assert w.image.exists() and w.log.exists()


@needs_x
@needs_vulkan
def test_a_window_as_large_as_the_screen_is_all_on_it(display, caches, tmp_path):
    run = ["run", "oscillator", "--view", "ggui", "--size", "1400x900", "--execution", "serial"]
    env = {**os.environ, **caches, "DISPLAY": display}
    process = subprocess.Popen([sys.executable, "-m", "taichi_cloth", *run], env=env, cwd=tmp_path)
    place = ["search", "--sync", "--onlyvisible", "--name", "oscillator", "getwindowgeometry"]
    try:

        def in_the_corner():
            said = ask_xdotool(env, *place)
            return said if "Position: 0,0 " in said else ""

        said = wait_for(in_the_corner, process, "the window in the corner")
        assert "Geometry: 1400x900" in said
    finally:
        process.kill()


UNSEEN = """
from taichi_cloth.ui.presenters.ggui import GguiPresenter
GguiPresenter._was_destroyed = lambda self: False
"""


@needs_x
@pytest.mark.thorough
@pytest.mark.parametrize("window", ["ggui"], indirect=True)
def test_a_window_destroyed_while_vulkan_draws_ends_the_run_with_its_files(window, capfd):
    """It goes after it was looked whether it is there: Taichi aborts."""
    w = window("none", 2, UNSEEN)
    w.ask("windowclose", w.id)
    assert w.process.wait(20) == 0
    assert w.image.exists() and w.log.exists()
    assert "note: the window was destroyed; its files hold" in capfd.readouterr().err


@needs_x
@pytest.mark.thorough
@pytest.mark.parametrize("kind", VIEWS)
@pytest.mark.parametrize("cut", ["windowkill", "server"])
def test_a_window_whose_connection_is_cut_keeps_the_files(kind, cut, caches, tmp_path):
    """At any moment of a frame: Xlib and Vulkan would both end the process."""
    with virtual_screen() as display:
        env = {**os.environ, **caches, "DISPLAY": display}

        def ask(*words):
            return subprocess.run(["xdotool", *words], env=env, capture_output=True, text=True)

        names = ("save", "npz"), ("record", "jsonl"), ("video", "gif"), ("image", "png")
        files = [word for flag, end in names for word in (f"--{flag}", f"{flag}.{end}")]
        process = subprocess.Popen(
            [*PROGRAM_LINE, "run", "oscillator", "--view", kind, "--execution", "serial", *files],
            env=env, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        process.stdout.readline()
        time.sleep(2.0)
        found = ask("search", "--onlyvisible", "--name", "taichi-cloth").stdout.split()
        if cut == "server":
            end_server(display)
        else:
            ask("windowkill", found[0])
        _, error = process.communicate(timeout=60)
    assert process.returncode == 3
    assert error.splitlines()[-1].endswith("was cut; its files hold the run until then")
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "image.png", "record.jsonl", "save.npz", "video.gif",
    ]  # fmt: skip
    assert trajectories.load(tmp_path / "save.npz").frame[0] == 1


def test_a_window_that_stands_still_next_has_our_title_and_not_gguis():
    """Which GGUI writes as it shows a picture: a new title is written before that, and after."""
    written = []
    view = object.__new__(GguiPresenter)
    view._window = SimpleNamespace(show=lambda: written.append("probe 60.0 FPS"))
    view._tap, view.closed = SimpleNamespace(entitle=written.append), False
    view._title, view._named = "probe", time.perf_counter() + 60
    view._show()
    assert written == ["probe 60.0 FPS"]  # each time would be too often
    view.entitle("probe, compiling")
    view._show()
    assert written[1:] == ["probe, compiling", "probe 60.0 FPS", "probe, compiling"]


def test_a_title_has_a_name_that_does_not_print_by_its_escapes():
    shown = object.__new__(Presentation)
    shown._sim = SimpleNamespace(scene=SimpleNamespace(name="x\ny\x1b[31m"))
    shown._state = SimpleNamespace(word=lambda state: Word("paused: by space", style.INK))
    shown._takes = SimpleNamespace(shutter=SimpleNamespace(state=""))
    assert shown.title() == "x\\ny\\x1b[31m, paused - taichi-cloth"


def test_an_interrupt_while_xlib_reads_events_is_raised_when_it_has(monkeypatch):
    """Within the reading it would be swallowed, with a traceback on standard error."""

    def interrupted(_):
        raise KeyboardInterrupt(15)

    kept, before = {}, x11._Converter(lambda *_: 7)

    def exchange(_, kind, converter):
        kept[kind] = converter
        return ctypes.cast(before, ctypes.c_void_p).value

    connection = object.__new__(x11.Connection)
    connection._x = SimpleNamespace(XESetWireToEvent=exchange)
    connection._read, connection._stop, connection.window = [], None, 0
    connection._display, connection._displays = 0, []
    connection._listen(1)
    event = ctypes.create_string_buffer(x11._SIZE)
    moved = 1, ctypes.addressof(event), 1
    assert kept[x11.MOTION](*moved) == 7 and len(connection._read) == 1
    monkeypatch.setattr(x11._Event, "from_buffer_copy", interrupted)
    assert kept[x11.MOTION](*moved) == 0
    with pytest.raises(KeyboardInterrupt, match="15"):
        connection.inputs()
    assert len(connection._read) == 1 and connection._stop is None
