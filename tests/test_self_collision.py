"""Cloths with a thickness: no triangle meets another one, and contacts give no energy."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
import taichi as ti
from selection import as_thorough

from bench.experiments.intersection_sweep import SCENES, row
from bench.experiments.intersections import intersecting_pairs
from taichi_cloth.errors import SimulationFailure
from taichi_cloth.front_end.mending import kernel
from taichi_cloth.kernels import methods
from taichi_cloth.kernels.kept_pairs import NEAR_BITS
from taichi_cloth.kernels.near_pairs import find_pairs
from taichi_cloth.kernels.pair_colours import COLOURS, colour_pairs
from taichi_cloth.kernels.pair_laws import SLACK, out_of_obstacles
from taichi_cloth.scene.cloth import grid, grid_triangles
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import Particles, Scene, World
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.scene.spheres import nearness, needed_diameters, too_near
from taichi_cloth.simulation.readings import Readings
from taichi_cloth.simulation.storage import layouts

WIDTH = 1.0


def sheets(size, heights, *, thickness=0.01, seed=0, velocity=None, obstacles=(), **world):
    """Square sheets of 1 m above each other, jittered, each a little aside of the one below."""
    rng, spacing = np.random.default_rng(seed), WIDTH / (size - 1)
    material = Material(density=0.2, thickness=thickness, stretch=20, shear=4, damping_time=1e-3)
    parts = []
    for k, height in enumerate(heights):
        particles, springs = grid(
            (1.0 + 0.04 * k, height, -0.5 + 0.03 * k),
            size,
            size,
            spacing,
            links=("structural", "shear"),
            across=(1.0, 0.0, 0.0),
            down=(0.0, 0.0, 1.0),
            material=material,
        )
        x = particles.position + rng.uniform(-2e-3, 2e-3, particles.position.shape) * spacing
        parts.append((replace(particles, position=x), springs))
    particles, springs = parts[0]
    triangles = grid_triangles(size, size)
    for k, (more, tied) in enumerate(parts[1:], 1):
        tied = replace(tied, between=tied.between + k * size**2)
        particles, springs = particles.joined(more), springs.joined(tied)
        triangles = np.concatenate([triangles, grid_triangles(size, size, k * size**2)])
    if velocity is not None:
        particles = replace(particles, velocity=velocity(particles.position))
    world = {"gravity": (0.0, -9.81, 0.0), "ground": 0.0, "friction": 0.3} | world
    world = World(size=(3.0, 3.0, 3.0), up="y", dt=1 / 60, contact="resting", **world)
    return Scene("sheets", world, particles, springs, triangles=triangles, obstacles=obstacles)


def draped(size, **more):
    """A sheet above a sphere."""
    sphere = Obstacle.build("sphere", centre=[1.5, 0.4, 0.0], radius=0.2, friction=0.3)
    return sheets(size, [0.7], obstacles=(sphere,), **more)


def most_intersections(sim, frames, every=3):
    worst = 0
    for _ in range(0, frames, every):
        sim.advance(every)
        worst = max(worst, len(intersecting_pairs(sim.positions(), sim.scene.triangles)))
    return worst


WAYS = [
    ("symplectic_euler", "graph"),
    *(
        as_thorough((method, "lanes" if method in ("symplectic_euler", "xpbd") else "graph"))
        for method in methods.METHODS
    ),
]


@pytest.mark.parametrize(("method", "topology"), WAYS)
def test_sheets_that_fall_on_each_other_never_intersect(pool, method, topology):
    # Explicit Euler, unstable at every step, stretches them to 1.9 times their length with 8.
    substeps = 64 if method == "explicit_euler" else 8
    sim = pool(sheets(9, [0.1, 0.35]), method, substeps=substeps, topology=topology)
    assert most_intersections(sim, 60) == 0 and sim.unsettled() == 0
    assert np.abs(sim.positions()[:, 1]).min() < 0.01  # they lie on the ground


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["drape", "stack"])
def test_coarse_built_in_scenes_never_intersect(device, name):
    """At three resolutions and from more starts: `bench/experiments/intersection_sweep.py`."""
    with_any = row(name, SCENES[name][1][0], 1, seconds=1.5)[4]
    assert with_any == 0


@kernel
def find_near(spec: ti.template(), state: ti.template()):
    """What the beginning of contacts does in a step, on one thread."""
    for _ in range(1):
        find_pairs(spec, state, 0)


def found_pairs(state, n):
    """Of each of n places those that may touch it in the step, as they are listed."""
    count, start = state.found_count.to_numpy()[:n], state.found_start.to_numpy()[:n]
    others = state.found.to_numpy() >> NEAR_BITS
    return [others[first : first + many] for first, many in zip(start, count, strict=True)]


def test_lists_of_patches_have_all_that_may_touch_in_each_step(pool):
    """Against all pairs, for sheets that turn, slide, jump and crumple."""
    scene = sheets(16, [0.3, 0.33, 0.36])
    sim = pool(scene, topology="graph", execution="serial")
    state, spheres, rng = sim.storage.state, scene.spheres, np.random.default_rng(3)
    n, x = len(scene.particles), scene.particles.position
    sheet, phase = np.arange(n) // 256, rng.uniform(0, 6, (3, 3))
    closer = np.zeros((n, n), bool)
    closer[np.repeat(np.arange(n), np.diff(spheres.start)), spheres.other] = True
    reach = 1.05 * (spheres.radius[:, None] + spheres.radius)
    ways, found = {"all": 0, "some": 0, "none": 0}, 0
    for step in range(60):
        way = 4e-3 * np.sin(0.1 * step + phase)[sheet] + 3e-4 * rng.normal(size=(n, 3))
        way += np.cross([0, 0.02, 0.01], x - x.mean(axis=0)) * (sheet == 1)[:, None]
        way[:, 1] -= 2e-3 * (sheet - 1)
        if step == 40:  # farther than lists can be made for
            way += 0.3 * (sheet == 2)[:, None]
        begun, x = x, x + way
        state.begun_x.from_numpy(begun)
        state.x.from_numpy(x)
        state.n_stale[None] = 0
        anchors = state.listed_x.to_numpy()[:n]
        find_near(sim.storage.specialization, state)
        moved = (anchors != state.listed_x.to_numpy()[:n]).any(axis=1).mean()
        ways["all" if moved == 1 else "some" if moved else "none"] += 1

        before, now = begun - begun[:, None], x - x[:, None]
        along = -(before * (now - before)).sum(2) / ((now - before) ** 2).sum(2).clip(1e-30)
        nearest = before + along.clip(0, 1)[..., None] * (now - before)
        distance = np.linalg.norm(nearest, axis=2)
        near = np.zeros((n, n), bool)
        for at, pairs in enumerate(found_pairs(state, n)):
            near[spheres.in_patches[at], spheres.in_patches[pairs]] = True
        near |= near.T
        may = (distance < 0.9999 * reach) & ~closer & ~np.eye(n, dtype=bool)
        assert not (may & ~near).any(), step
        assert not (near & (distance > 1.0001 * reach)).any(), step
        found += may.sum()
    assert found > 10_000 and ways["some"] > 20 and ways["none"] > 3 and 2 <= ways["all"] < 10, ways


def test_pairs_are_listed_in_the_order_of_their_places(pool):
    """Whenever lists were made, in sheets that jump about: sums of contacts have the same bits."""
    scene = sheets(16, [0.3, 0.33, 0.36])
    sim = pool(scene, topology="graph", execution="serial")
    state, rng = sim.storage.state, np.random.default_rng(3)
    n, x, compared = len(scene.particles), scene.particles.position, 0
    for _ in range(10):
        begun, x = x, x + 4e-3 * rng.normal(size=(n, 3))
        state.begun_x.from_numpy(begun)
        state.x.from_numpy(x)
        state.n_stale[None] = 0
        find_near(sim.storage.specialization, state)
        for others in found_pairs(state, n):
            assert (np.diff(others) > 0).all()
            compared += len(others) > 1
    assert compared > 100


@kernel
def find_and_colour(spec: ti.template(), state: ti.template()):
    """What comes before the sweeps of a step, on one thread."""
    for _ in range(1):
        find_pairs(spec, state, 0)
        colour_pairs(spec, state, 0)


def test_pairs_of_a_colour_have_no_particle_in_common(pool):
    """Of sheets as they lie, and of all particles in a ball: more pairs than there are colours."""
    scene = sheets(9, [0.3, 0.43, 0.56])
    sim = pool(scene, topology="graph", execution="serial")
    state, n = sim.storage.state, len(scene.particles)
    ball = np.random.default_rng(5).normal(size=(n, 3)) * 0.02 + 0.5
    for x, rest in ((scene.particles.position, False), (ball, True)):
        state.begun_x.from_numpy(x)
        state.x.from_numpy(x)
        state.outdated[None] = 1
        state.colours_at.fill(0)
        find_and_colour(sim.storage.specialization, state)
        first, second = state.near_from.to_numpy(), state.near.to_numpy() >> NEAR_BITS
        listed = []
        for colour, size in enumerate(state.colour_size.to_numpy()):
            rows = slice(colour * (n // 2), colour * (n // 2) + size)
            ends = np.concatenate([first[rows], second[rows]])
            assert colour == COLOURS or len(np.unique(ends)) == 2 * size
            listed += zip(first[rows], second[rows], strict=True)
        assert (state.colour_size[COLOURS] > 0) == rest
        pairs = [(at, other) for at, found in enumerate(found_pairs(state, n)) for other in found]
        assert len(listed) == len(pairs) > 100 and {*listed} == {*pairs}


vector = ti.types.vector(3, ti.f64)


@kernel
def put_out(spec: ti.template(), state: ti.template(), at: int, x: vector, v: vector) -> vector:
    """Where the particle at a place, at x with a velocity of v, is put by obstacles."""
    out, _ = out_of_obstacles(spec, state, at, x, v)
    return out


@kernel
def stopped(spec: ti.template(), state: ti.template(), at: int, x: vector, v: vector) -> vector:
    """The velocity that it goes on with."""
    _, out = out_of_obstacles(spec, state, at, x, v)
    return out


def test_what_a_pair_pushes_into_an_obstacle_is_put_onto_it(pool):
    """By contact and Coulomb's friction, which takes from positions what the step had of it."""
    sim = pool(draped(9), topology="graph", execution="serial")
    sim.advance()
    inside = sim.storage.specialization, sim.storage.state
    rng, at, dt = np.random.default_rng(2), 7, sim.dt
    centre, radius = np.array([1.5, 0.4, 0.0]), sim.radii()[0]
    assert (sim.radii() == radius).all()
    met = []
    for gap in [-0.01, -0.002, 0.5 * SLACK * radius, 2 * SLACK * radius] * 10:
        n, v = rng.normal(size=(2, 3))
        n /= np.linalg.norm(n)
        x, u = centre + (0.2 + radius + gap) * n, v @ n
        y, w = x - min(gap, 0.0) * n, v
        if gap <= SLACK * radius and u < 0:
            slide = v - u * n
            taken = -min(1.0, 0.3 * -u / np.linalg.norm(slide)) * slide
            y, w = y + dt * taken, v - u * n + taken
        np.testing.assert_allclose(put_out(*inside, at, x, v), y, rtol=0, atol=1e-12)
        np.testing.assert_allclose(stopped(*inside, at, x, v), w, rtol=0, atol=1e-12)
        met.append((gap, u < 0))
    assert len({*met}) == 8


def crossing(**more):
    """A slanting sheet that flies at another one at 1.5 m/s, without gravity."""

    def downward(x):
        return np.where(x[:, [1]] > 1.15, [0.0, -1.5, 0.0], 0.0)

    scene = sheets(9, [1.0, 1.3], gravity=(0.0, 0.0, 0.0), velocity=downward, **more)
    x = scene.particles.position.copy()
    x[81:, 1] += 0.1 * (x[81:, 0] - 1.5)
    return replace(scene, particles=replace(scene.particles, position=x))


def test_what_goes_farther_in_a_step_than_cells_can_be_counted_is_named(pool):
    """Sheets that may meet on their ways look at all cells: a count that overflows would crash."""
    away = sheets(5, [0.5, 0.53], velocity=lambda x: np.outer(x[:, 1] > 0.515, [-1e12, 0.0, 0.0]))
    with pytest.raises(SimulationFailure, match=r"has a speed of 1e\+12 before any step"):
        pool(away).advance(2)


def test_only_sheets_without_a_thickness_pass_through_each_other(pool):
    assert most_intersections(pool(crossing(thickness=0.0), substeps=8), 21) > 0
    assert most_intersections(pool(crossing(), substeps=8), 21) == 0


def test_vertices_in_any_order_keep_off_each_other(pool, monkeypatch):
    """Meshes' vertices are; pairs are named by the particles' numbers, wherever these lie."""
    monkeypatch.setattr(layouts, "WORTH_SORTING", 0)
    scene = crossing()
    old = np.random.default_rng(3).permutation(len(scene.particles))
    new, p = np.argsort(old), scene.particles
    springs = replace(scene.springs, between=new[scene.springs.between])
    scene = replace(
        scene,
        particles=Particles(**{f.name: getattr(p, f.name)[old] for f in fields(p)}),
        springs=springs,
        triangles=new[scene.triangles],
    )
    sim = pool(scene, substeps=8, topology="graph")
    start = sim.energy().total
    assert most_intersections(sim, 21) == 0
    assert sim.energy().total < start


def folding(x):
    """Both halves of a sheet thrown at each other: speeds up to 3 m/s."""
    v, away = np.zeros_like(x), x[:, 0] - x[:, 0].mean()
    v[:, 1], v[:, 0] = 6 * np.abs(away), -4 * away
    return v


def test_contacts_keep_momentum_and_give_no_energy(pool):
    """A sheet that folds onto itself without gravity."""
    scene = sheets(10, [1.5], gravity=(0.0, 0.0, 0.0), friction=0.2, velocity=folding)
    sim = pool(scene, substeps=16)
    momentum, energy = sim.momentum(), sim.energy().total
    size = float(scene.particles.mass @ np.linalg.norm(scene.particles.velocity, axis=1))
    touched = 0
    for _ in range(40):
        before = sim.energy().total
        sim.advance()
        assert sim.energy().total < before + 1e-3 * energy
        np.testing.assert_allclose(sim.momentum(), momentum, rtol=0, atol=1e-12 * size)
        touched += before - sim.energy().total > 1e-2 * energy
        assert len(intersecting_pairs(sim.positions(), scene.triangles)) == 0
    assert touched > 2


def test_sheets_that_a_step_takes_into_each_other_do_not_pass(pool):
    """The last one falls by one to three reaches a step, and ends some in the plane of another."""
    size, dt = 9, 1 / 240
    for heights in ([1.9, 2.4], [1.7, 1.86, 2.4]):
        for way, turn in ((0.25, 0.0), (0.17, 0.1), (0.25, 0.1), (0.4, 0.1)):
            scene = sheets(size, heights, gravity=(0.0, 0.0, 0.0))
            x, last = scene.particles.position.copy(), slice((len(heights) - 1) * size**2, None)
            c, s, middle = np.cos(turn), np.sin(turn), x[last].mean(axis=0)
            x[last] = (x[last] - middle) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + middle
            v = np.zeros_like(x)
            v[last] = np.array([0.1, -1.0, 0.0]) * way / dt
            scene = replace(scene, particles=replace(scene.particles, position=x, velocity=v))
            sim, deep = pool(scene, dt=dt), 0.1 * 2 * scene.spheres.radius.max()
            momentum, energy = sim.momentum(), sim.energy().total
            for _ in range(6):
                counted = sim.unsettled()
                sim.advance()
                assert len(intersecting_pairs(sim.positions(), scene.triangles)) == 0
                assert sim.penetration() <= deep or sim.unsettled() > counted
                assert sim.energy().total < energy * (1 + 1e-3)
            size_of = np.abs(momentum).max()
            np.testing.assert_allclose(sim.momentum(), momentum, rtol=0, atol=1e-12 * size_of)
            assert sim.energy().total < 0.8 * energy  # they met


def test_triangles_whose_corners_keep_apart_do_not_meet():
    """The proof's bound, on random pairs of triangles: it is held, and it is sharp."""
    rng, count = np.random.default_rng(1), 2000
    none = np.zeros((0, 2), np.int64), np.zeros(0)
    x = rng.normal(size=(count, 6, 3)) * rng.uniform(0.2, 1.0, (count, 6, 3))
    x[:, :, 0] += 20 * np.arange(count)[:, None]  # each pair far from all others
    pairs = np.arange(6 * count).reshape(-1, 3)
    needed = needed_diameters(x.reshape(-1, 3), pairs, *none).reshape(count, 2, 3)
    apart2 = ((x[:, :3, None] - x[:, None, 3:]) ** 2).sum(axis=3)
    bound2 = (needed[:, 0, :, None] ** 2 + needed[:, 1, None] ** 2) / 2
    certified = (apart2 >= bound2).all(axis=(1, 2))
    meet = np.zeros(count, bool)
    meet[intersecting_pairs(x.reshape(-1, 3), pairs)[:, 0] // 2] = True
    assert meet.sum() > 300 and certified.sum() > 10 and not (meet & certified).any()
    pair = pairs[:2]
    # Two diagonals of cells that cross at their middles: corners are a spacing apart.
    for lift, meets in ((-1e-6, 1), (1e-6, 0)):
        half = 0.5**0.5
        x = [[-half, 0, 0], [half, 0, 0], [0, 0, -half]]
        x += [[0, -half, lift], [0, half, lift], [0, 0, half + lift]]
        x = np.array(x)
        np.testing.assert_allclose(needed_diameters(x, pair, *none), 1.0, rtol=1e-5)
        assert len(intersecting_pairs(x, pair)) == meets


@pytest.mark.parametrize("closed", [False, True])
def test_layers_that_begin_nearer_than_spheres_guard_are_counted_and_never_certified(closed):
    """Those of a lining, and both sides of one surface that is thinner than it is cut."""
    scene = sheets(11, [0.5, 0.51], seed=0)
    x, half = scene.particles.position, len(scene.particles) // 2
    if closed:  # sewn along one side by triangles, as the rim of a thickened sheet is
        rim = np.arange(11)
        a, b = rim[:-1], rim[1:]
        sewn = np.vstack(
            [np.column_stack([a, b, a + half]), np.column_stack([b, b + half, a + half])]
        )
        scene = replace(scene, triangles=np.vstack([scene.triangles, sewn]))
    of = scene.spheres
    near = np.linalg.norm(x[:half, None] - x[None, half:], axis=2) < 0.09  # of a spacing of 0.1
    faced = set(map(tuple, np.argwhere(near) + [0, half]))
    found = set(map(tuple, np.sort(of.unguarded, axis=1)))
    assert len(found) > (60 if closed else 110) and all(j >= half > i for i, j in found)
    assert closed or faced <= found
    assert len(too_near(x, scene.triangles, of)) >= len(faced & found)
    words = nearness(x, of)
    i, j = of.unguarded[0]
    assert words.startswith(f"{len(found)} pairs of particles of cloth begin nearer")
    assert f"the first {i} and {j}, {np.linalg.norm(x[i] - x[j]):.3g} apart" in words
    apart = sheets(11, [0.5, 0.64], seed=0)
    assert len(apart.spheres.unguarded) == 0 and nearness(x, apart.spheres) == ""
    assert len(too_near(apart.particles.position, apart.triangles, apart.spheres)) == 0


def test_spheres_are_as_wide_as_spacing_asks_and_say_so():
    scene = sheets(11, [0.5, 0.56], seed=0)
    of = scene.spheres
    np.testing.assert_allclose(2 * of.radius, 0.125, rtol=0.01)
    assert len(of.widened) == 2 and "0.01 of particles 0 to 120 is taken as 0.125" in of.widened[0]
    pressed = scene.particles.position * [1.0, 0.1, 1.0]
    free = replace(of, start=0 * of.start, other=of.other[:0])
    assert len(too_near(pressed, scene.triangles, free)) > 100
    whole, folded = np.arange(len(scene.triangles)) % 3 > 0, scene.particles.position.copy()
    folded[:, 0] = np.abs(folded[:, 0] - 1.5)
    thin, found = sheets(11, [0.5], thickness=0.0), []
    for of_scene, alive in ((scene, np.ones_like(whole)), (scene, whole), (thin, None)):
        storage = SimpleNamespace(scene=of_scene, triangles_alive=lambda alive=alive: alive)
        read = SimpleNamespace(storage=storage, positions=lambda: folded)
        found.append(Readings.uncertified(read))
    near = [len(too_near(folded, scene.triangles[alive], of)) for alive in (whole | True, whole)]
    assert found == [*near, 0] and near[0] > near[1] > 100
    # Neighbours keep 0.7 of their distance, sheets that start nearer what they start with.
    row = slice(of.start[60], of.start[61])
    within, across = of.other[row] < 121, of.other[row] >= 121
    assert within.sum() == 8 and across.sum() > 0
    apart = np.linalg.norm(
        scene.particles.position[of.other[row]] - scene.particles.position[60], axis=1
    )
    np.testing.assert_allclose(of.reach[row], np.where(within, 0.7, 1.0) * apart, rtol=1e-12)
    thick = scene.with_world(gravity=(0.0, 0.0, 0.0))
    assert thick.features().thick and thick.features().resting
    assert not thin.features().thick and not thin.features().collisions
