"""What meters read: energy and where it went, against closed forms; margin, strain, momentum."""

import math
from dataclasses import replace

import numpy as np
import pytest
from discrete import DISCRETE
from selection import mostly_thorough
from test_stability import tangle

from taichi_cloth.kernels import methods
from taichi_cloth.kernels.forces import bending
from taichi_cloth.limits.eigenmodes import stable_step
from taichi_cloth.limits.matrices import stiffness_and_damping
from taichi_cloth.limits.network import Network
from taichi_cloth.limits.tracking import FastestMode
from taichi_cloth.scene.holding import Hold
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.scene.stencils import Stencils
from taichi_cloth.simulation.energy_account import power_of
from taichi_cloth.simulation.gauges import Gauges
from taichi_cloth.simulation.history import History
from taichi_cloth.simulation.simulation import Simulation

K, MASS, AMPLITUDE = 0.04, 1.0, 50.0
OMEGA2 = K / MASS

FREE = World((400.0, 200.0), gravity=(0.0, 0.0))


def oscillator(drag=0.0, dashpot=0.0):
    """One mass on one spring, at rest `AMPLITUDE` beyond the rest length."""
    scene = build("oscillator", stiffness=K, amplitude=AMPLITUDE)
    viscous = np.where(scene.particles.fixed, 0.0, drag)
    springs = replace(scene.springs, damping=np.full(1, dashpot))
    return replace(scene, particles=replace(scene.particles, viscous=viscous), springs=springs)


def bent(fixed, velocity, height, springs=None):
    """Three particles of a row that resists being bent, the middle one out of line by `height`."""
    x = np.array([[100.0, 50.0], [110.0, 50.0 + height], [120.0, 50.0]])
    row = Stencils.build(np.array([[1, 0, 2]]), np.array([[-0.2, 0.1, 0.1]]), 4.0)
    tied = Springs.none() if springs is None else Springs.build([(0, 1), (1, 2)], x, **springs)
    return Scene("bent", FREE, Particles.build(x, velocity, fixed=fixed), tied, stencils=row)


def booked(sim, frames, every=1):
    """What an account says after so many frames, read after every so many of them."""
    gauges = Gauges(sim, paced=False)
    gauges.after_frame(0.0)
    for frame in range(1, frames + 1):
        gauges.before_frame()
        sim.advance(1)
        if frame % every == 0:
            gauges.after_frame(frame / 60)
            assert len(gauges.network.position) == len(sim.positions())  # the next is read anew
    return gauges.state.booked


@pytest.mark.parametrize("method", mostly_thorough(methods.METHODS, ["symplectic_euler", "rk4"]))
def test_drift_is_what_the_discrete_map_makes_of_energy(pool, method):
    """Without damping all change is the method's: that of its one-step matrix, to round-off."""
    h, frames = 1.5, 60 if method != "explicit_euler" else 10  # which grows to the walls
    sim = pool(oscillator(), method, h, **({"tolerance": 1e-12} if method[:2] == "im" else {}))
    book = booked(sim, frames)
    x, v = np.linalg.matrix_power(DISCRETE[method](h, OMEGA2), frames) @ [AMPLITUDE, 0.0]
    expected = 0.5 * (MASS * v * v + K * x * x) - 0.5 * K * AMPLITUDE**2
    assert book.work == book.by_hand == 0.0
    solved = 1e-5 if methods.load(method).claims.implicit or method in ("vbd", "xpbd") else 1e-12
    assert book.drift == pytest.approx(expected, rel=1e-9, abs=solved * 0.5 * K * AMPLITUDE**2)


@pytest.mark.parametrize("damped_by", ["drag", "dashpot"])
def test_a_damped_swing_loses_what_the_closed_form_says(pool, damped_by):
    """The work of damping by the trapezoidal rule: its error falls as the square of the time
    between readings, `doubt` says how large it is, and rk4 itself drifts by next to nothing."""
    c, h, frames = 0.02, 0.5, 120
    decay, time = c / 2 / MASS, frames * h
    swing = math.sqrt(OMEGA2 - decay**2)
    phase = np.array([math.cos(swing * time), math.sin(swing * time)])
    x = AMPLITUDE * math.exp(-decay * time) * (phase @ [1.0, decay / swing])
    v = -AMPLITUDE * math.exp(-decay * time) * phase[1] * OMEGA2 / swing
    lost = 0.5 * (MASS * v * v + K * x * x) - 0.5 * K * AMPLITUDE**2
    assert lost < -10.0
    errors = []
    for every in (1, 2):
        book = booked(pool(oscillator(**{damped_by: c}), "rk4", h), frames, every)
        errors.append(book.work - lost)
        assert book.change == pytest.approx(lost, rel=1e-5)
        assert book.drift == pytest.approx(-errors[-1], abs=1e-3)
        assert 0.5 * abs(errors[-1]) < book.doubt < 2 * abs(errors[-1]) < 0.01 * abs(lost)
    assert errors[1] / errors[0] == pytest.approx(4.0, rel=0.1)


def test_what_is_set_by_hand_leaves_no_half_of_a_pair_in_doubt(pool):
    """`doubt` compares two parts of the work's integral with both at once. Velocities that are set
    after the first of them, to nearly what they were, begin a new pair and add no doubt.
    """
    doubts = []
    for touched in (None, 16):
        sim = pool(oscillator(drag=0.02), "rk4", 0.5)
        gauges = Gauges(sim, paced=False)
        gauges.after_frame(0.0)
        for frame in range(1, 121):
            gauges.before_frame()
            sim.advance(1)
            if frame == touched:
                sim.set(velocities=1.001 * sim.velocities())
            gauges.after_frame(frame / 60)
        doubts.append(gauges.state.booked.doubt)
    assert doubts[1] < 2 * doubts[0]


@pytest.mark.parametrize("method", ["rk4", "symplectic_euler"])
def test_pushes_changes_by_hand_and_breaks_are_no_drift(pool, method):
    """A push on a free body, a velocity that is set, and a spring that breaks with what it had."""
    world = World((400.0, 200.0), gravity=(0.0, 0.0), mouse="blow")
    body = Scene("body", world, Particles.build([[50.0, 50.0]], mass=2.0), Springs.none())
    sim = pool(body, method, 0.5, substeps=2)
    gauges = Gauges(sim, paced=False)
    gauges.after_frame(0.0)
    sim.hold([[0.3, 0.0]])
    for _ in range(20):
        gauges.before_frame()
        sim.advance(1)
    gauges.after_frame(0.1)
    speed = 0.3 / 2.0 * 10.0
    assert gauges.state.booked.work == pytest.approx(0.5 * 2.0 * speed**2)
    assert gauges.state.momentum == pytest.approx([2.0 * speed, 0.0])
    sim.hold([[0.0, 0.0]])
    sim.set(velocities=[[0.0, 4.0]])
    gauges.before_frame()
    sim.advance(1)
    gauges.after_frame(0.2)
    book = gauges.state.booked
    assert book.by_hand == pytest.approx(0.5 * 2.0 * (4.0**2 - speed**2))
    assert abs(book.drift) < 1e-9

    x = np.array([[100.0, 50.0], [110.0, 50.0]])
    apart = [[-1.0, 0.0], [1.0, 0.0]]
    springs = Springs.build([(0, 1)], x, stiffness=0.5, break_force=0.9)
    sim = pool(Scene("pair", world, Particles.build(x, apart), springs), "symplectic_euler", 0.01)
    gauges = Gauges(sim, paced=False)
    gauges.after_frame(0.0)
    for frame in range(200):
        sim.advance(1)
        gauges.after_frame(frame / 60)
    book = gauges.state.booked
    assert gauges.state.broken == 1 and gauges.state.spring == -1
    assert book.work == pytest.approx(-(0.9**2) / (2 * 0.5), rel=0.03)  # a step of 0.02 in length
    assert abs(book.drift) < 0.01 * abs(book.work)


@pytest.mark.parametrize("at_once", [True, False])
def test_a_spring_that_is_cut_takes_what_it_had_and_not_what_breaks_it(pool, at_once, monkeypatch):
    """Cut while it is hardly pulled, and read some steps later: in its place (`Storage.cut`) as by
    a load, that is a change by hand, and no work of 0.5 F^2 / k that would show as drift.
    """
    x = np.array([[100.0, 50.0], [110.0, 50.0]])
    springs = Springs.build([(0, 1)], x, stiffness=0.5, break_force=5.0)
    pair = Scene("pair", FREE, Particles.build(x, [[-1.0, 0.0], [1.0, 0.0]]), springs)
    sim = pool(pair, "rk4", 0.01)
    if not at_once:
        monkeypatch.setattr(type(sim.storage), "cut", lambda self, *how: False)
    gauges = Gauges(sim, paced=False)
    gauges.after_frame(0.0)
    sim.advance(20)
    gauges.after_frame(0.1)
    had = gauges.state.booked.energy.potential["springs"]
    sim.cut([0])
    sim.advance(3)
    gauges.after_frame(0.2)
    book = gauges.state.booked
    assert book.by_hand == pytest.approx(-had, rel=1e-5) and book.work == 0.0
    assert abs(book.drift) < 1e-6 * had


def test_a_spring_takes_what_it_has_where_it_is_gone_also_after_a_long_step(pool):
    """Read after every step: rk4 keeps energy, so what the spring had passed its break force by is
    gone with it, and is no drift.
    """
    x = np.array([[100.0, 50.0], [110.0, 50.0]])
    springs = Springs.build([(0, 1)], x, stiffness=0.05, break_force=0.06)
    pair = Scene("pair", FREE, Particles.build(x, [[-1.0, 0.0], [1.0, 0.0]]), springs)
    sim = pool(pair, "rk4", 0.4)
    book = booked(sim, 10)
    assert not sim.springs_alive()[0]
    assert book.work < -1.5 * 0.06**2 / (2 * 0.05)
    assert abs(book.drift) < 1e-4 * abs(book.work)


def test_what_breaks_takes_the_bending_that_needs_it(pool):
    """A bent row whose one spring is torn, and with it the row's resistance: rk4 drifts by next to
    nothing, so all of that energy is booked as work.
    """
    springs = {"stiffness": 0.05, "break_force": [0.05, np.inf]}
    scene = bent([False] * 3, [[-1.0, 0.0], [0.0, 0.0], [0.0, 0.0]], 3.0, springs)
    sim = pool(scene, "rk4", 0.05)
    gauges = Gauges(sim, paced=False)
    gauges.after_frame(0.0)
    bends = []
    for frame in range(120):
        sim.advance(1)
        gauges.after_frame(frame / 60)
        bends.append(gauges.state.booked.energy.potential["bending"])
    assert gauges.state.broken == 1 and bends[0] > 0 and bends[-1] == 0
    assert abs(gauges.state.booked.drift) < 1e-3 * max(bends)


def test_what_is_moved_against_bending_gives_energy():
    """The power of a fixed end that is carried on is the rate at which the row's energy grows by
    its motion alone: a difference quotient of the energy.
    """
    scene = bent([True, False, True], [[0.0, 0.0], [0.0, 0.0], [0.0, 0.5]], 1.0)
    particles, way = scene.particles, 1e-5 * scene.particles.velocity
    behind, ahead = (
        bending.energy(particles.position + s * way, None, None, particles, scene.stencils)
        for s in (-1, 1)
    )
    power = power_of(Network.from_scene(scene), 0.0)
    assert abs(power) > 0.01
    assert power == pytest.approx((ahead - behind) / 2e-5, rel=1e-6)


def test_a_hold_that_is_dragged_gives_energy_by_hand(device):
    """A swing on a held spring, whose place then jumps: all change is by hand and its dashpot's."""
    world = World((400.0, 200.0), gravity=(0.0, 0.0), tools=True)
    body = Scene("body", world, Particles.build([[50.0, 50.0]], mass=2.0), Springs.none())
    sim = Simulation(body, "rk4", 0.05, execution="serial")
    gauges = Gauges(sim, paced=False)
    gauges.after_frame(0.0)
    sim.grab([0], [50.0, 50.0], stiffness=0.4, damping=0.1)
    given = 0.0
    for frame in range(200):
        if frame in (10, 40):
            x, place = sim.positions()[0], np.array([50.0 + frame, 50.0])
            given -= 0.5 * 0.4 * ((x - sim.held().place) ** 2).sum()
            sim.drag(place)
            given += 0.5 * 0.4 * ((x - place) ** 2).sum()
        gauges.before_frame()
        sim.advance(1)
        gauges.after_frame(frame / 60)
    book = gauges.state.booked
    assert book.by_hand == pytest.approx(given) and book.work < -1.0
    assert abs(book.drift) < 1e-4 * given


def test_contacts_with_an_account_are_work(device):
    """A body that bounces and one that slides to a stop: verlet, exact in free fall, drifts not."""
    world = World(size=(100.0, 50.0), gravity=(0.0, -9.81), dt=0.01, up="y")
    plane = Obstacle.build(
        "plane", point=[0.0, 1.0], normal=[0.0, 1.0], friction=0.3, restitution=0.5
    )
    bodies = Particles.build([[10.0, 1.6], [20.0, 1.1]], [[0, 0], [2, 0]], mass=2.0, radius=0.1)
    scene = Scene("plane", world, bodies, Springs.none(), obstacles=(plane,))
    sim = Simulation(scene, "verlet", execution="serial", accounts_contacts=True)
    book = booked(sim, 200)
    assert book.change == pytest.approx(-2.0 * 9.81 * 0.5 - 0.5 * 2.0 * 2.0**2)
    assert book.work == pytest.approx(book.change) and abs(book.drift) < 1e-9


@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_the_mode_that_is_followed_is_that_of_the_exact_limit(damping):
    """At a state, and again where the particles have moved; its spring is named alike."""
    scene = tangle(damping=damping, drag=0.0)
    for method in ("symplectic_euler", "rk4"):
        module = methods.load(method)
        mode = FastestMode(module)
        for moved in (0.0, 3.0):
            x = scene.particles.position + moved * np.random.default_rng(2).random((6, 2))
            network = Network.from_scene(scene, x)
            exact = stable_step(module, network)
            found = [mode.follow(network, exact.dt, 40) for _ in range(10)][-1]
            assert found.limit.dt == pytest.approx(exact.dt, rel=0.03 if damping else 2e-3)
            # With dashpots two springs are nearly even, and rk4's modes are no common ones.
            assert found.limit.spring == exact.spring or damping
            assert found.error < 0.01


def test_the_mode_that_is_followed_is_made_of_springs_bending_holds_and_drag():
    """Its eigenvalue of h^2 K + 2 h C, and each part of it, are those of the whole matrices."""
    rng = np.random.default_rng(3)
    scene = tangle(damping=0.1, drag=0.0)
    particles = replace(scene.particles, viscous=rng.uniform(0.1, 1.0, 6))
    weight = np.array([[-2.0, 1.0, 1.0], [-3.0, 2.0, 1.0]])
    rows = Stencils.build([[2, 1, 3], [4, 3, 5]], weight, [0.1, 0.2])
    who, two = np.array([2, 4]), np.zeros((2, 2))
    hold = Hold(who, two, two[0], np.array([0.7, 0.4]), np.array([0.3, 0.1]), np.ones(2))
    world = replace(scene.world, tools=True, held=hold)
    network = Network.from_scene(replace(scene, world=world, particles=particles, stencils=rows))
    matrices = [of.toarray() for of in stiffness_and_damping(network)]
    for h in (0.1, 2.0):  # mostly C, mostly K
        mode = FastestMode(methods.load("symplectic_euler"))
        for _ in range(6):
            mode.follow(network, h, 40)
        made = mode.shares
        values, vectors = np.linalg.eigh(h * h * matrices[0] + 2 * h * matrices[1])
        assert h * h * made.omega2 + 2 * h * made.d == pytest.approx(values[-1], rel=1e-4)
        u = np.zeros((6, 2))
        u[1:] = vectors[:, -1].reshape(5, 2) / np.sqrt(particles.mass[1:, None])
        square = (u**2).sum(axis=1)
        expected = {
            "held": (hold.stiffness * square[who]).sum(),
            "drag": (particles.viscous * square).sum() + (hold.damping * square[who]).sum(),
            "bending": (rows.bending * (rows.curvature(u) ** 2).sum(axis=1)).sum(),
            "air": 0.0,
        }
        of_u = [vectors[:, -1] @ matrix @ vectors[:, -1] for matrix in matrices]
        sums = made.stiffness.sum(), made.damping.sum()
        expected["springs"] = of_u[0] - expected["held"] - expected["bending"]
        expected["dashpots"] = of_u[1] - expected["drag"]
        found = vars(made) | dict(zip(("springs", "dashpots"), sums, strict=True))
        for name, value in expected.items():
            assert found[name] == pytest.approx(value, rel=0.03, abs=1e-3 * sum(of_u)), (h, name)


def test_reading_changes_no_bit_and_names_the_strained_spring(device, pool):
    """A cloth that is blown on and tears, with gauges and without."""
    scene = build("cloth", columns=8, rows=6, break_force=1.2, damping=0.05)

    def run(sim, gauges):
        for frame in range(40):
            if frame in (3, 4, 5):
                sim.blow([180.0, 60.0], [40.0, 10.0])
            if gauges:
                gauges.before_frame()
            sim.advance(1)
            if gauges:
                gauges.after_frame(frame / 60)
        return sim.positions(), sim.velocities(), sim.springs_alive()

    plain = run(pool(scene), None)
    sim = pool(scene, another=True)
    gauges = Gauges(sim, paced=False)
    for a, b in zip(plain, run(sim, gauges), strict=True):
        assert np.array_equal(a, b)
    state, springs = gauges.state, scene.springs
    assert state.broken == (~plain[2]).sum() > 0
    a, b = springs.between[state.spring]
    length = np.linalg.norm(plain[0][a] - plain[0][b])
    assert state.ends == (a, b)
    assert state.strain == pytest.approx(length / springs.rest_length[state.spring] - 1)
    assert len(gauges.margins) == 4 and gauges.margin.used > 0


def test_a_history_keeps_the_last_seconds():
    history = History(seconds=2.0, rows=50, columns=1)
    for n in range(500):
        history.note(n / 10, n)
    age, values = history.last(49.9)
    assert age[-1] == 0.0 and age[0] == pytest.approx(2.1) and values[0, 0] == 478
    assert history.rate(49.9) == pytest.approx(10.0)
    history.clear()
    assert len(history) == 0 and history.rate(0.0) == 0.0
