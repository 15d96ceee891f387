"""Scene files: what they mean, and that a scene survives being written and read back."""

import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import small
from hypothesis import given, settings
from hypothesis import strategies as st

from taichi_cloth.errors import InputError
from taichi_cloth.kernels import obstacles as kinds
from taichi_cloth.kernels.obstacles.contract import COMMON
from taichi_cloth.scene import library, obstacles, scenefile, tables
from taichi_cloth.scene.assignments import read
from taichi_cloth.scene.checks import validate
from taichi_cloth.scene.cloth import grid, grid_triangles
from taichi_cloth.scene.model import (
    MOUSE_MODES,
    WALLS,
    ParticleDefaults,
    Particles,
    Scene,
    SpringDefaults,
    Springs,
    World,
)
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.scene.palette import FABRIC_COLOR, FIXED_COLOR
from taichi_cloth.scene.properties import BREAK_IN, PARTICLE_PROPERTIES, SPRING_PROPERTIES
from taichi_cloth.scene.triangles import springs_of_sides
from taichi_cloth.scene.world_keys import world_keys
from taichi_cloth.simulation import editing
from taichi_cloth.simulation.saved import digest
from taichi_cloth.simulation.snapshot import Snapshot

DOCUMENT = Path(__file__).parent.parent / "docs/scenes.md"
EXAMPLE = """
name = "box"
[world]
size = [600.0, 400.0, 500.0]
gravity = [0.0, 0.1, 0.0]
dt = 1.0
walls = ["top", "bottom", "left", "right", "front", "back"]
collisions = true
mouse = "spawn"
[particle]
mass = 10.0
radius = 30.0
viscous = 0.01
restitution = 0.95
[spring]
stiffness = 0.01
rest_length = 20.0
break_force = 5.0
damping = 0.0
[[particles]]
position = [100.0, 100.0, 0.0]
velocity = [3.0, -2.0, 1.0]
fixed = false
[[springs]]
between = [0, 1]
[[cloths]]
origin = [100.0, 20.0, -100.0]
columns = 16
rows = 12
spacing = 25.0
pinned = [[0, 0], [8, 0], [15, 0]]
links = ["structural"]
across = [1.0, 0.0, 0.0]
down = [0.0, 0.0, 1.0]
stiffness = { structural = 0.5 }
"""
# In space: air, contacts that end a step, materials, obstacles of each kind of key.
IN_SPACE = """
triangles = [[0, 1, 2]]
[world]
size = [4.0, 4.0, 4.0]
up = "y"
gravity = [0.0, -9.81, 0.0]
walls = ["bottom"]
ground = 0.1
friction = 0.4
contact = "resting"
air = { density = 1.2, drag = 1.0, lift = 0.6 }
[world.wind]
velocity = [3.0, 0.0, 1.0]
gust = 0.4
period = 2.0
seed = 1
[particle]
thickness = 0.01
[spring]
break_in = "tension"
[[stencils]]
between = [1, 0, 2]
weights = [-2.0, 1.0, 1.0]
bending = 2e-5
[[cloths]]
origin = [1.0, 2.0, 0.0]
columns = 4
rows = 3
spacing = 0.1
links = ["structural", "shear"]
density = 0.15
thickness = 0.004
stretch = 80.0
shear = 20.0
damping_time = 0.001
strength = 30.0
bending = 2e-5
[[obstacles]]
shape = "sphere"
centre = [1.0, 0.5, 0.0]
radius = 0.3
friction = 0.4
restitution = 0.5
velocity = [0.1, 0.0, 0.0]
spin = [0.0, 180.0, 0.0]
starts = 0.5
stops = 2.0
grip = 0.02
[[obstacles]]
shape = "box"
centre = [1.0, 0.5, 0.0]
half = [0.1, 0.2, 0.3]
turn = [0.0, 90.0, 0.0]
[[obstacles]]
shape = "capsule"
ends = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
radius = 0.1
[[obstacles]]
shape = "plane"
point = [0.0, 0.0, 0.0]
normal = [0.0, 1.0, 0.0]
[[obstacles]]
shape = "mesh"
vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
centre = [1.0, 1.0, 0.0]
scale = 0.5
cell = 0.1
"""


def assert_same_scene(a: Scene, b: Scene):
    """Equal in every value, bit for bit."""
    assert (a.name, a.particle_defaults, a.spring_defaults) == (
        b.name,
        b.particle_defaults,
        b.spring_defaults,
    )
    assert a.world == b.world and a.spring_color == b.spring_color
    for part in ("particles", "springs"):
        for f in fields(getattr(a, part)):
            one, other = getattr(getattr(a, part), f.name), getattr(getattr(b, part), f.name)
            assert one.dtype == other.dtype, f.name
            np.testing.assert_array_equal(one, other, err_msg=f.name)


def test_the_example_of_the_design_means_what_it_says():
    scene = scenefile.parse(EXAMPLE)
    assert scene.name == "box"
    assert scene.world == World(
        (600.0, 400.0, 500.0),
        (0.0, 0.1, 0.0),
        1.0,
        ("top", "bottom", "left", "right", "front", "back"),
        True,
        "spawn",
    )
    assert len(scene.particles) == 1 + 16 * 12
    assert (scene.particles.mass == 10).all() and (scene.particles.restitution == 0.95).all()
    np.testing.assert_array_equal(scene.particles.velocity[0], (3, -2, 1))
    np.testing.assert_array_equal(np.flatnonzero(scene.particles.fixed), (1, 9, 16))
    # The cloth's second particle is across, its second row down.
    np.testing.assert_array_equal(scene.particles.position[2], (125, 20, -100))
    np.testing.assert_array_equal(scene.particles.position[17], (100, 20, -75))
    assert len(scene.springs) == 1 + 356
    np.testing.assert_array_equal(scene.springs.stiffness[:2], (0.01, 0.5))
    assert (scene.springs.break_force == 5).all() and (scene.springs.rest_length == 20).all()


EVERY_TABLE = """
triangles = [[0, 1, 2]]
[world]
size = [4.0, 4.0, 4.0]
ground = 0.0
air = { density = 1.0 }
wind = { velocity = [1.0, 0.0, 0.0] }
[particle]
[spring]
[[particles]]
position = [0.0, 1.0, 0.0]
[[particles]]
position = [1.0, 1.0, 0.0]
[[particles]]
position = [1.0, 2.0, 0.0]
[[springs]]
between = [0, 1]
[[stencils]]
between = [0, 1, 2]
weights = [1.0, -2.0, 1.0]
bending = 1.0
[[cloths]]
origin = [0.0, 1.0, 1.0]
columns = 3
rows = 3
spacing = 0.1
[[meshes]]
file = "leaf.obj"
"""


def test_values_are_refused_in_the_words_of_the_file(tmp_path):
    """Whatever is refused: a message has true and { a = 1 }, never True or a dict of Python's."""
    (tmp_path / "leaf.obj").write_text("v 0 1 0\nv 1 1 0\nv 0 2 0\nf 1 2 3\n")
    scenefile.parse(EVERY_TABLE, folder=tmp_path)
    names = [name for name in tables.TABLES if name not in ("", "world", "particle", "spring")]
    keys = [f"{name}[0].{key}" for name in names for key in tables.TABLES[name]]
    keys += [f"{name}.{key}" for name in ("particle", "spring") for key in tables.TABLES[name]]
    keys += [f"world.{key}" for key in (*tables.TABLES["world"], *world_keys())]
    keys += [f"world.{key}.{part}" for key, of in world_keys().items() for part in of.table or ()]
    keys += ["cloths[0].stiffness.shear", *tables.TABLES[""]]
    refused = [(EVERY_TABLE, key) for key in keys if not key.startswith("obstacles[")]
    at = {key: "[1, 1, 1]" for key in ("centre", "half", "point", "normal")}
    at |= {"radius": "1", "ends": "[[0, 0, 0], [1, 1, 1]]", "file": "'leaf.obj'"}
    for shape in kinds.SHAPES:
        known = obstacles.keys_of(shape)
        given = [f"shape = '{shape}'", *(f"{key} = {at[key]}" for key in at if key in known)]
        text = "\n".join(["[world]", "size = [4, 4, 4]", "[[obstacles]]", *given])
        refused += [(text, f"obstacles[0].{key}") for key in known]
    said = {}
    for text, key in refused:
        for value in ("true", "[true, 1]", "{ a = [false] }"):
            try:
                scenefile.parse(text, "a.toml", assignments=[read(f"{key}={value}")])
            except InputError as error:
                said[key, value] = str(error)
    assert said["obstacles[0].radius", "[true, 1]"].endswith("is the list [true, 1]")
    assert len(said) > 2 * len(refused)  # all that is no value of its key
    python = re.compile(r"\b(True|False|None)\b|\{'|'\}|\(\(")
    assert not {case: words for case, words in said.items() if python.search(words)}


def test_a_cloth_in_a_file_is_the_built_in_cloth():
    text = """
    name = "cloth"
    [world]
    size = [600, 400]
    gravity = [0, 0.05]
    walls = true
    mouse = "blow"
    [particle]
    viscous = 0.05
    restitution = 0
    [spring]
    stiffness = 0.5
    rest_length = 25
    break_force = 5
    color = [255, 255, 255]
    [[cloths]]
    origin = [100, 20]
    columns = 16
    rows = 12
    spacing = 25
    pinned = [[0, 0], [8, 0], [15, 0]]
    """
    read, built = scenefile.parse(text), library.build("cloth")
    assert set(read.world.walls) == set(built.world.walls)
    assert_same_scene(read.with_world(walls=built.world.walls), built)


def test_cloths_and_meshes_have_colours_of_their_own(tmp_path):
    (tmp_path / "leaf.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    cloth = "[[cloths]]\norigin = [1, 1, 0]\ncolumns = 2\nrows = 2\nspacing = 1\n"
    file = tmp_path / "two.toml"
    file.write_text(
        "[world]\nsize = [9, 9, 9]\n"
        + (cloth + "pinned = [[0, 0]]\ncolor = [9, 8, 7]\n" + cloth)
        + "[[meshes]]\nfile = 'leaf.obj'\nmove = [4, 4, 0]\ncolor = [1, 2, 3]\n"
    )
    color = scenefile.load(file).particles.color
    assert color[:4].tolist() == [list(FIXED_COLOR)] + [[9, 8, 7]] * 3
    assert (color[4:8] == FABRIC_COLOR).all() and (color[8:] == (1, 2, 3)).all()
    file.write_text(file.read_text().replace("[1, 2, 3]", "[1, 2, 300]"))
    with pytest.raises(InputError, match=r"line 18: .*color"):
        scenefile.load(file)


def test_links_are_numbered_particle_by_particle():
    """Against the numbering spelled out as a loop."""
    columns, rows = 4, 3
    expected = []
    offsets = [(-1, 0), (0, -1), (-1, -1), (1, -1), (-2, 0), (0, -2)]
    for row in range(rows):
        for column in range(columns):
            for dc, dr in offsets:
                if 0 <= column + dc < columns and row + dr >= 0:
                    here = row * columns + column
                    expected.append((here, here + dr * columns + dc))
    _, springs = grid((0, 0), columns, rows, 2.0, links=("bend", "structural", "shear"))
    np.testing.assert_array_equal(springs.between, expected)


def test_rest_lengths_and_forces_of_links_follow_their_kind():
    particles, springs = grid(
        (0, 0, 0),
        5,
        4,
        2.0,
        links=("structural", "shear", "bend"),
        across=(3, 0, 0),
        down=(0, 0, 5),
        spring_defaults=SpringDefaults(stiffness=7.0, damping=0.5),
        stiffness={"shear": 3.0},
        break_force={"bend": 9.0},
        damping={"structural": 0.25},
        break_in={"shear": "tension"},
    )
    a, b = springs.between.T
    distance = np.linalg.norm(particles.position[a] - particles.position[b], axis=1)
    np.testing.assert_allclose(springs.rest_length, distance, rtol=1e-15)
    shear, bend = np.isclose(distance, np.sqrt(8)), np.isclose(distance, 4)
    structural = np.isclose(distance, 2)
    assert (springs.stiffness == np.where(shear, 3, 7)).all()
    assert (springs.break_force == np.where(bend, 9, np.inf)).all()
    assert (springs.damping == np.where(structural, 0.25, 0.5)).all()
    assert (springs.break_in == np.where(shear, "tension", "both")).all()
    assert structural.sum() == 4 * 4 + 5 * 3 and shear.sum() == 2 * 4 * 3
    assert bend.sum() == 3 * 4 + 5 * 2


def test_springs_come_before_cloth_links_and_may_tie_to_a_cloth():
    scene = scenefile.parse(
        """
        [world]
        size = [100, 100]
        [[cloths]]
        origin = [10, 10]
        columns = 2
        rows = 1
        spacing = 5
        [[cloths]]
        origin = [10, 50]
        columns = 1
        rows = 2
        spacing = 5
        [[particles]]
        position = [20, 20]
        [[springs]]
        between = [0, 2]
        [[springs]]
        between = [3, 0]
        break_force = 2
        """
    )
    np.testing.assert_array_equal(scene.springs.between, [(0, 2), (3, 0), (2, 1), (4, 3)])
    np.testing.assert_array_equal(scene.springs.break_force, [np.inf, 2, np.inf, np.inf])
    np.testing.assert_allclose(
        scene.springs.rest_length, [np.hypot(5, 10), np.hypot(10, 30), 5, 5], rtol=1e-15
    )


def test_springs_break_in_both_directions_where_nothing_else_is_said():
    text = EXAMPLE.replace("between = [0, 1]", "between = [0, 1]\nBREAK_IN")
    text = text.replace("break_force = 5.0", "break_force = 5.0\nDEFAULT") + "LINKS\n"

    def kinds(single="", default="", links=""):
        written = text.replace("BREAK_IN", single).replace("DEFAULT", default)
        scene = scenefile.parse(written.replace("LINKS", links))
        assert_same_scene(scenefile.parse(scenefile.dump(scene)), scene)
        return scene.spring_defaults.break_in, *scene.springs.break_in[:2]

    tension = 'break_in = "tension"'
    assert kinds() == ("both", "both", "both")
    assert kinds(default=tension) == ("tension", "tension", "tension")
    assert kinds(tension) == ("both", "tension", "both")
    assert kinds('break_in = "both"', tension) == ("tension", "both", "tension")
    assert kinds(links=tension) == ("both", "both", "tension")
    assert kinds(links='break_in = { structural = "tension" }') == ("both", "both", "tension")


def test_a_cloth_may_give_one_number_for_all_its_links():
    links = EXAMPLE.replace('["structural"]', '["structural", "shear"]')
    scene = scenefile.parse(links.replace("{ structural = 0.5 }", "0.25\nbreak_force = false"))
    cloth = scene.springs.select(np.arange(1, len(scene.springs)))
    assert (cloth.stiffness == 0.25).all() and np.isinf(cloth.break_force).all()


def test_false_makes_single_springs_unbreakable():
    text = EXAMPLE.replace("between = [0, 1]", "between = [0, 1]\nbreak_force = false")
    assert scenefile.parse(text).springs.break_force[0] == np.inf


@pytest.mark.parametrize(
    ("walls", "count"), [("true", 4), ("false", 0), ('["top"]', 1), ('["top", "top"]', 1)]
)
def test_walls(walls, count):
    text = f"[world]\nsize = [10, 10]\nwalls = {walls}"
    assert len(scenefile.parse(text).world.walls) == count


@pytest.mark.parametrize("name", library.names())
def test_built_in_scenes_survive_a_file(name, tmp_path):
    scene = small.build(name)
    scenefile.save(scene, tmp_path / "scene.toml")
    assert_same_scene(scenefile.load(tmp_path / "scene.toml"), scene)


# Once Taichi has started, the processor takes subnormal numbers for zero in the whole process.
finite = st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=False)
positive = st.floats(1e-300, 1e300)
not_negative = st.floats(0, 1e300, allow_subnormal=False)
fraction = st.floats(0, 1, allow_subnormal=False)


@st.composite
def any_scene(draw) -> Scene:
    """A valid scene of up to six particles with every kind of value."""
    dim = draw(st.sampled_from((2, 3)))
    size = tuple(draw(st.lists(st.floats(1e-3, 1e6), min_size=dim, max_size=dim)))
    walls = [name for name, (axis, _) in WALLS.items() if axis < dim]
    world = World(
        size=size,
        gravity=tuple(draw(st.lists(finite, min_size=dim, max_size=dim))),
        dt=draw(positive),
        walls=tuple(draw(st.lists(st.sampled_from(walls), unique=True))),
        collisions=draw(st.booleans()),
        mouse=draw(st.sampled_from(MOUSE_MODES)),
    )
    particle_defaults = ParticleDefaults(
        draw(positive), draw(not_negative), draw(not_negative), draw(fraction)
    )
    spring_defaults = SpringDefaults(
        draw(not_negative),
        draw(st.none() | not_negative),
        draw(st.none() | positive),
        draw(not_negative),
        draw(st.sampled_from(BREAK_IN)),
    )
    n = draw(st.integers(0, 6))

    def column(values, count):
        return draw(st.lists(values, min_size=count, max_size=count))

    inside = np.array(column(st.tuples(*[fraction] * dim), n)).reshape(n, dim)
    position = np.clip(world.low + inside * np.array(size), world.low, world.high)
    particles = Particles.build(
        position,
        np.array(column(st.tuples(*[finite] * dim), n)).reshape(n, dim),
        mass=column(st.just(particle_defaults.mass) | positive, n),
        radius=column(not_negative, n),
        viscous=column(not_negative, n),
        restitution=column(fraction, n),
        fixed=column(st.booleans(), n),
        color=np.array(column(st.tuples(*[st.integers(0, 255)] * 3), n)).reshape(n, 3),
    )
    pairs = [(i, j) for i in range(n) for j in range(i)]
    pairs = draw(st.lists(st.sampled_from(pairs), unique=True)) if pairs else []
    s = len(pairs)
    springs = Springs.build(
        pairs,
        position,
        stiffness=column(not_negative, s),
        rest_length=column(not_negative, s),
        break_force=column(positive | st.just(np.inf), s),
        damping=column(not_negative, s),
        break_in=column(st.sampled_from(BREAK_IN), s),
    )
    name = draw(st.text(st.characters(codec="utf-8", exclude_categories=("Cs",)), max_size=20))
    spring_color = draw(st.none() | st.tuples(*[st.integers(0, 255)] * 3))
    defaults = particle_defaults, spring_defaults
    return validate(Scene(name, world, particles, springs, *defaults, spring_color))


@settings(max_examples=150, deadline=None)
@given(any_scene())
def test_any_scene_survives_being_written_and_read(scene):
    assert_same_scene(scenefile.parse(scenefile.dump(scene)), scene)


@settings(max_examples=150, deadline=None)
@given(st.text(max_size=200) | st.sampled_from(EXAMPLE.splitlines()).map("\n".join))
def test_no_text_does_worse_than_being_refused(text):
    try:
        scenefile.parse(text)
    except InputError as error:
        assert "\n" not in str(error) or "\n" in text


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_no_edit_of_a_scene_does_worse_than_being_refused(data):
    """Any value in the examples may be replaced by any other kind of value."""
    lines = data.draw(st.sampled_from([EXAMPLE, IN_SPACE])).strip().splitlines()
    at = data.draw(st.sampled_from([i for i, line in enumerate(lines) if "=" in line]))
    value = data.draw(
        st.sampled_from(
            [
                *("0", "-1", "nan", "inf", "1e999", "true", '"x"', "[]", "[1]", "[1, 2]", "{}"),
                *("[1, 2, 3]", '["x"]', "[[0, 0]]", "[[0]]", "1979-05-27", "9" * 30, "9" * 400),
                *("{ x = 1 }", "{ structural = nan }", "{ structural = [] }", "[nan, 0, 0]"),
                *("[[0, 1, 2], [3]]", "2.5", "false"),
            ]
        )
    )
    lines[at] = lines[at].split("=")[0] + "= " + value
    try:
        scene = scenefile.parse("\n".join(lines))
    except InputError as error:
        assert f"line {at + 1}" in str(error) or lines[at].startswith(_CHANGES_OTHERS), str(error)
    else:
        validate(scene)


# A change of these may be noticed elsewhere: where particles no longer fit the world, a link is a
# duplicate, the partner of a spring is gone, or a number is given for links that are not there.
_CHANGES_OTHERS = (
    "between",
    "size",
    "columns",
    "rows",
    "spacing",
    "origin",
    "across",
    "down",
    "links",
    "stiffness",
    "stretch",
    "shear",
    "starts",
    "vertices",
)


def test_one_number_of_a_cloth_is_that_of_all_its_links():
    entry = """
[world]
size = [100, 100]
[spring]
break_force = 5
[[cloths]]
origin = [10, 10]
columns = 3
rows = 3
spacing = 5
links = ["structural", "shear"]
"""
    numbers = "stiffness = 2\ndamping = 0.5\nbreak_force = false\nrest_length = 6.5\n"
    springs = scenefile.parse(entry + numbers).springs
    assert len(springs) == 12 + 8
    assert (springs.stiffness == 2).all() and (springs.damping == 0.5).all()
    assert np.isinf(springs.break_force).all() and (springs.rest_length == 6.5).all()
    by_kind = "break_force = { shear = 3 }\n"
    assert set(scenefile.parse(entry + by_kind).springs.break_force) == {5.0, 3.0}
    ours = grid((10, 10), 3, 3, 5, links=("structural", "shear"), stiffness=2, rest_length=6.5)[1]
    assert (ours.stiffness == 2).all() and (ours.rest_length == 6.5).all()
    for wrong, says in (
        ("stiffness = -2", "line 12: .* stiffness must not be negative, is -2"),
        ("stiffness = [2]", "line 12: .* stiffness must be a number, or a table with one for each"),
        ("break_force = 0", "line 12: .* break_force must be positive, is 0"),
        ("damping = inf", "line 12: .* damping must be finite"),
        ("stiffness = false", "line 12: .* stiffness must be a number, or"),
    ):
        with pytest.raises(InputError, match=says):
            scenefile.parse(entry + wrong)


def test_triangles_of_cloths_and_of_a_list_come_back_as_they_were():
    """Two a cell, all with the same normal; a list of one's own first, numbered as particles are.

    Without a particle those at it are gone, the others keep their corners.
    """
    text = """
    triangles = [[0, 1, 2],
        [3, 1, 0]]
    [world]
    size = [9.0, 9.0, 9.0]
    [[particles]]
    position = [1.0, 1.0, 0.0]
    [[cloths]]
    origin = [2.0, 2.0, 0.0]
    columns = 4
    rows = 3
    spacing = 1.0
    """
    scene = scenefile.parse(text)
    np.testing.assert_array_equal(scene.triangles[:2], [[0, 1, 2], [3, 1, 0]])
    mine, x = scene.triangles[2:], scene.particles.position
    assert len(mine) == 2 * 3 * 2 and len(np.unique(np.sort(mine), axis=0)) == len(mine)
    area = np.cross(x[mine[:, 1]] - x[mine[:, 0]], x[mine[:, 2]] - x[mine[:, 0]]) / 2
    np.testing.assert_array_equal(area, np.tile([0.0, 0.0, 0.5], (12, 1)))  # across x down
    again = scenefile.parse(scenefile.dump(scene))
    np.testing.assert_array_equal(again.triangles, scene.triangles)
    left, _ = editing.without(Snapshot.at_start(scene), [5])
    kept = scene.triangles[(scene.triangles != 5).all(axis=1)]
    np.testing.assert_array_equal(left.x[left.scene.triangles], x[kept])
    assert not editing.same(
        Snapshot.at_start(scene), Snapshot.at_start(replace(scene, triangles=mine))
    )
    for listed, says in (("[0, 1, 13]", "there is no particle 13"), ("[2, 1, 2]", "one particle")):
        with pytest.raises(InputError, match=rf"line 2: triangle 0: .*{says}"):
            scenefile.parse(text.replace("[0, 1, 2]", listed))


def test_the_document_has_every_key_with_the_unit_and_the_limits_that_are_declared():
    """And no key that there is not. Keys of [particle] and [spring] stand there alone."""
    rows = re.findall(
        r"^\| `(\[+\w+\]+)(?: (\w+))?` \| `([\w.]+)` \| (.*?) ?\| (.+?) \| (.+?) \|$",
        DOCUMENT.read_text(),
        re.M,
    )
    documented = {(table, shape, key): says for table, shape, key, *says in rows}
    assert len(documented) == len(rows)
    inherited = dict.fromkeys(("springs", "cloths", "meshes"), SPRING_PROPERTIES)
    inherited["particles"] = PARTICLE_PROPERTIES
    known = {}
    for table, keys in tables.TABLES.items():
        name = f"[{table}]" if table in ("world", "particle", "spring") else f"[[{table}]]"
        own = [key for key in keys if table and key not in inherited.get(table, ())]
        known |= {(name, "", key): None for key in own}
    for key in world_keys().values():
        inner = {f"{key.name}.{part.name}": part for part in key.table.values()}
        known |= {("[world]", "", name): part for name, part in (inner or {key.name: key}).items()}
    known |= {("[particle]", "", name): about for name, about in PARTICLE_PROPERTIES.items()}
    known |= {("[spring]", "", name): about for name, about in SPRING_PROPERTIES.items()}
    known |= {("[[obstacles]]", "", key.name): key for key in COMMON}
    for shape in obstacles.shapes():
        known |= {("[[obstacles]]", shape, key.name): key for key in kinds.load(shape).keys}
    assert documented.keys() == known.keys()
    for place, about in known.items():
        if about is not None:
            unit, says, absent = documented[place]
            assert unit == about.unit, place
            for words, limit in (("at least", "minimum"), ("more than", "above")):
                if getattr(about, limit, None) is not None:
                    assert f"{words} {getattr(about, limit):g}" in says, place
            if getattr(about, "rule", None) and not getattr(about, "words", ()):
                assert re.sub("must (be )?", "", about.rule.of_links) in says, place
            if isinstance(default := getattr(about, "default", None), float):
                assert absent.partition("; with")[0] == f"{default:g}", place


def test_a_scene_of_numpy_s_numbers_is_one_of_python_s():
    """Its world and obstacles are compared, asked whether they are, and written as text; pairs of
    narrow whole numbers would overflow where they are made one number."""
    particles, springs = grid([0.1, 0.1, 0.0], 16, 12, 0.125, links=["structural", "shear"])
    triangles = grid_triangles(16, 12)
    air = {"density": 1.25, "drag": 1.0, "lift": 0.5}
    plain = Scene(
        "numbers",
        World(
            *((4.0, 4.0, 4.0), (0.0, -9.5, 0.0), 0.25, ("left", "right"), True, "blow", 0.0, 0.5),
            *("resting", {"air": air}, "y"),
        ),
        *(particles, springs),
        particle_defaults=ParticleDefaults(mass=2.0),
        spring_defaults=SpringDefaults(break_force=3.0),
        spring_color=(1, 2, 3),
        triangles=triangles,
        obstacles=(Obstacle("sphere", {"centre": (3.0, 3.0, 0.0), "radius": 0.5}),),
    )
    world, f = plain.world, np.float32
    narrow = replace(
        plain,
        world=World(
            *(np.array(world.size, f), np.array(world.gravity), f(0.25), np.array(world.walls)),
            *(np.bool_(True), np.str_("blow"), f(0.0), f(0.5), np.str_("resting")),
            *({"air": {name: f(value) for name, value in air.items()}}, np.str_("y"), np.False_),
        ),
        particles=replace(particles, radius=particles.radius.astype(f), color=particles.color + 0),
        springs=replace(springs, between=springs.between.astype(np.uint8)),
        particle_defaults=ParticleDefaults(mass=f(2.0)),
        spring_defaults=SpringDefaults(break_force=np.float64(3.0)),
        spring_color=np.array([1, 2, 3]),
        triangles=triangles.astype(np.uint8),
        obstacles=(Obstacle("sphere", {"centre": np.array([3.0, 3.0, 0.0]), "radius": f(0.5)}),),
    )
    assert validate(narrow).world == world
    assert narrow.obstacles == plain.obstacles
    assert digest(narrow) == digest(plain)
    assert scenefile.dump(narrow) == scenefile.dump(plain)
    sides = springs_of_sides(narrow.triangles, narrow.springs.between)
    np.testing.assert_array_equal(sides, springs_of_sides(triangles, springs.between))
    assert narrow.particles.radius.dtype == np.float64
