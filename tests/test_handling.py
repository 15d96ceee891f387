"""What mouse tools do: what they hit, what the physics of it is, and that logs do it again."""

from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
import small
from inside import state_of
from null_view import NullView
from selection import mostly_thorough

from taichi_cloth import load_events
from taichi_cloth.errors import InputError
from taichi_cloth.files.events import Recorder
from taichi_cloth.render.camera import Camera
from taichi_cloth.render.window_map import WindowMap
from taichi_cloth.scene import library
from taichi_cloth.scene.model import ParticleDefaults, Particles, Scene, World
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.storage.storage import Storage
from taichi_cloth.ui import app, picking
from taichi_cloth.ui.camera_moves import CameraMoves
from taichi_cloth.ui.controls import Controls
from taichi_cloth.ui.depiction import Depiction
from taichi_cloth.ui.framing import camera_of_world
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.tools import throw
from taichi_cloth.ui.tools.contract import Hand

pytestmark = pytest.mark.usefixtures("device")

CLOTH = library.build("cloth", columns=8, rows=6).with_world(tools=True)
COLLIDING = CLOTH.with_world(collisions=True)  # so that throwing a ball compiles nothing
WINDOW = (600, 400)


@pytest.fixture(scope="module")
def made(device):
    """Simulations that tests share, by method, topology and scene, each at its start."""
    found = {}

    def get(method="symplectic_euler", topology="graph", substeps=1, scene=CLOTH):
        key = method, topology, scene.world.collisions
        if key not in found:
            how = {"topology": topology, "execution": "serial", "lanes": 2}
            found[key] = Simulation(scene, method, **how)
        found[key].load_scene(scene, substeps=substeps)
        return found[key]

    return get


def key(name):
    return [Event("press", key=name), Event("release", key=name)]


def drag(*places, button="left", held=()):
    """Turns of events: the button goes down at the first place, and up at the last."""
    down = [Event("press", key=name) for name in held]
    up = [Event("release", key=name) for name in held]
    first, last = places[0], places[-1]
    moved = [[Event("move", pos=place)] for place in places[1:]]
    return [
        [Event("move", pos=first), *down, Event("press", pos=first, button=button)],
        *moved,
        [Event("release", pos=last, button=button), *up],
    ]


def click(place, button="left"):
    return [
        Event("move", pos=place),
        Event("press", pos=place, button=button),
        Event("release", pos=place, button=button),
    ]


class Hands(NullView):
    """A window that does as it is told, turn by turn."""

    visible = True

    def __init__(self, world, size, turns, camera=None):
        super().__init__(world, size)
        self.turns, self.camera, self.pictures = list(turns), camera, []

    def poll(self):
        return self.turns.pop(0) if self.turns else []

    def draw(self, picture):
        self.pictures.append(picture)


def end(sim):
    return [sim.positions(), sim.velocities(), sim.storage.marks(), sim.springs(), sim.fixed()]


def spot(sim, particle):
    """Where a particle of a plane is in the window at the start."""
    x = sim.scene.particles.position[particle]
    return tuple(float(number) for number in WindowMap.of(sim.scene.world, WINDOW).to_window(x))


def everything(sim):
    """Turns in which each tool is used."""
    x, y = spot(sim, 27)
    return [
        [],
        key("g"),
        *drag((x + 3, y), (x + 20, y - 10), (x + 50, y - 20), (x + 80, y - 20)),
        *drag((x + 4, y - 40), (x + 20, y - 60), held=("shift",)),
        key("c"),
        *drag((x - 90, y + 12), (x, y + 14), (x + 90, y + 10)),
        key("i"),
        click(spot(sim, 0)),
        [Event("move", pos=spot(sim, 7))],
        click(spot(sim, 7)),
        click(spot(sim, 7)),
        key("j"),
        click((60.0, 60.0), "right"),
        click((90.0, 70.0)),
        click((120.0, 75.0)),
        key("n"),
        click((200.0, 60.0)),
        key("t"),
        *drag((80.0, 300.0), (120.0, 280.0), (150.0, 270.0)),
        key("b"),
        [Event("move", pos=(x, y))],
        [Event("move", pos=(x + 30, y + 5))],
        [],
    ]


def recorded(path, sim, turns):
    """Run turns in a window, and write its log."""
    view = Hands(sim.scene.world, WINDOW, turns)
    with Recorder(path, app.log_header(sim, view)) as recorder:
        frames = len(turns) + 6  # without a bar and a strip, which take clicks
        app.run(sim, view, frames=frames, recorder=recorder, status=False, device="test")
    return end(sim), view


def test_every_tool_replays_to_the_bit_and_hits_the_same_elsewhere(made, tmp_path):
    path = tmp_path / "log.jsonl"
    sim = made(scene=COLLIDING)
    turns = everything(sim)
    live, view = recorded(path, sim, turns)
    log = load_events(path)
    assert log.header["tools"] is True
    events = [event for of_frame in log.by_frame.values() for event in of_frame]
    done = {event.kind for event in events}
    expected = {"grab", "drag", "let_go", "cut", "pin", "unpin", "link", "chain", "ball", "tool"}
    assert expected <= done
    assert any(picture.pointer and picture.pointer.ring for picture in view.pictures)

    def again(size, **how):
        other = made(scene=COLLIDING, **how)
        frames = len(turns) + 6
        view = NullView(CLOTH.world, size)
        app.run(other, view, frames=frames, replay=load_events(path), quiet=True, device="test")
        return end(other)

    for a, b in zip(live, again((1000, 500)), strict=True):
        assert a.tobytes() == b.tobytes()
    (cut,) = [set(event.values["springs"]) for event in events if event.kind == "cut"][:1]
    for finer in (again(WINDOW, substeps=3), again(WINDOW, method="verlet")):
        assert [len(part) for part in finer] == [len(part) for part in live]
        assert (finer[2][sorted(cut), 0] == live[2][sorted(cut), 0]).all()
        np.testing.assert_array_equal(finer[3], live[3])
        np.testing.assert_array_equal(finer[4], live[4])


def test_a_tool_that_is_chosen_by_name_is_in_the_log(made):
    sim, noted = made(), []
    controls = Controls(sim, None, WINDOW, note=noted.append)
    controls.choose("cut")
    assert controls.tool.name == "cut" and noted == [Event("tool", name="cut")]
    controls.choose("")
    assert controls.tool.name == "blow"
    with pytest.raises(InputError, match="unknown tool 'cat'"):
        controls.choose("cat")
    # A log says which tool is taken up; those from before there were tools have keys alone.
    controls.apply(Event("press", key="g"), replayed=True)
    assert controls.tool.name == "blow"


# The hold


def alone():
    world = World((600.0, 400.0), (0.0, 0.0), tools=True)
    particles = Particles.build([[300.0, 200.0]], mass=2.0)
    return Simulation(Scene("alone", world, particles), topology="graph", execution="serial")


def test_what_is_let_go_keeps_its_velocity_and_its_mass():
    sim = alone()
    sim.grab([0], (310.0, 200.0))
    for frame in range(40):
        sim.drag((310.0 + 2.0 * frame, 200.0 + frame))
        sim.advance()
    x, v = sim.positions(), sim.velocities()
    # It follows the pointer, and is behind it by what damping holds it back.
    np.testing.assert_allclose(v, [[2.0, 1.0]], rtol=1e-3)
    sim.let_go()
    assert sim.held() is None and sim.storage.scene.particles.mass.tolist() == [2.0]
    sim.advance(10)
    np.testing.assert_array_equal(sim.velocities(), v)
    np.testing.assert_allclose(sim.positions(), x + 10 * v, rtol=1e-14)


@pytest.mark.parametrize("method", ["xpbd", "vbd", "implicit_euler"])
def test_a_hold_is_a_step_of_backward_euler(pool, method):
    """Where methods are implicit, of a frame that is not 1 long:

    v' = (v + h k/m (target - x)) / (1 + h c/m + h^2 k/m).
    """
    h, k, c, m, v = 0.1, 30.0, 4.0, 2.0, 5.0
    world = World((600.0, 400.0), (0.0, 0.0), tools=True, dt=h)
    body = Particles.build([[300.0, 200.0]], [[v, 0.0]], mass=m)
    sim = pool(Scene("alone", world, body), method)
    sim.grab([0], (300.0, 200.0), stiffness=k, damping=c)
    sim.drag((310.0, 200.0))
    assert sim.storage.scene.particles.mass.tolist() == [m]
    sim.advance()
    expected = (v + h * k / m * 10.0) / (1 + h * c / m + h**2 * k / m)
    assert sim.velocities()[0] == pytest.approx([expected, 0.0], rel=1e-12)


WAYS = [
    (method, topology)
    for method in ("symplectic_euler", "rk4", "implicit_euler", "xpbd")
    for topology in ("graph", "lanes")
]


@pytest.mark.parametrize(("method", "topology"), mostly_thorough(WAYS, WAYS[:1]))
def test_a_hold_leaves_a_step_at_its_limit_stable(method, topology, made):
    """The original's cloth is run at the limit of its step, which more stiffness crosses."""
    sim = made(method, topology)
    sim.advance(20)
    particles = [27, 28]
    place = sim.positions()[particles].mean(axis=0)
    sim.grab(particles, place)
    weight = sim.storage.scene.particles.mass[particles]
    # rk4's step has room for it, and implicit methods need none.
    assert (weight >= 1.0).all() and (weight > 1.0).all() == (method == "symplectic_euler")
    sim.advance(400)
    at_rest = sim.positions()
    sim.advance(200)
    assert np.abs(sim.positions() - at_rest).max() < 5.0
    away = np.linalg.norm(sim.positions()[particles] - sim.held().targets, axis=1)
    assert away.max() < 10.0, "it lifts what hangs there"
    sim.let_go()
    np.testing.assert_array_equal(sim.storage.scene.particles.mass, CLOTH.particles.mass)


def test_a_hold_lasts_over_a_change_and_ends_with_a_reset(made):
    sim = made()
    sim.grab([20], sim.positions()[20])
    sim.drag(sim.positions()[20] + [0.0, -30.0])
    sim.spawn((50.0, 50.0))
    sim.advance(60)
    assert np.linalg.norm(sim.positions()[20] - sim.held().targets[0]) < 5.0
    sim.reset()
    assert sim.held() is None
    sim.advance()
    after = sim.positions()
    sim.load_scene(CLOTH)
    sim.advance()
    assert sim.positions().tobytes() == after.tobytes()
    with pytest.raises(InputError, match="no particle 4000"):
        sim.grab([4000], (1.0, 1.0))


def test_a_mass_that_is_set_in_a_hold_is_there_after_it(made):
    sim = made()
    free = sim.storage.scene.particles.mass.copy()
    sim.grab([20, 21], sim.positions()[20], stiffness=1e3)  # so stiff that they weigh more
    held = sim.storage.scene.particles.mass.copy()
    assert (held[20:22] > free[20:22]).all()
    sim.set(mass=7.0, particles=[19, 20])
    grown = sim.storage.scene.particles.mass
    np.testing.assert_allclose(grown[19:22], [7.0, 7.0 + held[20] - free[20], held[21]])
    with pytest.raises(InputError, match="no particle 4000"):
        sim.remove([4000])
    assert sim.held() is not None
    sim.let_go()
    expected = free.copy()
    expected[19:21] = 7.0
    np.testing.assert_array_equal(sim.storage.scene.particles.mass, expected)


# Cuts and pins


def crosses(a, b, c, d):
    """Whether two segments meet, in exact arithmetic."""
    a, b, c, d = ([Fraction(float(number)) for number in point] for point in (a, b, c, d))

    def side(p, q, r):
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    one, other = side(a, b, c) * side(a, b, d), side(c, d, a) * side(c, d, b)
    boxes = all(
        min(a[i], b[i]) <= max(c[i], d[i]) and min(c[i], d[i]) <= max(a[i], b[i]) for i in (0, 1)
    )
    return one <= 0 and other <= 0 and boxes


class Still:
    """What `picking` asks of a simulation: points at random, tied at random."""

    def __init__(self, rng, dim):
        self.x, self.pairs = rng.uniform(0.2, 1.8, (40, dim)), rng.integers(0, 40, (120, 2))
        self.alive = rng.random(120) < 0.8
        world = World((2.0, 2.0, 2.0)[:dim], (0.0,) * dim, up="y")
        self.scene, self.time = Scene("still", world, Particles.build(self.x)), 0.0

    def radii(self):
        return np.zeros(40)

    def positions(self):
        return self.x

    def springs(self):
        return self.pairs

    def springs_alive(self):
        return self.alive


@pytest.mark.parametrize("dim", [2, 3])
def test_a_path_cuts_the_springs_that_it_crosses(dim):
    rng = np.random.default_rng(3)
    sim, world = Still(rng, dim), World((2.0, 2.0, 2.0)[:dim], (0.0,) * dim, up="y")
    camera = Camera.framing(world.size, [0] * 3, [2] * 3, y_up=True) if dim == 3 else None
    window = WindowMap.of(world, WINDOW)
    places = window.to_window(camera.project(sim.x)[0] if camera else sim.x)
    low, high = places.min(axis=0), places.max(axis=0)
    for _ in range(30):
        start, end = rng.uniform(low, high, (2, 2))
        found = picking.springs_across(sim, camera, window, start, end)
        expected = [
            s
            for s, (a, b) in enumerate(sim.pairs)
            if sim.alive[s] and crosses(places[a], places[b], start, end)
        ]
        assert found.tolist() == expected
    assert len(picking.springs_across(sim, camera, window, low, low)) == 0


CUT_WAYS = [(m, t) for m in ("symplectic_euler", "verlet", "xpbd") for t in ("graph", "lanes")]


@pytest.mark.parametrize(("method", "topology"), mostly_thorough(CUT_WAYS, CUT_WAYS[:2]))
def test_cuts_without_a_load_are_those_with_one(method, topology, made, monkeypatch):
    sim = made(method, topology)
    ends = []
    for direct in (True, False):
        if not direct:
            monkeypatch.setattr(Storage, "cut", lambda self, *how: False)
        sim.reset()
        sim.advance(5)
        for first in (1, 20, 33):
            sim.cut([first, first + 1, 50])
            sim.advance(2)
        assert sim.storage.count_broken() == len(sim.springs()) - len(sim.drawn_springs()) == 7
        ends.append(end(sim))
    for a, b in zip(*ends, strict=True):
        assert a.tobytes() == b.tobytes()


METHODS = ("symplectic_euler", "verlet", "xpbd", "vbd", "implicit_euler")
PIN_WAYS = [
    ("cloth", "symplectic_euler", "graph"),
    *(("cloth", method, "lanes") for method in METHODS),
    *(("drape", method, "graph") for method in METHODS[:3:2]),
    ("flag", "symplectic_euler", "graph"),
    ("flag", "xpbd", "lanes"),
]


@pytest.mark.parametrize(
    ("name", "method", "topology"), mostly_thorough(PIN_WAYS, PIN_WAYS[:1] + PIN_WAYS[3:4])
)
def test_pins_in_place_are_those_of_a_load(name, method, topology, made, monkeypatch):
    """Bits of springs that break, of what is held, of bending where it is clamped, of pairs."""
    if name == "cloth":
        sim, pulled = made(method, topology), [0.0, 400.0]
    else:
        scene = small.build(name).with_world(tools=True)
        if name == "flag":  # bending alone, which lies along lines of grids in lanes
            scene = scene.with_world(ground=None, friction=0.0, more={})
            scene = replace(scene, obstacles=())
        how = {"topology": topology, "execution": "serial", "lanes": 2, "substeps": 24}
        sim, pulled = Simulation(scene, method, **how), [0.0, 0.5, 0.0]
    middle = sim.particle_count // 2
    ends = []
    for direct in (True, False):
        if not direct:
            monkeypatch.setattr(Storage, "change_particles", lambda self, *how: False)
        sim.reset()
        sim.advance(5)
        loads = sim.storage.loads
        sim.pin([middle, middle + 1])
        sim.set(particles=[middle + 2], mass=3.0, velocities=pulled)
        sim.advance(2)
        sim.grab([middle + 4], sim.positions()[middle + 4])
        sim.drag(sim.positions()[middle + 4] + pulled)
        sim.advance(3)
        sim.unpin([middle])
        sim.advance(4)
        assert sim.storage.loads == loads + 3
        sim.let_go()
        ends.append((*end(sim), sim.forces()))
    for a, b in zip(*ends, strict=True):
        assert a.tobytes() == b.tobytes()


def test_a_checkpoint_goes_back_over_a_pin(made):
    sim, moments = made(), []
    for chosen in ([], [20]):
        sim.pin(chosen)
        checkpoint = sim.checkpoint()
        sim.advance(3)
        moments.append((checkpoint, end(sim)))
    for checkpoint, ends in moments:
        sim.restore(checkpoint)
        sim.advance(3)
        for a, b in zip(ends, end(sim), strict=True):
            assert a.tobytes() == b.tobytes()


def test_a_pin_takes_the_inverse_mass_and_gives_it_back(made):
    sim = made()
    controls = Controls(sim, None, WINDOW)
    controls.choose("pin")

    def weight():
        state = state_of(sim)
        return float(state.w[int(state.slot[27])])

    controls.apply(click(spot(sim, 27))[1])
    assert sim.fixed()[27] and weight() == 0.0
    x = sim.positions()[27]
    sim.advance(5)
    np.testing.assert_array_equal(sim.positions()[27], x)
    controls.apply(click(spot(sim, 27))[1])
    assert not sim.fixed()[27] and weight() == 1.0
    np.testing.assert_array_equal(sim.colors(), CLOTH.particles.color)


# The camera


def test_drags_on_empty_space_move_the_camera_and_z_goes_back():
    world = World((600.0, 400.0, 500.0), (0.0,) * 3, collisions=True, tools=True)
    particles = Particles.build([[300.0, 200.0, 0.0]], radius=20.0)
    scene = Scene("one", world, particles, particle_defaults=ParticleDefaults(radius=20.0))
    sim = Simulation(scene, topology="graph", execution="serial")
    camera, noted = Camera(world.size), []
    controls = Controls(sim, camera, WINDOW, note=noted.append)
    controls.choose("grab")
    poses = [camera.pose]

    def move(button, start, to):
        for event in (
            Event("move", pos=start),
            Event("press", pos=start, button=button),
            Event("move", pos=to),
            Event("release", pos=to, button=button),
            Event("move", pos=(5.0, 5.0)),
        ):
            controls.apply(event)

    move("left", (30.0, 30.0), (60.0, 20.0))
    poses.append(camera.pose)
    assert poses[1][4:] != poses[0][4:] and poses[1][:4] == poses[0][:4]
    before = camera.project(np.zeros((1, 3)))[0]
    move("right", (300.0, 200.0), (310.0, 215.0))
    poses.append(camera.pose)
    shifted = camera.project(np.zeros((1, 3)))[0] - before
    assert shifted[0] == pytest.approx([10, 15], rel=0.2)
    for event in key("f"):
        controls.apply(event)
    assert camera.centre == pytest.approx([300, 200, 0])
    _, radius, _ = camera.project(sim.positions(), 20.0)
    assert radius[0] > 100, "it fills the picture"
    assert [event.drag for event in noted if event.kind == "view"] == ["turn", "pan", None]
    move("left", (300.0, 200.0), (320.0, 200.0))
    assert [event.kind for event in noted][-2:] == ["grab", "let_go"]  # no drag of the camera
    for pose in reversed(poses):
        for event in key("z"):
            controls.apply(event)
        assert camera.pose == pose
    # Logs of before: a press on empty space was none of the camera's.
    controls.apply(Event("press", pos=(30.0, 30.0), button="right"), replayed=True)
    controls.apply(Event("move", pos=(90.0, 30.0)), replayed=True)
    assert camera.pose == poses[0]


def test_a_link_of_a_chain_is_as_long_as_it_was_clicked_and_does_not_break(made, tmp_path):
    """In `cloth`, whose own springs are 25 long and break at 5; also to one that is there."""
    sim, path = made(), tmp_path / "log.jsonl"
    x, y = spot(sim, 47)
    clicks = click((x + 10, y + 140)), click((x - 140, y + 140)), click((x, y))
    turns = [[], key("j"), *clicks, *[[]] * 30]
    (place, *_), _ = recorded(path, sim, turns)
    count = len(CLOTH.springs)
    added = sim.storage.scene.springs.select(np.arange(count, count + 2))
    np.testing.assert_array_equal(added.between, [[48, 49], [49, 47]])
    assert added.rest_length == pytest.approx([150, np.hypot(140, 140)], rel=0.05)
    assert np.isinf(added.break_force).all() and sim.springs_alive()[count:].all()
    assert np.ptp(place[48:, 0]) == pytest.approx(150, rel=0.1)
    again = made()
    app.run(again, NullView(CLOTH.world, WINDOW), frames=len(turns) + 6, replay=load_events(path))
    for a, b in zip(end(again), end(sim), strict=True):
        assert a.tobytes() == b.tobytes()


@pytest.mark.parametrize("name", ["curtain", "pull"])
def test_what_is_clicked_finds_room_where_faces_meet_obstacles_and_cloths_are_thick(name):
    """Larger fields would compile everything anew, at each click of a chain."""
    scene = library.build(name).with_world(tools=True)
    sim = Simulation(scene, topology="graph", execution="serial")
    fields, above = sim.storage.state, scene.world.high - 0.1
    for link in range(3):
        tied = None if link == 0 else sim.particle_count - 1
        sim.spawn(above - [0.05 * link, 0, 0], tied_to=tied, mass=1e-3, radius=0.01)
    assert sim.storage.state is fields


@pytest.mark.parametrize(("name", "own"), [("g", [10]), ("i", [10]), ("c", [11, 10])])
def test_what_a_click_would_take_is_marked_while_the_pointer_is_over_it(made, name, own):
    sim = made()
    x, y = spot(sim, 10)
    there = (x + 12.0, y + 0.5) if name == "c" else (x + 3.0, y + 2.0)
    turns = [key(name), [Event("move", pos=there)], [], [Event("leave")], [], []]
    view = Hands(sim.scene.world, WINDOW, turns)
    app.run(sim, view, frames=6, status=False, device="test")
    count, pinned = sim.particle_count, int(sim.fixed().sum()) * (name == "i")
    marked = [len(picture.position) - count - pinned for picture in view.pictures[1:]]
    assert marked[1:4] == [len(own)] * 2 + [0] and marked[0] == 0
    found = view.pictures[3].position[count + pinned :]
    np.testing.assert_allclose(found, view.pictures[3].position[own])


def test_what_flew_off_is_not_framed():
    """A few of many; two that are far from each other are what there is."""
    x = np.random.default_rng(5).uniform([200, 100, -50], [400, 300, 50], (200, 3))
    for stray, place in ((3, x), (0, x), (0, np.array([[0.0, 0.0, 0.0], [500.0, 300.0, 0.0]]))):
        seen = np.concatenate([place, np.full((stray, 3), 1e5) * np.arange(1, stray + 1)[:, None]])
        fake = SimpleNamespace(positions=lambda x=seen: x, radii=lambda: np.ones(1))
        camera = Camera((600.0, 400.0, 500.0))
        camera.pose = CameraMoves(camera).framing(fake)
        pixels = camera.project(place)[0] / (600, 400)
        assert (pixels > 0).all() and (pixels < 1).all() and np.ptp(pixels, axis=0).max() > 0.8


@pytest.mark.parametrize("name", ["oscillator", "chain", "cloth"])
def test_a_ball_is_larger_than_what_it_is_thrown_at(name):
    scene, tool = library.build(name), throw.TOOL
    hand = Hand(SimpleNamespace(scene=scene, dt=1.0), None, WindowMap.of(scene.world, WINDOW))
    memory = tool.remember(0)
    tool.press(hand, memory, Event("press", pos=(300.0, 200.0), button="left"))
    (ball,) = tool.release(hand, memory, Event("release", pos=(310.0, 200.0), button="left"))
    assert ball.values["radius"] >= 1.3 * scene.particles.radius.max()


def test_a_ball_is_seen_as_large_as_it_is_however_fine_the_mesh():
    """Knots that are larger than their mesh would hide it, and are drawn smaller; so are those that
    are put or tied to them. Who a ball is does not matter, after particles are removed.
    """
    scene = library.build("cloth", columns=9, rows=7, spacing=2.0)
    sim = Simulation(scene.with_world(tools=True), topology="graph", execution="serial")
    depiction = Depiction(sim)
    knots = depiction.picture().radius
    assert knots == pytest.approx(np.full(63, 0.6)) and (scene.particles.radius == 5.0).all()
    sim.spawn((200.0, 100.0), radius=16.0, mass=50.0)
    sim.spawn((250.0, 100.0), radius=5.0, tied_to=62)
    # What was clicked in is seen, too: a hundredth of the picture's shorter side.
    assert depiction.picture().radius.tolist() == [*knots, 16.0, 4.0]
    sim.remove([0, 1])
    assert depiction.picture().radius.tolist() == [*knots[2:], 16.0, knots[0]]


def test_a_ball_is_thrown_along_the_line_of_sight_or_refused():
    world = World((600.0, 400.0, 500.0), (0.0,) * 3, collisions=True, tools=True)
    sim = Simulation(Scene("empty", world, Particles.none(3)), topology="graph", execution="serial")
    camera, noted = Camera(world.size), []
    controls = Controls(sim, camera, WINDOW, note=noted.append)
    controls.choose("throw")
    for event in click((300.0, 200.0)):
        controls.apply(event)
    (ball,) = [event.values for event in noted if event.kind == "ball"]
    eye, along = camera.ray((300.0, 200.0))
    way = np.array(ball["velocity"])
    np.testing.assert_allclose(way / np.linalg.norm(way), along, atol=1e-12)
    start = np.array(ball["pos"]) - eye
    np.testing.assert_allclose(start / np.linalg.norm(start), along, atol=1e-12)
    camera.centre = np.array([300.0, 900.0, 0.0])  # looks past the box
    for event in click((300.0, 200.0)):
        controls.apply(event)
    place, way = (np.array(noted[-1].values[name]) for name in ("pos", "velocity"))
    aim = camera.centre - place
    np.testing.assert_allclose(way / np.linalg.norm(way), aim / np.linalg.norm(aim), atol=1e-3)
    slinky = Simulation(library.build("slinky"), topology="graph", execution="serial")
    with pytest.raises(InputError, match="a ball would pass through here"):
        slinky.prepare_balls()


@pytest.mark.parametrize("distance", [None, 0.2])
def test_a_ball_that_falls_on_its_way_comes_to_what_was_clicked(pool, distance):
    """In metres and seconds it falls by more than its size before it is there. Close up, where it
    is slow and would fall for seconds, it is thrown faster, and not out of the world.
    """
    hung = Particles.build([[1.0, 0.5, 0.0]], fixed=True, radius=0.05, mass=1.0)
    world = World((2.0, 1.5, 2.0), (0.0, -9.81, 0.0), dt=1 / 60, up="y", tools=True)
    sim = pool(Scene("hung", world, hung))
    sim.reset()
    camera, noted = camera_of_world(world), []
    if distance:  # from the same eye
        camera.centre = camera.eye + distance * camera.rotation()[2]
        camera.distance = distance
    controls = Controls(sim, camera, WINDOW, note=noted.append)
    controls.choose("throw")
    place, _, _ = camera.project(hung.position, hung.radius)
    for event in click(tuple(WindowMap.of(world, WINDOW).to_window(place)[0])):
        controls.apply(event)
    (ball,) = [event.values for event in noted if event.kind == "ball"]
    t = np.linspace(0.0, 0.4, 4001)[:, None]
    path = np.array(ball["pos"]) + t * ball["velocity"] + 0.5 * t**2 * world.gravity
    apart = np.linalg.norm(path - hung.position[0], axis=1)
    assert apart[0] > 0.5 and apart.min() < ball["radius"] + 0.05
    way = path[: apart.argmin()]
    assert ((way > world.low) & (way < world.high)).all()
    rises = np.cross(way - way[0], hung.position[0] - way[0]) / apart[0]
    assert np.linalg.norm(rises, axis=1).max() <= apart[0] / 8 + 0.01


@pytest.mark.thorough
def test_a_ball_makes_a_scene_collide_on_the_graph():
    """However a run was asked for, so that a replay, which asks for its lanes, does the same."""
    place = [CLOTH.particles.position[:, 0].mean(), CLOTH.particles.position[:, 1].min() + 40]
    ball = {"pos": place, "velocity": [0.5, 4.0], "radius": 16.0, "mass": 50.0}
    sim = Simulation(CLOTH, topology="lanes", lanes=2, execution="serial")
    sim.advance(2)
    before = sim.checkpoint()
    ends = []
    for _ in range(2):
        assert (sim.topology, sim.scene.world.collisions) == ("lanes", False)
        throw.TOOL.events[0].replay(sim, ball)
        assert (sim.topology, sim.scene.world.collisions) == ("graph", True)
        sim.advance(30)
        ends.append(end(sim))
        sim.restore(before)
    for a, b in zip(*ends, strict=True):
        assert a.tobytes() == b.tobytes()
    sim.advance(30)
    assert np.abs(ends[0][0][:-1] - sim.positions()).max() > 1.0, "the ball meets the cloth"
