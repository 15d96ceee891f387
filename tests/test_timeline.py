"""Back in the last seconds, on from there another way, and out to files."""

import itertools
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from null_view import NullView

import taichi_cloth as tc
from taichi_cloth.errors import InputError
from taichi_cloth.files.events import Recorder
from taichi_cloth.files.exports import Export
from taichi_cloth.files.recordings import Recordings
from taichi_cloth.files.trajectory import Trajectory
from taichi_cloth.scene import scenefile
from taichi_cloth.scene.library import build
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.ui import app
from taichi_cloth.ui.chrome import instruments, meters
from taichi_cloth.ui.controls import Controls
from taichi_cloth.ui.depiction import Depiction
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.timeline import SPEEDS, Pace, Timeline
from taichi_cloth.ui.travel import Travel

SIZE = 1000  # bytes of a checkpoint of what stands for a simulation


class Saved:
    """Its checkpoint."""

    def __init__(self, state):
        self.state, self._array = state, np.zeros(SIZE, np.int8)

    def arrays(self):
        return [self._array]


class Done(NamedTuple):
    """What stands for an event."""

    kind: str
    number: int


class Counting:
    """What stands for a simulation and for what a window remembers: a hash of all that was done."""

    def __init__(self):
        self.state, self.loads, self.altered = 0, 0, False
        self.storage = self

    def checkpoint(self):
        return Saved(self.state)

    def restore(self, saved):
        self.state = saved.state
        self.loads += 1

    def memory(self):
        return self.state % 7

    def recall(self, memory):
        assert memory == self.state % 7

    def do(self, event):
        self.state = hash((self.state, event))
        self.altered = True

    def advance(self):
        self.state = hash((self.state, "frame"))
        self.altered = False


ACTIONS = st.lists(
    st.one_of(
        st.tuples(st.just("advance"), st.integers(1, 9)),
        st.tuples(st.just("do"), st.integers(0, 99)),
        st.tuples(st.just("go"), st.integers(-3, 40)),
        st.tuples(st.just("branch"), st.just(0)),
    ),
    max_size=25,
)


@given(ACTIONS, st.integers(2, 40), st.booleans(), st.integers(0, 4))
@settings(deadline=None, max_examples=200)
def test_any_frame_that_is_held_comes_back_as_it_was(actions, room, reruns, spacing):
    """Whatever is done, dropped and run again: each frame has what it had, the last its present."""
    sim = Counting()

    def rerun(frame, events):
        for event in events:
            sim.do(event.number)
        sim.advance()

    line = Timeline(
        sim,
        sim,
        rerun if reruns else None,
        seconds=0.5,
        most_bytes=room * SIZE,
        spacing=spacing,
        clock=itertools.count().__next__,
    )
    states, frame, present = {}, 0, 0
    for action, number in actions:
        if action == "go":
            frame = line.go(number)
        elif line.at is not None and action in ("advance", "do", "branch"):
            assert line.branch() == frame
            states = {f: state for f, state in states.items() if f <= frame}
            present = sim.state
        if action == "do":
            line.event(frame, Done("set" if number > 90 else "press", number))
            sim.do(number)
            present = sim.state
        elif action == "advance":
            for _ in range(number):
                sim.advance()
                frame += 1
                line.note(frame)
                states[frame] = present = sim.state
                assert line.bytes <= max(room, 2) * SIZE
        if line.frames:
            assert line.frames[-1] == max(states)
            assert line.frames[-1] - line.frames[0] <= 30 + 7
            last = frame == line.frames[-1]
            assert sim.state == (present if last else states[frame])
    for frame in reversed(line.frames):
        last = line.go(frame) == line.frames[-1]
        assert sim.state == (present if last else states[frame])


def test_a_long_run_that_is_large_still_reaches_back(device):
    sim = Counting()

    def rerun(frame, events):
        sim.advance()

    line = Timeline(sim, sim, rerun, seconds=10, most_bytes=160 * SIZE)
    for frame in range(1, 2001):
        sim.advance()
        line.note(frame)
    assert 600 <= len(line.frames) <= 608 and line.bytes <= 160 * SIZE


@pytest.fixture
def sparse():
    """A timeline with a checkpoint of its start alone; (make, line, what it ran again).

    make(first, end) makes the frames from one to the next.
    """
    sim, again = Counting(), []

    def rerun(frame, events):
        again.append((frame, list(events)))
        sim.advance()

    def make(first, end):
        for frame in range(first, end):
            sim.advance()
            line.note(frame + 1)

    line = Timeline(sim, sim, rerun, spacing=1e9, clock=lambda: 0.0)
    line.note(0)
    make(0, 3)
    return make, line, again


def test_what_was_done_after_the_frame_that_a_run_goes_on_from_is_not_done_again(sparse):
    make, line, again = sparse
    line.event(3, Done("move", 1))
    make(3, 6)
    line.go(3)
    assert line.branch() == 3
    make(3, 6)
    again.clear()
    line.go(5)
    assert again == [(frame, []) for frame in range(5)]


def test_the_frame_in_which_something_was_set_is_held_and_not_run_again(sparse):
    """To set something may compile, which nobody who goes back should wait for."""
    make, line, again = sparse
    line.event(3, Done("set", 1))
    make(3, 6)
    line.go(5)
    assert [frame for frame, _ in again] == [4]


def test_slow_motion_shows_frames_longer_and_changes_none():
    pace = Pace()
    assert [pace.turn() for _ in range(3)] == [True] * 3
    pace.slower()
    pace.slower()
    assert pace.slowness == 4 and pace.words == "1/4 speed"
    turns = [(pace.turn(), pace.part) for _ in range(8)]
    assert [due for due, _ in turns] == 2 * [False, False, False, True]
    assert [part for _, part in turns] == 2 * [0.25, 0.5, 0.75, 0.0]
    for _ in SPEEDS:
        pace.slower()
    assert pace.slowness == SPEEDS[-1]
    pace.full()
    assert pace.turn()


TORN_BY_A_BOX = """
[world]
up = "y"
size = [2.0, 2.0, 2.0]
gravity = [0.0, -9.81, 0.0]
dt = 0.016
substeps = 1
ground = 0.0
[particle]
restitution = 1.0
mass = 0.01
radius = 0.02
[[cloths]]
origin = [0.0, 1.0, 0.0]
columns = 5
rows = 4
spacing = 0.1
stiffness = 30.0
down = [0.0, 0.0, 1.0]
pinned = [[0, 0], [4, 0]]
[[obstacles]]
shape = "box"
centre = [0.2, 0.6, 0.2]
half = [0.1, 0.1, 0.1]
velocity = [3.0, 0.0, 0.6]
"""


def test_slower_motion_keeps_the_picture_where_it_is():
    pace = Pace()
    pace.slower()
    pace.turn()
    assert pace.part == 0.5
    pace.slower()
    assert pace.part == 0.5


@pytest.mark.usefixtures("device")
def test_slow_motion_draws_what_is_between_two_frames():
    """Particles, normals and obstacles move straight on from one frame to the next."""
    sim = Simulation(scenefile.parse(TORN_BY_A_BOX), substeps=4, execution="serial")
    sim.prepare_tools()
    depiction = Depiction(sim, frozenset({"surface", "springs"}))

    def left():
        whole = depiction.picture()
        seen = whole.position.copy(), whole.solids.vertex, whole.normals.copy()
        depiction.between.leave(sim)
        sim.advance(1)
        return seen

    for _ in range(12):
        before, solid, normals = left()
    now = depiction.picture()
    after, turned = now.position.copy(), now.normals.copy()
    assert np.abs(after - before).max() > 0.02 and np.abs(turned - normals).max() > 1e-3
    moved = np.array([3.0, 0.0, 0.6]) * sim.dt
    for part in (0.0, 1 / 16, 0.5, 15 / 16):
        seen = depiction.picture(part=part)
        np.testing.assert_allclose(seen.position, before + part * (after - before), atol=1e-6)
        np.testing.assert_allclose(seen.solids.vertex, solid + part * moved, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(seen.normals, axis=1), 1.0, atol=1e-6)
        middle = normals + part * (turned - normals)
        np.testing.assert_allclose(np.cross(seen.normals, middle), 0.0, atol=1e-6)
        assert seen.segments is now.segments
    np.testing.assert_array_equal(depiction.picture(part=0.0).position, before)
    np.testing.assert_array_equal(sim.drawn_positions(), after)
    sim.cut([7])
    cut = depiction.picture(part=0.5)  # torn at once, still on its way
    assert len(cut.segments) == len(now.segments) - 1 and len(cut.triangles) < len(now.triangles)
    np.testing.assert_allclose(cut.position, (before + after) / 2, atol=1e-6)
    for change in (lambda: sim.spawn([1.0, 1.0, 1.0], mass=0.01, radius=0.05), sim.reset):
        change()
        np.testing.assert_array_equal(depiction.picture(part=0.5).position, sim.drawn_positions())
        left()


class Script(NullView):
    """A window in which these events happen, turn by turn; then it is closed."""

    visible = True

    def __init__(self, world, turns):
        super().__init__(world)
        self.turns = list(turns)

    def poll(self):
        if not self.turns:
            return [Event("press", key="escape")]
        return self.turns.pop(0)

    def draw(self, picture):
        pass


def press(key):
    return [Event("press", key=key), Event("release", key=key)]


def gust(k):
    return [Event("move", pos=(200.0 + 9.0 * k, 150.0 + 5.0 * k))]


@pytest.mark.usefixtures("device")
def test_a_window_in_slow_motion_lags_by_a_frame_and_pauses_where_it_is():
    scene = build("cloth", columns=12, rows=9)
    sim = Simulation(scene, topology="graph", execution="serial")
    frames, drawn = [sim.drawn_positions().copy()], []

    class Seen(Script):
        def draw(self, picture):
            drawn.append((sim.frame, picture.position.copy()))
            if sim.frame == len(frames):
                frames.append(sim.drawn_positions().copy())

    turns = [[], [], press("q") + press("q"), *[[] for _ in range(10)], press("space"), []]
    app.run(sim, Seen(scene.world, turns), quiet=True)
    slow = drawn[-13:-2]  # before: at full speed; after it: paused
    assert [frame for frame, _ in slow] == [2] * 3 + [3] * 4 + [4] * 4
    for k, (frame, position) in enumerate(slow[3:]):
        part = k % 4 / 4
        expected = (1 - part) * frames[frame - 1] + part * frames[frame]
        np.testing.assert_array_equal(position, expected.astype(position.dtype))
    for frame, position in (*drawn[:-10], *drawn[-2:]):
        np.testing.assert_array_equal(position, frames[frame])


@pytest.mark.usefixtures("device")
def test_a_log_is_that_of_the_run_one_kept(tmp_path):
    """Back five frames, a look around, another way on with a cut: the log has no step back.

    What was put there meanwhile is gone, and the trajectory goes on without it.
    """
    scene = build("cloth", columns=12, rows=9)
    sim = Simulation(scene, topology="graph", execution="serial")
    turns = [gust(k) for k in range(10)] + [press("n")]
    turns += [[Event("press", pos=(400.0, 500.0), button="left")], gust(0)]
    turns += [press("left") for _ in range(7)] + [press(".") for _ in range(2)]
    turns += [press("left"), [Event("move", pos=(260.0, 140.0))], press("c")]
    turns += [
        [Event("press", pos=(200.0, 90.0), button="left")],
        *([Event("move", pos=(200.0 + 30 * k, 160.0))] for k in range(3)),
        [Event("release", pos=(300.0, 160.0), button="left")],
    ]
    turns += [press("space")] + [gust(k) for k in range(9)]
    log, kept = tmp_path / "log.jsonl", tmp_path / "kept.npz"
    view = Script(scene.world, turns)
    with Recorder(log, app.log_header(sim, view)) as recorder:
        trajectory = Trajectory(kept)
        app.run(sim, view, recorder=recorder, trajectory=trajectory, quiet=True)
        trajectory.save()
    assert 12 <= sim.frame <= 18
    frames = tc.load_trajectory(kept).frame
    np.testing.assert_array_equal(frames, np.arange(1, sim.frame + 1))
    assert sim.particle_count == len(scene.particles)
    again = Simulation(scene, topology="graph", execution="serial")
    replay = tc.load_events(log)
    assert any(event.kind == "cut" for events in replay.by_frame.values() for event in events)
    app.run(again, NullView(scene.world), frames=sim.frame, replay=replay, quiet=True)
    np.testing.assert_array_equal(again.positions(), sim.positions())
    np.testing.assert_array_equal(again.springs_alive(), sim.springs_alive())
    assert not sim.springs_alive().all()


@pytest.mark.usefixtures("device")
def test_meters_say_what_the_frame_that_was_gone_back_to_is_like(monkeypatch):
    """To look there notes nothing, and does nothing to the frame: one can go on to the last."""
    monkeypatch.setattr(meters, "REDRAWN", 0.0)
    scene = build("cloth", columns=12, rows=9)
    sim = Simulation(scene, topology="graph", execution="serial")
    seen = {}

    class Seen(Script):
        size = 900, 900

        def draw(self, picture):
            words = "".join(panel.words + "\n" for panel in picture.overlay)
            energy = f"energy\n{instruments.number(sim.energy().total)}\n"
            broken = f"broken\n{int((~sim.springs_alive()).sum())} of "
            seen.setdefault(sim.frame, []).append(energy in words and broken in words)

    turns = [gust(k) for k in range(12)] + [press("space")]
    turns += [press("left") for _ in range(6)] + [press(".") for _ in range(6)]
    app.run(sim, Seen(scene.world, turns), quiet=True, meters=True)
    last = max(seen)
    for frame in range(last - 6, last):
        assert seen[frame][1:] == [True] * (1 + (frame > last - 6))
    assert last == sim.frame and seen[last][-2]


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("after", ["i", "g"])
def test_the_tool_and_what_is_down_stay_the_users_as_one_goes_back(after):
    """Also where the tool of then held something, which it lets go, be it the one in hand with its
    button up; the log knows of it.
    """
    scene = build("cloth", columns=12, rows=9).with_world(tools=True)
    sim = Simulation(scene, topology="graph", execution="serial")
    size, at = tuple(map(int, scene.world.size)), scene.particles.position[100]
    log: list = []
    recorder = SimpleNamespace(
        write=lambda *one: log.append(one),
        rewind=lambda frame: log.__setitem__(slice(None), [one for one in log if one[0] < frame]),
    )
    frames = 0
    controls = Controls(sim, None, size, note=lambda event: travel.event(frames, event))
    travel = Travel(sim, controls, None, recorder, None)

    def do(*events):
        for event in events:
            travel.event(frames, event)
            controls.apply(event)
            travel.settle()

    def advance(count=1):
        nonlocal frames
        for _ in range(count):
            travel.go_on()
            controls.before_frame()
            sim.advance()
            frames += 1
            travel.note(frames)

    advance()
    do(*press("g"), Event("move", pos=tuple(at)), Event("press", pos=tuple(at), button="left"))
    advance(4)
    assert sim.held() is not None
    do(Event("release", pos=tuple(at), button="left"), *press("i") * (after == "i"))
    advance(2)
    name = controls.tool.name
    do(Event("press", key="ctrl"))
    for frame in (4, 3, 4, 0, 3):
        frames = travel.go(frame)
        assert (controls.tool.name, controls.held, sim.held()) == (name, {"ctrl"}, None)
        assert not controls.pressed
        assert not travel.timeline.touched and travel.timeline.frames.stop == 8
    do(Event("release", key="ctrl"))
    frames = travel.go(7)
    assert controls.tool.name == name and not controls.held and len(log) < 20
    frames = travel.go(3)
    advance(2)
    do(Event("move", pos=tuple(at + 30)))
    advance(3)
    by_frame = {frame: [e for f, e in log if f == frame] for frame, _ in log}
    again = Simulation(scene, topology="graph", execution="serial")
    replay = SimpleNamespace(by_frame=by_frame, header={"window": size, "seed": 0})
    app.run(again, NullView(scene.world), frames=frames, replay=replay, quiet=True)
    np.testing.assert_array_equal(again.positions(), sim.positions())
    assert frames == 8 and again.held() is None


@pytest.mark.usefixtures("device")
def test_what_is_run_again_tells_nothing_anew(tmp_path):
    """A click beside the world is told of once, and not as its frame is run again, to go back to
    the next one or to export it.
    """
    scene = build("cloth", columns=4, rows=3).with_world(tools=True)
    sim = Simulation(scene, topology="graph", execution="serial")
    size = tuple(map(int, scene.world.size))
    controls = Controls(sim, None, size, note=lambda event: travel.event(sim.frame, event))
    travel = Travel(sim, controls, None, None, None)
    travel.timeline._spacing = np.inf  # only the first frame has a checkpoint
    travel.note(0)
    beside = Event("press", pos=(-9.0, -9.0), button="left")
    for frame, events in enumerate(([*press("n"), beside], [], press("i"), [])):
        for event in events:
            travel.event(frame, event)
            controls.apply(event)
        told = controls.told
        controls.before_frame()
        sim.advance()
        travel.note(frame + 1)
        assert told[0].startswith("pin" if frame >= 2 else "that is outside the world")
    for back in (1, 2, 4):
        travel.go(back)
        assert controls.told == told
    travel.timeline.export(tmp_path / "seconds.npz")
    assert controls.told == told and controls.tool.name == "pin"


@pytest.mark.usefixtures("device")
def test_files_of_a_run_that_goes_back_over_its_reset_have_no_frame_of_another_run(tmp_path):
    """The frames before it are forgotten once another is noted; what came after are another's."""
    sim = Simulation(build("cloth", columns=4, rows=3), topology="graph", execution="serial")
    kept = Recordings(Trajectory(tmp_path / "a.npz"), Export(tmp_path / "b.npz", sim.dt))
    controls = Controls(sim, None, (800, 600))
    travel = Travel(sim, controls, None, None, kept)
    frames, seen = 0, {}

    def go_on(count):
        nonlocal frames
        travel.go_on()
        for _ in range(count):
            sim.advance()
            frames += 1
            kept.record(sim)
            travel.note(frames)
            seen[sim.frame] = sim.positions()

    go_on(6)
    sim.reset()
    frames = travel.go(5)  # at once: all of them are still there
    go_on(0)
    assert [part.frames for part in (kept.trajectory, kept.export)] == [5, 5]
    sim.reset()
    go_on(2)
    frames = travel.go(4)
    assert sim.frame == 4
    sim.set(velocities=1.0 + sim.velocities())
    go_on(3)
    kept.trajectory.save()
    kept.export.save()
    for name in ("a.npz", "b.npz"):
        with np.load(tmp_path / name) as found:
            assert found["frame"].tolist() == [5, 6, 7]
            for frame, position in zip(found["frame"], found["position"], strict=True):
                np.testing.assert_array_equal(position[:, :2], seen[frame])


@pytest.mark.usefixtures("device")
def test_looking_at_the_past_drops_nothing_and_exports_it(tmp_path):
    scene = build("cloth", columns=8, rows=6)
    sim = Simulation(scene, topology="graph", execution="serial")

    class Nothing:
        def memory(self):
            return None

        def recall(self, memory):
            pass

    line = Timeline(sim, Nothing(), None, seconds=0.1)
    with pytest.raises(InputError, match="there is no frame to export yet"):
        line.export(tmp_path / "none.npz")
    states = {}
    for frame in range(1, 12):
        sim.advance()
        line.note(frame)
        states[frame] = sim.positions()
    sim.pin([9])
    assert list(line.frames) == list(range(5, 12))
    line.go(7)
    assert line.export(tmp_path / "window.npz") == 7 and line.export(tmp_path / "window") == 7
    assert line.at == 7 and sim.frame == 7
    saved = tc.load_trajectory(tmp_path / "window.npz")
    for frame, position in zip(saved.frame, saved.position, strict=True):
        np.testing.assert_array_equal(position, states[frame])
    assert len(list((tmp_path / "window").iterdir())) == 7
    line.go(11)
    assert sim.fixed()[9]  # as it was left
