"""The built-in scenes say what they are, and move as their closed forms say (CPU, f64)."""

import copy
import inspect
import pickle
from dataclasses import replace

import numpy as np
import pytest
import small
from selection import as_thorough

from taichi_cloth.errors import InputError
from taichi_cloth.scene import library
from taichi_cloth.scene.checks import validate
from taichi_cloth.scene.model import Particles, Scene
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.scene.solids import held, solids

# What takes long to compile: `test_space_scenes.py` runs it, for seconds.
LONG = ("pull", "twist", "stack", "curtain", "shirt", "drape")


@pytest.mark.parametrize("name", library.names())
def test_every_scene_declares_itself(name):
    assert library.description(name).endswith(".")
    for parameter in library.parameters(name).values():
        assert parameter.help and parameter.check("it", parameter.default) == parameter.default
    assert library.build(name).name == name
    signature = inspect.signature(library.function(name))
    assert all(p.kind is p.KEYWORD_ONLY for p in signature.parameters.values())


def test_scenes_are_equal_where_all_of_their_numbers_are():
    """NumPy raised at the first table: "The truth value of an array ... is ambiguous"."""
    scene, again = (library.build("flag", columns=6) for _ in range(2))
    assert scene == again and scene in [again] and scene.springs == again.springs
    assert scene == copy.deepcopy(scene) == pickle.loads(pickle.dumps(scene))
    stiff = replace(scene.springs, stiffness=2 * scene.springs.stiffness)
    corner = scene.particles.position.copy()
    corner[0, 0] += 1e-9
    for other in (
        replace(scene, name="banner"),
        replace(scene, springs=stiff),
        replace(scene, particles=replace(scene.particles, position=corner)),
        replace(scene, triangles=scene.triangles[1:]),
        library.build("flag", columns=7),
    ):
        assert scene != other
    assert scene != "flag" and scene.particles != scene.springs
    assert scene.stencils == again.stencils


def test_particles_at_no_position_are_refused():
    """No position, and a single number, were one particle in 0 and in 1 dimension."""
    for given, says in (([], r"has \(0,\); Particles.none\(dim\) are none"), (1.0, r"has \(\)")):
        with pytest.raises(InputError, match=r"must have shape \(n, dim\), " + says):
            Particles.build(given)
    assert len(Particles.build(np.zeros((0, 3)))) == 0 and len(Particles.build([1.0, 2.0])) == 1


def test_lists_of_obstacles_and_triangles_are_taken():
    """They were refused: obstacles "must be a tuple", triangles "must be an array"."""
    scene, ball = (
        library.build("flag", columns=6),
        Obstacle.build("sphere", centre=3 * [0], radius=1),
    )
    for given in ([ball], (ball,), iter([ball]), np.array([ball])):
        assert validate(replace(scene, obstacles=given)).obstacles == (ball,)
    assert validate(replace(scene, obstacles=[])).obstacles == ()
    listed = replace(scene, triangles=scene.triangles.tolist())
    assert validate(listed) == scene and listed.triangles.dtype == np.int64
    assert validate(replace(scene, triangles=[])).triangles.shape == (0, 3)
    for name, wrong, says in (
        ("obstacles", ball, "must be a list of Obstacle"),
        ("obstacles", [1], "obstacle 0: must be an Obstacle, is 1"),
        ("triangles", [[0, 1], [2]], "must be an array of whole numbers"),
    ):
        with pytest.raises(InputError, match=says):
            validate(replace(scene, **{name: wrong}))


@pytest.mark.parametrize("name", [name for name in library.names() if name not in LONG])
def test_every_scene_runs(name, pool):
    scene = small.build(name)
    x = frames(pool, scene, 3, dt="auto" if scene.world.substeps == "auto" else None)
    still = scene.particles.fixed & (held(scene, solids(scene))[0] < 0)
    assert np.isfinite(x).all() and (x[:, still] == x[0, still]).all()
    assert len(scene.particles) == 0 or (x[-1] != x[0]).any(), "nothing moves"


def frames(pool, scene, count, **step):
    """Positions at the start and after each frame, (count + 1, n, dim)."""
    sim = pool(scene, **step)
    positions = [sim.positions()]
    for _ in range(count):
        sim.advance()
        positions.append(sim.positions())
    return np.array(positions)


def test_the_oscillator_is_a_cosine(pool):
    x = frames(
        pool,
        library.build("oscillator", amplitude=40.0, stiffness=0.02, mass=2.0),
        200,
        substeps=200,
    )
    t = np.arange(201)
    np.testing.assert_allclose(x[:, 1, 0], 250 + 40 * np.cos(0.1 * t), atol=0.05)
    assert (x[:, 1, 1] == 100).all() and (x[:, 0] == (100, 100)).all()


@pytest.mark.parametrize(("n", "mode"), [(1, 1), (7, 2), (16, 1), (16, 16)])
def test_the_chain_swings_in_its_normal_mode(pool, n, mode):
    scene = library.build("chain", particles=n, mode=mode)
    x = frames(pool, scene, 100, substeps=200)
    omega = 2 * np.sqrt(0.1) * np.sin(np.pi * mode / (2 * (n + 1)))
    at_rest = 50 + 500 * np.arange(n + 2) / (n + 1)
    expected = at_rest + np.cos(omega * np.arange(101))[:, None] * (x[0, :, 0] - at_rest)
    # Symplectic Euler with step h is off by A w h / 2 (a shift of half a step in time).
    amplitude = np.abs(x[0, :, 0] - at_rest).max()
    np.testing.assert_allclose(x[:, :, 0], expected, atol=0.6 * amplitude * omega / 200)


@pytest.mark.parametrize("n", [20, 100])
def test_the_slinkys_bottom_waits_for_the_collapse(pool, n):
    scene = library.build("slinky", particles=n)
    y = frames(pool, scene, 3 * n)[:, :, 1]
    arrival = int(n * np.sqrt(1 / 0.25))  # frames: n sqrt(m/k)
    # The ripple ahead of the front spreads like its cube root: a few particles' worth.
    early = arrival - int(5 * n ** (1 / 3))
    assert np.abs(y[:early, -1] - y[0, -1]).max() < 0.01 * (y[0, 1] - y[0, 0])
    assert y[early, 0] - y[0, 0] > 100
    assert y[3 * n, -1] - y[0, -1] > 10
    assert (np.diff(y[:early], axis=1) > 0).all(), "no particle passes another"
    # The centre of mass falls freely all the time; symplectic Euler adds g t dt / 2.
    t, g = np.arange(3 * n + 1), scene.world.gravity[1]
    np.testing.assert_allclose(y.mean(axis=1) - y[0].mean(), g * t * (t + 1) / 2, atol=1e-8)


@pytest.mark.parametrize("name", ["box", "sandbox"])
@pytest.mark.parametrize("count", [1, 2, 25])
def test_scattered_particles_touch_neither_each_other_nor_walls(name, count):
    scene = library.build(name, particles=count, radius=20.0, seed=count)
    position, world = scene.particles.position, scene.world
    distance = np.linalg.norm(position[:, None] - position, axis=2) + 1e9 * np.eye(count)
    assert len(position) == count and distance.min() >= 2 * 20
    assert (position >= world.low + 20).all() and (position <= world.high - 20).all()


def test_the_cloth_takes_shear_and_bend_springs_and_dashpots(pool):
    plain = library.build("cloth").springs
    assert len(plain) == 356 and (plain.damping == 0).all() and (plain.rest_length == 25).all()
    fuller = library.build("cloth", shear=0.1, bend=0.05, damping=0.02)
    springs, (a, b) = fuller.springs, fuller.springs.between.T
    assert {k: int((springs.stiffness == k).sum()) for k in (0.5, 0.1, 0.05)} == {
        0.5: 356,
        0.1: 2 * 15 * 11,
        0.05: 14 * 12 + 16 * 10,
    }
    assert len(springs) == 1014 and (springs.damping == 0.02).all()
    apart = np.linalg.norm(fuller.particles.position[a] - fuller.particles.position[b], axis=1)
    np.testing.assert_allclose(springs.rest_length, apart, rtol=1e-12)
    one_kind = library.build("cloth", columns=3, rows=3, bend=0.05).springs
    assert set(one_kind.stiffness) == {0.5, 0.05} and len(one_kind) == 12 + 6
    # It hangs whole, and less than the plain one, which diagonals do not hold in shape.
    hung = {}
    for name, scene in (("plain", library.build("cloth")), ("fuller", fuller)):
        sim = pool(scene)
        sim.advance(300)
        assert sim.springs_alive().all()
        hung[name] = sim.positions()[:, 1].max()
    assert fuller.particles.position[:, 1].max() < hung["fuller"] < hung["plain"] - 10


@pytest.mark.parametrize("name", ["shear", "bend", "damping"])
def test_the_cloths_springs_are_checked(name):
    for wrong in (-0.1, float("inf"), "much"):
        with pytest.raises(InputError, match=name):
            library.build("cloth", **{name: wrong})


def pinned(scene):
    """The columns of the pins, all of them in the first row."""
    return [int(i) for i in np.flatnonzero(scene.particles.fixed)]


def test_the_cloths_own_size_has_the_numbers_of_the_first_program():
    scene = library.build("cloth")
    assert pinned(scene) == [0, 8, 15] and scene.world.gravity == (0.0, 0.05)
    assert (scene.springs.stiffness == 0.5).all() and (scene.springs.break_force == 5.0).all()
    assert scene.world.size == (600.0, 400.0)


@pytest.mark.parametrize(
    ("size", "pins"),
    [
        ((1, 50, 25.0), 1),
        ((2, 3, 25.0), 2),
        ((44, 33, 8.0), 7),
        as_thorough(((64, 48, 6.0), 9)),
        as_thorough(((24, 16, 18.0), 4)),
        as_thorough(((100, 10, 25.0), 14)),
        as_thorough(((10, 100, 25.0), 3)),
        as_thorough(((128, 128, 25.0), 17)),
        as_thorough(((200, 150, 25.0), 26)),
    ],
)
def test_a_cloth_of_any_size_hangs_and_the_mouse_tears_it(pool, size, pins):
    columns, rows, spacing = size
    scene = library.build("cloth", columns=columns, rows=rows, spacing=spacing)
    assert len(pinned(scene)) == pins
    sim = pool(scene)
    lowest = 0.0
    for _ in range(25):
        sim.advance(100)
        lowest = max(lowest, sim.positions()[:, 1].max())
    assert sim.springs_alive().all(), "it tears itself"
    assert np.abs(sim.velocities()).max() < 0.2, "it does not come to rest"
    assert lowest < scene.world.size[1] - 20, "it lies on the floor"
    if columns < 16:
        return  # a ribbon gives way
    middle = sim.positions()[columns // 2 + columns * (min(rows, 12) // 2)]
    for sign in (1, -1, 1, -1, 1, -1):
        sim.blow(middle, (200.0 * sign, 100.0))
        sim.advance(3)
    assert 0 < (~sim.springs_alive()).sum() < 0.5 * len(scene.springs)


def test_the_cloths_pins_gravity_and_springs_are_parameters():
    def cloth(**values) -> Scene:
        return library.build("cloth", **values)

    assert pinned(cloth(pins=2)) == [0, 15] and pinned(cloth(pins=1)) == [8]
    assert pinned(cloth(pins=None)) == pinned(cloth())  # its default, given
    assert pinned(cloth(pins=0)) == [] and pinned(cloth(pins=16)) == list(range(16))
    with pytest.raises(InputError, match="pins must be at most the columns, 16, is 17"):
        cloth(pins=17)
    assert cloth(rows=48).world.gravity == (0.0, 0.0125)
    assert cloth(rows=48, gravity=0.05).world.gravity == (0.0, 0.05)
    assert cloth(gravity=-0.1).world.gravity == (0.0, -0.1)
    stiffer = cloth(stiffness=0.2, shear=0.1, break_force=7.0).springs
    assert set(stiffer.stiffness) == {0.2, 0.1} and (stiffer.break_force == 7).all()
    assert np.isinf(cloth(break_force=np.inf).springs.break_force).all()
    for wrong in (0.0, -np.inf, np.nan):
        with pytest.raises(InputError, match="break_force"):
            cloth(break_force=wrong)
