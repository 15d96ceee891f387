"""Obstacles thinner than what a step moves, than a face's side, or than a grid's cells."""

import re

import numpy as np
import pytest
from selection import as_thorough, thorough

from taichi_cloth.kernels import mesh_thickness
from taichi_cloth.kernels.faces import LEAST_ROOM
from taichi_cloth.kernels.mesh_thickness import sampled
from taichi_cloth.kernels.obstacles import mesh as mesh_shape
from taichi_cloth.kernels.obstacles.contract import turned
from taichi_cloth.scene.cloth import grid_triangles
from taichi_cloth.scene.model import Particles, Scene, Springs, World
from taichi_cloth.scene.obstacles import Obstacle, fault
from taichi_cloth.scene.solids import solids
from taichi_cloth.scene.stencils import mesh_stencils
from taichi_cloth.simulation.simulation import Simulation

SIDE = 0.05
FACES = grid_triangles(2, 2)
SHARED = [sorted(set(FACES[0]) & set(FACES[1]))]  # the ends of the side that both faces have
THIN = (2e-3, 1e-3, 1e-4)  # of a side: from a tenth of LEAST_ROOM on down


def thin_thing(shape, half):
    """A rod along x, or a plate, whose surface is `half` above 1."""
    if shape == "capsule":
        return Obstacle.build("capsule", ends=[[4.0, 1.0, 0.0], [6.0, 1.0, 0.0]], radius=half)
    return Obstacle.build("box", centre=[5.0, 1.0, 0.0], half=[1.0, half, half])


def falling_square(obstacle, speed, dt):
    """Two faces without forces that come down, level, with their middle over what is in the way.

    The rod runs between their corners, across the side that both have.
    """
    at = [[4.99, 1.0, -0.025], [5.04, 1.0, -0.025], [4.99, 1.0, 0.025], [5.04, 1.0, 0.025]]
    square = Particles.build(np.array(at) + [0.0, 0.3 * SIDE, 0.0], mass=0.001, radius=0.0)
    square.velocity[:, 1] = -speed
    world = World((10.0, 10.0, 10.0), (0.0, 0.0, 0.0), dt=dt, up="y", contact="resting")
    of = {"triangles": FACES, "obstacles": (obstacle,)}
    return Scene("square", world, square, Springs.none(), **of)


def heights_over_the_line(x):
    """How high above its middle line the sides are that cross what is in the way."""
    found = []
    for a, b in ((0, 2), (1, 3), *SHARED):
        (y, z), (to_y, to_z) = x[a, 1:] - [1.0, 0.0], x[b, 1:] - [1.0, 0.0]
        found.append(y - z * (to_y - y) / (to_z - z) if z * to_z < 0 else np.inf)
    return found


@pytest.mark.parametrize("shape", ["capsule", "box"])
def test_a_face_does_not_pass_what_is_thinner_than_it_moves_in_a_step(device, shape):
    """However little of its side it moves, and however many thicknesses; what goes several sides
    in a step may be left in it, and is counted.
    """
    sim = None
    for part in THIN:
        for way in (0.5 * part, 3.0 * part, 0.4 * LEAST_ROOM, 0.3, 3.0):
            half, dt = 0.5 * part * SIDE, 1 / 960
            scene = falling_square(thin_thing(shape, half), way * SIDE / dt, dt)
            sim = sim or Simulation(scene, substeps=1, topology="graph", execution="serial")
            sim.load_scene(scene)
            sim.advance(int(0.3 / way) + 1 + (way < 0.1))
            over = heights_over_the_line(sim.positions())
            counted = sim.unsettled_faces() > 0
            assert min(over) > 0.9 * half or (way > 1.0 and counted), (part, way, over)
            assert not counted or way > 1.0


def hung(kind, radius):
    """A scene of 9 particles in a row, or such rows as a mesh, that fall over a rod."""
    at = np.arange(9) * 0.03125 - 0.1365
    keys = {"dt": 1 / 60, "up": "y", "contact": "resting"}
    if kind == "chain in a plane":
        x = np.column_stack([10.0 + at, np.full(9, 20.05)])
        springs = Springs.build([[n, n + 1] for n in range(8)], x, stiffness=2000.0)
        rod = Obstacle.build("sphere", centre=[10.0, 20.0], radius=radius)
        world = World((20.0, 40.0), (0.0, -9.81), **keys)
        chain = Particles.build(x, mass=0.01, radius=0.0)
        return Scene("chain", world, chain, springs, obstacles=(rod,))
    across, along = np.meshgrid(at, at)
    x = np.column_stack([10.0 + across.ravel(), np.full(81, 20.05), along.ravel()])
    faces = grid_triangles(9, 9)
    ends = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    rod = Obstacle.build("capsule", ends=[[10.0, 20.0, -1.0], [10.0, 20.0, 1.0]], radius=radius)
    return Scene(
        "sheet",
        World((20.0, 40.0, 20.0), (0.0, -9.81, 0.0), **keys),
        Particles.build(x, mass=2e-4, radius=0.0),
        Springs.build(ends, x, stiffness=20.0, damping=2e-3),
        triangles=faces,
        stencils=mesh_stencils(x, faces, 1e-4),
        obstacles=(rod,),
    )


@thorough
@pytest.mark.parametrize("kind", ["chain in a plane", "mesh"])
def test_what_hangs_over_a_rod_of_a_thousandth_of_a_spacing_stays_there(device, kind):
    """The angle of each row around the rod would fall by a whole turn if it went through."""
    scene = hung(kind, 1.6e-5)
    for substeps in (8, 16, 64, 256):
        sim = Simulation(scene, substeps=substeps, topology="graph", execution="serial")
        before = None
        for _ in range(24):
            sim.advance()
            away = (sim.positions()[:, :2] - [10.0, 20.0]).reshape(-1, 9, 2)
            angle = np.arctan2(away[..., 1], away[..., 0])
            turn = np.abs(((np.diff(angle, axis=1) + np.pi) % (2 * np.pi) - np.pi).sum(axis=1))
            passed = before is not None and np.abs(turn - before).max() > np.pi
            assert not passed or sim.unsettled_faces() > 0, (substeps, sim.frame)
            before = turn
        assert turn.min() > np.pi, "it hangs down on both sides"


def table(top, turn=0.0, foot=0.06, end=-0.4):
    """A closed mesh: a plate of 1 m on a foot, whose top is as thick as that [length].

    foot: half of its width; end: how high its end is.
    """
    x = [-0.5, -0.5, -foot, -foot, foot, foot, 0.5, 0.5]
    y = [0.0, -top, -top, end, end, -top, -top, 0.0]
    ring = np.column_stack([x, y])
    vertices = np.vstack([np.column_stack([ring, np.full(8, z)]) for z in (-0.5, 0.5)])
    cut = np.array([[0, 1, 2], [0, 2, 5], [2, 3, 4], [2, 4, 5], [0, 5, 7], [5, 6, 7]])
    sides = [[k, (k + 1) % 8, k + 8] for k in range(8)]
    sides += [[(k + 1) % 8, (k + 1) % 8 + 8, k + 8] for k in range(8)]
    faces = np.vstack([cut[:, ::-1], cut + 8, sides])
    return {"vertices": vertices @ turned([turn, 0.3 * turn, 2.0 * turn], 3).T, "faces": faces}


@pytest.mark.parametrize("turn", [0.0, as_thorough(17.0)])
def test_cells_of_a_mesh_are_as_small_as_its_thinnest_part_asks(turn):
    """The zero of the field is then within a tenth of the thickness, and its middle inside."""
    top = 0.026  # less than the 32nd of a side that cells are without a reason
    mesh = Obstacle.build("mesh", **table(top, turn))
    assert fault(mesh, 3) is None
    scene = falling_square(mesh, 1.0, 1e-3)
    placed = solids(scene)[0].placed
    assert placed.cell < 0.75 * top and placed.nodes[..., 0].size < mesh_shape.MOST_CHOSEN
    at = np.random.default_rng(1).uniform([-0.45, 0.0, -0.45], [0.45, 0.0, 0.45], (2000, 3))
    at = at[np.abs(at[:, 0]) > 0.1]
    for depth in (0.0, top / 2, top):
        points = (at - [0.0, depth, 0.0]) @ turned([turn, 0.3 * turn, 2.0 * turn], 3).T
        d, _ = mesh_shape.twin(placed, points)
        if depth == top / 2:
            assert d.max() < -0.1 * top
        else:
            assert np.abs(d).max() < 0.1 * top
    thick = {name: values for name, values in table(0.2).items()}
    placed = solids(falling_square(Obstacle.build("mesh", **thick), 1.0, 1e-3))[0].placed
    assert placed.cell == 1.0 / mesh_shape.CELLS  # as it always was


def test_a_mesh_too_thin_for_any_grid_is_refused_by_its_place():
    thin = table(0.005)
    key, words = fault(Obstacle.build("mesh", **thin, centre=[10.0, 1.0, 0.0]), 3)
    place = np.array(re.search(r"thick at \((.*?)\)", words)[1].split(","), float)
    assert key == "cell" and "0.005 thick" in words and "an obstacle of its own" in words
    assert 9.5 < place[0] < 10.5 and 0.994 < place[1] < 1.001 and abs(place[2]) < 0.5
    key, words = fault(Obstacle.build("mesh", **table(0.02), cell=0.02), 3)
    assert key == "cell" and "cells of 0.02 lose" in words and "leave cell out" in words
    assert fault(Obstacle.build("mesh", **table(0.02), cell=0.02, least=0.03), 3) is None
    least = float(re.search(r"least = ([\d.]+)", fault(Obstacle.build("mesh", **thin), 3)[1])[1])
    assert fault(Obstacle.build("mesh", **thin, least=least), 3) is None


@pytest.mark.parametrize("inside_out", [False, True])
def test_the_thickness_of_a_mesh_is_that_between_its_sides(inside_out):
    """Of a table by its plate and its foot, whichever way its faces are turned."""
    mesh = table(0.02)
    faces = mesh["faces"][:, ::-1] if inside_out else mesh["faces"]
    found = sampled(mesh["vertices"][faces])
    top = np.abs(found.points[:, 1]) < 1e-9
    over_foot = np.abs(found.points[:, 0]) < 0.055
    np.testing.assert_allclose(found.inwards[top], [[0.0, -1.0, 0.0]] * top.sum(), atol=1e-12)
    away = np.abs(found.points[:, 0]) > 0.065
    np.testing.assert_allclose(found.thickness[top & away], 0.02, rtol=2e-2)
    np.testing.assert_allclose(found.thickness[top & over_foot], 0.4, rtol=2e-2)


def body_with_a_fin(thick, **more):
    """A body of 0.5 x 1.7 x 0.3 with a fin of 60 mm below it, as thick as that [length]."""
    mesh = table(1.7, foot=thick, end=-1.76)
    vertices = mesh["vertices"] * [0.5, 1.0, 0.3]
    return Obstacle.build("mesh", vertices=vertices, faces=mesh["faces"], **more)


def test_a_fin_that_a_grid_can_meet_is_met_and_not_taken_for_a_tip():
    """It ends nearer to the body than a cell of the usual width, but does not get thicker."""
    fin = body_with_a_fin(0.014)
    assert fault(fin, 3) is None
    placed = solids(falling_square(fin, 1.0, 1e-3))[0].placed
    assert placed.nodes[..., 0].size < mesh_shape.MOST_CHOSEN
    low, high = [0.0, -1.75, -0.14], [0.0, -1.72, 0.14]
    middle = np.random.default_rng(1).uniform(low, high, (500, 3))
    for side in (-0.007, 0.007):
        d, _ = mesh_shape.twin(placed, middle + [side, 0.0, 0.0])
        assert np.abs(d).max() < 0.1 * 0.014
    assert mesh_shape.twin(placed, middle)[0].max() < -0.2 * 0.014


def test_however_small_a_part_is_that_no_grid_meets_it_is_named_and_refused():
    """As the fingers of a body; the line says from which `least` on the rest is taken."""
    key, says = fault(body_with_a_fin(0.005), 3)
    thick, place = re.search(r"the mesh is ([\d.]+) thick at \((.*?)\)", says).groups()
    assert key == "cell" and float(thick) == pytest.approx(0.005, rel=2e-2)
    assert -1.76 <= float(place.split(",")[1]) < -1.7
    least = float(re.search(r"least = ([\d.]+)", says)[1])
    assert least > 0.005 and fault(body_with_a_fin(0.005, least=least), 3) is None


def test_what_tapers_off_is_no_thin_part():
    """A cone of 28 degrees ends in a tip that no grid has: it stays as round as a cell."""
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    rim = np.column_stack([0.25 * np.cos(angle), np.zeros(24), 0.25 * np.sin(angle)])
    k = np.arange(24)
    sides = np.column_stack([k, (k + 1) % 24, np.full(24, 24)])
    base = np.column_stack([(k + 1) % 24, k, np.full(24, 25)])
    vertices, faces = np.vstack([rim, [[0, 1.0, 0], [0, 0, 0]]]), np.vstack([sides, base])
    cone = Obstacle.build("mesh", vertices=vertices, faces=faces)
    assert fault(cone, 3) is None
    placed = solids(falling_square(cone, 1.0, 1e-3))[0].placed
    assert placed.cell == 1.0 / mesh_shape.CELLS


def test_a_mesh_is_checked_and_placed_by_one_grid(monkeypatch):
    """But where balls need more room around it than its check does."""
    built, build = [], mesh_shape._grid
    monkeypatch.setattr(mesh_shape, "_grid", lambda *given: built.append(given) or build(*given))
    mesh_shape._fitted.cache_clear()
    values = {**table(0.13, 11.0), "least": 0.0, "scale": 1.0, "turn": np.zeros(3)}
    values |= dict.fromkeys(("file", "cell", "centre"))
    assert mesh_shape.refusal(values) is None
    near = mesh_shape.place(values, 3, 0.01)
    assert len(built) == 1
    wide = mesh_shape.place(values, 3, 0.2)
    assert len(built) == 2 and wide.sizes[0] >= 0.2 and wide.cell == near.cell


def test_rays_cross_what_every_face_tested_says():
    """Bins and a look at balls around faces leave no crossing out."""
    rng = np.random.default_rng(3)
    mesh = table(0.02, 23.0)
    corners = mesh["vertices"][mesh["faces"]]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    points, ways = rng.uniform(low, high, (300, 3)), rng.standard_normal((300, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    nearest, which, crossings = mesh_thickness._Bins(corners).crossed(points, ways)
    ray, face = (row.ravel() for row in np.indices((len(points), len(corners))))
    t, hit = mesh_thickness._met(points[ray], ways[ray], corners[face])
    t = np.where(hit & (t > 0), t, np.inf).reshape(len(points), -1)
    np.testing.assert_array_equal(crossings, np.isfinite(t).sum(axis=1))
    np.testing.assert_array_equal(nearest, t.min(axis=1))
    met = np.isfinite(nearest)
    assert 50 < met.sum() < 250 and (which[met] == t[met].argmin(axis=1)).all()
