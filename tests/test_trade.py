"""The measured trade: errors against closed forms, references, fronts, files, choices."""

import csv
import errno
import itertools
import json
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import commands
import numpy as np
import pytest
from discrete import DISCRETE
from selection import thorough

from taichi_cloth.cli.main import main
from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.files import pending
from taichi_cloth.kernels import methods
from taichi_cloth.limits.bounds import any_geometry, grows_within
from taichi_cloth.limits.eigenmodes import stable_step
from taichi_cloth.limits.network import Network
from taichi_cloth.measuring.timing import Quiet
from taichi_cloth.measuring.worker import Worker, WorkerFailed
from taichi_cloth.scene import library
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.settings.sweeps import TradeOptions
from taichi_cloth.simulation.diagnostics import ContactAccount, Work
from taichi_cloth.trade import ode, plot, reference, rows, settings, trial
from taichi_cloth.trade.command import FILES, write
from taichi_cloth.trade.errors import (
    Breaks,
    Contacts,
    Invariants,
    Samples,
    distance,
    rms_by_frame,
)
from taichi_cloth.trade.outcomes import Outcome, Result, StudyFailure, failed_by
from taichi_cloth.trade.runner import Study
from taichi_cloth.trade.settings import Setting

CONTRACT = (
    "method,dt,substeps,iterations,precision,fast_math,arch,error_final_rms,error_final_max,"
    "error_trajectory,energy_drift,max_strain,wall_seconds,force_evaluations,sweeps,status,pareto"
)

OF_SECONDS = "error_second", "error_second_middle", "seconds", "seconds_known"
OF_CONTACTS = "penetration_max", "contact_energy", "first_touch_later"


def read(folder):
    """The rows of a folder's CSV, numbers as numbers."""

    def value(name, text):
        if name in ("method", "precision", "arch", "status", "command", "scene_hash", "timed_on"):
            return text
        if text in ("", "true", "false"):
            return {"": None, "true": True, "false": False}[text]
        try:
            return float(text)
        except ValueError:
            return text

    with (folder / "trade.csv").open(newline="") as file:
        return [{k: value(k, v) for k, v in row.items()} for row in csv.DictReader(file)]


@pytest.fixture(scope="module")
def oscillator(cli, tmp_path_factory):
    """A trade of the oscillator: its folder, and what it printed."""
    folder = tmp_path_factory.mktemp("oscillator")
    chosen = ["--methods", "symplectic_euler,verlet", "--substeps", "1,2,4", "--frames", 20]
    arguments = ["trade", "oscillator", *chosen, "--within", "110s", "--output", folder]
    return folder, *cli(*arguments)


# ------------------------------------------------------------------------------------------
# Errors and references


def test_errors_are_those_of_the_exact_discrete_map(oscillator):
    """On x'' = -w^2 x each method is a matrix, and the closed form a cosine."""
    amplitude, omega, frames = 50.0, 0.1, 20
    exact = amplitude * np.cos(omega * np.arange(1, frames + 1))
    seen = 0
    for row in read(oscillator[0]):
        if row["precision"] != "f64":
            continue
        step = np.linalg.matrix_power(
            DISCRETE[row["method"]](row["step"], omega**2), int(row["substeps"])
        )
        state, x, v = np.array([amplitude, 0.0]), [], []
        for _ in range(frames):
            state = step @ state
            x.append(state[0])
            v.append(state[1])
        error = np.abs(np.array(x) - exact)
        assert row["error_final_rms"] == pytest.approx(error[-1], rel=1e-6)
        assert row["error_final_max"] == pytest.approx(error[-1], rel=1e-6)
        assert row["error_trajectory"] == pytest.approx(np.sqrt((error**2).mean()), rel=1e-6)
        energy = 0.5 * np.array(v) ** 2 + 0.5 * omega**2 * np.array(x) ** 2
        start = 0.5 * omega**2 * amplitude**2
        # The scale is the largest kinetic and elastic energy of the reference, here constant.
        assert row["energy_drift"] == pytest.approx(np.abs(energy / start - 1).max(), rel=1e-6)
        stretch = max(amplitude, np.abs(x).max()) / 150.0
        assert row["max_strain"] == pytest.approx(stretch, rel=1e-9)
        assert row["force_evaluations"] == frames * row["substeps"]
        if row["substeps"] > 1:
            order = methods.load(row["method"]).claims.order
            assert row["order"] == pytest.approx(order, abs=0.05)
        seen += 1
    assert seen == 6


def test_closed_forms_of_scenes_solve_their_equations():
    """Against DOP853 on forces that know nothing of them, in every scene that has one."""
    known = [name for name in library.names() if library.solution(name)]
    assert {"oscillator", "chain"} <= set(known)
    times = np.linspace(0.0, 40.0, 9)
    for name in known:
        scene = library.build(name)
        solved = ode.solve(scene, times)
        assert solved.event is None and solved.until == times[-1]
        x, v = library.solution(name)(scene, times)
        np.testing.assert_allclose(x, solved.x, rtol=0, atol=1e-9)
        np.testing.assert_allclose(v, solved.v, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("length", "time"), [(1e-9, 1e9), (1e-9, 1e-12), (1e9, 1.0)])
def test_the_equation_is_solved_as_well_in_every_unit(length, time):
    """A cloth of atoms, or of planets, moves as any other."""
    scene = library.build("cloth", columns=3, rows=2, pins=1)
    world, particles, springs = scene.world, scene.particles, scene.springs
    acceleration = length / time**2
    scaled = replace(
        scene,
        world=replace(
            world,
            size=tuple(length * side for side in world.size),
            gravity=tuple(acceleration * g for g in world.gravity),
        ),
        particles=replace(
            particles,
            position=length * particles.position,
            radius=length * particles.radius,
            viscous=particles.viscous / time,
        ),
        springs=replace(
            springs,
            rest_length=length * springs.rest_length,
            stiffness=springs.stiffness / time**2,
            break_force=acceleration * springs.break_force,
        ),
    )
    times = np.linspace(0.0, 20.0, 21)
    here, there = ode.solve(scene, times), ode.solve(scaled, time * times, budget=2.0)
    assert not there.given_up and there.event is None
    np.testing.assert_allclose(there.x / length, here.x, rtol=0, atol=1e-10)
    np.testing.assert_allclose(there.v * time / length, here.v, rtol=0, atol=1e-10)


def test_two_independent_references_agree(pool):
    """Springs of all kinds, dashpots and drag, in 3-D too, by SciPy and by our kernels."""
    flat = library.build("cloth", columns=5, rows=4, shear=0.2, bend=0.1, damping=0.05)
    p = flat.particles
    rng = np.random.default_rng(1)
    deep = Particles.build(
        np.column_stack([p.position, rng.normal(0, 3, len(p))]),
        mass=rng.uniform(0.5, 2, len(p)),
        viscous=p.viscous,
        fixed=p.fixed,
    )
    world = World(size=(*flat.world.size, 200.0), gravity=(0.01, 0.05, 0.02))
    scene = Scene("deep", world, deep, replace(flat.springs))
    times = np.arange(21.0)
    solved = ode.solve(scene, times)
    sim = pool(scene, "rk4", substeps=256)
    for frame in range(1, len(times)):
        sim.advance()
        np.testing.assert_allclose(sim.positions(), solved.x[frame], rtol=0, atol=1e-11)
        np.testing.assert_allclose(sim.velocities(), solved.v[frame], rtol=0, atol=1e-11)


def test_contacts_and_breaks_end_the_smooth_solution():
    def falling(**world):
        return World(size=(100.0, 100.0), gravity=(0.0, 0.02), **world)

    times = np.arange(200.0)
    ball = Particles.build([[50.0, 50.0]], radius=5.0)
    solved = ode.solve(Scene("fall", falling(walls=("bottom",)), ball), times)
    reached = math.sqrt(2 * 45.0 / 0.02)
    assert "wall 'bottom'" in solved.event
    whole = int(solved.until)
    assert 0.5 * reached < solved.until <= reached
    np.testing.assert_allclose(solved.x[: whole + 1, 0, 1], 50 + 0.01 * times[: whole + 1] ** 2)

    pair = Particles.build([[20.0, 50.0], [60.0, 50.0]], [[1.0, 0.0], [0.0, 0.0]], radius=5.0)
    still = World(size=(100.0, 100.0), gravity=(0.0, 0.0), collisions=True)
    assert "collide" in ode.solve(Scene("pair", still, pair), times).event
    # So does one that passes the other between two moments of the solution.
    for speed in (37.0, 61.0, 89.0):
        quick = replace(pair, velocity=np.array([[speed, 0.0], [0.0, 0.0]]), radius=np.full(2, 0.5))
        solved = ode.solve(Scene("quick", still, quick), times)
        assert "collide" in solved.event and solved.until <= 39.0 / speed

    x = [[50.0, 10.0], [50.0, 20.0]]
    hung = Particles.build(x, fixed=[True, False])
    weak = Springs.build([[0, 1]], x, stiffness=0.1, break_force=0.03)
    assert "breaks" in ode.solve(Scene("hung", falling(), hung, weak), times).event
    strong = Springs.build([[0, 1]], x, stiffness=0.1, break_force=0.05)
    assert ode.solve(Scene("hung", falling(), hung, strong), times).event is None

    standing = Particles.build(x, fixed=[False, True])
    for break_in, says in (("both", "spring 0 breaks"), ("tension", None)):
        under = replace(weak, break_in=np.array([break_in]))
        assert ode.solve(Scene("stands", falling(), standing, under), times).event == says


def test_horizon_ends_before_a_disturbance_has_grown_into_the_errors():
    scene = library.build("oscillator")
    frames = np.arange(101)
    x = np.zeros((101, 2, 2))
    x[:, 1, 0] = 50.0 * np.minimum(frames, 1)  # the largest displacement
    other = x.copy()
    other[:, 1, 1] = 50.0 * reference.DISTURBANCE * np.exp(0.2 * frames)
    alive = np.ones((101, 0), bool)
    horizon = reference.limit_horizon(scene, Samples(x, x, alive), Samples(other, x, alive))
    last = int(math.log(reference.GROWN / reference.DISTURBANCE) / 0.2)  # 34.5
    assert horizon.asked == 100 and horizon.frames == last
    assert horizon.grown == pytest.approx(reference.DISTURBANCE * math.exp(0.2 * last))
    assert "of the 100 asked for" in horizon.describe()
    single = replace(horizon, frames=1)
    assert single.describe().startswith("horizon: 1 frame of the 100")
    assert replace(single, asked=1).describe().startswith("horizon: 1 frame, in")
    still = reference.limit_horizon(scene, Samples(x, x, alive), Samples(x, x, alive))
    assert still.frames == 100 and still.grown == 0.0
    # It does not matter that the runs come together again.
    passing = x.copy()
    passing[40, 1, 1] = 50.0 * 2 * reference.GROWN
    apart = reference.limit_horizon(scene, Samples(x, x, alive), Samples(passing, x, alive))
    assert apart.frames == 39


def test_a_disturbance_leaves_what_is_fixed():
    """What is free is moved by its size; a fixed end that moved would be another scene."""
    scene = library.build("oscillator")
    moved = reference.disturbed(scene, 1e-3).particles.position - scene.particles.position
    assert not moved[0].any() and np.linalg.norm(moved[1]) == pytest.approx(1e-3)


def test_what_is_known_decides_what_is_compared_to():
    """The closed form before DOP853 before fine runs; what each is worth; events and why not."""
    scene = library.build("oscillator")
    x = np.zeros((11, 2, 2))

    def samples(shift, alive=True):
        moved = x + np.array([0.0, shift])[:, None]
        return Samples(moved, x, np.full((11, 1), alive))

    fine = [("coarse", samples(1e-3)), ("fine", samples(1e-6))]
    solved = ode.SmoothTrajectory(x, x, until=10.0)
    args = scene, 10
    exact = reference.decide(*args, samples(2e-6), solved, 10.0, fine)
    assert exact.what == "the closed form"
    assert exact.apart.trajectory == pytest.approx(2e-6 * math.sqrt(2))
    both = reference.decide(*args, None, solved, 10.0, fine)
    assert both.what.startswith("DOP853") and both.against == "fine"
    assert both.apart.trajectory == pytest.approx(1e-6 * math.sqrt(2))
    hit = ode.SmoothTrajectory(x, x, until=4.0, event="particle 1 hits the wall 'left'")
    rough = reference.decide(*args, None, hit, 10.0, fine)
    assert (rough.what, rough.against) == ("fine", "coarse") and "wall 'left'" in rough.event
    assert rough.apart.trajectory == pytest.approx((1e-3 - 1e-6) * math.sqrt(2))
    slow = ode.SmoothTrajectory(x, x, until=4.0, given_up=True)
    given_up = reference.decide(*args, None, slow, 10.0, fine)
    assert given_up.event is None and "given up at time 4 of 10" in given_up.note
    torn = [fine[0], ("fine", samples(0.0, alive=False))]
    assert "spring 0 breaks" in reference.decide(*args, None, slow, 10.0, torn).event
    assert reference.decide(*args, None, None, 10.0, fine[:1]) is None
    # What a reference is worth limits what it can measure.
    horizon = reference.Horizon(10, 10, 1.0, "", 1e-10)
    assert both.floor(horizon) == pytest.approx(10 * both.apart.trajectory)
    # So does what a disturbance has grown to, which is a part of the scale.
    chaotic = replace(horizon, scale=50.0, grown=1e-6)
    assert both.floor(chaotic) == pytest.approx(5e-5)


def test_measures_are_what_they_say():
    rng = np.random.default_rng(0)
    scene = library.build("cloth", columns=4, rows=3)
    free = ~scene.particles.fixed
    x, v = rng.normal(size=(2, 6, 12, 2))
    alive = np.ones((6, len(scene.springs)), bool)
    moved = x.copy()
    moved[:, free] += [3.0, 4.0]
    moved[2:, 5] += [3.0, 4.0]
    one, other = Samples(x, v, alive), Samples(moved, v, alive)
    apart = distance(one, other, free)
    mean = (8 * 25 + 100) / 9
    assert apart.final_max == pytest.approx(10.0)
    assert apart.final_rms == pytest.approx(math.sqrt(mean))
    assert apart.trajectory == pytest.approx(math.sqrt((25 + 4 * mean) / 5))
    assert apart.trajectory_max == pytest.approx(10.0)
    still, fast = Invariants.of(scene, one), Invariants.of(scene, replace(one, v=v + [1.0, 0.0]))
    assert still.energy_drift(still) == still.momentum_drift(still) == 0.0
    assert fast.momentum_drift(still) == pytest.approx(9.0 / still.impulse)

    broken, true = alive.copy(), alive.copy()
    broken[3:, 2] = broken[4:, 7] = False
    true[5:, 7] = true[4:, 9] = False
    breaks = Breaks.of(replace(one, alive=broken), replace(one, alive=true))
    assert (breaks.count, breaks.agreeing, breaks.first, breaks.later) == (2, 1, 3, -1)
    none = Breaks.of(one, one)
    assert (none.count, none.agreeing, none.first, none.later) == (0, 0, None, None)


def test_invariants_of_three_states_by_hand():
    """A free mass of 2 on a spring of 3 from a fixed one, gravity 0.5: a fixed particle has no
    impulse, heights count in the scale by how much they vary, and springs that broke not at all.
    """
    x = np.array([[[0.0, 5.0], [4.0, 5.0]], [[0.0, 5.0], [5.0, 5.0]], [[0.0, 5.0], [4.0, 17.0]]])
    v = np.array([[[9.0, 0.0], [1.0, 0.0]], [[9.0, 0.0], [0.0, 2.0]], [[9.0, 0.0], [0.0, 0.0]]])
    alive = np.array([[True], [True], [False]])
    particles = Particles.build(x[0], fixed=[True, False], mass=2.0)
    springs = Springs.build([(0, 1)], x[0], stiffness=3.0, rest_length=4.0)
    scene = Scene("pair", World((40.0, 20.0), gravity=(0.0, 0.5)), particles, springs)
    found = Invariants.of(scene, Samples(x, v, alive))
    assert found.energy == pytest.approx([1.0 - 5.0, 4.0 + 1.5 - 5.0, -17.0])
    assert found.scale == pytest.approx(5.5 + 12.0)
    assert found.impulse == pytest.approx(4.0)
    assert found.strain == pytest.approx(0.25)


def test_a_particle_counts_from_when_both_have_it():
    """One is 3 away all the time; another one, 4 away, comes with the last frame in one run."""
    a, b = np.zeros((2, 4, 2, 2))
    b[:, 0, 0], b[:, 1, 0] = 3.0, 4.0
    b[:3, 1] = np.nan
    samples = [Samples(x, x, np.ones((4, 0), bool)) for x in (a, b)]
    free = np.ones(2, bool)
    assert rms_by_frame(*samples, free) == pytest.approx([3.0, 3.0, 3.0, math.sqrt(12.5)])
    assert distance(*samples, free).trajectory == pytest.approx(math.sqrt((9 * 3 + 16) / 4))


def test_what_contacts_did_is_that_of_the_run_and_of_the_reference_within_the_horizon():
    x, alive = np.zeros((4, 2, 2)), np.ones((4, 0), bool)

    def samples(*contacts):
        return Samples(x, x, alive, np.array(contacts, float))

    nan = math.nan
    run = samples([0, 0, nan], [0.1, 0.5, nan], [0.3, 0.5, 1.75], [0.3, 0.7, 1.75])
    true = samples([0, 0, nan], [0, 0, 1.5], [0, 0, 1.5], [0, 0, 1.5])
    assert Contacts.of(run, true) == Contacts(0.3, 0.7, 0.25)
    assert Contacts.of(run.first(1), true.first(1)) == Contacts(0.1, 0.5, None)
    smooth = Samples(x, x, alive)  # of the differential equation: nobody looks at contacts there
    assert Contacts.of(run, smooth) == Contacts(0.3, 0.7, None)
    assert Contacts.of(samples(*[[nan] * 3] * 4), true) == Contacts(None, None, None)
    assert Contacts.of(samples(*[[0.2, nan, nan]] * 4), true) == Contacts(0.2, None, None)  # a GPU


LANDING = """
name = "landing"
[world]
size = [20.0, 20.0]
up = "y"
gravity = [0.0, -10.0]
dt = 0.05
ground = 1.0
friction = 0.3
[particle]
restitution = 1.0
[[particles]]
position = [5.0, 2.35]
velocity = [1.0, 0.0]
radius = 0.1
[[particles]]
position = [7.0, 1.1]
radius = 0.1
"""


@thorough
def test_contacts_have_their_columns(cli, tmp_path):
    """A body that lands after 0.5 s and slides on, and one that lies."""
    (tmp_path / "landing.toml").write_text(
        LANDING.replace("position = [7.0, 1.1]", "position = [7.0, 9.0]")
    )
    chosen = ["--methods", "verlet,symplectic_euler", "--substeps", "1,8", "--precisions", "f64"]
    arguments = [
        "trade",
        "landing.toml",
        *chosen,
        "--frames",
        20,
        "--within",
        "110s",
        "--output",
        "out",
    ]
    out, _ = cli(*arguments, cwd=tmp_path)
    whole = json.loads((tmp_path / "out" / "trade.json").read_text())
    assert "touches ground" in whole["environment"]["event"]
    assert "first touch" in out and "penetration" in out
    for row in read(tmp_path / "out"):
        assert 0 <= row["penetration_max"] < 1e-12 and 0 <= row["contact_energy"] < 1e-9
        assert abs(row["first_touch_later"]) <= row["step"]
        # It meets the ground after half a second: some steps end there to the bit, and bounce, too.
        assert not row["below_floor"] and row["error_trajectory_relative"] < 0.03
    (tmp_path / "landing.toml").write_text(LANDING)
    cli(*arguments, cwd=tmp_path)
    for row in read(tmp_path / "out"):  # the second one lies from the start
        assert row["first_touch_later"] == pytest.approx(row["step"], rel=0.3)


# ------------------------------------------------------------------------------------------
# The front, files, the terminal


def test_front_is_that_of_every_pair_compared():
    rng = np.random.default_rng(5)
    for size in (0, 1, 2, 3, 10, 60):
        for _ in range(30):
            costs = [tuple(map(float, pair)) for pair in rng.integers(0, 8, (size, 2))]
            costs = [None if rng.random() < 0.1 else cost for cost in costs]
            beaten = [
                cost is None
                or any(
                    o is not None and o[0] <= cost[0] and o[1] <= cost[1] and o != cost
                    for o in costs
                )
                for cost in costs
            ]
            assert rows.pareto(costs) == [not b for b in beaten]


def test_orders_are_from_the_next_longer_step_and_only_of_errors_that_can_be_told():
    """Errors fall as h^2, then as h^4 from the second step on; the last is the reference's own."""
    errors = {1: 1.0, 2: 2.0**-2, 4: 2.0**-6, 8: 1e-9}
    made = [
        rows.Row(Setting("rk4", 1.0, n), error_trajectory=error, below_floor=n == 8)
        for n, error in errors.items()
    ]
    first, *between, last = rows._orders(made)
    assert first is None and last is None
    assert between == pytest.approx([2.0, 4.0])


def test_files_keep_the_contract_and_say_the_same(oscillator):
    folder, printed, told = oscillator
    header = (folder / "trade.csv").read_text().splitlines()[0]
    assert header.startswith(CONTRACT + ",")
    assert header.endswith(",command," + ",".join((*OF_CONTACTS, "timed_on", *OF_SECONDS)))
    table = read(folder)
    assert all(row[name] is None for row in table for name in OF_CONTACTS)  # nothing can touch
    assert len(table) == 12 and {row["precision"] for row in table} == {"f32", "f64"}
    whole = json.loads((folder / "trade.json").read_text())
    assert len(whole["rows"]) == len(table)
    for row, same in zip(table, whole["rows"], strict=True):
        assert {name: same[name] for name in row if same[name] != ""} == {
            name: value for name, value in row.items() if same[name] != ""
        }
        assert row["wall_lower"] <= row["wall_seconds"] <= row["wall_upper"]
        assert row["repeats"] >= 3 and row["status"] == "ok"
        # Of a horizon within a second the error of that is the trajectory's.
        assert row["error_second"] == row["error_trajectory_relative"] or row["below_floor"]
        assert (row["execution"], row["threads"]) == ("serial", 1)  # of so few particles
        assert row["error_trajectory_relative"] == pytest.approx(
            row["error_trajectory"] / whole["environment"]["scale"]
        )
    about = whole["environment"]
    assert about["reference"] == "the closed form" and "DOP853" in about["reference_against"]
    assert about["reference_apart"] < 1e-10 and about["scene_hash"] == table[0]["scene_hash"]
    for name in ("taichi ", "numpy ", "scipy ", "python "):
        assert name in about["versions"]
    assert about["machine"]["cores"] and about["date"] and about["devices"]
    # The front of the file is that of every pair compared.
    costs = [
        (r["wall_seconds"], max(r["error_trajectory"], about["reference_floor"])) for r in table
    ]
    for row, (seconds, error) in zip(table, costs, strict=True):
        beaten = any(s <= seconds and e <= error and (s, e) != (seconds, error) for s, e in costs)
        assert row["pareto"] is not beaten
        assert re.search(rf"●\s+{row['method']}", printed) or not row["pareto"]
    # Progress goes to standard error.
    progress = r"^(\d+) of (\d+): "
    done, of = re.findall(progress, told, re.M)[-1]
    assert done == of and int(of) >= len(table) and not re.search(progress, printed, re.M)


def test_rows_are_a_study_s_outcomes_beside_its_reference(tmp_path):
    """By hand: of two free particles one is 5, then 10 from the reference, the other one on it."""
    x = np.tile([[10.0, 50.0], [20.0, 50.0], [30.0, 50.0]], (3, 1, 1))
    particles = Particles.build(x[0], fixed=[True, False, False])
    springs = Springs.build([(0, 1), (1, 2)], x[0], stiffness=1.0, break_force=9.0)
    scene = Scene("row", World((100.0, 100.0), (0.0, 0.0)), particles, springs)

    def samples(*ways, breaks=(3, 3), first_touch=math.nan):
        moved, alive = x.copy(), np.arange(3)[:, None] < np.array(breaks)
        moved[1:, 1] += ways
        contacts = [[0.0, 0.0, math.nan], [0.4, 0.5, first_touch], [0.4, 0.7, first_touch]]
        return Samples(moved, 0.0 * x, alive, np.array(contacts))

    def outcome(setting, *ways, seconds=(), **of):
        file = tmp_path / f"{len(list(tmp_path.iterdir()))}.npz"
        np.savez(file, **vars(samples(*ways, **of)))
        about = {"device": "cpu", "threads": 2, "topology": "graph", "of the process": 1}
        work = {"force_evaluations": 12, "sweeps": 34, "unconverged": 5}
        return Outcome(setting, file=file, seconds=list(seconds), about=about, timed_on="m", **work)

    rough = Setting("implicit_midpoint", 1.0, 2, tolerance=0.1)
    exact = settings.converged(rough)
    lone = replace(rough, dt=2.0)  # whose converged run is missing
    verlet = [Setting("verlet", 1.0, count) for count in (1, 2, 4)]
    found = [
        outcome(rough, [3, 4], [6, 8], seconds=(3, 1, 2), breaks=(1, 2), first_touch=2.0),
        outcome(lone, [3, 4], [6, 8]),
        outcome(verlet[0], [0, 0], [0.8, 0], seconds=(0.5,)),
        outcome(verlet[1], [0, 0], [0.2, 0], seconds=(0.75,)),
        outcome(verlet[2], [0, 0], [0.002, 0], seconds=(1.0,)),  # which nobody can tell from
        outcome(replace(verlet[2], precision="f32"), [0, 0], [0.004, 0], seconds=(1.0,)),
        failed_by(Outcome(replace(verlet[0], dt=9.0)), WorkerFailed("too long")),
    ]
    true = samples([0, 0], [0, 0], breaks=(2, 3), first_touch=1.5)
    apart = SimpleNamespace(trajectory=1e-3)
    horizon = reference.Horizon(9, 2, 20.0, "", 1e-4)  # of a floor of 0.01
    judge = reference.Reference(true, "", "", apart)
    result = Result(scene, found, {exact: outcome(exact, [0, 0], [0, 6])}, horizon, judge)
    made = rows.rows_of(
        result, {"scene_hash": "h", "versions": "v"}, ["taichi-cloth", "run", "x y"]
    )
    first, alone, *rest, failed = made

    assert first.error_final_rms == pytest.approx(math.sqrt(100 / 2))
    assert first.error_final_max == first.error_trajectory_max == pytest.approx(10.0)
    assert first.error_trajectory == pytest.approx(math.sqrt((25 + 100) / 4))
    for name in ("error_final_rms", "error_final_max", "error_trajectory"):
        of_scale = getattr(first, f"{name}_relative")
        assert of_scale == pytest.approx(getattr(first, name) / 20.0), name
    assert first.error_discretisation == pytest.approx(math.sqrt(36 / 4))
    assert first.error_solver == pytest.approx(math.sqrt((25 + 36 + 4) / 4))
    assert alone.error_discretisation is alone.error_solver is None and alone.error_trajectory > 5
    assert rest[0].error_discretisation == rest[0].error_trajectory == pytest.approx(0.4)
    assert rest[0].error_solver is None

    assert (first.breaks, first.breaks_agreeing) == (2, 1)
    assert (first.first_break, first.first_break_later) == (1, -1)
    touched = first.penetration_max, first.contact_energy, first.first_touch_later
    assert touched == (0.4, 0.7, 0.5)
    assert first.max_strain == pytest.approx(1 - math.hypot(7, 4) / 10)  # of what holds

    assert (first.wall_lower, first.wall_seconds, first.wall_upper) == (1.5, 2.0, 2.5)
    assert (first.repeats, first.timed_on, first.frames) == (3, "m", 2)
    assert (first.device, first.threads, first.topology) == ("cpu", 2, "graph")
    assert (first.force_evaluations, first.sweeps, first.unconverged) == (12, 34, 5)
    assert (first.scene_hash, first.versions) == ("h", "v")
    assert first.command == " ".join(["taichi-cloth run 'x y'", *rough.words()])
    assert alone.wall_seconds is alone.repeats is None and alone.timed_on == ""

    assert [row.below_floor for row in made] == [False] * 4 + [True] * 2 + [False]
    assert {row.floor for row in made[:-1]} == {0.01} and {row.scale for row in made[:-1]} == {20.0}
    assert [row.order for row in rest] == [None, pytest.approx(2.0), None, None]
    # What cannot be told from none is alike: two that cost the same are both on the front.
    assert [row.pareto for row in made] == [False, False, True, True, True, True, False]
    assert rest[2].told() == (0.01, pytest.approx(0.01 / 20))
    assert first.told() == (first.error_trajectory, first.error_trajectory_relative)
    assert first.a_frame(first.wall_seconds) == 1.0 and alone.a_frame(alone.wall_seconds) is None
    assert failed.status == "failed: too long" and not failed.ok
    assert failed.error_trajectory is failed.floor is failed.wall_seconds is None


def test_what_overflowed_is_null_in_the_files():
    """Masses of 1e300 have such energies; JSON has no word for them."""
    row = rows.Row(Setting("verlet", 1.0, 1), energy_drift=math.inf, momentum_drift=math.nan)
    told = json.loads(rows.as_json([row], {"scale": math.inf, "left_out": ["a"]}))
    assert told["environment"] == {"scale": None, "left_out": ["a"]}
    assert told["rows"][0]["energy_drift"] is None and told["rows"][0]["dt"] == 1.0
    (line,) = csv.DictReader(rows.as_csv([row]).splitlines())
    assert line["energy_drift"] == line["momentum_drift"] == "" and line["dt"] == "1.0"


def test_plots_are_whole_pictures(oscillator):
    from PIL import Image

    picture = np.asarray(Image.open(oscillator[0] / "trade.png").convert("RGB"), int)
    assert picture.shape[0] > 600 and picture.shape[1] > 1200 and picture.std() > 15
    assert (picture[:, [0, -1]] == 255).all() and (picture[[0, -1]] == 255).all()  # nothing cut
    svg = ElementTree.parse(oscillator[0] / "trade.svg").getroot()
    assert svg.tag.endswith("svg")


def test_a_plot_of_other_rows_does_not_stay_beside_those_that_have_none(tmp_path):
    """Without an error there is no plot, and the one that lies there was of another trade."""
    for name in (*FILES, "notes.txt"):
        (tmp_path / name).write_text("of another trade")
    source, made = SceneSource("oscillator"), [rows.Row(Setting("verlet", 1.0, 1))]
    result = Result(source.build(), [], {}, None, None)
    written = write(tmp_path, source, TradeOptions(), result, made)
    assert written == ["trade.csv", "trade.json"]
    assert {path.name for path in tmp_path.iterdir()} == {*written, "notes.txt"}
    assert json.loads((tmp_path / "trade.json").read_text())["rows"][0]["method"] == "verlet"


def made_up(rng, count):
    """Rows with random errors and times, some of which failed."""
    made = []
    for k in range(count):
        error, seconds = 10 ** rng.uniform(-6, 0), 10 ** rng.uniform(-4, 0)
        failed = rng.random() < 0.2
        numbers = {
            "error_trajectory": 50 * error,
            "error_trajectory_relative": error,
            "wall_seconds": seconds,
            "wall_upper": 1.1 * seconds,
        }
        made.append(
            rows.Row(
                Setting("verlet", 1.0, k + 1),
                frames=10,
                **({"status": "failed: frame 1"} if failed else numbers),
            )
        )
    return made


def test_a_plot_s_title_is_no_formula():
    """A scene may be called anything, and all has been measured by the time it is drawn."""
    made = made_up(np.random.default_rng(3), 4)
    exact = reference.Reference(None, "the closed form", "", SimpleNamespace(trajectory=1e-9))
    scene = replace(library.build("oscillator"), name="$\\x$ \0")
    horizon = reference.Horizon(10, 10, 50.0, "the largest displacement", 0.0)
    result = Result(scene, [], {}, horizon, exact)
    assert ElementTree.fromstring(plot.draw(result, made, ["svg"])["svg"]).tag.endswith("svg")


@pytest.mark.parametrize(("dt", "tolerance"), [(1 / 60, 0.0123456789), (0.1 + 0.2, 1e-13 / 3)])
def test_commands_have_the_numbers_that_were_measured(dt, tolerance):
    """To the bit, so that two settings never share one; those of few digits are short."""
    words = Setting("tr_bdf2", dt, 2, tolerance=tolerance).words()
    assert float(words[words.index("--dt") + 1]) == dt
    assert float(words[words.index("--tolerance") + 1]) == tolerance
    short = " ".join(Setting("tr_bdf2", 1.0, 2, tolerance=0.01).words())
    assert "--dt 1 --substeps 2 --tolerance 0.01 " in short


@pytest.mark.parametrize(
    ("setting", "says", "flags"),
    [
        (
            Setting("vbd", 1.0, 1, "f32", False, "cuda", iterations=8),
            "vbd, 1 substep, 8 iterations, cuda f32 without fast_math",
            "--substeps 1 --iterations 8 --arch cuda --precision f32 --no-fast-math",
        ),
        (
            Setting("tr_bdf2", 1.0, 4, "f32", True, tolerance=1e-6),
            "tr_bdf2, 4 substeps, tolerance 1e-06, cpu f32",
            "--substeps 4 --tolerance 1e-06 --arch cpu --precision f32",
        ),
        (
            Setting("rk4", 1.0, 2),
            "rk4, 2 substeps, cpu f64",
            "--substeps 2 --arch cpu --precision f64",
        ),
    ],
)
def test_a_setting_is_said_in_words_and_in_flags(setting, says, flags):
    assert setting.describe() == says
    assert " ".join(setting.words()) == f"--method {setting.method} --dt 1 {flags}"


def test_a_row_can_be_run_again(oscillator, cli, tmp_path):
    """Its command gives the state that it was judged by."""
    row = next(r for r in read(oscillator[0]) if r["precision"] == "f64" and r["substeps"] == 2)
    words = row["command"].split()[1:]
    cli(*words, "--headless", "--frames", 20, "--save", "a.npz", "--quiet", cwd=tmp_path)
    with np.load(tmp_path / "a.npz") as saved:
        x = saved["position"][-1, 1, 0]
    exact = 250.0 + 50.0 * math.cos(0.1 * 20)
    assert abs(x - exact) == pytest.approx(row["error_final_max"], rel=1e-9)


TEARING = """
name = "tearing"
[world]
size = [100.0, 200.0]
gravity = [0.0, 0.1]
[spring]
stiffness = 0.2
rest_length = 20.0
[[particles]]
position = [50.0, 20.0]
fixed = true
[[particles]]
position = [50.0, 40.0]
[[springs]]
between = [0, 1]
break_force = 0.15
"""


@thorough
def test_of_a_tearing_scene_it_says_what_broke_and_which_order_survives(cli, tmp_path):
    (tmp_path / "tearing.toml").write_text(TEARING)
    chosen = ["--methods", "rk4", "--substeps", "16,256", "--precisions", "f64"]
    out, _ = cli(
        "trade", "tearing.toml", *chosen, "--dt", 8, "--frames", 3, "--within", "110s", cwd=tmp_path
    )
    table = read(tmp_path / "trade-tearing")
    whole = json.loads((tmp_path / "trade-tearing" / "trade.json").read_text())
    assert "spring 0 breaks" in whole["environment"]["event"]
    assert "not smooth" in out and "orders that survive" in out
    for row in table:
        assert (row["breaks"], row["breaks_agreeing"], row["first_break_later"]) == (1, 1, 0)
    # A break is seen at the end of a step: first order, of whatever order the method is.
    assert 0.5 < table[1]["order"] < 1.5


def test_a_setting_that_fails_is_a_row_without_errors(cli, tmp_path):
    (tmp_path / "stiff.toml").write_text(TEARING.replace("break_force = 0.15", ""))
    chosen = ["--methods", "symplectic_euler", "--substeps", "1,16", "--precisions", "f64"]
    arguments = ["trade", "stiff.toml", *chosen, "--dt", 8, "--frames", 60, "--output", "out"]
    out, _ = cli(*arguments, "--within", "110s", cwd=tmp_path)
    good, failed = read(tmp_path / "out")  # what may be unstable comes last
    assert re.match(r"failed: frame \d+, particle 1 runs away", failed["status"])
    assert failed["error_trajectory"] is failed["wall_seconds"] is None and not failed["pareto"]
    assert good["status"] == "ok" and good["pareto"]
    assert "✗" in out and "1 of 2 settings failed" in out


@thorough
def test_errors_of_the_step_and_of_its_solver_are_kept_apart(cli, tmp_path):
    """A loose tolerance adds to the error of the step, which stays what it is."""
    chosen = ["--methods", "implicit_euler", "--substeps", 2, "--precisions", "f64"]
    chosen += ["--tolerances", "1e-1,1e-7", "--columns", 5, "--rows", 4, "--frames", 20]
    cli("trade", "cloth", *chosen, "--within", "110s", "--output", tmp_path)
    tight, loose = read(tmp_path)
    assert tight["tolerance"] == 1e-7 and loose["tolerance"] == 0.1
    assert tight["error_discretisation"] == loose["error_discretisation"] > 0
    assert 0 < tight["error_solver"] < 1e-4 * tight["error_discretisation"]
    assert loose["error_solver"] > 100 * tight["error_solver"]
    for row in (tight, loose):
        apart = abs(row["error_trajectory"] - row["error_discretisation"])
        assert apart <= row["error_solver"] * (1 + 1e-9)
    assert loose["sweeps"] < tight["sweeps"]


@thorough
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_sweep_keeps_what_is_finished(tmp_path, number, status):
    process = subprocess.Popen(
        [sys.executable, "-m", "taichi_cloth", "trade", "oscillator", "--output", str(tmp_path)]
        + ["--precisions", "f64"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell that runs the tests in the background would have SIGINT ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    for line in process.stderr:
        if re.search(r"of \d+: \w+, \d+ substep", line):
            break
    process.send_signal(number)
    out, error = process.communicate(timeout=60)
    assert process.returncode == status and error.endswith("taichi-cloth: interrupted\n")
    assert "Traceback" not in error and "are kept" in out
    table = read(tmp_path)
    everything = settings.choose(library.build("oscillator"), TradeOptions(precisions="f64"))
    assert 0 < len(table) < len(everything)
    assert all(row["error_trajectory"] is not None for row in table)
    assert json.loads((tmp_path / "trade.json").read_text())["environment"]["interrupted"] is True


# ------------------------------------------------------------------------------------------
# Kills and full disks


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_sweep_ends_with_the_status_of_its_signal(
    number, status, monkeypatch, capsys, tmp_path, request
):
    before = signal.signal(number, signal.SIG_DFL)  # which nohup may have had ignored
    request.addfinalizer(lambda: signal.signal(number, before))

    def send_signal(study):
        time.sleep(0.2)  # until the study waits for news
        os.kill(os.getpid(), number)
        study._stop.wait(30)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Study, "_groups", lambda _: {})
    monkeypatch.setattr(Study, "_send", lambda study, groups: send_signal(study))
    monkeypatch.setattr(Study, "_solve", lambda study: None)
    tune = ["tune", "oscillator", "--error", "1%", "--substeps", "4"]  # without a survey
    for command in (["trade", "oscillator"], tune):
        assert main(command) == status
        assert capsys.readouterr().err.endswith("taichi-cloth: interrupted\n")
    assert not list(tmp_path.iterdir())


def test_a_process_ends_with_its_parent(tmp_path):
    """Its input ends with the parent, however that was killed; the parent's folder goes, too."""
    folder = tmp_path / "work"
    folder.mkdir()
    worker = Worker(folder, {})
    worker._requests.close()
    worker._process.wait(timeout=30)
    assert not folder.exists()
    worker.close()


def test_files_are_written_all_or_none(tmp_path):
    (tmp_path / "a").write_bytes(b"old")
    (tmp_path / "b").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        pending.write_all({tmp_path / "a": b"new", tmp_path / "b": b"new"})
    assert (tmp_path / "a").read_bytes() == b"old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]
    (tmp_path / "b").rmdir()
    pending.write_all({tmp_path / "a": b"new", tmp_path / "b": b"new"})
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes() == b"new"


@pytest.mark.parametrize(
    "failure",
    [
        StudyFailure("the reference fails"),
        OSError(errno.ENOSPC, "No space left on device"),
        OSError(errno.ENOSPC, "No space left on device", "/tmp/x"),
    ],
)
def test_what_ends_a_sweep_is_one_line_and_status_3(failure, monkeypatch, capsys, tmp_path):
    def measured(*_, **__):
        raise failure

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("taichi_cloth.trade.command.measured", measured)
    monkeypatch.setattr("taichi_cloth.cli.main._abandon", lambda stream: None)
    tune = ["tune", "oscillator", "--error", "1%", "--substeps", "4"]  # without a survey
    for command in (["trade", "oscillator"], tune):
        assert main(command) == 3
        error = capsys.readouterr().err
        assert error.startswith("taichi-cloth: error: ") and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


class Ticking:
    """A clock that goes on by a second whenever it is read."""

    def __init__(self):
        self.at = 0.0

    def perf_counter(self):
        self.at += 1.0
        return self.at


@pytest.fixture
def tried(pool, monkeypatch):
    """A trial of the oscillator, in this process, by a clock of ours."""
    made = object.__new__(trial.Trial)
    made._sim, made._ran = pool(library.build("oscillator"), "rk4"), set()
    monkeypatch.setattr(trial, "time", Ticking())
    return made


def test_a_trial_samples_each_frame_and_what_it_took(tried, tmp_path, monkeypatch):
    sim = tried._sim
    found = tried.sample(0.5, 3, {}, 4, str(tmp_path / "a.npz"))
    samples = Samples.read(tmp_path / "a.npz")
    assert samples.x.shape == samples.v.shape == (5, 2, 2) and samples.alive.shape == (5, 0)
    assert samples.contacts.shape == (5, 3) and np.isnan(samples.contacts).all()
    sim.set_step(0.5, 3)
    sim.reset()
    for frame in range(5):
        assert (samples.x[frame] == sim.positions()).all()
        assert (samples.v[frame] == sim.velocities()).all()
        sim.advance()
    work = {"force_evaluations": 4 * 3 * 4, "sweeps": 0, "unconverged": 0}
    # The clock is read at the start and the end, and twice for each state.
    assert found == {"failed": "", **work, "sampled_in": 11.0, "read_in": 5.0}

    # It is run with the solver's numbers that are asked for, which a run's device is told of.
    told, reset = [], sim.reset
    monkeypatch.setattr(sim, "solver", {})
    monkeypatch.setattr(sim, "reset", lambda: told.append(dict(sim.solver)) or reset())
    tried.sample(0.5, 3, {"iterations": 7}, 4, str(tmp_path / "a.npz"))
    assert told and all(numbers == {"iterations": 7} for numbers in told)
    sim.solver.clear()

    # A run that fails ends with its last good frame; one that does not solve its steps has failed.
    advance = sim.advance

    def failing(frames=1):
        if sim.frame == 2:
            raise SimulationFailure(1, 3, "runs away", "a long step", "shorten it")
        advance(frames)

    monkeypatch.setattr(sim, "advance", failing)
    found = tried.sample(0.5, 3, {}, 4, str(tmp_path / "b.npz"))
    assert found["failed"] == "failed: frame 3, particle 1 runs away; a long step"
    assert (Samples.read(tmp_path / "b.npz").x == samples.x[:3]).all()
    monkeypatch.setattr(sim, "advance", advance)
    monkeypatch.setattr(sim, "describe_convergence", lambda: "none of its steps did")
    for missed, failed in ((6, ""), (7, "failed: none of its steps did")):
        monkeypatch.setattr(sim, "work", lambda missed=missed: Work(12, 48, 0, missed))
        found = tried.sample(0.5, 3, {}, 4, str(tmp_path / "c.npz"))
        assert (found["failed"], found["unconverged"]) == (failed, missed)
        assert len(Samples.read(tmp_path / "c.npz")) == 5


def test_a_trial_keeps_what_contacts_did_until_each_frame(tried, tmp_path, monkeypatch):
    """The deepest of all frames yet; no energy where there is no account, as on a GPU."""
    sim, nan = tried._sim, math.nan
    tried.sample(0.5, 3, {}, 4, str(tmp_path / "a.npz"))
    monkeypatch.setattr(sim, "can_touch", lambda: True)
    for account, told in (
        (None, [nan, nan]),
        (ContactAccount(0.5, -0.25, None), [0.5, nan]),
        (ContactAccount(0.5, -0.25, 1.75), [0.5, 1.75]),
    ):
        depths = iter([0.1, 0.3, 0.2, 0.4])
        monkeypatch.setattr(sim, "penetration", lambda depths=depths: next(depths))
        monkeypatch.setattr(sim, "contact_account", lambda account=account: account)
        tried.sample(0.5, 3, {}, 4, str(tmp_path / "a.npz"))
        expected = [[deepest, *told] for deepest in (0.0, 0.1, 0.3, 0.3, 0.4)]
        contacts = Samples.read(tmp_path / "a.npz").contacts
        np.testing.assert_array_equal(contacts, np.array(expected))


@pytest.mark.parametrize(
    ("budget", "runs"), [(0.4, 1), (0.5, 2), (1.5, 3), (2.5, 3), (3.0, 4), (1e9, 6)]
)
def test_a_trial_is_timed_as_often_as_its_budget_lasts(budget, runs, tried, monkeypatch):
    """Of a second each: three times and more, but for one that alone takes twice the budget."""
    monkeypatch.setattr(trial, "MOST_REPEATS", 6)
    frames = []
    advance = tried._sim.advance
    monkeypatch.setattr(tried._sim, "advance", lambda n: frames.append(n) or advance(n))
    assert tried.time(1.0, 2, {}, 3, budget) == [1.0] * runs
    assert frames == [3] * (runs + 1) and tried._sim.frame == 3  # one before, which is not timed
    tried.time(1.0, 2, {}, 3, budget)
    assert frames == [3] * (2 * runs + 1)


def test_settings_that_the_machine_lost_are_no_choice():
    outcome = Outcome(Setting("rk4", 1.0, 1))
    result = Result(library.build("oscillator"), [outcome], {}, None, None)
    failed_by(outcome, WorkerFailed("SimulationFailure: frame 1"))
    result.check_whole()
    for why in ("its process ended: Killed", "OSError: [Errno 28] No space left on device"):
        failed_by(outcome, WorkerFailed(why))
        with pytest.raises(StudyFailure, match=r"1 of 1 settings were lost.*\(TMPDIR\).*--output"):
            result.check_whole()


# ------------------------------------------------------------------------------------------
# Settings


def test_default_settings_follow_from_the_claims():
    """They begin with the fewest substeps that are stable: one fewer is not."""
    scene = library.build("chain", stiffness=30.0)
    frequency = 2 * math.sqrt(30.0) * math.sin(math.pi * 16 / 34)  # of the chain's fastest mode
    every = ",".join(methods.METHODS)
    chosen = settings.choose(scene, TradeOptions())
    named = settings.choose(scene, TradeOptions(methods=every))
    stable = {m for m in methods.METHODS if methods.load(m).claims.stability_limit > 0}
    assert {s.method for s in chosen} == stable != {s.method for s in named} == set(methods.METHODS)
    assert [s for s in named if s.method in stable] == chosen
    for method in methods.METHODS:
        claims = methods.load(method).claims
        counts = sorted({s.substeps for s in named if s.method == method})
        assert len(counts) == settings.DOUBLINGS
        assert all(b == 2 * a for a, b in itertools.pairwise(counts))
        limit = claims.stability_limit or 2.0
        if math.isinf(limit):
            assert counts[0] == 1
        else:
            assert frequency / counts[0] <= limit < frequency / (counts[0] - 1)
    quick = settings.choose(scene, TradeOptions(quick=True))
    assert len(quick) < len(chosen) and {s.method for s in quick} == stable
    # Without fast_math there is f32 once more, and all else as it was.
    both = settings.choose(scene, TradeOptions(without_fast_math=True))
    assert len(set(both)) == len(both) and set(chosen) < set(both)
    assert {s.lacks_fast_math for s in chosen} == {False}
    again = [s for s in both if s.lacks_fast_math]
    assert {replace(s, fast_math=True) for s in again} == {s for s in chosen if s.fast_math}
    assert len(both) == len(chosen) + len(again)


@pytest.mark.parametrize("name", ["cloth", "warp", "slinky"])
def test_nothing_is_planned_that_is_known_to_be_unstable(name):
    """Neither around the start, nor first what may become so as springs turn."""
    sides = {"cloth": {"columns": 10, "rows": 9}, "warp": {"side": 9}}.get(name, {})
    scene = library.build(name, **sides)
    network = Network.from_scene(scene)
    bounds = any_geometry(network)
    for setting in settings.choose(scene, TradeOptions(quick=True)):
        method = methods.load(setting.method)
        assert setting.step <= (1 + 1e-9) * stable_step(method, network, exact=False).dt
    for method in ("verlet", "rk4"):
        asked = TradeOptions(methods=method, precisions="f64", quick=True)
        first, *rest = settings.choose(scene, asked)
        assert not grows_within(methods.load(method), bounds, first.step)
        doubtful = [s for s in rest if grows_within(methods.load(method), bounds, s.step)]
        assert rest[len(rest) - len(doubtful) :] == doubtful


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"methods": "rk4", "substeps": "1"}, "1 setting that 120 s and more plan: compensated"),
        (
            {"methods": "vbd", "precisions": "f64", "substeps": "1"},
            "2 settings that 120 s and more plan: 4 and 16 iterations",
        ),
        (
            {"methods": "rk4", "precisions": "f64"},
            "2 settings that 120 s and more plan: more substeps",
        ),
        (
            {"methods": "vbd", "iterations": "3"},
            "10 settings that 120 s and more plan: compensated, more substeps",
        ),
        ({"methods": "rk4", "precisions": "f64", "substeps": "1,2"}, None),
    ],
)
def test_what_a_minute_does_not_plan_is_said(given, says):
    scene, quick = library.build("oscillator"), TradeOptions(quick=True, **given)
    lines = settings.unplanned(scene, quick, settings.choose(scene, quick))
    assert lines == ([] if says is None else [says])
    whole = TradeOptions(**given)
    assert settings.unplanned(scene, whole, settings.choose(scene, whole)) == []


def test_what_is_asked_for_is_compared_where_a_method_takes_it():
    scene = library.build("oscillator")
    asked = {"dt": 0.25, "substeps": "2,1", "precisions": "f64", "tolerances": "1e-3,1e-6"}
    chosen = settings.choose(
        scene, TradeOptions(methods="vbd,rk4,tr_bdf2", iterations="3", **asked)
    )
    assert scene.world.dt != 0.25
    assert chosen == [
        *(Setting("vbd", 0.25, n, iterations=3) for n in (1, 2)),
        *(Setting("rk4", 0.25, n) for n in (1, 2)),
        *(Setting("tr_bdf2", 0.25, n, tolerance=t) for t in (1e-6, 1e-3) for n in (1, 2)),
    ]
    # Of a frame a quarter as long a quarter of the substeps is stable.
    stiff = library.build("oscillator", stiffness=300.0)
    for method, dt, fewest in (("verlet", 1.0, 9), ("verlet", 0.25, 3), ("rk4", 1.0, 7)):
        asked = TradeOptions(methods=method, precisions="f64", dt=dt)
        assert settings.choose(stiff, asked)[0].substeps == fewest  # of sqrt(300) dt / limit
    with pytest.raises(InputError, match="--iterations: none of the chosen methods takes it"):
        settings.choose(scene, TradeOptions(methods="rk4,tr_bdf2", iterations="3"))


def test_a_converged_solver_is_of_the_same_step_in_f64():
    """By what its method takes: residuals, or sweeps; without a solver there is none."""
    rough = Setting("implicit_midpoint", 0.5, 3, "f32", True, "cuda", tolerance=0.1)
    exact = settings.converged(rough)
    assert exact == Setting("implicit_midpoint", 0.5, 3, tolerance=settings.CONVERGED_TOLERANCE)
    swept = settings.converged(replace(rough, method="vbd", tolerance=None, iterations=4))
    assert swept == Setting("vbd", 0.5, 3, iterations=settings.CONVERGED_ITERATIONS)
    assert settings.converged(exact) == exact and settings.converged(swept) == swept
    assert settings.converged(replace(rough, method="verlet", tolerance=None)) is None


def test_no_method_is_named_where_methods_are_compared():
    folder = Path(settings.__file__).parent
    # The commands of a document's parts say which methods a part is about.
    files = [path for path in folder.glob("*.py") if path.name != "accuracy.py"]
    text = "".join(path.read_text() for path in files)
    assert not [name for name in methods.METHODS if re.search(rf"\b{name}\b(?! in)", text)]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["trade", "cloth", "--methods", "rk5"], "--methods: unknown 'rk5'; did you mean 'rk4'"),
        (["trade", "cloth", "--precisions", "f16"], "--precisions: unknown 'f16'"),
        (["trade", "cloth", "--substeps", "2,x"], "--substeps must be whole numbers"),
        (["trade", "cloth", "--substeps", "0"], "--substeps must be whole numbers"),
        (["trade", "cloth", "--tolerances", "2"], "--tolerances must be at most 1, is 2"),
        (["trade", "cloth", "--methods", "rk4", "--tolerances", "1e-3"], "none of the chosen"),
        (["trade", "box"], "no particle that can move"),
        (["trade", "slinky", "--topology", "lanes"], "no regular grid"),
        (["trade", "nothing"], "unknown scene"),
        (["trade", "cloth", "--columns", "100", "--rows", "100", "--frames", "900"], "at most 399"),
        (
            ["trade", "oscillator", "--archs", "metal" if sys.platform != "darwin" else "cuda"],
            "usable",
        ),
        (["trade", "cloth", "--dt", "1e308"], "a frame of 1e+308, and the most is 268435456"),
        (["trade", "cloth", "--stiffness", "1e30"], "would need 4.49e+16 steps in a frame of 1,"),
        (["tune", "cloth", "--error", "1%", "--dt", "1e308"], "use a smaller --dt or softer"),
        (["tune", "cloth"], "either --error"),
        (["tune", "cloth", "--error", "1%", "--frame-time", "1ms"], "either --error"),
        (["tune", "cloth", "--error", "-1%"], "--error must be"),
        (["tune", "drape", "--penetration", "-1mm"], "--penetration must be a length"),
        (["tune", "drape", "--penetration", "mm"], "--penetration must be a length"),
        (["tune", "drape", "--penetration", "1 inch"], "--penetration must be a length"),
        (["tune", "box", "--particles", "3", "--penetration", "1mm"], "has a unit"),
        (["tune", "oscillator", "--penetration", "0.1"], "can touch"),
        (
            ["tune", "drape", "--error", "1%", "--frame-time", "1ms", "--penetration", "1mm"],
            "either --error",
        ),
        (["tune", "cloth", "--error", "nan"], "--error must be"),
        (["tune", "cloth", "--frame-time", "8"], "--frame-time must be a time with its unit"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(arguments, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_frame_too_short_to_divide_by_is_refused():
    """In a process of its own: in one that has run kernels such numbers are zero."""
    error = commands.command("trade", "oscillator", "--dt", "1e-320", check=2)[1]
    assert "--dt 9.99989e-321: is too short a frame" in error and error.count("\n") == 1


def test_a_place_that_cannot_be_written_is_refused_first(tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    assert main(["trade", "oscillator", "--output", str(tmp_path / "file")]) == 2
    assert "cannot be made" in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "mine"


def test_whoever_measures_is_alone():
    quiet, seen, working = Quiet(), [], 0
    lock = threading.Lock()

    def work():
        nonlocal working
        for _ in range(20):
            with quiet.working():
                with lock:
                    working += 1
                time.sleep(0.001)
                with lock:
                    working -= 1
            with quiet.alone():
                seen.append(working)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=30)
    assert len(seen) == 80 and set(seen) == {0}
