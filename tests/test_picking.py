"""What a click in space means, and where it puts things: what rays meet first."""

from dataclasses import replace

import numpy as np
import pytest
from test_windows import FakeSimulation, Recorded, Script, calls, camera_of_world, press, world

from taichi_cloth.render.camera import Camera
from taichi_cloth.render.window_map import WindowMap
from taichi_cloth.scene.model import Obstacle, Particles, Scene, World
from taichi_cloth.scene.solids import Drawn, solids, surface
from taichi_cloth.ui import app, picking
from taichi_cloth.ui.controls import Controls
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.tools.contract import Hand

WINDOW = (600, 400)
BALLS, SHEETS, GRID = 6, 3, 5  # sheets of GRID x GRID particles
TABLE = Obstacle("box", {"centre": (1.0, 0.8, 1.0), "half": (0.5, 0.15, 0.35)})


class Seen:
    """What picking asks of a simulation: sheets and balls at random, around a table."""

    def __init__(self, rng):
        i, j = (part.ravel() for part in np.mgrid[:GRID, :GRID] / (GRID - 1.0))
        self.x = rng.uniform(0.2, 1.8, (BALLS, 3))
        self.faces = np.zeros((0, 3), int)
        cell = np.arange(GRID**2).reshape(GRID, GRID)
        a, b, c, d = (
            part.ravel() for part in (cell[:-1, :-1], cell[1:, :-1], cell[1:, 1:], cell[:-1, 1:])
        )
        for _ in range(SHEETS):
            begin, along, across = rng.uniform(0.2, 1.8, 3), *rng.uniform(-0.8, 0.8, (2, 3))
            new = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]) + len(self.x)
            self.faces = np.concatenate([self.faces, new])
            self.x = np.concatenate([self.x, begin + np.outer(i, along) + np.outer(j, across)])
        self.scene = Scene(
            "seen",
            World((2.0, 2.0, 4.0), (0.0,) * 3, up="y", ground=0.0),
            Particles.build(self.x, radius=0.01),
            triangles=self.faces,
            obstacles=(TABLE,),
        )
        self.r = np.where(np.arange(len(self.x)) < BALLS, 0.12, 0.01)
        self.time, self.particle_count = 0.0, len(self.x)

    def positions(self):
        return self.x

    def radii(self):
        return self.r

    def drawn_triangles(self):
        return self.faces

    def obstacles(self, time):
        return [Drawn(s.name, s.shape, *surface(s, 1.0), *s.pose(time)) for s in solids(self.scene)]


def to_triangle(eye, along, corners):
    """How far along a ray a triangle is: Möller and Trumbore, 1997; inf: it misses it."""
    a, b, c = corners
    p = np.cross(along, c - a)
    det = p @ (b - a)
    u, q = p @ (eye - a) / det, np.cross(eye - a, b - a)
    v, t = q @ along / det, q @ (c - a) / det
    return t if min(u, v, 1 - u - v, t) >= 0 else np.inf


def to_ball(eye, along, middle, radius):
    half = along @ (middle - eye)
    rest = radius**2 - (middle - eye) @ (middle - eye) + half**2
    return half - np.sqrt(rest) if rest >= 0 else np.inf


def to_table(eye, along):
    middle, half = np.array(TABLE.values["centre"]), np.array(TABLE.values["half"])
    ends = np.sort([(middle - half - eye) / along, (middle + half - eye) / along], axis=0)
    first, last = ends[0].max(), ends[1].min()
    return first if 0 < first <= last else np.inf


def test_what_the_table_hides_is_not_cut():
    """Of two sheets, before and behind it, a path over the table cuts the one before alone."""
    sim = Seen(np.random.default_rng(0))
    across = [[x, y, z] for z in (0.2, 1.8) for y in (0.1, 1.5) for x in np.linspace(0.6, 1.4, 5)]
    sim.x, sim.r, sim.particle_count = np.array(across), np.full(20, 0.01), 20
    pairs = np.array([(n + s, n + s + 5) for s in (0, 10) for n in range(5)])
    sim.springs, sim.springs_alive = lambda: pairs, lambda: np.ones(10, bool)
    window = WindowMap.of(sim.scene.world, WINDOW)
    camera = Camera.framing(sim.scene.world.size, [0] * 3, [2] * 3, y_up=True)
    for rot_y, seen in ((0.0, range(5, 10)), (180.0, range(5))):
        camera.rot_x, camera.rot_y = 0.0, rot_y
        for height, cut in ((0.8, seen), (1.2, range(10))):
            (level,) = window.to_window(camera.project([[1.0, height, 1.0]])[0])[:, 1]
            path = np.array([[20.0, level], [580.0, level]])
            assert picking.springs_across(sim, camera, window, *path).tolist() == list(cut)


def views(seed):
    """Such a simulation from somewhere, and pixels: sim, camera, window, pixels."""
    rng = np.random.default_rng(seed)
    sim = Seen(rng)
    window = WindowMap.of(sim.scene.world, WINDOW)
    camera = Camera.framing(sim.scene.world.size, [0] * 3, [2] * 3, y_up=True)
    camera.rotate(rng.uniform(-180, 180), rng.uniform(-40, 40))
    camera.zoom(rng.uniform(0.7, 2.0), about=rng.uniform(0.5, 1.5, 3))
    camera.pan(rng.uniform(-0.2, 0.2, 2))
    return sim, camera, window, rng.uniform([0, 0], WINDOW, (120, 2))


@pytest.mark.parametrize("seed", range(6))
def test_a_click_means_what_its_line_of_sight_meets_first(seed):
    (sim, camera, window, pixels), met = views(seed), set()
    places = picking.seen(sim.x, camera, window)[0]
    for pixel in pixels:
        eye, along = camera.ray(window.to_world(pixel))
        balls = [
            [to_ball(eye, along, sim.x[n], f * 0.12) for n in range(BALLS)] for f in (0.9, 1.1)
        ]
        if not np.array_equal(*np.isfinite(balls)):
            continue  # at a rim, where discs are not quite what is seen of spheres
        balls = [to_ball(eye, along, sim.x[n], 0.12) for n in range(BALLS)]
        faces = [to_triangle(eye, along, sim.x[face]) for face in sim.faces]
        first = {"ball": min(balls), "face": min(faces), "table": to_table(eye, along)}
        kind = min(first, key=first.get)
        found = picking.particle_at(sim, camera, window, pixel, near=0.0)
        if not np.isfinite(first[kind]):
            kind, expected = "nothing", None
        elif kind == "ball":
            expected = int(np.argmin(balls))
        elif kind == "face":
            corners = sim.faces[int(np.argmin(faces))]
            away = np.linalg.norm(places[corners] - pixel, axis=1)
            expected = int(corners[np.argmin(away)])
        else:
            expected = None
        met.add(kind)
        assert found == expected, (kind, pixel)
    assert len(met) >= 3


@pytest.mark.parametrize("seed", range(4))
def test_what_is_put_into_space_lies_before_what_is_seen_there_and_touches_it(seed):
    """A cloth, a ball, the table, or the floor; where nothing is, or only what is outside the
    world, it is in the plane of what one looks at.
    """
    sim, camera, window, pixels = views(seed)
    hand, radius, met, beyond = Hand(sim, camera, window), 0.03, 0, 0
    low, high = sim.scene.world.low, sim.scene.world.high
    for pixel in pixels:
        eye, along = camera.ray(window.to_world(pixel))
        ways = [
            *(to_triangle(eye, along, sim.x[face]) for face in sim.faces),
            *(to_ball(eye, along, sim.x[n], 0.12) for n in range(BALLS)),
            to_table(eye, along),
            eye[1] / -along[1] if eye[1] > 0 > along[1] else np.inf,
        ]
        place, first = hand.put(pixel, radius), min(ways)
        if not np.isfinite(first):
            np.testing.assert_allclose(place, hand.place(pixel))
            continue
        point = eye + first * along
        depth_inside = np.minimum(point - low, high - point)
        if first == ways[-1]:
            depth_inside[1] = np.inf
        if depth_inside.min() < -radius:  # a floor has no end, and the world has
            np.testing.assert_allclose(place, hand.place(pixel))
            beyond += 1
        if depth_inside.min() < radius:
            continue
        towards = point - place
        if abs(np.linalg.norm(towards) - radius) > 1e-6:
            rim = [to_ball(eye, along, x, f * 0.12) for x in sim.x[:BALLS] for f in (0.8, 1.1)]
            assert np.isfinite(rim).any()  # of which discs are not quite what is seen
            continue
        assert towards @ along > 0
        met += 1
    assert met > 5 and beyond > 3


def test_what_was_put_before_a_ball_is_there_again_in_a_replay_and_a_log_of_old_replays_as_it_did():
    ball = np.array([300.0, 200.0, -150.0])
    scene = Scene("fake", world("spawn", 3), Particles.build([ball]))
    camera, recorded, sim = camera_of_world(scene.world), Recorded(), FakeSimulation(scene)
    view = Script([press("left", tuple(camera.project([ball])[0][0] + [3.0, -2.0]))], [])
    view.camera = camera
    app.run(sim, view, recorder=recorded, status=False, device="test")
    ((_, put, *_),) = calls(sim, "spawn")
    touching = sim.radii()[0] + scene.particle_defaults.radius
    assert np.linalg.norm(put - ball) == pytest.approx(touching) and put[2] < ball[2]
    (event,) = [event for _, event in recorded if event.kind == "press"]
    assert event.about == put
    for logged, expected in ((event, put), (replace(event, about=None), None)):
        again, camera = FakeSimulation(scene), camera_of_world(scene.world)
        tools = Controls(again, camera, (600, 400))
        tools.apply(logged, replayed=True)
        ((_, found, *_),) = calls(again, "spawn")
        assert found == (expected or tuple(camera.unproject(event.pos)))


def test_the_wheel_comes_nearer_to_the_obstacle_that_is_under_the_pointer():
    met = 0
    for sim, camera, window, pixels in map(views, range(3)):
        controls = Controls(sim, camera, WINDOW)
        for pixel in pixels:
            eye, along = camera.ray(window.to_world(pixel))
            table = to_table(eye, along)
            faces = [to_triangle(eye, along, sim.x[face]) for face in sim.faces]
            balls = [to_ball(eye, along, x, 0.14) for x in sim.x[:BALLS]]
            near = np.linalg.norm(picking.seen(sim.x, camera, window)[0] - pixel, axis=1).min()
            if np.isfinite(table) and table < min(*faces, *balls) and near > 2 * picking.NEAR:
                event = controls.aimed(Event("wheel", pos=tuple(pixel), delta=1.0))
                np.testing.assert_allclose(event.about, eye + table * along, atol=1e-9)
                met += 1
    assert met > 3
