"""Lanes and graph: where particles and springs are stored, and that it makes no difference."""

from dataclasses import replace

import numpy as np
import pytest
from cloths import (
    LINKS,
    SIDES,
    TWO_CLOTHS,
    assert_same,
    cloth,
    edits,
    mixed,
    motion,
    particles_and_springs,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from inside import room_for_clicks
from original import Original
from selection import as_thorough, mostly_thorough

from taichi_cloth.kernels import methods
from taichi_cloth.scene import scenefile
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import Particles, Springs
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.storage import adjacency, layouts

pytestmark = pytest.mark.usefixtures("to_run_fast")

# --- layout ----------------------------------------------------------------------------------


def check(stored, count, springs):
    """A layout holds together: one slot a particle; each link leads from end to end."""
    assert len(np.unique(stored.slot)) == len(stored.slot) == count
    lanes, halo = stored.lanes, 0
    if lanes > 1:
        halo = max(abs(column) for column, _ in stored.links)
    depth = max(row for _, row in stored.links)
    in_use = np.zeros(stored.n_packs, int)  # 1: packs of rows; 2: their halos and empty rows
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
    inside = np.zeros(count, int)
    for k, of in enumerate(found, 1):
        inside[of.first : of.first + of.rows * of.columns] = k
    if stored is None:  # too few springs are links; of those in a grid, 4 were added and are others
        one, other = inside[springs.between].T
        within = np.count_nonzero((one > 0) & (one == other))
        assert layouts.WORTH_LANES * (within - 4) < len(springs)
    else:
        check(stored, count, springs)
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
        {"method": "verlet", "lanes": 2, "execution": "parallel"},
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


# By default a representative of each: 2-D and 3-D, torn and whole, one lane and several. Eight, as
# users have them, are in test_golden.py.
SOME_GRIDS = [
    "torn between walls",
    "one lane, as on GPUs",
]


@pytest.mark.parametrize("name", mostly_thorough(GRIDS, default=SOME_GRIDS))
def test_a_whole_grid_moves_the_same_to_the_last_bit(name, pool):
    scene, how = GRIDS[name]
    on_grid = motion(Simulation(scene, topology="lanes", **{"execution": "serial", **how}))
    same = {k: v for k, v in how.items() if k not in ("lanes", "execution")}
    assert_same(on_grid, motion(pool(scene, **same)))
    if np.isfinite(scene.springs.break_force).any():
        assert on_grid[2].any() and not on_grid[2].all()


QUICK = "verlet", "xpbd"


@pytest.mark.parametrize("method", mostly_thorough(methods.METHODS, default=QUICK))
def test_every_method_moves_a_grid_the_same_to_the_last_bit(method, pool):
    """Each has neighbours' values of its own to keep beside the rows."""
    scene = cloth(11, 7, LINKS[:2], drag=0.02, damping=0.05, break_force=2.0)
    on_grid = motion(pool(scene, method, 0.25, topology="lanes", execution="parallel"))
    on_graph = motion(pool(scene, method, 0.25))
    solves = "tolerance" in methods.load(method).claims.settings
    assert_same(on_grid, on_graph, 1e-5 if solves else 0.0)


@pytest.mark.parametrize(
    ("scene", "how"),
    [
        as_thorough((mixed(), {"lanes": 2})),
        as_thorough((mixed(2), {"execution": "parallel", "lanes": 2})),
        as_thorough((mixed(2, collisions=True), {"execution": "parallel", "lanes": 2})),
        as_thorough((mixed(collisions=True), {"lanes": 1})),
    ],
)
def test_cloths_tied_to_each_other_and_to_particles_move_the_same(scene, how, pool):
    on_grids = motion(Simulation(scene, topology="lanes", **{"execution": "serial", **how}))
    assert_same(on_grids, motion(pool(scene)), 1e-9)
    assert on_grids[2].any() and not on_grids[2].all()


def test_springs_unlike_the_others_of_their_kind_are_on_the_graph(pool):
    """Others in any number but stiffness, of no stiffness, or between no neighbours."""
    scene = cloth(8, 6, LINKS[:2], damping=0.02, break_force=2.0)
    springs = scene.springs
    springs.stiffness[[40, 20]] = 0.4, 0.0
    springs.rest_length[31] = 25.0
    springs.damping[44] = 0.3
    springs.break_force[52] = 0.5
    springs.break_in[61] = "tension"
    far = Springs.build([[0, 47], [3, 30]], scene.particles.position, stiffness=0.1)
    scene = replace(scene, springs=springs.joined(far))
    stored = layouts.on_grids(scene.springs, 48, 4)
    s = len(scene.springs)
    # A break force over a stiffness is a length, and links of a kind share it: 40 differs there.
    assert np.flatnonzero(stored.kind < 0).tolist() == [20, 31, 40, 44, 52, 61, s - 2, s - 1]
    on_grid = motion(pool(scene, topology="lanes", execution="parallel"))
    assert_same(on_grid, motion(pool(scene)), 1e-9)

    stiffer = cloth(8, 6, LINKS[:2])
    stiffer.springs.stiffness[::3] = 0.4  # a link's own, without a break force
    assert (layouts.on_grids(stiffer.springs, 48, 4).kind >= 0).all()
    on_grid = motion(pool(stiffer, topology="lanes", execution="parallel"))
    assert_same(on_grid, motion(pool(stiffer)))


BUCKLING = {
    "none": {},
    "shear": {"shear": "tension"},
    "structural": {"structural": "tension"},
    "all": dict.fromkeys(LINKS[:2], "tension"),
}


@pytest.mark.parametrize("kinds", mostly_thorough(BUCKLING, default=["structural"]))
def test_each_kind_of_link_breaks_as_it_says_frame_by_frame(kinds, topology, pool):
    """Thrown about so hard that links are squeezed to a twentieth, and others stretched."""
    numbers = {"drag": 0.02, "damping": 0.05, "break_force": 2.0}
    scene = cloth(11, 7, LINKS[:2], **numbers, break_in=BUCKLING[kinds], speed=5.0)
    twin, sim = Original(scene), pool(scene, topology=topology, execution="parallel")
    shortest = np.full(len(scene.springs), np.inf)
    for _ in range(40):
        np.testing.assert_array_equal(sim.springs_alive(), twin.holds)
        np.testing.assert_allclose(sim.positions(), twin.x, rtol=0, atol=1e-6)
        a, b = scene.springs.between.T
        length = np.linalg.norm(twin.x[a] - twin.x[b], axis=1)
        shortest[twin.holds] = np.minimum(shortest, length)[twin.holds]
        sim.advance()
        twin.step()
    buckles = scene.springs.break_in == "tension"
    assert twin.holds.any() and (twin.squeezed > 2 or buckles.all())
    assert (shortest[~buckles] >= 10.0).all() and (shortest[buckles] < 10.0).any() == buckles.any()


@pytest.mark.parametrize(
    ("execution", "lanes"),
    mostly_thorough([("serial", 2), ("parallel", 1)], default=[]),
)
def test_what_is_spawned_beside_a_cloth_moves_the_same(execution, lanes, pool):
    def spawn(sim):
        """Free, fixed and tied ones, more than there is room for; the last breaks a row's end."""
        for k in range(4):
            free = sim.spawn((30.0, 40.0 + 20 * k), (5.0, 1.0), fixed=k == 3)
        sim.spawn((50.0, 50.0), tied_to=free)
        sim.spawn((150.0, 300.0), tied_to=20)
        sim.advance(3)
        sim.spawn((250.0, 300.0), tied_to=34)

    scene = cloth(7, 5, LINKS[:2], walls=SIDES[:4], damping=0.02, break_force=3.0, mouse="spawn")
    with room_for_clicks(3):
        sim = Simulation(scene, topology="lanes", execution=execution, lanes=lanes)
        on_grid = motion(sim, act=spawn)
    assert_same(on_grid, motion(pool(scene), act=spawn), 1e-9)


def test_a_spawned_tie_may_end_the_last_grid(pool):
    """Tied to the last particle, a new one makes the row longer: a cloth of two rows is no grid."""

    def spawn(sim):
        sim.spawn((150.0, 200.0), tied_to=7)

    scene = cloth(4, 2, walls=SIDES[:4], mouse="spawn")
    sim = pool(scene, topology="lanes", execution="parallel")
    on_grid = motion(sim, act=spawn)
    assert sim.topology == "graph"
    assert_same(on_grid, motion(pool(scene), act=spawn), 1e-9)


def test_dashpots_have_no_race(topology, pool):
    """A force reads velocities that no thread may have changed: parallel is serial, to the bit."""
    scene = cloth(5, 40, LINKS[:2], damping=0.1, break_force=2.0)
    serial = motion(pool(scene))
    for _ in range(5):
        assert_same(motion(pool(scene, topology=topology, execution="parallel")), serial)


def test_the_order_of_particles_does_not_matter(topology, pool):
    """The same cloth numbered from its other end is again a grid, and moves the same."""
    scene = cloth(6, 9, LINKS[:2], damping=0.1, drag=0.01)
    backwards = Particles(**{name: values[::-1] for name, values in vars(scene.particles).items()})
    springs = replace(scene.springs, between=53 - scene.springs.between)
    turned = replace(scene, particles=backwards, springs=springs)
    x, v, _ = motion(pool(turned, topology=topology, execution="parallel"))
    expected = motion(pool(scene, topology=topology, execution="parallel"))
    np.testing.assert_allclose(x[::-1], expected[0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(v[::-1], expected[1], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("precision", "collisions", "threads"),
    [
        as_thorough(("f32", False, (1, 2, 2, 3))),
        as_thorough(("f64", True, (1, 3))),
    ],
)
def test_lanes_have_the_same_bits_for_every_thread_count_and_on_every_run(
    precision, collisions, threads, cli
):
    made = {"precision": precision, "method": "symplectic_euler", "collisions": collisions}
    found = [cli.call("cloths:bits", **made, threads=count) for count in threads]
    assert all(one == found[0] for one in found[1:])
    springs = len(scenefile.parse(TWO_CLOTHS.replace("COLLISIONS", "false")).springs)
    assert 0 < found[0][1] < springs


def test_lanes_without_a_grid_are_refused(cli):
    out, error = cli("run", "chain", "--topology", "lanes", "--headless", check=2)
    assert out == "" and error.count("\n") == 1
    assert "--topology lanes" in error and "'chain'" in error and "--topology graph" in error
