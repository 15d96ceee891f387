"""Surfaces in pictures: what is in front, which side one sees, how bright it is."""

from dataclasses import replace

import numpy as np
import pytest
from null_view import NullView

from taichi_cloth import load_scene
from taichi_cloth.errors import InputError
from taichi_cloth.files.events import Recorder
from taichi_cloth.render import style, surfaces
from taichi_cloth.render.camera import Camera
from taichi_cloth.render.picture import Picture, Solid
from taichi_cloth.render.surfaces import Topology
from taichi_cloth.render.window_map import WindowMap
from taichi_cloth.scene import library
from taichi_cloth.scene.cloth import grid_triangles
from taichi_cloth.scene.model import Particles, Scene, World
from taichi_cloth.scene.palette import FIXED_COLOR
from taichi_cloth.settings.options import shown_parts
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.ui import app, depiction, interaction, shown
from taichi_cloth.ui.depiction import Depiction
from taichi_cloth.ui.framing import camera_of, window_of
from taichi_cloth.ui.inputs import Event
from taichi_cloth.ui.solids import creased
from taichi_cloth.ui.view import View

WORLD = World(size=(2.0, 2.0, 2.0), gravity=(0.0, 0.0, 0.0), up="y")
NO_SPRINGS = np.zeros((0, 2), np.int64)
RED, BLUE = (200, 30, 30), (30, 30, 200)


def sheet(z=0.0, n=5, size=1.0, color=RED):
    """A square around the world's centre whose front looks along +z, to who looks from there."""
    line = np.linspace(-size / 2, size / 2, n)
    y, x = np.meshgrid(line[::-1], line, indexing="ij")
    place = np.stack([x + 1, y + 1, np.full_like(x, z)], axis=-1).reshape(-1, 3)
    triangles = grid_triangles(n, n)[:, ::-1]  # across x down points to -z
    return place, triangles, np.tile(np.array(color, np.uint8), (n * n, 1))


def picture_of(*sheets, balls=(), **more):
    """A picture of sheets, and of balls (centre, radius, color)."""
    place, faces, color, first = [], [], [], 0
    for x, triangles, c in sheets:
        place, faces, color = [*place, x], [*faces, triangles + first], [*color, c]
        first += len(x)
    as_spheres = np.arange(first + len(balls)) >= first
    place += [np.array([b[0]], float) for b in balls]
    color += [np.array([b[2]], np.uint8) for b in balls]
    radius = np.array([0.01] * first + [b[1] for b in balls], np.float32)
    return Picture(
        np.concatenate(place), radius, np.concatenate(color), NO_SPRINGS,
        triangles=np.concatenate(faces), as_spheres=as_spheres, **more,
    )  # fmt: skip


def camera(rot_x=0.0, rot_y=0.0):
    """One that looks at the world's centre, from +z where nothing is turned."""
    made = Camera.framing(WORLD.size, [0.4] * 2 + [-0.6], [1.6] * 2 + [0.6], y_up=True)
    made.rot_x, made.rot_y = rot_x, rot_y
    made.centre = np.array([1.0, 1.0, 0.0])
    return made


@pytest.fixture(autouse=True)
def started(device):
    """ti.GUI needs Taichi to have been started; anew, it would take the fields of other tests."""


def pixels(picture, view_camera, size=(160, 160)):
    """The picture as ti.GUI paints it, (h, w, 3) float."""
    view = View("gui", WORLD, size)
    view.camera = view_camera
    view.draw(picture)
    image = view.grab().astype(float)
    view.close()
    return image


def icosphere(subdivisions):
    """A unit sphere's vertices (k, 3) and triangles (m, 3), counterclockwise seen from outside."""
    golden = (1 + 5**0.5) / 2
    vertex = [(s, t * golden, 0) for s in (-1, 1) for t in (-1, 1)]
    vertex = np.array(vertex + [(0, *v[:2]) for v in vertex] + [(v[1], 0, v[0]) for v in vertex])
    near = np.linalg.norm(vertex[:, None] - vertex, axis=2) < 2.1
    faces = [
        (a, b, c) for a in range(12) for b in range(a) for c in range(b)
        if near[a, b] and near[b, c] and near[a, c]
    ]  # fmt: skip
    faces = np.array([f if np.linalg.det(vertex[list(f)]) > 0 else f[::-1] for f in faces])
    for _ in range(subdivisions):
        corner = vertex[faces]
        halves = (corner + np.roll(corner, -1, axis=1)) / 2
        (a, b, c), (d, e, f) = corner.transpose(1, 0, 2), halves.transpose(1, 0, 2)
        parts = np.stack([a, d, f, d, b, e, f, e, c, d, e, f], axis=1).reshape(-1, 3)
        vertex, faces = np.unique(parts.round(12), axis=0, return_inverse=True)
        faces = faces.reshape(-1, 3)
        vertex = vertex / np.linalg.norm(vertex, axis=1, keepdims=True) * golden
    return vertex / np.linalg.norm(vertex, axis=1, keepdims=True), faces


def middle(image):
    h, w = image.shape[:2]
    return image[h // 2, w // 2]


def hue(rgb):
    """A colour without its brightness."""
    return rgb / max(rgb.max(), 1)


def test_normals_of_a_sphere_point_out():
    vertex, triangles = icosphere(3)
    topology = Topology.build(triangles)
    face = topology.face_normals(vertex)
    normal = topology.normals(vertex, face)
    assert np.abs(normal - vertex).max() < 0.02
    area = np.linalg.norm(face, axis=1).sum() / 2
    assert area == pytest.approx(4 * np.pi, rel=0.01)


def test_each_side_of_a_sheet_has_its_own_colour():
    picture = picture_of(sheet())
    front, back = (middle(pixels(picture, camera(rot_y=turn))) for turn in (0, 180))
    np.testing.assert_allclose(hue(front), hue(np.array(RED, float)), atol=0.02)
    of_back = surfaces.back_of(np.array([RED], np.uint8))[0]
    np.testing.assert_allclose(hue(back), hue(of_back.astype(float)), atol=0.02)


def test_a_back_is_no_front_in_the_shade():
    """Whatever its colour: the hues of both differ by far more than light changes them."""
    color = np.random.default_rng(3).integers(0, 256, (5000, 3)).astype(np.uint8)
    color = np.concatenate([color, np.array([style.BACKS[0], (60, 60, 60), (235, 235, 235)])])
    color = color[color.sum(axis=1) > 60]
    front, back = color.astype(float), surfaces.back_of(color).astype(float)
    apart = [np.abs(hue(a) - hue(b)).max() for a, b in zip(front, back, strict=True)]
    assert min(apart) > 0.03 and np.median(apart) > 0.1


@pytest.mark.parametrize("up", ["y", ""])
@pytest.mark.parametrize("way", [{}, {"across": [-1.0, 0.0, 0.0]}])
def test_a_cloth_of_a_file_shows_its_own_colour_to_the_camera_from_the_start(tmp_path, up, way):
    """Also one that was given the other way round; its triangles keep their corners."""
    file = tmp_path / "plain.toml"
    place = [1.5 if way else 0.5, 1.5 if up else 0.5, 0.0]
    file.write_text(
        f'[world]\nsize = [2.0, 2.0, 2.0]\nup = "{up or "none"}"\n'.replace('up = "none"\n', "")
        + f"gravity = [0.0, {-9.81 if up else 9.81}, 0.0]\n"
        "[particle]\nradius = 0.01\n"
        f"[[cloths]]\norigin = {place}\ncolumns = 6\nrows = 6\nspacing = 0.2\n"
        f"color = {list(RED)}\n" + "".join(f"{key} = {value}\n" for key, value in way.items())
    )
    scene = load_scene(file)
    sim, view = Simulation(scene), View("gui", scene.world, (300, 300))
    view.camera = camera_of(scene)
    picture = Depiction(sim).picture()
    view.draw(picture)
    drawn = view.grab().reshape(-1, 3).astype(int)
    red, lining = (drawn[:, 0] > 3 * drawn[:, 1]).sum(), (drawn[:, 0] > 100).sum()
    assert red > 0.02 * len(drawn) and lining <= red
    np.testing.assert_array_equal(sim.drawn_triangles(), grid_triangles(6, 6))
    normal = Topology.build(picture.triangles).face_normals(picture.position)
    assert (normal @ (picture.position.mean(axis=0) - view.camera.eye) < 0).all()
    corners = picture.normals[picture.triangles[:, 0]]
    assert (np.einsum("ij,ij->i", corners, normal) > 0).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_what_clicks_put_into_a_scene_in_metres_is_seen(dim):
    """Its particles are 2 mm large; what came with the scene is drawn as it is."""
    world = replace(WORLD, size=WORLD.size[:dim], gravity=WORLD.gravity[:dim])
    place = [[1.0, 1.0, 0.0][:dim], [1.2, 1.0, 0.0][:dim]]
    scene = Scene("small", world, Particles.build(place, radius=0.002))
    sim = Simulation(scene)
    sim.spawn([1.0, 1.3, 0.0][:dim], radius=0.002)
    picture = Depiction(sim).picture()
    assert picture.radius[:2] == pytest.approx([0.002] * 2)
    camera = camera_of(scene)
    scale = 400 / (camera.middle[1] * 2) if camera else 400 / 2.0
    drawn = (
        camera.project(picture.position[2:], picture.radius[2:])[1]
        if camera
        else picture.radius[2:]
    )
    assert 3.0 < float(drawn[0]) * scale < 8.0


@pytest.mark.parametrize("name", ["net", "warp", "shirt"])
def test_what_has_no_floor_floats_in_no_void(name):
    """A floor is drawn under all that is seen from the start; nothing changes in the world."""
    scene = library.build(name)
    height, camera = depiction._ground(scene), camera_of(scene)
    assert scene.world.ground is None and height < scene.particles.position[:, 1].min()
    assert camera.is_above(height)
    assert depiction._ground(library.build("flag")) == 0.0
    assert depiction._ground(library.build("cloth")) is None


@pytest.mark.parametrize("up", [1.0, -1.0])
@pytest.mark.parametrize("height", [0.5, 5.0])
def test_what_lies_level_has_its_colour_above(up, height):
    """Also a sheet that begins above the eye: it is seen from above once it has fallen."""
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, -1], [0, 0, -1]]) + [0, up * height, 0]
    rises = np.array([[0, 1, 2], [0, 2, 3]])  # counterclockwise seen from +y
    eye = np.array([0.5, up * 2.0, 4.0])
    for faces, turned in ((rises, up < 0), (rises[:, ::-1], up > 0)):
        assert (shown.turned_away(eye, flat, faces, up) == turned).all()


def test_closed_bodies_are_drawn_as_they_are():
    vertex, triangles = icosphere(2)
    both = np.concatenate([triangles, triangles[:, ::-1] + len(vertex)])
    place = np.concatenate([vertex, vertex + [3.0, 0.0, 0.0]])
    assert not shown.turned_away(np.array([0.0, 1.0, 9.0]), place, both).any()


def test_a_sheet_is_as_bright_as_the_light_says():
    """Lambert's law, turned about the vertical axis: brightest towards the light."""
    picture, brightness = picture_of(sheet()), {}
    for turn in (-60, -30, 0, 30, 60):
        view = camera(rot_y=turn)
        brightness[turn] = middle(pixels(picture, view))[0] / RED[0]
        normal = np.array([0.0, 0.0, 1.0]) @ view.rotation().T
        expected = style.AMBIENT + sum(s * max(0, normal @ light) for light, s in style.LIGHTS)
        assert brightness[turn] == pytest.approx(min(expected, 255 / RED[0]), abs=0.02)
    assert max(brightness.values()) > 1.4 * min(brightness.values())


def test_the_nearer_one_hides_the_farther_one():
    near, far = sheet(0.3, color=RED), sheet(-0.3, color=BLUE)
    for order in ((near, far), (far, near)):
        seen = middle(pixels(picture_of(*order), camera()))
        assert seen[0] > 2 * seen[2]
        seen = middle(pixels(picture_of(*order), camera(rot_y=180)))
        of_back = surfaces.back_of(np.array([BLUE], np.uint8))[0]
        np.testing.assert_allclose(hue(seen), hue(of_back.astype(float)), atol=0.02)
    ball = ((1.0, 1.0, 0.0), 0.2, (20, 220, 20))
    hidden = middle(pixels(picture_of(near, balls=[ball]), camera()))
    assert hidden[0] > 2 * hidden[1]
    before = middle(pixels(picture_of(far, balls=[ball]), camera()))
    assert before[1] > 2 * before[2]


def test_what_goes_through_a_surface_is_hidden_where_it_is_behind(device):
    """To the pixel: a sheet that another one cuts at its middle, and a line through both."""
    across = sheet(color=BLUE)
    tilted = across[0] - 1
    tilted[:, 2] = 0.8 * tilted[:, 0]  # its right half is nearer to us
    one = sheet()
    two = (tilted + 1 - [0, 0, 1], across[1], across[2])
    image = pixels(picture_of(one, two), camera())
    left, right = image[80, 60], image[80, 100]
    assert left[0] > 2 * left[2] and right[2] > 2 * right[0]
    row = image[80, 50:111]
    blue = row[:, 2] > row[:, 0]
    assert blue.sum() == pytest.approx(30, abs=2) and (np.diff(blue.astype(int)) >= 0).all()
    ends = np.array([[1.0, 1.2, -0.5], [1.0, 0.8, 0.5]])  # comes out of the sheet in its middle
    place, faces, color = one
    count = len(place)
    picture = Picture(
        np.concatenate([place, ends]), np.full(count + 2, 0.01), np.concatenate([color, color[:2]]),
        np.array([[count, count + 1]]), spring_color=(20, 220, 20), triangles=faces,
        as_spheres=np.zeros(count + 2, bool),
    )  # fmt: skip
    image = pixels(picture, camera())
    green = (image[:, 78:83, 1] > image[:, 78:83, 0] + 60).any(axis=1)
    assert not green[30:78].any() and green[84:95].all()


def test_springs_in_a_surface_are_seen_from_both_sides(device):
    place, faces, color = sheet(n=3)
    segments = np.array([[3, 4], [4, 5]])  # the middle row
    picture = Picture(
        place, np.full(9, 0.01), color, segments, spring_color=(20, 220, 20), triangles=faces,
        as_spheres=np.zeros(9, bool),
    )  # fmt: skip
    for turn in (0, 40, 180):
        image = pixels(picture, camera(rot_y=turn))
        assert (image[78:83, 80, 1] > image[78:83, 80, 0] + 60).any()


def test_what_is_held_has_the_colour_of_its_cloth_in_surfaces():
    grey, blue = style.packed_one(FIXED_COLOR), style.packed_one(BLUE)
    color = np.array([FIXED_COLOR] * 4 + [BLUE, FIXED_COLOR], np.uint8)
    fixed = np.array([True] * 4 + [False, True])
    triangles = np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4]])
    seen = style.packed(shown.surface_colors(color, fixed, triangles) / 255)
    assert seen.tolist() == [blue] * 5 + [grey]  # what is in no triangle stays grey
    assert shown.surface_colors(color, ~fixed, triangles) is color


FRAMED = [
    "curtain",
    "drape",
    "flag",
    "net",
    "pull",
    "shirt",
    "stack",
    "trampoline",
    "twist",
    "warp",
]


@pytest.mark.parametrize("name", FRAMED)
def test_scenes_fill_their_first_picture(name):
    """All of what there is, the axes at a near origin, and where it will go are in it."""
    scene = library.build(name, **({"side": 17} if name in ("net", "warp") else {}))
    x, world, view = scene.particles.position, scene.world, camera_of(scene)
    low, high = x.min(axis=0), x.max(axis=0)
    later = x[:0]
    if world.ground is not None:
        later = x * [1, 0, 1]  # it may fall there
    elif name == "warp":
        later = np.array([[low[0], -high[2], low[2]], [high[0], -high[2], low[2]]])
    elif name == "net":
        later = np.array([(low + high) / 2 - [0, 0.17 * np.ptp(x[:, 0]), 0]])
    near = [] if name == "shirt" else [np.zeros((1, 3))]
    places, _, depth = view.project(np.concatenate([x, later, *near]))
    assert (depth > view.nearest_drawn).all()
    places /= world.size[:2]
    assert (places > 0.07).all() and (places < 0.93).all()
    used = np.ptp(places, axis=0)
    assert 0.65 < used.max() < 0.85  # the rest is for obstacles and what swings


def test_where_a_sheet_is_torn_one_sees_through_it():
    place, triangles, color = sheet(n=4)
    inside = (np.abs(place[triangles].mean(axis=1)[:, :2] - 1) < 0.17).all(axis=1)
    assert inside.sum() == 2  # the cell in the middle
    whole = middle(pixels(picture_of((place, triangles, color)), camera()))
    torn = middle(pixels(picture_of((place, triangles[~inside], color)), camera()))
    np.testing.assert_allclose(torn, style.WORLD, atol=1)
    assert whole[0] > 100


def test_what_lies_on_a_solid_is_seen_and_its_far_side_is_not():
    vertex, triangles = icosphere(3)
    vertex = 0.5 * vertex.astype(float) + [1, 1, 0]
    # Seen from z > 0 the sphere's corners go round the other way in the world's axes.
    solid = Solid(vertex, triangles, np.full((len(vertex), 3), 120, np.uint8))
    before = pixels(picture_of(sheet(0.52, size=0.2), solids=solid), camera())
    behind = pixels(picture_of(sheet(-0.52, size=0.2), solids=solid), camera())
    assert middle(before)[0] > 2 * middle(before)[2]
    assert np.ptp(hue(middle(behind))) < 0.05  # grey
    covered = (np.abs(behind - np.array(style.WORLD)).max(axis=2) > 8).mean()
    far = pixels(picture_of(sheet(9.0), solids=solid), camera())  # the sheet is behind the eye
    assert covered == pytest.approx((np.abs(far - style.WORLD).max(axis=2) > 8).mean(), abs=0.01)


def test_a_floor_is_below_what_stands_on_it():
    view = camera(rot_x=20)
    image = pixels(picture_of(sheet(size=0.2), ground=0.6), view)
    pixel = WindowMap(WORLD.size[:2], (160, 160)).to_window(view.project([[1.0, 0.6, 0.0]])[0])[0]
    x, y = np.round(pixel).astype(int)
    lit = image[y - 3 : y + 3, x - 3 : x + 3].mean(axis=(0, 1))
    assert (lit > np.array(style.WORLD) + 5).all()
    np.testing.assert_allclose(image[2, 80], style.WORLD, atol=2)  # above the horizon
    below = pixels(picture_of(sheet(9.0), ground=0.6), camera(rot_x=-20))
    np.testing.assert_allclose(below, np.broadcast_to(style.WORLD, below.shape), atol=2)


@pytest.mark.parametrize("size", [(2.0, 1.0, 3.0), (40.0, 90.0, 10.0)])
def test_a_camera_frames_what_there_is_with_y_up(size):
    world = World(size=size, gravity=(0.0, -9.8, 0.0), up="y")
    random = np.random.default_rng(1)
    place = np.array(size) * (0.4 + 0.2 * random.random((50, 3)) - [0, 0, 0.5])
    view = camera_of(Scene("s", world, Particles.build(place, radius=0.01 * min(size))))
    shown_pixels, _, depth = view.project(place)
    assert (depth > view.nearest_drawn).all()
    assert (shown_pixels >= 0).all() and (shown_pixels <= size[:2]).all()
    used = np.ptp(shown_pixels, axis=0) / size[:2]
    assert used.max() > 0.35  # and they fill the picture
    higher = view.project([view.centre, view.centre + [0, 0.1, 0]])[0]
    assert higher[1, 1] < higher[0, 1]
    nearer = view.project([view.centre, view.centre + [0, 0, 0.1]])[2]
    assert nearer[1] < nearer[0]
    assert max(window_of(world)) >= 720


def test_what_is_sharp_looks_sharp_and_what_is_round_round():
    corner = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    hull = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    hull += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    vertex, faces = creased(corner, np.array(hull))
    topology = Topology.build(faces)
    face = topology.face_normals(vertex)
    normal = topology.normals(vertex, face)
    for k in range(3):  # a cube's corners have the normals of their faces
        np.testing.assert_allclose(normal[faces[:, k]], face, atol=1e-12)
    np.testing.assert_array_equal(vertex[faces], corner[np.array(hull)])
    ball, round_faces = icosphere(2)
    assert len(creased(ball, round_faces)[0]) == len(ball)


def test_what_stands_still_is_kept_and_what_moves_is_wiped_away():
    """A floor, a solid and edges are drawn once and kept: nobody sees when that happens."""
    vertex, triangles = icosphere(2)
    grey = np.full((len(vertex), 3), 120, np.uint8)
    solid = Solid(0.3 * vertex.astype(float) + [1, 0.9, -0.1], triangles, grey)
    ball = ((1.2, 1.0, 0.3), 0.2, (20, 220, 20))
    one = picture_of(sheet(0.4), balls=[ball], solids=solid, ground=0.4)
    other = picture_of(sheet(0.7, size=0.3), solids=solid, ground=0.4)
    view = View("gui", WORLD, (150, 131))
    view.camera = camera(rot_x=20)

    def seen(picture, turn=0.0):
        view.camera.rot_y = turn
        view.draw(picture)
        return view.grab()

    first = seen(one)
    for picture, turn in ((one, 0.0), (other, 0.0), (other, 30.0), (other, 30.0), (one, 30.0)):
        seen(picture, turn)
    np.testing.assert_array_equal(seen(one), first)
    np.testing.assert_array_equal(seen(one), first)
    moved = replace(one, solids=Solid(solid.vertex + [0.3, 0, 0], triangles, grey))
    assert (seen(moved) != first).any()
    view.close()


TWO_STARTS = """
import weakref
import taichi as ti
from taichi.lang import impl
from taichi_cloth import runtime
from taichi_cloth.render.rasterizer import Image

runtime.start()
ti.root.dense(ti.i, 8).place(ti.field(ti.f32))
tree = ti.FieldsBuilder()
tree.place(ti.field(ti.f32))
tree = tree.finalize()
vars(tree)  # by which it has a dictionary of its own, as on Python 3.10
before, program = Image(ti.i32, 32, 64), weakref.ref(impl.get_runtime().prog)
runtime.start(threads=1)
print(program())  # whoever holds it still, its memory is given back before other is taken
color = Image(ti.i32, 32, 64)
before.arr = color.arr  # memory is given anew where what was there is gone
del before
color.fill(-1)
print(set(color.to_numpy().ravel().tolist()))
"""


def test_what_was_made_before_a_new_start_leaves_what_is_drawn_after_it_alone(cli):
    """Python drops it at any time; Taichi would free what lies now where it lay."""
    assert cli.call("commands:printed_by", program=TWO_STARTS).split() == ["None", "{-1}"]


def test_an_upright_plane_has_y_up():
    window = WindowMap.of(World(size=(4.0, 2.0), gravity=(0.0, -1.0), up="y"), (400, 300))
    points = np.array([[0.0, 0.0], [1.0, 1.5]])
    assert window.to_window(points).tolist() == [[0, 250], [100, 100]]
    np.testing.assert_allclose(window.to_world(window.to_window(points)), points)


def test_what_lies_in_no_surface_stays_seen():
    """A cell, a ball, and a thread from the cell's corner to the ball."""
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    segments = np.array([[0, 1], [1, 2], [2, 4]])

    def of(text):
        return shown.chosen(shown_parts(text), triangles, segments, 5)

    faces, springs, spheres = of("surface")
    assert faces is triangles
    assert springs.tolist() == [[2, 4]] and spheres.tolist() == [False] * 4 + [True]
    faces, springs, spheres = of("surface, springs")
    assert len(springs) == 3 and spheres.tolist() == [False] * 4 + [True]
    faces, springs, spheres = of("springs,particles")
    assert len(faces) == 0 and springs is segments and spheres is None
    faces, springs, spheres = of("particles")
    assert len(faces) == len(springs) == 0 and spheres is None
    faces, springs, spheres = of("springs")
    assert springs is segments and not spheres.any()
    with pytest.raises(InputError, match="--show: unknown word 'spring'; did you mean 'springs'"):
        shown_parts("spring")


def test_d_goes_through_what_is_drawn_also_in_a_replay(pool, tmp_path):
    """Pressed at frames 1 and 2 in a window; its log shows the same in another one."""

    class Watched(NullView):
        visible = True

        def __init__(self, world, keys):
            super().__init__(world)
            self.keys, self.seen = list(keys), []

        def poll(self):
            return [Event("press", key=key) for key in filter(None, [self.keys.pop(0)])]

        def draw(self, picture):
            balls = picture.as_spheres is None
            self.seen.append((len(picture.triangles) > 0, len(picture.segments) > 0, balls))

    scene = library.build("cloth", columns=4, rows=3)
    pressed = Watched(scene.world, [None, "d", "d", None])
    recorder = Recorder(tmp_path / "log.jsonl")
    sim = pool(scene)
    recorder.write_header(app.log_header(sim, pressed))
    app.run(sim, pressed, frames=4, recorder=recorder, quiet=True, device="cpu")
    recorder.close()
    springs, surface, both = (False, True, True), (True, False, False), (True, True, False)
    assert pressed.seen[:5] == [springs, springs, surface, both, both]
    replayed = Watched(scene.world, [None] * 4)
    log = interaction.load(tmp_path / "log.jsonl")
    app.run(pool(scene), replayed, frames=4, replay=log, quiet=True, device="cpu")
    assert replayed.seen[:4] == pressed.seen[:4]
    asked = Watched(scene.world, [None])
    app.run(pool(scene), asked, frames=1, show=shown_parts("surface,springs"), device="cpu")
    assert asked.seen[0] == both
