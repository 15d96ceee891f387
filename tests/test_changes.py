"""What is changed in a simulation while it runs, and what its public functions refuse."""

import gc
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from inside import spec_of, state_of
from selection import as_thorough
from taichi.lang.kernel_impl import Kernel

import taichi_cloth as tc
from taichi_cloth.errors import InputError
from taichi_cloth.files.trajectory import Trajectory
from taichi_cloth.kernels import forces
from taichi_cloth.kernels.forces.contract import ACCELERATION, FORCE, has
from taichi_cloth.scene import scenefile
from taichi_cloth.scene.library import build
from taichi_cloth.simulation import diagnostics, editing
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.snapshot import Snapshot

pytestmark = pytest.mark.usefixtures("device", "few_lanes")

# How a run is stored and stepped; what keeps vectors across steps, or goes by colours, besides.
RUNS = [
    ("symplectic_euler", "graph"),
    as_thorough(("symplectic_euler", "lanes")),
    *(as_thorough((method, "graph")) for method in ("verlet", "implicit_euler", "vbd", "xpbd")),
]
TOPOLOGIES = ["graph", as_thorough("lanes")]


def cloth(**values):
    return build("cloth", columns=8, rows=6, **values)


def total_forces(sim):
    """The forces on all particles, by the twins in NumPy of all that the scene has."""
    now = sim.storage.snapshot()
    world, particles = now.scene.world, now.scene.particles
    total = diagnostics.spring_forces(now.x, now.v, now.scene.springs.select(now.pulling))
    for term in map(forces.load, forces.TERMS):
        if term.adds in (ACCELERATION, FORCE) and has(term.twin):
            law = term.twin(now.x, now.v, world, particles)
            total += particles.mass[:, None] * law if term.adds == ACCELERATION else law
    return total


def test_what_is_set_at_the_start_runs_as_a_scene_that_has_it(pool, some_way):
    scene = cloth()
    n, s = len(scene.particles), len(scene.springs)
    mass, fixed = np.linspace(1, 2, n), np.arange(n) % 7 == 0
    v = np.random.default_rng(0).normal(0.0, 3.0, (n, 2))
    particles = replace(scene.particles, mass=mass, viscous=np.full(n, 0.1), fixed=fixed)
    numbers = {"stiffness": 0.7, "damping": 0.05, "break_force": 3.0}
    columns = {name: np.full(s, value) for name, value in numbers.items()}
    other = replace(
        scene.with_world(gravity=(0.01, 0.2)),
        particles=replace(particles, velocity=v),
        springs=replace(scene.springs, **columns),
    )
    sim = pool(other, **some_way)
    sim.advance(8)
    loaded = sim.positions(), sim.velocities(), sim.springs_alive(), sim.energy()
    sim = pool(scene, **some_way)
    sim.set(gravity=(0.01, 0.2), mass=mass, viscous=0.1, fixed=fixed, velocities=v)
    sim.set(**numbers)
    sim.advance(8)
    assert 0 < loaded[2].sum() < s
    for a, b in zip(loaded, (sim.positions(), sim.velocities(), sim.springs_alive()), strict=False):
        np.testing.assert_array_equal(a, b)
    assert sim.energy() == loaded[3]
    sim.reset()  # as the scene was given
    assert sim.storage.scene is scene


@pytest.mark.parametrize(("method", "topology"), RUNS[:3])
def test_setting_what_is_so_changes_no_bit(pool, topology, method):
    sim = pool(cloth(), method, topology=topology, substeps=2)
    sim.advance(6)
    x = sim.positions()
    sim.reset()
    sim.advance(3)
    particles = sim.storage.scene.particles
    sim.set(gravity=sim.scene.world.gravity, mass=particles.mass, fixed=particles.fixed)
    sim.set(stiffness=sim.scene.springs.stiffness, kind=None)
    sim.set(positions=sim.positions(), velocities=sim.velocities())
    sim.forces()
    sim.advance(3)
    np.testing.assert_array_equal(sim.positions(), x)


@pytest.mark.parametrize(("method", "topology"), RUNS)
def test_changes_in_a_run_keep_its_time_and_what_is_broken(pool, topology, method):
    sim = pool(cloth(shear=0.1), method, topology=topology)
    sim.advance(4)
    sim.set(break_force=np.inf)
    sim.set(break_force=0.5, rest_length=5.0, springs=[5])
    sim.set(positions=sim.positions()[9] + [0.0, 1.0], particles=9)
    sim.advance(2)
    broken = ~sim.springs_alive()
    assert broken[5]
    done = sim.work()
    sim.set(stiffness=0.7, kind="shear")
    sim.set(damping=[0.1, 0.2], springs=[3, 4])
    sim.set(stiffness=0.0, springs=2)
    sim.set(mass=2.0, velocities=(1.0, 0.0), particles=np.arange(48) == 20)
    assert (sim.frame, sim.time, sim.work()) == (6, 6.0, done)
    np.testing.assert_array_equal(~sim.springs_alive(), broken)
    springs = sim.storage.scene.springs
    assert (springs.stiffness == 0.7).sum() == 2 * 7 * 5  # two diagonals in each cell
    np.testing.assert_array_equal(springs.damping[[3, 4]], [0.1, 0.2])
    np.testing.assert_array_equal(sim.velocities()[20], [1.0, 0.0])
    np.testing.assert_allclose(sim.forces(), total_forces(sim), rtol=0, atol=1e-12)
    sim.blow((200.0, 100.0), (5.0, 5.0))
    push = sim.forces() - total_forces(sim)
    assert np.abs(push).max() > 0.1
    sim.set(gravity=(0.0, 0.3))  # the push lasts as long as it would have
    np.testing.assert_allclose(sim.forces() - total_forces(sim), push, rtol=0, atol=1e-12)
    sim.advance(2)
    np.testing.assert_allclose(sim.forces(), total_forces(sim), rtol=0, atol=1e-12)


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_springs_are_cut_tied_and_mended_and_particles_pinned_and_removed(pool, topology):
    scene = cloth()
    sim = pool(scene, topology=topology)
    sim.advance(2)
    between = sim.springs().tolist()
    sim.cut([10, 11])
    sim.advance(2)
    assert np.flatnonzero(~sim.springs_alive()).tolist() == [10, 11]
    assert [between.index(pair) for pair in sim.drawn_springs().tolist()].count(10) == 0
    new = sim.add_spring(0, 47, stiffness=0.3)
    assert new == sim.spring_count - 1 == len(between)
    apart = np.linalg.norm(sim.positions()[47] - sim.positions()[0])
    assert sim.storage.scene.springs.rest_length[new] == pytest.approx(apart, abs=1e-12)
    assert sim.add_spring(*between[10]) == 10 and sim.springs_alive()[10]
    with pytest.raises(InputError, match="spring 10 ties particles"):
        sim.add_spring(*between[10])
    np.testing.assert_allclose(sim.forces(), total_forces(sim), rtol=0, atol=1e-12)
    sim.pin(20)
    x = sim.positions()[20]
    sim.advance(2)
    np.testing.assert_array_equal(sim.positions()[20], x)
    assert not sim.velocities()[20].any()
    sim.unpin([20])
    sim.advance()
    assert (sim.positions()[20] != x).any()

    x, alive = sim.positions(), sim.springs_alive()
    left = sim.remove([7, 30])
    np.testing.assert_array_equal(left, np.setdiff1d(np.arange(48), [7, 30]))
    np.testing.assert_array_equal(sim.positions(), x[left])
    kept = [s for s, pair in enumerate([*between, [0, 47]]) if not {7, 30} & set(pair)]
    np.testing.assert_array_equal(left[sim.springs()], np.array([*between, [0, 47]])[kept])
    np.testing.assert_array_equal(sim.springs_alive(), alive[kept])
    assert not alive[kept].all()
    sim.advance()
    np.testing.assert_allclose(sim.forces(), total_forces(sim), rtol=0, atol=1e-12)
    sim.remove(np.ones(46, bool))
    assert sim.forces().shape == (0, 2) and sim.spring_count == 0
    sim.reset()
    assert sim.particle_count == 48 and sim.springs_alive().all()


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_a_cut_spring_stays_cut_when_a_frame_is_undone(pool, topology):
    sim = pool(cloth(), topology=topology)
    sim.cut(3)
    sim.set(velocities=(1e7, 0.0), particles=9)
    with pytest.raises(tc.SimulationFailure, match="runs away"):
        sim.advance()
    assert np.flatnonzero(~sim.springs_alive()).tolist() == [3]
    assert sim.storage.marks()[3, 0] == 2  # gone, not breaking: it pulls no more
    np.testing.assert_allclose(sim.forces(), total_forces(sim), rtol=0, atol=1e-12)


def test_a_step_that_follows_the_springs_follows_what_is_set(pool):
    sim = pool(cloth(), dt="auto")
    before = sim.substeps
    sim.set(stiffness=80.0)
    assert sim.substeps > before
    x, many = sim.positions(), sim.substeps
    with pytest.raises(InputError, match="--dt auto: a stable step"):
        sim.set(stiffness=1e30)
    assert (sim.substeps, sim.storage.scene.springs.stiffness.max()) == (many, 80.0)
    np.testing.assert_array_equal(sim.positions(), x)
    sim.set(stiffness=0.5)
    assert sim.substeps == before


def test_what_pushes_goes_on_over_loads_and_ends_when_it_should(pool):
    sim = pool(cloth())
    force = np.random.default_rng(2).normal(size=(sim.particle_count, 2))
    sim.blow((30.0, 30.0), (1.0, 1.0))
    sim.hold(force)  # which no frame's end takes away
    sim.load_as("graph", "serial", sim.positions(), sim.velocities())
    sim.spawn((50.0, 50.0))
    sim.advance()
    held = sim.storage.held()
    np.testing.assert_array_equal(
        held, np.vstack([force.astype(sim.storage.real), np.zeros((1, 2))])
    )
    sim.blow((30.0, 30.0), (1.0, 1.0))
    assert sim.storage.fits(sim.storage.snapshot())  # which changes nothing
    sim.advance()
    assert sim.storage.held() is None


def test_a_trajectory_does_not_go_on_without_particles(pool, tmp_path):
    sim, trajectory = pool(cloth()), Trajectory(tmp_path / "t.npz")
    sim.advance()
    trajectory.record(sim)
    sim.remove(3)
    sim.advance()
    with pytest.raises(InputError, match="of 48 particles cannot go on with 47"):
        trajectory.record(sim)
    trajectory.discard()


def test_what_is_noted_beside_a_run_is_written_or_refused_in_a_line(pool, tmp_path):
    """And a refusal loses nothing of what was recorded, nor leaves a file."""
    sim, trajectory = pool(cloth()), Trajectory(tmp_path / "t.npz")
    sim.advance()
    trajectory.record(sim)
    bad = ({"a": object()}, {(1, 2): 3}, [1], "words")
    for noted in bad:
        with pytest.raises(InputError, match="Trajectory.save: meta"):
            trajectory.save(noted)
        with pytest.raises(InputError, match="Checkpoint.save: about"):
            sim.checkpoint().save(tmp_path / "c.npz", about=noted)
    with pytest.raises(InputError, match="rewind: frame must be a whole number"):
        trajectory.rewind(None)
    trajectory.save({"seed": np.int64(3), "at": np.array([1.0, 2.0])})
    sim.checkpoint().save(tmp_path / "c.npz", {"seed": np.int64(3)})
    saved = tc.load_trajectory(tmp_path / "t.npz")
    assert saved.meta == {"seed": 3, "at": [1.0, 2.0]}
    assert repr(saved) == f"<Saved: 1 frame of {len(saved.fixed)} particles>"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["c.npz", "t.npz"]


def test_a_trajectory_that_is_never_saved_leaves_nothing(tmp_path):
    """Also where a program ends by an error."""
    trajectory = Trajectory(tmp_path / "t.npz")
    assert list(tmp_path.iterdir())
    del trajectory
    gc.collect()
    assert not list(tmp_path.iterdir())
    program = "import taichi_cloth as tc; t = tc.Trajectory('t.npz'); 1 / 0"
    ended = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True)
    assert b"ZeroDivisionError" in ended.stderr
    assert not list(tmp_path.iterdir())


def test_what_is_read_is_a_copy(pool):
    """What a program writes into it changes neither the run nor the scene that it was given."""
    scene = cloth()
    sim = pool(scene.with_parts(triangles=np.array([[0, 1, 8]])))
    sim.advance()
    reads = (
        *(sim.positions, sim.velocities, sim.forces, sim.radii, sim.colors, sim.fixed),
        *(sim.springs, sim.springs_alive, sim.triangles, sim.triangles_alive, sim.momentum),
    )
    for read in reads:
        had, mine = read(), read()
        mine[:] = 1 - mine if mine.dtype != bool else ~mine
        np.testing.assert_array_equal(read(), had, err_msg=read.__name__)
    assert sim.scene.particles.radius[0] == cloth().particles.radius[0]


REFUSED = [
    (lambda sim: sim.hold(np.ones((3, 2))), r"hold: force must have shape \(48, 2\)"),
    (lambda sim: sim.hold(np.full((48, 2), np.nan)), r"hold: force must be finite, is nan at \[0"),
    (lambda sim: sim.hold(np.ones((48, 2), complex)), "hold: force must be numbers"),
    (lambda sim: sim.blow((1, 2, 3), (1, 1)), "blow: pointer must have 2 numbers"),
    (lambda sim: sim.blow((1, 2), (np.inf, 1)), r"displacement must be finite, is inf at \[0\]"),
    (lambda sim: sim.blow_ray((1, 2, 3), (1, 0, 0), (1, 1, 1)), "the scene is 2-D; use blow"),
    (lambda sim: sim.advance(-5), "advance: frames must be .* at least 0, is -5"),
    (lambda sim: sim.advance(1.5), "advance: frames must be a whole number .*, is 1.5"),
    (lambda sim: sim.advance(True), "advance: frames must be a whole number .*, is True"),
    (lambda sim: sim.advance(10**5000), "advance: frames must be at most"),
    (lambda sim: sim.spawn((1.0, np.nan)), r"spawn: position must be finite, is nan at \[1\]"),
    (lambda sim: sim.spawn((1.0, 1.0), tied_to=48), "tied to particle 48, which does not exist"),
    (lambda sim: sim.spawn((1.0, 1.0), tied_to=0.0), "tied_to must be a whole number"),
    (lambda sim: sim.spawn((1.0, 1.0), color=(1, 2, 256)), "from 0 to 255, is 256.0 at"),
    (lambda sim: sim.spawn((1.0, 1.0), mass=1e-310), "particle 48"),
    (lambda sim: sim.spawn((1.0, 1.0), mas=2.0), "spawn: unknown name 'mas'; did you mean 'mass'"),
    (lambda sim: sim.set_step("soon"), "--dt must be a number, is 'soon'"),
    (lambda sim: sim.set_step(substeps=2.5), "--substeps must be a whole number"),
    (lambda sim: sim.load_as("graph", "serial", [[1.0]], [[1.0]]), "load_as: x must have shape"),
    (lambda sim: sim.load_scene(None), "scene must be a Scene, is None"),
    (lambda sim: sim.set(), "nothing to set"),
    (lambda sim: sim.set(stifness=1.0), "unknown name 'stifness'; did you mean 'stiffness'"),
    (lambda sim: sim.set(mass=np.ones(47)), "mass must be one number for all particles, or an"),
    (lambda sim: sim.set(mass=[1.0] * 47 + [0.0]), r"mass must be positive, is 0.0 at \[47\]"),
    (lambda sim: sim.set(restitution=1.5), "restitution must be between 0 and 1, is 1.5"),
    (lambda sim: sim.set(fixed=1), "fixed must be True or False, is 1"),
    (lambda sim: sim.set(gravity=(0.0, 0.1, 0.0)), "gravity must have 2 numbers"),
    (lambda sim: sim.set(break_force=np.nan), "break_force must not be NaN"),
    (lambda sim: sim.set(mass=1.0, springs=[1]), "none of what is set belongs to springs"),
    (lambda sim: sim.set(stiffness=1.0, springs=[999]), "no spring 999; there are springs 0 to 81"),
    (lambda sim: sim.set(stiffness=1.0, springs=[3, 3]), "spring 3 is named twice"),
    (lambda sim: sim.set(stiffness=1.0, kind="bend"), "no regular grid of the scene has bend"),
    (lambda sim: sim.set(mass=1.0, particles=[True]), "a mask must have 48 values"),
    (lambda sim: sim.set(positions=(-1.0, 5.0), particles=4), "particle 4 at .* outside the world"),
    (lambda sim: sim.set(stiffness=1.0, springs=[1], kind="shear"), "springs and kind both select"),
    (lambda sim: sim.set(stiffness=1.0, particles=[1]), "none of what is set belongs to particles"),
    (lambda sim: sim.set(gravity=(0.0, 1.0), springs=[1]), "set: springs: none of what is set"),
    (lambda sim: sim.set(gravity=(0.0, 1.0), kind="shear"), "set: kind: none of what is set"),
    (
        lambda sim: sim.set(bending=1.0),
        "set: bending: nothing in the scene has it; give its cloths",
    ),
    (lambda sim: sim.set(air={"density": 1.0}), "set: air: a 2-D world has none"),
    (lambda sim: sim.set(friction=-0.5), "set: friction must not be negative, is -0.5"),
    (lambda sim: sim.set(collisions=1), "set: collisions must be True or False, is 1"),
    (lambda sim: sim.add_spring(0, 48), "no particle 48; the scene has particles 0 to 47"),
    (lambda sim: sim.add_spring(48, 0), "no particle 48; the scene has particles 0 to 47"),
    (lambda sim: sim.add_spring(1, 0), "add_spring: spring 0 ties particles 1 and 0 already"),
    (lambda sim: sim.pin(None), "pin: particles must be an index"),
    (lambda sim: sim.cut(-1), "cut: springs: no spring -1"),
    (lambda sim: sim.remove(48), "remove: particles: no particle 48"),
    (lambda sim: sim.add_spring(0, 0), "it ties particle 0 to itself"),
    (lambda sim: sim.add_spring(0, 9, stiffness=-1), "stiffness must not be negative"),
    (lambda sim: sim.scene.springs.select([99]), "Springs.select: must be a mask of 82"),
    (lambda sim: sim.blow((1, 2), (1, 1), reach=1e-320), "blow: reach .* is so small that"),
    (lambda sim: sim.grab([0], (1, 2, 3)), "grab: place must have 2 numbers"),
    (lambda sim: sim.grab([0], (1, 2), stiffness=-1), "grab: stiffness must not be negative"),
    (lambda sim: sim.begin_from(None, 1.0, 1), "begin_from: takes what `start` returned, not None"),
    (lambda sim: sim.go_on_from([1]), r"go_on_from: takes a Simulation, not \[1\]"),
    (
        lambda sim: sim.go_on_from(Simulation(build("oscillator"), topology="graph")),
        "go_on_from: that run is of 'oscillator' in 2-D, this one of",
    ),
    (lambda sim: tc.picture(sim, parts=np.ones(())), "parts: must be some of"),
    (lambda sim: tc.picture(sim, camera=tc.Camera((1.0, 1.0, 1.0))), "camera: 'cloth' is 2-D"),
    (lambda sim: tc.show(sim, view=np.ones(2)), "unknown view"),
    (lambda sim: sim.report("x.html", pictures=1), "pictures must be True or False, is 1"),
    (lambda sim: sim.describe_convergence(), "symplectic_euler solves no equations to a tolerance"),
    (lambda sim: sim.topology_of([]), "--method must be one of"),
    (lambda sim: sim.obstacles("now"), "obstacles: time must be a number, is 'now'"),
]


IN_AIR = """
[world]
size = [9.0, 9.0, 9.0]
air = { density = 1.2, drag = 1.1 }
contact = "resting"
[[obstacles]]
shape = "sphere"
centre = [1.0, 8.0, 0.0]
radius = 0.5
friction = 0.25
[[obstacles]]
shape = "sphere"
centre = [8.0, 8.0, 0.0]
radius = 0.5
friction = 0.5
[[cloths]]
origin = [3.0, 3.0, 0.0]
columns = 4
rows = 3
spacing = 0.5
bending = 2e-3
"""


def with_set(now, **given):
    return editing.with_values(now, given, editing.Selection())


def test_what_is_set_of_a_world_leaves_the_rest_of_it():
    """Some keys of a table, all of it, or none any more; friction, which each obstacle has."""
    now = Snapshot.at_start(scenefile.parse(IN_AIR))
    breeze = {"velocity": (1.0, 0.0, 0.0), "seed": 3.0}
    world = with_set(now, air={"drag": 2.0}, wind=breeze).scene.world
    assert world.more["air"] == {"density": 1.2, "drag": 2.0}
    assert world.more["wind"] == breeze and world.gravity == now.scene.world.gravity
    blown = with_set(now, wind=breeze)
    assert with_set(blown, wind=None).scene.world.more == now.scene.world.more
    rubbing = with_set(now, friction=0.5).scene
    first, second = rubbing.obstacles
    assert rubbing.world.friction == first.value("friction") == 0.5
    assert first.value("radius") == 0.5 and second is now.scene.obstacles[1]
    assert with_set(now, collisions=True).scene.world.collisions is True
    bent = with_set(now, bending=0.5).scene.stencils
    assert (bent.bending == 0.5).all() and len(bent) == len(now.scene.stencils)
    assert editing.same(with_set(now, bending=now.scene.stencils.bending), now)
    assert editing.same(
        with_set(now, gravity=now.scene.world.gravity, mass=now.scene.particles.mass), now
    )
    for given in (
        *({"air": {"drag": 2.0}}, {"gravity": (0.0, 1.0, 0.0)}, {"collisions": True}),
        *({"friction": 0.1}, {"bending": 0.5}, {"mass": 2.0}, {"fixed": True}, {"stiffness": 9.0}),
        *({"velocities": (1.0, 0.0, 0.0)}, {"positions": (4.0, 4.0, 0.0)}),
    ):
        assert not editing.same(with_set(now, **given), now), given
    assert not editing.same(editing.with_cut(now, np.array([3]), 1), now)
    rubbing = replace(now, scene=replace(now.scene, obstacles=rubbing.obstacles))
    assert not editing.same(rubbing, now)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"air": 3}, "set: air must be a mapping with density, drag, lift, is 3"),
        ({"air": {"darg": 1.0}}, "set: air: unknown key 'darg'; did you mean 'drag'"),
        ({"air": {"drag": -1.0}}, "set: air.drag must be at least 0, is -1.0"),
        ({"wind": {"gust": 1.0}}, "set: wind: 'velocity' is missing"),
        ({"wind": {"velocity": (1.0, 0.0)}}, r"set: wind.velocity must have 3 numbers"),
        (
            {"wind": {"velocity": (1.0, 0.0, 0.0), "seed": 1.5}},
            "set: wind.seed must be a whole number, is 1.5",
        ),
        (
            {"wind": {"velocity": (1.0, 0.0, 0.0)}, "air": None},
            "set: wind does nothing without air; set both",
        ),
        ({"bending": -1.0}, "set: bending must not be negative, is -1.0"),
        ({"bending": [1.0, 2.0]}, "set: bending must be one number for all stencils, or an array"),
    ],
)
def test_what_is_set_of_a_world_is_refused_in_one_line(given, says):
    with pytest.raises(InputError, match=says):
        with_set(Snapshot.at_start(scenefile.parse(IN_AIR)), **given)


def test_a_particle_is_put_anywhere_inside_and_may_stay_where_it_got_by_itself():
    now = Snapshot.at_start(scenefile.parse(IN_AIR))
    low, high = now.scene.world.low, now.scene.world.high
    x = now.x.copy()
    x[0], x[1] = low, high
    assert (with_set(now, positions=x).x == x).all()
    for axis in range(3):
        for beyond in (low - 1.0, high + 1.0):
            x[2] = now.x[2]
            x[2, axis] = beyond[axis]
            with pytest.raises(InputError, match="particle 2 at .* which reaches from"):
                with_set(now, positions=x)
            strayed = replace(now, x=x.copy())
            assert (with_set(strayed, positions=x).x == x).all()


def test_wrong_arguments_are_refused_in_one_line_and_change_nothing(pool):
    sim = pool(cloth())
    sim.advance(2)
    x, frame = sim.positions(), sim.frame
    sim.grab([5], x[5])
    had = sim.held()
    for call, message in REFUSED:
        with pytest.raises(InputError, match=message) as refused:
            call(sim)
        assert "\n" not in str(refused.value)
        assert sim.held() is had
    sim.advance(np.int64(0))  # NumPy's whole numbers are whole numbers
    assert sim.frame == frame
    np.testing.assert_array_equal(sim.positions(), x)


def test_what_the_precision_cannot_hold_of_the_pointer_changes_nothing(pool, monkeypatch):
    sim = pool(cloth())
    sim.advance(2)
    sim.grab([5], sim.positions()[5])
    had, place = sim.held(), sim.held().place.copy()
    weight = sim.storage.scene.particles.mass[5]
    monkeypatch.setattr(sim.storage, "real", np.float32)  # as in a run in f32
    for call in (
        lambda: sim.drag((1e300, 0.0)),
        lambda: sim.grab([6], (0.0, 0.0), stiffness=1e300),
        lambda: sim.blow((0.0, 0.0), (1e300, 0.0)),
    ):
        with pytest.raises(InputError, match="too large or too small for float32"):
            call()
        np.testing.assert_array_equal(sim.held().particles, had.particles)
        np.testing.assert_array_equal(sim.held().place, place)
        assert sim.storage.scene.particles.mass[5] == weight
        assert sim.storage.held() is None  # no blow


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tc.start(arch=None), "--arch must be one of"),
        (lambda: tc.start(threads=1.5), "--threads must be a whole number"),
        (lambda: tc.start(cache="no"), "cache must be True or False"),
        (lambda: Simulation(None), "scene must be a Scene"),
        (lambda: Simulation(cloth(), dt=True), "--dt must be a number, is True"),
        (lambda: Simulation(cloth(), lanes=0), "lanes must be a whole number of at least 1"),
        (lambda: Simulation(cloth(), lanes=12), "power of two, is 12; give 8 or 16"),
        (lambda: Simulation(cloth(), topology=None), "--topology must be one of"),
        (lambda: Simulation(cloth(), "vbd", iterations=2.5), "--iterations must be a whole"),
        (lambda: Simulation(cloth(), compiling=1), "compiling must be a function, is 1"),
        (lambda: Simulation(cloth(), soon=None), "soon must be True or False, is None"),
        (lambda: Simulation(cloth(), lanes=np.ones(2)), "lanes must be a whole number"),
        (lambda: tc.validate(cloth().with_world(size=None)), "world: size must be a list of"),
        (lambda: tc.validate(cloth().with_world(dt=1j)), "world: dt must be a number, is 1j"),
        (lambda: tc.validate(cloth().with_world(dt=10**400)), "dt must be a finite number"),
        (lambda: tc.validate(cloth().with_world(walls="left")), "walls must be a list of names"),
        (lambda: tc.validate(replace(cloth(), springs=None)), "springs must be of type Springs"),
        (lambda: tc.Particles.build("here"), "position must be numbers, is 'here'"),
        (lambda: tc.Particles.build([[1, 2]], mass=[1, 2]), r"or an array of shape \(1,\)"),
        (lambda: tc.Springs.build([[0, 5]], [[1.0, 2.0]]), "no particle 5, which spring 0 ties"),
        (lambda: tc.Springs.build([[0, 1.5]], [[1.0, 2.0]]), "between must be whole numbers"),
        (lambda: tc.grid((0, 0), 2.5, 3, 1.0), "grid: columns must be a whole number, is 2.5"),
        (lambda: tc.grid((0, 0), 2, 3, 1.0, links="shear"), "links must be a list of kinds"),
        (lambda: tc.grid((0, 0), 2, 3, 1.0, links=np.ones(())), "links must be a list of kinds"),
        (lambda: tc.grid((0, 0), 2, 3, 1.0, material=7), "grid: material must be a Material, is 7"),
        (lambda: tc.grid((0, 0), 2, 3, 1.0, break_in=[]), "break_in of structural links must be a"),
        (
            lambda: tc.grid_stencils(3, 3, 1.0, 1.0, across=(1, 0), down=(2, 0)),
            "across and down must not be parallel",
        ),
        (lambda: tc.grid_stencils(3, 3, 1.0, 1.0, across=1), "across and down must be 2 or 3"),
        (
            lambda: tc.Springs.build([[0, 1]], [[1, 2], [3, 4]], break_in=["both", "both"]),
            r"break_in must be one .* for all springs, or an array of shape \(1,\)",
        ),
        (lambda: tc.Stencils.build([1, 0, 2], [1.0], 1.0), r"particle must have shape \(m, size\)"),
        (lambda: tc.Stencils.build([[1, 0, 2]], [[1.0]], 1.0), r"weight must have shape \(1, 3\)"),
        (
            lambda: tc.mesh_stencils([[0, 0], [1, 0], [0, 1]], [[0, 1.5, 2]], 1.0),
            "triangles must be whole numbers",
        ),
        (
            lambda: tc.mesh_stencils([[0, 0], [1, 0], [0, 1]], [0, 1, 2], 1.0),
            r"triangles must have shape \(t, 3\)",
        ),
        (lambda: tc.mesh("x.obj", up=0), "mesh: up must be 1 or -1, is 0"),
        (lambda: tc.mesh("x.obj", parts=True), "mesh: parts must be a whole number"),
        (lambda: tc.validate(cloth().with_world(size=np.ones(()))), "size must be a list of"),
        (lambda: tc.validate(cloth().with_world(tools="all")), "tools must be True or False"),
        (lambda: tc.validate(cloth().with_world(more={1: 2})), "unknown key 1; known: "),
        (lambda: tc.validate(cloth().with_parts(spring_color=((1,), 2, 3))), "color must be three"),
        (
            lambda: tc.validate(
                replace(cloth(), stencils=tc.Stencils(*[np.zeros(1, np.int64)] * 2, [1], [1]))
            ),
            "weight must be an array of numbers",
        ),
        (
            lambda: tc.validate(cloth().with_parts(obstacles=(tc.Obstacle("plane", 3),))),
            "values must be a mapping",
        ),
        (lambda: tc.load_scene(None), "load_scene: path must be a path, is None"),
        (lambda: tc.load_events(5), "load_events: path must be a path, is 5"),
        (lambda: tc.load_trajectory(5), "a trajectory's path is no int"),
        (lambda: tc.save_scene(None, "x.toml"), "scene must be a Scene"),
        (
            lambda: tc.scenes.build("cloth", columns=np.inf),
            "columns must be a (whole|finite) number",
        ),
        (lambda: tc.compare("x", "x", scene=True), "compare: scene must be a Scene, is True"),
        (lambda: tc.scenes.build(None), "a scene's name is a word, not None"),
    ],
)
def test_public_functions_refuse_what_makes_no_sense(call, message):
    with pytest.raises(InputError, match=message) as refused:
        call()
    assert "\n" not in str(refused.value)


def test_kinds_of_links_may_come_one_by_one():
    """What can be gone through but once made a cloth without springs, and no word of it."""
    kinds = ["structural", "shear"]
    of_list, of_iterator = (tc.grid((0, 0), 3, 3, 1.0, links=of)[1] for of in (kinds, iter(kinds)))
    np.testing.assert_array_equal(of_iterator.between, of_list.between)


def test_clicks_find_room_and_kernels_ready():
    """No click waits for a compiler, also after hundreds: a window compiles beforehand what the
    first ones need.
    """
    sim = Simulation(build("box", radius=2.0), execution="serial")
    sim.prepare_clicks()
    outside = r"^spawn: position .* is outside the world"  # and no particle 0, which is another
    for wrong, message in (((1e4, 0.0, 0.0), outside), ((1.0, 2.0), "3 numbers")):
        with pytest.raises(InputError, match=message):
            sim.spawn(wrong)
    with pytest.raises(InputError, match="does not exist"):
        sim.spawn((100.0, 100.0, 0.0), tied_to=5)
    assert sim.positions().shape == (0, 3)
    state, spec = state_of(sim), spec_of(sim)
    kernels = _compiled()
    rng = np.random.default_rng(0)
    x = rng.uniform([40, 40, -200], [560, 360, 200], (260, 3))
    last = None
    for k, place in enumerate(x):
        last = sim.spawn(place, tied_to=last if k < 5 else None)
    np.testing.assert_array_equal(sim.positions(), x)
    assert state_of(sim) is state and spec_of(sim) == spec
    assert _compiled() == kernels


@pytest.mark.parametrize("dim", [2, 3])
def test_no_motion_of_the_pointer_waits_for_a_compiler(dim):
    """Nor a cut, or a hold: what they need is compiled with the first frame's kernels."""
    scene = cloth() if dim == 2 else build("flag", columns=6)
    sim = Simulation(scene.with_world(mouse="blow", tools=True), execution="serial")
    sim.prepare_clicks()
    x = sim.positions()
    np.testing.assert_array_equal(x, scene.particles.position)
    sim.advance(1)
    kernels, to = _all_compiled(), x[-1]
    if dim == 2:
        sim.blow(to, [1.0, 0.0])
    else:
        sim.blow_ray(to, [0.0, 0.0, 1.0], [0.01, 0.0, 0.0], 0.2)
    sim.advance(2)
    sim.grab([len(x) - 1], to)
    sim.drag(to)
    sim.advance(1)
    sim.let_go()
    sim.cut([0])
    assert not _all_compiled() - kernels


def _all_compiled():
    """The kernels of any kind that are compiled: names, and for what."""
    kernels = [one for one in gc.get_objects() if type(one) is Kernel]
    return {(one.func.__name__, key) for one in kernels for key in one.compiled_kernels}


def _compiled():
    """How many kernels of the state's loading and reading are compiled."""
    from taichi_cloth.kernels import fracture, memory, readback, transfer

    modules = memory, readback, transfer
    found = [each for module in modules for each in vars(module).values()]
    found.append(fracture.mark_new_springs)
    return sum(len(k._primal.compiled_kernels) for k in found if hasattr(k, "_primal"))
