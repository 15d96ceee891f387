"""Lanes and graph: where particles and springs are stored, and that it makes no difference."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import taichi as ti
from conftest import command
from hypothesis import given, settings
from hypothesis import strategies as st

from taichi_cloth.kernels import laws
from taichi_cloth.kernels.loops import add_up, each_pack_moving
from taichi_cloth.kernels.packs import (
    dot,
    link_offset,
    pitch_of,
    read,
    scaled,
    set_slot_value,
    slot_value,
    write,
)
from taichi_cloth.kernels.springs import (
    accumulate,
    force_between,
    link_stiffness,
    link_value,
    number,
)
from taichi_cloth.scene.cloth import grid
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import (
    ParticleDefaults,
    Particles,
    Scene,
    SpringDefaults,
    Springs,
    World,
)
from taichi_cloth.simulation import adjacency, autotune, layouts, storage
from taichi_cloth.simulation.frame_timer import FrameTimer
from taichi_cloth.simulation.launch import Launcher
from taichi_cloth.simulation.simulation import Simulation

LINKS = ("structural", "shear", "bend")


# --- layout ----------------------------------------------------------------------------------


@st.composite
def particles_and_springs(draw):
    """(particle count, springs, grids, springs made by grids) of cloths among loose particles."""
    count, between, stiffness, grids = 0, [np.zeros((0, 2), int)], [], []
    for k in range(draw(st.integers(1, 2))):
        count += draw(st.integers(0, 3))  # loose particles before it
        links = LINKS[: draw(st.integers(1, 3))]
        columns, rows = draw(st.integers(2, 40)), draw(st.integers(2, 20))
        springs = grid((0.0, 0.0), columns, rows, 1.0, links=links)[1]
        between.append(springs.between + count)
        stiffness.append(np.full(len(springs), 1.0 + k))
        grids.append(adjacency.Grid(count, columns, rows))
        count += columns * rows
    count += draw(st.integers(0, 3))
    between, stiffness = np.concatenate(between), np.concatenate(stiffness)
    made = Springs.build(between, np.zeros((count, 2)), stiffness=stiffness, rest_length=1.0)
    return count, made, grids


@st.composite
def edits(draw, springs, count):
    """The same springs with some removed, and others added, in any order."""
    some = st.lists(st.integers(0, len(springs) - 1), max_size=4)
    kept = np.setdiff1d(np.arange(len(springs)), draw(some))
    pairs = {tuple(sorted(pair)) for pair in springs.between[kept].tolist()}
    end = st.integers(0, count - 1)
    more = [(a, b) for a, b in draw(st.lists(st.tuples(end, end), max_size=4)) if a != b]
    more = [pair for pair in {tuple(sorted(pair)) for pair in more} if pair not in pairs]
    extra = Springs.build(np.reshape(more, (-1, 2)).astype(int), np.zeros((count, 2)))
    edited = springs.select(kept).joined(extra)
    order = np.random.default_rng(draw(st.integers(0, 9))).permutation(len(edited))
    return edited.select(order)


def check(stored, count, springs):
    """A layout holds together: one site a particle; each link leads from end to end."""
    assert len(np.unique(stored.slot)) == len(stored.slot) == count
    lanes, halo = stored.lanes, 0
    if lanes > 1:
        halo = max(abs(column) for column, _ in stored.links)
    depth = max(row for _, row in stored.links)
    in_use = np.zeros(stored.n_packs, int)  # 1: cells of rows; 2: their halos and empty rows
    home, linked = np.full(stored.n_packs, -1), np.full(stored.n_packs, -1)
    for g, (first, rows, width, has_links) in enumerate(stored.grid):
        pitch, empty = width + 2 * halo, depth * has_links
        assert width >= halo and pitch <= stored.row
        begin, end = first - halo - empty * pitch, first - halo + (rows + empty) * pitch
        assert begin >= 0 and end <= stored.n_packs and not in_use[begin:end].any()
        in_use[begin:end] = 2
        cells = (first + np.arange(rows)[:, None] * pitch + np.arange(width)).ravel()
        in_use[cells], home[cells] = 1, g
        if has_links:
            linked[cells] = g
    cell, lane = np.divmod(stored.slot, lanes)
    assert (home[cell] >= 0).all()
    np.testing.assert_array_equal(stored.grid_of, linked)

    low, high = springs.between.min(axis=1), springs.between.max(axis=1)
    links = np.flatnonzero(stored.kind >= 0)
    np.testing.assert_array_equal(stored.owner[links], stored.slot[low[links]])
    first, _, width, _ = stored.grid[home[cell[low[links]]]].T
    column, row = np.array(stored.links)[stored.kind[links]].T
    far = cell[low[links]] + column + row * (width + 2 * halo)
    place = (far - first + halo) % (width + 2 * halo) - halo
    if lanes > 1:  # a halo cell repeats the row's other end, one lane on
        strip = np.where(place < 0, -1, np.where(place >= width, 1, 0))
        far = far - strip * width
        np.testing.assert_array_equal(lane[high[links]], lane[low[links]] + strip)
    np.testing.assert_array_equal(cell[high[links]], far)


@settings(max_examples=150, deadline=None)
@given(st.data(), particles_and_springs(), st.sampled_from([1, 2, 4, 8]))
def test_every_particle_has_a_site_and_every_link_leads_to_its_far_end(data, made, lanes):
    count, springs, grids = made
    assert adjacency.find_grids(springs.between, count) == grids
    stored = layouts.on_grids(springs, count, lanes)
    check(stored, count, springs)
    assert (stored.kind >= 0).all(), "all springs of whole grids are links"

    springs = data.draw(edits(springs, count))
    stored = layouts.on_grids(springs, count, lanes)
    found = adjacency.find_grids(springs.between, count)
    assert (stored is None) == (not found)
    if found:
        check(stored, count, springs)
        inside = np.zeros(count, int)
        for k, of in enumerate(found, 1):
            inside[of.first : of.first + of.rows * of.columns] = k
        assert (inside[springs.between[stored.kind >= 0]] > 0).all()


@pytest.mark.parametrize("odd", [0, 5])
def test_a_spring_that_differs_from_most_leaves_them_in_lanes(odd):
    springs = build("cloth", columns=9, rows=7).springs
    rest_length = springs.rest_length.copy()
    rest_length[odd] *= 1.5
    kind = layouts.on_grids(replace(springs, rest_length=rest_length), 63, 4).kind
    assert np.flatnonzero(kind < 0).tolist() == [odd]


def test_what_forms_no_grid_has_no_lanes():
    scenes = [build(name) for name in ("box", "chain", "oscillator", "sandbox", "slinky")]
    scenes += [build("cloth", columns=1, rows=5), build("cloth", columns=5, rows=1)]
    for scene in scenes:
        assert layouts.on_grids(scene.springs, len(scene.particles), 4) is None, scene.name
    cloth = build("cloth", columns=5, rows=4)
    shuffled = np.random.default_rng(0).permutation(20)[cloth.springs.between]
    assert layouts.on_grids(replace(cloth.springs, between=shuffled), 20, 4) is None
    wheel = np.array([[0, k] for k in range(1, 6)])
    assert adjacency.find_grids(wheel, 6) == []
    # A grid of springs none of which has both the usual rest length and the usual damping.
    odd = np.arange(1.0, 1 + len(cloth.springs))
    unlike = replace(cloth.springs, rest_length=odd, damping=7 * odd % 31)
    assert layouts.on_grids(unlike, 20, 4) is None


# --- the same motion -------------------------------------------------------------------------

SIDES = ("left", "right", "top", "bottom", "front", "back")


def cloth(
    columns,
    rows,
    links=("structural",),
    dim=2,
    *,
    walls=(),
    drag=0.0,
    damping=0.0,
    break_force=None,
    own_numbers=False,
    speed=2.0,
    **world,
):
    """A crumpled cloth that flies about. own_numbers: other stiffness and so on for each kind."""
    kinds = {kind: 1.0 + 0.3 * k * own_numbers for k, kind in enumerate(links)}
    particles, springs = grid(
        (100.0, 100.0, 0.0)[:dim],
        columns,
        rows,
        20.0,
        links=links,
        pinned=[(0, 0), (columns - 1, rows // 2)],
        particle_defaults=ParticleDefaults(mass=1.5, radius=4.0, viscous=drag, restitution=0.6),
        stiffness={kind: 0.2 * factor for kind, factor in kinds.items()},
        damping={kind: damping * factor for kind, factor in kinds.items()},
        rest_length={kind: 20.0 for kind in kinds},
        break_force={kind: break_force and break_force * factor for kind, factor in kinds.items()},
    )
    rng = np.random.default_rng(columns * rows)
    particles.position[:] += rng.uniform(-4, 4, particles.position.shape)
    particles.velocity[:] += rng.normal(0, speed, particles.position.shape)
    size = (200.0 + 20.0 * columns, 200.0 + 20.0 * rows, 60.0)[:dim]
    return Scene(
        "cloth",
        World(size, gravity=(0.01, 0.05, 0.02)[:dim], walls=walls, **world),
        particles,
        springs,
        particle_defaults=ParticleDefaults(viscous=drag),
        spring_defaults=SpringDefaults(stiffness=0.1, damping=damping, break_force=break_force),
    )


def motion(scene, *, frames=30, lanes=2, act=None, **how):
    """Positions, velocities and whole springs after some frames; act(sim) half way."""
    sim = Simulation(scene, lanes=lanes, **{"execution": "serial", **how})
    sim.advance(frames // 2)
    if act:
        act(sim)
    sim.advance(frames // 2)
    return sim.positions(), sim.velocities(), sim.springs_alive()


def assert_same(one, other, tolerance=0.0):
    """Two results of `motion` are equal: to the last bit, unless a tolerance is given."""
    np.testing.assert_array_equal(one[2], other[2])
    for a, b in zip(one[:2], other[:2], strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


GRIDS = {
    "plain": (cloth(9, 7), {"lanes": 4}),
    "torn between walls": (cloth(11, 9, walls=SIDES[:4], drag=0.02, break_force=2.0), {"lanes": 4}),
    "lanes of one column": (
        cloth(3, 8, LINKS[:2], 3, damping=0.05, own_numbers=True),
        {"lanes": 4},
    ),
    "sheared, torn, in space": (
        cloth(13, 8, LINKS[:2], 3, walls=SIDES, damping=0.03, break_force=1.5, own_numbers=True),
        {"execution": "parallel"},
    ),
    "bent, on the floor": (
        cloth(8, 11, LINKS, walls=("bottom",), drag=0.01, damping=0.02, break_force=1.0),
        {"execution": "parallel"},
    ),
    "bent, narrow": (cloth(4, 5, ("structural", "bend"), 3, drag=0.1, break_force=1.5), {}),
    "all links": (cloth(7, 6, LINKS, 3, damping=0.1, break_force=2.0), {"lanes": 4}),
    "eight lanes": (cloth(21, 5, LINKS[:2], walls=SIDES[:2], own_numbers=True), {"lanes": 8}),
    "one lane, as on GPUs": (
        cloth(6, 7, LINKS, walls=SIDES[:4], damping=0.02, break_force=1.0, own_numbers=True),
        {"lanes": 1, "execution": "parallel"},
    ),
    "explicit": (
        cloth(10, 6, LINKS[:2], walls=("bottom",), drag=0.1, damping=0.1),
        {"method": "explicit_euler", "substeps": 8},
    ),
    "kept acceleration": (
        cloth(10, 5, LINKS[:2], 3, walls=SIDES, drag=0.02, damping=0.05, break_force=2.0),
        {"method": "verlet", "execution": "parallel"},
    ),
    "four stages": (
        cloth(9, 6, LINKS[:2], walls=SIDES[:4], drag=0.02, damping=0.05, break_force=2.0),
        {"method": "rk4", "execution": "parallel", "lanes": 4},
    ),
    "spring by spring": (
        cloth(11, 7, LINKS, 3, walls=SIDES, drag=0.02, damping=0.05, break_force=2.0),
        {"method": "xpbd", "execution": "parallel"},
    ),
    "spring by spring, one lane": (
        cloth(9, 6, LINKS[:2], walls=SIDES[:4], drag=0.02, own_numbers=True),
        {"method": "xpbd", "lanes": 1, "iterations": 1, "execution": "parallel"},
    ),
    "particle by particle": (
        cloth(11, 7, LINKS, 3, walls=SIDES, drag=0.02, damping=0.05, break_force=2.0),
        {"method": "vbd", "execution": "parallel"},
    ),
    "particle by particle, one lane": (
        cloth(9, 6, walls=SIDES[:4], drag=0.02, own_numbers=True),
        {"method": "vbd", "lanes": 1, "iterations": 3, "execution": "parallel"},
    ),
    "two columns": (cloth(2, 9, LINKS, walls=SIDES[:4], damping=0.02, break_force=1.0), {}),
    "smallest": (cloth(2, 2, walls=SIDES[:4], break_force=1.0, speed=4.0), {"lanes": 8}),
}


@pytest.mark.parametrize("name", GRIDS)
def test_a_whole_grid_moves_the_same_to_the_last_bit(name, device):
    scene, how = GRIDS[name]
    on_grid = motion(scene, topology="lanes", **how)
    assert_same(on_grid, motion(scene, topology="graph", **how))
    if np.isfinite(scene.springs.break_force).any():
        assert on_grid[2].any() and not on_grid[2].all()


def joined(*parts):
    """Particles and springs of several (particles, springs)."""
    particles, springs = parts[0]
    for more, ties in parts[1:]:
        ties = replace(ties, between=ties.between + len(particles))
        particles, springs = particles.joined(more), springs.joined(ties)
    return particles, springs


def mixed(dim=3, **options):
    """Two cloths, one hanging from the other by a chain of particles that are on no grid."""
    defaults = {"drag": 0.01, "damping": 0.02, "break_force": 1.5, "walls": SIDES[: 2 * dim]}
    one = cloth(9, 6, LINKS[:2], dim, own_numbers=True, **(defaults | options))
    two = cloth(5, 9, ("structural", "bend"), dim, **(defaults | options))
    limit = one.spring_defaults.break_force
    chain = Particles.build(np.full((5, dim), 10.0) + 4.0 * np.arange(5)[:, None], radius=4.0)
    between = np.array([[0, 1], [1, 2], [2, 3], [3, 4]])
    ties = Springs.build(between, chain.position, stiffness=0.3, break_force=limit and 2 * limit)
    particles, springs = joined(
        (two.particles, two.springs), (chain, ties), (one.particles, one.springs)
    )
    n = len(two.particles)
    ends = np.array([[n - 1, n], [n + 4, n + 5], [3, n + 20], [0, n - 1]])
    damping = 3 * one.spring_defaults.damping
    ties = Springs.build(
        ends, particles.position, stiffness=0.2, damping=damping, break_force=limit and 3 * limit
    )
    return replace(one, particles=particles, springs=springs.joined(ties))


@pytest.mark.parametrize(
    ("scene", "how"),
    [
        (mixed(), {}),
        (mixed(2), {"execution": "parallel", "lanes": 2}),
        (mixed(2, collisions=True), {"execution": "parallel"}),
        (mixed(collisions=True), {"lanes": 1}),
    ],
)
def test_cloths_tied_to_each_other_and_to_particles_move_the_same(scene, how, device):
    on_grids = motion(scene, topology="lanes", **how)
    assert_same(on_grids, motion(scene, topology="graph"), 1e-9)
    assert on_grids[2].any() and not on_grids[2].all()


def test_springs_unlike_the_others_of_their_kind_are_on_the_graph(device):
    """Others in any number but stiffness, of no stiffness, or between no neighbours."""
    scene = cloth(8, 6, LINKS[:2], walls=SIDES[:4], damping=0.02, break_force=2.0)
    springs = scene.springs
    springs.stiffness[[40, 20]] = 0.4, 0.0
    springs.rest_length[31] = 25.0
    springs.damping[44] = 0.3
    springs.break_force[52] = 0.5
    far = Springs.build([[0, 47], [3, 30]], scene.particles.position, stiffness=0.1)
    scene = replace(scene, springs=springs.joined(far))
    stored = layouts.on_grids(scene.springs, 48, 4)
    s = len(scene.springs)
    # A break force over a stiffness is a length, and links of a kind share it: 40 differs there.
    assert np.flatnonzero(stored.kind < 0).tolist() == [20, 31, 40, 44, 52, s - 2, s - 1]
    assert_same(motion(scene, topology="lanes"), motion(scene, topology="graph"), 1e-9)

    stiffer = cloth(8, 6)
    stiffer.springs.stiffness[::3] = 0.4  # a link's own, without a break force
    assert (layouts.on_grids(stiffer.springs, 48, 4).kind >= 0).all()
    assert_same(motion(stiffer, topology="lanes"), motion(stiffer, topology="graph"))


@pytest.mark.parametrize("how", [{}, {"execution": "parallel", "lanes": 1}])
def test_what_is_spawned_beside_a_cloth_moves_the_same(how, device):
    def spawn(sim):
        """Free, fixed and tied ones, more than there is room for; the last breaks a row's end."""
        for k in range(4):
            free = sim.spawn((30.0, 40.0 + 20 * k), (5.0, 1.0), fixed=k == 3)
        sim.spawn((50.0, 50.0), tied_to=free)
        sim.spawn((150.0, 300.0), tied_to=20)
        sim.advance(3)
        sim.spawn((250.0, 300.0), tied_to=34)

    scene = cloth(7, 5, LINKS[:2], walls=SIDES[:4], damping=0.02, break_force=3.0, mouse="spawn")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(storage, "SPAWN_CAPACITY", 3)
        on_grid = motion(scene, topology="lanes", act=spawn, **how)
        assert_same(on_grid, motion(scene, topology="graph", act=spawn), 1e-9)


def test_a_spawned_tie_may_end_the_last_grid(device):
    """Tied to the last particle, a new one makes the row longer: a cloth of two rows is no grid."""

    def spawn(sim):
        sim.spawn((150.0, 200.0), tied_to=7)

    scene = cloth(4, 2, mouse="spawn")
    on_grid = motion(scene, topology="lanes", act=spawn)
    assert_same(on_grid, motion(scene, topology="graph", act=spawn), 1e-9)


def test_dashpots_have_no_race(topology, device):
    """A force reads velocities that no thread may have changed: parallel is serial, to the bit."""
    scene = cloth(5, 150, LINKS[:2], damping=0.1, break_force=2.0)
    serial = motion(scene, topology=topology)
    sim = Simulation(scene, topology=topology, execution="parallel")
    for _ in range(5):
        sim.reset()
        sim.advance(30)
        assert_same((sim.positions(), sim.velocities(), sim.springs_alive()), serial)


def test_the_order_of_particles_does_not_matter(topology, device):
    """The same cloth numbered from its other end is again a grid, and moves the same."""
    scene = cloth(6, 9, LINKS, damping=0.1, drag=0.01, walls=SIDES[:4])
    backwards = Particles(**{name: values[::-1] for name, values in vars(scene.particles).items()})
    springs = replace(scene.springs, between=53 - scene.springs.between)
    x, v, _ = motion(replace(scene, particles=backwards, springs=springs), topology=topology)
    expected = motion(scene, topology=topology)
    np.testing.assert_allclose(x[::-1], expected[0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(v[::-1], expected[1], rtol=0, atol=1e-9)


# Two cloths, one of them with all kinds of links, tied to each other by springs on the graph.
TWO_CLOTHS = """
[world]
size = [600.0, 500.0]
gravity = [0.0, 0.05]
walls = true
collisions = COLLISIONS
[particle]
viscous = 0.02
radius = 4.0
[spring]
stiffness = 0.3
damping = 0.1
break_force = 1.2
[[cloths]]
origin = [50.0, 30.0]
columns = 23
rows = 17
spacing = 20.0
pinned = [[0, 0], [22, 0]]
[[cloths]]
origin = [60.0, 400.0]
columns = 14
rows = 5
spacing = 15.0
links = ["structural", "shear", "bend"]
[[springs]]
between = [380, 395]
[[springs]]
between = [385, 400]
"""


@pytest.mark.parametrize(
    ("precision", "collisions", "threads"),
    [("f32", "false", (1, 2, 2, 3)), ("f64", "true", (1, 3))],
)
def test_lanes_have_the_same_bits_for_every_thread_count_and_on_every_run(
    precision, collisions, threads, tmp_path
):
    (tmp_path / "two.toml").write_text(TWO_CLOTHS.replace("COLLISIONS", collisions))
    runs = []
    for k, count in enumerate(threads):
        path = tmp_path / f"{k}.npz"
        how = ("--topology", "lanes", "--execution", "parallel", "--precision", precision)
        how += ("--threads", count, "--frames", 90, "--every", 30, "--headless")
        command("run", tmp_path / "two.toml", *how, "--save", path)
        with np.load(path) as file:
            runs.append(dict(file))
    assert not runs[0]["spring_alive"][-1].all()
    for other in runs[1:]:
        for name in ("position", "velocity", "spring_alive"):
            np.testing.assert_array_equal(other[name], runs[0][name])


def test_lanes_without_a_grid_are_refused():
    out, error = command("run", "chain", "--topology", "lanes", "--headless", check=2)
    assert out == "" and error.count("\n") == 1
    assert "--topology lanes" in error and "'chain'" in error and "--topology graph" in error


# --- what methods to come are built of -------------------------------------------------------


@ti.func
def stiffness_between(
    plan: ti.template(), state: ti.template(), value: ti.template(), i, j, k, rest, c
):
    """Change of a spring's force on i where the particles move by state.u (no dashpots).

    On the graph the far end of a spring that is gone is i itself, so the length may be zero.
    """
    d = value(plan, state.x, j) - value(plan, state.x, i)
    du = value(plan, state.u, j) - value(plan, state.u, i)
    length = laws.length(d)
    along = laws.unit(d, length)
    slack = ti.select(length > 0.0, rest / length, 0.0 * length)
    return scaled(k * (1.0 - slack), du) + scaled(k * slack * dot(along, du), along)


@ti.func
def keep_sum(plan: ti.template(), state: ti.template(), c, total):
    write(plan, state.sum, c, total)


@ti.func
def add_to_sum(plan: ti.template(), state: ti.template(), site, total):
    before = slot_value(plan, state.sum, site)
    set_slot_value(plan, state.sum, site, before + total)


@ti.func
def leave(plan: ti.template(), state: ti.template(), c):
    """Nothing: each_cell renews the halos."""


@ti.kernel
def sum_springs(
    plan: ti.template(),
    state: ti.template(),
    between: ti.template(),
    u: ti.types.ndarray(),
    out: ti.types.ndarray(),
):
    """out = sum over each particle's springs of `between`, which reads state.u = u."""
    for i in range(u.shape[0]):
        u_i = ti.Vector.zero(state.real, plan.dim)
        for axis in ti.static(range(plan.dim)):
            u_i[axis] = u[i, axis]
        set_slot_value(plan, state.u, state.slot[i], u_i)
    each_pack_moving(plan, state, 0, leave)
    accumulate(plan, state, 0, between, keep_sum, add_to_sum)
    for i in range(u.shape[0]):
        sum_i = slot_value(plan, state.sum, state.slot[i])
        for axis in ti.static(range(plan.dim)):
            out[i, axis] = sum_i[axis]


def with_more_fields(sim):
    """The simulation's state with two more fields of cells, u (which neighbours read) and sum."""
    plan, state = sim.storage.specialization, sim.storage.state
    state.add_vectors(plan, "u", haloed=True)
    state.add_vectors(plan, "sum")
    return spread(plan), state


def spread(plan):
    """The plan of a kernel whose loops are parallel ones."""
    return replace(plan, spread=True)


@pytest.mark.parametrize("lanes", [4, 1])
def test_a_product_with_the_stiffness_matrix_can_be_written(lanes, device):
    scene = mixed(damping=0.0, drag=0.0, walls=(), break_force=None)
    x, v = scene.particles.position, scene.particles.velocity
    u, out = np.random.default_rng(0).normal(size=x.shape), np.empty_like(x)
    products = []
    for name in ("lanes", "graph"):
        sim = Simulation(scene, topology=name, execution="parallel", lanes=lanes)
        sum_springs(*with_more_fields(sim), stiffness_between, u, out)
        products.append(out.copy())
        forces, h = [], 1e-6
        for sign in (1, -1):
            sim.load_as(name, "parallel", x + sign * h * u, v)
            plan = spread(sim.storage.specialization)
            sum_springs(plan, sim.storage.state, force_between, u, out)
            forces.append(out.copy())
        difference = (forces[0] - forces[1]) / (2 * h)
        np.testing.assert_allclose(products[-1], difference, rtol=0, atol=1e-7)
    np.testing.assert_allclose(*products, rtol=0, atol=1e-12)


@ti.func
def energy_between(
    plan: ti.template(), state: ti.template(), value: ti.template(), i, j, k, rest, c
):
    """Elastic energy of a spring."""
    stretch = laws.length(value(plan, state.x, j) - value(plan, state.x, i)) - rest
    return 0.5 * k * stretch * stretch


@ti.func
def links_energy(plan: ti.template(), state: ti.template(), c):
    """Energy of the links of cell c to later particles: each spring once."""
    g, total = state.grid_of[c], 0.0 * read(plan, state.w, c)
    if g >= 0:
        for s in ti.static(range(plan.kinds)):
            far = c + link_offset(state, s, pitch_of(plan, state, g))
            k = link_stiffness(plan, state, s, c)
            total += link_value(plan, state, energy_between, s, g, c, far, k)
    return total


@ti.kernel
def elastic_energy(plan: ti.template(), state: ti.template()) -> ti.f64:
    """Sum over links, then over the graph's half-springs, half of each."""
    if ti.static(plan.kinds > 0):
        add_up(plan, state, 0, links_energy, 0)
    total = 0.0
    if ti.static(plan.kinds > 0):
        for _ in range(1):
            total += state.sums[0, 0]
    if ti.static(plan.springs):
        for p in range(state.n_csr_rows[None]):
            i = state.csr_slot[p]
            for h in range(state.csr_start[p], state.csr_start[p + 1]):
                k, rest = number(plan, state.csr_k, h), number(plan, state.csr_rest, h)
                j = state.csr_other[h]
                if j != i:  # else it is gone
                    total += 0.5 * energy_between(plan, state, slot_value, i, j, k, rest, 0.0)
    return total


def test_the_energy_of_springs_can_be_summed(topology, device):
    sim = Simulation(mixed(), topology=topology, execution="parallel", lanes=4)
    sim.advance(30)  # some springs are gone
    plan, state = spread(sim.storage.specialization), sim.storage.state
    state.add_sums(1)
    alive = sim.springs_alive()
    assert alive.any() and not alive.all()
    assert elastic_energy(plan, state) == pytest.approx(sim.energy().elastic, rel=1e-12)


@ti.func
def kinetic_energy_of(plan: ti.template(), state: ti.template(), c):
    w, v = read(plan, state.w, c), read(plan, state.v, c)
    return ti.select(w > 0.0, 0.5 * dot(v, v) / w, 0.0 * w)


@ti.func
def sum_kinetic_energy(plan: ti.template(), state: ti.template(), t):
    """A method that moves nothing and adds up over all cells, in the middle of a step."""
    add_up(plan, state, t, kinetic_energy_of, 0)


def test_sums_over_cells_are_the_same_on_every_way(topology, device):
    sums = []
    for path in ("serial", "parallel"):
        scene = cloth(9, 7, LINKS[:2], speed=1.0)
        sim = Simulation(scene, topology=topology, execution=path, lanes=4)
        sim.advance(3)
        sim.storage.state.add_sums(1)
        sim._launcher = Launcher(SimpleNamespace(step=sum_kinetic_energy), sim._launcher.device)
        sim.advance(1)
        sums.append(sim.storage.state.sums[0, 0])
        assert sums[-1] == pytest.approx(sim.energy().kinetic, rel=1e-13)
    assert sums[0] == sums[1]


# --- which is faster -------------------------------------------------------------------------


@pytest.fixture
def measured(device, monkeypatch, tmp_path):
    """An empty cache of measurements, and the list of what is measured, in order."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    happened, measure = [], FrameTimer.time_candidate

    def counted(timer, topology, path):
        happened.append(f"{topology} {path}")
        return measure(timer, topology, path)

    monkeypatch.setattr(FrameTimer, "time_candidate", counted)
    return happened


WAYS = [f"{t} {path}" for t in ("lanes", "graph") for path in ("serial", "parallel")]


def test_what_is_fastest_is_measured_once(measured):
    sim = Simulation(build("cloth"), substeps=64)
    (of,) = autotune.measurements()
    assert sorted(measured) == sorted(of.seconds) == sorted(WAYS)
    assert all(0 < seconds < 1 for seconds in of.seconds.values())
    chosen = of.seconds[f"{sim.topology} {sim.execution}"]
    assert chosen <= 1.1 * min(of.seconds.values())
    np.testing.assert_array_equal(sim.positions(), sim.scene.particles.position)
    assert sim.frame == 0

    measured.clear()
    again = Simulation(build("cloth"), substeps=64)
    assert (again.topology, again.execution) == (sim.topology, sim.execution)
    assert measured == []


def test_threads_are_not_tried_where_one_is_done_before_they_wake(measured, monkeypatch):
    monkeypatch.setattr(autotune, "WAKING", 1.0)
    assert Simulation(build("cloth", columns=4, rows=3)).execution == "serial"
    assert sorted(measured) == ["graph serial", "lanes serial"]


@pytest.mark.parametrize("path", ["serial", "parallel"])
def test_a_run_is_the_same_after_measuring(path, measured, monkeypatch):
    """Both paths were run in the memory that one of them then goes on with."""

    time_candidate = FrameTimer.time_candidate

    def measure(timer, topology, candidate):
        time_candidate(timer, topology, candidate)
        return 1.0 if candidate == path else 2.0

    monkeypatch.setattr(FrameTimer, "time_candidate", measure)
    scene = cloth(9, 7)
    sim = Simulation(scene, topology="lanes")
    assert sim.execution == path
    sim.advance(30)
    expected = motion(scene, topology="lanes", execution=path)
    assert_same((sim.positions(), sim.velocities(), sim.springs_alive()), expected)


def test_the_smallest_of_the_table_is_chosen_and_words_are_honoured(measured, monkeypatch):
    monkeypatch.setattr(FrameTimer, "time_candidate", lambda *_: 1.0)
    scene = build("cloth", columns=4, rows=3)
    Simulation(scene)
    table = json.loads(autotune.cache_file().read_text())
    (key,) = table
    candidates = SimpleNamespace(
        scene_name=scene.name,
        key=autotune.measurements()[0].what,
        paths=("serial", "parallel"),
        substeps=1,
        topologies=lambda: ["lanes", "graph"],
        time_candidate=None,  # not called any more
    )

    def chosen(topology, path):
        choice = autotune.choose(topology, path, candidates)
        return f"{choice.topology} {choice.execution}"

    for fastest in WAYS:
        table[key] = {way: 1.0 + (way != fastest) for way in WAYS}
        autotune.cache_file().write_text(json.dumps(table))
        topology, path = fastest.split()
        assert fastest == chosen("auto", "auto") == chosen(topology, "auto") == chosen("auto", path)
        for way in WAYS:
            assert chosen(*way.split()) == way


def test_of_ways_that_are_about_as_fast_the_simpler_is_chosen():
    seconds = {"graph parallel": 1.0, "graph serial": 1.05, "lanes parallel": 1.2}
    assert autotune.fastest(seconds) == "graph serial"
    assert autotune.fastest(seconds | {"lanes parallel": 1.09}) == "lanes parallel"


def test_a_run_whose_threads_only_wait_goes_on_with_one(topology, device, monkeypatch):
    monkeypatch.setattr(autotune.Pace, "PATIENCE", 0.0)
    scene = cloth(9, 7)
    sim = Simulation(scene, topology=topology, execution="parallel")
    sim._pace = autotune.Pace(alone=1e-12)  # nothing is as fast
    sim.advance()
    assert sim.execution == "parallel"  # the first frame compiles
    sim.advance(15)
    sim.advance(14)
    assert sim.execution == "serial"
    expected = motion(scene, topology=topology)
    assert_same((sim.positions(), sim.velocities(), sim.springs_alive()), expected)


def test_measurements_hold_for_one_machine_kind_and_size_of_scene(measured, monkeypatch):
    monkeypatch.setattr(FrameTimer, "time_candidate", lambda *_: measured.append(1) or 1.0)

    def count(scene, **asked):
        measured.clear()
        Simulation(scene, **asked)
        return len(measured)

    small = build("cloth", columns=4, rows=3)
    assert count(small, topology="graph") == 2  # only what could be chosen
    assert count(small) == 2 and count(small) == 0
    assert count(build("cloth", columns=9, rows=9)) == 4  # another size
    assert count(small.with_world(walls=())) == 4  # other features
    assert count(build("oscillator")) == 2  # no grid
    with monkeypatch.context() as patch:
        patch.setattr("platform.node", lambda: "elsewhere")
        assert count(small) == 4
    autotune.cache_file().write_text("not JSON")
    assert count(small) == 4
    assert len(autotune.measurements()) == 1
