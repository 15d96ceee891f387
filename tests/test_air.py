"""Air and wind: the law against its twin and closed forms, its order, its share of the limit."""

from dataclasses import replace

import numpy as np
import pytest
import taichi as ti
from inside import spec_of, state_of
from scipy.spatial import Delaunay
from selection import mostly_thorough, thorough

from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels import forces, methods, sine
from taichi_cloth.kernels.forces import air
from taichi_cloth.kernels.packs import set_slot_value, slot_number, slot_value
from taichi_cloth.kernels.solvers import newton_cg
from taichi_cloth.kernels.surfaces import (
    compute_traction_damping,
    compute_traction_product,
    keep_tractions,
)
from taichi_cloth.limits import tractions
from taichi_cloth.limits.bounds import any_geometry, gershgorin, step_within
from taichi_cloth.limits.eigenmodes import stable_step
from taichi_cloth.limits.network import Network
from taichi_cloth.scene import assignments, library, scenefile
from taichi_cloth.scene.model import Particles, Scene, World
from taichi_cloth.scene.triangles import area_vectors, at_corners, corner_shares
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.stability import experiment
from taichi_cloth.trade import ode

FLAG = """
[world]
size = [8.0, 40.0, 8.0]
up = "y"
gravity = [0.0, -9.81, 0.0]
dt = 0.01
air = { density = 1.2, drag = 1.1, lift = 0.6 }
wind = { velocity = [1.0, 0.5, 4.0], gust = 0.3, period = 0.1, seed = 1 }
substeps = 1
[[cloths]]
origin = [3.0, 20.0, 0.0]
columns = 4
rows = 4
spacing = 0.1
links = ["structural", "shear"]
density = 0.15
stretch = 8.0
shear = 2.0
damping_time = 0.002
pinned = [[0, 0], [3, 0]]
"""


def flag(**world):
    """A small cloth in gusts that could tear, its particles moving at random."""
    scene = scenefile.parse(FLAG.replace("shear = 2.0", "shear = 2.0\nstrength = 1e4"))
    particles, rng = scene.particles, np.random.default_rng(5)
    free = ~particles.fixed[:, None]
    x = particles.position + free * rng.normal(0, 0.01, particles.position.shape)
    v = free * rng.normal(0, 1.0, particles.position.shape)
    scene = replace(scene, particles=replace(particles, position=x, velocity=v))
    return scene.with_world(**world)


def sheet(stretch=8.0, **more):
    """A flat sheet that lies across y, free, and falls; more: of [world]."""
    text = FLAG.replace("pinned = [[0, 0], [3, 0]]", "down = [0.0, 0.0, 1.0]")
    scene = scenefile.parse(text.replace("stretch = 8.0", f"stretch = {stretch}"))
    still = {"air": {"density": 1.2, "drag": 1.1, "lift": 0.6}}
    return scene.with_world(more=still | more)


@pytest.fixture(scope="module")
def falling(device):
    """A simulation of the sheet on the graph, with symplectic Euler."""
    return Simulation(sheet(), topology="graph", execution="serial")


@kernel
def damping_of_triangles(spec: ti.template(), state: ti.template(), out: ti.types.ndarray()):
    compute_traction_damping(spec, state, 0)
    for i in range(out.shape[0]):
        out[i] = slot_number(spec, state.traction_damping, state.slot[i])


@kernel
def product_of_triangles(
    spec: ti.template(), state: ti.template(), along: ti.types.ndarray(), out: ti.types.ndarray()
):
    for i in range(out.shape[0]):
        direction = ti.Vector([along[i, 0], along[i, 1], along[i, 2]])
        set_slot_value(spec, state.direction, state.slot[i], direction)
    keep_tractions(spec, state, 0)
    compute_traction_product(spec, state, 0)
    for i in range(out.shape[0]):
        product = slot_value(spec, state.traction, state.slot[i])
        for axis in ti.static(range(3)):
            out[i, axis] = product[axis]


def test_newtons_method_has_the_exact_derivative_of_the_air(device):
    """Against central differences of the forces, where velocities change positions by tau, too."""
    scene, tau, h = flag(), 0.02, 1e-6
    sim = Simulation(scene, "implicit_euler", topology="graph", execution="serial")
    sim.forces()  # which sets the wind
    state_of(sim).tau[None] = tau
    along = np.random.default_rng(2).normal(size=scene.particles.position.shape)
    state_of(sim).traction.fill(0.0)
    found = np.zeros_like(along)
    product_of_triangles(spec_of(sim), state_of(sim), along, found)
    x, v, world = scene.particles.position, scene.particles.velocity, scene.world
    shares = corner_shares(x, scene.triangles)
    ends = [
        tractions.forces_on_particles(
            x + s * h * tau * along, v + s * h * along, 0.0, world, scene.triangles, shares
        )
        for s in (-1, 1)
    ]
    expected = (ends[0] - ends[1]) / (2 * h)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


def expected_forces(sim):
    """All forces on the particles by twins, where triangles with a broken side are gone."""
    scene = sim.storage.scene
    whole = replace(
        scene,
        triangles=scene.triangles[sim.triangles_alive()],
        springs=scene.springs.select(sim.springs_alive()),
    )
    twins = ode.Forces(whole)
    twins.free[:] = True
    a = twins.acceleration(sim.positions(), sim.velocities(), sim.time)
    return np.where(scene.particles.fixed[:, None], 0.0, a * scene.particles.mass[:, None])


@pytest.mark.parametrize("topology", mostly_thorough(["lanes", "graph"], default=["graph"]))
def test_the_law_is_its_twin_in_gusts_and_on_torn_surfaces(topology, device):
    sim = Simulation(flag(), topology=topology, execution="serial", lanes=2)
    assert sim.topology == topology
    free = ~sim.scene.particles.fixed
    for substeps in (1, 5):  # the same wind at finer steps
        sim.load_scene(flag(), substeps=substeps)
        for _ in range(3):
            found, expected = sim.forces()[free], expected_forces(sim)[free]
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)
            sim.advance(7)
    sim.cut([3, 20])
    assert sim.triangles_alive().sum() < len(sim.triangles())
    sim.advance()
    np.testing.assert_allclose(sim.forces()[free], expected_forces(sim)[free], atol=1e-14)
    if topology == "graph":
        found = np.zeros(len(free))
        damping_of_triangles(spec_of(sim), state_of(sim), found)
        alive = sim.triangles()[sim.triangles_alive()]
        shares = corner_shares(sim.scene.particles.position, sim.triangles())
        shares = shares[sim.triangles_alive()]
        area = area_vectors(sim.positions(), alive)
        mean = tractions.mean_velocities(sim.velocities(), alive, shares)
        n, h = area / np.linalg.norm(area, axis=1)[:, None], 1e-6
        change = [air.twin(area, mean + s * h * n, sim.time, sim.scene.world) for s in (-1, 1)]
        along = ((change[0] - change[1]) * n).sum(axis=1) / (2 * h)
        expected = at_corners(shares * along[:, None], alive, len(free))
        np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_a_flat_sheet_falls_at_its_terminal_velocity(falling):
    """Flat: each particle's share of the air is its share of the mass."""
    scene = sheet()
    falling.load_scene(scene, substeps=4)
    falling.advance(200)
    v = falling.velocities()
    terminal = np.sqrt(2 * 0.15 * 9.81 / (1.2 * 1.1))
    np.testing.assert_allclose(v[:, 1], -terminal, rtol=1e-9)
    assert np.abs(v[:, [0, 2]]).max() < 1e-9 and np.ptp(falling.positions()[:, 1]) < 1e-9


OF_A_MESH = """
[[meshes]]
file = "sheet.obj"
density = 0.15
stretch = 8.0
damping_time = 0.002
move = [3.0, 20.0, 3.0]
"""


def flat_mesh(path, kind):
    """A file of a sheet across y: triangles between random points, or quads that are cut in two."""
    at, rng = np.linspace(0.0, 0.5, 9), np.random.default_rng(6)
    points = np.stack(np.meshgrid(at, at), axis=-1)
    points[1:-1, 1:-1] += rng.uniform(-0.02, 0.02, (7, 7, 2))
    points = points.reshape(-1, 2)
    faces = Delaunay(points).simplices
    if kind == "quads":
        first = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
        faces = np.stack([first, first + 9, first + 10, first + 1], axis=1)
    lines = [f"v {x:.17g} 0 {z:.17g}" for x, z in points]
    lines += ["f " + " ".join(map(str, face)) for face in faces + 1]
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("kind", ["random", "quads", "grid"])
def test_a_flat_sheet_falls_flat_against_the_wind_as_a_rigid_plate(kind, tmp_path, device):
    """v' = -g + (w - v)^2 g / u^2 with the terminal velocity u; w - v is by tanh what it is."""
    text, wind = FLAG.replace("pinned = [[0, 0], [3, 0]]", "down = [0.0, 0.0, 1.0]"), 2.0
    if kind != "grid":
        flat_mesh(tmp_path / "sheet.obj", kind)
        text = text[: text.index("[[cloths]]")] + OF_A_MESH
    (tmp_path / "scene.toml").write_text(text)
    scene = scenefile.load(tmp_path / "scene.toml")
    assert np.ptp(scene.particles.mass) > 0.5 * scene.particles.mass.mean()
    blown = {"wind": {"velocity": (0.0, wind, 0.0)}}
    scene = scene.with_world(more=scene.world.more | blown)
    sim = Simulation(scene, "rk4", substeps=10, topology="graph", execution="serial")
    sim.advance(30)
    g, u, t = 9.81, np.sqrt(2 * 0.15 * 9.81 / (1.2 * 1.1)), 0.3
    now = np.tanh(g * t / u)
    v = wind - u * (wind + u * now) / (u + wind * now)
    fallen = np.log(np.cosh(g * t / u) + wind / u * np.sinh(g * t / u)) * u**2 / g - wind * t
    ways = sim.positions() - scene.particles.position
    np.testing.assert_allclose(ways, np.tile([0.0, -fallen, 0.0], (len(ways), 1)), atol=1e-9)
    assert np.ptp(ways, axis=0).max() < 1e-12
    np.testing.assert_allclose(sim.velocities()[:, 1], v, rtol=1e-8)


def test_air_takes_energy_and_presses_on_plates_at_an_angle():
    rng, world = np.random.default_rng(0), sheet().world
    area, v = rng.normal(size=(2, 50, 3))
    assert ((air.twin(area, v, 0.0, world) * v).sum(axis=1) < 0).all()
    a = np.linspace(0.0, np.pi / 2, 7)
    plates = 0.3 * np.column_stack([0 * a, np.cos(a), -np.sin(a)])  # turned about x
    found = air.twin(plates, np.tile([0.0, 0.0, 2.0], (7, 1)), 0.0, world)
    size = 0.5 * 1.2 * 0.3 * 4.0 * np.sin(a) * (1.1 * np.sin(a) + 0.6 * np.cos(a) ** 2)
    expected = size[:, None] * plates / 0.3  # they move along z: the air presses back
    np.testing.assert_allclose(found, expected, atol=1e-15)
    for degenerate in (0 * area, area):
        assert np.isfinite(air.twin(degenerate, 0 * v, 0.0, world)).all()


def test_bounds_hold_for_every_triangle_in_every_wind():
    rng, world = np.random.default_rng(1), flag().world
    x, v = rng.normal(size=(2, 300, 3))
    triangles, h = np.arange(300).reshape(-1, 3), 1e-6
    corners = x[triangles]
    third = np.full((100, 3), 1 / 3)
    mean = tractions.mean_velocities(v, triangles, third)
    k, c = air.bound(corners, mean, world)
    by_v, by_x = np.zeros((100, 3, 3)), np.zeros((100, 3, 3))
    for time in (0.0, 0.03, 0.71):
        for axis in range(3):
            way = h * np.eye(3)[axis]
            for of, sign in ((by_v, 1), (by_x, 1)):
                pair = []
                for s in (sign, -sign):
                    there = corners.copy()
                    there[:, 1] += s * way if of is by_x else 0.0
                    area = area_vectors(there.reshape(-1, 3), triangles)
                    at = mean + (s * way if of is by_v else 0.0)
                    pair.append(air.twin(area, at, time, world))
                of[:, :, axis] = (pair[0] - pair[1]) / (2 * h)
        assert (np.linalg.norm(by_v, 2, axis=(1, 2)) <= c * (1 + 1e-6)).all()
        assert (np.linalg.norm(by_x, 2, axis=(1, 2)) <= k * (1 + 1e-6)).all()


@pytest.mark.parametrize(("drag", "lift"), [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
def test_bounds_of_particles_hold_for_the_whole_matrices_of_triangles_and_are_close(drag, lift):
    """Diagonals, and no matrix of a triangle's nine coordinates is more beside them than 1."""
    rng, count = np.random.default_rng(2), 500
    more = {"air": {"density": 30.0, "drag": drag, "lift": lift}, "wind": {"velocity": (2.0, 0, 1)}}
    world = World((40.0,) * 3, gravity=(0.0,) * 3, dt=0.1, up="y", more=more)
    x, v = rng.normal(size=(2, 3 * count, 3))
    v = np.repeat(v[:count], 3, axis=0) * 4.0
    triangles = np.arange(3 * count).reshape(-1, 3)
    shares, h = corner_shares(x, triangles), 1e-5
    bounds = tractions.bounds(x, v, world, triangles, shares)
    nearest = []
    for by_velocity, bound in zip((False, True), bounds, strict=True):
        columns = []
        for unit in np.eye(9).reshape(9, 3, 3):
            way, pair = h * np.tile(unit, (count, 1)), []
            for sign in (1, -1):
                to = (x, v + sign * way) if by_velocity else (x + sign * way, v)
                pair.append(tractions.forces_on_particles(*to, 0.0, world, triangles, shares))
            columns.append(((pair[1] - pair[0]) / (2 * h)).reshape(count, 9))
        scale = np.repeat(bound.reshape(count, 3), 3, axis=1) ** -0.5
        matrices = scale[:, :, None] * np.stack(columns, axis=2) * scale[:, None, :]
        nearest.append(np.linalg.norm(matrices, 2, axis=(1, 2)).max())
    assert max(nearest) <= 1 + 1e-6 and nearest[0] > 0.3 * drag and nearest[1] > 0.6


def test_gusts_are_of_their_size_seeded_and_smooth():
    world = flag().world
    t = np.linspace(0, 40, 20001)
    g = np.array([air.gust(world, time) for time in t])
    assert np.sqrt((g**2).mean()) == pytest.approx(0.3, rel=0.01) and abs(g.mean()) < 3e-3
    assert np.abs(g).max() <= 0.3 * air.PEAK == pytest.approx(air.strongest(world) - 1)
    assert np.abs(np.diff(g)).max() < 0.3 * air.PEAK * 2 * np.pi * 1.2 / 0.1 * 0.002
    other = flag(more=world.more | {"wind": {**world.more["wind"], "seed": 2.0}}).world
    assert air.gust(other, 0.5) != air.gust(world, 0.5)


def sinking(stretch):
    """The sheet in water, without dashpots, at its terminal velocity: flat, and steadily so."""
    density = 769.0
    speed = np.sqrt(2 * 0.15 * 9.81 / (density * 1.1))
    scene = sheet(stretch, air={"density": density, "drag": 1.1, "lift": 0.6})
    particles, springs = scene.particles, scene.springs
    noise = np.random.default_rng(0).normal(0, 1e-9, particles.position.shape)
    return replace(
        scene,
        particles=replace(particles, velocity=noise + (0.0, -speed, 0.0)),
        springs=replace(springs, damping=np.zeros(len(springs))),
    )


@pytest.mark.parametrize(
    "method", mostly_thorough(["symplectic_euler", "verlet", "rk4"], default=["symplectic_euler"])
)
def test_the_limit_counts_the_air(falling, method):
    """A step at 0.98 of the limit holds, one at 1.05 does not, whether springs or air set it."""
    module, sim = methods.load(method), falling
    if method != "symplectic_euler":
        sim = Simulation(sheet(), method, topology="graph", execution="serial")
    # Drag shortens the steps of verlet more.
    soft, stiff = (8.0, 600.0) if method == "verlet" else (8.0, 60.0)
    for stretch in (soft, stiff):
        scene = sinking(stretch)
        network = Network.from_scene(scene)
        limit = stable_step(module, network).dt
        still = stable_step(module, Network.from_scene(scene.with_world(more={}))).dt
        assert limit < 0.7 * still if stretch == soft else limit == pytest.approx(still, rel=0.1)
        for bounds in (gershgorin, any_geometry):
            assert 0.2 * limit < step_within(module, bounds(network)) <= limit * (1 + 1e-9)
        for part, holds in ((0.98, True), (1.05, False)):
            sim.load_scene(scene, dt=part * limit * 600, substeps=600)
            try:
                sim.advance()
                change = np.abs(sim.velocities() - scene.particles.velocity).max()
            except SimulationFailure:
                change = np.inf
            assert (change < 1e-6) == holds, (stretch, part, change)


def test_a_light_sheet_in_a_storm_has_the_limit_of_its_drag(falling):
    """It hovers on a wind of 100 m/s that carries its weight, and is disturbed as a whole.

    So it stays flat, and its flutter, which is physics and grows faster, begins with rounding.
    """
    scene, speed, density, small = sheet(), 100.0, 0.02, 1e-6
    particles = scene.particles
    weight = 1.2 * 1.1 * speed**2 / (2 * density)
    wind = {"wind": {"velocity": (0.0, speed, 0.0)}}
    scene = replace(
        scene.with_world(gravity=(0.0, -weight, 0.0), more=scene.world.more | wind),
        particles=replace(
            particles,
            mass=particles.mass * density / 0.15,
            velocity=np.tile([0.0, small, 0.0], (len(particles), 1)),
        ),
    )
    module, network = methods.load("symplectic_euler"), Network.from_scene(scene)
    limit, rate = stable_step(module, network), 1.2 * 1.1 * speed / density
    assert limit.dt == pytest.approx(2 / rate, rel=1e-6) and "drag" in limit.describe()
    assert experiment.drag_of_wind(scene) / scene.particles.mass == pytest.approx(
        rate * (1.1 + 0.3) / 1.1, rel=1e-9
    )
    for part, factor in ((0.98, 0.96**40), (1.05, 1.1**40)):
        falling.load_scene(scene, dt=part * limit.dt * 40, substeps=40)
        falling.advance()
        assert falling.velocities()[:, 1].mean() / small == pytest.approx(factor, rel=0.02)


@pytest.mark.thorough
@pytest.mark.parametrize("method", methods.METHODS)
def test_every_method_keeps_its_order_in_gusts(method, device):
    scene, times = scenefile.parse(FLAG), np.linspace(0, 0.1, 6)
    exact = ode.solve(scene, times)
    assert exact.until == times[-1]
    claims = methods.load(method).claims
    settings = {"tolerance": 1e-13, "iterations": 400}
    given = {name: settings[name] for name in claims.settings}
    sim = Simulation(scene, method, topology="graph", execution="serial", **given)
    errors = []
    for substeps in (8, 16, 32):
        sim.load_scene(scene, substeps=substeps)
        sim.advance(10)
        errors.append(np.abs(sim.positions() - exact.x[-1]).max())
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.abs(orders - claims.order).max() < 0.1 and sim.work().unconverged == 0


@pytest.mark.parametrize("method", mostly_thorough(["vbd", "xpbd"], ["vbd"]))
def test_sweeps_in_gusts_end_at_backward_eulers_steps(method, device):
    """Forces on triangles follow the sweeps, and what bounds them meanwhile is gone at the end."""
    ends = []
    for name, solver in ((method, {"iterations": 400}), ("implicit_euler", {"tolerance": 1e-13})):
        sim = Simulation(flag(), name, substeps=2, topology="graph", execution="serial", **solver)
        sim.advance()
        ends.append((sim.positions(), sim.velocities()))
    for found, exact in zip(*ends, strict=True):
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-11)


def streaming(columns=16):
    """A flag in wind of 10 m/s with gusts, in frames of a sixtieth of a second."""
    scene = library.build("flag", columns=columns, wind=10.0)
    return replace(scene, obstacles=())


IMPLICIT = ("implicit_euler", "implicit_midpoint", "tr_bdf2")


@pytest.mark.thorough
@pytest.mark.parametrize("method", IMPLICIT)
def test_every_implicit_step_converges_in_strong_wind(method, device):
    scene = streaming()
    sim = Simulation(scene, method, topology="graph", execution="serial")
    sim.advance(30)
    work = sim.work()
    assert work.unconverged == 0 and work.force_evaluations < 20 * work.steps
    assert np.abs(sim.velocities()).max() < 100.0


@ti.func
def while_it_may(spec: ti.template(), state: ti.template()):
    return newton_cg._may_be_cut(spec, state)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("method", "name"),
    [*((method, "flag") for method in IMPLICIT), ("implicit_euler", "cloth"), ("tr_bdf2", "cloth")],
)
def test_a_step_that_is_cut_is_the_methods_own_shorter_steps(method, name, device, monkeypatch):
    """At the times of these, in gusts; with one count of steps."""
    scene = flag()
    if name == "cloth":  # without air
        scene = library.build("cloth", columns=8, rows=8)
        scene = scene.with_world(mouse="none", walls=(), dt=4.0)
    sim = Simulation(scene, method, topology="graph", execution="serial", tolerance=1e-12)
    sim.load_scene(scene, substeps=4)
    sim.advance(3)
    monkeypatch.setattr(newton_cg, "_is_cut_soon", while_it_may)
    monkeypatch.setattr(newton_cg, "MOST_BEFORE_CUT", 0)
    monkeypatch.setattr(newton_cg, "MOST_HALVINGS", 2)
    cut = Simulation(scene, method, topology="graph", execution="serial", tolerance=1e-12)
    cut.advance(3)
    moved = np.abs(sim.positions() - scene.particles.position).max()
    np.testing.assert_allclose(cut.positions(), sim.positions(), rtol=0, atol=1e-9 * moved)
    assert cut.work().steps == 3 and cut.work().unconverged == 0
    assert cut.work().force_evaluations > sim.work().force_evaluations


@ti.func
def once_and_then_the_second_half(spec: ti.template(), state: ti.template()):
    return state.halvings[None] < 1 or (state.halvings[None] == 1 and state.parts_done[None] == 1)


@thorough
def test_a_step_whose_second_half_is_cut_takes_no_longer(device, monkeypatch):
    """A half and two quarters: a body in free fall has the speed of the whole step at its end, and
    falls by each part's length times the speed at that part's end.
    """
    for name in ("_is_cut_soon", "_may_be_cut"):
        monkeypatch.setattr(newton_cg, name, once_and_then_the_second_half)
    monkeypatch.setattr(newton_cg, "MOST_BEFORE_CUT", 0)
    world = World((400.0, 200.0), gravity=(0.0, 0.3))
    body = Particles.build([[50.0, 50.0]], mass=2.0)
    sim = Simulation(
        Scene("body", world, body), "implicit_euler", 2.0, topology="graph", execution="serial"
    )
    sim.advance()
    np.testing.assert_allclose(sim.velocities(), [[0.0, 0.6]], rtol=1e-9)
    fallen = 1.0 * 0.3 + 0.5 * 0.45 + 0.5 * 0.6
    np.testing.assert_allclose(sim.positions(), [[50.0, 50.0 + fallen]], rtol=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize("method", ["symplectic_euler", "rk4", "vbd"])
def test_air_is_the_same_on_both_topologies_and_all_threads(method, device):
    ends = []
    for topology, execution in (("graph", "serial"), ("lanes", "parallel"), ("graph", "parallel")):
        how = {"topology": topology, "execution": execution, "lanes": 2}
        sim = Simulation(flag(), method, substeps=4, **how)
        sim.advance(20)
        ends.append(sim.positions())
    np.testing.assert_array_equal(ends[0], ends[2])
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-10)


def test_tables_of_world_are_read_written_assigned_and_refused():
    scene = scenefile.parse(FLAG)
    assert scene.world.more["wind"] == {
        "velocity": (1.0, 0.5, 4.0), "gust": 0.3, "period": 0.1, "seed": 1.0
    }  # fmt: skip
    assert scenefile.parse(scenefile.dump(scene)).world == scene.world
    other = assignments.read("world.wind.velocity=[3,0,1]"), assignments.read("world.air.drag=2")
    changed = scenefile.parse(FLAG, assignments=other).world.more
    assert changed["wind"]["velocity"] == (3, 0, 1) and changed["wind"]["gust"] == 0.3
    assert changed["air"]["drag"] == 2 and forces.load("air").present(scene)
    table = "[world.air]\ndensity = 1.2\ndrag = 1.1\nlift = 0.6\n[[cloths]]"
    header = FLAG.replace("air = {", "#").replace("[[cloths]]", table)
    assert scenefile.parse(header).world == scene.world
    for old, new, says in (
        ("density = 1.2, ", "", "line 7: .*'density' is missing"),
        ("gust", "gusts", "line 8: .*unknown key 'gusts'; did you mean 'gust'"),
        ("seed = 1", "seed = 1.5", "line 8: .*seed must be a whole number"),
        ("drag = 1.1", "drag = -1.0", "line 7: .*drag must be at least 0"),
        ("[1.0, 0.5, 4.0]", "[1.0, 0.5]", "line 8: .*must have 3 numbers"),
        ("period = 0.1", "period = 0.0", "line 8: .*period must be at least"),
        ("air = {", "# air = {", "line 8: .*wind does nothing without air"),
        ("{ density = 1.2, drag = 1.1, lift = 0.6 }", "1.2", "line 7: .*air must be a table"),
    ):
        with pytest.raises(InputError, match=says):
            scenefile.parse(FLAG.replace(old, new))


def test_wind_is_set_while_a_scene_runs(falling):
    falling.load_scene(sheet())
    falling.set(wind={"velocity": (0.0, 3.0, 0.0)}, air={"drag": 2.0})
    force = falling.forces()[:, 1].sum()
    weight = -0.15 * 9.81 * 0.09
    assert force == pytest.approx(weight + 0.5 * 1.2 * 2.0 * 9.0 * 0.09, rel=1e-12)
    with pytest.raises(InputError, match=r"set: wind: unknown key 'speed'"):
        falling.set(wind={"speed": 1.0})


def test_the_series_of_a_sine_is_one(device, monkeypatch):
    """To rounding of the angle in turns: for backends that have no sine of f64."""
    monkeypatch.setattr(sine, "has_sine", lambda: False)
    angles = np.linspace(-50.0, 900.0, 501)
    found = np.zeros((2, 501))

    @kernel
    def compute(angles: ti.types.ndarray(), found: ti.types.ndarray()):
        for k in range(angles.shape[0]):
            found[0, k], found[1, k] = sine.sine_and_cosine(ti.f64, angles[k])

    compute(angles, found)
    np.testing.assert_allclose(found, [np.sin(angles), np.cos(angles)], rtol=0, atol=1e-12)
