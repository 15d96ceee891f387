"""`compare`: two runs whose first difference is known by construction, and a session run again."""

import json
import os
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import taichi_cloth as tc
from taichi_cloth import console
from taichi_cloth.comparison import picture as pictures
from taichi_cloth.comparison import report
from taichi_cloth.errors import InputError
from taichi_cloth.files.trajectory import Saved, Trajectory
from taichi_cloth.scene import library
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.scene.penetration import Moment, touching
from taichi_cloth.scene.solids import solids

AMPLITUDE, OMEGA = 50.0, 0.1  # of the oscillator


def recorded(sim, path, frames):
    """The path of a recording of so many frames."""
    trajectory = Trajectory(path)
    for _ in range(frames):
        sim.advance()
        trajectory.record(sim)
    trajectory.save({"scene": sim.scene.name})
    return path


def made_up(x, springs=((0, 1),), alive=None, fixed=None):
    """A recording of positions (k, n, 2) at times 1 to k, of springs that hold or not, (k, s)."""
    x = np.array(x, float)
    k, n, _ = x.shape
    return Saved(
        frame=np.arange(1, k + 1),
        time=np.arange(1.0, k + 1),
        position=x,
        velocity=0.0 * x,
        spring=np.array(springs),
        spring_alive=np.ones((k, len(springs)), bool) if alive is None else np.array(alive),
        meta={},
        start=x[0],
        fixed=np.zeros(n, bool) if fixed is None else np.array(fixed),
    )


def swing(step, times):
    """Where symplectic Euler has x'' = -OMEGA^2 x at `times`, let go at AMPLITUDE: its closed form.

    x_n = A cos((n + 1/2) theta) / cos(theta / 2), where sin(theta / 2) = OMEGA step / 2.
    """
    half = np.arcsin(OMEGA * step / 2)
    return AMPLITUDE * np.cos((2 * times / step + 1) * half) / np.cos(half)


@pytest.fixture(scope="module")
def swings(pool, tmp_path_factory):
    """Recordings of 60 units of time by step: frames of 1 or, of the second one, of a half."""
    folder, scene = tmp_path_factory.mktemp("swings"), library.build("oscillator")
    return {
        1.0: recorded(pool(scene), folder / "whole.npz", 60),
        0.5: recorded(pool(scene, dt=0.5), folder / "half.npz", 120),
    }


def test_the_distance_is_the_phase_error_of_the_oscillator(swings):
    """Also where frames are not as long: those at the same times are compared."""
    found = tc.compare(swings[1.0], swings[0.5], within="0.2%")
    times = np.arange(1.0, 61.0)
    apart = np.abs(swing(1.0, times) - swing(0.5, times))
    assert (found.time == times).all() and (found.frame_b == 2 * found.frame_a).all()
    assert np.allclose(found.rms, apart, rtol=1e-9, atol=1e-9)
    assert np.allclose(found.max, apart, rtol=1e-9, atol=1e-9) and (found.farthest == 1).all()
    scale = np.abs(swing(0.5, times) - AMPLITUDE).max()
    assert found.scale == pytest.approx(scale, rel=1e-12) and found.particles == 1
    assert found.error == pytest.approx(np.sqrt((apart**2).mean()) / scale, rel=1e-9)
    assert found.parted == times[np.argmax(apart > 0.002 * scale)]
    assert found.difference.time == 1.0 and found.difference.particle == 1
    assert not found.identical and found.first_break is None and found.break_a is None


def test_a_particle_that_is_free_in_one_of_both_is_measured():
    """Only what neither run can move is left out: one that is let go in B alone goes 3, then 4."""
    a, b = np.zeros((2, 3, 2, 2))
    b[1:, 0, 0] = [3.0, 4.0]
    held, free = made_up(a, fixed=[True, False]), made_up(b, fixed=[False, False])
    found = tc.compare(held, free, within=1.0)
    assert found.particles == 2 and found.parted == 2.0
    assert found.max.tolist() == [0.0, 3.0, 4.0]


def test_of_those_that_differ_first_the_farthest_is_named():
    """By how far each is from itself in the other run, not by its number or place."""
    a = np.zeros((2, 3, 2))
    a[1, :, 1] = 5.0
    b = a.copy()
    b[1, :, 0] = [0.1, 0.3, 0.2]
    found = tc.compare(made_up(a), made_up(b)).difference
    assert (found.time, found.what, found.particle) == (2.0, "position", 1)
    assert found.distance == pytest.approx(0.3)


def test_a_file_s_name_is_no_formula_in_a_picture(swings):
    """Nor does it make the picture no picture, whatever is in it."""
    found = replace(tc.compare(swings[1.0], swings[0.5]), a="$\\x$", b="\0 $")
    assert ElementTree.fromstring(pictures.draw(found, "svg")).tag.endswith("svg")


@pytest.mark.filterwarnings("error::UserWarning", "ignore::DeprecationWarning")
def test_runs_of_the_same_bits_have_a_picture(swings):
    """Its axis was first fitted to a single value, of which Matplotlib warned on the terminal."""
    same = replace(tc.compare(swings[1.0], swings[1.0]), scale=1.0)
    assert pictures.draw(same, "png").startswith(b"\x89PNG")


def test_columns_that_have_no_room_are_named(swings, monkeypatch, capsys):
    said = {}
    for width in (44, 80):
        monkeypatch.setenv("COLUMNS", str(width))
        report.show(tc.compare(swings[1.0], swings[0.5]), console.output())
        said[width] = " ".join(capsys.readouterr().out.split())
    assert "- left out, for the terminal is narrow: rms, farthest, max" in said[44]
    assert "left out" not in said[80] and "farthest" in said[80]


def test_identical_runs_are_identical(swings, cli):
    found = tc.compare(swings[1.0], tc.load_trajectory(swings[1.0]))
    assert found.identical and found.difference is None and found.parted is None
    assert not found.rms.any() and found.error == 0
    assert "identical to the bit in all 60 frames" in cli("compare", *[swings[1.0]] * 2)[0]
    # Half of the frames are not all of them, even if they have the same bits.
    saved = tc.load_trajectory(swings[1.0])
    some = {name: getattr(saved, name)[:30] for name in ("frame", "time", "position", "velocity")}
    short = tc.compare(saved, replace(saved, **some, spring_alive=saved.spring_alive[:30]))
    assert not short.identical and short.difference is None and short.frames_a == 60


def test_the_exit_status_and_what_is_written(swings, cli, tmp_path):
    both = swings[1.0], swings[0.5]
    out, _ = cli("compare", *both, check=1)
    assert "they part at time" in out and "the first difference: position" in out
    picture = tmp_path / "apart.svg"
    out, _ = cli("compare", *both, "--within", "10", "--json", "--picture", picture)
    said, found = json.loads(out), tc.compare(*both, within=10.0)
    assert said["same"] and said["parted"] is None and said["rms"] == found.rms.tolist()
    assert said["limit"] == 10.0 and said["difference"]["particle"] == 1
    assert "first difference" in "".join(ElementTree.parse(picture).getroot().itertext()) or (
        picture.stat().st_size > 10_000  # where letters are drawn as paths
    )
    cli("compare", *both, "--within", "10%", "--picture", tmp_path / "apart.png", check=0)
    assert (tmp_path / "apart.png").read_bytes().startswith(b"\x89PNG")


# ------------------------------------------------------------------------------------------
# Events


def hanging(*break_forces):
    """Masses that fall, each on a spring of its own, which breaks at a force of its own."""
    count = len(break_forces)
    top = [(50.0 + 50.0 * k, 20.0) for k in range(count)]
    below = [(x, y + 10.0) for x, y in top]
    return Scene(
        "hanging",
        World(size=(400.0, 400.0), gravity=(0.0, 0.1)),
        Particles.build([*top, *below], fixed=[True] * count + [False] * count),
        Springs.build(
            [(k, count + k) for k in range(count)],
            [*top, *below],
            stiffness=0.05,
            rest_length=10.0,
            break_force=break_forces,
        ),
    )


def test_the_first_break_is_named(pool, tmp_path):
    """Of three springs the second breaks at another force: its frames follow from its swing."""
    a = recorded(pool(hanging(0.12, 0.15, 9.0)), tmp_path / "a.npz", 30)
    b = recorded(pool(hanging(0.12, 0.06, 0.18)), tmp_path / "b.npz", 30)
    y, v, pull = 0.0, 0.0, [0.0]
    for _ in range(30):
        v += 0.1 - 0.05 * y
        y += v
        pull.append(0.05 * y)
    breaks = [int(np.argmax(np.array(pull) > force)) for force in (0.12, 0.15, 0.06, 0.18)]
    found = tc.compare(a, b)
    event = found.first_break
    assert (event.kind, event.spring, event.particles) == ("break", 1, (1, 4))
    assert (event.a, event.b, event.others) == (breaks[1], breaks[2], 1)
    assert event.time == breaks[2] == found.break_b and found.break_a == breaks[0]
    # What a spring breaks at changes nothing before: it pulls in the step in which it is marked.
    assert found.difference.frame_a == breaks[2] and found.difference.what == "springs that hold"
    only = tc.compare(b, a).first_break
    assert (only.a, only.b) == (event.b, event.a)
    third = tc.compare(
        recorded(pool(hanging(0.12, 0.15, 0.18)), tmp_path / "c.npz", 30), a
    ).first_break
    assert (third.spring, third.a, third.b, third.others) == (2, breaks[3], None, 0)


def test_the_first_break_is_that_of_either_run():
    """A spring breaks early in A and late in B, another in between in both: the early one differs
    first, though in B it is the last.
    """
    x = np.zeros((6, 3, 2))
    x[:, 1, 0] = np.arange(6.0)
    a, b = np.ones((2, 6, 2), bool)
    a[1:, 0] = b[5:, 0] = a[3:, 1] = b[2:, 1] = False
    springs = (0, 1), (1, 2)
    event = tc.compare(made_up(x, springs, a), made_up(x, springs, b)).first_break
    assert event.spring == 0 and (event.a, event.b, event.others) == (2.0, 6.0, 1)


def test_what_comes_later_is_not_broken_before(pool, tmp_path):
    """A mass and its spring that come in frame 3 of both, and break in frame 5 of A."""
    path = recorded(pool(hanging(9.0, 9.0, 9.0)), tmp_path / "a.npz", 6)
    saved = tc.load_trajectory(path)
    for array in (saved.position[:2], saved.velocity[:2], saved.start[None]):
        array[:, 5] = np.nan
    alive = saved.spring_alive.copy()
    alive[:2, 2] = False
    b = replace(saved, spring_alive=alive)
    alive = alive.copy()
    alive[4:, 2] = False
    found = tc.compare(replace(saved, spring_alive=alive), b)
    event = found.first_break
    assert (event.spring, event.a, event.b) == (2, 5.0, None)
    assert found.break_a == 5.0 and found.break_b is None
    assert found.difference.frame_a == 5 and not found.rms.any()


BALL = """
name = "ball"
[world]
size = [2.0, 2.0]
up = "y"
gravity = [0.0, -10.0]
ground = 0.2
dt = 0.01
[particle]
radius = 0.05
[[particles]]
position = [0.5, 1.0]
[[particles]]
position = [1.5, 1.0]
"""


def test_the_first_touch_is_named(cli, tmp_path):
    """Two balls fall on the ground, which is higher in B: frames follow from their fall."""
    (tmp_path / "ball.toml").write_text(BALL)
    run = ["run", "ball.toml", "--headless", "--quiet", "--precision", "f64", "--frames", 50]
    cli(*run, "--save", "a.npz", cwd=tmp_path)
    cli(*run, "--save", "b.npz", "--set", "world.ground=0.5", cwd=tmp_path)
    frame = np.arange(51)
    height = 1.0 - 10.0 * 0.01**2 * frame * (frame + 1) / 2 - 0.05  # of symplectic Euler
    at = {ground: 0.01 * np.argmax(height <= ground) for ground in (0.2, 0.5)}
    said = json.loads(cli("compare", "a.npz", "b.npz", "--json", cwd=tmp_path, check=1)[0])
    event = said["first_touch"]
    assert (event["thing"], event["particles"], event["others"]) == ("ground", [0], 1)
    assert event["a"] == pytest.approx(at[0.2]) and event["b"] == pytest.approx(at[0.5])
    assert said["touch_a"] == pytest.approx(at[0.2])
    alike = json.loads(cli("compare", "a.npz", "a.npz", "--json", cwd=tmp_path)[0])
    assert alike["first_touch"] is None
    assert alike["touch_a"] == alike["touch_b"] == pytest.approx(at[0.2])
    # One that is wholly new there; and what cannot be known, is said.
    out, _ = cli("compare", "a.npz", "b.npz", cwd=tmp_path, check=1)
    assert "particle 0 touches ground" in out and "in that frame" in " ".join(out.split())
    (tmp_path / "ball.toml").write_text(BALL.replace("0.05", "0.04"))
    out, _ = cli("compare", "a.npz", "b.npz", cwd=tmp_path, check=1)
    assert "touches are not known: the scene of a.npz is another one now" in " ".join(out.split())


def test_what_touches_is_seen_in_positions():
    """Walls, pairs and spheres, at exact contact; what is a hair away does not touch."""
    x = np.array([[1.0, 5.0], [3.0, 5.0], [5.01, 5.0], [9.0, 9.0]])
    world = World(size=(10.0, 10.0), gravity=(0.0, 0.0), walls=("left", "bottom"), collisions=True)
    sphere = tc.Obstacle("sphere", {"centre": (7.01, 5.0), "radius": 1.0})
    scene = Scene("x", world, Particles.build(x, radius=1.0), obstacles=(sphere,))
    found = touching(scene, solids(scene), Moment(x, 0.0 * x, 0.0))
    assert found.pairs.tolist() == [[0, 1]]
    assert {name: ids.tolist() for name, ids in found.things.items()} == {
        "obstacle 0": [2],
        "left wall": [0],
        "bottom wall": [3],
    }


def test_what_bounced_within_a_frame_touched_in_it():
    """What came and goes, both in 1.5 frames at most: off a wall, a pair, a sphere that moves."""
    world = World((40.0, 40.0), gravity=(0.0, 0.0), walls=("left",), collisions=True)
    rows = [  # place and speed along x a frame of 0.1 earlier and now
        (1.05, -1.0, 1.04, 1.0),  # off the wall
        (1.09, -1.0, 1.07, 1.0),  # turned before the wall: too late for a bounce
        (1.01, 1.0, 1.11, 1.0),  # goes
        (1.20, -1.0, 1.10, -1.0),  # comes
        (1.05, -1.0, 1.04, 1.0),  # fixed
        *((20.0, 1.0, 20.0, -1.0), (22.05, -1.0, 22.06, 1.0)),  # a pair that collided
        *((20.0, 1.0, 20.0, -1.0), (22.20, -1.0, 22.12, 1.0)),  # one that turned before it
        *((20.0, -1.0, 19.9, -1.0), (22.01, 1.0, 22.11, 1.0)),  # one that goes
        *((20.0, 1.0, 20.0, -1.0), (22.05, -1.0, 22.06, 1.0)),  # both fixed
        (33.05, 0.0, 33.16, 2.0),  # hit by the sphere
        (26.95, 0.0, 26.95, 0.0),  # which leaves this one
    ]
    across = [2, 6, 10, 14, 18, 5, 5, 10, 10, 15, 15, 20, 20, 30, 30]
    was, had, x, v = np.array(rows).T
    sphere = tc.Obstacle.build("sphere", centre=[30.0, 30.0], radius=2.0, velocity=[1.0, 0.0])
    moments = [
        Moment(np.column_stack([at, across]), np.column_stack([speed, 0.0 * at]), time)
        for at, speed, time in ((was, had, 0.0), (x, v, 0.1))
    ]
    fixed = np.isin(np.arange(len(rows)), [4, 11, 12])
    particles = Particles.build(moments[0].x, radius=1.0, fixed=fixed)
    scene = Scene("x", world, particles, obstacles=(sphere,))
    before, now = moments
    found = touching(scene, solids(scene), now, before)
    assert found.pairs.tolist() == [[5, 6]]
    things = {name: ids.tolist() for name, ids in found.things.items()}
    assert things == {"left wall": [0], "obstacle 0": [13]}
    of_now = touching(scene, solids(scene), fresh(now))
    assert not len(of_now.pairs) and not any(map(len, of_now.things.values()))
    # Pairs that rest on each other do not bounce.
    resting = scene.with_world(contact="resting")
    assert not len(touching(resting, solids(resting), *map(fresh, (now, before))).pairs)


def fresh(moment):
    """The same, of which nobody has asked what is in the way."""
    return replace(moment, gaps=[])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", ["<f4", ">f8", "<f2"])
def test_files_of_other_programs_are_read_in_our_types(swings, tmp_path, kind):
    """What they have written with fewer digits, or in another order of bytes; f16 goes to 65504."""
    saved = dict(np.load(swings[1.0]))
    for name, array in saved.items():
        if array.dtype.kind == "f" and name != "time":
            saved[name] = array.astype(kind)
        elif array.dtype.kind == "i":
            saved[name] = array.astype(">u2")
    np.savez(tmp_path / "other.npz", **saved)
    read = tc.load_trajectory(tmp_path / "other.npz")
    assert read.position.dtype == read.start.dtype == np.float64 and read.spring.dtype == np.int64
    rounding = 2 * np.finfo(kind).eps * np.abs(saved["position"]).max()
    assert tc.compare(swings[1.0], read).rms.max() <= rounding


# ------------------------------------------------------------------------------------------
# What cannot be compared


def test_what_cannot_be_compared_is_refused_in_a_line(swings, pool, cli, tmp_path):
    other = recorded(pool(hanging(1.0, 1.0, 1.0)), tmp_path / "other.npz", 3)
    odd = recorded(pool(library.build("oscillator"), dt=0.35), tmp_path / "odd.npz", 2)
    (tmp_path / "cut.npz").write_bytes(swings[1.0].read_bytes()[:-400])
    np.savez(tmp_path / "foreign.npz", position=np.zeros(3))
    saved = dict(np.load(swings[1.0]))
    np.savez(tmp_path / "short.npz", **{**saved, "time": saved["time"][:5]})
    np.savez(tmp_path / "back.npz", **{**saved, "time": saved["time"][::-1]})
    np.savez(tmp_path / "ends.npz", **{**saved, "spring": saved["spring"] + 5})
    np.savez(tmp_path / "export.npz", position=saved["position"], triangle_whole=np.ones((8, 0)))
    os.mkfifo(tmp_path / "pipe.npz")
    Trajectory(tmp_path / "empty.npz").save()
    for name, words in {
        "other.npz": "not of the same particles: scenes 'oscillator' and 'hanging', 2 particles",
        "odd.npz": "no frame at the same time",
        "cut.npz": "cut.npz: is no saved trajectory",
        "foreign.npz": "foreign.npz: is no saved trajectory: it has no 'frame'",
        "export.npz": "is no saved trajectory but an export, for other programs; use --save",
        "short.npz": "its 'time' is float64 (5,)",
        "back.npz": "its times do not grow",
        "ends.npz": "a spring's end is none of its 2 particles",
        "pipe.npz": "is no file but a pipe",
        "empty.npz": "has no frame",
        "nowhere.npz": "there is no such file",
    }.items():
        with pytest.raises(InputError, match=".") as refused:
            tc.compare(swings[1.0], tmp_path / name)
        assert words in str(refused.value) and "\n" not in str(refused.value)
    assert odd != other
    for words, said in {
        (swings[1.0],): "name two recordings",
        (swings[1.0], other, "--substeps", "2"): "--substeps: only with --events",
        (swings[1.0], other, "--within", "-1%"): "--within must be a number above 0, or one with %",
        (swings[1.0], swings[1.0], "--picture", "x.gif"): "must end with .png or .svg",
        ("--events", "no.jsonl", "--substeps", "2"): "there is no such file",
        ("--events", tmp_path / "pipe.npz", "--substeps", "2"): "is no file but a pipe",
        ("box", "--events", tmp_path / "pipe.npz", "--dt", "2"): "is no file but a pipe",
    }.items():
        _, error = cli("compare", *words, check=2)
        assert said in error and error.count("\n") == 1


def test_what_has_no_room_in_memory_is_refused(swings, monkeypatch):
    monkeypatch.setattr(os, "sysconf", lambda name: 8)
    with pytest.raises(InputError, match="whole.npz: would take .* GiB of memory"):
        tc.compare(swings[1.0], swings[0.5])


@pytest.mark.parametrize("number", [np.nan, np.inf, 1e200])
@pytest.mark.parametrize("array", ["position", "velocity"])
def test_a_lost_particle_is_named(swings, array, number):
    """In either recording, and in both; not one that is yet to come, whose rows are NaN."""
    good = tc.load_trajectory(swings[1.0])
    values = getattr(good, array).copy()
    values[6, 1, 0] = number
    bad = replace(good, **{array: values})
    for pair, label in (((good, bad), "B"), ((bad, good), "A"), ((bad, bad), "A")):
        with pytest.raises(
            InputError, match=f"^{label}: particle 1 is lost in frame 7: its {array}"
        ):
            tc.compare(*pair, within="50%")
    later = replace(good, position=good.position.copy(), velocity=good.velocity.copy())
    later.position[:7, 1] = later.velocity[:7, 1] = np.nan
    found = tc.compare(good, later, within="50%")
    assert found.difference.what == "particles that exist" and found.parted == 1.0


# ------------------------------------------------------------------------------------------
# A session run again

LOG = """{"header": {"scene": "cloth", "window": [400, 300], "dt": 1.0, "method": "verlet", \
"precision": "f64", "arguments": ["--columns", "6", "--rows", "4", "--spacing", "30", \
"--break-force", "inf"]}}
{"frame": 3, "event": "move", "pos": [200.0, 60.0]}
{"frame": 4, "event": "move", "pos": [206.0, 62.0]}
{"frame": 5, "event": "set", "name": "substeps", "value": 1}
"""


def test_a_run_that_fails_is_not_near_one_that_goes_on(cli, tmp_path):
    """However far apart is near enough, and however near they were up to there."""
    log = tmp_path / "session.jsonl"
    header = LOG.splitlines()[0].replace('"dt"', '"substeps": 8, "dt"')
    log.write_text(header.replace('"--columns"', '"--stiffness", "9", "--columns"'))
    words = ("compare", "--events", log, "--within", "1e9", "--frames", 60, "--json")
    said = json.loads(cli(*words, "--substeps", 1, check=1)[0])
    assert said["failed"]["a"] is None and said["failed"]["b"] and said["parted"] is None
    assert not said["same"] and said["frames_b"] < said["frames_a"] == 60


@pytest.mark.parametrize("name", ["a.npz", "b.jsonl"])
def test_what_is_kept_writes_nothing_over(cli, tmp_path, name):
    """Also where it is the log itself; nothing is run before."""
    log = tmp_path / "b.jsonl"
    log.write_text(LOG)
    (tmp_path / name).write_text(LOG)
    words = ("compare", "--events", log, "--substeps", 2)
    _, error = cli(*words, "--keep", log, check=2)
    assert f"--keep {log}: cannot be made: it is a file" in error and log.read_text() == LOG
    _, error = cli(*words, "--keep", tmp_path, check=2)
    assert f"'{name}' is there already" in error and error.count("\n") == 1
    assert log.read_text() == LOG and len(list(tmp_path.iterdir())) == 2 - (name == log.name)
    cli(*words, "--order", "--keep", tmp_path / "new", "--method", "x", check=2)
    assert not (tmp_path / "new").exists()


@pytest.mark.thorough
def test_a_session_is_run_again_at_a_finer_step(cli, tmp_path):
    """The pointer pushes at the same times; the distances of three runs show the method's order."""
    log = tmp_path / "session.jsonl"
    log.write_text(LOG)
    words = ["compare", "--events", log, "--dt", "0.5", "--order"]
    kept = tmp_path / "kept"
    out, _ = cli(*words, "--frames", 30, "--within", "5%", "--json", "--keep", kept)
    said = json.loads(out)
    assert said["settings_a"]["substeps"] == 1 and said["settings_b"]["substeps"] == 2
    assert said["settings_a"]["precision"] == said["settings_b"]["precision"] == "f64"
    assert said["settings_b"]["method"] == "verlet" and said["frames_b"] == 30
    assert said["time"] == list(range(1, 31)) and said["parted"] is None
    assert abs(said["order"] - 2) < 0.2  # of Verlet's scheme
    finest = tc.compare(kept / "a.npz", kept / "c.npz")
    assert said["own_error_relative"] == pytest.approx(finest.error, rel=0.15)
    assert any("substeps (first in frame 5)" in note for note in said["notes"])
    # By the last of several steps an error would be that of no run.
    log.write_text(LOG.replace('"value": 1', '"value": 8'))
    out, _ = cli(*words[:-1], "--frames", 8, "--json", check=1)
    said = json.loads(out)
    assert "own_error" not in said and "changes its steps" in said["notes"][-1]
    _, error = cli("compare", "--events", log, check=2)
    assert "say what the other run has" in error
    _, error = cli("compare", "box", "--events", log, "--substeps", 2, check=2)
    assert "is of scene 'cloth', not of 'box'" in error
    log.write_text(LOG.replace('"substeps", "value": 1', '"dt", "value": 2.0'))
    _, error = cli("compare", "--events", log, "--dt", "0.5", check=2)
    assert "sets its frame time itself; use --substeps" in error
