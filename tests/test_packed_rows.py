"""Rows of a graph in packs: the same sums, to the last bit, whatever a net looks like."""

from dataclasses import replace

import inside
import numpy as np
import pytest
from selection import as_thorough

from bench.cloths import sheet
from bench.equal_error.problems import NEAR, drape
from taichi_cloth.scene.library import build
from taichi_cloth.scene.model import Springs
from taichi_cloth.scene.obstacles import Obstacle
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.simulation.storage import adjacency, layouts, packing


@pytest.fixture
def small_nets(monkeypatch):
    """Rows of nets of any size are packed."""
    monkeypatch.setattr(layouts, "WORTH_SORTING", 0)
    monkeypatch.setattr(layouts, "WORTH_PACKING", 0)


def net(seed, count, most=7):
    """Ends of springs of a net in no order: some particles have many, some none."""
    rng = np.random.default_rng(seed)
    between = rng.integers(count, size=(count * most // 4, 2))
    return between[between[:, 0] != between[:, 1]]


def lattice(columns, rows, layers):
    """Ends of springs along the axes of a lattice, particle by particle."""
    at = np.arange(columns * rows * layers).reshape(layers, rows, columns)
    along = [(at[:, :, :-1], at[:, :, 1:]), (at[:, :-1], at[:, 1:]), (at[:-1], at[1:])]
    between = np.concatenate([np.stack([a, b], axis=-1).reshape(-1, 2) for a, b in along])
    return between[np.lexsort(between.T[::-1])]


@pytest.mark.parametrize(
    "between, count, copied",
    [
        (lattice(9, 7, 5), 320, 0.1),
        (lattice(64, 2, 3), 384, 0.1),
        (net(1, 64), 64, 1.0),
        (net(2, 640, most=30), 640, 1.0),
        (np.zeros((0, 2), np.int64), 16, 0.0),
    ],
)
def test_every_half_spring_is_read_once_in_its_row_s_order(between, count, copied):
    half = adjacency.half_springs(between, count)
    rows = packing.packed(half)
    packs, columns = count // packing.LANES, len(rows.run)
    assert rows.start[0] == 0 and rows.start[-1] == columns
    assert rows.packs == packs and rows.copies <= copied * columns
    column, lane = np.divmod(rows.place, packing.LANES)
    np.testing.assert_array_equal(lane, half.near % packing.LANES)
    # What a column reads: of particles, or of copies.
    slot = np.append(np.arange(count), rows.copied)
    np.testing.assert_array_equal(slot[rows.run[column] + lane], half.far)
    assert (rows.run >= 0).all() and (rows.run + packing.LANES <= len(slot)).all()
    for i in range(count):
        mine = column[half.row[i] : half.row[i + 1]]
        pack = i // packing.LANES
        assert (np.diff(mine) > 0).all()
        assert ((rows.start[pack] <= mine) & (mine < rows.start[pack + 1])).all()


def torn(scene, every):
    """A scene without some of its springs, so that no rows of its are alike."""
    s = scene.springs
    kept = np.random.default_rng(3).random(len(s)) > 1 / every
    return replace(scene, springs=s.select(kept))


def thrown():
    """A torn sheet that a ball is thrown and turned against, and that goes with it where held."""
    sheet = torn(drape(33), 12)
    x = sheet.particles.position
    held = (abs(x[:, 0] - 1.0) < 0.1) & (abs(x[:, 2]) < 0.1)
    moves = {"velocity": [0.5, 1.0, 0.2], "spin": [0.0, 90.0, 30.0]}
    ball = Obstacle.build(
        "sphere", centre=[1.0, 0.3, 0.0], radius=0.3, friction=0.5, grip=0.1, **moves
    )
    particles = replace(sheet.particles, fixed=held)
    return replace(sheet, particles=particles, obstacles=(ball,))


def caught():
    """A cloth in a plane, with dashpots, that falls on a ball and tears there."""
    cloth = build("cloth", columns=30, rows=24)
    x, springs = cloth.particles.position, cloth.springs
    ball = Obstacle.build(
        "sphere", centre=[x[:, 0].mean(), x[:, 1].max() + 101.0], radius=100.0, friction=0.3
    )
    springs = replace(springs, damping=np.full(len(springs), 0.01))
    return replace(cloth, springs=springs, obstacles=(ball,))


def scenes():
    """Nets with and without dashpots, in space and in a plane, whole, torn and tearing."""
    warp = build("warp", side=20)
    cloth = build("cloth", columns=30, rows=24)
    met = {"thrown": thrown(), "caught": caught()}
    return {"dashpots": warp, "torn": torn(warp, 12), "breaking": cloth, **met}


@pytest.mark.parametrize(
    "name, method",
    [
        ("dashpots", "symplectic_euler"),
        ("torn", "verlet"),
        as_thorough(("breaking", "symplectic_euler")),
        as_thorough(("thrown", "rk4")),
        ("caught", "verlet"),
    ],
)
def test_a_net_moves_as_one_by_one_to_the_last_bit(name, method, small_nets, request):
    scene = scenes()[name]
    tears = name in ("breaking", "caught")
    substeps = 8 if tears else 16
    rng = np.random.default_rng(5)
    push = rng.normal(0, 6.0 if tears else 0.3, scene.particles.position.shape)
    scene.particles.velocity[:] = np.where(scene.particles.fixed[:, None], 0.0, push)
    given = {"method": method, "substeps": substeps, "topology": "graph"}
    meets = name in ("thrown", "caught")
    given["accounts_contacts"] = meets
    one, packed = (
        Simulation(scene, execution=path, lanes=lanes, **given)
        for path, lanes in (("serial", 1), ("parallel", None))
    )
    assert not inside.spec_of(one).packed_rows and inside.spec_of(packed).packed_rows
    if meets:  # which compiles long
        request.getfixturevalue("all_compiled_soon")
    for sim in (one, packed):
        sim.account_contacts()
    for _ in range(3):
        one.advance(2)
        packed.advance(2)
        np.testing.assert_array_equal(one.positions(), packed.positions())
        np.testing.assert_array_equal(one.velocities(), packed.velocities())
        np.testing.assert_array_equal(one.springs_alive(), packed.springs_alive())
        np.testing.assert_array_equal(one.forces(), packed.forces())
    assert packed.springs_alive().all() != tears
    if name == "thrown":
        centre = np.array([1.0, 0.3, 0.0]) + 0.1 * np.array([0.5, 1.0, 0.2])
        reach = np.linalg.norm(packed.positions() - centre, axis=1) - 0.3 - NEAR
        assert 20 < (abs(reach) < 1e-9).sum() < 500  # that lie on the ball
    if meets:
        account, same = one.contact_account(), packed.contact_account()
        assert abs(account.balance) > 0.01 and account.balance == pytest.approx(same.balance)
        assert account.gained == pytest.approx(same.gained)
        assert account.first_touch == same.first_touch
    if name == "breaking":  # a checkpoint, and a load, of a net with springs that are gone
        checkpoint = packed.checkpoint()
        packed.advance(3)
        after = packed.positions()
        packed.restore(checkpoint)
        packed.advance(3)
        np.testing.assert_array_equal(packed.positions(), after)
        one.advance(3)
        np.testing.assert_array_equal(one.positions(), after)
        for sim in (one, packed):
            sim.spawn((50.0, 300.0))  # the springs are stored anew
            sim.advance(2)
        np.testing.assert_array_equal(one.positions(), packed.positions())


def test_a_shuffled_sheet_is_packed_in_our_order_and_a_tangle_is_not(small_nets):
    scene = sheet(80)
    given = {"substeps": 16, "topology": "graph", "execution": "serial", "dt": 0.08 / 80}
    one, packed = (Simulation(scene, lanes=lanes, **given) for lanes in (1, None))
    assert inside.spec_of(packed).packed_rows
    for sim in (one, packed):
        sim.advance(3)
    assert np.abs(one.positions() - scene.particles.position).max() > 1e-4
    np.testing.assert_allclose(packed.positions(), one.positions(), atol=1e-12)

    between = np.unique(np.sort(net(4, len(scene.particles)), axis=1), axis=0)
    tangle = Springs.build(between, scene.particles.position)
    sim = Simulation(replace(scene, springs=tangle), **given)
    assert not inside.spec_of(sim).packed_rows
