"""The camera: the golden projections, and what must hold for every camera and pixel."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import taichi_cloth as tc
from taichi_cloth.errors import InputError
from taichi_cloth.render.camera import Camera
from taichi_cloth.render.window_map import WindowMap, default_window
from taichi_cloth.scene.model import World
from taichi_cloth.ui.chrome.layout import Parts, arrange
from taichi_cloth.ui.framing import window_of

GOLDEN = json.loads((Path(__file__).parent / "golden" / "projection.json").read_text())

angle = st.floats(-360, 360)
length = st.floats(50, 2000)
cameras = st.builds(
    lambda w, h, d, distance, focal, a, b: Camera((w, h, d), distance, focal, a, b),
    length, length, length, st.floats(300, 8000), st.floats(200, 3000), angle, angle,
)  # fmt: skip
pixels = st.tuples(st.floats(-2000, 3000), st.floats(-2000, 3000))


@pytest.mark.parametrize("row", GOLDEN["rows"])
def test_golden_projection(row):
    camera = Camera(
        GOLDEN["world_size"], row["camera_offset_z"], row["focal_len"], row["rot_x"], row["rot_y"]
    )
    pixel, radius, depth = camera.project([row["pos"]], row["radius"])
    seen = [*pixel[0], radius[0], depth[0]]
    np.testing.assert_allclose(seen, row["screen_x_y_radius_depth"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        camera.unproject(row["pixel"]), row["unprojected"], rtol=0, atol=1e-9
    )


@given(cameras, pixels)
def test_unprojected_pixels_project_back(camera, pixel):
    pixel_again, _, depth = camera.project([camera.unproject(pixel)])
    np.testing.assert_allclose(pixel_again[0], pixel, atol=1e-7)
    np.testing.assert_allclose(depth, camera.distance)


@given(cameras, pixels, st.floats(10, 5000))
def test_points_on_a_ray_share_its_pixel(camera, pixel, far):
    eye, direction = camera.ray(pixel)
    assert np.linalg.norm(direction) == pytest.approx(1)
    pixel_again, _, _ = camera.project([eye + far * direction])
    np.testing.assert_allclose(pixel_again[0], pixel, atol=1e-5)


@given(cameras, pixels)
def test_a_ray_passes_through_the_unprojected_point(camera, pixel):
    eye, direction = camera.ray(pixel)
    to_point = camera.unproject(pixel) - eye
    np.testing.assert_allclose(np.cross(to_point, direction), 0, atol=1e-6)


@given(cameras)
def test_rotation_keeps_lengths(camera):
    np.testing.assert_allclose(camera.rotation() @ camera.rotation().T, np.eye(3), atol=1e-12)


def test_rotate_and_zoom():
    camera = Camera((600, 400, 500))
    camera.rotate(10, -5)
    assert (camera.rot_y, camera.rot_x) == (25, 10)
    camera.zoom(2)
    assert camera.distance == 1000
    camera.zoom(0.5)
    assert camera.distance == 2000


@given(st.lists(st.floats(0.05, 20), max_size=30))
def test_zoom_stays_outside_the_world(factors):
    """But for a zoom to a point, which goes into it."""
    camera = Camera((600, 400, 500))
    for factor in factors:
        camera.zoom(factor)
    corner = np.linalg.norm([300, 200, 250])
    assert corner < camera.distance < 50 * corner
    camera.zoom(1e9, camera.centre)
    assert 0.09 * corner < camera.distance < 0.11 * corner


@given(cameras, pixels, st.floats(0.2, 3), st.floats(0.05, 20))
def test_what_one_comes_nearer_to_stays_where_it_is_in_the_picture(camera, pixel, far, factor):
    """And what is as deep as it grows by the factor, within the limits of the distance."""
    eye, direction = camera.ray(pixel)
    there = eye + far * camera.distance * direction
    before = camera.project([there], 1.0)
    shrinks = camera.distance
    camera.zoom(factor, there)
    shrinks /= camera.distance
    after = camera.project([there], 1.0)
    np.testing.assert_allclose(after[0], before[0], atol=1e-4)
    np.testing.assert_allclose(after[1], before[1] * shrinks, rtol=1e-9)


def test_an_eye_that_was_put_too_near_goes_from_there():
    """No nearer, and out by the factor alone, not at once to where it might have been."""
    camera = Camera((600, 400, 500))
    camera.distance = 0.5 * camera.nearest
    camera.zoom(2.0)
    assert camera.distance == 0.5 * camera.nearest
    camera.zoom(0.8)
    assert camera.distance == pytest.approx(0.625 * camera.nearest)


@pytest.mark.parametrize("y_up", [False, True])
def test_a_camera_above_a_floor_is_on_the_side_where_things_fall_from(y_up):
    """With a positive rot_x it looks down, whichever way y points."""
    for degrees in (20.0, -20.0):
        camera = Camera((600, 400, 500), rot_x=degrees, rot_y=0.0, y_up=y_up)
        away = camera.eye[1] - camera.centre[1]
        assert (away > 0) == (y_up == (degrees > 0))
        assert camera.is_above(float(camera.centre[1])) == (degrees > 0)


@given(st.integers(0, 1000))
def test_what_is_framed_fills_the_picture_and_no_more_with_what_is_around_it(seed):
    """All is within the lines of sight at the borders of what may be filled, and the first to leave
    these are as far from both, across and down.
    """
    rng, around, filled = np.random.default_rng(seed), 15.0, 0.9
    points = rng.uniform(0.0, 400.0, (20, 3))
    camera = Camera((600, 400, 500), rot_x=rng.uniform(-80, 80), rot_y=rng.uniform(-180, 180))
    camera.pose = camera.framed(points, around, filled)
    turned = camera.rotate_points(points)
    slope = filled * camera.middle / camera.focal_length
    room = slope * (camera.distance + turned[:, 2:]) - around
    right, left = room - turned[:, :2], room + turned[:, :2]
    assert right.min() > -1e-6 and left.min() > -1e-6
    assert right.min(axis=0) == pytest.approx(left.min(axis=0), abs=1e-6)


def test_zoom_refuses_nonsense():
    with pytest.raises(InputError, match="the zoom factor must be positive, is 0"):
        Camera((600, 400, 500)).zoom(0)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (lambda _: Camera(3), "Camera: world_size must be two or three lengths"),
        (lambda _: Camera((1, "b", 3)), "Camera: world_size must be numbers, is '1' at [0]"),
        (lambda _: Camera((1, 0, 3)), "Camera: world_size must be positive, is 0.0 at [1]"),
        (lambda _: Camera((1, 2, 3), "far"), "Camera: distance must be a number, is 'far'"),
        (lambda _: Camera((1, 2, 3), -4.0), "Camera: distance must be positive, is -4"),
        (lambda _: Camera((1, 2), centre=(0, 0)), "centre must have 3 numbers, has shape (2,)"),
        (lambda _: Camera((1, 2, 3), y_up=1), "Camera: y_up must be True or False, is 1"),
        (lambda camera: camera.project([[1, 2]]), "must have shape (n, 3), has shape (1, 2)"),
        (lambda camera: camera.project(None), "positions must be numbers, is None"),
        (lambda camera: camera.unproject(5), "pixel must have 2 numbers, has a single value"),
        (lambda camera: camera.rotate("x", 0), "dx_deg must be a number, is 'x'"),
        (lambda camera: setattr(camera, "pose", [0] * 6), "pose: distance must be positive, is 0"),
        (
            lambda _: tc.camera_of(World((1, 1, 1), (0, 0, 0))),
            "camera_of: must be given a Scene, is World(",
        ),
    ],
)
def test_what_a_camera_is_not_given(wrong, says):
    with pytest.raises(InputError) as refused:
        wrong(Camera((600, 400, 500)))
    assert says in str(refused.value)


sizes = st.tuples(st.integers(50, 3000), st.integers(50, 3000))


@given(sizes, sizes, pixels)
def test_layout_keeps_the_aspect_and_inverts(world, window, pixel):
    layout = WindowMap(world, window)
    np.testing.assert_allclose(layout.to_window(layout.to_world(pixel)), pixel, atol=1e-6)
    low, high = layout.to_window([0, 0]), layout.to_window(world)
    width, height = high - low
    assert width / height == pytest.approx(world[0] / world[1])
    assert (low > -1e-6).all() and (high < np.array(window) + 1e-6).all()
    assert width == pytest.approx(window[0]) or height == pytest.approx(window[1])


def test_one_pixel_is_one_unit_in_a_window_of_the_worlds_size():
    assert WindowMap((600, 400), (600, 400)).to_world((12.25, 7.5)).tolist() == [12.25, 7.5]


def test_a_worlds_window_has_its_aspect_and_room_for_what_is_around_it():
    large = {"screen": (3000, 3000)}
    assert default_window((800.0, 520.0), **large) == (1280, 832)
    assert default_window((400.0, 400.0), **large) == (1280, 1280)
    assert default_window((800.0, 520.0), around=lambda _: 60, **large) == (1280, 892)
    assert default_window(None, **large) == (1280, 800)
    parts = Parts(bar=True, strip=1)
    window = window_of(World(size=(800.0, 520.0), gravity=(0.0, 0.0)), parts, (2560, 1440))
    room = arrange(window, parts).world
    assert room.width / room.height == pytest.approx(800 / 520, rel=0.02) and room.width >= 1280


@given(st.floats(1e-3, 1e6), st.floats(1e-3, 1e6), st.integers(300, 4000), st.integers(200, 3000))
def test_default_windows_fit_a_screen(w, h, across, down):
    width, height = default_window((w, h), screen=(across, down))
    assert 0 < width <= max(across, 1) and 0 < height <= down
    assert width >= min(1280, 0.9 * across) and height >= min(800, 0.85 * down)


@given(st.integers(200, 3000), st.integers(150, 2000), st.booleans(), st.integers(0, 2))
def test_a_layout_covers_the_window_without_overlaps(width, height, bar, rows):
    parts = Parts(bar=bar, strip=rows, row="a" if bar else "", columns=("a", "b") if rows else ())
    layout = arrange((width, height), parts)
    rects = [layout.world, layout.bar, layout.strip, layout.row, *layout.columns.values()]
    rects = [rect for rect in rects if rect is not None]
    assert sum(rect.width * rect.height for rect in rects) == width * height
    for pixel in ((0, 0), (width - 1, height - 1), (width // 2, height // 2)):
        assert sum(rect.holds(pixel) for rect in rects) == 1


def test_camera_needs_no_taichi():
    code = (
        "import sys, taichi_cloth.render.camera, taichi_cloth.ui.view, taichi_cloth.ui.app;"
        "bad = {'taichi', 'matplotlib', 'imageio', 'scipy', 'rich', 'PIL'} & set(sys.modules);"
        "sys.exit(str(bad) if bad else 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
