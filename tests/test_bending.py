"""Bending: rigidity of cloth in grids and meshes, against closed forms and on every topology."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp, trapezoid
from scipy.sparse import coo_array
from scipy.sparse.linalg import eigsh, spsolve
from scipy.spatial import Delaunay
from selection import thorough
from strips import DENSITY, LENGTH, RIGIDITY, strip, tips

from taichi_cloth.errors import InputError, SimulationFailure
from taichi_cloth.kernels import methods
from taichi_cloth.limits.bounds import any_geometry, gershgorin, step_within
from taichi_cloth.limits.eigenmodes import stable_step
from taichi_cloth.limits.matrices import stiffness_and_damping
from taichi_cloth.limits.network import Network
from taichi_cloth.scene import scenefile
from taichi_cloth.scene.cloth import grid, grid_stencils, grid_triangles
from taichi_cloth.scene.model import ParticleDefaults, Scene, SpringDefaults, Springs, World
from taichi_cloth.scene.stencils import Stencils, mesh_stencils
from taichi_cloth.scene.triangles import areas
from taichi_cloth.simulation import diagnostics
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.storage import lines


def crumpled(columns=7, rows=6, mesh=False, bending=20.0, **options):
    """A cloth of 20 spacing, thrown about in space."""
    particles, springs = grid(
        (100.0, 100.0, 0.0),
        columns,
        rows,
        20.0,
        links=("structural", "shear"),
        pinned=[(0, 0), (1, 0)],
        spring_defaults=SpringDefaults(stiffness=0.2, damping=0.01, **options),
        particle_defaults=ParticleDefaults(mass=1.5),
    )
    stencils = grid_stencils(columns, rows, 20.0, bending)
    if mesh:
        triangles = grid_triangles(columns, rows)
        stencils = mesh_stencils(particles.position, triangles, bending)
    rng = np.random.default_rng(0)
    particles.position[:] += rng.uniform(-4, 4, particles.position.shape)
    particles.velocity[:] += rng.normal(0, 1, particles.position.shape)
    world = World((400.0, 400.0, 400.0), gravity=(0.01, 0.05, 0.02), dt=0.5)
    return Scene("crumpled", world, particles, springs, stencils=stencils)


# --- closed forms ----------------------------------------------------------------------------


def patch(kind, cells):
    """Points (n, 2) in a unit square and triangles: of a regular grid, or of points at random."""
    at = np.linspace(0, 1, cells + 1)
    x, y = np.meshgrid(at, at)
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    if kind == "regular":
        return points, grid_triangles(cells + 1, cells + 1)
    inside = ((points > 1e-9) & (points < 1 - 1e-9)).all(axis=1)
    moved = np.random.default_rng(1).uniform(-0.3, 0.3, (inside.sum(), 2))
    points[inside] += moved / cells
    corners = Delaunay(points).simplices
    one, other = (points[corners[:, k]] - points[corners[:, 0]] for k in (1, 2))
    return points, corners[np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) > 1e-9]


def on_cylinder(points, angle, radius):
    """The points (n, 3) where the plane, turned by an angle, is rolled up without stretching."""
    along = points @ [np.cos(angle), np.sin(angle)]
    aside = points @ [-np.sin(angle), np.cos(angle)]
    turn = along / radius
    return np.stack([radius * np.sin(turn), aside, radius * np.cos(turn)], axis=1)


@pytest.mark.parametrize("kind", ["regular", "random"])
def test_a_mesh_on_a_cylinder_holds_b_over_two_r_squared_whichever_way_it_is_rolled(kind):
    """To first order in the spacing, by what is missing at borders."""
    errors = []
    for cells in (16, 32, 64):
        points, triangles = patch(kind, cells)
        stencils = mesh_stencils(points, triangles, 3.0)
        flat = np.column_stack([points, 0 * points[:, 0]])
        assert np.abs(stencils.curvature(flat)).max() < 1e-12 * cells
        energies = []
        for angle in np.deg2rad([0, 25, 45, 70, 90, 135]):
            vectors = stencils.curvature(on_cylinder(points, angle, 0.8))
            energies.append(0.5 * (stencils.bending[:, None] * vectors**2).sum())
        errors.append(np.abs(np.array(energies) / (3.0 / (2 * 0.8**2)) - 1).max())
    assert errors[2] < 0.02
    assert errors[0] > 1.7 * errors[1] > 1.7**2 * errors[2]


@pytest.mark.parametrize(("columns", "rows"), [(9, 5), (5, 9), (9, 1), (1, 9)])
def test_a_grid_on_a_cylinder_holds_its_second_differences(columns, rows):
    """Each is 4 R sin^2(s / 2R); strips are a spacing wide, at borders half of it."""
    spacing, radius = 0.5, 3.0
    along, aside = max(columns, rows), min(columns, rows)
    particles, _ = grid((0.0, 0.0), columns, rows, spacing)
    angle = 0.0 if columns > rows else np.pi / 2
    stencils = grid_stencils(columns, rows, spacing, 3.0)
    vectors = stencils.curvature(on_cylinder(particles.position, angle, radius))
    energy = 0.5 * (stencils.bending[:, None] * vectors**2).sum()
    second = 4 * radius * np.sin(spacing / (2 * radius)) ** 2
    width = max(aside - 1, 1) * spacing
    expected = 3.0 * width / (2 * spacing**3) * (along - 2) * second**2
    assert energy == pytest.approx(expected, rel=1e-12)


def plane(kind, cells, seed=1):
    """Points (n, 2) in a unit square and triangles: squares that are cut along one diagonal, or
    along either in turn; quads of points at random, cut at random; triangles between such points.
    """
    if kind in ("regular", "random"):
        return patch(kind, cells)
    points = patch("random" if kind == "quads" else "regular", cells)[0]
    first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    quads = np.stack([first, first + 1, first + cells + 2, first + cells + 1], axis=1)
    other = (first // (cells + 1) + first % (cells + 1)) % 2 == 1
    if kind == "quads":
        other = np.random.default_rng(seed).random(len(quads)) < 0.5
    quads[other] = np.roll(quads[other], 1, axis=1)
    return points, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


KINDS = ("regular", "in turn", "quads", "random")


def curvature_matrix(stencils, count):
    """The curvature vectors by positions, (m, count)."""
    entries = stencils.weight, (stencils.owner, stencils.particle)
    return coo_array(entries, shape=(len(stencils), count)).tocsr()


@pytest.mark.parametrize("kind", [*KINDS, "two triangles", "ladder"])
def test_a_mesh_stores_nothing_that_is_straight_and_something_of_all_else(kind):
    """Its matrix has three eigenvalues of 0, and none near them."""
    if kind == "two triangles":
        points = np.array([[0.0, 0.0], [1.0, 0.1], [0.3, 0.8], [0.4, -1.1]])
        triangles = np.array([[0, 1, 2], [1, 0, 3]])
    elif kind == "ladder":
        points, triangles = np.argwhere(np.ones((9, 2))) / 8, grid_triangles(2, 9)
    else:
        points, triangles = plane(kind, 8)
    bent = curvature_matrix(mesh_stencils(points, triangles, 1.0), len(points))
    values = np.linalg.eigvalsh((bent.T @ bent).toarray())
    assert np.abs(values[:3]).max() < 1e-12 * values[-1]
    assert values[3] > (1e-4 if len(points) > 20 else 1e-3) * values[-1]
    for straight in (1.0 + 0 * points[:, 0], *points.T):
        assert np.abs(bent @ straight).max() < 1e-12 * np.abs(bent).max()


@pytest.mark.parametrize("kind", KINDS)
def test_a_uniform_bend_is_stored_exactly_and_pulls_at_nothing_inside(kind):
    """The integral of second derivatives away from borders is their own, and their divergence 0."""
    points, triangles = plane(kind, 12)
    stencils = mesh_stencils(points, triangles, 1.0)
    bent = curvature_matrix(stencils, len(points))
    x, y = points.T
    away = np.minimum(points, 1 - points).min(axis=1)  # from the nearest border
    corners = stencils.particle[stencils.start[:-1, None] + np.arange(3)]
    inside = (away[corners] > 0.3).all(axis=1)
    mine = (away[triangles] > 0.3).all(axis=1)
    area = areas(points, triangles[mine]).sum()
    for values, square in ((x * x / 2, 1.0), (x * y, 2.0), (y * y / 2, 1.0), (x * x - y * y, 8.0)):
        vectors = bent @ values
        assert (vectors[inside] ** 2).sum() == pytest.approx(square * area, rel=1e-10)
        force = bent.T @ vectors
        assert np.abs(force[away > 0.4]).max() < 1e-10 * np.abs(force).max()


def sag(points, triangles):
    """How far the free side of a plate of a unit length sinks, clamped where x is 0 or less, under
    its weight and to first order, in parts of what a beam's does, q L^4 / (8 B).
    """
    area = areas(points, triangles)
    load = np.bincount(triangles.ravel(), np.repeat(area / 3, 3), len(points))
    stencils, free = mesh_stencils(points, triangles, 1.0), points[:, 0] > 1e-9
    bent = curvature_matrix(stencils, len(points))
    held = stencils.stiffness(~free)
    stiffness = (bent.T @ bent.multiply(held[:, None])).tocsr()[free][:, free]
    sunk = spsolve(stiffness.tocsc(), load[free])
    return 8 * float(sunk[points[free, 0] > 1 - 1e-9].mean())


def sagged(kind, cells):
    """That of a square plate of cells, with two more columns of points that clamp it."""
    points, triangles = plane(kind, cells)
    count = len(points)
    side = np.flatnonzero(points[:, 0] < 1e-9)
    side = side[np.argsort(points[side, 1])]
    held = points[side] - [1 / cells, 0.0]  # with those at 0 they are level
    more = np.arange(count, count + len(side))
    strips = np.stack([more[:-1], side[:-1], side[1:], more[1:]], axis=1)
    added = np.concatenate([strips[:, [0, 1, 2]], strips[:, [0, 2, 3]]])
    return sag(np.vstack([points, held]), np.concatenate([triangles, added]))


def test_a_plate_of_triangles_sags_as_a_beam_however_it_is_cut():
    for kind in KINDS:
        errors = [sagged(kind, cells) - 1 for cells in (8, 16, 32)]
        assert np.abs(errors[1:]).max() < 0.01 and abs(errors[2]) < 3e-3, (kind, errors)
        assert errors[0] > 2.5 * errors[1], (kind, errors)


def test_a_strip_sags_alike_in_whatever_direction_it_is_cut_out_of_a_mesh():
    """Out of squares, and of equilateral triangles: points inside are theirs, turned."""
    cells, found = 20, []
    at = np.arange(-3 * cells, 3 * cells + 1) / cells
    for slant, angle in itertools.product((0.0, 0.5), (0, 15, 30, 45)):
        x, y = np.meshgrid(at, at)
        lattice = np.stack([x + slant * y, np.sqrt(1 - slant**2) * y], axis=-1).reshape(-1, 2)
        turn = np.deg2rad(angle)
        turned = lattice @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
        turned += [0.0123, 0.0071]
        gap = 0.45 / cells
        inside = (turned > gap).all(axis=1) & (turned < [1 - gap, 0.5 - gap]).all(axis=1)
        across, along = np.linspace(0, 0.5, cells // 2 + 1), np.linspace(0, 1, cells + 1)[1:-1]
        sides = [np.column_stack([np.full_like(across, x), across]) for x in (-1 / cells, 0, 1)]
        sides += [np.column_stack([along, np.full_like(along, y)]) for y in (0, 0.5)]
        points = np.vstack([*sides, turned[inside]])
        triangles = Delaunay(points).simplices
        triangles = triangles[areas(points, triangles) > 1e-9]
        found.append(sag(points, triangles))
    assert np.abs(np.array(found) - 1).max() < 0.01, found
    assert max(found) / min(found) < 1.015, found


def test_momentum_and_angular_momentum_are_kept():
    for mesh in (False, True):
        scene = crumpled(mesh=mesh)
        x, free = scene.particles.position, np.zeros(len(scene.particles), bool)
        force = diagnostics.stencil_forces(x, scene.stencils, free)
        largest = np.abs(force).max()
        assert largest > 1.0
        np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-12 * largest)
        np.testing.assert_allclose(np.cross(x, force).sum(axis=0), 0.0, atol=1e-9 * largest)


def elastica(load):
    """The free end (along, down) of a cantilever under its own weight, its length 1: theta'' =
    -load (1 - s) cos(theta), theta(0) = theta'(1) = 0.
    """

    def slope(s, y):
        return np.stack([y[1], -load * (1 - s) * np.cos(y[0])])

    def ends(a, b):
        return np.array([a[0], b[1]])

    s = np.linspace(0, 1, 201)
    found = solve_bvp(slope, ends, s, np.zeros((2, len(s))), tol=1e-10, max_nodes=20_000)
    s = np.linspace(0, 1, 20_001)
    theta = found.sol(s)[0]
    return np.array([trapezoid(np.cos(theta), s), trapezoid(np.sin(theta), s)])


def at_equilibrium(scene):
    """Where the free particles of a scene are in balance (n, dim): Newton's method on the twins."""
    particles, springs, dim = scene.particles, scene.springs, scene.world.dim
    x, free = particles.position.copy(), np.repeat(~particles.fixed, dim)
    still, one = np.zeros_like(x), np.eye(dim)
    n, (a, b) = len(x), springs.between.T
    bent = np.zeros((len(scene.stencils), n))
    bent[scene.stencils.owner, scene.stencils.particle] = scene.stencils.weight
    k = scene.stencils.stiffness(particles.fixed)
    bending = np.kron(bent.T @ (k[:, None] * bent), one)
    for part in np.linspace(0.1, 1, 10):  # of the load
        weight = part * particles.mass[:, None] * np.array(scene.world.gravity)
        for _ in range(12):
            force = weight + diagnostics.spring_forces(x, still, springs)
            force += diagnostics.stencil_forces(x, scene.stencils, particles.fixed)
            d = x[b] - x[a]
            length = np.linalg.norm(d, axis=1)[:, None, None]
            along = d[:, :, None] * d[:, None, :] / length**2
            across = 1 - springs.rest_length[:, None, None] / length
            blocks = springs.stiffness[:, None, None] * (along + across * (one - along))
            whole = bending.reshape(n, dim, n, dim).transpose(0, 2, 1, 3).copy()
            for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
                np.add.at(whole, (i, j), sign * blocks)
            matrix = whole.transpose(0, 2, 1, 3).reshape(n * dim, n * dim)[np.ix_(free, free)]
            x.reshape(-1)[free] += np.linalg.solve(matrix, force.ravel()[free])
    assert np.abs(force.ravel()[free]).max() < 1e-7 * np.abs(weight).sum()
    return x


def test_a_cantilever_is_an_elastica_with_an_error_of_second_order():
    load, errors = 10.0, []
    exact = elastica(load)
    assert 0.6 < exact[1] < 0.8  # far from small angles
    for cells in (16, 32, 64):
        x = at_equilibrium(strip(cells, rows=1, dim=2, load=load))
        errors.append(np.abs(x[-1] - [1.0, 2.0] - exact).max())
    assert errors[2] < 1e-3
    assert all(3.5 < a / b < 4.5 for a, b in zip(errors[:-1], errors[1:], strict=True)), errors


def of_any_triangles(scene, columns, rows):
    """A strip (`strips.strip`) as a mesh: free particles off its borders moved at random."""
    x = scene.particles.position.copy()
    grid_x = x.reshape(rows, columns, 3)
    moved = np.random.default_rng(1).uniform(-0.25, 0.25, (rows - 2, columns - 3, 2))
    grid_x[1:-1, 2:-1, [0, 2]] += moved * (grid_x[0, 1, 0] - grid_x[0, 0, 0])
    flat = x[:, [0, 2]]
    triangles = Delaunay(flat).simplices
    one, other = (flat[triangles[:, k]] - flat[triangles[:, 0]] for k in (1, 2))
    area = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2
    triangles, area = triangles[area > 1e-9], area[area > 1e-9]
    mass = DENSITY * np.bincount(triangles.ravel(), np.repeat(area / 3, 3), len(x))
    sides = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return replace(
        scene,
        particles=replace(scene.particles, position=x, mass=mass),
        springs=Springs.build(np.unique(sides, axis=0), x, stiffness=40.0),
        stencils=mesh_stencils(x, triangles, RIGIDITY),
    )


@thorough
def test_a_cantilever_of_any_triangles_is_an_elastica():
    """Its free end is within 0.16 % of its length with 32 cells, and more bring it nearer."""
    exact = elastica(10.0)
    for cells, rows, within in ((8, 3, 0.014), (16, 5, 0.005), (32, 9, 0.002)):
        scene = of_any_triangles(strip(cells, rows, load=10.0), cells + 2, rows)
        x = at_equilibrium(scene)
        tip = x.reshape(rows, -1, 3)[:, -1, :2].mean(axis=0)
        assert np.abs(tip - [1.0, 2.0] - exact).max() < within


def lowest(scene):
    """The lowest frequency of a scene (radians a time), and its mode (n, dim)."""
    stiffness, _ = stiffness_and_damping(Network.from_scene(scene))
    values, vectors = eigsh(stiffness, 1, sigma=0.0)
    mode, free = np.zeros_like(scene.particles.position), ~scene.particles.fixed
    mode[free] = vectors[:, 0].reshape(-1, scene.world.dim)
    mode[free] /= np.sqrt(scene.particles.mass[free, None])
    return float(np.sqrt(values[0])), mode


@pytest.mark.parametrize(("mesh", "within"), [(False, 2e-3), (True, 1e-2)])
def test_a_strip_swings_as_euler_and_bernoulli_say_however_finely_it_is_divided(mesh, within):
    exact = 1.8751040687**2 * np.sqrt(RIGIDITY / DENSITY) / LENGTH**2
    found = [
        lowest(strip(cells, rows, mesh=mesh))[0] for cells, rows in ((16, 2), (32, 3), (64, 5))
    ]
    assert abs(found[2] / exact - 1) < within
    assert max(found) / min(found) < 1.03


# --- stability -------------------------------------------------------------------------------


@pytest.mark.parametrize("mesh", [False, True])
def test_the_stable_step_knows_of_bending(mesh):
    """Against the eigenvalues of differences of the twins' forces, in their own geometry."""
    scene = crumpled(5, 4, mesh, bending=400.0)
    scene = replace(scene, springs=replace(scene.springs, damping=0 * scene.springs.damping))
    particles, springs = scene.particles, scene.springs
    x, free = particles.position, np.repeat(~particles.fixed, 3)
    springs.rest_length[:] = np.linalg.norm(np.diff(x[springs.between], axis=1)[:, 0], axis=1)
    h, columns = 1e-4, []
    for unit in np.eye(x.size)[free]:
        forces = []
        for sign in (1, -1):
            moved = x + sign * h * unit.reshape(x.shape)
            total = diagnostics.spring_forces(moved, 0 * x, springs)
            total += diagnostics.stencil_forces(moved, scene.stencils, particles.fixed)
            forces.append(total.ravel()[free])
        columns.append((forces[1] - forces[0]) / (2 * h))
    largest = np.linalg.eigvalsh(np.array(columns)).max() / particles.mass[0]
    network, method = Network.from_scene(scene), methods.load("symplectic_euler")
    limit = stable_step(method, network)
    assert limit.dt == pytest.approx(2 / np.sqrt(largest), rel=1e-3)
    assert limit.bent >= 0 and "bending" in limit.describe()
    in_any, rough = any_geometry(network).omega2, gershgorin(network).omega2
    assert largest * (1 - 1e-6) < in_any <= rough < 1.6 * largest
    assert step_within(method, gershgorin(network)) <= limit.dt


# --- scenes ----------------------------------------------------------------------------------

CLOTH = """
[world]
size = [9.0, 9.0, 9.0]
[[cloths]]
origin = [1.0, 1.0, 0.0]
columns = 5
rows = 4
spacing = 0.5
bending = 2e-3
[[stencils]]
between = [5, 0, 11]
weights = [-2.0, 1.5, 0.5]
bending = 1.0
"""


def test_stencils_of_files_come_back_as_they_were():
    scene = scenefile.parse(CLOTH)
    listed, cloth = scene.stencils.select(np.arange(1)), grid_stencils(5, 4, 0.5, 2e-3)
    for name, column in vars(scene.stencils.select(np.arange(1, len(scene.stencils)))).items():
        np.testing.assert_array_equal(column, getattr(cloth, name))
    np.testing.assert_array_equal(listed.particle, [5, 0, 11])
    again = scenefile.parse(scenefile.dump(scene))
    for name, column in vars(scene.stencils).items():
        np.testing.assert_array_equal(column, getattr(again.stencils, name))


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (("bending = 2e-3", "bending = -1.0"), "line 9: .*at least 0"),
        (("bending = 2e-3", "bending = nan"), "line 9: .*bending must be finite, is nan"),
        (("[5, 0, 11]", "[5, 0, 77]"), "line 11: .*particles 0 to 19"),
        (("[5, 0, 11]", "[5, 0, 0]"), "line 11: .*twice"),
        (("[5, 0, 11]", "[5, 0]"), "line 12: .*one for each"),
        (("-2.0", "-2.5"), "line 12: .*add up to 0"),
        (("bending = 1.0", "bending = -1.0"), "line 13: .*not be negative"),
    ],
)
def test_what_is_no_stencil_is_refused_by_its_line(wrong, says):
    with pytest.raises(InputError, match=says):
        scenefile.parse(CLOTH.replace(*wrong))


def test_one_triangle_without_an_area_among_others_is_refused():
    x = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [2.0, 0.0, 0.0]]
    assert len(mesh_stencils(x, [[0, 1, 2], [1, 3, 2]], 1.0)) == 2
    with pytest.raises(InputError, match="triangle 1 has no area"):
        mesh_stencils(x, [[0, 1, 2], [0, 1, 3]], 1.0)


# --- on the device ---------------------------------------------------------------------------


def forces_of(sim):
    """The forces on all particles by the twins, with stencils found one by one: (n, dim)."""
    now = sim.storage.snapshot()
    scene, particles = now.scene, now.scene.particles
    gone = {tuple(sorted(pair)) for pair in scene.springs.between[~now.pulling].tolist()}
    kept, stencils = [], scene.stencils
    for m in range(len(stencils)):
        of = stencils.particle[stencils.start[m] : stencils.start[m + 1]].tolist()
        first = of[:1] if len(of) == 3 else of
        kept.append(not any(tuple(sorted((a, b))) in gone for a in first for b in of))
    total = particles.mass[:, None] * np.array(scene.world.gravity)
    total = total + diagnostics.spring_forces(now.x, now.v, scene.springs.select(now.pulling))
    held = stencils.select(np.array(kept))
    return total + diagnostics.stencil_forces(now.x, held, particles.fixed), np.array(kept)


@pytest.mark.parametrize(
    ("mesh", "way"),
    [
        (False, {"topology": "graph", "execution": "serial"}),
        pytest.param(False, {"topology": "lanes", "execution": "parallel"}, marks=thorough),
        pytest.param(True, {"topology": "lanes", "execution": "serial"}, marks=thorough),
        pytest.param(True, {"topology": "graph", "execution": "parallel"}, marks=thorough),
    ],
)
def test_no_force_is_left_across_a_tear(mesh, way, device):
    """While cloth tears, when it is cut, set, or a frame is undone; and however it is launched."""
    scene = crumpled(mesh=mesh, break_force=1.2)
    sim = Simulation(scene, "symplectic_euler", substeps=4, lanes=2, **way)

    def check():
        expected, kept = forces_of(sim)
        np.testing.assert_allclose(sim.storage.forces(sim.steps), expected, rtol=1e-12, atol=1e-10)
        return kept

    for _ in range(5):
        sim.advance(4)
        check()
    torn = check()
    assert torn.any() and not torn.all()
    one = sim.positions()
    sim.cut([int(np.flatnonzero(sim.springs_alive())[0])])
    check()
    sim.set(bending=35.0)
    held = check()
    sim.set(velocities=1e9 * np.eye(len(scene.particles), 3, -3))
    with pytest.raises(SimulationFailure):
        sim.advance()
    np.testing.assert_array_equal(check(), held)
    sim.load_scene(scene, None, 4)
    for _ in range(20):
        sim.advance()
    np.testing.assert_array_equal(sim.positions(), one)


def test_sweeps_leave_each_stencil_the_pull_of_where_its_particles_go(device):
    """Those of vbd follow each visit: on any number of threads, to the same bits."""
    scene, found = crumpled(mesh=True, bending=150.0), []
    for execution in ("serial", "parallel"):
        sim = Simulation(scene, "vbd", topology="graph", execution=execution, iterations=3)
        sim.advance(2)
        stencils = scene.stencils
        expected = -stencils.stiffness(scene.particles.fixed)[:, None]
        expected = expected * stencils.curvature(sim.positions())
        pulls = sim.storage.state.stencil_pull.to_numpy()[: len(stencils)]
        np.testing.assert_allclose(pulls, expected, rtol=1e-11, atol=1e-12 * np.abs(pulls).max())
        found.append((sim.positions(), pulls))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


@thorough
@pytest.mark.parametrize("mesh", [False, True])
def test_many_sweeps_over_stencils_end_at_the_solution_of_backward_euler(mesh, device):
    scene = crumpled(5, 4, mesh, bending=150.0)
    ways = ({"topology": "lanes", "execution": "parallel"}, {"topology": "graph"})
    for way in ways[mesh:]:
        exact = Simulation(scene, "implicit_euler", lanes=2, tolerance=1e-13, **way)
        exact.advance()
        assert exact.work().unconverged == 0
        moved = np.abs(exact.positions() - scene.particles.position).max()
        for method in ("xpbd", "vbd"):
            sim = Simulation(scene, method, lanes=2, iterations=8, **way)
            errors = []
            for sweeps in (8, 64, 512):
                sim.solver["iterations"] = sweeps
                sim.load_scene(scene)
                sim.advance()
                errors.append(np.abs(sim.positions() - exact.positions()).max() / moved)
            assert errors[0] > 1e-8 > 1e-9 > errors[2], (method, way, errors)


@thorough
@pytest.mark.parametrize("topology", ["lanes", "graph"])
def test_a_strip_swings_in_its_lowest_mode(topology, device):
    scene = strip(32)
    omega, mode = lowest(scene)
    start = 1e-6 * mode / np.abs(mode).max()
    moved = replace(scene.particles, position=scene.particles.position + start)
    period = 2 * np.pi / omega
    scene = replace(scene.with_world(dt=period / 8), particles=moved)
    steps = int(
        np.ceil(
            1.1 * period / 8 / stable_step(methods.load("verlet"), Network.from_scene(scene)).dt
        )
    )
    sim = Simulation(
        scene, "verlet", substeps=steps, topology=topology, execution="serial", lanes=2
    )
    for part in range(1, 9):
        sim.advance()
        expected = start * np.cos(part * np.pi / 4)
        found = sim.positions() - scene.particles.position + start
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


@thorough
@pytest.mark.parametrize("mesh", [False, True])
def test_a_strip_that_comes_to_rest_is_an_elastica(mesh, device):
    load, errors = 10.0, []
    for cells in (8, 16):
        scene = strip(cells, 2, load=load, stiffness=2e3, mesh=mesh).with_world(dt=5.0)
        sim = Simulation(scene, "implicit_euler", topology="graph", tolerance=1e-10)
        sim.advance(60)
        assert np.abs(sim.velocities()).max() < 1e-6
        tip = sim.positions().reshape(2, -1, 3)[:, -1].mean(axis=0)
        errors.append(np.abs(tip[:2] - [1.0, 2.0] - elastica(load)).max())
    assert errors[0] < 0.02 and errors[1] < (0.35 if not mesh else 0.7) * errors[0]


@thorough
def test_a_strip_hangs_alike_in_every_precision(device, cli):
    """The free end, in lengths of the strip: f32 to 2e-4, compensated to 1e-5."""
    cases = [(False, "symplectic_euler"), (True, "implicit_euler")]
    exact = np.array(tips(cases, 10.0))
    assert np.abs(exact - [1.0, 2.0] - elastica(10.0)).max() < 0.02
    for precision, within in (("f32", 2e-4), ("compensated", 1e-5)):
        found = cli.call("strips:tips_in", precision=precision, cases=cases, load=10.0)
        errors = np.abs(np.array(found) - exact).max(axis=1)
        assert errors.max() < within, (precision, errors)
        assert precision == "f32" or errors[0] < 1e-6  # which adds small changes up


def test_pairs_of_particles_in_stencils_are_found_once_and_colours_keep_them_apart():
    stencils = crumpled(mesh=True).stencils.joined(crumpled().stencils)
    expected = set()
    for m in range(len(stencils)):
        of = stencils.particle[stencils.start[m] : stencils.start[m + 1]].tolist()
        expected |= {(min(a, b), max(a, b)) for a in of for b in of if a != b}
    assert lines.pairs(stencils).tolist() == sorted(map(list, expected))
    assert lines.pairs(Stencils.none()).shape == (0, 2)
    colour = lines.colours(stencils, 7 * 6)[stencils.owner]
    assert len(np.unique(np.stack([colour, stencils.particle]), axis=1).T) == len(colour)


def test_stencils_that_are_not_there_cost_nothing():
    assert len(grid_stencils(2, 2, 1.0, 1.0)) == len(Stencils.none()) == 0
