"""Two runs beside each other: the same in equal settings, apart by what theory says in others."""

import json
import os
import subprocess
import time

import numpy as np
import pytest
from commands import PROGRAM
from lacking import VIEWS, needs_x
from null_view import NullView
from screens import virtual_screen, wait_for
from selection import thorough
from test_comparison import swing

import taichi_cloth as tc
from taichi_cloth.beside import watch
from taichi_cloth.beside.given import Given, read
from taichi_cloth.beside.twin import Twin
from taichi_cloth.cli.run_beside import Beside
from taichi_cloth.comparison.compare import compare
from taichi_cloth.error_meter.meter import ErrorMeter
from taichi_cloth.error_meter.window import LEAST
from taichi_cloth.errors import InputError
from taichi_cloth.files.trajectory import Trajectory
from taichi_cloth.scene import library
from taichi_cloth.simulation import live
from taichi_cloth.ui import app
from taichi_cloth.ui.inputs import Event


def pull_about(sim):
    """All that tools, panel and scripts do, a frame after each."""
    sim.blow((150.0, 120.0), (6.0, -4.0))
    yield
    sim.grab([40, 41], (200.0, 130.0))
    yield
    for step in range(6):
        sim.drag((200.0 + 12.0 * step, 130.0 + 6.0 * step))
        yield
    sim.let_go()
    sim.cut([12, 30])
    yield
    sim.pin([50])
    sim.spawn((300.0, 200.0), (1.0, -2.0), tied_to=20)
    yield
    sim.unpin([50])
    sim.add_spring(3, 40)
    live.apply(sim, "stiffness", 0.3)
    live.apply(sim, "gravity.y", 0.2)
    yield
    sim.set_step(substeps=2)
    sim.hold(np.full((sim.particle_count, 2), 0.02))
    yield
    yield


@pytest.fixture
def pair(pool):
    """Two simulations of one small cloth that tears, at its start."""
    scene = library.build("cloth", columns=12, rows=8).with_world(tools=True)
    return pool(scene), pool(scene, another=True)


def test_equal_settings_are_never_apart(pair):
    """Through everything that can be done, back in time, and from the start again."""
    first, second = pair
    twin = Twin(first, second, Given())
    try:
        with pytest.raises(InputError, match="has that, too"):
            twin.check_differs()
        for _ in pull_about(first):
            first.advance()
            assert np.array_equal(first.positions(), second.positions())
            assert np.array_equal(first.springs_alive(), second.springs_alive())
            assert twin.watch.now.max == 0.0 and twin.watch.first is None
        assert not first.springs_alive().all()
        kept = first.checkpoint(), second.checkpoint()
        first.advance(3)
        after, rows = second.positions(), twin.watch.last(3)
        first.restore(kept[0])
        second.restore(kept[1])
        first.advance(3)
        assert np.array_equal(second.positions(), after) and twin.watch.last(3) == rows
        with pytest.raises(InputError, match="outside"):  # which neither does
            first.spawn((-1e4, 0.0))
        assert second.particle_count == first.particle_count
        first.reset()
        assert second.frame == 0 and twin.watch.now is None
        assert np.array_equal(first.positions(), second.positions())
    finally:
        twin.close()
    first.advance()
    assert second.frame == 0


@pytest.mark.parametrize("torn", ["first", "second"])
def test_what_one_refuses_neither_does(pair, torn):
    """A spring that holds in one run and not in the other cannot be tied anew in either."""
    first, second = pair
    own, set_to = ("break_force=off", 0.1) if torn == "first" else ("break_force=0.1", None)
    twin, meter = Twin(first, second, read(own)), ErrorMeter(first)
    try:
        first.set(break_force=set_to)
        while np.array_equal(first.springs_alive(), second.springs_alive()):
            first.advance()
            assert first.frame < LEAST
        spring = np.flatnonzero(first.springs_alive() != second.springs_alive())[0]
        i, j = map(int, first.springs()[spring])
        there = first.checkpoint(), second.checkpoint()
        ends: list[list] = []
        for tried in (False, True):
            for sim, checkpoint in zip(pair, there, strict=True):
                sim.restore(checkpoint)
            first.advance()  # after which the spring pulls no more
            if tried:
                says = "the run beside: .*already" if torn == "first" else "^add_spring: .*already"
                with pytest.raises(InputError, match=says):
                    first.add_spring(i, j)
                noted = dict(meter._window.acts)
            first.advance(3)
            ends.append([(sim.springs_alive(), sim.positions(), sim.frame) for sim in pair])
        for without, one in zip(*ends, strict=True):
            assert all(map(np.array_equal, without, one))
        assert twin.watch.now.frame == first.frame and not noted
    finally:
        meter.close()
        twin.close()


def test_a_run_that_was_resumed_has_its_second_from_there(pair):
    """In equal settings it never is apart; what is its own, it has from there on."""
    first, second = pair
    for _ in pull_about(first):
        first.advance()
    first.grab([60, 61], (200.0, 150.0), stiffness=200.0)
    there, clock = first.checkpoint(), (first.frame, first.time, first.steps)
    for substeps, own in ((2, Given()), (2, read("gravity.y=0.3")), (4, read("substeps=4"))):
        first.restore(there)
        second.set_step(substeps=substeps)
        second.reset()
        twin = Twin(first, second, own, resumed=True)
        try:
            assert (second.frame, second.time, second.steps) == clock and twin.watch.now is None
            assert np.array_equal(first.positions(), second.positions())
            assert np.array_equal(first.springs_alive(), second.springs_alive())
            held = [sim.network().particles.mass[60] - 1.0 for sim in pair]  # what it weighs more
            assert np.isclose(held[1], held[0] * (2 / substeps) ** 2, rtol=0.5) and held[1] > 0
            first.advance(5)
            apart, frames = twin.watch.now.max, len(twin.watch.last(100))
            assert (apart > 0) == (own != Given()) and frames == 5
            assert second.work().steps == second.work().force_evaluations == 5 * substeps
            first.reset()
            assert second.frame == 0 and twin.watch.now is None
            assert np.array_equal(first.positions(), second.positions())
        finally:
            twin.close()


@thorough
def test_what_tools_switched_on_for_good_is_so_in_a_second_run_that_joins(pool):
    """So that both begin alike after a reset; but for what is the second one's own."""
    scene = library.build("cloth", columns=12, rows=8).with_world(tools=False)
    first, second = pool(scene), pool(scene, another=True)
    first.prepare_balls()
    for own, collide in ((Given(), True), (read("collisions=off"), False)):
        second.load_scene(scene)
        twin = Twin(first, second, own, resumed=True)
        try:
            for reset in (False, True):
                if reset:
                    first.reset()
                world = second.storage.scene.world
                assert (world.tools, world.collisions) == (True, collide)
        finally:
            twin.close()


def test_a_long_run_keeps_its_last_frames_and_what_all_come_to(pair, monkeypatch):
    """Also where one goes back: in the same run, and to before a reset."""
    monkeypatch.setattr(watch, "KEPT", 40)
    first, second = pair
    twin = Twin(first, second, read("substeps=3"))

    def whole():
        weight = [row.count for row in seen]
        mean = np.average([row.rms**2 for row in seen], weights=weight)
        return mean**0.5, max(row.max for row in seen)

    def along(frames):
        for _ in range(frames):
            first.advance()
            seen.append(twin.watch.now)
        distance = twin.watch.distance()
        assert (distance.trajectory, distance.trajectory_max) == pytest.approx(whole())
        assert distance.final_rms == seen[-1].rms and twin.watch.last(40) == seen[-40:]
        assert twin.watch.scale == max(row.scale for row in seen)
        assert len(twin.watch._rows) <= 40

    try:
        seen: list[watch.Apart] = []
        along(90)
        there, end = [sim.checkpoint() for sim in pair], twin.watch.distance()
        along(15)
        for blown in (False, True):
            for sim, checkpoint in zip(pair, there, strict=True):
                sim.restore(checkpoint)
            assert twin.watch.distance() == end
            del seen[90:]
            if blown:
                first.blow((150.0, 120.0), (6.0, -4.0))
            along(30)
        first.reset()
        seen.clear()
        along(50)
        for sim, checkpoint in zip(pair, there, strict=True):
            sim.restore(checkpoint)
        seen.clear()
        along(3)
    finally:
        twin.close()


def test_both_begin_from_a_checkpoint(cli, tmp_path):
    """The left one has the bits that it has alone."""
    there, words = tmp_path / "there.npz", ("run", "cloth", "--columns", "8", "--rows", "6")
    cli(*words, "--headless", "--frames", "20", "--checkpoint", there)
    left, both = (str(tmp_path / name) for name in ("left.npz", "both.npz"))
    more = ("--headless", "--frames", "10", "--resume", there, "--save")
    cli(*words, *more, left)
    out, _ = cli(*words, *more, both, "--beside", "method=rk4")
    assert "beside it: rk4, 1 substep" in out and "apart" in out
    assert compare(left, both).identical
    found = compare(both, both.replace(".npz", "-beside.npz"))
    assert found.time[0] == 21.0 and 0.0 < found.max[0] < found.max[-1]


def test_their_distance_is_the_phase_error_of_the_oscillator(pool, tmp_path):
    """By closed forms of symplectic Euler, and by `compare` of what both recorded."""
    scene, times = library.build("oscillator"), np.arange(1.0, 61.0)
    given = read("dt=0.4")  # so three steps in each frame
    first, second = pool(scene), pool(scene, substeps=3, another=True)
    twin = Twin(first, second, given)
    files = [Trajectory(tmp_path / name) for name in ("a.npz", "b.npz")]
    try:
        for _ in times:
            first.advance()
            for file, sim in zip(files, (first, second), strict=True):
                file.record(sim)
        apart = np.abs(swing(1.0, times) - swing(1 / 3, times))
        rows = twin.watch.last(60)
        assert np.allclose([row.rms for row in rows], apart, rtol=1e-9, atol=1e-9)
        for file in files:
            file.save({"scene": scene.name})
        found = compare(tmp_path / "a.npz", tmp_path / "b.npz")
        assert np.array_equal(found.rms, [row.rms for row in rows])
        assert np.array_equal(found.max, [row.max for row in rows])
        assert found.scale == twin.watch.scale
        assert found.distance.trajectory == pytest.approx(twin.watch.distance().trajectory)
        first.set_step(substeps=2)  # theirs are no longer than they were told
        assert (first.substeps, second.substeps) == (2, 3)
        first.set_step(dt=0.5)
        assert (second.dt, second.substeps) == (0.5, 2)
    finally:
        twin.close()


def test_what_differs_first_is_what_compare_names(pair, tmp_path):
    """A cloth that tears under a pull, in another stiffness, which a change leaves alone."""
    first, second = pair
    first.reset()
    second.reset()
    twin = Twin(first, second, read("stiffness=0.2"))
    files = [Trajectory(tmp_path / name) for name in ("a.npz", "b.npz")]
    try:
        for frame in range(40):
            if frame == 5:
                first.grab([60], first.positions()[60])
            first.drag(first.scene.particles.position[60] + [4.0 * frame, 6.0 * frame])
            if frame == 20:
                live.apply(first, "stiffness", 0.4)
                live.apply(first, "damping", 0.01)
            first.advance()
            for file, sim in zip(files, (first, second), strict=True):
                file.record(sim)
        stiffness = live.setting(second, "stiffness").read(second)
        assert stiffness == 0.2 and live.setting(second, "damping").read(second) == 0.01
        for file in files:
            file.save({"scene": first.scene.name})
        found = compare(tmp_path / "a.npz", tmp_path / "b.npz", scene=first.scene)
        for name in ("first_break", "first_touch"):
            theirs, ours = getattr(found, name), getattr(twin.watch, name)
            assert (theirs is None) == (ours is None)
            if theirs is not None:
                assert theirs.particles == ours.particles and theirs.time == ours.time
                assert theirs.spring == ours.spring
        assert found.first_break is not None
        first.reset()
        assert live.setting(second, "stiffness").read(second) == 0.2
    finally:
        twin.close()


EVENTS = [
    (3, {"event": "move", "pos": [180.0, 140.0]}),
    (4, {"event": "move", "pos": [200.0, 150.0]}),
    (6, {"event": "cut", "springs": [20, 21]}),
    (8, {"event": "grab", "particle": 30, "pos": [150, 150], "stiffness": [0.4], "damping": [0.0]}),
    (9, {"event": "drag", "pos": [170.0, 190.0]}),
    (14, {"event": "let_go"}),
    (15, {"event": "set", "name": "stiffness", "value": 0.4}),
    (16, {"event": "pin", "particle": 25}),
    (18, {"event": "press", "key": "r"}),
    (20, {"event": "cut", "springs": [40]}),
]


@thorough
def test_a_log_replays_both_to_the_bit(cli, tmp_path):
    """Each run has the bits that it has alone; what differs is said."""
    log, words = tmp_path / "log.jsonl", ("run", "cloth", "--columns", "8", "--rows", "6")
    lines = [{"header": {"scene": "cloth", "window": [600, 400]}}]
    lines += [{"frame": frame, **event} for frame, event in EVENTS]
    log.write_text("\n".join(map(json.dumps, lines)))
    both = ("--headless", "--frames", "30", "--events")
    once, again = tmp_path / "once.jsonl", [tmp_path / name for name in ("a", "b", "l", "r")]
    a, b, left, right = (str(path) + ".npz" for path in again)
    beside = ("--beside", "method=rk4,substeps=2")
    out, _ = cli(*words, *both, log, *beside, "--record", once, "--save", a)
    assert "beside it: rk4, 2 substeps" in out and "apart" in out
    header = json.loads(once.read_text().splitlines()[0])["header"]
    assert header["beside"].startswith("method=rk4,substeps=2,topology=")
    cli(*words, *both, once, "--save", b)
    topology = header["beside"].rpartition("=")[2]
    cli(*words, *both, once, "--beside", "none", "--save", left)
    alone = ("--beside", "none", "--method", "rk4", "--substeps", "2", "--topology", topology)
    cli(*words, *both, once, *alone, "--save", right)
    second = [path.replace(".npz", "-beside.npz") for path in (a, b)]
    assert compare(a, b).identical and compare(a, left).identical
    assert compare(*second).identical and compare(second[0], right).identical
    assert not compare(a, second[0]).identical
    assert tc.load_trajectory(a).meta["method"] == "symplectic_euler"
    assert tc.load_trajectory(second[0]).meta["method"] == "rk4"


def test_a_second_run_that_fails_stops_alone(cli):
    """It is said, and the run fails; the first one has gone on to its end."""
    words = ("run", "cloth", "--columns", "8", "--rows", "6", "--headless", "--frames", "60")
    out, said = cli(*words, "--beside", "method=explicit_euler,stiffness=50", check=3)
    assert "60 frames" in out and "the run beside stopped" in said
    assert "in parts of the largest displacement in the right run" in out


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("rk4", "is no KEY=VALUE"),
        ("method=rk5", "did you mean 'rk4'"),
        ("substeps=0", "at least 1"),
        ("substeps=2,substeps=3", "given twice"),
        ("substeps=8,substeps=8", "given twice"),
        ("method=rk4,method=verlet", "given twice"),
        ("dt=0.1,substeps=2", "exclude each other"),
        ("precision=f64", "compare --events FILE.jsonl --precision f64"),
        ("frames=3", "give --frames"),
    ],
)
def test_what_makes_no_second_run_is_refused(given, says):
    with pytest.raises(InputError, match=says):
        read(given)


def test_what_the_scene_refuses_is_refused(cli):
    words = ("run", "cloth", "--columns", "4", "--rows", "3", "--headless", "--frames", "2")
    for given, says in (
        ("metod=rk4", "did you mean 'method'"),
        ("substeps=1", "the first run has that, too"),
        ("stiffness=soft", "must be a number, is 'soft'"),
        ("collisions=2", "must be on or off"),
    ):
        assert says in cli(*words, "--beside", given, check=2)[1]
    said = cli(*words, "--beside", "zzzz=2", check=2)[1]
    known = said.partition("known: ")[2].strip().split(", ")
    assert "substeps" in known and len(known) == len(set(known)) and said.count("\n") == 1


# ------------------------------------------------------------------------------------------
# Windows


class Hands(NullView):
    """A window of 1000 x 700 pixels in which prepared turns of events happen."""

    visible = True

    def __init__(self, sim, turns):
        super().__init__(sim.scene.world, (1000, 700))
        self.turns, self.pictures = turns, []

    def poll(self):
        return self.turns(self) if callable(self.turns) else []

    def draw(self, picture):
        self.pictures.append(picture)


def test_the_mouse_in_either_half_acts_on_both(pair):
    """It takes what one sees there; the pointer is in both, and what differs is said."""
    first, second = pair
    first.reset()
    second.reset()
    twin = Twin(first, second, read("stiffness=0.2"))
    events, taken = [], []

    def turns(view):
        frame = first.frame
        if frame == 0:
            return [Event("move", pos=(20.0, 300.0)), Event("press", key="g")]
        if frame == 30:
            half = view.pictures[-1].beside
            apart = half.room.x - view.room.x
            assert half.room.width == view.room.width and apart > view.room.width
            # The particle of the right run that is now farthest from where the left one has it.
            away = np.linalg.norm(second.positions() - first.positions(), axis=1)
            taken.append(int(np.where(second.fixed(), 0, away).argmax()))
            scale = view.room.width / first.scene.world.size[0]
            top = view.room.y + (view.room.height - scale * first.scene.world.size[1]) / 2
            x, y = scale * second.positions()[taken[0]] + [half.room.x, top]
            return [Event("move", pos=(x, y)), Event("press", pos=(x, y), button="left")]
        if frame == 40:
            return [
                Event("move", pos=(300.0, 690.0)),
                Event("release", pos=(300.0, 690.0), button="left"),
            ]
        return []

    class Recorded:
        def write(self, frame, event):
            events.append(event)

        def rewind(self, frame):
            pass

    try:
        view = Hands(first, turns)
        app.run(first, view, frames=45, recorder=Recorded(), beside=Beside(twin), meters=True)
    finally:
        twin.close()
    (grab,) = [event for event in events if event.kind == "grab"]
    assert list(grab.values["particle"]) == taken
    assert [event.kind for event in events].count("let_go") == 1
    held = view.pictures[-8]  # still held
    said = "\n".join(panel.words for panel in held.overlay)
    assert "symplectic_euler, 1 substep, stiffness 0.5" in said
    assert "symplectic_euler, 1 substep, stiffness 0.2" in said
    assert "ms a frame" in said and "distance" in said and "largest" in said
    assert held.pointer is not None and held.beside.picture.pointer is not None
    apart = held.beside.room.x - view.room.x
    assert np.allclose(held.beside.picture.pointer.place - held.pointer.place, [apart, 0])
    assert not np.array_equal(held.position, held.beside.picture.position)


@thorough
@needs_x
@pytest.mark.parametrize("kind", VIEWS)
def test_a_real_window_shows_both(kind, caches, tmp_path):
    """What is pulled in the right half is seen in both, and a replay has it to the bit."""
    from PIL import Image

    log, image, saved = (tmp_path / name for name in ("log.jsonl", "last.png", "a.npz"))
    given = ["run", "cloth", "--columns", "8", "--rows", "6", "--beside", "substeps=3"]
    ways = ["--topology", "graph", "--view", kind, "--size", "1000x640", "--seed", "1"]
    files = ["--record", log, "--image", image, "--save", saved]
    with virtual_screen() as name:
        env = {**os.environ, **caches, "DISPLAY": name}
        said = subprocess.Popen(
            [*PROGRAM, *map(str, (*given, *ways, *files))],
            env=env,
            stdout=subprocess.PIPE,
            text=True,
        )

        def ask(*words):
            done = subprocess.run(["xdotool", *map(str, words)], env=env, capture_output=True)
            time.sleep(0.15)
            return done.stdout.split()

        search = ("search", "--onlyvisible", "--name", "cloth, playing")
        found = wait_for(lambda: ask(*search), said, "the window", 180)
        to = ("mousemove", "--window", found[0].decode())
        ask(*to, 665, 230)
        ask("key", "g")
        ask("mousedown", 1)
        for step in range(8):
            ask(*to, 665 + 14 * step, 230 + 16 * step)
        ask("mouseup", 1)
        ask("key", "Escape")  # the tool is put away
        ask("key", "Escape")
        assert "beside it: symplectic_euler, 3 substeps" in said.communicate(timeout=60)[0]
        assert said.returncode == 0
    events = [json.loads(line) for line in log.read_text().splitlines()]
    assert events[0]["header"]["beside"] == "substeps=3,topology=graph"
    assert {"grab", "drag", "let_go"} <= {event.get("event") for event in events}
    pixels = np.asarray(Image.open(image).convert("RGB")).astype(int)
    green = (pixels[:, :, 1] > 150) & (pixels[:, :, 0] < 90)
    assert all(half.sum() > 200 for half in (green[:, :495], green[:, 505:]))
    frames = str(tc.load_trajectory(saved).frame[-1])
    again = tmp_path / "b.npz"
    replay = ["run", "cloth", "--headless", "--events", log, "--frames", frames, "--save", again]
    subprocess.run([*PROGRAM, *map(str, replay)], env={**os.environ, **caches}, check=True)
    for one, other in ((saved, again), (tmp_path / "a-beside.npz", tmp_path / "b-beside.npz")):
        assert compare(one, other).identical
